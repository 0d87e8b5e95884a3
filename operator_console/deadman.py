"""Dead-man commands: they last while an operator presses a button on the page.

The page repeats that the button is pressed, and each repetition sends the request once. Nothing is
renewed by a timer here: if the operator, the browser or the network stops, the requests stop, and
the winch stops by its own timeout.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Generic, NamedTuple, TypeVar

from operator_console.exchange import Completion

RENEWAL_TIMEOUT: Final = 1.0
"""A press without renewal for longer has ended [s]; equals the winch's timeout."""

_CAPACITY: Final = 16  # presses kept

O = TypeVar("O")  # noqa: E741 - an order


class Renewal(NamedTuple):
    """Result of one renewal."""

    is_done: bool
    reason: str


@dataclass
class _Press(Generic[O]):
    order: O
    renewed: float  # [s]


class DeadmanCommands(Generic[O]):
    """Orders whose buttons are pressed.

    Args:
        send_again: repeats an order to the machine; returns its completion if it has ended.
        clock: steady clock [s].
    """

    def __init__(
        self,
        send_again: Callable[[O], Completion | None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._send_again = send_again
        self._clock = clock
        self._presses: dict[str, _Press[O]] = {}

    def begin(self, order: O) -> str:
        """Register an accepted order; return the key for its renewals."""
        name = secrets.token_hex(8)
        self._presses[name] = _Press(order, self._clock())
        while len(self._presses) > _CAPACITY:
            del self._presses[next(iter(self._presses))]
        return name

    def end(self, name: str) -> None:
        """Forget a press: its renewals are refused."""
        self._presses.pop(name, None)

    def renew(self, name: str) -> Renewal:
        """Send the order again if its button is still pressed."""
        press = self._presses.get(name)
        if press is None:
            return Renewal(False, "this press is not known or has ended")
        gap = self._clock() - press.renewed
        if gap > RENEWAL_TIMEOUT:
            del self._presses[name]
            return Renewal(
                False, f"the press was not renewed for {gap:.1f} s (limit {RENEWAL_TIMEOUT:g} s)"
            )
        completion = self._send_again(press.order)
        if completion is not None:
            del self._presses[name]
            return Renewal(False, completion.reason)
        press.renewed = self._clock()
        return Renewal(True, "renewed")
