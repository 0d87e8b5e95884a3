"""Whom a SYNC waits for in lockstep."""

from __future__ import annotations

from rover_hil.devices import SYNC_PERIOD
from rover_hil.lockstep import LockstepBarrier

PATIENCE = 3.0


def test_while_nobody_was_heard_cycles_go_by_the_wall_clock():
    lockstep = LockstepBarrier(PATIENCE)
    assert not lockstep.may_go_on(1, 0.9 * SYNC_PERIOD)
    assert lockstep.may_go_on(1, SYNC_PERIOD)


def test_who_was_heard_is_waited_for_however_long_it_takes_within_the_patience():
    lockstep = LockstepBarrier(PATIENCE)
    lockstep.on_progress("winch", 1)
    assert lockstep.may_go_on(1, 0.0)
    assert not lockstep.may_go_on(2, PATIENCE)
    lockstep.on_progress("winch", 2)
    assert lockstep.may_go_on(2, 0.0)


def test_a_commander_is_waited_for_in_one_of_every_few_cycles():
    lockstep = LockstepBarrier(PATIENCE)
    lockstep.on_progress("commander", 5, within=3)
    assert all(lockstep.may_go_on(cycle, 0.0) for cycle in (5, 6, 7))
    assert not lockstep.may_go_on(8, SYNC_PERIOD)


def test_who_has_gone_costs_the_patience_once_and_is_waited_for_again_when_back():
    lockstep = LockstepBarrier(PATIENCE)
    lockstep.on_progress("jump", 1)
    lockstep.on_progress("winch", 1)
    lockstep.on_progress("winch", 2)
    assert not lockstep.may_go_on(2, PATIENCE)
    assert lockstep.may_go_on(2, PATIENCE + SYNC_PERIOD)
    lockstep.on_progress("winch", 3)
    assert lockstep.may_go_on(3, 0.0)
    assert not lockstep.may_go_on(4, 0.0)  # the other is still waited for
    lockstep.on_progress("winch", 4)
    lockstep.on_progress("jump", 4)
    lockstep.on_progress("winch", 5)
    assert not lockstep.may_go_on(5, 0.0)
