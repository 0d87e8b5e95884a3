"""The planar rover: two bodies on a slider, attached to the last node of a tether.

The paper's axes: x horizontal, y up, theta counter-clockwise, slider axis (-sin theta, cos theta).
The tether is attached to Body 1 at the body-fixed point p = (a, b). Body 2 has Body 1's
orientation; its centre is at b = (0, s) along the slider. With the tether's last node r_n

    G1 = r_n - R p,     G2 = G1 + R b,

so r_n, theta and s are the unknowns and no constraint force appears. The Cayley parameter of a
step's rotation is th = 2 tan(dtheta/2) = h (w0 + w1)/2, which defines the angular velocity w; with
R_m = (R_0 + R_1)/2 the equations of the step are, for f_i = m_i (2/h)(dG_i/h - V_i0) - m_i g,

    last node   tether + f_1 + f_2 = 0
    rotation    (J_1 + J_2)(w1 - w0)/h - R_m p x f_1 + (B - R_m p) x f_2 = 0
    slider      (1 + th^2/4) R_m e_y . f_2 + k (s_m - l_0) + c ds/h = 0

(index m: mean of start and end; B = (R_0 b_0 + R_1 b_1)/2). These levers conserve the angular
momentum; and because (R_1 - R_0) u = th J R_m u exactly (J the quarter turn), the work of the
forces equals the change of the energies: without damping the energy is conserved. Rotation and
slide are condensed into the last node before the tether's elimination.
"""

from typing import NamedTuple

import numpy as np

from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.energy_momentum import Workspace, set_end
from rover_sim.physics.tether.tether import Tether

# Entries of the array `body`.
X1, Y1, THETA, SLIDE, VX1, VY1, VX2, VY2, OMEGA = range(9)
BODY_SIZE = 9


class PlanarRover(NamedTuple):
    """Masses, geometry and spring of the rover."""

    m1: float  # [kg]
    m2: float  # [kg]
    inertia: float  # J1 + J2 about the bodies' own centres [kg m^2]
    attachment_x: float  # a [m]
    attachment_y: float  # b [m]
    spring_rate: float  # k [N/m]
    spring_free_length: float  # l0 [m]
    slider_damping: float  # c [N s/m]


NO_ROVER = PlanarRover(1.0, 1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0)


@inner
def rover_energies(
    rover: PlanarRover, pull: tuple[float, ...], body: Array
) -> tuple[float, float, float]:
    """Kinetic, gravity and spring energy [J] under the gravity vector `pull` [m/s^2].

    The potential of gravity is zero at the origin.
    """
    gx, gy = pull
    x2 = body[X1] - np.sin(body[THETA]) * body[SLIDE]
    y2 = body[Y1] + np.cos(body[THETA]) * body[SLIDE]
    kinetic = 0.5 * (
        rover.m1 * (body[VX1] ** 2 + body[VY1] ** 2)
        + rover.m2 * (body[VX2] ** 2 + body[VY2] ** 2)
        + rover.inertia * body[OMEGA] ** 2
    )
    gravity = -rover.m1 * (gx * body[X1] + gy * body[Y1]) - rover.m2 * (gx * x2 + gy * y2)
    spring = 0.5 * rover.spring_rate * (body[SLIDE] - rover.spring_free_length) ** 2
    return kinetic, gravity, spring


class _StepMotion(NamedTuple):
    """Motion of a step; (c, z) are cosine and sine of theta, m: mean of start and end."""

    th: float  # Cayley parameter of the rotation
    ds: float  # slide [m]
    s1: float  # [m]
    sm: float
    c1: float
    z1: float
    cm: float
    zm: float
    scale: float  # 1 / (1 + th^2/4)
    widening: float  # 1 + th^2/4
    spin: float  # th ds/4 [m]
    px: float  # R_m p [m]
    py: float
    lx: float  # lever B - R_m p [m]
    ly: float


class _StepForces(NamedTuple):
    """Inertia and weight of the bodies in a step [N], and the residuals of their equations."""

    fx1: float
    fy1: float
    fx2: float
    fy2: float
    along: float  # of Body 2 along the slider [N]
    rotation: float  # residual [N m]
    slider: float  # residual [N]


class _StepStiffness(NamedTuple):
    """Derivatives of the residuals by th (t), ds (s) and the last node's position (x, y).

    k_ab is the derivative by b of the equation of a.
    """

    k_tt: float
    k_ts: float
    k_tx: float
    k_ty: float
    k_st: float
    k_ss: float
    k_sx: float
    k_sy: float
    k_xt: float
    k_xs: float
    k_yt: float
    k_ys: float
    k_xx: float  # = k_yy


@inner
def _step_motion(rover: PlanarRover, body: Array, increment: Array) -> _StepMotion:
    th, ds = increment[0], increment[1]
    a, b = rover.attachment_x, rover.attachment_y
    s0 = body[SLIDE]
    sm = s0 + 0.5 * ds
    # Cosines and sines at start, end (the Cayley map) and their means.
    c0, z0 = np.cos(body[THETA]), np.sin(body[THETA])
    scale = 1.0 / (1.0 + 0.25 * th * th)
    turn_c, turn_z = (1.0 - 0.25 * th * th) * scale, th * scale
    c1, z1 = c0 * turn_c - z0 * turn_z, z0 * turn_c + c0 * turn_z
    cm, zm = 0.5 * (c0 + c1), 0.5 * (z0 + z1)
    px, py = cm * a - zm * b, zm * a + cm * b
    spin = 0.25 * th * ds
    lx, ly = -zm * sm - spin * cm - px, cm * sm - spin * zm - py
    return _StepMotion(
        th, ds, s0 + ds, sm, c1, z1, cm, zm, scale, 1.0 + 0.25 * th * th, spin, px, py, lx, ly
    )


@inner
def _step_forces(
    tether: Tether, rover: PlanarRover, h: float, body: Array, m: _StepMotion, work: Workspace
) -> _StepForces:
    gx, gy = tether.gravity
    n = tether.elements
    drx, dry = work.increment[0, n], work.increment[1, n]
    # Displacements of the centres; (R1 - R0) u = th J R_m u with J the quarter turn.
    dx1, dy1 = drx + m.th * m.py, dry - m.th * m.px
    dx2 = dx1 - m.zm * m.ds - m.th * m.cm * m.sm
    dy2 = dy1 + m.cm * m.ds - m.th * m.zm * m.sm
    unit1, unit2 = 2.0 * rover.m1 / h, 2.0 * rover.m2 / h
    fx1 = unit1 * (dx1 / h - body[VX1]) - rover.m1 * gx
    fy1 = unit1 * (dy1 / h - body[VY1]) - rover.m1 * gy
    fx2 = unit2 * (dx2 / h - body[VX2]) - rover.m2 * gx
    fy2 = unit2 * (dy2 / h - body[VY2]) - rover.m2 * gy
    along = -m.zm * fx2 + m.cm * fy2
    rotation = (
        2.0 * rover.inertia / h * (m.th / h - body[OMEGA])
        - (m.px * fy1 - m.py * fx1)
        + (m.lx * fy2 - m.ly * fx2)
    )
    slider = (
        m.widening * along
        + rover.spring_rate * (m.sm - rover.spring_free_length)
        + rover.slider_damping * m.ds / h
    )
    return _StepForces(fx1, fy1, fx2, fy2, along, rotation, slider)


@inner
def _step_stiffness(rover: PlanarRover, h: float, m: _StepMotion, f: _StepForces) -> _StepStiffness:
    a, b = rover.attachment_x, rover.attachment_y
    c1, z1, cm, zm = m.c1, m.z1, m.cm, m.zm
    # By th, dR1/dth being scale J R1; G1 and G2 move by (u1), (u2).
    dcm, dzm = -0.5 * m.scale * z1, 0.5 * m.scale * c1
    p1x, p1y = c1 * a - z1 * b, z1 * a + c1 * b
    u1x, u1y = m.scale * p1y, -m.scale * p1x
    u2x, u2y = u1x - m.scale * c1 * m.s1, u1y - m.scale * z1 * m.s1
    dpx, dpy = dcm * a - dzm * b, dzm * a + dcm * b
    dlx = -dzm * m.sm - 0.25 * m.ds * cm - m.spin * dcm - dpx
    dly = dcm * m.sm - 0.25 * m.ds * zm - m.spin * dzm - dpy
    i1, i2 = 2.0 * rover.m1 / h / h, 2.0 * rover.m2 / h / h
    k_tt = (
        2.0 * rover.inertia / h**2
        - (dpx * f.fy1 - dpy * f.fx1)
        - i1 * (m.px * u1y - m.py * u1x)
        + (dlx * f.fy2 - dly * f.fx2)
        + i2 * (m.lx * u2y - m.ly * u2x)
    )
    k_st = (
        0.5 * m.th * f.along
        + m.widening * (dcm * f.fy2 - dzm * f.fx2)
        + m.widening * i2 * (cm * u2y - zm * u2x)
    )
    k_xt, k_yt = i1 * u1x + i2 * u2x, i1 * u1y + i2 * u2y
    # By s, along which G2 moves by R1 e_y, and by the last node's position.
    k_ts = (
        -(0.5 * zm + 0.25 * m.th * cm) * f.fy2
        - (0.5 * cm - 0.25 * m.th * zm) * f.fx2
        + i2 * (m.lx * c1 + m.ly * z1)
    )
    k_ss = (
        m.widening * i2 * (zm * z1 + cm * c1) + 0.5 * rover.spring_rate + rover.slider_damping / h
    )
    k_tx, k_ty = i1 * m.py - i2 * m.ly, -i1 * m.px + i2 * m.lx
    k_sx, k_sy = -m.widening * i2 * zm, m.widening * i2 * cm
    return _StepStiffness(
        k_tt, k_ts, k_tx, k_ty, k_st, k_ss, k_sx, k_sy, k_xt, -i2 * z1, k_yt, i2 * c1, i1 + i2
    )


@inner
def _condense(f: _StepForces, k: _StepStiffness, z: Array, work: Workspace) -> None:
    """Eliminate th and ds from the equations of the last node."""
    inverse = 1.0 / (k.k_tt * k.k_ss - k.k_ts * k.k_st)
    z[0, 0] = inverse * (k.k_ss * f.rotation - k.k_ts * f.slider)
    z[1, 0] = inverse * (k.k_tt * f.slider - k.k_st * f.rotation)
    z[0, 1] = inverse * (k.k_ss * k.k_tx - k.k_ts * k.k_sx)
    z[1, 1] = inverse * (k.k_tt * k.k_sx - k.k_st * k.k_tx)
    z[0, 2] = inverse * (k.k_ss * k.k_ty - k.k_ts * k.k_sy)
    z[1, 2] = inverse * (k.k_tt * k.k_sy - k.k_st * k.k_ty)
    set_end(work, 1, 4, 0, f.fx1 + f.fx2 - k.k_xt * z[0, 0] - k.k_xs * z[1, 0])
    set_end(work, 1, 4, 1, f.fy1 + f.fy2 - k.k_yt * z[0, 0] - k.k_ys * z[1, 0])
    set_end(work, 1, 0, 0, k.k_xx - k.k_xt * z[0, 1] - k.k_xs * z[1, 1])
    set_end(work, 1, 1, 0, -k.k_xt * z[0, 2] - k.k_xs * z[1, 2])
    set_end(work, 1, 0, 1, -k.k_yt * z[0, 1] - k.k_ys * z[1, 1])
    set_end(work, 1, 1, 1, k.k_xx - k.k_yt * z[0, 2] - k.k_ys * z[1, 2])


@inner
def add_rover(
    tether: Tether,
    rover: PlanarRover,
    h: float,
    body: Array,
    increment: Array,
    z: Array,
    work: Workspace,
) -> None:
    """Add the rover to the tether's tip, condensed onto the last node's position.

    Args:
        tether: constants.
        rover: constants.
        h: length of the step [s].
        body: the rover at the step's start, (BODY_SIZE,).
        increment: current th and ds, (2,).
        z: (2, 3), filled with K_zz^-1 (g, K_zr) of th and ds for `apply_rover_increment`.
        work: of the tether, with its current increment.
    """
    motion = _step_motion(rover, body, increment)
    forces = _step_forces(tether, rover, h, body, motion, work)
    _condense(forces, _step_stiffness(rover, h, motion, forces), z, work)


@inner
def apply_rover_increment(n: int, z: Array, work: Workspace, increment: Array) -> float:
    """Apply the Newton increment of th and ds, given that of node n; returns |dth| + |dds|.

    A sum, because a maximum could drop a NaN.
    """
    size = 0.0
    for k in range(2):
        change = z[k, 0] - z[k, 1] * work.solution[n + 1, 0] - z[k, 2] * work.solution[n + 1, 1]
        increment[k] -= change
        size += abs(change)
    return size


@inner
def end_rover_step(
    n: int,
    rover: PlanarRover,
    h: float,
    body: Array,
    increment: Array,
    work: Workspace,
    body1: Array,
) -> float:
    """Write the rover's state after a converged step; returns the damper's dissipation [J]."""
    th, ds = increment[0], increment[1]
    theta1 = body[THETA] + 2.0 * np.arctan(0.5 * th)
    sm = body[SLIDE] + 0.5 * ds
    cm = 0.5 * (np.cos(body[THETA]) + np.cos(theta1))
    zm = 0.5 * (np.sin(body[THETA]) + np.sin(theta1))
    px = cm * rover.attachment_x - zm * rover.attachment_y
    py = zm * rover.attachment_x + cm * rover.attachment_y
    dx1, dy1 = work.increment[0, n] + th * py, work.increment[1, n] - th * px
    dx2, dy2 = dx1 - zm * ds - th * cm * sm, dy1 + cm * ds - th * zm * sm
    body1[X1] = body[X1] + dx1
    body1[Y1] = body[Y1] + dy1
    body1[THETA] = theta1
    body1[SLIDE] = body[SLIDE] + ds
    body1[VX1] = 2.0 * dx1 / h - body[VX1]
    body1[VY1] = 2.0 * dy1 / h - body[VY1]
    body1[VX2] = 2.0 * dx2 / h - body[VX2]
    body1[VY2] = 2.0 * dy2 / h - body[VY2]
    body1[OMEGA] = 2.0 * th / h - body[OMEGA]
    return rover.slider_damping * ds * ds / h
