"""Codecs: conversion between ROS messages and typed samples, with the table's checks.

``encode`` and ``decode`` are pure. They need the message packages, not rclpy.
Both check every number for finiteness and against its limits, so that a bad value is
neither sent nor accepted.
"""

from __future__ import annotations

import array
import sys
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from msg_schemas.checks import (
    check_age,
    check_frame,
    check_joint_names,
    check_numbers,
    check_orientation,
    check_text,
)
from msg_schemas.message_parts import (
    Message,
    from_time,
    new_message,
    quaternion_of,
    set_values,
    vector_of,
)
from msg_schemas.message_types import message_class, to_time
from msg_schemas.motion_codecs import (
    decode_odometry,
    decode_path,
    decode_pose,
    decode_twist,
    encode_odometry,
    encode_path,
    encode_pose,
    encode_twist,
)
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import (
    TETHER_COLUMNS,
    ClockSample,
    Colour,
    DrawingSample,
    ImuSample,
    JointSample,
    JointValue,
    Level,
    OdometrySample,
    PathSample,
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
from msg_schemas.table import Topic, find_topic

__all__ = [
    "Message",
    "check",
    "check_age",
    "decode",
    "encode",
    "find_topic",
    "from_time",
    "message_class",
    "to_time",
]

_FLOAT64 = 8
_POINT_STEP = 8 * len(TETHER_COLUMNS)
_COVARIANCE = 36  # values of a pose's


def encode(name: str, sample: Sample) -> Message:
    """Turn a sample into the topic's message.

    Raises:
        Refusal: a value is not finite, out of limits, or not of this topic.
    """
    topic = find_topic(name)
    check_type(topic, sample)
    return _CODECS[topic.sample].encode(topic, sample)


def decode(name: str, message: Message, now_ns: int | None = None) -> Any:
    """Turn a message into the topic's sample.

    Args:
        name: topic name, relative, as in the table.
        message: a ROS message of the topic's type.
        now_ns: receiver's clock [ns]; if given, the message's age is checked too.

    Raises:
        Refusal: bad number, wrong joint, wrong length, bad text, too old ...
    """
    topic = find_topic(name)
    sample: Sample = _CODECS[topic.sample].decode(topic, message)
    check(topic, sample)
    if now_ns is not None:
        sample = check_age(topic, sample, now_ns)
    return sample


def check_type(topic: Topic, sample: Sample) -> None:
    """Refuse a sample of another type, and what ``check`` refuses."""
    if not isinstance(sample, topic.sample):
        raise Refusal(
            topic.name,
            RefusalCode.WRONG_TYPE,
            f"got a {type(sample).__name__}, this topic carries {topic.sample.__name__}",
        )
    check(topic, sample)


def check(topic: Topic, sample: Sample) -> None:
    """Refuse a sample whose names, numbers or words the table does not allow."""
    if isinstance(sample, JointSample):
        check_joint_names(topic, list(sample.joints))
    elif isinstance(sample, TextSample):
        check_text(topic, sample.text)
    elif isinstance(sample, OdometrySample):
        check_orientation(topic, sample.orientation)
        _check_covariance(topic, sample.pose_covariance)
    elif isinstance(sample, PoseSample):
        check_orientation(topic, sample.orientation, may_be_open=True)
    elif isinstance(sample, PathSample):
        for pose in sample.poses:
            check_orientation(topic, pose.orientation, may_be_open=True)
    check_numbers(topic, sample.scalars())


def _check_covariance(topic: Topic, given: tuple[float, ...]) -> None:
    if given and len(given) != _COVARIANCE:
        raise Refusal(
            topic.name,
            RefusalCode.WRONG_LENGTH,
            f"pose_covariance has {len(given)} values, it must have {_COVARIANCE} or none",
        )
    check_numbers(topic, (("pose_covariance", value) for value in given))


# --- the codecs, one per sample type -----------------------------------------------------------


def _encode_joints(topic: Topic, sample: JointSample) -> Message:
    message = new_message(topic, sample.stamp_ns)
    message.name = list(sample.joints)
    values = sample.joints.values()
    message.position = array.array("d", [v.position for v in values])
    message.velocity = array.array("d", [v.velocity for v in values])
    message.effort = array.array("d", [v.effort for v in values])
    return message


def _joint_column(topic: Topic, message: Message, part: str) -> list[float]:
    names = list(message.name)
    given = list(getattr(message, part))
    if len(given) == len(names):
        return [float(v) for v in given]
    rows = [topic.by_path.get(f"{name}.{part}") for name in names]
    defaults = [row.default for row in rows if row is not None and row.default is not None]
    if not given and len(defaults) == len(names):
        return defaults
    raise Refusal(
        topic.name,
        RefusalCode.WRONG_LENGTH,
        f"{part} has {len(given)} values for {len(names)} joints, it must have {len(names)}",
    )


def _decode_joints(topic: Topic, message: Message) -> JointSample:
    names = [str(name) for name in message.name]
    check_joint_names(topic, names)
    columns = [_joint_column(topic, message, p) for p in ("position", "velocity", "effort")]
    joints = {n: JointValue(*v) for n, *v in zip(names, *columns, strict=True)}
    return JointSample(from_time(message.header.stamp), joints)


def _encode_imu(topic: Topic, sample: ImuSample) -> Message:
    message = new_message(topic, sample.stamp_ns)
    message.orientation_covariance[0] = -1.0  # sensor_msgs/Imu: no orientation estimate
    set_values(message.angular_velocity, sample.angular_velocity)
    set_values(message.linear_acceleration, sample.linear_acceleration)
    return message


def _decode_imu(topic: Topic, message: Message) -> ImuSample:
    check_frame(topic, message.header.frame_id, topic.frame)
    return ImuSample(
        from_time(message.header.stamp),
        vector_of(message.angular_velocity),
        vector_of(message.linear_acceleration),
    )


def _encode_wrench(topic: Topic, sample: WrenchSample) -> Message:
    message = new_message(topic, sample.stamp_ns)
    set_values(message.wrench.force, sample.force)
    set_values(message.wrench.torque, sample.torque)
    return message


def _decode_wrench(topic: Topic, message: Message) -> WrenchSample:
    check_frame(topic, message.header.frame_id, topic.frame)
    return WrenchSample(
        from_time(message.header.stamp),
        vector_of(message.wrench.force),
        vector_of(message.wrench.torque),
    )


def _encode_tether(topic: Topic, sample: TetherSample) -> Message:
    if sample.nodes.ndim != 2 or sample.nodes.shape[1] != len(TETHER_COLUMNS):
        raise Refusal(
            topic.name,
            RefusalCode.WRONG_LENGTH,
            f"nodes have shape {sample.nodes.shape}, it must be (n + 1, {len(TETHER_COLUMNS)})",
        )
    message = new_message(topic, sample.stamp_ns)
    point_field = message_class("sensor_msgs/msg/PointField")
    message.height = 1
    message.width = sample.nodes.shape[0]
    message.fields = [
        point_field(name=name, offset=8 * column, datatype=_FLOAT64, count=1)
        for column, name in enumerate(TETHER_COLUMNS)
    ]
    message.point_step = _POINT_STEP
    message.row_step = _POINT_STEP * sample.nodes.shape[0]
    data = np.ascontiguousarray(sample.nodes, dtype="<f8").tobytes()
    message.data = array.array("B", data)
    message.is_dense = True
    return message


def _decode_tether(topic: Topic, message: Message) -> TetherSample:
    check_frame(topic, message.header.frame_id, topic.frame)
    names = tuple(f.name for f in message.fields)
    plain = all(f.datatype == _FLOAT64 and f.count == 1 for f in message.fields)
    if names != TETHER_COLUMNS or not plain or message.is_bigendian:
        raise Refusal(
            topic.name,
            RefusalCode.WRONG_NAME,
            f"fields are {names}, they must be {TETHER_COLUMNS}, little-endian FLOAT64",
        )
    data = bytes(message.data)
    expected = message.width * message.height * _POINT_STEP
    if message.point_step != _POINT_STEP or len(data) != expected or message.width == 0:
        raise Refusal(
            topic.name,
            RefusalCode.WRONG_LENGTH,
            f"data has {len(data)} bytes at point step {message.point_step}, it must have "
            f"{expected} at {_POINT_STEP}",
        )
    nodes = np.frombuffer(data, dtype="<f8").reshape(-1, len(TETHER_COLUMNS))
    return TetherSample(from_time(message.header.stamp), nodes)


def _encode_text(topic: Topic, sample: TextSample) -> Message:
    return message_class(topic.message)(data=sample.text)


def _decode_text(_topic: Topic, message: Message) -> TextSample:
    return TextSample(str(message.data))


def _encode_clock(topic: Topic, sample: ClockSample) -> Message:
    return message_class(topic.message)(clock=to_time(sample.stamp_ns))


def _decode_clock(_topic: Topic, message: Message) -> ClockSample:
    return ClockSample(from_time(message.clock))


def _encode_statuses(topic: Topic, sample: StatusSample) -> Message:
    status_class = message_class("diagnostic_msgs/msg/DiagnosticStatus")
    pair_class = message_class("diagnostic_msgs/msg/KeyValue")
    message = new_message(topic, sample.stamp_ns)
    message.status = [
        status_class(
            level=bytes([status.level]),
            name=status.name,
            message=status.message,
            hardware_id=status.hardware_id,
            values=[pair_class(key=k, value=v) for k, v in status.values.items()],
        )
        for status in sample.statuses
    ]
    return message


def _level(raw: bytes | int) -> Level:
    return Level(raw if isinstance(raw, int) else int.from_bytes(raw, sys.byteorder))


def _decode_statuses(topic: Topic, message: Message) -> StatusSample:
    statuses = []
    for item in message.status:
        try:
            level = _level(item.level)
        except ValueError as error:
            raise Refusal(
                topic.name, RefusalCode.OUT_OF_LIMITS, f"level is {item.level!r}, it must be 0 .. 3"
            ) from error
        values = {str(pair.key): str(pair.value) for pair in item.values}
        statuses.append(
            Status(str(item.name), str(item.message), level, str(item.hardware_id), values)
        )
    return StatusSample(from_time(message.header.stamp), tuple(statuses))


# visualization_msgs/Marker: ARROW, CUBE, SPHERE, CYLINDER, LINE_STRIP, TRIANGLE_LIST.
_MARKER_TYPES = {"arrow": 0, "box": 1, "sphere": 2, "cylinder": 3, "line": 4, "triangles": 11}
_MARKER_KINDS = {number: kind for kind, number in _MARKER_TYPES.items()}


def _encode_drawing(topic: Topic, sample: DrawingSample) -> Message:
    marker_class = message_class("visualization_msgs/msg/Marker")
    point_class = message_class("geometry_msgs/msg/Point")
    colour_class = message_class("std_msgs/msg/ColorRGBA")
    message = message_class(topic.message)()
    for index, shape in enumerate(sample.shapes):
        marker = marker_class()
        marker.header.stamp = to_time(sample.stamp_ns)
        marker.header.frame_id = shape.frame
        marker.ns = shape.namespace
        marker.id = index
        marker.type = _MARKER_TYPES[shape.kind]
        set_values(marker.scale, shape.size)
        set_values(marker.color, shape.colour, "rgba")
        set_values(marker.pose.position, shape.position)
        set_values(marker.pose.orientation, shape.orientation, "xyzw")
        marker.points = [point_class(x=x, y=y, z=z) for x, y, z in shape.points]
        marker.colors = [colour_class(r=r, g=g, b=b, a=a) for r, g, b, a in shape.colours]
        message.markers.append(marker)
    return message


def _marker_kind(topic: Topic, number: int) -> str:
    if number not in _MARKER_KINDS:
        raise Refusal(
            topic.name,
            RefusalCode.WRONG_TYPE,
            f"marker type is {number}, it must be one of {sorted(_MARKER_KINDS)}",
        )
    return _MARKER_KINDS[number]


def _colour(message: Message) -> Colour:
    return (float(message.r), float(message.g), float(message.b), float(message.a))


def _decode_drawing(topic: Topic, message: Message) -> DrawingSample:
    stamp = from_time(message.markers[0].header.stamp) if message.markers else 0
    shapes = tuple(
        Shape(
            str(m.ns),
            _marker_kind(topic, int(m.type)),
            str(m.header.frame_id),
            _colour(m.color),
            vector_of(m.scale),
            tuple(vector_of(p) for p in m.points),
            vector_of(m.pose.position),
            quaternion_of(m.pose.orientation),
            tuple(_colour(each) for each in m.colors),
        )
        for m in message.markers
    )
    return DrawingSample(stamp, shapes)


class _Codec(NamedTuple):
    encode: Callable[[Topic, Any], Message]
    decode: Callable[[Topic, Message], Any]


_CODECS: Mapping[type[Any], _Codec] = MappingProxyType(
    {
        JointSample: _Codec(_encode_joints, _decode_joints),
        OdometrySample: _Codec(encode_odometry, decode_odometry),
        PoseSample: _Codec(encode_pose, decode_pose),
        PathSample: _Codec(encode_path, decode_path),
        TwistSample: _Codec(encode_twist, decode_twist),
        ImuSample: _Codec(_encode_imu, _decode_imu),
        WrenchSample: _Codec(_encode_wrench, _decode_wrench),
        TetherSample: _Codec(_encode_tether, _decode_tether),
        TextSample: _Codec(_encode_text, _decode_text),
        ClockSample: _Codec(_encode_clock, _decode_clock),
        StatusSample: _Codec(_encode_statuses, _decode_statuses),
        DrawingSample: _Codec(_encode_drawing, _decode_drawing),
    }
)
