"""Simulate a jump of the spatial plant's rover and compute its metrics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from msg_schemas.events import PlantEvent
from rover_sim.physics.ground.terrain import Terrain, floor_heights
from rover_sim.physics.tether.ancf import Array
from rover_sim.plants.plant import JumpMotorCommand, Outcome, PlantCommand
from rover_sim.plants.run import RunError
from rover_sim.plants.spatial_plant import SpatialPlant
from rover_sim.plants.spatial_state import SpatialState
from rover_sim.scenarios.hardware import BOX_CORNERS
from rover_sim.scenarios.scenario import ScenarioError

_TICK = 0.05  # [s]
_NUT_SPEED = 0.05  # holds the nut at the compression [m/s]


@dataclass(frozen=True)
class SpatialJumpMetrics:
    """Metrics of a jump from the latch's release to the end of the simulation.

    Attributes:
        height: largest rise of Body 1's centre above its start [m].
        travel: horizontal distance of that centre from its start at the end [m].
        turn: change of the heading [rad].
        tilt: angle at the end between the directions of base_link's z at start and end [rad].
        flight_time: from take-off to the first touchdown [s].
        peak_tension: largest tension in the tether [N].
        clearance: smallest height of the bodies' corners above floor and boulders below them, from
            the take-off on at the ticks [m]; below 0 a corner is in the ground.
        energy_drift: residual of the energy balance at the end [J].
        outcome: of the last tick.
    """

    height: float
    travel: float
    turn: float
    tilt: float
    flight_time: float
    peak_tension: float
    clearance: float
    energy_drift: float
    outcome: Outcome


def spatial_jump(
    plant: SpatialPlant,
    state: SpatialState | None = None,
    *,
    after_touchdown: float = 0.5,
    max_flight_time: float = 10.0,
) -> SpatialJumpMetrics:
    """Trip the latch of a rover with a compressed spring, and simulate its flight and landing.

    Args:
        plant: with a rover.
        state: the rover on the ground, its spring compressed; default: the scenario's start.
        after_touchdown: simulated time after the first touchdown [s].
        max_flight_time: longest time from the release to the touchdown [s].

    Raises:
        ScenarioError: the scenario has no rover, or its start no compressed spring.
        RunError: the simulation diverged, the tether broke, the rover did not take off, or the
            flight exceeded the limit.
        SettlingError: the rover does not come to rest at the start.
    """
    scenario = plant.scenario
    rover, start = scenario.rover, scenario.start
    if rover is None:
        raise ScenarioError("rover", None, f"{scenario.name} has no rover, so nothing jumps")
    if state is None:
        if start.compression == 0.0:
            raise ScenarioError(
                "start.compression", start.compression, "should be above 0 m for a jump"
            )
        state = plant.initial_state()
    compression = rover.slider.free_length - state.s
    trip = PlantCommand(JumpMotorCommand(min(compression, rover.jump_drive.stroke), _NUT_SPEED))
    corners, first_of_body2 = rover.corners
    first, release = state, state.time
    took_off = touched_down = math.nan
    height = peak = 0.0
    flown: list[SpatialState] = []
    end = release + max_flight_time
    while state.time < end - 1e-9:
        state, result = plant.step(state, trip, min(_TICK, end - state.time))
        peak = max(peak, result.peak_tension)
        if state.phase.final:
            raise RunError(f"no landing: {result.outcome.value} at t = {state.time:.6g} s")
        for event in result.events:
            if event.name is PlantEvent.TAKE_OFF and math.isnan(took_off):
                took_off = event.time
            elif event.name is PlantEvent.APEX:
                height = max(height, event.values["z"] - float(first.G1[2]))
            elif event.name is PlantEvent.TOUCHDOWN and math.isnan(touched_down):
                touched_down = event.time
                end = min(end, touched_down + after_touchdown)
        if not math.isnan(took_off):
            flown.append(state)
    if math.isnan(touched_down):
        raise RunError(f"no landing within {max_flight_time:g} s after the release")
    displacement = state.G1 - first.G1
    return SpatialJumpMetrics(
        height=height,
        travel=math.hypot(float(displacement[0]), float(displacement[1])),
        turn=state.turn_from(first),
        tilt=state.tilt_from(first),
        flight_time=touched_down - took_off,
        peak_tension=peak,
        clearance=_clearance(corners, first_of_body2, plant.model.terrain, flown),
        energy_drift=result.energies.drift,
        outcome=result.outcome,
    )


def _clearance(
    corners: Array, first_of_body2: int, terrain: Terrain, states: Sequence[SpatialState]
) -> float:
    """Return the smallest height of the bodies' corners above the ground below them [m]."""
    boxes = np.repeat(
        [np.concatenate([corners[:BOX_CORNERS], corners[first_of_body2:]])], len(states), axis=0
    )
    boxes[:, BOX_CORNERS:, 2] += np.array([[state.s] for state in states])
    rotations = np.array([state.rotation.T for state in states])
    points = np.array([[state.G1] for state in states]) + boxes @ rotations
    return float(np.min(points[..., 2] - floor_heights(terrain, points[..., 0], points[..., 1])))
