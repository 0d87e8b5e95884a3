"""What a procedure sends to the system under test, and gets back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from msg_schemas.samples import JointValue
from rover_hil.rehearsal.message_history import MessageHistory


class PreconditionError(Exception):
    """The machine or the operator cannot do what a step requires; the text gives the reason."""


@dataclass(frozen=True)
class OutgoingMessage:
    """A message to publish, valid or deliberately invalid.

    Attributes:
        stamp_ns: stamp of the message.
        joints: values by joint.
        omit: array that is left empty; None: none.
    """

    stamp_ns: int
    joints: Mapping[str, JointValue]
    omit: str | None = None


@dataclass(frozen=True)
class RehearsalResponse:
    """Response of a service."""

    success: bool
    message: str


class PeriodicPublisher(Protocol):
    """Publishes at a fixed rate until stopped.

    Attributes:
        longest_interval: longest time between two of its messages by the steady clock [s].
        last_stamp_ns: time of the last one by the rehearsal's clock.
    """

    longest_interval: float
    last_stamp_ns: int

    def stop(self) -> None:
        """Stop publishing."""


class ProcedureEnvironment(Protocol):
    """What a procedure runs against."""

    history: MessageHistory

    def now_ns(self) -> int:
        """Return the clock of the machine [ns]."""

    def steady_ns(self) -> int:
        """Return the computer's steady clock [ns]."""

    def wall_ns(self) -> int:
        """Return the computer's time of day [ns], by which bags log."""

    def wait(self, timeout: float) -> None:
        """Wait for about this time [s] while messages are received."""

    def longest_stall(self, since_ns: int) -> float:
        """Return the longest delay of the rehearsal itself since a steady time [s]."""

    def listen(self, topics: tuple[str, ...]) -> None:
        """Receive these topics in place of those of earlier steps."""

    def is_available(self, name: str) -> bool:
        """Whether a topic has a publisher, a command a subscriber, or a service a server."""

    def has_subscriber(self, topic: str) -> bool:
        """Whether a topic has a subscriber besides the recorder."""

    def send(self, topic: str, message: OutgoingMessage) -> None:
        """Publish once, unchecked: the message may violate the contract."""

    def send_periodically(
        self, topic: str, make: Callable[[int], OutgoingMessage], period: float
    ) -> PeriodicPublisher:
        """Publish now and every `period` [s] of the steady clock; `make` gets the clock's time."""

    def call(self, service: str, data: bool | None, timeout: float) -> RehearsalResponse:
        """Call a service.

        Raises:
            PreconditionError: it has no server, or does not respond.
        """

    def parameter(self, node: str, name: str) -> object:
        """Read a parameter.

        Raises:
            PreconditionError: there is no such node or parameter.
        """

    def set_parameter(self, node: str, name: str, value: object) -> None:
        """Set a parameter.

        Raises:
            PreconditionError: there is no such node, or it refuses the value.
        """

    def request_action(self, key: str, instruction: str) -> None:
        """Prompt the operator to do something, and wait until it is done.

        Raises:
            PreconditionError: it cannot be done, or there is no operator.
        """

    def request_answer(self, key: str, question: str) -> bool:
        """Put a yes-or-no question to the operator.

        Raises:
            PreconditionError: the operator cannot answer it, or there is no operator.
        """

    def report_progress(self, line: str) -> None:
        """Report a line to the operator."""
