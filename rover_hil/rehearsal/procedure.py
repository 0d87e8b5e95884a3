"""Test procedures: read from YAML and validated before anything runs."""

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
from msg_schemas.fields import known_names_hint
from msg_schemas.shipped import read_named, shipped_names
from msg_schemas.table import SERVICES, TOPICS
from rover_hil.rehearsal.actions import ACTIONS, Action, Mark, Publish
from rover_hil.rehearsal.expectation import Expectation
from rover_hil.rehearsal.expectation_result import InterfaceRule
from rover_hil.rehearsal.expectations import EXPECTATIONS

SHIPPED = Path(__file__).parent / "procedures"
"""Folder of the package's procedures."""


def _read_names(value: object, path: str) -> tuple[str, ...]:
    names = [value] if isinstance(value, str) else value
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ConfigurationError(path, value, "should be a name or a list of names")
    return tuple(names)


def _names(about: str) -> Any:
    return read_by(_read_names, (tuple,), about, ())


@dataclass(frozen=True, kw_only=True)
class Step(Configuration):
    """One step: actions, and what is expected of them."""

    rule: str = choice(tuple(InterfaceRule), "interface rule of the contract under test")
    title: str = text("the tested property, in one sentence")
    moves: bool = flag("the machine may move: the operator confirms before the first such step")
    needs: tuple[str, ...] = _names("topics and services that must be available")
    after: tuple[str, ...] = _names("earlier steps that must have passed")
    attempts: int | None = quantity(
        "-", "attempts, where one is invalid; null: as the procedure", None, kind=int,
        minimum=1, maximum=20, optional=True,
    )  # fmt: skip
    do: tuple[Action, ...] = sections(ACTIONS, "a list of actions", ())
    expect: tuple[Expectation, ...] = sections(EXPECTATIONS, "a list of expectations", ())

    def check(self) -> None:
        """Refuse contradictory keys."""
        for index, name in enumerate(self.needs):
            if name not in TOPICS and name not in SERVICES:
                expected = f"no such topic or service{known_names_hint(name, (*TOPICS, *SERVICES))}"
                raise ConfigurationError(f"needs[{index}]", name, expected)
        if not self.expect and not any(action.is_evaluated for action in self.do):
            raise ConfigurationError(
                "expect", None, "missing; a step without expectations cannot fail"
            )
        moving = [action for action in self.do if action.may_move]
        if moving and not self.moves:
            raise ConfigurationError(
                "moves", False, "should be true for a step that commands, requests motion or arms"
            )
        duration = sum(action.minimum_duration for action in self.do)
        has_mark = any(isinstance(action, Mark) for action in self.do)
        for index, expectation in enumerate(self.expect):
            if getattr(expectation, "since", "") == "mark" and not has_mark:
                raise ConfigurationError(
                    f"expect[{index}].since", "mark", "the step has no mark action"
                )
            after = expectation.evaluated_after
            if duration <= after:
                time = f"{duration:g} s, from {after:g} s on" if duration else "zero"
                raise ConfigurationError(
                    f"expect[{index}]", type(expectation).__name__.lower(),
                    f"covers the time of the actions, which is {time}: add a wait",
                )  # fmt: skip

    @property
    def subscribed_topics(self) -> tuple[str, ...]:
        """Topics to subscribe to."""
        of_actions = (name for action in self.do for name in action.subscribed_topics)
        of_expectations = (name for each in self.expect for name in each.subscribed_topics)
        return tuple(dict.fromkeys((*of_actions, *of_expectations)))

    @property
    def published(self) -> tuple[str, ...]:
        """Topics that it publishes."""
        return tuple(dict.fromkeys(each.topic for each in self.do if isinstance(each, Publish)))


@dataclass(frozen=True, kw_only=True)
class Procedure(Configuration):
    """A sequence of steps."""

    about: str = text("its purpose, in a sentence or two")
    attempts: int = quantity(
        "-", "attempts at a step, where one is invalid", 3, kind=int,
        minimum=1, maximum=20,
    )  # fmt: skip
    steps: Mapping[str, Step] = sections(Step, "a mapping of step names to steps", keyed=True)

    def check(self) -> None:
        """Refuse contradictory keys."""
        if not self.steps:
            raise ConfigurationError("steps", {}, "should have at least one step")
        before: list[str] = []
        for name, step in self.steps.items():
            for other in step.after:
                if other not in before:
                    raise ConfigurationError(
                        f"steps.{name}.after",
                        other,
                        f"no earlier step{known_names_hint(other, before)}",
                    )
            before.append(name)

    @property
    def subscribed_topics(self) -> tuple[str, ...]:
        """Topics to subscribe to."""
        return tuple(
            dict.fromkeys(name for step in self.steps.values() for name in step.subscribed_topics)
        )


@dataclass(frozen=True)
class LoadedProcedure:
    """A procedure and the file it was read from.

    Attributes:
        name: of the file, without suffix.
        path: of the file.
        digest: SHA-256 of the file's bytes.
    """

    name: str
    path: Path
    digest: str
    procedure: Procedure


def shipped() -> list[str]:
    """Names of the package's own procedures."""
    return shipped_names(SHIPPED)


def load_procedure(name_or_path: str) -> LoadedProcedure:
    """Read a procedure of the package by name, or a file by path.

    Raises:
        ShippedError: it cannot be read, or is invalid.
    """
    path, procedure = read_named(Procedure, name_or_path, SHIPPED, "procedure")
    return LoadedProcedure(
        path.stem, path, hashlib.sha256(path.read_bytes()).hexdigest(), procedure
    )
