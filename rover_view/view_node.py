"""The ``view_node`` executable: publishes joints, frames, the observed wall and predictions."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geometry_msgs.msg import TransformStamped

from msg_schemas import machine, topics
from msg_schemas.access import TRANSFORMS
from msg_schemas.message_types import to_time
from msg_schemas.parameters import ParameterError, parameter
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.regular_files import file_problem, read_text
from msg_schemas.samples import (
    DrawingSample,
    JointSample,
    JointValue,
    Level,
    OdometrySample,
    PoseEstimateSample,
    TextSample,
)
from rover_runtime.component import Component
from rover_view.observed_wall import ObservedWall
from rover_view.predicted_jump import prediction_markers
from rover_view.robot_model import (
    DescriptionError,
    LinkFrame,
    RobotModel,
    body_frames,
    estimated_frames,
)

NO_TF = "no tf: {}; viewers show the markers, but no robot model"


@dataclass(frozen=True)
class ViewParameters:
    """Publishing rate of the frames, and the description of a rover that no plant describes."""

    frame_rate: float = parameter(
        30.0, "Hz", "publishing rate of the moving frames", 1.0, 100.0, read_only=True
    )
    description_file: str = parameter(
        "",
        "-",
        "URDF to publish on robot_description where no plant does, as with real drives; "
        "empty = none",
        read_only=True,
    )


class ViewNode(Component):
    """Publishes joints and link frames, and markers of the observed wall and predicted jumps."""

    NAME = "view_node"
    PARAMETERS = (ViewParameters,)
    RECEIVES_WITH_CALLS = True

    _moving: Any = None
    _still: Any = None

    def setup(self) -> None:
        """Open topics; without tf2_msgs, log a warning and publish no frames."""
        self._wall_publisher = self.publisher(topics.OBSERVED_WALL)
        self._jump_publisher = self.publisher(topics.PREDICTED_JUMP)
        self._joint_publisher = self.publisher(topics.JOINT_STATES)
        self._message: Any = None
        self._open_transforms()
        self._begin()
        self._model: RobotModel | None = None
        self._description = self._read_description()
        if self._description is None:
            self.subscribe(topics.ROBOT_DESCRIPTION, self._on_description)
        else:
            self._description_publisher = self.publisher(topics.ROBOT_DESCRIPTION)
        self.subscribe(topics.DESCENT_OBSERVATION, self._on_observation)
        self.subscribe(topics.JUMP_PREDICTION, self._on_prediction)
        self.subscribe(topics.ODOMETRY, self._on_odometry)
        self.subscribe(topics.POSE, self._on_pose)
        self.subscribe(topics.WHEEL_STATE, self._on_wheels)
        self.subscribe(topics.JUMP_MOTOR_STATE, self._on_nut)
        self.subscribe(topics.WINCH_STATE, self._on_winch)
        self.subscribe(topics.TRUTH_BODY1, self._on_body1)
        self.subscribe(topics.TRUTH_BODY2, self._on_body2)

    def _open_transforms(self) -> None:
        node = self.port.ros_node
        if node is None:
            return
        # The ROS host alone has a graph for tf.
        from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: PLC0415

        from rover_runtime.ros.interface_packages import InterfacesMissing, load_interfaces  # noqa: PLC0415

        try:
            messages = load_interfaces(
                "tf2_msgs",
                "msg",
                lambda text: self.port.log(Level.OK, text),
                self.check_shutdown,
            )
        except InterfacesMissing as error:
            self.port.log(Level.WARN, NO_TF.format(error))
            return
        self._message = messages.TFMessage
        # Relative names: each namespace has its own tree of frames.
        moving, still = TRANSFORMS
        self._moving = node.create_publisher(self._message, moving, 100)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._still = node.create_publisher(self._message, still, latched)

    def _read_description(self) -> TextSample | None:
        """Return the description that this node publishes."""
        file = self.parameters_of(ViewParameters).description_file
        if not file:
            return None
        try:
            text = read_text(Path(file).expanduser())
            self._model = RobotModel.read(text)
        except OSError as error:
            raise ParameterError(f"description_file: {file_problem(error)}") from None
        except (UnicodeError, DescriptionError) as error:
            raise ParameterError(f"description_file is {file!r}: {error}") from None
        return TextSample(text)

    def start(self) -> None:
        """Start publishing joints and frames."""
        if self._description is not None:
            self._description_publisher.send(self._description)
            self._publish_still()
        rate = self.parameters_of(ViewParameters).frame_rate
        self.every(1.0 / rate, self._publish, by_wall_clock=True)

    def release(self) -> None:
        """Close the topics of tf."""
        for publisher in (self._moving, self._still):
            if publisher is not None:
                self.port.ros_node.destroy_publisher(publisher)
        self._moving = self._still = None

    def clock_jumped(self) -> None:
        """Clear what belongs to another run."""
        self._begin()
        self._wall_publisher.send(self._wall.drawing(self.now_ns()))
        self._jump_publisher.send(DrawingSample(self.now_ns(), ()))

    def _begin(self) -> None:
        self._wall = ObservedWall()
        self._odometry: OdometrySample | None = None
        self._pose: PoseEstimateSample | None = None
        self._body1: OdometrySample | None = None
        self._body2: OdometrySample | None = None
        self._joints: dict[str, JointValue] = {}
        self._measured_ns = self._published_ns = -1
        self._truth_ns = self._estimate_ns = -1

    # --- inputs ----------------------------------------------------------------------------------

    def _on_description(self, sample: TextSample) -> None:
        try:
            self._model = RobotModel.read(sample.text)
        except DescriptionError as error:
            raise Refusal(topics.ROBOT_DESCRIPTION, RefusalCode.BAD_TEXT, str(error)) from None
        self._publish_still()

    def _on_observation(self, sample: JointSample) -> None:
        if self._model is None:
            raise Refusal(
                topics.DESCENT_OBSERVATION,
                RefusalCode.NOT_ACTIVE,
                f"the camera's pose is unknown: no {topics.ROBOT_DESCRIPTION} was received",
            )
        if self._wall.add(sample, self._model):
            self._wall_publisher.send(self._wall.drawing(sample.stamp_ns))

    def _on_prediction(self, sample: JointSample) -> None:
        if self._pose is not None and self._pose.is_known:
            self._jump_publisher.send(prediction_markers(sample, self._pose, self.now_ns()))

    def _on_odometry(self, sample: OdometrySample) -> None:
        self._odometry = sample

    def _on_pose(self, sample: PoseEstimateSample) -> None:
        self._pose = sample

    def _on_body1(self, sample: OdometrySample) -> None:
        is_first, self._body1 = self._body1 is None, sample
        if is_first:
            self._publish_still()

    def _on_body2(self, sample: OdometrySample) -> None:
        self._body2 = sample

    def _on_wheels(self, sample: JointSample) -> None:
        self._set_joints(sample.stamp_ns, sample.joints)

    def _on_nut(self, sample: JointSample) -> None:
        nut = sample.joints[machine.JUMP_SCREW]
        held = JointValue(-nut.position, -nut.velocity) if nut.position > 0.0 else JointValue()
        self._set_joints(sample.stamp_ns, {machine.JUMP_SLIDER: held})

    def _on_winch(self, sample: JointSample) -> None:
        radius = math.nan if self._model is None else self._model.drum_radius
        if radius > 0.0:
            drum = sample.joints[machine.WINCH_DRUM]
            turned = JointValue(drum.position / radius, drum.velocity / radius)
            self._set_joints(sample.stamp_ns, {machine.WINCH_DRUM: turned})

    def _set_joints(self, stamp_ns: int, joints: Mapping[str, JointValue]) -> None:
        self._measured_ns = max(self._measured_ns, stamp_ns)
        self._joints |= {name: JointValue(*value[:2]) for name, value in joints.items()}

    # --- outputs ---------------------------------------------------------------------------------

    def _publish(self) -> None:
        if self._measured_ns != self._published_ns:
            self._published_ns = self._measured_ns
            self._joint_publisher.send(JointSample(self._measured_ns, dict(self._joints)))
            if self._model is not None:
                self._send_frames(self._model.moved(self._positions()), self._measured_ns)
        odometry, pose = self._odometry, self._pose
        if odometry is not None and pose is not None and odometry.stamp_ns == pose.stamp_ns:
            if pose.stamp_ns != self._estimate_ns:
                self._send_frames(estimated_frames(odometry, pose), pose.stamp_ns)
            self._estimate_ns = pose.stamp_ns
        body1 = self._body1
        if body1 is not None and body1.stamp_ns != self._truth_ns:
            self._truth_ns = body1.stamp_ns
            frames = body_frames(body1, self._body2)
            if self._model is not None:
                # Its slider is where the true Body 2 is.
                positions = self._positions()
                positions.pop(machine.JUMP_SLIDER, None)
                frames += [
                    each.named(machine.TRUTH_PREFIX) for each in self._model.moved(positions)
                ]
            self._send_frames(frames, body1.stamp_ns)

    def _positions(self) -> dict[str, float]:
        return {name: value.position for name, value in self._joints.items()}

    def _publish_still(self) -> None:
        """Publish the fixed frames, and where there is ground truth those of the true rover."""
        frames = [] if self._model is None else list(self._model.fixed)
        if self._body1 is not None:
            frames += [each.named(machine.TRUTH_PREFIX) for each in frames]
            frames.append(
                LinkFrame(machine.WORLD_FRAME, machine.TRUTH_PREFIX + machine.WORLD_FRAME)
            )
        if self._still is not None:
            self._still.publish(frames_message(self._message, frames, self.now_ns()))

    def _send_frames(self, frames: Iterable[LinkFrame], stamp_ns: int) -> None:
        if self._moving is not None and self._moving.get_subscription_count():
            self._moving.publish(frames_message(self._message, frames, stamp_ns))


def frames_message(kind: Any, frames: Iterable[LinkFrame], stamp_ns: int) -> Any:
    """Return the frames as a message of tf, whose type is `kind`."""
    transforms = []
    for frame in frames:
        message = TransformStamped()
        message.header.stamp = to_time(stamp_ns)
        message.header.frame_id, message.child_frame_id = frame.parent, frame.child
        translation, rotation = message.transform.translation, message.transform.rotation
        translation.x, translation.y, translation.z = frame.position
        rotation.x, rotation.y, rotation.z, rotation.w = frame.orientation
        transforms.append(message)
    return kind(transforms=transforms)


def main() -> int:
    """Run the node."""
    from rover_runtime.ros.process import run  # noqa: PLC0415 - the loop host needs no ROS

    return run(ViewNode)


if __name__ == "__main__":
    sys.exit(main())
