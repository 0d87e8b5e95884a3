"""Gains of the attitude law. Pure.

The tilt p against the tether responds to a rotor's momentum h as I p'' + m g d p = -h'. The law

    h' = K q - k_b h

(q the estimated tilt rate, k_b the desaturation) damps it with the ratio K/(2 I w_b),
w_b^2 = m g d/I, while k_b is small against w_b.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas.parameters import parameter


@dataclass(frozen=True)
class AttitudeDesign:
    """Design of the attitude law."""

    tilt_damping_ratio: float = parameter(0.4, "-", "damping ratio of the tilt", 0.02, 1.0)
    desaturation_time: float = parameter(
        15.0, "s", "time constant with which a rotor sheds its momentum", 1.0, 600.0
    )


class AxisGains(NamedTuple):
    """Gains of one axis."""

    rate: float  # K [N m s/rad]
    desaturation: float  # k_b [1/s]


def design_axis(inertia: float, stiffness: float, design: AttitudeDesign) -> AxisGains:
    """Design the gains of one axis.

    Args:
        inertia: I about the centre of mass [kg m^2].
        stiffness: m g d [N m/rad].
        design: requirements.
    """
    frequency = math.sqrt(stiffness / inertia)
    rate = 2.0 * design.tilt_damping_ratio * inertia * frequency
    return AxisGains(rate, 1.0 / design.desaturation_time)
