"""Activities of a synthetic mission and their metrics."""

import math
from itertools import accumulate
from pathlib import Path

import numpy as np
import pytest
from contract_bag import MadeUp, Parabola, ns
from made_up_mission import (
    FORWARD,
    GRAVITY,
    MISSION,
    RADIUS,
    RIPPLE,
    SHORT,
    SLIP,
    UP,
    Leg,
    mission,
    write_mission,
)

from msg_schemas import machine, topics
from msg_schemas.samples import JointSample, JointValue
from rover_bags.analysis.metrics import Metrics, measure
from rover_bags.analysis.signals import closed, opened, runs
from rover_bags.analysis.timeline import TimelineEventKind
from rover_bags.reading.read import read_bag
from rover_bags.views.run_plots import run_plots

BEGINS = [0.0, *accumulate(leg.duration for leg in MISSION)]


@pytest.fixture(scope="module")
def metrics(tmp_path_factory: pytest.TempPathFactory) -> Metrics:
    return measure(read_bag(write_mission(tmp_path_factory.mktemp("mission") / "bag")))


def test_every_activity_is_found_at_its_time(metrics: Metrics):
    found = [(interval.activity.value, interval.begin_s) for interval in metrics.timeline.intervals]
    assert [what for what, _ in found] == [leg.what for leg in MISSION]
    np.testing.assert_allclose([at for _, at in found], BEGINS[:-1], atol=0.05)


def test_timeline_events_are_found(metrics: Metrics):
    found = {event.kind: event.time_s for event in metrics.timeline.events}
    assert found[TimelineEventKind.TOUCHDOWN] == pytest.approx(BEGINS[6], abs=0.05)
    assert found[TimelineEventKind.LATCH_TRIP] == pytest.approx(BEGINS[13], abs=0.05)
    assert found[TimelineEventKind.TAKE_OFF] == pytest.approx(BEGINS[13], abs=0.05)
    assert found[TimelineEventKind.LANDING] == pytest.approx(BEGINS[14], abs=0.05)
    assert TimelineEventKind.FAULT not in found
    assert TimelineEventKind.LIFT_OFF not in found


def test_a_descent_has_metrics_of_drum_and_tension(metrics: Metrics):
    assert [descent.downward for descent in metrics.descents] == [True, False, True]
    first = metrics.descents[0]
    assert first.to_m - first.from_m == pytest.approx(8.0 * 0.25, abs=0.01)
    assert first.rate_m_s == pytest.approx(0.25, rel=0.01)
    assert first.depth_to_m is not None
    assert first.depth_from_m is not None
    assert first.depth_to_m - first.depth_from_m == pytest.approx(2.0, abs=0.01)
    assert first.tracking_error_m == pytest.approx(0.002, abs=1e-9)
    assert first.ripple == pytest.approx(RIPPLE / math.sqrt(2.0), rel=0.05)
    assert first.swing_max_rad == pytest.approx(0.0, abs=1e-9)


def test_a_drive_has_path_and_slip(metrics: Metrics):
    drive, turn = metrics.drives
    rolled = 4.0 * 2.0 * RADIUS
    assert drive.path_m == pytest.approx((1.0 - SLIP) * rolled, rel=0.02)
    assert drive.rolled_m == pytest.approx(rolled, rel=0.02)
    assert drive.slip == pytest.approx(SLIP, abs=0.01)
    assert turn.turning
    assert turn.heading_rad == pytest.approx(3.0 * 0.5, rel=0.02)
    (traverse,) = metrics.traverses
    assert traverse.drives == 2
    assert traverse.closing_distance_m == pytest.approx((1.0 - SLIP) * rolled, rel=0.02)


def test_a_jump_over_the_ground_has_range_and_attitude(metrics: Metrics):
    (jump,) = metrics.jumps
    assert jump.take_off_s == pytest.approx(BEGINS[13], abs=0.03)
    assert jump.flight_time_s == pytest.approx(1.2, abs=0.03)
    assert jump.jump_height_m == pytest.approx(UP**2 / (2.0 * GRAVITY), rel=0.03)
    assert jump.range_m == pytest.approx(FORWARD * 1.2, rel=0.03)
    assert jump.rotation_rad == pytest.approx(0.0, abs=1e-6)
    assert jump.tilt_rad == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("pitch", [0.0, 0.5, -0.5])
def test_the_travel_of_a_jump_does_not_depend_on_the_pitch(tmp_path: Path, pitch: float):
    (jump,) = measure(read_bag(write_mission(tmp_path / "bag", legs=SHORT, pitch=pitch))).jumps
    assert jump.travel_m == pytest.approx(jump.range_m, rel=1e-9)
    assert jump.range_m == pytest.approx(FORWARD * 1.2, rel=0.03)


def test_a_jump_with_the_nose_straight_up_has_no_travel(tmp_path: Path):
    legs, pitch = SHORT, math.pi / 2
    (jump,) = measure(read_bag(write_mission(tmp_path / "bag", legs=legs, pitch=pitch))).jumps
    assert jump.travel_m == 0.0


def test_images_count_while_the_rover_hangs_and_sees_the_wall(metrics: Metrics):
    assert len(metrics.imaging_stops) == 3
    assert [stop.sharp for stop in metrics.imaging_stops] == [1.0, 0.0, 0.0]
    assert metrics.imaging_stops[0].images == pytest.approx(30, abs=1)
    assert metrics.imaging_stops[0].wall_m == 3.0


def test_images_logged_by_a_descent_are_mapped(tmp_path: Path):
    made = MadeUp()
    for index, smear in enumerate((0.1, 0.2, 3.0)):
        joints = {
            machine.PICTURE: JointValue(1.0 + index),
            machine.DEPTH: JointValue(10.0 + 2.0 * index),
            machine.HEADING: JointValue(0.3),
            machine.CAMERA_RATE: JointValue(velocity=1e-3),
            machine.SMEAR: JointValue(smear),
            machine.WALL_DISTANCE: JointValue(3.0),
        }
        time = 1.0 + index
        made.add(time, topics.DESCENT_OBSERVATION, JointSample(ns(time), joints))
    bag = read_bag(made.write(tmp_path / "bag"))
    found = measure(bag)
    assert found.coverage is not None
    assert (found.coverage.images, found.coverage.sharp, found.coverage.stops) == (3, 2, 3)
    assert found.to_mapping()["coverage"]["smeared"] == 1
    assert "coverage" in [plot.name for plot in run_plots(bag, found)]


def test_the_audits_sum_the_recorded_terms(metrics: Metrics):
    energy = metrics.audits.energy
    assert energy is not None
    span = BEGINS[-1]
    assert energy.turnover_J == pytest.approx(3.5 * span, rel=0.01)
    assert energy.residual_J == pytest.approx(1e-6 * span, rel=0.01)
    assert energy.drift_error_J < 1e-9
    assert energy.gravity_error_J is None
    descent = energy.intervals[1]
    assert descent.input_J == pytest.approx(2.0 * 8.0, rel=0.01)
    assert descent.stored_J == pytest.approx(0.5 * 8.0, rel=0.01)
    flywheel = metrics.audits.rotors[0]
    assert flywheel.momentum_max_N_m_s == pytest.approx(0.15)
    assert flywheel.share == pytest.approx(0.5)
    (flight,) = metrics.audits.flights
    # In free fall only gravity changes the momentum.
    assert flight.momentum_change_N_s < 1e-9
    assert flight.unexplained_N_s is not None
    assert flight.unexplained_N_s < 1e-9
    assert any("gravity" in text for text in metrics.audits.not_audited)


def test_a_brake_that_closes_on_a_turning_drum_is_a_fault(tmp_path: Path):
    legs = (Leg("hanging", 1.0), Leg("descending", 4.0, 0.3), Leg("hanging", 2.0))
    bag = read_bag(write_mission(tmp_path / "bag", legs=legs, brake_at=3.0))
    faults = [m for m in measure(bag).timeline.events if m.kind is TimelineEventKind.FAULT]
    assert len(faults) == 1
    assert faults[0].time_s == pytest.approx(3.0, abs=0.03)
    assert "0.300 m/s" in faults[0].reason


def test_a_short_trim_of_the_drum_is_not_a_descent(tmp_path: Path):
    legs = (
        Leg("hanging", 2.0),
        *(Leg("descending" if n % 2 else "ascending", 0.4, 0.05 * (-1) ** n) for n in range(10)),
        Leg("hanging", 2.0),
    )
    bag = read_bag(write_mission(tmp_path / "bag", legs=legs))
    assert [interval.activity.value for interval in measure(bag).timeline.intervals] == ["hanging"]


@pytest.mark.parametrize("force", [3.0, 20.0, 150.0])
def test_a_rover_that_only_hangs_neither_touches_down_nor_jumps(tmp_path: Path, force: float):
    """The nut of a hanging rover is loaded and relieved, as by its own weight or a held spring."""
    made = mission(legs=(Leg("hanging", 4.0), Leg("descending", 6.0, 0.2), Leg("hanging", 6.0)))
    made.rows = [row for row in made.rows if row[1] != topics.JUMP_MOTOR_STATE]
    for tick in range(800):
        time = tick / 50.0
        loaded = force if (time % 3.0) > 1.2 else 0.0
        screw = {machine.JUMP_SCREW: JointValue(0.1, 0.0, loaded)}
        made.add(time, topics.JUMP_MOTOR_STATE, JointSample(ns(time), screw))
    found = measure(read_bag(made.write(tmp_path / "bag"))).timeline
    assert [each.activity.value for each in found.intervals] == ["hanging", "descending", "hanging"]
    assert not found.events


def test_damping_strokes_are_not_descents_but_travels_beside_them_are(tmp_path: Path):
    def stroke(n: int) -> Leg:
        side = -1 if n % 2 else 1
        # The first stroke is half as long; the strokes decay.
        duration = (1.0 if n == 0 else 2.0) * 0.9**n
        return Leg("descending" if side > 0 else "ascending", duration, 0.2 * side)

    legs = (
        Leg("hanging", 2.0),
        Leg("descending", 8.0, 0.25),
        Leg("hanging", 1.0),
        *(stroke(n) for n in range(6)),
        Leg("ascending", 0.5, -0.1),
        *(stroke(n) for n in range(6, 12)),
        Leg("hanging", 2.0),
        Leg("ascending", 5.0, -0.1),
        Leg("hanging", 3.0),
        Leg("descending", 5.0, 0.1),
    )
    bag = read_bag(write_mission(tmp_path / "bag", legs=legs))
    found = [interval.activity.value for interval in measure(bag).timeline.intervals]
    assert found == [
        "hanging", "descending", "hanging", "ascending", "hanging", "descending",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("down", "rest", "up"),
    [pytest.param(11.0, 3.0, 5.0, id="after a rest"), pytest.param(8.0, 2.1, 7.7, id="long")],
)
def test_an_ascent_between_descents_is_a_travel_unless_it_damps_a_swing(
    tmp_path: Path, down: float, rest: float, up: float
):
    legs = (
        Leg("hanging", 2.0),
        Leg("descending", down, 0.2),
        Leg("hanging", rest),
        Leg("ascending", up, -0.1),
        Leg("hanging", 2.8),
        Leg("descending", 6.0, 0.2),
        Leg("hanging", 2.0),
    )
    bag = read_bag(write_mission(tmp_path / "bag", legs=legs))
    assert [interval.activity.value for interval in measure(bag).timeline.intervals] == [
        leg.what for leg in legs
    ]


def test_a_bag_without_switches_or_phase_has_no_activities(tmp_path: Path):
    made = MadeUp()
    absent = (topics.TRUTH_PHASE, topics.CONTACT)
    made.jumps([Parabola()], until=1.8, without=absent)
    found = measure(read_bag(made.write(tmp_path / "bag")))
    assert found.timeline.intervals == ()
    assert len(found.jumps) == 1


def test_closing_fills_gaps_and_opening_removes_blips():
    time = np.arange(10.0)
    flags = np.array([1, 1, 0, 1, 1, 0, 0, 0, 1, 0], dtype=bool)
    assert closed(flags, time, 2.0).tolist() == [1, 1, 1, 1, 1, 0, 0, 0, 1, 0]
    assert opened(flags, time, 1.5).tolist() == [1, 1, 0, 1, 1, 0, 0, 0, 0, 0]
    assert runs(flags) == [(0, 1), (2, 2), (3, 4), (5, 7), (8, 8), (9, 9)]
