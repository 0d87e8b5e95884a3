"""A publisher for recorders under test: ``python -m numbered_source MODE RATE``.

Prints a line for each message: its number, the time [ns], and the number of messages sent so far
while a subscription was matched.
Modes:

* ``contract``: numbered states of the jump motor, now and then a word on the winch's tension
  topic, and a latched configuration, as the contract has them;
* ``stranger``: a topic outside the contract, best effort;
* ``volatile``: a latched topic of the contract, published without latching.
"""

import json
import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64, String

from msg_schemas import qos, topics
from msg_schemas.cdr import pack
from msg_schemas.message_types import message_class
from msg_schemas.phases import LoadState
from msg_schemas.samples import JointSample, JointValue, TextSample
from msg_schemas.table import JUMP_SCREW, find_topic

SEED = 42
STRANGE_TOPIC = "strange/number"
SLOW_EVERY = 3
_PATIENCE = 3.0
CONFIGURATION = {"node": "/source", "scenario": {"name": "made up"}, "seed": SEED}


def _contract(node: Any) -> tuple[Any, Callable[[int], None]]:
    def opened(name: str) -> Any:
        row = find_topic(name)
        return node.create_publisher(message_class(row.message), name, qos.profile(row.intent))

    config, fast = opened(topics.CONFIG), opened(topics.JUMP_MOTOR_STATE)
    slow = opened(topics.TENSION_WATCH)
    config.publish(pack(topics.CONFIG, TextSample(json.dumps(CONFIGURATION))))

    def send(number: int) -> None:
        value = JointValue(0.0, 0.0, number * 1e-3)
        sample = JointSample(number * 10_000_000, {JUMP_SCREW: value})
        fast.publish(pack(topics.JUMP_MOTOR_STATE, sample))
        if number % SLOW_EVERY == 0:
            slow.publish(pack(topics.TENSION_WATCH, TextSample(LoadState.NORMAL)))

    return fast, send


def _stranger(node: Any) -> tuple[Any, Callable[[int], None]]:
    weak = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
    publisher = node.create_publisher(Float64, STRANGE_TOPIC, weak)
    return publisher, lambda number: publisher.publish(Float64(data=float(number)))


def _volatile(node: Any) -> tuple[Any, Callable[[int], None]]:
    publisher = node.create_publisher(String, topics.TENSION_WATCH, 5)
    return publisher, lambda _: publisher.publish(String(data="slack"))


def main() -> None:
    """Publish until SIGINT or SIGTERM."""
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("source")
    modes = {"contract": _contract, "stranger": _stranger, "volatile": _volatile}
    publisher, send = modes[sys.argv[1]](node)
    rate = float(sys.argv[2])
    count = delivered = 0
    while not stop.wait(1.0 / rate):
        count += 1
        send(count)
        delivered += publisher.get_subscription_count() > 0
        print(count, time.time_ns(), delivered, flush=True)
    # Messages in transit may be lost when their publisher ends, whatever the recorder does.
    publisher.wait_for_all_acked(Duration(seconds=_PATIENCE))
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
