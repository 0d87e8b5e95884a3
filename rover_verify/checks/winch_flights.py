"""The armed winch on the hanging rover: the shipped winch_node with the simulator."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from msg_schemas import topics
from msg_schemas.phases import WinchMode
from rover_launch.loop import Parameters
from rover_verify.checks.winch_record import TICK
from rover_verify.harness.flight import WINCH, Flight

SCENARIO = "free_hang"
WEIGHT = 16.2  # of the default rover on the Moon [N]
ATTACHMENT = 0.44  # from the tether's attachment down to the wheels of a standing rover [m]


def sensor_errors(cell_noise: float = 0.1, rate_noise: float = 0.002) -> dict[str, object]:
    """Overrides of the scenario's sensors, beside their shipped biases.

    Args:
        cell_noise: standard deviation of a reading of the load cell [N].
        rate_noise: standard deviation of a reading of the payout rate [m/s], which is the
            difference of two readings of the encoder.
    """
    return {
        "sensors.fairlead_load_cell.noise_density": cell_noise * math.sqrt(TICK),
        "sensors.drum_encoder.noise_density": rate_noise * TICK * math.sqrt(0.5 * TICK),
    }


def on_floor(depth: float) -> dict[str, object]:
    """Overrides for a bare floor of rock, which a rover reaches on so much tether [m]."""
    return {"environment.floor": {"height": -(depth + ATTACHMENT), "material": "rock"}}


def fly_winch(
    overrides: Mapping[str, object],
    seed: int,
    *,
    controllers: Sequence[str] = WINCH,
    parameters: Parameters | None = None,
) -> Flight:
    """Start a flight with an armed winch, which has been at rest for half a second.

    Args:
        overrides: of the scenario by dotted path.
        seed: of the sensors' errors.
        controllers: executables.
        parameters: of the nodes, where they differ from the shipped ones.
    """
    flight = Flight(
        controllers,
        SCENARIO,
        {**sensor_errors(), **overrides},
        seed=seed,
        parameters=parameters,
        defaults={},
    )
    flight.run(0.1)
    arm(flight)
    flight.run(0.5)
    return flight


def arm(flight: Flight) -> bool:
    """Arm the winch; whether it is armed."""
    return bool(flight.call(topics.WINCH_REARM).success)


def request(
    flight: Flight, joint: str, position: float, velocity: float = 0.0, effort: float = 0.0
) -> None:
    """Request a motion, and let the request arrive."""
    flight.request(topics.WINCH_REQUEST, joint, position, velocity, effort)
    flight.run(3.0 * TICK)


def is_at_rest(flight: Flight) -> bool:
    """Whether the winch has come to rest at its length."""
    winch = flight.winch
    return winch.mode is not WinchMode.LENGTH and winch.servo.is_at_rest


def slack(flight: Flight) -> float:
    """Length by which the tether is longer than the distance to the rover [m]."""
    return max(0.0, flight.state.length - chord(flight))


def chord(flight: Flight) -> float:
    """Distance from the fairlead to the tether's attachment [m]."""
    return math.hypot(*flight.state.nodes[-1, 0])
