"""Sequence of a descent or ascent with its stops. Pure; stepped without ROS.

=============  ==================================================================================
standby        hangs where it is; waits for a request
damping        takes the swing away: before a travel that would make too much of it, or at a stop
travelling     on the way to the next depth
settling       winch at rest, pumping stopped; waits until the camera is steady, or damps again
exposing       takes the stop's pictures, each while the camera is steady
holding        stands still, as asked; `resume` goes on with what is left
=============  ==================================================================================

Every stop ends with its pictures or with the reason why there are none.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from enum import StrEnum
from typing import NamedTuple

from msg_schemas.machine import MAX_LENGTH
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import Level
from msg_schemas.transition import Transition
from rover_control.descent_parameters import ProfileParameters
from rover_control.hanging_rover import HangingParameters
from rover_control.stillness import best_span, still_span
from rover_control.swing_estimator import SwingEstimate
from rover_control.yaw_momentum import Handing

SUBJECT = "descent"  # of refusals
_FELT_TIME = 0.5  # over which the camera's rate is judged, as its estimate is noisy [s]
_BEGIN = 1.25  # damping begins where this much above where it ends
_PERIODS = 1.3  # of the swing that a settling may take at least
_AGAIN = 1.6  # over the rate at which handing on ends, where it begins
_BORNE = 0.85  # of the steady rate, that a cone may take along
_PLANE = 0.15  # minor over major axis, below which a swing counts as plane
_ROUND = 1.15  # an ellipse whose major axis is this much above its circle's is round enough


class DescentPhase(StrEnum):
    """What the descent is doing; the words of the contract."""

    STANDBY = "standby"
    DAMPING = "damping"
    TRAVELLING = "travelling"
    SETTLING = "settling"
    EXPOSING = "exposing"
    HOLDING = "holding"


class Stop(NamedTuple):
    """One depth to go to."""

    depth: float  # length at the drum [m]
    observes: bool  # takes pictures there
    rate: float  # largest payout rate on the way [m/s]


class Wish(NamedTuple):
    """What the profile wants done now."""

    length: float  # that the winch is to go to or keep [m]; NaN = as it is
    rate: float  # at most [m/s]
    trims: bool  # the winch against the swing
    pumps: bool  # the wheels against swing and yaw
    quiet: bool  # for pictures, now or soon
    hands_on: bool  # the momentum of a cone to the mother, through the twisted tether
    unwinds: bool  # the tether, that was twisted for that
    exposes: bool  # a picture now


class DescentProfile:
    """A descent.

    Args:
        parameters: rates, limits, patience.
        hanging: the rover.
        decay_time: in which damping takes a plane swing away, by the length [m], in s.
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
        self.stops: deque[Stop] = deque()
        self._stop: Stop | None = None  # the one that is travelled to or worked at
        self.keeps = math.nan  # length that the winch is to go to or keep [m]
        self._since = math.nan  # in the phase [s]
        self._arrived = math.nan  # at the stop [s]
        self._steady_since = math.nan
        self._stepped = math.nan  # [s]
        self._felt = 0.0  # mean square of the camera's rate [(rad/s)^2]
        self._taken = 0
        self._trials = 0
        self._last_exposure = -math.inf
        self._known_since = math.nan
        self._handing = Handing(0.0, math.inf, 0.0)
        self._hands_on = self._unwinds = False
        self._handed_for = 0.0  # [s]
        self._keeps_swing = False
        self._changes: list[Transition] = []

    def look_again(self) -> None:
        """The swing is not known any more: it is to be learnt before anything is done."""
        self._known_since = math.nan

    def take_changes(self) -> list[Transition]:
        """Return what changed since the last call, and forget it."""
        taken, self._changes = self._changes, []
        return taken

    @property
    def is_idle(self) -> bool:
        """Whether nothing is left to be done."""
        return self.phase is DescentPhase.STANDBY and not self.stops

    # --- asked from outside ----------------------------------------------------------------------

    def request(self, stop: Stop, swing: SwingEstimate | None, length: float) -> None:
        """Add a stop to what is to be done.

        Raises:
            Refusal: held, the swing is not known yet, too fast, or the rover could touch the wall.
        """
        if self.phase is DescentPhase.HOLDING:
            raise _refused(
                RefusalCode.WRONG_PHASE, "the descent is held; it goes on when it is resumed"
            )
        if swing is None:
            raise _refused(
                RefusalCode.STALE, "the swing is not known: IMU or winch have not been heard"
            )
        if not 0.0 < stop.depth <= MAX_LENGTH:
            raise _refused(
                RefusalCode.OUT_OF_LIMITS, f"depth is {stop.depth!r} m, it must be above 0"
            )
        if stop.rate > self.parameters.travel_rate:
            raise _refused(
                RefusalCode.OUT_OF_LIMITS,
                f"rate is {stop.rate!r} m/s, it must be at most {self.parameters.travel_rate:g}",
            )
        why = self._touches(swing, length, stop.depth)
        if why:
            raise _refused(RefusalCode.OUT_OF_LIMITS, why)
        rate = stop.rate if stop.rate > 0.0 else self.parameters.travel_rate
        self.stops.append(stop._replace(rate=rate))

    def hold(self, length: float, now: float) -> str:
        """Stand still where it is [m]."""
        if self.phase is not DescentPhase.HOLDING:
            self.keeps = length
            self._enter(DescentPhase.HOLDING, f"asked to hold, at {length:.4g} m", now)
        return f"holding {self.keeps:.4g} m"

    def resume(self, now: float) -> str:
        """Go on after a hold.

        Raises:
            Refusal: nothing is held.
        """
        if self.phase is not DescentPhase.HOLDING:
            raise Refusal(
                SUBJECT,
                RefusalCode.WRONG_PHASE,
                f"the descent is in {self.phase}, only a hold is resumed",
            )
        if self._has_pictures:
            self._end_observation()
        elif self._stop is not None:
            self.stops.appendleft(self._stop)
            self._stop = None
        self._enter(DescentPhase.STANDBY, "resumed", now)
        return f"{len(self.stops)} stops are left"

    def abort(self, length: float, now: float) -> str:
        """Forget what was to be done, and stay where it is [m]."""
        if self._has_pictures:
            self._end_observation()
        dropped = len(self.stops) + (self._stop is not None)
        self.stops.clear()
        if self._stop is not None:
            self._end_stop("aborted", Level.WARN, length)
        self.keeps = length
        if self.phase is not DescentPhase.STANDBY:
            self._enter(DescentPhase.STANDBY, "aborted", now, Level.WARN)
        return f"{dropped} stops are dropped"

    # --- stepped by time -------------------------------------------------------------------------

    def step(
        self,
        swing: SwingEstimate,
        length: float,
        *,
        handing: Handing,
        winch_rests: bool,
        rotors_rest: bool,
        now: float,
    ) -> Wish:
        """Advance to now [s]; returns what is wanted.

        Args:
            swing: as estimated.
            length: paid out [m].
            handing: what it would take to rid the rover of its momentum about the plumb line.
            winch_rests: the winch stands with its brake closed.
            rotors_rest: the wheels do not turn for the pumping any more.
            now: [s].
        """
        p = self.parameters
        if math.isnan(self._known_since):
            self._known_since = now
        if math.isnan(self._since):
            self._since = now
        exposes = False
        self._feel(swing.camera_rate, now)
        self._handing = handing
        if self.phase is DescentPhase.STANDBY:
            if self.stops and now - self._known_since >= p.estimator_settling_time:
                self._begin(swing, length, now)
        elif self.phase is DescentPhase.DAMPING:
            self._damp(swing, length, now)
        elif self.phase is DescentPhase.TRAVELLING:
            assert self._stop is not None
            if abs(length - self._stop.depth) < p.depth_tolerance and winch_rests:
                self._arrived = now
                self._enter(DescentPhase.SETTLING, f"at {length:.4g} m", now)
        elif self.phase is DescentPhase.SETTLING:
            self._settle(swing, length, winch_rests and rotors_rest, now)
        elif self.phase is DescentPhase.EXPOSING:
            exposes = self._expose(now)
        return Wish(
            self.keeps,
            self._rate(length),
            self.phase is DescentPhase.DAMPING and self._trims(swing, length),
            self.phase in (DescentPhase.DAMPING, DescentPhase.TRAVELLING),
            self.phase in (DescentPhase.SETTLING, DescentPhase.EXPOSING),
            self._hands_on,
            self._unwinds,
            exposes,
        )

    def _feel(self, rate: float, now: float) -> None:
        h = 0.0 if math.isnan(self._stepped) else now - self._stepped
        self._stepped = now
        self._felt += min(h / _FELT_TIME, 1.0) * (rate * rate - self._felt)

    @property
    def _is_steady(self) -> bool:
        return self._felt < self.parameters.steady_rate**2

    def _trims(self, swing: SwingEstimate, length: float) -> bool:
        """Whether the winch damps; rotors that hand a momentum on need swing to push against."""
        if not self._hands_on:
            return self._swings(swing, length)
        plane = swing.ellipse.major - abs(swing.ellipse.minor)
        most = self.parameters.transfer_swing * (2.0 if self._keeps_swing else 1.0)
        self._keeps_swing = plane < most
        return not self._keeps_swing

    def _rate(self, length: float) -> float:
        p = self.parameters
        rate = p.travel_rate if self._stop is None else self._stop.rate
        if self.keeps < length:
            rate = min(rate, max(p.ascent_rate_gain * length, p.min_ascent_rate))
        return rate

    def _begin(self, swing: SwingEstimate, length: float, now: float) -> None:
        self._stop = self.stops.popleft()
        self._taken = self._trials = 0
        why = self._touches(swing, length, self._stop.depth)
        if why:
            self._end_stop(why, Level.WARN, length)
            return
        self._arrived = math.nan
        if math.isnan(self.keeps):
            self.keeps = length
        if self._too_much(swing, length):
            self._arrived = now
            ellipse = swing.ellipse
            self._enter(
                DescentPhase.DAMPING,
                f"{_deg(ellipse.major)} x {_deg(ellipse.minor)} are too much to leave with",
                now,
            )
            return
        self._travel(now)

    def _travel(self, now: float) -> None:
        assert self._stop is not None
        self.keeps = self._stop.depth
        self._arrived = math.nan
        self._enter(DescentPhase.TRAVELLING, f"to {self._stop.depth:g} m", now)

    @property
    def _is_there(self) -> bool:
        return self._stop is not None and self.keeps == self._stop.depth

    def _damp(self, swing: SwingEstimate, length: float, now: float) -> None:
        p = self.parameters
        handed = self._hands_on
        self._handed_for = now - self._arrived
        self._hands_on = self._must_hand_on(swing)
        self._unwinds = not self._hands_on and (handed or self._unwinds) and self._is_wound(swing)
        enough = swing.swing_error < p.swing_error_limit and not self._too_much(swing, length)
        late = now - self._arrived > p.stop_timeout
        if late and not self._is_there:
            self._travel(now)
        elif late:
            self._give_up(self._unsteady(swing, now), length, now)
        elif enough:
            if self._is_there:
                self._enter(DescentPhase.SETTLING, "damped", now)
            else:
                self._travel(now)

    def _settle(self, swing: SwingEstimate, length: float, all_rests: bool, now: float) -> None:
        p = self.parameters
        stop = self._stop
        assert stop is not None
        steady = self._is_steady and all_rests
        known = swing.swing_error < p.swing_error_limit
        if stop.observes and known and now - self._since > 0.5 and not steady:
            why = self._hopeless(swing, length, length)
            if why:
                self._give_up(why, length, now)
                return
        if not stop.observes:
            if not self._too_much(swing, length):
                self._end_stop("reached", Level.OK, length)
                self._enter(DescentPhase.STANDBY, f"reached {length:.4g} m", now)
                return
            steady = False
        patience = max(p.settling_timeout, _PERIODS * math.tau / swing.frequency)
        if not steady:
            self._steady_since = math.nan
        elif math.isnan(self._steady_since):
            self._steady_since = now
        if steady and now - self._steady_since >= p.steady_dwell:
            self._enter(DescentPhase.EXPOSING, f"steady at {length:.4g} m", now)
        elif now - self._arrived > p.stop_timeout or (
            self._trials >= p.settling_attempts and now - self._since > patience
        ):
            self._give_up(self._unsteady(swing, now), length, now)
        elif (
            all_rests
            and not steady
            and (self._too_much(swing, length) or now - self._since > patience)
        ):
            self._steady_since = math.nan
            self._trials += now - self._since > patience
            ellipse = swing.ellipse
            text = f"swings by {_deg(ellipse.major)} x {_deg(ellipse.minor)}"
            self._enter(DescentPhase.DAMPING, text, now)

    def _expose(self, now: float) -> bool:
        p = self.parameters
        assert self._stop is not None
        if self._has_pictures:
            # The last one may still be exposed: who hears of the end may move the rover.
            if now - self._last_exposure >= p.exposure_interval:
                self._end_observation()
                self._enter(DescentPhase.STANDBY, "pictures taken", now)
            return False
        if not self._is_steady:
            if now - self._last_exposure > 2.0 * p.exposure_interval and now - self._since > 2.0:
                self._steady_since = math.nan
                self._enter(DescentPhase.SETTLING, "unsteady again", now)
            return False
        if now - self._last_exposure < p.exposure_interval:
            return False
        self._last_exposure = now
        self._taken += 1
        return True

    # --- judgement -------------------------------------------------------------------------------

    def _too_much(self, swing: SwingEstimate, length: float) -> bool:
        """Whether there is more swing than the stop that is meant bears."""
        stop = self._stop
        assert stop is not None
        if self._must_hand_on(swing) or self._unwinds or self._swings(swing, length):
            return True
        limit = self.parameters.damped_yaw_rate
        # What damping leaves must not begin it again at once.
        if self.phase is DescentPhase.SETTLING:
            limit *= 2.0
        return stop.observes and self._is_there and abs(swing.yaw_rate) > limit

    def _swings(self, swing: SwingEstimate, length: float) -> bool:
        """Whether there is more for the winch to damp than the stop that is meant bears."""
        stop = self._stop
        assert stop is not None
        p, ellipse = self.parameters, swing.ellipse
        there = self.hanging.grown(ellipse.major, length, stop.depth)
        going_up = not self._is_there and stop.depth < length
        if going_up:
            # Damping works best where the tether is short; only what a plane swing becomes counts.
            plane = self.hanging.grown(ellipse.major - abs(ellipse.minor), length, stop.depth)
            return plane > p.largest_swing
        if not stop.observes:
            return self._is_there and there > 0.5 * p.largest_swing
        quick = self.decay_time(length) < p.quick_damping_time
        if self._hopeless(swing, length, stop.depth) and (self._is_there or not quick):
            return False
        w = self.hanging.swing_frequency(stop.depth)
        if quick and not self._is_there:
            return there * w > max(p.damped_swing_rate, _ROUND * self._circle_rate(stop.depth))
        minor = self.hanging.grown(ellipse.minor, length, stop.depth)
        # What the winch can make no rounder is steady enough, or hopeless.
        is_round = ellipse.major < _ROUND * math.sqrt(ellipse.major * abs(ellipse.minor))
        limit = p.steady_rate if is_round else p.damped_swing_rate
        span = still_span(there, minor, w, limit)
        settling = self.phase is DescentPhase.SETTLING
        return span < self._needed / (_BEGIN if settling else 1.0)

    @property
    def _needed(self) -> float:
        """Time [s] that the rover must be still for a stop's pictures."""
        p = self.parameters
        return p.steady_dwell + (p.exposures + 1) * p.exposure_interval

    def _hopeless(self, swing: SwingEstimate, length: float, depth: float) -> str:
        """Why no damping makes the rover still enough for pictures at a depth, if so."""
        p, w = self.parameters, self.hanging.swing_frequency(depth)
        # Just after a push the ellipse is not known well; what may be plane is to be damped.
        known = max(abs(swing.ellipse.minor) - 2.0 * swing.swing_error / swing.frequency, 0.0)
        major, minor = (
            self.hanging.grown(each, length, depth) for each in (swing.ellipse.major, known)
        )
        passed_on = self._is_there and self._handing.time <= p.max_transfer_time
        if passed_on or best_span(major, minor, w, p.steady_rate) >= self._needed:
            return ""
        rate = math.degrees(math.sqrt(major * minor) * w)
        return (
            f"a cone of {_deg(major)} x {_deg(minor)} turns the camera, by {rate:.2f} deg/s when "
            "it is round, and its momentum about the plumb line cannot be damped"
        )

    def _circle_rate(self, depth: float) -> float:
        """Rate [rad/s] that is left at a depth when all but the momentum is damped.

        Of the circle that has the momentum m (l + d)^2 w a^2.
        """
        w, inertia = self.hanging.swing_frequency(depth), self.hanging.reach_inertia(depth)
        return math.sqrt(abs(self._handing.momentum) * w / inertia)

    def _must_hand_on(self, swing: SwingEstimate) -> bool:
        """Whether a cone's momentum is to be handed to the mother here, and can be."""
        stop, p = self._stop, self.parameters
        assert stop is not None
        if self._handing.time > p.max_transfer_time:
            return False
        # What is all but plane is the winch's; its momentum is not known well enough either.
        if not self._hands_on and abs(swing.ellipse.minor) < _PLANE * swing.ellipse.major:
            return False
        limit = p.transfer_threshold_rate
        if not stop.observes:
            limit = 0.25 * p.largest_swing * self.hanging.swing_frequency(stop.depth)
            if not self._is_there:
                return False
        # The longer it takes the less is to be had: estimates of momentum and twist are off, too.
        limit *= (
            1.0
            + max(self._handed_for - p.transfer_relaxation_time, 0.0) / p.transfer_relaxation_time
        )
        # Once is enough: what is left then is near what its estimate and the twist's are off.
        limit *= 1.0 if self._hands_on else _AGAIN
        if stop.observes:
            limit = min(limit, _BORNE * p.steady_rate)
        return self._circle_rate(stop.depth) > limit

    def _is_wound(self, swing: SwingEstimate) -> bool:
        """Whether the tether's twist would spin the rover, or it still turns by it."""
        p = self.parameters
        return (
            abs(self._handing.pull) > p.unwound_acceleration
            or abs(swing.yaw_rate) > p.unwound_yaw_rate
        )

    def _touches(self, swing: SwingEstimate, length: float, depth: float) -> str:
        p = self.parameters
        there = self.hanging.grown(swing.ellipse.major, length, depth)
        reach = max(swing.ellipse.major * length, there * depth) + p.rover_reach
        if reach < p.wall_clearance:
            return ""
        return (
            f"swinging by {_deg(swing.ellipse.major)} the rover reaches {reach:.3g} m from the "
            f"plumb line, the wall is {p.wall_clearance:g} m away"
        )

    def _unsteady(self, swing: SwingEstimate, now: float) -> str:
        return (
            f"not steady within {now - self._arrived:.0f} s: still "
            f"{_deg(swing.ellipse.major)} x {_deg(swing.ellipse.minor)}, camera at "
            f"{math.degrees(swing.camera_rate):.2f} deg/s"
        )

    def _give_up(self, reason: str, length: float, now: float) -> None:
        self._end_stop(reason, Level.WARN, length)
        self._enter(DescentPhase.STANDBY, "given up", now, Level.WARN)

    @property
    def _has_pictures(self) -> bool:
        """Whether all pictures of the present stop are taken."""
        stop = self._stop
        return stop is not None and stop.observes and self._taken >= self.parameters.exposures

    def _end_observation(self) -> None:
        assert self._stop is not None
        self._end_stop(f"{self._taken} pictures", Level.OK, self._stop.depth)

    def _end_stop(self, reason: str, level: Level, length: float) -> None:
        stop, self._stop = self._stop, None
        assert stop is not None
        values = {"depth": stop.depth, "length": length, "pictures": self._taken}
        self._changes.append(Transition("stop_ended", reason, level, values))

    def _enter(self, phase: DescentPhase, reason: str, now: float, level: Level = Level.OK) -> None:
        self.phase = phase
        self._since = now
        if phase is not DescentPhase.DAMPING:
            self._hands_on = self._unwinds = False
            self._handed_for = 0.0
        self._changes.append(Transition(f"descent_{phase}", reason, level))


def _deg(angle: float) -> str:
    return f"{math.degrees(angle):.2f} deg"


def _refused(code: RefusalCode, reason: str) -> Refusal:
    return Refusal(SUBJECT, code, reason)
