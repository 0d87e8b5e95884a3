"""Jumps of the shipped nodes on the spatial plant with its real sensors."""

from __future__ import annotations

import math
from typing import NamedTuple

import pytest

from msg_schemas import machine, topics
from msg_schemas.phases import JumpPhase
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample, JointValue, Sample, TextSample
from msg_schemas.table import TOPICS
from rover_control.jump.jump_controller import JumpController, JumpSettings
from rover_verify.checks.floor import Stand, start_on_floor
from rover_verify.checks.jumping import Jumper
from rover_verify.harness.flight import JUMP

pytestmark = pytest.mark.usefixtures("compiled")


class Jumped(NamedTuple):
    """A rover with its jumps."""

    rover: Jumper
    phases: list[str]
    records: list[JointSample]  # on jump/flown


@pytest.fixture(scope="module")
def jumped() -> Jumped:
    """A rover with a spring 5 % too stiff after three requested jumps of 0.2 m."""
    stand = Stand(slope=0.05, downhill=1.0, spring=1.05)
    flight = start_on_floor(JUMP, stand.overrides(), 3)
    made = Jumped(Jumper(flight), [], [])

    def receive(_name: str, sample: Sample, _sender: str, _now_ns: int) -> None:
        if isinstance(sample, TextSample):
            made.phases.append(sample.text)
        elif isinstance(sample, JointSample):
            made.records.append(sample)

    flight.host.exchange.listen(receive, topics.JUMP_PHASE, topics.JUMP_FLOWN)
    for _ in range(3):
        assert not math.isnan(made.rover.jump(0.2))
    return made


def test_every_jump_begins_and_ends_in_standby(jumped: Jumped):
    assert jumped.phases == 3 * [
        "compressing", "settling", "releasing", "flight", "landed", "hooking", "standby",
    ]  # fmt: skip
    assert not jumped.rover.flight.refusals


def test_heights_are_measured_to_millimetres(jumped: Jumped):
    heights = [record.joints[machine.JUMP_HEIGHT].position for record in jumped.records]
    assert heights == pytest.approx(jumped.rover.heights, abs=4e-3)


def test_the_estimate_adapts_to_a_stiff_spring(jumped: Jumped):
    errors = [abs(height / 0.2 - 1.0) for height in jumped.rover.heights]
    assert errors[0] > 0.04
    assert errors[2] < 0.5 * errors[0]
    assert jumped.records[-1].joints[machine.SPRING_GAIN].position > 1.02
    strokes = [record.joints[machine.JUMP_STROKE].position for record in jumped.records]
    assert strokes[2] < strokes[0]


def test_a_record_holds_the_expected_interval(jumped: Jumped):
    record = jumped.records[0]
    assert set(record.joints) == {*TOPICS[topics.JUMP_FLOWN].joints}
    _, low, high = record.joints[machine.JUMP_HEIGHT]
    assert low < 0.2 < high


def test_a_height_beyond_the_stroke_limit_is_refused_with_the_limit(jumped: Jumped):
    flight = jumped.rover.flight
    assert math.isnan(jumped.rover.jump(1.0))
    assert "limit of 0.2 m reaches 0." in jumped.rover.reason
    assert flight.refusals.pop()[1].code is RefusalCode.OUT_OF_LIMITS
    assert jumped.rover.phase == JumpPhase.STANDBY


def test_a_request_is_refused_before_any_sample():
    for joint in (machine.JUMP_STROKE, machine.JUMP_HEIGHT):
        with pytest.raises(Refusal, match="never received") as caught:
            JumpController(JumpSettings()).request(JointSample(0, {joint: JointValue(0.1)}), 1)
        assert caught.value.code is RefusalCode.STALE
