"""What a host exchanges with the other processes that share its simulated time."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from rover_runtime.port import Message

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
