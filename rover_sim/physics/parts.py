"""What of a step in space two processes can compile side by side."""

from typing import Any

from rover_sim.physics.energy_momentum import assemble, end_step, solve_increment
from rover_sim.physics.remesh import merge_first, split_first
from rover_sim.physics.rover_contact import add_feet, begin_feet, end_feet
from rover_sim.physics.spatial_rover import Pose
from rover_sim.physics.spatial_step import Model, Solver
from rover_sim.physics.tether_contact import add_tether_contact, end_tether_contact
from rover_sim.physics.variable_length import Payout, end_exit_step


def parts(model: Model, solver: Solver) -> list[tuple[Any, tuple[Any, ...]]]:
    """Functions that take a third of the time in which `spatial.advance` is compiled.

    First those that it calls late enough for another process to be ahead of it, then from its end
    on.

    Returns:
        Each with arguments of the types that it is called with there.
    """
    tether, h, motion = model.tether, model.step, solver.after
    work, contact, exit_ = solver.work, solver.contact, solver.exit
    q, v, anchors, mouth = motion.q, motion.v, motion.tether_anchors, motion.mouth
    body, feet_anchors = motion.body, motion.feet_anchors
    terrain, feet, ground = model.terrain, model.feet, model.tether_ground
    pay = Payout(1.0, 1.0, 0.0, 0.0)
    p = model.rover.attachment
    zero = (0.0, 0.0, 0.0)
    pose = Pose((zero, zero, zero), zero, zero, zero, zero, zero, zero, zero, 0.0, 0.0, 0.0)
    return [
        (begin_feet, (feet, terrain, pose, body, solver.feet)),
        (
            add_feet,
            (feet, terrain, p, h, pose, body, zero, feet_anchors, solver.rover, solver.feet),
        ),
        (end_tether_contact, (ground, tether, h, anchors, work, contact)),
        (end_exit_step, (tether, h, pay, exit_, mouth[0], mouth[1])),
        (end_feet, (feet, terrain, h, pose, feet_anchors, solver.feet, feet_anchors)),
        (end_step, (tether, h, q, v, work, q, v)),
        (solve_increment, (tether, work)),
        (add_tether_contact, (terrain, ground, tether, h, anchors, work, contact)),
        (merge_first, (tether, 1.0, 0.0, mouth, q, v, anchors)),
        (split_first, (tether, 1.0, 0.0, mouth, q, v, anchors)),
        (assemble, (tether, h, work)),
    ]
