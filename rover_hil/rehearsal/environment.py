"""What a procedure sends to the system under test, and gets back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from msg_schemas.samples import JointValue


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
