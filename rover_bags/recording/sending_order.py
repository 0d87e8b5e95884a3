"""Received messages in the order in which they were sent."""

from __future__ import annotations

import bisect
from collections.abc import Iterable

from rover_bags.files.write_queue import Item


class SendingOrder:
    """Holds received messages until earlier ones have arrived.

    Batches overlap: one that takes longer to the recorder than the next seems to be received after
    it, and of a topic with several publishers, the batches of one arrive after a later one of
    another.
    """

    def __init__(self) -> None:
        self._held: list[Item] = []
        self._logged: dict[str, int] = {}  # log time of the last message by topic [ns since 1970]

    def add(self, items: Iterable[Item]) -> None:
        """Hold messages."""
        self._held += items

    def take(self, until_ns: int) -> list[Item]:
        """Return the messages that were sent until then [ns since 1970], in the order of sending.

        The log times of a topic do not go back.
        """
        self._held.sort(key=_sent)
        count = bisect.bisect(self._held, until_ns, key=_sent)
        taken = [self._in_order(item) for item in self._held[:count]]
        del self._held[:count]
        return taken

    def _in_order(self, item: Item) -> Item:
        name = item.source.name
        log_ns = max(item.log_ns, self._logged.get(name, 0))
        self._logged[name] = log_ns
        return item._replace(log_ns=log_ns)


def _sent(item: Item) -> int:
    """Return when a message was sent; the clock of another machine may be ahead [ns since 1970]."""
    return min(item.publish_ns, item.log_ns)
