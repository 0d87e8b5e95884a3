"""Base class of all expectations, with their ranges and times.

An expectation is a frozen configuration: its fields are the keys of the procedure. Times are in
seconds of the clock that stamps the machine's messages, and are measured by these stamps: a slow
network or a busy computer does not change the result.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from msg_schemas.configuration import Configuration, ConfigurationError, quantity
from rover_hil.rehearsal.expectation_result import ExpectationResult
from rover_hil.rehearsal.message_history import EvaluationWindow

NANO = 1e9
LATE = 0.5
"""An unexpected message is awaited for so long after the end of the window [s]."""
LONGEST = 3600.0
"""Longest time that a procedure may give [s]."""


def is_in_range(value: float, minimum: float | None, maximum: float | None) -> bool:
    """Whether a value lies in a range; None leaves an end open."""
    return (minimum is None or value >= minimum) and (maximum is None or value <= maximum)


def range_text(minimum: float | None, maximum: float | None, unit: str) -> str:
    """A range as text."""
    unit = "" if unit in {"", "-"} else f" {unit}"
    if minimum is None:
        return f"at most {maximum:g}{unit}"
    if maximum is None:
        return f"at least {minimum:g}{unit}"
    return f"{minimum:g} to {maximum:g}{unit}"


def check_range(minimum: float | None, maximum: float | None) -> None:
    """Refuse a range without ends, or with minimum above maximum."""
    if minimum is None and maximum is None:
        raise ConfigurationError("minimum", None, "missing; give minimum, maximum or both")
    if minimum is not None and maximum is not None and minimum > maximum:
        raise ConfigurationError("minimum", minimum, f"should be at most the maximum, {maximum:g}")


def bound(unit: str, about: str) -> Any:
    """Field for one end of a range."""
    return quantity(unit, about, None, optional=True)


def within(about: str, default: float = 1.0) -> Any:
    """Field for a time [s]."""
    return quantity("s", about, default, minimum=0.0, maximum=LONGEST)


@dataclass(frozen=True, kw_only=True)
class Expectation(Configuration):
    """Base class of all expectations."""

    @property
    def subscribed_topics(self) -> tuple[str, ...]:
        """Topics to subscribe to."""
        return ()

    @property
    def evaluated_after(self) -> float:
        """Time of the actions after which it is evaluated [s]; negative: also without any."""
        return -1.0

    def is_decided(self, window: EvaluationWindow, now_ns: int) -> bool:
        """Whether waiting longer cannot change the result; called after the actions have ended."""
        raise NotImplementedError

    def evaluate(self, window: EvaluationWindow) -> tuple[ExpectationResult, ...]:
        """The results, one for each tested quantity."""
        raise NotImplementedError
