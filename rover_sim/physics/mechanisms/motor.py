"""Electric motor with its drive: torque and speed limits, current, and a rate servo."""

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from msg_schemas.configuration import Configuration, quantity
from rover_sim.physics.numerics.compiled import checked_inner
from rover_sim.physics.numerics.named_parameters import from_parameters


class MotorMode(IntEnum):
    """Control mode of the motor's drive."""

    OFF = 0  # no current, the rotor turns freely
    TORQUE = 1  # commanded torque, within the limits
    RATE = 2  # rate servo; the commanded torque is the feed-forward
    POSITION = 3  # moves to a position, limited to the commanded rate (jump drive only)


# Plain integers for compiled functions.
OFF, TORQUE, RATE, POSITION = (int(mode) for mode in MotorMode)


@dataclass(frozen=True)
class MotorParameters(Configuration):
    """A brushless motor with a current-limited drive; all values at the motor's own shaft."""

    max_torque: float = quantity("N m", "torque at the drive's current limit", above=0.0)
    stall_torque: float = quantity("N m", "at the bus voltage, without current limit", above=0.0)
    no_load_rate: float = quantity("rad/s", "no-load speed at the bus voltage", above=0.0)
    torque_constant: float = quantity("N m/A", "torque per current", above=0.0)
    servo_bandwidth: float = quantity(  # choose it far below 2/h
        "rad/s", "bandwidth of the rate loop", above=0.0, maximum=500.0
    )


class Motor(NamedTuple):
    """`MotorParameters` for compiled functions."""

    max_torque: float
    stall_torque: float
    no_load_rate: float
    torque_constant: float
    servo_bandwidth: float


def make_motor(parameters: MotorParameters) -> Motor:
    """Convert the parameters for compiled functions."""
    return from_parameters(Motor, parameters)


@checked_inner
def limited_torque(motor: Motor, requested: float, rate: float, limit: float) -> float:
    """Torque [N m] of the motor at a rate for a requested torque.

    When driving, back-EMF limits it to stall_torque (1 - |rate|/no_load_rate); when braking, only
    the current limit applies. `limit` is a further bound on the magnitude. A requested NaN gives
    zero torque.
    """
    bound = min(motor.max_torque, limit)
    if requested * rate > 0.0:
        bound = min(bound, motor.stall_torque * (1.0 - abs(rate) / motor.no_load_rate))
    bound = max(bound, 0.0)
    if requested > bound:
        return bound
    if requested < -bound:
        return -bound
    if requested == requested:  # noqa: PLR0124 - false for NaN alone
        return requested
    return 0.0


@checked_inner
def rate_servo(
    motor: Motor,
    inertia: float,
    rate_setpoint: float,
    rate: float,
    feed_forward: float,
    limit: float,
    integral: float,
    h: float,
) -> tuple[float, float]:
    """Torque [N m] of the PI rate loop and its new integral [N m].

    With bandwidth b and inertia J at the motor the gains are J b and J b^2/4, so that the loop is
    critically damped on the bare inertia. While the torque is at its limit, the integral only
    changes towards the inside of the limit (anti-windup).
    """
    error = rate_setpoint - rate
    gain = inertia * motor.servo_bandwidth
    requested = feed_forward + gain * error + integral
    torque = limited_torque(motor, requested, rate, limit)
    if (requested - torque) * error <= 0.0:
        integral += 0.25 * gain * motor.servo_bandwidth * error * h
    return torque, integral


@checked_inner
def motor_torque(
    motor: Motor,
    mode: int,
    inertia: float,
    rate_setpoint: float,
    rate: float,
    torque: float,
    limit: float,
    integral: float,
    h: float,
) -> tuple[float, float]:
    """Torque [N m] of the motor in a mode, OFF, TORQUE or RATE, and the rate servo's new integral.

    The torque is the command with TORQUE and the feed-forward with RATE; see `rate_servo`.
    """
    if mode == TORQUE:
        return limited_torque(motor, torque, rate, limit), 0.0
    if mode == RATE:
        return rate_servo(motor, inertia, rate_setpoint, rate, torque, limit, integral, h)
    return 0.0, 0.0
