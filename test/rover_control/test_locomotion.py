"""Wheels or jump: each rule, and what moves the choice."""

from __future__ import annotations

import math

import pytest

from rover_control.locomotion import (
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


def test_as_long_as_nothing_holds_it_the_rover_drives():
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
def test_a_stuck_rover_jumps_if_it_lands_upright_surely_enough(
    upright: float, mode: LocomotionMode
):
    choice = choose(RISK, FREE._replace(stuck=1, assessment=landing(upright)))
    assert choice.mode is mode
    assert choice.wheels_risk == pytest.approx(2.0 / 3.0)


def test_jumps_that_did_not_help_lead_back_to_the_wheels():
    modes = [
        choose(RISK, FREE._replace(stuck=1, jumped=jumped, assessment=landing(1.0))).mode
        for jumped in range(5)
    ]
    assert modes == [LocomotionMode.JUMP] * 3 + [LocomotionMode.WHEELS] * 2
    more = choose(RISK, FREE._replace(stuck=4, jumped=3, assessment=landing(1.0)))
    assert more.mode is LocomotionMode.JUMP


def test_ground_too_steep_for_wheels_is_jumped_if_anything():
    steep = FREE._replace(slope=0.31, assessment=landing(1.0))
    assert choose(RISK, steep).mode is LocomotionMode.JUMP
    assert choose(RISK, steep._replace(assessment=landing(0.4))).mode is LocomotionMode.WHEELS


@pytest.mark.parametrize("assessment", [None, JumpAssessment(0.0, "it would topple")])
def test_what_was_not_predicted_or_advised_against_is_not_jumped(assessment: JumpAssessment | None):
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
def test_the_study_s_rule_goes_by_slack_and_stiffness_alone(
    value: float, stiffness: float, mode: LocomotionMode
):
    around = FREE._replace(slack_value=value, axial_stiffness=stiffness, stuck=3)
    assert choose(SLACK, around).mode is mode
    assert choose(SLACK, around._replace(assessment=landing(0.0))).mode is mode


def test_the_slack_value_is_drop_over_way_aside():
    assert slack_value(3.0, 4.0, 10.0) == 2.0
    assert slack_value(0.0, 0.0, 10.0) == math.inf
