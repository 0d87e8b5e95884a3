"""A written procedure: its steps, read from YAML and judged before anything runs."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from msg_schemas.configuration import (
    Configuration,
    ConfigurationError,
    choice,
    flag,
    quantity,
    read_by,
    sections,
    text,
)
from msg_schemas.fields import not_known
from msg_schemas.shipped import ShippedError, names_in, read_named
from msg_schemas.table import SERVICES, TOPICS
from rover_hil.rehearsal.actions import ACTIONS, Action, Mark, Publish
from rover_hil.rehearsal.expectation import Expectation
from rover_hil.rehearsal.expectations import EXPECTATIONS
from rover_hil.rehearsal.finding import Rule

SHIPPED = Path(__file__).parents[1] / "procedures"
"""Where the procedures of the package lie."""


class ProcedureError(ValueError):
    """A procedure that cannot be run: which file, step, key and value, and what would be right."""


def _read_names(value: object, path: str) -> tuple[str, ...]:
    names = [value] if isinstance(value, str) else value
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ConfigurationError(path, value, "should be a name or a list of names")
    return tuple(names)


def _names(about: str) -> Any:
    return read_by(_read_names, (tuple,), about, ())


@dataclass(frozen=True, kw_only=True)
class Step(Configuration):
    """One step: it does something, and expects something of it."""

    rule: str = choice(tuple(Rule), "interface rule of the contract that it tests")
    title: str = text("what it shows, in one sentence")
    moves: bool = flag("the machine may move; the operator confirms before the first such step")
    needs: tuple[str, ...] = _names("topics and services that somebody must offer")
    after: tuple[str, ...] = _names("earlier steps that must have passed")
    attempts: int | None = quantity(
        "-", "how often it is tried where the test itself was disturbed", None, kind=int,
        minimum=1, maximum=20, optional=True,
    )  # fmt: skip
    do: tuple[Action, ...] = sections(ACTIONS, "a list of actions", ())
    expect: tuple[Expectation, ...] = sections(EXPECTATIONS, "a list of expectations", ())

    def check(self) -> None:
        """Refuse what no single key can show."""
        for index, name in enumerate(self.needs):
            if name not in TOPICS and name not in SERVICES:
                expected = f"no such topic or service{not_known(name, (*TOPICS, *SERVICES))}"
                raise ConfigurationError(f"needs[{index}]", name, expected)
        if not self.expect and not any(action.judges for action in self.do):
            raise ConfigurationError(
                "expect", None, "missing; a step that expects nothing could not fail"
            )
        moving = [action for action in self.do if action.may_move]
        if moving and not self.moves:
            raise ConfigurationError(
                "moves", False, "should be true of a step that commands, asks for motion or arms"
            )
        takes = sum(action.duration for action in self.do)
        has_mark = any(isinstance(action, Mark) for action in self.do)
        for index, expectation in enumerate(self.expect):
            if getattr(expectation, "counts_from", "") == "mark" and not has_mark:
                raise ConfigurationError(
                    f"expect[{index}].counts_from", "mark", "the step's actions hold no mark"
                )
            if expectation.needs_time and takes <= 0.0:
                raise ConfigurationError(
                    f"expect[{index}]", type(expectation).__name__.lower(),
                    "is judged while the actions go on, which take no time: should have a wait",
                )  # fmt: skip

    @property
    def heard_on(self) -> tuple[str, ...]:
        """Topics that it must listen to."""
        of_actions = (name for action in self.do for name in action.heard_on)
        of_expectations = (name for each in self.expect for name in each.heard_on)
        return tuple(dict.fromkeys((*of_actions, *of_expectations)))

    @property
    def published(self) -> tuple[str, ...]:
        """Topics on which it commands."""
        return tuple(dict.fromkeys(each.topic for each in self.do if isinstance(each, Publish)))


@dataclass(frozen=True, kw_only=True)
class Procedure(Configuration):
    """A whole procedure."""

    about: str = text("what it is for, in a sentence or two")
    attempts: int = quantity(
        "-", "how often a step is tried where the test itself was disturbed", 3, kind=int,
        minimum=1, maximum=20,
    )  # fmt: skip
    steps: Mapping[str, Step] = sections(Step, "a mapping of step names to steps", keyed=True)

    def check(self) -> None:
        """Refuse what no single key can show."""
        if not self.steps:
            raise ConfigurationError("steps", {}, "should hold at least one step")
        before: list[str] = []
        for name, step in self.steps.items():
            for other in step.after:
                if other not in before:
                    raise ConfigurationError(
                        f"steps.{name}.after", other, f"no earlier step{not_known(other, before)}"
                    )
            before.append(name)

    @property
    def heard_on(self) -> tuple[str, ...]:
        """Topics that it must listen to."""
        return tuple(dict.fromkeys(name for step in self.steps.values() for name in step.heard_on))


@dataclass(frozen=True)
class Written:
    """A procedure with the file that it stands in.

    Attributes:
        name: of the file, without its ending.
        path: where it was read.
        digest: SHA-256 of the file's bytes.
    """

    name: str
    path: Path
    digest: str
    procedure: Procedure


def shipped() -> list[str]:
    """Names of the package's own procedures."""
    return names_in(SHIPPED)


def load_procedure(name_or_path: str) -> Written:
    """Read a procedure: one of the package by its name, or a file by its path.

    Raises:
        ProcedureError: it cannot be read, or something in it is not as it should be.
    """
    try:
        path, procedure = read_named(Procedure, name_or_path, SHIPPED, "procedure")
    except ShippedError as error:
        raise ProcedureError(str(error)) from None
    return Written(path.stem, path, hashlib.sha256(path.read_bytes()).hexdigest(), procedure)
