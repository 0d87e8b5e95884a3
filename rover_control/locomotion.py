"""Wheels or jump, by the risk of each. Pure.

Two rules may be chosen between:

``risk``
    Wheels that got stuck n times here without getting on fail again with (n + 1)/(n + 2), Laplace's
    rule of succession; wheels that have not got stuck, with `usual_risk`. On ground steeper than
    they climb they fail. A jump fails if the rover topples, as its prediction tells, or if it does
    not get the rover on; m jumps that did not leave (m + 1)/(m + 3) for that, so the first one is
    given 2 of 3. Toppling weighs `topple_weight` times as much as standing where one stood. A jump
    that the prediction advises against fails.
``slack``
    The source study's: with a stiff tether jump up to a slack value dh/df of 1.5, drive above it.
    The study found attitudes to scatter above 1.5; rebuilt, that comes from the mesh of a tether
    that was not at rest (docs/study.md), so this rule stands here for comparison.

dh is how far the fairlead lies above the tether's attachment, df how far aside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from msg_schemas.parameters import parameter


class Way(StrEnum):
    """How to get on."""

    WHEELS = "wheels"
    JUMP = "jump"


@dataclass(frozen=True)
class LocomotionParameters:
    """How wheels or jump are chosen."""

    locomotion_rule: str = parameter(
        "risk",
        "-",
        "risk: by what is predicted; slack: the source study's",
        choices=("risk", "slack"),
    )
    rule_slack: float = parameter(
        1.5, "-", "slack value up to which the study's rule jumps", 0.0, 100.0
    )
    stiff_tether: float = parameter(
        1.0e3, "N", "axial stiffness EA below which the study's rule always jumps", 0.0, 1e9
    )
    tether_stiffness: float = parameter(2.0e4, "N", "EA of the tether that is used", 0.1, 1e9)
    usual_risk: float = parameter(0.05, "-", "of wheels that have not got stuck here", 0.0, 1.0)
    steepest_drive: float = parameter(0.30, "rad", "ground that wheels still climb", 0.02, 1.5)
    topple_weight: float = parameter(
        2.0, "-", "of toppling against standing where one stood", 1.0, 100.0
    )


class Outlook(NamedTuple):
    """What a prediction says of a jump."""

    upright: float  # probability of landing so
    refused: str  # why it is better not to jump; empty = go


class Surroundings(NamedTuple):
    """What is known where the choice is made."""

    slack_value: float  # dh/df [-]; inf = plumb below the fairlead
    axial_stiffness: float  # EA of the tether [N]
    slope: float  # of what the rover stands on [rad]; nan = not known
    stuck: int  # times that the wheels got stuck here and did not get on since
    jumped: int  # jumps here that did not get the rover on
    outlook: Outlook | None  # of a jump from here; None = none was made


class Choice(NamedTuple):
    """How to get on, and why."""

    way: Way
    wheels_risk: float  # weighed probability of failing; nan = not looked at
    jump_risk: float
    reason: str


def slack_value(x: float, y: float, drop: float) -> float:
    """Slack value dh/df [-] of a rover (x, y) [m] beside the plumb line, `drop` [m] below."""
    aside = math.hypot(x, y)
    return math.inf if aside == 0.0 else drop / aside


def choose(parameters: LocomotionParameters, around: Surroundings) -> Choice:
    """Choose between wheels and jump.

    Args:
        parameters: the rule and its numbers.
        around: what is known.
    """
    if parameters.locomotion_rule == "slack":
        return _by_slack(parameters, around)
    wheels = _wheels_risk(parameters, around)
    jump, why = _jump_risk(parameters, around)
    way = Way.JUMP if jump < wheels else Way.WHEELS
    reason = f"wheels fail with {wheels:.2f}, a jump with {jump:.2f}: {why}"
    return Choice(way, wheels, jump, reason)


def _by_slack(parameters: LocomotionParameters, around: Surroundings) -> Choice:
    nan, limit = math.nan, parameters.rule_slack
    if around.axial_stiffness < parameters.stiff_tether:
        return Choice(Way.JUMP, nan, nan, f"a tether of {around.axial_stiffness:g} N is soft")
    if around.slack_value <= limit:
        return Choice(
            Way.JUMP, nan, nan, f"slack value {around.slack_value:.3g} is up to {limit:g}"
        )
    return Choice(Way.WHEELS, nan, nan, f"slack value {around.slack_value:.3g} is above {limit:g}")


def _wheels_risk(parameters: LocomotionParameters, around: Surroundings) -> float:
    if around.slope > parameters.steepest_drive:
        return 1.0
    if around.stuck == 0:
        return parameters.usual_risk
    return (around.stuck + 1.0) / (around.stuck + 2.0)


def _jump_risk(parameters: LocomotionParameters, around: Surroundings) -> tuple[float, str]:
    outlook, weight = around.outlook, parameters.topple_weight
    if outlook is None:
        return weight, "no jump was predicted"
    if outlook.refused:
        return weight, outlook.refused
    stays = (around.jumped + 1.0) / (around.jumped + 3.0)
    risk = (1.0 - outlook.upright) * weight + outlook.upright * stays
    return risk, f"it lands upright with {outlook.upright:.2f}"
