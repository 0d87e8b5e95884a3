"""Sequence of a descent or ascent with its stops. Pure; stepped without ROS.

=============  ==================================================================================
standby        waits for a request
damping        damps the swing, before a travel that would amplify it too much or at a stop
travelling     moves to the next depth
settling       winch at rest, pumping stopped; waits for a steady camera, or damps again
exposing       takes the stop's pictures, each while the camera is steady
holding        stands still on request; `resume` continues with the remaining stops
=============  ==================================================================================

Every stop ends with its pictures, or with the reason for none.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from msg_schemas import machine, topics
from msg_schemas.events import DescentEvent, EventName, EventReport
from msg_schemas.faults import Reason
from msg_schemas.phases import DescentPhase
from msg_schemas.refusal import Refusal, RefusalCode
from rover_control.hanging.camera_rate import CameraRate
from rover_control.hanging.cone_transfer import ConeTransfer
from rover_control.hanging.descent_parameters import ProfileParameters
from rover_control.hanging.descent_stop import DescentStop, PresentStop
from rover_control.hanging.hanging_rover import HangingParameters
from rover_control.hanging.swing_estimator import SwingEstimate
from rover_control.hanging.swing_limits import SwingLimits, deg
from rover_control.hanging.yaw_momentum import MomentumTransfer, YawTask

_SETTLING_PERIODS = 1.3  # swing periods that a settling may take at least
_CALM_FRACTION = 0.7  # of the largest swing, below which an ascent needs no time for the rotors
_CERTAINTY = 3.0  # standard deviations of the swing within which it is judged
_PHASE_EVENTS = {
    DescentPhase.STANDBY: DescentEvent.STANDBY,
    DescentPhase.DAMPING: DescentEvent.DAMPING,
    DescentPhase.TRAVELLING: DescentEvent.TRAVELLING,
    DescentPhase.SETTLING: DescentEvent.SETTLING,
    DescentPhase.EXPOSING: DescentEvent.EXPOSING,
    DescentPhase.HOLDING: DescentEvent.HOLDING,
}


class ProfileSetpoints(NamedTuple):
    """Setpoints of the profile."""

    length: float  # of the winch [m]; NaN = unchanged
    rate: float  # largest [m/s]
    trim: float  # the winch damps the swing, 1, leaves it, 0, or raises it, -1
    pumps: bool  # the rotors damp swing and yaw
    quiet: bool  # imaging, now or soon
    yaw: YawTask  # of the rotors
    exposes: bool  # take a picture now


class DescentProfile:
    """Sequencer of a descent.

    Args:
        parameters: rates, limits, timeouts.
        hanging: rover and tether.
        decay_time: decay time of a damped plane swing [s] on a length [m].
    """

    def __init__(
        self,
        parameters: ProfileParameters,
        hanging: HangingParameters,
        decay_time: Callable[[float], float],
    ) -> None:
        self.parameters = parameters
        self.hanging = hanging
        self.transfer = ConeTransfer(parameters, hanging)
        self.limits = SwingLimits(parameters, hanging, decay_time, self.transfer)
        self.phase = DescentPhase.STANDBY
        self.stops: deque[DescentStop] = deque()
        self.stop: DescentStop | None = None  # present stop
        self.length_setpoint = math.nan  # of the winch [m]
        self._camera = CameraRate()
        self._phase_since = math.nan  # start of the phase [s]
        self._arrived_at = math.nan  # arrival at the stop [s]
        self._steady_since = math.nan
        self._pictures = 0
        self._attempts = 0
        self._last_exposure = -math.inf
        self._estimating_since = math.nan
        self._changes: list[EventReport] = []

    def on_swing_lost(self) -> None:
        """Let the swing estimate settle again before the next action."""
        self._estimating_since = math.nan

    def take_changes(self) -> list[EventReport]:
        """Return the transitions since the last call, and clear them."""
        taken, self._changes = self._changes, []
        return taken

    @property
    def is_idle(self) -> bool:
        """Whether no stop is left."""
        return self.phase is DescentPhase.STANDBY and not self.stops

    # --- requests --------------------------------------------------------------------------------

    def request(self, stop: DescentStop, swing: SwingEstimate | None, length: float) -> None:
        """Add a stop.

        Raises:
            Refusal: in a hold, swing unknown, rate too high, or the rover could touch the wall.
        """
        if self.phase is DescentPhase.HOLDING:
            raise _refused(RefusalCode.WRONG_PHASE, "the descent is held; resume it first")
        if swing is None:
            raise _refused(
                RefusalCode.STALE, "the swing is unknown: no sample of IMU or winch received"
            )
        if not 0.0 < stop.depth <= machine.MAX_LENGTH:
            raise _refused(
                RefusalCode.OUT_OF_LIMITS, f"depth is {stop.depth!r} m, it must be above 0"
            )
        if stop.rate > self.parameters.travel_rate:
            raise _refused(
                RefusalCode.OUT_OF_LIMITS,
                f"rate is {stop.rate!r} m/s, it must be at most "
                f"{self.parameters.travel_rate:g} m/s",
            )
        reason = self.limits.wall_conflict(swing, length, stop.depth, -_CERTAINTY)
        if reason:
            raise _refused(RefusalCode.OUT_OF_LIMITS, reason)
        rate = stop.rate if stop.rate > 0.0 else self.parameters.travel_rate
        self.stops.append(stop._replace(rate=rate))

    def hold(self, length: float, now: float, cause: Reason = Reason.REQUESTED) -> str:
        """Hold the present length [m]."""
        if self.phase is not DescentPhase.HOLDING:
            self.length_setpoint = length
            self._enter(DescentPhase.HOLDING, f"hold requested at {length:.4g} m", now, cause)
        return f"holding {self.length_setpoint:.4g} m"

    def resume(self, now: float) -> str:
        """Continue after a hold.

        Raises:
            Refusal: the descent is not held.
        """
        if self.phase is not DescentPhase.HOLDING:
            raise Refusal(
                topics.DESCENT_RESUME,
                RefusalCode.WRONG_PHASE,
                f"the descent is in {self.phase}, only a hold can be resumed",
            )
        if self._has_pictures:
            self._end_observation()
        elif self.stop is not None:
            self.stops.appendleft(self.stop)
            self.stop = None
        self._enter(DescentPhase.STANDBY, "resumed", now, Reason.REQUESTED)
        return f"{len(self.stops)} stops left"

    def abort(self, length: float, now: float) -> str:
        """Drop all stops, and hold the present length [m]."""
        if self._has_pictures:
            self._end_observation()
        dropped = len(self.stops) + (self.stop is not None)
        self.stops.clear()
        if self.stop is not None:
            self._end_stop(DescentEvent.STOP_ABORTED, "aborted", length, Reason.REQUESTED)
        self.length_setpoint = length
        if self.phase is not DescentPhase.STANDBY:
            self._enter(DescentPhase.STANDBY, "aborted", now, Reason.REQUESTED)
        return f"{dropped} stops dropped"

    # --- control step ----------------------------------------------------------------------------

    def step(
        self,
        swing: SwingEstimate,
        length: float,
        *,
        transfer: MomentumTransfer,
        winch_rests: bool,
        rotors_rest: bool,
        now: float,
    ) -> ProfileSetpoints:
        """Advance to now [s]; returns the setpoints.

        Args:
            swing: estimate of the swing.
            length: payout [m].
            transfer: prediction of a transfer of the momentum about the plumb line.
            winch_rests: the winch stands with its brake closed.
            rotors_rest: the rotors have come down from pumping.
            now: [s].
        """
        p = self.parameters
        if math.isnan(self._estimating_since):
            self._estimating_since = now
        if math.isnan(self._phase_since):
            self._phase_since = now
        exposes = False
        # A yaw rate that is not known is no steady camera.
        self._camera.update(math.hypot(swing.camera_rate, swing.yaw_error), now)
        self.transfer.prediction = transfer
        if self.phase is DescentPhase.STANDBY:
            if self.stops and now - self._estimating_since >= p.estimator_settling_time:
                self._begin(swing, length, now)
        elif self.phase is DescentPhase.DAMPING:
            self._damp(swing, length, now)
        elif self.phase is DescentPhase.TRAVELLING:
            assert self.stop is not None
            if abs(length - self.stop.depth) < p.depth_tolerance and winch_rests:
                self._arrived_at = now
                self._enter(DescentPhase.SETTLING, f"at {length:.4g} m", now)
        elif self.phase is DescentPhase.SETTLING:
            self._settle(swing, length, winch_rests and rotors_rest, now)
        elif self.phase is DescentPhase.EXPOSING:
            exposes = self._expose(now)
        return ProfileSetpoints(
            self.length_setpoint,
            self._rate(swing, length),
            self._trim(swing, length) if self.phase is DescentPhase.DAMPING else 0.0,
            self.phase in (DescentPhase.DAMPING, DescentPhase.TRAVELLING),
            self.phase in (DescentPhase.SETTLING, DescentPhase.EXPOSING),
            self.transfer.task,
            exposes,
        )

    @property
    def _present(self) -> PresentStop:
        assert self.stop is not None
        return PresentStop(self.stop, self._is_at_stop, self.phase is DescentPhase.SETTLING)

    def _trim(self, swing: SwingEstimate, length: float) -> float:
        """What the winch does to the swing: damps 1, nothing 0, raises -1."""
        if self.transfer.task in (YawTask.TRANSFER, YawTask.RELAX):
            return self.transfer.trim(swing)
        return float(self.limits.swing_exceeds(swing, length, self._present))

    def _rate(self, swing: SwingEstimate, length: float) -> float:
        """Largest payout rate [m/s].

        Shortening amplifies the swing whatever the rate, by `swing_amplitude_at`. Where that passes
        the largest swing, a slow ascent gives the rotors the time to damp it.
        """
        p = self.parameters
        rate = p.travel_rate if self.stop is None else self.stop.rate
        if not self.length_setpoint < length:
            return rate
        slow = max(p.ascent_rate_gain * length, p.min_ascent_rate)
        possible = swing.ellipse.major + swing.swing_error / swing.frequency
        there = self.hanging.swing_amplitude_at(possible, length, self.length_setpoint)
        calm = (p.largest_swing - there) / ((1.0 - _CALM_FRACTION) * p.largest_swing)
        return rate - max(rate - slow, 0.0) * (1.0 - min(max(calm, 0.0), 1.0))

    def _begin(self, swing: SwingEstimate, length: float, now: float) -> None:
        """Begin the next stop, or wait until the swing is known well enough to judge it."""
        depth = self.stops[0].depth
        reason = self.limits.wall_conflict(swing, length, depth, _CERTAINTY)
        is_certain = self.limits.wall_conflict(swing, length, depth, -_CERTAINTY)
        is_late = now - self._estimating_since > self.parameters.stop_timeout
        if reason and not is_certain and not is_late:
            return
        self.stop = self.stops.popleft()
        self._pictures = self._attempts = 0
        if reason:
            self._end_stop(DescentEvent.STOP_FAILED, reason, length, Reason.OUT_OF_LIMITS)
            return
        self._arrived_at = math.nan
        if math.isnan(self.length_setpoint):
            self.length_setpoint = length
        if self.limits.exceeds(swing, length, self._present):
            self._arrived_at = now
            ellipse = swing.ellipse
            self._enter(
                DescentPhase.DAMPING,
                f"{deg(ellipse.major)} x {deg(ellipse.minor)} exceed the limits of a travel",
                now,
            )
            return
        self._travel(now)

    def _travel(self, now: float) -> None:
        assert self.stop is not None
        self.length_setpoint = self.stop.depth
        self._arrived_at = math.nan
        self._enter(DescentPhase.TRAVELLING, f"to {self.stop.depth:g} m", now)

    @property
    def _is_at_stop(self) -> bool:
        return self.stop is not None and self.length_setpoint == self.stop.depth

    def _damp(self, swing: SwingEstimate, length: float, now: float) -> None:
        p = self.parameters
        self.transfer.step(swing, length, self._present, now - self._arrived_at)
        known = swing.swing_error < p.swing_error_limit
        enough = known and not self.limits.exceeds(swing, length, self._present)
        late = now - self._arrived_at > p.stop_timeout
        if late and not self._is_at_stop:
            self._travel(now)
        elif late:
            self._give_up(self._unsteady(swing, now), length, now)
        elif enough:
            if self._is_at_stop:
                self._enter(DescentPhase.SETTLING, "damped", now)
            else:
                self._travel(now)

    def _settle(self, swing: SwingEstimate, length: float, all_rests: bool, now: float) -> None:
        p = self.parameters
        stop = self.stop
        assert stop is not None
        steady = self._camera.is_below(p.steady_rate) and all_rests
        known = swing.swing_error < p.swing_error_limit
        if stop.observes and known and now - self._phase_since > 0.5 and not steady:
            reason = self.limits.unachievable(swing, length, length, is_at=self._is_at_stop)
            if reason:
                self._give_up(reason, length, now)
                return
        if not stop.observes:
            if not self.limits.exceeds(swing, length, self._present):
                self._end_stop(
                    DescentEvent.STOP_COMPLETED, "depth reached", length, Reason.COMPLETED
                )
                text = f"reached {length:.4g} m"
                self._enter(DescentPhase.STANDBY, text, now, Reason.COMPLETED)
                return
            steady = False
        timeout = max(p.settling_timeout, _SETTLING_PERIODS * math.tau / swing.frequency)
        if not steady:
            self._steady_since = math.nan
        elif math.isnan(self._steady_since):
            self._steady_since = now
        if steady and now - self._steady_since >= p.steady_dwell:
            self._enter(DescentPhase.EXPOSING, f"steady at {length:.4g} m", now)
        elif now - self._arrived_at > p.stop_timeout or (
            self._attempts >= p.settling_attempts and now - self._phase_since > timeout
        ):
            self._give_up(self._unsteady(swing, now), length, now)
        elif (
            all_rests
            and not steady
            and (
                self.limits.exceeds(swing, length, self._present)
                or now - self._phase_since > timeout
            )
        ):
            self._steady_since = math.nan
            self._attempts += now - self._phase_since > timeout
            ellipse = swing.ellipse
            text = f"swings by {deg(ellipse.major)} x {deg(ellipse.minor)}"
            self._enter(DescentPhase.DAMPING, text, now)

    def _expose(self, now: float) -> bool:
        p = self.parameters
        assert self.stop is not None
        if self._has_pictures:
            # The end of the stop may move the rover; wait until the last exposure is over.
            if now - self._last_exposure >= p.exposure_interval:
                self._end_observation()
                self._enter(DescentPhase.STANDBY, "pictures taken", now, Reason.COMPLETED)
            return False
        if not self._camera.is_below(p.steady_rate):
            if (
                now - self._last_exposure > 2.0 * p.exposure_interval
                and now - self._phase_since > 2.0
            ):
                self._steady_since = math.nan
                self._enter(DescentPhase.SETTLING, "unsteady again", now)
            return False
        if now - self._last_exposure < p.exposure_interval:
            return False
        self._last_exposure = now
        self._pictures += 1
        return True

    # --- end of a stop ---------------------------------------------------------------------------

    def _unsteady(self, swing: SwingEstimate, now: float) -> str:
        return (
            f"not steady within {now - self._arrived_at:.0f} s: swing "
            f"{deg(swing.ellipse.major)} x {deg(swing.ellipse.minor)}, camera at "
            f"{math.degrees(swing.camera_rate):.2f} deg/s, its yaw rate known within "
            f"{math.degrees(swing.yaw_error):.2f} deg/s"
        )

    def _give_up(self, reason: str, length: float, now: float) -> None:
        self._end_stop(DescentEvent.STOP_FAILED, reason, length, Reason.TIME_LIMIT)
        self._enter(DescentPhase.STANDBY, "stop given up", now, Reason.TIME_LIMIT)

    @property
    def _has_pictures(self) -> bool:
        """Whether all pictures of the present stop are taken."""
        stop = self.stop
        return stop is not None and stop.observes and self._pictures >= self.parameters.exposures

    def _end_observation(self) -> None:
        assert self.stop is not None
        text = f"{self._pictures} pictures"
        depth = self.stop.depth
        self._end_stop(DescentEvent.STOP_COMPLETED, text, depth, Reason.COMPLETED)

    def _end_stop(self, name: EventName, text: str, length: float, reason: Reason) -> None:
        stop, self.stop = self.stop, None
        assert stop is not None
        values = {"depth": stop.depth, "length": length, "pictures": self._pictures}
        self._changes.append(EventReport(name, text, values, reason))

    def _enter(
        self, phase: DescentPhase, text: str, now: float, reason: Reason | None = None
    ) -> None:
        self.phase = phase
        self._phase_since = now
        if phase is not DescentPhase.DAMPING:
            self.transfer.end()
        self._changes.append(EventReport(_PHASE_EVENTS[phase], text, reason=reason))


def _refused(code: RefusalCode, reason: str) -> Refusal:
    return Refusal(topics.DESCENT_REQUEST, code, reason)
