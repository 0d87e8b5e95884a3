"""The swing estimator against a simulated rover in space."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest
from hanging_model import HangingModel

from rover_control.hanging.hanging_rover import HangingParameters
from rover_control.hanging.swing_estimator import EstimatorParameters, SwingEstimate, SwingEstimator

HANGING = HangingParameters()
GYRO_NOISE = math.radians(0.05)


def watched(
    model: HangingModel, seconds: float, *, pump: float = 0.0, estimate: bool = True
) -> SwingEstimator:
    """Run an estimator on the model; `pump` gives the rotor momenta."""
    estimator = SwingEstimator(EstimatorParameters(), HANGING)
    frequency = HANGING.swing_frequency(model.length)
    for k in range(round(100 * seconds)):
        rate = pump * math.cos(frequency * 0.01 * k)
        gyro, force = model.step((0.5 * rate, rate))
        estimator.on_drum(model.length, model.payout_rate)
        change = (-0.01 * rate, 0.005 * rate) if estimate else (0.0, 0.0)
        estimator.step(gyro, force, change, 0.01)
    return estimator


def make_model(length: float, **rest: object) -> HangingModel:
    frequency = HANGING.swing_frequency(length)
    amplitude = math.radians(1.0)
    # An ellipse of 1 by 0.4 deg, counter-clockwise.
    u, v = complex(amplitude), 0.4j * amplitude * frequency
    model = HangingModel(HANGING, length, u, v, phi=u, phi_rate=v)
    return replace(model, noise=GYRO_NOISE, accelerometer_noise=0.01, **rest)  # type: ignore[arg-type]


def misses(estimate: SwingEstimate, model: HangingModel) -> tuple[float, float]:
    """Errors of swing direction [rad] and of the rover's angular rate [rad/s]."""
    direction = complex(*estimate.direction) - model.in_base(model.u)
    rate = complex(*estimate.direction_rate) + complex(*estimate.tilt_rate)
    return abs(direction), abs(rate - model.in_base(model.phi_rate))


@pytest.mark.parametrize("length", [2.0, 15.0, 45.0])
def test_swing_and_bias_are_estimated_under_noise(length: float):
    model = make_model(length, bias=(0.002, -0.0015, 0.001), yaw_rate=0.004)
    estimate = watched(model, 50.0).estimate
    direction, rate = misses(estimate, model)
    assert direction < math.radians(0.06)
    assert rate < math.radians(0.06)
    # Along x turns -omega_y, along y omega_x.
    assert estimate.gyro_bias == pytest.approx((0.0015, 0.002), abs=2e-4)
    assert estimate.yaw_rate == pytest.approx(0.004, abs=6e-4)


def test_the_ellipse_has_its_sense_and_plane():
    ellipse = watched(make_model(10.0), 40.0).estimate.ellipse
    assert math.degrees(ellipse.major) == pytest.approx(1.0, abs=0.06)
    assert math.degrees(ellipse.minor) == pytest.approx(0.4, abs=0.06)
    assert math.sin(ellipse.plane) == pytest.approx(0.0, abs=0.1)
    mirrored = make_model(10.0)
    mirrored.v, mirrored.phi_rate = -mirrored.v, -mirrored.phi_rate
    assert watched(mirrored, 30.0).estimate.ellipse.minor < math.radians(-0.3)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_solid_angle_and_precession_of_a_cone_do_not_bias_the_gyro(sign: float):
    frequency = HANGING.swing_frequency(2.0)
    u, v = complex(math.radians(3.0)), 1j * sign * math.radians(2.2) * frequency
    model = HangingModel(HANGING, 2.0, u, v, phi=u, phi_rate=v, bias=(0.0, 0.0, 0.001))
    model = replace(model, noise=GYRO_NOISE, accelerometer_noise=0.01)
    estimator = watched(model, 60.0)
    # Heading and plane: the half and three eighths of w a b, 0.05 and 0.04 deg/s here.
    swept = 0.5 * frequency * math.radians(3.0) * math.radians(2.2)
    yaw_rate = estimator.estimate.yaw_rate + sign * swept
    assert swept > math.radians(0.04)
    assert abs(yaw_rate) < math.radians(0.02)


def test_a_swing_keeps_its_plane_in_space_while_the_rover_yaws():
    model = make_model(15.0, yaw_rate=0.05)
    estimate = watched(model, 50.0).estimate
    assert misses(estimate, model)[0] < math.radians(0.05)
    assert estimate.ellipse.plane % math.pi == pytest.approx(-model.yaw % math.pi, abs=0.1)


@pytest.mark.parametrize("rate", [0.3, -0.3])
def test_the_swing_is_tracked_at_a_payout_rate(rate: float):
    model = make_model(18.0, payout_rate=rate)
    estimate = watched(model, 40.0).estimate
    assert misses(estimate, model)[0] < math.radians(0.06)


def test_rotor_reactions_are_not_taken_for_swing():
    # 0.3 deg of swing on 5 m, and rotors that tilt the rover by more than that.
    def still() -> HangingModel:
        return make_model(5.0)

    model = still()
    known = misses(watched(model, 40.0, pump=0.02).estimate, model)[0]
    assert known < math.radians(0.04)
    other = still()
    unknown = misses(watched(other, 40.0, pump=0.02, estimate=False).estimate, other)[0]
    assert unknown > 1.5 * known


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_continuously_pumped_swing_is_estimated_without_lag(sign: float):
    # Momenta at right angles to the swing's velocity, as they turn the rover; IMU read at 50 Hz.
    amplitude, frequency = math.radians(1.5), HANGING.swing_frequency(2.0)
    u, v = complex(amplitude), 1j * amplitude * frequency
    model = HangingModel(HANGING, 2.0, u, v, phi=u, phi_rate=v)
    estimator = SwingEstimator(EstimatorParameters(), HANGING)
    push = sign * 0.03 * frequency
    missed = []
    for k in range(1500):
        phase = frequency * 0.02 * k
        rates = (push * math.cos(phase), push * math.sin(phase))
        model.step(rates)
        gyro, force = model.step(rates)
        estimator.on_drum(2.0, 0.0)
        estimator.step(gyro, force, (-0.02 * rates[1], 0.02 * rates[0]), 0.02)
        if k > 1000:
            estimate = complex(*estimator.estimate.direction)
            missed.append(abs(estimate) - abs(model.in_base(model.u)))
    # The swing grows or falls by more than that, within some seconds.
    assert abs(abs(model.u) - amplitude) > math.radians(0.3)
    assert max(abs(each) for each in missed) < math.radians(0.03)


def test_a_free_tilt_is_separated_from_the_swing():
    model = make_model(20.0)
    model.phi += 1j * math.radians(1.0)
    estimate = watched(model, 30.0).estimate
    tilt = model.in_base(model.phi - model.u)
    assert abs(complex(*estimate.tilt) - tilt) < math.radians(0.12)
    assert misses(estimate, model)[0] < math.radians(0.05)


def test_the_ellipse_is_that_of_the_centre_of_mass_whatever_the_tilt():
    length = 3.0
    model = make_model(length)
    frequency = HANGING.swing_frequency(length)
    model.phi += 1j * math.radians(1.0)
    estimator = watched(model, 40.0)
    share = HANGING.lever / (length + HANGING.lever)
    for k in range(1000):
        gyro, force = model.step((0.0, 0.0))
        estimator.step(gyro, force, (0.0, 0.0), 0.01)
        if k % 50 == 0:
            z = model.u + share * (model.phi - model.u)
            turned = (model.v + share * (model.phi_rate - model.v)) / (1j * frequency)
            ahead, back = 0.5 * abs(z + turned), 0.5 * abs(z - turned)
            found = estimator.estimate.ellipse
            assert found.major == pytest.approx(ahead + back, abs=math.radians(0.03))
            assert found.minor == pytest.approx(ahead - back, abs=math.radians(0.03))


# An instant impact between accelerometer samples, and forces of 10 to 500 ms.
@pytest.mark.parametrize(("samples", "arm"), [(1, 0.0), (1, 30.2), (3, 30.2), (50, 30.2)])
def test_a_disturbance_is_detected_and_estimated_within_a_quarter_period(samples: int, arm: float):
    model = make_model(30.0)
    estimator = watched(model, 50.0)
    calm = estimator.estimate.swing_error
    push = cmath.rect(math.radians(1.5) * HANGING.swing_frequency(30.0) / samples, 2.0)
    impact = arm * push / 0.01
    errors: list[float] = []
    swings: list[float] = []
    for k in range(700):
        if k < samples:
            model.v += push
            model.phi_rate += push
        gyro, force = model.step((0.0, 0.0))
        if k < samples:
            force = (force[0] + impact.real, force[1] + impact.imag, force[2])
        estimator.step(gyro, force, (0.0, 0.0), 0.01)
        errors.append(estimator.estimate.swing_error)
        swings.append(estimator.estimate.ellipse.major)
    assert max(errors[:70]) > 5.0 * calm
    assert (estimator.disturbances, estimator.divergences) == (1, 0)
    assert max(swings) < math.radians(3.0)
    assert misses(estimator.estimate, model)[0] < math.radians(0.15)
    # No false detection.
    assert calm < 2.5e-4


@pytest.mark.parametrize("plane", [0.0, 45.0, 90.0])
def test_a_disturbance_is_detected_in_every_plane(plane: float):
    model = make_model(30.0)
    estimator = watched(model, 50.0)
    push = cmath.rect(math.radians(0.62) * HANGING.swing_frequency(30.0), math.radians(plane))
    for k in range(1000):
        model.v += push if k == 0 else 0.0
        model.phi_rate += push if k == 0 else 0.0
        gyro, force = model.step((0.0, 0.0))
        if k == 0:  # the tether's force over one sample
            impact = 30.2 * push / 0.01
            force = (force[0] + impact.real, force[1] + impact.imag, force[2])
        estimator.step(gyro, force, (0.0, 0.0), 0.01)
    assert estimator.disturbances == 1
    assert misses(estimator.estimate, model)[0] < math.radians(0.1)


@pytest.mark.parametrize("yaw_rate", [0.0, -0.09])
def test_the_swing_of_a_lifted_rover_is_estimated_under_tilt_and_vibration(
    yaw_rate: float,
):
    model = make_model(6.6, yaw_rate=yaw_rate)
    # Tilts by 4 deg at 16 deg/s, as after a lift off the floor; heavier than the nominal mass.
    model.phi += math.radians(4.0) * cmath.exp(0.5j)
    model.phi_rate += math.radians(16.0) * cmath.exp(2.0j)
    model.hanging = replace(HANGING, rover_mass=11.0)
    model.vibration = math.radians(3.0)
    estimator = watched(model, 15.0)
    assert estimator.disturbances == 0
    assert misses(estimator.estimate, model)[0] < math.radians(0.2)
    assert abs(estimator.yaw_bias) < 0.002


@pytest.mark.parametrize("plane", [0.0, 0.7, 2.1])
def test_the_estimate_of_a_lifted_rover_is_within_its_deviation_from_the_first_second(
    plane: float,
):
    model = make_model(50.0)
    model.u, model.v = 0.1 * model.u, 0.1 * model.v
    model.phi = model.u + math.radians(2.0) * cmath.exp(1j * plane)
    model.phi_rate += math.radians(10.0) * cmath.exp(1j * (plane + 1.5))
    model.vibration = math.radians(2.0)
    model.vibration_rate = 3.6
    estimator = SwingEstimator(EstimatorParameters(), HANGING)
    for k in range(2000):
        gyro, force = model.step((0.0, 0.0))
        estimator.on_drum(50.0, 0.0)
        estimator.step(gyro, force, (0.0, 0.0), 0.01)
        if k > 100:
            estimate = estimator.estimate
            deviation = estimate.swing_error / estimate.frequency
            assert misses(estimate, model)[0] < 6.0 * deviation + math.radians(0.1)


@pytest.mark.parametrize("rate", [7.2, 10.7])  # of a long tether's second and third mode [rad/s]
def test_tether_vibration_gives_no_false_detection_and_masks_no_disturbance(rate: float):
    model = make_model(45.0)
    model.vibration_rate = rate
    estimator = SwingEstimator(EstimatorParameters(), HANGING)
    before: list[float] = []
    after: list[float] = []
    for k in range(10000):
        model.vibration = math.radians(1.0) * math.sin(0.0008 * k) ** 2
        if k == 6000:
            assert estimator.disturbances == 0
            push = 1j * math.radians(1.5) * HANGING.swing_frequency(45.0)
            model.v += push
            model.phi_rate += push
        gyro, force = model.step((0.0, 0.0))
        estimator.on_drum(45.0, 0.0)
        estimator.step(gyro, force, (0.0, 0.0), 0.01)
        if k > 3000:
            (before if k < 6000 else after).append(misses(estimator.estimate, model)[0])
    assert max(before) < math.radians(0.1)
    assert max(after[2000:]) < math.radians(0.4)


def test_a_free_tilt_with_an_inertia_error_is_not_taken_for_swing():
    model = make_model(6.6)
    model.phi += math.radians(4.0)
    model.phi_rate += math.radians(16.0) * 1j
    model.hanging = replace(HANGING, inertia_about_x=0.16, inertia_about_y=0.16)
    estimator = watched(model, 10.0)
    assert misses(estimator.estimate, model)[0] < math.radians(0.5)


def test_without_the_drum_nothing_is_estimated():
    estimator = SwingEstimator(EstimatorParameters(), HANGING)
    estimator.step((0.1, 0.1, 0.1), (0.0, 0.0, 1.62), (0.0, 0.0), 0.01)
    assert estimator.estimate.direction == (0.0, 0.0)


def test_a_slack_tether_shows_no_tilt():
    model = make_model(15.0)
    estimator = watched(model, 20.0)
    before = estimator.estimate.tilt
    estimator.step((0.0, 0.0, 0.0), (5.0, 5.0, 0.1), (0.0, 0.0), 0.01)
    assert estimator.estimate.tilt == pytest.approx(before, abs=1e-3)


@pytest.mark.parametrize("pull", [0.0, 0.2, 1.0, 5.0])
@pytest.mark.parametrize("h", [0.01, 0.1, 0.2])
def test_motion_of_a_supported_rover_does_not_diverge(pull: float, h: float):
    rng = np.random.default_rng(1)
    estimator = SwingEstimator(EstimatorParameters(), HANGING)
    estimator.on_drum(51.0, 0.0)
    for k in range(1500):
        disturbance = 0.3 if k % 500 in range(200, 205) else 0.0
        x, y, z = rng.normal(disturbance, GYRO_NOISE, 3)
        estimator.step((x, y, z), (0.01, 0.0, pull * HANGING.rover_gravity), (0.0, 0.0), h)
        estimate = estimator.estimate
        assert max(abs(angle) for angle in (*estimate.direction, *estimate.tilt)) < 1.0
        assert estimate.swing_error < 1.0


def imaged(
    model: HangingModel,
    seconds: float,
    *,
    distance: float = 1000.0,
    smear_noise: float = 0.0,
    until_imaged: float = 0.0,
) -> SwingEstimator:
    """Run an estimator on the model, with the image of the wall behind the rover at 10 Hz."""
    estimator = SwingEstimator(EstimatorParameters(), HANGING)
    rng = np.random.default_rng(3)
    moved = 0.0j  # of the image in this exposure [rad]: upward, sideways
    for k in range(round(100 * seconds)):
        gyro, force = model.step((0.0, 0.0))
        estimator.on_drum(model.length, 0.0)
        estimator.step(gyro, force, (0.0, 0.0), 0.01)
        rate, speed = model.in_base(model.phi_rate), model.in_base(model.v)
        reach = (model.length + HANGING.lever) / distance
        moved += 0.01 * complex(rate.real, model.yaw_rate - reach * speed.imag)
        if k % 10 == 9:
            smear = abs(moved) / 0.5e-3 + smear_noise * rng.standard_normal()
            if 0.01 * k >= until_imaged:
                estimator.on_image(max(smear, 0.0), distance)
            moved = 0.0j
    return estimator


def make_calm(length: float, **rest: object) -> HangingModel:
    model = HangingModel(HANGING, length, 0.0j, 0.0j, phi=0.0j, phi_rate=0.0j)
    return replace(model, noise=GYRO_NOISE, accelerometer_noise=0.01, **rest)  # type: ignore[arg-type]


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("length", [2.0, 45.0])
def test_a_still_image_reveals_the_yaw_bias_of_a_calm_rover(length: float, sign: float):
    bias = sign * 0.005
    estimator = imaged(make_calm(length, bias=(0.001, 0.001, bias)), 5.0)
    error = estimator.estimate.yaw_error
    assert error < 2e-4
    assert abs(estimator.yaw_bias - bias) < 3.0 * error
    unseen = imaged(make_calm(length, bias=(0.001, 0.001, bias)), 5.0, until_imaged=9.0)
    assert unseen.estimate.yaw_error > 1.9e-3


def test_many_smeared_images_do_not_make_the_yaw_rate_known_better_than_one():
    # A turn of 0.06 deg/s, that no image tells from a bias.
    model = make_calm(15.0, yaw_rate=0.001)
    estimator = imaged(model, 60.0)
    assert estimator.estimate.yaw_error > 0.001
    assert abs(estimator.estimate.yaw_rate - 0.001) < 1.5 * estimator.estimate.yaw_error


def test_a_report_of_the_smear_with_noise_is_allowed_for():
    model = make_calm(15.0, bias=(0.0, 0.0, -0.005))
    estimator = imaged(model, 5.0, smear_noise=0.1)
    error = estimator.estimate.yaw_error
    assert 2e-4 < error < 1e-3
    assert abs(estimator.yaw_bias + 0.005) < 3.0 * error


@pytest.mark.parametrize("distance", [3.0, 1000.0])
@pytest.mark.parametrize("plane", [0.0, 1.2, 0.5 * math.pi])
def test_images_of_a_swinging_rover_bound_the_yaw_bias_at_the_turning_points(
    distance: float, plane: float
):
    u = math.radians(0.3) * cmath.exp(1j * plane)
    model = make_calm(5.0, bias=(0.0, 0.0, 0.005))
    model.u = model.phi = u
    estimator = imaged(model, 20.0, distance=distance)
    error = estimator.estimate.yaw_error
    assert error < 1.2e-3
    assert abs(estimator.yaw_bias - 0.005) < 3.0 * error


def test_a_pause_keeps_the_biases_and_adds_their_random_walk():
    estimator = imaged(make_calm(5.0, bias=(0.001, 0.001, 0.005)), 10.0)
    bias, before = estimator.estimate.gyro_bias, estimator.estimate.yaw_error
    yaw_bias = estimator.yaw_bias
    estimator.reset_swing(100.0)
    assert estimator.estimate.gyro_bias == bias
    assert estimator.yaw_bias == yaw_bias
    walked = EstimatorParameters().yaw_gyro_bias_random_walk * math.sqrt(100.0)
    assert estimator.estimate.yaw_error == pytest.approx(math.hypot(before, walked))
    # Never less certain than at the start.
    estimator.reset_swing(1e9)
    assert estimator.estimate.yaw_error == EstimatorParameters().gyro_turn_on_bias


def test_an_estimator_whose_covariance_is_not_positive_begins_anew():
    estimator = watched(make_model(10.0), 20.0)
    # The rates of swing and tilt about one axis, correlated by more than their variances allow.
    variances = estimator._covariance[[1, 3], [1, 3]]
    for row, column in ((1, 3), (3, 1)):
        estimator._covariance[row, column] = -0.5 * variances.sum() - 1e-5
    estimator.step((0.0, 0.0, 0.0), (0.0, 0.0, HANGING.rover_gravity), (0.0, 0.0), 0.01)
    assert estimator.divergences == 1
    assert estimator.estimate.ellipse.major == 0.0
