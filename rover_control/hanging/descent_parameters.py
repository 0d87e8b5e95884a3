"""Parameters of the descent and of its profile. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from msg_schemas import machine
from msg_schemas.parameters import ParameterError, parameter


@dataclass(frozen=True)
class ProfileParameters:
    """Rates, limits and timeouts of a descent."""

    travel_rate: float = parameter(0.3, "m/s", "largest payout rate", 0.01, machine.MAX_PAYOUT_RATE)
    ascent_rate_gain: float = parameter(
        0.02, "1/s", "largest rate of a swinging rover's ascent over its length", 1e-4, 1.0
    )
    min_ascent_rate: float = parameter(
        0.02, "m/s", "lower bound of that rate", 1e-3, machine.MAX_PAYOUT_RATE
    )
    depth_tolerance: float = parameter(
        0.01, "m", "depth error within which a stop is reached", 1e-3, 1.0
    )
    steady_rate: float = parameter(
        0.00175, "rad/s", "camera rate below which the rover is steady, 0.10 deg/s", 1e-5, 0.1
    )
    steady_dwell: float = parameter(
        3.0, "s", "time for which it must be steady before the first picture", 0.1, 60.0
    )
    damped_swing_rate: float = parameter(
        0.0014, "rad/s", "swing rate at which damping ends, 0.08 deg/s", 1e-5, 0.1
    )
    stop_timeout: float = parameter(600.0, "s", "longest time at a stop", 1.0, 1e4)
    settling_timeout: float = parameter(
        25.0, "s", "time to become steady before the swing is damped again", 1.0, 600.0
    )
    settling_attempts: int = parameter(4, "-", "settling attempts per stop", 1, 100)
    quick_damping_time: float = parameter(
        60.0, "s", "decay time up to which a swing is damped even if the next stop gains nothing",
        1.0, 1e4,
    )  # fmt: skip
    transfer_threshold_rate: float = parameter(
        0.0011,
        "rad/s",
        "cone rate at the next stop above which its momentum is transferred, 0.06 deg/s",
        1e-5,
        0.1,
    )
    transfer_swing: float = parameter(
        0.009, "rad", "plane swing that is kept during a momentum transfer", 0.0, 0.1
    )
    max_transfer_time: float = parameter(
        400.0, "s", "longest predicted momentum transfer", 0.0, 1e4
    )
    transfer_relaxation_time: float = parameter(
        200.0,
        "s",
        "duration of a transfer after which its threshold rises linearly",
        1.0,
        1e4,
    )
    unwound_acceleration: float = parameter(
        5.0e-5,
        "rad/s^2",
        "yaw acceleration from twist below which the tether is unwound",
        1e-6,
        0.1,
    )
    unwound_yaw_rate: float = parameter(
        0.0025, "rad/s", "yaw rate below which the tether is unwound, 0.14 deg/s", 1e-5, 0.1
    )
    exposures: int = parameter(3, "-", "pictures per stop", 1, 1000)
    exposure_interval: float = parameter(0.5, "s", "time between two pictures", 0.05, 60.0)
    largest_swing: float = parameter(
        0.0175, "rad", "largest predicted swing amplitude of a travel, 1 deg", 1e-3, 0.5
    )
    damped_yaw_rate: float = parameter(
        0.0007, "rad/s", "yaw rate at which damping ends, 0.04 deg/s", 1e-5, 0.1
    )
    swing_error_limit: float = parameter(
        2.5e-4,
        "rad/s",
        "standard deviation of the swing rate below which the swing is known",
        1e-6,
        0.1,
    )
    estimator_settling_time: float = parameter(
        8.0, "s", "settling time of the swing estimate before the first action", 0.1, 300
    )
    wall_clearance: float = parameter(
        3.0, "m", "distance from the plumb line to the wall", 0.1, 1e3
    )
    rover_reach: float = parameter(0.4, "m", "extent of the rover from the plumb line", 0.0, 10.0)


@dataclass(frozen=True)
class DescentParameters:
    """Limits of stops, timeouts of sensors and camera."""

    min_depth: float = parameter(1.6, "m", "least depth of a stop, as length at the drum", 0.1, 1e3)
    max_depth: float = parameter(
        48.0, "m", "largest depth of a stop: depth of the floor less the rover's height", 0.1, 1e3
    )
    sensor_timeout_steps: int = parameter(
        25,
        "-",
        "consecutive steps without a fresh sensor reading after which the sensor is lost",
        1,
        10000,
    )
    max_gyro_delay: float = parameter(
        0.1,
        "s",
        "largest delay from the gyro's sample to a step; a later one does not drive the rotors",
        0.02,
        5.0,
    )
    gyro_delay_recovery: float = parameter(
        2.0, "s", "time without such a delay before the rotors follow again", 0.0, 60.0
    )
    screw_lead: float = parameter(
        2.0e-3, "m", "lead of the jump motor's screw, per turn", 1e-4, 0.1
    )
    nut_unloaded_position: float = parameter(
        2.0e-3,
        "m",
        "largest nut position at which it bears no spring and may be driven clear",
        0.0,
        0.1,
    )
    nut_speed: float = parameter(0.01, "m/s", "speed at which the nut is driven clear", 1e-3, 0.5)
    nut_timeout: float = parameter(20.0, "s", "time within which the nut must be clear", 1.0, 600.0)
    exposure_latency: float = parameter(
        0.1, "s", "time from the command of a picture to the end of its exposure", 0.0, 10.0
    )
    camera_timeout: float = parameter(
        1.0,
        "s",
        "longest wait for the camera's report before a picture is published without it",
        0.0,
        60.0,
    )

    def __post_init__(self) -> None:
        """Refuse limits that leave no range.

        Raises:
            ParameterError: min_depth is not below max_depth.
        """
        if self.min_depth >= self.max_depth:
            msg = f"min_depth is {self.min_depth:g} m, it must be less than max_depth, "
            raise ParameterError(msg + f"{self.max_depth:g} m")
