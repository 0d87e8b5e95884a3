"""Refusals: why a message, a request or a value was rejected, and how `diagnostics` reports it.

A refusal is raised at the boundary, before anything moves. Its text names the topic, the
offending value, its limits and the remedy.
"""

from __future__ import annotations

from dataclasses import dataclass

from msg_schemas.described import Described
from msg_schemas.samples import Level, Status
from msg_schemas.text_limits import LONGEST_REASON, cut, printable


class RefusalCode(Described):
    """Kinds of refusals."""

    NOT_FINITE = "not_finite", "a number is NaN or infinite"
    OUT_OF_LIMITS = "out_of_limits", "a number lies outside its limits"
    WRONG_NAME = "wrong_name", "joint or field names are not those of the topic"
    WRONG_LENGTH = "wrong_length", "an array is too short or too long"
    WRONG_TYPE = "wrong_type", "the sample has the type of another topic"
    MALFORMED = "malformed", "the bytes are no message of the topic's type"
    WRONG_FRAME = "wrong_frame", "the frame is not that of the topic"
    BAD_TEXT = "bad_text", "the topic does not define this word, or the text is no JSON"
    UNSTAMPED = "unstamped", "the stamp is zero where one is required"
    STALE = "stale", "older than the topic allows, or a required input is missing"
    UNCERTAIN = "uncertain", "an estimate is not accurate enough yet"
    FROM_THE_FUTURE = "from_the_future", "stamped further ahead than the topic allows"
    OUT_OF_ORDER = "out_of_order", "stamped before the last accepted command of the same source"
    WRONG_PHASE = "wrong_phase", "not possible in the present phase"
    OWNED = "owned", "another command source owns the topic"
    NOT_ACTIVE = "not_active", "the node or the drive is not active"
    NOT_ARMED = "not_armed", "the drive must be armed first"
    NOT_SUPPORTED = "not_supported", "the plant or the drive cannot do it"


class Refusal(ValueError):
    """Something was rejected at the boundary.

    Attributes:
        subject: topic, service or parameter that it came by.
        code: the kind of refusal.
        reason: one sentence: what, which value, what would be accepted; a long one is cut.
        command_source: the command source, where the message names it.
    """

    def __init__(self, subject: str, code: RefusalCode, reason: str) -> None:
        reason = printable(cut(reason, LONGEST_REASON))
        super().__init__(f"{subject}: {reason} [{code.value}]")
        self.subject = subject
        self.code = code
        self.reason = reason
        self.command_source = ""


@dataclass(frozen=True)
class RefusalReport:
    """A refusal as `diagnostics` reports it.

    Attributes:
        node: the node that refused.
        subject: topic or service of the request.
        code: the kind of refusal.
        reason: why, for people.
        command_source: the command source; empty = not named.
        refused: refusals of this subject since the node's start.
        not_shown: refusals since the last report that were counted only.
    """

    node: str
    subject: str
    code: RefusalCode
    reason: str
    command_source: str = ""
    refused: int = 1
    not_shown: int = 0

    def status(self) -> Status:
        """The line of `diagnostics`."""
        values = {
            "subject": self.subject,
            "code": self.code.value,
            "refused": str(self.refused),
            "not_shown": str(self.not_shown),
        }
        if self.command_source:
            values["command_source"] = self.command_source
        name = f"{self.node}: refused {self.subject}"
        return Status(name, self.reason, Level.WARN, self.node, values)


def read_refusal(status: Status) -> RefusalReport | None:
    """Decode a line of `diagnostics`; None = it is no refusal."""
    values = status.values
    try:
        return RefusalReport(
            status.hardware_id,
            values["subject"],
            RefusalCode(values["code"]),
            status.message,
            values.get("command_source", ""),
            int(values["refused"]),
            int(values["not_shown"]),
        )
    except (KeyError, ValueError):
        return None
