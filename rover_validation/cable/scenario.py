"""``mother_rover validate cable scenario``: a scenario's tether from an identified cable."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

from rover_sim import MOST_BENT, CableLaws, HeldCable, ScenarioError, scenario_from_mapping
from rover_validation.cable.model import Cable, laws_of, natural_curvature
from rover_validation.refusals import OK, SetError, refusing

_AIR_DENSITY: Final = 1.2
"""Of the air in which the takes are recorded [kg/m3]."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = (
        "Write a scenario with the identified cable as its tether, hanging in air from its root: "
        "stiffness, damping, drag, natural curvature along it and markers as point masses. Other "
        "scenarios take it as their base. Exit codes: 0 written, 2 a value is refused."
    )
    parser.add_argument("cable", type=Path, help="YAML file that identify wrote")
    parser.add_argument(
        "--line-density", type=float, required=True, help="mass per length of the cable [kg/m]"
    )
    parser.add_argument("--diameter", type=float, required=True, help="of the cable [m]")
    parser.add_argument("--out", type=Path, required=True, help="YAML file of the scenario")


@refusing("cable scenario")
def run(options: argparse.Namespace) -> int:
    """Write the scenario; return the exit code."""
    cable = Cable.read(options.cable)
    mapping = scenario_of(cable, options.out.stem, options.line_density, options.diameter)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(
        yaml.safe_dump(mapping, sort_keys=False, default_flow_style=None, width=100),
        encoding="utf-8",
    )
    tether = mapping["tether"]
    print(
        f"{options.out}: {tether['length']:g} m of {tether['line_density']:g} kg/m in "
        f"{tether['elements']} elements, EI {tether['bending_stiffness']:.3g} N m2"
    )
    return OK


def scenario_of(cable: Cable, name: str, line_density: float, diameter: float) -> dict[str, Any]:
    """The keys and values of a scenario with an identified cable.

    Args:
        cable: identified.
        name: of the scenario.
        line_density: [kg/m].
        diameter: [m].

    Raises:
        SetError: the density or the diameter is no positive number, or the scenario is refused.
    """
    for argument, value in (("line-density", line_density), ("diameter", diameter)):
        if not 0.0 < value < math.inf:
            raise SetError(f"--{argument} = {value:g}: should be finite and above 0")
    laws = laws_of(cable.values)
    held = HeldCable(cable.geometry.places * cable.values["length_ratio"], cable.geometry.elements)
    curvature = natural_curvature(cable.geometry, cable.values)
    bent = float(np.hypot(*curvature).max()) * held.length
    mapping: dict[str, Any] = {
        "name": name,
        "model": "spatial",
        "about": "A cable that is identified from takes of its motion, hanging in air.",
        "environment": {
            "gravity": held.gravity,
            "floor": None,
            "air": _air(laws, line_density, diameter),
        },
        "tether": {
            "length": _plain(held.length),
            "elements": max(held.elements, math.ceil(1.0001 * bent / MOST_BENT)),
            "contact": None,
            **_section(laws, line_density),
            "masses": [
                {"position": _plain(place), "mass": _plain(laws.marker_mass * line_density)}
                for place in held.places[1:-1]
            ],
            "natural_curvature": {
                "rows": [
                    [_plain(each) for each in row]
                    for row in zip(held.nodes, *curvature, strict=True)
                ]
            },
        },
        "start": {"kind": "hanging", "settling_time": 600.0, "residual_speed": 1e-4},
    }
    try:
        scenario_from_mapping(mapping)
    except ScenarioError as error:
        raise SetError(f"the scenario is refused: {error}") from None
    return mapping


def _section(laws: CableLaws, line_density: float) -> dict[str, float]:
    section, stiffness = laws.section(line_density), laws.bending_stiffness * line_density
    return {
        "axial_stiffness": _plain(section.axial_stiffness),
        "bending_stiffness": _plain(stiffness),
        "line_density": _plain(section.line_density),
        "axial_damping_time": _plain(section.axial_damping_time),
        "bending_damping_time": _plain(laws.bending_damping_time),
        "bending_relaxation_ratio": _plain(laws.relaxation_ratio),
        "bending_relaxation_time": _plain(laws.relaxation_time),
        "twist_stiffness": _plain(laws.twist_ratio * stiffness),
    }


def _air(laws: CableLaws, line_density: float, diameter: float) -> dict[str, float] | None:
    """Coefficients with which the air's law has the identified drag."""
    if laws.drag == 0.0:
        return None
    across = laws.drag * line_density / (0.5 * _AIR_DENSITY * diameter)
    return {
        "diameter": _plain(diameter),
        "density": _AIR_DENSITY,
        "normal_coefficient": _plain(across),
        "axial_coefficient": _plain(laws.axial_drag * across / math.pi),
    }


def _plain(value: float) -> float:
    return float(f"{value:.6g}")
