"""Let tether and rover of a spatial scenario come to rest at the start, by a simulation."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from rover_sim.physics.rover import spatial_rover
from rover_sim.plants.plant import StepResult
from rover_sim.plants.spatial_state import SpatialState
from rover_sim.scenarios.spatial_scenario import SpatialScenario

Step: TypeAlias = Callable[[SpatialState, float], tuple[SpatialState, StepResult]]
"""Advances a state by a time [s]."""

SETTLING_AXIAL, SETTLING_BENDING = 0.05, 0.2
"""Damping times of the tether while it settles [s]."""
_TICK = 0.02  # [s]
_SCALE = 0.97  # factor of the velocities after a tick
_SLOW = 20.0  # time after which only soft modes of the tether move [s]
_FREE_ITERATIONS = 200_000  # Newton iterations of the whole, beyond those of each step
_MOST_PER_STEP = 100  # Newton iterations of a time step, on average; a machine's takes 3
_AT_REST = 1.0e-6  # speed below which the system is at rest [m/s]


class SettlingError(RuntimeError):
    """Rover and tether do not settle at the start; the message has the reason."""


def settle(scenario: SpatialScenario, state: SpatialState, step: Step) -> SpatialState:
    """Step a state with reduced velocities until all is at rest.

    Args:
        scenario: with the limits of time and speed.
        state: to begin with.
        step: of a plant with a strongly damped tether.

    Raises:
        SettlingError: it diverges, takes far too many iterations, or still moves when the time is
            over.
    """
    longest = scenario.start.settling_time
    speed, iterations = math.inf, 0
    while state.time < longest:
        before = _mean_square_speed(state)
        state, result = step(state, _TICK)
        iterations += result.newton_iterations
        steps = state.time / scenario.integration.h
        if iterations > _FREE_ITERATIONS + _MOST_PER_STEP * steps:
            raise SettlingError(
                f"{scenario.name}: {iterations} Newton iterations in the first {state.time:.3g} s"
                f" of settling, should be fewer than {_MOST_PER_STEP} a step; give a stiffness,"
                " damping or friction nearer to a machine's, or a smaller integration.h"
            )
        if state.phase.final:
            raise SettlingError(
                f"{scenario.name}: {result.outcome.value} while settling, after {state.time:.3g} s"
            )
        speed = _max_speed(state)
        if speed < _AT_REST:
            break
        # The rotation of a slack loop about the line of its ends is very soft: it would take
        # minutes with reduced velocities, so they are not reduced while it gains speed.
        gains = state.time > _SLOW and _mean_square_speed(state) > before
        tether = 1.0 if gains else _SCALE
        state = _scaled_velocities(state, _SCALE, tether)
    if speed > max(scenario.start.residual_speed, _AT_REST):
        raise SettlingError(
            f"{scenario.name}: still moving at {speed:.3g} m/s after {longest:g} s of"
            " settling; give start.settling_time more, or another start.position"
        )
    return _scaled_velocities(state, 0.0)


def _max_speed(state: SpatialState) -> float:
    """Return the largest speed of a node or a body [m/s]."""
    speeds = [
        float(np.max(np.linalg.norm(state.node_rates[:, 0], axis=1))),
        float(np.linalg.norm(state.G1_rate)),
        float(np.linalg.norm(state.G2_rate)),
        0.2 * float(np.linalg.norm(state.omega)),
    ]
    return max(speeds)


def _mean_square_speed(state: SpatialState) -> float:
    """Return the mean square of the nodes' speeds [m^2/s^2]."""
    return float(np.mean(state.node_rates[:, 0] ** 2))


def _scaled_velocities(
    state: SpatialState, factor: float, tether: float | None = None
) -> SpatialState:
    """Return the state with scaled velocities, except those of the drives relative to Body 1.

    Args:
        state: to scale.
        factor: of the velocities.
        tether: factor of the tether's; None: the same.
    """
    body = state.body.copy()
    for first in (spatial_rover.SPIN, spatial_rover.VELOCITY1, spatial_rover.VELOCITY2):
        body[first : first + 3] *= factor
    fairlead_slope = state.fairlead_slope.copy()
    fairlead_slope[1] *= factor
    rates = (factor if tether is None else tether) * state.node_rates
    jump, wheels = state.drives.jump, state.drives.wheels
    drives = state.drives._replace(
        jump=jump._replace(body_rate=factor * jump.body_rate),
        wheels=wheels._replace(body_rate=factor * wheels.body_rate),
    )
    return state.replaced(node_rates=rates, body=body, fairlead_slope=fairlead_slope, drives=drives)
