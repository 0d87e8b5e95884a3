"""A component of a user's own: arms the winch and pays out, at fixed simulated times."""

import sys

from msg_schemas import machine, topics
from msg_schemas.samples import JointSample, JointValue
from rover_runtime.component import Component

ARM_AT, PAY_OUT_AT = 0.5, 1.0  # simulated time [s]
LENGTH = 8.0  # [m]


class Pilot(Component):
    """Calls a service and sends a request."""

    NAME = "pilot"

    def setup(self) -> None:
        self._request = self.publisher(topics.WINCH_REQUEST)
        self._is_armed = self._is_requested = False
        self.answer = ""

    def start(self) -> None:
        self.every(0.05, self._step)

    def _step(self) -> None:
        now = self.now_ns() * 1e-9
        if now >= ARM_AT and not self._is_armed:
            self._is_armed = self.call_service(topics.WINCH_REARM, self._on_answer)
        if now >= PAY_OUT_AT and not self._is_requested:
            self._is_requested = True
            value = JointValue(LENGTH, 0.2, 0.0)
            self._request.send(JointSample(self.now_ns(), {machine.WINCH_TO_LENGTH: value}))

    def _on_answer(self, success: bool, text: str) -> None:
        self.answer = f"{success}: {text}"


def main() -> int:
    from rover_runtime.ros.process import run

    return run(Pilot)


if __name__ == "__main__":
    sys.exit(main())
