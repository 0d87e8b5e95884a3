"""A plain rclpy node that lowers the rover by the topics `descent/request` and `commands`."""

import sys
import time
from contextlib import suppress

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from sensor_msgs.msg import JointState

from rover_runtime.ros import middleware

# Sender and identifier, which the record repeats; `commands` also brings records of earlier runs.
NAME = f"lowering#{time.time_ns()}"
OVER = ("refused", "done", "failed", "superseded", "expired")


class Lowering(Node):
    """Sends one request once its node is there, and prints the course of its record."""

    def __init__(self, depth: float) -> None:
        super().__init__("lowering")
        self.ended: Future = Future()
        self._request = JointState(name=["plain_stop"], position=[depth], velocity=[0.0])
        self._request.effort = [0.0]
        self._request.header.frame_id = NAME
        self._publisher = self.create_publisher(JointState, "descent/request", 10)
        latched = QoSProfile(depth=200, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(DiagnosticArray, "commands", self._on_commands, latched)
        self._timer = self.create_timer(0.1, self._send)

    def _send(self) -> None:
        if self._publisher.get_subscription_count() and self.count_publishers("commands"):
            self._publisher.publish(self._request)
            self._timer.cancel()

    def _on_commands(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {each.key: each.value for each in status.values}
            if f"{values['sender']}#{values['id']}" == NAME:
                print(f"{values['state']}: {status.message} {values['progress']}", flush=True)
                if values["state"] in OVER and not self.ended.done():
                    self.ended.set_result(values["state"])


def main() -> None:
    """Descend to the depth that the argument gives [m]."""
    middleware.select_transport()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Lowering(float(sys.argv[1]))
    with suppress(KeyboardInterrupt):
        rclpy.spin_until_future_complete(node, node.ended)


if __name__ == "__main__":
    main()
