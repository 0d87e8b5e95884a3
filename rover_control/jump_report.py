"""What the jump tells of itself, as samples of the contract. Pure."""

from __future__ import annotations

import math

from msg_schemas.machine import (
    JUMP_HEIGHT,
    JUMP_RANGE,
    JUMP_STROKE,
    JUMP_TILT,
    JUMP_TIME,
    JUMP_TURN,
    JUMP_WANTED,
    SPRING_GAIN,
    SPRING_ZERO,
)
from msg_schemas.samples import JointSample, JointValue
from rover_control.jump import NINETY, JumpRecord


def flown_sample(record: JumpRecord) -> JointSample:
    """A jump, foretold and flown."""
    flown, expected = record.flown, record.expected
    low, high = 0.0, 0.0
    if expected is not None:
        low, high = expected.quantile(-NINETY), expected.quantile(NINETY)
    values = {
        JUMP_WANTED: 0.0 if math.isnan(record.wanted) else record.wanted,
        JUMP_STROKE: record.stroke,
        JUMP_RANGE: flown.range,
        JUMP_TURN: flown.turn,
        JUMP_TILT: flown.tilt,
        JUMP_TIME: flown.flight_time,
        SPRING_GAIN: record.gain,
        SPRING_ZERO: record.zero,
    }
    joints = {JUMP_HEIGHT: JointValue(max(flown.height, 0.0), low, high)}
    joints |= {name: JointValue(value) for name, value in values.items()}
    return JointSample(record.stamp_ns, joints)
