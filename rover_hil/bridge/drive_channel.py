"""Command channel of one drive: its CiA 402 state, and the command sets sent to it."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import NamedTuple

from canopen.profiles.p402 import State402

from msg_schemas.table import TOPICS
from rover_hil.bridge.wiring import AT_REST, Values
from rover_hil.canopen.devices import NUMBER_SHIFT, NUMBERS, SYNC_PERIOD, reference_count
from rover_hil.canopen.link import pack
from rover_hil.canopen.objects import Device

UNKNOWN = ""
DISABLED, READY, SWITCHED_ON = "SWITCH ON DISABLED", "READY TO SWITCH ON", "SWITCHED ON"
ENABLED, QUICK_STOP, FAULT = "OPERATION ENABLED", "QUICK STOP ACTIVE", "FAULT"
_RESET_TIMEOUT = 0.5  # of a fault, from arming on [s]
_REPEAT_PERIOD = 0.02  # of commands, which feeds the drive's watchdog [s]
_KEPT_SETS = 256  # command sets
# Of the drive's range of newer numbers, which is twice as long.
_MOST_UNEXECUTED = 1 << 14  # command sets
_STANDSTILL_RATE = 1e-3  # of the winch [m/s]
# Controlword that holds a state.
_HOLD_WORDS = {
    DISABLED: State402.CW_DISABLE_VOLTAGE,
    READY: State402.CW_SHUTDOWN,
    SWITCHED_ON: State402.CW_SWITCH_ON,
    ENABLED: State402.CW_OPERATION_ENABLED,
}
_POWERED = (SWITCHED_ON, ENABLED)
_DOWN_WORDS = (State402.CW_QUICK_STOP, State402.CW_DISABLE_VOLTAGE)
_STATE_SEQUENCE = (DISABLED, READY, SWITCHED_ON, ENABLED)


def state_of(statusword: int) -> str:
    """The state in a statusword, by the names and masks of `canopen`."""
    for name, (mask, bits) in State402.SW_MASK.items():
        if statusword & mask == bits:
            return str(name)
    return UNKNOWN


def controlword(state: str, target: str) -> int:
    """The controlword for the next transition towards a state, or to stay in it.

    A drive with power is always left by its quick stop, which ends in switch on disabled: it may be
    enabled already, and that be unknown yet.

    Args:
        state: present state.
        target: disabled, switched on or enabled.
    """
    if state == target:
        return _HOLD_WORDS[target]
    if state in (ENABLED, QUICK_STOP) or (state == SWITCHED_ON and target == DISABLED):
        return int(State402.CW_QUICK_STOP)
    if state not in _STATE_SEQUENCE or target == DISABLED:
        return int(State402.CW_DISABLE_VOLTAGE)
    index, target_index = _STATE_SEQUENCE.index(state), _STATE_SEQUENCE.index(target)
    next_state = _STATE_SEQUENCE[index + 1] if target_index > index else target
    return int(State402.TRANSITIONTABLE[state, next_state])


class SentCommandSet(NamedTuple):
    """A command set that has been sent."""

    command_ns: int  # stamp of the contract's command; 0: none, or a repetition
    sent_ns: int  # when it was sent, by the bridge's clock


class DriveChannel:
    """Command channel of one drive.

    Args:
        device: the drive.
        send: puts a frame on the link.

    Attributes:
        state: from its last statusword; empty: unknown.
        armed: whether it may be enabled; while it is in fault, it is reset.
        setpoint: of its controller; None: none.
        topic: topic of the setpoint.
        commanded_ns: reception of the setpoint, by the bridge's clock.
    """

    def __init__(self, device: Device, send: Callable[[int, bytes], None]) -> None:
        self.device = device
        self.state = UNKNOWN
        self.armed = False
        self.setpoint: Values | None = None
        self.topic = ""
        self.commanded_ns = 0
        self._send = send
        self._armed_ns = 0
        self._is_sent_up = False  # since it was last switched on
        self._is_sent_down = False  # since it was last switched on or enabled
        self._sequence = 0
        self._number = 0
        self._sent_ns: int | None = None
        self._sent: OrderedDict[int, SentCommandSet] = OrderedDict()
        self._last_executed: int | None = None

    @property
    def target(self) -> str:
        """The required state."""
        if not self.armed:
            return DISABLED
        return ENABLED if self.setpoint is not None else SWITCHED_ON

    def arm(self, now_ns: int) -> None:
        """Accept commands, and reset a fault."""
        self.armed, self._armed_ns = True, now_ns

    def keeps_fault(self, now_ns: int) -> bool:
        """Whether it is armed, and its fault could not be reset in time."""
        is_late = now_ns - self._armed_ns >= _RESET_TIMEOUT * 1e9
        return self.armed and self.state == FAULT and is_late

    def on_state(self, state: str) -> bool:
        """Take the drive's state; returns whether it switched itself off.

        A drive does so where its safe torque off, its supply or a panel takes its power. It must
        not move on when they give it back.
        """
        before, self.state = self.state, state
        is_off = (before == ENABLED != state) or (before == SWITCHED_ON and state not in _POWERED)
        is_by_itself = is_off and not self._is_sent_down
        if state != before:
            self._is_sent_up = False
            self._is_sent_down &= state not in _POWERED
        return is_by_itself

    def disarm(self) -> None:
        """Drop the setpoint, and refuse commands until it is armed again."""
        self.armed = False
        self.setpoint = None

    def restarted(self) -> None:
        """Forget the state and sequence of a drive that restarted."""
        self.disarm()
        self.state = UNKNOWN
        self._sent.clear()
        self._last_executed = None

    def command(self, topic: str, setpoint: Values, now_ns: int) -> None:
        """Take a new setpoint."""
        self.setpoint, self.topic, self.commanded_ns = setpoint, topic, now_ns
        self._number = (self._number + 1) % NUMBERS

    def expire_setpoint(self, velocity: float, now_ns: int) -> float | None:
        """Drop a setpoint that was not renewed in time; returns its age [s], or None.

        Args:
            velocity: reported by the drive, in its unit.
            now_ns: bridge's clock.
        """
        if self.setpoint is None:
            return None
        stale = TOPICS[self.topic].stale
        is_moving = abs(velocity) > _STANDSTILL_RATE or self.setpoint["target_velocity"] != 0.0
        limit = min(stale.timeout, stale.timeout_moving) if is_moving else stale.timeout
        age = (now_ns - self.commanded_ns) * 1e-9
        if age < limit:
            return None
        self.setpoint = None
        return age

    def is_due(self, now_ns: int) -> bool:
        """Whether to send a command set without a new command."""
        if self.state == UNKNOWN:
            return False
        if self.state != self.target:
            period = SYNC_PERIOD
        elif self.target != DISABLED:
            period = _REPEAT_PERIOD
        else:
            return False
        # Half a cycle of tolerance: cycles vary in length.
        return self._sent_ns is None or now_ns - self._sent_ns >= (period - 0.5 * SYNC_PERIOD) * 1e9

    def send(self, sample_time_ns: int, now_ns: int, command_ns: int = 0) -> None:
        """Send a command set.

        Args:
            sample_time_ns: time of the newest received sample, by the drive's clock.
            now_ns: bridge's clock.
            command_ns: stamp of the command, if it is sent for the first time; else 0.
        """
        values = self.setpoint if self.setpoint is not None else AT_REST
        entries = self.device.by_key
        counts = {key: entries[key].counts(value) for key, value in values.items()}
        self._sequence = (self._sequence + 1) & 0xFFFF
        word = self._next_word()
        counts |= {
            "controlword": word,
            "sequence": self._sequence,
            "reference_time": reference_count(sample_time_ns),
            "switches": counts["switches"] | (self._number << NUMBER_SHIFT),
        }
        self._sent[self._sequence] = SentCommandSet(command_ns, now_ns)
        while len(self._sent) > _KEPT_SETS:
            self._sent.popitem(last=False)
        self._sent_ns = now_ns
        for pdo in self.device.rpdos:
            self._send(pdo.can_id(self.device.node_id), pack(pdo, counts))

    def _next_word(self) -> int:
        """The controlword of the next command set."""
        word = controlword(self.state, self.target)
        if self.armed and self.state == FAULT and self._sequence % 2:
            # Repeated until it succeeds, since a set may be lost; only a rising edge of it resets.
            word = int(State402.CW_SWITCH_ON_DISABLED)
        elif self.state == self.target == SWITCHED_ON and self._is_sent_up:
            word = int(State402.CW_QUICK_STOP)  # its setpoint is gone before it is known as enabled
        self._is_sent_up |= word == State402.CW_OPERATION_ENABLED
        self._is_sent_down |= self.state in _POWERED and word in _DOWN_WORDS
        return word

    def on_executed(self, sequence: int) -> SentCommandSet | None:
        """The command set that a drive has executed, at its first report; else None."""
        unexecuted = (self._sequence - sequence) & 0xFFFF
        if self._last_executed is None or unexecuted > _MOST_UNEXECUTED:
            # The drive only executes newer sets: continue from its sequence number.
            self._sequence = sequence
        if sequence == self._last_executed:
            return None
        self._last_executed = sequence
        return self._sent.get(sequence)
