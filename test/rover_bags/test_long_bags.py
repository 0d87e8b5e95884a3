"""Long bags: block decoding, thinned time series, windows read again."""

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
from contract_bag import MadeUp, Parabola, ns
from made_up_mission import SHORT, write_mission
from mcap.reader import make_reader

from msg_schemas import machine, topics
from msg_schemas.cdr import pack
from msg_schemas.samples import JointSample, JointValue, TetherSample, TextSample
from msg_schemas.table import TOPICS
from rover_bags.analysis.metrics import measure
from rover_bags.files.scan import BagScan
from rover_bags.reading import time_series
from rover_bags.reading.read import Bag, read_bag, received_messages, windows
from rover_bags.reading.time_series import LARGEST
from rover_bags.views.bag_analysis import analyse_bag
from rover_bags.views.summary import data_warnings
from rover_cli.command_line import main


@pytest.fixture(scope="module")
def jumps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = MadeUp()
    second = Parabola(take_off=2.0, up=1.0, forward=-0.2, turning=0.3, start=Parabola().landing)
    made.jumps([Parabola(), second], until=2.8)
    return made.write(tmp_path_factory.mktemp("jumps") / "bag")


@pytest.fixture(scope="module")
def mission(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_mission(tmp_path_factory.mktemp("mission") / "bag", legs=SHORT)


@pytest.mark.parametrize("bag", ["jumps", "mission"])
def test_block_extraction_agrees_with_the_decoder(bag: str, request: pytest.FixtureRequest):
    path = request.getfixturevalue(bag)
    read = read_bag(path)
    place = dict.fromkeys(read.time_series, 0)
    for message in received_messages(BagScan(path)):
        series, index = read.time_series[message.name], place[message.name]
        place[message.name] += 1
        assert series.log_ns[index] == message.log_ns
        assert series.publish_ns[index] == message.publish_ns
        if isinstance(message.sample, TetherSample):
            np.testing.assert_array_equal(series.shapes[index], message.sample.nodes)
            assert series.columns[LARGEST][index] == message.sample.nodes[:, 6].max()
        elif isinstance(message.sample, TextSample):
            assert series.texts[index] == message.sample.text
        else:
            for column, value in message.sample.scalars():
                assert series.columns[column][index] == value
    assert all(place[name] == len(series) for name, series in read.time_series.items())


def test_only_the_invalid_message_of_a_block_is_rejected(tmp_path: Path):
    made = MadeUp()
    good = JointSample(ns(0.2), {machine.JUMP_SCREW: JointValue(0.1, 0.1, 10.0)})
    data = pack(topics.JUMP_MOTOR_COMMAND, good)
    number = data.index(np.float64(10.0).tobytes())
    invalid = {
        3: data[:number] + np.float64(math.inf).tobytes() + data[number + 8 :],
        7: data.replace(machine.JUMP_SCREW.encode(), machine.JUMP_SCREW.upper().encode()),
        8: data[:number] + np.float64(-5.0).tobytes() + data[number + 8 :],
    }
    for index in range(20):
        made.add_raw(0.1 * index, topics.JUMP_MOTOR_COMMAND, invalid.get(index, data))
    bag = read_bag(made.write(tmp_path / "bag"))
    assert len(bag.time_series[topics.JUMP_MOTOR_COMMAND]) == 17
    assert bag.rejected == {topics.JUMP_MOTOR_COMMAND: 3}
    reasons = " ".join(item.reason for item in bag.rejected_examples)
    assert "finite" in reasons
    assert "JUMP_SCREW" in reasons
    assert "-5.0" in reasons


def assert_same_metrics(full: Bag, thin: Bag) -> None:
    before, after = measure(full).topics, measure(thin).topics
    for name, row in before.items():
        for field in ("count", "rate_hz", "wall_rate_hz", "max_gap_s", "max_gap_at_s", "gaps",
                      "latency_max_ms", "rejected"):  # fmt: skip
            assert getattr(after[name], field) == pytest.approx(getattr(row, field)), (name, field)


def test_thinned_time_series_keep_extremes_and_topic_metrics(mission: Path):
    full, thin = read_bag(mission), read_bag(mission, max_messages=100)
    assert thin.thinned
    assert not full.thinned
    assert_same_metrics(full, thin)
    for name in (topics.TRUTH_BODY1, topics.LOAD_CELL, topics.TRUTH_ENERGY):
        a, b = full.time_series[name], thin.time_series[name]
        assert len(b) <= 200
        assert len(b) == math.ceil(len(a) / b.stride)
        np.testing.assert_array_equal(b.time, a.time[:: b.stride])
        for path in a.columns:
            np.testing.assert_array_equal(b.columns[path], a.columns[path][:: b.stride])
            low = np.minimum.reduceat(a.columns[path], np.arange(0, len(a), b.stride))
            high = np.maximum.reduceat(a.columns[path], np.arange(0, len(a), b.stride))
            np.testing.assert_array_equal(b.lowest(path), low)
            np.testing.assert_array_equal(b.highest(path), high)


def test_events_beyond_those_that_are_held_are_reported_as_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(time_series, "_MAX_STATUSES", 3)
    made = MadeUp()
    for number in range(5):
        made.event(0.1 * number, "touchdown", "down", {})
    bag = read_bag(made.write(tmp_path / "bag"), max_messages=1000)
    assert "events: only the first 3 of 5 messages are reported" in data_warnings(bag, measure(bag))


def test_a_window_read_again_holds_every_message(mission: Path):
    full, thin = read_bag(mission), read_bag(mission, max_messages=100)
    body = full.time_series[topics.TRUTH_BODY1]
    spans = [(int(body.log_ns[a]), int(body.log_ns[b])) for a, b in ((100, 300), (250, 500))]
    parts = list(windows(thin, spans, [topics.TRUTH_BODY1]))
    assert len(parts) == 2
    for part, (begin, end) in zip(parts, spans, strict=True):
        inside = (body.log_ns >= begin) & (body.log_ns <= end)
        series = part.time_series[topics.TRUTH_BODY1]
        np.testing.assert_array_equal(series.time, body.time[inside])
        np.testing.assert_array_equal(
            series.columns["position.z"], body.columns["position.z"][inside]
        )


def test_a_window_after_the_last_message_is_empty(mission: Path):
    thin = read_bag(mission, max_messages=100)
    after = int(thin.time_series[topics.TRUTH_BODY1].log_ns[-1]) + 10_000_000_000
    spans = [(after, after + 1), (after + 2, after + 3)]
    parts = list(windows(thin, spans, [topics.TRUTH_BODY1]))
    assert [part.time_series == thin.time_series for part in parts] == [True, True]


def test_a_scan_within_a_time_yields_its_messages_alone(mission: Path):
    every = [(each.topic.name, each.log_ns) for each in BagScan(mission)]
    within = every[len(every) // 3][1], every[len(every) // 2][1]
    found = [(each.topic.name, each.log_ns) for each in BagScan(mission, within)]
    assert found == [each for each in every if within[0] <= each[1] <= within[1]]
    assert 0 < len(found) < len(every)


def test_a_scan_within_a_time_reads_only_the_chunks_of_that_time(mission: Path, tmp_path: Path):
    (name,) = mission.glob("*.mcap")
    contents = bytearray(name.read_bytes())
    with name.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    first, *later = sorted(summary.chunk_indexes, key=lambda each: each.message_start_time)
    assert later
    within = first.message_start_time, first.message_end_time
    for chunk in later:
        if chunk.message_start_time > within[1]:
            contents[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 1
    (tmp_path / "bag.mcap").write_bytes(contents)
    scan = BagScan(tmp_path / "bag.mcap", within)
    assert [each.log_ns for each in scan] == [each.log_ns for each in BagScan(mission, within)]
    assert scan.damage == []
    whole = BagScan(tmp_path / "bag.mcap")
    assert 0 < sum(1 for _ in whole) < sum(1 for _ in BagScan(mission))
    assert whole.damage


@pytest.mark.parametrize("bag", ["jumps", "mission"])
def test_jumps_of_a_thinned_bag_are_measured_in_full(bag: str, request: pytest.FixtureRequest):
    path = request.getfixturevalue(bag)
    full = analyse_bag(path, with_drawings=False).metrics
    found = analyse_bag(path, with_drawings=False, max_messages=40)
    assert found.bag.thinned
    assert len(found.metrics.jumps) == len(full.jumps)
    for thin, whole in zip(found.metrics.jumps, full.jumps, strict=True):
        for name, value in dataclasses.asdict(whole).items():
            if isinstance(value, float):
                assert getattr(thin, name) == pytest.approx(value, abs=1e-9), name
    assert [p.activity for p in found.metrics.timeline.intervals] == [
        p.activity for p in full.timeline.intervals
    ]


def test_each_pass_shows_its_progress(jumps: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["bag", "report", str(jumps), "--json"]) == 0
    shown = capsys.readouterr()
    assert "reading" in shown.err
    assert "100%" in shown.err
    assert json.loads(shown.out)["jumps"]
    assert main(["bag", "report", str(jumps), "--json", "--quiet"]) == 0
    assert capsys.readouterr().err == ""


def test_every_fast_topic_has_a_layout(mission: Path):
    names = {name for name, row in TOPICS.items() if row.rate == 100.0}
    assert len(names & set(read_bag(mission).time_series)) >= 8
