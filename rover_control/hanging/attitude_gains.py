"""Gains and stability margins of the attitude law. Pure.

The tilt p against the tether responds to a rotor's momentum h as I p'' + m g d p = -h'. The law

    h' = K q - k_b h

(q the estimated tilt rate, k_b the desaturation) damps it with the ratio K/(2 I w_b),
w_b^2 = m g d/I, while k_b is small against w_b. The margins follow from the open loop

    L(s) = K s^2/(s + k_b) e^(-s T)/(1 + s/B) / (I s^2 + m g d)

with the delay T from the gyro's sample to the torque and the bandwidth B of the rotor drive.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_schemas.parameters import parameter


@dataclass(frozen=True)
class AttitudeDesign:
    """Design of the attitude law, and the dynamics of the drives."""

    tilt_damping_ratio: float = parameter(0.4, "-", "damping ratio of the tilt", 0.02, 1.0)
    desaturation_time: float = parameter(
        15.0, "s", "time constant with which a rotor sheds its momentum", 1.0, 600.0
    )
    loop_delay: float = parameter(0.04, "s", "delay from the gyro's sample to the torque", 0.0, 0.5)
    drive_bandwidth: float = parameter(20.0, "rad/s", "bandwidth of the rotor drives", 1.0, 1e3)


class AxisGains(NamedTuple):
    """Gains of one axis, with their margins."""

    rate: float  # K [N m s/rad]
    desaturation: float  # k_b [1/s]
    frequency: float  # w_b [rad/s]
    gain_margin: float  # factor on the gain at the stability limit
    phase_margin: float  # [rad], the smallest of all crossings
    friction_tilt: float  # tilt offset that uncompensated friction holds [rad]


def loop(
    frequencies: NDArray[np.float64],
    rate: float,
    inertia: float,
    stiffness: float,
    design: AttitudeDesign,
) -> NDArray[np.complex128]:
    """Open loop L(j w) at angular frequencies [rad/s], for a gain K [N m s/rad]."""  # fmt: skip
    s = 1j * frequencies
    law = rate * s**2 / (s + 1.0 / design.desaturation_time)
    drive = np.exp(-s * design.loop_delay) / (1.0 + s / design.drive_bandwidth)
    return np.asarray(law * drive / (inertia * s**2 + stiffness))


def design_axis(
    inertia: float, stiffness: float, friction: float, design: AttitudeDesign
) -> AxisGains:
    """Design the gains of one axis.

    Args:
        inertia: I about the centre of mass [kg m^2].
        stiffness: m g d [N m/rad].
        friction: dry friction of the rotor's bearings [N m].
        design: requirements.
    """
    frequency = math.sqrt(stiffness / inertia)
    rate = 2.0 * design.tilt_damping_ratio * inertia * frequency
    w = np.geomspace(1e-2 * frequency, 1e2 * frequency, 20001)
    # Skip the resonance, where the loop gain is infinite.
    w = w[np.abs(w - frequency) > 1e-6 * frequency]
    response = loop(w, rate, inertia, stiffness, design)
    size = np.abs(response)
    phase = np.angle(response)
    crossings = np.nonzero((size[1:] - 1.0) * (size[:-1] - 1.0) < 0.0)[0]
    margins = [math.pi - abs(float(phase[k])) for k in crossings]
    flips = np.nonzero((response.imag[1:] * response.imag[:-1] < 0.0) & (response.real[1:] < 0.0))[
        0
    ]
    above = [float(size[k]) for k in flips if w[k] > 1.01 * frequency]
    return AxisGains(
        rate,
        1.0 / design.desaturation_time,
        frequency,
        1.0 / max(above) if above else math.inf,
        min(margins, default=math.pi),
        friction / stiffness,
    )
