"""Choice between wheels and jump by each rule."""

from __future__ import annotations

import math

import pytest

from rover_control.mission.locomotion import (
    JumpAssessment,
    LocomotionMode,
    LocomotionParameters,
    LocomotionSituation,
    choose,
    slack_value,
)

RISK = LocomotionParameters()
SLACK = LocomotionParameters(locomotion_rule="slack")
FREE = LocomotionSituation(3.0, 2e4, 0.05, 0, 0, None)


def landing(upright: float) -> JumpAssessment:
    return JumpAssessment(upright, "")


def test_a_rover_that_is_not_stuck_drives():
    choice = choose(RISK, FREE._replace(assessment=landing(1.0)))
    assert choice.mode is LocomotionMode.WHEELS
    assert choice.wheels_risk == RISK.base_wheel_risk
    assert choice.jump_risk == pytest.approx(1.0 / 3.0)


@pytest.mark.parametrize(
    ("upright", "mode"),
    [
        (1.0, LocomotionMode.JUMP),
        (0.9, LocomotionMode.JUMP),
        (0.75, LocomotionMode.WHEELS),
        (0.0, LocomotionMode.WHEELS),
    ],
)
def test_a_stuck_rover_jumps_if_it_is_likely_to_land_upright(upright: float, mode: LocomotionMode):
    choice = choose(RISK, FREE._replace(stuck=1, assessment=landing(upright)))
    assert choice.mode is mode
    assert choice.wheels_risk == pytest.approx(2.0 / 3.0)


def test_failed_jumps_lead_back_to_the_wheels():
    modes = [
        choose(RISK, FREE._replace(stuck=1, jumped=jumped, assessment=landing(1.0))).mode
        for jumped in range(5)
    ]
    assert modes == [LocomotionMode.JUMP] * 3 + [LocomotionMode.WHEELS] * 2
    more = choose(RISK, FREE._replace(stuck=4, jumped=3, assessment=landing(1.0)))
    assert more.mode is LocomotionMode.JUMP


def test_on_ground_too_steep_for_wheels_the_rover_jumps():
    steep = FREE._replace(slope=0.31, assessment=landing(1.0))
    assert choose(RISK, steep).mode is LocomotionMode.JUMP
    assert choose(RISK, steep._replace(assessment=landing(0.4))).mode is LocomotionMode.WHEELS


@pytest.mark.parametrize("assessment", [None, JumpAssessment(0.0, "it would topple")])
def test_without_an_accepted_prediction_the_rover_does_not_jump(assessment: JumpAssessment | None):
    choice = choose(RISK, FREE._replace(stuck=9, slope=1.0, assessment=assessment))
    assert choice.mode is LocomotionMode.WHEELS
    assert choice.jump_risk == RISK.topple_weight
    assert ("it would topple" if assessment else "no prediction of a jump") in choice.reason


@pytest.mark.parametrize(
    ("value", "stiffness", "mode"),
    [
        (1.5, 2e4, LocomotionMode.JUMP),
        (1.51, 2e4, LocomotionMode.WHEELS),
        (math.inf, 2e4, LocomotionMode.WHEELS),
        (3.0, 10.0, LocomotionMode.JUMP),
    ],
)
def test_the_slack_rule_depends_on_slack_value_and_stiffness_only(
    value: float, stiffness: float, mode: LocomotionMode
):
    around = FREE._replace(slack_value=value, axial_stiffness=stiffness, stuck=3)
    assert choose(SLACK, around).mode is mode
    assert choose(SLACK, around._replace(assessment=landing(0.0))).mode is mode


def test_the_slack_value_is_drop_over_horizontal_distance():
    assert slack_value(3.0, 4.0, 10.0) == 2.0
    assert slack_value(0.0, 0.0, 10.0) == math.inf
