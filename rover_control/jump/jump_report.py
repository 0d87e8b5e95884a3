"""Published samples of the jump controller. Pure."""

from __future__ import annotations

import math

from msg_schemas.machine import (
    JUMP_AHEAD,
    JUMP_HEIGHT,
    JUMP_LEFT,
    JUMP_RANGE,
    JUMP_REQUESTED,
    JUMP_SLACK,
    JUMP_STROKE,
    JUMP_TENSION,
    JUMP_TILT,
    JUMP_TIME,
    JUMP_TURN,
    ROLLOUTS,
    SPRING_GAIN,
    SPRING_ZERO,
    UPRIGHT,
)
from msg_schemas.samples import JointSample, JointValue
from rover_control.jump.jump_controller import JumpRecord
from rover_control.prediction.jump_prediction import NO_INTERVAL, JumpPrediction


def prediction_sample(prediction: JumpPrediction, stamp_ns: int) -> JointSample:
    """A predicted jump."""
    joints = {
        JUMP_HEIGHT: JointValue(*prediction.height),
        JUMP_RANGE: JointValue(*prediction.range),
        JUMP_TURN: JointValue(*prediction.turn),
        JUMP_TENSION: JointValue(*prediction.peak_tension),
        JUMP_STROKE: JointValue(prediction.stroke),
        JUMP_SLACK: JointValue(prediction.slack),
        UPRIGHT: JointValue(prediction.upright),
        ROLLOUTS: JointValue(float(prediction.rollouts)),
    }
    return JointSample(stamp_ns, joints)


def flown_sample(record: JumpRecord) -> JointSample:
    """A measured jump beside its prediction."""
    flown, expected, prediction = record.flown, record.expected, record.prediction
    low, high = 0.0, 0.0
    if expected is not None:
        low, high = expected.interval()
    distance = turn = tension = NO_INTERVAL
    if prediction is not None:
        distance, turn, tension = prediction.range, prediction.turn, prediction.peak_tension
    peak_tension = 0.0 if math.isnan(record.peak_tension) else record.peak_tension
    values = {
        JUMP_REQUESTED: 0.0 if math.isnan(record.requested_height) else record.requested_height,
        JUMP_AHEAD: flown.ahead,
        JUMP_LEFT: flown.left,
        JUMP_STROKE: record.stroke,
        JUMP_TILT: flown.tilt,
        JUMP_TIME: flown.flight_time,
        SPRING_GAIN: record.gain,
        SPRING_ZERO: record.zero,
    }
    joints = {
        JUMP_HEIGHT: JointValue(max(flown.height, 0.0), low, high),
        JUMP_RANGE: JointValue(flown.range, distance.low, distance.high),
        JUMP_TURN: JointValue(flown.turn, turn.low, turn.high),
        JUMP_TENSION: JointValue(peak_tension, tension.low, tension.high),
    }
    joints |= {name: JointValue(value) for name, value in values.items()}
    return JointSample(record.stamp_ns, joints)
