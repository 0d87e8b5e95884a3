"""Odometry from encoders, gyro and tether."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from rover_control.drive.drive_odometry import (
    UNKNOWN_ANGLE,
    DeadReckoning,
    DriveOdometry,
    OdometryParameters,
    TetherMeasurement,
    chord_of,
)
from rover_control.drive.ratchet_kinematics import ChassisParameters, GroundPose, RatchetKinematics

H = 0.02  # [s]
G = (0.0, 0.0, 1.62)
CHASSIS = ChassisParameters()


def odometry(**values: float | bool) -> DriveOdometry:
    parameters = replace(OdometryParameters(), **values)  # type: ignore[arg-type]
    return DriveOdometry(RatchetKinematics(CHASSIS), parameters)


class Feed:
    """Feeds wheel and gyro samples to an odometry; without a noise density they have no noise."""

    def __init__(
        self, reckoning: DriveOdometry, bias: float = 0.0, noise: float = 0.0, seed: int = 0
    ) -> None:
        self.reckoning, self.bias, self.now = reckoning, bias, 0.0
        self.noise = noise / math.sqrt(H)
        self.generator = np.random.default_rng(seed)
        reckoning.on_gyro((0.0, 0.0, bias), G, 0.0, at_rest=False)

    def roll(self, left: float, right: float, yaw: float, time: float, *, at_rest: bool = False):
        for _ in range(round(time / H)):
            self.now += H
            rate = yaw + self.bias + self.noise * self.generator.normal()
            self.reckoning.on_gyro((0.0, 0.0, rate), G, self.now, at_rest=at_rest)
            self.reckoning.on_wheels(left * H, right * H, H)


def test_straight_travel_is_the_rolled_distance_less_the_slip():
    reckoning = odometry()
    reckoning.set_pose(GroundPose(1.0, 2.0, 0.5))
    Feed(reckoning).roll(1.0, 1.0, 0.0, 10.0)
    distance = 0.15 * 10.0 * (1.0 - CHASSIS.driving_slip)
    assert reckoning.travelled == pytest.approx(distance)
    assert reckoning.pose.x == pytest.approx(1.0 + distance * math.cos(0.5))
    assert reckoning.pose.y == pytest.approx(2.0 + distance * math.sin(0.5))


def test_the_slip_follows_the_wheel_torque():
    reckoning = odometry()
    for _ in range(500):
        reckoning.on_wheels(H, H, H, CHASSIS.driving_torque + 0.1)
    assert reckoning.slip == pytest.approx(
        CHASSIS.driving_slip + 0.1 * CHASSIS.slip_per_torque, abs=1e-3
    )


@pytest.mark.parametrize(
    ("torque", "slip"),
    [
        (0.57, 0.22),
        (0.75, 0.41),
        (0.88, 0.61),
        (0.96, 0.76),
        (1.0, 0.87),
        (1.02, 0.975),
        (1.1, 0.985),
    ],
)
def test_the_slip_increases_up_to_the_soils_strength_within_its_deviation(
    torque: float, slip: float
):
    """The simulated rover's slip on slopes of 0 to 9 degrees."""
    reckoning = odometry(initial_position_std=0.0)
    for _ in range(300):
        reckoning.on_wheels(H, H, H, torque)
    reckoning.set_pose(GroundPose(0.0, 0.0, 0.0))
    for _ in range(300):
        reckoning.on_wheels(H, H, H, torque)
    error = reckoning.pose.x - 0.15 * 300 * H * (1.0 - slip)
    assert abs(error) < 2.0 * math.sqrt(reckoning.covariance()[0, 0])


def test_a_turn_rotates_the_pose_about_the_right_wheel_by_the_gyro():
    reckoning = odometry()
    reckoning.set_pose(GroundPose(1.0, 2.0, 0.5))
    pivot = reckoning.kinematics.pivot_of(reckoning.pose)
    Feed(reckoning).roll(-5.0, 0.0, 0.25, 4.0)
    assert reckoning.pose.heading == pytest.approx(1.5)
    assert reckoning.kinematics.pivot_of(reckoning.pose) == pytest.approx(pivot)
    assert reckoning.travelled == 0.0


def test_unequal_slip_of_the_sides_gives_an_arc():
    # Left slips 0.276, right 0.236: the middle of the axle moves by the mean slip.
    reckoning = odometry()
    left, right = 0.15 * (1.0 - 0.276), 0.15 * (1.0 - 0.236)
    yaw = (right - left) / CHASSIS.track_width
    Feed(reckoning).roll(1.0, 1.0, yaw, 20.0)
    radius = 0.5 * (left + right) / yaw
    angle = yaw * 20.0
    # The middle of the axle moves on an arc; base_link lies behind it.
    x = 0.08 + radius * math.sin(angle) - 0.08 * math.cos(angle)
    y = radius * (1.0 - math.cos(angle)) - 0.08 * math.sin(angle)
    assert reckoning.pose.x == pytest.approx(x, abs=2e-3)
    assert reckoning.pose.y == pytest.approx(y, abs=2e-3)


def test_a_wheel_that_overruns_its_axle_rolls_without_slip():
    reckoning = odometry()
    Feed(reckoning).roll(0.0, 1.0, 0.0, 1.0)
    assert reckoning.pose.x == pytest.approx(0.15)


def test_the_gyro_bias_is_estimated_at_rest_and_removed():
    reckoning = odometry()
    feed = Feed(reckoning, bias=3e-3)
    before = reckoning.bias_error
    feed.roll(0.0, 0.0, 0.0, 5.0, at_rest=True)
    assert reckoning.bias == pytest.approx(3e-3, abs=2e-5)
    assert reckoning.bias_error < 0.02 * before
    assert reckoning.pose == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    feed.roll(1.0, 1.0, 0.0, 20.0)
    assert reckoning.pose.heading == pytest.approx(0.0, abs=5e-4)


def test_an_unestimated_bias_increases_the_heading_covariance():
    reckoning = odometry(initial_heading_std=0.0)
    reckoning.set_pose(GroundPose(0.0, 0.0, 0.0))
    Feed(reckoning, bias=3e-3).roll(1.0, 1.0, 0.0, 20.0)
    error = math.sqrt(reckoning.covariance()[2, 2])
    assert error == pytest.approx(0.005 * 20.0, rel=0.02)
    assert reckoning.pose.heading == pytest.approx(0.06, rel=0.01)


def test_gravity_gives_the_pitch_at_rest_and_the_gyro_integrates_it():
    reckoning = odometry()
    force = (-1.62 * math.sin(0.1), 0.0, 1.62 * math.cos(0.1))
    for k in range(200):
        reckoning.on_gyro((0.0, 0.0, 0.0), force, H * k, at_rest=True)
    assert reckoning.attitude.pitch == pytest.approx(0.1, abs=1e-3)
    # Nose down, gravity's reaction has a component along -x.
    for k in range(200, 250):
        reckoning.on_gyro((0.0, 0.1, 0.0), G, H * k, at_rest=False)
    assert reckoning.attitude.pitch > 0.18


def test_a_rover_that_the_tether_rocks_at_rest_keeps_the_pitch_of_the_next_motion():
    reckoning, bias = odometry(), 2e-3
    # The tether lifts the nose while the rover waits; as the wheels start, it comes down again.
    lift = [0.04 * math.sin(math.pi * k / 25) for k in range(26)]
    rates = [*([0.0] * 150), *lift, *([-sum(lift) / 10] * 10), *([0.0] * 500)]
    for k, rate in enumerate(rates):
        reckoning.on_gyro((0.0, rate + bias, 0.0), G, H * k, at_rest=k < 176)
    assert abs(reckoning.attitude.pitch) < 3e-3


def test_rotation_at_a_touchdown_does_not_enter_the_gyro_bias():
    reckoning = odometry()
    feed = Feed(reckoning, bias=1e-3)
    feed.roll(0.0, 0.0, -0.004, 0.1, at_rest=True)
    feed.roll(0.0, 0.0, -0.2, 0.3, at_rest=True)
    assert reckoning.bias_error == pytest.approx(0.005, rel=1e-3)
    feed.roll(0.0, 0.0, 0.0, 5.0, at_rest=True)
    assert reckoning.bias == pytest.approx(1e-3, abs=2e-5)


@pytest.mark.parametrize("seed", range(5))
def test_the_gyro_bias_is_known_soon_after_a_touchdown(seed: int):
    reckoning = odometry()
    feed = Feed(reckoning, bias=-5e-4, noise=1e-4, seed=seed)
    feed.roll(0.0, 0.0, 0.1, 0.3, at_rest=True)
    feed.roll(0.0, 0.0, 0.0, 5.0, at_rest=True)
    assert reckoning.bias_error < 6e-5
    assert abs(reckoning.bias + 5e-4) < 4.0 * reckoning.bias_error


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("rate", [0.002, -0.006])
def test_a_slow_drag_that_begins_at_rest_turns_the_heading_and_spares_the_bias(
    rate: float, seed: int
):
    reckoning = odometry()
    feed = Feed(reckoning, bias=-5e-4, noise=1e-4, seed=seed)
    feed.roll(0.0, 0.0, 0.0, 10.0, at_rest=True)
    feed.roll(0.0, 0.0, rate, 10.0, at_rest=True)
    assert reckoning.bias == pytest.approx(-5e-4, abs=2e-4)
    assert reckoning.pose.heading == pytest.approx(10.0 * rate, abs=2e-3)
    feed.roll(0.0, 0.0, 0.0, 10.0, at_rest=True)
    assert reckoning.bias == pytest.approx(-5e-4, abs=1e-4)


def test_a_rover_hauled_with_still_wheels_changes_its_heading():
    # The winch hauls the rover over the floor while its wheels are still.
    reckoning = odometry()
    feed = Feed(reckoning, bias=1e-3)
    feed.roll(0.0, 0.0, 0.0, 5.0, at_rest=True)
    bias = reckoning.bias
    feed.roll(0.0, 0.0, 0.3, 4.0, at_rest=True)
    assert reckoning.pose.heading == pytest.approx(1.2, abs=1e-3)
    assert reckoning.bias == pytest.approx(bias, abs=1e-6)


def test_the_gyro_bias_is_estimated_on_the_back():
    reckoning = odometry()
    for k in range(500):
        reckoning.on_gyro((0.0, 0.0, 1e-3), (0.0, 0.05, -1.62), H * k, at_rest=True)
    assert reckoning.attitude.inclination > 3.0
    assert reckoning.bias == pytest.approx(1e-3, abs=2e-5)


def taut(x: float, y: float, drop: float = 10.0) -> TetherMeasurement:
    return TetherMeasurement(math.hypot(x, y, drop), 1.0, 0.0)


def test_a_taut_tether_corrects_the_slip():
    values = {"slip_std": 0.05, "slip_correlation_distance": 100.0, "tether_range_std": 0.02}
    reckoning = odometry(initial_position_std=0.01, **values)
    reckoning.set_pose(GroundPose(0.0, 5.0, math.pi / 2.0))
    reckoning.on_tether(taut(0.0, 5.0, 3.0), is_taut=True)
    assert reckoning.drop == pytest.approx(3.0)
    feed = Feed(reckoning)
    y = 5.0
    for _ in range(800):
        feed.roll(1.0, 1.0, 0.0, H)
        y += 0.15 * (1.0 - 0.32) * H
        reckoning.on_tether(taut(0.0, y, 3.0), is_taut=True)
    blind = 5.0 + 0.15 * (1.0 - CHASSIS.driving_slip) * 16.0
    assert abs(reckoning.pose.y - y) < 0.4 * abs(blind - y)
    assert reckoning.slip > CHASSIS.driving_slip + 0.01


def test_a_slack_tether_only_bounds_the_distance():
    reckoning = odometry()
    reckoning.set_pose(GroundPose(5.0, 0.0, 0.0))
    reckoning.on_tether(taut(5.0, 0.0), is_taut=True)
    before = reckoning.pose
    reckoning.on_tether(taut(9.0, 0.0), is_taut=False)
    assert reckoning.pose == before
    reckoning.on_tether(taut(4.0, 0.0), is_taut=False)
    assert reckoning.pose.x < before.x


def test_the_sag_is_that_of_a_shallow_catenary():
    # Exact catenary between supports at one level: L = 2 a sinh(c/2a), a = H/w.
    chord, weight_by_length, horizontal = 20.0, 0.0081, 2.0
    a = horizontal / weight_by_length
    length = 2.0 * a * math.sinh(chord / (2.0 * a))
    end_tension = horizontal * math.cosh(chord / (2.0 * a))
    weight = weight_by_length * length
    chord = chord_of(TetherMeasurement(length, end_tension + 0.5 * weight, weight), chord)
    assert length - chord == pytest.approx(length - chord, rel=0.02)


def test_the_covariance_matches_a_monte_carlo_simulation():
    scatter, ends = 0.03, []
    generator = np.random.default_rng(4)
    for _ in range(60):
        slip, x = CHASSIS.driving_slip + scatter * generator.standard_normal(), 0.0
        keep = math.exp(-0.1116 * 0.5 / 5.0)
        for _ in range(80):
            x += 0.15 * 0.5 * (1.0 - slip)
            spread = scatter * math.sqrt(1.0 - keep**2) * generator.standard_normal()
            slip = CHASSIS.driving_slip + keep * (slip - CHASSIS.driving_slip) + spread
        ends.append(x)
    reckoning = odometry(initial_position_std=0.0, slip_std=scatter, slip_correlation_distance=5.0)
    reckoning.set_pose(GroundPose(0.0, 0.0, 0.0))
    Feed(reckoning).roll(1.0, 1.0, 0.0, 40.0)
    std = math.sqrt(reckoning.covariance()[0, 0])
    assert std == pytest.approx(float(np.std(ends)), rel=0.35)
    assert reckoning.pose.x == pytest.approx(float(np.mean(ends)), abs=3.0 * std / math.sqrt(60.0))


def test_a_pose_that_nobody_gave_is_only_known_to_be_within_the_tether():
    reckoning = odometry()
    assert np.diag(reckoning.covariance()) == pytest.approx([1e6, 1e6, UNKNOWN_ANGLE])
    assert reckoning.height[1] == pytest.approx(1e6)
    reckoning.on_tether(TetherMeasurement(6.0, 10.0, 0.5), is_taut=False)
    z, variance = reckoning.height
    assert np.diag(reckoning.covariance()) == pytest.approx([9.0, 9.0, UNKNOWN_ANGLE])
    # The true place of a rover beside the plumb line is within two standard deviations.
    assert abs(z - -4.84) < 2.0 * math.sqrt(variance)
    reckoning.set_pose(GroundPose(3.0, 0.0, 0.0), knows_heading=False)
    errors = [0.05**2, 0.05**2, UNKNOWN_ANGLE]
    assert np.diag(reckoning.covariance()) == pytest.approx(errors, rel=0.01)
    assert reckoning.height[0] == pytest.approx(-math.sqrt(36.0 - 9.0) - CHASSIS.attachment_offset)
    reckoning.set_pose(GroundPose(3.0, 0.0, 0.0), errors=(0.3, 0.2, 0.1))
    assert np.diag(reckoning.covariance()) == pytest.approx([0.09, 0.04, 0.01], rel=0.01)


def test_dead_reckoning_never_jumps_while_the_pose_is_corrected():
    corrected = odometry()
    dead = DeadReckoning(corrected)
    assert not np.any(dead.covariance())
    feeds = [Feed(each, bias=0.003) for each in (corrected, dead)]
    generator = np.random.default_rng(3)
    largest = 0.0
    for leg in range(4):
        for yaw, rates, at_rest in ((0.0, (0.0, 0.0), True), (0.05, (1.0, 1.0), False)):
            for _ in range(150):
                before = dead.pose
                for feed in feeds:
                    feed.roll(*rates, yaw, H, at_rest=at_rest)
                tether = TetherMeasurement(5.0 + 0.1 * leg + generator.normal(0.0, 0.1), 9.0, 0.3)
                corrected.on_tether(tether, is_taut=leg > 0)
                largest = max(largest, before.distance(dead.pose.x, dead.pose.y))
        corrected.set_pose(GroundPose(3.0 + leg, 1.0, 0.5))
    # A step of the wheels, and nothing more.
    assert 0.0 < largest < 0.15 * H * 1.5
    spread = np.linalg.eigvalsh(dead.covariance())
    assert np.all(spread > 0.0)
    assert dead.covariance()[0, 0] > 0.0


def test_the_covariance_of_dead_reckoning_is_that_of_its_errors():
    """Of many rovers with a gyro's bias and noise, each at rest before and after a drive."""
    generator = np.random.default_rng(11)
    squares = []
    for _ in range(60):
        dead = DeadReckoning(odometry())
        bias = generator.normal(0.0, dead.parameters.gyro_turn_on_bias)
        noise = dead.parameters.gyro_noise_density / math.sqrt(H)
        now, true = 0.0, 0.0
        dead.on_gyro((0.0, 0.0, bias), G, now, at_rest=False)
        for at_rest, yaw, steps in ((False, 0.2, 200), (True, 0.0, 200), (False, 0.1, 200)):
            for _ in range(steps):
                now += H
                measured = yaw + bias + generator.normal(0.0, noise)
                dead.on_gyro((0.0, 0.0, measured), G, now, at_rest=at_rest)
                true += yaw * H
        squares.append((dead.turned - true) ** 2 / dead.covariance()[2, 2])
    assert 0.6 < np.mean(squares) < 1.5


def test_a_flight_carries_the_rover_an_unknown_distance():
    """Of its speed's spread times its duration, flight by flight."""
    reckoning = odometry(flight_speed_std=0.2, initial_position_std=0.05)
    reckoning.set_pose(GroundPose(1.0, 2.0, 0.0))
    feed, before = Feed(reckoning), reckoning.pose
    variance = 0.05**2
    for flight in (1.0, 0.6):
        for _ in range(round(flight / H)):
            feed.now += H
            reckoning.on_gyro((0.0, 0.0, 0.0), (0.0, 0.0, 0.1), feed.now, at_rest=False, flies=True)
        feed.roll(0.0, 0.0, 0.0, 1.0)
        variance += (0.2 * flight) ** 2
        assert np.diag(reckoning.covariance())[:2] == pytest.approx([variance, variance], rel=0.01)
    assert reckoning.pose == before
