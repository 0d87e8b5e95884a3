"""Result of one evaluated expectation: expected and measured value, and their place in the bag."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from msg_schemas.described import Described


class Result(StrEnum):
    """Result of an expectation, a step, a rule, or a whole procedure."""

    PASS = "PASS"
    FAIL = "FAIL"
    NOT_RUN = "NOT RUN"


class InterfaceRule(Described):
    """The interface rules of the contract: each step tests one."""

    RATE = "rate", "states and measurements are published at the contract's rate, without gaps"
    LATENCY = "latency", "published samples are fresh, and commands are executed in time"
    LIMITS = "limits", "published and accepted values lie within the contract's limits"
    WATCHDOG = "watchdog", "a timeout on any hop stops motion in time"
    REFUSAL = "refusal", "an invalid or unsafe request is refused with its reason"
    RESTART = "restart", "nothing moves after a restart until the drives are armed again"
    SAFE_STATE = "safe_state", "off means motors without power and the brake closed"


TIMED = frozenset(
    {
        InterfaceRule.RATE,
        InterfaceRule.LATENCY,
        InterfaceRule.WATCHDOG,
        InterfaceRule.RESTART,
        InterfaceRule.SAFE_STATE,
    }
)
"""Rules that measure times: while simulated time stands still, they seem to be kept."""


@dataclass(frozen=True)
class ExpectationResult:
    """One evaluated expectation or action.

    Attributes:
        description: the quantity or condition that was tested.
        expected: the value or range that passes.
        measured: the value that was found; empty: none.
        topics: topics of the bag that show it.
        begin_ns, end_ns: interval by the rehearsal's clock, which the messages' stamps follow.
    """

    result: Result
    description: str
    expected: str
    measured: str
    topics: tuple[str, ...] = ()
    begin_ns: int = 0
    end_ns: int = 0


def worst(results: Iterable[Result]) -> Result:
    """FAIL before NOT RUN before PASS; NOT RUN for an empty sequence."""
    found = set(results)
    if Result.FAIL in found:
        return Result.FAIL
    return Result.PASS if found == {Result.PASS} else Result.NOT_RUN
