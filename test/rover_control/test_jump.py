"""Jump controller on the spatial plant with its real sensors, without ROS."""

from __future__ import annotations

import pytest

from msg_schemas import topics
from msg_schemas.machine import JUMP_HEIGHT, JUMP_STROKE, SPRING_GAIN
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample, JointValue
from msg_schemas.table import TOPICS
from rover_control.jump import Jump, JumpSettings
from rover_control.jump_report import flown_sample
from rover_verify.checks.jump_rig import JumpingRover, Stand

pytestmark = pytest.mark.usefixtures("compiled")


@pytest.fixture(scope="module")
def rover() -> JumpingRover:
    """A rover with a spring 5 % too stiff after three requested jumps of 0.2 m."""
    rover = JumpingRover(Stand(slope=0.05, downhill=1.0, spring=1.05), seed=3)
    for _ in range(3):
        assert rover.perform_jump(0.2)
    return rover


def test_every_jump_begins_and_ends_in_standby(rover: JumpingRover):
    phases = [change.phase.value for _, change in rover.changes]
    assert phases == 3 * [
        "compressing", "settling", "releasing", "flight", "landed", "hooking", "standby",
    ]  # fmt: skip
    assert not rover.refusals


def test_heights_are_measured_to_millimetres(rover: JumpingRover):
    heights = [record.flown.height for record in rover.records]
    assert heights == pytest.approx(rover.heights, abs=4e-3)


def test_the_estimate_adapts_to_a_stiff_spring(rover: JumpingRover):
    errors = [abs(height / 0.2 - 1.0) for height in rover.heights]
    assert errors[0] > 0.04
    assert errors[2] < 0.5 * errors[0]
    assert rover.control.spring.gain > 1.02
    assert all(record.accepted for record in rover.records)
    strokes = [record.stroke for record in rover.records]
    assert strokes[2] < strokes[0]


def test_a_record_is_a_sample_of_the_contract(rover: JumpingRover):
    record = rover.records[0]
    sample = flown_sample(record)
    assert set(sample.joints) == {*TOPICS[topics.JUMP_FLOWN].joints}
    flown, low, high = sample.joints[JUMP_HEIGHT]
    assert flown == record.flown.height
    assert record.expected is not None
    assert (low, high) == record.expected.interval(0.9)
    assert low < record.expected.mean < high
    assert sample.joints[SPRING_GAIN].position == record.gain


def test_a_height_beyond_the_stroke_limit_is_refused_with_the_limit(
    rover: JumpingRover,
):
    now = rover.now_ns
    with pytest.raises(Refusal, match=r"limit of 0\.2 m reaches 0\.\d+ m") as caught:
        rover.control.request(JointSample(now, {JUMP_HEIGHT: JointValue(1.0)}), now)
    assert caught.value.code is RefusalCode.OUT_OF_LIMITS
    assert rover.control.phase.value == "standby"


def test_the_spring_estimate_can_be_reset(rover: JumpingRover):
    kept = rover.control.spring
    rover.control.reset_spring()
    assert rover.control.spring.gain == 1.0
    rover.control.spring = kept


def test_a_request_is_refused_before_any_sample():
    for joint in (JUMP_STROKE, JUMP_HEIGHT):
        with pytest.raises(Refusal, match="never received") as caught:
            Jump(JumpSettings()).request(JointSample(0, {joint: JointValue(0.1)}), 1)
        assert caught.value.code is RefusalCode.STALE
