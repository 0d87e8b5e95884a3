"""A node of ours among the processes: it listens, commands and calls, by the contract.

It has an rclpy context of its own, in the ROS domain of the processes it watches,
and spins in a thread of its own. It never sleeps: it waits until what has arrived
fulfils a condition, or a bound is passed.
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

from msg_schemas import middleware, qos, topics
from msg_schemas.access import ACCESS, ALL
from msg_schemas.codecs import decode, encode, message_class, topic_row
from msg_schemas.endpoint_matching import EndpointMatching, listeners
from msg_schemas.node import READY
from msg_schemas.samples import JointSample, JointValue, Sample, Status, StatusSample
from msg_schemas.table import SERVICES
from rover_verify.harness.processes import PATIENCE, ros_arguments

TRANSITIONS = {
    "configure": Transition.TRANSITION_CONFIGURE,
    "activate": Transition.TRANSITION_ACTIVATE,
    "deactivate": Transition.TRANSITION_DEACTIVATE,
    "cleanup": Transition.TRANSITION_CLEANUP,
}

# They take nothing of what is published.
_LISTEN_TO_ALL = frozenset(name for name, row in ACCESS.items() if row.subscribes == ALL)

_DEEP = 5000
_number = itertools.count()


class Feed:
    """All samples of one topic since the observer began to listen."""

    def __init__(self, name: str, changed: threading.Condition) -> None:
        self.name = name
        self._changed = changed
        self._samples: list[Any] = []

    def add(self, sample: Any) -> None:
        """Append a sample and wake who waits."""
        with self._changed:
            self._samples.append(sample)
            self._changed.notify_all()

    @property
    def samples(self) -> list[Any]:
        """A copy of what has arrived so far."""
        with self._changed:
            return list(self._samples)

    @property
    def last(self) -> Any:
        """The newest sample; None = nothing has arrived."""
        with self._changed:
            return self._samples[-1] if self._samples else None

    def __len__(self) -> int:
        with self._changed:
            return len(self._samples)

    def wait(
        self,
        predicate: Callable[[Any], bool] = lambda _: True,
        since: int = 0,
        timeout: float = PATIENCE,
    ) -> Any:
        """Wait for a sample that fulfils the predicate, from index ``since`` on; return it."""
        deadline = time.monotonic() + timeout
        index = since
        with self._changed:
            while True:
                while index < len(self._samples):
                    if predicate(self._samples[index]):
                        return self._samples[index]
                    index += 1
                left = deadline - time.monotonic()
                if left <= 0.0:
                    last = self._samples[-1] if self._samples else "nothing"
                    raise AssertionError(
                        f"{self.name}: none of {len(self._samples) - since} samples is as wanted "
                        f"after {timeout:g} s; the last is {last}"
                    )
                self._changed.wait(left)

    def wait_for_count(self, count: int, timeout: float = PATIENCE) -> list[Any]:
        """Wait until that many samples have arrived in all; return them."""
        deadline = time.monotonic() + timeout
        with self._changed:
            while len(self._samples) < count:
                left = deadline - time.monotonic()
                assert left > 0.0, (
                    f"{self.name}: {len(self._samples)} samples after {timeout:g} s, not {count}"
                )
                self._changed.wait(left)
            return list(self._samples)


class Observer:
    """Listens, commands and calls in one ROS domain (and namespace)."""

    def __init__(
        self, domain: int, namespace: str = "", remap: Mapping[str, str] | None = None
    ) -> None:
        self._context = Context()
        middleware.choose()
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
        self._reached: dict[str, tuple[int, int]] = {}  # the graph when each publisher was
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._spin, name="observer", daemon=True)
        self._thread.start()
        for name in (topics.EVENTS, topics.DIAGNOSTICS):
            self.listen(name)

    def _spin(self) -> None:
        while not self._stopping.is_set():
            try:
                self._executor.spin_once(timeout_sec=0.1)
            except ExternalShutdownException:
                return

    def close(self) -> None:
        """Leave the graph; nothing of this observer stays."""
        self._stopping.set()
        self._executor.wake()
        self._thread.join(10.0)
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    # --- listening -------------------------------------------------------------------------------

    def listen(self, name: str) -> Feed:
        """Collect the topic's samples from now on, and what is latched; one feed per topic."""
        if name not in self._feeds:
            row = topic_row(name)
            feed = Feed(name, self._changed)

            def hear(message: Any) -> None:
                sample = decode(name, message)
                if name == topics.DIAGNOSTICS:
                    self._reporting.update(status.hardware_id for status in sample.statuses)
                feed.add(sample)

            self.node.create_subscription(
                message_class(row.message), name, hear, qos.profile(row.intent, _DEEP)
            )
            self._feeds[name] = feed
            self._executor.wake()
        return self._feeds[name]

    def wait_for_text(self, name: str, *words: str, since: int = 0) -> str:
        """Wait until a topic of words says one of them."""
        return str(self.listen(name).wait(lambda s: s.text in words, since).text)

    def wait_for_status(
        self, name: str, wanted: Callable[[Status], bool], since: int = 0
    ) -> Status:
        """Wait for one status (of events, diagnostics or sim status) as wanted."""
        found: list[Status] = []

        def look(sample: StatusSample) -> bool:
            found[:] = [status for status in sample.statuses if wanted(status)]
            return bool(found)

        self.listen(name).wait(look, since)
        return found[0]

    def wait_for_event(self, name: str, since: int = 0) -> Status:
        """Wait for an event by its name."""
        return self.wait_for_status(topics.EVENTS, lambda s: s.name == name, since)

    def wait_for_refusal(self, subject: str, code: str, since: int = 0) -> Status:
        """Wait until diagnostics say that something was refused, and why."""
        return self.wait_for_status(
            topics.DIAGNOSTICS,
            lambda s: s.name.endswith(f"refused {subject}") and s.values.get("code") == code,
            since,
        )

    def wait_until_ready(self, node_name: str, since: int = 0) -> None:
        """Wait until a node's health says that it hears what it must and can do its work."""
        self.wait_for_status(
            topics.DIAGNOSTICS,
            lambda s: s.name == f"{node_name}: node" and s.message == READY,
            since,
        )

    def time_ns(self) -> int:
        """Simulated time as last heard."""
        last = self.listen(topics.CLOCK).last
        return 0 if last is None else int(last.stamp_ns)

    def wait_for_time(self, stamp_ns: int) -> int:
        """Wait until simulated time has come so far; returns it."""
        clock = self.listen(topics.CLOCK)
        return int(clock.wait(lambda s: s.stamp_ns >= stamp_ns, max(0, len(clock) - 1)).stamp_ns)

    # --- commanding ------------------------------------------------------------------------------

    def publisher(self, name: str) -> Any:
        """Return a raw publisher that reaches a node that takes it, and all others that listen."""
        if name not in self._publishers:
            row = topic_row(name)
            self._publishers[name] = self.node.create_publisher(
                message_class(row.message), name, qos.profile(row.intent)
            )
        made = self._publishers[name]
        self.wait_until(lambda: self._reaches_a_taker(name), f"nobody takes {name}")
        return made

    def _reaches_a_taker(self, name: str) -> bool:
        """Whether all who listen to a publisher are met, and who takes it is heard refusing.

        A node that was killed stays in the graph for a while, and its successor counts besides.
        """
        made = self._publishers[name]
        graph = (made.get_subscription_count(), self.node.count_publishers(topics.DIAGNOSTICS))
        if self._reached.get(name) == graph:
            return True
        listening = Counter(node for node, _ in listeners(self.node, made))
        tell = self.node.get_publishers_info_by_topic(topics.DIAGNOSTICS)
        telling = Counter(each.node_name for each in tell)
        takers = (listening.keys() & telling.keys()) - _LISTEN_TO_ALL
        reaches = (
            bool(takers)
            and all(listening[each] >= telling[each] for each in takers)
            and takers <= self._reporting
        )
        if reaches:
            self._reached[name] = graph
        return reaches

    def send(self, name: str, sample: Sample) -> None:
        """Publish a good sample."""
        self.publisher(name).publish(encode(name, sample))

    def send_joint(
        self,
        name: str,
        joint: str,
        position: float,
        velocity: float,
        effort: float = 0.0,
        stamp_ns: int | None = None,
    ) -> None:
        """Publish one joint's command, stamped with simulated time unless told otherwise."""
        self.publisher(name)  # may wait, and the stamp must be that of the sending
        stamp = self.time_ns() if stamp_ns is None else stamp_ns
        value = JointValue(position, velocity, effort)
        self.send(name, JointSample(stamp, {joint: value}))

    def wait_until(
        self, condition: Callable[[], bool], complaint: str, timeout: float = PATIENCE
    ) -> None:
        """Wait for a condition of the graph, which nobody announces: look again every 20 ms."""
        deadline = time.monotonic() + timeout
        pause = threading.Event()
        while not condition():
            assert time.monotonic() < deadline, f"{complaint} after {timeout:g} s"
            pause.wait(0.02)

    # --- calling ---------------------------------------------------------------------------------

    def call(self, name: str, data: bool | None = None) -> Any:
        """Call a service of the contract and return its answer."""
        kind = message_class(SERVICES[name].service)
        request = kind.Request() if data is None else kind.Request(data=data)
        return self._call(kind, name, request)

    def _call(self, kind: type[Any], name: str, request: Any) -> Any:
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
            discovery = EndpointMatching(self.node)

            def knows_the_client() -> bool:
                return any(map(discovery.is_with, self._servers(name)))

            self.wait_until(knows_the_client, f"nobody serves {name}")
            # By the thread that spins: it must not wait for what is being destroyed.
            self._executor.create_task(discovery.close)
        client = self._clients[name]
        self.wait_until(client.service_is_ready, f"nobody serves {name}")
        answered = threading.Event()
        future = client.call_async(request)
        future.add_done_callback(lambda _: answered.set())
        assert answered.wait(PATIENCE), f"{name} gave no answer in {PATIENCE:g} s"
        return future.result()

    def _servers(self, name: str) -> list[str]:
        """Names of the nodes that serve it."""
        service, found = self.node.resolve_service_name(name), []
        for node, namespace in self.node.get_node_names_and_namespaces():
            with suppress(NodeNameNonExistentError):  # it has just ended
                if service in dict(self.node.get_service_names_and_types_by_node(node, namespace)):
                    found.append(node)
        return found

    def change_state(self, node_name: str, transition: str) -> bool:
        """Ask a lifecycle node for a transition; returns whether it succeeded."""
        request = ChangeState.Request(transition=Transition(id=TRANSITIONS[transition]))
        return bool(self._call(ChangeState, f"{node_name}/change_state", request).success)

    def state_of(self, node_name: str) -> str:
        """Return a lifecycle node's state."""
        answer = self._call(GetState, f"{node_name}/get_state", GetState.Request())
        return str(answer.current_state.label)

    def set_parameter(self, node_name: str, name: str, value: object) -> Any:
        """Set a parameter of a node; returns the result with its reason."""
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()]
        )
        return self._call(SetParameters, f"{node_name}/set_parameters", request).results[0]

    def get_parameter(self, node_name: str, name: str) -> Any:
        """Return a parameter of a node."""
        request = GetParameters.Request(names=[name])
        answer = self._call(GetParameters, f"{node_name}/get_parameters", request)
        return rclpy.parameter.parameter_value_to_python(answer.values[0])

    def describe_parameter(self, node_name: str, name: str) -> Any:
        """Return a parameter's descriptor."""
        request = DescribeParameters.Request(names=[name])
        answer = self._call(DescribeParameters, f"{node_name}/describe_parameters", request)
        return answer.descriptors[0]
