"""A tether between two driven ends: the motion of a cable that is held and moved at both ends.

Position and slope of both ends follow given rates; the tether between them moves by the laws of the
plant: `energy_momentum`, `air_drag`, `natural_curvature` and `point_masses`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_sim.physics.numerics.compiled import checked, checked_inner, inner
from rover_sim.physics.tether.air_drag import AirDrag, add_drag
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.carried_frames import (
    end_natural_curvature,
    relax_bending,
    relax_twist,
)
from rover_sim.physics.tether.energy_momentum import (
    Workspace,
    assemble,
    begin_ends,
    begin_step,
    end_step,
    largest_turn,
    make_workspace,
    solve_increment,
)
from rover_sim.physics.tether.natural_curvature import (
    NO_EXIT,
    NaturalCurvature,
    add_natural_curvature,
    begin_natural_curvature,
)
from rover_sim.physics.tether.newton import (
    CONTINUE,
    CONVERGENCE_SIZE,
    FAILED,
    MAX_ROTATION,
    convergence_status,
    reset_rate,
)
from rover_sim.physics.tether.node_blocks import hermite_weights, interpolated
from rover_sim.physics.tether.point_masses import PointMasses, add_point_masses
from rover_sim.physics.tether.tether import Tether, row_width

_MAX_HALVINGS = 5


class DrivenCable(NamedTuple):
    """Constants and work arrays of a cable between two driven ends."""

    tether: Tether
    drag: AirDrag
    natural: NaturalCurvature
    masses: PointMasses
    tolerance: float  # of the Newton iteration [m]
    work: Workspace
    q: Array  # state: coordinates (6, width)
    v: Array  # state: rates (6, width)
    q1: Array  # work
    v1: Array  # work
    ends: Array  # work: rates of the ends at a step's start and end, (2, 2, 6)
    convergence: Array  # work, see `newton`


def make_driven_cable(
    tether: Tether,
    drag: AirDrag,
    natural: NaturalCurvature,
    masses: PointMasses,
    tolerance: float,
) -> DrivenCable:
    """Allocate the state and the work arrays of a cable."""
    rows = (6, row_width(tether.elements, 3))
    return DrivenCable(
        tether,
        drag,
        natural,
        masses,
        tolerance,
        make_workspace(tether.elements, 3),
        np.zeros(rows),
        np.zeros(rows),
        np.zeros(rows),
        np.zeros(rows),
        np.zeros((2, 2, 6)),
        np.zeros(CONVERGENCE_SIZE),
    )


@inner
def _begin(cable: DrivenCable, h: float, rates0: Array, rates1: Array) -> None:
    """Initial guess of a step: the rates of the inner nodes, the given ones of the ends."""
    n = cable.tether.elements
    work = cable.work
    for k in range(6):
        for i in range(row_width(n, 3)):
            work.increment[k, i] = h * cable.v[k, i]
        work.end_fixed[0, k] = 1.0
        work.end_fixed[1, k] = 1.0
        work.increment[k, 0] = 0.5 * h * (rates0[0, k] + rates1[0, k])
        work.increment[k, n] = 0.5 * h * (rates0[1, k] + rates1[1, k])
        cable.v[k, 0] = rates0[0, k]
        cable.v[k, n] = rates0[1, k]


@checked_inner
def attempt_driven_step(cable: DrivenCable, h: float, rates0: Array, rates1: Array) -> bool:
    """Attempt a step; write its end state to q1 and v1.

    Args:
        cable: constants and state.
        h: [s].
        rates0: rates of position and slope of root and tip at the step's start, (2, 6).
        rates1: the same at its end.

    Returns:
        Whether the iteration converged.
    """
    tether, work = cable.tether, cable.work
    _begin(cable, h, rates0, rates1)
    begin_ends(tether, work)
    begin_step(tether, h, cable.q, cable.v, work)
    if cable.natural.active:
        begin_natural_curvature(tether, cable.q, cable.natural)
    previous = np.inf
    status = CONTINUE
    iteration = 0
    while status == CONTINUE:
        assemble(tether, h, work)
        if cable.drag.normal > 0.0:
            add_drag(cable.drag, tether, h, cable.q, work)
        if cable.natural.active:
            add_natural_curvature(tether, cable.q, work, cable.natural)
        add_point_masses(cable.masses, tether, h, cable.v, work)
        change = solve_increment(tether, work)
        status = convergence_status(iteration, change, previous, cable.tolerance, cable.convergence)
        previous = change
        iteration += 1
    if status == FAILED or not largest_turn(tether, work) < MAX_ROTATION:
        return False
    end_step(tether, h, cable.q, cable.v, work, cable.q1, cable.v1)
    return True


@inner
def _end_step(cable: DrivenCable, h: float) -> None:
    """Carry the frames to the end of an accepted step, and take its end state."""
    tether, law = cable.tether, cable.natural
    if law.active:
        end_natural_curvature(tether, cable.q, cable.q1, law)
        if law.relaxation.share > 0.0:
            relax_bending(tether, cable.q1, h, law)
    for k in range(6):
        for i in range(tether.elements + 1):
            cable.q[k, i] = cable.q1[k, i]
            cable.v[k, i] = cable.v1[k, i]


@checked
def march(
    cable: DrivenCable,
    rates: Array,
    h: float,
    stride: int,
    element: NDArray[np.int64],
    xi: Array,
    positions: Array,
) -> int:
    """Simulate the cable; return the number of frames reached.

    The part of its bending stiffness that relaxes carries no moment at the start.

    Args:
        cable: constants; its state is changed.
        rates: rates of position and slope of root and tip at the steps' ends, (steps + 1, 2, 6).
        h: length of a step [s].
        stride: steps between frames.
        element: element of each marker, (k,).
        xi: place of each marker in its element, (k,).
        positions: filled, (frames, k, 3) [m]; the first frame is the initial state.
    """
    tether = cable.tether
    frames = positions.shape[0]
    reset_rate(cable.convergence)
    if cable.natural.active:
        relax_twist(tether, cable.q, NO_EXIT, True, 0.0, cable.natural)
        if cable.natural.relaxation.share > 0.0:
            relax_bending(tether, cable.q, np.inf, cable.natural)
    start, end = cable.ends[0], cable.ends[1]
    for frame in range(frames):
        if frame > 0:
            for s in range((frame - 1) * stride, frame * stride):
                done = 0.0
                part = 1.0
                while done < 1.0 - 1.0e-9:
                    for side in range(2):
                        for k in range(6):
                            a, b = rates[s, side, k], rates[s + 1, side, k]
                            start[side, k] = a + done * (b - a)
                            end[side, k] = a + (done + part) * (b - a)
                    if not attempt_driven_step(cable, part * h, start, end):
                        reset_rate(cable.convergence)
                        part *= 0.5
                        if part < 0.9 / (1 << _MAX_HALVINGS):
                            return frame
                        continue
                    _end_step(cable, part * h)
                    done += part
        for m in range(element.size):
            place = interpolated(hermite_weights(xi[m], tether.element_length), cable.q, element[m])
            positions[frame, m, 0], positions[frame, m, 1], positions[frame, m, 2] = place
    return frames
