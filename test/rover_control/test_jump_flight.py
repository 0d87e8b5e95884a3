"""Flights measured by an IMU, against known trajectories."""

from __future__ import annotations

import math

import numpy as np
import pytest

from msg_schemas.samples import ImuSample
from rover_control.jump.jump_flight import FlightRecorder, MeasuredJump

NANO = 1_000_000_000
STEP = NANO // 100
G = 1.62
HELD, UP = 0.5, 0.05  # durations of rest and push [s]


def fly(
    speed: float = 1.0,
    ahead: float = 0.3,
    *,
    bias: tuple[float, float, float] = (0.0, 0.0, 0.0),
    tilt: float = 0.0,
    spin: float = 0.0,
    clip: float = 80.0,
    push: float = UP,
    gap: int = -1,
    recorder: FlightRecorder | None = None,
) -> MeasuredJump | None:
    """A parabola from rest to rest, push and landing `push` [s] long, as measured by an IMU.

    Args:
        speed, ahead: at take-off, up and along the level x [m/s].
        bias: of the accelerometer [m/s^2].
        tilt: of the body about its y [rad].
        spin: about the vertical in flight [rad/s].
        clip: range of the accelerometer [m/s^2].
        gap: index of the first of ten lost samples.
    """
    recorder = FlightRecorder(imu_offset=0.0) if recorder is None else recorder
    recorder.begin()
    flight = 2.0 * speed / G
    released, landed = HELD, HELD + push + flight
    ends = landed + push + 0.6
    yaw = 0.0
    for k in range(1, round(ends * 100)):
        t = (k - 0.5) / 100.0
        world = np.zeros(3)
        if released <= t < released + push:
            world = np.array([ahead, 0.0, speed]) / push
        elif released + push <= t < landed:
            world = np.array([0.0, 0.0, -G])
        elif landed <= t < landed + push:
            world = np.array([-ahead, 0.0, speed]) / push
        turning = spin if released + push <= t < landed else 0.0
        yaw += turning / 100.0
        c, s = math.cos(yaw - 0.5 * turning / 100.0), math.sin(yaw - 0.5 * turning / 100.0)
        force = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ (
            world + np.array([0.0, 0.0, G])
        )
        c, s = math.cos(tilt), math.sin(tilt)
        body = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
        force = np.clip(body @ force + np.array(bias), -clip, clip)
        rate = body @ np.array([0.0, 0.0, turning])
        if k == round(HELD * 100):
            recorder.release(k * STEP)
        if not gap <= k < gap + 10:
            gyro = (float(rate[0]) + 0.002, float(rate[1]), float(rate[2]))
            x, y, z = force.tolist()
            recorder.on_imu(ImuSample(k * STEP, gyro, (x, y, z)), k * STEP)
    last = (round(ends * 100) - 1) * STEP
    return recorder.finish(round(landed * NANO), flight, last)


def rise(speed: float, push: float = UP) -> float:
    return 0.5 * speed * push + speed**2 / (2.0 * G)


@pytest.mark.parametrize("tilt", [0.0, 0.1, -0.3])
@pytest.mark.parametrize("speed", [0.3, 0.6, 1.1])
def test_height_and_range_are_measured_with_any_bias_and_tilt(speed: float, tilt: float):
    flown = fly(speed, 0.2, tilt=tilt, bias=(0.02, -0.01, 0.015))
    assert flown is not None
    assert flown.height == pytest.approx(rise(speed), abs=3e-3)
    assert flown.ahead == pytest.approx(0.2 * (2.0 * speed / G + UP), abs=0.01)
    assert flown.left == pytest.approx(0.0, abs=0.01)
    assert flown.range == math.hypot(flown.ahead, flown.left)
    assert abs(flown.turn) < 0.01
    assert flown.tilt < 0.01


def test_a_rotation_about_the_vertical_is_measured():
    flown = fly(1.0, spin=0.4)
    assert flown is not None
    assert flown.turn == pytest.approx(0.4 * 2.0 / G, abs=0.01)
    assert flown.height == pytest.approx(rise(1.0), abs=3e-3)


def test_accelerometer_saturation_is_corrected():
    short = 0.01  # 110 m/s^2
    flown = fly(1.1, push=short, clip=80.0)
    assert flown is not None
    # The landing is as short: half of the remaining velocity is its own.
    assert flown.height == pytest.approx(rise(1.1, short), rel=0.02)


def test_a_flight_with_samples_missing_is_not_measured():
    assert fly(gap=80) is None


def test_a_jump_without_release_or_with_few_samples_is_not_measured():
    assert FlightRecorder().finish(0, 0.0, NANO) is None
    recorder = FlightRecorder()
    recorder.release(NANO)
    recorder.on_imu(ImuSample(NANO, (0.0, 0.0, 0.0), (0.0, 0.0, G)), NANO)
    assert recorder.finish(2 * NANO, 1.0, 3 * NANO) is None


def test_one_recorder_measures_one_flight_after_the_other():
    recorder = FlightRecorder(imu_offset=0.0)
    for speed in (1.0, 0.5):
        flown = fly(speed, recorder=recorder)
        assert flown is not None
        assert flown.height == pytest.approx(rise(speed), abs=3e-3)
