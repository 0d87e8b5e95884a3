"""CiA 402 state machine of a drive: states, commands, transitions.

Transitions are numbered as in the standard. The quick stop option code is 2: the drive slows down
and goes to switch on disabled (transition 12), so transition 16 does not exist.
"""

from __future__ import annotations

import enum

from rover_hil.canopen.devices import ErrorCode


class DriveState(enum.StrEnum):
    """States, named as in `canopen.profiles.p402`."""

    NOT_READY = "NOT READY TO SWITCH ON"
    DISABLED = "SWITCH ON DISABLED"
    READY = "READY TO SWITCH ON"
    SWITCHED_ON = "SWITCHED ON"
    ENABLED = "OPERATION ENABLED"
    QUICK_STOP = "QUICK STOP ACTIVE"
    FAULT_REACTION = "FAULT REACTION ACTIVE"
    FAULT = "FAULT"


class DriveCommand(enum.Enum):
    """Command in a controlword."""

    SHUTDOWN = "shutdown"
    SWITCH_ON = "switch on"  # in OPERATION ENABLED: disable operation
    ENABLE = "enable operation"
    DISABLE_VOLTAGE = "disable voltage"
    QUICK_STOP = "quick stop"
    FAULT_RESET = "fault reset"


_RESET_BIT = 0x80
_STATUS = {
    DriveState.NOT_READY: 0x00,
    DriveState.DISABLED: 0x40,
    DriveState.READY: 0x21,
    DriveState.SWITCHED_ON: 0x23,
    DriveState.ENABLED: 0x27,
    DriveState.QUICK_STOP: 0x07,
    DriveState.FAULT_REACTION: 0x0F,
    DriveState.FAULT: 0x08,
}
_VOLTAGE, _REMOTE = 0x10, 0x200
_TRANSITIONS = {
    (DriveState.DISABLED, DriveCommand.SHUTDOWN): DriveState.READY,  # 2
    (DriveState.READY, DriveCommand.SWITCH_ON): DriveState.SWITCHED_ON,  # 3
    (DriveState.READY, DriveCommand.ENABLE): DriveState.ENABLED,  # 3 and 4 in one
    (DriveState.SWITCHED_ON, DriveCommand.ENABLE): DriveState.ENABLED,  # 4
    (DriveState.ENABLED, DriveCommand.SWITCH_ON): DriveState.SWITCHED_ON,  # 5
    (DriveState.SWITCHED_ON, DriveCommand.SHUTDOWN): DriveState.READY,  # 6
    (DriveState.READY, DriveCommand.DISABLE_VOLTAGE): DriveState.DISABLED,  # 7
    (DriveState.READY, DriveCommand.QUICK_STOP): DriveState.DISABLED,  # 7
    (DriveState.ENABLED, DriveCommand.SHUTDOWN): DriveState.READY,  # 8
    (DriveState.ENABLED, DriveCommand.DISABLE_VOLTAGE): DriveState.DISABLED,  # 9
    (DriveState.SWITCHED_ON, DriveCommand.DISABLE_VOLTAGE): DriveState.DISABLED,  # 10
    (DriveState.SWITCHED_ON, DriveCommand.QUICK_STOP): DriveState.DISABLED,  # 10
    (DriveState.ENABLED, DriveCommand.QUICK_STOP): DriveState.QUICK_STOP,  # 11
    (DriveState.QUICK_STOP, DriveCommand.DISABLE_VOLTAGE): DriveState.DISABLED,  # 12
    (DriveState.FAULT, DriveCommand.FAULT_RESET): DriveState.DISABLED,  # 15
}


def decode_controlword(controlword: int, before: int) -> DriveCommand | None:
    """The command in a controlword; None: none defined by the standard.

    Args:
        controlword: object 6040h.
        before: the previous one; a rising edge of bit 7 resets a fault.
    """
    if controlword & _RESET_BIT and not before & _RESET_BIT:
        return DriveCommand.FAULT_RESET
    if controlword & _RESET_BIT:
        return None
    if not controlword & 0x2:
        return DriveCommand.DISABLE_VOLTAGE
    if not controlword & 0x4:
        return DriveCommand.QUICK_STOP
    if not controlword & 0x1:
        return DriveCommand.SHUTDOWN
    return DriveCommand.ENABLE if controlword & 0x8 else DriveCommand.SWITCH_ON


class Automaton:
    """State of one drive.

    Attributes:
        state: present state.
        error_code: object 603Fh, of the last fault.
    """

    def __init__(self) -> None:
        self.state = DriveState.NOT_READY
        self.error_code = ErrorCode.NO_ERROR
        self._controlword = 0

    def power_on(self) -> None:
        """Restart and self-test: transitions 0 and 1."""
        self.state = DriveState.DISABLED
        self.error_code = ErrorCode.NO_ERROR
        self._controlword = 0

    def power_off(self) -> None:
        """Lose the supply and all state."""
        self.state = DriveState.NOT_READY
        self.error_code = ErrorCode.NO_ERROR

    def command(self, controlword: int) -> None:
        """Process a controlword; ignore a command that the present state does not allow."""
        requested = decode_controlword(controlword, self._controlword)
        self._controlword = controlword
        if requested is None:
            return
        after = _TRANSITIONS.get((self.state, requested))
        if after is None:
            return
        if requested is DriveCommand.FAULT_RESET:
            self.error_code = ErrorCode.NO_ERROR
        self.state = after

    def fail(self, error_code: ErrorCode) -> bool:
        """Enter the fault reaction: transition 13; returns whether the fault is new."""
        if self.state in {DriveState.FAULT_REACTION, DriveState.FAULT}:
            return False
        self.state = DriveState.FAULT_REACTION
        self.error_code = error_code
        return True

    def on_standstill(self) -> None:
        """End a quick stop or fault reaction at standstill: transitions 12 and 14."""
        if self.state is DriveState.FAULT_REACTION:
            self.state = DriveState.FAULT
        elif self.state is DriveState.QUICK_STOP:
            self.state = DriveState.DISABLED

    @property
    def enabled(self) -> bool:
        """Whether the drive follows setpoints."""
        return self.state is DriveState.ENABLED

    @property
    def statusword(self) -> int:
        """Object 6041h."""
        powered = self.state not in {DriveState.NOT_READY}
        return _STATUS[self.state] | _REMOTE | (_VOLTAGE if powered else 0)
