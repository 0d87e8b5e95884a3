"""One drive as the bridge sees it: its state by CiA 402, and the command sets that go to it."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import NamedTuple

from canopen.profiles.p402 import State402

from msg_schemas.table import TOPICS
from rover_hil.devices import NUMBER_SHIFT, NUMBERS, SYNC_PERIOD, upon_count
from rover_hil.link import pack
from rover_hil.objects import Device
from rover_hil.wiring import AT_REST, Values

UNKNOWN = ""
DISABLED, READY, SWITCHED_ON = "SWITCH ON DISABLED", "READY TO SWITCH ON", "SWITCHED ON"
ENABLED, FAULT = "OPERATION ENABLED", "FAULT"
_REPEATED = 0.02  # commands are, so that the drive's own watchdog is fed [s]
_REMEMBERED = 256  # sent sets
_STANDING = 1e-3  # rate that counts as standing, of the winch [m/s]
# Controlword that keeps a state.
_KEEPS = {
    DISABLED: State402.CW_DISABLE_VOLTAGE,
    READY: State402.CW_SHUTDOWN,
    SWITCHED_ON: State402.CW_SWITCH_ON,
    ENABLED: State402.CW_OPERATION_ENABLED,
}
_LADDER = (DISABLED, READY, SWITCHED_ON, ENABLED)


def state_of(statusword: int) -> str:
    """The state that a statusword tells, by `canopen`'s names and masks."""
    for name, (mask, bits) in State402.SW_MASK.items():
        if statusword & mask == bits:
            return str(name)
    return UNKNOWN


def controlword(state: str, target: str) -> int:
    """What brings a drive one transition nearer to a state, or keeps it there.

    Args:
        state: present one.
        target: one of disabled, switched on and enabled.
    """
    if state == target:
        return _KEEPS[target]
    if state not in _LADDER or target == DISABLED:
        return int(State402.CW_DISABLE_VOLTAGE)
    at, to = _LADDER.index(state), _LADDER.index(target)
    further = _LADDER[at + 1] if to > at else target
    return int(State402.TRANSITIONTABLE[state, further])


class Sent(NamedTuple):
    """A command set on its way."""

    command_ns: int  # stamp of the contract's command; 0: none, or a repetition
    taken_ns: int  # when the bridge took it, by its own clock


class DriveChannel:
    """One drive.

    Args:
        device: which one.
        send: puts a frame on the link.

    Attributes:
        state: told by its last statusword, empty before.
        armed: whether it may be enabled.
        resets: whether a fault is to be reset once, as it was armed while in one.
        setpoint: what its controller wants, None when nothing.
        topic: that the set-point came by.
        commanded_ns: when it came, by the bridge's clock.
    """

    def __init__(self, device: Device, send: Callable[[int, bytes], None]) -> None:
        self.device = device
        self.state = UNKNOWN
        self.armed = False
        self.resets = False
        self.setpoint: Values | None = None
        self.topic = ""
        self.commanded_ns = 0
        self._send = send
        self._sequence = 0
        self._number = 0
        self._sent_ns: int | None = None
        self._sent: OrderedDict[int, Sent] = OrderedDict()
        self._answered: int | None = None

    @property
    def target(self) -> str:
        """The state that it should be in."""
        if not self.armed:
            return DISABLED
        return ENABLED if self.setpoint is not None else SWITCHED_ON

    def disarm(self) -> None:
        """Nothing moves until it is armed again."""
        self.armed = self.resets = False
        self.setpoint = None

    def restarted(self) -> None:
        """The drive began anew: its sequence too."""
        self.disarm()
        self.state = UNKNOWN
        self._sent.clear()
        self._answered = None

    def command(self, topic: str, setpoint: Values, now_ns: int) -> None:
        """Take a new set-point."""
        self.setpoint, self.topic, self.commanded_ns = setpoint, topic, now_ns
        self._number = (self._number + 1) % NUMBERS

    def ceased(self, velocity: float, now_ns: int) -> float | None:
        """Forget a set-point that was not renewed in time; returns its age [s].

        Args:
            velocity: that the drive tells, in its unit.
            now_ns: bridge's clock.
        """
        if self.setpoint is None:
            return None
        stale = TOPICS[self.topic].stale
        moves = abs(velocity) > _STANDING or self.setpoint["target_velocity"] != 0.0
        limit = min(stale.timeout, stale.timeout_moving) if moves else stale.timeout
        age = (now_ns - self.commanded_ns) * 1e-9
        if age < limit:
            return None
        self.setpoint = None
        return age

    def is_due(self, now_ns: int) -> bool:
        """Whether a set should be sent though no command has come."""
        if self.state == UNKNOWN:
            return False
        if self.state != self.target:
            wait = SYNC_PERIOD
        elif self.target != DISABLED:
            wait = _REPEATED
        else:
            return False
        # A little less: cycles are not of one length to the nanosecond.
        return self._sent_ns is None or now_ns - self._sent_ns >= (wait - 0.5 * SYNC_PERIOD) * 1e9

    def send(self, upon_ns: int, now_ns: int, command_ns: int = 0) -> None:
        """Send a command set.

        Args:
            upon_ns: sample time of the newest sample heard, by the drive's clock.
            now_ns: bridge's clock.
            command_ns: stamp of the contract's command that it carries for the first time.
        """
        word = controlword(self.state, self.target)
        if self.state == FAULT and self.armed and self.resets:
            word = State402.CW_SWITCH_ON_DISABLED
            self.resets = False
        values = self.setpoint if self.setpoint is not None else AT_REST
        entries = self.device.by_key
        counts = {key: entries[key].counts(value) for key, value in values.items()}
        self._sequence = (self._sequence + 1) & 0xFFFF
        counts |= {
            "controlword": word,
            "sequence": self._sequence,
            "upon": upon_count(upon_ns),
            "switches": counts["switches"] | (self._number << NUMBER_SHIFT),
        }
        self._sent[self._sequence] = Sent(command_ns, now_ns)
        while len(self._sent) > _REMEMBERED:
            self._sent.popitem(last=False)
        self._sent_ns = now_ns
        for pdo in self.device.hears:
            self._send(pdo.can_id(self.device.node_id), pack(pdo, counts))

    def executed(self, sequence: int) -> Sent | None:
        """The set that the drive says it has executed, the first time that it says so."""
        if self._answered is None:
            # Sets go on from where the drive stands, as it executes newer ones alone.
            self._sequence = sequence
        if sequence == self._answered:
            return None
        self._answered = sequence
        return self._sent.get(sequence)


def in_units(device: Device, counts: Mapping[str, int]) -> dict[str, float]:
    """Values in the units of a device's entries."""
    entries = device.by_key
    return {key: entries[key].value(count) for key, count in counts.items() if key in entries}
