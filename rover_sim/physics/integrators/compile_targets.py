"""Functions of the spatial plant and its sensors, with arguments of the types of a simulation."""

from typing import Any, TypeAlias

import numpy as np

from rover_sim.physics.ground.ray import distance_to_ground
from rover_sim.physics.ground.rover_contact import (
    add_rover_contact,
    begin_rover_contact,
    end_rover_contact,
)
from rover_sim.physics.ground.terrain import Terrain
from rover_sim.physics.ground.tether_contact import add_tether_contact
from rover_sim.physics.integrators import integrator_memory, spatial
from rover_sim.physics.integrators.integrator_memory import record_wheel_torques, report_loads
from rover_sim.physics.integrators.spatial import DriveCommands, DriveStates
from rover_sim.physics.integrators.spatial_step import Model, Solver
from rover_sim.physics.numerics.vectors import dot
from rover_sim.physics.rover import body_motion
from rover_sim.physics.rover.spatial_rover import Pose
from rover_sim.physics.tether.energy_momentum import end_step, solve_increment
from rover_sim.physics.tether.remesh import merge_first, split_first
from rover_sim.physics.tether.variable_length import Payout, end_exit_step

Target: TypeAlias = tuple[Any, tuple[Any, ...]]
"""A function, and arguments of the types for which it is compiled."""


def full_step(model: Model, solver: Solver, drives: DriveStates, commands: DriveCommands) -> Target:
    """`spatial.advance` and arguments of the types of a step."""
    memory = np.zeros(integrator_memory.MEMORY_SIZE)
    report = np.zeros(integrator_memory.REPORT_SIZE)
    events = np.zeros((integrator_memory.MAX_EVENTS, integrator_memory.EVENT_SIZE))
    arguments = (model, solver.after, drives, commands, memory, model.step, events, report, solver)
    return spatial.advance, arguments


def step_parts(model: Model, solver: Solver, drives: DriveStates) -> list[Target]:
    """Functions called by `full_step` that take half of its compilation time.

    They are in the order in which the compilation of `full_step` reaches them, late enough for a
    second process to have compiled them before.

    Returns:
        Each function with arguments of the types of a step.
    """
    tether, h, motion = model.tether, model.step, solver.after
    work, tether_contact, exit_element = solver.work, solver.tether_contact, solver.exit_element
    memory = np.zeros(integrator_memory.MEMORY_SIZE)
    report = np.zeros(integrator_memory.REPORT_SIZE)
    q, v, anchors, fairlead_slope = motion.q, motion.v, motion.tether_anchors, motion.fairlead_slope
    body, rover_anchors = motion.body, motion.rover_anchors
    terrain, contact_model, ground = model.terrain, model.rover_contact, model.tether_contact
    pay = Payout(1.0, 1.0, 0.0, 0.0)
    p = model.rover.attachment
    zero = (0.0, 0.0, 0.0)
    pose = Pose((zero, zero, zero), zero, zero, zero, zero, zero, zero, zero, 0.0, 0.0, 0.0)
    return [
        (
            begin_rover_contact,
            (contact_model, terrain, pose, body, rover_anchors, solver.rover_contact),
        ),
        (
            add_rover_contact,
            (
                contact_model,
                terrain,
                p,
                h,
                pose,
                body,
                zero,
                rover_anchors,
                solver.rover,
                solver.rover_contact,
            ),
        ),
        (end_exit_step, (tether, h, pay, exit_element, fairlead_slope[0], fairlead_slope[1])),
        (
            end_rover_contact,
            (contact_model, terrain, h, pose, rover_anchors, solver.rover_contact, rover_anchors),
        ),
        (end_step, (tether, h, q, v, work, q, v)),
        (solve_increment, (tether, work)),
        (add_tether_contact, (terrain, ground, tether, h, anchors, work, tether_contact)),
        (record_wheel_torques, (contact_model, solver.rover_contact, body, body, memory)),
        (report_loads, (4, solver.rover_contact, True, report)),
        (merge_first, (tether, 1.0, 0.0, fairlead_slope, q, v, anchors)),
        (split_first, (tether, 1.0, 0.0, fairlead_slope, q, v, anchors)),
        (spatial.energies, (model, motion, drives, memory, solver)),
    ]


def sensor_functions(terrain: Terrain) -> list[Target]:
    """Return the functions that the sensors call."""
    zero, upright = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
    body = body_motion.BodyMotion(zero, upright, zero, zero)
    return [
        (body_motion.mean_rate, (upright, upright, 1.0)),
        (body_motion.specific_force, (body, body, zero, 1.0, 1.0)),
        (body_motion.camera_ray, (body, zero, zero)),
        (body_motion.image_rate, (body, zero, zero, 1.0)),
        (distance_to_ground, (terrain, zero, zero, 1.0)),
        (dot, (zero, zero)),
    ]
