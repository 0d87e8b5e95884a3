"""How it is recognised that what an operator asked for is over, done or not. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from msg_schemas.samples import Level, Status


@dataclass(frozen=True)
class Completion:
    """That it is over.

    Attributes:
        is_done: what was asked for is reached.
        reason: as the node says it.
    """

    is_done: bool
    reason: str


@dataclass(frozen=True)
class CompletionCriterion:
    """Events of the node that took the request tell its end.

    Attributes:
        done: the event that ends it; a failure where its level is not OK.
        of: values of that event, each equal to the argument of that name: another's end is none.
        near: values of that event that must be near the argument, else it ended elsewhere:
            name of the argument, and how near.
        lost: events after which it will not be reached any more.
    """

    done: str
    of: Mapping[str, str] = field(default_factory=dict)
    near: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    lost: tuple[str, ...] = ()

    def judge(self, event: Status, arguments: Mapping[str, float]) -> Completion | None:
        """What an event means for a request with these arguments; None = it goes on."""
        if event.name in self.lost:
            return Completion(False, f"{event.name}: {event.message}")
        if event.name != self.done:
            return None
        if any(_number(event, value) != arguments[name] for value, name in self.of.items()):
            return None
        reached = all(
            abs(_number(event, value) - arguments[name]) <= within
            for value, (name, within) in self.near.items()
        )
        return Completion(reached and event.level is Level.OK, event.message)


def _number(event: Status, value: str) -> float:
    try:
        return float(event.values[value])
    except (KeyError, ValueError):
        return float("nan")
