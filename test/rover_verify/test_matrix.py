"""The runner: what passes, fails, breaks; what is kept; and that a stopped run goes on."""

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rover_cli.command_line import main
from rover_sim.physics.references.planar_dae import PlanarDae
from rover_verify import checks
from rover_verify.checks import CheckBatch, Measured, NotPossible
from rover_verify.requirements import matrix, matrix_page
from rover_verify.requirements.matrix import RowResult, Store, measure, verify
from rover_verify.requirements.requirements import Limit, Requirement, load_requirements


def row_of(check: str | None, status: str = "required", identifier: str = "TEST-ROW-01"):
    return Requirement(
        id=identifier,
        area="Area",
        statement="It is so.",
        method="test",
        limit=Limit("<=", 1.0, "m"),
        check=check,
        tests=(),
        status=status,
        milestone="",
        command="verify",
        note="",
    )


UseCheck = Callable[[Callable[[CheckBatch], Measured]], None]


@pytest.fixture
def with_check(monkeypatch: pytest.MonkeyPatch) -> UseCheck:
    """Let a row's check be a function of the test."""

    def use(check: Callable[[CheckBatch], Measured]) -> None:
        monkeypatch.setattr(matrix, "find_check", lambda _name: check)

    return use


def batch_in(folder: Path) -> CheckBatch:
    return CheckBatch(runs=3, seed=1, folder=folder)


def test_every_package_and_the_tests_are_sources_of_a_result():
    root = Path(matrix.__file__).parents[2]
    assert {path.parent.name for path in root.glob("*/py.typed")} | {"test"} == set(matrix.SOURCES)


@pytest.mark.parametrize("name", ["rover_hil/eds/winch.eds", "test/rover_hil/test_faults.py"])
def test_a_change_of_a_source_is_another_source(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
):
    monkeypatch.setattr(matrix, "_ROOT", tmp_path)
    source = tmp_path / name
    source.parent.mkdir(parents=True)
    source.write_text("before", encoding="utf-8")
    before = matrix.source_digest()
    source.write_text("after", encoding="utf-8")
    assert matrix.source_digest() != before


@pytest.mark.parametrize(("value", "state"), [(0.5, "PASS"), (1.0, "PASS"), (1.01, "FAIL")])
def test_a_value_beyond_the_limit_fails(
    with_check: UseCheck, tmp_path: Path, value: float, state: str
):
    with_check(lambda _batch: Measured(value, "as it is"))
    result = measure(row_of("some.check"), batch_in(tmp_path))
    assert (result.state, result.measured, result.passed) == (state, value, state == "PASS")


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_value_that_is_not_finite_fails(with_check: UseCheck, tmp_path: Path, value: float):
    with_check(lambda _batch: Measured(value))
    result = measure(row_of("some.check"), batch_in(tmp_path))
    assert (result.state, result.measured, result.passed) == ("FAIL", None, False)


def test_a_check_that_raises_is_reported_with_its_trace_and_hides_nothing(
    with_check: UseCheck, tmp_path: Path
):
    def broken(_batch: CheckBatch) -> Measured:
        raise ZeroDivisionError("of the check")

    with_check(broken)
    result = measure(row_of("some.check"), batch_in(tmp_path))
    assert result.state == "ERROR"
    assert "ZeroDivisionError: of the check" in result.note
    assert "in broken" in (tmp_path / "error.txt").read_text()


def test_a_check_that_does_not_exist_is_an_error(tmp_path: Path):
    assert measure(row_of("tether.nothing"), batch_in(tmp_path)).state == "ERROR"


def test_a_check_that_cannot_run_here_is_reported(with_check: UseCheck, tmp_path: Path):
    def absent(_batch: CheckBatch) -> Measured:
        raise NotPossible("no tool")

    with_check(absent)
    assert measure(row_of("some.check"), batch_in(tmp_path)).state == "NOT RUN"


def test_open_rows_are_reported_and_never_decide(with_check: UseCheck, tmp_path: Path):
    result = measure(row_of(None, "open"), batch_in(tmp_path))
    assert (result.state, result.measured, result.passed) == ("OPEN", None, False)
    with_check(lambda _batch: Measured(5.0))
    result = measure(row_of("some.check", "open"), batch_in(tmp_path))
    assert (result.state, result.measured, result.passed) == ("OPEN", 5.0, False)
    with_check(lambda _batch: Measured(float("nan")))
    result = measure(row_of("some.check", "open"), batch_in(tmp_path))
    assert (result.state, result.measured, result.passed) == ("OPEN", None, False)


def test_open_rows_are_measured_on_few_runs(with_check: UseCheck, tmp_path: Path):
    with_check(lambda batch: Measured(float(batch.runs)))
    rows = [row_of("some.check", status, f"TEST-{status}-01") for status in ("open", "required")]
    results = verify(rows, CheckBatch(20, 1, tmp_path), quiet=True)
    assert [result.measured for result in results] == [2.0, 20.0]


def test_open_rows_that_are_named_have_all_their_runs(with_check: UseCheck, tmp_path: Path):
    with_check(lambda batch: Measured(float(batch.runs)))
    row = row_of("some.check", "open")
    few = verify([row], CheckBatch(20, 1, tmp_path), quiet=True)
    # Not the few that are kept.
    all_ = verify([row], CheckBatch(20, 1, tmp_path), quiet=True, named=[row.id])
    assert [each.measured for each in few + all_] == [2.0, 20.0]


def test_random_runs_do_not_depend_on_how_many_there_are(tmp_path: Path):
    few = [g.random() for g in CheckBatch(3, 7, tmp_path).generators()]
    many = [g.random() for g in CheckBatch(5, 7, tmp_path).generators()]
    other = [g.random() for g in CheckBatch(3, 8, tmp_path).generators()]
    assert few == many[:3]
    assert few != other


# ------------------------------------------------------------------------------- keeping results


def test_a_result_is_kept_for_the_same_runs_seed_and_source_only(tmp_path: Path):
    row, result = row_of("some.check"), RowResult("PASS", 0.5, True, 1.0, "note", {"a": 1.0})
    Store(CheckBatch(3, 1, tmp_path), "source").put(row, result)
    assert Store(CheckBatch(3, 1, tmp_path), "source").get(row) == result
    for runs, seed, source in ((4, 1, "source"), (3, 2, "source"), (3, 1, "changed")):
        assert Store(CheckBatch(runs, seed, tmp_path), source).get(row) is None
    assert Store(CheckBatch(3, 1, tmp_path), "source").get(row_of("other.check")) is None


@pytest.mark.parametrize("state", ["FAIL", "ERROR", "NOT RUN"])
def test_what_did_not_pass_is_measured_again(tmp_path: Path, state: str):
    value = 2.0 if state == "FAIL" else None
    store = Store(CheckBatch(3, 1, tmp_path), "source")
    store.put(row_of("some.check"), RowResult(state, value, False))
    assert store.get(row_of("some.check")) is None


def test_a_half_written_result_counts_as_none(tmp_path: Path):
    store = Store(CheckBatch(3, 1, tmp_path), "source")
    (tmp_path / "TEST-ROW-01.json").write_text('{"key": {"runs"')
    assert store.get(row_of("some.check")) is None


def test_what_a_check_keeps_outlives_a_kill_and_not_a_fresh_start(
    with_check: UseCheck, tmp_path: Path
):
    there: list[bool] = []

    def stops_the_first_time(batch: CheckBatch) -> Measured:
        assert batch.kept is not None
        there.append((batch.kept / "run").exists())
        batch.kept.mkdir(parents=True, exist_ok=True)
        (batch.kept / "run").touch()
        if len(there) == 1:
            raise KeyboardInterrupt
        return Measured(0.5)

    with_check(stops_the_first_time)
    with pytest.raises(KeyboardInterrupt):
        verify([row_of("some.check")], CheckBatch(3, 1, tmp_path), quiet=True)
    verify([row_of("some.check")], CheckBatch(4, 2, tmp_path), quiet=True)
    verify([row_of("some.check")], CheckBatch(4, 2, tmp_path), quiet=True, fresh=True)
    assert there == [False, True, False]


def test_a_stopped_run_goes_on_where_it_was(with_check: UseCheck, tmp_path: Path):
    ran: list[Path] = []

    def stops_in_the_second(batch: CheckBatch) -> Measured:
        ran.append(batch.folder)
        if len(ran) == 2:
            raise KeyboardInterrupt
        return Measured(0.5)

    with_check(stops_in_the_second)
    rows = [row_of("some.check", identifier=f"TEST-ROW-0{i}") for i in (1, 2, 3)]
    with pytest.raises(KeyboardInterrupt):
        verify(rows, CheckBatch(3, 1, tmp_path), quiet=True)
    results = verify(rows, CheckBatch(3, 1, tmp_path), quiet=True)
    assert [result.state for result in results] == ["PASS"] * 3
    assert [folder.name for folder in ran] == [
        "TEST-ROW-01", "TEST-ROW-02", "TEST-ROW-02", "TEST-ROW-03",
    ]  # fmt: skip
    verify(rows, CheckBatch(3, 1, tmp_path), quiet=True, fresh=True)
    assert len(ran) == 7


def test_killed_it_keeps_what_was_done(tmp_path: Path):
    code = (
        "import sys, threading\n"
        "from rover_verify.requirements import matrix\n"
        "from rover_verify.checks import Measured\n"
        "from rover_verify.requirements.requirements import load_requirements\n"
        "done = []\n"
        "def check(batch):\n"
        "    if done:\n"
        "        print('second', flush=True)\n"
        "        threading.Event().wait(60)\n"
        "    done.append(1)\n"
        "    return Measured(0.0)\n"
        "matrix.find_check = lambda name: check\n"
        "rows = [r for r in load_requirements() if r.id.startswith('TETHER-RIGID')]\n"
        "rows += [r for r in load_requirements() if r.id.startswith('TETHER-MIRROR')]\n"
        "folder = __import__('pathlib').Path(sys.argv[1])\n"
        "matrix.verify(rows, matrix.CheckBatch(2, 1, folder), quiet=True)\n"
    )
    root = str(Path(matrix.__file__).parents[2])
    with subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": root},
    ) as process:
        guard = threading.Timer(120.0, process.kill)
        guard.start()
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith("second"):
                break
        process.send_signal(signal.SIGKILL)
        guard.cancel()
    kept = list((tmp_path / "verification" / "results").glob("*.json"))
    assert [path.stem for path in kept] == ["TETHER-RIGID-01"]


# ----------------------------------------------------------------------------------- reports


def run_main(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, value: float, *more: str) -> int:
    first = next(row for row in load_requirements() if row.id == "TETHER-RIGID-01")
    to_come = replace(first, id="TETHER-RIGID-02", status="open", check=None)
    monkeypatch.setattr(matrix, "load_requirements", lambda: [first, to_come])
    monkeypatch.setattr(matrix, "find_check", lambda _name: lambda _batch: Measured(value, "so"))
    return main(["verify", "--only", "TETHER-RIGID", "--runs", "2", "--out", str(tmp_path), *more])


def test_the_report_and_the_exit_code(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    assert run_main(monkeypatch, tmp_path, 0.0) == 0
    rows = json.loads((tmp_path / "verification.json").read_text())
    assert rows[0]["id"] == "TETHER-RIGID-01"
    for row in rows:
        assert {"id", "statement", "required", "measured", "pass", "method", "command"} <= set(row)
    assert rows[0]["pass"] is True
    assert all(row["measured"] is None and row["pass"] is False for row in rows[1:])
    assert run_main(monkeypatch, tmp_path, 1.0, "--fresh") == 1
    text = (tmp_path / "verification.html").read_text()
    assert "Not passed" in text
    assert "TETHER-RIGID-01" in text


def test_the_page_is_self_contained_and_shows_every_row(tmp_path: Path):
    rows: list[Mapping[str, object]] = [
        {
            "id": f"TEST-ROW-0{i}", "area": "Area", "statement": "a < b & c", "required": "<= 1 m",
            "measured": 0.5, "unit": "m", "pass": True, "state": state, "status": "required",
            "method": "test", "command": "verify", "note": "", "details": {"x": 1.0, "y": "z"},
        }
        for i, state in enumerate(matrix_page.STATES)
    ]  # fmt: skip
    text = matrix_page.render(rows, 3, 1)
    assert "http://" not in text
    assert "https://" not in text
    assert "a &lt; b &amp; c" in text
    for row in rows:
        assert str(row["id"]) in text


@pytest.mark.parametrize("arguments", [["--runs", "0"], ["--seed", "-1"], ["--only", "NO-SUCH"]])
def test_bad_arguments_are_refused(arguments: list[str], capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as ended:
        main(["verify", *arguments])
    assert ended.value.code == 2
    assert arguments[0].strip("-") in capsys.readouterr().err or "requirement" in arguments[0]


def test_the_list_shows_every_requirement(capsys: pytest.CaptureFixture[str]):
    assert main(["verify", "--list"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert len(listed) == len(load_requirements())


def test_a_repeated_choice_adds_to_the_first(capsys: pytest.CaptureFixture[str]):
    assert main(["verify", "--list", "--only", "TETHER-SAG", "--only", "TETHER-BEAM-01"]) == 0
    listed = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert listed == ["TETHER-SAG-01", "TETHER-SAG-02", "TETHER-BEAM-01"]


# --------------------------------------------------------------------- checks are able to fail


def row_named(identifier: str) -> Requirement:
    return next(row for row in load_requirements() if row.id == identifier)


def test_a_wrong_model_fails_its_check(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """Gravity off by one part in a thousand shows in the motion."""
    row = row_named("PLANAR-DAE-01")
    assert measure(row, batch_in(tmp_path)).state == "PASS"

    def heavier(
        section: Any, length: float, elements: int, rover: Any, gravity: float
    ) -> PlanarDae:
        return PlanarDae(section, length, elements, rover, 1.001 * gravity)

    monkeypatch.setattr("rover_verify.checks.planar.PlanarDae", heavier)
    assert measure(row, batch_in(tmp_path)).state == "FAIL"


@pytest.mark.parametrize(("limit", "state"), [(2e-4, "PASS"), (1e-5, "FAIL")])
def test_the_worst_value_that_tests_record_is_held_to_the_limit(
    tmp_path: Path, limit: float, state: str
):
    row = row_named("TETHER-CIRCLE-01")
    result = measure(replace(row, limit=Limit("<=", limit, "m")), batch_in(tmp_path))
    assert result.state == state
    assert result.details is not None
    assert (
        result.measured == max(map(float, result.details.values())) == pytest.approx(7e-5, rel=0.1)
    )


def test_generated_runs_are_reported_to_the_progress_callback(tmp_path: Path):
    reported: list[tuple[int, int]] = []
    batch = checks.CheckBatch(2, 1, tmp_path, lambda done, total: reported.append((done, total)))
    assert all(isinstance(g, np.random.Generator) for g in batch.generators())
    assert reported == [(1, 2), (2, 2)]
