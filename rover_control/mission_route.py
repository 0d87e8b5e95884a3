"""The legs of a mission: what is made of its plan, and which of them comes next. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from rover_control.mission_plan import MissionPlan


class LegKind(StrEnum):
    """What a leg of the mission does."""

    LOOK = "look"
    TURN = "turn"
    APPROACH = "approach"
    DAMP = "damp"
    LAND = "land"
    VISIT = "visit"
    JUMP = "jump"
    RETURN = "return"
    LIFT = "lift"
    ASCEND = "ascend"
    STOW = "stow"

    @property
    def is_on_floor(self) -> bool:
        """Whether the rover stands when it begins."""
        return self in (LegKind.VISIT, LegKind.JUMP, LegKind.RETURN, LegKind.LIFT)


@dataclass(frozen=True)
class Leg:
    """One leg of a mission.

    Attributes:
        depth: that it leads to, as length at the drum [m].
        angle: to turn by [rad].
        x, y, heading: where it leads to on the floor [m, rad]; a heading of NaN is left open.
        height: of a jump [m].
    """

    kind: LegKind
    name: str
    depth: float = math.nan
    angle: float = math.nan
    x: float = math.nan
    y: float = math.nan
    heading: float = math.nan
    height: float = math.nan


def itinerary(plan: MissionPlan) -> tuple[Leg, ...]:
    """The legs of a mission, in their order."""
    return (*_outbound_legs(plan), *homeward_legs(plan, on_floor=plan.landing is not None))


def homeward_legs(plan: MissionPlan, *, on_floor: bool) -> tuple[Leg, ...]:
    """The legs that lead back to the stow, from the floor or from where the rover hangs."""
    up = (
        Leg(LegKind.ASCEND, f"ascend to {plan.stow:g} m", depth=plan.stow),
        Leg(LegKind.STOW, "stow"),
    )
    if not on_floor:
        return up
    back = (Leg(LegKind.RETURN, "return", x=0.0, y=0.0), Leg(LegKind.LIFT, "lift off"))
    return (*back, *up)


def recovery_legs(plan: MissionPlan, number: int) -> tuple[Leg, ...]:
    """The legs that take the rover off the floor and set it down below the fairlead.

    Args:
        plan: one with a landing.
        number: of the rescue, from 1.
    """
    landing = plan.landing
    assert landing is not None
    name = f"recovery {number}: "
    return (
        Leg(LegKind.LIFT, name + "lift off"),
        Leg(
            LegKind.DAMP,
            f"{name}damp swing at {landing.approach_depth:g} m",
            depth=landing.approach_depth,
        ),
        Leg(LegKind.LAND, name + "land", depth=landing.max_depth),
    )


def _outbound_legs(plan: MissionPlan) -> Iterator[Leg]:
    for look in plan.looks:
        at = f"look from {look.depth:g} m"
        yield Leg(LegKind.LOOK, at, depth=look.depth)
        for turn in look.turns:
            yield Leg(LegKind.TURN, f"turn by {turn:g} deg", angle=math.radians(turn))
            yield Leg(LegKind.LOOK, f"{at} after {turn:g} deg", depth=look.depth)
    landing = plan.landing
    if landing is None:
        return
    depth = landing.approach_depth
    yield Leg(LegKind.APPROACH, f"approach to {depth:g} m", depth=depth)
    yield Leg(LegKind.LAND, "land", depth=landing.max_depth)
    for number, point in enumerate(plan.survey, 1):
        heading = math.nan if point.heading is None else math.radians(point.heading)
        name = f"waypoint {number} at ({point.x:g}, {point.y:g}) m"
        yield Leg(LegKind.VISIT, name, x=point.x, y=point.y, heading=heading)
        if point.jump_height is not None:
            yield Leg(LegKind.JUMP, f"jump at waypoint {number}", height=point.jump_height)


class Route:
    """The legs of one mission, or of its way home, and how far it is.

    Args:
        plan: of the mission.

    Attributes:
        legs: all, in their order; recoveries are put in as they become necessary.
    """

    def __init__(self, plan: MissionPlan) -> None:
        self.plan = plan
        self.legs = itinerary(plan)
        self._index = 0
        self._home: bool | None = None  # whether the way home began on the floor; None: no way home
        self._recoveries: list[int] = []  # where in `legs` they were put in

    @property
    def leg(self) -> Leg | None:
        """The leg that is done or comes next; None = none is left."""
        return self.legs[self._index] if self._index < len(self.legs) else None

    @property
    def number(self) -> int:
        """Of the leg, from 1; 0 where none is left."""
        return self._index + 1 if self.leg is not None else 0

    @property
    def recoveries(self) -> int:
        """How many were put in."""
        return len(self._recoveries)

    def begin(self, *, on_floor: bool) -> None:
        """The whole mission; of a rover that stands already from its first leg on the floor."""
        self.legs = itinerary(self.plan)
        floor_legs = [leg.kind.is_on_floor for leg in self.legs]
        self._index = floor_legs.index(True) if on_floor and True in floor_legs else 0
        self._home, self._recoveries = None, []

    def begin_home(self, *, on_floor: bool) -> None:
        """The way home."""
        self.legs = homeward_legs(self.plan, on_floor=on_floor)
        self._index, self._home, self._recoveries = 0, on_floor, []

    def rewind(self) -> None:
        """The mission is over; what comes next would be its first leg."""
        self._index, self._home = 0, None

    def advance(self) -> None:
        """To the next leg."""
        self._index += 1

    def leave_floor(self) -> None:
        """Past all that is done on the floor."""
        while self.legs[self._index].kind.is_on_floor:
            self._index += 1

    def insert_recovery(self) -> None:
        """Put a rescue before the present leg of a mission that lands."""
        self._insert_recovery(self._index)

    def _insert_recovery(self, index: int) -> None:
        self._recoveries.append(index)
        legs = recovery_legs(self.plan, len(self._recoveries))
        self.legs = (*self.legs[:index], *legs, *self.legs[index:])

    def checkpoint(self) -> dict[str, Any]:
        """How far it is, as JSON values."""
        return {"home": self._home, "recoveries": list(self._recoveries), "leg": self._index}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Go on from a checkpoint of the same plan."""
        if saved["home"] is None:
            self.begin(on_floor=False)
        else:
            self.begin_home(on_floor=saved["home"])
        for index in saved["recoveries"]:
            self._insert_recovery(int(index))
        self._index = int(saved["leg"])
