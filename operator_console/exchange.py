"""Follow one operator's order by the record that the node keeps of it.

A request names its sender and an identifier in ``header.frame_id``, or has a stamp of its own where
the topic has a frame. The node repeats both in the record. A call carries no name: its record is
the first one that the node takes after it was made.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from msg_schemas import topics
from msg_schemas.commands import CommandRecord, CommandState, read_command, split_name
from msg_schemas.events import NodeEvent
from msg_schemas.refusal import RefusalCode
from msg_schemas.samples import PoseSample, Status, StatusSample
from operator_console.commands import Order


class OrderStatus(StrEnum):
    """What happened to an order."""

    ACCEPTED = "accepted"
    REFUSED = "refused"
    UNAVAILABLE = "no node available"
    NO_ANSWER = "no answer"
    CANCELLED = "cancelled"


@dataclass(frozen=True)
class OrderResult:
    """Result of an order, or of one of its parts.

    Attributes:
        status: accepted, refused, ...
        by: topic or service that carried it.
        reason: the node's message.
        code: refusal code of the contract; empty if the node gave none.
        parts: results of the service calls, if there were several.
    """

    status: OrderStatus
    by: str
    reason: str
    code: str = ""
    parts: tuple[OrderResult, ...] = ()

    @property
    def is_accepted(self) -> bool:
        """Whether a node accepted it."""
        return self.status is OrderStatus.ACCEPTED

    @property
    def is_failure(self) -> bool:
        """Whether an available node did not accept it."""
        return self.status not in {OrderStatus.ACCEPTED, OrderStatus.UNAVAILABLE}


@dataclass(frozen=True)
class Completion:
    """The end of an order.

    Attributes:
        is_done: whether the goal is reached.
        reason: why, for people.
    """

    is_done: bool
    reason: str


class Exchange:
    """An order in progress: finds its record among those of all commands.

    Args:
        order: a command with a request, or with a call that lasts.
        name: sender and identifier that the request carries.
        after_ns: of a call, time by the node's clock before it was made [ns].

    Attributes:
        node: node that handles the order.
        subject: topic or service.
        goal: pose of a relative request.
        record: the latest record of the order; None until it is known.
        outcome: acceptance or refusal; None until it is known.
        completion: how the order ended; None until it has.
        events: events of the node since the acceptance.
    """

    def __init__(self, order: Order, name: str = "", after_ns: int = 0) -> None:
        self.order = order
        self.name = name
        self._after_ns = after_ns
        request = order.command.request
        if request is not None:
            self.node, self.subject = request.node, request.topic
        else:
            (call,) = order.command.calls
            (self.node,), self.subject = call.servers, call.service
        self.goal: PoseSample | None = None
        self.record: CommandRecord | None = None
        self.outcome: OrderResult | None = None
        self.completion: Completion | None = None
        self.events: list[Status] = []

    def aim(self, goal: PoseSample) -> None:
        """Set the goal of a relative request, whose record is found by its stamp."""
        self.goal = goal

    def on_statuses(self, topic: str, sample: StatusSample) -> None:
        """Process a message of the topics of records or events."""
        for status in sample.statuses:
            if status.hardware_id != self.node:
                continue
            if topic == topics.COMMANDS:
                self._on_record(read_command(status))
            elif topic == topics.EVENTS:
                self._on_event(status)

    def _on_record(self, record: CommandRecord | None) -> None:
        if record is None or record.subject != self.subject or not self._is_own(record):
            return
        self.record = record
        refused = record.state is CommandState.REFUSED
        code = record.reason.value if refused and record.reason is not None else ""
        if self.outcome is None:
            status = OrderStatus.REFUSED if refused else OrderStatus.ACCEPTED
            reason = record.text if refused else "accepted"
            self.outcome = OrderResult(status, record.subject, reason, code)
            if refused:
                return
        if record.state.is_over and self.completion is None:
            is_done = record.state is CommandState.DONE
            text = record.text + (f" [{code}]" if refused else "")
            self.completion = Completion(is_done, text if is_done else f"{record.state}: {text}")

    def _is_own(self, record: CommandRecord) -> bool:
        if self.order.command.request is None:
            if self.record is None:
                return record.taken_ns > self._after_ns
            return record.key == self.record.key
        own = split_name(self.name) if self.goal is None else ("", str(self.goal.stamp_ns))
        return (record.sender, record.identifier) == own

    def _on_event(self, status: Status) -> None:
        if self.outcome is None or not self.outcome.is_accepted or self.completion is not None:
            return
        self.events.append(status)
        if status.name == NodeEvent.ACTIVE:
            self.lose(f"{self.node} has started again")

    def lose(self, reason: str) -> Completion:
        """Complete the order without success: its record has been lost."""
        self.completion = Completion(False, f"{reason}, the command is lost")
        return self.completion


class SentOrder:
    """An order that was sent.

    Attributes:
        order: the order.
        outcome: its result.
        exchange: of an order that lasts, the source of later events.
        answered: steady time of the answer [s].
    """

    def __init__(
        self, order: Order, outcome: OrderResult, exchange: Exchange | None = None
    ) -> None:
        self.order = order
        self.outcome = outcome
        self.exchange = exchange
        self.answered = time.monotonic()


_CODED = re.compile(r"^(?:(?P<subject>\S+): )?(?P<reason>.*) \[(?P<code>[a-z_]+)\]$", re.DOTALL)


def answer_of(service: str, success: bool, message: str) -> OrderResult:
    """Convert a service's response."""
    if success:
        return OrderResult(OrderStatus.ACCEPTED, service, message or "done")
    match = _CODED.match(message)
    if match is None or match["code"] not in list(RefusalCode):
        return OrderResult(OrderStatus.REFUSED, service, message or "no reason given")
    return OrderResult(OrderStatus.REFUSED, service, match["reason"], match["code"])


# A node that refuses with one of these codes has nothing to stop.
_IDLE = frozenset({RefusalCode.WRONG_PHASE, RefusalCode.NOT_ARMED, RefusalCode.NOT_ACTIVE})
_WORST_FIRST = (OrderStatus.CANCELLED, OrderStatus.NO_ANSWER, OrderStatus.REFUSED)


def joined(parts: Iterable[OrderResult], all_required: bool) -> OrderResult:
    """Combine the results of several services into one."""
    found = tuple(parts)
    if len(found) == 1:
        return found[0]
    accepted = [part for part in found if part.is_accepted]
    unavailable = [part for part in found if part.status is OrderStatus.UNAVAILABLE]
    missing = "; ".join(f"{part.by}: {part.reason}" for part in unavailable)
    note = f" (without {missing})" if unavailable else ""
    for status in _WORST_FIRST:
        for part in found:
            is_idle = part.code in _IDLE and accepted and not all_required
            if part.status is status and not is_idle:
                return OrderResult(status, part.by, part.reason + note, part.code, found)
    if not accepted:
        names = ", ".join(part.by for part in found)
        why = "; ".join(part.reason for part in unavailable)
        return OrderResult(OrderStatus.UNAVAILABLE, names, why, parts=found)
    reasons = "; ".join(part.reason for part in accepted)
    by = ", ".join(part.by for part in accepted)
    return OrderResult(OrderStatus.ACCEPTED, by, reasons + note, parts=found)
