"""The drive's automaton: every state with every order, against the standard's table."""

from __future__ import annotations

import itertools

import pytest
from canopen.profiles.p402 import State402
from hypothesis import given
from hypothesis import strategies as st

from rover_hil.bridge.drive_channel import (
    DISABLED,
    ENABLED,
    FAULT,
    SWITCHED_ON,
    controlword,
    state_of,
)
from rover_hil.canopen.devices import ErrorCode
from rover_hil.emulator.cia402 import Automaton, DriveCommand, DriveState, decode_controlword

WORDS = {
    DriveCommand.SHUTDOWN: 0x06,
    DriveCommand.SWITCH_ON: 0x07,
    DriveCommand.ENABLE: 0x0F,
    DriveCommand.DISABLE_VOLTAGE: 0x00,
    DriveCommand.QUICK_STOP: 0x02,
    DriveCommand.FAULT_RESET: 0x80,
}
# CiA 402, figure of the state machine: what each order leads to; what is not there does nothing.
TABLE = {
    DriveState.DISABLED: {DriveCommand.SHUTDOWN: DriveState.READY},
    DriveState.READY: {
        DriveCommand.SWITCH_ON: DriveState.SWITCHED_ON,
        DriveCommand.ENABLE: DriveState.ENABLED,
        DriveCommand.DISABLE_VOLTAGE: DriveState.DISABLED,
        DriveCommand.QUICK_STOP: DriveState.DISABLED,
    },
    DriveState.SWITCHED_ON: {
        DriveCommand.ENABLE: DriveState.ENABLED,
        DriveCommand.SHUTDOWN: DriveState.READY,
        DriveCommand.DISABLE_VOLTAGE: DriveState.DISABLED,
        DriveCommand.QUICK_STOP: DriveState.DISABLED,
    },
    DriveState.ENABLED: {
        DriveCommand.SWITCH_ON: DriveState.SWITCHED_ON,
        DriveCommand.SHUTDOWN: DriveState.READY,
        DriveCommand.DISABLE_VOLTAGE: DriveState.DISABLED,
        DriveCommand.QUICK_STOP: DriveState.QUICK_STOP,
    },
    DriveState.QUICK_STOP: {DriveCommand.DISABLE_VOLTAGE: DriveState.DISABLED},
    DriveState.FAULT: {DriveCommand.FAULT_RESET: DriveState.DISABLED},
    DriveState.FAULT_REACTION: {},
    DriveState.NOT_READY: {},
}


def brought_to(state: DriveState) -> Automaton:
    """An automaton in a state, reached by commands and faults."""
    made = Automaton()
    if state is DriveState.NOT_READY:
        return made
    made.power_on()
    words = {
        DriveState.READY: (0x06,),
        DriveState.SWITCHED_ON: (0x06, 0x07),
        DriveState.ENABLED: (0x06, 0x07, 0x0F),
        DriveState.QUICK_STOP: (0x06, 0x07, 0x0F, 0x02),
    }
    for word in words.get(state, ()):
        made.command(word)
    if state in {DriveState.FAULT_REACTION, DriveState.FAULT}:
        made.fail(ErrorCode.DRIVE_OVERTEMPERATURE)
    if state is DriveState.FAULT:
        made.on_standstill()
    assert made.state is state
    return made


@pytest.mark.parametrize(("state", "command"), list(itertools.product(DriveState, DriveCommand)))
def test_each_command_leads_to_the_state_of_the_standard(state: DriveState, command: DriveCommand):
    drive = brought_to(state)
    drive.command(WORDS[command])
    assert drive.state is TABLE[state].get(command, state)


@pytest.mark.parametrize("state", DriveState)
def test_the_library_decodes_the_statusword(state: DriveState):
    assert state_of(brought_to(state).statusword) == state.value


@pytest.mark.parametrize("state", DriveState)
def test_a_fault_comes_from_every_state_and_keeps_the_first_code(state: DriveState):
    drive = brought_to(state)
    was_in_fault = state in {DriveState.FAULT_REACTION, DriveState.FAULT}
    assert drive.fail(ErrorCode.RPDO_TIMEOUT) is not was_in_fault
    first = ErrorCode.DRIVE_OVERTEMPERATURE if was_in_fault else ErrorCode.RPDO_TIMEOUT
    assert drive.error_code is first
    drive.on_standstill()
    assert drive.state is DriveState.FAULT
    assert not drive.enabled


def test_a_fault_is_reset_only_by_the_edge_of_its_bit():
    drive = brought_to(DriveState.FAULT)
    drive.command(0x80)
    assert state_of(drive.statusword) == DISABLED
    assert drive.error_code is ErrorCode.NO_ERROR
    drive.fail(ErrorCode.RPDO_TIMEOUT)
    drive.on_standstill()
    drive.command(0x80)  # the bit was set already
    assert state_of(drive.statusword) == FAULT
    drive.command(0x00)
    drive.command(0x80)
    assert state_of(drive.statusword) == DISABLED


def test_a_quick_stop_ends_switched_on_disabled_at_standstill():
    drive = brought_to(DriveState.QUICK_STOP)
    drive.command(0x0F)  # transition 16 does not exist
    assert not drive.enabled
    assert state_of(drive.statusword) == DriveState.QUICK_STOP.value
    drive.on_standstill()
    assert state_of(drive.statusword) == DISABLED


@given(st.lists(st.integers(0, 0xFFFF), max_size=30))
def test_no_sequence_of_controlwords_enables_without_a_shutdown_command(words: list[int]):
    drive = Automaton()
    drive.power_on()
    commands = [
        decode_controlword(word, before) for before, word in itertools.pairwise([0, *words])
    ]
    for word in words:
        drive.command(word)
    assert not drive.enabled or DriveCommand.SHUTDOWN in commands


@pytest.mark.parametrize("state", [s for s in DriveState if s is not DriveState.NOT_READY])
@pytest.mark.parametrize("target", [DISABLED, SWITCHED_ON, ENABLED])
def test_the_bridge_s_controlwords_lead_a_drive_to_its_target_state(state: DriveState, target: str):
    drive = brought_to(state)
    for _ in range(4):
        drive.on_standstill()
        drive.command(controlword(state_of(drive.statusword), target))
    stays = {DriveState.FAULT_REACTION, DriveState.FAULT}  # until it is armed, which resets it
    assert drive.state.value == (DriveState.FAULT if state in stays else target)


def test_the_states_are_named_as_in_the_library():
    assert {state.value for state in DriveState} == set(State402.SW_MASK)
