"""Reaction of wheels and flywheel: signs, budgets, reports of saturation."""

from __future__ import annotations

import itertools
import math
from collections import deque

import pytest

from rover_control.hanging.attitude import (
    AxisControl,
    FlywheelReaction,
    RotorParameters,
    WheelReaction,
)
from rover_control.hanging.attitude_gains import AttitudeDesign, design_axis
from rover_control.hanging.hanging_rover import HangingParameters

HANGING, ROTORS, DESIGN = HangingParameters(), RotorParameters(), AttitudeDesign()
H = 0.02


def make_axis(budget: float = 0.02) -> AxisControl:
    return AxisControl("axis", design_axis(0.18, 3.29, DESIGN), budget)


def test_momentum_follows_the_tilt_and_desaturates():
    axis = make_axis()
    axis.step(0.01, H)
    gained = axis.momentum
    assert gained == pytest.approx(axis.gains.rate * 0.01 * H)
    for _ in range(round(DESIGN.desaturation_time / H)):
        axis.step(0.0, H)
    assert axis.momentum == pytest.approx(gained / math.e, rel=0.01)


def test_saturation_is_reported_before_the_budget_is_spent():
    axis = make_axis()
    reported_at = None
    for _ in range(2000):
        axis.step(0.01, H)
        assert abs(axis.momentum) <= axis.budget
        if axis.saturation and reported_at is None:
            reported_at = axis.momentum
    assert reported_at is not None
    assert reported_at < axis.budget
    assert "cannot hold" in axis.saturation
    assert f"of {axis.budget:g} N m s" in axis.saturation
    for _ in range(2000):
        axis.step(0.0, H)
    assert not axis.saturation


def test_a_repeated_saturation_is_reported_once():
    axis = make_axis()
    reports: list[bool] = []
    for step in range(3000):
        # An undamped tilt oscillation, until it ends.
        axis.step(0.2 * math.cos(4.0 * step * H) if step < 2000 else 0.0, H)
        if not reports or bool(axis.saturation) is not reports[-1]:
            reports.append(bool(axis.saturation))
    assert reports == [False, True, False]


def flown(tilt_rate: float, delay_steps: int = 0) -> tuple[float, float]:
    """Tilts along x and y after 4 s of both control loops on linear plants, from a rate.

    Samples and commands of the flywheel travel for some steps.
    """
    wheels, flywheel = (
        WheelReaction(HANGING, ROTORS, DESIGN),
        FlywheelReaction(HANGING, ROTORS, DESIGN),
    )
    for _ in range(400):  # to its bias
        wheels.step(0.0, 0.0, H, pumps=True)
    x = y = 0.0
    vx = vy = tilt_rate
    wheel = wheels.step(0.0, 0.0, H, pumps=True)
    angle, rate = ROTORS.screw_travel_centre, 0.0
    age = delay_steps * H
    read = deque([(angle, rate)] * (delay_steps + 1), maxlen=delay_steps + 1)
    sent = deque([0.0] * (delay_steps + 1), maxlen=delay_steps + 1)
    swept = [0.0, 0.0]
    for k in range(round(4.0 / H)):
        after = wheels.step(vx, 0.0, H, pumps=True)
        sent.append(flywheel.step(vy, 0.0, 0.0, *read[0], age, H, quiet=False))
        # Rotors react about +y, which displaces toward -x, and about +x, toward +y.
        wheel_torque = HANGING.wheel_inertia * (after - wheel) / H
        wheel = after
        friction = ROTORS.flywheel_friction * math.tanh(10.0 * rate)
        turning = (sent[0] - friction) / HANGING.flywheel_inertia
        rate += H * turning
        angle += H * rate
        read.append((angle, rate))
        vx += H * (-HANGING.stiffness * x + wheel_torque) / HANGING.inertia_about_y
        vy += (
            H
            * (-HANGING.stiffness * y - HANGING.flywheel_inertia * turning)
            / (HANGING.inertia_about_x)
        )
        x, y = x + H * vx, y + H * vy
        if k > 150:
            swept = [max(swept[0], abs(x)), max(swept[1], abs(y))]
    return swept[0], swept[1]


def test_both_reactions_damp_their_tilts():
    start = math.radians(4.0)  # 4 deg/s swing by 1 deg
    along_x, along_y = flown(start)
    assert along_x < math.radians(0.1)
    assert along_y < math.radians(0.1)


def test_the_flywheel_damps_its_tilt_with_late_samples_and_commands():
    _, along_y = flown(math.radians(4.0), delay_steps=round(0.06 / H))
    assert along_y < math.radians(0.1)


def test_the_left_wheel_never_drives_the_right_one():
    wheels = WheelReaction(HANGING, ROTORS, DESIGN)
    for k in range(4000):
        rate = wheels.step(0.2 * math.sin(0.1 * k), 0.02, H, pumps=k < 2000)
        assert rate <= 0.0
    assert wheels.is_quiet


def test_a_turning_wheel_ramps_to_its_bias():
    wheels = WheelReaction(HANGING, ROTORS, DESIGN)
    wheels.start_from(ROTORS.wheel_pump_bias)
    rates = [ROTORS.wheel_pump_bias, *(wheels.step(0.0, 0.0, H, pumps=False) for _ in range(1000))]
    steps = [after - before for before, after in itertools.pairwise(rates)]
    assert max(map(abs, steps)) <= ROTORS.wheel_acceleration * H * (1.0 + 1e-9)
    assert wheels.is_quiet
    # A wheel that turned forward is not driven forward.
    wheels.start_from(3.0)
    assert wheels.step(0.0, 0.0, H, pumps=False) <= 0.0


def test_the_flywheel_returns_the_nut_and_keeps_within_its_travel():
    flywheel = FlywheelReaction(HANGING, ROTORS, DESIGN)
    centre, travel = ROTORS.screw_travel_centre, ROTORS.screw_travel
    assert flywheel.step(0.0, 0.0, 0.0, centre + 0.5 * travel, 0.0, 0.0, H, quiet=False) < 0.0
    other = FlywheelReaction(HANGING, ROTORS, DESIGN)
    assert other.step(0.0, 0.0, 0.0, centre - 0.5 * travel, 0.0, 0.0, H, quiet=False) > 0.0
    # Beyond its travel no setpoint leads farther out.
    assert flywheel.step(0.05, 0.0, 0.0, centre + 1.01 * travel, 0.0, 0.0, H, quiet=False) < (
        ROTORS.flywheel_friction + 0.05 * flywheel.axis.gains.rate
    )
    assert "travel" in flywheel.axis.saturation


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_nut_that_moves_toward_an_end_is_braked_smoothly(sign: float):
    flywheel = FlywheelReaction(HANGING, ROTORS, DESIGN)
    inertia = HANGING.flywheel_inertia
    angle = rate = 0.0
    hardest = 0.0
    for k in range(round(20.0 / H)):
        # The pump commands it onward after it has reached its rate.
        pumped = sign * inertia * min(40.0, 40.0 * k * H)
        torque = flywheel.step(
            0.0, pumped, 0.0, ROTORS.screw_travel_centre + angle, rate, 0.0, H, quiet=False
        )
        friction = ROTORS.flywheel_friction * math.tanh(10.0 * rate)
        change = (torque - friction) / inertia
        rate += H * change
        angle += H * rate
        if k * H > 1.0:
            hardest = max(hardest, abs(change) * inertia)
    assert 0.7 * ROTORS.screw_travel < sign * angle < ROTORS.screw_travel
    # Its reaction tilts the rover by less than a degree.
    assert hardest / HANGING.stiffness < math.radians(1.0)


def test_friction_is_compensated_in_the_direction_of_motion():
    flywheel = FlywheelReaction(HANGING, ROTORS, DESIGN)
    flywheel.axis.momentum = 0.02  # 20 rad/s
    for _ in range(2):
        centre = ROTORS.screw_travel_centre
        torque = flywheel.step(0.0, 0.0, 0.0, centre, 20.0, 0.0, H, quiet=False)
    assert torque == pytest.approx(ROTORS.flywheel_friction, abs=3e-3)
