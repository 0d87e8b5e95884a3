"""What one run of a sweep does: from a scenario to a row of results.

An experiment declares its columns, so that every row of a sweep has them, also the rows of runs
that failed. A new plant or question joins by one entry of `EXPERIMENTS`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

import rover_sim
from rover_sim import (
    AnyScenario,
    Outcome,
    PlanarPlant,
    RunError,
    Scenario,
    ScenarioError,
    build_plant,
    jump,
)

Value = float | int | str | bool | None
Kind = type[float] | type[int] | type[str] | type[bool]


@dataclass(frozen=True)
class Setting:
    """A number that an experiment can be given besides the scenario."""

    unit: str
    about: str
    default: float
    minimum: float
    maximum: float


@dataclass(frozen=True)
class Experiment:
    """What is done with each scenario of a sweep.

    Attributes:
        about: what it does, in words.
        columns: name (with its unit) and kind of each result.
        settings: numbers that it takes, by name.
        perform: from scenario, seed of the run and settings to the results; raises RunError,
            StaticsError or ScenarioError where there are none.
    """

    about: str
    columns: Mapping[str, Kind]
    settings: Mapping[str, Setting]
    perform: Callable[[AnyScenario, int, Mapping[str, float]], Mapping[str, Value]]


def _jump(scenario: AnyScenario, _seed: int, settings: Mapping[str, float]) -> dict[str, Value]:
    if not isinstance(scenario, Scenario):
        raise ScenarioError("model", scenario.model, "should be planar for the experiment jump")
    if scenario.rover is None:
        raise ScenarioError("rover", None, f"{scenario.name} has no rover, so nothing jumps")
    plant = PlanarPlant(scenario)
    start = plant.initial_state()
    metrics = jump(plant, start, limit=settings["limit"])
    found: dict[str, Value] = dict(metrics.to_mapping())
    slopes = np.linalg.norm(start.nodes[:, 1], axis=-1)
    return {
        **found,
        "slack_value": metrics.slack_value,
        "take_off_energy_J": scenario.take_off_energy,
        "initial_axial_energy_J": plant.energies(start).axial,
        "initial_slope_error": float(np.max(np.abs(slopes - 1.0))),
    }


def _run(scenario: AnyScenario, _seed: int, settings: Mapping[str, float]) -> dict[str, Value]:
    if not isinstance(scenario, Scenario):
        raise ScenarioError("model", scenario.model, "should be planar for the experiment run")
    plant = build_plant(scenario)
    done = rover_sim.run(plant, plant.initial_state(), settings["duration"], tick=settings["tick"])
    final, last = done.final, done.results[-1]
    if last.outcome is Outcome.DIVERGED:
        raise RunError(f"diverged at t = {final.time:.6g} s")
    x, y = (float(value) for value in final.nodes[-1, 0])
    return {
        "outcome": last.outcome.value,
        "phase": final.phase.value,
        "time_s": final.time,
        "tip_x_m": x,
        "tip_y_m": y,
        "peak_tension_N": done.peak_tension,
        "energy_drift_J": done.energy_drift,
        "stored_energy_J": last.energies.stored,
        "dissipated_energy_J": last.energies.dissipated,
        "newton_iterations": sum(result.newton_iterations for result in done.results),
    }


EXPERIMENTS: Final[Mapping[str, Experiment]] = MappingProxyType(
    {
        "jump": Experiment(
            "the rover takes off as the scenario says and flies to its landing",
            MappingProxyType(
                {
                    "outcome": str,
                    "jump_height_m": float,
                    "attitude_variation_rad": float,
                    "travel_m": float,
                    "flight_time_s": float,
                    "peak_tension_N": float,
                    "energy_drift_J": float,
                    "slack_value": float,
                    "take_off_energy_J": float,
                    "initial_axial_energy_J": float,
                    "initial_slope_error": float,
                }
            ),
            MappingProxyType(
                {"limit": Setting("s", "a flight is given up after this", 10.0, 1e-3, 1e4)}
            ),
            _jump,
        ),
        "run": Experiment(
            "the scenario runs from its start for a while, nothing commanded",
            MappingProxyType(
                {
                    "outcome": str,
                    "phase": str,
                    "time_s": float,
                    "tip_x_m": float,
                    "tip_y_m": float,
                    "peak_tension_N": float,
                    "energy_drift_J": float,
                    "stored_energy_J": float,
                    "dissipated_energy_J": float,
                    "newton_iterations": int,
                }
            ),
            MappingProxyType(
                {
                    "duration": Setting("s", "simulated time", 1.0, 1e-4, 1e6),
                    "tick": Setting("s", "between two looks at the energy", 0.01, 1e-4, 10.0),
                }
            ),
            _run,
        ),
    }
)


def results_of(experiment: Experiment, values: Mapping[str, Value]) -> dict[str, Value]:
    """The results in the order of the columns; what is no finite number becomes None."""
    row: dict[str, Value] = {}
    for name in experiment.columns:
        value = values[name]
        bad = isinstance(value, float) and not math.isfinite(value)
        row[name] = None if bad else value
    return row
