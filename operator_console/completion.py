"""The end of an order, done or not."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Completion:
    """The end of an order.

    Attributes:
        is_done: whether the goal is reached.
        reason: why, for people.
    """

    is_done: bool
    reason: str
