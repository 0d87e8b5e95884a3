# ruff: noqa: RUF009 - the helpers that the fields call return dataclass fields
"""Mission plans: observation depths, landing, survey and return, read from YAML. Pure.

A plan is validated before anything moves; `mission_route` derives the legs from it.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from msg_schemas import machine
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
from msg_schemas.shipped import read_named, shipped_names

SHIPPED = Path(__file__).parent / "plans"
"""Folder of the shipped plans."""


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
    """A depth at which the camera takes pictures of the wall."""

    depth: float = quantity("m", "tether length at the drum", above=0.0, maximum=machine.MAX_LENGTH)
    turns: tuple[float, ...] = _turns("turns [deg] about the plumb line, with pictures after each")


@dataclass(frozen=True, kw_only=True)
class Landing(Configuration):
    """Landing below the fairlead."""

    approach_depth: float = quantity(
        "m",
        "depth at which the swing is damped before the landing",
        above=0.0,
        maximum=machine.MAX_LENGTH,
    )
    max_depth: float = quantity(
        "m", "tether length at which the landing fails without touchdown", above=0.0,
        maximum=machine.MAX_LENGTH,
    )  # fmt: skip
    rate: float = quantity(
        "m/s", "payout rate from the approach depth on", 0.05, minimum=0.01, maximum=0.2
    )


@dataclass(frozen=True, kw_only=True)
class Waypoint(Configuration):
    """A place to visit, in map; the plumb line of the fairlead is at (0, 0)."""

    x: float = quantity(
        "m", "position of base_link", minimum=-machine.MAX_LENGTH, maximum=machine.MAX_LENGTH
    )
    y: float = quantity(
        "m", "position of base_link", minimum=-machine.MAX_LENGTH, maximum=machine.MAX_LENGTH
    )
    heading: float | None = quantity(
        "deg", "heading of base_link x at the waypoint; omitted: any", None, minimum=-180.0,
        maximum=180.0, optional=True,
    )  # fmt: skip
    jump_height: float | None = quantity(
        "m", "height of a jump at the waypoint, for a view over the rubble; omitted: no jump",
        None, minimum=0.01, maximum=machine.MAX_JUMP_HEIGHT, optional=True,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Jumps(Configuration):
    """Detours and jumps of a stuck rover."""

    max_jumps: int = quantity(
        "-", "largest number of jumps on the way to one waypoint", 2, kind=int, minimum=0,
        maximum=20,
    )  # fmt: skip
    max_detours: int = quantity(
        "-", "largest number of detours on the way to one waypoint", 2, kind=int, minimum=0,
        maximum=20,
    )  # fmt: skip
    stroke: float = quantity(
        "m", "spring compression of a jump without prediction", 0.12, minimum=0.01,
        maximum=machine.MAX_STROKE,
    )  # fmt: skip
    clearance: float = quantity(
        "m", "clearance of a predicted jump", 0.2, minimum=0.01, maximum=machine.MAX_JUMP_HEIGHT
    )
    slack: float = quantity(
        "m", "slack that the winch gives before a jump", 0.8, minimum=0.1, maximum=machine.MAX_SLACK
    )


@dataclass(frozen=True, kw_only=True)
class Lift(Configuration):
    """Lift-off from the floor."""

    height: float = quantity("m", "height above the floor", 0.8, minimum=0.2, maximum=10.0)
    rate: float = quantity("m/s", "reel-in rate", 0.05, minimum=0.01, maximum=0.2)
    winch_only_length: float = quantity(
        "m", "tether length up to which the winch alone does the last trial of an ascent; 0: never",
        10.0, minimum=0.0, maximum=machine.MAX_LENGTH,
    )  # fmt: skip
    radius: float = quantity(
        "m", "distance from the plumb line within which the rover may be lifted", 0.8, minimum=0.1,
        maximum=20.0,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class RecoveryPlan(Configuration):
    """Recovery of an immobilized or overturned rover by the winch.

    The winch hauls the rover over the floor to below the fairlead and lifts it; the tether also
    sets it upright.
    """

    max_count: int = quantity(
        "-", "largest number of recoveries for each waypoint; 0: none", 2, kind=int, minimum=0,
        maximum=20,
    )  # fmt: skip
    radius: float = quantity(
        "m", "distance from the plumb line within which the rover may be hauled; about the "
        "amplitude of its swing afterwards", 3.0, minimum=0.1, maximum=20.0,
    )  # fmt: skip
    rate: float = quantity("m/s", "reel-in rate while hauling", 0.02, minimum=0.01, maximum=0.2)


@dataclass(frozen=True, kw_only=True)
class MissionPlan(Configuration):
    """A whole mission, from the stow below the fairlead to the floor and back."""

    about: str = text("purpose of the mission, in a sentence or two", "")
    heading: float = quantity(
        "deg", "heading of base_link x in map at the start of the mission", 0.0, minimum=-180.0,
        maximum=180.0,
    )  # fmt: skip
    stow: float = quantity("m", "depth of the stow", 2.0, above=0.0, maximum=machine.MAX_LENGTH)
    looks: tuple[Look, ...] = sections(Look, "observation depths, downward", ())
    landing: Landing | None = section(
        Landing, "landing on the floor; null: no landing", None, optional=True
    )
    survey: tuple[Waypoint, ...] = sections(Waypoint, "waypoints on the floor", ())
    jumps: Jumps = section(Jumps, "detours and jumps of a stuck rover", Jumps())
    lift: Lift = section(Lift, "lift-off from the floor", Lift())
    recovery: RecoveryPlan = section(
        RecoveryPlan, "recovery of an immobilized rover", RecoveryPlan()
    )

    def check(self) -> None:
        """Check keys against each other."""
        above = self.stow
        for index, look in enumerate(self.looks):
            if look.depth < above:
                right = f"should be at least {above:g} m, the depth before it"
                raise ConfigurationError(f"looks[{index}].depth", look.depth, right)
            above = look.depth
        landing = self.landing
        if landing is None:
            if self.survey:
                right = (
                    "a mission without a landing has no waypoints; should have a landing as well"
                )
                raise ConfigurationError("survey", f"{len(self.survey)} waypoints", right)
            return
        if landing.approach_depth < above:
            right = f"should be at least {above:g} m, the depth before it"
            raise ConfigurationError("landing.approach_depth", landing.approach_depth, right)
        if landing.max_depth <= landing.approach_depth:
            right = f"should be more than approach_depth, {landing.approach_depth:g} m"
            raise ConfigurationError("landing.max_depth", landing.max_depth, right)
        if landing.approach_depth - self.lift.height < self.stow:
            most = landing.approach_depth - self.stow
            right = f"should be at most {most:g} m, to stay below the stow"
            raise ConfigurationError("lift.height", self.lift.height, right)

    @property
    def digest(self) -> str:
        """Hash of the content; identifies the plan of a checkpoint."""
        content = json.dumps(to_mapping(self), sort_keys=True)
        return hashlib.sha256(content.encode()).hexdigest()[:16]


def shipped() -> list[str]:
    """Names of the shipped plans."""
    return shipped_names(SHIPPED)


def load_plan(name_or_path: str) -> MissionPlan:
    """Read a shipped plan by its name, or a file by its path.

    Raises:
        ShippedError: the file cannot be read or is invalid.
    """
    return read_named(MissionPlan, name_or_path, SHIPPED, "mission")[1]
