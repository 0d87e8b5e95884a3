"""A plain node in lockstep that sends commands: simulated time waits for it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping

import rclpy
from rclpy.context import Context

from msg_schemas.samples import JointSample, JointValue
from rover_runtime.ros.participant import Participant

Commands = Mapping[str, Mapping[str, JointValue]]
"""Joints by topic."""


class CommandSource:
    """Sends commands periodically, in a thread of its own, until it is closed.

    Args:
        domain: ROS domain identifier.
        plant: node with the source of time, whose parameter ``lockstep`` names ``NAME``.
        period: between two commands, in simulated time [s].
        commands: returns what is sent now.
        opened: topics that are opened before the first command.

    Attributes:
        is_listened: set once somebody outside the lockstep receives all opened topics.
    """

    NAME = "commanding"

    def __init__(
        self,
        domain: int,
        plant: str,
        period: float,
        commands: Callable[[], Commands],
        opened: Iterable[str] = (),
    ) -> None:
        self._plant, self._period, self._commands = plant, period, commands
        self._opened = tuple(opened)
        self._context = Context()
        rclpy.init(args=[], context=self._context, domain_id=domain)
        self.is_listened = threading.Event()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=self.NAME)
        self._thread.start()

    def _run(self) -> None:
        node = rclpy.create_node(self.NAME, context=self._context)
        participant = Participant(node, self._plant)

        def send() -> None:
            for name, joints in self._commands().items():
                participant.send(name, JointSample(participant.now_ns(), dict(joints)))
            if all(map(participant.has_listeners, self._opened)):
                self.is_listened.set()

        for name in self._opened:
            participant.open(name)
        participant.every(self._period, send)
        participant.spin(self._stopping.is_set)
        node.destroy_node()

    def close(self) -> None:
        """Leave the lockstep and the graph."""
        self._stopping.set()
        self._thread.join()
        self._context.try_shutdown()
