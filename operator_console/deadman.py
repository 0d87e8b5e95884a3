"""Orders that last for as long as somebody presses: a dead man's switch over a network.

Who presses says so again and again, and each time the order is said again to the machine, once.
Here nothing runs by itself: where the press, the browser or the network ends, so do the renewals,
and the winch stops by its own timeout.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Generic, NamedTuple, TypeVar

from operator_console.completion import Completion

LONGEST_GAP: Final = 1.0
"""A press that was not heard for longer is over [s]: as the winch has it."""

_MOST: Final = 16  # presses that are remembered

O = TypeVar("O")  # noqa: E741 - an order


class Renewal(NamedTuple):
    """What became of one."""

    is_done: bool
    reason: str


@dataclass
class _Held(Generic[O]):
    order: O
    heard: float  # [s]


class DeadmanCommands(Generic[O]):
    """Those that are pressed.

    Args:
        say_again: says an order to the machine once more; returns how it ended, if it has.
        clock: steady [s].
    """

    def __init__(
        self,
        say_again: Callable[[O], Completion | None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._say_again = say_again
        self._clock = clock
        self._held: dict[str, _Held[O]] = {}

    def begin(self, order: O) -> str:
        """Hold an order that was accepted; returns the name by which it is renewed."""
        name = secrets.token_hex(8)
        self._held[name] = _Held(order, self._clock())
        while len(self._held) > _MOST:
            del self._held[next(iter(self._held))]
        return name

    def renew(self, name: str) -> Renewal:
        """Say it again, if it is held still."""
        held = self._held.get(name)
        if held is None:
            return Renewal(False, "nothing is held by that name")
        gap = self._clock() - held.heard
        if gap > LONGEST_GAP:
            del self._held[name]
            return Renewal(False, f"it was not held for {gap:.1f} s")
        ending = self._say_again(held.order)
        if ending is not None:
            del self._held[name]
            return Renewal(False, ending.reason)
        held.heard = self._clock()
        return Renewal(True, "held")
