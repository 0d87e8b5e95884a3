"""Spin stopped by the swing, and a cone's momentum transferred through the tether."""

from __future__ import annotations

import math

import pytest
from rope_pendulum import HANGING, H, Pendulum, swinging

from rover_control.hanging.hanging_rover import HangingParameters
from rover_control.hanging.rotor_pump import RotorPump
from rover_control.hanging.swing_damping import DampingParameters
from rover_control.hanging.yaw_momentum import YawMomentumController, YawParameters, YawTask


def kept(rover: Pendulum, seconds: float, task: YawTask) -> list[float]:
    """Run the controller; returns the twists [rad]."""
    pump, controller = (
        RotorPump(DampingParameters(), HANGING),
        YawMomentumController(YawParameters(), HANGING),
    )
    twists = []
    for _ in range(round(seconds / H)):
        swing = rover.estimate()
        largest = pump.largest_torque(swing, rover.length)
        torque = controller.step(swing, rover.yaw, rover.length, largest, H, task)
        momenta = pump.momenta(swing, rover.length, torque, damps=False)
        rover.step(0.0, complex(momenta.x, momenta.y))
        twists.append(rover.yaw)
    return twists


def whole(rover: Pendulum) -> float:
    return rover.momentum + HANGING.inertia_about_z * rover.yaw_rate


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("length", [7.5, 20.0])
def test_a_spinning_rover_is_stopped_by_its_swing(sign: float, length: float):
    rover = swinging(length, 0.6, 0.5)
    rover.yaw_rate = sign * math.radians(0.5)
    kept(rover, 200.0, YawTask.HOLD)
    assert abs(rover.yaw_rate) < math.radians(0.05)
    assert math.degrees(rover.amplitude) < 0.75


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_cone_s_momentum_leaves_through_the_twisted_tether(sign: float):
    rover = swinging(2.0, 3.0, sign * 1.5)
    rover.has_torsion = True
    controller = YawMomentumController(YawParameters(), HANGING)
    before = whole(rover)
    predicted = controller.predict_transfer(rover.estimate(), 0.0, 2.0).time
    twists = kept(rover, predicted, YawTask.TRANSFER)
    assert abs(whole(rover)) < 0.05 * abs(before)
    # It turned with the cone, within the bound, and back.
    bound = controller.twist_bound(2.0)
    assert 0.5 * bound < max(sign * each for each in twists) < 1.2 * bound
    assert abs(twists[-1]) < 0.15 * bound
    assert abs(rover.yaw_rate) < 0.05


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_twist_is_unwound_without_overshoot(sign: float):
    # A small swing must stop the spin from unwinding.
    rover = swinging(2.0, 1.2, sign * 0.8)
    rover.has_torsion, rover.yaw, rover.yaw_rate = True, sign * 1.5, sign * -0.07
    twists = [sign * each for each in kept(rover, 60.0, YawTask.UNWIND)]
    assert min(twists) > -0.1
    assert twists[-1] < 0.15


def test_a_relaxing_tether_has_three_equal_poles():
    # With f the torsional frequency, twist, yaw rate and momentum have the poles -f: from rest
    # twist/twist_0 = e^(-ft) (1 + ft - f^2 t^2).
    length, frequency = 2.0, HANGING.torsional_frequency(2.0)
    torsion, inertia = HANGING.torsional_stiffness(length), HANGING.inertia_about_z
    controller = YawMomentumController(YawParameters(), HANGING)
    swing = swinging(length, 0.1).estimate()
    lever = HANGING.pendulum_inertia(length) * swing.direction[0]
    twist, rate, taken = 1.0, 0.0, 0.0  # the last by the rotors from the swing [N m s]
    for k in range(round(6.0 / (frequency * H))):
        phase = frequency * k * H
        expected = math.exp(-phase) * (1.0 + phase - phase * phase)
        assert twist == pytest.approx(expected, abs=0.02)
        swing = swing._replace(yaw_rate=rate, direction_rate=(0.0, -taken / lever))
        torque = controller.step(swing, twist, length, 1.0, H, YawTask.RELAX)
        taken += H * torque
        rate += H * (torque - torsion * twist) / inertia
        twist += H * rate


@pytest.mark.parametrize("turns", [1.0, -2.5])
def test_a_wound_tether_relaxes_without_a_rest(turns: float):
    rover = swinging(2.0, 0.6, 0.1)
    rover.has_torsion, rover.yaw = True, math.tau * turns
    largest = abs(rover.yaw) * HANGING.inertia_about_z * HANGING.torsional_frequency(2.0)
    kept(rover, 450.0, YawTask.RELAX)
    assert abs(rover.yaw) < 0.4
    assert abs(rover.yaw_rate) < 0.02
    # The rover left to itself would turn to and fro with the momentum `largest`.
    assert abs(whole(rover)) < 0.15 * largest


def test_the_momentum_is_filtered_from_a_noisy_estimate():
    rover = swinging(2.0, 1.0, 0.8)
    rover.has_torsion, rover.yaw = True, 3.0
    controller = YawMomentumController(YawParameters(), HANGING)
    errors, noisy = [], []
    for k in range(round(60.0 / H)):
        swing = rover.estimate()
        off = 0.15 * math.sin(1.7 * k * H)  # of the swing, as the tilt's trace in it
        x, y = swing.direction
        swing = swing._replace(direction=(x * (1.0 + off), y * (1.0 + off)))
        controller.step(swing, rover.yaw, 2.0, 0.0, H, YawTask.TRANSFER)
        rover.step()
        if k * H > 20.0:
            errors.append(
                abs(controller.predict_transfer(swing, rover.yaw, 2.0).momentum - whole(rover))
            )
            noisy.append(abs(controller.observer.measured(swing, 2.0) - whole(rover)))
    assert max(errors) < 0.3 * max(noisy)
    # After a disturbance it restarts.
    pushed = swinging(2.0, 2.0, -1.9)
    controller.observer.restart()
    controller.step(pushed.estimate(), 0.0, 2.0, 0.0, H, YawTask.TRANSFER)
    followed = controller.predict_transfer(pushed.estimate(), 0.0, 2.0).momentum
    assert followed == pytest.approx(pushed.momentum, rel=0.01)


def test_a_tether_without_torsion_transfers_nothing():
    rover = swinging(2.0, 3.0, 1.5)
    loose = HangingParameters(twist_stiffness=0.0)
    controller = YawMomentumController(YawParameters(), loose)
    assert controller.predict_transfer(rover.estimate(), 0.0, 2.0).time == math.inf
    assert controller.twist_bound(2.0) == 0.0
    # The controller then only stops the yaw.
    rover.yaw_rate = 0.01
    assert controller.step(rover.estimate(), 0.0, 2.0, 1e-3, 10.0, YawTask.TRANSFER) < 0.0


def test_the_swivel_friction_bounds_the_twist():
    slippery = HangingParameters(swivel_friction=1.0e-4)
    controller = YawMomentumController(YawParameters(), slippery)
    share = YawParameters().swivel_friction_fraction
    assert controller.twist_bound(2.0) * slippery.torsional_stiffness(2.0) == pytest.approx(
        share * 1.0e-4
    )
