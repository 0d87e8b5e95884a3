"""The bench: matching by error, the table and its JSON, with and without the peer."""

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from msg_schemas import topics
from rover_cli.command_line import main
from rover_verify.bench import (
    bench,
    bench_cases,
    bench_messages,
    bench_mission,
    bench_spatial,
    core_peak,
    exudyn_peer,
)
from rover_verify.bench.bench_cases import (
    BenchCase,
    Ours,
    Point,
    Survey,
    match,
    ratios_along,
    timed,
)
from rover_verify.bench.bench_row import Row, bench_row
from rover_verify.bench.trial import SAMPLE, BenchSetting, Trial

KEYS = {"case", "n", "rtf", "error_m", "peer", "peer_rtf", "peer_error_m", "ratio"}
MISSION_ROWS = [
    bench_row(bench_mission.CASE, 1, host="composed", process="sim_node", share=0.25),
    bench_row(bench_mission.CASE, 6, host="loop host", rtf=8.0),
]
TINY = BenchCase("tiny", "tether_pendulum", (), 3, 0.2, 0.2, 1e-3)


@pytest.fixture
def once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Short runs are not repeated for their time."""
    monkeypatch.setattr(bench_cases, "_MOST_REPEATS", 0)


def point(h: float, cpu: float, error: float) -> Point:
    return Point(BenchSetting(h, 1e-8, "method"), cpu, error, 0)


def survey(*points: Point) -> Survey:
    return Survey(points, 1e-9)


PEER = survey(point(4e-3, 0.1, 5e-3), point(2e-3, 0.2, 8e-4), point(1e-3, 0.4, 2e-4))
OWN = survey(point(4e-3, 0.01, 2e-3), point(2e-3, 0.02, 6e-4), point(1e-3, 0.04, 1e-4))


def test_the_peer_s_fastest_setting_within_the_accuracy_meets_ours_that_is_no_worse():
    pair = match(TINY, OWN, PEER)
    assert pair.peer is not None
    assert (pair.peer.setting.h, pair.ours.setting.h) == (2e-3, 2e-3)
    slow = survey(point(2e-3, 0.02, 9e-4), point(1e-3, 0.04, 1e-4))
    assert match(TINY, slow, PEER).ours.setting.h == 1e-3


def test_without_a_peer_the_fastest_within_the_accuracy_is_shown():
    pair = match(TINY, OWN, None)
    assert pair.peer is None
    assert pair.ours.setting.h == 2e-3


def test_where_nobody_is_accurate_enough_the_best_are_compared():
    bad = survey(point(1e-3, 0.4, 0.5))
    assert match(TINY, OWN, bad).peer == bad.points[0]
    assert match(TINY, bad, None).ours == bad.points[0]


def test_the_frontier_holds_what_nobody_beats():
    beaten = point(3e-3, 0.3, 9e-4)
    assert beaten not in survey(*PEER.points, beaten).frontier()
    assert survey(*PEER.points).frontier() == list(PEER.points)


def test_ratios_along_the_frontier_leave_out_what_is_too_coarse():
    found = dict(ratios_along(OWN, PEER, 1e-4))
    assert found == {8e-4: pytest.approx(10.0), 2e-4: pytest.approx(10.0)}


def test_errors_count_up_to_the_given_time_only():
    path = np.zeros((5, 2))
    other = path.copy()
    other[1] = 3e-3, 4e-3
    other[4] = 1.0, 0.0
    assert Trial(0.1, other).error(path, 2 * SAMPLE) == pytest.approx(5e-3)
    assert Trial(0.1, other).error(path, 4 * SAMPLE) == pytest.approx(1.0)


def test_every_step_of_the_bench_meets_the_samples_and_the_ends():
    for case in bench_cases.cases():
        assert case.compared_until <= case.duration
        for setting in Ours(case).settings() if case.elements == 5 else []:
            assert math.isclose(SAMPLE / setting.h, round(SAMPLE / setting.h))


def test_timing_takes_turns_and_gives_medians():
    order: list[str] = []

    def run(name: str, times: list[float]) -> Callable[[], Trial]:
        def once() -> Trial:
            order.append(name)
            return Trial(times.pop(0), np.zeros((1, 2)))

        return once

    runs = [run("a", [1.0, 9.0, 2.0]), run("b", [5.0, 4.0, 3.0])]
    assert timed(runs, 3, lambda _text: None) == [2.0, 4.0]
    assert order == ["a", "b"] * 3


def test_ours_converges_to_its_own_reference():
    ours = Ours(TINY)
    reference = ours.run(ours.reference(), 0.2)
    coarse, fine = (ours.run(BenchSetting(h, 1e-10, "") , 0.2) for h in (4e-3, 1e-3))  # fmt: skip
    assert reference is not None
    assert coarse is not None
    assert fine is not None
    assert fine.error(reference.path, 0.2) < 0.2 * coarse.error(reference.path, 0.2)
    assert fine.cpu > 0.0
    assert fine.iterations > 0


def check_rows(rows: list[Row], *, peer: bool) -> None:
    assert rows
    for row in rows:
        assert set(row) >= KEYS
        assert isinstance(row["rtf"], float)
        assert row["rtf"] > 0.0
        if row["error_m"] is not None:
            assert (row["ratio"] is not None) == peer
    json.dumps(rows, allow_nan=False)
    assert "tiny" in bench.table(rows)


@pytest.mark.skipif(exudyn_peer.load() is None, reason="Exudyn is not installed")
@pytest.mark.usefixtures("once")
def test_a_tiny_case_side_by_side():
    rows = bench.run_bench([TINY], 1, costs=False, quiet=True)
    check_rows(rows, peer=True)
    (row,) = rows
    assert str(row["peer"]).startswith("Exudyn 1.")
    assert row["ours_no_less_accurate"] is True
    assert isinstance(row["ratio"], float)
    assert isinstance(row["peer_rtf"], float)
    assert isinstance(row["rtf"], float)
    assert row["ratio"] == pytest.approx(row["rtf"] / row["peer_rtf"])


@pytest.mark.skipif(exudyn_peer.load() is None, reason="Exudyn is not installed")
@pytest.mark.parametrize("name", ["pendulum, 1 s", "jump"])
def test_both_codes_move_alike(name: str):
    """The comparison is of the same motion: both converge to it but for the strain's definition."""
    (case,) = [c for c in bench_cases.cases() if c.name == name and c.elements == 5]
    ours, peer = Ours(case), bench_cases.Exudyn(case)
    own = ours.run(BenchSetting(2.5e-4, 1e-10, ""), 0.4)
    other = peer.run(BenchSetting(2.5e-4, 1e-9, "GeneralizedAlpha"), 0.4)
    assert own is not None
    assert other is not None
    assert own.error(other.path, 0.4) < 3e-5


@pytest.mark.usefixtures("once")
def test_a_tiny_case_without_the_peer_is_written(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setattr(exudyn_peer, "load", lambda: None)
    monkeypatch.setattr(bench, "cases", lambda: [TINY])
    assert main(["bench", "--out", str(tmp_path), "--repetitions", "1", "--case", "tiny"]) == 0
    rows = json.loads((tmp_path / "bench.json").read_text())
    check_rows(rows, peer=False)
    assert {rows[0][key] for key in ("peer", "peer_rtf", "peer_error_m", "ratio")} == {None}
    assert "not installed" in bench.notes(peer=False)


@pytest.mark.slow
@pytest.mark.usefixtures("once")
def test_the_smallest_bench_runs_to_its_tables(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(bench, "cases", lambda: [TINY])
    monkeypatch.setattr(bench, "COST_ELEMENTS", (3, 5))
    monkeypatch.setattr(bench, "_SWEEP_RUNS", 20)
    monkeypatch.setattr(bench_spatial, "ELEMENTS", (20, 40))
    monkeypatch.setattr(bench_mission, "measure", lambda _duration: MISSION_ROWS)
    assert main(["bench", "--out", str(tmp_path), "--repetitions", "1"]) == 0
    printed = capsys.readouterr().out
    for heading in (
        "sim_node",
        "tiny",
        "cost per step",
        "resting on rubble",
        "workers",
        "Written:",
    ):
        assert heading in printed
    rows = json.loads((tmp_path / "bench.json").read_text())
    assert {"tiny", "cost per step"} < {row["case"] for row in rows}


def test_each_hot_topic_is_packed_and_unpacked(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(bench_messages, "_CALLS", 20)
    arguments = ["--out", str(tmp_path), "--repetitions", "1", "--case", bench_messages.CASE]
    assert main(["bench", *arguments]) == 0
    rows = json.loads((tmp_path / "bench.json").read_text())
    assert [row["topic"] for row in rows] == [row.name for row in bench_messages.hot_topics()]
    assert topics.WINCH_COMMAND in capsys.readouterr().out
    for row in rows:
        assert 0.0 < row["pack_us"] < 1e4
        assert 0.0 < row["unpack_us"] < 1e4


@pytest.mark.ros
@pytest.mark.process
@pytest.mark.slow
def test_a_mission_is_measured_on_each_host(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(bench, "_MISSION_DURATION", 1.0)
    monkeypatch.setattr(bench_mission, "_SETTLED", 0.0)
    arguments = ["--out", str(tmp_path), "--case", bench_mission.CASE]
    assert main(["bench", *arguments]) == 0
    rows = json.loads((tmp_path / "bench.json").read_text())
    shares = {(row["host"], row["process"]): row["share"] for row in rows if "share" in row}
    assert ("composed", "rover_nodes") in shares
    assert ("each alone", "jump_node") in shares
    assert all(0.0 < share < 2.0 for share in shares.values())
    speeds = {row["host"]: row["rtf"] for row in rows if row["rtf"] is not None}
    assert speeds.keys() == {
        "loop host",
        "one process",
        "composed",
        "each alone",
        "composed, recorder",
        "one process, recorder, page",
    }
    assert all(0.01 < speed < 1000.0 for speed in speeds.values())
    assert "one process" in capsys.readouterr().out


@pytest.mark.parametrize("arguments", [["--repetitions", "0"], ["--case", "nothing"]])
def test_bad_arguments_are_refused(arguments: list[str]):
    with pytest.raises(SystemExit) as ended:
        main(["bench", *arguments])
    assert ended.value.code == 2


def test_the_core_s_peak_is_measured():
    assert 0.1 < core_peak.peak_gflops() < 1e4
