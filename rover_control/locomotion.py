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
    """How to get on."""

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
    """What a prediction says of a jump."""

    upright: float  # probability of landing so
    refused: str  # why it is better not to jump; empty = go


class LocomotionSituation(NamedTuple):
    """What is known where the choice is made."""

    slack_value: float  # dh/df [-]; inf = plumb below the fairlead
    axial_stiffness: float  # EA of the tether [N]
    slope: float  # of what the rover stands on [rad]; nan = not known
    stuck: int  # times that the wheels got stuck here and did not get on since
    jumped: int  # jumps here that did not get the rover on
    assessment: JumpAssessment | None  # of a jump from here; None = none was made


class Choice(NamedTuple):
    """How to get on, and why."""

    mode: LocomotionMode
    wheels_risk: float  # weighed probability of failing; nan = not looked at
    jump_risk: float
    reason: str


def slack_value(x: float, y: float, drop: float) -> float:
    """Slack value dh/df [-] of a rover (x, y) [m] beside the plumb line, `drop` [m] below."""
    horizontal = math.hypot(x, y)
    return math.inf if horizontal == 0.0 else drop / horizontal


def choose(parameters: LocomotionParameters, around: LocomotionSituation) -> Choice:
    """Choose between wheels and jump.

    Args:
        parameters: the rule and its numbers.
        around: what is known.
    """
    if parameters.locomotion_rule == "slack":
        return _by_slack(parameters, around)
    wheels = _wheels_risk(parameters, around)
    jump, why = _jump_risk(parameters, around)
    mode = LocomotionMode.JUMP if jump < wheels else LocomotionMode.WHEELS
    reason = f"wheels fail with {wheels:.2f}, a jump with {jump:.2f}: {why}"
    return Choice(mode, wheels, jump, reason)


def _by_slack(parameters: LocomotionParameters, around: LocomotionSituation) -> Choice:
    nan, limit = math.nan, parameters.slack_rule_threshold
    if around.axial_stiffness < parameters.slack_rule_stiffness:
        return Choice(
            LocomotionMode.JUMP, nan, nan, f"a tether of {around.axial_stiffness:g} N is soft"
        )
    if around.slack_value <= limit:
        return Choice(
            LocomotionMode.JUMP,
            nan,
            nan,
            f"slack value {around.slack_value:.3g} is up to {limit:g}",
        )
    return Choice(
        LocomotionMode.WHEELS, nan, nan, f"slack value {around.slack_value:.3g} is above {limit:g}"
    )


def _wheels_risk(parameters: LocomotionParameters, around: LocomotionSituation) -> float:
    if around.slope > parameters.max_drive_slope:
        return 1.0
    if around.stuck == 0:
        return parameters.base_wheel_risk
    return (around.stuck + 1.0) / (around.stuck + 2.0)


def _jump_risk(parameters: LocomotionParameters, around: LocomotionSituation) -> tuple[float, str]:
    assessment, weight = around.assessment, parameters.topple_weight
    if assessment is None:
        return weight, "no jump was predicted"
    if assessment.refused:
        return weight, assessment.refused
    stays = (around.jumped + 1.0) / (around.jumped + 3.0)
    risk = (1.0 - assessment.upright) * weight + assessment.upright * stays
    return risk, f"it lands upright with {assessment.upright:.2f}"
