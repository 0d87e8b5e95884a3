"""Counting the failing tests of a requirement: none that was not run counts as passed."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

from rover_verify.checks import CheckBatch, NotPossible
from rover_verify.checks.suite_tests import run_tests

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

@pytest.mark.parametrize("values", [(1.0, 3.0), (2.0,)])
def test_recorded(values, record_property):
    for value in values:
        record_property("error", value)
"""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    (tmp_path / "test_it.py").write_text(TESTS, encoding="utf-8")
    return tmp_path


@pytest.fixture
def batch(tmp_path: Path) -> CheckBatch:
    return CheckBatch(runs=1, seed=7, folder=tmp_path)


def test_what_draws_at_random_draws_by_the_seed(batch: CheckBatch, tree: Path):
    text = "import os\n\ndef test_seed():\n    assert os.environ['TEST_SEED'] == '7'\n"
    (tree / "test_seed.py").write_text(text, encoding="utf-8")
    assert run_tests(("test_seed.py",), batch, root=tree).value == 0


def test_what_fails_and_what_breaks_is_counted_and_named(batch: CheckBatch, tree: Path):
    names = ("test_good", "test_bad", "test_without")
    measured = run_tests(tuple(f"test_it.py::{name}" for name in names), batch, root=tree)
    assert measured.value == 2
    assert measured.note == "3 tests of test_it.py"
    assert "one is not two" in str(measured.details["test_bad"])
    assert "no fixture" in str(measured.details["test_without"])
    assert run_tests(("test_it.py::test_good",), batch, root=tree).value == 0


def test_a_skipped_test_has_shown_nothing(batch: CheckBatch, tree: Path):
    with pytest.raises(NotPossible, match=r"test_left_out: .*no browser here"):
        run_tests(("test_it.py",), batch, root=tree)


def test_no_tests_show_nothing(batch: CheckBatch, tree: Path):
    with pytest.raises(NotPossible, match=r"test_there.py comes with the source tree only"):
        run_tests(("test_there.py",), batch, root=tree)
    with pytest.raises(NotPossible, match="pytest"):
        run_tests(("test_it.py::test_missing",), batch, root=tree)


@pytest.mark.parametrize(("worst", "value"), [(max, 3.0), (min, 1.0)])
def test_the_worst_recorded_value_is_returned(
    batch: CheckBatch, tree: Path, worst: Callable[[Iterable[float]], float], value: float
):
    measured = run_tests(("test_it.py::test_recorded",), batch, "error", worst, tree)
    assert measured.value == value
    assert len(measured.details) == 3


@pytest.mark.parametrize(
    ("names", "quantity"),
    [(("test_recorded",), "height"), (("test_recorded", "test_bad"), "error")],
)
def test_nothing_recorded_or_a_failed_test_has_no_value(
    batch: CheckBatch, tree: Path, names: tuple[str, ...], quantity: str
):
    tests = tuple(f"test_it.py::{name}" for name in names)
    assert math.isnan(run_tests(tests, batch, quantity, root=tree).value)
