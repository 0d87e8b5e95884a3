"""Rare events of jumps: rounds of a sweep, continued after a stop, with any number of workers."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from msg_schemas.package import package_version
from rover_cli.command_line import main
from rover_studies.sweep.rare_event_sweep import rare_event_numbers
from rover_studies.sweep.sweep import sweep
from rover_studies.sweep.sweep_plan import SweepPlan, make_plan
from rover_studies.sweep.sweep_store import SweepStore, read_results

pytestmark = [pytest.mark.process, pytest.mark.slow]

EVENT: dict[str, Any] = {"quantity": "peak_tension_N", "above": 4.0, "max_runs": 2000}
CONTENT: dict[str, Any] = {
    "name": "overload",
    "scenario": "paper_table1_high",
    "set": {
        "tether.elements": 3,
        "tether.axial_damping_time": 1e-3,
        "start.geometry": "-K",
        "start.slack": 1.0,
    },
    "random": {
        "start.theta0": {"normal": [0.0, 4.0], "within": [-16.0, 16.0]},
        "take_off.compression": {"normal": [0.2, 0.01], "within": [0.15, 0.25]},
    },
    "rare_event": EVENT,
}


def rows(folder: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = read_results(folder).to_pylist()
    return found


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the results of `CONTENT`, by one process."""
    folder = tmp_path_factory.mktemp("whole") / "out"
    sweep(make_plan(CONTENT), folder, workers=1, show_progress=False).close()
    return folder


def test_the_estimate_agrees_with_monte_carlo(whole: Path, tmp_path: Path):
    plan = make_plan(CONTENT)
    found = rare_event_numbers(plan, read_results(whole))
    assert found["outcome"] == "estimated"
    assert 0 < found["runs"] <= 2000
    simple = make_plan(
        {**CONTENT, "rare_event": {**EVENT, "method": "monte_carlo", "max_runs": 2000}, "seed": 2}
    )
    sweep(simple, tmp_path / "out", workers=2, show_progress=False).close()
    expected = rare_event_numbers(simple, read_results(tmp_path / "out"))
    assert expected["probability"] < 0.05
    # Each interval holds the truth, so they overlap.
    assert max(found["low"], expected["low"]) < min(found["high"], expected["high"])
    # The most probable failing run fails, when it is simulated alone.
    row = rows(whole)[found["design_run"]]
    assert row["peak_tension_N"] > 4.0
    assert found["design_point"] == {path: row[path] for path in CONTENT["random"]}


def test_rounds_do_not_depend_on_the_number_of_workers(whole: Path, tmp_path: Path):
    sweep(make_plan(CONTENT), tmp_path / "out", workers=3, show_progress=False).close()
    assert rows(tmp_path / "out") == rows(whole)


def test_a_stopped_estimate_goes_on_with_the_same_rounds(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """It stops once within the first round and once within the second."""
    plan = make_plan(CONTENT)
    add = SweepStore.add
    for stop_at in (plan.count // 2, plan.count + 20):

        def add_and_stop(
            store: SweepStore, batch: Sequence[Mapping[str, Any]], limit: int = stop_at
        ) -> None:
            add(store, batch)
            if store.done >= limit:
                raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(SweepStore, "add", add_and_stop)
            with pytest.raises(KeyboardInterrupt):
                sweep(plan, tmp_path / "out", workers=1, show_progress=False)
        assert stop_at <= kept(tmp_path / "out", plan) < len(rows(whole))
    sweep(plan, tmp_path / "out", workers=1, show_progress=False).close()
    assert rows(tmp_path / "out") == rows(whole)


def kept(folder: Path, plan: SweepPlan) -> int:
    store = SweepStore(folder, plan, package_version())
    done = store.done
    store.close()
    return done


def test_the_command_prints_and_stores_the_estimate(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    file = tmp_path / "plan.yaml"
    file.write_text(json.dumps(CONTENT), encoding="utf-8")
    assert main(["sweep", str(file), "--dry-run"]) == 0
    assert "probability of peak_tension_N above 4 from at most 2000 runs" in capsys.readouterr().out
    # Complete already: the command repeats its summary.
    assert main(["sweep", str(file), "--out", str(whole)]) == 0
    text = capsys.readouterr().out
    assert main(["sweep", str(file), "--out", str(whole), "--json"]) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert json.loads((whole / "summary.json").read_text()) == numbers
    found = numbers["rare_event"]
    assert found["outcome"] == "estimated"
    assert f"{found['probability']:.4g}, {found['low']:.3g} to {found['high']:.3g}" in text
    assert f"from {found['counted_runs']} of {found['runs']} runs" in text
    assert f"start.theta0 = {found['design_point']['start.theta0']}" in text
    assert main(["sweep", str(file), "--out", str(whole), "--runs", "5"]) == 2
    assert "determines its runs" in capsys.readouterr().err


def test_a_limit_that_no_jump_approaches_is_reported(tmp_path: Path):
    # The tether cannot be longer than it is.
    event = {"quantity": "jump_height_m", "above": 50.0, "max_runs": 2000}
    plan = make_plan({**CONTENT, "rare_event": event})
    sweep(plan, tmp_path / "out", workers=1, show_progress=False).close()
    found = rare_event_numbers(plan, read_results(tmp_path / "out"))
    assert found["outcome"] == "not_reached"
    assert found["probability"] is None
    assert 0.3 < found["nearest"] < 2.0
    assert found["design_point"] is None
