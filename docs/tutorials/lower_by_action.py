"""A plain rclpy node that lowers the rover by the action `descend`; Ctrl-C holds it."""

import sys

import rclpy
from rclpy.action.client import ActionClient
from rclpy.signals import SignalHandlerOptions

from rover_runtime.ros import middleware
from rover_runtime.ros.interface_packages import load_interfaces

# Where the package is installed: from mother_rover_interfaces.action import Descend
Descend = load_interfaces("mother_rover_interfaces", "action", print).Descend


def main() -> None:
    """Descend to the depth that the argument gives [m]."""
    middleware.select_transport()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("lowering")
    client = ActionClient(node, Descend, "descend")
    client.wait_for_server()
    sent = client.send_goal_async(
        Descend.Goal(depth=float(sys.argv[1])),
        lambda message: print(f"{message.feedback.text}: {message.feedback.progress:g}"),
    )
    rclpy.spin_until_future_complete(node, sent)
    ended = sent.result().get_result_async()
    try:
        rclpy.spin_until_future_complete(node, ended)
    except KeyboardInterrupt:
        sent.result().cancel_goal_async()
        rclpy.spin_until_future_complete(node, ended)
    result = ended.result().result
    print(f"{result.state}: {result.text}", flush=True)


if __name__ == "__main__":
    main()
