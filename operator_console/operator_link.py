"""The way of an operator's orders to the nodes and of their answers back, over rclpy.

What is pure stands elsewhere: ``commands`` (what can be asked for), ``exchange`` (what is an
answer), ``endings`` (when it is over), ``telemetry`` (what is known). Here is what waits.
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

from msg_schemas import middleware, qos, topics
from msg_schemas.codecs import decode, encode, message_class, topic_row
from msg_schemas.endpoint_matching import EndpointMatching, listeners
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import OdometrySample, StatusSample
from msg_schemas.specifications import Intent
from msg_schemas.table import SERVICES
from operator_console.commands import COMMANDS, Call, Command, Order
from operator_console.completion import Completion
from operator_console.exchange import Exchange, Outcome, Verdict, answer_of, joined
from operator_console.telemetry import HEARD, Snapshot, Telemetry

NOT_SENT = "what was asked for"
"""By what an order is refused that nobody was told of."""

PATIENCE = 10.0
"""How long a node that would take an order, and then its answer, are waited for [s]."""

# A participant of Fast DDS that was not met at once is met when one of the two announces itself
# again, each 3 s; its endpoints follow [s].
_MET = 4.0
_DEEP = 200  # messages that may wait: what all nodes have latched comes at one time
_ONE_S_OWN_NS = 1_000_000
_LOOK = 0.05  # at what nobody announces, such as the graph [s]
_MEETING = 3.0  # for nodes that are known and not heard yet [s]
_SLOWING = 5.0  # for what is asked to come to rest, before the next is asked [s]
_KNOWN = 0.5  # longest for a server to get to know who calls it [s]
_GRACE = 1.0  # for what is good to know before an order is sent [s]


def never() -> bool:
    """Nobody gives up."""
    return False


class Sent:
    """An order that has gone out.

    Attributes:
        order: what was asked for.
        outcome: what became of it.
        exchange: of a request, what its taker says from then on.
        answered: when the answer came, by the steady clock [s].
    """

    def __init__(self, order: Order, outcome: Outcome, exchange: Exchange | None = None) -> None:
        self.order = order
        self.outcome = outcome
        self.exchange = exchange
        self.answered = time.monotonic()


class OperatorLink:
    """Sends orders and waits for what becomes of them; hears what there is to know.

    Another thread spins the node. Any thread may send; several may at once. Who ends before its
    node does, closes it.

    Args:
        node: by whose name and namespace it speaks.
        who: asks; nodes and bags tell it.
        changed: called after each sample that was heard, in the spinning thread.
    """

    def __init__(
        self,
        node: Node,
        who: str,
        changed: Callable[[str, Any], None] = lambda _topic, _sample: None,
    ) -> None:
        self._node = node
        self._who = who
        self._on_change = changed
        self._changed = threading.Condition()
        self._making = threading.Lock()
        self._telemetry = Telemetry()
        self._pose: tuple[OdometrySample, float] | None = None  # and when it was heard [s]
        self._exchanges: WeakSet[Exchange] = WeakSet()
        self._heard: dict[str, Any] = {}
        self._everyone_is_met = time.monotonic() + _MET
        self._publishers: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}
        self._acquaintances: dict[str, EndpointMatching] = {}  # by service
        self._found: dict[str, float] = {}  # when each service was seen to be there [s]
        self.listen(topics.EVENTS, topics.DIAGNOSTICS)

    def close(self) -> None:
        """Hear and say nothing more; the node goes on."""
        with self._making:
            for subscription in self._heard.values():
                self._node.destroy_subscription(subscription)
            for publisher in self._publishers.values():
                self._node.destroy_publisher(publisher)
            for client in self._clients.values():
                self._node.destroy_client(client)
            for discovery in self._acquaintances.values():
                discovery.close()
            self._acquaintances.clear()
            self._found.clear()
            self._heard.clear()
            self._publishers.clear()
            self._clients.clear()

    # --- hearing ---------------------------------------------------------------------------------

    def listen(self, *names: str) -> None:
        """Hear these topics from now on, and what is latched there."""
        for name in names:
            if name in self._heard:
                continue
            row = topic_row(name)
            self._heard[name] = self._node.create_subscription(
                message_class(row.message), name, self._hearer(name),
                qos.profile(row.intent, _DEEP),
            )  # fmt: skip

    def listen_to_all(self) -> None:
        """Hear everything that telemetry shows."""
        self.listen(*HEARD)

    def _hearer(self, name: str) -> Callable[[Any], None]:
        def hear(message: Any) -> None:
            try:
                sample = decode(name, message)
            except Refusal:
                return  # a node that breaks the contract is not believed, its value grows stale
            with self._changed:
                self._telemetry.hear(name, sample, time.monotonic())
                if name == topics.ODOMETRY:
                    self._pose = (sample, time.monotonic())
                if isinstance(sample, StatusSample):
                    for exchange in self._exchanges:
                        exchange.hear(name, sample)
                self._changed.notify_all()
            self._on_change(name, sample)

        return hear

    def snapshot(self) -> Snapshot:
        """What is known now."""
        with self._changed:
            return self._telemetry.snapshot(time.monotonic())

    def meet_everyone(self, timeout: float, cancelled: Callable[[], bool] = never) -> bool:
        """Wait until all who are there were heard; whether there is anybody."""
        self.listen_to_all()
        known = self._telemetry
        if not self._wait(lambda: known.hears_anybody, timeout, cancelled):
            return False
        left = min(timeout, self._everyone_is_met - time.monotonic())
        self._wait(never, left, cancelled)

        def are_heard() -> bool:
            now = time.monotonic()
            there = self._node.get_publishers_info_by_topic(topics.DIAGNOSTICS)
            return known.knows_phases and all(known.is_heard(p.node_name, now) for p in there)

        # Not for long: one that was killed stays among them for a while.
        self._wait(are_heard, _MEETING, cancelled)
        return not cancelled()

    def wait_until(
        self,
        condition: Callable[[Telemetry], bool],
        timeout: float,
        cancelled: Callable[[], bool] = never,
    ) -> bool:
        """Wait until what is known fulfils a condition; whether it does."""
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
                self._changed.wait(min(left, _LOOK))
            return True

    # --- sending ---------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Get to know all takers, so that no order waits for that."""
        for command in COMMANDS.values():
            if command.request is not None:
                self._publisher(command.request.topic)
            for call in command.calls:
                self._client(call.service)

    def fill_in(
        self,
        command: Command,
        given: Mapping[str, object],
        patience: float = PATIENCE,
        cancelled: Callable[[], bool] = never,
    ) -> dict[str, object]:
        """Add to the arguments those left out for which a node's parameter stands, once heard."""
        filled = dict(given)
        for argument in command.arguments:
            if argument.parameter is None or filled.get(argument.name) is not None:
                continue
            node, name = argument.parameter
            self.listen(topics.CONFIG)
            self.wait_until(
                lambda known, n=node, p=name: known.parameter(n, p) is not None,  # type: ignore[misc]
                patience,
                cancelled,
            )
            with self._changed:
                filled[argument.name] = self._telemetry.parameter(node, name)
        return filled

    def send(
        self,
        order: Order,
        patience: float = PATIENCE,
        cancelled: Callable[[], bool] = never,
    ) -> Sent:
        """Send an order and wait for its answer.

        Args:
            order: to send.
            patience: for who takes it, and then for the answer [s].
            cancelled: asked while waiting; true gives up.
        """
        if order.command.request is not None:
            return self._ask(order, patience, cancelled)
        return Sent(order, self._call_all(order, patience, cancelled))

    def follow(
        self,
        sent: Sent,
        timeout: float,
        cancelled: Callable[[], bool] = never,
        tell: Callable[[str], None] = lambda _line: None,
    ) -> Completion | None:
        """Wait until what was accepted is over; what must be renewed is, meanwhile.

        Args:
            sent: an order that was accepted.
            timeout: for that [s].
            cancelled: asked while waiting; true gives up.
            tell: called with each event on the way, as a line of text.

        Returns:
            How it ended; None = it goes on.
        """
        if sent.exchange is None:
            return self._follow_calls(sent, timeout, cancelled)
        exchange, told = sent.exchange, 0
        renew = exchange.request.renew
        pause = 1.0 / renew if renew else _LOOK
        deadline = time.monotonic() + timeout
        while True:
            left = min(pause, deadline - time.monotonic())
            self._wait(lambda: exchange.ending is not None, left, cancelled)
            with self._changed:
                story, told = exchange.story[told:], len(exchange.story)
                ending = exchange.ending
            for event in story:
                tell(f"{event.name}: {event.message}")
            if ending is not None or cancelled() or time.monotonic() >= deadline:
                return ending
            if renew:
                self._publish(exchange)

    def renew(self, sent: Sent) -> Completion | None:
        """Say a request again that must be renewed; returns how it ended, and says nothing then."""
        assert sent.exchange is not None
        with self._changed:
            ending = sent.exchange.ending
        if ending is None:
            self._publish(sent.exchange)
        return ending

    def undo(self, order: Order, patience: float = PATIENCE) -> Sent | None:
        """End halfway, safely, what an order began; None = nothing is to be ended."""
        undo = order.command.undo
        return self.send(COMMANDS[undo].order({}), patience) if undo else None

    # --- requests --------------------------------------------------------------------------------

    def _ask(self, order: Order, patience: float, cancelled: Callable[[], bool]) -> Sent:
        exchange = Exchange(order, f"{self._who}#{secrets.token_hex(4)}")
        request = exchange.request
        if request.ahead:
            self.listen(topics.ODOMETRY)
        made = self._publisher(request.topic)
        if order.command.heads:
            self.listen(topics.DESCENT_PHASE, topics.WINCH_STATE)

        at = (request.taker, self._node.get_namespace())

        def is_there() -> bool:
            # Who can be asked must also be heard refusing.
            heard = self._telemetry.is_heard(request.taker, time.monotonic())
            return heard and at in listeners(self._node, made)

        if not self._wait(is_there, patience, cancelled):
            verdict = Verdict.GIVEN_UP if cancelled() else Verdict.NOBODY
            return Sent(order, Outcome(verdict, request.topic, self._absence(request.taker)))
        if order.command.heads:
            known = self._telemetry
            self._wait(
                lambda: known.is_idle is False or (known.is_idle and known.depth) is not None,
                min(patience, _GRACE),
                cancelled,
            )
            contradiction = ""
            if known.is_idle and known.depth is not None:
                contradiction = order.contradiction(known.depth)
            if contradiction:
                code = RefusalCode.WRONG_PHASE.value
                return Sent(order, Outcome(Verdict.REFUSED, NOT_SENT, contradiction, code))
        if request.ahead and not self._aim(exchange, patience, cancelled):
            reason = f"{request.taker} does not tell where the rover is ({topics.ODOMETRY})"
            return Sent(order, Outcome(Verdict.NO_ANSWER, topics.ODOMETRY, reason))
        with self._changed:
            self._exchanges.add(exchange)
        try:
            self._publish(exchange)
        except Refusal as refusal:  # by the contract, such as a goal beyond its limits
            refused = Outcome(Verdict.REFUSED, NOT_SENT, refusal.reason, refusal.code.value)
            return Sent(order, refused)
        self._wait(lambda: exchange.outcome is not None, patience, cancelled)
        outcome = exchange.outcome
        if outcome is None:
            verdict = Verdict.GIVEN_UP if cancelled() else Verdict.NO_ANSWER
            reason = f"{request.taker} has not said whether it took it"
            outcome = Outcome(verdict, request.topic, reason)
        return Sent(order, outcome, exchange)

    def _aim(self, exchange: Exchange, patience: float, cancelled: Callable[[], bool]) -> bool:
        """Aim ahead of where the rover is now; the answer will bear the stamp."""
        asked = time.monotonic()
        self._wait(lambda: self._pose is not None and self._pose[1] > asked, patience, cancelled)
        if self._pose is None or self._pose[1] <= asked:
            return False
        seen, _ = self._pose
        # One's own, as two who saw the same pose would stamp alike; the clock is the taker's.
        stamp_ns = seen.stamp_ns + secrets.randbelow(_ONE_S_OWN_NS)
        exchange.commander = f"{stamp_ns} ns"
        exchange.goal = exchange.order.goal(seen, stamp_ns)
        return True

    def _publish(self, exchange: Exchange) -> None:
        topic = exchange.request.topic
        message = encode(topic, exchange.goal or exchange.order.sample())
        if exchange.goal is None:
            message.header.frame_id = exchange.commander
        self._publisher(topic).publish(message)

    def _publisher(self, topic: str) -> Any:
        with self._making:
            if topic not in self._publishers:
                kind = message_class(topic_row(topic).message)
                self._publishers[topic] = self._node.create_publisher(
                    kind, topic, qos.profile(Intent.COMMAND)
                )
            return self._publishers[topic]

    def _absence(self, name: str) -> str:
        """Say that a node is not there, and where there is one of that name."""
        here = self._node.get_namespace()
        others = {
            namespace
            for node, namespace in self._node.get_node_names_and_namespaces()
            if node == name and namespace != here
        }
        hint = f"; there is one in {', '.join(sorted(others))}" if others else ""
        return f"{name} is not heard in the namespace {here}{hint}"

    # --- calls -----------------------------------------------------------------------------------

    def _client(self, service: str) -> Any:
        with self._making:
            if service not in self._clients:
                kind = message_class(SERVICES[service].service)
                self._clients[service] = self._node.create_client(kind, service)
            return self._clients[service]

    def _get_known(self, calls: Iterable[Call]) -> None:
        """Open what is called, and see to it that its server knows of that."""
        new = {call.service for call in calls} - self._clients.keys()
        for service in new:
            self._client(service)
        if new:
            self._acquaintances |= dict.fromkeys(new, EndpointMatching(self._node, self._wake))

    def _is_ready(self, call: Call) -> bool:
        """Whether it would be done and answered; nobody is waited for long who is there."""
        if not self._client(call.service).service_is_ready():
            return False
        discovery = self._acquaintances.get(call.service)
        if discovery is None or discovery.is_with(call.server):
            return True
        now = time.monotonic()
        return now > self._found.setdefault(call.service, now) + _KNOWN

    def _call_all(self, order: Order, patience: float, cancelled: Callable[[], bool]) -> Outcome:
        """Call every service that is there: each at once, or in order where all are needed."""
        calls, in_order = order.command.calls, order.command.needs_all
        self._get_known(calls)
        parts: dict[Call, Outcome] = {}
        if in_order:
            self._wait(lambda: not self._missing(calls), patience, cancelled)
            for call in calls:
                parts |= self._call_batch([call], 0.0, patience, cancelled)
                if parts[call].is_trouble:
                    break
            return joined(parts.values(), in_order)
        begun = time.monotonic()
        later = [call for call in calls if call.at_rest]
        at_once = [call for call in calls if not call.at_rest]
        parts |= self._call_batch(at_once, patience, patience, cancelled)
        if later:
            self._wait(lambda: not self._missing(later), patience, cancelled)
            if any(self._client(call.service).service_is_ready() for call in later):
                self.listen(topics.WINCH_STATE, topics.JUMP_PHASE)
                limit = min(patience, _SLOWING)
                self._wait(lambda: self._telemetry.is_at_rest(begun), limit, cancelled)
            parts |= self._call_batch(later, 0.0, patience, cancelled)
        return joined([parts[call] for call in calls], in_order)

    def _missing(self, calls: Iterable[Call]) -> list[Call]:
        """Those that may still come: their server is known to be there, or not known yet."""
        waited_for = [call for call in calls if not self._is_ready(call)]
        here, now = self._node.get_namespace(), time.monotonic()
        if now < self._everyone_is_met:
            return waited_for
        graph = self._node.get_node_names_and_namespaces()
        return [
            call
            for call in waited_for
            if self._telemetry.is_heard(call.server, now) or (call.server, here) in graph
        ]

    def _call_batch(
        self,
        calls: Sequence[Call],
        patience: float,
        answer: float,
        cancelled: Callable[[], bool],
    ) -> dict[Call, Outcome]:
        """Call each as soon as it is there, and wait for all answers.

        Args:
            calls: to be made.
            patience: for who would serve them [s].
            answer: patience for the answers [s].
            cancelled: asked while waiting.
        """
        begun = time.monotonic()
        asked: dict[Call, Any] = {}
        asked_last = begun

        def are_answered() -> bool:
            nonlocal asked_last
            for call in calls:
                if call not in asked and self._is_ready(call):
                    asked[call], asked_last = self._begin(call), time.monotonic()
            if any(not future.done() for future in asked.values()):
                return time.monotonic() > asked_last + answer
            rest = [call for call in calls if call not in asked]
            # Who has not been found is waited for longer where nobody has done anything yet.
            accepted = any(future.result().success for future in asked.values())
            left = begun + patience - time.monotonic()
            return not rest or left <= 0.0 or (accepted and not self._missing(rest))

        self._wait(are_answered, patience + answer, cancelled)
        return {call: self._outcome_of(call, asked.get(call), cancelled()) for call in calls}

    def _begin(self, call: Call) -> Any:
        client = self._client(call.service)
        request = client.srv_type.Request()
        if call.data is not None:
            request.data = call.data
        future = client.call_async(request)
        future.add_done_callback(lambda _: self._wake())
        return future

    def _outcome_of(self, call: Call, future: Any, is_given_up: bool) -> Outcome:
        if future is not None and future.done():
            answer = future.result()
            return answer_of(call.service, answer.success, answer.message)
        if future is None:
            verdict = Verdict.GIVEN_UP if is_given_up else Verdict.NOBODY
            return Outcome(verdict, call.service, self._absence(call.server))
        self._client(call.service).remove_pending_request(future)
        verdict = Verdict.GIVEN_UP if is_given_up else Verdict.NO_ANSWER
        return Outcome(verdict, call.service, f"{call.server} has not said whether it did it")

    def _wake(self) -> None:
        with self._changed:
            self._changed.notify_all()

    def _follow_calls(
        self, sent: Sent, timeout: float, cancelled: Callable[[], bool]
    ) -> Completion | None:
        if not sent.order.command.rests:
            return Completion(True, sent.outcome.reason)
        self.listen_to_all()
        rests = self.wait_until(lambda known: known.is_at_rest(sent.answered), timeout, cancelled)
        return Completion(True, "at rest") if rests else None


@contextmanager
def open_link(
    name: str, namespace: str = "", arguments: Sequence[str] = (), who: str = ""
) -> Iterator[OperatorLink]:
    """A link with a node and a thread of its own, for a program that is no node itself.

    Args:
        name: of the node.
        namespace: in which the machine is; empty = none.
        arguments: of ROS, ``--ros-args ...``.
        who: asks; by default the name.
    """
    context = Context()
    middleware.choose()
    rclpy.init(args=list(arguments), context=context)
    node = rclpy.create_node(
        f"{name}_{secrets.token_hex(4)}", namespace=namespace, context=context,
        enable_rosout=False, start_parameter_services=False,
    )  # fmt: skip
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    ending = threading.Event()

    def spin() -> None:
        while not ending.is_set():
            try:
                executor.spin_once(timeout_sec=0.1)
            except ExternalShutdownException:
                return

    thread = threading.Thread(target=spin, name=name, daemon=True)
    thread.start()
    try:
        yield OperatorLink(node, who or name)
    finally:
        ending.set()
        executor.wake()
        thread.join(10.0)
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()
