"""Gains of the attitude law on the linearised plant: damping, margins, and sensitivity."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from rover_control.hanging.attitude_gains import AttitudeDesign, AxisGains, design_axis

DESIGN = AttitudeDesign()
INERTIA, STIFFNESS, FRICTION = 0.18, 3.2, 0.02


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
        torque += h * DESIGN.drive_bandwidth * (delayed - torque)
        momentum += torque * h
        rate += h * (-STIFFNESS * tilt - torque) / inertia
        tilt += h * rate
        seen.append(tilt)
    return np.array(seen)


def test_the_gain_gives_the_required_damping():
    gains = design_axis(INERTIA, STIFFNESS, FRICTION, replace(DESIGN, tilt_damping_ratio=0.1))
    frequency = math.sqrt(STIFFNESS / INERTIA)
    assert gains.frequency == pytest.approx(frequency)
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
    gains = design_axis(INERTIA, STIFFNESS, FRICTION, DESIGN)
    assert gains.gain_margin > 2.0
    delay = DESIGN.loop_delay
    calm = flown(gains, gain=0.5 * (1.0 + gains.gain_margin), delay=delay)
    wild = flown(gains, gain=1.15 * gains.gain_margin, delay=delay)
    assert abs(calm[-2000:]).max() < 0.05
    assert not abs(wild[-2000:]).max() < 1.0


def test_the_default_rover_has_sufficient_margins():
    for inertia in (0.177, 0.189):
        gains = design_axis(inertia, 3.29, FRICTION, DESIGN)
        assert gains.gain_margin > 3.0
        assert math.degrees(gains.phase_margin) > 45.0


@pytest.mark.parametrize("off", [0.8, 1.2])
def test_the_loop_stays_damped_with_a_mass_error_of_a_fifth(off: float):
    gains = design_axis(INERTIA, STIFFNESS, FRICTION, DESIGN)
    tilt = flown(gains, delay=DESIGN.loop_delay, inertia=off * INERTIA)
    assert abs(tilt[8000:]).max() < 0.05


def test_delay_reduces_the_margin():
    margins = [
        design_axis(INERTIA, STIFFNESS, FRICTION, replace(DESIGN, loop_delay=delay)).gain_margin
        for delay in (0.02, 0.04, 0.08)
    ]
    assert margins == sorted(margins, reverse=True)


def test_friction_gives_the_tilt_offset():
    gains = design_axis(INERTIA, STIFFNESS, FRICTION, DESIGN)
    assert gains.friction_tilt == pytest.approx(FRICTION / STIFFNESS)
