"""A wheel that joins its setpoint, without the descent around it."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from rover_control.hanging.descent_settings import DescentSettings
from rover_control.hanging.hanging_controller import NO_COMMANDS, ActuatorCommands
from rover_control.hanging.rotor_supervisor import RotorSupervisor

H = 0.02  # period of the controller [s]
BIAS, AMPLITUDE, FREQUENCY = -13.0, 11.0, 3.3  # of a coning wheel [rad/s]


def coning(time: float) -> float:
    """Setpoint whose bias ramps as the controller's does, and whose amplitude ramps with it."""
    share = min(time / 4.0, 1.0)
    return share * (BIAS + AMPLITUDE * math.cos(FREQUENCY * time))


def followed(phase: float, duration: float) -> list[tuple[float, float]]:
    """Setpoints and commands of a wheel that coasts, and then cones from a phase [s] on."""
    supervisor, commands = RotorSupervisor(DescentSettings(), []), []
    supervisor.step(NO_COMMANDS, H, 0.0)
    for tick in range(round(duration / H)):
        setpoint = coning(phase + tick * H)
        given = ActuatorCommands(setpoint, 0.0, None, None, None)
        rate, _ = supervisor.step(given, H, 0.0)
        assert rate is not None
        commands.append((setpoint, rate))
    return commands


@pytest.mark.parametrize("phase", [0.0, 0.5, 1.0, 4.0, 4.5, 5.2])
def test_a_wheel_joins_a_setpoint_that_swings_faster_than_its_ramp(phase: float):
    slowest = DescentSettings().hanging_controller.rotors.wheel_acceleration
    followed_for = abs(BIAS) + AMPLITUDE
    commands = followed(phase, followed_for / slowest + 2.0)
    assert abs(commands[0][1]) <= slowest * H + 1e-12  # from rest
    late = commands[round(followed_for / slowest / H) + 1 :]
    assert len(late) > 50
    assert all(rate == setpoint for setpoint, rate in late)


@pytest.mark.parametrize("phase", [0.0, 0.5, 1.0, 4.0, 4.5, 5.2])
def test_a_wheel_that_joins_is_neither_stepped_nor_driven_forward(phase: float):
    rotors = DescentSettings().hanging_controller.rotors
    commands = followed(phase, 12.0)
    swings = AMPLITUDE * FREQUENCY + (abs(BIAS) + AMPLITUDE) / 4.0
    allowed = (swings + rotors.wheel_acceleration) * H
    assert max(rate for _, rate in commands) <= 0.0
    assert all(abs(b - a) <= allowed for (_, a), (_, b) in pairwise(commands))
