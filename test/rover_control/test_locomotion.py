"""Wheels or jump: each rule, and what moves the choice."""

from __future__ import annotations

import math

import pytest

from rover_control.locomotion import (
    LocomotionParameters,
    Outlook,
    Surroundings,
    Way,
    choose,
    slack_value,
)

RISK = LocomotionParameters()
SLACK = LocomotionParameters(locomotion_rule="slack")
FREE = Surroundings(3.0, 2e4, 0.05, 0, 0, None)


def landing(upright: float) -> Outlook:
    return Outlook(upright, "")


def test_as_long_as_nothing_holds_it_the_rover_drives():
    choice = choose(RISK, FREE._replace(outlook=landing(1.0)))
    assert choice.way is Way.WHEELS
    assert choice.wheels_risk == RISK.usual_risk
    assert choice.jump_risk == pytest.approx(1.0 / 3.0)


@pytest.mark.parametrize(
    ("upright", "way"), [(1.0, Way.JUMP), (0.9, Way.JUMP), (0.75, Way.WHEELS), (0.0, Way.WHEELS)]
)
def test_a_stuck_rover_jumps_if_it_lands_upright_surely_enough(upright: float, way: Way):
    choice = choose(RISK, FREE._replace(stuck=1, outlook=landing(upright)))
    assert choice.way is way
    assert choice.wheels_risk == pytest.approx(2.0 / 3.0)


def test_jumps_that_did_not_help_lead_back_to_the_wheels():
    ways = [
        choose(RISK, FREE._replace(stuck=1, jumped=jumped, outlook=landing(1.0))).way
        for jumped in range(5)
    ]
    assert ways == [Way.JUMP] * 3 + [Way.WHEELS] * 2
    more = choose(RISK, FREE._replace(stuck=4, jumped=3, outlook=landing(1.0)))
    assert more.way is Way.JUMP


def test_ground_too_steep_for_wheels_is_jumped_if_anything():
    steep = FREE._replace(slope=0.31, outlook=landing(1.0))
    assert choose(RISK, steep).way is Way.JUMP
    assert choose(RISK, steep._replace(outlook=landing(0.4))).way is Way.WHEELS


@pytest.mark.parametrize("outlook", [None, Outlook(0.0, "it would topple")])
def test_what_was_not_predicted_or_advised_against_is_not_jumped(outlook: Outlook | None):
    choice = choose(RISK, FREE._replace(stuck=9, slope=1.0, outlook=outlook))
    assert choice.way is Way.WHEELS
    assert choice.jump_risk == RISK.topple_weight
    assert ("it would topple" if outlook else "no jump was predicted") in choice.reason


@pytest.mark.parametrize(
    ("value", "stiffness", "way"),
    [
        (1.5, 2e4, Way.JUMP),
        (1.51, 2e4, Way.WHEELS),
        (math.inf, 2e4, Way.WHEELS),
        (3.0, 10.0, Way.JUMP),
    ],
)
def test_the_study_s_rule_goes_by_slack_and_stiffness_alone(
    value: float, stiffness: float, way: Way
):
    around = FREE._replace(slack_value=value, axial_stiffness=stiffness, stuck=3)
    assert choose(SLACK, around).way is way
    assert choose(SLACK, around._replace(outlook=landing(0.0))).way is way


def test_the_slack_value_is_drop_over_way_aside():
    assert slack_value(3.0, 4.0, 10.0) == 2.0
    assert slack_value(0.0, 0.0, 10.0) == math.inf
