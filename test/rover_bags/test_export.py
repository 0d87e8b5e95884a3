"""`mother_rover bag export`, and time series as tables."""

import csv
import errno
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from contract_bag import MadeUp, Parabola, ns, tether

from msg_schemas import topics
from msg_schemas.samples import ImuSample
from msg_schemas.table import TOPICS
from rover_bags.reading.read import TimeSeries, portions, read_bag
from rover_bags.views import export
from rover_cli.command_line import main


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of a jump; the tether gets another node on the way."""
    made = MadeUp()
    made.jumps([Parabola()], until=1.8)
    for index in range(40):
        time = 1.8 + 0.02 * index
        made.add(time, topics.TRUTH_TETHER, tether(time, (1.0, 2.0), 5.0, nodes=6 + index // 20))
        force = (0.1 * index, 0.0, 1.62)
        made.add(time, topics.IMU, ImuSample(ns(time), (0.01, 0.0, index * 1e-3), force))
    made.event(1.9, "touchdown", "touchdown at 0.4 m/s", {"speed": "0.4"})
    made.event(2.0, "take_off", "the rover takes off", {})
    return made.write(tmp_path_factory.mktemp("run") / "bag")


def test_each_topic_becomes_a_parquet_file_with_units(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(export, "_PORTION", 30)  # a file of several portions
    out = tmp_path / "out"
    assert main(["bag", "export", str(run), "--out", str(out), "--quiet"]) == 0
    bag = read_bag(run)
    files = {file.relative_to(out).with_suffix("").as_posix() for file in out.rglob("*.parquet")}
    assert files == {name.strip("/") for name in bag.time_series}
    for name, series in bag.time_series.items():
        table = pq.read_table(out / f"{name.strip('/')}.parquet")
        units = {each.path: each.unit for each in TOPICS[name].fields}
        for path, values in series.columns.items():
            if path in units:
                assert table.schema.field(path).metadata[b"unit"].decode() == units[path]
            np.testing.assert_array_equal(table.column(path).to_numpy(), values)
        if not series.statuses:
            assert table.column("log_ns").to_pylist() == series.log_ns.tolist()
            np.testing.assert_allclose(table.column("time").to_numpy(), series.time, atol=1e-9)
    tether = pq.read_table(out / "truth" / "tether.parquet")
    shapes = bag.time_series[topics.TRUTH_TETHER].shapes
    assert tether.column("nodes.z").to_pylist() == [shape[:, 2].tolist() for shape in shapes]
    assert tether.schema.field("nodes.tension").metadata[b"unit"] == b"N"


def test_a_topic_that_the_bag_lacks_is_stated(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    out = tmp_path / "out"
    given = ["--out", str(out), "--quiet"]
    lacking = f"bag holds no valid message of {topics.TRUTH_STATE}\n"
    assert main(["bag", "export", str(run), topics.TRUTH_STATE, *given]) == 2
    assert capsys.readouterr().err.endswith(lacking)
    assert not out.exists()
    assert main(["bag", "export", str(run), topics.TRUTH_STATE, topics.IMU, *given]) == 0
    assert capsys.readouterr().err.endswith(lacking)
    assert [each.name for each in out.iterdir()] == ["sensors"]


def test_a_topic_as_csv_has_the_same_numbers_and_its_units_beside(run: Path, tmp_path: Path):
    out = tmp_path / "out"
    names = [f"/{topics.IMU}", topics.TRUTH_TETHER, topics.CLOCK]
    arguments = ["bag", "export", str(run), *names, "--format", "csv"]
    assert main([*arguments, "--out", str(out), "--quiet"]) == 0
    series = read_bag(run).time_series[topics.IMU]
    with (out / "sensors" / "imu.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["linear_acceleration.z"]) for row in rows] == pytest.approx(
        series.columns["linear_acceleration.z"].tolist(), rel=1e-14
    )
    with (out / "truth" / "tether.csv").open() as file:
        row = next(csv.DictReader(file))
    assert len(row["nodes.x"].split()) == len(row["nodes.tension"].split()) > 1
    units = json.loads((out / export.UNITS_FILE).read_text())
    assert units[topics.IMU]["linear_acceleration.z"] == "m/s^2"
    assert set(units) == {topics.IMU, topics.TRUTH_TETHER, topics.CLOCK}


def test_each_status_is_a_row(run: Path, tmp_path: Path):
    assert main(["bag", "export", str(run), "events", "-o", str(tmp_path / "out"), "--quiet"]) == 0
    rows = pq.read_table(tmp_path / "out" / "events.parquet").to_pylist()
    series = read_bag(run).time_series[topics.EVENTS]
    statuses = [status for each in series.statuses for status in each]
    assert [row["name"] for row in rows] == [status.name for status in statuses]
    assert [json.loads(row["values"]) for row in rows] == [dict(each.values) for each in statuses]
    assert {row["level"] for row in rows} <= {"OK", "WARN", "ERROR", "STALE"}


def test_portions_hold_every_message_once(run: Path):
    bag = read_bag(run, max_messages=50)
    found: dict[str, list[int]] = {}
    for portion in portions(bag, bag.time_series, 30):
        assert len(portion) <= 30
        found.setdefault(portion.topic, []).extend(portion.log_ns.tolist())
    whole = read_bag(run).time_series
    assert found == {name: series.log_ns.tolist() for name, series in whole.items()}


def test_a_time_series_is_a_data_frame_with_units(run: Path):
    pytest.importorskip("pandas")
    series = read_bag(run).time_series[topics.IMU]
    frame = series.to_pandas()
    assert len(frame) == len(series)
    column = "linear_acceleration.x"
    assert frame[column].to_numpy() == pytest.approx(series.columns[column])
    assert frame.attrs["units"][column] == "m/s^2"


@pytest.mark.parametrize(
    ("arguments", "code", "complaint"),
    [
        (["{bag}", "sensors/imo"], 2, "sensors/imo: no topic of the contract"),
        (["{bag}x"], 2, "bagx"),
        (["{bag}", "--out", "{full}"], 3, "it holds files; give a new or empty folder"),
        (["{bag}", "--out", "{full}/kept.txt"], 3, "it exists and is never overwritten"),
        (["{bag}", "--out", "{full}/kept.txt/x"], 3, "a part of its path is a file"),
    ],
)
def test_bad_arguments_are_refused(
    run: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    code: int,
    complaint: str,
):
    (tmp_path / "kept.txt").write_text("mine")
    words = [each.format(bag=run, full=tmp_path) for each in arguments]
    assert main(["bag", "export", *words, "--quiet"]) == code
    captured = capsys.readouterr()
    assert complaint in captured.err
    assert "Errno" not in captured.err
    assert captured.out == ""
    assert [file.name for file in tmp_path.iterdir()] == ["kept.txt"]


@pytest.mark.parametrize("stop", [KeyboardInterrupt, OSError(errno.ENOSPC, "no space")])
def test_an_export_that_does_not_end_leaves_nothing(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stop: BaseException
):
    (tmp_path / "empty").mkdir()

    def fail(*_: object, **__: object) -> Iterator[TimeSeries]:
        yield next(portions(bag, bag.time_series, 30))
        raise stop

    bag = read_bag(run, max_messages=50)
    monkeypatch.setattr("rover_bags.views.export.portions", fail)
    for folder in ("new", "empty"):
        with pytest.raises(type(stop) if isinstance(stop, OSError) else KeyboardInterrupt):
            export.export(bag, tmp_path / folder)
    assert [each.name for each in tmp_path.rglob("*")] == ["empty"]
