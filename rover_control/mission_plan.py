# ruff: noqa: RUF009 - the helpers that the fields call return dataclass fields
"""A mission as it is planned: depths to look from, where to land, what to visit. Pure.

A plan is a YAML file, judged before anything moves; `mission_route` makes the mission's legs of it.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from msg_schemas.configuration import (
    Configuration,
    ConfigurationError,
    quantity,
    read_by,
    section,
    sections,
    text,
    to_mapping,
)
from msg_schemas.machine import MAX_JUMP_HEIGHT, MAX_LENGTH, MAX_SLACK, MAX_STROKE
from msg_schemas.shipped import ShippedError, names_in, read_named

SHIPPED = Path(__file__).parent / "missions"
"""Where the plans of the package lie."""


class PlanError(ValueError):
    """A plan that cannot be followed: which file, key and value, and what would be right."""


def _read_turns(value: object, path: str) -> tuple[float, ...]:
    if not isinstance(value, list | tuple):
        raise ConfigurationError(path, value, "should be a list of angles")
    for index, angle in enumerate(value):
        is_number = isinstance(angle, int | float) and not isinstance(angle, bool)
        if not is_number or not 0.0 < abs(angle) <= 180.0:
            right = "should be a number from -180 to 180 deg, and not 0"
            raise ConfigurationError(f"{path}[{index}]", angle, right)
    return tuple(float(angle) for angle in value)


def _turns(about: str) -> Any:
    return read_by(_read_turns, (tuple,), about, ())


@dataclass(frozen=True, kw_only=True)
class Look(Configuration):
    """A depth at which pictures of the wall are taken."""

    depth: float = quantity("m", "length at the drum", above=0.0, maximum=MAX_LENGTH)
    turns: tuple[float, ...] = _turns(
        "angles [deg] to turn by about the plumb line, each with pictures after it"
    )


@dataclass(frozen=True, kw_only=True)
class Landing(Configuration):
    """How the rover is set down below the fairlead."""

    approach: float = quantity(
        "m", "depth at which the swing is taken away before", above=0.0, maximum=MAX_LENGTH
    )
    deepest: float = quantity(
        "m", "length by which the floor must have been touched", above=0.0, maximum=MAX_LENGTH
    )
    rate: float = quantity("m/s", "payout rate on the way", 0.05, minimum=0.01, maximum=0.2)


@dataclass(frozen=True, kw_only=True)
class Waypoint(Configuration):
    """A place to visit, in map; the plumb line of the fairlead is at (0, 0)."""

    x: float = quantity("m", "of base_link", minimum=-MAX_LENGTH, maximum=MAX_LENGTH)
    y: float = quantity("m", "of base_link", minimum=-MAX_LENGTH, maximum=MAX_LENGTH)
    heading: float | None = quantity(
        "deg", "of base_link's x there; left out: any", None, minimum=-180.0, maximum=180.0,
        optional=True,
    )  # fmt: skip
    hop: float | None = quantity(
        "m", "rise of a jump there, to see over the rubble; left out: none", None, above=0.0,
        maximum=MAX_JUMP_HEIGHT, optional=True,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Jumps(Configuration):
    """How a rover that is stuck gets on."""

    most: int = quantity(
        "-", "jumps on the way to one waypoint; 0: none", 2, kind=int, minimum=0, maximum=20
    )
    detours: int = quantity(
        "-", "ways around by wheels, on the way to one waypoint", 2, kind=int, minimum=0,
        maximum=20,
    )  # fmt: skip
    stroke: float = quantity(
        "m", "of the spring, for a jump that was not predicted", 0.12, minimum=0.01,
        maximum=MAX_STROKE,
    )  # fmt: skip
    clearance: float = quantity(
        "m", "rise that a predicted jump is to reach", 0.2, minimum=0.01, maximum=MAX_JUMP_HEIGHT
    )
    slack: float = quantity("m", "that the winch gives before", 0.8, minimum=0.1, maximum=MAX_SLACK)


@dataclass(frozen=True, kw_only=True)
class Lift(Configuration):
    """How the rover is taken off the floor."""

    height: float = quantity("m", "above where it stood", 0.8, minimum=0.2, maximum=10.0)
    rate: float = quantity("m/s", "at which the tether is reeled in", 0.05, minimum=0.01,
                           maximum=0.2)  # fmt: skip
    alone: float = quantity(
        "m", "length up to which the last trial of an ascent is the winch's alone; 0: never", 10.0,
        minimum=0.0, maximum=MAX_LENGTH,
    )  # fmt: skip
    radius: float = quantity(
        "m", "from the plumb line within which it may be lifted", 0.8, minimum=0.1, maximum=20.0
    )


@dataclass(frozen=True, kw_only=True)
class Rescue(Configuration):
    """How a rover that cannot go on, or lies on its side, is taken below the fairlead.

    The winch hauls it over the floor and up by the tether, which sets it upright, too.
    """

    most: int = quantity(
        "-", "times in a mission that it is taken up and set down again; 0: never", 2, kind=int,
        minimum=0, maximum=20,
    )  # fmt: skip
    radius: float = quantity(
        "m", "from the plumb line within which it may be hauled; it swings about as wide", 3.0,
        minimum=0.1, maximum=20.0,
    )  # fmt: skip
    rate: float = quantity(
        "m/s", "at which the tether is reeled in", 0.05, minimum=0.01, maximum=0.2
    )


@dataclass(frozen=True, kw_only=True)
class MissionPlan(Configuration):
    """A whole mission, from the stow below the fairlead to the floor and back."""

    about: str = text("what it is for, in a sentence or two", "")
    heading: float = quantity(
        "deg", "of base_link's x in map where the mission begins", 0.0, minimum=-180.0,
        maximum=180.0,
    )  # fmt: skip
    stow: float = quantity(
        "m", "depth at which the rover is stowed", 2.0, above=0.0, maximum=MAX_LENGTH
    )
    looks: tuple[Look, ...] = sections(Look, "a list of depths to look from, downward", ())
    landing: Landing | None = section(
        Landing, "where the floor is; null: the mission does not land", None, optional=True
    )
    survey: tuple[Waypoint, ...] = sections(Waypoint, "a list of waypoints on the floor", ())
    jumps: Jumps = section(Jumps, "for a rover that is stuck", Jumps())
    lift: Lift = section(Lift, "off the floor", Lift())
    rescue: Rescue = section(Rescue, "of a rover that cannot go on", Rescue())

    def check(self) -> None:
        """Refuse what no single key can show."""
        above = self.stow
        for index, look in enumerate(self.looks):
            if look.depth < above:
                right = f"should not lie above what comes before it, {above:g} m"
                raise ConfigurationError(f"looks[{index}].depth", look.depth, right)
            above = look.depth
        landing = self.landing
        if landing is None:
            if self.survey:
                right = "a mission that does not land has none; should have a landing as well"
                raise ConfigurationError("survey", f"{len(self.survey)} waypoints", right)
            return
        if landing.approach < above:
            right = f"should not lie above what comes before it, {above:g} m"
            raise ConfigurationError("landing.approach", landing.approach, right)
        if landing.deepest <= landing.approach:
            right = f"should lie below the approach, {landing.approach:g} m"
            raise ConfigurationError("landing.deepest", landing.deepest, right)
        if landing.approach - self.lift.height < self.stow:
            right = f"should leave the rover below the stow, {self.stow:g} m"
            raise ConfigurationError("lift.height", self.lift.height, right)

    @property
    def digest(self) -> str:
        """Tells one plan from another."""
        content = json.dumps(to_mapping(self), sort_keys=True)
        return hashlib.sha256(content.encode()).hexdigest()[:16]


def shipped() -> list[str]:
    """Names of the package's own plans."""
    return names_in(SHIPPED)


def load_plan(name_or_path: str) -> MissionPlan:
    """Read a plan: one of the package by its name, or a file by its path.

    Raises:
        PlanError: it cannot be read, or something in it is not as it should be.
    """
    try:
        return read_named(MissionPlan, name_or_path, SHIPPED, "mission")[1]
    except ShippedError as error:
        raise PlanError(str(error)) from None
