"""Quadratic drag of the air on the tether, by the cross-flow principle.

The force per length on a slender cylinder whose velocity relative to the air has the part v_n
normal to its axis and v_t along it (Hoerner 1965, Fluid-Dynamic Drag, section 3-4: the cross-flow
principle; Morison et al. 1950, J. Petroleum Technology 2, for the normal part) is

    f = -c_n |v_n| v_n - c_t |v_t| v_t,    c_n = rho C_n d / 2,   c_t = pi rho C_t d / 2,

with air density rho, diameter d, C_n about 1.1 and C_t about 0.02 for a smooth cylinder between
Reynolds numbers of 1e2 and 1e5. The force acts at the two Gauss points of each element, each for
half of its length, at mid-step, so its work is never positive relative to the air.
"""

import math
from typing import Any, NamedTuple

from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.numerics.vectors import Vector, axpy, dot, scale, sub
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.energy_momentum import Workspace
from rover_sim.physics.tether.node_blocks import hermite_weights, interpolated, subtract_force
from rover_sim.physics.tether.tether import Tether

_POINTS = (0.5 - math.sqrt(1.0 / 12.0), 0.5 + math.sqrt(1.0 / 12.0))


class AirDrag(NamedTuple):
    """Coefficients per length of tether and wind."""

    normal: float  # c_n [kg/m2]; 0: no air
    axial: float  # c_t [kg/m2]
    wind: Vector  # velocity of the air [m/s]


NO_AIR = AirDrag(0.0, 0.0, (0.0, 0.0, 0.0))


@inner
def drag_force(drag: AirDrag, velocity: Vector, axis: Vector) -> tuple[Vector, Any]:
    """Drag per length [N/m] and its derivative by the velocity (xx, xy, xz, yy, yz, zz).

    Args:
        drag: coefficients.
        velocity: of the tether relative to the air [m/s].
        axis: unit vector along the tether.
    """
    speed = dot(velocity, axis)
    normal = axpy(-speed, axis, velocity)
    size = math.sqrt(dot(normal, normal))
    along = drag.axial * abs(speed)
    across = drag.normal * size
    force = scale(-along * speed, axis)
    force = axpy(-across, normal, force)
    # -across (I - t t^T) - c_n n n^T / |n| - 2 along t t^T
    shape = drag.normal / (size + 1.0e-9)
    over = across - 2.0 * along
    t, n = axis, normal
    return force, (
        over * t[0] * t[0] - shape * n[0] * n[0] - across,
        over * t[0] * t[1] - shape * n[0] * n[1],
        over * t[0] * t[2] - shape * n[0] * n[2],
        over * t[1] * t[1] - shape * n[1] * n[1] - across,
        over * t[1] * t[2] - shape * n[1] * n[2],
        over * t[2] * t[2] - shape * n[2] * n[2] - across,
    )


@inner
def _point_drag(
    drag: AirDrag, tether: Tether, h: float, q0: Array, e: int, g: int, work: Workspace
) -> tuple[Any, Vector, Vector, Any]:
    """Weights, travel, force [N] and its derivative by the travel at a Gauss point."""
    length = tether.element_length
    weights = hermite_weights(_POINTS[g], length)
    travel = interpolated(weights, work.increment, e)
    axis = (
        q0[0, e + 1] - q0[0, e] + 0.5 * (work.increment[0, e + 1] - work.increment[0, e]),
        q0[1, e + 1] - q0[1, e] + 0.5 * (work.increment[1, e + 1] - work.increment[1, e]),
        q0[2, e + 1] - q0[2, e] + 0.5 * (work.increment[2, e + 1] - work.increment[2, e]),
    )
    axis = scale(1.0 / math.sqrt(dot(axis, axis) + 1.0e-24), axis)
    force, tangent = drag_force(drag, sub(scale(1.0 / h, travel), drag.wind), axis)
    part = 0.5 * length
    rate = part / h
    return (
        weights,
        travel,
        scale(part, force),
        (
            rate * tangent[0],
            rate * tangent[1],
            rate * tangent[2],
            rate * tangent[3],
            rate * tangent[4],
            rate * tangent[5],
        ),
    )


@inner
def add_drag(drag: AirDrag, tether: Tether, h: float, q0: Array, work: Workspace) -> None:
    """Add the drag at the increment in `work` to the elements' residual and tangent."""
    for e in range(tether.elements):
        for g in range(2):
            weights, _, force, tangent = _point_drag(drag, tether, h, q0, e, g, work)
            subtract_force(weights, e, force, tangent, work.blocks)


@inner
def drag_loss(drag: AirDrag, tether: Tether, h: float, q0: Array, work: Workspace) -> float:
    """Work of the tether on the air in the step [J]."""
    loss = 0.0
    for e in range(tether.elements):
        for g in range(2):
            _, travel, force, _ = _point_drag(drag, tether, h, q0, e, g, work)
            loss -= dot(force, travel)
    return loss
