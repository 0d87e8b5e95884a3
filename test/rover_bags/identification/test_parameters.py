"""Parameters that can be estimated, and their paths in scenarios."""

import math

import pytest

from rover_bags.identification.parameters import (
    PARAMETERS,
    IdentifyError,
    value_of,
    with_stiffness,
    with_values,
    without_errors,
)
from rover_sim import load_spatial


def test_values_are_set_in_the_scenario():
    base = with_stiffness(load_spatial("spatial_table1"))
    values = {name: 1.25 * (value_of(base, name) or math.nan) for name in PARAMETERS
              if value_of(base, name) is not None}  # fmt: skip
    other = with_values(base, values)
    for name, value in values.items():
        assert value_of(other, name) == pytest.approx(value)
    friction = other.rover.wheel_drive.left_friction if other.rover else None
    assert friction is not None
    assert friction.breakaway == pytest.approx(1.25 * 0.03)
    with pytest.raises(IdentifyError, match="swivel_friction"):
        with_values(base, {"swivel_friction": 1.0})


def test_sensors_without_errors_still_saturate():
    quiet = without_errors(load_spatial("identify_hang")).sensors
    assert quiet.gyro.noise_density == quiet.gyro.bias == quiet.wheel_encoders.resolution == 0.0
    assert quiet.gyro.range == load_spatial("identify_hang").sensors.gyro.range
    assert quiet.camera.range_finder.noise_density == 0.0
