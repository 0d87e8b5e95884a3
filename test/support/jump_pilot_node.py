"""A component that sets the rover's pose and requests jumps' predictions, at simulated times."""

import sys

from msg_schemas import machine, topics
from msg_schemas.samples import IDENTITY, ZERO, JointSample, JointValue, PoseEstimateSample
from rover_runtime.component import Component

POSE_SET_AT = 1.0  # simulated time [s]
REQUESTED_AT = (2.0, 7.0, 12.0)  # simulated time [s]
CLEARANCE = 0.12  # [m]


class JumpPilot(Component):
    """Sends requests."""

    NAME = "jump_pilot"

    def setup(self) -> None:
        self._request = self.publisher(topics.JUMP_REQUEST)
        self._left = list(REQUESTED_AT)
        self._pose = self.publisher(topics.DRIVE_START)
        self._is_placed = False

    def start(self) -> None:
        self.every(0.05, self._step)

    def _step(self) -> None:
        if not self._is_placed and self.now_ns() * 1e-9 >= POSE_SET_AT:
            self._is_placed = True
            self._pose.send(PoseEstimateSample(self.now_ns(), ZERO, IDENTITY))
        if self._left and self.now_ns() * 1e-9 >= self._left[0]:
            self._left.pop(0)
            joints = {machine.JUMP_PREDICTION: JointValue(CLEARANCE)}
            self._request.send(JointSample(self.now_ns(), joints))


def main() -> int:
    from rover_runtime.ros.process import run

    return run(JumpPilot)


if __name__ == "__main__":
    sys.exit(main())
