"""The demonstration: judged by its figures, run as a process, stopped in the middle."""

import json
import signal
from pathlib import Path

import pytest

from msg_schemas import topics
from rover_cli.command_line import main
from rover_verify.demo.jump_show import judge
from rover_verify.harness import Process
from rover_verify.harness.processes import environment

GOOD = {
    "jump_height_m": 0.3084,
    "attitude_variation_rad": 0.6615,
    "energy_drift_J": 1e-9,
    "jumps": [{}],
    "closed": True,
    "topics": {
        topics.TRUTH_BODY1: {"count": 100, "lost_in_transport": 0, "dropped": 0, "rejected": 0}
    },
}


def test_the_reference_itself_is_as_it_should_be():
    assert all(holds for _, holds in judge(GOOD))


@pytest.mark.parametrize(
    "change",
    [
        {"jump_height_m": 0.3090},
        {"jump_height_m": None},
        {"attitude_variation_rad": -0.6615},
        {"attitude_variation_rad": 0.664},
        {"energy_drift_J": 1e-3},
        {"energy_drift_J": None},
        {"jumps": []},
        {"jumps": [{}, {}]},
        {"closed": False},
        {"topics": {"clock": {"count": 100, "lost_in_transport": 0, "dropped": 0, "rejected": 1}}},
        {"topics": {"clock": {"count": 100, "lost_in_transport": 0, "dropped": 1, "rejected": 0}}},
        {"topics": {"clock": {"count": 100, "lost_in_transport": 20, "dropped": 0, "rejected": 0}}},
    ],
)
def test_any_deviation_is_reported(change: dict[str, object]):
    assert sum(not holds for _, holds in judge({**GOOD, **change})) == 1


def run_demo(folder: Path, *arguments: str) -> Process:
    return Process("rover_cli", ("demo", *arguments), environment(0), folder)


@pytest.mark.ros
@pytest.mark.process
@pytest.mark.slow
@pytest.mark.usefixtures("compiled")
def test_it_shows_a_jump_and_replaces_an_older_one(tmp_path: Path):
    old = tmp_path / "out" / "demo"
    old.mkdir(parents=True)
    (old / "metrics.json").write_text("{}")
    (old / "of_before").write_text("")
    process = run_demo(tmp_path, "jump")
    assert process.wait(240.0) == 0, process.output
    assert "All checks passed." in process.output
    metrics = json.loads((old / "metrics.json").read_text())
    assert metrics["pass"] is True
    assert metrics["jump_height_m"] == pytest.approx(0.3084, abs=5e-4)
    names = {path.name for path in old.iterdir()}
    assert {"bag", "metrics.json", "report.html", "animation.gif"} <= names
    assert "of_before" not in names
    assert [path.name for path in old.parent.iterdir()] == ["demo"]
    assert process.has_group_exited()


@pytest.mark.ros
@pytest.mark.process
@pytest.mark.usefixtures("compiled")
@pytest.mark.parametrize(
    ("number", "begun"),
    [
        (signal.SIGINT, ".shown.*"),
        (signal.SIGINT, ".shown.*/bag/*.mcap"),
        (signal.SIGTERM, ".shown.*/bag/*.mcap"),
        (signal.SIGINT, ".shown.*/bag/metadata.yaml"),
    ],
)
def test_stopped_at_any_time_it_leaves_nothing_running_and_nothing_half_done(
    tmp_path: Path, number: signal.Signals, begun: str
):
    process = run_demo(tmp_path, "jump", "--out", "shown")
    folder = tmp_path / "shown"

    for _ in range(600):
        if any(tmp_path.glob(begun)):
            break
        assert process.is_running, process.output
        try:
            process.wait(0.1)
        except AssertionError:
            continue
    process.send(number)
    process.send(number)
    assert process.wait() == 130
    assert "all processes have ended" in process.output
    assert not folder.exists()
    assert list(tmp_path.iterdir()) == []
    assert processes_in(tmp_path) == []


def processes_in(folder: Path) -> list[str]:
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            if (entry / "cwd").readlink().is_relative_to(folder):
                found.append((entry / "cmdline").read_text())
        except OSError:
            continue
    return found


def test_a_folder_that_is_not_a_demo_is_not_overwritten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "letters").write_text("dear")
    assert main(["demo", "--out", str(tmp_path)]) == 2
    assert "choose another folder" in capsys.readouterr().err
    assert (tmp_path / "letters").read_text() == "dear"


def test_a_place_that_cannot_be_written_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "file").write_text("")
    assert main(["demo", "--out", str(tmp_path / "file" / "demo")]) == 2
    assert "cannot write" in capsys.readouterr().err


def test_a_real_time_factor_out_of_range_is_refused():
    with pytest.raises(SystemExit) as ended:
        main(["demo", "jump", "--real-time-factor", "0"])
    assert ended.value.code == 2
