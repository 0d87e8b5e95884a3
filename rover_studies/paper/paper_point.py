"""One point of the source paper's study of the tethered jump, from the command line.

    mother_rover study point --geometry=+K --slack 2 --elements 20 --json

Exit status: 0 if the rover landed, 1 if it did not (no equilibrium at the start, divergence, a
broken tether), 2 if the input is invalid.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import threading
from collections.abc import Sequence
from typing import Any

from msg_schemas.number_arguments import positive
from rover_sim import (
    Outcome,
    PlanarPlant,
    RunError,
    Scenario,
    ScenarioError,
    StaticsError,
    jump,
    list_scenarios,
    load_planar,
    parse_override,
)
from rover_studies.paper.paper_plan import GEOMETRIES

LANDED, NO_LANDING, BAD_INPUT = 0, 1, 2

NEGLIGIBLE_SHARE = 0.01
"""Initial stretch energy over the jump's, below which there is no warning [-]."""

_COMPILING_NOTE_AFTER = 4.0  # [s]


def study_point(scenario: Scenario) -> dict[str, Any]:
    """Simulate one jump; return settings and results by names that carry the units.

    `energy_drift_J` is the residual of the energy balance at the landing, `initial_axial_energy_J`
    the stretch energy of the tether's initial shape: negligible in static equilibrium, but not in
    an unrelaxed shape on a coarse mesh.

    Raises:
        ScenarioError: the scenario has no rover.
        StaticsError: the tether has no equilibrium at the start.
        RunError: the rover did not land.
    """
    if scenario.rover is None:
        raise ScenarioError("rover", None, f"{scenario.name} has no rover for a jump")
    plant = PlanarPlant(scenario)
    start = plant.initial_state()
    metrics = jump(plant, start)
    return {
        **_settings(scenario),
        **{name: value for name, value in metrics.to_mapping().items() if name != "slack_value"},
        "converged": metrics.outcome in {Outcome.CONVERGED, Outcome.HALVED},
        "take_off_energy_J": scenario.take_off_energy,
        "initial_axial_energy_J": plant.energies(start).axial,
    }


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    if options.list:
        for name in list_scenarios("planar"):
            scenario = load_planar(name)
            if scenario.rover is not None:
                sys.stdout.write(f"{name:22s} {scenario.about}\n")
        return LANDED
    try:
        scenario = _scenario_of(options)
    except ScenarioError as error:
        return _fail(error, BAD_INPUT)
    note = threading.Timer(_COMPILING_NOTE_AFTER, _note_compilation)
    note.daemon = True
    note.start()
    try:
        point = study_point(scenario)
    except ScenarioError as error:
        return _fail(error, BAD_INPUT)
    except (StaticsError, RunError) as error:
        if options.json:
            failed = {**_settings(scenario), "converged": False, "reason": str(error)}
            sys.stdout.write(json.dumps(failed, allow_nan=False) + "\n")
        return _fail(error, NO_LANDING)
    finally:
        note.cancel()
    sys.stdout.write(json.dumps(point, allow_nan=False) + "\n" if options.json else _table(point))
    return LANDED


def _settings(scenario: Scenario) -> dict[str, Any]:
    rover, take_off = scenario.rover, scenario.take_off
    return {
        "scenario": scenario.name,
        "geometry": scenario.start.geometry,
        "slack": scenario.slack_value if math.isfinite(scenario.slack_value) else None,
        "initial_shape": scenario.start.initial_shape,
        "elements": scenario.tether.elements,
        "theta0_deg": scenario.start.theta0,
        "take_off_m": take_off.compression if take_off is not None else None,
        "m1_kg": rover.m1 if rover is not None else None,
        "m2_kg": rover.m2 if rover is not None else None,
        "h": scenario.integration.h,
    }


def _scenario_of(options: argparse.Namespace) -> Scenario:
    base = load_planar(options.scenario)
    overrides: dict[str, object] = {}
    if options.geometry is not None:
        overrides["start.geometry"] = options.geometry
        if base.start.geometry == "chord":
            overrides |= {"start.chord": None, "start.side": None}
    if options.take_off is not None:
        overrides |= {"take_off.compression": options.take_off, "take_off.velocity": None}
    for option, path in (
        ("slack", "start.slack"),
        ("elements", "tether.elements"),
        ("initial_shape", "start.initial_shape"),
        ("theta0", "start.theta0"),
        ("m2", "rover.m2"),
        ("h", "integration.h"),
    ):
        value = getattr(options, option)
        if value is not None:
            overrides[path] = value
    overrides |= dict(parse_override(assignment) for assignment in options.set)
    if base.rover is None:
        raise ScenarioError("rover", None, f"{base.name} has no rover for a jump")
    return base.with_overrides(overrides)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = "Simulate one tethered jump of the paper's study and print its results."
    parser.epilog = (
        "Exit codes: 0 landed, 1 no landing, 2 bad input. `mother_rover study all` makes the whole "
        "study (figures 11 to 16)."
    )
    add = parser.add_argument
    add("--scenario", default="paper_table1_high", help="name (see --list) or path of a YAML file")
    add("--geometry", choices=GEOMETRIES, help="position of the rover: -H, -K or +K")
    add("--slack", type=float, help="slack evaluation value dh/df")
    add("--elements", type=positive, help="number of tether elements")
    add(
        "--initial-shape",
        choices=("static", "catenary", "arc"),
        help="tether in static equilibrium, or an unrelaxed catenary or arc",
    )
    add("--theta0", type=float, metavar="DEG", help="angle of the rover at take-off")
    add("--take-off", type=float, metavar="M", help="compression delta of the jump spring")
    add("--m2", type=float, metavar="KG", help="mass of Body 2")
    add("--h", type=float, metavar="S", help="time step")
    add(
        "--set",
        action="append",
        default=[],
        metavar="PATH=VALUE",
        help="any other value of the scenario, e.g. rover.slider_damping=5",
    )
    add("--json", action="store_true", help="print one JSON object instead of a table")
    add("--list", action="store_true", help="list the scenarios with a rover and exit")


def normalize_arguments(arguments: Sequence[str]) -> list[str]:
    """Write ``--geometry -H``, which argparse reads as two options, as ``--geometry=-H``."""
    joined: list[str] = []
    for argument in arguments:
        if joined and joined[-1] == "--geometry" and not argument.startswith("--"):
            joined[-1] = f"--geometry={argument}"
        else:
            joined.append(argument)
    return joined


def _table(point: dict[str, Any]) -> str:
    rows = [
        ("jump height", f"{point['jump_height_m']:.4f} m"),
        ("attitude variation", f"{point['attitude_variation_rad']:+.4f} rad"),
        ("travel", f"{point['travel_m']:+.4f} m"),
        ("flight time", f"{point['flight_time_s']:.4f} s"),
        ("peak tension", f"{point['peak_tension_N']:.4g} N"),
        ("energy at take-off", f"{point['take_off_energy_J']:.4g} J"),
        ("energy drift", f"{point['energy_drift_J']:+.2g} J"),
        ("integration", point["outcome"]),
    ]
    slack = "" if point["slack"] is None else f", slack {point['slack']:g}"
    head = (
        f"{point['scenario']}: geometry {point['geometry']}{slack}, {point['initial_shape']} start,"
        f" {point['elements']} elements, h = {point['h']:g} s"
    )
    lines = [head, "", *(f"  {name:20s}{value}" for name, value in rows)]
    stored, released = point["initial_axial_energy_J"], point["take_off_energy_J"]
    if point["initial_shape"] != "static" and stored > NEGLIGIBLE_SHARE * released:
        warning = (
            f"On this mesh the unrelaxed {point['initial_shape']} stores {stored:.4g} J of"
            f" stretch energy, {stored / released:.2g} times the jump's energy,\nand releases it in"
            " flight. Its effect on the jump is an artefact of the mesh."
        )
        lines += ["", warning]
    return "\n".join(lines) + "\n"


def _fail(error: Exception, status: int) -> int:
    sys.stderr.write(f"mother_rover study point: {error}\n")
    return status


def _note_compilation() -> None:
    sys.stderr.write(
        "mother_rover study point: the first run compiles the integrator, up to a minute ...\n"
    )
