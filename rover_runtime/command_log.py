"""The commands that a component has taken, from taking to end. Pure.

A request or a service call is taken before its callback runs. A callback that begins something
calls ``begin``; without it the command is done when the callback returns. What ends a command has a
``Reason``, which determines its last state. A hold ends commands, and ``resume`` takes them anew.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from msg_schemas.commands import CommandRecord, CommandState, split_name, state_after
from msg_schemas.faults import Reason
from msg_schemas.refusal import Refusal

_STEPS = 10  # published steps of the progress


@dataclass
class _Command:
    """A command and what its record does not show."""

    record: CommandRecord
    kind: str  # joint of the request; empty = none
    is_named: bool  # whether the sender has chosen the identifier
    farthest: float = field(default=math.nan)  # largest distance to its goal so far

    def continues(self, other: _Command) -> bool:
        """Whether a message of the same sender renews the other command."""
        if self.record.subject != other.record.subject or self.record.sender != other.record.sender:
            return False
        if self.is_named or other.is_named:
            return self.record.identifier == other.record.identifier
        return True


class CommandLog:
    """Keeps the records of one component.

    Args:
        node: name of the component.
        now_ns: its clock [ns].
        publish: called with each new or changed record.
    """

    def __init__(
        self, node: str, now_ns: Callable[[], int], publish: Callable[[CommandRecord], None]
    ) -> None:
        self._node = node
        self._now_ns = now_ns
        self._publish = publish
        self._taking: _Command | None = None
        self._open: list[_Command] = []  # in the order of their execution
        self._held: list[_Command] = []
        self._last_now_ns = self._last_taken_ns = -1

    @property
    def open(self) -> tuple[CommandRecord, ...]:
        """Records of the commands that have not ended, the one under way first."""
        return tuple(command.record for command in self._open)

    # --- taking ----------------------------------------------------------------------------------

    def take(
        self, subject: str, name: str = "", stamp_ns: int = 0, what: str = "", kind: str = ""
    ) -> None:
        """Take a command.

        Args:
            subject: topic or service.
            name: sender and identifier, as the message names them.
            stamp_ns: stamp of the message [ns]; 0 = none.
            what: content for people.
            kind: which of the topic's requests it is.
        """
        sender, identifier = split_name(name)
        now_ns = self._time_of_taking()
        record = CommandRecord(
            self._node, subject, sender, identifier or str(stamp_ns or now_ns), now_ns,
            CommandState.ACCEPTED, what,
        )  # fmt: skip
        self._taking = _Command(record, kind, bool(identifier))

    def begin(
        self, *, expiry: float = math.inf, renews: bool = False, queues: bool = False
    ) -> None:
        """Open the command that is being taken: it lasts until its end is reported.

        Args:
            expiry: time without a renewal after which the component ends it [s].
            renews: it asks for what is under way; from the same sender it is a renewal.
            queues: it waits for the open commands; otherwise it supersedes them.
        """
        new = self._taking
        assert new is not None, "begin belongs in the callback of a request or a service"
        self._taking = None
        if renews and self._open and new.continues(self._open[0]):
            return
        if not queues:
            self._held.clear()
            by = new.record.subject + (f" of {new.record.sender}" if new.record.sender else "")
            self.end_all(Reason.SUPERSEDED, f"replaced by {by}")
        new.record = replace(new.record, expiry=expiry)
        self._open.append(new)
        self._publish(new.record)

    def drop(self) -> None:
        """Keep no record of the command that is being taken: it asks for nothing."""
        self._taking = None

    def finish_taking(self, text: str = "") -> None:
        """End the taking: a command that was not begun is done."""
        if self._taking is not None:
            self._finish(self._taking, CommandState.DONE, Reason.COMPLETED, text)
            self._taking = None

    def refuse(self, refusal: Refusal, *, publishes: bool = True) -> None:
        """Refuse the command that is being taken."""
        taking, self._taking = self._taking, None
        if taking is not None and publishes:
            refused = replace(
                taking.record,
                state=CommandState.REFUSED,
                reason=refusal.code,
                text=refusal.reason,
            )
            self._publish(refused)

    # --- course ----------------------------------------------------------------------------------

    def progress(self, text: str = "", distance: float = math.nan) -> None:
        """Report that the first open command is under way.

        Args:
            text: present activity, for people.
            distance: what is left to its goal, in any unit; nan = unknown.
        """
        if not self._open:
            return
        command = self._open[0]
        if not command.farthest >= distance:
            command.farthest = distance
        done = command.record.progress
        if command.farthest > 0.0 and distance >= 0.0:
            step = math.floor(_STEPS * (1.0 - distance / command.farthest)) / _STEPS
            done = step if math.isnan(done) else max(step, done)
        before = command.record
        is_same = done == before.progress or (math.isnan(done) and math.isnan(before.progress))
        if before.state is CommandState.RUNNING and before.text == text and is_same:
            return
        command.record = replace(before, state=CommandState.RUNNING, text=text, progress=done)
        self._publish(command.record)

    def end(
        self, reason: Reason, text: str, *kinds: str, result: Mapping[str, str] | None = None
    ) -> None:
        """End the first open command, or the first one of these kinds.

        Args:
            reason: determines its last state.
            text: the reason for people.
            kinds: joints of the requests.
            result: values by their names.
        """
        for command in self._open:
            if not kinds or command.kind in kinds:
                self._open.remove(command)
                self._finish(command, state_after(reason), reason, text, result)
                return

    def end_all(self, reason: Reason, text: str) -> None:
        """End all open commands."""
        while self._open:
            self.end(reason, text)

    def hold(self, reason: Reason, text: str) -> None:
        """End all open commands, and keep them for ``resume``."""
        self._held = [*self._open, *self._held]
        self.end_all(reason, text)

    def resume(self) -> None:
        """Take the held commands anew."""
        held, self._held = self._held, []
        for command in held:
            record = replace(
                command.record,
                taken_ns=self._time_of_taking(),
                state=CommandState.ACCEPTED,
                progress=math.nan,
                text="",
            )
            self._open.append(replace(command, record=record, farthest=math.nan))
            self._publish(record)

    def discard(self, reason: Reason, text: str) -> None:
        """End all open commands, and forget the held ones: nothing can resume them."""
        self._held.clear()
        self.end_all(reason, text)

    def _time_of_taking(self) -> int:
        """Return the present time [ns], or a later one: no two commands have the same."""
        now_ns = self._now_ns()
        is_repeated = self._last_now_ns <= now_ns <= self._last_taken_ns
        self._last_taken_ns = self._last_taken_ns + 1 if is_repeated else now_ns
        self._last_now_ns = now_ns
        return self._last_taken_ns

    def _finish(
        self,
        command: _Command,
        state: CommandState,
        reason: Reason,
        text: str,
        result: Mapping[str, str] | None = None,
    ) -> None:
        done = 1.0 if state is CommandState.DONE else command.record.progress
        ended = replace(command.record, state=state, reason=reason, text=text, progress=done)
        self._publish(replace(ended, result=result or {}))
