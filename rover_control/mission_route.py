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
    CALM = "calm"
    LAND = "land"
    VISIT = "visit"
    HOP = "hop"
    RETURN = "return"
    LIFT = "lift"
    ASCEND = "ascend"
    STOW = "stow"

    @property
    def is_on_floor(self) -> bool:
        """Whether the rover stands when it begins."""
        return self in (LegKind.VISIT, LegKind.HOP, LegKind.RETURN, LegKind.LIFT)


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
    return (*_way_down(plan), *way_home(plan, stands=plan.landing is not None))


def way_home(plan: MissionPlan, *, stands: bool) -> tuple[Leg, ...]:
    """The legs that lead back to the stow, from the floor or from where the rover hangs."""
    up = (
        Leg(LegKind.ASCEND, f"ascend to {plan.stow:g} m", depth=plan.stow),
        Leg(LegKind.STOW, "stow"),
    )
    if not stands:
        return up
    back = (Leg(LegKind.RETURN, "return", x=0.0, y=0.0), Leg(LegKind.LIFT, "lift off"))
    return (*back, *up)


def rescue(plan: MissionPlan, number: int) -> tuple[Leg, ...]:
    """The legs that take the rover off the floor and set it down below the fairlead.

    Args:
        plan: one with a landing.
        number: of the rescue, from 1.
    """
    landing = plan.landing
    assert landing is not None
    name = f"rescue {number}: "
    return (
        Leg(LegKind.LIFT, name + "lift off"),
        Leg(LegKind.CALM, f"{name}calm at {landing.approach:g} m", depth=landing.approach),
        Leg(LegKind.LAND, name + "land", depth=landing.deepest),
    )


def _way_down(plan: MissionPlan) -> Iterator[Leg]:
    for look in plan.looks:
        at = f"look from {look.depth:g} m"
        yield Leg(LegKind.LOOK, at, depth=look.depth)
        for turn in look.turns:
            yield Leg(LegKind.TURN, f"turn by {turn:g} deg", angle=math.radians(turn))
            yield Leg(LegKind.LOOK, f"{at} after {turn:g} deg", depth=look.depth)
    landing = plan.landing
    if landing is None:
        return
    depth = landing.approach
    yield Leg(LegKind.APPROACH, f"approach to {depth:g} m", depth=depth)
    yield Leg(LegKind.LAND, "land", depth=landing.deepest)
    for number, point in enumerate(plan.survey, 1):
        heading = math.nan if point.heading is None else math.radians(point.heading)
        name = f"waypoint {number} at ({point.x:g}, {point.y:g}) m"
        yield Leg(LegKind.VISIT, name, x=point.x, y=point.y, heading=heading)
        if point.hop is not None:
            yield Leg(LegKind.HOP, f"hop at waypoint {number}", height=point.hop)


class Route:
    """The legs of one mission, or of its way home, and how far it is.

    Args:
        plan: of the mission.

    Attributes:
        legs: all, in their order; rescues are put in as they become necessary.
    """

    def __init__(self, plan: MissionPlan) -> None:
        self.plan = plan
        self.legs = itinerary(plan)
        self._index = 0
        self._home: bool | None = None  # whether the way home began on the floor; None: no way home
        self._rescues: list[int] = []  # where in `legs` they were put in

    @property
    def leg(self) -> Leg | None:
        """The leg that is done or comes next; None = none is left."""
        return self.legs[self._index] if self._index < len(self.legs) else None

    @property
    def number(self) -> int:
        """Of the leg, from 1; 0 where none is left."""
        return self._index + 1 if self.leg is not None else 0

    @property
    def rescues(self) -> int:
        """How many were put in."""
        return len(self._rescues)

    def begin(self, *, stands: bool) -> None:
        """The whole mission; of a rover that stands already from its first leg on the floor."""
        self.legs = itinerary(self.plan)
        on_floor = [leg.kind.is_on_floor for leg in self.legs]
        self._index = on_floor.index(True) if stands and True in on_floor else 0
        self._home, self._rescues = None, []

    def begin_home(self, *, stands: bool) -> None:
        """The way home."""
        self.legs = way_home(self.plan, stands=stands)
        self._index, self._home, self._rescues = 0, stands, []

    def rewind(self) -> None:
        """The mission is over; what comes next would be its first leg."""
        self._index, self._home = 0, None

    def go_on(self) -> None:
        """To the next leg."""
        self._index += 1

    def leave_floor(self) -> None:
        """Past all that is done on the floor."""
        while self.legs[self._index].kind.is_on_floor:
            self._index += 1

    def put_rescue(self) -> None:
        """Put a rescue before the present leg of a mission that lands."""
        self._put_rescue(self._index)

    def _put_rescue(self, index: int) -> None:
        self._rescues.append(index)
        legs = rescue(self.plan, len(self._rescues))
        self.legs = (*self.legs[:index], *legs, *self.legs[index:])

    def checkpoint(self) -> dict[str, Any]:
        """How far it is, as JSON values."""
        return {"home": self._home, "rescues": list(self._rescues), "leg": self._index}

    def restore(self, kept: Mapping[str, Any]) -> None:
        """Go on from a checkpoint of the same plan."""
        if kept["home"] is None:
            self.begin(stands=False)
        else:
            self.begin_home(stands=kept["home"])
        for index in kept["rescues"]:
            self._put_rescue(int(index))
        self._index = int(kept["leg"])
