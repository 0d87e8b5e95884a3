"""What a rehearsal needs of the place where it runs: clocks, messages, calls, an operator."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from msg_schemas.samples import JointValue
from rover_hil.rehearsal.history import History


class CannotDoError(Exception):
    """This machine, or this operator, cannot do what a step asks for; the text says why."""


@dataclass(frozen=True)
class Outgoing:
    """A message to send, right or deliberately wrong.

    Attributes:
        stamp_ns: as it is to stand in the message.
        joints: by their names.
        omit: array that is left out; None: none.
    """

    stamp_ns: int
    joints: Mapping[str, JointValue]
    omit: str | None = None


@dataclass(frozen=True)
class Answer:
    """Of a service."""

    success: bool
    message: str


class Sending(Protocol):
    """Messages that go out at a rate until told otherwise.

    Attributes:
        count: how many have gone out.
        longest: the longest time between two of them by the steady clock [s].
        last_ns: when the last one went out, by the rehearsal's clock.
    """

    count: int
    longest: float
    last_ns: int

    def stop(self) -> None:
        """Send no more."""


class Stand(Protocol):
    """Where a rehearsal runs.

    Attributes:
        history: what is heard of the machine.
    """

    history: History

    def now_ns(self) -> int:
        """The clock that the machine's stamps follow [ns]."""

    def steady_ns(self) -> int:
        """The computer's steady clock [ns]."""

    def wall_ns(self) -> int:
        """The computer's time of day [ns], by which bags log."""

    def wait(self, timeout: float) -> None:
        """Let things happen, about so long [s]."""

    def held_up(self, since_ns: int) -> float:
        """The longest time for which the rehearsal itself was held up, since a steady time [s]."""

    def listen(self, topics: tuple[str, ...]) -> None:
        """Hear these topics from soon on, and others of procedures no more."""

    def is_offered(self, name: str) -> bool:
        """Whether somebody publishes a topic, or serves a service."""

    def is_heard(self, topic: str) -> bool:
        """Whether somebody listens to a topic."""

    def send(self, topic: str, message: Outgoing) -> None:
        """Publish once."""

    def send_steadily(self, topic: str, make: Callable[[int], Outgoing], period: float) -> Sending:
        """Publish now and every period [s] until stopped; `make` gets the clock's time."""

    def call(self, service: str, data: bool | None, timeout: float) -> Answer:
        """Call a service.

        Raises:
            CannotDoError: nobody serves it.
        """

    def parameter(self, node: str, name: str) -> object:
        """A parameter's present value.

        Raises:
            CannotDoError: there is no such node or parameter.
        """

    def set_parameter(self, node: str, name: str, value: object) -> None:
        """Set a parameter.

        Raises:
            CannotDoError: there is no such node, or it refuses.
        """

    def ask(self, key: str, what: str) -> None:
        """Have the operator do something, and wait until it is done.

        Raises:
            CannotDoError: it cannot be done, or there is no operator.
        """

    def question(self, key: str, what: str) -> bool:
        """Ask the operator a question.

        Raises:
            CannotDoError: it cannot be judged, or there is no operator.
        """

    def tell(self, line: str) -> None:
        """Show the operator how it goes."""
