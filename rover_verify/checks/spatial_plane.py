"""Spatial jumps in a vertical plane of any azimuth against the planar plant."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from rover_sim import PlanarPlant, PlantCommand, SpatialPlant, SpatialState, jump, load_planar
from rover_sim.physics.numerics.event_location import apex_instant, crossing_instant, hermite
from rover_sim.physics.rover import rep103
from rover_sim.physics.tether.ancf import Array
from rover_verify.checks import CheckBatch, Measured
from rover_verify.checks.spatial_cases import spatial_twin, taken_off, twin_state

_TOLERANCE = 1.0e-12
_DURATION = 0.4  # most of a flight [s]
_IDLE = PlantCommand()


def _place(state: SpatialState) -> Array:
    """Attachment, Body 1 and theta in the x-z plane."""
    theta = rep103.planar_angle(state.orientation)
    return np.array([*rep103.planar_vector(state.tip), *rep103.planar_vector(state.G1), theta])


def order(batch: CheckBatch) -> Measured:
    """Lowest order of convergence of spatial jumps to a planar jump with a much smaller step."""
    del batch
    worst, details = math.inf, {}
    for theta0 in (0.0, -10.0, 15.0):
        overrides = {
            "start.theta0": theta0,
            "after_landing": "fly_on",
            "integration.h": 1.0e-3 / 16.0,
            "integration.tolerance": _TOLERANCE,
        }
        fine = load_planar("taut_jump", overrides)
        planar = PlanarPlant(fine)
        flat, _ = planar.step(taken_off(planar), _IDLE, _DURATION)
        expected = np.array([*flat.nodes[-1, 0], *flat.G1, flat.theta])
        errors = []
        for h in (1.0e-3, 5.0e-4, 2.5e-4):
            plant = spatial_twin(replace(fine, integration=replace(fine.integration, h=h)))
            start = twin_state(plant, taken_off(planar), 0.0)
            state, _ = plant.step(start, _IDLE, _DURATION)
            errors.append(float(np.linalg.norm(_place(state) - expected)))
            details[f"theta0 = {theta0:g} deg, h = {h * 1e3:g} ms"] = errors[-1]
        worst = min(worst, *(math.log2(coarse / less) for coarse, less in pairwise(errors)))
    return Measured(worst, "jumps at 1, 0.5, 0.25 ms against the planar one at 1/16 ms", details)


def _flight(plant: SpatialPlant, state: SpatialState) -> tuple[float, float]:
    """Height and travel of G1 until it falls through its start height.

    Raises:
        RuntimeError: G1 does not return to its start height within 3 s.
    """
    tick = plant.scenario.integration.h
    start, level, height = state.G1, float(state.G1[2]), 0.0
    for _ in range(round(3.0 / tick)):
        before = state
        state, _ = plant.step(state, _IDLE, tick)
        ends = (
            float(before.G1[2]), float(before.G1_rate[2]),
            float(state.G1[2]), float(state.G1_rate[2]),
        )  # fmt: skip
        if ends[1] > 0.0 >= ends[3]:
            height = max(height, hermite(apex_instant(tick, *ends), tick, *ends) - level)
        if height > 0.0 and ends[2] <= level:
            instant = crossing_instant(0.0, tick, tick, *ends, level)
            landing = [
                hermite(instant, tick, before.G1[d], before.G1_rate[d], state.G1[d],
                        state.G1_rate[d])
                for d in range(2)
            ]  # fmt: skip
            return height, float(np.hypot(*(np.array(landing) - start[:2])))
    raise RuntimeError(f"{plant.scenario.name}: G1 is above its start height for 3 s")


def turned(batch: CheckBatch) -> Measured:
    """Largest relative deviation of height and travel from the planar jump, in rotated planes."""
    details = {}
    for index, generator in enumerate(batch.generators(min(batch.runs, 8))):
        azimuth = float(generator.uniform(-math.pi, math.pi))
        overrides = {
            "start.theta0": float(generator.uniform(-15.0, 15.0)),
            "integration.tolerance": _TOLERANCE,
            "take_off.velocity": [float(generator.uniform(0.5, 1.5)), 2.0],
        }
        if index == 0:
            overrides = {"integration.tolerance": _TOLERANCE}
        scenario = load_planar("taut_jump", overrides)
        planar = PlanarPlant(scenario)
        metrics = jump(planar)
        plant = spatial_twin(scenario)
        height, travel = _flight(plant, twin_state(plant, taken_off(planar), azimuth))
        off = max(abs(height / metrics.height - 1.0), abs(travel / abs(metrics.travel) - 1.0))
        details[f"at {math.degrees(azimuth):.1f} deg"] = off
    return Measured.largest(details, f"{len(details)} taut jumps, planes at random")
