"""Balance of the rover in a flight: the wheels as a reaction wheel. Pure.

The soil below tail and wheels yields unequally when the latch trips, so a jump leaves the ground
with the nose turning down. In flight no torque acts about base_link y, the axle's direction: with
pitch rate q', wheel rate w, the rover's moment of inertia I and that of the spinning wheels J,
I q' + J w is constant. Wheels that spin up forward stop the turn and bring the pitch back to that
of the stance, in which the rover lands on wheels and tail together; on the ground they brake. The
wheels can only turn forward (module `ratchet_kinematics`): they balance a nose that turns down.
"""

from __future__ import annotations

from dataclasses import dataclass

from msg_schemas.parameters import parameter


@dataclass(frozen=True)
class FlightBalanceParameters:
    """Balance of the pitch in a flight by the wheels."""

    flight_pitch_inertia: float = parameter(
        0.17, "kg m^2", "moment of inertia of the flying rover about y", 1e-3, 1e3
    )
    flight_wheel_inertia: float = parameter(
        0.012, "kg m^2", "moment of inertia of both wheels about the axle", 1e-5, 10.0
    )
    flight_pitch_gain: float = parameter(
        1.0, "1/s", "pitch rate per pitch beyond that of the stance", 0.0, 10.0
    )
    flight_wheel_rate: float = parameter(
        9.0, "rad/s", "largest wheel rate in a flight; 0: the wheels do not balance", 0.0, 50.0
    )


class FlightBalance:
    """Wheel rates of a jump.

    Args:
        parameters: inertias, gain and limit.
    """

    def __init__(self, parameters: FlightBalanceParameters) -> None:
        self.parameters = parameters
        self.stance = 0.0
        """Pitch before the jump, nose down positive [rad]."""

    def wheel_rate(self, pitch: float, pitch_rate: float, wheel_rate: float) -> float:
        """Wheel rate to command in flight [rad/s], positive forward.

        Args:
            pitch: nose down positive [rad].
            pitch_rate: about base_link y [rad/s].
            wheel_rate: measured, positive forward [rad/s].
        """
        p = self.parameters
        excess = pitch_rate + p.flight_pitch_gain * (pitch - self.stance)
        balancing = wheel_rate + p.flight_pitch_inertia / p.flight_wheel_inertia * excess
        return min(max(balancing, 0.0), p.flight_wheel_rate)
