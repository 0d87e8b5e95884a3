"""Counting the failing tests of a requirement: none that was not run counts as passed."""

from __future__ import annotations

from pathlib import Path

import pytest

from rover_verify.checks import NotPossible
from rover_verify.checks.suite_tests import failing

TESTS = """
import pytest

def test_good():
    assert True

def test_bad():
    assert 1 == 2, "one is not two"

@pytest.fixture
def broken():
    raise RuntimeError("no fixture")

def test_without(broken):
    pass

def test_left_out():
    pytest.skip("no browser here")
"""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    (tmp_path / "test_it.py").write_text(TESTS, encoding="utf-8")
    return tmp_path


def test_what_fails_and_what_breaks_is_counted_and_named(tree: Path):
    names = ("test_good", "test_bad", "test_without")
    measured = failing(tree, tuple(f"test_it.py::{name}" for name in names), tree)
    assert measured.value == 2
    assert measured.note == "3 tests of test_it.py"
    assert "one is not two" in str(measured.details["test_bad"])
    assert "no fixture" in str(measured.details["test_without"])
    assert failing(tree, ("test_it.py::test_good",), tree).value == 0


def test_a_skipped_test_has_shown_nothing(tree: Path):
    with pytest.raises(NotPossible, match=r"test_left_out: .*no browser here"):
        failing(tree, ("test_it.py",), tree)


def test_no_tests_show_nothing(tree: Path):
    with pytest.raises(NotPossible, match=r"test_there.py comes with the source tree only"):
        failing(tree, ("test_there.py",), tree)
    with pytest.raises(NotPossible, match="pytest"):
        failing(tree, ("test_it.py::test_missing",), tree)
