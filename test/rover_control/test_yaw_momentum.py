"""Spin stopped by the swing, and a cone's momentum handed to the mother through the tether."""

from __future__ import annotations

import math

import pytest
from rope_pendulum import HANGING, H, Pendulum, swinging

from rover_control.hanging_rover import HangingParameters
from rover_control.rotor_pump import RotorPump
from rover_control.swing_damping import DampingParameters
from rover_control.yaw_momentum import YawMomentumController, YawParameters


def kept(rover: Pendulum, seconds: float, *, transfers: bool, unwinds: bool = False) -> list[float]:
    """Go on; returns the twists [rad]."""
    pump, keeper = (
        RotorPump(DampingParameters(), HANGING),
        YawMomentumController(YawParameters(), HANGING),
    )
    twists = []
    for _ in range(round(seconds / H)):
        swing = rover.estimate()
        largest = pump.largest_torque(swing, rover.length)
        torque = keeper.step(
            swing, rover.yaw, rover.length, largest, H, transfers=transfers, unwinds=unwinds
        )
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
    kept(rover, 200.0, transfers=False)
    assert abs(rover.yaw_rate) < math.radians(0.05)
    assert math.degrees(rover.amplitude) < 0.75


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_cone_s_momentum_leaves_through_the_twisted_tether(sign: float):
    rover = swinging(2.0, 3.0, sign * 1.5)
    rover.has_torsion = True
    keeper = YawMomentumController(YawParameters(), HANGING)
    before = whole(rover)
    predicted = keeper.predict_transfer(rover.estimate(), 0.0, 2.0).time
    twists = kept(rover, predicted, transfers=True)
    assert abs(whole(rover)) < 0.05 * abs(before)
    # It was turned the way of the cone, within the bound, and back again.
    bound = keeper.twist_bound(2.0)
    assert 0.5 * bound < max(sign * each for each in twists) < 1.2 * bound
    assert abs(twists[-1]) < 0.15 * bound
    assert abs(rover.yaw_rate) < 0.05


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_twist_is_taken_out_and_not_wound_the_other_way(sign: float):
    # What spins it back must be stopped by a swing that then has little left to push against.
    rover = swinging(2.0, 1.2, sign * 0.8)
    rover.has_torsion, rover.yaw, rover.yaw_rate = True, sign * 1.5, sign * -0.07
    twists = [sign * each for each in kept(rover, 60.0, transfers=False, unwinds=True)]
    assert min(twists) > -0.1
    assert twists[-1] < 0.15


def test_the_momentum_is_followed_through_a_noisy_estimate():
    rover = swinging(2.0, 1.0, 0.8)
    rover.has_torsion, rover.yaw = True, 3.0
    keeper = YawMomentumController(YawParameters(), HANGING)
    told, noisy = [], []
    for k in range(round(60.0 / H)):
        swing = rover.estimate()
        off = 0.15 * math.sin(1.7 * k * H)  # of the swing, as the tilt's trace in it
        x, y = swing.direction
        swing = swing._replace(direction=(x * (1.0 + off), y * (1.0 + off)))
        keeper.step(swing, rover.yaw, 2.0, 0.0, H, transfers=True)
        rover.step()
        if k * H > 20.0:
            told.append(abs(keeper.predict_transfer(swing, rover.yaw, 2.0).momentum - whole(rover)))
            noisy.append(abs(keeper.momentum(swing, 2.0) - whole(rover)))
    assert max(told) < 0.3 * max(noisy)
    # After a push it is what it is then.
    pushed = swinging(2.0, 2.0, -1.9)
    keeper.restart()
    keeper.step(pushed.estimate(), 0.0, 2.0, 0.0, H, transfers=True)
    followed = keeper.predict_transfer(pushed.estimate(), 0.0, 2.0).momentum
    assert followed == pytest.approx(pushed.momentum, rel=0.01)


def test_a_rope_without_torsion_passes_nothing_on():
    rover = swinging(2.0, 3.0, 1.5)
    loose = HangingParameters(twist_stiffness=0.0)
    keeper = YawMomentumController(YawParameters(), loose)
    assert keeper.predict_transfer(rover.estimate(), 0.0, 2.0).time == math.inf
    assert keeper.twist_bound(2.0) == 0.0
    # It is then only kept from turning.
    rover.yaw_rate = 0.01
    assert keeper.step(rover.estimate(), 0.0, 2.0, 1e-3, 10.0, transfers=True) < 0.0


def test_a_swivel_that_slips_early_bounds_the_twist():
    slippery = HangingParameters(swivel_friction=1.0e-4)
    keeper = YawMomentumController(YawParameters(), slippery)
    share = YawParameters().swivel_friction_fraction
    assert keeper.twist_bound(2.0) * slippery.torsional_stiffness(2.0) == pytest.approx(
        share * 1.0e-4
    )
