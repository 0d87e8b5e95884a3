"""What a rehearsal finds: one verdict with what was required, what was measured, and where."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """Of a finding, a step, a rule, or a whole rehearsal."""

    PASS = "PASS"
    FAIL = "FAIL"
    NOT_RUN = "NOT RUN"


class Rule(StrEnum):
    """The interface rules of the contract: each step tests one."""

    RATE = "rate"
    LATENCY = "latency"
    LIMITS = "limits"
    WATCHDOG = "watchdog"
    REFUSAL = "refusal"
    RESTART = "restart"
    SAFE_STATE = "safe_state"


TIMED = frozenset({Rule.RATE, Rule.LATENCY, Rule.WATCHDOG, Rule.RESTART, Rule.SAFE_STATE})
"""Rules by which times are measured: where time stood still, they seem to be kept."""

ABOUT_RULES: dict[Rule, str] = {
    Rule.RATE: "what is told comes as often as the contract says, without gaps",
    Rule.LATENCY: "what is told is fresh, and commands are executed in time",
    Rule.LIMITS: "numbers keep their limits: those told, and those that are accepted",
    Rule.WATCHDOG: "silence on any hop stops what moves, in time",
    Rule.REFUSAL: "what must not be done is refused, with its reason",
    Rule.RESTART: "nothing moves after a restart until it is armed again",
    Rule.SAFE_STATE: "off means motors without power and the brake closed",
}


@dataclass(frozen=True)
class Finding:
    """One thing that was judged.

    Attributes:
        what: in words.
        required: what would be right.
        measured: what was found; empty: nothing.
        topics: on which this is to be seen, in the bag.
        begin_ns, end_ns: when, by the rehearsal's clock, which the messages' stamps follow.
    """

    verdict: Verdict
    what: str
    required: str
    measured: str
    topics: tuple[str, ...] = ()
    begin_ns: int = 0
    end_ns: int = 0


def worst(verdicts: Iterable[Verdict]) -> Verdict:
    """FAIL before NOT RUN before PASS; of nothing NOT RUN."""
    found = set(verdicts)
    if Verdict.FAIL in found:
        return Verdict.FAIL
    return Verdict.PASS if found == {Verdict.PASS} else Verdict.NOT_RUN
