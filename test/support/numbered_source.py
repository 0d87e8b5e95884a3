"""A publisher for recorders under test: ``python -m numbered_source MODE RATE``.

Prints a line for each message: its number, the time [ns], and the number of messages sent so far
while a subscription was matched.
Modes:

* ``contract``: numbered states of the jump motor, now and then a word on the winch's tension
  topic, and a latched configuration, as the contract has them;
* ``batches``: the same, the states also in batches;
* ``second``: the states alone, numbered from ``FIRST_OF_SECOND``;
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
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64, String

from msg_schemas import machine, qos, topics
from msg_schemas.cdr import pack
from msg_schemas.message_types import message_class
from msg_schemas.phases import LoadState
from msg_schemas.samples import JointSample, JointValue, TextSample
from msg_schemas.table import find_topic
from rover_runtime.batches import PERIOD
from rover_runtime.ros.batches import BatchPublisher

SEED = 42
STRANGE_TOPIC = "strange/number"
FIRST_OF_SECOND = 500_000
SLOW_EVERY = 3
_PATIENCE = 3.0
CONFIGURATION = {"node": "/source", "scenario": {"name": "made up"}, "seed": SEED}


def _state(number: int) -> bytes:
    value = JointValue(0.0, 0.0, number * 1e-3)
    sample = JointSample(number * 10_000_000, {machine.JUMP_SCREW: value})
    return pack(topics.JUMP_MOTOR_STATE, sample)


def _contract(node: Any, *, in_batches: bool = False) -> tuple[Any, Callable[[int], None]]:
    batch = BatchPublisher(node) if in_batches else None

    def opened(name: str) -> Any:
        row = find_topic(name)
        return node.create_publisher(message_class(row.message), name, qos.profile(row.intent))

    config, fast = opened(topics.CONFIG), opened(topics.JUMP_MOTOR_STATE)
    slow = opened(topics.TENSION_WATCH)
    config.publish(pack(topics.CONFIG, TextSample(json.dumps(CONFIGURATION))))

    def send(number: int) -> None:
        if batch is not None:
            batch.add(fast.topic_name, _state(number))
        fast.publish(_state(number))
        if number % SLOW_EVERY == 0:
            slow.publish(pack(topics.TENSION_WATCH, TextSample(LoadState.NORMAL)))

    return fast if batch is None else batch.publisher, send


def _batches(node: Any) -> tuple[Any, Callable[[int], None]]:
    return _contract(node, in_batches=True)


def _second(node: Any) -> tuple[Any, Callable[[int], None]]:
    row = find_topic(topics.JUMP_MOTOR_STATE)
    publisher = node.create_publisher(message_class(row.message), row.name, qos.profile(row.intent))
    return publisher, lambda number: publisher.publish(_state(FIRST_OF_SECOND + number))


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
    modes = {
        "contract": _contract,
        "batches": _batches,
        "second": _second,
        "stranger": _stranger,
        "volatile": _volatile,
    }
    mode = sys.argv[1]
    node = rclpy.create_node("source" if mode != "second" else mode)
    publisher, send = modes[mode](node)
    rate = float(sys.argv[2])
    count = delivered = 0
    executor = EventsExecutor()  # for the timer by which batches are sent
    executor.add_node(node)
    while not stop.wait(1.0 / rate):
        executor.spin_once(timeout_sec=0.0)
        count += 1
        send(count)
        delivered += publisher.get_subscription_count() > 0
        print(count, time.time_ns(), delivered, flush=True)
    executor.spin_once(timeout_sec=2.0 * PERIOD)
    # Messages in transit may be lost when their publisher ends, whatever the recorder does.
    publisher.wait_for_all_acked(Duration(seconds=_PATIENCE))
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
