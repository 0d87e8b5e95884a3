"""A node that observes processes: it subscribes, publishes and calls by the contract.

It has its own rclpy context in the ROS domain of the observed processes, and spins in its own
thread. It waits for conditions with a timeout, without fixed delays.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import NodeNameNonExistentError
from rclpy.parameter import Parameter

from msg_schemas import qos, topics
from msg_schemas.access import ACCESS, ALL
from msg_schemas.cdr import pack, unpack
from msg_schemas.commands import CommandRecord, CommandState, read_command
from msg_schemas.events import EventName
from msg_schemas.health import Health, read_health
from msg_schemas.message_types import message_class
from msg_schemas.phases import HealthState
from msg_schemas.refusal import read_refusal
from msg_schemas.samples import JointSample, JointValue, Sample, Status, StatusSample
from msg_schemas.table import SERVICES, find_topic
from rover_runtime.ros import middleware
from rover_runtime.ros.endpoint_matching import EndpointMatching, matched_subscribers
from rover_verify.harness.processes import DEFAULT_TIMEOUT, ros_arguments

TRANSITIONS = {
    "configure": Transition.TRANSITION_CONFIGURE,
    "activate": Transition.TRANSITION_ACTIVATE,
    "deactivate": Transition.TRANSITION_DEACTIVATE,
    "cleanup": Transition.TRANSITION_CLEANUP,
}

# Nodes that only record: they receive no commands.
_SUBSCRIBES_ALL = frozenset(name for name, row in ACCESS.items() if row.subscribes == ALL)

_QUEUE_DEPTH = 5000
_number = itertools.count()


class Feed:
    """All samples of one topic since the start of its subscription."""

    def __init__(self, name: str, changed: threading.Condition) -> None:
        self.name = name
        self._changed = changed
        self._samples: list[Any] = []

    def add(self, sample: Any) -> None:
        """Append a sample and notify waiting threads."""
        with self._changed:
            self._samples.append(sample)
            self._changed.notify_all()

    @property
    def samples(self) -> list[Any]:
        """A copy of the samples received so far."""
        with self._changed:
            return list(self._samples)

    @property
    def last(self) -> Any:
        """The newest sample; None = no sample."""
        with self._changed:
            return self._samples[-1] if self._samples else None

    def __len__(self) -> int:
        with self._changed:
            return len(self._samples)

    def wait(
        self,
        predicate: Callable[[Any], bool] = lambda _: True,
        since: int = 0,
        timeout: float = DEFAULT_TIMEOUT,
    ) -> Any:
        """Wait for a sample that fulfils the predicate, from index ``since`` on; return it."""
        index, found = since, False

        def is_found() -> bool:
            nonlocal index, found
            while not found and index < len(self._samples):
                found = predicate(self._samples[index])
                index += not found
            return found

        with self._changed:
            if not self._changed.wait_for(is_found, timeout):
                last = self._samples[-9:] or "nothing"
                raise AssertionError(
                    f"{self.name}: none of {len(self._samples) - since} samples matches "
                    f"within {timeout:g} s; the last: {last}"
                )
            return self._samples[index]

    def wait_for_count(self, count: int, timeout: float = DEFAULT_TIMEOUT) -> list[Any]:
        """Wait until a number of samples has been received in total; return them."""
        with self._changed:
            assert self._changed.wait_for(lambda: len(self._samples) >= count, timeout), (
                f"{self.name}: {len(self._samples)} samples within {timeout:g} s, not {count}"
            )
            return list(self._samples)


class Observer:
    """Subscribes, publishes and calls in one ROS domain and namespace."""

    def __init__(
        self, domain: int, namespace: str = "", remap: Mapping[str, str] | None = None
    ) -> None:
        self._context = Context()
        middleware.select_transport()
        rclpy.init(args=[], context=self._context, domain_id=domain)
        self.node = rclpy.create_node(
            f"observer_{next(_number)}",
            namespace=namespace,
            context=self._context,
            cli_args=ros_arguments(remap=remap),
            use_global_arguments=False,
        )
        self._changed = threading.Condition()
        self._feeds: dict[str, Feed] = {}
        self._reporting: set[str] = set()  # names of the nodes whose diagnostics were received
        self._publishers: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}
        self._matched_graph: dict[str, tuple[int, int]] = {}  # graph at the match of each publisher
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._spin, name="observer", daemon=True)
        self._thread.start()
        for name in (topics.COMMANDS, topics.EVENTS, topics.DIAGNOSTICS):
            self.listen(name)

    def _spin(self) -> None:
        while not self._stopping.is_set():
            try:
                self._executor.spin_once(timeout_sec=0.1)
            except ExternalShutdownException:
                return

    def close(self) -> None:
        """Leave the graph and release all resources."""
        self._stopping.set()
        self._executor.wake()
        self._thread.join(10.0)
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    # --- subscriptions ---------------------------------------------------------------------------

    def listen(self, name: str) -> Feed:
        """Collect the samples of a topic from now on, and latched ones; one feed per topic."""
        if name not in self._feeds:
            row = find_topic(name)
            feed = Feed(name, self._changed)

            def on_message(data: bytes) -> None:
                sample = unpack(name, data)
                if name == topics.DIAGNOSTICS:
                    self._reporting.update(status.hardware_id for status in sample.statuses)
                feed.add(sample)

            profile = qos.profile(row.intent, _QUEUE_DEPTH)
            self.node.create_subscription(
                message_class(row.message), name, on_message, profile, raw=True
            )
            self._feeds[name] = feed
            self._executor.wake()
        return self._feeds[name]

    def wait_for_text(self, name: str, *words: str, since: int = 0) -> str:
        """Wait until a text topic has one of these texts."""
        return str(self.listen(name).wait(lambda s: s.text in words, since).text)

    def wait_for_status(
        self, name: str, matches: Callable[[Status], bool], since: int = 0
    ) -> Status:
        """Wait for a matching status (of events, diagnostics or sim status)."""
        found: list[Status] = []

        def find(sample: StatusSample) -> bool:
            found[:] = [status for status in sample.statuses if matches(status)]
            return bool(found)

        self.listen(name).wait(find, since)
        return found[0]

    def events(self, *names: str, since: int = 0) -> list[Status]:
        """Received events with one of these names, from a number of samples on."""
        samples = self.listen(topics.EVENTS).samples[since:]
        return [status for sample in samples for status in sample.statuses if status.name in names]

    def wait_for_event(self, name: EventName, since: int = 0, **values: str) -> Status:
        """Wait for an event by name and some of its values."""
        return self.wait_for_status(
            topics.EVENTS, lambda s: s.name == name and values.items() <= s.values.items(), since
        )

    def wait_for_command(
        self, subject: str, *states: CommandState, sender: str | None = None, since: int = 0
    ) -> CommandRecord:
        """Wait for the record of a command in one of these states, or in any one without them."""

        def look(status: Status) -> bool:
            record = read_command(status)
            return (
                record is not None
                and record.subject == subject
                and sender in (None, record.sender)
                and (not states or record.state in states)
            )

        found = read_command(self.wait_for_status(topics.COMMANDS, look, since))
        assert found is not None
        return found

    def wait_for_refusal(self, subject: str, code: str, since: int = 0) -> Status:
        """Wait for the refusal of a subject for a reason in the diagnostics."""

        def look(status: Status) -> bool:
            refusal = read_refusal(status)
            return refusal is not None and (refusal.subject, refusal.code) == (subject, code)

        return self.wait_for_status(topics.DIAGNOSTICS, look, since)

    def wait_until_ready(self, node_name: str, since: int = 0) -> None:
        """Wait until a node's health reports it as ready."""
        ready = Health(node_name, HealthState.READY)
        self.wait_for_status(topics.DIAGNOSTICS, lambda s: read_health(s) == ready, since)

    def time_ns(self) -> int:
        """Simulated time as last received [ns]."""
        last = self.listen(topics.CLOCK).last
        return 0 if last is None else int(last.stamp_ns)

    def wait_for_time(self, stamp_ns: int) -> int:
        """Wait for a simulated time; returns the time reached [ns]."""
        clock = self.listen(topics.CLOCK)
        return int(clock.wait(lambda s: s.stamp_ns >= stamp_ns, max(0, len(clock) - 1)).stamp_ns)

    # --- publishing ------------------------------------------------------------------------------

    def publisher(self, name: str) -> Any:
        """Return a raw publisher that is matched with its receivers and all other subscribers."""
        if name not in self._publishers:
            row = find_topic(name)
            self._publishers[name] = self.node.create_publisher(
                message_class(row.message), name, qos.profile(row.intent)
            )
        made = self._publishers[name]
        self.wait_until(lambda: self._reaches_receivers(name), f"{name} has no receiver")
        return made

    def _reaches_receivers(self, name: str) -> bool:
        """Whether a publisher is matched with all subscribers whose diagnostics are received.

        A killed node stays in the graph for a while; its successor counts in addition.
        """
        made = self._publishers[name]
        graph = (made.get_subscription_count(), self.node.count_publishers(topics.DIAGNOSTICS))
        if self._matched_graph.get(name) == graph:
            return True
        subscriptions = Counter(node for node, _ in matched_subscribers(self.node, made))
        diagnostics = self.node.get_publishers_info_by_topic(topics.DIAGNOSTICS)
        reporters = Counter(each.node_name for each in diagnostics)
        receivers = (subscriptions.keys() & reporters.keys()) - _SUBSCRIBES_ALL
        matches_all = (
            bool(receivers)
            and all(subscriptions[each] >= reporters[each] for each in receivers)
            and receivers <= self._reporting
        )
        if matches_all:
            self._matched_graph[name] = graph
        return matches_all

    def send(self, name: str, sample: Sample) -> None:
        """Publish a valid sample."""
        self.publisher(name).publish(pack(name, sample))

    def send_joint(
        self,
        name: str,
        joint: str,
        position: float,
        velocity: float,
        effort: float = 0.0,
        stamp_ns: int | None = None,
    ) -> None:
        """Publish one joint's command, stamped with simulated time by default."""
        self.publisher(name)  # may wait: determine the stamp afterwards
        stamp = self.time_ns() if stamp_ns is None else stamp_ns
        value = JointValue(position, velocity, effort)
        self.send(name, JointSample(stamp, {joint: value}))

    def wait_until(
        self, condition: Callable[[], bool], complaint: str, timeout: float = DEFAULT_TIMEOUT
    ) -> None:
        """Poll a condition of the graph every 20 ms; AssertionError after a timeout."""
        deadline = time.monotonic() + timeout
        pause = threading.Event()
        while not condition():
            assert time.monotonic() < deadline, f"{complaint} after {timeout:g} s"
            pause.wait(0.02)

    # --- services --------------------------------------------------------------------------------

    def call(self, name: str, data: bool | None = None) -> Any:
        """Call a service of the contract and return its response."""
        kind = message_class(SERVICES[name].service)
        request = kind.Request() if data is None else kind.Request(data=data)
        return self.request(kind, name, request)

    def request(self, kind: type[Any], name: str, request: Any) -> Any:
        """Call any service and return its response."""
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
            discovery = EndpointMatching(self.node)

            def is_matched() -> bool:
                return any(map(discovery.is_matched, self._servers(name)))

            self.wait_until(is_matched, f"{name} has no server")
            # In the spinning thread: it must not wait for a destroyed entity.
            self._executor.create_task(discovery.close)
        client = self._clients[name]
        self.wait_until(client.service_is_ready, f"{name} has no server")
        answered = threading.Event()
        future = client.call_async(request)
        future.add_done_callback(lambda _: answered.set())
        assert answered.wait(DEFAULT_TIMEOUT), (
            f"{name} did not respond within {DEFAULT_TIMEOUT:g} s"
        )
        return future.result()

    def _servers(self, name: str) -> list[str]:
        """Names of the nodes that serve a service."""
        service, found = self.node.resolve_service_name(name), []
        for node, namespace in self.node.get_node_names_and_namespaces():
            with suppress(NodeNameNonExistentError):  # the node has just exited
                if service in dict(self.node.get_service_names_and_types_by_node(node, namespace)):
                    found.append(node)
        return found

    def change_state(self, node_name: str, transition: str) -> bool:
        """Request a transition of a lifecycle node; returns whether it succeeded."""
        request = ChangeState.Request(transition=Transition(id=TRANSITIONS[transition]))
        return bool(self.request(ChangeState, f"{node_name}/change_state", request).success)

    def state_of(self, node_name: str) -> str:
        """Return a lifecycle node's state."""
        answer = self.request(GetState, f"{node_name}/get_state", GetState.Request())
        return str(answer.current_state.label)

    def set_parameter(self, node_name: str, name: str, value: object) -> Any:
        """Set a parameter of a node; returns the result with its reason."""
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()]
        )
        return self.request(SetParameters, f"{node_name}/set_parameters", request).results[0]

    def get_parameter(self, node_name: str, name: str) -> Any:
        """Return a parameter of a node."""
        request = GetParameters.Request(names=[name])
        answer = self.request(GetParameters, f"{node_name}/get_parameters", request)
        return rclpy.parameter.parameter_value_to_python(answer.values[0])

    def describe_parameter(self, node_name: str, name: str) -> Any:
        """Return a parameter's descriptor."""
        request = DescribeParameters.Request(names=[name])
        answer = self.request(DescribeParameters, f"{node_name}/describe_parameters", request)
        return answer.descriptors[0]
