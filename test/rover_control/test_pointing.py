"""Pointing by coning: predictions against simulated motion, and refusals."""

from __future__ import annotations

import math
from dataclasses import dataclass

import pytest

from msg_schemas.faults import Reason
from msg_schemas.refusal import Refusal, RefusalCode
from rover_control.hanging.hanging_rover import HangingParameters
from rover_control.hanging.pointing import Pointing, PointingParameters, TurnPrediction
from rover_control.hanging.rotor_pump import NO_MOMENTA, RotorMomenta
from rover_control.hanging.swing_estimator import SwingEstimate

HANGING = HangingParameters()
POINTING = PointingParameters(coning_efficiency=1.0)  # the rover below is the model
RIGHT = 0.5 * math.pi
H = 0.05


def make() -> Pointing:
    return Pointing(POINTING, HANGING)


@dataclass
class Coned:
    """A rover on the twisted tether whose tilt follows its rotors at once."""

    length: float
    heavier: float = 1.0
    heading: float = 0.0
    spin: float = 0.0  # by the twist [rad/s]
    pumped: RotorMomenta = NO_MOMENTA
    before: RotorMomenta = NO_MOMENTA  # momenta of the last step

    def step(self, pointing: Pointing) -> None:
        """Advance by H."""
        w = POINTING.coning_frequency
        inertia_z = self.heavier * HANGING.inertia_about_z
        inertia = self.heavier * math.sqrt(math.prod(HANGING.inertias))
        weighs = self.heavier * HANGING.stiffness - inertia * w * w
        # (m g d - I w^2) p = -h', where h turns with the coning.
        h = complex(self.pumped.x, self.pumped.y)
        advance = self.before.x * self.pumped.y - self.before.y * self.pumped.x
        sense = math.copysign(1.0, advance)
        tilt = -1j * sense * w * h / weighs
        tilt_rate = 1j * sense * w * tilt
        swept = tilt.real * tilt_rate.imag - tilt.imag * tilt_rate.real
        momenta = (h.imag, -h.real)  # about base_link x and y
        leaning = momenta[0] * tilt.real + momenta[1] * tilt.imag
        self.spin -= H * HANGING.torsional_stiffness(self.length) * self.heading / inertia_z
        rate = self.spin - (leaning + inertia * swept) / inertia_z
        zero = (0.0, 0.0)
        swing = SwingEstimate(
            zero,
            zero,
            (tilt.real, tilt.imag),
            (tilt_rate.real, tilt_rate.imag),
            zero,
            rate,
            HANGING.swing_frequency(self.length),
            0.0,
            0.0,
        )
        self.heading += H * (rate + 0.5 * swept)
        self.before = self.pumped
        self.pumped = pointing.step(self.heading, self.length, swing, momenta, H)


def turning_time(rate: float, torsion: float) -> float:
    """Time of a right turn against a torsional oscillator [rad/s]: ramp, full coning, approach.

    At full coning the heading is rate / torsion * sin(torsion * t); half the ramp is lost. The
    approach, whose time constant follows the rate left, ends at the tolerance.
    """
    p, turned = POINTING, RIGHT
    for _ in range(50):
        left = max(
            math.sqrt(rate**2 - (torsion * turned) ** 2) * p.approach_time, p.heading_tolerance
        )
        turned = RIGHT - left
    coned = math.asin(turned * torsion / rate) / torsion if torsion else turned / rate
    approach = p.approach_time * math.log(left / p.heading_tolerance)
    return 0.5 * p.coning_ramp_time + coned + approach


def test_from_zero_twist_the_turn_matches_the_closed_form():
    pointing = make()
    torsion = math.sqrt(HANGING.torsional_stiffness(15.0) / HANGING.inertia_about_z)
    rate = pointing.largest_rate
    predicted = pointing.predict(RIGHT, 0.0, 15.0)
    assert predicted.turning == pytest.approx(turning_time(rate, torsion), abs=1.5)
    assert predicted.limit is Reason.TWIST
    # Without torsional stiffness the hold is unlimited at any length.
    loose = Pointing(POINTING, HangingParameters(twist_stiffness=0.0))
    free = loose.predict(RIGHT, 0.0, 15.0)
    assert free.turning == pytest.approx(turning_time(rate, 0.0), abs=1.5)
    assert free.holding == math.inf


def test_a_helping_twist_shortens_the_turn_and_a_bias_limits_the_hold():
    pointing = make()
    plain = pointing.predict(RIGHT, 0.0, 20.0)
    helped = pointing.predict(RIGHT, -0.5 * RIGHT, 20.0)
    assert helped.turning < plain.turning
    assert helped.holding > plain.holding
    biased = pointing.predict(RIGHT, 0.0, 20.0, yaw_error=2e-4)
    assert biased.limit is Reason.GYRO_BIAS
    # The uncertainty grows from the start of the turn.
    assert biased.turning + biased.holding == pytest.approx(POINTING.heading_tolerance / 4e-4)


@pytest.mark.parametrize("turn", [RIGHT, -RIGHT])
def test_a_right_angle_is_accepted_from_15_m_and_refused_at_5_m(
    turn: float,
):
    for length in (15.0, 30.0, 45.0):
        pointing = make()
        predicted = pointing.request(turn, 0.3, length, yaw_error=1e-4, twist=0.0)
        assert predicted.turning < POINTING.max_turn_time
        assert predicted.holding > POINTING.min_hold_time
        assert pointing.is_active
    pointing = make()
    with pytest.raises(Refusal, match=r"90 deg takes more than .* 5 m of tether: against"):
        pointing.request(turn, 0.3, 5.0, yaw_error=1e-4, twist=0.0)
    assert not pointing.is_active
    with pytest.raises(Refusal, match="limited by gyro_bias") as uncertain:
        pointing.request(turn, 0.3, 30.0, yaw_error=0.01, twist=0.0)
    assert uncertain.value.code is RefusalCode.UNCERTAIN
    with pytest.raises(Refusal, match=r"-pi \.\. pi"):
        pointing.request(math.nan, 0.3, 30.0, yaw_error=0.0, twist=0.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("heavier", [0.8, 1.0, 1.2])
def test_the_simulated_rover_turns_and_holds_as_predicted(sign: float, heavier: float):
    pointing = make()
    length = 15.0
    rover = Coned(length, heavier)
    at_request = pointing.request(sign * RIGHT, 0.0, length, yaw_error=0.0, twist=0.0, mass=heavier)
    time = reached = 0.0
    predicted: TurnPrediction | None = None
    lost: tuple[str, Reason] | None = None
    while lost is None:
        rover.step(pointing)
        time += H
        reached_prediction, lost = pointing.take_reached(), pointing.take_lost()
        if reached_prediction is not None:
            reached, predicted = time, reached_prediction
        elif predicted is not None and lost is None:
            assert abs(rover.heading - sign * RIGHT) < 1.01 * POINTING.heading_tolerance
        assert time < 1000.0
    assert predicted is not None
    assert predicted.limit is Reason.TWIST
    assert lost[1] is Reason.TWIST
    assert not pointing.is_active
    assert reached < POINTING.max_turn_time
    assert time - reached == pytest.approx(predicted.holding, rel=0.1)
    # The prediction at the request, with the estimated mass.
    assert time - reached == pytest.approx(at_request.holding, rel=0.2)
    assert reached == pytest.approx(at_request.turning, rel=0.06)


def test_a_heading_that_is_no_longer_known_is_released():
    pointing, rover = make(), Coned(15.0)
    prediction = pointing.request(RIGHT, 0.0, 15.0, yaw_error=2e-4, twist=0.0)
    assert prediction.limit is Reason.GYRO_BIAS
    time = 0.0
    lost: tuple[str, Reason] | None = None
    while lost is None:
        rover.step(pointing)
        time += H
        lost = pointing.take_lost()
        assert time < 1000.0
    assert lost[1] is Reason.GYRO_BIAS
    assert time == pytest.approx(POINTING.heading_tolerance / 4e-4, abs=1.0)
    # The rotors ramp down.
    for _ in range(round(POINTING.coning_ramp_time / H) + 2):
        rover.step(pointing)
    assert rover.pumped == NO_MOMENTA


def test_a_wheel_bias_during_a_swing_is_not_taken_for_twist():
    pointing = make()
    rate, turn = 0.3, 0.1
    for k in range(2000):
        # A bias about base_link y, while the rover swings along y: L_z is kept.
        lean = 0.03 * math.sin(rate * H * k)
        momentum = -0.03
        turning = -momentum * lean / HANGING.inertia_about_z
        swing = SwingEstimate(
            (0.0, lean),
            (0.0, 0.0),
            (0.0, 0.0),
            (0.0, 0.0),
            (0.0, 0.0),
            turning,
            rate,
            0.0,
            0.0,
        )
        if k == 0:
            pointing.request(turn, 0.0, 30.0, yaw_error=0.0, twist=0.0)
        pumped = pointing.step(0.0, 30.0, swing, (0.0, momentum), H)
        if k > 400:
            # Set by the remaining turn; the rate goes with the square of the momentum.
            share = turn / POINTING.approach_time / pointing.largest_rate
            expected = POINTING.coning_momentum * math.sqrt(share)
            assert math.hypot(pumped.x, pumped.y) == pytest.approx(expected, rel=1e-6)


def test_the_rotors_stay_within_their_bound_and_ramp_down():
    pointing, rover = make(), Coned(30.0)
    pointing.request(RIGHT, 0.0, 30.0, yaw_error=0.0, twist=0.0)
    rover.step(pointing)
    last = rover.pumped
    for k in range(2000):
        if k == 1000:
            pointing.stop()
        rover.step(pointing)
        now = rover.pumped
        assert math.hypot(now.x, now.y) <= POINTING.coning_momentum + 1e-9
        # Change by the coning frequency, and by the square root of the ramp.
        assert abs(now.x - last.x) < 0.012
        last = now
    assert (now.x, now.y) == (0.0, 0.0)
    assert not pointing.is_coning
