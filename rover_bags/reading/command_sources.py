"""Find motors that two command sources have commanded at a time.

A drive takes the commands of one source until these have timed out and refuses those of others, so
that such commands are a defect of the controllers, whichever of them the drive has obeyed.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas.cdr import header
from msg_schemas.refusal import Refusal
from msg_schemas.table import TOPICS


@dataclass(frozen=True)
class CommandConflict:
    """Commands to a motor within the timeout of another source's last command.

    Attributes:
        motor: that both command, as the contract names it.
        sources: names of both, in alphabetical order.
        commands: number of such commands.
        begin_s, end_s: stamps of the first and the last of them [s].
    """

    motor: str
    sources: tuple[str, str]
    commands: int
    begin_s: float
    end_s: float

    @property
    def text(self) -> str:
        """The finding as a sentence."""
        one, other = self.sources
        return (
            f"{self.motor} was commanded by {one} and {other} at a time: {self.commands} commands "
            f"from {self.begin_s:.3f} s to {self.end_s:.3f} s"
        )


class _Last(NamedTuple):
    source: str
    stamp_ns: int


class CommandSources:
    """Collects the sources of commands, message by message, in the order of sending."""

    def __init__(self) -> None:
        self._last: dict[str, _Last] = {}  # command of each motor
        self._stamps: dict[tuple[str, str, str], list[int]] = {}  # of conflicting commands

    def add(self, topic: str, source: str, stamp_ns: int) -> None:
        """Take the source and the stamp [ns] of a message; other topics are ignored."""
        spec = TOPICS[topic]
        if not spec.owned:
            return
        last = self._last.get(spec.owned)
        self._last[spec.owned] = _Last(source, stamp_ns)
        if last is None or last.source == source:
            return
        if abs(stamp_ns - last.stamp_ns) < spec.stale.timeout * 1e9:
            one, other = sorted((last.source, source))
            self._stamps.setdefault((spec.owned, one, other), []).append(stamp_ns)

    def add_message(self, topic: str, data: bytes) -> None:
        """Take a serialized message; one without a valid header is ignored."""
        if not TOPICS[topic].owned:
            return
        try:
            stamp_ns, source = header(topic, data)
        except Refusal:
            return
        self.add(topic, source, stamp_ns)

    @property
    def conflicts(self) -> tuple[CommandConflict, ...]:
        """The conflicts so far, by their begin."""
        return tuple(sorted(self._found(), key=lambda found: found.begin_s))

    def _found(self) -> Iterable[CommandConflict]:
        for (motor, one, other), stamps in self._stamps.items():
            begin, end = min(stamps) / 1e9, max(stamps) / 1e9
            yield CommandConflict(motor, (one, other), len(stamps), begin, end)
