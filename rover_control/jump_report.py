"""What the jump tells of itself, as samples of the contract. Pure."""

from __future__ import annotations

import math

from msg_schemas.machine import (
    FORECAST_TIME,
    JUMP_HEIGHT,
    JUMP_RANGE,
    JUMP_SLACK,
    JUMP_STROKE,
    JUMP_TENSION,
    JUMP_TILT,
    JUMP_TIME,
    JUMP_TURN,
    JUMP_WANTED,
    SPRING_GAIN,
    SPRING_ZERO,
    UPRIGHT,
)
from msg_schemas.samples import JointSample, JointValue
from rover_control.jump import JumpRecord
from rover_control.jump_forecast import NO_BAND, Forecast


def forecast_sample(forecast: Forecast, stamp_ns: int) -> JointSample:
    """A jump as it is foretold."""
    joints = {
        JUMP_HEIGHT: JointValue(*forecast.height),
        JUMP_RANGE: JointValue(*forecast.range),
        JUMP_TURN: JointValue(*forecast.turn),
        JUMP_TENSION: JointValue(*forecast.peak_tension),
        JUMP_STROKE: JointValue(forecast.stroke),
        JUMP_SLACK: JointValue(forecast.slack),
        UPRIGHT: JointValue(forecast.upright),
        FORECAST_TIME: JointValue(forecast.took, 0.0, float(forecast.rollouts)),
    }
    return JointSample(stamp_ns, joints)


def flown_sample(record: JumpRecord) -> JointSample:
    """A jump, foretold and flown."""
    flown, expected, forecast = record.flown, record.expected, record.forecast
    low, high = 0.0, 0.0
    if expected is not None:
        low, high = expected.interval()
    way = turn = tension = NO_BAND
    if forecast is not None:
        way, turn, tension = forecast.range, forecast.turn, forecast.peak_tension
    pull = 0.0 if math.isnan(record.peak_tension) else record.peak_tension
    values = {
        JUMP_WANTED: 0.0 if math.isnan(record.wanted) else record.wanted,
        JUMP_STROKE: record.stroke,
        JUMP_TILT: flown.tilt,
        JUMP_TIME: flown.flight_time,
        SPRING_GAIN: record.gain,
        SPRING_ZERO: record.zero,
    }
    joints = {
        JUMP_HEIGHT: JointValue(max(flown.height, 0.0), low, high),
        JUMP_RANGE: JointValue(flown.range, way.low, way.high),
        JUMP_TURN: JointValue(flown.turn, turn.low, turn.high),
        JUMP_TENSION: JointValue(pull, tension.low, tension.high),
    }
    joints |= {name: JointValue(value) for name, value in values.items()}
    return JointSample(record.stamp_ns, joints)
