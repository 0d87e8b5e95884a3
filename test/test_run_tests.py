"""The tool that runs the tests: markers of a user, flaky tests."""

from pathlib import Path

import pytest
import tool_scripts

run_tests = tool_scripts.load("run_tests")

# Fails at its first run alone.
FLAKY = """
import pathlib
import pytest

@pytest.mark.process
def test_flaky():
    mark = pathlib.Path(__file__).with_name("seen")
    seen = mark.exists()
    mark.touch()
    assert seen, "not yet"

@pytest.mark.process
def test_good():
    pass
"""
BROKEN = "import pytest\n\n@pytest.mark.process\ndef test_broken():\n    assert 1 == 2\n"
MARKERS = "[pytest]\nmarkers =\n    process: x\n    slow: x\n"


@pytest.mark.parametrize(
    ("given", "split"),
    [
        ([], (False, [], [])),
        (["-k", "winch", "-x"], (False, [], ["-k", "winch", "-x"])),
        (["-m", "not slow", "-k", "winch"], (False, ["not slow"], ["-k", "winch"])),
        (["--one-process", "-mslow", "test/a.py"], (True, ["slow"], ["test/a.py"])),
        (["-m", "not ros", "-m", "slow"], (False, ["not ros", "slow"], [])),
    ],
)
def test_a_user_s_markers_are_found(given: list[str], split: tuple[bool, list[str], list[str]]):
    assert run_tests.split_arguments(given) == split


def test_all_expressions_of_markers_must_hold():
    assert run_tests.combined("not process", ["slow or ros"]) == "not process and (slow or ros)"
    assert run_tests.combined("process", ["a", "b"]) == "process and (a) and (b)"
    assert run_tests.combined("process", []) == "process"


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "pytest.ini").write_text(MARKERS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTEST_ADDOPTS", "")
    monkeypatch.setattr(run_tests, "_ONE_PROCESS", ())
    monkeypatch.setattr(run_tests, "_WITH_PROCESSES", ())
    return tmp_path


def test_a_flaky_test_is_listed_with_its_traceback(tree: Path, capfd: pytest.CaptureFixture[str]):
    (tree / "test_two.py").write_text(FLAKY)
    assert run_tests.main([]) == run_tests.PASSED
    printed = capfd.readouterr().out.rpartition("==== flaky")[2]
    assert "FLAKY test_two.test_flaky" in printed
    assert "AssertionError: not yet" in printed
    assert "test_good" not in printed


def test_a_test_that_fails_again_is_a_failure(tree: Path, capfd: pytest.CaptureFixture[str]):
    (tree / "test_two.py").write_text(BROKEN)
    assert run_tests.main([]) == run_tests.FAILED
    assert "FLAKY" not in capfd.readouterr().out


def test_tests_with_processes_can_be_left_out(tree: Path):
    (tree / "test_two.py").write_text(BROKEN)
    assert run_tests.main(["--one-process"]) == run_tests.PASSED


def test_markers_of_a_user_select_within_both_passes(tree: Path, capfd: pytest.CaptureFixture[str]):
    (tree / "test_two.py").write_text(BROKEN)
    assert run_tests.main(["-m", "slow"]) == run_tests.PASSED
    assert "test_broken" not in capfd.readouterr().out
