"""From a goal to what the drive is told: cascade of length, rate and tension, and the brake. Pure.

The drive itself holds the rate that it is told, with a feed-forward and a limit of the motor's
tension. Above it:

length    an S-curve is followed; its rate plus a gain on the length's error
rate      the S-curve's rate alone, whose length is followed too, so that nothing drifts
tension   the motor's pull alone, corrected by the tension's error: the drum gives way by itself
          as fast as its inertia allows, which no rate loop can on a stiff tether; between two rates

What is commanded is one motion throughout: a change of goal starts from the present rate and
acceleration. Where the drum cannot follow, because the motor is at its limit, the S-curve waits
for it: nothing winds up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum, auto
from typing import NamedTuple

from msg_schemas.machine import MAX_LENGTH, MAX_PAYOUT_RATE, MAX_TENSION, SMALLEST_LIMIT
from msg_schemas.parameters import ParameterError, parameter
from tether_winch.drum_model import DrumModel
from tether_winch.profile import Motion, MotionLimits, stopping_distance, toward_length, toward_rate


@dataclass(frozen=True)
class ServoParameters:
    """Motion: limits of the S-curve, gains, ends of the tether, trim."""

    largest_rate: float = parameter(
        0.35, "m/s", "largest payout rate of any request", 0.01, MAX_PAYOUT_RATE
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
    friction_lead_gain: float = parameter(
        0.02, "m/s/N", "rate per tension error by which the friction compensation leads", 0.0, 1.0
    )
    relief_acceleration: float = parameter(
        3.0, "m/s^2", "deceleration of a slack take-up when the tether comes taut", 0.01, 20.0
    )
    shortest_length: float = parameter(2.0, "m", "hard end, reeled in", 0.0, MAX_LENGTH)
    longest_length: float = parameter(58.0, "m", "hard end, paid out", 0.1, MAX_LENGTH)
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
    end_rate: float = parameter(0.1, "m/s", "largest rate at a soft end", 1e-3, MAX_PAYOUT_RATE)
    tension_limit: float = parameter(
        40.0, "N", "largest tension of the motor where a request gives none",
        SMALLEST_LIMIT, MAX_TENSION,
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
        """Refuse ends that leave no room, and a stop that is softer than the S-curve."""
        if self.shortest_length + self.soft_margin >= self.longest_length - self.soft_margin:
            msg = (
                f"shortest_length is {self.shortest_length:g} m and longest_length "
                f"{self.longest_length:g} m: with a soft_margin of {self.soft_margin:g} m they "
                "leave no room"
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
    """What is followed."""

    REST = auto()
    LENGTH = auto()
    RATE = auto()
    TENSION = auto()


@dataclass(frozen=True)
class Goal:
    """What the servo is to reach or keep.

    Attributes:
        kind: which of length, rate and tension is followed; REST comes to rest and brakes.
        length: to go to, or longest length of a tension hold [m].
        rate: to keep, or the largest one [m/s].
        tension: to hold at the fairlead [N].
        limit: largest tension that the motor may use [N].
        reels_in: whether the tether may be reeled in.
        pays_out: whether it may be paid out.
        quick: come to rest by the quick limits.
    """

    kind: GoalKind
    length: float = math.inf
    rate: float = 0.0
    tension: float = 0.0
    limit: float = math.inf
    reels_in: bool = True
    pays_out: bool = True
    quick: bool = False


REST = Goal(GoalKind.REST)


class Sensed(NamedTuple):
    """Estimates of one instant that the servo goes by."""

    length: float  # paid out [m]
    rate: float  # of payout [m/s]
    tension: float  # at the fairlead [N]; NaN = not known
    load: float  # of the rover by its running mean [N]; stands in where the tension is not known
    carried: float  # by the motor, from its current [N]
    brake_is_open: bool


class DriveCommand(NamedTuple):
    """What the drive is told."""

    length: float  # aimed at [m]
    rate: float  # of payout [m/s]
    feed_forward: float  # tension that the motor is to carry [N]
    release_brake: bool
    limit: float  # largest tension that the motor may use [N]


class _Pull(NamedTuple):
    """The motor holds a tension by its pull while the drum runs between two rates."""

    tension: float  # of the motor [N]; below 0 it drives the tether out
    low: float  # [m/s]
    high: float
    rate: float  # now [m/s]


class BrakePhase(Enum):
    """Who carries the load, and who is about to."""

    CLOSED = auto()
    LOADING = auto()  # the motor takes the load over, behind the brake
    OPENING = auto()
    OPEN = auto()
    CLOSING = auto()
    UNLOADING = auto()  # the motor gives the load to the brake


class WinchServo:
    """Follows goals with one drum.

    Args:
        parameters: limits and gains.
        drum: what is known of the drum.
    """

    _CLOSED_FOR = 0.05  # the motor carries the load on so long after the brake has closed [s]

    def __init__(self, parameters: ServoParameters, drum: DrumModel) -> None:
        self.parameters = parameters
        self.goal = REST
        self.phase = BrakePhase.CLOSED
        self.motion = Motion(0.0, 0.0, 0.0)
        self.trim_offset = 0.0  # length added by the trim [m]
        self.feed_forward = 0.0  # [N]
        self.waits = False  # the S-curve waits for the drum
        self._drum = drum
        self._rate = 0.0  # commanded, trim included [m/s]
        self._trim_wanted: float | None = None
        self._trim = 0.0  # [m/s]
        self._load = math.nan  # low-passed [N]
        self._in_phase = 0.0  # [s]
        self._at_rest = 0.0  # [s]
        self._pull: _Pull | None = None  # where a tension is held

    @property
    def reference(self) -> Motion:
        """What the drum is to follow, trim included."""
        return Motion(
            self.motion.length + self.trim_offset,
            self.motion.rate + self._trim,
            self.motion.acceleration,
        )

    @property
    def rests(self) -> bool:
        """Whether nothing moves and the brake has taken over."""
        return self.phase in (BrakePhase.CLOSED, BrakePhase.UNLOADING)

    @property
    def time_in_phase(self) -> float:
        """How long the brake has been in its phase [s]."""
        return self._in_phase

    @property
    def aimed_tension(self) -> float:
        """Tension that is held, or else fed forward [N]."""
        holds = self.goal.kind is GoalKind.TENSION
        return self.goal.tension if holds else self.feed_forward

    def retune(self, parameters: ServoParameters, drum: DrumModel) -> None:
        """Go by other limits and gains at once."""
        self.parameters, self._drum = parameters, drum

    def aim(self, goal: Goal) -> None:
        """Take a new goal; the motion goes on from where it is."""
        self.goal = goal
        self._at_rest = 0.0

    def trim(self, rate: float | None) -> None:
        """Add a rate [m/s] to the goal's own, within the bounds; None ends it."""
        self._trim_wanted = rate

    def close_at_once(self, sensed: Sensed) -> DriveCommand:
        """Brake and zero torque, now; what was aimed at is forgotten."""
        self.goal = REST
        self._trim_wanted = None
        self._enter(BrakePhase.CLOSED)
        self.feed_forward = 0.0
        self._stand(sensed)
        return DriveCommand(self._told_length(), 0.0, 0.0, False, SMALLEST_LIMIT)

    def step(self, sensed: Sensed, allowed_tension: float, h: float) -> DriveCommand:
        """Advance by h; returns what the drive is told.

        Args:
            sensed: estimates now.
            allowed_tension: that the motor may use without overheating [N].
            h: duration [s].
        """
        self._in_phase += h
        self._follow_load(sensed, h)
        self._step_brake(sensed)
        if self.phase is BrakePhase.OPEN:
            self._move(sensed, h)
        else:
            self._stand(sensed)
        self._feed_forward(sensed, h)
        limit = min(self.goal.limit, allowed_tension)
        if math.isinf(limit):
            limit = self.parameters.tension_limit
        if self._pull is not None:
            return self._pulling(self._pull, limit)
        release = self.phase in (BrakePhase.OPENING, BrakePhase.OPEN)
        return DriveCommand(
            self._told_length(),
            self._rate,
            min(self.feed_forward, limit),
            release,
            max(limit, SMALLEST_LIMIT),
        )

    # --- brake -----------------------------------------------------------------------------------

    def _step_brake(self, sensed: Sensed) -> None:
        wants = self._wants_to_move(sensed)
        if self.phase in (BrakePhase.CLOSED, BrakePhase.UNLOADING):
            if wants:
                self._enter(BrakePhase.LOADING)
        elif self.phase is BrakePhase.LOADING:
            if not wants:
                self._enter(BrakePhase.UNLOADING)
            elif abs(self._wanted_feed_forward(sensed) - self.feed_forward) < 0.5:
                self._enter(BrakePhase.OPENING)
        elif self.phase is BrakePhase.OPENING:
            if sensed.brake_is_open:
                self._enter(BrakePhase.OPEN)
        elif self.phase is BrakePhase.OPEN:
            if not sensed.brake_is_open:  # the drive has closed it by itself
                self._enter(BrakePhase.OPENING)
            elif self._is_idle(wants):
                self._enter(BrakePhase.CLOSING)
                # The drive's rate loop ends with the brake: its part goes on as feed-forward.
                self.feed_forward = max(sensed.carried, 0.0)
        elif self.phase is BrakePhase.CLOSING:
            if wants:
                self._enter(BrakePhase.OPENING)
            elif not sensed.brake_is_open and self._in_phase > self._CLOSED_FOR:
                self._enter(BrakePhase.UNLOADING)

    def _is_idle(self, wants: bool) -> bool:
        if wants or self.motion.rate != 0.0 or self._trim != 0.0:
            self._at_rest = 0.0
            return False
        needed = 0.0 if self.goal.kind is GoalKind.REST else self.parameters.idle_time
        return self._at_rest >= needed

    def _enter(self, phase: BrakePhase) -> None:
        if phase is not self.phase:
            self.phase = phase
            self._in_phase = 0.0
            self._at_rest = 0.0

    def _wants_to_move(self, sensed: Sensed) -> bool:
        goal = self.goal
        if goal.kind is GoalKind.REST:
            return False
        if self._trim_wanted is not None:
            return True
        if goal.kind is GoalKind.LENGTH:
            at = self.motion.length if self.phase is BrakePhase.OPEN else sensed.length
            way = self._bounded(goal.length) - at
            if (way > 0.0 and not goal.pays_out) or (way < 0.0 and not goal.reels_in):
                return False
            return abs(way) > self.parameters.length_tolerance
        if goal.kind is GoalKind.RATE:
            low, high = self._soft_ends()
            at = self.motion.length
            blocked = (goal.rate > 0.0 and at >= high) or (goal.rate < 0.0 and at <= low)
            return goal.rate != 0.0 and not blocked
        return goal.reels_in or goal.pays_out

    # --- motion ----------------------------------------------------------------------------------

    def _stand(self, sensed: Sensed) -> None:
        """The brake holds: the motion is that of the drum."""
        self._pull = None
        self.motion = Motion(sensed.length, 0.0, 0.0)
        self.trim_offset = 0.0
        self._trim = self._rate = 0.0
        self.waits = False

    def _move(self, sensed: Sensed, h: float) -> None:
        p, goal = self.parameters, self.goal
        self._pull = None
        self._step_trim(h)
        if goal.kind is GoalKind.TENSION:
            self._move_by_tension(sensed, h)
        else:
            limits = self._limits()
            after = self._toward_goal(limits, h)
            if (after.rate < 0.0 and not goal.reels_in) or (after.rate > 0.0 and not goal.pays_out):
                after = toward_rate(self.motion, 0.0, limits, h)
            self.motion = self._waiting(after, sensed)
        error = self.reference.length - sensed.length
        correction = p.length_gain * error if goal.kind is not GoalKind.TENSION else 0.0
        rate = self.reference.rate + correction
        largest = min(
            MAX_PAYOUT_RATE, self._drum.largest_rate(sensed.length, self._tension(sensed))
        )
        self._rate = min(max(rate, -largest), largest)
        resting = self.motion.rate == 0.0 and self._trim == 0.0 and abs(sensed.rate) < 0.01
        self._at_rest = self._at_rest + h if resting else 0.0

    def _toward_goal(self, limits: MotionLimits, h: float) -> Motion:
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

    def _waiting(self, after: Motion, sensed: Sensed) -> Motion:
        """The S-curve, held back where the drum does not follow."""
        limit = self.parameters.following_error_limit
        lead = after.length + self.trim_offset - sensed.length
        self.waits = abs(lead) > limit and lead * after.rate > 0.0
        if not self.waits:
            return after
        length = sensed.length - self.trim_offset + math.copysign(limit, lead)
        # No faster than the drum, so that it starts softly where the drum comes free.
        slower = min(abs(after.rate), abs(sensed.rate))
        return Motion(length, math.copysign(slower, after.rate), 0.0)

    def _move_by_tension(self, sensed: Sensed, h: float) -> None:
        p, goal = self.parameters, self.goal
        limits = self._limits()
        error = 0.0 if math.isnan(sensed.tension) else sensed.tension - goal.tension
        self.waits = False
        low, high = self._rate_range(sensed, limits)
        if goal.pays_out:
            self._hold_tension(sensed, error, low, high)
            return
        # Slack is taken up at the goal's rate until the tether pulls; then to a stop.
        pull = max(goal.tension - self._drum.hanging_weight(sensed.length), 1e-3)
        rate = low * min(max(-error / (0.5 * pull), 0.0), 1.0)
        change = limits.acceleration * h
        # A tether that comes taut on a moving drum must not wait for the S-curve.
        way_out = p.relief_acceleration * h if error > -0.5 * goal.tension else change
        rate = min(max(rate, self.motion.rate - change), self.motion.rate + max(way_out, change))
        self.motion = Motion(sensed.length - self.trim_offset, rate, 0.0)

    def _hold_tension(self, sensed: Sensed, error: float, low: float, high: float) -> None:
        p = self.parameters
        self.motion = Motion(sensed.length - self.trim_offset, sensed.rate, 0.0)
        # Dry friction is made up for by where the drum should go, before it goes there.
        rate = sensed.rate + p.friction_lead_gain * error
        pull = self._drum.motor_tension(self.goal.tension, sensed.length, rate, 0.0)
        self._pull = _Pull(pull - p.tension_gain * error, low, high, sensed.rate)

    def _pulling(self, pull: _Pull, limit: float) -> DriveCommand:
        """A rate loop at its torque limit gives that torque; at an end of its range, the rate."""
        within = pull.low <= pull.rate <= pull.high
        if within:
            rate = pull.low if pull.tension > 0.0 else pull.high
            # The drive takes its limit for a motor that drives.
            most = min(abs(pull.tension) * self._drum.parameters.gear_efficiency, limit)
        else:
            rate, most = min(max(pull.rate, pull.low), pull.high), limit
        carried = min(max(pull.tension, 0.0), limit)
        return DriveCommand(self._told_length(), rate, carried, True, max(most, SMALLEST_LIMIT))

    def _rate_range(self, sensed: Sensed, limits: MotionLimits) -> tuple[float, float]:
        """Rates that the goal, and a stop before the soft ends, leave to the tension loop."""
        goal = self.goal
        low_end, high_end = self._soft_ends()
        high_end = min(high_end, goal.length)

        def reach(way: float) -> float:
            return math.sqrt(max(way, 0.0) * limits.acceleration)

        high = min(limits.rate, reach(high_end - sensed.length)) if goal.pays_out else 0.0
        low = -min(limits.rate, reach(sensed.length - low_end)) if goal.reels_in else 0.0
        return low, high

    def _limits(self) -> MotionLimits:
        p, goal = self.parameters, self.goal
        if goal.quick or goal.kind is GoalKind.REST:
            return MotionLimits(p.largest_rate, p.quick_stop_acceleration, p.quick_stop_jerk)
        named = abs(goal.rate)
        rate = min(named, p.largest_rate) if named > 0.0 else p.largest_rate
        if self._nears_an_end():
            rate = min(rate, p.end_rate)
        return MotionLimits(rate, p.acceleration, p.jerk)

    def _nears_an_end(self) -> bool:
        """Whether it must have the end's rate now, or slow down to it, before a soft end."""
        p, goal, motion = self.parameters, self.goal, self.motion
        low, high = self._soft_ends()
        outward = goal.length - motion.length if goal.kind is GoalKind.LENGTH else goal.rate
        if motion.rate != 0.0:
            outward = motion.rate
        way = high - motion.length if outward > 0.0 else motion.length - low
        excess = max(abs(motion.rate) - p.end_rate, 0.0)
        # To the end's rate: a ramp of the acceleration at either side.
        time = excess / p.acceleration + p.acceleration / p.jerk
        slowing = time * (p.end_rate + 0.5 * excess) if excess > 0.0 else 0.0
        return way <= p.end_zone + slowing

    def _step_trim(self, h: float) -> None:
        p = self.parameters
        wanted = 0.0 if self._trim_wanted is None else self._trim_wanted
        wanted = min(max(wanted, -p.trim_rate), p.trim_rate)
        for side in (1.0, -1.0):
            room = max(p.trim_length - side * self.trim_offset, 0.0)
            end = self._soft_ends()[1 if side > 0.0 else 0]
            room = min(room, max(side * (end - self.reference.length), 0.0))
            most = math.sqrt(2.0 * p.trim_acceleration * room) * 0.7
            wanted = min(wanted, most) if side > 0.0 else max(wanted, -most)
        if (wanted < 0.0 and not self.goal.reels_in) or (wanted > 0.0 and not self.goal.pays_out):
            wanted = 0.0
        change = p.trim_acceleration * h
        self._trim = min(max(wanted, self._trim - change), self._trim + change)
        self.trim_offset += self._trim * h
        self.trim_offset = min(max(self.trim_offset, -p.trim_length), p.trim_length)
        if self._trim_wanted is None and self._trim == 0.0 and self.trim_offset != 0.0:
            # What the trim has added becomes a way for the S-curve.
            self.motion = self.motion._replace(length=self.motion.length + self.trim_offset)
            self.trim_offset = 0.0

    # --- feed-forward ----------------------------------------------------------------------------

    def _follow_load(self, sensed: Sensed, h: float) -> None:
        load = sensed.load
        if not math.isnan(sensed.tension):
            load = sensed.tension - self._drum.hanging_weight(sensed.length)
        if math.isnan(self._load):
            self._load = load
        else:
            self._load += (load - self._load) * -math.expm1(-h / self.parameters.load_filter_time)

    def _tension(self, sensed: Sensed) -> float:
        return max(self._load, 0.0) + self._drum.hanging_weight(sensed.length)

    def _wanted_feed_forward(self, sensed: Sensed) -> float:
        if self.phase in (BrakePhase.CLOSED, BrakePhase.UNLOADING):
            return 0.0
        if self.phase is BrakePhase.CLOSING:
            return self.feed_forward
        rate, acceleration = self.reference.rate, self.motion.acceleration
        wanted = self._drum.motor_tension(self._tension(sensed), sensed.length, rate, acceleration)
        return max(wanted, 0.0)

    def _feed_forward(self, sensed: Sensed, h: float) -> None:
        wanted = self._wanted_feed_forward(sensed)
        change = self.parameters.feed_forward_slew * h
        self.feed_forward = min(max(wanted, self.feed_forward - change), self.feed_forward + change)

    # --- ends ------------------------------------------------------------------------------------

    def _soft_ends(self) -> tuple[float, float]:
        p = self.parameters
        return p.shortest_length + p.soft_margin, p.longest_length - p.soft_margin

    def _bounded(self, length: float) -> float:
        low, high = self._soft_ends()
        return min(max(length, low), high)

    def _told_length(self) -> float:
        return min(max(self.reference.length, 0.0), MAX_LENGTH)

    @property
    def stopping_way(self) -> float:
        """Way [m] to rest by the quick limits."""
        p = self.parameters
        limits = MotionLimits(p.largest_rate, p.quick_stop_acceleration, p.quick_stop_jerk)
        return stopping_distance(self.motion.rate, self.motion.acceleration, limits)


def at_rest_quickly(goal: Goal) -> Goal:
    """The goal of coming to rest by the quick limits, with the motor's limit kept."""
    return replace(REST, limit=goal.limit, quick=True)
