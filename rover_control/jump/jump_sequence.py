"""State machine of one jump: compress, settle, release, fly, land, hook the latch again. Pure.

Inputs are the rover's own sensors: contact switch, jump motor state, IMU and, if available, the
load cell at the tether's end. Every state has a time limit and a defined exit:

=============  =======================================================================
standby        waits for a request
compressing    drives the nut to the stroke against the latch; on failure letting_down
settling       waits until the rover is quiet, then checks tilt and tether tension; on
               failure letting_down
releasing      trips the latch; on failure letting_down
flight         waits for ground contact; on timeout fault
landed         waits until the rover is at rest; if toppled or restless fault
hooking        drives the nut up past the latch, which engages; on timeout fault
letting_down   drives the nut back to zero slowly; on timeout fault
fault          no commands; ``abort`` lets the spring down and returns to standby
=============  =======================================================================

Times are those of the controller's clock [ns], which may be simulated and may jump.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from msg_schemas import topics
from msg_schemas.events import EventReport, JumpEvent
from msg_schemas.faults import JumpFailure, JumpFault, Reason
from msg_schemas.phases import JumpPhase
from msg_schemas.refusal import Refusal, RefusalCode
from rover_control.jump.jump_parameters import JumpParameters
from rover_control.jump.jump_sensors import Reading, Sensors, is_fresh, seconds, staleness

_MIN_SPRING_FORCE = 1.0  # least spring force that the nut can detect [N]
_RELEASED_FRACTION = 0.5  # fraction of the peak force below which the spring counts as released
_UNDERWAY = frozenset({JumpPhase.RELEASING, JumpPhase.FLIGHT, JumpPhase.LANDED, JumpPhase.HOOKING})


class NutCommand(NamedTuple):
    """Command of the jump motor."""

    compression: float  # [m]
    rate: float  # [m/s]
    force: float  # [N]
    trips: bool = False  # whether the latch releases at the setpoint


_PHASE_EVENTS = {
    JumpPhase.COMPRESSING: JumpEvent.COMPRESSING,
    JumpPhase.SETTLING: JumpEvent.SETTLING,
    JumpPhase.RELEASING: JumpEvent.RELEASING,
    JumpPhase.FLIGHT: JumpEvent.FLIGHT,
    JumpPhase.LANDED: JumpEvent.LANDED,
    JumpPhase.HOOKING: JumpEvent.HOOKING,
    JumpPhase.STANDBY: JumpEvent.STANDBY,
    JumpPhase.FAULT: JumpEvent.FAULT,
}


class Transition(NamedTuple):
    """A change of phase and the event that reports it."""

    phase: JumpPhase
    event: EventReport


class JumpSequence:
    """Sequence of the jumps of one rover.

    Args:
        parameters: limits and times.
    """

    def __init__(self, parameters: JumpParameters) -> None:
        self.parameters = parameters
        self.phase = JumpPhase.STANDBY
        self.peak_compression = 0.0  # largest compression since the request [m]
        self._entered_ns = 0
        self._stroke = 0.0
        self._speed = parameters.nut_speed
        self._travel = 0.0  # nut travel to the stroke [m]
        self._peak_force = 0.0  # largest spring force since the request [N]
        self._held_ns = 0  # when the nut last held the spring
        self._quiet_since_ns: int | None = None
        self._standing_force = 0.0  # specific force before the jump [m/s^2]
        self._transitions: list[Transition] = []

    def take_transitions(self) -> list[Transition]:
        """Return the transitions since the last call and clear them."""
        transitions, self._transitions = self._transitions, []
        return transitions

    # --- requests --------------------------------------------------------------------------------

    def waiting_for(self, sensors: Sensors, now_ns: int) -> tuple[str, ...]:
        """Topics of the stale sensors; no jump begins without them."""
        return sensors.waiting_for(now_ns, self.parameters.sensor_timeout)

    def check_request(self, sensors: Sensors, now_ns: int) -> None:
        """Check that a jump can begin now, whatever its stroke.

        Raises:
            Refusal: busy, in fault, not standing, a sensor stale, or the nut not at zero.
        """
        if self.phase is not JumpPhase.STANDBY:
            hint = f"; call {topics.JUMP_ABORT}"
            raise _refused(
                RefusalCode.WRONG_PHASE,
                f"the jump sequence is in phase {self.phase}, not in standby"
                + (hint if self.phase is JumpPhase.FAULT else ""),
            )
        stale = self._stale_sensor(sensors, now_ns)
        if stale:
            raise _refused(RefusalCode.STALE, f"{stale}: the state of the rover is unknown")
        compression, _ = _known(sensors)
        if sensors.is_open:
            raise _refused(
                RefusalCode.WRONG_PHASE,
                "the contact switch is open; the rover must stand on the ground to jump",
            )
        if compression.value > self.parameters.nut_zero_tolerance:
            raise _refused(
                RefusalCode.WRONG_PHASE,
                f"the spring is compressed by {compression.value:.4g} m; let it down first "
                f"({topics.JUMP_ABORT})",
            )

    def request(self, stroke: float, speed: float, sensors: Sensors, now_ns: int) -> None:
        """Begin a jump.

        Args:
            stroke: compression of the spring at take-off [m].
            speed: nut speed [m/s]; 0 = the parameter `nut_speed`.
            sensors: present readings.
            now_ns: the controller's clock.

        Raises:
            Refusal: see `check_request`, or the stroke exceeds its limit.
        """
        self.check_request(sensors, now_ns)
        limit = self.parameters.max_stroke
        if stroke > limit:
            raise _refused(RefusalCode.OUT_OF_LIMITS, f"stroke is {stroke!r} m, limit {limit:g} m")
        compression, force = _known(sensors)
        self._stroke = stroke
        self._speed = speed if speed > 0.0 else self.parameters.nut_speed
        self._travel = stroke - compression.value
        self.peak_compression = compression.value
        self._peak_force = 0.0
        self._standing_force = force.value
        self._held_ns = compression.stamp_ns
        self._enter(
            JumpPhase.COMPRESSING,
            f"requested stroke {stroke:g} m at {self._speed:g} m/s",
            now_ns,
            values={"stroke": stroke, "speed": self._speed},
        )

    def abort(self, sensors: Sensors, now_ns: int) -> str:
        """Abort a compression or leave a fault by letting the spring down; returns what happens.

        Raises:
            Refusal: the latch has tripped, or the nut's position is unknown in standby.
        """
        if self.phase in _UNDERWAY:
            raise Refusal(
                topics.JUMP_ABORT,
                RefusalCode.WRONG_PHASE,
                f"the jump sequence is in phase {self.phase}: the latch has tripped, the "
                "spring cannot be let down",
            )
        if self.phase is JumpPhase.LETTING_DOWN:
            return "the spring is already being let down"
        if self.phase is JumpPhase.STANDBY:
            timeout = self.parameters.sensor_timeout
            stale = staleness(topics.JUMP_MOTOR_STATE, sensors.compression, now_ns, timeout)
            if stale:
                raise Refusal(topics.JUMP_ABORT, RefusalCode.STALE, stale)
            if self._is_let_down(sensors, now_ns):
                return "the spring is already let down"
        self._let_go(JumpEvent.ABORTED, Reason.REQUESTED, f"aborted in {self.phase}", now_ns)
        return "letting the spring down"

    def clock_jumped(self, now_ns: int) -> None:
        """Restart after a clock jump: all times are invalid."""
        if self.phase is not JumpPhase.STANDBY:
            text = "the clock jumped back"
            self._enter(
                JumpPhase.STANDBY, text, now_ns, name=JumpEvent.RESET, reason=Reason.CLOCK_JUMP
            )
        self._entered_ns = now_ns

    # --- control step ----------------------------------------------------------------------------

    def step(self, sensors: Sensors, now_ns: int) -> NutCommand | None:
        """Advance to a time [ns]; returns the nut command, or None."""
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
        if self._is_stale_or_lifted(sensors, now_ns) or self._has_released(sensors, now_ns):
            return
        p = self.parameters
        compression, _ = _known(sensors)
        felt = 0.0 if sensors.nut_force is None else sensors.nut_force.value
        if compression.value >= p.hook_check_stroke and felt < p.hook_check_force:
            self._let_go(
                JumpEvent.CANCELLED,
                Reason.OUT_OF_LIMITS,
                f"nut force is {felt:.3g} N at {compression.value:.4g} m, minimum "
                f"{p.hook_check_force:g} N: the latch has not hooked Body 2",
                now_ns,
                JumpFailure.NOT_HOOKED,
                {"compression": compression.value, "force": felt},
            )
            return
        if abs(compression.value - self._stroke) <= p.nut_position_tolerance:
            self._quiet_since_ns = None
            self._enter(
                JumpPhase.SETTLING,
                f"spring held at {compression.value:.4g} m",
                now_ns,
                values={"compression": compression.value, "force": felt},
            )
            return
        limit = self._travel / self._speed + p.nut_time_margin
        if self._elapsed(now_ns) > limit:
            self._let_go(
                JumpEvent.FAILED,
                Reason.TIME_LIMIT,
                f"not compressed within {limit:.3g} s: the nut reached "
                f"{compression.value:.4g} m of {self._stroke:g} m",
                now_ns,
                JumpFailure.NOT_COMPRESSED,
                {"compression": compression.value},
            )

    def _hold(self, sensors: Sensors, now_ns: int) -> None:
        if self._is_stale_or_lifted(sensors, now_ns) or self._has_released(sensors, now_ns):
            return
        p = self.parameters
        if self._is_quiet(sensors, now_ns) and sensors.rate <= p.quiet_rate:
            if self._quiet_since_ns is None:
                self._quiet_since_ns = now_ns
            if seconds(now_ns, self._quiet_since_ns) >= p.hold_time:
                self._decide_release(sensors, now_ns)
                return
        else:
            self._quiet_since_ns = None
        if self._elapsed(now_ns) > p.hold_timeout:
            self._let_go(
                JumpEvent.CANCELLED,
                Reason.TIME_LIMIT,
                f"not quiet within {p.hold_timeout:g} s with the spring held: angular rate "
                f"{sensors.rate:.3g} rad/s, limit {p.quiet_rate:g} rad/s, or the "
                "accelerometer is not quiet",
                now_ns,
                JumpFailure.NOT_QUIET,
                {"rate": sensors.rate},
            )

    def _decide_release(self, sensors: Sensors, now_ns: int) -> None:
        """Trip the latch if tilt and tether tension are within their limits."""
        p, tension_reading = self.parameters, sensors.tether_tension
        is_known = tension_reading is not None and is_fresh(
            tension_reading, now_ns, p.sensor_timeout
        )
        tension = tension_reading.value if tension_reading is not None and is_known else math.nan
        values = {"tilt": sensors.tilt, "tension": tension}
        cancelled, beyond = JumpEvent.CANCELLED, Reason.OUT_OF_LIMITS
        if sensors.tilt > p.max_tilt:
            text = f"the tilt is {sensors.tilt:.3g} rad, limit {p.max_tilt:g} rad"
            self._let_go(cancelled, beyond, text, now_ns, JumpFailure.TILTED, values)
        elif tension > p.max_tether_tension:
            text = (
                f"the tether tension is {tension:.3g} N, limit {p.max_tether_tension:g} N; "
                "give slack"
            )
            self._let_go(cancelled, beyond, text, now_ns, JumpFailure.TAUT, values)
        else:
            self._enter(
                JumpPhase.RELEASING,
                "the rover is quiet and upright, the tether slack",
                now_ns,
                values=values,
            )

    def _release(self, sensors: Sensors, now_ns: int) -> None:
        if self._has_released(sensors, now_ns):
            return
        limit = self.parameters.release_timeout
        if self._elapsed(now_ns) > limit:
            stale = self._stale_sensor(sensors, now_ns) or (
                "the nut still measures the spring's force"
            )
            self._let_go(
                JumpEvent.FAILED,
                Reason.TIME_LIMIT,
                f"the latch did not trip within {limit:g} s: {stale}",
                now_ns,
                JumpFailure.NOT_TRIPPED,
            )

    def _is_stale_or_lifted(self, sensors: Sensors, now_ns: int) -> bool:
        """Let the spring down if a sensor is stale or the rover was lifted with the spring held."""
        stale = self._stale_sensor(sensors, now_ns)
        if stale:
            cause = JumpFailure.SENSOR_TIMEOUT
            self._let_go(JumpEvent.FAILED, Reason.SENSOR_TIMEOUT, stale, now_ns, cause)
            return True
        compression, _ = _known(sensors)
        if sensors.is_open and sensors.opened_ns is not None:
            lifted = seconds(compression.stamp_ns, sensors.opened_ns)
            if lifted > self.parameters.contact_loss_time:
                self._let_go(
                    JumpEvent.CANCELLED,
                    Reason.OUT_OF_LIMITS,
                    f"contact lost at {compression.value:.4g} m with the spring still held",
                    now_ns,
                    JumpFailure.LIFTED,
                )
                return True
        return False

    def _has_released(self, sensors: Sensors, now_ns: int) -> bool:
        """Track the spring; enter the flight once the latch no longer holds it."""
        if sensors.compression is None or sensors.nut_force is None:
            return False
        compression, force = sensors.compression, sensors.nut_force.value
        p = self.parameters
        nut_returned = (
            self.peak_compression > p.nut_zero_tolerance
            and compression.value < 0.5 * self.peak_compression
        )
        force_dropped = (
            self._peak_force > _MIN_SPRING_FORCE and force < _RELEASED_FRACTION * self._peak_force
        )
        if nut_returned or force_dropped:
            self._enter(
                JumpPhase.FLIGHT,
                f"latch tripped; last compression {self.peak_compression:.4g} m",
                now_ns,
                values={"compression": self.peak_compression},
            )
            return True
        self.peak_compression = max(self.peak_compression, compression.value)
        self._peak_force = max(self._peak_force, force)
        self._held_ns = compression.stamp_ns
        return False

    def _let_down(self, sensors: Sensors, now_ns: int) -> None:
        if self._is_let_down(sensors, now_ns):
            self._enter(JumpPhase.STANDBY, "spring let down", now_ns)
            return
        travel = max(self.peak_compression, self.parameters.max_stroke)
        limit = travel / self.parameters.let_down_speed + self.parameters.nut_time_margin
        text = "spring not let down"
        fault = JumpFault.SPRING_NOT_LET_DOWN
        self._check_timeout(sensors, now_ns, limit, fault, text, "the nut does not return")

    def _hook(self, sensors: Sensors, now_ns: int) -> None:
        p = self.parameters
        if sensors.is_let_down(
            p.nut_park_position + p.nut_position_tolerance, now_ns, p.sensor_timeout
        ):
            self._enter(JumpPhase.STANDBY, "the nut is above the latch", now_ns)
            return
        limit = (max(self.peak_compression, p.max_stroke) - p.nut_park_position) / p.nut_speed
        limit += p.nut_time_margin
        fault = JumpFault.LATCH_NOT_HOOKED
        self._check_timeout(
            sensors, now_ns, limit, fault, "latch not hooked", "the nut does not move up"
        )

    def _check_timeout(
        self,
        sensors: Sensors,
        now_ns: int,
        limit: float,
        fault: JumpFault,
        failure: str,
        otherwise: str,
    ) -> None:
        if self._elapsed(now_ns) > limit:
            reason = self._stale_sensor(sensors, now_ns) or otherwise
            text = f"{failure} within {limit:.3g} s: {reason}"
            self._fail(fault, text, now_ns)

    def _fly(self, sensors: Sensors, now_ns: int) -> None:
        # The switch may report the take-off later than the nut does: require that it has opened.
        has_opened = sensors.last_open_ns is not None and sensors.last_open_ns > self._held_ns
        closed = sensors.contact is not None and not sensors.is_open
        if closed and has_opened:
            flown = sensors.open_time
            text = f"ground contact after about {flown:.3g} s of flight"
            self._land(JumpEvent.LANDED, text, flown, now_ns)
        elif closed and self._elapsed(now_ns) > self.parameters.take_off_timeout:
            limit = self.parameters.take_off_timeout
            text = f"no take-off within {limit:g} s"
            self._land(JumpEvent.NO_TAKE_OFF, text, 0.0, now_ns, Reason.TIME_LIMIT)
        elif self._elapsed(now_ns) > self.parameters.flight_timeout:
            limit = self.parameters.flight_timeout
            self._fail(JumpFault.NO_LANDING, f"no landing within {limit:g} s", now_ns)

    def _land(
        self, name: JumpEvent, text: str, flown: float, now_ns: int, reason: Reason | None = None
    ) -> None:
        self._quiet_since_ns = None
        values = {"flight_time": flown}
        self._enter(JumpPhase.LANDED, text, now_ns, values, name=name, reason=reason)

    def _settle(self, sensors: Sensors, now_ns: int) -> None:
        if self._is_quiet(sensors, now_ns):
            if self._quiet_since_ns is None:
                self._quiet_since_ns = now_ns
            if seconds(now_ns, self._quiet_since_ns) >= self.parameters.settle_time:
                self._finish(sensors, now_ns)
                return
        else:
            self._quiet_since_ns = None
        limit = self.parameters.settle_timeout
        otherwise = "the contact or the accelerometer is not quiet"
        fault = JumpFault.NOT_AT_REST
        self._check_timeout(sensors, now_ns, limit, fault, "not at rest after landing", otherwise)

    def _finish(self, sensors: Sensors, now_ns: int) -> None:
        """End the jump: hook the latch again if the nut is below it, else return to standby."""
        p = self.parameters
        values = {"tilt": sensors.tilt}
        if sensors.tilt > p.toppled_tilt:
            text = f"toppled: tilt at rest {sensors.tilt:.3g} rad, limit {p.toppled_tilt:g} rad"
            self._fail(JumpFault.TOPPLED, text, now_ns, values)
            return
        compression, _ = _known(sensors)
        if compression.value > p.nut_zero_tolerance:
            text = "at rest on the ground, nut below the latch"
            self._enter(JumpPhase.HOOKING, text, now_ns, values=values)
            return
        self._enter(JumpPhase.STANDBY, "at rest on the ground", now_ns, values=values)

    # --- helpers ---------------------------------------------------------------------------------

    def _is_quiet(self, sensors: Sensors, now_ns: int) -> bool:
        if self._stale_sensor(sensors, now_ns):
            return False
        _, force = _known(sensors)
        spread = self.parameters.quiet_force_fraction * self._standing_force
        return not sensors.is_open and abs(force.value - self._standing_force) <= spread

    def _is_let_down(self, sensors: Sensors, now_ns: int) -> bool:
        return sensors.is_let_down(
            self.parameters.nut_zero_tolerance, now_ns, self.parameters.sensor_timeout
        )

    def _stale_sensor(self, sensors: Sensors, now_ns: int) -> str:
        return sensors.stale(now_ns, self.parameters.sensor_timeout)

    def _elapsed(self, now_ns: int) -> float:
        return seconds(now_ns, self._entered_ns)

    def _enter(
        self,
        phase: JumpPhase,
        text: str,
        now_ns: int,
        values: Mapping[str, object] | None = None,
        *,
        name: JumpEvent | None = None,
        reason: Reason | None = None,
    ) -> None:
        self.phase = phase
        self._entered_ns = now_ns
        event = EventReport(name or _PHASE_EVENTS[phase], text, values or {}, reason)
        self._transitions.append(Transition(phase, event))

    def _let_go(
        self,
        name: JumpEvent,
        reason: Reason,
        text: str,
        now_ns: int,
        cause: JumpFailure | None = None,
        values: Mapping[str, object] | None = None,
    ) -> None:
        """Let the spring down, and report why."""
        details = {**({} if cause is None else {"cause": cause.value}), **(values or {})}
        self._enter(JumpPhase.LETTING_DOWN, text, now_ns, details, name=name, reason=reason)

    def _fail(
        self,
        fault: JumpFault,
        text: str,
        now_ns: int,
        values: Mapping[str, object] | None = None,
    ) -> None:
        details = {"fault": fault.value, **(values or {})}
        self._enter(JumpPhase.FAULT, text, now_ns, details, reason=Reason.FAULT)


def _refused(code: RefusalCode, reason: str) -> Refusal:
    return Refusal(topics.JUMP_REQUEST, code, reason)


def _known(sensors: Sensors) -> tuple[Reading, Reading]:
    """Compression and specific force, if the sensors are not stale."""
    assert sensors.compression is not None
    assert sensors.specific_force is not None
    return sensors.compression, sensors.specific_force
