"""Contact of a point with the ground: Hunt-Crossley normal force, Coulomb friction, anchor.

All laws are written for an implicit step of length h that carries the point from a depth d0 to a
depth d1 (positive: inside the ground) by the travel u = x1 - x0. They give the force averaged over
the step and its derivative with respect to u, which is what a Newton iteration on x1 needs. The
force is continuously differentiable in u.

Normal force (Hunt and Crossley 1975, J. Applied Mechanics 42(2)):

    N = f_e max(0, 1 + 3/2 c d'),    f_e = (U(d1) - U(d0)) / (d1 - d0),    U(d) = 2/5 k d^(5/2),

with d' = (d1 - d0)/h. f_e is the discrete gradient of U (Gonzalez 1996, J. Nonlinear Science 6), a
step average of k d^(3/2): its work is exactly the change of the elastic energy U for every step
length, through touchdown and lift-off too, so an undamped contact conserves energy and a damped one
(c > 0) dissipates. The maximum is smoothed within `FACTOR_ROUNDING`.

Friction: a bristle spring of stiffness k_a with deflection e, tangential to the ground, that
carries at most the Coulomb limit L = mu(v) N, in parallel with regularised Coulomb friction
(mu N v / sqrt(v^2 + v_s^2)) that carries the remainder of the limit:

    F_t = -S e/|e| - (L - S) v / sqrt(v^2 + v_s^2),     S = min(k_a |e|, L),

mu(v) = mu_k + (mu_s - mu_k) / (1 + (v/v_st)^2) falls from its static to its kinetic value. With
k_a = 0 this is regularised Coulomb friction alone, which creeps on a slope at about
v_s tan(alpha)/mu. With k_a > 0 the spring is the parking anchor: below the limit a body at rest
does not creep; during sliding the spring stays at its limit and |F_t| = L. The minimum is
smoothed within `LIMIT_ROUNDING`, so a body does not creep up to (1 - LIMIT_ROUNDING) mu N.
The spring is elastic-perfectly plastic (the one-dimensional form is Prandtl's, and LuGre's with
the drift removed: Dupont, Hayward, Armstrong and Altpeter 2002, IEEE Trans. Automatic Control
47(5)): it stores 1/2 k_a e^2 for every N, its limit only shortens e, and the remaining force
opposes v, so no closed cycle of motion and load gains energy.

The deflection is a state. `advance_bristle` updates it once after an accepted step; inside the
Newton iteration it keeps its value at the step's start.

Vectors are tuples of three floats in the world frame; SI units.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas.configuration import Configuration, ConfigurationError, quantity
from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.numerics.named_parameters import from_parameters
from rover_sim.physics.numerics.vectors import Matrix, Vector

FACTOR_ROUNDING = 0.1  # half-width in 1 + 3/2 c d' over which max(0, .) is smoothed [-]
TOUCH = 1.0e-15  # a smaller depth is no contact, so that no quotient degenerates [m]
LIMIT_ROUNDING = 0.05  # half-width in k_a |e| / L over which min(., 1) is smoothed [-]

NO_VECTOR: Vector = (0.0, 0.0, 0.0)
NO_MATRIX: Matrix = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class ContactLaw(NamedTuple):
    """Contact parameters of a pair of materials, for compiled functions."""

    stiffness: float  # k [N/m^1.5]
    damping: float  # c [s/m]
    static_friction: float  # mu_s [-]
    kinetic_friction: float  # mu_k [-]
    stribeck_speed: float  # v_st [m/s]
    slip_speed: float  # v_s [m/s]
    anchor_stiffness: float  # k_a [N/m]


@dataclass(frozen=True)
class ContactParameters(Configuration):
    """A pair of materials in contact at a point: of the rover's corners or wheels and the ground.

    Choose the anchor's stiffness by the largest permitted deflection at rest, weight sin(alpha) /
    k_a over all contacts, and no stiffer: the tether's light contact points need k_a near
    mu N / 0.1 mm.
    """

    stiffness: float = quantity("N/m^1.5", "k of k d^1.5", above=0.0)
    damping: float = quantity(  # restitution is about 1 - c v
        "s/m", "c of 1 + 1.5 c d'", 0.5, minimum=0.0
    )
    static_friction: float = quantity("-", "mu at rest", 0.6, minimum=0.0, maximum=5.0)
    kinetic_friction: float = quantity("-", "mu sliding", 0.5, minimum=0.0, maximum=5.0)
    stribeck_speed: float = quantity("m/s", "Stribeck velocity", 0.05, above=0.0)
    slip_speed: float = quantity("m/s", "of the friction's regularisation", 0.002, above=0.0)
    anchor_stiffness: float = quantity("N/m", "of the parking anchor", 1.0e5, minimum=0.0)

    def check(self) -> None:
        """Refuse a friction at rest below that of sliding."""
        if self.static_friction < self.kinetic_friction:
            raise ConfigurationError(
                "static_friction",
                self.static_friction,
                f"should be at least the kinetic_friction of {self.kinetic_friction:g}",
            )

    def law(self) -> ContactLaw:
        """The same numbers for compiled functions."""
        return from_parameters(ContactLaw, self)


# A standing wheel sinks in by a tenth of a millimetre. With a hundredth of this stiffness Body 1
# would bounce while the spring accelerates Body 2, and a jump would lose a tenth of its height.
# Restitution is 0.36 at 0.8 m/s, as after a jump of 0.2 m, and 0.83 at 0.1 m/s [our choice]; normal
# impacts of stones on rock, talus and asphalt, which are faster, have about 0.2 (Wyllie 2014, Int.
# J. Rock Mechanics and Mining Sciences 67).
ROCK = ContactParameters(stiffness=1.0e7, damping=2.0)
REGOLITH = ContactParameters(stiffness=2.0e4)


@inner
def blend_laws(first: ContactLaw, second: ContactLaw, weight: float) -> ContactLaw:
    """The law between two materials: `first` at weight 0, `second` at weight 1, linear between."""
    w0 = 1.0 - weight
    w1 = weight
    return ContactLaw(
        w0 * first.stiffness + w1 * second.stiffness,
        w0 * first.damping + w1 * second.damping,
        w0 * first.static_friction + w1 * second.static_friction,
        w0 * first.kinetic_friction + w1 * second.kinetic_friction,
        w0 * first.stribeck_speed + w1 * second.stribeck_speed,
        w0 * first.slip_speed + w1 * second.slip_speed,
        w0 * first.anchor_stiffness + w1 * second.anchor_stiffness,
    )


@inner
def damping_factor(damping: float, rate: float) -> tuple[float, float]:
    """Factor max(0, 1 + 3/2 c d'), smoothed at 0, and its derivative with respect to d' [s/m].

    The factor stays within [0, 1] while d' < 0, so damping never adds energy.

    Args:
        damping: c [s/m].
        rate: d' [m/s], positive when the depth increases.
    """
    slope = 1.5 * damping
    y = 1.0 + slope * rate
    if y >= FACTOR_ROUNDING:
        return y, slope
    if y <= -FACTOR_ROUNDING:
        return 0.0, 0.0
    t = y + FACTOR_ROUNDING
    return t * t * (0.25 / FACTOR_ROUNDING), t * (0.5 / FACTOR_ROUNDING) * slope


@inner
def normal_force(law: ContactLaw, depth0: float, depth1: float, h: float) -> tuple[float, float]:
    """Normal force N [N] averaged over a step, and dN/dd1 [N/m].

    Args:
        law: materials.
        depth0: d at the step's start [m]; negative when clear of the ground.
        depth1: d at its end [m].
        h: length of the step [s].
    """
    if depth1 <= TOUCH:
        if depth0 <= TOUCH:
            return 0.0, 0.0
        # leaves: U(d0) is spent over the whole travel d0 - d1
        inverse = 1.0 / (depth0 - min(depth1, 0.0))
        elastic = 0.4 * law.stiffness * depth0 * depth0 * math.sqrt(depth0) * inverse
        tangent = elastic * inverse
    elif depth0 <= TOUCH:
        # arrives
        inverse = 1.0 / (depth1 - min(depth0, 0.0))
        root = law.stiffness * depth1 * math.sqrt(depth1) * inverse
        elastic = 0.4 * root * depth1
        tangent = root - elastic * inverse
    else:
        # (d1^5/2 - d0^5/2) / (d1 - d0) with a = sqrt(d0), b = sqrt(d1), without cancellation
        a = math.sqrt(depth0)
        b = math.sqrt(depth1)
        inverse = 1.0 / (a + b)
        unit = 0.4 * law.stiffness * inverse
        elastic = unit * (depth0 * (depth0 + a * b + depth1) + depth1 * (a * b + depth1))
        tangent = (0.5 * unit * inverse) * (
            2.0 * depth0 * (a + 2.0 * b) + 3.0 * depth1 * (2.0 * a + b)
        )
    factor, slope = damping_factor(law.damping, (depth1 - depth0) / h)
    return elastic * factor, tangent * factor + elastic * slope / h


@inner
def friction_coefficient(law: ContactLaw, speed_squared: float) -> tuple[float, float]:
    """Coefficient mu(v) [-] and d mu / d(v^2) [s^2/m^2]."""
    unit = 1.0 / (law.stribeck_speed * law.stribeck_speed)
    fall = 1.0 / (1.0 + speed_squared * unit)
    excess = (law.static_friction - law.kinetic_friction) * fall
    return law.kinetic_friction + excess, -excess * fall * unit


@inner
def smooth_cap(ratio: float) -> tuple[float, float]:
    """min(ratio, 1), smoothed at 1 from below, and its derivative; ratio >= 0."""
    if ratio <= 1.0 - LIMIT_ROUNDING:
        return ratio, 1.0
    if ratio >= 1.0 + LIMIT_ROUNDING:
        return 1.0, 0.0
    t = ratio - (1.0 - LIMIT_ROUNDING)
    return ratio - t * t * (0.25 / LIMIT_ROUNDING), 1.0 - t * (0.5 / LIMIT_ROUNDING)


class _AnchorPull(NamedTuple):
    """Pull of an anchor at mid-step."""

    force: float  # S [N]
    stiffness: float  # S over the deflection [N/m]
    slope: float  # dS/dw along the deflection [N/m]
    along: float  # what a slip along the deflection changes less than one across it [N/m]
    by_limit: float  # dS/dL [-]
    is_limited: bool  # whether S depends on the Coulomb limit


@inner
def _anchor_pull(limit: float, anchor_stiffness: float, length: float) -> _AnchorPull:
    """Pull of an anchor with a deflection [m]: elastic, and capped by the Coulomb limit [N]."""
    pull = anchor_stiffness * length
    if pull <= (1.0 - LIMIT_ROUNDING) * limit:
        return _AnchorPull(pull, anchor_stiffness, 0.5 * anchor_stiffness, 0.0, 0.0, False)
    ratio = pull / limit
    capped_ratio, slope = smooth_cap(ratio)
    spring = limit * capped_ratio
    across = spring / length
    turn = 0.5 * anchor_stiffness * slope
    share = capped_ratio - ratio * slope
    return _AnchorPull(spring, across, turn, 0.5 * across - turn, share, True)


@inner
def friction_force(
    limit: float,
    anchor_stiffness: float,
    slip_speed: float,
    normal: Vector,
    slip: Vector,
    h: float,
    bristle: Vector,
) -> tuple[Vector, Vector, Matrix]:
    """Friction force with anchor, averaged over a step.

    Args:
        limit: L [N], Coulomb limit of the friction force, > 0.
        anchor_stiffness: k_a [N/m].
        slip_speed: v_s [m/s].
        normal: unit normal of the ground.
        slip: tangential travel w of the point over the ground in the step [m].
        h: length of the step [s].
        bristle: tangential deflection e of the anchor at the step's start [m].

    Returns:
        Force F_t [N], dF_t/dL [-], dF_t/dw [N/m] as rows, for w changing within the tangent plane.
    """
    nx, ny, nz = normal
    wx, wy, wz = slip
    width = slip_speed * h
    inverse = 1.0 / math.sqrt(wx * wx + wy * wy + wz * wz + width * width)
    gx, gy, gz = wx * inverse, wy * inverse, wz * inverse  # direction of slip, less than unit

    # The anchor at mid-step: its force there times the slip is its change of energy.
    ex = bristle[0] + 0.5 * wx
    ey = bristle[1] + 0.5 * wy
    ez = bristle[2] + 0.5 * wz
    length = math.sqrt(ex * ex + ey * ey + ez * ez)
    pull = _anchor_pull(limit, anchor_stiffness, length)
    share, across = pull.by_limit, pull.stiffness
    cx, cy, cz = 0.0, 0.0, 0.0
    if pull.is_limited:
        cx, cy, cz = ex / length, ey / length, ez / length

    rest = limit - pull.force
    force = (
        -across * ex - rest * gx,
        -across * ey - rest * gy,
        -across * ez - rest * gz,
    )
    over = 1.0 - share
    by_limit = (-share * cx - over * gx, -share * cy - over * gy, -share * cz - over * gz)

    # dF/dw = -across/2 P + along c c^T + g dS^T - rest/W (P - g g^T), dS/dw = turn e/|e|
    turn = pull.slope
    if length > 0.0:
        turn /= length
    sx, sy, sz = turn * ex, turn * ey, turn * ez
    drag = rest * inverse
    plane = 0.5 * across + drag
    along = pull.along
    ax, ay, az = along * cx, along * cy, along * cz
    bx, by, bz = drag * gx + sx, drag * gy + sy, drag * gz + sz
    tangent = (
        plane * (nx * nx - 1.0) + ax * cx + gx * bx,
        plane * nx * ny + ax * cy + gx * by,
        plane * nx * nz + ax * cz + gx * bz,
        plane * ny * nx + ay * cx + gy * bx,
        plane * (ny * ny - 1.0) + ay * cy + gy * by,
        plane * ny * nz + ay * cz + gy * bz,
        plane * nz * nx + az * cx + gz * bx,
        plane * nz * ny + az * cy + gz * by,
        plane * (nz * nz - 1.0) + az * cz + gz * bz,
    )
    return force, by_limit, tangent


@inner
def tangential(vector: Vector, normal: Vector) -> Vector:
    """The part of a vector in the tangent plane."""
    along = vector[0] * normal[0] + vector[1] * normal[1] + vector[2] * normal[2]
    return (
        vector[0] - along * normal[0],
        vector[1] - along * normal[1],
        vector[2] - along * normal[2],
    )


@inner
def contact_force(
    law: ContactLaw,
    depth0: float,
    depth1: float,
    normal: Vector,
    travel: Vector,
    h: float,
    bristle: Vector,
) -> tuple[Vector, Matrix]:
    """Force of the ground on a point, averaged over a step, and its derivative.

    The derivative assumes dd1/du = -n and a constant normal: exact on flat ground; on curved ground
    it omits N dn/du, which is small while the depth is small against the radius.

    Args:
        law: materials.
        depth0: d at the step's start [m].
        depth1: d at its end [m].
        normal: unit normal n, out of the ground.
        travel: u = x1 - x0 [m].
        h: length of the step [s].
        bristle: deflection of the anchor at the step's start [m]; zero for a new contact.

    Returns:
        Force F [N] (3,) and dF/du [N/m] (9,) as rows; for dF/dv at mid-step multiply by h.
    """
    if depth0 <= TOUCH and depth1 <= TOUCH:
        return NO_VECTOR, NO_MATRIX
    load, stiffness = normal_force(law, depth0, depth1, h)
    nx, ny, nz = normal
    slip = tangential(travel, normal)
    wx, wy, wz = slip
    rate = 1.0 / (h * h)
    mu, fall = friction_coefficient(law, (wx * wx + wy * wy + wz * wz) * rate)
    limit = mu * load
    if limit <= 0.0:
        stiffness = -stiffness
        return (load * nx, load * ny, load * nz), (
            stiffness * nx * nx,
            stiffness * nx * ny,
            stiffness * nx * nz,
            stiffness * ny * nx,
            stiffness * ny * ny,
            stiffness * ny * nz,
            stiffness * nz * nx,
            stiffness * nz * ny,
            stiffness * nz * nz,
        )
    friction, by_limit, tangent = friction_force(
        limit,
        law.anchor_stiffness,
        law.slip_speed,
        normal,
        slip,
        h,
        tangential(bristle, normal),
    )
    # dL/du = -mu N' n + N mu' w
    px = -stiffness * (nx + mu * by_limit[0])
    py = -stiffness * (ny + mu * by_limit[1])
    pz = -stiffness * (nz + mu * by_limit[2])
    fade = 2.0 * load * fall * rate
    qx, qy, qz = fade * by_limit[0], fade * by_limit[1], fade * by_limit[2]
    return (
        (load * nx + friction[0], load * ny + friction[1], load * nz + friction[2]),
        (
            tangent[0] + px * nx + qx * wx,
            tangent[1] + px * ny + qx * wy,
            tangent[2] + px * nz + qx * wz,
            tangent[3] + py * nx + qy * wx,
            tangent[4] + py * ny + qy * wy,
            tangent[5] + py * nz + qy * wz,
            tangent[6] + pz * nx + qz * wx,
            tangent[7] + pz * ny + qz * wy,
            tangent[8] + pz * nz + qz * wz,
        ),
    )


@inner
def advance_anchor(limit: float, anchor_stiffness: float, slip: Vector, bristle: Vector) -> Vector:
    """Deflection e1 [m] of an anchor after a step with the slip w; it yields beyond the limit."""
    ex = bristle[0] + slip[0]
    ey = bristle[1] + slip[1]
    ez = bristle[2] + slip[2]
    pull = anchor_stiffness * math.sqrt(ex * ex + ey * ey + ez * ez)
    if pull <= (1.0 - LIMIT_ROUNDING) * limit:
        return ex, ey, ez
    if limit <= 0.0:
        return 0.0, 0.0, 0.0
    ratio = pull / limit
    scale = smooth_cap(ratio)[0] / ratio
    return scale * ex, scale * ey, scale * ez


@inner
def advance_bristle(
    law: ContactLaw,
    depth0: float,
    depth1: float,
    normal: Vector,
    travel: Vector,
    h: float,
    bristle: Vector,
) -> Vector:
    """Deflection of the anchor at the end of an accepted step [m]; zero once contact is lost.

    The arguments are those of `contact_force`.
    """
    if depth1 <= TOUCH:
        return NO_VECTOR
    load, _ = normal_force(law, depth0, depth1, h)
    slip = tangential(travel, normal)
    speed_squared = (slip[0] ** 2 + slip[1] ** 2 + slip[2] ** 2) / (h * h)
    mu, _ = friction_coefficient(law, speed_squared)
    return advance_anchor(mu * load, law.anchor_stiffness, slip, tangential(bristle, normal))


@inner
def contact_energy(law: ContactLaw, depth: float, bristle: Vector) -> float:
    """Energy that a contact stores [J]: 2/5 k d^(5/2) + 1/2 k_a e^2.

    A step dissipates -F.u minus the change of this energy.
    """
    stored = 0.5 * law.anchor_stiffness * (bristle[0] ** 2 + bristle[1] ** 2 + bristle[2] ** 2)
    if depth > 0.0:
        stored += 0.4 * law.stiffness * depth * depth * math.sqrt(depth)
    return stored


def restitution(law: ContactLaw, speed: float) -> float:
    """Coefficient of restitution e [-] of an impact along the normal at `speed` [m/s].

    From m v dv/dd = -k d^(3/2) (1 + b v), b = 3/2 c, the speeds in and out obey, whatever k and m,
    b v_i - ln(1 + b v_i) = -b v_o - ln(1 - b v_o); for small c v_i this is e = 1 - c v_i.
    """
    b = 1.5 * law.damping
    if b * speed == 0.0:
        return 1.0
    arrived = b * speed - math.log1p(b * speed)
    low, high = 0.0, min(1.0, b * speed)
    for _ in range(200):
        middle = 0.5 * (low + high)
        if middle >= 1.0 or -middle - math.log1p(-middle) > arrived:
            high = middle
        else:
            low = middle
    return 0.5 * (low + high) / (b * speed)
