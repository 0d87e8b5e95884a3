"""What the table forbids is neither sent nor accepted, and the refusal states the reason."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from contract_samples import STAMP_NS, joint_names, samples_of
from hypothesis import given, settings
from hypothesis import strategies as st
from ros_messages import message_of, sent_by_rclpy

from msg_schemas import topics
from msg_schemas.cdr import header, pack, unpack
from msg_schemas.machine import (
    JUMP_SCREW,
    JUMP_STROKE,
    MAX_STROKE,
    WINCH_AT_RATE,
    WINCH_AT_TENSION,
    WINCH_SLACK,
    WINCH_TO_LENGTH,
)
from msg_schemas.message_types import message_class
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import (
    JointSample,
    JointValue,
    OdometrySample,
    PathSample,
    PoseEstimateSample,
    PoseSample,
    TetherSample,
    TextSample,
    TwistSample,
    WrenchSample,
)
from msg_schemas.specifications import Intent, Topic, Unstamped
from msg_schemas.table import TOPICS
from rover_verify.harness.hil_invalid import ERRORS, JointMessage

ROWS = list(TOPICS.values())
BAD_NUMBERS = (math.nan, math.inf, -math.inf)
by_name = pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)


def read(name: str, message: Any, now_ns: int | None = None) -> Any:
    """The sample in a message as rclpy sends it."""
    return unpack(name, sent_by_rclpy(message), now_ns)


def numeric_leaves(message: Any, path: str = "") -> list[tuple[Any, str, str]]:
    """Every float of a message: (owner, attribute, path); array elements are reached by index."""
    found = []
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if kind in {"double", "float"}:
            found.append((message, name, f"{path}.{name}"))
        elif hasattr(value, "get_fields_and_field_types"):
            found += numeric_leaves(value, f"{path}.{name}")
    return found


CARRIED = {
    "geometry_msgs/msg/PoseWithCovarianceStamped": ("pose.pose", "pose.covariance"),
    "nav_msgs/msg/Odometry": ("pose.pose", "twist.twist"),
    "sensor_msgs/msg/Imu": ("angular_velocity", "linear_acceleration"),
    "geometry_msgs/msg/WrenchStamped": ("wrench",),
}


@pytest.mark.parametrize("row", [r for r in ROWS if r.message in CARRIED], ids=lambda r: r.name)
@pytest.mark.parametrize("bad", BAD_NUMBERS)
@given(data=st.data())
@settings(max_examples=1, deadline=None)
def test_every_float_that_is_not_finite_is_refused(row: Topic, bad: float, data: st.DataObject):
    sample = data.draw(samples_of(row))
    template = message_of(row.name, sample)
    paths = [p for _, _, p in numeric_leaves(template) if p[1:].startswith(CARRIED[row.message])]
    assert paths
    for index, path in enumerate(paths):
        message = message_of(row.name, sample)
        leaves = [x for x in numeric_leaves(message) if x[2][1:].startswith(CARRIED[row.message])]
        owner, attribute, _ = leaves[index]
        setattr(owner, attribute, bad)
        with pytest.raises(Refusal) as refused:
            read(row.name, message)
        # A quaternion that is not finite may be refused for its norm; both name the value.
        assert refused.value.code in {RefusalCode.NOT_FINITE, RefusalCode.OUT_OF_LIMITS}, path


@pytest.mark.parametrize("row", [r for r in ROWS if r.joints], ids=lambda r: r.name)
@pytest.mark.parametrize("part", ["position", "velocity", "effort"])
@pytest.mark.parametrize("bad", BAD_NUMBERS)
def test_joint_numbers_that_are_not_finite_are_refused(row: Topic, part: str, bad: float):
    for names in joint_names(row):
        for index, name in enumerate(names):
            message = message_of(row.name, good(row, names))
            getattr(message, part)[index] = bad
            with pytest.raises(Refusal, match=rf"{name}\.{part} is (nan|-?inf), it must be a fin"):
                read(row.name, message)


def good(row: Topic, names: tuple[str, ...] | None = None, stamp_ns: int = STAMP_NS) -> JointSample:
    """A good sample of these joints, by default of the first ones that the topic allows."""
    return JointSample(stamp_ns, {n: value(row, n) for n in names or joint_names(row)[0]})


def value(row: Topic, name: str) -> JointValue:
    def middle(part: str) -> float:
        item = row.by_path[f"{name}.{part}"]
        low, high = max(item.minimum, -1.0), min(item.maximum, 1.0)
        return 0.5 * (low + high)

    return JointValue(middle("position"), middle("velocity"), middle("effort"))


@pytest.mark.parametrize(
    ("row", "path"),
    [(r, f.path) for r in ROWS if r.joints for f in r.fields if math.isfinite(f.maximum)],
    ids=lambda x: getattr(x, "name", x),
)
def test_joint_numbers_beyond_their_limits_are_refused_in_encode_and_decode(row: Topic, path: str):
    name, part = path.rsplit(".", 1)
    item = row.by_path[path]
    names = next(names for names in joint_names(row) if name in names)
    for wrong in (item.maximum + 1e-6, item.minimum - 1e-6):
        joints = {**good(row, names).joints}
        joints[name] = joints[name]._replace(**{part: wrong})
        with pytest.raises(Refusal) as refused:
            pack(row.name, JointSample(STAMP_NS, joints))
        assert refused.value.code is RefusalCode.OUT_OF_LIMITS
        assert repr(wrong) in refused.value.reason
        assert f"{item.maximum:g}" in refused.value.reason


def jump_command(**changes: Any) -> Any:
    message = message_of(
        topics.JUMP_MOTOR_COMMAND,
        JointSample(STAMP_NS, {JUMP_SCREW: JointValue(0.2, 0.05, 400.0)}),
    )
    for name, changed in changes.items():
        setattr(message, name, changed)
    return message


@pytest.mark.parametrize(
    ("changes", "code", "text"),
    [
        ({"name": ["nut"]}, RefusalCode.WRONG_NAME, r"\['nut'\]"),
        ({"name": []}, RefusalCode.WRONG_NAME, r"\[\]"),
        (
            {"name": [JUMP_SCREW, JUMP_SCREW], "position": [0.1, 0.1]},
            RefusalCode.WRONG_NAME,
            "each once",
        ),
        ({"position": []}, RefusalCode.WRONG_LENGTH, "position has 0 values for 1 joints"),
        ({"velocity": [0.1, 0.1]}, RefusalCode.WRONG_LENGTH, "velocity has 2 values"),
        ({"effort": []}, RefusalCode.WRONG_LENGTH, "effort has 0 values"),
        ({"position": [MAX_STROKE + 0.01]}, RefusalCode.OUT_OF_LIMITS, "0.41"),
        ({"position": [-0.11]}, RefusalCode.OUT_OF_LIMITS, "-0.11"),
        ({"velocity": [0.0]}, RefusalCode.OUT_OF_LIMITS, "0.0001"),
    ],
)
def test_bad_actuator_commands_are_refused_with_the_value(
    changes: dict[str, Any], code: RefusalCode, text: str
):
    with pytest.raises(Refusal, match=text) as refused:
        read(topics.JUMP_MOTOR_COMMAND, jump_command(**changes))
    assert refused.value.code is code
    assert refused.value.subject == topics.JUMP_MOTOR_COMMAND


SECOND = 1_000_000_000
REST = (0.0, 0.0, 0.0)


def good_command(row: Topic, stamp_ns: int = STAMP_NS) -> Any:
    """A sample that the topic accepts, of joints or not."""
    if row.sample is TwistSample:
        return TwistSample(stamp_ns, REST, REST)
    if row.sample is PoseEstimateSample:
        return PoseEstimateSample(stamp_ns, REST)
    if row.sample is PoseSample:
        return PoseSample(stamp_ns, REST)
    if row.sample is PathSample:
        return PathSample(stamp_ns, (PoseSample(stamp_ns, REST),))
    return good(row, stamp_ns=stamp_ns)


def test_an_orientation_is_a_unit_quaternion_or_left_open():
    half = PoseSample(STAMP_NS, REST, (0.0, 0.0, 0.0, 0.5))
    with pytest.raises(Refusal, match=r"norm 0\.5.*all zeros"):
        pack(topics.DRIVE_GOAL, half)
    with pytest.raises(Refusal, match=r"norm 0\.5"):
        pack(topics.DRIVE_PATH, PathSample(STAMP_NS, (PoseSample(STAMP_NS, REST), half)))
    packed = pack(topics.DRIVE_GOAL, PoseSample(STAMP_NS, REST))
    assert header(topics.DRIVE_GOAL, packed).frame_id == "map"


def test_poses_of_another_frame_are_refused():
    message = message_of(topics.DRIVE_PATH, PathSample(STAMP_NS, (PoseSample(STAMP_NS, REST),)))
    message.poses[0].header.frame_id = "odom"
    with pytest.raises(Refusal, match="'odom', it must be 'map'") as refused:
        read(topics.DRIVE_PATH, message)
    assert refused.value.code is RefusalCode.WRONG_FRAME


@pytest.mark.parametrize(
    ("given", "code"),
    [
        ((1.0,) * 6, RefusalCode.WRONG_LENGTH),
        ((math.nan,) * 36, RefusalCode.NOT_FINITE),
    ],
)
def test_a_bad_covariance_is_refused(given: tuple[float, ...], code: RefusalCode):
    sample = OdometrySample(STAMP_NS, REST, (0.0, 0.0, 0.0, 1.0), REST, REST, given)
    with pytest.raises(Refusal) as refused:
        pack(topics.ODOMETRY, sample)
    assert refused.value.code is code


@pytest.mark.parametrize(
    "row", [r for r in ROWS if r.intent is Intent.COMMAND], ids=lambda r: r.name
)
def test_commands_are_taken_within_their_age_and_refused_beyond(row: Topic):
    sample = good_command(row)
    message = message_of(row.name, sample)
    oldest = STAMP_NS + round(row.stale.max_age * SECOND)
    earliest = STAMP_NS - round(row.stale.max_lead * SECOND)
    assert read(row.name, message, oldest) == sample
    assert read(row.name, message, earliest) == sample
    with pytest.raises(Refusal, match="ago") as refused:
        read(row.name, message, oldest + 1000)
    assert refused.value.code is RefusalCode.STALE
    with pytest.raises(Refusal, match="ahead") as refused:
        read(row.name, message, earliest - 1000)
    assert refused.value.code is RefusalCode.FROM_THE_FUTURE


@pytest.mark.parametrize(
    "row", [r for r in ROWS if r.intent is Intent.COMMAND], ids=lambda r: r.name
)
def test_an_unstamped_command_is_refused_or_stamped_as_the_table_requires(row: Topic):
    message = message_of(row.name, good_command(row, stamp_ns=0))
    if row.stale.unstamped is Unstamped.REFUSE:
        with pytest.raises(Refusal) as refused:
            read(row.name, message, STAMP_NS)
        assert refused.value.code is RefusalCode.UNSTAMPED
    else:
        assert read(row.name, message, STAMP_NS).stamp_ns == STAMP_NS


@pytest.mark.parametrize("code", ERRORS, ids=str)
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=200)
def test_a_command_with_a_random_error_is_refused_for_it(code: RefusalCode, seed: int):
    generator = np.random.default_rng(seed)
    rows = [row for row in ROWS if row.intent is Intent.COMMAND and row.joints]
    row = rows[int(generator.integers(len(rows)))]
    names = joint_names(row)
    message = JointMessage.of(good(row, names[int(generator.integers(len(names)))]))
    words = ERRORS[code](generator, row, message, STAMP_NS)
    with pytest.raises(Refusal) as refused:
        unpack(row.name, message.serialized(), STAMP_NS)
    assert refused.value.code is code
    assert words in refused.value.reason


@pytest.mark.parametrize("row", [r for r in ROWS if r.optional_joints], ids=lambda r: r.name)
def test_a_machine_may_lack_its_optional_joints_but_no_other(row: Topic):
    for names in joint_names(row):
        assert read(row.name, message_of(row.name, good(row, names))) == good(row, names)
    missing = [row.optional_joints] if row.joints else []
    for names in (*missing, (*row.joints, "propeller")):
        message = message_of(row.name, good(row))
        message.name = list(names)
        message.position = message.velocity = message.effort = [0.0] * len(names)
        with pytest.raises(Refusal, match="may further be") as refused:
            read(row.name, message)
        assert refused.value.code is RefusalCode.WRONG_NAME


@pytest.mark.parametrize("row", [r for r in ROWS if r.one_joint], ids=lambda r: r.name)
@pytest.mark.parametrize("wrong", [[], ["propeller"], "first two", "first twice"])
def test_a_message_about_one_joint_names_exactly_one(row: Topic, wrong: list[str] | str):
    for names in joint_names(row):
        assert read(row.name, message_of(row.name, good(row, names))) == good(row, names)
    if isinstance(wrong, str):
        wrong = [*row.joints[:2]] if wrong == "first two" else [row.joints[0]] * 2
    message = message_of(row.name, good(row))
    message.name = wrong
    message.position = message.velocity = message.effort = [0.0] * len(wrong)
    with pytest.raises(Refusal, match="exactly one of") as refused:
        read(row.name, message)
    assert refused.value.code is RefusalCode.WRONG_NAME


@pytest.mark.parametrize(
    ("joint", "fields", "taken"),
    [
        (WINCH_TO_LENGTH, {"position": [30.0]}, JointValue(30.0)),
        (WINCH_AT_RATE, {"velocity": [-0.2]}, JointValue(0.0, -0.2)),
        (WINCH_AT_TENSION, {"effort": [4.0]}, JointValue(0.0, 0.0, 4.0)),
        (WINCH_SLACK, {"position": [0.4]}, JointValue(0.4)),
    ],
)
def test_an_operator_s_winch_request_needs_its_one_number_only(
    joint: str, fields: dict[str, list[float]], taken: JointValue
):
    kind = message_class("sensor_msgs/msg/JointState")
    assert read(topics.WINCH_REQUEST, kind(name=[joint], **fields)).joints == {joint: taken}
    with pytest.raises(Refusal, match="has 0 values"):
        read(topics.WINCH_REQUEST, kind(name=[joint]))


def test_an_operator_may_leave_out_what_has_a_default():
    message = message_class("sensor_msgs/msg/JointState")(name=[JUMP_STROKE], position=[0.2])
    assert read(topics.JUMP_REQUEST, message).joints == {JUMP_STROKE: JointValue(0.2, 0.0, 0.0)}
    bare = message_class("sensor_msgs/msg/JointState")(name=[JUMP_STROKE])
    with pytest.raises(Refusal, match="position has 0 values"):
        read(topics.JUMP_REQUEST, bare)


def test_a_quaternion_that_is_not_unit_is_refused():
    sample = OdometrySample(STAMP_NS, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.9), (0.0,) * 3, (0.0,) * 3)
    with pytest.raises(Refusal, match=r"norm 0\.9"):
        pack(topics.TRUTH_BODY1, sample)


@pytest.mark.parametrize("attribute", ["frame_id", "child_frame_id"])
def test_a_foreign_frame_is_refused(attribute: str):
    sample = OdometrySample(STAMP_NS, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), (0.0,) * 3, (0.0,) * 3)
    message = message_of(topics.TRUTH_BODY1, sample)
    setattr(message.header if attribute == "frame_id" else message, attribute, "odom")
    with pytest.raises(Refusal, match="'odom'") as refused:
        read(topics.TRUTH_BODY1, message)
    assert refused.value.code is RefusalCode.WRONG_FRAME


def test_bad_words_and_bad_json_are_refused():
    for name, bad in (
        (topics.JUMP_PHASE, "flying"),
        (topics.CONFIG, "{"),
        (topics.CONFIG, "[1]"),
    ):
        message = message_class("std_msgs/msg/String")(data=bad)
        with pytest.raises(Refusal) as refused:
            read(name, message)
        assert refused.value.code is RefusalCode.BAD_TEXT


def tether(rows: int = 3) -> TetherSample:
    return TetherSample(STAMP_NS, np.arange(7.0 * rows).reshape(rows, 7))


@pytest.mark.parametrize(
    ("damage", "code"),
    [
        (lambda m: setattr(m, "width", 4), RefusalCode.WRONG_LENGTH),
        (lambda m: setattr(m, "width", 0), RefusalCode.WRONG_LENGTH),
        (lambda m: setattr(m, "data", m.data[:-1]), RefusalCode.WRONG_LENGTH),
        (lambda m: setattr(m, "point_step", 48), RefusalCode.WRONG_LENGTH),
        (lambda m: setattr(m.fields[0], "name", "u"), RefusalCode.WRONG_NAME),
        (lambda m: setattr(m.fields[3], "datatype", 7), RefusalCode.WRONG_NAME),
        (lambda m: setattr(m, "is_bigendian", True), RefusalCode.WRONG_NAME),
    ],
)
def test_a_damaged_point_cloud_is_refused(damage: Callable[[Any], None], code: RefusalCode):
    message = message_of(topics.TRUTH_TETHER, tether())
    damage(message)
    with pytest.raises(Refusal) as refused:
        read(topics.TRUTH_TETHER, message)
    assert refused.value.code is code


@pytest.mark.parametrize("bad", BAD_NUMBERS)
@pytest.mark.parametrize("column", range(7))
def test_one_bad_number_in_a_tether_is_refused(column: int, bad: float):
    sample = tether(50)
    sample.nodes[17, column] = bad
    with pytest.raises(Refusal):
        pack(topics.TRUTH_TETHER, sample)


def test_a_sample_of_another_topic_is_refused():
    with pytest.raises(Refusal) as refused:
        pack(topics.LOAD_CELL, TextSample("held"))
    assert refused.value.code is RefusalCode.WRONG_TYPE


def test_an_unknown_topic_is_an_error_that_lists_the_known_ones():
    with pytest.raises(KeyError, match=topics.LOAD_CELL):
        pack("sensors/lidar", WrenchSample(STAMP_NS, (0.0, 0.0, 1.0)))


def test_samples_are_frozen():
    for row in ROWS:
        assert dataclasses.is_dataclass(row.sample)
        assert row.sample.__dataclass_params__.frozen


def test_variances_have_limits():
    variances = [1.0] * 36
    variances[35] = 1.1e6
    sample = PoseEstimateSample(STAMP_NS, REST, pose_covariance=tuple(variances))
    with pytest.raises(Refusal, match=r"pose_covariance\[35\] is .* must lie in 0 \.\. 1e\+06 rad"):
        pack(topics.DRIVE_START, sample)
    variances[14], variances[35] = -1e-9, 1.0
    sample = PoseEstimateSample(STAMP_NS, REST, pose_covariance=tuple(variances))
    with pytest.raises(Refusal, match=r"variances .* must be at least 0") as refused:
        pack(topics.DRIVE_START, sample)
    assert refused.value.code is RefusalCode.OUT_OF_LIMITS
