"""A node that answers each winch state at once with a command of the same stamp.

The motor holds the load with the brake open: the fastest loop that a controller can make.
``python -m rover_verify.harness.answerer``
"""

from __future__ import annotations

import sys

from msg_schemas import machine, topics
from msg_schemas.samples import JointSample, JointValue
from rover_runtime.component import Component
from rover_runtime.ros.process import run

_CARRIED = 16.2  # load held by the motor [N]
_LIMIT = 100.0  # [N]


class Answerer(Component):
    """Holds the drum with its motor, and answers every state."""

    NAME = "answerer"

    def setup(self) -> None:
        """Open both topics."""
        self._publisher = self.publisher(topics.WINCH_COMMAND)
        self.subscribe(topics.WINCH_STATE, self._answer)

    def _answer(self, state: JointSample) -> None:
        joints = {
            machine.WINCH_DRUM: JointValue(
                state.joints[machine.WINCH_DRUM].position, 0.0, _CARRIED
            ),
            machine.WINCH_BRAKE: JointValue(1.0),
            machine.WINCH_LIMIT: JointValue(0.0, 0.0, _LIMIT),
        }
        self._publisher.send(JointSample(state.stamp_ns, joints))


if __name__ == "__main__":
    sys.exit(run(Answerer))
