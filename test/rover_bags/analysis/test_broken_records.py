"""Analysis of bags whose record pauses, restarts or lacks messages."""

import dataclasses
import struct
from pathlib import Path

import numpy as np
import pytest
from contract_bag import MadeUp, Parabola, ns
from made_up_mission import SHORT, SLIP, Leg, mission

from msg_schemas import topics
from msg_schemas.events import SimulationEvent
from msg_schemas.samples import ClockSample, Level, Status, StatusSample
from rover_bags.analysis.activities import path_length
from rover_bags.analysis.metrics import Metrics, measure
from rover_bags.analysis.timeline import TimelineEventKind
from rover_bags.reading.read import read_bag
from rover_bags.views.bag_analysis import analyse_bag

LENGTH = sum(leg.duration for leg in SHORT)


def measured(made: MadeUp, folder: Path) -> Metrics:
    folder.mkdir(exist_ok=True)
    return measure(read_bag(made.write(folder / "bag")))


def shown(metrics: Metrics) -> list[str]:
    return [interval.activity.value for interval in metrics.timeline.intervals]


@pytest.fixture(scope="module")
def twice(tmp_path_factory: pytest.TempPathFactory) -> Metrics:
    """Two runs in one bag with a clock reset between them; the second descends more slowly."""
    made = mission(legs=SHORT)
    slower = tuple(
        dataclasses.replace(leg, rate=0.2) if leg.what == "descending" else leg for leg in SHORT
    )
    made.rows += [(row[0] + LENGTH + 3.0, *row[1:]) for row in mission(legs=slower).rows]
    return measured(made, tmp_path_factory.mktemp("twice"))


def test_each_of_two_runs_has_its_own_activities_and_events(twice: Metrics):
    words = [leg.what for leg in SHORT]
    assert shown(twice) == [*words, *words]
    kinds = [event.kind for event in twice.timeline.events]
    half = len(kinds) // 2
    assert kinds[:half] == kinds[half:]
    assert kinds.count(TimelineEventKind.TOUCHDOWN) == kinds.count(TimelineEventKind.LANDING) == 2
    assert [d.rate_m_s for d in twice.descents] == pytest.approx([0.25, 0.2], rel=0.01)
    assert len(twice.jumps) == 2
    assert len(twice.traverses) == 2
    for traverse in twice.traverses:
        assert traverse.path_m == pytest.approx((1.0 - SLIP) * 0.6, rel=0.02)


def test_each_of_two_runs_has_its_own_energy_balance(twice: Metrics):
    energy = twice.audits.energy
    assert energy is not None
    assert energy.turnover_J == pytest.approx(2 * 3.5 * LENGTH, rel=0.01)
    assert energy.residual_J == pytest.approx(1e-6 * LENGTH, rel=0.01)
    assert len(energy.intervals) == 2 * len(SHORT)
    first, second = energy.intervals[: len(SHORT)], energy.intervals[len(SHORT) :]
    for one, other in zip(first, second, strict=True):
        assert one.input_J == pytest.approx(2.0 * (one.end_s - one.begin_s), rel=1e-6)
        assert other.input_J == pytest.approx(one.input_J, rel=1e-6)


def restamped(data: bytes, by: float) -> bytes:
    """A message whose header or clock is later by some time [s]."""
    seconds, rest = struct.unpack_from("<iI", data, 4)
    stamp = divmod(seconds * 10**9 + rest + ns(by), 10**9)
    return data[:4] + struct.pack("<iI", *stamp) + data[12:]


def two_runs(first: tuple[Leg, ...], second: tuple[Leg, ...], *, clock: bool) -> MadeUp:
    """A reset of clock and plant, or of the plant alone, between two runs."""
    made = mission(legs=first)
    end = sum(leg.duration for leg in first)
    made.rows += [
        (time + end, name, data if clock else restamped(data, end))
        for time, name, data in mission(legs=second).rows
        if name != topics.CONFIG
    ]
    if not clock:
        made.event(end - 0.01, SimulationEvent.PLANT_RESET, "reset the plant", {})
    return made


@pytest.mark.parametrize("clock", [True, False])
@pytest.mark.parametrize(
    ("first", "events"),
    [
        ((Leg("hanging", 2.0), Leg("descending", 4.0, 0.25)), []),
        ((Leg("standing", 2.0), Leg("compressing", 2.0, 0.06)), []),
        (
            (Leg("standing", 2.0), Leg("compressing", 2.0, 0.06), Leg("flight", 0.7)),
            ["latch_trip", "take_off"],
        ),
    ],
)
def test_a_reset_is_no_motion(
    first: tuple[Leg, ...], events: list[str], clock: bool, tmp_path: Path
):
    again = (Leg("hanging", 2.0), Leg("descending", 3.0, 0.25))
    found = measured(two_runs(first, again, clock=clock), tmp_path)
    assert shown(found) == [leg.what for leg in (*first, *again)]
    assert [event.kind for event in found.timeline.events] == events
    assert [jump.touchdown_s for jump in found.jumps] == [None] * events.count("take_off")
    energy = found.audits.energy
    assert energy is not None
    total = sum(leg.duration for leg in (*first, *again))
    assert energy.turnover_J == pytest.approx(3.5 * total, rel=0.02)
    assert all(each.input_J > 0.0 and each.dissipated_J > 0.0 for each in energy.intervals)


def test_rates_and_duration_include_both_runs(twice: Metrics):
    assert twice.simulated_s == pytest.approx(2 * LENGTH, abs=0.1)
    for name in (topics.CLOCK, topics.CONTACT, topics.TRUTH_BODY1):
        assert twice.topics[name].rate_hz == pytest.approx(50.0, rel=1e-3)


def test_events_belong_to_their_own_run(tmp_path: Path):
    made = MadeUp()
    jump = Parabola()
    for offset, height in ((0.0, 0.25), (5.0, 0.5)):
        made.jumps([jump], until=1.8, offset=offset)
        landing = jump.take_off + jump.flight_time
        made.event(landing, "touchdown", "down", {"height": str(height)})
        row = made.rows.pop()
        made.rows.append((row[0] + offset, *row[1:]))
    found = measured(made, tmp_path).jumps
    assert [jump.reported for jump in found] == [{"height": 0.25}, {"height": 0.5}]


def test_what_a_reset_publishes_without_a_stamp_is_of_the_new_run(tmp_path: Path):
    made = MadeUp()
    for number in range(10):
        made.add(0.1 * number, topics.CLOCK, ClockSample(ns(10.0 + 0.1 * number)))
        made.add(2.0 + 0.1 * number, topics.CLOCK, ClockSample(ns(0.1 * number)))
    reset = Status(SimulationEvent.RESET, "reset", Level.OK, "sim_node")
    made.add(1.5, topics.EVENTS, StatusSample(0, (reset,)))
    (entry,) = measured(made, tmp_path).events
    assert entry.time_s == 0.0


@pytest.mark.parametrize("max_messages", [1 << 15, 50])
def test_drawings_show_the_run_of_their_jump(max_messages: int, tmp_path: Path):
    made = MadeUp()
    for offset, up in ((0.0, 1.0), (5.0, 2.0)):
        made.jumps([Parabola(up=up)], until=1.8, offset=offset)
    found = analyse_bag(made.write(tmp_path / "bag"), max_messages=max_messages)
    assert found.drawings is not None
    for jump, scene in zip(found.metrics.jumps, found.drawings.scenes, strict=True):
        assert scene is not None
        assert float(np.max(scene.readout)) == pytest.approx(jump.jump_height_m, rel=0.02)
    first, second = (plots[0].svg for plots in found.drawings.plots)
    assert first != second


@pytest.mark.parametrize("by_time", [True, False])
def test_recordings_in_one_folder_are_read_as_one(by_time: bool, tmp_path: Path):
    """The later one has the earlier name, or both are of the same time."""
    made, folder = mission(legs=SHORT), tmp_path / "bag"
    whole = measured(made, tmp_path / "whole")
    folder.mkdir()
    for name, is_first in (("b", True), ("a", False)):
        part = MadeUp()
        part.rows = [
            row for row in made.rows
            if (row[0] < 7.0 if by_time else row[1].startswith("truth/")) == is_first
        ]  # fmt: skip
        part.write(tmp_path / name).joinpath(f"{name}_0.mcap").rename(folder / f"{name}_0.mcap")
    found = measure(read_bag(folder))
    assert found.timeline == whole.timeline
    assert found.descents == whole.descents
    assert found.jumps == whole.jumps


def test_a_pause_of_the_record_ends_the_activity(tmp_path: Path):
    legs = (Leg("hanging", 3.0), Leg("descending", 5.0, 0.2), Leg("standing", 6.0))
    made = mission(legs=legs)
    made.rows = [row for row in made.rows if not 5.0 < row[0] < 10.0]
    found = measured(made, tmp_path)
    assert shown(found) == ["hanging", "descending", "standing"]
    assert found.timeline.intervals[1].end_s == pytest.approx(5.0, abs=0.05)
    assert found.timeline.intervals[2].begin_s == pytest.approx(10.0, abs=0.05)
    assert found.timeline.events == ()  # the touchdown lies in the pause


def test_a_timed_out_sensor_ends_the_activity(tmp_path: Path):
    legs = (Leg("standing", 2.0), Leg("driving", 3.0, 2.0), Leg("standing", 10.0))
    made = mission(legs=legs)
    made.rows = [row for row in made.rows if row[1] != topics.WHEEL_STATE or row[0] < 4.0]
    (drive,) = measured(made, tmp_path).drives
    assert drive.end_s <= 5.1


def test_a_missing_sample_of_one_body_changes_no_momentum(tmp_path: Path):
    made = mission(legs=(Leg("standing", 2.0), Leg("compressing", 2.0, 0.06), Leg("flight", 1.2),
                         Leg("standing", 2.0)))  # fmt: skip
    made.rows = [
        row for row in made.rows if row[1] != topics.TRUTH_BODY2 or not 4.5 < row[0] < 4.53
    ]
    (flight,) = measured(made, tmp_path).audits.flights
    assert flight.momentum_change_N_s < 1e-9


def test_a_brake_is_judged_by_simulated_time(tmp_path: Path):
    legs = (Leg("hanging", 1.0), Leg("descending", 9.0, 0.3), Leg("hanging", 3.0))
    made = mission(legs=legs)
    # The run was fifty times faster than real time; the brake closed long after the drum stopped.
    made.rows = [(row[0] / 50.0, *row[1:]) for row in made.rows]
    found = measured(made, tmp_path)
    assert "descending" in shown(found)
    assert [m for m in found.timeline.events if m.kind is TimelineEventKind.FAULT] == []


def test_a_path_up_a_slope_is_longer_than_its_projection():
    time = np.linspace(0.0, 5.0, 251)
    path = np.stack([0.3 * time, np.zeros_like(time), 0.4 * time], axis=1)
    assert path_length(time, path) == pytest.approx(2.5)
