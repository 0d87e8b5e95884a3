"""The operator at the terminal, and a program in the operator's place."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from rover_hil.rehearsal.environment import PreconditionError
from rover_hil.rehearsal.operator_prompts import OperatorPrompts


@pytest.fixture
def terminal() -> Iterator[tuple[io.TextIOWrapper, int]]:
    """Read end of the terminal, and the descriptor to write the operator's input to."""
    reading, writing = os.pipe()
    with os.fdopen(reading, encoding="utf-8") as read:
        yield read, writing
        os.close(writing)


def at_terminal(terminal: io.TextIOWrapper, *, stopped: bool = False) -> OperatorPrompts:
    return OperatorPrompts("", 5.0, lambda: stopped, terminal)


def program(folder: Path, text: str) -> str:
    path = folder / "operator_program"
    path.write_text(f"#!/bin/sh\n{text}\n", encoding="utf-8")
    path.chmod(0o755)
    return str(path)


def test_the_operator_reports_done_or_impossible(terminal: tuple[io.TextIOWrapper, int]):
    read, typed = terminal
    operator = at_terminal(read)
    os.write(typed, b"what?\nd\n")
    operator.prompt("plug", "Unplug it.")
    os.write(typed, b"n\n")
    with pytest.raises(PreconditionError, match=r"Unplug it\. The operator answered: impossible"):
        operator.prompt("plug", "Unplug it.")


def test_the_operator_answers_a_question(terminal: tuple[io.TextIOWrapper, int]):
    read, typed = terminal
    operator = at_terminal(read)
    os.write(typed, b"Yes\n")
    assert operator.inspect("still", "Does it stand?")
    os.write(typed, b"no\n")
    assert not operator.inspect("still", "Does it stand?")
    os.write(typed, b"c\n")
    with pytest.raises(PreconditionError, match="cannot decide"):
        operator.inspect("still", "Does it stand?")


def test_without_an_operator_a_prompt_fails():
    with pytest.raises(PreconditionError, match="no operator at a terminal"):
        OperatorPrompts("", 5.0, lambda: False).prompt("plug", "Unplug it.")


def test_a_prompt_fails_when_the_operator_stops_the_rehearsal(
    terminal: tuple[io.TextIOWrapper, int],
):
    with pytest.raises(PreconditionError, match="gave no answer"):
        at_terminal(terminal[0], stopped=True).prompt("plug", "Unplug it.")


def test_a_program_acts_in_the_operator_s_place(tmp_path: Path):
    operator_program = program(tmp_path, '[ "$1" = plug ] && exit 0; [ "$1" = still ] && exit 1; '
                    "echo no arm >&2; exit 9")  # fmt: skip
    operator = OperatorPrompts(operator_program, 30.0, lambda: False)
    operator.prompt("plug", "Unplug it.")
    assert operator.inspect("plug", "Is it out?")
    assert not operator.inspect("still", "Does it stand?")
    with pytest.raises(PreconditionError, match="exit code 9: no arm"):
        operator.prompt("lift", "Lift it.")
    with pytest.raises(PreconditionError, match="The operator program failed"):
        OperatorPrompts(str(tmp_path / "none"), 1.0, lambda: False).prompt("plug", "Unplug it.")
