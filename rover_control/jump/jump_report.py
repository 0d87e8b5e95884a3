"""Published samples of the jump controller. Pure."""

from __future__ import annotations

import math

from msg_schemas import machine
from msg_schemas.samples import JointSample, JointValue
from rover_control.jump.jump_controller import JumpRecord
from rover_control.prediction.jump_prediction import NO_INTERVAL, JumpPrediction


def prediction_sample(prediction: JumpPrediction, stamp_ns: int) -> JointSample:
    """A predicted jump."""
    joints = {
        machine.JUMP_HEIGHT: JointValue(*prediction.height),
        machine.JUMP_RANGE: JointValue(*prediction.range),
        machine.JUMP_TURN: JointValue(*prediction.turn),
        machine.JUMP_TENSION: JointValue(*prediction.peak_tension),
        machine.JUMP_STROKE: JointValue(prediction.stroke),
        machine.JUMP_SLACK: JointValue(prediction.slack),
        machine.UPRIGHT: JointValue(prediction.upright),
        machine.ROLLOUTS: JointValue(float(prediction.rollouts)),
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
        machine.JUMP_REQUESTED: 0.0
        if math.isnan(record.requested_height)
        else record.requested_height,
        machine.JUMP_AHEAD: flown.ahead,
        machine.JUMP_LEFT: flown.left,
        machine.JUMP_STROKE: record.stroke,
        machine.JUMP_TILT: flown.tilt,
        machine.JUMP_TIME: flown.flight_time,
        machine.SPRING_GAIN: record.gain,
        machine.SPRING_ZERO: record.zero,
    }
    joints = {
        machine.JUMP_HEIGHT: JointValue(max(flown.height, 0.0), low, high),
        machine.JUMP_RANGE: JointValue(flown.range, distance.low, distance.high),
        machine.JUMP_TURN: JointValue(flown.turn, turn.low, turn.high),
        machine.JUMP_TENSION: JointValue(peak_tension, tension.low, tension.high),
    }
    joints |= {name: JointValue(value) for name, value in values.items()}
    return JointSample(record.stamp_ns, joints)
