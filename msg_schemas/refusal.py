"""Refusals: why a message, a request or a value was not let through.

A refusal is raised at the boundary, before anything moves. Its text names the
topic, what was wrong, the offending value and what would have been right.
"""

from __future__ import annotations

from enum import StrEnum

REQUEST_ACCEPTED = "request_accepted"
"""Event: a request whose ``header.frame_id`` says who asks was not refused; it repeats who."""


class RefusalCode(StrEnum):
    """The reasons for which the contract turns something away."""

    NOT_FINITE = "not_finite"
    OUT_OF_LIMITS = "out_of_limits"
    WRONG_NAME = "wrong_name"
    WRONG_LENGTH = "wrong_length"
    WRONG_TYPE = "wrong_type"
    WRONG_FRAME = "wrong_frame"
    BAD_TEXT = "bad_text"
    UNSTAMPED = "unstamped"
    STALE = "stale"
    FROM_THE_FUTURE = "from_the_future"
    OUT_OF_ORDER = "out_of_order"
    WRONG_PHASE = "wrong_phase"
    OWNED = "owned"
    NOT_ACTIVE = "not_active"
    NOT_ARMED = "not_armed"
    NOT_SUPPORTED = "not_supported"


class Refusal(ValueError):
    """Something was turned away at the boundary.

    Attributes:
        subject: topic, service or parameter that it came by.
        code: the kind of reason.
        reason: one sentence: what, which value, what would be right.
        commander: who asked, where the message says so.
    """

    def __init__(self, subject: str, code: RefusalCode, reason: str) -> None:
        super().__init__(f"{subject}: {reason} [{code.value}]")
        self.subject = subject
        self.code = code
        self.reason = reason
        self.commander = ""
