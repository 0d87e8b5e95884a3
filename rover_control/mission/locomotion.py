"""Choice between wheels and jump where the rover is stuck, by the risk of each. Pure.

The parameter `locomotion_rule` selects one of two rules:

``risk``
    Wheels that got stuck n times at this place fail again with probability (n + 1)/(n + 2)
    (Laplace's rule of succession), wheels that have not got stuck with `base_wheel_risk`. On slopes
    above `max_drive_slope` they fail. A jump fails if the rover topples, with the predicted
    probability, or if the rover is stuck again afterwards, with probability (m + 1)/(m + 3) after m
    jumps at this place: 1/3 for the first one. Toppling costs `topple_weight` times as much as
    staying in place. A jump that the prediction rejects fails.
``slack``
    The rule of the source study: with a stiff tether, jump up to a slack value dh/df of 1.5, drive
    above it. In the study attitudes scatter above 1.5; here that scatter came from the mesh of a
    tether that was not at rest (docs/study.md). The rule serves for comparison.

dh is the height of the fairlead above the tether attachment, df the horizontal distance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from msg_schemas.parameters import parameter


class LocomotionMode(StrEnum):
    """Mode of locomotion."""

    WHEELS = "wheels"
    JUMP = "jump"


@dataclass(frozen=True)
class LocomotionParameters:
    """Rule that chooses between wheels and jump."""

    locomotion_rule: str = parameter(
        "risk", "-", "risk: predicted risk; slack: slack value, as in the source study",
        choices=("risk", "slack"),
    )  # fmt: skip
    slack_rule_threshold: float = parameter(
        1.5, "-", "slack rule: largest slack value at which the rover jumps", 0.0, 100.0
    )
    slack_rule_stiffness: float = parameter(
        1.0e3, "N", "slack rule: axial stiffness EA below which the rover always jumps", 0.0, 1e9
    )
    tether_stiffness: float = parameter(2.0e4, "N", "axial stiffness EA of the tether", 0.1, 1e9)
    base_wheel_risk: float = parameter(
        0.05, "-", "failure probability of wheels that have not got stuck here", 0.0, 1.0
    )
    max_drive_slope: float = parameter(
        0.30, "rad", "largest slope that the wheels climb", 0.02, 1.5
    )
    topple_weight: float = parameter(
        2.0, "-", "cost of toppling over the cost of staying in place", 1.0, 100.0
    )


class JumpAssessment(NamedTuple):
    """Predicted outcome of a jump."""

    upright: float  # probability of landing upright
    rejection: str  # why the jump is rejected; empty = accepted


class LocomotionSituation(NamedTuple):
    """State of a stuck rover and its surroundings."""

    slack_value: float  # dh/df [-]; inf = below the fairlead
    axial_stiffness: float  # EA of the tether [N]
    slope: float  # slope of the ground [rad]; nan = unknown
    stuck: int  # wheel failures at this place since the last progress
    jumped: int  # jumps at this place without progress
    assessment: JumpAssessment | None  # predicted jump from here; None = not predicted


class Choice(NamedTuple):
    """Chosen mode and the reason."""

    mode: LocomotionMode
    wheels_risk: float  # expected cost of failure; nan = not evaluated
    jump_risk: float
    reason: str


def slack_value(x: float, y: float, drop: float) -> float:
    """Slack value dh/df [-] of a rover (x, y) [m] beside the plumb line, `drop` [m] below."""
    horizontal = math.hypot(x, y)
    return math.inf if horizontal == 0.0 else drop / horizontal


def choose(parameters: LocomotionParameters, situation: LocomotionSituation) -> Choice:
    """Choose between wheels and jump.

    Args:
        parameters: rule and thresholds.
        situation: state of the rover.
    """
    if parameters.locomotion_rule == "slack":
        return _by_slack(parameters, situation)
    wheels = _wheels_risk(parameters, situation)
    jump, why = _jump_risk(parameters, situation)
    mode = LocomotionMode.JUMP if jump < wheels else LocomotionMode.WHEELS
    reason = f"risk of wheels {wheels:.2f}, of a jump {jump:.2f}: {why}"
    return Choice(mode, wheels, jump, reason)


def _by_slack(parameters: LocomotionParameters, situation: LocomotionSituation) -> Choice:
    value, limit = situation.slack_value, parameters.slack_rule_threshold
    stiffness, stiff = situation.axial_stiffness, parameters.slack_rule_stiffness
    mode = LocomotionMode.JUMP
    if stiffness < stiff:
        reason = f"tether stiffness {stiffness:g} N is below {stiff:g} N"
    elif value <= limit:
        reason = f"slack value {value:.3g} is within the threshold of {limit:g}"
    else:
        mode = LocomotionMode.WHEELS
        reason = f"slack value {value:.3g} is above the threshold of {limit:g}"
    return Choice(mode, math.nan, math.nan, reason)


def _wheels_risk(parameters: LocomotionParameters, situation: LocomotionSituation) -> float:
    if situation.slope > parameters.max_drive_slope:
        return 1.0
    if situation.stuck == 0:
        return parameters.base_wheel_risk
    return (situation.stuck + 1.0) / (situation.stuck + 2.0)


def _jump_risk(
    parameters: LocomotionParameters, situation: LocomotionSituation
) -> tuple[float, str]:
    assessment, weight = situation.assessment, parameters.topple_weight
    if assessment is None:
        return weight, "no prediction of a jump"
    if assessment.rejection:
        return weight, assessment.rejection
    stays = (situation.jumped + 1.0) / (situation.jumped + 3.0)
    risk = (1.0 - assessment.upright) * weight + assessment.upright * stays
    return risk, f"probability of landing upright {assessment.upright:.2f}"
