"""Codecs of odometry, poses, paths and twists."""

from __future__ import annotations

from typing import Any

from msg_schemas.checks import check_frame
from msg_schemas.message_parts import (
    Message,
    from_time,
    new_message,
    quaternion_of,
    set_values,
    vector_of,
)
from msg_schemas.message_types import message_class, to_time
from msg_schemas.samples import OdometrySample, PathSample, PoseSample, TwistSample
from msg_schemas.specifications import Topic


def encode_odometry(topic: Topic, sample: OdometrySample) -> Message:
    """Turn an odometry sample into its message."""
    message = new_message(topic, sample.stamp_ns)
    message.child_frame_id = topic.child_frame
    set_values(message.pose.pose.position, sample.position)
    set_values(message.pose.pose.orientation, sample.orientation, "xyzw")
    set_values(message.twist.twist.linear, sample.linear)
    set_values(message.twist.twist.angular, sample.angular)
    if sample.pose_covariance:
        message.pose.covariance = list(sample.pose_covariance)
    return message


def decode_odometry(topic: Topic, message: Message) -> OdometrySample:
    """Turn an odometry message into its sample."""
    check_frame(topic, message.header.frame_id, topic.frame)
    check_frame(topic, message.child_frame_id, topic.child_frame, "child_frame_id")
    return OdometrySample(
        from_time(message.header.stamp),
        vector_of(message.pose.pose.position),
        quaternion_of(message.pose.pose.orientation),
        vector_of(message.twist.twist.linear),
        vector_of(message.twist.twist.angular),
        _covariance(message.pose.covariance),
    )


def _covariance(given: Any) -> tuple[float, ...]:
    values = tuple(float(value) for value in given)
    return values if any(values) else ()


def _set_pose(target: Message, sample: PoseSample) -> None:
    set_values(target.position, sample.position)
    set_values(target.orientation, sample.orientation, "xyzw")


def encode_pose(topic: Topic, sample: PoseSample) -> Message:
    """Turn a pose into its message."""
    message = new_message(topic, sample.stamp_ns)
    _set_pose(message.pose, sample)
    return message


def decode_pose(topic: Topic, message: Message) -> PoseSample:
    """Turn a pose message into its sample."""
    check_frame(topic, message.header.frame_id, topic.frame)
    return PoseSample(
        from_time(message.header.stamp),
        vector_of(message.pose.position),
        quaternion_of(message.pose.orientation),
    )


def encode_path(topic: Topic, sample: PathSample) -> Message:
    """Turn a path into its message."""
    message = new_message(topic, sample.stamp_ns)
    pose_class = message_class("geometry_msgs/msg/PoseStamped")
    for each in sample.poses:
        pose = pose_class()
        pose.header.stamp = to_time(each.stamp_ns)
        pose.header.frame_id = topic.frame
        _set_pose(pose.pose, each)
        message.poses.append(pose)
    return message


def decode_path(topic: Topic, message: Message) -> PathSample:
    """Turn a path message into its sample."""
    check_frame(topic, message.header.frame_id, topic.frame)
    return PathSample(
        from_time(message.header.stamp), tuple(decode_pose(topic, each) for each in message.poses)
    )


def encode_twist(topic: Topic, sample: TwistSample) -> Message:
    """Turn a twist into its message."""
    message = new_message(topic, sample.stamp_ns)
    set_values(message.twist.linear, sample.linear)
    set_values(message.twist.angular, sample.angular)
    return message


def decode_twist(topic: Topic, message: Message) -> TwistSample:
    """Turn a twist message into its sample."""
    check_frame(topic, message.header.frame_id, topic.frame)
    return TwistSample(
        from_time(message.header.stamp),
        vector_of(message.twist.linear),
        vector_of(message.twist.angular),
    )
