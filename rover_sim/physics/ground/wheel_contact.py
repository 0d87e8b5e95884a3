"""Contact force on a wheel in an implicit step: on regolith or rock, rolling, slipping or parked.

On regolith (the floor) the force is that of `wheel_soil`, on rock (boulders, wall, bare floor) that
of `contact`; `wheel_ground_geometry` computes the contact point.

Signs: the axle's direction a points to the left of the wheel, forward is t = a x n / |a x n|
(n the ground's normal), the spin w is positive rolling forward. The force F acts at the contact
point, but its moment about the axle is -M, which on soil differs from the moment of F:
`wheel_moment` gives the moment about the wheel's centre. The wheel's rotor takes -M; the body feels
the reaction of motor or brake instead.

On regolith, with the sinkage z at mid-step and v_x, v_y the centre's mean speed forward and left:

- longitudinal: X, Z, M of the stress integral at z and the slip of v_x and w r_s, all times the
  factor max(0, 1 + 3/2 c z') of Hunt and Crossley. Compacted soil hardly rebounds: with the default
  c = 5 s/m the restitution is 0.13 at 1 m/s and a wheel is at rest after two or three oscillations
  [our choice]. Backward rolling is the mirror image; around v_x = 0, within +-v_b, forward and
  backward are blended, so that a wheel spinning in place has its thrust and no rolling resistance.
  The slip ratio uses w r_s and v_x smoothed at 0 over the same width.
- lateral: friction of the strength H = (c b l + Z tan phi) of the patch of length l = 2 r
  sin(theta_1/2), opposite to the slip (v_y and u_x = w r_s - v_x) and mobilised after Janosi and
  Hanamoto while the soil passes: F_y = -H v_y / sqrt(v_y^2 + u_x^2 + v_k^2), v_k =
  2 K sqrt(v_x^2 + (w r_s)^2)/l + v_s, whose initial slope is H l / (2 K |v_x|), the mean over the
  patch. On a soil with ploughing the pressure N d on the wheel's leading side is added
  (`wheel_soil`). Without ploughing, as for the default regolith, the wheel holds less on a side
  slope than in reality.
- side slip: on a soil with a_u, X, Z and M are those of the law at the angle between travel and
  wheel plane, from those of straight travel: the pressure that side slip leaves, the depth that
  grousers excavate, and the part of the thrust M/r_s that is along the plane (`_side_slip`). So a
  wheel that is dragged askew sinks deeper. Without a_u, as for the default regolith, they are those
  of straight travel.
- parking: when wheel and soil are at rest, speed^2 = v_x^2 + v_y^2 + (w r_s)^2 < v_b^2, friction
  with an anchor (module `contact`) of the limit H replaces both forces by the fraction
  (1 - speed^2/v_b^2)^2. A braked wheel thus does not creep.
"""

import math
from typing import NamedTuple

from rover_sim.physics.ground.contact import (
    NO_MATRIX,
    NO_VECTOR,
    TOUCH,
    ContactLaw,
    advance_anchor,
    advance_bristle,
    contact_force,
    damping_factor,
    friction_force,
    tangential,
)
from rover_sim.physics.ground.wheel_soil import MOST_SLIP, STEEPEST_WHEEL, weakened
from rover_sim.physics.ground.wheel_table import WheelTable, look_up, sinking_work
from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.numerics.vectors import Matrix, Vector, dot, product

FADING = 4.0  # speed over the parking speed below which the effect of side slip fades
_STEEPEST = math.tan(math.radians(STEEPEST_WHEEL))


class WheelLaw(NamedTuple):
    """Contact law of a wheel on regolith: table of the stress integral and further parameters."""

    table: WheelTable
    damping: float = 5.0  # c [s/m]
    parking_speed: float = 0.005  # v_b [m/s]
    slip_speed: float = 0.002  # v_s [m/s]
    anchor_stiffness: float = 1.0e5  # k_a [N/m]


class WheelForce(NamedTuple):
    """Force and torque of the ground on a wheel, averaged over a step."""

    force: Vector  # F [N]
    tangent: Matrix  # d force / d u, u the centre's travel [N/m], rows
    torque: float  # M, against the spin about the axle [N m]
    torque_slope: float  # dM/dw [N m s]
    force_by_spin: Vector  # d force / dw [N s]
    torque_by_travel: Vector  # dM/du [N]


NO_FORCE = WheelForce(NO_VECTOR, NO_MATRIX, 0.0, 0.0, NO_VECTOR, NO_VECTOR)


class _Graded(NamedTuple):
    """A quantity of a wheel on soil with its derivatives."""

    value: float
    n: float  # by the travel along n
    t: float  # by v_x: by the travel along t, times h
    y: float  # by v_y, in the same way
    w: float  # by the rim's speed


@inner
def wheel_moment(arm: Vector, axle: Vector, force: Vector, torque: float) -> Vector:
    """Moment of the ground on a wheel about its centre [N m]: arm x F, but -M about the axle.

    Args:
        arm: from the wheel's centre to the contact point [m].
        axle: unit vector a.
        force: F [N].
        torque: M [N m].
    """
    x = arm[1] * force[2] - arm[2] * force[1]
    y = arm[2] * force[0] - arm[0] * force[2]
    z = arm[0] * force[1] - arm[1] * force[0]
    excess = x * axle[0] + y * axle[1] + z * axle[2] + torque
    return x - excess * axle[0], y - excess * axle[1], z - excess * axle[2]


@inner
def rock_force(
    law: ContactLaw,
    radius: float,
    depth0: float,
    depth1: float,
    normal: Vector,
    forward: Vector,
    travel: Vector,
    spin: float,
    h: float,
    bristle: Vector,
) -> WheelForce:
    """Force on a wheel in contact with rock, averaged over a step.

    Args:
        law: wheel on rock.
        radius: from the axle to the rock: length of the arm, r + h on the grousers' tips [m].
        depth0: depth of the rim's deepest point at the step's start [m].
        depth1: at its end [m].
        normal: n.
        forward: t.
        travel: u of the wheel's centre [m].
        spin: w, mean of the step [rad/s].
        h: length of the step [s].
        bristle: deflection of the anchor at the step's start [m].
    """
    if depth0 <= TOUCH and depth1 <= TOUCH:
        return NO_FORCE
    force, tangent = contact_force(
        law, depth0, depth1, normal, _over_ground(travel, forward, radius * spin * h), h, bristle
    )
    pull = dot(force, forward)
    along, across = product(tangent, forward), _rows(tangent, forward)
    return WheelForce(
        force,
        tangent,
        radius * pull,
        -radius * radius * h * dot(forward, along),
        (-radius * h * along[0], -radius * h * along[1], -radius * h * along[2]),
        (radius * across[0], radius * across[1], radius * across[2]),
    )


@inner
def advance_rock_bristle(
    law: ContactLaw,
    radius: float,
    depth0: float,
    depth1: float,
    normal: Vector,
    forward: Vector,
    travel: Vector,
    spin: float,
    h: float,
    bristle: Vector,
) -> Vector:
    """Deflection of the anchor after an accepted step [m]; arguments as for `rock_force`."""
    return advance_bristle(
        law, depth0, depth1, normal, _over_ground(travel, forward, radius * spin * h), h, bristle
    )


@inner
def _over_ground(travel: Vector, forward: Vector, rolled: float) -> Vector:
    """Travel of the wheel's contact point over the ground."""
    return (
        travel[0] - rolled * forward[0],
        travel[1] - rolled * forward[1],
        travel[2] - rolled * forward[2],
    )


@inner
def _rows(m: Matrix, v: Vector) -> Vector:
    """Product v m."""
    return (
        m[0] * v[0] + m[3] * v[1] + m[6] * v[2],
        m[1] * v[0] + m[4] * v[1] + m[7] * v[2],
        m[2] * v[0] + m[5] * v[1] + m[8] * v[2],
    )


@inner
def _smooth_positive(x: float, width: float) -> tuple[float, float]:
    """max(x, 0) smoothed over +-width, and its derivative."""
    if x >= width:
        return x, 1.0
    if x <= -width:
        return 0.0, 0.0
    t = x + width
    return 0.25 * t * t / width, 0.5 * t / width


@inner
def slip_ratio(speed: float, rim_speed: float, width: float) -> tuple[float, float, float]:
    """Slip s of a wheel that travels forward, and its derivatives by speed and rim speed [s/m].

    Args:
        speed: v_x [m/s]; a negative speed or rim speed counts as zero.
        rim_speed: w r_s [m/s].
        width: v_b, over which both are smoothed at 0 [m/s].
    """
    v, dv = _smooth_positive(speed, width)
    w, dw = _smooth_positive(rim_speed, width)
    most = max(v, w)
    inverse = 1.0 / math.sqrt(most * most + 0.01 * width * width)
    slip = (w - v) * inverse
    shrink = -slip * most * inverse * inverse
    by_v = -inverse + (shrink if v > w else 0.0)
    by_w = inverse + (0.0 if v > w else shrink)
    return slip, by_v * dv, by_w * dw


@inner
def _side_slip(
    law: WheelLaw, speed: float, side_speed: float, rim_speed: float
) -> tuple[float, float, float]:
    """What side slip changes of a wheel that travels straight, by `wheel_soil`.

    Side slip counts up to the angle STEEPEST_WHEEL, beyond which the law does not hold, and fades
    below the speed FADING v_b: the law's sinkage takes a way to develop.

    Args:
        law: the wheel on its soil.
        speed: v_x [m/s]; a negative speed or rim speed counts as zero.
        side_speed: v_y [m/s].
        rim_speed: w r_s [m/s].

    Returns:
        Fraction of the pressure that is left, exp(q_0^2 - q^2) with q_0 without side slip; sinkage
        by which grousers excavate less [m]; fraction of the shear that is along the wheel's plane.
    """
    system = law.table.system
    if system.side_weakening == 0.0 or side_speed == 0.0:
        return 1.0, 0.0, 1.0
    least = FADING * law.parking_speed * FADING * law.parking_speed
    speed, _ = _smooth_positive(speed, law.parking_speed)
    rim_speed, _ = _smooth_positive(rim_speed, law.parking_speed)
    straight = math.sqrt(speed * speed + least)
    side = min(abs(side_speed), _STEEPEST * straight)
    travel = math.sqrt(straight * straight + side * side)
    slip = rim_speed - speed
    share = weakened(system, slip / travel, side / travel) / weakened(system, slip / straight, 0.0)
    deeper = min(max(slip, 0.0) / straight, MOST_SLIP) - min(max(slip, 0.0) / travel, MOST_SLIP)
    along = slip * slip + least
    return share, system.excavation * deeper, math.sqrt(along / (along + side * side))


@inner
def _side_slip_slopes(
    law: WheelLaw, speed: float, side_speed: float, rim_speed: float, ahead: bool
) -> tuple[float, float, float]:
    """Derivatives of `_side_slip` by v_x (`ahead`) or v_y."""
    step = 1.0e-4 * law.slip_speed
    dx, dy = (step, 0.0) if ahead else (0.0, step)
    one = _side_slip(law, speed + dx, side_speed + dy, rim_speed)
    other = _side_slip(law, speed - dx, side_speed - dy, rim_speed)
    rate = 0.5 / step
    return (
        rate * (one[0] - other[0]),
        rate * (one[1] - other[1]),
        rate * (one[2] - other[2]),
    )


@inner
def rolling_force(
    law: WheelLaw, sinkage: float, speed: float, side_speed: float, rim_speed: float
) -> tuple[float, ...]:
    """X, Z, M of a wheel that travels forward or backward, without damping.

    Args:
        law: the wheel.
        sinkage: z [m], > 0.
        speed: v_x [m/s].
        side_speed: v_y [m/s].
        rim_speed: w r_s [m/s].

    Returns:
        X, dX/dz, dX/dv_x, dX/d(w r_s), then the same for Z and M; dX/dv_y and dZ/dv_y.
    """
    width = law.parking_speed
    radius = law.table.system.radius
    per_radius = 1.0 / law.table.system.shear_radius
    share = min(max(speed / width, -1.0), 1.0)
    ahead = 0.5 + share * (0.75 - 0.25 * share * share)
    shift = 0.75 * (1.0 - share * share) / width
    x = xz = xv = xw = 0.0
    f = fz = fv = fw = 0.0
    m = mz = mv = mw = 0.0
    xy = fy = 0.0
    for side in range(2):
        sign = 1.0 if side == 0 else -1.0
        weight = ahead if side == 0 else 1.0 - ahead
        if weight == 0.0:
            continue
        slip, by_v, by_w = slip_ratio(sign * speed, sign * rim_speed, width)
        left, deeper, along = _side_slip(law, sign * speed, side_speed, sign * rim_speed)
        entry = math.sqrt(0.5 * (sinkage + deeper) / radius)
        by_sinkage = 0.25 / (radius * entry)
        a, ae, a_s, b, be, bs, c, ce, cs = look_up(law.table.nodes, entry, slip)
        if left < 1.0 or along < 1.0:
            # the thrust, about M / r_s, turns with the shear
            thrust, lost = c * per_radius, (along - 1.0) * per_radius
            a, ae, a_s = a + lost * c, ae + lost * ce, a_s + lost * cs
            by_y = _side_slip_slopes(law, sign * speed, side_speed, sign * rim_speed, False)
            by_x = _side_slip_slopes(law, sign * speed, side_speed, sign * rim_speed, True)
            sunk = left * by_sinkage
            xy += sign * weight * (by_y[0] * a + sunk * by_y[1] * ae + left * by_y[2] * thrust)
            xv += weight * (by_x[0] * a + sunk * by_x[1] * ae + left * by_x[2] * thrust)
            fy += weight * (by_y[0] * b + sunk * by_y[1] * be)
            fv += sign * weight * (by_x[0] * b + sunk * by_x[1] * be)
            c, ce, cs = along * c, along * ce, along * cs
        weight *= left
        blend = shift * left
        # input speeds and outputs X, M are mirrored: their derivatives keep their sign
        x += sign * weight * a
        xz += sign * weight * ae * by_sinkage
        xv += weight * a_s * by_v + blend * a
        xw += weight * a_s * by_w
        f += weight * b
        fz += weight * be * by_sinkage
        fv += sign * (weight * bs * by_v + blend * b)
        fw += sign * weight * bs * by_w
        m += sign * weight * c
        mz += sign * weight * ce * by_sinkage
        mv += weight * cs * by_v + blend * c
        mw += weight * cs * by_w
    return x, xz, xv, xw, f, fz, fv, fw, m, mz, mv, mw, xy, fy


@inner
def _left_direction(normal: Vector, forward: Vector) -> Vector:
    """Unit vector to the left, n x t."""
    return (
        normal[1] * forward[2] - normal[2] * forward[1],
        normal[2] * forward[0] - normal[0] * forward[2],
        normal[0] * forward[1] - normal[1] * forward[0],
    )


@inner
def _side_pressure(
    law: WheelLaw, sinkage: float, vy: float, slip: float
) -> tuple[float, float, float, float]:
    """Force of the soil on the side that pushes it, and its derivatives.

    The pressure N d over the buried segment has a closed form; the decay with motion along the side
    is that of the rim's lowest point.

    Args:
        law: the wheel on its soil.
        sinkage: z [m], > 0.
        vy: speed to the left [m/s].
        slip: w r_s - v_x [m/s].

    Returns:
        Force to the left [N], its derivatives by travel along n [N/m], by v_x and by v_y [N s/m].
    """
    system = law.table.system
    if system.ploughing == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    r = system.radius
    below = max(r - sinkage, -r)
    half_chord = math.sqrt(r * r - below * below)
    area = r * r * math.acos(below / r) - below * half_chord
    moment = 2.0 / 3.0 * half_chord * half_chord * half_chord - below * area
    rounding = law.slip_speed * law.slip_speed
    speed = math.sqrt(vy * vy + slip * slip + rounding)
    push = math.sqrt(vy * vy + rounding)
    decay = math.exp(-system.ploughing_decay * (1.0 - abs(vy) / speed))
    pressure = system.ploughing * decay / push
    force = -pressure * moment * vy
    cubed = system.ploughing_decay / (speed * speed * speed)
    by_y = force * cubed * (slip * slip + rounding) * (1.0 if vy >= 0.0 else -1.0)
    by_y -= pressure * moment * rounding / (push * push)
    return force, 0.5 * pressure * area * vy, force * cubed * abs(vy) * slip, by_y


@inner
def _parking_share(law: WheelLaw, speed_squared: float) -> tuple[float, float]:
    """Fraction of the parking friction, and its derivative by the squared speed."""
    unit = 1.0 / (law.parking_speed * law.parking_speed)
    rest = 1.0 - speed_squared * unit
    if rest <= 0.0:
        return 0.0, 0.0
    return rest * rest, -2.0 * rest * unit


@inner
def _patch_length(radius: float, sinkage: float) -> tuple[float, float]:
    """Length of the patch [m], and its derivative by the travel along n [-]."""
    entry = math.sqrt(0.5 * sinkage / radius)
    return 2.0 * radius * entry, -0.25 / entry


@inner
def _lateral_force(
    law: WheelLaw,
    sinkage: float,
    v: float,
    vy: float,
    rim_speed: float,
    strength: _Graded,
) -> _Graded:
    """Force to the left of a wheel that is not parked [N].

    Args:
        law: the wheel on its soil.
        sinkage: z [m], > 0.
        v: v_x [m/s].
        vy: v_y [m/s].
        rim_speed: w r_s [m/s].
        strength: H of the patch [N].
    """
    system = law.table.system
    length, length_n = _patch_length(system.radius, sinkage)
    rolled = math.sqrt(
        v * v + rim_speed * rim_speed + 1.0e-4 * law.parking_speed * law.parking_speed
    )
    lag = 2.0 * system.shear_modulus / length
    soft = lag * rolled + law.slip_speed
    slip = rim_speed - v
    inverse = 1.0 / math.sqrt(vy * vy + slip * slip + soft * soft)
    share = -vy * inverse
    cubed = strength.value * vy * inverse * inverse * inverse
    pushed = _side_pressure(law, sinkage, vy, slip)
    return _Graded(
        strength.value * share + pushed[0],
        share * strength.n - cubed * soft * lag * rolled / length * length_n + pushed[1],
        share * strength.t + cubed * (soft * lag * v / rolled - slip) + pushed[2],
        share * strength.y - strength.value * inverse + cubed * vy + pushed[3],
        share * strength.w + cubed * (soft * lag * rim_speed / rolled + slip) - pushed[2],
    )


@inner
def _damped(factor: float, push: float, force: _Graded) -> _Graded:
    """A force times the damping factor; `force.n` is its derivative by the sinkage."""
    return _Graded(
        factor * force.value,
        -0.5 * factor * force.n - push * force.value,
        factor * force.t,
        factor * force.y,
        factor * force.w,
    )


@inner
def _patch_strength(law: WheelLaw, sinkage: float, load: _Graded) -> _Graded:
    """Strength H of the patch under a load [N]."""
    system = law.table.system
    length, length_n = _patch_length(system.radius, sinkage)
    strip = system.cohesion * system.width
    return _Graded(
        strip * length + system.friction * load.value,
        strip * length_n + system.friction * load.n,
        system.friction * load.t,
        system.friction * load.y,
        system.friction * load.w,
    )


@inner
def _parking_limit(parked: _Graded, strength: _Graded) -> _Graded:
    """Limit of the friction that holds the parked share of a wheel [N]."""
    return _Graded(
        parked.value * strength.value,
        parked.value * strength.n,
        parked.value * strength.t + strength.value * parked.t,
        parked.value * strength.y + strength.value * parked.y,
        parked.value * strength.w + strength.value * parked.w,
    )


@inner
def _moving_part(force: _Graded, parked: _Graded) -> _Graded:
    """The part of a force that parking does not replace."""
    moving = 1.0 - parked.value
    return _Graded(
        moving * force.value,
        moving * force.n,
        moving * force.t - force.value * parked.t,
        moving * force.y - force.value * parked.y,
        moving * force.w - force.value * parked.w,
    )


@inner
def _soil_torque(
    turn: _Graded,
    parked: _Graded,
    limit: _Graded,
    grip: float,
    gain: float,
    stiffness: float,
    radius: float,
    rate: float,
) -> tuple[float, float, float, float, float]:
    """Torque M [N m]; its derivatives by the travel along n, t and to the left [N], and by w.

    Args:
        turn: torque of the moving wheel.
        parked: share of the parked wheel.
        limit: of the friction that holds it.
        grip: this friction along t [N].
        gain: its derivative by the limit.
        stiffness: its derivative by the contact point's mean speed along t [N s/m].
        radius: r_s [m].
        rate: 1/h [1/s].
    """
    moving = 1.0 - parked.value
    slope = radius * (moving * turn.w - turn.value * parked.w)
    return (
        moving * turn.value + radius * grip,
        moving * turn.n + radius * gain * limit.n,
        rate * (moving * turn.t - turn.value * parked.t + radius * gain * limit.t),
        rate * (radius * gain * limit.y - turn.value * parked.y),
        slope + radius * radius * (gain * limit.w - stiffness),
    )


@inner
def _force_by_travel(
    tangent: Matrix,
    by_normal: Vector,
    normal: Vector,
    by_forward: Vector,
    forward: Vector,
    by_side: Vector,
    side: Vector,
    rate: float,
) -> Matrix:
    """Derivative of the force by the travel [N/m], of the parked wheel's friction `tangent`."""
    t0, t1, t2 = rate * forward[0], rate * forward[1], rate * forward[2]
    y0, y1, y2 = rate * side[0], rate * side[1], rate * side[2]
    return (
        tangent[0] + by_normal[0] * normal[0] + by_forward[0] * t0 + by_side[0] * y0,
        tangent[1] + by_normal[0] * normal[1] + by_forward[0] * t1 + by_side[0] * y1,
        tangent[2] + by_normal[0] * normal[2] + by_forward[0] * t2 + by_side[0] * y2,
        tangent[3] + by_normal[1] * normal[0] + by_forward[1] * t0 + by_side[1] * y0,
        tangent[4] + by_normal[1] * normal[1] + by_forward[1] * t1 + by_side[1] * y1,
        tangent[5] + by_normal[1] * normal[2] + by_forward[1] * t2 + by_side[1] * y2,
        tangent[6] + by_normal[2] * normal[0] + by_forward[2] * t0 + by_side[2] * y0,
        tangent[7] + by_normal[2] * normal[1] + by_forward[2] * t1 + by_side[2] * y1,
        tangent[8] + by_normal[2] * normal[2] + by_forward[2] * t2 + by_side[2] * y2,
    )


@inner
def _force_by_spin(by_rim: Vector, along: Vector, radius: float, h: float) -> Vector:
    """Derivative of the force by w [N s], from those by the rim's speed and by the friction."""
    return (
        radius * (by_rim[0] - h * along[0]),
        radius * (by_rim[1] - h * along[1]),
        radius * (by_rim[2] - h * along[2]),
    )


@inner
def soil_force(
    law: WheelLaw,
    depth0: float,
    depth1: float,
    normal: Vector,
    forward: Vector,
    travel: Vector,
    spin: float,
    h: float,
    bristle: Vector,
) -> WheelForce:
    """Force on a wheel that rolls, slips or is parked on regolith, averaged over a step.

    The derivative assumes constant normal and forward vectors, and dd1/du = -n.

    Args:
        law: the wheel on its soil.
        depth0: depth of the rim's deepest point at the step's start [m].
        depth1: at its end [m].
        normal: n.
        forward: t.
        travel: u of the wheel's centre [m].
        spin: w, mean of the step [rad/s].
        h: length of the step [s].
        bristle: deflection of the anchor at the step's start [m].
    """
    sinkage = 0.5 * (depth0 + depth1)
    if sinkage <= TOUCH:
        return NO_FORCE
    system = law.table.system
    side = _left_direction(normal, forward)
    rate = 1.0 / h
    v = (dot(travel, forward)) * rate
    vy = (travel[0] * side[0] + travel[1] * side[1] + travel[2] * side[2]) * rate
    rim_speed = spin * system.shear_radius
    factor, fall = damping_factor(law.damping, (depth1 - depth0) * rate)
    x, xz, xv, xw, f, fz, fv, fw, m, mz, mv, mw, xy, fy = rolling_force(
        law, sinkage, v, vy, rim_speed
    )

    push = fall * rate
    load = _damped(factor, push, _Graded(f, fz, fv, fy, fw))
    pull = _damped(factor, push, _Graded(x, xz, xv, xy, xw))
    turn = _Graded(factor * m, -0.5 * factor * mz - push * m, factor * mv, 0.0, factor * mw)
    strength = _patch_strength(law, sinkage, load)
    drift = _lateral_force(law, sinkage, v, vy, rim_speed, strength)

    share, slope = _parking_share(law, v * v + vy * vy + rim_speed * rim_speed)
    parked = _Graded(share, 0.0, 2.0 * slope * v, 2.0 * slope * vy, 2.0 * slope * rim_speed)
    limit = _parking_limit(parked, strength)
    hold, by_limit, tangent = NO_VECTOR, NO_VECTOR, NO_MATRIX
    if limit.value > 0.0:
        hold, by_limit, tangent = friction_force(
            limit.value,
            law.anchor_stiffness,
            law.slip_speed,
            normal,
            _over_ground(tangential(travel, normal), forward, rim_speed * h),
            h,
            tangential(bristle, normal),
        )
    grip, gain, radius = dot(hold, forward), dot(by_limit, forward), system.shear_radius
    along, across = product(tangent, forward), _rows(tangent, forward)
    torque, m_n, m_t, m_y, m_w = _soil_torque(
        turn, parked, limit, grip, gain, h * dot(along, forward), radius, rate
    )
    pull, drift = _moving_part(pull, parked), _moving_part(drift, parked)

    by_normal = _combine(load.n, normal, pull.n, forward, drift.n, side, limit.n, by_limit)
    by_forward = _combine(load.t, normal, pull.t, forward, drift.t, side, limit.t, by_limit)
    by_side = _combine(load.y, normal, pull.y, forward, drift.y, side, limit.y, by_limit)
    by_rim = _combine(load.w, normal, pull.w, forward, drift.w, side, limit.w, by_limit)
    return WheelForce(
        _combine(load.value, normal, pull.value, forward, drift.value, side, 1.0, hold),
        _force_by_travel(tangent, by_normal, normal, by_forward, forward, by_side, side, rate),
        torque,
        m_w,
        _force_by_spin(by_rim, along, radius, h),
        _combine(m_n, normal, m_t, forward, m_y, side, radius, across),
    )


@inner
def _combine(
    a: float, p: Vector, b: float, q: Vector, c: float, r: Vector, d: float, s: Vector
) -> Vector:
    """Linear combination a p + b q + c r + d s."""
    return (
        a * p[0] + b * q[0] + c * r[0] + d * s[0],
        a * p[1] + b * q[1] + c * r[1] + d * s[1],
        a * p[2] + b * q[2] + c * r[2] + d * s[2],
    )


@inner
def advance_soil_bristle(
    law: WheelLaw,
    depth0: float,
    depth1: float,
    normal: Vector,
    forward: Vector,
    travel: Vector,
    spin: float,
    h: float,
    bristle: Vector,
) -> Vector:
    """Deflection of the anchor after an accepted step [m]; arguments as for `soil_force`."""
    sinkage = 0.5 * (depth0 + depth1)
    if sinkage <= TOUCH or depth1 <= TOUCH:
        return NO_VECTOR
    system = law.table.system
    slide = tangential(travel, normal)
    v = (dot(slide, forward)) / h
    speed_squared = (slide[0] ** 2 + slide[1] ** 2 + slide[2] ** 2) / (h * h)
    rim_speed = spin * system.shear_radius
    parked, _ = _parking_share(law, speed_squared + rim_speed * rim_speed)
    factor, _ = damping_factor(law.damping, (depth1 - depth0) / h)
    side = _left_direction(normal, forward)
    vy = (slide[0] * side[0] + slide[1] * side[1] + slide[2] * side[2]) / h
    load = factor * rolling_force(law, sinkage, v, vy, rim_speed)[4]
    length = math.sqrt(2.0 * system.radius * sinkage)
    strength = system.cohesion * system.width * length + system.friction * load
    return advance_anchor(
        parked * strength,
        law.anchor_stiffness,
        _over_ground(slide, forward, rim_speed * h),
        tangential(bristle, normal),
    )


@inner
def soil_energy(law: WheelLaw, depth: float, bristle: Vector) -> float:
    """Energy that a wheel's contact with soil stores [J]: of the sinkage and of the anchor.

    Z without slip depends on the sinkage alone, so its work comes back as the wheel is lifted
    slowly; damping and slip dissipate.
    """
    stored = 0.5 * law.anchor_stiffness * dot(bristle, bristle)
    if depth > 0.0:
        stored += sinking_work(law.table, depth)
    return stored
