"""The operator at the terminal, and a program in the operator's place."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from rover_hil.rehearsal.operator_desk import OperatorDesk
from rover_hil.rehearsal.stand import CannotDoError


@pytest.fixture
def keyboard() -> Iterator[tuple[io.TextIOWrapper, int]]:
    """What the operator types is written to the descriptor."""
    reading, writing = os.pipe()
    with os.fdopen(reading, encoding="utf-8") as read:
        yield read, writing
        os.close(writing)


def at_terminal(keyboard: io.TextIOWrapper, *, over: bool = False) -> OperatorDesk:
    return OperatorDesk("", 5.0, lambda: over, keyboard)


def program(folder: Path, text: str) -> str:
    path = folder / "hands"
    path.write_text(f"#!/bin/sh\n{text}\n", encoding="utf-8")
    path.chmod(0o755)
    return str(path)


def test_the_operator_says_done_or_that_it_cannot_be(keyboard: tuple[io.TextIOWrapper, int]):
    read, typed = keyboard
    desk = at_terminal(read)
    os.write(typed, b"what?\nd\n")
    desk.do("plug", "Unplug it.")
    os.write(typed, b"n\n")
    with pytest.raises(CannotDoError, match=r"Unplug it\. The operator says that it cannot"):
        desk.do("plug", "Unplug it.")


def test_the_operator_judges(keyboard: tuple[io.TextIOWrapper, int]):
    read, typed = keyboard
    desk = at_terminal(read)
    os.write(typed, b"Yes\n")
    assert desk.judge("still", "Does it stand?")
    os.write(typed, b"no\n")
    assert not desk.judge("still", "Does it stand?")
    os.write(typed, b"c\n")
    with pytest.raises(CannotDoError, match="cannot be said"):
        desk.judge("still", "Does it stand?")


def test_without_an_operator_nothing_is_done_by_hand():
    with pytest.raises(CannotDoError, match="no operator at a terminal"):
        OperatorDesk("", 5.0, lambda: False).do("plug", "Unplug it.")


def test_an_operator_who_ends_the_rehearsal_gives_no_answer(
    keyboard: tuple[io.TextIOWrapper, int],
):
    with pytest.raises(CannotDoError, match="gave no answer"):
        at_terminal(keyboard[0], over=True).do("plug", "Unplug it.")


def test_a_program_acts_as_the_hands(tmp_path: Path):
    hands = program(tmp_path, '[ "$1" = plug ] && exit 0; [ "$1" = still ] && exit 1; '
                    "echo no arm >&2; exit 9")  # fmt: skip
    desk = OperatorDesk(hands, 30.0, lambda: False)
    desk.do("plug", "Unplug it.")
    assert desk.judge("plug", "Is it out?")
    assert not desk.judge("still", "Does it stand?")
    with pytest.raises(CannotDoError, match="exit code 9: no arm"):
        desk.do("lift", "Lift it.")
    with pytest.raises(CannotDoError, match="The hands could not"):
        OperatorDesk(str(tmp_path / "none"), 1.0, lambda: False).do("plug", "Unplug it.")
