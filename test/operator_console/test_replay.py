"""A bag as frames of the page, with ages, journal and remarks."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import zstandard
from contract_bag import MadeUp, Parabola, ns, odometry

from msg_schemas import topics
from msg_schemas.health import Health
from msg_schemas.phases import HealthState, JumpPhase
from msg_schemas.samples import ClockSample, StatusSample, TextSample
from msg_schemas.table import TOPICS
from operator_console.bag_shelf import BagShelf, ShelfError
from operator_console.liveness import SILENT_AFTER
from operator_console.replay import read_replay, read_state, sample_at
from rover_bags.reading.read import read_bag

JUMP = Parabola()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = MadeUp()
    made.jumps([JUMP], until=3.0, rate=50.0)
    made.add(1.5, topics.JUMP_PHASE, TextSample(JumpPhase.FLIGHT))
    made.event(2.0, "landed", "it stands", {})
    made.refusal(2.5, topics.JUMP_REQUEST, "jump_stroke.position is nan")
    where = tmp_path_factory.mktemp("bags")
    made.write(where / "jump")
    (where / "notes.txt").write_text("no bag", encoding="utf-8")
    return where


def test_frames_show_the_bag_s_values_at_their_times(folder: Path):
    replay = read_replay(folder / "jump")
    times = [made["time"] for made in replay.frames]
    assert times == sorted(times)
    assert times[1] - times[0] == pytest.approx(0.1)
    assert times[-1] - times[0] == pytest.approx(3.0, abs=0.21)
    for made in replay.frames[1:]:
        x, _, z, *_ = made["geometry"]["body1"]
        (px, pz, _), _ = JUMP.at(made["time"] - made["geometry"]["age"])
        assert (x, z) == pytest.approx((px, pz), abs=0.1)
        assert made["geometry"]["source"] == "simulation"
        tension = made["values"]["tension"]
        assert tension[0] == pytest.approx(5.0)
        assert not tension[2]


def test_the_state_at_a_time_is_the_last_received_until_then(folder: Path):
    early, late = (read_state(folder / "jump", at) for at in (1.0, 2.2))
    assert (early.reading("jump").value, late.reading("jump").value) == (None, JumpPhase.FLIGHT)
    assert [event.name for event in late.events] == ["landed"]
    assert not early.events
    at_the_end = read_state(folder / "jump")
    assert len(at_the_end.refusals) == 1
    assert at_the_end.reading("tension").value == pytest.approx(5.0)
    assert not at_the_end.reading("tension").is_stale


def test_a_state_before_the_bag_is_refused(folder: Path):
    with pytest.raises(ValueError, match=r"begins at .* s, after -1 s"):
        read_state(folder / "jump", -1.0)


def test_phases_events_and_refusals_appear_at_their_times(folder: Path):
    replay = read_replay(folder / "jump")
    times = [made["time"] for made in replay.frames if made["phases"]["jump"][0] == "flight"]
    assert times[0] == pytest.approx(1.5, abs=0.11)
    by_title = {entry["title"]: entry for entry in replay.journal}
    assert by_title["landed"]["time"] == pytest.approx(2.0, abs=0.01)
    refusal = by_title[f"refused {topics.JUMP_REQUEST}"]
    assert refusal["time"] == pytest.approx(2.5, abs=0.01)
    assert refusal["text"] == "jump_stroke.position is nan [not_finite]"


def test_without_a_clock_events_are_at_the_times_of_the_stamps(tmp_path: Path):
    made, since = MadeUp(), 2e6
    for step in range(20):
        sample = odometry(since + 0.1 * step, np.zeros(3), np.zeros(3))
        made.add(0.1 * step, topics.TRUTH_BODY1, sample)
    made.event(1.0, "landed", "it stands", {})
    replay = read_replay(made.write(tmp_path / "bag"))
    assert len(replay.frames) <= 21
    assert replay.journal[0]["time"] == pytest.approx(since + 1.0)


@pytest.mark.parametrize("pace", [5.0, 0.2])
def test_a_node_is_silent_by_the_recorder_s_time_whatever_the_pace(tmp_path: Path, pace: float):
    made, killed = MadeUp(), 4.5
    for received in np.arange(0.0, 10.0, 0.05):
        made.add(received, topics.CLOCK, ClockSample(ns(pace * received)))
    for received in np.arange(0.3, 10.0, 1.0):
        nodes = ("winch_node", "drive_node") if received < killed else ("winch_node",)
        statuses = tuple(Health(node, HealthState.READY).status({}) for node in nodes)
        made.add(received, topics.DIAGNOSTICS, StatusSample(ns(pace * received), statuses))
    bag = made.write(tmp_path / "bag")
    silent: dict[str, list[float]] = {"winch_node": [], "drive_node": []}
    parts: list[dict[str, str]] = []
    for shown in read_replay(bag).frames:
        parts = shown.get("parts", parts)
        for part in parts:
            if part["level"] == "stale":
                silent[part["name"]].append(shown["time"])
    assert silent["winch_node"] == []
    assert silent["drive_node"][0] == pytest.approx(
        pace * (4.3 + SILENT_AFTER), abs=0.11 + pace / 20
    )
    for received, is_silent in ((7.2, False), (7.4, True)):
        nodes_then = read_state(bag, pace * received).nodes
        assert [each.is_silent for each in nodes_then] == [is_silent, False]


def test_a_long_bag_is_replayed_with_fewer_frames_and_a_remark(folder: Path):
    replay = read_replay(folder / "jump", most_frames=11)
    assert len(replay.frames) in {10, 11, 12}
    assert any("one frame per 0.3 s" in remark for remark in replay.remarks)


def test_a_truncated_bag_has_a_remark(folder: Path, tmp_path: Path):
    made = MadeUp()
    made.jumps([JUMP], until=2.0, rate=20.0)
    replay = read_replay(made.write(tmp_path / "cut", close=False))
    assert any("did not close" in remark for remark in replay.remarks)
    assert replay.frames


def test_samples_are_restored(folder: Path):
    bag = read_bag(folder / "jump")
    for name, series in bag.time_series.items():
        if name != topics.PLACE:
            assert isinstance(sample_at(series, len(series) - 1), TOPICS[name].sample)


def test_only_what_is_listed_can_be_replayed(folder: Path):
    shelf = BagShelf(folder)
    (listed,) = shelf.listed()
    assert listed["name"] == "jump"
    assert listed["size"] > 1000
    content = json.loads(shelf.replay("jump"))
    assert content["name"] == "jump"
    assert content["machine"]["scenario"] == "made up"
    for name in ("../jump", "notes.txt", "", "..", "jump/..", str(folder / "jump"), "other"):
        with pytest.raises(ShelfError, match="there is no bag"):
            shelf.replay(name)
    assert BagShelf(None).listed() == []


def test_another_bag_of_the_same_name_and_size_is_read(folder: Path, tmp_path: Path):
    shutil.copytree(folder / "jump", tmp_path / "jump")
    shelf = BagShelf(tmp_path)
    assert shelf.replay("jump")
    file = tmp_path / "jump" / "jump_0.mcap"
    file.write_bytes(bytes(file.stat().st_size))
    with pytest.raises(ShelfError, match="jump: "):
        shelf.replay("jump")


def test_a_compressed_bag_is_listed(folder: Path, tmp_path: Path):
    (tmp_path / "bag").mkdir()
    data = zstandard.compress((folder / "jump" / "jump_0.mcap").read_bytes())
    for name in ("bag/bag_0.mcap.zstd", "alone.mcap.zstd"):
        (tmp_path / name).write_bytes(data)
    shelf = BagShelf(tmp_path)
    assert {each["name"] for each in shelf.listed()} == {"bag", "alone.mcap.zstd"}
    assert json.loads(shelf.replay("bag"))["frames"]


def test_an_unreadable_bag_is_reported(tmp_path: Path):
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "broken_0.mcap").write_bytes(b"nothing of the kind")
    with pytest.raises(ShelfError, match="broken: "):
        BagShelf(tmp_path).replay("broken")
