"""Metrics of synthetic bags against closed forms."""

import dataclasses
import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from contract_bag import EPOCH_NS, LATENCY_NS, STORE, MadeUp, Parabola, ns, odometry

from msg_schemas import machine, topics
from msg_schemas.cdr import pack
from msg_schemas.events import PlantEvent
from msg_schemas.samples import (
    ClockSample,
    JointSample,
    JointValue,
    Status,
    StatusSample,
    TextSample,
)
from msg_schemas.table import TOPICS
from rover_bags.analysis import jumps
from rover_bags.analysis.geometry import masses_of
from rover_bags.analysis.metrics import Metrics, measure
from rover_bags.files.folder import ScanError
from rover_bags.files.store import BagWriter, standard_type
from rover_bags.reading.read import ReadError, read_bag
from rover_bags.views.summary import data_warnings


def measured(made: MadeUp, path: Path, **options: object) -> Metrics:
    return measure(read_bag(made.write(path / "bag", **options)))  # type: ignore[arg-type]


def assert_is(found: jumps.RecordedJump, jump: Parabola, tolerance: float = 1e-9) -> None:
    assert found.take_off_s == pytest.approx(jump.take_off, abs=tolerance)
    assert found.apex_s == pytest.approx(jump.take_off + jump.up / 9.81, abs=1e-6)
    assert found.touchdown_s == pytest.approx(jump.take_off + jump.flight_time, abs=tolerance)
    assert found.jump_height_m == pytest.approx(jump.height, abs=tolerance)
    assert found.flight_time_s == pytest.approx(jump.flight_time, abs=2 * tolerance)
    assert found.travel_m == pytest.approx(jump.forward * jump.flight_time, abs=tolerance)
    turned = jump.turning * jump.flight_time
    assert found.attitude_variation_rad == pytest.approx(turned, abs=tolerance)


SIGNS = (topics.TRUTH_PHASE, topics.CONTACT)


@pytest.mark.parametrize(
    ("without", "held"),
    [((), True), ((), False), (SIGNS[:1], True), (SIGNS, True), (SIGNS, False)],
    ids=["phase", "phase, flies on", "contact", "motion", "motion, flies on"],
)
def test_a_parabola_gives_its_closed_form(tmp_path: Path, without: tuple[str, ...], held: bool):
    jump = Parabola()
    made = MadeUp()
    made.jumps([jump], until=1.8, held=held, without=without)
    found = measured(made, tmp_path).jumps
    assert len(found) == 1
    assert_is(found[0], jump)


def test_a_jump_backward_and_downward_has_negative_signs(tmp_path: Path):
    jump = Parabola(forward=-0.7, turning=-4.0, start=(1.0, 3.0, -0.5))
    made = MadeUp()
    made.jumps([jump], until=1.8)
    found = measured(made, tmp_path).jumps
    assert_is(found[0], jump)
    assert found[0].travel_m < 0.0
    assert found[0].attitude_variation_rad < 0.0


def test_turns_beyond_half_a_revolution_are_counted(tmp_path: Path):
    jump = Parabola(turning=15.0)
    made = MadeUp()
    made.jumps([jump], until=1.8)
    assert measured(made, tmp_path).jumps[0].attitude_variation_rad == pytest.approx(
        15.0 * jump.flight_time
    )


def test_a_jump_straight_up_without_turning_is_one_flight(tmp_path: Path):
    jump = Parabola(forward=0.0, turning=0.0, up=9.81 * 0.2, take_off=1.0)
    made = MadeUp()
    made.jumps([jump], until=1.8, without=SIGNS)
    found = measured(made, tmp_path).jumps
    assert len(found) == 1
    assert_is(found[0], jump)


def test_several_jumps_are_measured_separately(tmp_path: Path):
    first = Parabola()
    second = Parabola(take_off=2.0, up=1.0, forward=-0.2, turning=0.3, start=Parabola().landing)
    made = MadeUp()
    made.jumps([first, second], until=3.0)
    found = measured(made, tmp_path)
    assert len(found.jumps) == 2
    for row, jump in zip(found.jumps, (first, second), strict=True):
        assert_is(row, jump)
    assert found.to_mapping()["jump_height_m"] == found.jumps[0].jump_height_m


def test_slack_tension_and_residual_are_of_the_flight(tmp_path: Path):
    jump = Parabola()
    made = MadeUp()
    made.jumps([jump], until=1.8)
    found = measured(made, tmp_path).jumps[0]
    assert found.slack == pytest.approx(0.5)
    assert found.peak_tension_N == pytest.approx(7.5)
    # From the last sample before take-off to the first after touchdown.
    assert found.energy_drift_J == pytest.approx(1e-6 * (1.42 - 1.0), rel=1e-6)


def test_the_latest_sample_before_an_event_is_searched_within_its_run():
    time = np.array([0.0, 0.01, 0.02, 0.03, 0.0, 0.01, 0.02])
    places = np.zeros((7, 3))
    body = jumps.MotionSeries(time, np.arange(7), places, places, time, time)
    assert jumps.latest(body, 3, 0.018) == 1
    assert jumps.latest(body, 0, 0.02) == 2
    assert jumps.latest(body, 5, 0.005) == 4
    assert jumps.latest(body, 5, -1.0) == 4
    assert jumps.latest(body, 2, 9.0) == 3


def test_metrics_of_missing_topics_are_none(tmp_path: Path):
    made = MadeUp()
    absent = (topics.TRUTH_TETHER, topics.TRUTH_ENERGY, topics.LOAD_CELL, topics.TRUTH_BODY2)
    made.jumps([Parabola()], until=1.8, without=absent)
    found = measured(made, tmp_path).jumps[0]
    assert_is(found, Parabola())
    assert found.slack is None
    assert found.peak_tension_N is None
    assert found.energy_drift_J is None


def test_a_bag_that_ends_in_flight_has_no_touchdown(tmp_path: Path):
    made = MadeUp()
    made.jumps([Parabola()], until=1.3)
    found = measured(made, tmp_path).jumps[0]
    assert found.touchdown_s is None
    assert found.jump_height_m == pytest.approx(Parabola().height)


def test_standing_is_not_a_jump(tmp_path: Path):
    made = MadeUp()
    made.jumps([Parabola(take_off=99.0)], until=1.0)
    found = measured(made, tmp_path)
    assert found.jumps == ()
    assert found.to_mapping()["jump_height_m"] is None


def test_requests_out_of_order_are_no_reset(tmp_path: Path):
    made = MadeUp()
    made.jumps([Parabola(take_off=0.3)], until=1.2)
    for stamp in (0.4, 0.2, 0.6):
        request = JointSample(ns(stamp), {machine.WINCH_TO_LENGTH: JointValue(3.0, 0.1)})
        made.add(0.6, topics.WINCH_REQUEST, request)
    bag = read_bag(made.write(tmp_path / "bag"))
    assert bag.timings[topics.WINCH_REQUEST].restarts == 1
    assert not any("reset" in text for text in data_warnings(bag, measure(bag)))


def test_a_reset_of_simulated_time_separates_jumps(tmp_path: Path):
    jump = Parabola()
    made = MadeUp()
    made.jumps([jump], until=1.2)
    made.jumps([dataclasses.replace(jump, up=1.5)], until=1.8, offset=2.0)
    bag = read_bag(made.write(tmp_path / "bag"))
    metrics = measure(bag)
    assert any("simulated time was reset once" in text for text in data_warnings(bag, metrics))
    found = metrics.jumps
    assert [row.touchdown_s is None for row in found] == [True, False]
    assert_is(found[1], dataclasses.replace(jump, up=1.5))
    assert found[1].peak_tension_N == pytest.approx(7.5)


def test_events_of_the_plant_date_take_off_and_touchdown(tmp_path: Path):
    jump = Parabola()
    made = MadeUp()
    made.jumps([jump], until=1.8)
    made.event(jump.take_off, "take_off", "up", {})
    landing = jump.take_off + jump.flight_time
    made.event(landing, "touchdown", "down", {"height": "0.2", "why": "gravity"})
    found = measured(made, tmp_path)
    assert found.jumps[0].reported == {"height": 0.2}
    assert found.jumps[0].flight_time_s == pytest.approx(jump.flight_time, abs=1e-8)
    assert [entry.name for entry in found.events] == [PlantEvent.TAKE_OFF, PlantEvent.TOUCHDOWN]


def with_rows(path: Path, until: float, is_kept: Callable[[float, str], bool]) -> Metrics:
    """Metrics of a jump of which only some messages were recorded, by time [s] and topic."""
    made = MadeUp()
    made.jumps([Parabola()], until=until)
    made.rows = [row for row in made.rows if is_kept(row[0], row[1])]
    return measured(made, path)


def test_rates_and_gaps_are_measured(tmp_path: Path):
    def is_kept(time: float, topic: str) -> bool:
        return not ((topic == topics.LOAD_CELL and 0.5 < time < 0.8) or time == 1.5)

    rows = with_rows(tmp_path, 2.0, is_kept).topics
    load = rows[topics.LOAD_CELL]
    assert load.expected_hz == 100.0
    assert load.count == 201 - 29 - 1
    assert load.gaps == 2
    assert load.max_gap_s == pytest.approx(0.30)
    assert load.max_gap_at_s == pytest.approx(0.5)
    assert load.rate_hz == pytest.approx((load.count - 1) / 2.0)
    assert rows[topics.TRUTH_ENERGY].gaps == 1
    assert rows[topics.TRUTH_TETHER].gaps == 1
    assert rows[topics.TRUTH_TETHER].rate_hz == pytest.approx(50.0, rel=0.02)
    assert load.slow_hz is None


def test_gaps_of_a_slow_topic_are_counted_by_its_typical_rate(tmp_path: Path):
    def is_kept(time: float, topic: str) -> bool:
        thinned = round(time * 100) % 8 == 0 and not 0.5 < time < 0.8
        return topic != topics.LOAD_CELL or thinned

    load = with_rows(tmp_path, 2.0, is_kept).topics[topics.LOAD_CELL]
    assert load.slow_hz == pytest.approx(12.5)
    assert load.gaps == 1


def test_a_topic_that_was_slow_only_at_first_has_gaps(tmp_path: Path):
    def is_kept(time: float, topic: str) -> bool:
        return topic != topics.LOAD_CELL or time > 1.4 or round(time * 100) % 2 == 0

    load = with_rows(tmp_path, 4.0, is_kept).topics[topics.LOAD_CELL]
    assert load.slow_hz is None
    assert load.gaps == 70


def test_status_topics_are_paced_by_the_wall_clock(tmp_path: Path):
    made = MadeUp()
    status = Status("sim_node: plant", "running")
    for count in range(21):
        # Simulated time runs five times faster than wall time.
        made.add(count * 0.1, topics.SIM_STATUS, StatusSample(ns(count * 0.5), (status,)))
        made.add(count * 0.1, topics.CLOCK, ClockSample(ns(count * 0.5)))
    rows = measured(made, tmp_path).topics
    assert rows[topics.SIM_STATUS].gaps == 0
    assert rows[topics.SIM_STATUS].rate_hz == pytest.approx(10.0)
    assert rows[topics.CLOCK].gaps == 0
    assert rows[topics.CLOCK].slow_hz == pytest.approx(2.0)
    assert rows[topics.CLOCK].wall_rate_hz == pytest.approx(10.0)


@pytest.mark.parametrize(("lockstep", "gaps"), [("", 1), ("sim_node,winch_node", None)])
def test_in_lockstep_status_topics_promise_no_rate(tmp_path: Path, lockstep: str, gaps: int | None):
    made = MadeUp()
    status = Status("sim_node: plant", "running")
    configuration = {"node": "/sim_node", "parameters": {"lockstep": lockstep}}
    made.add(0.0, topics.CONFIG, TextSample(json.dumps(configuration)))
    for count in range(21):
        delay = 1.0 if count > 10 else 0.0  # wall time stands still once
        made.add(count * 0.1 + delay, topics.SIM_STATUS, StatusSample(ns(count * 0.1), (status,)))
        made.add(count * 0.1 + delay, topics.CLOCK, ClockSample(ns(count * 0.1)))
    assert measured(made, tmp_path).topics[topics.SIM_STATUS].gaps == gaps


def test_latency_is_from_publication_to_reception(tmp_path: Path):
    made = MadeUp()
    made.jumps([Parabola()], until=1.8)
    rows = measured(made, tmp_path).topics
    assert rows[topics.LOAD_CELL].latency_p50_ms == pytest.approx(LATENCY_NS * 1e-6)
    assert rows[topics.LOAD_CELL].latency_max_ms == pytest.approx(LATENCY_NS * 1e-6)
    assert rows[topics.TRUTH_PHASE].latency_p50_ms is None


def test_refusals_are_listed_with_their_reason(tmp_path: Path):
    made = MadeUp()
    made.jumps([Parabola()], until=1.0)
    made.refusal(0.5, topics.JUMP_REQUEST, "position is nan")
    refusals = measured(made, tmp_path).refusals
    assert [(e.time_s, e.node, e.message) for e in refusals] == [
        (0.5, "jump_node", "position is nan")
    ]


# --- reading --------------------------------------------------------------------------------------


def test_columns_follow_the_contract(tmp_path: Path):
    made = MadeUp()
    made.jumps([Parabola()], until=1.2)
    bag = read_bag(made.write(tmp_path / "bag"))
    body = bag.time_series[topics.TRUTH_BODY1]
    paths = {field.path for field in TOPICS[topics.TRUTH_BODY1].fields}
    assert set(body.columns) == paths
    assert len(body) == 121
    np.testing.assert_allclose(body.time, np.arange(121) / 100.0, atol=1e-12)
    moved = jumps.motion(body)
    poses = np.array([Parabola().at(time)[0] for time in body.time])
    np.testing.assert_allclose(moved.position[:, [0, 2]], poses[:, :2], atol=1e-12)
    np.testing.assert_allclose(moved.theta, poses[:, 2], atol=1e-12)
    tether = bag.time_series[topics.TRUTH_TETHER]
    assert tether.nodes is not None
    assert tether.nodes.shape == (61, 6, 7)
    assert bag.scenario["name"] == "made up"
    assert bag.seed == 7


def test_requests_of_several_kinds_share_one_series(tmp_path: Path):
    made = MadeUp()
    made.jumps([Parabola()], until=0.5)
    for time, joint, value in (
        (0.1, machine.WINCH_TO_LENGTH, JointValue(12.0, 0.0, 0.0)),
        (0.2, machine.WINCH_AT_RATE, JointValue(0.0, 0.3, 0.0)),
        (0.3, machine.WINCH_TO_LENGTH, JointValue(10.0, 0.0, 0.0)),
    ):
        made.add(time, topics.WINCH_REQUEST, JointSample(ns(time), {joint: value}))
    requests = read_bag(made.write(tmp_path / "bag")).time_series[topics.WINCH_REQUEST]
    lengths = requests.columns[f"{machine.WINCH_TO_LENGTH}.position"]
    rates = requests.columns[f"{machine.WINCH_AT_RATE}.velocity"]
    np.testing.assert_array_equal(lengths, [12.0, math.nan, 10.0])
    np.testing.assert_array_equal(rates, [math.nan, 0.3, math.nan])


def test_world_velocity_is_the_twist_rotated_by_the_attitude(tmp_path: Path):
    made = MadeUp()
    pose, rates = np.array([0.0, 0.0, 0.9]), np.array([0.3, -1.2, 2.0])
    for time in (0.0, 0.1):
        made.add(time, topics.TRUTH_BODY1, odometry(time, pose, rates))
    moved = jumps.motion(read_bag(made.write(tmp_path / "bag")).time_series[topics.TRUTH_BODY1])
    np.testing.assert_allclose(moved.velocity[0], [0.3, 0.0, -1.2], atol=1e-12)
    np.testing.assert_allclose(moved.theta_rate, 2.0)


def test_messages_that_violate_the_contract_are_counted_and_reported(tmp_path: Path):
    made = MadeUp()
    made.jumps([Parabola()], until=0.5)
    good = JointSample(ns(0.2), {machine.JUMP_SCREW: JointValue(0.1, 0.1, 10.0)})
    data = bytearray(pack(topics.JUMP_MOTOR_COMMAND, good))
    made.add_raw(0.2, topics.JUMP_MOTOR_COMMAND, bytes(data))
    place = bytes(data).index(np.float64(0.1).tobytes())
    data[place : place + 8] = np.float64(math.nan).tobytes()
    made.add_raw(0.3, topics.JUMP_MOTOR_COMMAND, bytes(data))
    made.add_raw(0.4, topics.JUMP_MOTOR_COMMAND, bytes(data[:40]))
    bag = read_bag(made.write(tmp_path / "bag"))
    assert len(bag.time_series[topics.JUMP_MOTOR_COMMAND]) == 1
    assert bag.rejected == {topics.JUMP_MOTOR_COMMAND: 2}
    assert "nan" in bag.rejected_examples[0].reason
    assert measure(bag).topics[topics.JUMP_MOTOR_COMMAND].rejected == 2


def test_a_bag_of_a_namespace_is_found_by_its_topics(tmp_path: Path):
    made = MadeUp()
    made.jumps([Parabola()], until=1.8)
    bag = read_bag(made.write(tmp_path / "bag", prefix="/site/rover1/"))
    assert bag.namespace == "/site/rover1"
    assert_is(measure(bag).jumps[0], Parabola())


@pytest.mark.parametrize("prefix", ["", "rover1/"])
def test_names_without_the_first_slash_are_read(tmp_path: Path, prefix: str):
    made = MadeUp()
    made.jumps([Parabola()], until=1.8)
    bag = read_bag(made.write(tmp_path / "bag", prefix=prefix))
    assert_is(measure(bag).jumps[0], Parabola())


def test_several_rovers_in_one_bag_need_a_namespace(tmp_path: Path):
    kind = standard_type(TOPICS[topics.TRUTH_BODY1].message)
    with BagWriter(tmp_path / "bag", sync=False) as writer:
        for number in (1, 2):
            channel = writer.add_topic(f"/rover{number}/{topics.TRUTH_BODY1}", kind)
            for step in range(number * 10):
                data = pack(topics.TRUTH_BODY1, odometry(step * 0.1, np.zeros(3), np.zeros(3)))
                writer.write(channel, EPOCH_NS + step, EPOCH_NS + step, data)
    with pytest.raises(ReadError, match="/rover1, /rover2"):
        read_bag(tmp_path / "bag")
    for name in ("/rover3", "/rover", "rover1 /rover2"):
        with pytest.raises(ReadError, match=r"no topic in the namespace .*/rover1 or /rover2"):
            read_bag(tmp_path / "bag", namespace=name)
    assert (
        len(read_bag(tmp_path / "bag", namespace="/rover2").time_series[topics.TRUTH_BODY1]) == 20
    )


def test_a_bag_without_a_clock_counts_from_its_start(tmp_path: Path):
    made = MadeUp()
    made.jumps([Parabola()], until=1.8, without=[topics.CLOCK])
    found = measured(made, tmp_path)
    assert_is(found.jumps[0], dataclasses.replace(Parabola(), take_off=1.003))
    assert found.simulated_s is None


def test_interrupted_and_damaged_bags_are_read_partially(tmp_path: Path):
    made = MadeUp()
    made.jumps([Parabola()], until=1.8)
    path = made.write(tmp_path / "bag", close=False)
    bag = read_bag(path)
    assert not bag.closed
    assert_is(measure(bag).jumps[0], Parabola())
    file = next(path.glob("*.mcap"))
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    cut = read_bag(path)
    assert cut.damage
    assert 0.3 < sum(cut.counts.values()) / sum(bag.counts.values()) < 0.6
    file.write_bytes(whole[:500])
    with pytest.raises(ReadError, match="no message that can be read"):
        read_bag(path)


def test_a_path_without_a_bag_is_refused(tmp_path: Path):
    with pytest.raises(ScanError, match="there is no bag"):
        read_bag(tmp_path / "nothing")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ScanError, match=r"holds no file ending in .mcap, .db3"):
        read_bag(tmp_path / "empty")
    (tmp_path / "empty" / "old_0.db3").write_text("")
    with pytest.raises(ScanError, match="empty: nothing was recorded"):
        read_bag(tmp_path / "empty")


def test_foreign_topics_are_counted_but_not_read(tmp_path: Path):
    kind = "std_msgs/msg/Float64"
    with BagWriter(tmp_path / "bag", sync=False) as writer:
        channel = writer.add_topic("/elsewhere", standard_type(kind))
        for step in range(5):
            data = bytes(STORE.serialize_cdr(STORE.types[kind](data=1.0), kind))
            writer.write(channel, EPOCH_NS + step, EPOCH_NS, data)
    bag = read_bag(tmp_path / "bag")
    assert bag.counts == {"/elsewhere": 5}
    assert measure(bag).topics["/elsewhere"].count == 5
    assert json.dumps(measure(bag).to_mapping())


@pytest.mark.parametrize(
    ("m1", "m2", "masses"),
    [(7.0, 3.0, (7.0, 3.0)), (7.0, 0.0, (7.0, 0.0)), (0.0, 3.0, None), (7.0, -1.0, None)],
)
def test_a_rover_of_a_single_body_has_masses(
    tmp_path: Path, m1: float, m2: float, masses: tuple[float, float] | None
):
    made = MadeUp()
    made.add(
        0.0, topics.CONFIG, TextSample(json.dumps({"scenario": {"rover": {"m1": m1, "m2": m2}}}))
    )
    assert masses_of(read_bag(made.write(tmp_path / "bag"))) == masses
