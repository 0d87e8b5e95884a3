"""Match the answers of nodes to one operator's order.

A request carries a command source in ``header.frame_id``. The node repeats that name when it
accepts (an event) or refuses (on diagnostics). Its later events belong to the accepted request.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from msg_schemas import topics
from msg_schemas.events import NodeEvent
from msg_schemas.refusal import RefusalCode, read_refusal
from msg_schemas.samples import PoseSample, Status, StatusSample
from operator_console.commands import Order
from operator_console.completion import Completion


class OrderStatus(StrEnum):
    """What happened to an order."""

    ACCEPTED = "accepted"
    REFUSED = "refused"
    UNAVAILABLE = "no node available"
    NO_ANSWER = "no answer"
    CANCELLED = "cancelled"


@dataclass(frozen=True)
class Outcome:
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
    parts: tuple[Outcome, ...] = ()

    @property
    def is_accepted(self) -> bool:
        """Whether a node accepted it."""
        return self.status is OrderStatus.ACCEPTED

    @property
    def is_failure(self) -> bool:
        """Whether an available node did not accept it."""
        return self.status not in {OrderStatus.ACCEPTED, OrderStatus.UNAVAILABLE}

    @property
    def text(self) -> str:
        """One sentence for operators."""
        code = f" [{self.code}]" if self.code else ""
        what = self.by if self.status is OrderStatus.ACCEPTED else f"{self.by} {self.status.value}"
        return f"{what}: {self.reason}{code}"


class Exchange:
    """A request in progress: filters its answers from all status messages.

    Args:
        order: a command with a request.
        command_source: the name that the request carries.

    Attributes:
        goal: pose of a relative request.
        outcome: acceptance or refusal; None until it is known.
        completion: how the request ended; None until it has.
        events: events of the node since the acceptance.
    """

    def __init__(self, order: Order, command_source: str) -> None:
        request = order.command.request
        assert request is not None
        self.order = order
        self.request = request
        self.command_source = command_source
        self.goal: PoseSample | None = None
        self.outcome: Outcome | None = None
        self.completion: Completion | None = None
        self.events: list[Status] = []

    def on_statuses(self, topic: str, sample: StatusSample) -> None:
        """Process a message of the events or diagnostics topic."""
        for status in sample.statuses:
            if status.hardware_id != self.request.node:
                continue
            if topic == topics.EVENTS:
                self._on_event(status)
            elif topic == topics.DIAGNOSTICS:
                self._on_refusal(status)

    def _on_event(self, status: Status) -> None:
        if status.name == NodeEvent.REQUEST_ACCEPTED:
            if status.values.get("command_source") == self.command_source and self.outcome is None:
                self.outcome = Outcome(OrderStatus.ACCEPTED, self.request.topic, "accepted")
            return
        if self.outcome is None or not self.outcome.is_accepted or self.completion is not None:
            return
        self.events.append(status)
        criterion = self.order.command.completion
        if criterion is not None:
            self.completion = criterion.evaluate(status, self.order.contract_values)

    def _on_refusal(self, status: Status) -> None:
        refusal, topic = read_refusal(status), self.request.topic
        if refusal is None or refusal.subject != topic:
            return
        if refusal.command_source != self.command_source:
            return
        code = refusal.code.value
        if self.outcome is None:
            self.outcome = Outcome(OrderStatus.REFUSED, topic, refusal.reason, code)
        elif self.completion is None:  # a renewal is refused
            self.completion = Completion(False, f"refused: {refusal.reason} [{code}]")


_CODED = re.compile(r"^(?:(?P<subject>\S+): )?(?P<reason>.*) \[(?P<code>[a-z_]+)\]$", re.DOTALL)


def answer_of(service: str, success: bool, message: str) -> Outcome:
    """Convert a service's response."""
    if success:
        return Outcome(OrderStatus.ACCEPTED, service, message or "done")
    match = _CODED.match(message)
    if match is None or match["code"] not in list(RefusalCode):
        return Outcome(OrderStatus.REFUSED, service, message or "no reason given")
    return Outcome(OrderStatus.REFUSED, service, match["reason"], match["code"])


# A node that refuses with one of these codes has nothing to stop.
_IDLE = frozenset({RefusalCode.WRONG_PHASE, RefusalCode.NOT_ARMED, RefusalCode.NOT_ACTIVE})
_WORST_FIRST = (OrderStatus.CANCELLED, OrderStatus.NO_ANSWER, OrderStatus.REFUSED)


def joined(parts: Iterable[Outcome], all_required: bool) -> Outcome:
    """Combine the results of several services into one."""
    found = tuple(parts)
    if len(found) == 1:
        return found[0]
    accepted = [part for part in found if part.is_accepted]
    unavailable = [part.reason for part in found if part.status is OrderStatus.UNAVAILABLE]
    note = f" ({'; '.join(unavailable)})" if unavailable else ""
    for status in _WORST_FIRST:
        for part in found:
            is_idle = part.code in _IDLE and accepted and not all_required
            if part.status is status and not is_idle:
                return Outcome(status, part.by, part.reason + note, part.code, found)
    if not accepted:
        names = ", ".join(part.by for part in found)
        return Outcome(OrderStatus.UNAVAILABLE, names, "; ".join(unavailable), parts=found)
    reasons = "; ".join(part.reason for part in accepted)
    by = ", ".join(part.by for part in accepted)
    return Outcome(OrderStatus.ACCEPTED, by, reasons + note, parts=found)
