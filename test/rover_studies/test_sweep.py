"""Sweeps: reproducible results, without lost or repeated runs."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pyarrow.csv
import pyarrow.parquet as pq
import pytest

from msg_schemas.package import package_version
from rover_cli.command_line import main
from rover_sim import Scenario, SpatialPlant, SpatialScenario, jump, load_scenario, spatial_jump
from rover_sim.plants.plant_factory import build_plant
from rover_studies.sweep import sweep as sweep_module
from rover_studies.sweep.sweep import (
    DONE,
    FAILED,
    REFUSED,
    Stopped,
    run_one,
    run_sweep,
    summary,
    sweep,
)
from rover_studies.sweep.sweep_plan import SweepPlan, make_plan
from rover_studies.sweep.sweep_store import StoreError, SweepStore, read_results
from rover_studies.sweep.sweep_workers import Workers, WorkersError, dask_cluster, local_processes

ROOT = Path(__file__).resolve().parents[2]
DEADLINE = 300.0

CONTENT: dict[str, Any] = {
    "name": "small",
    "scenario": "paper_table1_high",
    "runs": 30,
    "set": {"tether.elements": 3},
    "grid": {"start.geometry": ["-K", "+K"]},
    "random": {"start.slack": {"uniform": [0.6, 3.4]}, "start.theta0": {"normal": [0.0, 5.0]}},
}


def nothing(_rows: object) -> None:
    """Ignore the rows."""


def in_threads(count: int) -> Workers:
    return Workers(ThreadPoolExecutor(count), count, "threads")


def rows(folder: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = read_results(folder).to_pylist()
    return found


def assert_same(found: Sequence[Mapping[str, Any]], expected: Sequence[Mapping[str, Any]]) -> None:
    """Equal except for the last digits of measured values.

    A process that compiles the plant runs functions of its own library where one that loads it from
    the cache runs the copies in their callers, in which sums may be ordered otherwise.
    """
    assert len(found) == len(expected)
    for row, reference in zip(found, expected, strict=True):
        assert row == {
            key: pytest.approx(value, rel=1e-7, abs=1e-10) if isinstance(value, float) else value
            for key, value in reference.items()
        }


def write(plan: Path, content: Mapping[str, Any]) -> Path:
    plan.write_text(json.dumps(content), encoding="utf-8")
    return plan


@pytest.fixture(scope="module")
def expected() -> list[dict[str, Any]]:
    """The rows of `CONTENT`, simulated one by one."""
    plan = make_plan(CONTENT)
    return [dict(run_one(plan, number)) for number in range(plan.count)]


def test_a_row_is_the_jump_of_its_parameters(expected: list[dict[str, Any]]):
    row = expected[40]
    scenario = load_scenario(
        "paper_table1_high",
        {
            "tether.elements": 3,
            **{path: row[path] for path in ("start.geometry", "start.slack")},
            "start.theta0": row["start.theta0"],
        },
    )
    assert isinstance(scenario, Scenario)
    metrics = jump(build_plant(scenario))
    assert row["start.geometry"] == "+K"
    assert row["status"] == DONE
    assert row["jump_height_m"] == metrics.height
    assert row["attitude_variation_rad"] == metrics.attitude_variation


@pytest.mark.process
@pytest.mark.slow
def test_results_do_not_depend_on_the_number_of_workers(
    tmp_path: Path, expected: list[dict[str, Any]]
):
    plan, found = make_plan(CONTENT), []
    for workers in (1, 2, 5):
        sweep(plan, tmp_path / str(workers), workers=workers, show_progress=False).close()
        found.append(rows(tmp_path / str(workers)))
    assert found[0] == found[1] == found[2]
    assert_same(found[0], expected)


@pytest.mark.process
def test_a_dask_cluster_gives_the_same_results(tmp_path: Path, expected: list[dict[str, Any]]):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        sweep(
            make_plan(CONTENT),
            tmp_path / "out",
            scheduler=cluster.scheduler_address,
            show_progress=False,
        ).close()
    assert_same(rows(tmp_path / "out"), expected)


def test_a_cluster_that_does_not_answer_is_refused(monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("rover_studies.sweep.sweep_workers._CONNECT_TIMEOUT", 0.5)
    refused = pytest.raises(
        WorkersError, match=r"no dask scheduler answers at tcp://127\.0\.0\.1:9"
    )
    with refused, dask_cluster("tcp://127.0.0.1:9"):
        pass


@pytest.mark.process
def test_killed_at_any_time_it_continues_without_repetition(
    tmp_path: Path, expected: list[dict[str, Any]]
):
    content = {**CONTENT, "runs": 150}
    plan, out = write(tmp_path / "plan.yaml", content), tmp_path / "out"
    whole = make_plan(content)
    command = [sys.executable, "-m", "rover_cli", "sweep", str(plan), "--out", str(out)]
    kept: set[int] = set()
    for kill in range(3):
        process = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL)
        try:
            wait_for_parts(process, out, len(list(out.glob("parts/*.parquet"))) + 1)
        finally:
            process.kill()
            process.wait()
        done = kept_runs(out, whole)
        assert kept < done, f"kill {kill}: nothing was kept"
        kept = done
    assert 0 < len(kept) < whole.count
    resumed = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, timeout=DEADLINE, check=False
    )
    assert resumed.returncode == 0, resumed.stderr
    # It started with the completed runs.
    assert f"{len(kept)}/{whole.count}" in resumed.stderr
    assert_same(rows(out), [dict(run_one(whole, number)) for number in range(whole.count)])
    assert not (out / "parts").exists()


def kept_runs(folder: Path, plan: SweepPlan) -> set[int]:
    """Numbers of the completed runs of a killed sweep."""
    store = SweepStore(folder, plan, package_version())
    missing, count = set(store.missing()), store.done
    store.close()
    found = set(range(plan.count)) - missing
    assert len(found) == count
    return found


def wait_for_parts(process: subprocess.Popen[bytes], out: Path, count: int) -> None:
    look_again = threading.Event()
    for _ in range(int(DEADLINE / 0.02)):
        if len(list(out.glob("parts/*.parquet"))) >= count:
            return
        assert process.poll() is None, "it ended by itself"
        look_again.wait(0.02)
    pytest.fail("nothing was kept in time")


@pytest.mark.process
def test_workers_do_not_outlive_a_killed_sweep(tmp_path: Path):
    plan, out = write(tmp_path / "plan.yaml", {**CONTENT, "runs": 5000}), tmp_path / "out"
    process = subprocess.Popen(
        [sys.executable, "-m", "rover_cli", "sweep", str(plan), "--out", str(out)],
        cwd=ROOT,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        wait_for_parts(process, out, 1)
        process.kill()
        process.wait()
        look_again = threading.Event()
        for _ in range(1000):
            try:
                os.killpg(process.pid, 0)
            except ProcessLookupError:
                return
            look_again.wait(0.02)
        pytest.fail("workers are left")
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


@pytest.mark.process
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_what_a_terminal_sends_to_all_processes_keeps_completed_runs(
    tmp_path: Path, number: signal.Signals
):
    plan, out = write(tmp_path / "plan.yaml", {**CONTENT, "runs": 5000}), tmp_path / "out"
    process = subprocess.Popen(
        [sys.executable, "-m", "rover_cli", "sweep", str(plan), "--out", str(out)],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # Background processes of a shell ignore SIGINT, and so would their children.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509
    )
    wait_for_parts(process, out, 1)  # type: ignore[arg-type]
    os.killpg(process.pid, number)
    _, output = process.communicate(timeout=DEADLINE)
    assert process.returncode == 130
    assert "repeat the command to continue" in output
    assert "Traceback" not in output


class Flaky:
    """A task that kills its worker process."""

    def __reduce__(self) -> Any:
        return (os._exit, (9,))


@pytest.mark.process
def test_a_lost_worker_stops_the_sweep_and_loses_nothing(tmp_path: Path):
    plan = make_plan({**CONTENT, "runs": 5000})
    store = SweepStore(tmp_path / "out", plan, "1")
    with local_processes(1) as workers:

        def on_rows(_rows: object) -> None:
            if store.done > 3:
                workers.executor.submit(Flaky())  # type: ignore[arg-type]

        with pytest.raises(Stopped, match="a worker process died"):
            run_sweep(plan, store, workers, on_rows)
    assert 3 < store.done < plan.count
    store.close()


@pytest.mark.parametrize(("of_cluster", "raised"), [(False, OSError), (True, Stopped)])
def test_an_operating_system_s_error_is_the_cluster_s_only_with_a_cluster(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, of_cluster: bool, raised: type[Exception]
):
    def no_file(_text: str, _numbers: Sequence[int]) -> None:
        raise FileNotFoundError("no such file")

    monkeypatch.setattr(sweep_module, "run_batch", no_file)
    store = SweepStore(tmp_path / "out", make_plan(CONTENT), "1")
    with in_threads(1).executor as pool, pytest.raises(raised, match="no such file"):
        run_sweep(make_plan(CONTENT), store, Workers(pool, 1, "", of_cluster), nothing)
    store.close()


def test_a_failed_run_is_a_row_with_its_reason(tmp_path: Path):
    plan = make_plan(
        {
            "scenario": "paper_table1_high",
            "grid": {"start.geometry": ["-H", "+K"], "start.slack": [0.3, 1.0]},
            "set": {"tether.elements": 3, "tether.breaking_load": 8.0},
        }
    )
    with in_threads(1).executor as pool:
        store = SweepStore(tmp_path / "out", plan, "1")
        run_sweep(plan, store, Workers(pool, 1, ""), nothing)
    store.finish()
    found = rows(tmp_path / "out")
    assert [row["status"] for row in found] == [REFUSED, DONE, DONE, FAILED]
    assert "out of reach" in found[0]["reason"]
    assert "tether_broken" in found[3]["reason"]
    assert found[0]["jump_height_m"] is None
    numbers = summary(plan, store.table())
    assert numbers["statuses"] == {REFUSED: 1, DONE: 2, FAILED: 1}
    assert numbers["results"]["jump_height_m"]["count"] == 2


def test_a_folder_of_another_plan_or_without_a_sweep_is_refused(tmp_path: Path):
    out = tmp_path / "out"
    plan = make_plan(CONTENT)
    SweepStore(out, plan, "1").close()
    SweepStore(out, plan, "1").close()
    with pytest.raises(StoreError, match="another plan: seed differ"):
        SweepStore(out, make_plan({**CONTENT, "seed": 9}), "1")
    with pytest.raises(StoreError, match="started with version 1"):
        SweepStore(out, plan, "2")
    (tmp_path / "else").mkdir()
    (tmp_path / "else" / "thesis.tex").write_text("precious", encoding="utf-8")
    with pytest.raises(StoreError, match="has no sweep"):
        SweepStore(tmp_path / "else", plan, "1")
    with pytest.raises(StoreError, match="is a file"):
        SweepStore(tmp_path / "else" / "thesis.tex" / "out", plan, "1")


def test_a_folder_in_use_is_refused(tmp_path: Path):
    plan = make_plan(CONTENT)
    store = SweepStore(tmp_path / "out", plan, "1")
    with pytest.raises(StoreError, match="another process is running"):
        SweepStore(tmp_path / "out", plan, "1")
    store.close()


@pytest.mark.parametrize("column", ["run", "peak_tension_N"])
def test_a_damaged_part_is_repeated(tmp_path: Path, expected: list[dict[str, Any]], column: str):
    plan, out = make_plan(CONTENT), tmp_path / "out"
    store = SweepStore(out, plan, "1")
    for first in range(0, 30, 10):
        store.add(expected[first : first + 10])
    store.close()
    part = sorted((out / "parts").glob("*.parquet"))[1]
    data = bytearray(part.read_bytes())
    group = pq.read_metadata(part).row_group(0)
    chunks = [group.column(index) for index in range(group.num_columns)]
    (chunk,) = (each for each in chunks if each.path_in_schema == column)
    begin = chunk.dictionary_page_offset or chunk.data_page_offset
    data[begin + chunk.total_compressed_size - 1] ^= 0xFF
    part.write_bytes(bytes(data))
    (out / "parts" / "000000059_1.parquet.unfinished").write_bytes(b"half")
    store = SweepStore(out, plan, "1")
    assert store.done == 20
    with in_threads(1).executor as pool:
        run_sweep(plan, store, Workers(pool, 1, ""), nothing)
    store.finish()
    assert_same(rows(out), expected)


def test_damaged_results_are_refused_with_the_remedy(tmp_path: Path):
    out = tmp_path / "out"
    SweepStore(out, make_plan(CONTENT), "1").close()
    (out / "results.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(StoreError, match=r"results\.parquet is damaged: .*; remove it and repeat"):
        SweepStore(out, make_plan(CONTENT), "1")


def test_batches_never_have_a_run_twice(tmp_path: Path):
    plan = make_plan(CONTENT)
    store = SweepStore(tmp_path / "out", plan, "1")
    seen: list[int] = []

    def on_rows(batch: Sequence[Mapping[str, Any]]) -> None:
        seen.extend(int(row["run"]) for row in batch)

    with in_threads(2).executor as pool:
        run_sweep(plan, store, Workers(pool, 2, ""), on_rows)
    assert sorted(seen) == list(range(plan.count))
    store.close()


@pytest.mark.process
def test_the_command_runs_a_plan_and_prints_its_summary(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], expected: list[dict[str, Any]]
):
    plan, out = write(tmp_path / "plan.yaml", CONTENT), tmp_path / "out"
    assert main(["sweep", str(plan), "--dry-run"]) == 0
    assert "60 runs = 2 points of the grid x 30" in capsys.readouterr().out
    assert main(["sweep", str(plan), "--out", str(out), "--workers=1", "--json", "--csv"]) == 0
    output = json.loads(capsys.readouterr().out)
    heights = [row["jump_height_m"] for row in expected]
    assert output["runs"] == 60
    assert output["results"]["jump_height_m"]["mean"] == pytest.approx(sum(heights) / 60, rel=1e-9)
    assert json.loads((out / "summary.json").read_text()) == output
    table = pyarrow.csv.read_csv(out / "results.csv")
    assert table.column("jump_height_m").to_pylist() == pytest.approx(heights, rel=1e-9)
    # Complete: repeated, the command only prints the summary.
    assert main(["sweep", str(plan), "--out", str(out)]) == 0
    assert "jump_height_m" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [(["--set", "tether.elements=none"], "tether.elements"), (["--seed", "-4"], "seed: -4"),
     (["--set", "nonsense"], "dotted.path=value")],
)  # fmt: skip
def test_bad_arguments_are_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], complaint: str
):
    assert main(["sweep", str(write(tmp_path / "plan.yaml", CONTENT)), *arguments]) == 2
    output = capsys.readouterr().err
    assert complaint in output
    assert len(output.splitlines()) == 1


def test_the_experiment_run_simulates_a_tether(tmp_path: Path):
    plan = make_plan(
        {
            "scenario": "tether_pendulum",
            "experiment": "run",
            "settings": {"duration": 0.1, "tick": 0.05},
            "grid": {"tether.elements": [4, 8]},
        }
    )
    row = run_one(plan, 1)
    assert row["status"] == DONE
    assert row["time_s"] == pytest.approx(0.1)
    # Released level, it is initially in free fall except near its fixed end.
    assert row["tip_y_m"] == pytest.approx(-0.5 * 9.81 * 0.1**2, rel=0.05)
    assert abs(float(str(row["energy_drift_J"]))) < 1e-9


def test_spatial_jumps_that_share_a_settled_start_are_bit_for_bit_the_single_ones():
    plan = make_plan(
        {
            "scenario": "floor_rubble",
            "experiment": "spatial_jump",
            "runs": 2,
            "set": {"environment.boulders": None, "tether.length": 6.0, "start.position": [1.0, 0]},
            "random": {
                "start.compression": {"uniform": [0.08, 0.12]},
                "start.heading": {"choice": [0.0, 90.0]},
            },
        }
    )
    for number in range(2):
        row = run_one(plan, number)
        assert row["status"] == DONE, row
        scenario = plan.scenario_of(plan.run(number))
        assert isinstance(scenario, SpatialScenario)
        metrics = spatial_jump(SpatialPlant(scenario))
        assert row["jump_height_m"] == metrics.height
        assert row["clearance_m"] == metrics.clearance
        assert row["peak_tension_N"] == metrics.peak_tension


def test_a_rover_that_does_not_settle_is_a_failed_run():
    plan = make_plan(
        {
            "scenario": "floor_rubble",
            "experiment": "spatial_jump",
            "set": {"start.compression": 0.1, "start.settling_time": 0.02},
        }
    )
    row = run_one(plan, 0)
    assert row["status"] == FAILED
    assert "still moving" in str(row["reason"])
    assert row["jump_height_m"] is None
