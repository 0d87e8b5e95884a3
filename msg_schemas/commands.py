"""Records of commands: what became of each request and service call, and how `commands` reports it.

The component that took a command keeps its record and publishes every change. A record that has
ended never changes again.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

from msg_schemas.described import Described
from msg_schemas.events import NodeEvent
from msg_schemas.faults import Reason
from msg_schemas.refusal import RefusalCode
from msg_schemas.samples import (
    JointSample,
    Level,
    PathSample,
    PoseEstimateSample,
    PoseSample,
    Sample,
    Status,
)
from msg_schemas.specifications import Topic
from msg_schemas.text_limits import LONGEST_NAME, LONGEST_REASON, cut, printable

_RESULT = "result."  # prefix of the names of result values
_END_NS = 2**63  # of times [ns since 1970]


class CommandState(Described):
    """State of a command."""

    REFUSED = "refused", "it was not taken; the reason is the code of the refusal"
    ACCEPTED = "accepted", "it was taken and has not begun"
    RUNNING = "running", "it is being executed; `progress` is the fraction done, where it is known"
    DONE = "done", "its goal is reached, or it needed no time"
    FAILED = "failed", "its goal will not be reached"
    SUPERSEDED = "superseded", "a newer command has replaced or stopped it"
    EXPIRED = "expired", "its sender has not renewed it in time"

    @property
    def is_over(self) -> bool:
        """Whether it never changes again."""
        return self not in (CommandState.ACCEPTED, CommandState.RUNNING)


_STATES = {
    Reason.COMPLETED: CommandState.DONE,
    Reason.REQUESTED: CommandState.SUPERSEDED,
    Reason.SUPERSEDED: CommandState.SUPERSEDED,
    Reason.TAKEN_OVER: CommandState.SUPERSEDED,
    Reason.RENEWAL_TIMEOUT: CommandState.EXPIRED,
}


def state_after(reason: Reason) -> CommandState:
    """Return the last state of a command that ended for a reason."""
    return _STATES.get(reason, CommandState.FAILED)


@dataclass(frozen=True)
class CommandRecord:
    """What became of a command.

    Attributes:
        node: component that took it.
        subject: topic or service that it came by.
        sender: who sent it; empty = not named.
        identifier: chosen by the sender, else the stamp of the message or the time of taking [ns].
        taken_ns: when it was taken [ns].
        state: its state.
        what: its content for people, such as ``plain_stop 12 m``.
        reason: code of a refusal, or why it ended; None = it has not ended.
        text: reason or present activity, for people.
        progress: fraction done, 0 .. 1; nan = unknown.
        expiry: time without a renewal after which it expires [s]; inf = it needs no renewal.
        result: values of the event that ended it, by their names.
    """

    node: str
    subject: str
    sender: str
    identifier: str
    taken_ns: int
    state: CommandState
    what: str = ""
    reason: RefusalCode | Reason | None = None
    text: str = ""
    progress: float = math.nan
    expiry: float = math.inf
    result: Mapping[str, str] = field(default_factory=dict)

    @property
    def key(self) -> tuple[str, str, str, str, int]:
        """What all records of this command, and of no other, have in common."""
        return self.node, self.subject, self.sender, self.identifier, self.taken_ns

    @property
    def is_warning(self) -> bool:
        """Whether it ended otherwise than by a request."""
        return self.state in (CommandState.REFUSED, CommandState.FAILED, CommandState.EXPIRED)

    def number(self, name: str) -> float:
        """A number of the result; NaN = it has none of this name."""
        try:
            return float(self.result[name])
        except (KeyError, ValueError):
            return math.nan

    def status(self) -> Status:
        """The line of `commands`."""
        values = {
            "sender": self.sender,
            "id": self.identifier,
            "taken": str(self.taken_ns),
            "state": self.state.value,
            "what": self.what,
            "reason": "" if self.reason is None else self.reason.value,
            "progress": "" if math.isnan(self.progress) else f"{self.progress:g}",
            "expiry": "" if math.isinf(self.expiry) else f"{self.expiry:g}",
        }
        values |= {_RESULT + name: value for name, value in self.result.items()}
        level = Level.WARN if self.is_warning else Level.OK
        return Status(self.subject, cut(self.text, LONGEST_REASON), level, self.node, values)


def read_command(status: Status) -> CommandRecord | None:
    """Decode a line of `commands`; None = it is no record."""
    values = status.values
    try:
        state = CommandState(values["state"])
        word = values["reason"]
        reason: RefusalCode | Reason | None = None
        if word:
            reason = RefusalCode(word) if state is CommandState.REFUSED else Reason(word)
        taken_ns, progress = int(values["taken"]), values["progress"]
        if not (0 <= taken_ns < _END_NS and 0.0 <= float(progress or 0.0) <= 1.0):
            return None
        return CommandRecord(
            status.hardware_id,
            status.name,
            values["sender"],
            values["id"],
            taken_ns,
            state,
            values["what"],
            reason,
            status.message,
            float(progress or math.nan),
            float(values["expiry"] or math.inf),
            {k.removeprefix(_RESULT): v for k, v in values.items() if k.startswith(_RESULT)},
        )
    except (KeyError, ValueError):
        return None


class CommandTable:
    """The latest record of each command, of all components, the last changed one last.

    Args:
        limit: commands to keep; the least recently changed ones are forgotten. None = no limit.
    """

    def __init__(self, limit: int | None = None) -> None:
        self._limit = limit
        self._rows: dict[tuple[str, str, str, str, int], tuple[CommandRecord, int]] = {}
        self._active: set[str] = set()  # components that have started and not ended

    def __iter__(self) -> Iterator[tuple[CommandRecord, int]]:
        """Yield each record with the time of its last change [ns]."""
        return iter(self._rows.values())

    def on_record(self, record: CommandRecord, stamp_ns: int) -> None:
        """Process a record that was published at a time [ns]."""
        self._rows.pop(record.key, None)
        self._rows[record.key] = record, stamp_ns
        while self._limit is not None and len(self._rows) > self._limit:
            del self._rows[next(iter(self._rows))]

    def on_event(self, event: Status, stamp_ns: int) -> None:
        """Process an event that was published at a time [ns]: a new start knows no earlier command.

        A component that starts without having ended was killed. Its clock may not be known yet, or
        have begun anew.
        """
        node = event.hardware_id
        if event.name == NodeEvent.INACTIVE:
            self._active.discard(node)
        if event.name != NodeEvent.ACTIVE:
            return
        for record, changed_ns in tuple(self._rows.values()):
            is_older = record.taken_ns < stamp_ns or node in self._active
            if record.node == node and is_older and not record.state.is_over:
                text = f"{node} has started again"
                lost = replace(
                    record, state=CommandState.FAILED, reason=Reason.RESTARTED, text=text
                )
                self.on_record(lost, max(stamp_ns, changed_ns))
        self._active.add(node)


def split_name(text: str) -> tuple[str, str]:
    """Return the sender and the identifier that a message's `frame_id` names.

    The identifier follows the last ``#``; empty = none. Long names are cut, and characters that
    cannot be shown are replaced.
    """
    sender, _, identifier = text.rpartition("#") if "#" in text else (text, "", "")
    return printable(sender[:LONGEST_NAME]), printable(identifier[:LONGEST_NAME])


def content_of(row: Topic, sample: Sample) -> str:
    """Return the content of a request for people."""
    if isinstance(sample, JointSample):
        return ", ".join(
            f"{name} {_first(row, name, value)}" for name, value in sample.joints.items()
        )
    if isinstance(sample, PoseSample | PoseEstimateSample):
        return f"({sample.position[0]:g}, {sample.position[1]:g}) m"
    if isinstance(sample, PathSample):
        return f"{len(sample.poses)} poses" if len(sample.poses) != 1 else "1 pose"
    return ""


def _first(row: Topic, name: str, value: tuple[float, float, float]) -> str:
    """The first part of a joint that its topic uses, with its unit."""
    for part, number in zip(("position", "velocity", "effort"), value, strict=True):
        field = row.by_path[f"{name}.{part}"]
        is_used = field.minimum < field.maximum
        if is_used and (field.default is None or number):
            return f"{number:g} {field.unit}"
    return ""
