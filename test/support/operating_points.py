"""Operating points of a wheel that rolls steadily on soil, by two laws."""

import math
from typing import NamedTuple

from rover_sim.physics.ground.wheel_soil import DEEPEST, WheelOnSoil, stress_integral
from rover_sim.physics.numerics.roots_and_splines import bracketed_root


class OperatingPoint(NamedTuple):
    """Operating point of a wheel that rolls steadily under a load."""

    sinkage: float  # z [m]
    pull: float  # X, drawbar pull [N]
    torque: float  # M, torque of the drive [N m]


def operating_point(system: WheelOnSoil, load: float, slip: float) -> OperatingPoint:
    """Steady operating point: the sinkage at which the soil carries the load.

    Args:
        system: wheel and soil.
        load: on the wheel, normal to the ground [N], > 0.
        slip: s [-], from -1 to 1.

    Raises:
        ValueError: the soil does not carry the load before the wheel sinks by 0.98 of its radius.
    """

    def excess(entry: float) -> float:
        return float(stress_integral(system, entry, slip)[1]) - load

    if not (load > 0.0 and -1.0 <= slip <= 1.0):
        raise ValueError(f"load = {load} N at slip {slip}: a load above 0 and a slip in [-1, 1]")
    if excess(DEEPEST) < 0.0:
        raise ValueError(
            f"load = {load} N at slip {slip}: the soil carries at most "
            f"{load + excess(DEEPEST):.3g} N before the wheel sinks by {2.0 * DEEPEST**2:.3g} of "
            "its radius"
        )
    entry = bracketed_root(excess, 0.0, DEEPEST, xtol=1e-13, rtol=1e-13)
    pull, _, torque = stress_integral(system, entry, slip)
    return OperatingPoint(2.0 * system.radius * entry**2, pull, torque)


def flat_plate(system: WheelOnSoil, load: float, slip: float) -> OperatingPoint:
    """Operating point by Bekker's flat plate; driven wheels only, 0 < s <= 1.

    The older estimate (Bekker 1956, Theory of Land Locomotion): all load on a flat patch of length
    sqrt(2 r z), thrust from its mean shear, resistance from the soil's compaction.

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
