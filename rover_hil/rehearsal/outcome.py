"""What came of a rehearsal, before it is written down."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from rover_hil.rehearsal.finding import Finding, Rule, Verdict, worst
from rover_hil.rehearsal.procedure import Written


@dataclass(frozen=True)
class StepOutcome:
    """What came of one step.

    Attributes:
        name, title, rule: as the procedure has them.
        reason: why it was not run; empty: it was.
        findings: of its last attempt.
        disturbances: of each attempt that said nothing, why.
        begin_ns, end_ns: of its last attempt by the rehearsal's clock, which stamps follow.
        wall_begin_ns, wall_end_ns: the same by the time of day, by which bags log.
        remarks: what is worth knowing.
    """

    name: str
    title: str
    rule: Rule
    reason: str = ""
    findings: tuple[Finding, ...] = ()
    disturbances: tuple[str, ...] = ()
    begin_ns: int = 0
    end_ns: int = 0
    wall_begin_ns: int = 0
    wall_end_ns: int = 0
    remarks: tuple[str, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """Of all its findings; not run without any."""
        if self.reason:
            return Verdict.NOT_RUN
        return worst(finding.verdict for finding in self.findings)


@dataclass(frozen=True)
class Outcome:
    """What came of a whole rehearsal.

    Attributes:
        written: the procedure.
        steps: in their order.
        completed: whether it ran to its end.
        about: who, when, where, with what: names and texts.
        machine: the devices that were found: name, state and values of each.
        configurations: latched configuration of each node, by its name.
        bag: path of the recording, as seen from the record; empty: there is none.
        bag_note: what the recorder says of it.
    """

    written: Written
    steps: tuple[StepOutcome, ...]
    completed: bool
    about: Mapping[str, str] = field(default_factory=dict)
    machine: tuple[Mapping[str, str], ...] = ()
    configurations: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    bag: str = ""
    bag_note: str = ""

    @property
    def verdict(self) -> Verdict:
        """FAIL if a step failed; PASS only if all were run and passed."""
        found = worst(step.verdict for step in self.steps)
        if found is Verdict.PASS and not self.completed:
            return Verdict.NOT_RUN
        return found

    def of_rule(self, rule: Rule) -> tuple[StepOutcome, ...]:
        """The steps that test a rule."""
        return tuple(step for step in self.steps if step.rule is rule)

    def rule_verdict(self, rule: Rule) -> Verdict:
        """Of all steps that test a rule; NOT RUN without any."""
        return worst(step.verdict for step in self.of_rule(rule))
