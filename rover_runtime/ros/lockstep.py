"""Lockstep over DDS: carries the components of a process on a loop host that waits for the others.

Every message is published on its topic as ever, so that recorders, pages and operators see it. The
processes also exchange reports (``rover_runtime.lockstep``), signs of life and exclusions, as JSON
texts on topics of their own.
"""

from __future__ import annotations

import json
import time
import zlib
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.executors import Executor
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from msg_schemas import qos
from msg_schemas.access import LOCKSTEP, Act
from msg_schemas.cdr import pack
from msg_schemas.events import EventReport, NodeEvent
from msg_schemas.message_types import message_class
from msg_schemas.parameters import ParameterError
from msg_schemas.refusal import Refusal
from msg_schemas.samples import Level
from msg_schemas.table import SERVICES, TOPICS, Intent
from rover_runtime.admission import read_message
from rover_runtime.component import Component, Groups
from rover_runtime.delays import Delays
from rover_runtime.lockstep import LockstepProcess, Report
from rover_runtime.loop_host import LoopHost
from rover_runtime.loop_port import LoopPort
from rover_runtime.port import Message
from rover_runtime.ros.endpoint_matching import matched_subscribers
from rover_runtime.ros.scheduling import reset_thread_priority

if TYPE_CHECKING:
    from rover_runtime.ros.node import ComponentNode

REPORTS, ALIVE, EXCLUDED = LOCKSTEP

_QUEUE_DEPTH = 1000  # messages
_LATCHED_DEPTH = 10  # a phase may change more than once before it is taken
_ALIVE_PERIOD = 0.2  # [s]
_ALIVE_TIMEOUT = 2.0  # without a sign of life time waits no longer [s]
_SPIN_SLICE = 0.1  # [s]
_MAX_MESSAGES_AT_ONCE = 100


def read_processes(text: str) -> dict[str, tuple[str, ...]]:
    """Return the nodes of each process.

    Args:
        text: ``sim_node,winch_node`` or ``plant=sim_node,mother_nodes=winch_node+descent_node``.

    Raises:
        ParameterError: a name is missing or repeated.
    """
    found: dict[str, tuple[str, ...]] = {}
    for part in text.split(","):
        name, _, nodes = part.strip().partition("=")
        found[name] = tuple((nodes or name).split("+"))
    names = [node for nodes in found.values() for node in nodes]
    if not all(names) or len(set(names)) < len(names) or len(found) < text.count(",") + 1:
        msg = f"lockstep is {text!r}: should be PROCESS=NODE+NODE,..., each name once"
        raise ParameterError(msg)
    return found


@dataclass
class _Peer:
    """Another process, as its last sign of life shows it."""

    token: str
    is_ready: bool
    is_member: bool
    subscribes: Mapping[str, str]  # node by topic
    serves: tuple[str, ...]
    node: str
    at: float  # wall time [s]


class LockstepCarrier:
    """Carries the components of this process; the ``Network`` of its ``LockstepProcess``.

    Args:
        processes: nodes of each process, in the order in which they receive.
        name: of this process.
        seed: of the delays.
        namespace: of the nodes.
        token: text that no other instance of the process has.
    """

    def __init__(
        self,
        processes: Mapping[str, tuple[str, ...]],
        name: str,
        seed: int,
        namespace: str,
        token: str,
    ) -> None:
        order = [node for nodes in processes.values() for node in nodes]
        self.host = LoopHost(Delays(seed), order=order, namespace=namespace.rstrip("/"))
        self.host.executor = ThreadPoolExecutor(1, "work", reset_thread_priority)
        self.host.log = self._log
        self.process = LockstepProcess(name, self.host, self)
        self._processes = processes
        self._name = name
        self._token = token
        self._nodes: dict[str, ComponentNode] = {}
        self._publishers: dict[str, dict[str, Any]] = {}  # by topic and component
        self._subscribers: dict[str, str] = {}  # node by topic
        self._served: dict[str, Any] = {}
        self._peers: dict[str, _Peer] = {}
        self._shared: dict[str, Any] = {}  # publishers of the lockstep's own topics
        self._is_ready = False
        self._next_at = 0.0  # wall time of the next tick [s]

    # --- components ------------------------------------------------------------------------------

    def add(
        self, node: ComponentNode, component_class: type[Component], groups: Groups
    ) -> Component:
        """Carry a component that a node shows in the graph."""
        self._nodes[component_class.NAME] = node
        if not self._shared:
            self._open_shared(node)
        return self.host.add(component_class, groups, node)

    def _open_shared(self, node: ComponentNode) -> None:
        profile = QoSProfile(depth=_QUEUE_DEPTH)
        for name, receive in (
            (REPORTS, self._on_report),
            (ALIVE, self._on_alive),
            (EXCLUDED, self._on_excluded),
        ):
            self._shared[name] = node.create_publisher(String, name, profile)
            node.create_subscription(String, name, receive, profile)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(_ALIVE_PERIOD, self._send_alive, clock=steady)

    def _log(self, name: str, level: Level, text: str) -> None:
        if name in self._nodes:
            self._nodes[name].log(level, text)

    # --- Network ---------------------------------------------------------------------------------

    def open(self, act: Act, port: LoopPort, name: str) -> None:
        """Create the publisher, subscription or service of a component."""
        node = self._nodes[port.name]
        if act is Act.PUBLISH and port.name not in self._publishers.setdefault(name, {}):
            row = TOPICS[name]
            depth = _LATCHED_DEPTH if row.intent is Intent.LATCHED else None
            self._publishers[name][port.name] = node.create_publisher(
                message_class(row.message), name, qos.profile(row.intent, depth)
            )
        elif act is Act.SUBSCRIBE and name not in self._subscribers:
            self._subscribers[name] = port.name
            self._subscribe(node, name)
        elif act is Act.SERVE and name not in self._served:
            kind = message_class(SERVICES[name].service)
            self._served[name] = node.create_service(kind, name, partial(self._on_request, name))
        self._is_ready = False

    def _subscribe(self, node: ComponentNode, name: str) -> None:
        row, kind = TOPICS[name], message_class(TOPICS[name].message)

        def receive(data: bytes) -> None:
            if self.host.is_subscribed(name):
                self.process.on_message(name, _digest(data), read_message(row, data))

        def on_message(data: bytes) -> None:
            receive(data)
            for _ in range(_MAX_MESSAGES_AT_ONCE):
                with subscription.handle:
                    taken = subscription.handle.take_message(kind, True)
                if taken is None:
                    return
                receive(taken[0])

        subscription = node.create_subscription(
            kind, name, on_message, qos.profile(row.intent, _QUEUE_DEPTH), raw=True
        )

    def _on_request(self, service: str, request: Any, response: Any) -> Any:
        """Answer a request from outside, between two ticks."""
        arguments = (bool(request.data),) if hasattr(request, "data") else ()
        response.success, response.message = self.host.answer(service, arguments)
        return response

    def publish(self, component: str, topic: str, message: Message) -> int:
        """Publish a message on its topic; returns the digest of its bytes."""
        assert not isinstance(message.content, Refusal)
        data = pack(topic, message.content, message.sender)
        self._publishers[topic][component].publish(data)
        return _digest(data)

    def report(self, report: Report) -> None:
        """Publish a report."""
        self._shared[REPORTS].publish(String(data=report.to_json()))

    def is_received(self, topic: str) -> bool:
        """Whether somebody outside this process receives a topic."""
        own = topic in self._subscribers
        publishers = self._publishers.get(topic, {}).values()
        return any(each.get_subscription_count() > own for each in publishers)

    def is_served(self, service: str) -> bool:
        """Whether a member serves a service."""
        return any(
            service in peer.serves for name, peer in self._peers.items()
            if name in self.process.members
        )  # fmt: skip

    # --- what the others send --------------------------------------------------------------------

    def _on_report(self, message: String) -> None:
        report = Report.from_json(message.data)
        if report.process != self._name:
            self.process.on_report(report)

    def _on_excluded(self, message: String) -> None:
        process, token = message.data.split()
        if process != self._name or token == self._token:
            self.process.exclude(process)

    def _on_alive(self, message: String) -> None:
        given = json.loads(message.data)
        name = str(given.pop("process"))
        if name == self._name or name not in self._processes:
            return
        peer = _Peer(**given, at=time.monotonic())
        before = self._peers.get(name)
        self._peers[name] = peer
        if before is None or before.token != peer.token:
            self._is_ready = False
        if not self.host.has_source or not self.process.is_member:
            return
        members = self.process.members
        if before is not None and before.token != peer.token and name in members:
            self._exclude(name, before.token, "its process was started again")
        elif name not in members and peer.is_ready and not peer.is_member:
            self.process.invite(name)
            text = f"simulated time waits for {name} again"
            self._event(NodeEvent.PARTICIPANT_JOINED, text, {"process": name})

    def _send_alive(self) -> None:
        if not self._is_ready:
            self._is_ready = self._is_matched()
        content = {
            "process": self._name,
            "token": self._token,
            "is_ready": self._is_ready,
            "is_member": self.process.is_member,
            "subscribes": self._subscribers,
            "serves": tuple(self._served),
            "node": next(iter(self._nodes)),
        }
        self._shared[ALIVE].publish(String(data=json.dumps(content)))

    def _is_matched(self) -> bool:
        """Whether all other processes receive what this one publishes."""
        if self._processes.keys() - {self._name} - self._peers.keys():
            return False
        for publisher in self._shared.values():
            if not self._reaches(publisher, (peer.node for peer in self._peers.values())):
                return False
        return all(
            self._reaches(
                publisher,
                (p.subscribes[topic] for p in self._peers.values() if topic in p.subscribes),
            )
            for topic, publishers in self._publishers.items()
            for publisher in publishers.values()
        )

    def _reaches(self, publisher: Any, nodes: Iterable[str]) -> bool:
        node = next(iter(self._nodes.values()))
        expected = set(nodes)
        return not expected or expected <= {
            name for name, _ in matched_subscribers(node, publisher)
        }

    # --- ticks -----------------------------------------------------------------------------------

    def spin(self, executor: Executor, is_over: Callable[[], bool]) -> None:
        """Run ticks and serve the graph until a condition holds."""
        while not is_over():
            executor.spin_once(timeout_sec=min(self._advance(), _SPIN_SLICE))

    def _advance(self) -> float:
        """Run the next tick if it may run; returns the wall time to wait for messages [s]."""
        if not self.process.is_member:
            if self.host.has_source and self._is_ready and self._all_ready():
                self.process.begin(self._processes)
            return _SPIN_SLICE
        if self.host.has_source:
            now = time.monotonic()
            if now < self._next_at:
                return self._next_at - now
            if self.process.run_tick():
                now = time.monotonic()
                self._next_at = now + self.host.pace(now)
                return 0.0
            self._exclude_silent(now)
        elif self.process.run_tick():
            return 0.0
        return _SPIN_SLICE

    def _all_ready(self) -> bool:
        return all(
            name in self._peers and self._peers[name].is_ready
            for name in self._processes
            if name != self._name
        )

    def _exclude_silent(self, now: float) -> None:
        for name in self.process.missing():
            peer = self._peers.get(name)
            if peer is not None and now - peer.at > _ALIVE_TIMEOUT:
                reason = f"no sign of life for {now - peer.at:.1f} s"
                self._exclude(name, peer.token, reason)

    def _exclude(self, name: str, token: str, reason: str) -> None:
        self.process.exclude(name)
        self._shared[EXCLUDED].publish(String(data=f"{name} {token}"))
        text = f"simulated time waits for {name} no longer: {reason}"
        self._event(NodeEvent.PARTICIPANT_EXCLUDED, text, {"process": name})

    def _event(self, name: NodeEvent, text: str, values: Mapping[str, str]) -> None:
        component = self.host[next(iter(self._nodes))]
        component.event(EventReport(name, text, dict(values)), diagnoses=True)

    def leave(self) -> None:
        """Tell the others not to wait for this process, which ends."""
        self._shared[EXCLUDED].publish(String(data=f"{self._name} {self._token}"))
        self.process.exclude(self._name)


def _digest(data: bytes) -> int:
    """Return the digest of a message's bytes; the middleware may append zeros."""
    return zlib.crc32(data.rstrip(b"\0"))
