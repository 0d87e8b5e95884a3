"""A step in space as two processes compile it side by side: the whole, and parts ahead of it."""

from typing import Any

import numpy as np

from rover_sim.physics import integrator_memory, spatial
from rover_sim.physics.energy_momentum import end_step, solve_increment
from rover_sim.physics.integrator_memory import remember_torques, report_loads
from rover_sim.physics.remesh import merge_first, split_first
from rover_sim.physics.rover_contact import add_feet, begin_feet, end_feet
from rover_sim.physics.spatial import Machines, Orders
from rover_sim.physics.spatial_rover import Pose
from rover_sim.physics.spatial_step import Model, Solver
from rover_sim.physics.tether_contact import add_tether_contact
from rover_sim.physics.variable_length import Payout, end_exit_step


def whole(
    model: Model, solver: Solver, machines: Machines, orders: Orders
) -> tuple[Any, tuple[Any, ...]]:
    """`spatial.advance`, with arguments of the types that it is called with."""
    book, report = np.zeros(integrator_memory.BOOK_SIZE), np.zeros(integrator_memory.REPORT_SIZE)
    events = np.zeros((integrator_memory.MAX_EVENTS, integrator_memory.EVENT_SIZE))
    arguments = (model, solver.after, machines, orders, book, model.step, events, report, solver)
    return spatial.advance, arguments


def parts(model: Model, solver: Solver, machines: Machines) -> list[tuple[Any, tuple[Any, ...]]]:
    """Functions that take half of the time in which `whole` is compiled.

    In the order in which it comes to them, first those that it calls late enough for another
    process to be ahead of it.

    Returns:
        Each with arguments of the types that it is called with there.
    """
    tether, h, motion = model.tether, model.step, solver.after
    work, contact, exit_ = solver.work, solver.contact, solver.exit
    book, report = np.zeros(integrator_memory.BOOK_SIZE), np.zeros(integrator_memory.REPORT_SIZE)
    q, v, anchors, mouth = motion.q, motion.v, motion.tether_anchors, motion.mouth
    body, feet_anchors = motion.body, motion.feet_anchors
    terrain, feet, ground = model.terrain, model.feet, model.tether_ground
    pay = Payout(1.0, 1.0, 0.0, 0.0)
    p = model.rover.attachment
    zero = (0.0, 0.0, 0.0)
    pose = Pose((zero, zero, zero), zero, zero, zero, zero, zero, zero, zero, 0.0, 0.0, 0.0)
    return [
        (begin_feet, (feet, terrain, pose, body, feet_anchors, solver.feet)),
        (
            add_feet,
            (feet, terrain, p, h, pose, body, zero, feet_anchors, solver.rover, solver.feet),
        ),
        (end_exit_step, (tether, h, pay, exit_, mouth[0], mouth[1])),
        (end_feet, (feet, terrain, h, pose, feet_anchors, solver.feet, feet_anchors)),
        (end_step, (tether, h, q, v, work, q, v)),
        (solve_increment, (tether, work)),
        (add_tether_contact, (terrain, ground, tether, h, anchors, work, contact)),
        (remember_torques, (feet, solver.feet, body, body, book)),
        (report_loads, (4, solver.feet, True, report)),
        (merge_first, (tether, 1.0, 0.0, mouth, q, v, anchors)),
        (split_first, (tether, 1.0, 0.0, mouth, q, v, anchors)),
        (spatial.energies, (model, motion, machines, book, solver)),
    ]
