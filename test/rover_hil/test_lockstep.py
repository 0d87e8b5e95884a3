"""Participants that a SYNC waits for in lockstep."""

from __future__ import annotations

from rover_hil.bridge.lockstep import LockstepBarrier
from rover_hil.canopen.devices import SYNC_PERIOD

TIMEOUT = 3.0


def test_without_participants_cycles_follow_the_wall_clock():
    lockstep = LockstepBarrier(TIMEOUT)
    assert not lockstep.may_go_on(1, 0.9 * SYNC_PERIOD)
    assert lockstep.may_go_on(1, SYNC_PERIOD)


def test_a_participant_is_awaited_within_the_timeout():
    lockstep = LockstepBarrier(TIMEOUT)
    lockstep.on_progress("winch", 1)
    assert lockstep.may_go_on(1, 0.0)
    assert not lockstep.may_go_on(2, TIMEOUT)
    lockstep.on_progress("winch", 2)
    assert lockstep.may_go_on(2, 0.0)


def test_a_command_source_is_awaited_in_one_of_every_few_cycles():
    lockstep = LockstepBarrier(TIMEOUT)
    lockstep.on_progress("command source", 5, within=3)
    assert all(lockstep.may_go_on(cycle, 0.0) for cycle in (5, 6, 7))
    assert not lockstep.may_go_on(8, SYNC_PERIOD)


def test_a_lost_participant_costs_the_timeout_once_and_is_awaited_again_when_back():
    lockstep = LockstepBarrier(TIMEOUT)
    lockstep.on_progress("jump", 1)
    lockstep.on_progress("winch", 1)
    lockstep.on_progress("winch", 2)
    assert not lockstep.may_go_on(2, TIMEOUT)
    assert lockstep.may_go_on(2, TIMEOUT + SYNC_PERIOD)
    lockstep.on_progress("winch", 3)
    assert lockstep.may_go_on(3, 0.0)
    assert not lockstep.may_go_on(4, 0.0)  # the other one is still awaited
    lockstep.on_progress("winch", 4)
    lockstep.on_progress("jump", 4)
    lockstep.on_progress("winch", 5)
    assert not lockstep.may_go_on(5, 0.0)
