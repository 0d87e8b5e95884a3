# ruff: noqa: RUF009 - the helpers that the fields call return dataclass fields
"""Sections of a scenario for its sensors: errors of each channel, position, camera."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

from msg_schemas import configuration
from msg_schemas.configuration import Configuration, choice, quantity
from rover_sim.physics.numerics.vectors import Vector

ErrorModel: TypeAlias = Literal["full", "ideal"]


@dataclass(frozen=True)
class SensorErrors(Configuration):
    """Errors of one measured quantity with the unit U."""

    scale: float = quantity("-", "reading over the true signal, before the bias", 1.0, above=0.0)
    noise_density: float = quantity("U/sqrt(Hz)", "density of the white noise", 0.0, minimum=0.0)
    bias: float = quantity("U", "standard deviation of the initial bias", 0.0, minimum=0.0)
    bias_random_walk: float = quantity(
        "U/sqrt(s)", "density of the bias's random walk", 0.0, minimum=0.0
    )
    range: float = quantity(
        "U", "largest magnitude, where the reading saturates", math.inf, above=0.0, infinite=True
    )
    resolution: float = quantity("U", "step of the readings, 0: none", 0.0, minimum=0.0)
    delay: float = quantity("s", "from truth to reading", 0.0, minimum=0.0, maximum=5.0)


@dataclass(frozen=True)
class CameraSettings(Configuration):
    """The wall camera, with a range finder along its optical axis."""

    position: Vector = quantity("m", "in base_link", (-0.16, 0.0, 0.05), length=3)
    axis: Vector = quantity("-", "optical axis in base_link", (-1.0, 0.0, 0.0), length=3)
    pixel_angle: float = quantity("rad", "angle of a pixel", 0.5e-3, above=0.0)
    exposure: float = quantity("s", "exposure time", 0.1, above=0.0, maximum=10.0)
    max_range: float = quantity("m", "range of the range finder", 60.0, above=0.0, maximum=500.0)
    range_finder: SensorErrors = configuration.section(
        SensorErrors, "wall distance [m]", SensorErrors(noise_density=5e-4, resolution=1e-3)
    )

    def check(self) -> None:
        """Refuse an axis of length 0."""
        if not any(self.axis):
            raise configuration.ConfigurationError(
                "axis", list(self.axis), "should not be the zero vector"
            )


# Our choice: a tactical MEMS IMU (0.05 deg/s and 0.01 m/s^2 a sample at 100 Hz), encoders of 4096
# counts at the motors, Hall current sensors, and strain-gauge load cells of 500 N.
_GYRO = SensorErrors(
    noise_density=8.7e-5, bias=1.7e-3, bias_random_walk=3e-6, range=8.7, resolution=0.0, delay=0.0
)
_ACCELEROMETER = SensorErrors(noise_density=1e-3, bias=0.01, bias_random_walk=1e-5, range=80.0)
_COUNT = 2.0 * math.pi / 4096.0
_CURRENT = SensorErrors(noise_density=1e-3, bias=5e-3, range=20.0)
_LOAD_CELL = SensorErrors(noise_density=5e-3, bias=0.05, bias_random_walk=5e-4, range=500.0)


@dataclass(frozen=True)
class SensorSettings(Configuration):
    """All sensors; `error_model: ideal` removes all errors."""

    error_model: ErrorModel = choice(
        get_args(ErrorModel), "full: with the errors below; ideal: without errors", "full"
    )
    seed: int = quantity("-", "of all errors", 0, kind=int, minimum=0, maximum=2**31 - 1)
    imu_position: Vector = quantity("m", "of the IMU in base_link", (0.05, 0.0, 0.0), length=3)
    gyro: SensorErrors = configuration.section(SensorErrors, "angular velocity [rad/s]", _GYRO)
    accelerometer: SensorErrors = configuration.section(
        SensorErrors, "specific force [m/s^2]", _ACCELEROMETER
    )
    flywheel_encoder: SensorErrors = configuration.section(
        SensorErrors, "angle of the jump motor's shaft [rad]", SensorErrors(resolution=_COUNT)
    )
    wheel_encoders: SensorErrors = configuration.section(
        SensorErrors, "angles of the wheels [rad]", SensorErrors(resolution=_COUNT / 4.0)
    )
    drum_encoder: SensorErrors = configuration.section(
        SensorErrors, "length paid out [m]", SensorErrors(resolution=2e-6)
    )
    currents: SensorErrors = configuration.section(
        SensorErrors, "currents of the motors [A]", _CURRENT
    )
    fairlead_load_cell: SensorErrors = configuration.section(
        SensorErrors, "tension at the fairlead [N]", _LOAD_CELL
    )
    rover_load_cell: SensorErrors = configuration.section(
        SensorErrors, "tension at the rover [N]", _LOAD_CELL
    )
    contact_threshold: float = quantity("N", "load that closes a contact switch", 0.5, above=0.0)
    camera: CameraSettings = configuration.section(
        CameraSettings, "the wall camera", CameraSettings()
    )
