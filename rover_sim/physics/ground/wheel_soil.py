"""A rigid wheel on regolith: sinkage, pull and driving torque over slip.

Soil (Bekker 1969, Introduction to Terrain-Vehicle Systems; Janosi and Hanamoto 1961):

    pressure under a plate of width b at sinkage z     p = k z^n,  k = k_c/b + k_phi
    shear stress after a shear displacement j          tau = (c + p tan phi) (1 - exp(-|j|/K)).

Wheel (Wong and Reece 1967, J. Terramechanics 4(1) and 4(2)): with theta from the vertical, positive
towards the side where the soil enters, theta_1 the angle of entry, sinkage z = r (1 - cos theta_1),
the radial stress is p at the depth r (cos theta - cos theta_1) from theta_1 down to theta_m, and
from there to the exit at theta = 0 it falls symmetrically. The shear displacement is

    j(theta) = r_s (theta_1 - theta) - (v/w) (sin theta_1 - sin theta),

with the travel speed v and the spin w; tau has the sign of j. With the width b,

    pull     X = b int (r_s' tau cos theta - r p sin theta) dtheta,
    load     Z = b int (r_s' tau sin theta + r p cos theta) dtheta,
    torque   M = b r_s r_s' int tau dtheta,                               r_s' = r_s,

forces on the wheel at its axle, M the torque of the drive. Slip is s = (w r_s - v) / max(w r_s, v),
from -1 (locked, skidding) over 0 (rolling) to 1 (spinning in place): driven, braked and towed
wheels. The angle of greatest stress is theta_m = (c1 + c2 |s|) theta_1;
Wong and Reece measured (0.43, 0.32) on compact and (0.18, 0.32) on loose sand. The default is
c1 = c2 = 0, Bekker's pressure down to the bottom: c1 and c2 are unknown for undisturbed regolith.
The pull is larger than on loose sand: 0.36 N against 0.10 N at 20 % slip for the smooth wheel of
0.1 m under 8.1 N.

Grousers of height h: the soil between them shears with the wheel, so that the shear surface is a
circle of radius r_s = r + engagement h (Ding, Gao, Deng, Nagatani and Yoshida 2011,
J. Terramechanics 48(1)), and their flanks add shear area as under a track with spuds (Bekker 1956):
c grows by 1 + 2 h/b, tan phi by 1 + 0.64 (h/b) arctan(b/h). Slip refers to r_s. The pressure acts
on the rim. The load on the grousers' tips is neglected.

What the wheel does to loose soil beyond this, each term absent by default, with the travel speed V,
its parts v forward and u sideways, and x = (w r_s - v)/V (`wheel_forces`) [our form]:

- Slip sinkage: the pressure falls by exp(-q^2) with the slip,
  q^2 = (a x)^2 + (a_u u/V)^2 of a wheel that skids, x < 0, and of one that is driven the larger of
  a_u |u|/V and a x / sqrt(1 + (x/x_s)^2): beyond x_s the rim slides over the soil.
- Ploughing: surfaces that push soil aside feel a pressure N d at the depth d, as a retaining wall
  does (Terzaghi 1943, Theoretical Soil Mechanics), times exp(-e (1 - v_n/|v|)), with the part v_n
  of the surface's velocity v along its normal: on the wheel's leading side, and f N d sin^2 theta
  on the rim's front. On the side the friction acts against the velocity.
- Release: a wheel that skids or slips sideways carries soil along, and shear follows the sliding
  velocity in place of the displacement: where the rim moves into the soil with v_n faster than
  along it with v_t, the stress takes the fraction v_t / sqrt(v_t^2 + (m v_n)^2), against v_t. The
  share of this part is k^2/(k^2 + k_h^2), k^2 = (max(v - w r_s, 0)^2 + u^2)/V^2, so that a rolling
  or driven wheel straight ahead has Wong and Reece's shear.
- Rear contact: behind the axle the pressure falls from the bottom's to zero at the angle
  g theta_1 min(1, w r_s / V).
- Excavation: grousers of height h carry soil away; the surface under the rim lies lower by
  e_h h x, x at most MOST_SLIP, of a driven wheel.
- Thrust of grousers: where the rim slides backward, their flanks push soil with the stress
  g_f (h/b) N d exp(-q^2) v_t/|v| along the wheel's plane, q that of the slip sinkage.

The shear displacement has the part (u/w)(theta_1 - theta) sideways then, and the stress opposes its
sum. The law holds up to the angle STEEPEST_WHEEL between travel and wheel plane: beyond, soil that
is pushed aside closes behind the wheel, which no term describes.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_schemas.configuration import Configuration, ConfigurationError, quantity
from rover_sim.physics.numerics.compiled import inner, kernel
from rover_sim.physics.numerics.named_parameters import from_parameters

Array = NDArray[np.float64]

_points, _weights = np.polynomial.legendre.leggauss(16)
_POINTS: Array = (1.0 + _points) / 2.0
_WEIGHTS: Array = _weights / 2.0

_side_points, _side_weights = np.polynomial.legendre.leggauss(8)
_SIDE_POINTS: Array = _side_points
_SIDE_WEIGHTS: Array = _side_weights

DEEPEST = 0.7  # largest sin(theta_1 / 2) = sqrt(z / 2r) of the plant's table, z = 0.98 r
STEEPEST_WHEEL = 75.0  # largest angle between travel and wheel plane for which the law holds [deg]
MOST_SLIP = 10.0  # x from which on grousers excavate no deeper
LOCKED = 0.05  # a slip below -1 + LOCKED is a locked wheel
_PEAK_ROUNDING = 0.02  # slip within which |s| in theta_m is smoothed
_HALF_SKID = 0.3  # k_h [-]
_LARGEST_PEAK = 0.9  # largest theta_m / theta_1


@dataclass(frozen=True)
class Soil(Configuration):
    """Bekker and shear parameters of a soil under a wheel.

    Defaults: lunar regolith (Apollo values as in the Lunar Sourcebook).
    """

    cohesive_modulus: float = quantity("N/m^(n+1)", "k_c", 1400.0, minimum=0.0)
    frictional_modulus: float = quantity("N/m^(n+2)", "k_phi", 8.2e5, above=0.0)
    exponent: float = quantity("-", "n", 1.0, minimum=0.3, maximum=2.0)
    cohesion: float = quantity("Pa", "c", 170.0, minimum=0.0)
    friction_angle: float = quantity("deg", "phi", 35.0, minimum=1.0e-3, maximum=60.0)
    shear_modulus: float = quantity("m", "K", 0.018, above=0.0)
    peak_offset: float = quantity("-", "c1", 0.0, minimum=0.0, maximum=1.0)
    peak_slope: float = quantity("-", "c2", 0.0, minimum=0.0, maximum=1.0)
    slip_weakening: float = quantity("-", "a, by slip ahead", 0.0, minimum=0.0)
    side_weakening: float = quantity("-", "a_u, by side slip", 0.0, minimum=0.0)
    slip_saturation: float = quantity(
        "-", "x_s, slip from which a driven rim slides", 0.5, above=0.0
    )
    ploughing: float = quantity(
        "N/m^3", "N, pressure over depth on a side that pushes soil", 0.0, minimum=0.0
    )
    front_ploughing: float = quantity(
        "-", "f, of the rim's front over the side's", 1.0, minimum=0.0
    )
    ploughing_decay: float = quantity("-", "e, with motion along the surface", 1.0, minimum=0.0)
    shear_release: float = quantity(  # 0: shear follows the displacement alone
        "-", "m, of shear where the rim moves into the soil", 0.0, minimum=0.0
    )
    rear_contact: float = quantity(
        "-", "g, exit angle over entry angle", 0.0, minimum=0.0, maximum=1.0
    )
    excavation: float = quantity("-", "e_h, depth over grouser height and slip", 0.0, minimum=0.0)
    grouser_thrust: float = quantity(
        "-", "g_f, of the grousers' flanks where the rim slides backward", 0.0, minimum=0.0
    )


@dataclass(frozen=True)
class Wheel(Configuration):
    """A rigid wheel with straight grousers."""

    radius: float = quantity("m", "of the rim", 0.15, above=0.0)
    width: float = quantity("m", "of the rim", 0.06, above=0.0)
    grouser_height: float = quantity("m", "of the grousers", 0.01, minimum=0.0)
    grouser_engagement: float = quantity(
        "-",
        "share of the grousers' height at which the soil shears",
        1.0,
        minimum=0.0,
        maximum=1.0,
    )

    def check(self) -> None:
        """Refuse grousers as high as the radius."""
        if self.grouser_height >= self.radius:
            raise ConfigurationError(
                "grouser_height",
                self.grouser_height,
                f"should be below the radius of {self.radius:g} m",
            )

    @property
    def shear_radius(self) -> float:
        """r_s [m]."""
        return self.radius + self.grouser_engagement * self.grouser_height


class WheelOnSoil(NamedTuple):
    """A wheel and its soil for compiled functions."""

    radius: float  # r [m]
    shear_radius: float  # r_s [m]
    width: float  # b [m]
    modulus: float  # k [N/m^(n+2)]
    exponent: float  # n [-]
    cohesion: float  # c, including the grousers' effect [Pa]
    friction: float  # tan phi, including the grousers' effect [-]
    shear_modulus: float  # K [m]
    peak_offset: float  # c1 [-]
    peak_slope: float  # c2 [-]
    slip_weakening: float  # a [-]
    side_weakening: float  # a_u [-]
    slip_saturation: float  # x_s [-]
    ploughing: float  # N [N/m^3]
    front_ploughing: float  # f [-]
    ploughing_decay: float  # e [-]
    shear_release: float  # m [-]
    rear_contact: float  # g [-]
    excavation: float  # e_h h [m]
    grouser_thrust: float  # g_f h/b [-]


def wheel_on_soil(wheel: Wheel, soil: Soil) -> WheelOnSoil:
    """Convert the parameters for compiled functions."""
    share = wheel.grouser_height / wheel.width
    flank = 0.64 * share * math.atan(1.0 / share) if share > 0.0 else 0.0
    return from_parameters(
        WheelOnSoil,
        soil,
        radius=wheel.radius,
        shear_radius=wheel.shear_radius,
        width=wheel.width,
        modulus=soil.cohesive_modulus / wheel.width + soil.frictional_modulus,
        cohesion=soil.cohesion * (1.0 + 2.0 * share),
        friction=math.tan(math.radians(soil.friction_angle)) * (1.0 + flank),
        excavation=soil.excavation * wheel.grouser_height,
        grouser_thrust=soil.grouser_thrust * share,
    )


@inner
def _time_to_pass(rim: float, travel: float) -> float:
    """V/(w r_s) for the displacements; of a nearly locked wheel continued linearly.

    Below w r_s = LOCKED V the soil's strength is fully mobilised.
    """
    if rim >= LOCKED * travel:
        return travel / rim
    return (2.0 - rim / travel / LOCKED) / LOCKED


@inner
def weakened(system: WheelOnSoil, excess: float, side: float) -> float:
    """Fraction of the plate's pressure that the slip leaves: exp(-q^2) of x and u/V."""
    across = system.side_weakening * side
    if excess <= 0.0:
        along = system.slip_weakening * excess
        return math.exp(-(along * along + across * across))
    limit = system.slip_saturation
    along = system.slip_weakening / math.sqrt(1.0 / (excess * excess) + 1.0 / (limit * limit))
    most = max(along, across)
    return math.exp(-most * most)


@kernel
def wheel_forces(
    system: WheelOnSoil, sinkage: float, forward: float, side: float, rim: float
) -> tuple[float, float, float, float]:
    """Stress integral over rim and leading side by fixed Gauss rules, in any steady motion.

    Args:
        system: wheel and soil.
        sinkage: z, of the rim's deepest point below the undisturbed surface [m], from 0 to 2 r.
        forward: speed along the wheel's plane, v >= 0, in any unit.
        side: speed across it, u, in the same unit.
        rim: w r_s >= 0, in the same unit; not all three zero.

    Returns:
        Pull X, side force Y against u [N], load Z [N], torque M [N m].
    """
    travel = max(math.sqrt(forward * forward + side * side), 1.0e-9 * rim)
    v, u, w = forward / travel, abs(side) / travel, rim / travel
    excess = w - v
    buried = sinkage
    if excess > 0.0:
        buried -= system.excavation * min(excess, MOST_SLIP)
    x, y, z, m = _rim_forces(system, buried, v, u, w, excess)
    if u > 0.0 and system.ploughing > 0.0:
        sx, sy, sz, sm = _side_forces(system, sinkage, v, u, w)
        x, y, z, m = x + sx, y + sy, z + sz, m + sm
    return x, (-y if side < 0.0 else y), z, m


@inner
def _rim_forces(
    system: WheelOnSoil, sinkage: float, v: float, u: float, w: float, excess: float
) -> tuple[float, float, float, float]:
    """The rim's part of `wheel_forces`; speeds over V, x in place of w - v."""
    if sinkage <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    r, r_s = system.radius, system.shear_radius
    surface = 1.0 - sinkage / r  # height of the soil's surface below the axle, over r
    theta1 = min(2.0 * math.asin(math.sqrt(min(0.5 * sinkage / r, 1.0))), 0.5 * math.pi)
    sin1 = math.sin(theta1)
    slip = excess / max(v, w, 1.0e-9)
    size = slip * slip / math.sqrt(slip * slip + _PEAK_ROUNDING * _PEAK_ROUNDING)
    peak = min(system.peak_offset + system.peak_slope * size, _LARGEST_PEAK) * theta1
    exit_angle = system.rear_contact * theta1 * min(1.0, w)
    left = weakened(system, excess, u)
    modulus = system.modulus * left
    passing = _time_to_pass(w, 1.0)
    ploughing = system.front_ploughing * system.ploughing
    thrust = system.grouser_thrust * system.ploughing * left
    released_share = 0.0
    if system.shear_release > 0.0:
        skid = max(v - w, 0.0) ** 2 + u * u
        released_share = skid / (skid + _HALF_SKID * _HALF_SKID)
    pull = across = load = torque = 0.0
    for zone in range(3):
        low = -exit_angle if zone == 0 else (0.0 if zone == 1 else peak)
        high = 0.0 if zone == 0 else (peak if zone == 1 else theta1)
        if high <= low:
            continue
        for g in range(_POINTS.size):
            theta = low + (high - low) * _POINTS[g]
            weight = (high - low) * _WEIGHTS[g]
            cos = math.cos(theta)
            sin = math.sin(theta)
            if zone == 0:
                depth = sinkage * (1.0 - (theta / exit_angle) ** 2)
            elif zone == 1:
                depth = r * (math.cos(theta1 - theta / peak * (theta1 - peak)) - surface)
            else:
                depth = r * (cos - surface)
            depth = max(depth, 0.0)
            pressure = modulus * (depth if system.exponent == 1.0 else depth**system.exponent)
            # velocity of the rim over V: along its normal, and along it towards the entry
            normal = v * sin
            along = v * cos - w
            speed = math.sqrt(normal * normal + along * along + u * u + 1.0e-12)
            if zone > 0 and ploughing > 0.0:
                decay = system.ploughing_decay * (1.0 - normal / speed)
                pressure += ploughing * max(r * (cos - surface), 0.0) * sin * sin * math.exp(-decay)
            # displacement since the entry, against the drive and across
            dx = r_s * (v * passing * (sin1 - sin) - (theta1 - theta))
            dy = r_s * u * passing * (theta1 - theta)
            displacement = math.sqrt(dx * dx + dy * dy)
            tau = (system.cohesion + pressure * system.friction) * (
                1.0 - math.exp(-displacement / system.shear_modulus)
            )
            released = system.shear_release * normal
            by_speed = released_share / math.sqrt(
                along * along + u * u + released * released + 1.0e-6
            )
            by_displacement = (1.0 - released_share) / max(displacement, 1.0e-9)
            dx, dy = by_speed * along + by_displacement * dx, by_speed * u + by_displacement * dy
            weight *= system.width
            shear_x, shear_y = r_s * weight * tau * dx, r_s * weight * tau * dy
            if along < 0.0:
                below = max(r * (cos - surface), 0.0)
                shear_x += r_s * weight * thrust * below * along / speed
            pressure *= r * weight
            pull -= shear_x * cos + pressure * sin
            across += shear_y
            load += pressure * cos - shear_x * sin
            torque -= shear_x
    return pull, across, load, r_s * torque


@inner
def _side_forces(
    system: WheelOnSoil, sinkage: float, v: float, u: float, w: float
) -> tuple[float, float, float, float]:
    """The leading side's part of `wheel_forces`; speeds over V."""
    r = system.radius
    surface = r - sinkage  # depth of the soil's surface below the axle
    half_height = 0.5 * min(sinkage, 2.0 * r)
    spin = w / system.shear_radius
    pull = across = load = torque = 0.0
    for i in range(_SIDE_POINTS.size):
        below = r - half_height * (1.0 - _SIDE_POINTS[i])  # depth below the axle
        chord = math.sqrt(max(r * r - below * below, 0.0))
        strip = half_height * _SIDE_WEIGHTS[i] * chord * system.ploughing * (below - surface)
        for j in range(_SIDE_POINTS.size):
            ahead = chord * _SIDE_POINTS[j]
            vx = v - spin * below
            vz = -spin * ahead
            sliding = vx * vx + vz * vz
            decay = system.ploughing_decay * (1.0 - u / math.sqrt(sliding + u * u))
            force = strip * _SIDE_WEIGHTS[j] * math.exp(-decay)
            released = system.shear_release * u
            friction = system.friction * force / math.sqrt(sliding + released * released + 1.0e-6)
            pull -= friction * vx
            across += force
            load -= friction * vz
            torque -= friction * (vx * below + vz * ahead)
    return pull, across, load, torque


@kernel
def stress_integral(system: WheelOnSoil, entry: float, slip: float) -> tuple[float, float, float]:
    """Return the forces of a wheel that travels in its plane.

    Args:
        system: wheel and soil.
        entry: sin(theta_1 / 2) = sqrt(z / 2r) [-], from 0 to 1.
        slip: s [-], from -1 to 1.

    Returns:
        Pull X [N], load Z [N], torque M [N m].
    """
    sinkage = 2.0 * system.radius * entry * entry
    forward, rim = (1.0 - slip, 1.0) if slip >= 0.0 else (1.0, 1.0 + slip)
    pull, _, load, torque = wheel_forces(system, sinkage, forward, 0.0, rim)
    return pull, load, torque


@kernel
def steady_sinkage(
    system: WheelOnSoil, load: float, forward: float, side: float, rim: float
) -> float:
    """Sinkage at which the soil carries a load in a steady motion [m]; NaN: at none up to 2 r.

    The least one is found where the load rises and falls with the sinkage.

    Args:
        system: wheel and soil.
        load: on the wheel [N], > 0.
        forward: v, as for `wheel_forces`.
        side: u.
        rim: w r_s.
    """
    most = 2.0 * system.radius
    low, high = 0.0, math.nan
    for i in range(1, 41):
        high = most * i / 40.0
        if wheel_forces(system, high, forward, side, rim)[2] >= load:
            break
        low = high
    if low == high:
        return math.nan
    for _ in range(40):
        middle = 0.5 * (low + high)
        if wheel_forces(system, middle, forward, side, rim)[2] < load:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def steady_wheel(
    system: WheelOnSoil, load: float, forward: float, side: float, rim: float
) -> tuple[float, float, float, float]:
    """Sinkage [m], pull [N], side force against u [N] and torque [N m] of a steady motion.

    A wheel that the soil does not carry is buried: z = 2 r. Beyond the angle STEEPEST_WHEEL between
    travel and wheel plane the law does not hold; its forces are an extrapolation.

    Args:
        system: wheel and soil.
        load: on the wheel [N], > 0.
        forward: v, as for `wheel_forces`.
        side: u.
        rim: w r_s.
    """
    sinkage = float(steady_sinkage(system, load, forward, side, rim))
    if math.isnan(sinkage):
        sinkage = 2.0 * system.radius
    pull, across, _, torque = wheel_forces(system, sinkage, forward, side, rim)
    return sinkage, pull, across, torque
