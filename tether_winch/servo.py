"""Servo of the winch: cascade of length, rate and tension control, and the brake. Pure.

The drive runs a rate loop with a tension feed-forward and a tension limit. Outer loops:

length    follows an S-curve; commands its rate plus a gain times the length error
rate      follows an S-curve in rate and, against drift, in length
tension   commands motor torque, corrected by the tension error, between two rate limits: the drum
          yields as fast as its inertia allows, which no rate loop does on a stiff tether

The commanded motion is continuous: a change of goal starts from the present rate and acceleration.
Where the drum lags because the motor is at its limit, the S-curve waits for it, without windup.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum, auto
from typing import NamedTuple

from msg_schemas import machine
from msg_schemas.parameters import ParameterError, parameter
from tether_winch.drum_model import DrumModel
from tether_winch.profile import MotionLimits, ProfilePoint, toward_length, toward_rate

_AT_LIMIT = 0.5  # fraction of a rate limit above which a tension hold may run at it
_TENSION_FILTER_TIME = 0.03  # time constant of the low-pass on the tension's derivative [s]


@dataclass(frozen=True)
class ServoParameters:
    """Motion: limits of the S-curve, gains, ends of the tether, trim."""

    largest_rate: float = parameter(
        0.35, "m/s", "largest payout rate of any request", 0.01, machine.MAX_PAYOUT_RATE
    )
    acceleration: float = parameter(0.3, "m/s^2", "acceleration limit of the S-curve", 0.01, 5.0)
    jerk: float = parameter(1.0, "m/s^3", "jerk limit of the S-curve", 0.05, 100.0)
    quick_stop_acceleration: float = parameter(
        0.6, "m/s^2", "acceleration limit of a quick stop: touchdown, snag, timeout", 0.01, 10.0
    )
    quick_stop_jerk: float = parameter(6.0, "m/s^3", "jerk limit of a quick stop", 0.05, 1000.0)
    length_gain: float = parameter(2.0, "1/s", "gain from length error to payout rate", 0.0, 20.0)
    length_tolerance: float = parameter(
        0.002, "m", "length error within which a length is reached", 1e-4, 0.1
    )
    following_error_limit: float = parameter(
        0.04, "m", "lead of the S-curve over the drum beyond which it waits", 1e-3, 1.0
    )
    tension_gain: float = parameter(
        1.0, "-", "fraction of the tension error that the motor adds to its pull", 0.0, 10.0
    )
    tension_damping_ratio: float = parameter(
        0.45, "-", "damping ratio of the drum on the tether's stiffness in a tension hold", 0.0, 1.0
    )
    friction_lead_gain: float = parameter(
        0.02, "m/s/N", "rate per tension error by which the friction compensation leads", 0.0, 1.0
    )
    relief_acceleration: float = parameter(
        3.0, "m/s^2", "deceleration of a slack take-up when the tether comes taut", 0.01, 20.0
    )
    shortest_length: float = parameter(2.0, "m", "hard end, reeled in", 0.0, machine.MAX_LENGTH)
    longest_length: float = parameter(58.0, "m", "hard end, paid out", 0.1, machine.MAX_LENGTH)
    soft_margin: float = parameter(
        0.2, "m", "distance of the soft ends from the hard ends; no motion leads beyond", 0.0, 50.0
    )
    end_zone: float = parameter(
        1.0,
        "m",
        "distance before a soft end within which the rate is limited to end_rate",
        0.0,
        50.0,
    )
    end_rate: float = parameter(
        0.1, "m/s", "largest rate at a soft end", 1e-3, machine.MAX_PAYOUT_RATE
    )
    tension_limit: float = parameter(
        40.0, "N", "largest tension of the motor where a request gives none",
        machine.SMALLEST_LIMIT, machine.MAX_TENSION,
    )  # fmt: skip
    feed_forward_slew: float = parameter(
        150.0, "N/s", "slew rate limit of the tension feed-forward", 1.0, 1e5
    )
    load_filter_time: float = parameter(
        0.5, "s", "time constant of the low-pass on the load that is fed forward", 0.01, 10.0
    )
    idle_time: float = parameter(0.5, "s", "time at rest after which the brake closes", 0.05, 60.0)
    trim_rate: float = parameter(0.1, "m/s", "largest rate of a trim", 0.0, 0.5)
    trim_length: float = parameter(1.5, "m", "largest length that a trim adds", 0.0, 20.0)
    trim_acceleration: float = parameter(0.3, "m/s^2", "acceleration limit of the trim", 0.01, 5.0)

    def __post_init__(self) -> None:
        """Refuse ends that leave no range, and a quick stop softer than the S-curve.

        Raises:
            ParameterError: two parameters contradict each other.
        """
        if self.shortest_length + self.soft_margin >= self.longest_length - self.soft_margin:
            msg = (
                f"shortest_length is {self.shortest_length:g} m and longest_length "
                f"{self.longest_length:g} m: a soft_margin of {self.soft_margin:g} m leaves no "
                "range between them"
            )
            raise ParameterError(msg)
        if self.quick_stop_acceleration < self.acceleration or self.quick_stop_jerk < self.jerk:
            msg = (
                f"quick_stop_acceleration {self.quick_stop_acceleration:g} and quick_stop_jerk "
                f"{self.quick_stop_jerk:g} must not be below acceleration {self.acceleration:g} "
                f"and jerk {self.jerk:g}"
            )
            raise ParameterError(msg)


class GoalKind(Enum):
    """Controlled quantity."""

    REST = auto()
    LENGTH = auto()
    RATE = auto()
    TENSION = auto()


@dataclass(frozen=True)
class ServoGoal:
    """Goal of the servo.

    Attributes:
        kind: controlled quantity; REST comes to rest and closes the brake.
        length: setpoint, or longest payout of a tension hold [m].
        rate: setpoint, or largest rate [m/s].
        tension: setpoint at the fairlead [N].
        limit: tension limit of the motor [N].
        reels_in: whether reeling in is allowed.
        pays_out: whether paying out is allowed.
        quick: come to rest with the quick-stop limits.
    """

    kind: GoalKind
    length: float = math.inf
    rate: float = 0.0
    tension: float = 0.0
    limit: float = math.inf
    reels_in: bool = True
    pays_out: bool = True
    quick: bool = False


REST = ServoGoal(GoalKind.REST)


class SensedState(NamedTuple):
    """Estimates of one instant."""

    length: float  # payout [m]
    rate: float  # payout rate [m/s]
    tension: float  # at the fairlead [N]; NaN = unknown
    load: float  # mean load [N]; used while the tension is unknown
    carried: float  # motor tension from its current [N]
    brake_is_open: bool


class ServoCommand(NamedTuple):
    """Command to the drive."""

    length: float  # setpoint [m]
    rate: float  # payout rate [m/s]
    feed_forward: float  # motor tension [N]
    release_brake: bool
    limit: float  # tension limit of the motor [N]


class _TensionHold(NamedTuple):
    """Torque-controlled tension hold between two rate limits."""

    tension: float  # motor tension [N]; below 0 it pays out
    low: float  # [m/s]
    high: float
    side: int  # 1 = the drum runs at the high limit, -1 = at the low one, 0 = between them


class BrakePhase(Enum):
    """Transfer of the load between brake and motor."""

    CLOSED = auto()
    LOADING = auto()  # the motor takes over the load behind the closed brake
    OPENING = auto()
    OPEN = auto()
    CLOSING = auto()
    UNLOADING = auto()  # the motor hands the load to the brake


class WinchServo:
    """Follows goals with one drum.

    Args:
        parameters: limits and gains.
        drum: model of the drum.
    """

    _CLOSED_HOLD = 0.05  # the motor keeps the load for this time after the brake has closed [s]

    def __init__(self, parameters: ServoParameters, drum: DrumModel) -> None:
        self.parameters = parameters
        self.goal = REST
        self.phase = BrakePhase.CLOSED
        self.motion = ProfilePoint(0.0, 0.0, 0.0)
        self.trim_offset = 0.0  # length that the trim has added [m]
        self.feed_forward = 0.0  # [N]
        self.is_lagging = False  # the drum lags so far that the S-curve waits
        self._drum = drum
        self._rate = 0.0  # commanded, trim included [m/s]
        self._trim_setpoint: float | None = None
        self._trim = 0.0  # [m/s]
        self._load = math.nan  # low-passed [N]
        self._filtered_tension, self._tension_rate = math.nan, 0.0  # [N], [N/s]
        self._phase_time = 0.0  # [s]
        self._rest_time = 0.0  # [s]
        self._tension_hold: _TensionHold | None = None  # where a tension is held
        self._rate_side = 0  # of the last tension hold

    @property
    def reference(self) -> ProfilePoint:
        """Reference motion of the drum, trim included."""
        return ProfilePoint(
            self.motion.length + self.trim_offset,
            self.motion.rate + self._trim,
            self.motion.acceleration,
        )

    @property
    def is_at_rest(self) -> bool:
        """Whether the drum stands with the brake closed."""
        return self.phase in (BrakePhase.CLOSED, BrakePhase.UNLOADING)

    @property
    def time_in_phase(self) -> float:
        """Time in the present brake phase [s]."""
        return self._phase_time

    @property
    def tension_setpoint(self) -> float:
        """Tension setpoint, or else the tension feed-forward [N]."""
        holds = self.goal.kind is GoalKind.TENSION
        return self.goal.tension if holds else self.feed_forward

    def retune(self, parameters: ServoParameters, drum: DrumModel) -> None:
        """Apply other limits and gains at once."""
        self.parameters, self._drum = parameters, drum

    def set_goal(self, goal: ServoGoal) -> None:
        """Set a new goal; the motion continues from its present state."""
        self.goal = goal
        self._rest_time = 0.0

    def trim(self, rate: float | None) -> None:
        """Add a rate [m/s] to the goal's, within the trim's limits; None ends the trim."""
        self._trim_setpoint = rate

    def emergency_stop(self, sensed: SensedState) -> ServoCommand:
        """Close the brake with zero torque at once, and drop the goal."""
        self.goal = REST
        self._trim_setpoint = None
        self._enter(BrakePhase.CLOSED)
        self.feed_forward = 0.0
        self._follow_drum(sensed)
        return ServoCommand(self._commanded_length(), 0.0, 0.0, False, machine.SMALLEST_LIMIT)

    def step(self, sensed: SensedState, allowed_tension: float, h: float) -> ServoCommand:
        """Advance by h; returns the command to the drive.

        Args:
            sensed: present estimates.
            allowed_tension: motor tension allowed by the thermal model [N].
            h: duration [s].
        """
        self._phase_time += h
        self._filter_load(sensed, h)
        self._step_brake(sensed)
        if self.phase is BrakePhase.OPEN:
            self._move(sensed, h)
        else:
            self._follow_drum(sensed)
        self._feed_forward(sensed, h)
        limit = min(self.goal.limit, allowed_tension)
        if math.isinf(limit):
            limit = self.parameters.tension_limit
        if self._tension_hold is not None:
            return self._tension_command(self._tension_hold, limit)
        release = self.phase in (BrakePhase.OPENING, BrakePhase.OPEN)
        return ServoCommand(
            self._commanded_length(),
            self._rate,
            min(self.feed_forward, limit),
            release,
            max(limit, machine.SMALLEST_LIMIT),
        )

    # --- brake -----------------------------------------------------------------------------------

    def _step_brake(self, sensed: SensedState) -> None:
        demand = self._has_motion_demand(sensed)
        if self.phase in (BrakePhase.CLOSED, BrakePhase.UNLOADING):
            if demand:
                self._enter(BrakePhase.LOADING)
        elif self.phase is BrakePhase.LOADING:
            if not demand:
                self._enter(BrakePhase.UNLOADING)
            elif abs(self._feed_forward_setpoint(sensed) - self.feed_forward) < 0.5:
                self._enter(BrakePhase.OPENING)
        elif self.phase is BrakePhase.OPENING:
            if sensed.brake_is_open:
                self._enter(BrakePhase.OPEN)
        elif self.phase is BrakePhase.OPEN:
            if not sensed.brake_is_open:  # the drive has closed it
                self._enter(BrakePhase.OPENING if demand else BrakePhase.UNLOADING)
            elif self._is_idle(demand):
                self._enter(BrakePhase.CLOSING)
                # The drive's rate loop stops with the brake: its share continues as feed-forward.
                self.feed_forward = max(sensed.carried, 0.0)
        elif self.phase is BrakePhase.CLOSING:
            if demand:
                self._enter(BrakePhase.OPENING)
            elif not sensed.brake_is_open and self._phase_time > self._CLOSED_HOLD:
                self._enter(BrakePhase.UNLOADING)

    def _is_idle(self, demand: bool) -> bool:
        if demand or self.motion.rate != 0.0 or self._trim != 0.0:
            self._rest_time = 0.0
            return False
        needed = 0.0 if self.goal.kind is GoalKind.REST else self.parameters.idle_time
        return self._rest_time >= needed

    def _enter(self, phase: BrakePhase) -> None:
        if phase is not self.phase:
            self.phase = phase
            self._phase_time = 0.0
            self._rest_time = 0.0

    def _has_motion_demand(self, sensed: SensedState) -> bool:
        goal = self.goal
        if goal.kind is GoalKind.REST:
            return False
        if self._trim_setpoint is not None:
            return True
        if goal.kind is GoalKind.LENGTH:
            at = self.motion.length if self.phase is BrakePhase.OPEN else sensed.length
            distance = self._bounded(goal.length) - at
            if (distance > 0.0 and not goal.pays_out) or (distance < 0.0 and not goal.reels_in):
                return False
            return abs(distance) > self.parameters.length_tolerance
        if goal.kind is GoalKind.RATE:
            low, high = self._soft_ends()
            at = self.motion.length
            blocked = (goal.rate > 0.0 and at >= high) or (goal.rate < 0.0 and at <= low)
            return goal.rate != 0.0 and not blocked
        return goal.reels_in or goal.pays_out

    # --- motion ----------------------------------------------------------------------------------

    def _follow_drum(self, sensed: SensedState) -> None:
        """Set the reference motion to the drum's while the brake holds."""
        self._tension_hold = None
        self.motion = ProfilePoint(sensed.length, 0.0, 0.0)
        self.trim_offset = 0.0
        self._trim = self._rate = 0.0
        self.is_lagging = False

    def _move(self, sensed: SensedState, h: float) -> None:
        p, goal = self.parameters, self.goal
        self._tension_hold = None
        self._step_trim(h)
        if goal.kind is GoalKind.TENSION:
            self._move_by_tension(sensed, h)
        else:
            limits = self._limits()
            after = self._toward_goal(limits, h)
            if (after.rate < 0.0 and not goal.reels_in) or (after.rate > 0.0 and not goal.pays_out):
                after = toward_rate(self.motion, 0.0, limits, h)
            self.motion = self._limit_following_error(after, sensed)
        error = self.reference.length - sensed.length
        correction = p.length_gain * error if goal.kind is not GoalKind.TENSION else 0.0
        rate = self.reference.rate + correction
        largest = min(
            machine.MAX_PAYOUT_RATE, self._drum.largest_rate(sensed.length, self._tension(sensed))
        )
        self._rate = min(max(rate, -largest), largest)
        resting = self.motion.rate == 0.0 and self._trim == 0.0 and abs(sensed.rate) < 0.01
        self._rest_time = self._rest_time + h if resting else 0.0

    def _toward_goal(self, limits: MotionLimits, h: float) -> ProfilePoint:
        """The next point of the S-curve; a rate above the limit comes down to it smoothly."""
        goal, motion, ends = self.goal, self.motion, self._soft_ends()
        wide = replace(limits, rate=max(limits.rate, abs(motion.rate)))
        if goal.kind is not GoalKind.LENGTH:
            rate = goal.rate if goal.kind is GoalKind.RATE else 0.0
            rate = min(max(rate, -limits.rate), limits.rate)
            return toward_rate(motion, rate, wide, h, ends)
        to_stop = toward_length(motion, self._bounded(goal.length), wide, h)
        if wide.rate == limits.rate:
            return to_stop
        side = math.copysign(1.0, motion.rate)
        slower = toward_rate(motion, side * limits.rate, wide, h, ends)
        return min(to_stop, slower, key=lambda after: side * after.rate)

    def _limit_following_error(self, after: ProfilePoint, sensed: SensedState) -> ProfilePoint:
        """Hold the S-curve back where the drum lags behind it."""
        limit = self.parameters.following_error_limit
        lead = after.length + self.trim_offset - sensed.length
        self.is_lagging = abs(lead) > limit and lead * after.rate > 0.0
        if not self.is_lagging:
            return after
        length = sensed.length - self.trim_offset + math.copysign(limit, lead)
        # No faster than the drum, for a soft start when the drum comes free.
        slower = min(abs(after.rate), abs(sensed.rate))
        return ProfilePoint(length, math.copysign(slower, after.rate), 0.0)

    def _move_by_tension(self, sensed: SensedState, h: float) -> None:
        p, goal = self.parameters, self.goal
        limits = self._limits()
        error = 0.0 if math.isnan(sensed.tension) else sensed.tension - goal.tension
        self.is_lagging = False
        low, high = self._rate_range(sensed, limits)
        if goal.pays_out:
            self._hold_tension(sensed, error, low, high)
            return
        # Take up slack at the goal's rate until the tether comes taut, then stop.
        pull = max(goal.tension - self._drum.hanging_weight(sensed.length), 1e-3)
        rate = low * min(max(-error / (0.5 * pull), 0.0), 1.0)
        change = limits.acceleration * h
        # A tether that comes taut on a moving drum needs a faster stop than the S-curve's.
        relief = p.relief_acceleration * h if error > -0.5 * goal.tension else change
        rate = min(max(rate, self.motion.rate - change), self.motion.rate + max(relief, change))
        self.motion = ProfilePoint(sensed.length - self.trim_offset, rate, 0.0)

    def _hold_tension(self, sensed: SensedState, error: float, low: float, high: float) -> None:
        p = self.parameters
        self.motion = ProfilePoint(sensed.length - self.trim_offset, sensed.rate, 0.0)
        # Compensate dry friction in the direction of the tension error, before the drum moves.
        rate = sensed.rate + p.friction_lead_gain * error
        pull = self._drum.motor_tension(self.goal.tension, sensed.length, rate, 0.0)
        pull -= p.tension_gain * error + self._damping_time(sensed.length) * self._tension_rate
        self._rate_side = self._limited_side(sensed.rate, error, low, high)
        self._tension_hold = _TensionHold(pull, low, high, self._rate_side)

    def _damping_time(self, length: float) -> float:
        """Motor tension per rate of the tether's tension [s] that damps the drum.

        A drum of mass m on a tether of stiffness k: m v' = (1 + g) e + c e', e' = -k v, with the
        tension error e and the gain g. A damping ratio z needs c = 2 z sqrt((1 + g) m/k).
        """
        p, drum = self.parameters, self._drum
        ratio = (1.0 + p.tension_gain) * drum.mass(length) / drum.stiffness(length)
        return 2.0 * p.tension_damping_ratio * math.sqrt(ratio)

    def _limited_side(self, rate: float, error: float, low: float, high: float) -> int:
        """Side of the rate limit at which the drum runs, 0 = between the limits.

        It stays there while the tension error drives it beyond. If each reading below the limit
        let it accelerate, it would swing about the limit, as readings and commands are late.
        """
        if not low <= rate <= high:
            return 1 if rate > high else -1
        side = self._rate_side
        limit = high if side > 0 else -low
        return side if side * error > 0.0 and side * rate > _AT_LIMIT * limit else 0

    def _tension_command(self, pull: _TensionHold, limit: float) -> ServoCommand:
        """Convert a tension hold to a drive command.

        Within the rate limits the rate loop saturates at the torque limit and so holds a torque;
        at a rate limit it holds the rate.
        """
        if pull.side == 0:
            rate = pull.low if pull.tension > 0.0 else pull.high
            # The drive applies its limit as for a driving motor.
            most = min(abs(pull.tension) * self._drum.parameters.gear_efficiency, limit)
        else:
            rate, most = pull.high if pull.side > 0 else pull.low, limit
        carried = min(max(pull.tension, 0.0), limit)
        return ServoCommand(
            self._commanded_length(), rate, carried, True, max(most, machine.SMALLEST_LIMIT)
        )

    def _rate_range(self, sensed: SensedState, limits: MotionLimits) -> tuple[float, float]:
        """Rate range of the tension loop, from the goal and a stop before the soft ends."""
        goal = self.goal
        low_end, high_end = self._soft_ends()
        high_end = min(high_end, goal.length)

        def reach(distance: float) -> float:
            return math.sqrt(max(distance, 0.0) * limits.acceleration)

        high = min(limits.rate, reach(high_end - sensed.length)) if goal.pays_out else 0.0
        low = -min(limits.rate, reach(sensed.length - low_end)) if goal.reels_in else 0.0
        return low, high

    def _limits(self) -> MotionLimits:
        p, goal = self.parameters, self.goal
        if goal.quick or goal.kind is GoalKind.REST:
            return MotionLimits(p.largest_rate, p.quick_stop_acceleration, p.quick_stop_jerk)
        named = abs(goal.rate)
        rate = min(named, p.largest_rate) if named > 0.0 else p.largest_rate
        if self._is_near_soft_end():
            rate = min(rate, p.end_rate)
        return MotionLimits(rate, p.acceleration, p.jerk)

    def _is_near_soft_end(self) -> bool:
        """Whether the rate must be at, or slow down to, `end_rate` before a soft end."""
        p, goal, motion = self.parameters, self.goal, self.motion
        low, high = self._soft_ends()
        outward = goal.length - motion.length if goal.kind is GoalKind.LENGTH else goal.rate
        if motion.rate != 0.0:
            outward = motion.rate
        distance = high - motion.length if outward > 0.0 else motion.length - low
        excess = max(abs(motion.rate) - p.end_rate, 0.0)
        # Slow down to end_rate with a jerk ramp at either side.
        time = excess / p.acceleration + p.acceleration / p.jerk
        slowing = time * (p.end_rate + 0.5 * excess) if excess > 0.0 else 0.0
        return distance <= p.end_zone + slowing

    def _step_trim(self, h: float) -> None:
        p = self.parameters
        if self._trim_setpoint is None:
            # The S-curve takes over length and rate that the trim has added: if both slowed down
            # at once, their accelerations would add up and make the load bounce.
            motion = self.motion
            self.motion = motion._replace(
                length=motion.length + self.trim_offset, rate=motion.rate + self._trim
            )
            self.trim_offset = self._trim = 0.0
            return
        setpoint = min(max(self._trim_setpoint, -p.trim_rate), p.trim_rate)
        for side in (1.0, -1.0):
            room = max(p.trim_length - side * self.trim_offset, 0.0)
            end = self._soft_ends()[1 if side > 0.0 else 0]
            room = min(room, max(side * (end - self.reference.length), 0.0))
            most = math.sqrt(2.0 * p.trim_acceleration * room) * 0.7
            setpoint = min(setpoint, most) if side > 0.0 else max(setpoint, -most)
        if (setpoint < 0.0 and not self.goal.reels_in) or (
            setpoint > 0.0 and not self.goal.pays_out
        ):
            setpoint = 0.0
        change = p.trim_acceleration * h
        self._trim = min(max(setpoint, self._trim - change), self._trim + change)
        self.trim_offset += self._trim * h
        self.trim_offset = min(max(self.trim_offset, -p.trim_length), p.trim_length)

    # --- feed-forward ----------------------------------------------------------------------------

    def _filter_load(self, sensed: SensedState, h: float) -> None:
        load = sensed.load
        if not math.isnan(sensed.tension):
            load = sensed.tension - self._drum.hanging_weight(sensed.length)
        if math.isnan(self._load):
            self._load = load
        else:
            self._load += (load - self._load) * -math.expm1(-h / self.parameters.load_filter_time)
        if math.isnan(sensed.tension) or math.isnan(self._filtered_tension):
            self._filtered_tension, self._tension_rate = sensed.tension, 0.0
        else:
            change = sensed.tension - self._filtered_tension
            self._tension_rate = change / (_TENSION_FILTER_TIME + h)
            self._filtered_tension += self._tension_rate * h

    def _tension(self, sensed: SensedState) -> float:
        return max(self._load, 0.0) + self._drum.hanging_weight(sensed.length)

    def _feed_forward_setpoint(self, sensed: SensedState) -> float:
        if self.phase in (BrakePhase.CLOSED, BrakePhase.UNLOADING):
            return 0.0
        if self.phase is BrakePhase.CLOSING:
            return self.feed_forward
        rate, acceleration = self.reference.rate, self.motion.acceleration
        setpoint = self._drum.motor_tension(
            self._tension(sensed), sensed.length, rate, acceleration
        )
        return max(setpoint, 0.0)

    def _feed_forward(self, sensed: SensedState, h: float) -> None:
        setpoint = self._feed_forward_setpoint(sensed)
        change = self.parameters.feed_forward_slew * h
        self.feed_forward = min(
            max(setpoint, self.feed_forward - change), self.feed_forward + change
        )

    # --- ends ------------------------------------------------------------------------------------

    def _soft_ends(self) -> tuple[float, float]:
        p = self.parameters
        return p.shortest_length + p.soft_margin, p.longest_length - p.soft_margin

    def _bounded(self, length: float) -> float:
        low, high = self._soft_ends()
        return min(max(length, low), high)

    def _commanded_length(self) -> float:
        return min(max(self.reference.length, 0.0), machine.MAX_LENGTH)


def quick_stop(goal: ServoGoal) -> ServoGoal:
    """Goal of a quick stop, with the tension limit of another goal."""
    return replace(REST, limit=goal.limit, quick=True)
