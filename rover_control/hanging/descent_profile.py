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

from msg_schemas.events import DescentEvent, EventName, EventReport
from msg_schemas.faults import Reason
from msg_schemas.machine import MAX_LENGTH
from msg_schemas.phases import DescentPhase
from msg_schemas.refusal import Refusal, RefusalCode
from rover_control.hanging.descent_parameters import ProfileParameters
from rover_control.hanging.hanging_rover import HangingParameters
from rover_control.hanging.imaging_window import imaging_window, longest_imaging_window
from rover_control.hanging.swing_estimator import SwingEstimate
from rover_control.hanging.yaw_momentum import MomentumTransfer

SUBJECT = "descent"  # of refusals
_RATE_FILTER_TIME = 0.5  # averaging time of the noisy camera rate [s]
_DAMPING_HYSTERESIS = 1.25  # ratio of the limits at which damping begins and ends
_SETTLING_PERIODS = 1.3  # swing periods that a settling may take at least
_TRANSFER_HYSTERESIS = 1.6  # ratio of the rates at which a momentum transfer begins and ends
_CONE_RATE_FRACTION = 0.85  # fraction of the steady rate that a cone may keep
_CALM_FRACTION = 0.7  # of the largest swing, below which an ascent needs no time for the rotors
_PLANE_RATIO = 0.15  # minor over major axis below which a swing is plane
_CERTAINTY = 3.0  # standard deviations of the swing within which it is judged
_ROUND_RATIO = 1.15  # major axis over its circle's radius below which an ellipse is round
_PHASE_EVENTS = {
    DescentPhase.STANDBY: DescentEvent.STANDBY,
    DescentPhase.DAMPING: DescentEvent.DAMPING,
    DescentPhase.TRAVELLING: DescentEvent.TRAVELLING,
    DescentPhase.SETTLING: DescentEvent.SETTLING,
    DescentPhase.EXPOSING: DescentEvent.EXPOSING,
    DescentPhase.HOLDING: DescentEvent.HOLDING,
}


class DescentStop(NamedTuple):
    """A stop of the descent."""

    depth: float  # length at the drum [m]
    observes: bool  # pictures are taken there
    rate: float  # largest payout rate to it [m/s]


class ProfileSetpoints(NamedTuple):
    """Setpoints of the profile."""

    length: float  # of the winch [m]; NaN = unchanged
    rate: float  # largest [m/s]
    trims: bool  # the winch damps the swing
    pumps: bool  # the rotors damp swing and yaw
    quiet: bool  # imaging, now or soon
    transfers: (
        bool  # transfer of a cone's momentum to the mother machine through the twisted tether
    )
    unwinds: bool  # untwisting of the tether after a transfer
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
        self.decay_time = decay_time
        self.phase = DescentPhase.STANDBY
        self.stops: deque[DescentStop] = deque()
        self.stop: DescentStop | None = None  # present stop
        self.length_setpoint = math.nan  # of the winch [m]
        self._phase_since = math.nan  # start of the phase [s]
        self._arrived_at = math.nan  # arrival at the stop [s]
        self._steady_since = math.nan
        self._stepped_at = math.nan  # [s]
        self._mean_square_rate = 0.0  # of the camera [(rad/s)^2]
        self._pictures = 0
        self._attempts = 0
        self._last_exposure = -math.inf
        self._estimating_since = math.nan
        self._transfer = MomentumTransfer(0.0, math.inf, 0.0)
        self._transfers = self._unwinds = False
        self._transfer_time = 0.0  # [s]
        self._holds_swing = False
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
        if not 0.0 < stop.depth <= MAX_LENGTH:
            raise _refused(
                RefusalCode.OUT_OF_LIMITS, f"depth is {stop.depth!r} m, it must be above 0"
            )
        if stop.rate > self.parameters.travel_rate:
            raise _refused(
                RefusalCode.OUT_OF_LIMITS,
                f"rate is {stop.rate!r} m/s, it must be at most "
                f"{self.parameters.travel_rate:g} m/s",
            )
        reason = self._wall_conflict(swing, length, stop.depth, -_CERTAINTY)
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
                SUBJECT,
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
        self._filter_camera_rate(math.hypot(swing.camera_rate, swing.yaw_error), now)
        self._transfer = transfer
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
            self.phase is DescentPhase.DAMPING and self._trims(swing, length),
            self.phase in (DescentPhase.DAMPING, DescentPhase.TRAVELLING),
            self.phase in (DescentPhase.SETTLING, DescentPhase.EXPOSING),
            self._transfers,
            self._unwinds,
            exposes,
        )

    def _filter_camera_rate(self, rate: float, now: float) -> None:
        h = 0.0 if math.isnan(self._stepped_at) else now - self._stepped_at
        self._stepped_at = now
        self._mean_square_rate += min(h / _RATE_FILTER_TIME, 1.0) * (
            rate * rate - self._mean_square_rate
        )

    @property
    def _is_steady(self) -> bool:
        return self._mean_square_rate < self.parameters.steady_rate**2

    def _trims(self, swing: SwingEstimate, length: float) -> bool:
        """Whether the winch damps; a momentum transfer needs some swing for the rotors."""
        if not self._transfers:
            return self._swing_exceeds_limits(swing, length)
        plane = swing.ellipse.major - abs(swing.ellipse.minor)
        most = self.parameters.transfer_swing * (2.0 if self._holds_swing else 1.0)
        self._holds_swing = plane < most
        return not self._holds_swing

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
        reason = self._wall_conflict(swing, length, depth, _CERTAINTY)
        is_certain = self._wall_conflict(swing, length, depth, -_CERTAINTY)
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
        if self._exceeds_limits(swing, length):
            self._arrived_at = now
            ellipse = swing.ellipse
            self._enter(
                DescentPhase.DAMPING,
                f"{_deg(ellipse.major)} x {_deg(ellipse.minor)} exceed the limits of a travel",
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
        transferring = self._transfers
        self._transfer_time = now - self._arrived_at
        self._transfers = self._must_transfer(swing)
        self._unwinds = (
            not self._transfers and (transferring or self._unwinds) and self._is_wound(swing)
        )
        enough = swing.swing_error < p.swing_error_limit and not self._exceeds_limits(swing, length)
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
        steady = self._is_steady and all_rests
        known = swing.swing_error < p.swing_error_limit
        if stop.observes and known and now - self._phase_since > 0.5 and not steady:
            reason = self._unachievable(swing, length, length)
            if reason:
                self._give_up(reason, length, now)
                return
        if not stop.observes:
            if not self._exceeds_limits(swing, length):
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
            and (self._exceeds_limits(swing, length) or now - self._phase_since > timeout)
        ):
            self._steady_since = math.nan
            self._attempts += now - self._phase_since > timeout
            ellipse = swing.ellipse
            text = f"swings by {_deg(ellipse.major)} x {_deg(ellipse.minor)}"
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
        if not self._is_steady:
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

    # --- limits ----------------------------------------------------------------------------------

    def _exceeds_limits(self, swing: SwingEstimate, length: float) -> bool:
        """Whether swing, yaw or twist exceed the limits of the present stop."""
        stop = self.stop
        assert stop is not None
        if self._must_transfer(swing) or self._unwinds or self._swing_exceeds_limits(swing, length):
            return True
        limit = self.parameters.damped_yaw_rate
        # Hysteresis: the rest after damping must not start it again.
        if self.phase is DescentPhase.SETTLING:
            limit *= 2.0
        return stop.observes and self._is_at_stop and abs(swing.yaw_rate) > limit

    def _swing_exceeds_limits(self, swing: SwingEstimate, length: float) -> bool:
        """Whether the swing that the winch can damp exceeds the limits of the present stop."""
        stop = self.stop
        assert stop is not None
        p, ellipse = self.parameters, swing.ellipse
        there = self.hanging.swing_amplitude_at(ellipse.major, length, stop.depth)
        going_up = not self._is_at_stop and stop.depth < length
        if going_up:
            # Damping works best on a short tether; only the amplified plane swing counts.
            plane = self.hanging.swing_amplitude_at(
                ellipse.major - abs(ellipse.minor), length, stop.depth
            )
            return plane > p.largest_swing
        if not stop.observes:
            return self._is_at_stop and there > 0.5 * p.largest_swing
        quick = self.decay_time(length) < p.quick_damping_time
        if self._unachievable(swing, length, stop.depth) and (self._is_at_stop or not quick):
            return False
        w = self.hanging.swing_frequency(stop.depth)
        if quick and not self._is_at_stop:
            return there * w > max(
                p.damped_swing_rate, _ROUND_RATIO * self._residual_rate(stop.depth)
            )
        minor = self.hanging.swing_amplitude_at(ellipse.minor, length, stop.depth)
        # The winch cannot improve a round ellipse any further.
        is_round = ellipse.major < _ROUND_RATIO * math.sqrt(ellipse.major * abs(ellipse.minor))
        limit = p.steady_rate if is_round else p.damped_swing_rate
        span = imaging_window(there, minor, w, limit)
        settling = self.phase is DescentPhase.SETTLING
        return span < self._imaging_time / (_DAMPING_HYSTERESIS if settling else 1.0)

    @property
    def _imaging_time(self) -> float:
        """Steady time [s] that a stop's pictures need."""
        p = self.parameters
        return p.steady_dwell + (p.exposures + 1) * p.exposure_interval

    def _unachievable(self, swing: SwingEstimate, length: float, depth: float) -> str:
        """Why damping cannot give an imaging window at a depth; empty if it can."""
        p, w = self.parameters, self.hanging.swing_frequency(depth)
        # After a disturbance the ellipse is uncertain; damp what may be plane.
        known = max(abs(swing.ellipse.minor) - 2.0 * swing.swing_error / swing.frequency, 0.0)
        major, minor = (
            self.hanging.swing_amplitude_at(each, length, depth)
            for each in (swing.ellipse.major, known)
        )
        is_transferable = self._is_at_stop and self._transfer.time <= p.max_transfer_time
        if (
            is_transferable
            or longest_imaging_window(major, minor, w, p.steady_rate) >= self._imaging_time
        ):
            return ""
        rate = math.degrees(math.sqrt(major * minor) * w)
        return (
            f"a cone of {_deg(major)} x {_deg(minor)} turns the camera by {rate:.2f} deg/s once "
            "it is round; its momentum about the plumb line cannot be damped here"
        )

    def _residual_rate(self, depth: float) -> float:
        """Camera rate [rad/s] at a depth after damping: w a of the circle with the same momentum.

        The momentum of a circle is m (l + d)^2 w a^2.
        """
        w, inertia = self.hanging.swing_frequency(depth), self.hanging.pendulum_inertia(depth)
        return math.sqrt(abs(self._transfer.momentum) * w / inertia)

    def _must_transfer(self, swing: SwingEstimate) -> bool:
        """Whether a cone's momentum must, and can, be transferred to the mother machine here."""
        stop, p = self.stop, self.parameters
        assert stop is not None
        if self._transfer.time > p.max_transfer_time:
            return False
        # A nearly plane swing is damped by the winch; its momentum estimate is uncertain.
        if not self._transfers and abs(swing.ellipse.minor) < _PLANE_RATIO * swing.ellipse.major:
            return False
        limit = p.transfer_threshold_rate
        if not stop.observes:
            limit = 0.25 * p.largest_swing * self.hanging.swing_frequency(stop.depth)
            if not self._is_at_stop:
                return False
        # Relax the limit with time: the estimates of momentum and twist have errors.
        limit *= (
            1.0
            + max(self._transfer_time - p.transfer_relaxation_time, 0.0)
            / p.transfer_relaxation_time
        )
        # Hysteresis: the rest after a transfer is of the size of the estimation errors.
        limit *= 1.0 if self._transfers else _TRANSFER_HYSTERESIS
        if stop.observes:
            limit = min(limit, _CONE_RATE_FRACTION * p.steady_rate)
        return self._residual_rate(stop.depth) > limit

    def _is_wound(self, swing: SwingEstimate) -> bool:
        """Whether the tether is twisted so far that it would spin the rover."""
        p = self.parameters
        return (
            abs(self._transfer.twist_acceleration) > p.unwound_acceleration
            or abs(swing.yaw_rate) > p.unwound_yaw_rate
        )

    def _wall_conflict(
        self, swing: SwingEstimate, length: float, depth: float, deviations: float
    ) -> str:
        """Why the rover could touch the wall on the way to a depth; empty if it cannot.

        Args:
            swing: estimate of the swing.
            length: payout [m].
            depth: of the stop [m].
            deviations: standard deviations by which the swing is larger than estimated.
        """
        p = self.parameters
        error = deviations * swing.swing_error / swing.frequency
        most = max(swing.ellipse.major + error, 0.0)
        there = self.hanging.swing_amplitude_at(most, length, depth)
        reach = max(most * length, there * depth) + p.rover_reach
        if reach < p.wall_clearance:
            return ""
        return (
            f"a swing of {_deg(swing.ellipse.major)}, known within {_deg(abs(error))}, takes the "
            f"rover {reach:.3g} m from the plumb line, the wall is at {p.wall_clearance:g} m"
        )

    def _unsteady(self, swing: SwingEstimate, now: float) -> str:
        return (
            f"not steady within {now - self._arrived_at:.0f} s: swing "
            f"{_deg(swing.ellipse.major)} x {_deg(swing.ellipse.minor)}, camera at "
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
            self._transfers = self._unwinds = False
            self._transfer_time = 0.0
        self._changes.append(EventReport(_PHASE_EVENTS[phase], text, reason=reason))


def _deg(angle: float) -> str:
    return f"{math.degrees(angle):.2f} deg"


def _refused(code: RefusalCode, reason: str) -> Refusal:
    return Refusal(SUBJECT, code, reason)
