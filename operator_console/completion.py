"""Completion criteria: they recognise from events that a request has ended, done or not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from msg_schemas.events import EventName
from msg_schemas.faults import Reason
from msg_schemas.samples import Status


@dataclass(frozen=True)
class Completion:
    """The end of a request.

    Attributes:
        is_done: whether the goal is reached.
        reason: the node's message.
    """

    is_done: bool
    reason: str


@dataclass(frozen=True)
class CompletionCriterion:
    """Events of the node that accepted a request, which show its end.

    Attributes:
        event: event that completes the request; None = it lasts until it is aborted.
        failed_by: events that end the request without success.
        matching: values of these events that must equal an argument, by the value's name; another
            request's event does not match.
        aborted_by: events after which the goal is not reached any more.
        reasons: reasons of the completing event that mean success; empty = every reason.

    Raises:
        ValueError: an event does not declare a value that the criterion reads.
    """

    event: EventName | None
    failed_by: tuple[EventName, ...] = ()
    matching: Mapping[str, str] = field(default_factory=dict)
    aborted_by: tuple[EventName, ...] = ()
    reasons: tuple[Reason, ...] = ()

    def __post_init__(self) -> None:
        """Refuse values that the events do not declare."""
        completing = [] if self.event is None else [self.event]
        required = [
            (event, value) for event in (*completing, *self.failed_by) for value in self.matching
        ] + [(event, "reason") for event in completing if self.reasons]
        for event, value in required:
            if value not in event.values:
                declared = ", ".join(event.values) or "none"
                raise ValueError(
                    f"event {event} declares no value {value!r}, it declares: {declared}"
                )

    def evaluate(self, event: Status, arguments: Mapping[str, float]) -> Completion | None:
        """What an event means for a request with these arguments; None = it continues."""
        if event.name in self.aborted_by:
            return Completion(False, f"{event.name}: {event.message}")
        if event.name not in (self.event, *self.failed_by):
            return None
        if any(_number(event, value) != arguments[name] for value, name in self.matching.items()):
            return None
        reached = event.name == self.event
        if self.reasons:
            reached = reached and event.values.get("reason") in self.reasons
        return Completion(reached, event.message)


def _number(event: Status, value: str) -> float:
    try:
        return float(event.values[value])
    except (KeyError, ValueError):
        return float("nan")
