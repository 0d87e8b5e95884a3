"""sim_node as a process, observed and commanded from another one over DDS."""

from __future__ import annotations

import itertools
import json
import math
import re
import signal
import statistics
import subprocess
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
from driving import drive_nut, has_event
from ros_messages import message_of

from msg_schemas import machine, topics
from msg_schemas.access import ACCESS
from msg_schemas.events import NodeEvent, PlantEvent, SimulationEvent
from msg_schemas.parameters import ParameterError, from_mapping
from msg_schemas.phases import PlantPhase
from msg_schemas.samples import JointSample, JointValue, Level, TextSample
from msg_schemas.table import TOPICS
from rover_sim import build_plant, jump, load_planar, load_scenario
from rover_sim.node.sim_node import RateParameters, SimParameters, load

if TYPE_CHECKING:
    from rover_verify.harness import NodeHarness, Observer, Process, Processes

    Sim = tuple[Process, Observer]

pytestmark = [pytest.mark.ros, pytest.mark.process, pytest.mark.usefixtures("compiled")]

MODULE = "rover_sim.node.sim_node"
NODE = "sim_node"
NANO = 1_000_000_000
DIVERGING = '{"integration.tolerance": 1.0e-30, "integration.max_halvings": 0}'


def start(harness: NodeHarness, **parameters: object) -> Sim:
    process = harness.processes.start(MODULE, {"scenario": "paper_table1_high", **parameters})
    observer = harness.observer()
    observer.listen(topics.EVENTS)
    observer.listen(topics.DIAGNOSTICS)
    observer.listen(topics.CLOCK)
    observer.wait_for_event(NodeEvent.ACTIVE)
    return process, observer


def status(observer: Observer, key: str, value: str, since: int = 0) -> Any:
    """Wait until the simulation's status has a value."""
    return observer.wait_for_status(topics.SIM_STATUS, lambda s: s.values.get(key) == value, since)


def pause(observer: Observer) -> int:
    """Pause and return the simulated time."""
    events = observer.listen(topics.EVENTS)
    since = len(events)
    answer = observer.call(topics.SIM_PAUSE, True)
    assert answer.success, answer.message
    paused = events.wait(
        lambda sample: any(s.name == SimulationEvent.PAUSED for s in sample.statuses), since
    )
    return observer.wait_for_time(paused.stamp_ns)


# ---------------------------------------------------------------------------------- topics


def test_every_topic_is_received_at_its_rate_in_simulated_time(
    harness: NodeHarness, record_property: Callable[[str, object], None]
):
    _, observer = start(harness)
    rows = [
        row
        for row in TOPICS.values()
        if row.name in ACCESS["sim_node"].publishes
        and row.rate is not None
        and row.sample is not TextSample
        and not row.spatial_only
    ]
    feeds = {row.name: observer.listen(row.name) for row in rows}
    for row in rows:
        if row.name == topics.SIM_STATUS:
            feeds[row.name].wait_for_count(5)
            continue
        assert row.rate is not None
        stamps = [sample.stamp_ns for sample in feeds[row.name].wait_for_count(40)]
        gaps = {b - a for a, b in itertools.pairwise(stamps[1:])}
        record_property("error", max(abs(gap * row.rate / NANO - 1.0) for gap in gaps))
        assert gaps == {round(NANO / row.rate)}, row.name


def test_a_rover_on_the_ground_is_at_rest(harness: NodeHarness):
    _, observer = start(harness)
    assert observer.wait_for_text(topics.TRUTH_PHASE, PlantPhase.HELD)
    assert observer.listen(topics.CONTACT).wait().joints[machine.FLOOR_SWITCH].position == 1.0
    force = observer.listen(topics.IMU).wait().linear_acceleration
    assert force == pytest.approx((0.0, 0.0, 9.81), abs=1e-6)
    body = observer.listen(topics.TRUTH_BODY1).wait()
    assert body.position == pytest.approx((2.2 + 0.15, 0.0, -2.2), abs=1e-6)
    assert body.linear == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


def test_its_configuration_is_latched_with_all_values_and_the_seed(harness: NodeHarness):
    _, observer = start(
        harness, overrides='{"start.slack": 1.5, "tether.elements": 7}', seed=42, tick=0.02,
        clock_rate=50.0, sensor_rate=50.0, truth_rate=50.0,
    )  # fmt: skip
    content = json.loads(observer.listen(topics.CONFIG).wait().text)
    expected = load_scenario("paper_table1_high", {"start.slack": 1.5, "tether.elements": 7})
    assert content["scenario"] == json.loads(json.dumps(expected.to_mapping()))
    assert content["seed"] == 42
    assert content["parameters"]["tick"] == 0.02
    shape = observer.listen(topics.TRUTH_TETHER).wait().nodes
    assert shape.shape == (8, 7)


# ------------------------------------------------------------------------------------- it is flown


@pytest.mark.parametrize("changes", [{}, {"start.geometry": "+K", "start.slack": 2.0}])
def test_a_jump_commanded_from_another_process_is_that_of_the_plant(
    harness: NodeHarness, changes: dict[str, object]
):
    _, observer = start(harness, overrides=json.dumps(changes), real_time_factor=2.0)
    bodies = observer.listen(topics.TRUTH_BODY1)
    nut = observer.listen(topics.JUMP_MOTOR_STATE)
    for feed in (bodies, nut):
        feed.wait()
    drive_nut(observer, 0.2, 0.4, has_event(observer, PlantEvent.TAKE_OFF))
    flown = {k: float(v) for k, v in observer.wait_for_event(PlantEvent.TOUCHDOWN).values.items()}
    observer.wait_for_text(topics.TRUTH_PHASE, PlantPhase.LANDED)

    alone = jump(build_plant(load_planar("paper_table1_high", changes)))
    assert flown["height"] == pytest.approx(alone.height, abs=1e-6)
    assert flown["attitude_variation"] == pytest.approx(alone.attitude_variation, abs=2e-4)
    assert flown["flight_time"] == pytest.approx(alone.flight_time, abs=1e-5)
    # The published ground truth agrees.
    heights = [sample.position[2] for sample in bodies.samples]
    assert max(heights) - heights[0] == pytest.approx(alone.height, abs=5e-4)
    speeds = {round(s.joints[machine.JUMP_SCREW].velocity, 6) for s in nut.samples}
    assert 0.4 in speeds
    observer.wait_for_event(PlantEvent.APEX)


# ------------------------------------------------------------------------- bad commands are refused


@pytest.fixture(scope="module")
def sim(shared_harness: NodeHarness) -> Sim:
    """A running simulation for tests that leave the nut at zero."""
    # Slow, so that commands do not expire on a busy machine.
    running = start(shared_harness, real_time_factor=0.5)
    running[1].listen(topics.JUMP_MOTOR_STATE).wait()
    return running


def bad_jump_commands() -> list[Any]:
    def set_(part: str, value: float) -> Callable[[Any], object]:
        return lambda m: getattr(m, part).__setitem__(0, value)

    def at(seconds: float) -> Callable[[Any], object]:
        def change(message: Any) -> None:
            stamp = message.header.stamp.sec * NANO + message.header.stamp.nanosec
            stamp += round(seconds * NANO)
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, NANO)

        return change

    def unstamp(message: Any) -> None:
        message.header.stamp.sec = message.header.stamp.nanosec = 0

    cases: dict[str, tuple[str, str, Callable[[Any], object]]] = {
        "nan": ("not_finite", "nan", set_("position", math.nan)),
        "infinite speed": ("not_finite", "inf", set_("velocity", math.inf)),
        "wrong joint": ("wrong_name", "jump_screw", lambda m: m.name.__setitem__(0, "screw")),
        "no joint": ("wrong_name", "jump_screw", lambda m: m.name.clear()),
        "wrong length": ("wrong_length", "velocity", lambda m: m.velocity.append(0.1)),
        "negative": ("out_of_limits", "-0.1 .. 0.4 m", set_("position", -0.11)),
        "above the latch": ("out_of_limits", "free travel is 0 m", set_("position", -0.05)),
        "too far": ("out_of_limits", "-0.1 .. 0.4 m", set_("position", 0.41)),
        "too fast": ("out_of_limits", "0.5 m/s", set_("velocity", 0.6)),
        "too weak": ("out_of_limits", "164.8 N", set_("effort", 100.0)),
        "stale": ("stale", "at most 0.5 s", at(-1.0)),
        "future": ("from_the_future", "at most 0.1 s", at(+10.0)),
        "unstamped": ("unstamped", "header.stamp", unstamp),
    }
    return [pytest.param(*case, id=name) for name, case in cases.items()]


@pytest.mark.parametrize(("code", "words", "change"), bad_jump_commands())
def test_a_bad_jump_command_is_refused_with_its_reason_and_nothing_moves(
    sim: Sim, code: str, words: str, change: Callable[[Any], object]
):
    process, observer = sim
    nut = observer.listen(topics.JUMP_MOTOR_STATE)
    moved, received = len(nut), len(observer.listen(topics.DIAGNOSTICS))
    stamp = observer.wait_for_time(2 * NANO)
    value = {machine.JUMP_SCREW: JointValue(0.2, 0.1, 400.0)}
    message = message_of(topics.JUMP_MOTOR_COMMAND, JointSample(stamp, value))
    change(message)
    observer.publisher(topics.JUMP_MOTOR_COMMAND).publish(message)
    refusal = observer.wait_for_refusal(topics.JUMP_MOTOR_COMMAND, code, received)
    assert words in refusal.message
    observer.wait_for_time(observer.time_ns() + NANO // 10)
    assert all(s.joints[machine.JUMP_SCREW] == (0.0, 0.0, 0.0) for s in nut.samples[moved:])
    assert process.is_running


def test_a_command_older_than_the_last_accepted_one_is_refused(sim: Sim):
    _, observer = sim
    received = len(observer.listen(topics.DIAGNOSTICS))
    now = observer.wait_for_time(NANO)
    for stamp in (now, now - 10_000_000):
        observer.send_joint(topics.JUMP_MOTOR_COMMAND, machine.JUMP_SCREW, 0.0, 0.1, 10.0, stamp)
    observer.wait_for_refusal(topics.JUMP_MOTOR_COMMAND, "out_of_order", received)


def send_winch(observer: Observer, length: float, rate: float = 0.0) -> None:
    joints = {
        machine.WINCH_DRUM: JointValue(length, rate),
        machine.WINCH_BRAKE: JointValue(0.0),
        machine.WINCH_LIMIT: JointValue(effort=100.0),
    }
    observer.send(topics.WINCH_COMMAND, JointSample(observer.time_ns(), joints))


def test_a_drum_without_a_motor_refuses_to_move_and_accepts_to_hold(sim: Sim):
    _, observer = sim
    received = len(observer.listen(topics.DIAGNOSTICS))
    observer.wait_for_time(NANO)
    send_winch(observer, 5.0)
    send_winch(observer, 4.0, 0.1)
    refusal = observer.wait_for_refusal(topics.WINCH_COMMAND, "not_supported", received)
    assert refusal.values["refused"] == "1"


def test_after_all_refusals_a_valid_command_is_executed(sim: Sim):
    _, observer = sim
    nut = observer.listen(topics.JUMP_MOTOR_STATE)

    def compression() -> float:
        return float(nut.last.joints[machine.JUMP_SCREW].position)

    drive_nut(observer, 0.3, 0.05, lambda: compression() > 0.02)
    assert observer.listen(topics.TRUTH_PHASE).wait().text == PlantPhase.HELD
    drive_nut(observer, 0.0, 0.1, lambda: compression() == 0.0)


def test_commands_in_flight_are_refused(harness: NodeHarness):
    _, observer = start(harness, real_time_factor=0.1)
    drive_nut(observer, 0.1, 0.5, has_event(observer, PlantEvent.TAKE_OFF))
    took_off = next(
        e.stamp_ns
        for e in observer.listen(topics.EVENTS).samples
        if e.statuses[0].name == PlantEvent.TAKE_OFF
    )
    observer.wait_for_time(took_off + 110_000_000)
    observer.send_joint(topics.JUMP_MOTOR_COMMAND, machine.JUMP_SCREW, 0.1, 0.1, 400.0)
    refusal = observer.wait_for_refusal(topics.JUMP_MOTOR_COMMAND, "wrong_phase")
    assert "flight" in refusal.message


def test_a_scenario_without_a_rover_refuses_to_jump(harness: NodeHarness):
    _, observer = start(harness, scenario="tether_pendulum", real_time_factor=0.1)
    observer.wait_for_text(topics.TRUTH_PHASE, PlantPhase.FREE)
    observer.wait_for_time(1)
    observer.send_joint(topics.JUMP_MOTOR_COMMAND, machine.JUMP_SCREW, 0.1, 0.1, 400.0)
    refusal = observer.wait_for_refusal(topics.JUMP_MOTOR_COMMAND, "not_supported")
    assert "no rover" in refusal.message
    assert observer.node.count_publishers(f"/{topics.IMU}") == 0


def test_when_commands_cease_the_nut_stops_at_its_position(harness: NodeHarness):
    _, observer = start(harness, real_time_factor=0.5)
    nut = observer.listen(topics.JUMP_MOTOR_STATE)
    observer.wait_for_time(1)
    observer.send_joint(topics.JUMP_MOTOR_COMMAND, machine.JUMP_SCREW, 0.3, 0.1, 400.0)
    stopped = observer.wait_for_event(SimulationEvent.COMMAND_TIMEOUT, drive="jump_motor")
    assert stopped.level is Level.ERROR
    observer.wait_for_status(
        topics.DIAGNOSTICS, lambda s: s.name == f"{NODE}: {SimulationEvent.COMMAND_TIMEOUT}"
    )
    position = float(stopped.values["compression"])
    assert position == pytest.approx(0.05, abs=0.002)
    # Samples from before the stop may arrive after its event.
    stopped_ns = next(
        sample.stamp_ns
        for sample in observer.listen(topics.EVENTS).samples
        if any(s.name == SimulationEvent.COMMAND_TIMEOUT for s in sample.statuses)
    )
    nut.wait(lambda s: s.stamp_ns > stopped_ns + NANO // 2)
    later = [s for s in nut.samples if s.stamp_ns > stopped_ns]
    assert {s.joints[machine.JUMP_SCREW].position for s in later} == {position}


# -------------------------------------------------------------------------- pause, step and reset


def test_pause_stops_time_and_step_advances_it_by_one_tick(harness: NodeHarness):
    _, observer = start(harness)
    clock, body = observer.listen(topics.CLOCK), observer.listen(topics.TRUTH_BODY1)
    body.wait()
    assert not observer.call(topics.SIM_STEP).success
    stamp = pause(observer)
    status(observer, "paused", "true")
    count = len(clock)
    for step in range(1, 4):
        assert observer.call(topics.SIM_STEP).success
        assert observer.wait_for_time(stamp + step * 10_000_000) == stamp + step * 10_000_000
    assert len(clock) == count + 3
    body.wait(lambda s: s.stamp_ns == stamp + 30_000_000)
    # Services are taken by the plant's clock, which stamps their records.
    last = observer.listen(topics.COMMANDS)
    record = last.wait(lambda s: s.stamp_ns == stamp + 30_000_000).statuses[0]
    assert record.name == topics.SIM_STEP
    assert abs(int(record.values["taken"]) - stamp) <= 30_000_000
    assert observer.call(topics.SIM_PAUSE, False).success
    observer.wait_for_time(stamp + NANO // 2)


def test_a_paused_simulation_still_refuses_with_reason_and_publishes_its_health(
    harness: NodeHarness,
):
    _, observer = start(harness, start_paused=True)
    status(observer, "paused", "true")
    observer.wait_until(
        lambda: observer.call(topics.SIM_STEP).success and observer.time_ns() > 0,
        "stepping is not received",
    )
    observer.send_joint(topics.JUMP_MOTOR_COMMAND, machine.JUMP_SCREW, 0.2, 0.1, 100.0)
    observer.wait_for_refusal(topics.JUMP_MOTOR_COMMAND, "out_of_limits")
    received = len(observer.listen(topics.DIAGNOSTICS))
    observer.wait_for_status(
        topics.DIAGNOSTICS,
        lambda s: s.name == f"{NODE}: plant" and s.values["paused"] == "true",
        received,
    )


def test_reset_restarts_at_zero_and_the_next_jump_is_equal(harness: NodeHarness):
    _, observer = start(harness, real_time_factor=2.0)
    heights = []
    for _ in range(2):
        since = len(observer.listen(topics.EVENTS))
        drive_nut(observer, 0.1, 0.5, has_event(observer, PlantEvent.TAKE_OFF, since))
        heights.append(float(observer.wait_for_event(PlantEvent.TOUCHDOWN, since).values["height"]))
        clock, phases = observer.listen(topics.CLOCK), observer.listen(topics.TRUTH_PHASE)
        count, reported = len(clock), len(phases)
        assert observer.call(topics.SIM_RESET).success
        clock.wait(lambda s: s.stamp_ns == 0, count)
        observer.wait_for_text(topics.TRUTH_PHASE, PlantPhase.HELD, since=reported)
        observer.wait_for_event(SimulationEvent.RESET, since)
    assert heights[1] == pytest.approx(heights[0], abs=1e-6)


def test_reset_plant_resets_the_plant_and_time_continues(harness: NodeHarness):
    _, observer = start(harness, real_time_factor=2.0)
    clock, bodies = observer.listen(topics.CLOCK), observer.listen(topics.TRUTH_BODY1)
    start_position = bodies.wait().position
    drive_nut(observer, 0.1, 0.5, has_event(observer, PlantEvent.TAKE_OFF))
    reported = len(observer.listen(topics.TRUTH_PHASE))
    stamp, count = observer.time_ns(), len(bodies)
    assert observer.call(topics.SIM_RESET_PLANT).success
    observer.wait_for_text(topics.TRUTH_PHASE, PlantPhase.HELD, since=reported)
    bodies.wait(lambda s: s.position == start_position, count)
    observer.wait_for_time(stamp + NANO // 5)
    stamps = [sample.stamp_ns for sample in clock.samples]
    assert stamps == sorted(stamps)


# ------------------------------------------------------------------------------------- divergence


@pytest.mark.parametrize(
    ("overrides", "phase", "words"),
    [
        (DIVERGING, PlantPhase.DIVERGED, "last converged state"),
        ('{"tether.breaking_load": 0.01}', PlantPhase.TETHER_BROKEN, "tension"),
    ],
)
def test_a_stopped_plant_is_reported_and_services_still_work(
    harness: NodeHarness, overrides: str, phase: PlantPhase, words: str
):
    process, observer = start(
        harness, overrides=overrides, start_paused=True, real_time_factor=0.25
    )
    bodies = observer.listen(topics.TRUTH_BODY1)
    observer.call(topics.SIM_PAUSE, False)
    observer.wait_for_text(topics.TRUTH_PHASE, phase)
    event = observer.wait_for_event(PlantEvent[phase.name])
    assert event.level is Level.ERROR
    assert words in event.message
    observer.wait_for_status(
        topics.DIAGNOSTICS, lambda s: s.name == f"{NODE}: plant" and s.level is Level.ERROR
    )
    status(observer, "outcome", phase.value)
    # Nothing moves, time continues, commands are refused with the remedy.
    count, stamp = len(bodies), observer.time_ns()
    samples = bodies.wait_for_count(count + 20)[count:]
    assert len({sample.position for sample in samples}) == 1
    assert observer.wait_for_time(stamp + NANO // 10)
    observer.send_joint(topics.JUMP_MOTOR_COMMAND, machine.JUMP_SCREW, 0.1, 0.1, 400.0)
    refusal = observer.wait_for_refusal(topics.JUMP_MOTOR_COMMAND, "wrong_phase")
    assert topics.SIM_RESET in refusal.message
    phases = observer.listen(topics.TRUTH_PHASE)
    reported = len(phases)
    assert observer.call(topics.SIM_RESET).success
    observer.wait_for_text(topics.TRUTH_PHASE, PlantPhase.HELD, since=reported)
    assert process.stop() == 0


def test_a_run_of_given_duration_that_diverges_ends_with_code_3(processes: Processes):
    process = processes.start(MODULE, {"overrides": DIVERGING, "duration": 5.0})
    assert process.wait() == 3


# ------------------------------------------------------------------------------------------- pace


def test_a_run_of_given_duration_ends_by_itself(harness: NodeHarness):
    process, observer = start(harness, duration=3.0, real_time_factor=0.0, start_paused=True)
    observer.call(topics.SIM_PAUSE, False)
    assert process.wait() == 0
    assert "simulated 3 s" in observer.wait_for_event(SimulationEvent.FINISHED).message
    assert observer.listen(topics.CLOCK).last.stamp_ns == 3 * NANO
    assert process.has_group_exited()


def test_the_factor_reached_is_measured_and_can_be_changed_while_it_runs(
    harness: NodeHarness, record_property: Callable[[str, object], None]
):
    _, observer = start(harness)
    feed = observer.listen(topics.SIM_STATUS)

    def measured() -> float:
        """Median of the last ten readings."""
        return statistics.median(
            float(sample.statuses[0].values["measured_real_time_factor"] or "nan")
            for sample in feed.samples[-10:]
        )

    for factor in (1.0, 0.5, 2.0):
        assert observer.set_parameter(NODE, "real_time_factor", factor).successful
        feed.wait_for_count(len(feed) + 10)

        def is_reached(factor: float = factor) -> bool:
            return abs(measured() / factor - 1.0) < 0.1

        observer.wait_until(is_reached, f"factor {factor} is not reached")
        record_property("error", abs(measured() / factor - 1.0))
    assert observer.set_parameter(NODE, "real_time_factor", 0.0).successful
    observer.wait_until(lambda: measured() > 3.0, "it does not run as fast as it can")


def test_a_simulation_too_slow_for_its_factor_is_reported(harness: NodeHarness):
    _, observer = start(harness, real_time_factor=1000.0)
    reported = observer.wait_for_status(topics.SIM_STATUS, lambda s: s.level is Level.WARN)
    assert "too slow for a real-time factor of 1000" in reported.message
    assert float(reported.values["wall_time_dropped"]) > 0.0


def test_two_simulations_in_namespaces_do_not_disturb_each_other(harness: NodeHarness):
    remap = {topics.CLOCK: topics.CLOCK.strip("/")}
    observers = {}
    for name in ("one", "two"):
        harness.processes.start(
            MODULE, {"scenario": "paper_table1_low"}, namespace=name, remap=remap
        )
        observers[name] = harness.observer(name, remap)
    one, two = observers["one"], observers["two"]
    two_nut, two_phase = two.listen(topics.JUMP_MOTOR_STATE), two.listen(topics.TRUTH_PHASE)
    two_nut.wait()
    for observer in (one, two):
        observer.wait_for_time(1)
    assert two.set_parameter(f"/two/{NODE}", "real_time_factor", 0.5).successful
    drive_nut(one, 0.1, 0.4, has_event(one, PlantEvent.TAKE_OFF))
    one.wait_for_text(topics.TRUTH_PHASE, PlantPhase.LANDED)
    assert {s.joints[machine.JUMP_SCREW].position for s in two_nut.samples} == {0.0}
    assert [s.text for s in two_phase.samples] == [PlantPhase.HELD]
    for observer in (one, two):
        stamps = [s.stamp_ns for s in observer.listen(topics.CLOCK).samples]
        assert {b - a for a, b in itertools.pairwise(stamps)} == {10_000_000}


# --------------------------------------------------------------------------------------- lifecycle


def test_deactivation_stops_time_and_activation_continues_it(harness: NodeHarness):
    _, observer = start(harness)
    clock = observer.listen(topics.CLOCK)
    observer.wait_for_time(NANO // 2)
    assert observer.change_state(NODE, "deactivate")
    observer.wait_for_event(NodeEvent.INACTIVE)
    # What was sent before the event has arrived when a later call is answered.
    assert not observer.call(topics.SIM_PAUSE, True).success
    count, stamp = len(clock), observer.time_ns()
    assert not observer.call(topics.SIM_PAUSE, True).success
    assert len(clock) == count
    assert observer.change_state(NODE, "activate")
    observer.wait_for_time(stamp + NANO // 2)
    stamps = [s.stamp_ns for s in clock.samples]
    assert stamps == sorted(stamps)


def test_after_cleanup_and_configuration_time_starts_at_zero(harness: NodeHarness):
    _, observer = start(harness)
    observer.wait_for_time(NANO // 2)
    for transition in ("deactivate", "cleanup", "configure"):
        assert observer.change_state(NODE, transition)
    clock = observer.listen(topics.CLOCK)
    count = len(clock)
    assert observer.change_state(NODE, "activate")
    clock.wait(lambda s: 0 < s.stamp_ns < NANO // 2, count)


# ------------------------------------------------------------------------------------ how it ends


def interrupt(process: Process) -> None:
    process.send(signal.SIGINT)


def interrupt_twice(process: Process) -> None:
    process.send_to_group(signal.SIGINT)
    process.send(signal.SIGINT)


def terminate(process: Process) -> None:
    process.send(signal.SIGTERM)


@pytest.mark.parametrize(
    ("end", "factor"), [(interrupt, 0.0), (interrupt_twice, 1.0), (terminate, 0.0)]
)
def test_a_signal_ends_it_and_leaves_no_process(
    harness: NodeHarness, end: Callable[[Process], None], factor: float
):
    process, _ = start(harness, real_time_factor=factor)
    end(process)
    assert process.wait() == 0
    assert process.has_group_exited()
    assert "Traceback" not in process.output


def test_a_signal_ends_it_while_paused(harness: NodeHarness):
    process, observer = start(harness, start_paused=True)
    status(observer, "paused", "true")
    assert process.stop(signal.SIGTERM) == 0
    assert process.has_group_exited()


@pytest.mark.parametrize(
    ("parameters", "complaint"),
    [
        ({"scenario": "/nowhere/mine.yaml"}, "/nowhere/mine.yaml"),
        ({"sensor_rate": 200.0}, "at most 100 Hz"),
        ({"realtime_factor": 1.0}, "did you mean 'real_time_factor'?"),
    ],
)
def test_bad_configuration_ends_it_with_code_2_and_one_line(
    processes: Processes, parameters: dict[str, object], complaint: str
):
    process = processes.start(MODULE, parameters)
    assert process.wait() == 2
    assert "Traceback" not in process.output
    lines = [line for line in process.output.splitlines() if "rcl]" not in line]
    assert len(lines) == 1, process.output
    assert complaint in lines[0]


@pytest.mark.parametrize(
    ("parameters", "complaint"),
    [
        ({"scenario": "paper_table9"}, "paper_table1_high"),
        ({"scenario": ""}, "paper_table1_high"),
        ({"overrides": "{start.slack: .nan}"}, "start.slack"),
        ({"overrides": "{start.slak: 2}"}, "did you mean 'slack'?"),
        ({"overrides": "[1, 2"}, "not YAML"),
        ({"overrides": "3"}, "should be a mapping"),
        ({"overrides": "{rover.wheels: 4}"}, "rover.wheels"),
        ({"model": "cubic"}, "one of scenario, planar, spatial"),
        ({"model": "spatial"}, "paper_table1_high is planar: should be planar, or scenario"),
        ({"model": "planar", "scenario": "marius_hills"}, "marius_hills is spatial"),
        ({"tick": 0.0}, "tick = 0.0: should be a number"),
        ({"seed": -1}, "seed"),
        ({"real_time_factor": -1.0}, "real_time_factor"),
        ({"duration": math.inf}, "finite"),
    ],
)
def test_a_bad_scenario_or_parameter_is_refused_with_the_reason(
    parameters: dict[str, object], complaint: str
):
    with pytest.raises(ValueError, match=re.escape(complaint)):
        load(from_mapping(SimParameters, parameters))


@pytest.mark.parametrize("model", ["planar", "spatial"])
def test_the_model_is_the_scenario_s_and_can_be_required(model: str):
    scenario = {"planar": "paper_table1_high", "spatial": "marius_hills"}[model]
    for required in ("scenario", model):
        parameters = from_mapping(SimParameters, {"scenario": scenario, "model": required})
        assert load(parameters).model == model


def test_rates_may_not_exceed_one_per_tick():
    rates = from_mapping(RateParameters, {"sensor_rate": 100.0})
    rates.check(0.01)
    with pytest.raises(ParameterError, match=r"at most 50 Hz, once per tick of 0\.02 s"):
        rates.check(0.02)


def test_the_node_is_made_before_the_plant_is_imported():
    program = (
        "import sys, rover_sim.node.sim_node\n"
        "print(*(name for name in ('numba', 'rover_sim.physics') if name in sys.modules))\n"
        "print(rover_sim.build_plant.__name__, 'numba' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60.0
    )
    assert done.stdout.split("\n")[:2] == ["", "build_plant True"]
