"""The servo of the winch alone, on a drum that pulls at an elastic tether."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tether_winch.drum_model import DrumModel, DrumModelParameters
from tether_winch.servo import (
    BrakePhase,
    GoalKind,
    SensedState,
    ServoGoal,
    ServoParameters,
    WinchServo,
)

H, SUBSTEPS = 0.01, 10  # step of the servo [s]; steps of the drum in it
SETPOINT, EXCESS = 1.5, 1.0  # [N]; of the tension at first
LATE = 2  # steps from a reading to the torque that it causes


def held_tension(length: float, damping_ratio: float, duration: float) -> np.ndarray:
    """Tension [N] of a tether to a fixed point, from the instant at which the brake is open.

    Gear and drum are without friction, so that nothing but the servo damps the drum.

    Args:
        length: of the tether [m].
        damping_ratio: of the tension hold.
        duration: [s].
    """
    drum = DrumModel(
        DrumModelParameters(
            gear_efficiency=1.0, gear_backdrive_efficiency=1.0, drum_friction=0.0, drum_viscous=0.0
        )
    )
    servo = WinchServo(ServoParameters(tension_damping_ratio=damping_ratio), drum)
    servo.set_goal(ServoGoal(GoalKind.TENSION, rate=0.3, tension=SETPOINT, limit=40.0))
    stiffness, mass = drum.stiffness(length), drum.mass(length)
    offset, rate, is_open = 0.0, 0.0, False
    held: list[float] = []
    readings = [SETPOINT + EXCESS] * LATE
    while len(held) < duration / H:
        readings.append(SETPOINT + EXCESS - stiffness * offset)
        tension = readings[-1 - LATE]
        state = SensedState(length + offset, rate, tension, tension, tension, is_open)
        command = servo.step(state, math.inf, H)
        is_open = command.release_brake
        if servo.phase is not BrakePhase.OPEN:
            continue
        held.append(readings[-1])
        for _ in range(SUBSTEPS):
            h = H / SUBSTEPS
            rate += (SETPOINT + EXCESS - stiffness * offset - command.limit) / mass * h
            offset += rate * h
    return np.array(held)


@pytest.mark.parametrize("length", [25.0, 45.0, 57.0])
def test_a_tension_hold_damps_the_drum_on_the_tethers_stiffness(length: float):
    servo, drum = ServoParameters(), DrumModel(DrumModelParameters())
    stiffness = (1.0 + servo.tension_gain) * drum.stiffness(length)
    period = math.tau / math.sqrt(stiffness / drum.mass(length))
    damped, undamped = (
        np.abs(held_tension(length, ratio, 6.0 * period) - SETPOINT)[round(3.0 * period / H) :]
        for ratio in (servo.tension_damping_ratio, 0.0)
    )
    assert damped.max() < 0.1 * EXCESS
    assert undamped.max() > 0.9 * EXCESS
