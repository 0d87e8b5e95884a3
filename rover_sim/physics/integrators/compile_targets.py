"""Functions of the spatial plant and its sensors, with arguments of the types of a simulation."""

from collections.abc import Callable
from typing import Any, TypeAlias

import numba

from rover_sim.physics.ground.ray import distance_to_ground
from rover_sim.physics.ground.rover_contact import (
    add_corner_contact,
    add_wheel_contact,
    begin_rover_contact,
    end_rover_contact,
    roll_wheels,
)
from rover_sim.physics.ground.terrain import Terrain, wall_radius
from rover_sim.physics.ground.tether_contact import add_tether_contact
from rover_sim.physics.integrators import spatial
from rover_sim.physics.integrators.drive_states import DriveCommands
from rover_sim.physics.integrators.integrator_memory import record_wheel_torques, report_loads
from rover_sim.physics.integrators.material_frames import end_frames
from rover_sim.physics.mechanisms.wheel_drive import WheelResponse
from rover_sim.physics.numerics.record import Record
from rover_sim.physics.numerics.vectors import dot
from rover_sim.physics.rover import body_motion
from rover_sim.physics.rover.spatial_rover import Pose
from rover_sim.physics.tether.energy_momentum import assemble, end_step, solve_increment
from rover_sim.physics.tether.remesh import merge_first, split_first
from rover_sim.physics.tether.variable_length import Payout, end_exit_step

Target: TypeAlias = tuple[Any, tuple[Any, ...]]
"""A function, and arguments of the types for which it is compiled."""


def full_step(record: Record, commands: DriveCommands) -> Target:
    """`spatial.advance` and arguments of the types of a step."""
    return spatial.advance, (record, commands, 1.0)


def step_parts(record: Record) -> list[Target]:
    """Functions that take half of the compilation time of `full_step`.

    The energies, which the initial state needs, come first. The others are in the order in which
    the compilation of `full_step` reaches them, late enough for a second process to have compiled
    them before.

    Returns:
        Each function with arguments of the types of a step.
    """
    session, at = record.value, record.field
    tether, h = session.model.tether, 1.0
    contact, terrain = at("model.rover_contact"), at("model.terrain")
    rover_step, contact_step = at("solver.rover"), at("solver.rover_contact")
    work, tether_contact, exit_element = (
        at("solver.work"), at("solver.tether_contact"), at("solver.exit_element")
    )  # fmt: skip
    q, v, anchors, fairlead_slope = (
        session.motion.q, session.motion.v, session.motion.tether_anchors,
        session.motion.fairlead_slope,
    )  # fmt: skip
    fairlead = session.solver.fairlead
    body, rover_anchors = session.motion.body, session.motion.rover_anchors
    pay = Payout(1.0, 1.0, 0.0, 0.0)
    zero = (0.0, 0.0, 0.0)
    vectors = [zero] * (len(Pose._fields) - 4)  # all but the rotation, s0, s1, ds
    pose = Pose._make(((zero, zero, zero), *vectors, 0.0, 0.0, 0.0))
    response = WheelResponse(0.0, 0.0, 0.0, 0.0, 0.0)
    return [
        (spatial.energies, (record,)),
        (begin_rover_contact, (contact, terrain, h, pose, body, rover_anchors, contact_step)),
        (
            add_corner_contact,
            (contact, terrain, zero, h, pose, body, zero, rover_anchors, rover_step, contact_step),
        ),
        (roll_wheels, (contact, terrain, h, pose, rover_anchors, contact_step)),
        (
            add_wheel_contact,
            (contact, zero, h, pose, response, h, rover_step, contact_step),
        ),
        (assemble, (tether, h, work)),
        (end_step, (tether, h, q, v, work, q, v)),
        (solve_increment, (tether, work)),
        (end_exit_step, (tether, h, pay, work, exit_element, fairlead_slope[0], fairlead_slope[1])),
        (
            end_rover_contact,
            (contact, terrain, h, pose, rover_anchors, contact_step, rover_anchors),
        ),
        (
            add_tether_contact,
            (terrain, at("model.tether_contact"), tether, h, anchors, work, tether_contact),
        ),
        (record_wheel_torques, (contact_step, session.memory)),
        (report_loads, (4, contact_step, True, session.report)),
        (end_frames, (record, tether, pay, 1.0e-3)),
        (merge_first, (tether, 1.0, 0.0, fairlead, fairlead_slope, q, v, anchors)),
        (split_first, (tether, 1.0, 0.0, fairlead, fairlead_slope, q, v, anchors)),
    ]


def sensor_functions(terrain: Terrain) -> list[Target]:
    """Return the functions that sensors and drawings call."""
    zero, upright = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
    body = body_motion.BodyMotion(zero, upright, zero, zero)
    return [
        (body_motion.mean_rate, (upright, upright, 1.0)),
        (body_motion.specific_force, (body, body, zero, 1.0, 1.0)),
        (body_motion.camera_ray, (body, zero, zero)),
        (body_motion.image_rate, (body, zero, zero, 1.0)),
        (distance_to_ground, (terrain, zero, zero, 1.0)),
        (dot, (zero, zero)),
        (wall_radius, (terrain, 0.0)),
    ]


def compile_for(function: Any, arguments: tuple[Any, ...]) -> Callable[..., Any]:
    """Compile a function for arguments of these types, or load it from the cache.

    Returns:
        The function for these types only. A call skips what numba does to find it, which takes as
        long as a time step.
    """
    typeof: Any = numba.typeof
    compiled: Callable[..., Any] = function.compile(tuple(typeof(each) for each in arguments))
    return compiled
