"""Legs derived from a plan, and the progress along them."""

from __future__ import annotations

from dataclasses import replace

import pytest

from rover_control.mission.mission_plan import Landing, Look, MissionPlan, Waypoint, load_plan
from rover_control.mission.mission_route import (
    LegKind,
    Route,
    homeward_legs,
    itinerary,
    recovery_legs,
)

PLAN = MissionPlan(
    stow=2.0,
    looks=(Look(depth=4.0, turns=(30.0, -60.0)),),
    landing=Landing(approach_depth=6.0, max_depth=9.0),
    survey=(Waypoint(x=1.0, y=0.5), Waypoint(x=2.0, y=0.0, heading=90.0)),
)


def test_legs_follow_from_the_plan():
    legs = itinerary(PLAN)
    assert [leg.kind.value for leg in legs] == [
        "look", "turn", "look", "turn", "look", "approach", "land", "visit", "visit", "return",
        "lift", "ascend", "stow",
    ]  # fmt: skip
    assert legs[1].angle == pytest.approx(0.5236, abs=1e-4)
    assert legs[8].heading == pytest.approx(1.5708, abs=1e-4)
    assert len({leg.name for leg in legs}) == len(legs)


def test_the_return_begins_where_the_rover_is():
    plan = load_plan("shallow")
    assert [leg.kind.value for leg in homeward_legs(plan, on_floor=True)] == [
        "return", "lift", "ascend", "stow",
    ]  # fmt: skip
    assert [leg.kind.value for leg in homeward_legs(plan, on_floor=False)] == ["ascend", "stow"]


def names(route: Route) -> list[str]:
    return [leg.name for leg in route.legs]


def at(kind: LegKind) -> Route:
    route = Route(PLAN)
    while route.leg is not None and route.leg.kind is not kind:
        route.advance()
    return route


def test_a_route_ends_after_its_last_leg_and_can_be_rewound():
    route = at(LegKind.STOW)
    assert route.number == len(route.legs) == 13
    route.advance()
    assert (route.leg, route.number) == (None, 0)
    route.rewind()
    assert route.number == 1


def test_a_standing_rover_starts_with_the_first_leg_on_the_floor():
    route = Route(PLAN)
    route.begin(on_floor=True)
    assert route.leg is not None
    assert route.leg.kind is LegKind.VISIT


def test_a_standing_rover_of_a_plan_without_a_landing_returns():
    route = Route(replace(PLAN, landing=None, survey=()))
    route.begin(on_floor=True)
    assert [leg.kind.value for leg in route.legs] == ["return", "lift", "ascend", "stow"]
    assert route.number == 1


def test_without_a_landing_the_next_leg_is_the_ascent():
    route = at(LegKind.LAND)
    route.advance()
    route.leave_floor()
    assert route.leg is not None
    assert route.leg.kind is LegKind.ASCEND


def test_a_recovery_precedes_the_leg_that_needs_it():
    route = at(LegKind.VISIT)
    number = route.number
    route.insert_recovery()
    assert route.number == number
    assert [leg.kind.value for leg in route.legs[number - 1 : number + 5]] == [
        "lift", "land", "lift", "damp", "land", "visit",
    ]  # fmt: skip


def test_a_recovery_before_the_lift_sets_the_rover_down():
    route = at(LegKind.LIFT)
    number = route.number
    route.insert_recovery()
    assert [leg.kind.value for leg in route.legs[number - 1 : number + 3]] == [
        "lift", "land", "lift", "ascend",
    ]  # fmt: skip


def test_recoveries_are_counted_for_the_leg_that_needs_them():
    route = at(LegKind.VISIT)
    for count in range(3):
        assert route.recoveries == count
        route.insert_recovery()
        for _ in recovery_legs(PLAN, 1, LegKind.VISIT):
            route.advance()
    assert (route.recoveries, len(set(names(route)))) == (3, len(names(route)))
    route.advance()
    assert route.recoveries == 0
    route.insert_recovery()
    for _ in recovery_legs(PLAN, 1, LegKind.VISIT):
        route.advance()
    assert (route.recoveries, len(set(names(route)))) == (1, len(names(route)))


@pytest.mark.parametrize("home", [None, True, False])
def test_a_route_resumes_from_its_checkpoint(home: bool | None):
    route = at(LegKind.VISIT)
    if home is None:
        route.insert_recovery()
    else:
        route.begin_home(on_floor=home)
    route.advance()
    assert_resumes(route)


def test_a_route_with_a_recovery_on_the_return_resumes_from_its_checkpoint():
    route = at(LegKind.VISIT)
    route.insert_recovery()
    while route.leg is not None and route.leg.name != "lift off":
        route.advance()
    route.insert_recovery()
    route.advance()
    assert_resumes(route)


@pytest.mark.parametrize(("leg", "recoveries"), [(13, []), (-1, []), (7, [13])])
def test_a_checkpoint_with_a_leg_that_the_route_does_not_have_is_refused(
    leg: int, recoveries: list[int]
):
    with pytest.raises(ValueError, match=r"must be within 0 \.\. 12"):
        Route(PLAN).restore({"home": None, "recoveries": recoveries, "leg": leg})


def assert_resumes(route: Route) -> None:
    other = Route(PLAN)
    other.restore(route.checkpoint())
    assert names(other) == names(route)
    assert (other.number, other.recoveries) == (route.number, route.recoveries)
