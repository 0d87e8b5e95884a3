"""Joins a user's plain rclpy node to a lockstep: simulated time waits for it.

``docs/tutorials/plain_node.py`` shows it. The launch argument ``participants`` names the node.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.parameter_client import AsyncParameterClient
from rclpy.serialization import deserialize_message, serialize_message

from msg_schemas.cdr import pack, unpack
from msg_schemas.message_types import message_class
from msg_schemas.samples import Level, Sample
from msg_schemas.table import find_topic
from rover_runtime.component import Component, Publisher
from rover_runtime.ros.foreign_callbacks import guard_foreign_callbacks
from rover_runtime.ros.lockstep import LockstepCarrier, read_processes

_TIMEOUT = 60.0  # until the plant answers; it may have to compile first [s]


class Participant:
    """A node that shares simulated time with a plant and its controllers.

    What it sends and receives through this object is exchanged tick by tick. Its own
    subscriptions, timers and services are served between two ticks.

    Args:
        node: plain rclpy node; the parameter ``lockstep`` of the plant names it.
        plant: name of the node with the source of time, in the same namespace.

    Raises:
        TimeoutError: the plant does not answer.
        ParameterError: the plant's parameter ``lockstep`` is wrong.
        KeyError: it does not name the node.
    """

    def __init__(self, node: Node, plant: str = "sim_node") -> None:
        self._node = node
        self._executor = EventsExecutor(context=node.context)
        self._executor.add_node(node)
        name = node.get_name()
        text, seed = self._read(plant, "lockstep", "delay_seed")
        processes = read_processes(text)
        process = {n: each for each, nodes in processes.items() for n in nodes}[name]
        self._carrier = LockstepCarrier(
            processes, process, seed, node.get_namespace(), secrets.token_hex(4)
        )
        kind = type("PlainNode", (Component,), {"NAME": name})
        self._component = self._carrier.add(node, kind, {}, self._log)
        self._publishers: dict[str, Publisher] = {}
        guard_foreign_callbacks(node, self._component.refuse)

    def _read(self, plant: str, *names: str) -> list[Any]:
        client = AsyncParameterClient(self._node, plant)
        future = None
        if client.wait_for_services(_TIMEOUT):
            future = client.get_parameters(list(names))
            self._executor.spin_until_future_complete(future, _TIMEOUT)
        if future is None or not future.done():
            msg = f"{plant} does not report its parameters within {_TIMEOUT:g} s"
            raise TimeoutError(msg)
        return [rclpy.parameter.parameter_value_to_python(v) for v in future.result().values]

    def _log(self, level: Level, text: str) -> None:
        if level is Level.OK:
            self._node.get_logger().info(text)
        else:
            self._node.get_logger().warning(text)

    def now_ns(self) -> int:
        """Simulated time [ns]."""
        return self._component.now_ns()

    def subscribe(self, topic: str, callback: Callable[[Any], None]) -> None:
        """Call back with the messages of a topic of the contract."""
        kind = message_class(find_topic(topic).message)

        def receive(sample: Sample) -> None:
            callback(deserialize_message(pack(topic, sample), kind))

        self._component.subscribe(topic, receive)

    def publish(self, topic: str, message: Any) -> None:
        """Send a message on a topic of the contract; raises Refusal where it violates it."""
        self.send(topic, unpack(topic, serialize_message(message)))

    def send(self, topic: str, sample: Sample) -> None:
        """Send a sample of the contract; one that violates it is refused and reported."""
        self.open(topic).send(sample)

    def open(self, topic: str) -> Publisher:
        """Open a topic to send to, so that others discover it before the first message."""
        if topic not in self._publishers:
            self._publishers[topic] = self._component.publisher(topic)
        return self._publishers[topic]

    def has_listeners(self, topic: str) -> bool:
        """Whether somebody outside the lockstep receives an open topic, such as a recorder."""
        return self._carrier.is_listened(topic)

    def call(self, service: str, answered: Callable[[bool, str], None]) -> bool:
        """Call a Trigger service; returns whether it has a server."""
        return self._component.call_service(service, answered)

    def every(self, period: float, callback: Callable[[], None]) -> None:
        """Call back with a period of simulated time [s], once the node spins."""
        self._component.every(period, callback)

    def spin(self, is_over: Callable[[], bool] = lambda: False) -> None:
        """Share simulated time until a condition holds, or an exception such as KeyboardInterrupt.

        Then the others go on without the node.
        """
        self._component.configure()
        self._component.activate()
        try:
            context = self._node.context
            self._carrier.spin(self._executor, lambda: is_over() or not context.ok())
        finally:
            self._component.deactivate()
            self._carrier.leave(self._executor)
            self._executor.shutdown()
