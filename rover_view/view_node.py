"""The ``view_node`` executable: publishes link frames, the observed wall and predicted jumps."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from geometry_msgs.msg import TransformStamped

from msg_schemas import topics
from msg_schemas.access import TRANSFORMS
from msg_schemas.message_types import to_time
from msg_schemas.parameters import parameter
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample, JointValue, Level, OdometrySample, TextSample
from msg_schemas.table import WHEEL_LEFT, WHEEL_RIGHT, WINCH_DRUM
from rover_runtime.component import Component
from rover_view.observed_wall import ObservedWall
from rover_view.predicted_jump import prediction_markers
from rover_view.robot_model import DescriptionError, LinkFrame, RobotModel

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # not among the wheels on PyPI; a sourced ROS 2 has it
    TFMessage = None

NO_TF = (
    "no tf: tf2_msgs cannot be imported (install ros-jazzy-tf2-msgs); viewers show the markers, "
    "but no robot model"
)
_NOTHING = JointValue()


@dataclass(frozen=True)
class ViewParameters:
    """Publishing rate of the frames."""

    frame_rate: float = parameter(
        30.0, "Hz", "publishing rate of the moving frames", 1.0, 100.0, read_only=True
    )


class ViewNode(Component):
    """Publishes link frames, and markers of the observed wall and of predicted jumps."""

    NAME = "view_node"
    PARAMETERS = (ViewParameters,)

    def setup(self) -> None:
        """Open topics; without tf2_msgs, log a warning and publish the markers only."""
        self._model: RobotModel | None = None
        self._wall = ObservedWall()
        self._wall_publisher = self.publisher(topics.OBSERVED_WALL)
        self._jump_publisher = self.publisher(topics.PREDICTED_JUMP)
        self._body1: OdometrySample | None = None
        self._body2: OdometrySample | None = None
        self._wheels: tuple[float, float] = (0.0, 0.0)
        self._length: float | None = None
        self._published_ns = -1
        self._moving: Any = None
        self._still: Any = None
        self.subscribe(topics.ROBOT_DESCRIPTION, self._on_description)
        self.subscribe(topics.DESCENT_OBSERVATION, self._on_observation)
        self.subscribe(topics.TRUTH_BODY1, self._on_body1)
        self.subscribe(topics.JUMP_PREDICTION, self._on_prediction)
        node = self.port.ros_node
        if node is None:
            return
        if TFMessage is None:
            self.port.log(Level.WARN, NO_TF)
            return
        from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: PLC0415 - here is ROS

        # Relative names: each namespace has its own tree of frames.
        moving, still = TRANSFORMS
        self._moving = node.create_publisher(TFMessage, moving, 100)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._still = node.create_publisher(TFMessage, still, latched)
        self.subscribe(topics.TRUTH_BODY2, self._on_body2)
        self.subscribe(topics.WHEEL_STATE, self._on_wheels)
        self.subscribe(topics.WINCH_STATE, self._on_winch)

    def start(self) -> None:
        """Start publishing frames."""
        if self._moving is not None:
            rate = self.parameters_of(ViewParameters).frame_rate
            self.every(1.0 / rate, self._publish_frames, by_wall_clock=True)

    def clock_jumped(self) -> None:
        """Clear the images, which belong to another run."""
        self._published_ns = -1
        self._wall = ObservedWall()
        self._wall_publisher.send(self._wall.drawing(self.now_ns()))

    def _on_description(self, sample: TextSample) -> None:
        try:
            self._model = RobotModel.read(sample.text)
        except DescriptionError as error:
            raise Refusal(topics.ROBOT_DESCRIPTION, RefusalCode.BAD_TEXT, str(error)) from None
        if self._still is not None:
            self._still.publish(frames_message(self._model.fixed, self.now_ns()))

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
        # With hardware there is no ground truth, so the rover's position is unknown.
        if self._body1 is not None:
            self._jump_publisher.send(prediction_markers(sample, self._body1, self.now_ns()))

    def _on_body1(self, sample: OdometrySample) -> None:
        self._body1 = sample

    def _on_body2(self, sample: OdometrySample) -> None:
        self._body2 = sample

    def _on_wheels(self, sample: JointSample) -> None:
        joints = sample.joints
        self._wheels = (joints[WHEEL_LEFT].position, joints[WHEEL_RIGHT].position)

    def _on_winch(self, sample: JointSample) -> None:
        self._length = sample.joints[WINCH_DRUM].position

    def _publish_frames(self) -> None:
        model, body = self._model, self._body1
        if model is None or body is None or body.stamp_ns == self._published_ns:
            return
        self._published_ns = body.stamp_ns
        frames = [*model.bodies(body, self._body2), *model.wheels(*self._wheels)]
        if self._length is not None:
            frames += model.drum(self._length)
        self._moving.publish(frames_message(frames, body.stamp_ns))


def frames_message(frames: Iterable[LinkFrame], stamp_ns: int) -> Any:
    """Return the frames as a message of tf."""
    transforms = []
    for frame in frames:
        message = TransformStamped()
        message.header.stamp = to_time(stamp_ns)
        message.header.frame_id, message.child_frame_id = frame.parent, frame.child
        translation, rotation = message.transform.translation, message.transform.rotation
        translation.x, translation.y, translation.z = frame.position
        rotation.x, rotation.y, rotation.z, rotation.w = frame.orientation
        transforms.append(message)
    return TFMessage(transforms=transforms)


def main() -> int:
    """Run the node."""
    from rover_runtime.ros.process import run  # noqa: PLC0415 - the loop host needs no ROS

    return run(ViewNode)


if __name__ == "__main__":
    sys.exit(main())
