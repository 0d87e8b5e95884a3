"""Experiments of a sweep: the simulation of a scenario and its row of results.

An experiment declares its columns, so that all rows of a sweep have them, including failed runs. To
add an experiment, add an entry to `EXPERIMENTS`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from rover_sim import (
    AnyScenario,
    Outcome,
    PlanarPlant,
    RunError,
    Scenario,
    ScenarioError,
    SpatialPlant,
    SpatialScenario,
    build_plant,
    jump,
    march,
    spatial_jump,
)

Value = float | int | str | bool | None
Kind = type[float] | type[int] | type[str] | type[bool]


@dataclass(frozen=True)
class Setting:
    """A numerical setting of an experiment besides the scenario."""

    unit: str
    about: str
    default: float
    minimum: float
    maximum: float


@dataclass(frozen=True)
class SweepExperiment:
    """The simulation of each scenario of a sweep.

    Attributes:
        about: description.
        columns: name (with unit) and type of each result.
        settings: by name.
        accepts: raises ScenarioError for a scenario that the experiment cannot simulate.
        perform: computes the results from scenario, seed of the run and settings; raises RunError,
            StaticsError or ScenarioError.
    """

    about: str
    columns: Mapping[str, Kind]
    settings: Mapping[str, Setting]
    accepts: Callable[[AnyScenario], object]
    perform: Callable[[AnyScenario, int, Mapping[str, float]], Mapping[str, Value]]


def _planar(scenario: AnyScenario) -> Scenario:
    if not isinstance(scenario, Scenario):
        raise ScenarioError("model", scenario.model, "should be planar for this experiment")
    return scenario


def _planar_with_rover(scenario: AnyScenario) -> Scenario:
    planar = _planar(scenario)
    if planar.rover is None:
        raise ScenarioError("rover", None, f"{planar.name} has no rover, so nothing jumps")
    return planar


def _spatial_ready_to_jump(scenario: AnyScenario) -> SpatialScenario:
    if not isinstance(scenario, SpatialScenario):
        raise ScenarioError("model", scenario.model, "should be spatial for this experiment")
    if scenario.rover is None:
        raise ScenarioError("rover", None, f"{scenario.name} has no rover, so nothing jumps")
    if scenario.start.compression == 0.0:
        raise ScenarioError("start.compression", 0.0, "should be above 0 m for a jump")
    return scenario


def _jump(given: AnyScenario, _seed: int, settings: Mapping[str, float]) -> dict[str, Value]:
    scenario = _planar_with_rover(given)
    plant = PlanarPlant(scenario)
    start = plant.initial_state()
    metrics = jump(plant, start, max_flight_time=settings["max_flight_time"])
    found: dict[str, Value] = dict(metrics.to_mapping())
    slopes = np.linalg.norm(start.nodes[:, 1], axis=-1)
    return {
        **found,
        "slack_value": metrics.slack_value,
        "take_off_energy_J": scenario.take_off_energy,
        "initial_axial_energy_J": plant.energies(start).axial,
        "initial_slope_error": float(np.max(np.abs(slopes - 1.0))),
    }


class _LastPlant:
    """Plant of the last run: runs that differ in the jump alone share model and settled state."""

    def __init__(self) -> None:
        self._plant: SpatialPlant | None = None

    def of(self, scenario: SpatialScenario) -> SpatialPlant:
        """Return the settled plant of a scenario."""
        plant = self._plant or SpatialPlant(scenario)
        try:
            plant = plant.with_scenario(scenario)
        except ScenarioError:
            plant = SpatialPlant(scenario)
        plant.settled_state()
        self._plant = plant
        return plant


_last_plant = _LastPlant()


def _spatial_jump(
    given: AnyScenario, _seed: int, settings: Mapping[str, float]
) -> dict[str, Value]:
    scenario = _spatial_ready_to_jump(given)
    metrics = spatial_jump(
        _last_plant.of(scenario),
        after_touchdown=settings["after_touchdown"],
        max_flight_time=settings["max_flight_time"],
    )
    return {
        "outcome": metrics.outcome.value,
        "jump_height_m": metrics.height,
        "travel_m": metrics.travel,
        "turn_rad": metrics.turn,
        "tilt_rad": metrics.tilt,
        "flight_time_s": metrics.flight_time,
        "peak_tension_N": metrics.peak_tension,
        "clearance_m": metrics.clearance,
        "energy_drift_J": metrics.energy_drift,
    }


def _run(given: AnyScenario, _seed: int, settings: Mapping[str, float]) -> dict[str, Value]:
    plant = build_plant(_planar(given))
    final, peak, drift, iterations = plant.initial_state(), 0.0, 0.0, 0
    for state, last in march(plant, final, settings["duration"], tick=settings["tick"]):
        peak = max(peak, last.peak_tension)
        drift = max(drift, last.energies.drift, key=abs)
        iterations += last.newton_iterations
        final = state
    if last.outcome is Outcome.DIVERGED:
        raise RunError(f"diverged at t = {final.time:.6g} s")
    x, y = (float(value) for value in final.nodes[-1, 0])
    return {
        "outcome": last.outcome.value,
        "phase": final.phase.value,
        "time_s": final.time,
        "tip_x_m": x,
        "tip_y_m": y,
        "peak_tension_N": peak,
        "energy_drift_J": drift,
        "stored_energy_J": last.energies.stored,
        "dissipated_energy_J": last.energies.dissipated,
        "newton_iterations": iterations,
    }


_JUMP_NUMBERS: Final = (
    "jump_height_m", "attitude_variation_rad", "travel_m", "flight_time_s", "peak_tension_N",
    "energy_drift_J", "slack_value", "take_off_energy_J", "initial_axial_energy_J",
    "initial_slope_error",
)  # fmt: skip
_SPATIAL_JUMP_NUMBERS: Final = (
    "jump_height_m", "travel_m", "turn_rad", "tilt_rad", "flight_time_s", "peak_tension_N",
    "clearance_m", "energy_drift_J",
)  # fmt: skip
_RUN_NUMBERS: Final = (
    "time_s", "tip_x_m", "tip_y_m", "peak_tension_N", "energy_drift_J", "stored_energy_J",
    "dissipated_energy_J",
)  # fmt: skip

EXPERIMENTS: Final[Mapping[str, SweepExperiment]] = {
    "jump": SweepExperiment(
        "the scenario's take-off and the flight up to the landing",
        {"outcome": str, **dict.fromkeys(_JUMP_NUMBERS, float)},
        {"max_flight_time": Setting("s", "longest time of flight", 10.0, 1e-3, 1e4)},
        _planar_with_rover,
        _jump,
    ),
    "spatial_jump": SweepExperiment(
        "the jump of a spatial scenario's standing rover from its start.compression",
        {"outcome": str, **dict.fromkeys(_SPATIAL_JUMP_NUMBERS, float)},
        {
            "after_touchdown": Setting("s", "simulated time after the touchdown", 0.5, 0.0, 1e3),
            "max_flight_time": Setting(
                "s", "longest time from release to touchdown", 10.0, 1e-3, 1e4
            ),
        },
        _spatial_ready_to_jump,
        _spatial_jump,
    ),
    "run": SweepExperiment(
        "the scenario from its start for a duration, without commands",
        {
            "outcome": str,
            "phase": str,
            **dict.fromkeys(_RUN_NUMBERS, float),
            "newton_iterations": int,
        },
        {
            "duration": Setting("s", "simulated time", 1.0, 1e-4, 1e6),
            "tick": Setting("s", "period of the energy samples", 0.01, 1e-4, 10.0),
        },
        _planar,
        _run,
    ),
}


def results_of(experiment: SweepExperiment, values: Mapping[str, Value]) -> dict[str, Value]:
    """Return the results in the order of the columns, with None for values that are not finite."""
    row: dict[str, Value] = {}
    for name in experiment.columns:
        value = values[name]
        bad = isinstance(value, float) and not math.isfinite(value)
        row[name] = None if bad else value
    return row
