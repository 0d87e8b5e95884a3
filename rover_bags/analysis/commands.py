"""Commands recorded in a bag: who sent them, when they were taken and ended, and why."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from msg_schemas import topics
from msg_schemas.commands import CommandTable, read_command
from msg_schemas.samples import Status
from rover_bags.reading.read import Bag, TimeSeries


@dataclass(frozen=True)
class RecordedCommand:
    """A command and what became of it.

    Attributes:
        node: The node that took it.
        request: Topic or service, and content.
        sender: Sender and identifier; without a sender the identifier alone.
        taken_s: When it was taken, by the node's clock [s].
        changed_s: When it ended, or last changed, by the node's clock [s].
        state, reason: Words of the contract; an empty reason: it has not ended.
        text: Reason or last activity, for people.
        progress: Fraction done; None: unknown.
    """

    node: str
    request: str
    sender: str
    taken_s: float
    changed_s: float
    state: str
    reason: str
    text: str
    progress: float | None


def commands_of(bag: Bag) -> tuple[RecordedCommand, ...]:
    """Return the commands of a bag in the order in which they were taken."""
    table = CommandTable()
    received = [
        (log_ns, topic, stamp_ns, status)
        for topic in (topics.EVENTS, topics.COMMANDS)
        for log_ns, stamp_ns, statuses in _messages(bag.series(topic))
        for status in statuses
    ]
    for _, topic, stamp_ns, status in sorted(received, key=lambda each: each[0]):
        if topic == topics.COMMANDS:
            record = read_command(status)
            if record is not None:
                table.on_record(record, stamp_ns)
        else:
            table.on_event(status, stamp_ns)
    found = [
        RecordedCommand(
            record.node,
            f"{record.subject} {record.what}".rstrip(),
            f"{record.sender}#{record.identifier}" if record.sender else record.identifier,
            record.taken_ns * 1e-9,
            changed_ns * 1e-9,
            record.state.value,
            "" if record.reason is None else record.reason.value,
            record.text,
            None if math.isnan(record.progress) else record.progress,
        )
        for record, changed_ns in table
    ]
    return tuple(sorted(found, key=lambda each: each.taken_s))


def _messages(series: TimeSeries | None) -> Iterable[tuple[int, int, Sequence[Status]]]:
    if series is None:
        return ()
    return zip(series.log_ns.tolist(), series.stamp_ns.tolist(), series.statuses, strict=True)
