"""Send operators' orders to the nodes and receive their answers, over rclpy.

The pure parts are ``commands`` (the table), ``exchange`` (answers, and how an order ends) and
``telemetry`` (the known state).
"""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any
from weakref import WeakSet

import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from msg_schemas import qos, topics
from msg_schemas.cdr import pack, unpack
from msg_schemas.message_types import message_class
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import PoseEstimateSample, StatusSample
from msg_schemas.specifications import Intent
from msg_schemas.table import SERVICES, find_topic
from operator_console.commands import COMMANDS, OperatorCommand, Order, ServiceCall
from operator_console.exchange import (
    Completion,
    Exchange,
    OrderResult,
    OrderStatus,
    SentOrder,
    answer_of,
    joined,
)
from operator_console.receiver import Receiver
from operator_console.telemetry import TELEMETRY_TOPICS, Snapshot, Telemetry
from rover_runtime.ros import middleware
from rover_runtime.ros.endpoint_matching import EndpointMatching, matched_subscribers
from rover_runtime.ros.foreign_callbacks import guard_foreign_callbacks

NOT_SENT = "order"
"""Endpoint in the outcome of an order that was refused before it was sent."""

ANSWER_TIMEOUT = 10.0
"""Longest wait for the node of an order, and again for its answer [s]."""

# Two participants of Fast DDS that miss each other at the start discover each other with the next
# announcement, every second by the profiles of `rover_runtime`; the endpoints follow [s].
_DISCOVERY_TIME = 1.5
_STAMP_OFFSET_NS = 1_000_000
_POLL_PERIOD = 0.05  # for state without notification, such as the graph [s]
_FIRST_STATUS_TIMEOUT = 3.0  # for the first health report of a discovered node [s]
_DECELERATION_TIMEOUT = 5.0  # for winch and wheels, before the descent is called [s]
_MATCHING_TIMEOUT = 0.5  # for a server to discover its client [s]
_STATE_TIMEOUT = 1.0  # for the state that an order is checked against [s]


class LinkError(ValueError):
    """The link has no node: ROS refuses its arguments or its environment."""


def _never_cancelled() -> bool:
    """Return False: the default of `cancelled`."""
    return False


class OperatorLink:
    """Sends orders and waits for their results; receives the machine's state.

    Another thread spins the node. Any thread may send, several at the same time. Close the link
    before its node ends, if the node is used further.

    Args:
        node: node that publishes, calls and subscribes.
        command_source: name that requests carry and that nodes and bags report.
        changed: called in the spinning thread after each sample that arrived.
    """

    def __init__(
        self,
        node: Node,
        command_source: str,
        changed: Callable[[str, Any], None] = lambda _topic, _sample: None,
    ) -> None:
        self._node = node
        self._command_source = command_source
        self._on_change = changed
        self._changed = threading.Condition()
        self._creation_lock = threading.Lock()
        self._telemetry = Telemetry()
        self._pose: tuple[PoseEstimateSample, float] | None = None  # and its arrival [s]
        self._exchanges: WeakSet[Exchange] = WeakSet()
        self._receiver = Receiver(node, self._on_message)
        self._discovery_deadline = time.monotonic() + _DISCOVERY_TIME
        self._publishers: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}
        self._matchings: dict[str, EndpointMatching] = {}  # by service
        self._found_at: dict[str, float] = {}  # first sight of each service [s]
        self.subscribe(topics.COMMANDS, topics.EVENTS, topics.DIAGNOSTICS)

    def close(self) -> None:
        """Destroy subscriptions, publishers and clients; the node stays."""
        with self._creation_lock:
            self._receiver.close()
            for publisher in self._publishers.values():
                self._node.destroy_publisher(publisher)
            for client in self._clients.values():
                self._node.destroy_client(client)
            for discovery in self._matchings.values():
                discovery.close()
            self._matchings.clear()
            self._found_at.clear()
            self._publishers.clear()
            self._clients.clear()

    # --- receiving -------------------------------------------------------------------------------

    def subscribe(self, *names: str) -> None:
        """Subscribe to these topics, with their latched messages."""
        self._receiver.subscribe(*names)

    def subscribe_all(self) -> None:
        """Subscribe to everything that telemetry shows."""
        self.subscribe(*TELEMETRY_TOPICS)

    def _on_message(self, name: str, data: bytes) -> None:
        try:
            sample = unpack(name, data)
        except Refusal:
            return  # a message that breaks the contract is dropped; the value becomes stale
        with self._changed:
            self._telemetry.on_sample(name, sample, time.monotonic())
            if name == topics.POSE:
                self._pose = (sample, time.monotonic())
            if isinstance(sample, StatusSample):
                for exchange in self._exchanges:
                    exchange.on_statuses(name, sample)
            self._changed.notify_all()
        self._on_change(name, sample)

    def snapshot(self) -> Snapshot:
        """The present state."""
        with self._changed:
            return self._telemetry.snapshot(time.monotonic())

    def wait_for_nodes(
        self, timeout: float, cancelled: Callable[[], bool] = _never_cancelled
    ) -> bool:
        """Wait until every node has reported its health; return whether there is any node."""
        self.subscribe_all()
        known = self._telemetry
        if not self._wait(lambda: known.has_any_node, timeout, cancelled):
            return False
        left = min(timeout, self._discovery_deadline - time.monotonic())
        self._wait(_never_cancelled, left, cancelled)

        def have_reported() -> bool:
            return known.has_all_phases and not self.unreported()

        # With a limit: a killed node stays in the graph for a while.
        self._wait(have_reported, _FIRST_STATUS_TIMEOUT, cancelled)
        return not cancelled()

    def unreported(self) -> list[str]:
        """Nodes in the graph whose health reports have not arrived."""
        now = time.monotonic()
        there = {p.node_name for p in self._node.get_publishers_info_by_topic(topics.DIAGNOSTICS)}
        return sorted(name for name in there if not self._telemetry.is_alive(name, now))

    def wait_until(
        self,
        condition: Callable[[Telemetry], bool],
        timeout: float,
        cancelled: Callable[[], bool] = _never_cancelled,
    ) -> bool:
        """Wait until telemetry fulfils a condition; return whether it does."""
        return self._wait(lambda: condition(self._telemetry), timeout, cancelled)

    def _wait(
        self, condition: Callable[[], bool], timeout: float, cancelled: Callable[[], bool]
    ) -> bool:
        deadline = time.monotonic() + timeout
        with self._changed:
            while not condition():
                left = deadline - time.monotonic()
                if left <= 0.0 or cancelled():
                    return False
                self._changed.wait(min(left, _POLL_PERIOD))
            return True

    # --- sending ---------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Create all publishers and clients, so that no order waits for discovery."""
        for command in COMMANDS.values():
            if command.request is not None:
                self._publisher(command.request.topic)
            for call in command.calls:
                self._client(call.service)

    def with_defaults(
        self,
        command: OperatorCommand,
        given: Mapping[str, object],
        timeout: float = ANSWER_TIMEOUT,
        cancelled: Callable[[], bool] = _never_cancelled,
    ) -> dict[str, object]:
        """Add missing arguments whose default is a node's parameter, once that is known."""
        completed = dict(given)
        for argument in command.arguments:
            if argument.parameter is None or completed.get(argument.name) is not None:
                continue
            node, name = argument.parameter
            self.subscribe(topics.CONFIG)
            self.wait_until(
                lambda known, n=node, p=name: known.parameter(n, p) is not None,  # type: ignore[misc]
                timeout,
                cancelled,
            )
            with self._changed:
                completed[argument.name] = self._telemetry.parameter(node, name)
        return completed

    def send(
        self,
        order: Order,
        timeout: float = ANSWER_TIMEOUT,
        cancelled: Callable[[], bool] = _never_cancelled,
    ) -> SentOrder:
        """Send an order and wait for its answer.

        Args:
            order: the order.
            timeout: longest wait for the node, and again for the answer [s].
            cancelled: polled while waiting; True cancels.
        """
        if order.command.request is not None:
            return self._send_request(order, timeout, cancelled)
        if order.command.lasts:
            return self._send_call(order, timeout, cancelled)
        return SentOrder(order, self._call_all(order, timeout, cancelled))

    def follow(
        self,
        sent: SentOrder,
        timeout: float,
        cancelled: Callable[[], bool] = _never_cancelled,
        report: Callable[[str], None] = lambda _line: None,
    ) -> Completion | None:
        """Wait until an accepted order is complete; renew it meanwhile where required.

        Args:
            sent: an accepted order.
            timeout: longest wait [s].
            cancelled: polled while waiting; True cancels.
            report: called with a line of text for each event.

        Returns:
            How it ended; None = it continues.
        """
        if sent.exchange is None:
            return self._follow_calls(sent, timeout, cancelled)
        exchange, reported = sent.exchange, 0
        request = sent.order.command.request
        renew = 0.0 if request is None else request.renewal_rate
        pause = 1.0 / renew if renew else _POLL_PERIOD
        deadline = time.monotonic() + timeout
        while True:
            left = min(pause, deadline - time.monotonic())
            self._wait(lambda: exchange.completion is not None, left, cancelled)
            with self._changed:
                events, reported = exchange.events[reported:], len(exchange.events)
                completion = exchange.completion
            for event in events:
                report(f"{event.name}: {event.message}")
            if completion is None and self._has_gone(exchange.node):
                completion = exchange.lose(f"{exchange.node} does not run any more")
            if completion is not None or cancelled() or time.monotonic() >= deadline:
                return completion
            if renew:
                self._publish(exchange)

    def _has_gone(self, node: str) -> bool:
        """Whether a node is silent and has left the graph."""
        if self._telemetry.is_alive(node, time.monotonic()):
            return False
        here = self._node.get_namespace()
        return (node, here) not in self._node.get_node_names_and_namespaces()

    def renew(self, sent: SentOrder) -> Completion | None:
        """Send a request again unless it has ended; return its completion."""
        assert sent.exchange is not None
        with self._changed:
            completion = sent.exchange.completion
        if completion is None:
            self._publish(sent.exchange)
        return completion

    def undo(self, order: Order, timeout: float = ANSWER_TIMEOUT) -> SentOrder | None:
        """Send the command that stops an order safely; None = the order has none."""
        undo = order.command.undo
        return self.send(COMMANDS[undo].order({}), timeout) if undo else None

    # --- requests --------------------------------------------------------------------------------

    def _send_request(
        self, order: Order, timeout: float, cancelled: Callable[[], bool]
    ) -> SentOrder:
        request = order.command.request
        assert request is not None
        exchange = Exchange(order, f"{self._command_source}#{secrets.token_hex(4)}")
        if request.is_relative:
            self.subscribe(topics.POSE)
        publisher = self._publisher(request.topic)
        if order.command.direction:
            self.subscribe(topics.DESCENT_PHASE, topics.WINCH_STATE)

        at = (request.node, self._node.get_namespace())

        def is_available() -> bool:
            # A refusal must be able to arrive before a request is sent.
            is_alive = self._telemetry.is_alive(request.node, time.monotonic())
            return is_alive and at in matched_subscribers(self._node, publisher)

        if not self._wait(is_available, timeout, cancelled):
            status = OrderStatus.CANCELLED if cancelled() else OrderStatus.UNAVAILABLE
            return SentOrder(
                order, OrderResult(status, request.topic, self._unavailable(request.node))
            )
        if order.command.direction:
            known = self._telemetry
            self._wait(
                lambda: known.is_idle is False or (known.is_idle and known.depth) is not None,
                min(timeout, _STATE_TIMEOUT),
                cancelled,
            )
            contradiction = ""
            if known.is_idle and known.depth is not None:
                contradiction = order.contradiction(known.depth)
            if contradiction:
                code = RefusalCode.WRONG_PHASE.value
                return SentOrder(
                    order, OrderResult(OrderStatus.REFUSED, NOT_SENT, contradiction, code)
                )
        if request.is_relative and not self._set_goal(exchange, timeout, cancelled):
            reason = f"{request.node} does not report the rover's pose ({topics.POSE})"
            status = OrderStatus.CANCELLED if cancelled() else OrderStatus.UNAVAILABLE
            return SentOrder(order, OrderResult(status, topics.POSE, reason))
        if cancelled():
            not_sent = OrderResult(OrderStatus.CANCELLED, NOT_SENT, "it was not sent")
            return SentOrder(order, not_sent)
        with self._changed:
            self._exchanges.add(exchange)
        try:
            self._publish(exchange)
        except Refusal as refusal:  # the contract refuses it, such as a goal out of limits
            refused = OrderResult(OrderStatus.REFUSED, NOT_SENT, refusal.reason, refusal.code.value)
            return SentOrder(order, refused)
        self._wait(lambda: exchange.outcome is not None, timeout, cancelled)
        outcome = exchange.outcome
        if outcome is None:
            status = OrderStatus.CANCELLED if cancelled() else OrderStatus.NO_ANSWER
            reason = f"{request.node} has neither accepted nor refused it"
            outcome = OrderResult(status, request.topic, reason)
        return SentOrder(order, outcome, exchange)

    def _set_goal(self, exchange: Exchange, timeout: float, cancelled: Callable[[], bool]) -> bool:
        """Set the goal ahead of the present pose; its stamp identifies the request."""
        requested = time.monotonic()
        self._wait(lambda: self._pose is not None and self._pose[1] > requested, timeout, cancelled)
        if self._pose is None or self._pose[1] <= requested:
            return False
        pose, _ = self._pose
        # The random offset makes the stamp unique: two sources may use the same pose.
        stamp_ns = pose.stamp_ns + secrets.randbelow(_STAMP_OFFSET_NS)
        exchange.aim(exchange.order.goal(pose, stamp_ns))
        return True

    def _publish(self, exchange: Exchange) -> None:
        topic = exchange.subject
        name = exchange.name if exchange.goal is None else ""
        data = pack(topic, exchange.goal or exchange.order.sample(), name)
        self._publisher(topic).publish(data)

    def _publisher(self, topic: str) -> Any:
        with self._creation_lock:
            if topic not in self._publishers:
                kind = message_class(find_topic(topic).message)
                self._publishers[topic] = self._node.create_publisher(
                    kind, topic, qos.profile(Intent.COMMAND)
                )
            return self._publishers[topic]

    def _unavailable(self, *names: str) -> str:
        """Report that no node of these names is available, and other namespaces that have one."""
        here = self._node.get_namespace()
        found = self._node.get_node_names_and_namespaces()
        silent = sorted(node for node, namespace in found if node in names and namespace == here)
        if silent:
            return f"{' and '.join(silent)} runs, but reports nothing: simulated time may wait"
        others = {namespace for node, namespace in found if node in names and namespace != here}
        hint = f"; it runs in {', '.join(sorted(others))}" if others else ""
        return f"{' or '.join(names)} does not run in the namespace {here}{hint}"

    # --- calls -----------------------------------------------------------------------------------

    def _client(self, service: str) -> Any:
        with self._creation_lock:
            if service not in self._clients:
                kind = message_class(SERVICES[service].service)
                self._clients[service] = self._node.create_client(kind, service)
            return self._clients[service]

    def _discover(self, calls: Iterable[ServiceCall]) -> None:
        """Create the clients, and watch that each server has discovered its client."""
        new = {call.service for call in calls} - self._clients.keys()
        for service in new:
            self._client(service)
        if new:
            self._matchings |= dict.fromkeys(new, EndpointMatching(self._node, self._wake))

    def _is_ready(self, call: ServiceCall) -> bool:
        """Whether a call would be executed and answered."""
        if not self._client(call.service).service_is_ready():
            return False
        discovery = self._matchings.get(call.service)
        if discovery is None or any(discovery.is_matched(node) for node in call.servers):
            return True
        now = time.monotonic()
        return now > self._found_at.setdefault(call.service, now) + _MATCHING_TIMEOUT

    def _send_call(self, order: Order, timeout: float, cancelled: Callable[[], bool]) -> SentOrder:
        """Call a service whose record lasts, and follow that record."""
        node = Exchange(order).node
        # The record of this call is younger than the node's last report, those of others are older.
        if not self.wait_until(
            lambda known: known.is_alive(node, time.monotonic()), timeout, cancelled
        ):
            status = OrderStatus.CANCELLED if cancelled() else OrderStatus.UNAVAILABLE
            (call,) = order.command.calls
            return SentOrder(order, OrderResult(status, call.service, self._unavailable(node)))
        with self._changed:
            exchange = Exchange(order, after_ns=self._telemetry.reported_ns(node))
            self._exchanges.add(exchange)
        return SentOrder(order, self._call_all(order, timeout, cancelled), exchange)

    def _call_all(self, order: Order, timeout: float, cancelled: Callable[[], bool]) -> OrderResult:
        """Call every available service: all at the same time, or in order if all are required."""
        calls, in_order = order.command.calls, order.command.all_required
        self._discover(calls)
        parts: dict[ServiceCall, OrderResult] = {}
        if in_order:
            self._wait(lambda: not self._missing(calls), timeout, cancelled)
            for call in calls:
                parts |= self._call_batch([call], 0.0, timeout, cancelled)
                if parts[call].is_failure:
                    break
            return joined(parts.values(), in_order)
        started = time.monotonic()
        later = [call for call in calls if call.after_rest]
        at_once = [call for call in calls if not call.after_rest]
        parts |= self._call_batch(at_once, timeout, timeout, cancelled)
        if later:
            self._wait(lambda: not self._missing(later), timeout, cancelled)
            if any(self._client(call.service).service_is_ready() for call in later):
                self.subscribe(topics.WINCH_STATE, topics.JUMP_PHASE)
                limit = min(timeout, _DECELERATION_TIMEOUT)
                self._wait(lambda: self._telemetry.is_at_rest(started), limit, cancelled)
            parts |= self._call_batch(later, 0.0, timeout, cancelled)
        return joined([parts[call] for call in calls], in_order)

    def _missing(self, calls: Iterable[ServiceCall]) -> list[ServiceCall]:
        """Calls whose server runs or may still be discovered, but is not ready."""
        waited_for = [call for call in calls if not self._is_ready(call)]
        here, now = self._node.get_namespace(), time.monotonic()
        if now < self._discovery_deadline:
            return waited_for
        graph = self._node.get_node_names_and_namespaces()
        return [
            call
            for call in waited_for
            if any(
                self._telemetry.is_alive(node, now) or (node, here) in graph
                for node in call.servers
            )
        ]

    def _call_batch(
        self,
        calls: Sequence[ServiceCall],
        timeout: float,
        answer: float,
        cancelled: Callable[[], bool],
    ) -> dict[ServiceCall, OrderResult]:
        """Call each service as soon as it is ready, and wait for all answers.

        Args:
            calls: the calls.
            timeout: longest wait for the servers [s].
            answer: longest wait for the answers [s].
            cancelled: polled while waiting.
        """
        started = time.monotonic()
        requested: dict[ServiceCall, Any] = {}
        last_call = started

        def are_answered() -> bool:
            nonlocal last_call
            for call in calls:
                if call not in requested and self._is_ready(call):
                    requested[call], last_call = self._begin(call), time.monotonic()
            if any(not future.done() for future in requested.values()):
                return time.monotonic() > last_call + answer
            rest = [call for call in calls if call not in requested]
            # Wait longer for missing servers while none has accepted.
            accepted = any(future.result().success for future in requested.values())
            left = started + timeout - time.monotonic()
            return not rest or left <= 0.0 or (accepted and not self._missing(rest))

        self._wait(are_answered, timeout + answer, cancelled)
        return {call: self._outcome_of(call, requested.get(call), cancelled()) for call in calls}

    def _begin(self, call: ServiceCall) -> Any:
        client = self._client(call.service)
        request = client.srv_type.Request()
        if call.data is not None:
            request.data = call.data
        future = client.call_async(request)
        future.add_done_callback(lambda _: self._wake())
        return future

    def _outcome_of(self, call: ServiceCall, future: Any, is_cancelled: bool) -> OrderResult:
        if future is not None and future.done():
            answer = future.result()
            return answer_of(call.service, answer.success, answer.message)
        if future is None and is_cancelled:
            return OrderResult(OrderStatus.CANCELLED, call.service, "it was not called")
        if future is None:
            reason = self._unavailable(*call.servers)
            return OrderResult(OrderStatus.UNAVAILABLE, call.service, reason)
        self._client(call.service).remove_pending_request(future)
        reason = f"{' or '.join(call.servers)} has not answered"
        return OrderResult(OrderStatus.NO_ANSWER, call.service, reason)

    def _wake(self) -> None:
        with self._changed:
            self._changed.notify_all()

    def _follow_calls(
        self, sent: SentOrder, timeout: float, cancelled: Callable[[], bool]
    ) -> Completion | None:
        if not sent.order.command.completes_at_rest:
            return Completion(True, sent.outcome.reason)
        self.subscribe_all()
        is_at_rest = self.wait_until(
            lambda known: known.is_at_rest(sent.answered), timeout, cancelled
        )
        return Completion(True, "at rest") if is_at_rest else None


@contextmanager
def open_link(
    name: str, namespace: str = "", arguments: Sequence[str] = ()
) -> Iterator[OperatorLink]:
    """Open a link with its own node and thread, for a program that is no node.

    Args:
        name: name of the node, to which a random suffix is added, and of the source of requests.
        namespace: namespace of the machine; empty = none.
        arguments: ROS arguments, ``--ros-args ...``.

    Raises:
        LinkError: ROS refuses the arguments or its environment.
    """
    context = Context()
    middleware.select_transport()
    try:
        rclpy.init(args=list(arguments), context=context)
        node = rclpy.create_node(
            f"{name}_{secrets.token_hex(4)}", namespace=namespace, context=context,
            enable_rosout=False, start_parameter_services=False,
        )  # fmt: skip
    except (RuntimeError, ValueError) as error:  # the base classes of rclpy's errors
        msg = f"bad ROS arguments or environment: {str(error).splitlines()[0]}"
        raise LinkError(msg) from error
    guard_foreign_callbacks(node, lambda refusal: node.get_logger().warning(str(refusal)))
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    stop = threading.Event()

    def spin() -> None:
        while not stop.is_set():
            try:
                executor.spin_once(timeout_sec=0.1)
            except ExternalShutdownException:
                return

    thread = threading.Thread(target=spin, name=name, daemon=True)
    thread.start()
    try:
        yield OperatorLink(node, name)
    finally:
        stop.set()
        executor.wake()
        thread.join(10.0)
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()
