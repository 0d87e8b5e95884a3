"""The automaton of a drive by CiA 402, on the drive's side: states, commands, transitions.

The transitions bear the standard's numbers. The quick stop option code is 2: a quick stop slows
down and then switches on disabled (12), so that transition 16 does not exist.
"""

from __future__ import annotations

import enum


class DriveState(enum.StrEnum):
    """States by the names that `canopen.profiles.p402` has for them."""

    NOT_READY = "NOT READY TO SWITCH ON"
    DISABLED = "SWITCH ON DISABLED"
    READY = "READY TO SWITCH ON"
    SWITCHED_ON = "SWITCHED ON"
    ENABLED = "OPERATION ENABLED"
    QUICK_STOP = "QUICK STOP ACTIVE"
    REACTING = "FAULT REACTION ACTIVE"
    FAULT = "FAULT"


class Order(enum.Enum):
    """What a controlword asks for."""

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
    DriveState.REACTING: 0x0F,
    DriveState.FAULT: 0x08,
}
_VOLTAGE, _REMOTE = 0x10, 0x200
_TRANSITIONS = {
    (DriveState.DISABLED, Order.SHUTDOWN): DriveState.READY,  # 2
    (DriveState.READY, Order.SWITCH_ON): DriveState.SWITCHED_ON,  # 3
    (DriveState.READY, Order.ENABLE): DriveState.ENABLED,  # 3 and 4 in one
    (DriveState.SWITCHED_ON, Order.ENABLE): DriveState.ENABLED,  # 4
    (DriveState.ENABLED, Order.SWITCH_ON): DriveState.SWITCHED_ON,  # 5
    (DriveState.SWITCHED_ON, Order.SHUTDOWN): DriveState.READY,  # 6
    (DriveState.READY, Order.DISABLE_VOLTAGE): DriveState.DISABLED,  # 7
    (DriveState.READY, Order.QUICK_STOP): DriveState.DISABLED,  # 7
    (DriveState.ENABLED, Order.SHUTDOWN): DriveState.READY,  # 8
    (DriveState.ENABLED, Order.DISABLE_VOLTAGE): DriveState.DISABLED,  # 9
    (DriveState.SWITCHED_ON, Order.DISABLE_VOLTAGE): DriveState.DISABLED,  # 10
    (DriveState.SWITCHED_ON, Order.QUICK_STOP): DriveState.DISABLED,  # 10
    (DriveState.ENABLED, Order.QUICK_STOP): DriveState.QUICK_STOP,  # 11
    (DriveState.QUICK_STOP, Order.DISABLE_VOLTAGE): DriveState.DISABLED,  # 12
    (DriveState.FAULT, Order.FAULT_RESET): DriveState.DISABLED,  # 15
}


def order_of(controlword: int, before: int) -> Order | None:
    """What a controlword asks for; None: nothing that the standard knows.

    Args:
        controlword: object 6040h.
        before: the one before it; a fault is reset by the edge of bit 7, not by its level.
    """
    if controlword & _RESET_BIT and not before & _RESET_BIT:
        return Order.FAULT_RESET
    if controlword & _RESET_BIT:
        return None
    if not controlword & 0x2:
        return Order.DISABLE_VOLTAGE
    if not controlword & 0x4:
        return Order.QUICK_STOP
    if not controlword & 0x1:
        return Order.SHUTDOWN
    return Order.ENABLE if controlword & 0x8 else Order.SWITCH_ON


class Automaton:
    """One drive's state.

    Attributes:
        state: present state.
        error_code: object 603Fh: of the last fault, 0 without one.
    """

    def __init__(self) -> None:
        self.state = DriveState.NOT_READY
        self.error_code = 0
        self._controlword = 0

    def power_on(self) -> None:
        """Begin anew, and test itself: transitions 0 and 1."""
        self.state = DriveState.DISABLED
        self.error_code = 0
        self._controlword = 0

    def power_off(self) -> None:
        """Lose the supply, and with it everything."""
        self.state = DriveState.NOT_READY
        self.error_code = 0

    def command(self, controlword: int) -> None:
        """Take a controlword; what is not allowed in the present state changes nothing."""
        order = order_of(controlword, self._controlword)
        self._controlword = controlword
        if order is None:
            return
        after = _TRANSITIONS.get((self.state, order))
        if after is None:
            return
        if order is Order.FAULT_RESET:
            self.error_code = 0
        self.state = after

    def fail(self, error_code: int) -> bool:
        """A fault occurs: transition 13; returns whether it is a new one."""
        if self.state in {DriveState.REACTING, DriveState.FAULT}:
            return False
        self.state = DriveState.REACTING
        self.error_code = error_code
        return True

    def come_to_rest(self) -> None:
        """The drive stands, its reaction or quick stop is over: transitions 12 and 14."""
        if self.state is DriveState.REACTING:
            self.state = DriveState.FAULT
        elif self.state is DriveState.QUICK_STOP:
            self.state = DriveState.DISABLED

    @property
    def enabled(self) -> bool:
        """Whether set-points are followed."""
        return self.state is DriveState.ENABLED

    @property
    def statusword(self) -> int:
        """Object 6041h."""
        powered = self.state not in {DriveState.NOT_READY}
        return _STATUS[self.state] | _REMOTE | (_VOLTAGE if powered else 0)
