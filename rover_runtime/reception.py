"""What a component receives: admits messages, records commands, and keeps what came too early."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple, Protocol

from msg_schemas import qos
from msg_schemas.commands import content_of
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample
from msg_schemas.specifications import Topic
from rover_runtime.admission import Admission
from rover_runtime.command_log import CommandLog
from rover_runtime.port import Message


class ReceivingComponent(Protocol):
    """The component for which messages are received."""

    @property
    def active(self) -> bool:
        """Whether it is active."""

    def now_ns(self) -> int:
        """Return its clock [ns]."""

    def knows_time(self) -> bool:
        """Whether its clock has a reading."""

    def unready(self) -> str:
        """Why no message can be accepted now; empty = it can."""

    def refuse(self, refusal: Refusal) -> bool:
        """Report a refusal; returns whether it is reported now."""


class _Latched(NamedTuple):
    """A subscribed latched topic and its last messages, of one or several publishers."""

    row: Topic
    callback: Callable[[Any], None]
    kept: deque[Message]


class Reception:
    """Passes admitted samples to callbacks, and refuses the others with their reason.

    Args:
        receiver: the component. Its clock judges the age of messages; that of a source of simulated
            time is not its port's.
        commands: records of its commands.

    Attributes:
        accepted: number of accepted messages.
    """

    def __init__(self, receiver: ReceivingComponent, commands: CommandLog) -> None:
        self.accepted = 0
        self._receiver = receiver
        self._commands = commands
        self._admission = Admission()
        self._latched: list[_Latched] = []
        self._is_latched_processed = False

    def open(
        self, row: Topic, callback: Callable[[Any], None], depth: int | None = None
    ) -> Callable[[Message], None]:
        """Open a topic; returns what receives its messages.

        Args:
            row: specification of the topic.
            callback: gets the accepted samples; it may raise ``Refusal``.
            depth: of the queue, and of what a latched topic keeps until the component is ready;
                None = that of the topic's intent.
        """
        if not row.is_latched:
            return partial(self._receive, row, callback)
        latched = _Latched(row, callback, deque(maxlen=qos.depth(row.intent, depth)))
        self._latched.append(latched)
        return partial(self._receive_latched, latched)

    def _receive(self, row: Topic, callback: Callable[[Any], None], message: Message) -> None:
        if row.is_command and not row.owned:
            self._record(row, message)
        now_ns = self._receiver.now_ns()
        if self._receiver.active and (now_ns or self._receiver.knows_time()):
            self._process(row, callback, message, now_ns)
        elif row.is_command:
            refusal = Refusal(row.name, RefusalCode.NOT_ACTIVE, self._receiver.unready())
            self._refuse_message(row, message, refusal)

    def _receive_latched(self, latched: _Latched, message: Message) -> None:
        latched.kept.append(message)
        if not self._is_latched_processed:
            self.process_latched()  # this message with the others
        elif not self._receiver.unready():
            self._process(latched.row, latched.callback, message, self._receiver.now_ns())

    def _process(
        self, row: Topic, callback: Callable[[Any], None], message: Message, now_ns: int
    ) -> None:
        try:
            callback(self._admission.admit(row, message, now_ns))
        except Refusal as refusal:
            self._refuse_message(row, message, refusal)
            return
        self.accepted += 1
        if row.is_command:
            self._admission.accepted(row, message, now_ns)
            self._commands.finish_taking()

    def restart(self) -> None:
        """Let the latched messages be processed anew, as the component is activated."""
        self._is_latched_processed = False

    def process_latched(self) -> None:
        """Process latched messages that came before the node was ready; none is sent twice."""
        if self._is_latched_processed or self._receiver.unready():
            return
        self._is_latched_processed = True
        for row, callback, kept in tuple(self._latched):
            for message in tuple(kept):
                self._process(row, callback, message, self._receiver.now_ns())

    def forget_stamps(self) -> None:
        """Forget the stamps of past commands, because the clock has gone back."""
        self._admission.forget()

    def forget_latched(self) -> None:
        """Forget the latched messages, because their topics are closed."""
        self._latched.clear()

    def owners(self) -> Mapping[str, str]:
        """Command source that owns each motor."""
        return self._admission.owners(self._receiver.now_ns())

    def _record(self, row: Topic, message: Message) -> None:
        sample, what, kind = message.content, "", ""
        if not isinstance(sample, Refusal):
            what = content_of(row, sample)
            if isinstance(sample, JointSample):
                kind = next(iter(sample.joints))
        name = "" if row.frame else message.sender
        self._commands.take(row.name, name, message.stamp_ns, what, kind)

    def _refuse_message(self, row: Topic, message: Message, refusal: Refusal) -> None:
        refusal.command_source = "" if row.frame else message.sender
        self._commands.refuse(refusal, publishes=self._receiver.refuse(refusal))
