"""Results of a procedure and its steps, before they are written to a record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from rover_hil.rehearsal.expectation_result import ExpectationResult, InterfaceRule, Result, worst
from rover_hil.rehearsal.procedure import LoadedProcedure


@dataclass(frozen=True)
class ProcedureStepResult:
    """Result of one step.

    Attributes:
        name, title, rule: from the procedure.
        reason: why it was not run; empty: it was run.
        results: of its last attempt.
        invalid_attempts: for each invalid attempt, the reason.
        begin_ns, end_ns: interval of the last attempt by the rehearsal's clock.
        wall_begin_ns, wall_end_ns: the same by the time of day, by which bags log.
    """

    name: str
    title: str
    rule: InterfaceRule
    reason: str = ""
    results: tuple[ExpectationResult, ...] = ()
    invalid_attempts: tuple[str, ...] = ()
    begin_ns: int = 0
    end_ns: int = 0
    wall_begin_ns: int = 0
    wall_end_ns: int = 0

    @property
    def result(self) -> Result:
        """The worst of its results; NOT RUN without any."""
        if self.reason:
            return Result.NOT_RUN
        return worst(result.result for result in self.results)


@dataclass(frozen=True)
class ProcedureResult:
    """Result of a whole procedure.

    Attributes:
        loaded: the procedure and its file.
        steps: results in the order of the steps.
        completed: whether all steps had their turn.
        about: operator, machine, times and versions, by name.
        devices: name, state and values of each device on the link.
        configurations: latched configuration of each node, by its name.
        bag: path of the recording relative to the record; empty: none.
        bag_note: the recorder's summary.
    """

    loaded: LoadedProcedure
    steps: tuple[ProcedureStepResult, ...]
    completed: bool
    about: Mapping[str, str] = field(default_factory=dict)
    devices: tuple[Mapping[str, str], ...] = ()
    configurations: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    bag: str = ""
    bag_note: str = ""

    @property
    def result(self) -> Result:
        """FAIL if a step failed; PASS only if every step was run and passed."""
        found = worst(step.result for step in self.steps)
        if found is Result.PASS and not self.completed:
            return Result.NOT_RUN
        return found

    def steps_of(self, rule: InterfaceRule) -> tuple[ProcedureStepResult, ...]:
        """Results of the steps that test a rule."""
        return tuple(step for step in self.steps if step.rule is rule)

    def rule_result(self, rule: InterfaceRule) -> Result:
        """The worst result of the steps that test a rule; NOT RUN without any."""
        return worst(step.result for step in self.steps_of(rule))
