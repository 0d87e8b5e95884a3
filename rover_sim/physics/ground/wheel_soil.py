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

`flat_plate` is the older estimate (Bekker 1956, Theory of Land Locomotion): all load on a flat
patch of length sqrt(2 r z), thrust from its mean shear, resistance from the soil's compaction.

Grousers of height h: the soil between them shears with the wheel, so that the shear surface is a
circle of radius r_s = r + engagement h (Ding, Gao, Deng, Nagatani and Yoshida 2011,
J. Terramechanics 48(1)), and their flanks add shear area as under a track with spuds (Bekker 1956):
c grows by 1 + 2 h/b, tan phi by 1 + 0.64 (h/b) arctan(b/h). Slip refers to r_s. The pressure acts
on the rim. The load on the grousers' tips, bulldozing in front of the wheel and slip sinkage are
neglected.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from rover_sim.physics.numerics.compiled import inner, kernel

Array = NDArray[np.float64]

_points, _weights = np.polynomial.legendre.leggauss(16)
_POINTS: Array = (1.0 + _points) / 2.0
_WEIGHTS: Array = _weights / 2.0

DEEPEST = 0.5  # the table ends where sin(theta_1/2) = sqrt(z / 2r) has this value, z = r/2
_ENTRY_CELLS = 40  # of the table
_SLIP_CELLS = 96
LIGHT = 0.05  # largest entry of a light load; z = 0.5 % of r
LOCKED = 0.05  # a slip below -1 + LOCKED is a locked wheel
_PEAK_ROUNDING = 0.02  # slip within which |s| in theta_m is smoothed
_LARGEST_PEAK = 0.9  # largest theta_m / theta_1


@dataclass(frozen=True)
class Soil:
    """Strength of a soil; the default is lunar regolith (Apollo values as in the Lunar Sourcebook).

    Raises:
        ValueError: a value is not finite or out of its range.
    """

    cohesive_modulus: float = 1400.0  # k_c [N/m^(n+1)], >= 0
    frictional_modulus: float = 8.2e5  # k_phi [N/m^(n+2)], > 0
    exponent: float = 1.0  # n [-], in [0.3, 2]
    cohesion: float = 170.0  # c [Pa], >= 0
    friction_angle: float = 35.0  # phi [deg], in (0, 60)
    shear_modulus: float = 0.018  # K [m], > 0
    peak_offset: float = 0.0  # c1 [-], in [0, 1]
    peak_slope: float = 0.0  # c2 [-], in [0, 1]

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not math.isfinite(value):
                raise ValueError(f"{name} = {value}: must be finite")
        for name in ("cohesive_modulus", "cohesion"):
            if getattr(self, name) < 0.0:
                raise ValueError(f"{name} = {getattr(self, name)}: must not be below 0")
        for name in ("frictional_modulus", "shear_modulus"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} = {getattr(self, name)}: must be above 0")
        for name, low, high in (
            ("exponent", 0.3, 2.0),
            ("friction_angle", 1.0e-3, 60.0),
            ("peak_offset", 0.0, 1.0),
            ("peak_slope", 0.0, 1.0),
        ):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} = {getattr(self, name)}: must be from {low} to {high}")


@dataclass(frozen=True)
class Wheel:
    """A rigid wheel with straight grousers.

    Raises:
        ValueError: a value is not finite or out of its range.
    """

    radius: float = 0.15  # r, of the rim [m], > 0
    width: float = 0.06  # b [m], > 0
    grouser_height: float = 0.01  # h [m], >= 0, below the radius
    grouser_engagement: float = 1.0  # share of the grousers' height in shear [-], in [0, 1]

    def __post_init__(self) -> None:
        for name in ("radius", "width"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} = {value}: must be finite and above 0")
        if not 0.0 <= self.grouser_height < self.radius:
            raise ValueError(
                f"grouser_height = {self.grouser_height}: must be from 0 to below the radius"
            )
        if not 0.0 <= self.grouser_engagement <= 1.0:
            raise ValueError(f"grouser_engagement = {self.grouser_engagement}: must be from 0 to 1")

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


class OperatingPoint(NamedTuple):
    """Operating point of a wheel that rolls steadily under a load."""

    sinkage: float  # z [m]
    pull: float  # X, drawbar pull [N]
    torque: float  # M, torque of the drive [N m]


def wheel_on_soil(wheel: Wheel, soil: Soil) -> WheelOnSoil:
    """Convert the parameters to plain floats for compiled functions."""
    share = wheel.grouser_height / wheel.width
    flank = 0.64 * share * math.atan(1.0 / share) if share > 0.0 else 0.0
    return WheelOnSoil(
        float(wheel.radius),
        float(wheel.shear_radius),
        float(wheel.width),
        soil.cohesive_modulus / wheel.width + soil.frictional_modulus,
        float(soil.exponent),
        soil.cohesion * (1.0 + 2.0 * share),
        math.tan(math.radians(soil.friction_angle)) * (1.0 + flank),
        float(soil.shear_modulus),
        float(soil.peak_offset),
        float(soil.peak_slope),
    )


@inner
def _speed_ratio(slip: float) -> float:
    """Ratio v / (w r_s): 1 - s driven, 1 / (1 + s) braked.

    The ratio of a locked wheel is infinite; below s = -1 + LOCKED, where the soil's strength is
    fully mobilised, it is continued linearly.
    """
    if slip >= 0.0:
        return 1.0 - slip
    if slip >= LOCKED - 1.0:
        return 1.0 / (1.0 + slip)
    return (2.0 - (1.0 + slip) / LOCKED) / LOCKED


@kernel
def stress_integral(system: WheelOnSoil, entry: float, slip: float) -> tuple[float, float, float]:
    """Wong and Reece's stress integral by a fixed Gauss rule of 16 points a zone.

    Args:
        system: wheel and soil.
        entry: sin(theta_1 / 2) = sqrt(z / 2r) [-], from 0 to 1/2.
        slip: s [-], from -1 to 1.

    Returns:
        Pull X [N], load Z [N], torque M [N m].
    """
    if entry <= 0.0:
        return 0.0, 0.0, 0.0
    theta1 = 2.0 * math.asin(entry)
    cos1 = math.cos(theta1)
    sin1 = math.sin(theta1)
    size = slip * slip / math.sqrt(slip * slip + _PEAK_ROUNDING * _PEAK_ROUNDING)
    peak = min(system.peak_offset + system.peak_slope * size, _LARGEST_PEAK) * theta1
    rolling = system.shear_radius * _speed_ratio(slip)
    pull = 0.0
    load = 0.0
    torque = 0.0
    for zone in range(2):
        low = 0.0 if zone == 0 else peak
        high = peak if zone == 0 else theta1
        if high <= low:
            continue
        for g in range(_POINTS.size):
            theta = low + (high - low) * _POINTS[g]
            weight = (high - low) * _WEIGHTS[g]
            cos = math.cos(theta)
            sin = math.sin(theta)
            if zone == 0:
                depth = math.cos(theta1 - theta / peak * (theta1 - peak)) - cos1
            else:
                depth = cos - cos1
            depth *= system.radius
            if system.exponent == 1.0:
                pressure = system.modulus * depth
            else:
                pressure = system.modulus * max(depth, 0.0) ** system.exponent
            shear = system.shear_radius * (theta1 - theta) - rolling * (sin1 - sin)
            tau = (system.cohesion + pressure * system.friction) * (
                1.0 - math.exp(-abs(shear) / system.shear_modulus)
            )
            if shear < 0.0:
                tau = -tau
            tau *= system.shear_radius * weight
            pressure *= system.radius * weight
            pull += tau * cos - pressure * sin
            load += tau * sin + pressure * cos
            torque += tau
    b = system.width
    return b * pull, b * load, b * system.shear_radius * torque


def sinkage_of(system: WheelOnSoil, entry: float) -> float:
    """Sinkage z [m] at sin(theta_1 / 2): z = 2 r sin^2(theta_1 / 2)."""
    return 2.0 * system.radius * entry**2


def operating_point(system: WheelOnSoil, load: float, slip: float) -> OperatingPoint:
    """Steady operating point: the sinkage at which the soil carries the load.

    Args:
        system: wheel and soil.
        load: on the wheel, normal to the ground [N], > 0.
        slip: s [-], from -1 to 1.

    Raises:
        ValueError: the soil does not carry the load before the wheel sinks by half its radius.
    """

    def excess(entry: float) -> float:
        return float(stress_integral(system, entry, slip)[1]) - load

    if not (load > 0.0 and -1.0 <= slip <= 1.0):
        raise ValueError(f"load = {load} N at slip {slip}: a load above 0 and a slip in [-1, 1]")
    if excess(DEEPEST) < 0.0:
        raise ValueError(
            f"load = {load} N at slip {slip}: the soil carries at most "
            f"{load + excess(DEEPEST):.3g} N before the wheel sinks by half its radius"
        )
    entry = float(brentq(excess, 0.0, DEEPEST, xtol=1e-13, rtol=1e-13))
    pull, _, torque = stress_integral(system, entry, slip)
    return OperatingPoint(sinkage_of(system, entry), pull, torque)


def flat_plate(system: WheelOnSoil, load: float, slip: float) -> OperatingPoint:
    """Operating point by Bekker's flat plate, for comparison; driven wheels only, 0 < s <= 1.

    z = (3 W / ((3 - n) b k sqrt(2 r)))^(2/(2n+1)), patch length l = sqrt(2 r z),
    H = (b l c + W tan phi) (1 - K/(s l) (1 - exp(-s l/K))), R = b k z^(n+1) / (n+1), X = H - R.
    """
    if not (load > 0.0 and 0.0 < slip <= 1.0):
        raise ValueError(f"load = {load} N at slip {slip}: a load above 0 and a slip in (0, 1]")
    n, b, k = system.exponent, system.width, system.modulus
    sinkage = (3.0 * load / ((3.0 - n) * b * k * math.sqrt(2.0 * system.radius))) ** (
        2.0 / (2.0 * n + 1.0)
    )
    length = math.sqrt(2.0 * system.radius * sinkage)
    ratio = slip * length / system.shear_modulus
    thrust = (b * length * system.cohesion + load * system.friction) * (
        1.0 + math.expm1(-ratio) / ratio
    )
    resistance = b * k * sinkage ** (n + 1.0) / (n + 1.0)
    return OperatingPoint(sinkage, thrust - resistance, thrust * system.shear_radius)


def slope_limit(system: WheelOnSoil, load: float, slip: float, pull: float = 0.0) -> float:
    """Steepest slope [deg] that a driven wheel climbs at the given slip.

    Args:
        system: wheel and soil.
        load: the wheel's share of the weight on level ground [N].
        slip: s [-].
        pull: load along the slope besides the weight [N].

    Returns:
        Angle alpha with X(load cos alpha, s) = load sin alpha + pull; negative if the wheel only
        moves downhill, -90 if not even that.
    """

    def surplus(degrees: float) -> float:
        alpha = math.radians(degrees)
        point = operating_point(system, load * math.cos(alpha), slip)
        return point.pull - load * math.sin(alpha) - pull

    if surplus(-89.0) < 0.0:
        return -90.0
    if surplus(89.0) > 0.0:
        return 90.0
    return float(brentq(surplus, -89.0, 89.0, xtol=1e-6))


class WheelTable(NamedTuple):
    """Table of the stress integral of one wheel on one soil; see `wheel_table`."""

    system: WheelOnSoil
    # X, Z, M over (entry, slip), each with its derivatives by entry, by slip and by both, in units
    # of a cell, (entry nodes, slip nodes, 3, 4) in one piece.
    nodes: Array
    # Largest error of X, Z and M / r_s between the nodes, relative to Z or, for lighter loads, to Z
    # at the entry LIGHT [-]; without the first cell, z < 0.03 % of r.
    error: float


def wheel_table(system: WheelOnSoil) -> WheelTable:
    """Tabulate the stress integral for bicubic interpolation, continuous with its derivatives.

    The table covers all slips, and sinkages up to half the radius. Its error is measured at the
    cells' midpoints and stored in the table.
    """
    nodes = np.empty((_ENTRY_CELLS + 1, _SLIP_CELLS + 1, 3, 4))
    _fill_table(system, nodes, np.empty((3, 3, 3)))
    return WheelTable(system, nodes.ravel(), _table_error(system, nodes.ravel()))


@kernel
def _fill_table(system: WheelOnSoil, nodes: Array, around: Array) -> None:
    cell_entry = DEEPEST / _ENTRY_CELLS
    cell_slip = 2.0 / _SLIP_CELLS
    for i in range(_ENTRY_CELLS + 1):
        for j in range(_SLIP_CELLS + 1):
            entry = i * cell_entry
            slip = j * cell_slip - 1.0
            # differences around the node, one-sided towards the inside at the table's edges
            step_entry = 1.0e-4 * cell_entry
            step_slip = 1.0e-4 * cell_slip
            e0, e1 = (0 if i == 0 else -1), (0 if i == _ENTRY_CELLS else 1)
            s0, s1 = (0 if j == 0 else -1), (0 if j == _SLIP_CELLS else 1)
            for a in range(3):
                for b in range(3):
                    around[a, b] = stress_integral(
                        system,
                        entry + min(max(a - 1, e0), e1) * step_entry,
                        slip + min(max(b - 1, s0), s1) * step_slip,
                    )
            over_entry = 1.0e4 / (e1 - e0)
            over_slip = 1.0e4 / (s1 - s0)
            for c in range(3):
                nodes[i, j, c, 0] = around[1, 1, c]
                nodes[i, j, c, 1] = (around[2, 1, c] - around[0, 1, c]) * over_entry
                nodes[i, j, c, 2] = (around[1, 2, c] - around[1, 0, c]) * over_slip
                twist = around[2, 2, c] - around[0, 2, c] - around[2, 0, c] + around[0, 0, c]
                nodes[i, j, c, 3] = twist * over_entry * over_slip


@kernel
def _table_error(system: WheelOnSoil, nodes: Array) -> float:
    worst = 0.0
    light = stress_integral(system, LIGHT, 0.0)[1]
    for i in range(1, _ENTRY_CELLS):
        for j in range(_SLIP_CELLS):
            entry = (i + 0.5) * DEEPEST / _ENTRY_CELLS
            slip = (j + 0.5) * 2.0 / _SLIP_CELLS - 1.0
            exact = stress_integral(system, entry, slip)
            found = look_up(nodes, entry, slip)
            for c in range(3):
                scale = max(exact[1], light) * (system.shear_radius if c == 2 else 1.0)
                worst = max(worst, abs(found[3 * c] - exact[c]) / scale)
    return worst


@inner
def look_up(nodes: Array, entry: float, slip: float) -> tuple[float, ...]:
    """Interpolate a table.

    Beyond the table's edge the entry is extrapolated from the last cell, the slip is limited to
    [-1, 1].

    Args:
        nodes: of a `WheelTable`.
        entry: sin(theta_1 / 2) = sqrt(z / 2r), >= 0.
        slip: s.

    Returns:
        X, dX/dentry, dX/ds, Z, dZ/dentry, dZ/ds [N], M, dM/dentry, dM/ds [N m].
    """
    a = entry * (_ENTRY_CELLS / DEEPEST)
    b = (min(max(slip, -1.0), 1.0) + 1.0) * (0.5 * _SLIP_CELLS)
    i = min(int(a), _ENTRY_CELLS - 1)
    j = min(int(b), _SLIP_CELLS - 1)
    a -= i
    b -= j
    # Hermite's weights of value and slope at the near and the far node, and their derivatives
    a1, b1 = a - 1.0, b - 1.0
    u0, u1, u2, u3 = (1.0 + 2.0 * a) * a1 * a1, a * a1 * a1, a * a * (3.0 - 2.0 * a), a * a * a1
    v0, v1, v2, v3 = (1.0 + 2.0 * b) * b1 * b1, b * b1 * b1, b * b * (3.0 - 2.0 * b), b * b * b1
    p0, p1, p3 = 6.0 * a * a1, a1 * (3.0 * a - 1.0), a * (3.0 * a - 2.0)
    q0, q1, q3 = 6.0 * b * b1, b1 * (3.0 * b - 1.0), b * (3.0 * b - 2.0)
    near = 12 * (i * (_SLIP_CELLS + 1) + j)
    far = near + 12 * (_SLIP_CELLS + 1)
    per_entry = _ENTRY_CELLS / DEEPEST
    per_slip = 0.5 * _SLIP_CELLS

    x = _channel(nodes, near, far, v0, v1, v2, v3, q0, q1, q3)
    z = _channel(nodes, near + 4, far + 4, v0, v1, v2, v3, q0, q1, q3)
    m = _channel(nodes, near + 8, far + 8, v0, v1, v2, v3, q0, q1, q3)
    return (
        u0 * x[0] + u1 * x[1] + u2 * x[2] + u3 * x[3],
        (p0 * (x[0] - x[2]) + p1 * x[1] + p3 * x[3]) * per_entry,
        (u0 * x[4] + u1 * x[5] + u2 * x[6] + u3 * x[7]) * per_slip,
        u0 * z[0] + u1 * z[1] + u2 * z[2] + u3 * z[3],
        (p0 * (z[0] - z[2]) + p1 * z[1] + p3 * z[3]) * per_entry,
        (u0 * z[4] + u1 * z[5] + u2 * z[6] + u3 * z[7]) * per_slip,
        u0 * m[0] + u1 * m[1] + u2 * m[2] + u3 * m[3],
        (p0 * (m[0] - m[2]) + p1 * m[1] + p3 * m[3]) * per_entry,
        (u0 * m[4] + u1 * m[5] + u2 * m[6] + u3 * m[7]) * per_slip,
    )


@inner
def _channel(
    t: Array,
    near: int,
    far: int,
    v0: float,
    v1: float,
    v2: float,
    v3: float,
    q0: float,
    q1: float,
    q3: float,
) -> tuple[float, ...]:
    """Interpolate one quantity along slip: value and entry slope at both entries, then d/ds."""
    return (
        v0 * t[near] + v1 * t[near + 2] + v2 * t[near + 12] + v3 * t[near + 14],
        v0 * t[near + 1] + v1 * t[near + 3] + v2 * t[near + 13] + v3 * t[near + 15],
        v0 * t[far] + v1 * t[far + 2] + v2 * t[far + 12] + v3 * t[far + 14],
        v0 * t[far + 1] + v1 * t[far + 3] + v2 * t[far + 13] + v3 * t[far + 15],
        q0 * (t[near] - t[near + 12]) + q1 * t[near + 2] + q3 * t[near + 14],
        q0 * (t[near + 1] - t[near + 13]) + q1 * t[near + 3] + q3 * t[near + 15],
        q0 * (t[far] - t[far + 12]) + q1 * t[far + 2] + q3 * t[far + 14],
        q0 * (t[far + 1] - t[far + 13]) + q1 * t[far + 3] + q3 * t[far + 15],
    )
