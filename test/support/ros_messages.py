"""Samples as ROS messages, built and serialized by ROS: the reference of the contract's codecs."""

import array
from collections.abc import Callable
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, PoseStamped
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import PointField
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker

from msg_schemas.message_types import message_class, to_time
from msg_schemas.samples import (
    TETHER_COLUMNS,
    ClockSample,
    DrawingSample,
    ImuSample,
    JointSample,
    OdometrySample,
    PathSample,
    PoseEstimateSample,
    PoseSample,
    Sample,
    StatusSample,
    TetherSample,
    TextSample,
    TwistSample,
    WrenchSample,
)
from msg_schemas.specifications import Topic
from msg_schemas.table import TOPICS

STORE = get_typestore(Stores.ROS2_JAZZY)


def message_of(name: str, sample: Any) -> Any:
    """The ROS message of a sample."""
    topic = TOPICS[name]
    message = message_class(topic.message)()
    if hasattr(message, "header"):
        message.header.stamp = to_time(sample.stamp_ns)
        message.header.frame_id = topic.frame
    _FILL[type(sample)](topic, message, sample)
    return message


def message_in(name: str, data: bytes) -> Any:
    """The ROS message of a contract topic in these bytes."""
    return deserialize_message(data, message_class(TOPICS[name].message))


def sent_by_rclpy(message: Any) -> bytes:
    """The message as rclpy serializes it, perhaps with padding of any content."""
    return bytes(serialize_message(message))


def serialised(kind: str, message: Any) -> bytes:
    """The message as rosbags serializes it: each byte of padding is zero."""
    return bytes(STORE.serialize_cdr(_converted(message, kind), kind))


def _set(target: Any, values: tuple[float, ...], axes: str = "xyz") -> None:
    for axis, value in zip(axes, values, strict=True):
        setattr(target, axis, float(value))


def _clock(_topic: Topic, message: Any, sample: ClockSample) -> None:
    message.clock = to_time(sample.stamp_ns)


def _text(_topic: Topic, message: Any, sample: TextSample) -> None:
    message.data = str(sample.text)


def _joints(_topic: Topic, message: Any, sample: JointSample) -> None:
    message.name = list(sample.joints)
    message.position = [value.position for value in sample.joints.values()]
    message.velocity = [value.velocity for value in sample.joints.values()]
    message.effort = [value.effort for value in sample.joints.values()]


def _odometry(topic: Topic, message: Any, sample: OdometrySample) -> None:
    message.child_frame_id = topic.child_frame
    _estimate(topic, message, sample)
    _set(message.twist.twist.linear, sample.linear)
    _set(message.twist.twist.angular, sample.angular)


def _estimate(topic: Topic, message: Any, sample: PoseEstimateSample | OdometrySample) -> None:
    _pose(topic, message.pose, sample)
    if sample.pose_covariance:
        message.pose.covariance = list(sample.pose_covariance)


def _pose(
    _topic: Topic, message: Any, sample: PoseSample | PoseEstimateSample | OdometrySample
) -> None:
    _set(message.pose.position, sample.position)
    _set(message.pose.orientation, sample.orientation, "xyzw")


def _path(topic: Topic, message: Any, sample: PathSample) -> None:
    for each in sample.poses:
        pose = PoseStamped()
        pose.header.stamp = to_time(each.stamp_ns)
        pose.header.frame_id = topic.frame
        _pose(topic, pose, each)
        message.poses.append(pose)


def _twist(_topic: Topic, message: Any, sample: TwistSample) -> None:
    _set(message.twist.linear, sample.linear)
    _set(message.twist.angular, sample.angular)


def _imu(_topic: Topic, message: Any, sample: ImuSample) -> None:
    message.orientation_covariance[0] = -1.0  # no orientation estimate
    _set(message.angular_velocity, sample.angular_velocity)
    _set(message.linear_acceleration, sample.linear_acceleration)


def _wrench(_topic: Topic, message: Any, sample: WrenchSample) -> None:
    _set(message.wrench.force, sample.force)
    _set(message.wrench.torque, sample.torque)


def _tether(_topic: Topic, message: Any, sample: TetherSample) -> None:
    message.height, message.width = 1, len(sample.nodes)
    message.fields = [
        PointField(name=name, offset=8 * column, datatype=PointField.FLOAT64, count=1)
        for column, name in enumerate(TETHER_COLUMNS)
    ]
    message.point_step = 8 * len(TETHER_COLUMNS)
    message.row_step = message.point_step * len(sample.nodes)
    message.data = array.array("B", sample.nodes.astype("<f8").tobytes())
    message.is_dense = True


def _statuses(_topic: Topic, message: Any, sample: StatusSample) -> None:
    message.status = [
        DiagnosticStatus(
            level=bytes([status.level]),
            name=status.name,
            message=status.message,
            hardware_id=status.hardware_id,
            values=[KeyValue(key=k, value=v) for k, v in status.values.items()],
        )
        for status in sample.statuses
    ]


_MARKERS = {
    "arrow": Marker.ARROW,
    "box": Marker.CUBE,
    "sphere": Marker.SPHERE,
    "cylinder": Marker.CYLINDER,
    "line": Marker.LINE_STRIP,
    "triangles": Marker.TRIANGLE_LIST,
}


def _drawing(_topic: Topic, message: Any, sample: DrawingSample) -> None:
    clearing = Marker(action=Marker.DELETEALL)
    clearing.header.stamp = to_time(sample.stamp_ns)
    clearing.header.frame_id = "map"
    message.markers.append(clearing)
    for number, shape in enumerate(sample.shapes):
        marker = Marker(ns=shape.namespace, id=number, type=_MARKERS[shape.kind])
        marker.header.stamp = to_time(sample.stamp_ns)
        marker.header.frame_id = shape.frame
        _set(marker.scale, shape.size)
        _set(marker.color, shape.colour, "rgba")
        _set(marker.pose.position, shape.position)
        _set(marker.pose.orientation, shape.orientation, "xyzw")
        marker.points = [Point(x=x, y=y, z=z) for x, y, z in shape.points]
        marker.colors = [ColorRGBA(r=r, g=g, b=b, a=a) for r, g, b, a in shape.colours]
        message.markers.append(marker)


_FILL: dict[type[Sample], Callable[[Topic, Any, Any], None]] = {
    ClockSample: _clock,
    DrawingSample: _drawing,
    ImuSample: _imu,
    JointSample: _joints,
    OdometrySample: _odometry,
    PathSample: _path,
    PoseEstimateSample: _estimate,
    PoseSample: _pose,
    StatusSample: _statuses,
    TetherSample: _tether,
    TextSample: _text,
    TwistSample: _twist,
    WrenchSample: _wrench,
}


def _converted(message: Any, kind: str) -> Any:
    values = {}
    for field, field_type in message.get_fields_and_field_types().items():
        values[field] = _value(getattr(message, field), field_type)
    return STORE.types[kind](**values)


def _value(value: Any, field_type: str) -> Any:
    base = field_type.removeprefix("sequence<").split("[")[0].removesuffix(">").split(",")[0]
    if "/" in base:
        package, name = base.split("/")
        kind = f"{package}/msg/{name}"
        if base != field_type:
            return [_converted(item, kind) for item in value]
        return _converted(value, kind)
    if base == "octet":
        return value[0]
    if base in {field_type, "string"}:
        return value
    return np.asarray(value)
