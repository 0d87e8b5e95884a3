"""Twist angle of the tether, and the swivel between tether and rover.

The cable elements have no torsion; a spring GJ/L between fairlead and rover represents it. Its
angle is that of the rover against a twist-free (parallel-transported) frame along the tether
(Bishop 1975, American Mathematical Monthly 82): the smallest rotation from one tangent t1 to the
next t2 takes a vector d normal to t1 to

    d - (d.t2)/(1 + t1.t2) (t1 + t2).

The sequence of tangents is: straight down, with d the world's x axis; the slope at the fairlead;
the slopes of the nodes; and the rover's -z axis b, about which the angle of its x axis against d is
measured. On a straight tether this is the swing-twist angle. A rover that cones about the vertical
returns to the same angle, though the integral of w.t does not (it drifts by the solid angle that t
encloses). With the last tangent t constant, the angle changes at the rate

    w.a,   a = (t + b)/(1 + t.b),

so the work of a moment -M a on the rover is exactly -M times the change of the angle.

Where two consecutive tangents are opposite, in a folded tether, the smallest rotation is undefined
and the angle keeps its previous value. The angle is unwrapped to within half a turn of its previous
value.

The swivel is elastic-perfectly plastic: below its friction torque it sticks and the tether twists,
above it slips.
"""

import math

from rover_sim.physics.numerics.compiled import checked, checked_inner
from rover_sim.physics.numerics.vectors import (
    Quaternion,
    Vector,
    add,
    axpy,
    cross,
    dot,
    rotation_of,
    scale,
)
from rover_sim.physics.tether.ancf import Array

FOLDED = 1.0e-3  # 1 + t1.t2 below which the rotation from t1 to t2 is undefined [-]

_DOWN: Vector = (0.0, 0.0, -1.0)
_FORWARD: Vector = (1.0, 0.0, 0.0)


@checked_inner
def direction_of(slope: Vector, otherwise: Vector) -> Vector:
    """Unit vector along a slope; `otherwise` if the slope is too small or not finite."""
    square = dot(slope, slope)
    if not 1.0e-12 < square < math.inf:
        return otherwise
    return scale(1.0 / math.sqrt(square), slope)


@checked_inner
def transported(d: Vector, t1: Vector, t2: Vector) -> tuple[Vector, bool]:
    """Parallel transport of d, normal to t1, from t1 to t2; False if it is undefined."""
    denominator = 1.0 + dot(t1, t2)
    if not denominator > FOLDED:
        return d, False
    return axpy(-dot(d, t2) / denominator, add(t1, t2), d), True


@checked_inner
def tip_direction(elements: int, q: Array) -> Vector:
    """Unit tangent at the last node of a tether with rows q (6, width)."""
    n = elements
    return direction_of((q[3, n], q[4, n], q[5, n]), _DOWN)


@checked_inner
def twist_axis(elements: int, q: Array, orientation: Quaternion) -> Vector:
    """Vector a (3,) with which the twist changes at the rate w.a; zero if folded."""
    t = tip_direction(elements, q)
    b = scale(-1.0, rotation_of(orientation)[2])
    denominator = 1.0 + dot(t, b)
    if not denominator > FOLDED:
        return (0.0, 0.0, 0.0)
    return scale(1.0 / denominator, add(t, b))


@checked
def twist_angle(
    elements: int, slope: Vector, q: Array, orientation: Quaternion, before: float
) -> float:
    """Twist of the tether [rad], positive for a rotation of the rover about its -z axis (down).

    Args:
        elements: n.
        slope: at the fairlead, (3,).
        q: rows (6, width) of the chain's nodes.
        orientation: of the rover, body to world.
        before: the angle of the previous step, for unwrapping and for a folded tether.
    """
    body = rotation_of(orientation)
    t1 = _DOWN
    d = _FORWARD
    t2 = direction_of((slope[0], slope[1], slope[2]), t1)
    for i in range(-1, elements + 2):
        if i == elements + 1:
            t2 = scale(-1.0, body[2])
        elif i >= 0:
            t2 = direction_of((q[3, i], q[4, i], q[5, i]), t1)
        d, defined = transported(d, t1, t2)
        if not defined:
            return before
        t1 = t2
    sine = dot(cross(d, body[0]), t1)
    cosine = dot(d, body[0])
    if not sine * sine + cosine * cosine > 0.25:  # 1, up to rounding
        return before
    turn = math.atan2(sine, cosine) - before
    turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
    return before + turn


@checked_inner
def swivel_torque(
    stiffness: float, friction: float, twist: float, slip: float
) -> tuple[float, float, float]:
    """Torque of the twisted tether on the rover, and slip of the swivel.

    Args:
        stiffness: GJ/L [N m/rad].
        friction: torque at which the swivel slips [N m]; 0: free, inf: clamped.
        twist: angle of the rover against the tether's frame [rad].
        slip: of the swivel before the step [rad].

    Returns:
        Torque on the rover about `twist_axis` [N m]; slip after the step [rad]; heat of slip [J].
    """
    elastic = stiffness * (twist - slip)
    if abs(elastic) <= friction:
        return -elastic, slip, 0.0
    limit = math.copysign(friction, elastic)
    after = twist - limit / stiffness
    return -limit, after, friction * abs(after - slip)


@checked_inner
def twist_energy(stiffness: float, twist: float, slip: float) -> float:
    """Elastic energy of the twisted tether [J]."""
    return 0.5 * stiffness * (twist - slip) ** 2
