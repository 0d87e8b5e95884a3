"""Route of a mission: the legs derived from its plan, and the present one. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from rover_control.mission.mission_plan import MissionPlan


class LegKind(StrEnum):
    """Kind of a leg."""

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
        """Whether the leg begins on the floor."""
        return self in (LegKind.VISIT, LegKind.JUMP, LegKind.RETURN, LegKind.LIFT)


@dataclass(frozen=True)
class Leg:
    """One leg of a mission.

    Attributes:
        depth: destination, as tether length at the drum [m].
        angle: of a turn [rad].
        x, y, heading: destination on the floor in map [m, rad]; heading NaN = any.
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
    """All legs of a mission, in order."""
    return (*_outbound_legs(plan), *homeward_legs(plan, on_floor=plan.landing is not None))


def homeward_legs(plan: MissionPlan, *, on_floor: bool) -> tuple[Leg, ...]:
    """The legs back to the stow, from the floor or from a hanging position."""
    up = (
        Leg(LegKind.ASCEND, f"ascend to {plan.stow:g} m", depth=plan.stow),
        Leg(LegKind.STOW, "stow"),
    )
    if not on_floor:
        return up
    back = (Leg(LegKind.RETURN, "return", x=0.0, y=0.0), Leg(LegKind.LIFT, "lift off"))
    return (*back, *up)


def recovery_legs(plan: MissionPlan, number: int, before: LegKind) -> tuple[Leg, ...]:
    """The legs that lift the rover off the floor and set it down below the fairlead.

    A hauled rover leaves the floor on a cone, which the winch cannot damp, and the rotors only
    slowly. The first landing stops it; after the second lift the rover swings in a plane.

    Args:
        plan: a plan with a landing.
        number: of the recovery, from 1.
        before: kind of the leg that follows; if it lifts the rover, it is the second lift.
    """
    landing = plan.landing
    assert landing is not None
    name = f"recovery {number}: "
    depth = landing.approach_depth
    set_down = (
        Leg(LegKind.LIFT, name + "lift off"),
        Leg(LegKind.LAND, name + "set down", depth=landing.max_depth),
    )
    if before is LegKind.LIFT:
        return set_down
    return (
        *set_down,
        Leg(LegKind.LIFT, name + "lift off again"),
        Leg(LegKind.DAMP, f"{name}damp swing at {depth:g} m", depth=depth),
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
    """Legs of a mission or of its return, and the progress along them.

    Args:
        plan: of the mission.

    Attributes:
        legs: all legs in order; recoveries are inserted when needed.
    """

    def __init__(self, plan: MissionPlan) -> None:
        self.plan = plan
        self.legs = itinerary(plan)
        self._index = 0
        self._home: bool | None = None  # whether the return began on the floor; None: no return
        self._recoveries: list[int] = []  # their indices in `legs`

    @property
    def leg(self) -> Leg | None:
        """The active or next leg; None = no leg remains."""
        return self.legs[self._index] if self._index < len(self.legs) else None

    @property
    def number(self) -> int:
        """Number of the leg, from 1; 0 = no leg remains."""
        return self._index + 1 if self.leg is not None else 0

    @property
    def recoveries(self) -> int:
        """Number of recoveries directly before the present leg: those that it has needed."""
        if self.leg is None:
            return 0
        index, count = self._index, 0
        for begin in reversed(self._recoveries):
            if begin + len(recovery_legs(self.plan, 1, self.leg.kind)) != index:
                break
            index, count = begin, count + 1
        return count

    def begin(self, *, on_floor: bool) -> None:
        """Start the whole mission; a standing rover starts with the first leg on the floor.

        Where the plan has none, that is the return.
        """
        if on_floor and self.plan.landing is None:
            self.begin_home(on_floor=True)
            return
        self.legs = itinerary(self.plan)
        self._index = [leg.kind.is_on_floor for leg in self.legs].index(True) if on_floor else 0
        self._home, self._recoveries = None, []

    def begin_home(self, *, on_floor: bool) -> None:
        """Start the return."""
        self.legs = homeward_legs(self.plan, on_floor=on_floor)
        self._index, self._home, self._recoveries = 0, on_floor, []

    def rewind(self) -> None:
        """Reset to the first leg after the end of the mission."""
        self._index, self._home = 0, None

    def advance(self) -> None:
        """Go on to the next leg."""
        self._index += 1

    def back_to_lift(self) -> bool:
        """Go back to the lift that precedes the present leg; False if none does."""
        follows = self._index > 0 and self.legs[self._index - 1].kind is LegKind.LIFT
        self._index -= follows
        return follows

    def leave_floor(self) -> None:
        """Skip the legs on the floor."""
        while self.legs[self._index].kind.is_on_floor:
            self._index += 1

    def insert_recovery(self) -> None:
        """Insert a recovery before the present leg of a mission with a landing."""
        self._insert_recovery(self._index)

    def _insert_recovery(self, index: int) -> None:
        self._recoveries.append(index)
        legs = recovery_legs(self.plan, len(self._recoveries), self.legs[index].kind)
        self.legs = (*self.legs[:index], *legs, *self.legs[index:])

    def checkpoint(self) -> dict[str, Any]:
        """Progress as JSON values."""
        return {"home": self._home, "recoveries": list(self._recoveries), "leg": self._index}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Resume from a checkpoint of the same plan.

        Raises:
            ValueError: it names a leg that the route does not have.
        """
        if saved["home"] is None:
            self.begin(on_floor=False)
        else:
            self.begin_home(on_floor=saved["home"])
        for index in saved["recoveries"]:
            self._insert_recovery(self._checked(index))
        self._index = self._checked(saved["leg"])

    def _checked(self, index: Any) -> int:
        """An index of a leg from a checkpoint.

        Raises:
            ValueError: the route has no such leg.
        """
        if not 0 <= int(index) < len(self.legs):
            right = f"must be within 0 .. {len(self.legs) - 1}"
            raise ValueError(f"the index of a leg is {index!r}, it {right}")
        return int(index)
