"""What of the machine can be sought in a recorded run, and scenarios with other values of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

from rover_bags.files.store import BagError
from rover_sim import SpatialScenario


class IdentifyError(BagError):
    """Bags from which nothing can be identified; the text says why."""


@dataclass(frozen=True)
class Sought:
    """A parameter of the machine that can be sought.

    Attributes:
        unit: of its value.
        about: what it is.
        path: in the scenario, dotted; a number at the end is a place in a vector.
        along: paths whose values change by the same factor.
    """

    unit: str
    about: str
    path: str
    along: tuple[str, ...] = ()


_LEFT: Final = "rover.wheel_drive.left_friction"
PARAMETERS: Final[Mapping[str, Sought]] = MappingProxyType(
    {
        "EA": Sought("N", "axial stiffness of the tether", "tether.axial_stiffness"),
        "EI": Sought("N m^2", "bending stiffness of the tether", "tether.bending_stiffness"),
        "axial_damping": Sought("s", "axial damping time", "tether.axial_damping_time"),
        "bending_damping": Sought("s", "bending damping time", "tether.bending_damping_time"),
        "twist_stiffness": Sought("N m^2", "GJ of the tether", "tether.twist_stiffness"),
        "swivel_friction": Sought("N m", "friction of the swivel", "tether.swivel_friction"),
        "wheel_friction": Sought(
            "N m", "dry friction of the left wheel with the gears", f"{_LEFT}.coulomb",
            (f"{_LEFT}.breakaway",),
        ),
        "wheel_drag": Sought("N m s", "viscous friction of the same", f"{_LEFT}.viscous"),
        "inertia_x": Sought("kg m^2", "Body 1 about x", "rover.inertia1.0"),
        "inertia_y": Sought("kg m^2", "Body 1 about y", "rover.inertia1.1"),
        "inertia_z": Sought("kg m^2", "Body 1 about z", "rover.inertia1.2"),
    }
)  # fmt: skip
"""By name. All of them are above 0, and sought as their logarithms."""


def with_stiffness(scenario: SpatialScenario) -> SpatialScenario:
    """The same scenario, its tether's section given by its stiffnesses."""
    section = scenario.tether.section
    given = dict.fromkeys(("youngs_modulus", "radius", "area", "second_moment", "density"))
    return scenario.with_overrides(
        {
            **{f"tether.{name}": value for name, value in given.items()},
            "tether.axial_stiffness": section.axial_stiffness,
            "tether.bending_stiffness": section.bending_stiffness,
            "tether.line_density": section.line_density,
        }
    )


def value_of(scenario: SpatialScenario, name: str) -> float | None:
    """The value of one of `PARAMETERS`, None where there is none that could be sought."""
    return _sought(scenario.to_mapping(), name)


def with_values(scenario: SpatialScenario, values: Mapping[str, float]) -> SpatialScenario:
    """A scenario with other values of the named parameters.

    Args:
        scenario: its tether given by stiffnesses (see :func:`with_stiffness`).
        values: by the names of `PARAMETERS`.

    Raises:
        IdentifyError: the scenario has no such parameter.
        ScenarioError: it refuses the value.
    """
    mapping = scenario.to_mapping()
    for name, value in values.items():
        sought = PARAMETERS[name]
        before = _sought(mapping, name)
        if before is None:
            raise IdentifyError(f"{scenario.name} has no {name} ({sought.path}) that can be sought")
        for path in (sought.path, *sought.along):
            own = _at(mapping, path)
            _put(mapping, path, value * (0.0 if own is None else own) / before)
    return SpatialScenario.from_mapping(mapping)


def without_errors(scenario: SpatialScenario) -> SpatialScenario:
    """The scenario with sensors that only delay and saturate."""
    mapping = scenario.to_mapping()
    for channel in [*mapping["sensors"].values(), mapping["sensors"]["camera"]["range_finder"]]:
        if isinstance(channel, dict) and "noise_density" in channel:
            channel.update(noise_density=0.0, bias=0.0, bias_walk=0.0, resolution=0.0)
    return SpatialScenario.from_mapping(mapping)


def _sought(mapping: Mapping[str, Any], name: str) -> float | None:
    """The value of one of `PARAMETERS`, None where there is none that could be sought."""
    value = _at(mapping, PARAMETERS[name].path)
    return value if value is not None and 0.0 < value < math.inf else None


def _at(mapping: Mapping[str, Any], path: str) -> float | None:
    node: Any = mapping
    for name in path.split("."):
        if isinstance(node, list) and name.isdigit():
            node = node[int(name)]
        elif isinstance(node, Mapping):
            node = node.get(name)
        else:
            return None
    return float(node) if isinstance(node, int | float) else None


def _put(mapping: dict[str, Any], path: str, value: float) -> None:
    *parents, last = path.split(".")
    node: Any = mapping
    for name in parents:
        node = node[name]
    node[int(last) if isinstance(node, list) else last] = value
