"""Sequence of one jump: compress, take off, fly, land. Pure; stepped without ROS.

It knows what the rover's own sensors say: the contact switch, the jump motor's state and
the accelerometer. Every state has a time limit and a way out:

=============  =======================================================================
standby        waits for a request
compressing    drives the nut to the stroke, until the latch trips; else lets it down
letting_down   drives the nut back to zero, softly; else fault
flight         waits for the ground; else fault
landed         waits until the rover rests; else fault
fault          nothing is driven; ``abort`` lets the spring down and leads back to standby
=============  =======================================================================

Time is the controller's clock in nanoseconds, which may be simulated and jump. What the sensors say
holds for the time of their stamps, however late it is heard.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import NamedTuple

from msg_schemas import topics
from msg_schemas.parameters import parameter
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import ImuSample, JointSample, Level
from msg_schemas.table import FLOOR_SWITCH, JUMP_SCREW, MAX_NUT_FORCE, MAX_NUT_SPEED, MAX_STROKE

_NANO = 1e9
_CLOSED = 0.5  # a contact's position from here on means closed


class JumpPhase(StrEnum):
    """What the sequence is doing; the words of the contract."""

    STANDBY = "standby"
    COMPRESSING = "compressing"
    LETTING_DOWN = "letting_down"
    FLIGHT = "flight"
    LANDED = "landed"
    FAULT = "fault"


@dataclass(frozen=True)
class JumpParameters:
    """Limits and times of a jump."""

    largest_stroke: float = parameter(
        0.30, "m", "largest compression of the spring that a request may ask for", 0.005, MAX_STROKE
    )
    nut_speed: float = parameter(
        0.05, "m/s", "nut speed if the request names none", 1e-3, MAX_NUT_SPEED
    )
    let_down_speed: float = parameter(
        0.05, "m/s", "nut speed while letting the spring down", 1e-3, MAX_NUT_SPEED
    )
    nut_force: float = parameter(
        400.0, "N", "largest force that the nut may use", 1.0, MAX_NUT_FORCE
    )
    nut_zero: float = parameter(1e-3, "m", "a compression below this counts as none", 1e-5, 0.02)
    sensor_timeout: float = parameter(
        0.25, "s", "a sensor whose last sample is older is lost", 0.02, 5.0
    )
    compress_margin: float = parameter(
        1.5, "s", "longer than stroke / speed that a compression may take", 0.1, 60.0
    )
    contact_loss_time: float = parameter(
        0.10, "s", "contact open with the spring held for this long: lifted, not taken off",
        0.0, 5.0,
    )  # fmt: skip
    flight_limit: float = parameter(20.0, "s", "longest flight", 0.5, 120.0)
    settle_time: float = parameter(
        0.30, "s", "on the ground and quiet for this long: landed for good", 0.0, 10.0
    )
    settle_limit: float = parameter(5.0, "s", "longest time to come to rest", 0.5, 60.0)
    quiet_force: float = parameter(
        0.15, "-", "quiet: specific force within this part of that before the jump", 0.01, 1.0
    )


class Reading(NamedTuple):
    """A sensor's last value and when it was measured."""

    value: float
    stamp_ns: int


@dataclass(frozen=True)
class Sensors:
    """What the rover knows of itself; None = never heard."""

    contact: Reading | None = None  # 1 closed, 0 open
    opened_ns: int | None = None  # when the contact last opened,
    last_open_ns: int | None = None  # was last open,
    closed_ns: int | None = None  # and closed again
    compression: Reading | None = None  # [m]
    specific_force: Reading | None = None  # magnitude [m/s^2]

    def readings(self) -> tuple[tuple[str, Reading | None], ...]:
        """Return each sensor's topic and last reading."""
        return (
            (topics.CONTACT, self.contact),
            (topics.JUMP_MOTOR_STATE, self.compression),
            (topics.IMU, self.specific_force),
        )

    def with_contact(self, sample: JointSample, now_ns: int) -> Sensors:
        """Take a sample of the contact switch."""
        value, stamp_ns = sample.joints[FLOOR_SWITCH].position, sample.stamp_ns or now_ns
        taken = replace(self, contact=Reading(value, stamp_ns))
        if taken.is_open:
            opened_ns = self.opened_ns if self.is_open else stamp_ns
            return replace(taken, opened_ns=opened_ns, last_open_ns=stamp_ns)
        return replace(taken, closed_ns=stamp_ns) if self.is_open else taken

    def with_jump_motor(self, sample: JointSample, now_ns: int) -> Sensors:
        """Take a sample of the jump motor's state."""
        value = sample.joints[JUMP_SCREW].position
        return replace(self, compression=Reading(value, sample.stamp_ns or now_ns))

    def with_imu(self, sample: ImuSample, now_ns: int) -> Sensors:
        """Take a sample of the accelerometer."""
        force = math.hypot(*sample.linear_acceleration)
        return replace(self, specific_force=Reading(force, sample.stamp_ns or now_ns))

    @property
    def is_open(self) -> bool:
        """Whether the contact is known to be open."""
        return self.contact is not None and self.contact.value < _CLOSED

    @property
    def open_time(self) -> float:
        """How long the contact was open when it was so last [s]; nan if that is not known."""
        if self.opened_ns is None or self.closed_ns is None or self.closed_ns < self.opened_ns:
            return math.nan
        return _seconds(self.closed_ns, self.opened_ns)


class NutCommand(NamedTuple):
    """What the jump motor is to do."""

    compression: float  # [m]
    rate: float  # [m/s]
    force: float  # [N]


@dataclass(frozen=True)
class Transition:
    """A change of phase with its reason and its values."""

    phase: JumpPhase
    reason: str
    level: Level = Level.OK
    values: Mapping[str, object] = field(default_factory=dict)


class JumpSequence:
    """The sequence of one rover's jumps.

    Args:
        parameters: limits and times.
    """

    def __init__(self, parameters: JumpParameters) -> None:
        self.parameters = parameters
        self.phase = JumpPhase.STANDBY
        self._entered_ns = 0
        self._stroke = 0.0
        self._speed = parameters.nut_speed
        self._highest = 0.0  # compression reached since the request [m]
        self._held_ns = 0  # when the spring was last measured held by the nut
        self._quiet_since_ns: int | None = None
        self._standing_force = 0.0  # specific force before the jump [m/s^2]
        self._transitions: list[Transition] = []

    def take_transitions(self) -> list[Transition]:
        """Return what changed since the last call, and forget it."""
        taken, self._transitions = self._transitions, []
        return taken

    # --- asked from outside ----------------------------------------------------------------------

    def waiting_for(self, sensors: Sensors, now_ns: int) -> tuple[str, ...]:
        """Return the topics of the sensors that are silent: no jump is begun without them."""
        return tuple(t for t, r in sensors.readings() if self._silence(t, r, now_ns))

    def request(self, stroke: float, speed: float, sensors: Sensors, now_ns: int) -> None:
        """Begin a jump.

        Args:
            stroke: compression of the spring at take-off [m].
            speed: nut speed [m/s]; 0 = the parameters'.
            sensors: what is known now.
            now_ns: the controller's clock.

        Raises:
            Refusal: busy, in fault, not standing, a sensor lost, nut not at zero, stroke too long.
        """
        if self.phase is not JumpPhase.STANDBY:
            way_out = f"; {topics.JUMP_ABORT} leads out of it"
            raise _refused(
                RefusalCode.WRONG_PHASE,
                f"the sequence is in {self.phase}, a jump starts from standby"
                + (way_out if self.phase is JumpPhase.FAULT else ""),
            )
        limit = self.parameters.largest_stroke
        if stroke > limit:
            raise _refused(
                RefusalCode.OUT_OF_LIMITS, f"stroke is {stroke!r} m, it must be at most {limit:g} m"
            )
        lost = self._lost(sensors, now_ns)
        if lost:
            raise _refused(RefusalCode.STALE, f"{lost}, so the rover's state is not known")
        compression, force = _known(sensors)
        if sensors.is_open:
            raise _refused(
                RefusalCode.WRONG_PHASE, "the contact switch is open, the rover must stand to jump"
            )
        if compression.value > self.parameters.nut_zero:
            raise _refused(
                RefusalCode.WRONG_PHASE,
                f"the spring is compressed by {compression.value:.4g} m already, it must be let "
                f"down first ({topics.JUMP_ABORT})",
            )
        self._stroke = stroke
        self._speed = speed if speed > 0.0 else self.parameters.nut_speed
        self._highest = compression.value
        self._standing_force = force.value
        self._held_ns = compression.stamp_ns
        self._enter(
            JumpPhase.COMPRESSING,
            f"requested: {stroke:g} m at {self._speed:g} m/s",
            now_ns,
            values={"stroke": stroke, "speed": self._speed},
        )

    def abort(self, sensors: Sensors, now_ns: int) -> str:
        """End a compression or leave a fault: lets the spring down; returns what is done.

        Raises:
            Refusal: the rover flies; or in standby, where the nut stands is not known.
        """
        if self.phase in (JumpPhase.FLIGHT, JumpPhase.LANDED):
            raise Refusal(
                topics.JUMP_ABORT,
                RefusalCode.WRONG_PHASE,
                f"the sequence is in {self.phase}: the latch has tripped, nothing can be let down",
            )
        if self.phase is JumpPhase.LETTING_DOWN:
            return "already letting the spring down"
        if self.phase is JumpPhase.STANDBY:
            silent = self._silence(topics.JUMP_MOTOR_STATE, sensors.compression, now_ns)
            if silent:
                raise Refusal(topics.JUMP_ABORT, RefusalCode.STALE, silent)
            if self._is_down(sensors, now_ns):
                return "nothing to let down"
        self._enter(JumpPhase.LETTING_DOWN, f"aborted in {self.phase}", now_ns, Level.WARN)
        return "letting the spring down"

    def clock_jumped(self, now_ns: int) -> None:
        """Start over when the clock has jumped: what was timed by it means nothing any more."""
        if self.phase is not JumpPhase.STANDBY:
            self._enter(JumpPhase.STANDBY, "the clock has jumped back", now_ns, Level.WARN)
        self._entered_ns = now_ns

    # --- stepped by time -------------------------------------------------------------------------

    def step(self, sensors: Sensors, now_ns: int) -> NutCommand | None:
        """Advance to now; returns what the jump motor is to do, None = nothing."""
        step = {
            JumpPhase.COMPRESSING: self._compress,
            JumpPhase.LETTING_DOWN: self._let_down,
            JumpPhase.FLIGHT: self._fly,
            JumpPhase.LANDED: self._settle,
        }.get(self.phase)
        if step is not None:
            step(sensors, now_ns)
        if self.phase is JumpPhase.COMPRESSING:
            return NutCommand(self._stroke, self._speed, self.parameters.nut_force)
        if self.phase is JumpPhase.LETTING_DOWN:
            return NutCommand(0.0, self.parameters.let_down_speed, self.parameters.nut_force)
        return None

    def _compress(self, sensors: Sensors, now_ns: int) -> None:
        lost = self._lost(sensors, now_ns)
        if lost:
            self._enter(JumpPhase.LETTING_DOWN, lost, now_ns, Level.ERROR)
            return
        compression, _ = _known(sensors)
        zero = self.parameters.nut_zero
        sprang_back = self._highest > zero and compression.value < 0.5 * self._highest
        lifted_unloaded = compression.value <= zero and self._has_opened(sensors)
        if sprang_back or lifted_unloaded:
            self._enter(
                JumpPhase.FLIGHT,
                f"the latch has tripped, the nut was last seen at {self._highest:.4g} m",
                now_ns,
                values={"compression": self._highest},
            )
            return
        self._highest = max(self._highest, compression.value)
        self._held_ns = compression.stamp_ns
        if sensors.is_open and sensors.opened_ns is not None:
            lifted = _seconds(compression.stamp_ns, sensors.opened_ns)
            if lifted > self.parameters.contact_loss_time:
                self._enter(
                    JumpPhase.LETTING_DOWN,
                    f"contact lost at {compression.value:.4g} m with the spring still held",
                    now_ns,
                    Level.WARN,
                )
                return
        limit = self._stroke / self._speed + self.parameters.compress_margin
        if self._elapsed(now_ns) > limit:
            self._enter(
                JumpPhase.LETTING_DOWN,
                f"no take-off within {limit:.3g} s, the nut came to {compression.value:.4g} m "
                f"of {self._stroke:g} m",
                now_ns,
                Level.ERROR,
                {"compression": compression.value},
            )

    def _let_down(self, sensors: Sensors, now_ns: int) -> None:
        if self._is_down(sensors, now_ns):
            self._enter(JumpPhase.STANDBY, "the spring is let down", now_ns)
            return
        way = max(self._highest, self.parameters.largest_stroke)
        limit = way / self.parameters.let_down_speed + self.parameters.compress_margin
        if self._elapsed(now_ns) > limit:
            lost = self._lost(sensors, now_ns)
            reason = lost or "the nut does not come back"
            self._enter(
                JumpPhase.FAULT,
                f"spring not let down within {limit:.3g} s: {reason}",
                now_ns,
                Level.ERROR,
            )

    def _fly(self, sensors: Sensors, now_ns: int) -> None:
        # The switch may tell of the take-off later than the nut does: it must have opened.
        if sensors.contact is not None and not sensors.is_open and self._has_opened(sensors):
            flown = sensors.open_time
            self._quiet_since_ns = None
            self._enter(
                JumpPhase.LANDED,
                f"contact after about {flown:.3g} s of flight",
                now_ns,
                values={"flight_time": flown},
            )
            return
        limit = self.parameters.flight_limit
        if self._elapsed(now_ns) > limit:
            self._enter(JumpPhase.FAULT, f"no landing within {limit:g} s", now_ns, Level.ERROR)

    def _settle(self, sensors: Sensors, now_ns: int) -> None:
        if self._rests(sensors, now_ns):
            if self._quiet_since_ns is None:
                self._quiet_since_ns = now_ns
            if _seconds(now_ns, self._quiet_since_ns) >= self.parameters.settle_time:
                self._enter(JumpPhase.STANDBY, "at rest on the ground", now_ns)
                return
        else:
            self._quiet_since_ns = None
        limit = self.parameters.settle_limit
        if self._elapsed(now_ns) > limit:
            reason = self._lost(sensors, now_ns) or "contact or accelerometer are not quiet"
            self._enter(
                JumpPhase.FAULT,
                f"not at rest within {limit:g} s after landing: {reason}",
                now_ns,
                Level.ERROR,
            )

    # --- helpers ---------------------------------------------------------------------------------

    def _rests(self, sensors: Sensors, now_ns: int) -> bool:
        if self._lost(sensors, now_ns):
            return False
        _, force = _known(sensors)
        spread = self.parameters.quiet_force * self._standing_force
        return not sensors.is_open and abs(force.value - self._standing_force) <= spread

    def _has_opened(self, sensors: Sensors) -> bool:
        """Whether the contact was open after the spring was last measured held."""
        return sensors.last_open_ns is not None and sensors.last_open_ns > self._held_ns

    def _is_down(self, sensors: Sensors, now_ns: int) -> bool:
        compression = sensors.compression
        return (
            compression is not None
            and self._is_fresh(compression, now_ns)
            and compression.value <= self.parameters.nut_zero
        )

    def _is_fresh(self, reading: Reading, now_ns: int) -> bool:
        return abs(_seconds(now_ns, reading.stamp_ns)) <= self.parameters.sensor_timeout

    def _lost(self, sensors: Sensors, now_ns: int) -> str:
        """Say which sensor is silent; empty if none is."""
        silences = (self._silence(topic, r, now_ns) for topic, r in sensors.readings())
        return next(filter(None, silences), "")

    def _silence(self, topic: str, reading: Reading | None, now_ns: int) -> str:
        if reading is None:
            return f"{topic} was never heard"
        if self._is_fresh(reading, now_ns):
            return ""
        age = _seconds(now_ns, reading.stamp_ns)
        if age > 0.0:
            return f"{topic} is silent for {age:.3g} s"
        return f"{topic} is stamped {-age:.3g} s ahead: its sender follows another clock"

    def _elapsed(self, now_ns: int) -> float:
        return _seconds(now_ns, self._entered_ns)

    def _enter(
        self,
        phase: JumpPhase,
        reason: str,
        now_ns: int,
        level: Level = Level.OK,
        values: Mapping[str, object] | None = None,
    ) -> None:
        self.phase = phase
        self._entered_ns = now_ns
        self._transitions.append(Transition(phase, reason, level, values or {}))


def _refused(code: RefusalCode, reason: str) -> Refusal:
    return Refusal(topics.JUMP_REQUEST, code, reason)


def _known(sensors: Sensors) -> tuple[Reading, Reading]:
    """Compression and specific force of sensors that are not lost."""
    assert sensors.compression is not None
    assert sensors.specific_force is not None
    return sensors.compression, sensors.specific_force


def _seconds(later_ns: int, earlier_ns: int) -> float:
    return (later_ns - earlier_ns) / _NANO
