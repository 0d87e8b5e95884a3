"""Parameters of the machine that can be estimated, and scenarios with changed values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

from rover_bags.files.store import BagError
from rover_sim import SpatialScenario


class IdentifyError(BagError):
    """Bags or requests that cannot be identified; the message states the reason."""


@dataclass(frozen=True)
class ParameterSpec:
    """A parameter of the machine that can be estimated.

    Attributes:
        unit: unit of its value.
        about: description.
        path: dotted path in the scenario; a number at the end is an index into a vector.
        along: paths whose values are scaled by the same factor.
    """

    unit: str
    about: str
    path: str
    along: tuple[str, ...] = ()


_LEFT: Final = "rover.wheel_drive.left_friction"
PARAMETERS: Final[Mapping[str, ParameterSpec]] = MappingProxyType(
    {
        "EA": ParameterSpec("N", "axial stiffness of the tether", "tether.axial_stiffness"),
        "EI": ParameterSpec(
            "N m^2", "bending stiffness of the tether", "tether.bending_stiffness",
        ),
        "axial_damping": ParameterSpec("s", "axial damping time", "tether.axial_damping_time"),
        "bending_damping": ParameterSpec(
            "s", "bending damping time", "tether.bending_damping_time",
        ),
        "twist_stiffness": ParameterSpec(
            "N m^2", "torsional stiffness (GJ)", "tether.twist_stiffness",
        ),
        "swivel_friction": ParameterSpec("N m", "friction of the swivel", "tether.swivel_friction"),
        "wheel_friction": ParameterSpec(
            "N m", "Coulomb friction of the left wheel", f"{_LEFT}.coulomb",
            (f"{_LEFT}.breakaway",),
        ),
        "wheel_drag": ParameterSpec(
            "N m s", "viscous friction of the left wheel", f"{_LEFT}.viscous",
        ),
        "inertia_x": ParameterSpec("kg m^2", "inertia of Body 1 about x", "rover.inertia1.0"),
        "inertia_y": ParameterSpec("kg m^2", "inertia of Body 1 about y", "rover.inertia1.1"),
        "inertia_z": ParameterSpec("kg m^2", "inertia of Body 1 about z", "rover.inertia1.2"),
    }
)  # fmt: skip
"""Parameters by name. All are positive and estimated as logarithms."""


def with_stiffness(scenario: SpatialScenario) -> SpatialScenario:
    """Return the scenario with the tether's section given by stiffnesses."""
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
    """Return the value of a parameter, or None if it cannot be estimated in this scenario."""
    return _value(scenario.to_mapping(), name)


def with_values(scenario: SpatialScenario, values: Mapping[str, float]) -> SpatialScenario:
    """Return a scenario with other values of the named parameters.

    Args:
        scenario: scenario with its tether given by stiffnesses (see :func:`with_stiffness`).
        values: values by parameter name.

    Raises:
        IdentifyError: the scenario lacks such a parameter.
        ScenarioError: a value is invalid.
    """
    mapping = scenario.to_mapping()
    for name, value in values.items():
        spec = PARAMETERS[name]
        before = _value(mapping, name)
        if before is None:
            raise IdentifyError(
                f"{scenario.name} has no {name} ({spec.path}) that can be estimated"
            )
        for path in (spec.path, *spec.along):
            own = _at(mapping, path)
            _put(mapping, path, value * (0.0 if own is None else own) / before)
    return SpatialScenario.from_mapping(mapping)


def without_errors(scenario: SpatialScenario) -> SpatialScenario:
    """Return the scenario with sensors that only delay and saturate."""
    mapping = scenario.to_mapping()
    for channel in [*mapping["sensors"].values(), mapping["sensors"]["camera"]["range_finder"]]:
        if isinstance(channel, dict) and "noise_density" in channel:
            channel.update(noise_density=0.0, bias=0.0, bias_random_walk=0.0, resolution=0.0)
    return SpatialScenario.from_mapping(mapping)


def _value(mapping: Mapping[str, Any], name: str) -> float | None:
    """Value of a parameter, or None if it is missing, 0 or infinite."""
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
