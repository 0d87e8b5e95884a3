"""Sequence of one jump: compress, settle, release, fly, land, hook again. Pure; without ROS.

It knows what the rover's own sensors say: the contact switch, the jump motor's state, the IMU and,
if it is heard, the load cell at the tether's end. Every state has a time limit and a way out:

=============  =======================================================================
standby        waits for a request
compressing    drives the nut to the stroke, where the latch holds; else lets it down
settling       waits until the rover is quiet, then looks at tilt and tether; else lets
               the spring down
releasing      trips the latch; else lets the spring down
flight         waits for the ground; else fault
landed         waits until the rover rests; toppled or restless: fault
hooking        drives the nut up past the latch, which snaps in; else fault
letting_down   drives the nut back to zero, softly; else fault
fault          nothing is driven; ``abort`` lets the spring down and leads back to standby
=============  =======================================================================

Time is the controller's clock in nanoseconds, which may be simulated and jump.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from msg_schemas import topics
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import Level
from rover_control.jump_parameters import JumpParameters, JumpPhase
from rover_control.jump_sensors import Reading, Sensors, is_fresh, seconds, silence

_FELT = 1.0  # a spring that pushes with more is felt by the nut [N]
_LET_GO = 0.5  # a spring that pushes with less than this share of what it did has been let go
_UNDERWAY = frozenset({JumpPhase.RELEASING, JumpPhase.FLIGHT, JumpPhase.LANDED, JumpPhase.HOOKING})


class NutCommand(NamedTuple):
    """What the jump motor is to do."""

    compression: float  # [m]
    rate: float  # [m/s]
    force: float  # [N]
    trips: bool = False  # whether the latch lets go there


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
        self.highest = 0.0  # compression reached since the request [m]
        self._entered_ns = 0
        self._stroke = 0.0
        self._speed = parameters.nut_speed
        self._way = 0.0  # of the nut to the stroke [m]
        self._strongest = 0.0  # force of the spring since the request [N]
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
        return sensors.waiting_for(now_ns, self.parameters.sensor_timeout)

    def check_request(self, sensors: Sensors, now_ns: int) -> None:
        """Refuse a jump that cannot be begun now, whatever its stroke.

        Raises:
            Refusal: busy, in fault, not standing, a sensor lost, nut not at zero.
        """
        if self.phase is not JumpPhase.STANDBY:
            way_out = f"; {topics.JUMP_ABORT} leads out of it"
            raise _refused(
                RefusalCode.WRONG_PHASE,
                f"the sequence is in {self.phase}, a jump starts from standby"
                + (way_out if self.phase is JumpPhase.FAULT else ""),
            )
        lost = self._lost(sensors, now_ns)
        if lost:
            raise _refused(RefusalCode.STALE, f"{lost}, so the rover's state is not known")
        compression, _ = _known(sensors)
        if sensors.is_open:
            raise _refused(
                RefusalCode.WRONG_PHASE, "the contact switch is open, the rover must stand to jump"
            )
        if compression.value > self.parameters.nut_zero_tolerance:
            raise _refused(
                RefusalCode.WRONG_PHASE,
                f"the spring is compressed by {compression.value:.4g} m already, it must be let "
                f"down first ({topics.JUMP_ABORT})",
            )

    def request(self, stroke: float, speed: float, sensors: Sensors, now_ns: int) -> None:
        """Begin a jump.

        Args:
            stroke: compression of the spring at take-off [m].
            speed: nut speed [m/s]; 0 = the parameters'.
            sensors: what is known now.
            now_ns: the controller's clock.

        Raises:
            Refusal: as of `check_request`, or the stroke is too long.
        """
        self.check_request(sensors, now_ns)
        limit = self.parameters.max_stroke
        if stroke > limit:
            raise _refused(
                RefusalCode.OUT_OF_LIMITS, f"stroke is {stroke!r} m, it must be at most {limit:g} m"
            )
        compression, force = _known(sensors)
        self._stroke = stroke
        self._speed = speed if speed > 0.0 else self.parameters.nut_speed
        self._way = stroke - compression.value
        self.highest = compression.value
        self._strongest = 0.0
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
            Refusal: the latch has been told to trip; or in standby, where the nut stands is not
                known.
        """
        if self.phase in _UNDERWAY:
            raise Refusal(
                topics.JUMP_ABORT,
                RefusalCode.WRONG_PHASE,
                f"the sequence is in {self.phase}: the latch has tripped, nothing can be let down",
            )
        if self.phase is JumpPhase.LETTING_DOWN:
            return "already letting the spring down"
        if self.phase is JumpPhase.STANDBY:
            patience = self.parameters.sensor_timeout
            silent = silence(topics.JUMP_MOTOR_STATE, sensors.compression, now_ns, patience)
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
            JumpPhase.SETTLING: self._hold,
            JumpPhase.RELEASING: self._release,
            JumpPhase.LETTING_DOWN: self._let_down,
            JumpPhase.FLIGHT: self._fly,
            JumpPhase.LANDED: self._settle,
            JumpPhase.HOOKING: self._hook,
        }.get(self.phase)
        if step is not None:
            step(sensors, now_ns)
        p = self.parameters
        if self.phase in (JumpPhase.COMPRESSING, JumpPhase.SETTLING):
            return NutCommand(self._stroke, self._speed, p.max_nut_force)
        if self.phase is JumpPhase.RELEASING:
            return NutCommand(self._stroke, self._speed, p.max_nut_force, trips=True)
        if self.phase is JumpPhase.HOOKING:
            return NutCommand(p.nut_park_position, p.nut_speed, p.max_nut_force)
        if self.phase is JumpPhase.LETTING_DOWN:
            return NutCommand(0.0, p.let_down_speed, p.max_nut_force)
        return None

    def _compress(self, sensors: Sensors, now_ns: int) -> None:
        if self._is_lost_or_lifted(sensors, now_ns) or self._has_let_go(sensors, now_ns):
            return
        p = self.parameters
        compression, _ = _known(sensors)
        felt = 0.0 if sensors.nut_force is None else sensors.nut_force.value
        if compression.value >= p.hook_check_stroke and felt < p.hook_check_force:
            self._enter(
                JumpPhase.LETTING_DOWN,
                f"the nut feels {felt:.3g} N at {compression.value:.4g} m, so the latch has not "
                "hooked Body 2",
                now_ns,
                Level.WARN,
                {"compression": compression.value, "force": felt},
            )
            return
        if abs(compression.value - self._stroke) <= p.nut_position_tolerance:
            self._quiet_since_ns = None
            self._enter(
                JumpPhase.SETTLING,
                f"the spring is held at {compression.value:.4g} m",
                now_ns,
                values={"compression": compression.value, "force": felt},
            )
            return
        limit = self._way / self._speed + p.nut_time_margin
        if self._elapsed(now_ns) > limit:
            self._enter(
                JumpPhase.LETTING_DOWN,
                f"not compressed within {limit:.3g} s, the nut came to {compression.value:.4g} m "
                f"of {self._stroke:g} m",
                now_ns,
                Level.ERROR,
                {"compression": compression.value},
            )

    def _hold(self, sensors: Sensors, now_ns: int) -> None:
        if self._is_lost_or_lifted(sensors, now_ns) or self._has_let_go(sensors, now_ns):
            return
        p = self.parameters
        if self._rests(sensors, now_ns) and sensors.rate <= p.quiet_rate:
            if self._quiet_since_ns is None:
                self._quiet_since_ns = now_ns
            if seconds(now_ns, self._quiet_since_ns) >= p.hold_time:
                self._judge(sensors, now_ns)
                return
        else:
            self._quiet_since_ns = None
        if self._elapsed(now_ns) > p.hold_timeout:
            self._enter(
                JumpPhase.LETTING_DOWN,
                f"not quiet within {p.hold_timeout:g} s with the spring held: it turns at "
                f"{sensors.rate:.3g} rad/s, at most {p.quiet_rate:g}, or its accelerometer is "
                "not quiet",
                now_ns,
                Level.WARN,
                {"rate": sensors.rate},
            )

    def _judge(self, sensors: Sensors, now_ns: int) -> None:
        """Release the spring if the rover stands well and the tether is slack."""
        p, pull = self.parameters, sensors.pull
        known = pull is not None and is_fresh(pull, now_ns, p.sensor_timeout)
        tension = pull.value if pull is not None and known else math.nan
        values = {"tilt": sensors.tilt, "pull": tension}
        wrong = ""
        if sensors.tilt > p.max_tilt:
            wrong = f"the rover tilts by {sensors.tilt:.3g} rad, at most {p.max_tilt:g} to jump"
        elif tension > p.max_tether_tension:
            wrong = (
                f"the tether tension is {tension:.3g} N, limit {p.max_tether_tension:g} N; "
                "give slack"
            )
        if wrong:
            self._enter(JumpPhase.LETTING_DOWN, wrong, now_ns, Level.WARN, values)
        else:
            self._enter(JumpPhase.RELEASING, "quiet, upright and slack", now_ns, values=values)

    def _release(self, sensors: Sensors, now_ns: int) -> None:
        if self._has_let_go(sensors, now_ns):
            return
        limit = self.parameters.release_timeout
        if self._elapsed(now_ns) > limit:
            lost = self._lost(sensors, now_ns) or "the nut still feels the spring"
            self._enter(
                JumpPhase.LETTING_DOWN,
                f"the latch has not tripped within {limit:g} s: {lost}",
                now_ns,
                Level.ERROR,
            )

    def _is_lost_or_lifted(self, sensors: Sensors, now_ns: int) -> bool:
        """Let the spring down if a sensor is lost or the rover is lifted with the spring held."""
        lost = self._lost(sensors, now_ns)
        if lost:
            self._enter(JumpPhase.LETTING_DOWN, lost, now_ns, Level.ERROR)
            return True
        compression, _ = _known(sensors)
        if sensors.is_open and sensors.opened_ns is not None:
            lifted = seconds(compression.stamp_ns, sensors.opened_ns)
            if lifted > self.parameters.contact_loss_time:
                self._enter(
                    JumpPhase.LETTING_DOWN,
                    f"contact lost at {compression.value:.4g} m with the spring still held",
                    now_ns,
                    Level.WARN,
                )
                return True
        return False

    def _has_let_go(self, sensors: Sensors, now_ns: int) -> bool:
        """Follow the spring; go over to the flight once the latch no longer holds it."""
        if sensors.compression is None or sensors.nut_force is None:
            return False
        compression, force = sensors.compression, sensors.nut_force.value
        p = self.parameters
        sprang_back = self.highest > p.nut_zero_tolerance and compression.value < 0.5 * self.highest
        let_go = self._strongest > _FELT and force < _LET_GO * self._strongest
        if sprang_back or let_go:
            self._enter(
                JumpPhase.FLIGHT,
                f"the latch has tripped, the nut was last seen at {self.highest:.4g} m",
                now_ns,
                values={"compression": self.highest},
            )
            return True
        self.highest = max(self.highest, compression.value)
        self._strongest = max(self._strongest, force)
        self._held_ns = compression.stamp_ns
        return False

    def _let_down(self, sensors: Sensors, now_ns: int) -> None:
        if self._is_down(sensors, now_ns):
            self._enter(JumpPhase.STANDBY, "the spring is let down", now_ns)
            return
        way = max(self.highest, self.parameters.max_stroke)
        limit = way / self.parameters.let_down_speed + self.parameters.nut_time_margin
        self._give_up(sensors, now_ns, limit, "spring not let down", "the nut does not come back")

    def _hook(self, sensors: Sensors, now_ns: int) -> None:
        p = self.parameters
        if sensors.is_down(
            p.nut_park_position + p.nut_position_tolerance, now_ns, p.sensor_timeout
        ):
            self._enter(JumpPhase.STANDBY, "the nut stands above the latch", now_ns)
            return
        limit = (max(self.highest, p.max_stroke) - p.nut_park_position) / p.nut_speed
        limit += p.nut_time_margin
        self._give_up(sensors, now_ns, limit, "latch not hooked", "the nut does not come up")

    def _give_up(
        self, sensors: Sensors, now_ns: int, limit: float, what: str, otherwise: str
    ) -> None:
        if self._elapsed(now_ns) > limit:
            reason = self._lost(sensors, now_ns) or otherwise
            text = f"{what} within {limit:.3g} s: {reason}"
            self._enter(JumpPhase.FAULT, text, now_ns, Level.ERROR)

    def _fly(self, sensors: Sensors, now_ns: int) -> None:
        # The switch may tell of the take-off later than the nut does: it must have opened.
        has_opened = sensors.last_open_ns is not None and sensors.last_open_ns > self._held_ns
        closed = sensors.contact is not None and not sensors.is_open
        if closed and has_opened:
            flown = sensors.open_time
            self._land(f"contact after about {flown:.3g} s of flight", flown, Level.OK, now_ns)
        elif closed and self._elapsed(now_ns) > self.parameters.take_off_timeout:
            limit = self.parameters.take_off_timeout
            text = f"the rover has not left the ground within {limit:g} s"
            self._land(text, 0.0, Level.WARN, now_ns)
        elif self._elapsed(now_ns) > self.parameters.flight_timeout:
            limit = self.parameters.flight_timeout
            self._enter(JumpPhase.FAULT, f"no landing within {limit:g} s", now_ns, Level.ERROR)

    def _land(self, text: str, flown: float, level: Level, now_ns: int) -> None:
        self._quiet_since_ns = None
        self._enter(JumpPhase.LANDED, text, now_ns, level, {"flight_time": flown})

    def _settle(self, sensors: Sensors, now_ns: int) -> None:
        if self._rests(sensors, now_ns):
            if self._quiet_since_ns is None:
                self._quiet_since_ns = now_ns
            if seconds(now_ns, self._quiet_since_ns) >= self.parameters.settle_time:
                self._rest(sensors, now_ns)
                return
        else:
            self._quiet_since_ns = None
        limit = self.parameters.settle_timeout
        otherwise = "contact or accelerometer are not quiet"
        self._give_up(sensors, now_ns, limit, "not at rest after landing", otherwise)

    def _rest(self, sensors: Sensors, now_ns: int) -> None:
        """Hook again if the nut stands below the latch, and stand by."""
        p = self.parameters
        values = {"tilt": sensors.tilt}
        if sensors.tilt > p.toppled_tilt:
            text = f"toppled: at rest with a tilt of {sensors.tilt:.3g} rad"
            self._enter(JumpPhase.FAULT, text, now_ns, Level.ERROR, values)
            return
        compression, _ = _known(sensors)
        if compression.value > p.nut_zero_tolerance:
            text = "at rest on the ground, the nut is below the latch"
            self._enter(JumpPhase.HOOKING, text, now_ns, values=values)
            return
        self._enter(JumpPhase.STANDBY, "at rest on the ground", now_ns, values=values)

    # --- helpers ---------------------------------------------------------------------------------

    def _rests(self, sensors: Sensors, now_ns: int) -> bool:
        if self._lost(sensors, now_ns):
            return False
        _, force = _known(sensors)
        spread = self.parameters.quiet_force_fraction * self._standing_force
        return not sensors.is_open and abs(force.value - self._standing_force) <= spread

    def _is_down(self, sensors: Sensors, now_ns: int) -> bool:
        return sensors.is_down(
            self.parameters.nut_zero_tolerance, now_ns, self.parameters.sensor_timeout
        )

    def _lost(self, sensors: Sensors, now_ns: int) -> str:
        return sensors.lost(now_ns, self.parameters.sensor_timeout)

    def _elapsed(self, now_ns: int) -> float:
        return seconds(now_ns, self._entered_ns)

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
