"""Received messages in the order in which they were sent."""

from __future__ import annotations

from collections.abc import Iterable

from rover_bags.files.write_queue import Item

_CLOCK_STEP_NS = 10_000_000_000  # back, by which only the machine's clock can have been set [ns]


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
        """Return the messages that were received until then [ns since 1970], by their log times.

        The messages of a topic are in the order of sending, and their log times do not go back,
        unless the machine's clock is set back.
        """
        self._held.sort(key=_sent)
        logged = self._logged.copy()
        items = [_logged_after(item, logged) for item in self._held]
        self._held = [item for item in items if item.log_ns > until_ns]
        taken = sorted((item for item in items if item.log_ns <= until_ns), key=_log_time)
        self._logged |= {item.source.name: item.log_ns for item in taken}
        return taken


def times_in_batch(sent_ns: int, batch_sent_ns: int, received_ns: int) -> tuple[int, int]:
    """Return log time and time of sending of a message of a batch [ns since 1970].

    No message is sent after its batch, whatever a foreign batch states.

    Args:
        sent_ns: When it was sent, as the batch states.
        batch_sent_ns: When the batch was sent, by the same clock.
        received_ns: When the batch was received.
    """
    sent = min(sent_ns, batch_sent_ns)
    return max(sent + received_ns - batch_sent_ns, 0), sent


def _logged_after(item: Item, logged: dict[str, int]) -> Item:
    """Return a message that is not logged before the last one of its topic, and note it."""
    name = item.source.name
    last = logged.get(name, 0)
    if 0 < last - item.log_ns < _CLOCK_STEP_NS:
        return item._replace(log_ns=last)
    logged[name] = item.log_ns
    return item


def _log_time(item: Item) -> int:
    return item.log_ns


def _sent(item: Item) -> int:
    """Return when a message was sent; the clock of another machine may be ahead [ns since 1970]."""
    return min(item.publish_ns, item.log_ns)
