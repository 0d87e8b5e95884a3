"""Balance of a jump's flight by the wheels."""

from __future__ import annotations

import math

import pytest

from msg_schemas import machine, topics
from msg_schemas.events import JumpEvent, PlantEvent
from msg_schemas.phases import DrivePhase
from rover_control.drive.flight_balance import FlightBalance, FlightBalanceParameters
from rover_verify.checks.floor import Stand, start_on_floor
from rover_verify.harness.flight import JUMP, Flight

P = FlightBalanceParameters()
STEP = 0.02  # [s]
SPIN = P.flight_wheel_inertia * P.flight_wheel_rate  # largest momentum of the wheels [N m s]


def flown(pitch_rate: float, duration: float, delay: int = 3) -> tuple[float, float]:
    """Pitch rate [rad/s] and pitch [rad] after a flight; the wheels follow with a delay in steps.

    The momentum about y is constant.
    """
    balance = FlightBalance(P)
    balance.stance = 0.1
    pitch, wheel, commands = 0.1, 0.0, [0.0] * delay
    momentum = P.flight_pitch_inertia * pitch_rate
    for _ in range(round(duration / STEP)):
        pitch_rate = (momentum - P.flight_wheel_inertia * wheel) / P.flight_pitch_inertia
        pitch += STEP * pitch_rate
        commands.append(balance.wheel_rate(pitch, pitch_rate, wheel))
        wheel += 0.5 * (commands[-1 - delay] - wheel)
    return pitch_rate, pitch


@pytest.mark.parametrize("pitch_rate", [0.1, 0.35, 0.55])
def test_the_wheels_stop_the_turn_and_bring_the_pitch_back(pitch_rate: float):
    assert P.flight_pitch_inertia * pitch_rate < SPIN
    rate, pitch = flown(pitch_rate, 4.0)
    assert rate == pytest.approx(0.0, abs=0.05)
    assert pitch == pytest.approx(0.1, abs=0.05)


def test_a_fast_turn_loses_what_the_wheels_can_hold():
    rate, _ = flown(2.0, 1.0)
    assert rate == pytest.approx(2.0 - SPIN / P.flight_pitch_inertia, rel=1e-6)


def test_the_wheels_turn_forward_only():
    assert FlightBalance(P).wheel_rate(0.0, -0.3, 0.0) == 0.0
    assert flown(-0.3, 1.0)[0] == pytest.approx(-0.3)


def jumped(**parameters: float) -> tuple[Flight, float]:
    """A jump of 0.2 m on a level floor, and the pitch [rad] at its first touchdown."""
    flight = start_on_floor(JUMP, Stand().overrides(), 5, {"drive_node": parameters})
    flight.run(2.0)
    pitches: list[float] = []

    def is_over() -> bool:
        if len(pitches) < len(flight.events_named(PlantEvent.TOUCHDOWN)):
            pitches.append(-math.asin(flight.state.rotation[2, 0]))
        return bool(flight.events_named(JumpEvent.STANDBY))

    flight.request(topics.JUMP_REQUEST, machine.JUMP_HEIGHT, 0.2)
    assert flight.run(40.0, is_over)
    return flight, pitches[0]


def test_a_jump_lands_in_the_attitude_of_its_stance():
    flight, pitch = jumped()
    assert math.degrees(pitch) == pytest.approx(2.0, abs=3.0)
    flight.run(1.0)
    assert flight.phases[topics.DRIVE_PHASE] == DrivePhase.RELEASED


def test_without_the_balance_the_nose_turns_down():
    assert math.degrees(jumped(flight_wheel_rate=0.0)[1]) > 12.0


def test_the_phase_announces_the_use_of_the_wheels():
    flight = start_on_floor(JUMP, Stand().overrides(), 5)
    flight.run(2.0)
    phases, commands = [], []
    flight.host.exchange.listen(
        lambda _n, sample, *_: phases.append(sample.text), topics.DRIVE_PHASE
    )
    flight.host.exchange.listen(lambda *_: commands.append(flight.time), topics.WHEEL_COMMAND)
    flight.request(topics.JUMP_REQUEST, machine.JUMP_HEIGHT, 0.1)
    flight.run(2.0)
    assert phases == [DrivePhase.BALANCING]
    assert commands
    flight.call(topics.JUMP_ABORT)
    assert flight.run(10.0, lambda: bool(flight.events_named(JumpEvent.STANDBY)))
    flight.run(0.1)
    last = len(commands)
    flight.run(1.0)
    assert phases == [DrivePhase.BALANCING, DrivePhase.RELEASED]
    assert len(commands) == last
