"""A plain rclpy node for which simulated time waits: it arms the winch and pays out."""

import sys
from contextlib import suppress

import rclpy
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time
from sensor_msgs.msg import JointState

from rover_runtime.ros import middleware
from rover_runtime.ros.participant import Participant


class Pilot:
    """Arms the winch after 0.5 s of simulated time, and pays out to 8 m after 1 s."""

    def __init__(self, participant: Participant) -> None:
        self._participant = participant
        self._is_armed = self._is_requested = False
        participant.subscribe("winch/mode", lambda message: print(message.data, flush=True))
        participant.every(0.05, self._step)

    def _step(self) -> None:
        now_ns = self._participant.now_ns()
        if now_ns >= 500_000_000 and not self._is_armed:
            self._is_armed = self._participant.call("winch/rearm", lambda _success, _text: None)
        if now_ns >= 1_000_000_000 and not self._is_requested:
            self._is_requested = True
            request = JointState(name=["winch_length"], position=[8.0], velocity=[0.2])
            request.effort = [0.0]
            request.header.stamp = Time(nanoseconds=now_ns).to_msg()
            self._participant.publish("winch/request", request)


def main() -> None:
    """Run until Ctrl-C; the argument names the plant."""
    middleware.select_transport()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    participant = Participant(rclpy.create_node("pilot"), *sys.argv[1:2])
    Pilot(participant)
    with suppress(KeyboardInterrupt):
        participant.spin()


if __name__ == "__main__":
    main()
