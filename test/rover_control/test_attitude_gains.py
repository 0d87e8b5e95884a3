"""Gains of the attitude law on the linearised plant: damping, margins, and sensitivity.

The margins follow from the open loop

    L(s) = K s^2/(s + k_b) e^(-s T)/(1 + s/B) / (I s^2 + m g d)

with the delay T from the gyro's sample to the torque and the bandwidth B of the rotor drive.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from rover_control.hanging.attitude_gains import AttitudeDesign, AxisGains, design_axis

DESIGN = AttitudeDesign()
INERTIA, STIFFNESS = 0.18, 3.2
DELAY = 0.04  # T [s]
BANDWIDTH = 20.0  # B [rad/s]


class Margins(NamedTuple):
    """Stability margins of one axis."""

    gain: float  # factor on the gain at the stability limit
    phase: float  # [rad], the smallest of all crossings


def margins_of(inertia: float, stiffness: float, delay: float = DELAY) -> Margins:
    """Margins of the designed gains."""
    gains = design_axis(inertia, stiffness, DESIGN)
    frequency = math.sqrt(stiffness / inertia)
    w = np.geomspace(1e-2 * frequency, 1e2 * frequency, 20001)
    # Skip the resonance, where the loop gain is infinite.
    w = w[np.abs(w - frequency) > 1e-6 * frequency]
    s = 1j * w
    law = gains.rate * s**2 / (s + gains.desaturation)
    drive = np.exp(-s * delay) / (1.0 + s / BANDWIDTH)
    response = law * drive / (inertia * s**2 + stiffness)
    size, phase = np.abs(response), np.angle(response)
    crossings = np.nonzero((size[1:] - 1.0) * (size[:-1] - 1.0) < 0.0)[0]
    is_flip = (response.imag[1:] * response.imag[:-1] < 0.0) & (response.real[1:] < 0.0)
    above = [float(size[k]) for k in np.nonzero(is_flip)[0] if w[k] > 1.01 * frequency]
    return Margins(
        1.0 / max(above) if above else math.inf,
        min((math.pi - abs(float(phase[k])) for k in crossings), default=math.pi),
    )


def flown(
    gains: AxisGains, *, gain: float = 1.0, delay: float = 0.0, inertia: float = INERTIA
) -> np.ndarray:
    """Tilt over 20 s after a release at 1, on the exact linear plant."""
    h, tilt, rate, momentum = 1e-3, 1.0, 0.0, 0.0
    late = [0.0] * max(1, round(delay / h))
    seen, torque = [], 0.0
    for _ in range(20000):
        setpoint = gain * gains.rate * rate - gains.desaturation * momentum
        late.append(setpoint)
        delayed = late.pop(0)
        torque += h * BANDWIDTH * (delayed - torque)
        momentum += torque * h
        rate += h * (-STIFFNESS * tilt - torque) / inertia
        tilt += h * rate
        seen.append(tilt)
    return np.array(seen)


def test_the_gain_gives_the_required_damping():
    gains = design_axis(INERTIA, STIFFNESS, replace(DESIGN, tilt_damping_ratio=0.1))
    # K s^2/(s + k_b) -> K s: I s^2 + K s + m g d
    assert gains.rate / (2.0 * math.sqrt(INERTIA * STIFFNESS)) == pytest.approx(0.1)
    tilt = flown(gains)
    peaks = [
        tilt[k] for k in range(1, 6000) if tilt[k - 1] < tilt[k] >= tilt[k + 1] and tilt[k] > 0.05
    ]
    ratio = math.log(peaks[0] / peaks[1])
    damping = ratio / math.hypot(ratio, math.tau)
    # The drive's lag reduces it.
    assert damping == pytest.approx(0.1, rel=0.15)


def test_the_loop_is_stable_up_to_its_gain_margin():
    gains = design_axis(INERTIA, STIFFNESS, DESIGN)
    margin = margins_of(INERTIA, STIFFNESS).gain
    assert margin > 2.0
    calm = flown(gains, gain=0.5 * (1.0 + margin), delay=DELAY)
    wild = flown(gains, gain=1.15 * margin, delay=DELAY)
    assert abs(calm[-2000:]).max() < 0.05
    assert not abs(wild[-2000:]).max() < 1.0


def test_the_default_rover_has_sufficient_margins():
    for inertia in (0.177, 0.189):
        margins = margins_of(inertia, 3.29)
        assert margins.gain > 3.0
        assert math.degrees(margins.phase) > 45.0


@pytest.mark.parametrize("off", [0.8, 1.2])
def test_the_loop_stays_damped_with_a_mass_error_of_a_fifth(off: float):
    gains = design_axis(INERTIA, STIFFNESS, DESIGN)
    tilt = flown(gains, delay=DELAY, inertia=off * INERTIA)
    assert abs(tilt[8000:]).max() < 0.05


def test_delay_reduces_the_margin():
    margins = [margins_of(INERTIA, STIFFNESS, delay).gain for delay in (0.02, 0.04, 0.08)]
    assert margins == sorted(margins, reverse=True)
