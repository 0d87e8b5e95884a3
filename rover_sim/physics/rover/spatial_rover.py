"""The spatial rover: two bodies on a slider, attached to the last node of a tether.

World axes: z up. Body axes: REP-103, z along the slider. The tether is attached to Body 1 at the
body-fixed point p; Body 2 has Body 1's orientation and its centre is at s along the body's z axis
e, beside Body 1's centre by the offset o. With the tether's last node r_n and the orientation R

    G1 = r_n - R p,     G2 = G1 + R (o + s e),

so r_n, R and s are the unknowns and no constraint force appears. The rotation of a step is the
Cayley vector th (body axes), whose rate is the mean angular velocity, th = h (W0 + W1)/2; with
R_m = (R_0 + R_1)/2, index m for means of start and end, and f_i = m_i (2/h)(dG_i/h - V_i0) - m_i g
the equations of the step are

    last node   tether + f_1 + f_2 - F = 0
    rotation    [R_1 (J W1 + H_1) - R_0 (J W0 + H_0)]/h
                - R_m p x f_1 + ((R_0 e s_0 + R_1 e s_1)/2 + R_m (o - p)) x f_2 - M = 0
    slider      R_0 (e + th x e/2) . f_2 - F_s - S = 0

J is the inertia of both bodies about their own centres without the spin inertia of the rotors,
whose absolute axial momenta are H (body axes); F_s pushes the bodies apart (module `slider`), its
mean in the step; F, M and S are the external loads: the force, the moment about the last node and
the force along the slider. The levers are means of start and end, so the angular momentum is
conserved; because
(R_1 - R_0) u = (R_0 th) x (R_m u) exactly, and with the slider's direction above, the work of these
forces equals the change of the energies (Simo and Wong 1991, IJNME 31; the planar case is the
scheme of `planar_rover`). For the same reasons the work of an external force at a point of a body
is exactly force times the point's travel (`add_point_load`). Rotation and slide are condensed into
the last node before the tether's elimination.
"""

from typing import NamedTuple

import numpy as np

from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.numerics.vectors import (
    Matrix,
    Rotation,
    Vector,
    add,
    axpy,
    cayley,
    cayley_change,
    cayley_tangent,
    cayley_update,
    cross,
    dot,
    product,
    rotate,
    rotation_of,
    scale,
    sub,
)
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.energy_momentum import Workspace, set_end

# Entries of the array `body`: centre of Body 1, its orientation (w, x, y, z), the angular velocity
# in body axes, the velocities of both centres, the slide and the rotors' momenta in body axes.
POSITION, ORIENTATION, SPIN, VELOCITY1, VELOCITY2, SLIDE, ROTORS = 0, 3, 7, 10, 13, 16, 17
BODY_SIZE = 20


class SpatialRover(NamedTuple):
    """Masses and geometry of the rover; inertias about the bodies' own centres."""

    m1: float  # [kg]
    m2: float  # [kg]
    inertia: Vector  # principal moments of J1 + J2 about the body axes, without rotors [kg m^2]
    attachment: Vector  # p [m]
    offset: Vector = (0.0, 0.0, 0.0)  # o of the slider's axis [m]; its z is 0


class RoverStep(NamedTuple):
    """Arrays of the rover's part of a step."""

    increment: Array  # (4,): th and ds
    coupling: Array  # (4, 8): rows of rotation and slide, columns th, ds, last node, residual
    return_coupling: Array  # (3, 4): last node's rows, columns th, ds
    slide: Array  # (2,): mean force F_s [N] and its derivative by the change of s [N/m]
    load: Array  # (7,): external loads F [N], M about the last node [N m] and S [N]
    load_tangent: Array  # (7, 7): their derivatives by th, ds and the last node's position
    rotors_after: Array  # (3,): H_1, rotor momenta at the step's end


def make_rover_step() -> RoverStep:
    """Allocate the arrays of the rover's part."""
    return RoverStep(
        np.zeros(4),
        np.zeros((4, 8)),
        np.zeros((3, 4)),
        np.zeros(2),
        np.zeros(7),
        np.zeros((7, 7)),
        np.zeros(3),
    )


@inner
def vector_at(array: Array, start: int) -> Vector:
    """Three consecutive entries as a vector."""
    return (array[start], array[start + 1], array[start + 2])


@inner
def set_vector_at(array: Array, start: int, value: Vector) -> None:
    """Write three consecutive entries."""
    array[start], array[start + 1], array[start + 2] = value


@inner
def orientation(body: Array) -> tuple[float, float, float, float]:
    """The quaternion (w, x, y, z)."""
    q = ORIENTATION
    return (body[q], body[q + 1], body[q + 2], body[q + 3])


@inner
def _times(inertia: Vector, u: Vector) -> Vector:
    """J u for principal moments J."""
    return (inertia[0] * u[0], inertia[1] * u[1], inertia[2] * u[2])


@inner
def _set_column(matrix: Array, row: int, column: int, value: Vector) -> None:
    """Write a vector down a column."""
    for d in range(3):
        matrix[row + d, column] = value[d]


class Pose(NamedTuple):
    """The rover at the start and the end of a step, from th and ds."""

    start: Rotation  # R_0
    th: Vector
    attachment0: Vector  # R_0 p
    attachment1: Vector  # R_1 p
    axis0: Vector  # R_0 e
    axis1: Vector  # R_1 e
    attachment_change: Vector  # R_1 p - R_0 p
    offset0: Vector  # R_0 o
    offset1: Vector  # R_1 o
    offset_change: Vector
    axis_change: Vector
    s0: float
    s1: float
    ds: float


@inner
def pose_of(rover: SpatialRover, body: Array, increment: Array) -> Pose:
    """Pose of the rover for the increments th and ds."""
    start = rotation_of(orientation(body))
    th = vector_at(increment, 0)
    s0, ds = body[SLIDE], increment[3]
    attachment0 = rotate(start, rover.attachment)
    attachment_change = rotate(start, cayley_change(th, rover.attachment))
    offset0 = rotate(start, rover.offset)
    offset_change = rotate(start, cayley_change(th, rover.offset))
    axis_change = rotate(start, cayley_change(th, (0.0, 0.0, 1.0)))
    return Pose(
        start,
        th,
        attachment0,
        add(attachment0, attachment_change),
        start[2],
        add(start[2], axis_change),
        attachment_change,
        offset0,
        add(offset0, offset_change),
        offset_change,
        axis_change,
        s0,
        s0 + ds,
        ds,
    )


@inner
def slide_rate(rover: SpatialRover, body: Array) -> float:
    """Rate of the slide s' [m/s]: of Body 2's velocity, without that by the rotation at o."""
    axis = rotation_of(orientation(body))[2]
    apart = dot(axis, sub(vector_at(body, VELOCITY2), vector_at(body, VELOCITY1)))
    return apart - (body[SPIN] * rover.offset[1] - body[SPIN + 1] * rover.offset[0])


@inner
def _tip_increment(n: int, work: Workspace) -> Vector:
    """Increment of the last node's position."""
    increment = work.increment
    return (increment[0, n], increment[1, n], increment[2, n])


@inner
def _displacements(pose: Pose, dr: Vector) -> tuple[Vector, Vector]:
    """Displacements of the centres of both bodies when the last node moves by dr.

    Computed from changes of the levers: the rounding error of a difference of levers, times
    2 m/h^2, would be a noticeable force.
    """
    first = sub(dr, pose.attachment_change)
    along = axpy(pose.s0, pose.axis_change, scale(pose.ds, pose.axis1))
    return first, add(first, add(along, pose.offset_change))


@inner
def _slider_direction(pose: Pose, th: Vector) -> Vector:
    """Direction R_0 (e + th x e/2) of the slider's force, with which its work is exact."""
    return axpy(0.5, rotate(pose.start, cross(th, (0.0, 0.0, 1.0))), pose.axis0)


@inner
def clear_loads(step: RoverStep) -> None:
    """Set the external loads to zero."""
    for r in range(7):
        step.load[r] = 0.0
        for c in range(7):
            step.load_tangent[r, c] = 0.0


@inner
def point_travel(
    pose: Pose, dr: Vector, point: Vector, attachment: Vector, sliding: bool
) -> tuple[Vector, Vector]:
    """Lever at the step's end [m] and travel in the step [m] of a point of one of the bodies.

    Args:
        pose: of the step.
        dr: travel of the last node [m].
        point: in base_link [m]; of Body 2 (`sliding`) as at s = 0.
        attachment: p [m].
        sliding: whether the point is Body 2's.

    Returns:
        The lever from the last node to the point at the end, and the point's travel.
    """
    lever0, lever1 = levers(pose, point, attachment, sliding)
    return lever1, add(dr, sub(lever1, lever0))


@inner
def levers(pose: Pose, point: Vector, attachment: Vector, sliding: bool) -> tuple[Vector, Vector]:
    """Levers from the last node to a point at the step's start and end."""
    rigid = sub(point, attachment)
    lever0 = rotate(pose.start, rigid)
    lever1 = rotate(pose.start, cayley(pose.th, rigid))
    if sliding:
        lever0 = axpy(pose.s0, pose.axis0, lever0)
        lever1 = axpy(pose.s1, pose.axis1, lever1)
    return lever0, lever1


@inner
def add_point_load(
    step: RoverStep,
    pose: Pose,
    attachment: Vector,
    point: Vector,
    sliding: bool,
    force: Vector,
    tangent: Matrix,
) -> None:
    """Add an external force on one of the bodies, averaged over the step.

    Args:
        step: added to.
        pose: of the step.
        attachment: p [m].
        point: as for `point_travel`.
        sliding: whether the point is Body 2's.
        force: on the body [N], world axes.
        tangent: derivative of the force by the point's travel [N/m], rows, (9,).
    """
    lever0, lever1 = levers(pose, point, attachment, sliding)
    lever = scale(0.5, add(lever0, lever1))
    moment = cross(lever, force)
    axis = _slider_direction(pose, pose.th)
    for d in range(3):
        step.load[d] += force[d]
        step.load[3 + d] += moment[d]
    if sliding:
        step.load[6] += dot(axis, force)
    for c in range(7):
        unit = (
            1.0 if c in (0, 4) else 0.0,
            1.0 if c in (1, 5) else 0.0,
            1.0 if c in (2, 6) else 0.0,
        )
        swept = (0.0, 0.0, 0.0)
        if c < 3:
            turn = rotate(pose.start, cayley_tangent(pose.th, unit))
            swept = cross(turn, lever1)
        elif c == 3:
            if not sliding:
                continue
            swept = pose.axis1
        change = product(tangent, unit if c > 3 else swept)
        turned_moment = add(cross(lever, change), scale(0.5, cross(swept, force)))
        for d in range(3):
            step.load_tangent[d, c] += change[d]
            step.load_tangent[3 + d, c] += turned_moment[d]
        if sliding:
            along = dot(axis, change)
            if c < 3:
                along += 0.5 * dot(force, rotate(pose.start, cross(unit, (0.0, 0.0, 1.0))))
            step.load_tangent[6, c] += along


@inner
def _inertia_force(mass: float, h: float, change: Vector, rate: Vector, gravity: Vector) -> Vector:
    """F = m (2/h)(dG/h - V0) - m g."""
    return axpy(-mass, gravity, scale(2.0 * mass / h, axpy(-1.0, rate, scale(1.0 / h, change))))


@inner
def add_rover(
    rover: SpatialRover,
    gravity: Vector,
    h: float,
    n: int,
    body: Array,
    work: Workspace,
    step: RoverStep,
) -> None:
    """Add the rover to the tip of a tether of n elements, condensed onto the last node."""
    th = vector_at(step.increment, 0)
    pose = pose_of(rover, body, step.increment)
    d1, d2 = _displacements(pose, _tip_increment(n, work))
    f1 = _inertia_force(rover.m1, h, d1, vector_at(body, VELOCITY1), gravity)
    f2 = _inertia_force(rover.m2, h, d2, vector_at(body, VELOCITY2), gravity)
    i1, i2 = 2.0 * rover.m1 / h**2, 2.0 * rover.m2 / h**2

    e = (0.0, 0.0, 1.0)
    axis = _slider_direction(pose, th)
    lever1 = scale(-0.5, add(pose.attachment0, pose.attachment1))
    reach = add(scale(0.5 * pose.s0, pose.axis0), scale(0.5 * pose.s1, pose.axis1))
    reach = add(reach, scale(0.5, add(pose.offset0, pose.offset1)))
    lever2 = add(reach, lever1)

    spin0 = vector_at(body, SPIN)
    spin1 = axpy(-1.0, spin0, scale(2.0 / h, th))
    momentum0 = rotate(pose.start, add(_times(rover.inertia, spin0), vector_at(body, ROTORS)))
    inside = add(_times(rover.inertia, spin1), vector_at(step.rotors_after, 0))
    momentum1 = rotate(pose.start, cayley(th, inside))
    rotation = scale(1.0 / h, sub(momentum1, momentum0))
    rotation = add(rotation, add(cross(lever1, f1), cross(lever2, f2)))
    rotation = sub(rotation, vector_at(step.load, 3))
    slider = dot(axis, f2) - step.slide[0] - step.load[6]
    force = sub(add(f1, f2), vector_at(step.load, 0))

    # Derivatives. R_1 u changes by (R_0 A dth) x R_1 u, R_m u by half of it.
    rows, back = step.coupling, step.return_coupling
    for k in range(3):
        unit = (1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0)
        turn = rotate(pose.start, cayley_tangent(th, unit))
        move1 = cross(pose.attachment1, turn)
        move_axis = cross(turn, pose.axis1)
        move2 = add(axpy(pose.s1, move_axis, move1), cross(turn, pose.offset1))
        spun = rotate(pose.start, cayley(th, _times(rover.inertia, unit)))
        change = scale(1.0 / h, axpy(2.0 / h, spun, cross(turn, momentum1)))
        change = axpy(i1, cross(lever1, move1), change)
        change = axpy(i2, cross(lever2, move2), change)
        change = axpy(0.5, cross(move1, f1), change)
        change = axpy(0.5, cross(move2, f2), change)
        _set_column(rows, 0, k, change)
        rows[3, k] = i2 * dot(axis, move2) + 0.5 * dot(f2, rotate(pose.start, cross(unit, e)))
        _set_column(back, 0, k, axpy(i1, move1, scale(i2, move2)))
        _set_column(rows, 0, 4 + k, axpy(i1, cross(lever1, unit), scale(i2, cross(lever2, unit))))
        rows[3, 4 + k] = i2 * axis[k]
    _set_column(rows, 0, 3, axpy(i2, cross(lever2, pose.axis1), scale(0.5, cross(pose.axis1, f2))))
    rows[3, 3] = i2 * dot(axis, pose.axis1) - step.slide[1]
    _set_column(back, 0, 3, scale(i2, pose.axis1))
    _set_column(rows, 0, 7, rotation)
    rows[3, 7] = slider
    outside = step.load_tangent
    for c in range(7):
        for r in range(4):
            rows[r, c] -= outside[3 + r, c]
    for c in range(4):
        for r in range(3):
            back[r, c] -= outside[r, c]

    _solve_rows(rows)
    for r in range(3):
        residual = force[r]
        for k in range(4):
            residual -= back[r, k] * rows[k, 7]
        set_end(work, 1, 6, r, residual)
        for c in range(3):
            entry = (i1 + i2 if r == c else 0.0) - outside[r, 4 + c]
            for k in range(4):
                entry -= back[r, k] * rows[k, 4 + c]
            set_end(work, 1, c, r, entry)


@inner
def _solve_rows(rows: Array) -> None:
    """Gauss-Jordan with row pivoting on the first four of eight columns, in place."""
    for k in range(4):
        best = k
        for r in range(k + 1, 4):
            if abs(rows[r, k]) > abs(rows[best, k]):
                best = r
        if best != k:
            for c in range(k, 8):
                rows[k, c], rows[best, c] = rows[best, c], rows[k, c]
        inverse = 1.0 / rows[k, k]
        for c in range(k, 8):
            rows[k, c] *= inverse
        for r in range(4):
            if r != k:
                multiplier = rows[r, k]
                for c in range(k, 8):
                    rows[r, c] -= multiplier * rows[k, c]


@inner
def apply_rover_increment(n: int, work: Workspace, step: RoverStep) -> float:
    """Apply the Newton increment of th and ds, given the last node's; returns sum of magnitudes."""
    largest = 0.0
    for k in range(4):
        change = step.coupling[k, 7]
        for c in range(3):
            change -= step.coupling[k, 4 + c] * work.solution[n + 1, c]
        step.increment[k] -= change
        largest += abs(change)
    return largest


@inner
def end_rover_step(
    rover: SpatialRover,
    h: float,
    n: int,
    body: Array,
    work: Workspace,
    step: RoverStep,
    after: Array,
) -> None:
    """Write the rover's state after a converged step."""
    th = vector_at(step.increment, 0)
    pose = pose_of(rover, body, step.increment)
    d1, d2 = _displacements(pose, _tip_increment(n, work))
    set_vector_at(after, POSITION, add(vector_at(body, POSITION), d1))
    quaternion = cayley_update(orientation(body), th)
    for k in range(4):
        after[ORIENTATION + k] = quaternion[k]
    set_vector_at(after, SPIN, axpy(-1.0, vector_at(body, SPIN), scale(2.0 / h, th)))
    set_vector_at(after, VELOCITY1, axpy(-1.0, vector_at(body, VELOCITY1), scale(2.0 / h, d1)))
    set_vector_at(after, VELOCITY2, axpy(-1.0, vector_at(body, VELOCITY2), scale(2.0 / h, d2)))
    after[SLIDE] = pose.s1
    set_vector_at(after, ROTORS, vector_at(step.rotors_after, 0))


@inner
def rover_energies(rover: SpatialRover, gravity: Vector, body: Array) -> tuple[float, float]:
    """Kinetic (without the rotors' spin) and gravity energy of the rover [J]."""
    centre1 = vector_at(body, POSITION)
    start = rotation_of(orientation(body))
    centre2 = axpy(body[SLIDE], start[2], add(centre1, rotate(start, rover.offset)))
    v1, v2, spin = vector_at(body, VELOCITY1), vector_at(body, VELOCITY2), vector_at(body, SPIN)
    kinetic = 0.5 * (
        rover.m1 * dot(v1, v1) + rover.m2 * dot(v2, v2) + dot(spin, _times(rover.inertia, spin))
    )
    weight = -rover.m1 * dot(gravity, centre1) - rover.m2 * dot(gravity, centre2)
    return kinetic, weight
