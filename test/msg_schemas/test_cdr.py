"""Codecs write and read the bytes of ROS, and refuse all other bytes with the reason."""

import math
import struct
import tracemalloc
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from contract_samples import STAMP_NS, joint_names, joint_samples, samples_of
from damage import damaged, little_time
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ros_messages import message_in, message_of, sent_by_rclpy, serialised

from msg_schemas import topics
from msg_schemas.cdr import header, pack, template, unpack
from msg_schemas.layouts import LAYOUTS
from msg_schemas.machine import FLOOR_SWITCH, JUMP_SCREW, WHEEL_LEFT
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import (
    ClockSample,
    DrawingSample,
    ImuSample,
    JointSample,
    JointValue,
    Level,
    OdometrySample,
    PathSample,
    PoseEstimateSample,
    PoseSample,
    Sample,
    Shape,
    Status,
    StatusSample,
    TetherSample,
    TextSample,
    TwistSample,
    WrenchSample,
)
from msg_schemas.specifications import Topic
from msg_schemas.table import TOPICS

ROWS = list(TOPICS.values())
PADDING = 12
by_name = pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
few = settings(max_examples=15, suppress_health_check=[HealthCheck.too_slow])


def same(left: Any, right: Any) -> bool:
    if isinstance(left, TetherSample):
        return left.stamp_ns == right.stamp_ns and np.array_equal(left.nodes, right.nodes)
    return bool(left == right)


def several(row: Topic) -> st.SearchStrategy[Any]:
    """Samples in a row: later messages are written and read by the template of earlier ones."""
    return st.lists(samples_of(row), min_size=1, max_size=4)


# --- equality with ROS ----------------------------------------------------------------------------


@pytest.mark.ros
@by_name
@given(data=st.data())
@few
def test_packed_samples_are_the_messages_of_ros(row: Topic, data: st.DataObject):
    for sample in data.draw(several(row)):
        packed = pack(row.name, sample)
        assert packed == serialised(row.message, message_of(row.name, sample))
        assert message_in(row.name, packed) == message_of(row.name, sample)


@pytest.mark.ros
@by_name
@given(data=st.data())
@few
def test_messages_sent_by_rclpy_are_read(row: Topic, data: st.DataObject):
    for sample in data.draw(several(row)):
        assert same(unpack(row.name, sent_by_rclpy(message_of(row.name, sample))), sample)


@by_name
@given(data=st.data())
@few
def test_samples_come_back_unchanged(row: Topic, data: st.DataObject):
    for sample in data.draw(several(row)):
        assert same(unpack(row.name, pack(row.name, sample)), sample)


@pytest.mark.ros
@pytest.mark.parametrize("row", [r for r in ROWS if r.joints], ids=lambda r: r.name)
@given(data=st.data(), words=st.lists(st.text(min_size=1, max_size=9), min_size=1, max_size=3))
@few
def test_messages_of_several_command_sources_come_by_turns(
    row: Topic, data: st.DataObject, words: list[str]
):
    senders = [f"/{word.encode('utf-8', 'replace').hex()}" for word in words]
    for names in joint_names(row) * 2:
        for sender in senders:
            sample = data.draw(joint_samples(row, names))
            message = message_of(row.name, sample)
            message.header.frame_id = sender
            packed = pack(row.name, sample, sender)
            assert packed == serialised(row.message, message)
            assert unpack(row.name, packed) == sample
            assert header(row.name, packed) == (sample.stamp_ns, sender)


# --- other legal messages -------------------------------------------------------------------------


def test_a_message_with_padding_and_options_is_read():
    wrench = WrenchSample(STAMP_NS, (0.0, 0.0, -4.0))
    packed = pack(topics.LOAD_CELL, wrench)
    for options in (b"\0\0", b"\0\3"):
        for size in (0, 1, PADDING):
            data = packed[:2] + options + packed[4:] + b"\xa5" * size
            assert unpack(topics.LOAD_CELL, data) == wrench


def test_a_message_without_a_frame_is_read():
    message = message_of(topics.IMU, unpack(topics.IMU, imu()))
    message.header.frame_id = ""
    assert unpack(topics.IMU, sent_by_rclpy(message)) == unpack(topics.IMU, imu())


def imu() -> bytes:
    layout = LAYOUTS["sensor_msgs/msg/Imu"]
    values = layout.blank
    return layout.serialize([STAMP_NS, "", *values[2:]])


def test_an_orientation_of_the_imu_is_not_looked_at():
    message = message_in(topics.IMU, imu())
    for orientation in (0.5, float("nan")):
        message.orientation.x = orientation
        message.orientation_covariance[8] = 1.0
        for _ in range(2):
            assert unpack(topics.IMU, sent_by_rclpy(message)) == unpack(topics.IMU, imu())


def test_a_string_without_its_end_and_one_of_length_zero_are_read():
    layout = LAYOUTS["std_msgs/msg/String"]
    assert layout.parse(b"\0\1\0\0\3\0\0\0abc") == ["abc"]
    assert layout.parse(b"\0\1\0\0\0\0\0\0") == [""]


# --- bytes that are no message --------------------------------------------------------------------


REST = (0.0, 0.0, 0.0)
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
_STATUS = Status("n", "m", Level.WARN, "winch_node", {"state": "ready", "": "ä"})
_LINE = Shape("t", "line", "map", (1.0,) * 4, (0.1,) * 3, (REST, REST), colours=((0.5,) * 4,))
EXAMPLES: dict[str, Sample] = {
    topics.CLOCK: ClockSample(1),
    topics.CONFIG: TextSample('{"seed": 1}'),
    topics.CONTACT: JointSample(1, {FLOOR_SWITCH: JointValue(1.0), WHEEL_LEFT: JointValue()}),
    topics.DRIVE_GOAL: PoseSample(1, REST),
    topics.DRIVE_PATH: PathSample(1, (PoseSample(2, REST), PoseSample(3, REST, UPRIGHT))),
    topics.EVENTS: StatusSample(1, (_STATUS, _STATUS)),
    topics.IMU: ImuSample(1, REST, REST),
    topics.LOAD_CELL: WrenchSample(1, REST, REST),
    topics.MARKERS: DrawingSample(1, (_LINE, _LINE)),
    topics.ODOMETRY: OdometrySample(1, REST, UPRIGHT, REST, REST, (1.0,) * 36),
    topics.POSE: PoseEstimateSample(1, REST, UPRIGHT, (1.0,) * 36),
    topics.TRUTH_TETHER: TetherSample(1, np.ones((2, 7))),
    topics.CMD_VEL: TwistSample(1, REST, REST),
}
"""A sample of each type."""


@pytest.fixture(params=EXAMPLES, ids=str)
def good(request: pytest.FixtureRequest) -> tuple[Topic, bytes]:
    """A topic with one of its messages, of which the codec knows the template."""
    name: str = request.param
    data = pack(name, EXAMPLES[name])
    assert same(unpack(name, data), EXAMPLES[name])
    return TOPICS[name], data


def test_there_is_an_example_of_each_message_type():
    assert {TOPICS[name].message for name in EXAMPLES} == LAYOUTS.keys()


def test_truncated_messages_are_refused(good: tuple[Topic, bytes]):
    row, data = good
    for size in range(len(data)):
        with pytest.raises(Refusal) as refused:
            unpack(row.name, data[:size])
        assert refused.value.code is RefusalCode.MALFORMED, size


def test_overlong_messages_are_refused(good: tuple[Topic, bytes]):
    row, data = good
    unpack(row.name, data + bytes(PADDING))
    with pytest.raises(Refusal, match="13 more than its parts") as refused:
        unpack(row.name, data + bytes(PADDING + 1))
    assert refused.value.code is RefusalCode.MALFORMED


@pytest.mark.parametrize(
    ("head", "reason"),
    [
        (b"\0\0\0\0", "big-endian"),
        (b"\0\2\0\0", "no little-endian CDR"),
        (b"\0\3\0\0", "no little-endian CDR"),
        (b"\0\7\0\0", "no little-endian CDR"),
        (b"\1\1\0\0", "no little-endian CDR"),
    ],
)
def test_other_representations_are_refused(good: tuple[Topic, bytes], head: bytes, reason: str):
    row, data = good
    with pytest.raises(Refusal, match=reason) as refused:
        unpack(row.name, head + data[4:])
    assert refused.value.code is RefusalCode.MALFORMED


@pytest.mark.fuzz
@given(row=st.sampled_from(ROWS), data=st.data())
@settings(max_examples=400, suppress_health_check=[HealthCheck.too_slow])
def test_a_damaged_message_is_refused_or_holds_the_contract(row: Topic, data: st.DataObject):
    good = pack(row.name, data.draw(samples_of(row)))
    message = data.draw(damaged(good))
    try:
        with little_time(0.1 + 1e-5 * len(message)):
            sample = unpack(row.name, message)
    except Refusal:
        return
    assert same(unpack(row.name, pack(row.name, sample)), sample)


@by_name
@given(data=st.binary(max_size=200), is_cdr=st.booleans())
@settings(max_examples=50)
def test_arbitrary_bytes_raise_refusals_only(row: Topic, data: bytes, is_cdr: bool):
    message = (b"\0\1\0\0" if is_cdr else b"") + data
    with suppress(Refusal):
        unpack(row.name, message)
    with suppress(Refusal):
        header(row.name, message)


def test_false_lengths_are_refused_without_allocating(good: tuple[Topic, bytes]):
    row, data = good
    for at in range(4, len(data) - 3, 4):
        for count in (2**32 - 1, 2**31, 2**28):
            false = data[:at] + struct.pack("<I", count) + data[at + 4 :]
            tracemalloc.start()
            with suppress(Refusal):
                unpack(row.name, false)
            _, peak = tracemalloc.get_traced_memory()
            tracemalloc.stop()
            assert peak < 200_000, at


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        (topics.CONFIG, b"{\xff}", "no UTF-8"),
        (topics.CONFIG, b"{\0}", "NUL"),
        (topics.CONFIG, b"[" * 100_000, "not JSON"),
        (topics.CONFIG, b"1" * 10_000, "not JSON"),
    ],
)
def test_strings_that_are_no_text_are_refused(name: str, content: bytes, reason: str):
    data = b"\0\1\0\0" + struct.pack("<I", len(content) + 1) + content + b"\0"
    with pytest.raises(Refusal, match=reason):
        unpack(name, data)


# --- samples that no message can hold -------------------------------------------------------------


@pytest.mark.parametrize("stamp_ns", [-(2**31) * 10**9 - 1, 2**31 * 10**9])
@pytest.mark.parametrize("times", [1, 2])
def test_a_stamp_beyond_32_bits_of_seconds_is_refused(stamp_ns: int, times: int):
    pack(topics.LOAD_CELL, WrenchSample(2**31 * 10**9 - 1, (0.0, 0.0, 0.0)))
    with pytest.raises(Refusal) as refused:
        pack(topics.LOAD_CELL, WrenchSample(stamp_ns, (0.0, 0.0, 0.0)))
    assert refused.value.code is RefusalCode.MALFORMED


@pytest.mark.parametrize("word", ["a\0b", "\ud800"])
def test_a_text_that_is_no_string_is_refused(word: str):
    for name, sample in (
        (topics.ROBOT_DESCRIPTION, TextSample(word)),
        (topics.EVENTS, StatusSample(1, (Status(word, "", Level.OK, "", {}),))),
        (topics.DIAGNOSTICS, StatusSample(1, (Status("", "", Level.OK, "", {"key": word}),))),
    ):
        with pytest.raises(Refusal) as refused:
            pack(name, sample)
        assert refused.value.code is RefusalCode.MALFORMED


def test_a_list_of_triangles_with_a_point_too_many_is_refused():
    shape = Shape("wall", "triangles", "map", (1.0,) * 4, (1.0,) * 3, ((0.0, 0.0, 0.0),) * 4)
    with pytest.raises(Refusal, match="4 points"):
        unpack(topics.PLACE, pack(topics.PLACE, DrawingSample(1, (shape,))))


def test_a_drawing_without_shapes_clears_the_one_before():
    empty = DrawingSample(5, ())
    data = pack(topics.PREDICTED_JUMP, empty)
    (marker,) = message_in(topics.PREDICTED_JUMP, data).markers
    assert marker.action == marker.DELETEALL
    assert unpack(topics.PREDICTED_JUMP, data) == empty


def test_a_colour_beyond_single_precision_is_refused():
    shape = Shape("t", "box", "map", (1e300, 0.0, 0.0, 1.0), (0.1,) * 3)
    with pytest.raises(Refusal, match="float too large"):
        pack(topics.MARKERS, DrawingSample(1, (shape,)))


# --- templates ------------------------------------------------------------------------------------


@pytest.mark.parametrize("position", [0.5, -0.2, math.nan, math.inf])
def test_a_number_beyond_its_limit_is_refused_by_a_known_template(position: float):
    def sample(position: float) -> JointSample:
        return JointSample(STAMP_NS, {JUMP_SCREW: JointValue(position, 0.01, 100.0)})

    packed = pack(topics.JUMP_MOTOR_COMMAND, sample(0.1))
    for _ in range(2):
        with pytest.raises(Refusal, match=rf"jump_screw\.position is {position}"):
            pack(topics.JUMP_MOTOR_COMMAND, sample(position))
        assert unpack(topics.JUMP_MOTOR_COMMAND, packed) == sample(0.1)
        false = packed.replace(struct.pack("<d", 0.1), struct.pack("<d", position))
        with pytest.raises(Refusal, match=rf"jump_screw\.position is {position}"):
            unpack(topics.JUMP_MOTOR_COMMAND, false)


def test_a_template_knows_where_the_numbers_are():
    sample = JointSample(STAMP_NS, {JUMP_SCREW: JointValue(0.1, 0.02, 300.0)})
    data = pack(topics.JUMP_MOTOR_COMMAND, sample)
    found = template(topics.JUMP_MOTOR_COMMAND, data)
    assert found is not None
    for path, value in sample.scalars():
        number = found.numbers[path]
        assert struct.unpack_from("<d", data, number.offset) == (value,)
        assert number.low <= value <= number.high
    assert template(topics.CONFIG, pack(topics.CONFIG, TextSample("{}"))) is None


def test_templates_are_not_kept_without_bound():
    for count in range(1000):
        sample = JointSample(STAMP_NS, {JUMP_SCREW: JointValue(0.1, 0.02, 300.0)})
        data = pack(topics.JUMP_MOTOR_COMMAND, sample, f"x{count}")
        assert unpack(topics.JUMP_MOTOR_COMMAND, data) == sample
    tracemalloc.start()
    for count in range(1000):
        data = pack(topics.JUMP_MOTOR_COMMAND, sample, f"y{count:0500}")
        unpack(topics.JUMP_MOTOR_COMMAND, data)
    kept, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert kept < 1_000_000
