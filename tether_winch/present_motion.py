"""Present motion of the winch: goal, renewals, trims, and the jump that it waits for. Pure."""

from __future__ import annotations

import math
from dataclasses import replace

from msg_schemas import topics
from msg_schemas.table import TOPICS
from tether_winch.requests import JUMPING
from tether_winch.servo import REST, GoalKind, ServoGoal, WinchServo

_MIN_STEPS = 3  # servo steps after which a motion has begun
_RENEWAL_TOLERANCE = 0.1  # relative change of tension or rate that counts as a renewal
_MIN_TIME = 0.05  # shortest motion [s]
_MIN_RENEWED_TIME = 0.3  # shortest motion of a renewed request; a trim may follow [s]
# Time without renewal after which a trim ends [s].
_TRIM_TIMEOUT = TOPICS[topics.WINCH_TRIM].stale.timeout


class PresentMotion:
    """Motion in progress; all times are of the controller's clock [s].

    Args:
        servo: that executes it.

    Attributes:
        goal: of the motion.
        steps: of the servo in this motion.
        requires_renewal: whether its request must be renewed.
    """

    def __init__(self, servo: WinchServo) -> None:
        self.goal = REST
        self.steps = 0
        self.requires_renewal = False
        self._servo = servo
        self._begun_at = 0.0
        self._renewed_at = 0.0
        self._trimmed_at: float | None = None
        self._jump = ""  # phase
        self._jump_since = 0.0
        self._held = REST
        self._held_at = -math.inf

    def aim(self, goal: ServoGoal) -> None:
        """Set the goal; reeling in is inhibited during a jump."""
        self.goal = goal
        allowed = replace(goal, reels_in=False) if self.jump else goal
        if allowed != self._servo.goal:
            self._servo.set_goal(allowed)

    def begin(self, now: float) -> None:
        """Begin a motion to the goal."""
        self._begun_at, self.steps = now, 0

    def continues(self, goal: ServoGoal, *, at_any_rate: bool) -> bool:
        """Whether a goal merely renews the present one.

        Args:
            goal: of the request.
            at_any_rate: whether its rate may differ, as that of an ascent, which follows the swing.
        """
        return _renews(goal, self.goal, at_any_rate=at_any_rate)

    def hold(self, now: float) -> None:
        """Remember the motion that a hold ends: a renewal of it may be on its way."""
        self._held, self._held_at = self.goal, now

    def held_for(self, goal: ServoGoal, now: float) -> float:
        """Time since a hold [s] if the goal would continue what it ended; else infinite."""
        return now - self._held_at if _renews(goal, self._held, at_any_rate=True) else math.inf

    def age(self, now: float) -> float:
        """Time since the motion began [s]."""
        return now - self._begun_at

    # --- renewals and trims ----------------------------------------------------------------------

    def renew(self, now: float, *, requires_renewal: bool) -> None:
        """Take a request for the motion."""
        self._renewed_at, self.requires_renewal = now, requires_renewal

    def is_unrenewed(self, now: float, timeout: float) -> bool:
        """Whether the last request is older than a time [s]."""
        return now - self._renewed_at > timeout

    def trim(self, rate: float, now: float) -> None:
        """Add a rate [m/s] until the trim times out."""
        self._trimmed_at = now
        self._servo.trim(rate)

    def end_trim(self) -> None:
        """End a trim."""
        self._trimmed_at = None
        self._servo.trim(None)

    def step(self, now: float, jump_timeout: float) -> None:
        """End a trim that is not renewed, and a jump that lasts longer than a time [s]."""
        if self.jump and now - self._jump_since > jump_timeout:
            self._jump = ""
            self.aim(self.goal)
        if self._trimmed_at is not None and now - self._trimmed_at > _TRIM_TIMEOUT:
            self.end_trim()

    # --- jumps -----------------------------------------------------------------------------------

    @property
    def jump(self) -> str:
        """Phase of a jump in progress; empty = none."""
        return self._jump if self._jump in JUMPING else ""

    def on_jump(self, phase: str, now: float) -> str:
        """Update with the phase of the jump; returns the phase before."""
        before, self._jump, self._jump_since = self._jump, phase, now
        self.aim(self.goal)
        return before

    def clock_jumped(self, now: float) -> None:
        """Begin all times anew."""
        self._trimmed_at = None
        self._jump_since = self._begun_at = now
        self._held_at = -math.inf

    # --- where it leads --------------------------------------------------------------------------

    def is_complete(self, now: float) -> bool:
        """Whether the servo has come to rest at the goal."""
        # Time alone does not suffice: a stalled node would end a motion that has not begun.
        # A controller that trims reacts to the mode, so its first trim comes later.
        least = _MIN_RENEWED_TIME if self.requires_renewal else _MIN_TIME
        begun = self.steps >= _MIN_STEPS and self.age(now) > least
        return begun and self._trimmed_at is None and self._servo.is_at_rest

    def pays_out(self, length: float, tolerance: float) -> bool:
        """Whether it pays out or shall do so, at a payout [m] and its tolerance [m]."""
        goal = self.goal
        # The rate of a length goal is a limit for both directions.
        is_length = goal.kind is GoalKind.LENGTH
        demand = goal.length - length > tolerance if is_length else goal.rate > 0.0
        return self._servo.reference.rate > 0.0 or demand

    def reels_in(self, length: float, tolerance: float) -> bool:
        """Whether it pulls at a snag; paying out frees the rover."""
        return self._servo.reference.rate < 0.0 or not self.pays_out(length, tolerance)


def _renews(goal: ServoGoal, before: ServoGoal, *, at_any_rate: bool) -> bool:
    """Whether a goal merely renews another one.

    Renewals may differ a little, as a tension follows the paid-out weight.
    """
    if replace(goal, tension=before.tension, rate=before.rate) != before:
        return False
    little = abs(goal.tension - before.tension) <= _RENEWAL_TOLERANCE * before.tension
    turned = abs(goal.rate - before.rate)
    return little and (at_any_rate or turned <= _RENEWAL_TOLERANCE * abs(before.rate))
