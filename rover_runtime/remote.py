"""What a host exchanges with the other processes that share its simulated time."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, NamedTuple, Protocol

from msg_schemas.access import Act
from rover_runtime.port import Message

if TYPE_CHECKING:
    from rover_runtime.loop_port import LoopPort


OPERATOR = "operator"
"""Name of the sender of messages and requests from outside."""


class Sent(NamedTuple):
    """A message to other processes, to be received in the tick ``due``."""

    topic: str
    sender: str  # name of the component
    sequence: int
    due: int


class Kept(NamedTuple):
    """A message that late joiners receive."""

    sent: Sent
    message: Message


def restarted(kept: deque[Kept]) -> deque[Kept]:
    """Return the kept messages as those of a host that begins anew with the first tick."""
    return deque((Kept(sent._replace(due=0), each) for sent, each in kept), kept.maxlen)


class Call(NamedTuple):
    """A request to a service, to be received in the tick ``due``."""

    service: str
    caller: str
    number: int
    arguments: tuple[bool, ...]
    due: int


class Response(NamedTuple):
    """The response to a request, to be received in the tick ``due``."""

    service: str
    caller: str
    number: int
    server: str
    success: bool
    message: str
    due: int


class Remote(Protocol):
    """The other processes whose components share simulated time with those of a host."""

    def open(self, act: Act, port: LoopPort, name: str) -> None:
        """Show a topic or service of a component to the others."""

    def is_received(self, topic: str) -> bool:
        """Whether a topic has a receiver in another process."""

    def is_served(self, service: str) -> bool:
        """Whether a component of another process serves a service."""

    def send(self, sent: Sent, data: bytes) -> None:
        """Send a message of this host's components, as its bytes, to the others."""

    def call(self, call: Call) -> None:
        """Send a request of this host's components to the server of a service."""

    def respond(self, response: Response) -> None:
        """Send the response to a request from another process."""
