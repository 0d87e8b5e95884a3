"""One order and what comes back for it: how answers are recognised among all that nodes say. Pure.

A request bears a name of its own in ``header.frame_id``; the node that takes it repeats that name
when it accepts (an event) or refuses (on diagnostics). What that node tells by events after the
acceptance is about what it accepted.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from msg_schemas import topics
from msg_schemas.refusal import REQUEST_ACCEPTED, RefusalCode
from msg_schemas.samples import PoseSample, Status, StatusSample
from operator_console.commands import Order
from operator_console.completion import Completion


class Verdict(StrEnum):
    """What became of an order."""

    ACCEPTED = "accepted"
    REFUSED = "refused"
    NOBODY = "nobody is there to take it"
    NO_ANSWER = "no answer"
    GIVEN_UP = "given up"


@dataclass(frozen=True)
class Outcome:
    """What became of an order, or of a part of it.

    Attributes:
        verdict: in one word.
        by: topic or service by which it went.
        reason: why, as the node says it; of an acceptance what it does.
        code: of a refusal, as the contract has it; empty where the node gave none.
        parts: of an order that went several ways, what became of each.
    """

    verdict: Verdict
    by: str
    reason: str
    code: str = ""
    parts: tuple[Outcome, ...] = ()

    @property
    def is_accepted(self) -> bool:
        """Whether it is done, or being done."""
        return self.verdict is Verdict.ACCEPTED

    @property
    def is_trouble(self) -> bool:
        """Whether somebody was there, and did not do it."""
        return self.verdict not in {Verdict.ACCEPTED, Verdict.NOBODY}

    @property
    def text(self) -> str:
        """One sentence for people."""
        code = f" [{self.code}]" if self.code else ""
        what = self.by if self.verdict is Verdict.ACCEPTED else f"{self.by} {self.verdict.value}"
        return f"{what}: {self.reason}{code}"


class Exchange:
    """A request on its way: hears all statuses, and keeps what is an answer to it.

    Args:
        order: a command that is a request.
        commander: the name that the request bears.

    Attributes:
        goal: of a request ahead, the pose that is asked for.
        outcome: acceptance or refusal; None until it is known.
        ending: that it is over; None until it is.
        story: events of the taker since the acceptance.
    """

    def __init__(self, order: Order, commander: str) -> None:
        request = order.command.request
        assert request is not None
        self.order = order
        self.request = request
        self.commander = commander
        self.goal: PoseSample | None = None
        self.outcome: Outcome | None = None
        self.ending: Completion | None = None
        self.story: list[Status] = []

    def hear(self, topic: str, sample: StatusSample) -> None:
        """Take what was said on events or diagnostics."""
        for status in sample.statuses:
            if status.hardware_id != self.request.taker:
                continue
            if topic == topics.EVENTS:
                self._on_event(status)
            elif topic == topics.DIAGNOSTICS:
                self._on_refusal(status)

    def _on_event(self, status: Status) -> None:
        if status.name == REQUEST_ACCEPTED:
            if status.values.get("commander") == self.commander and self.outcome is None:
                self.outcome = Outcome(Verdict.ACCEPTED, self.request.topic, "accepted")
            return
        if self.outcome is None or not self.outcome.is_accepted or self.ending is not None:
            return
        self.story.append(status)
        ends = self.order.command.ends
        if ends is not None:
            self.ending = ends.judge(status, self.order.told)

    def _on_refusal(self, status: Status) -> None:
        taker, topic = self.request.taker, self.request.topic
        if status.name == f"{taker}: refused {topic}":
            if status.values.get("commander") != self.commander:
                return
            code = status.values.get("code", "")
            if self.outcome is None:
                self.outcome = Outcome(Verdict.REFUSED, topic, status.message, code)
            elif self.ending is None:  # of what was said again
                self.ending = Completion(False, f"refused: {status.message} [{code}]")


_CODED = re.compile(r"^(?:(?P<subject>\S+): )?(?P<reason>.*) \[(?P<code>[a-z_]+)\]$", re.DOTALL)


def answer_of(service: str, success: bool, message: str) -> Outcome:
    """What a service's answer means."""
    if success:
        return Outcome(Verdict.ACCEPTED, service, message or "done")
    match = _CODED.match(message)
    if match is None or match["code"] not in list(RefusalCode):
        return Outcome(Verdict.REFUSED, service, message or "no reason given")
    return Outcome(Verdict.REFUSED, service, match["reason"], match["code"])


# A node that refuses so has nothing under way.
_IDLE = frozenset({RefusalCode.WRONG_PHASE, RefusalCode.NOT_ARMED, RefusalCode.NOT_ACTIVE})
_WORST_FIRST = (Verdict.GIVEN_UP, Verdict.NO_ANSWER, Verdict.REFUSED)


def joined(parts: Iterable[Outcome], needs_all: bool) -> Outcome:
    """What became of an order that went to several servers, or would have."""
    found = tuple(parts)
    if len(found) == 1:
        return found[0]
    accepted = [part for part in found if part.is_accepted]
    away = [part.reason for part in found if part.verdict is Verdict.NOBODY]
    note = f" ({'; '.join(away)})" if away else ""
    for verdict in _WORST_FIRST:
        for part in found:
            is_idle = part.code in _IDLE and accepted and not needs_all
            if part.verdict is verdict and not is_idle:
                return Outcome(verdict, part.by, part.reason + note, part.code, found)
    if not accepted:
        names = ", ".join(part.by for part in found)
        return Outcome(Verdict.NOBODY, names, "; ".join(away), parts=found)
    told = "; ".join(part.reason for part in accepted)
    by = ", ".join(part.by for part in accepted)
    return Outcome(Verdict.ACCEPTED, by, told + note, parts=found)
