"""jump_node and sim_node as processes; the test is the operator."""

from __future__ import annotations

import math
import signal
import statistics
from itertools import pairwise
from typing import TYPE_CHECKING

import pytest
from graph import forbidden_to_controllers, subscriptions_of
from ros_messages import message_of

from msg_schemas import machine, topics
from msg_schemas.access import BATCHES
from msg_schemas.events import JumpEvent, PlantEvent, SimulationEvent
from msg_schemas.health import Health, read_health
from msg_schemas.phases import HealthState, JumpPhase, PlantPhase
from msg_schemas.samples import (
    ClockSample,
    ImuSample,
    JointSample,
    JointValue,
    Level,
    Sample,
    Status,
)
from rover_sim import build_plant, jump, load_planar

if TYPE_CHECKING:
    from rover_verify.harness import NodeHarness, Observer, Process, Processes

pytestmark = [
    pytest.mark.ros,
    pytest.mark.process,
    pytest.mark.usefixtures("compiled", "compiled_in_space"),
]

MODULE, NODE = "rover_control.jump.jump_node", "jump_node"
NANO = 1_000_000_000
NOW_NS = 5 * NANO


def start_both(harness: NodeHarness) -> tuple[Process, Observer]:
    """Start simulator and jump_node; returns the latter once it accepts requests.

    Simulated time is slow, so that no sample is lost on a busy machine.
    """
    observer = harness.observer()
    observer.listen(topics.EVENTS)
    observer.listen(topics.DIAGNOSTICS)
    observer.listen(topics.JUMP_MOTOR_COMMAND)
    process = harness.processes.start(MODULE, {"use_sim_time": True})
    harness.processes.start(
        "rover_sim.node.sim_node", {"scenario": "paper_table1_high", "real_time_factor": 0.5}
    )
    # Each node's last topic: once it is matched, so are the others.
    observer.wait_for_text(topics.JUMP_PHASE, JumpPhase.STANDBY)
    observer.listen(topics.JUMP_MOTOR_STATE).wait()
    observer.wait_until_ready(NODE)
    return process, observer


def request(observer: Observer, stroke: float, speed: float = 0.0) -> None:
    """Send a request without a time stamp, as an operator does."""
    observer.send_joint(topics.JUMP_REQUEST, machine.JUMP_STROKE, stroke, speed, stamp_ns=0)


def phases(observer: Observer, since: int = 0) -> list[str]:
    return [sample.text for sample in observer.listen(topics.JUMP_PHASE).samples[since:]]


def wait_for_compression(observer: Observer, low: float, high: float = math.inf) -> None:
    feed = observer.listen(topics.JUMP_MOTOR_STATE)
    feed.wait(lambda s: low < s.joints[machine.JUMP_SCREW].position < high, max(0, len(feed) - 1))


def test_a_requested_jump_matches_the_plant_and_passes_its_phases(harness: NodeHarness):
    _, observer = start_both(harness)
    since = len(observer.listen(topics.JUMP_PHASE))
    request(observer, 0.2, 0.4)
    touchdown = observer.wait_for_event(PlantEvent.TOUCHDOWN)
    observer.wait_for_text(topics.JUMP_PHASE, JumpPhase.STANDBY, since=since)
    alone = jump(build_plant(load_planar("paper_table1_high")))
    assert float(touchdown.values["height"]) == pytest.approx(alone.height, abs=1e-5)
    assert phases(observer, since) == [
        "compressing", "settling", "releasing", "flight", "landed", "standby",
    ]  # fmt: skip
    landed = observer.wait_for_event(JumpEvent.LANDED)
    assert float(landed.values["flight_time"]) == pytest.approx(alone.flight_time, abs=0.03)


def test_commands_are_sent_only_while_compressing(harness: NodeHarness):
    _, observer = start_both(harness)
    commands = observer.listen(topics.JUMP_MOTOR_COMMAND)
    assert not commands.samples
    request(observer, 0.1, 0.1)
    observer.wait_for_event(JumpEvent.STANDBY)
    samples = commands.samples
    assert {s.joints[machine.JUMP_SCREW] for s in samples} == {JointValue(0.1, 0.1, 400.0)}
    latch = [s.joints[machine.JUMP_LATCH].position for s in samples]
    assert latch == sorted(latch)  # held first, then tripped
    assert {*latch} == {0.0, 1.0}
    begin, end = (stamp_of(observer, name) for name in (JumpEvent.COMPRESSING, JumpEvent.FLIGHT))
    assert end - begin > 0.9 * NANO
    stamps = [sample.stamp_ns for sample in samples]
    # The first one answers the request, the last one precedes the detected take-off.
    assert begin <= stamps[0] <= begin + NANO // 20
    assert stamps[-1] <= end
    gaps = [later - earlier for earlier, later in pairwise(stamps)]
    assert statistics.median(gaps) / NANO == pytest.approx(0.05, abs=0.01)


def stamp_of(observer: Observer, event: str) -> int:
    """Time at which jump_node reported an event [ns]."""
    feed = observer.listen(topics.EVENTS)
    return int(feed.wait(lambda sample: sample.statuses[0].name == event).stamp_ns)


def test_an_abort_lets_the_spring_down_and_no_jump_happens(harness: NodeHarness):
    _, observer = start_both(harness)
    since = len(observer.listen(topics.JUMP_PHASE))
    request(observer, 0.2, 0.05)
    wait_for_compression(observer, 0.02)
    answer = observer.call(topics.JUMP_ABORT)
    assert answer.success
    assert "spring" in answer.message
    observer.wait_for_text(topics.JUMP_PHASE, JumpPhase.STANDBY, since=since)
    assert phases(observer, since) == ["compressing", "letting_down", "standby"]
    wait_for_compression(observer, -1.0, 1e-9)
    assert observer.listen(topics.TRUTH_PHASE).wait().text == PlantPhase.HELD


@pytest.mark.parametrize(
    ("stroke", "code"),
    [(0.35, "out_of_limits"), (0.0, "out_of_limits"), (math.nan, "not_finite")],
)
def test_a_bad_request_is_refused_with_its_reason_and_nothing_moves(
    shared_sim: Observer, stroke: float, code: str
):
    observer = shared_sim
    count = len(observer.listen(topics.DIAGNOSTICS))
    message = message_of(
        topics.JUMP_REQUEST, JointSample(0, {machine.JUMP_STROKE: JointValue(0.1)})
    )
    message.position[0] = stroke
    observer.publisher(topics.JUMP_REQUEST).publish(message)
    observer.wait_for_refusal(topics.JUMP_REQUEST, code, count)
    assert not observer.listen(topics.JUMP_MOTOR_COMMAND).samples


@pytest.fixture(scope="module")
def shared_sim(shared_harness: NodeHarness) -> Observer:
    """Simulator and jump_node for requests that are refused."""
    return start_both(shared_harness)[1]


def test_a_request_for_an_unknown_joint_is_refused(shared_sim: Observer):
    observer = shared_sim
    message = message_of(
        topics.JUMP_REQUEST, JointSample(0, {machine.JUMP_STROKE: JointValue(0.1)})
    )
    message.name[0] = "stroke"
    observer.publisher(topics.JUMP_REQUEST).publish(message)
    refusal = observer.wait_for_refusal(topics.JUMP_REQUEST, "wrong_name")
    assert machine.JUMP_STROKE in refusal.message


def test_the_node_subscribes_to_no_ground_truth(shared_sim: Observer):
    subscriptions = subscriptions_of(shared_sim, NODE, last=topics.JUMP_REQUEST)
    assert BATCHES in subscriptions  # by which it receives its sensors
    assert not subscriptions & forbidden_to_controllers()


def test_without_sensors_a_request_is_refused(harness: NodeHarness):
    harness.processes.start(MODULE)
    observer = harness.observer()
    observer.wait_for_text(topics.JUMP_PHASE, JumpPhase.STANDBY)
    request(observer, 0.1)
    refusal = observer.wait_for_refusal(topics.JUMP_REQUEST, "stale")
    assert "never received" in refusal.message


def test_a_request_during_a_jump_is_refused_and_the_jump_continues(harness: NodeHarness):
    _, observer = start_both(harness)
    request(observer, 0.1, 0.05)
    wait_for_compression(observer, 0.01)
    request(observer, 0.2)
    refusal = observer.wait_for_refusal(topics.JUMP_REQUEST, "wrong_phase")
    assert "compressing" in refusal.message
    observer.wait_for_event(PlantEvent.TOUCHDOWN)


def test_after_a_kill_the_nut_stops_and_the_next_node_lets_the_spring_down(
    harness: NodeHarness,
):
    process, observer = start_both(harness)
    request(observer, 0.2, 0.05)
    wait_for_compression(observer, 0.02)
    process.send(signal.SIGKILL)
    process.wait()
    stopped = float(
        observer.wait_for_event(SimulationEvent.COMMAND_TIMEOUT, drive="jump_motor").values[
            "compression"
        ]
    )
    assert 0.02 < stopped < 0.1

    events, count = len(observer.listen(topics.EVENTS)), len(observer.listen(topics.DIAGNOSTICS))
    harness.processes.start(MODULE, {"use_sim_time": True})
    observer.wait_until_ready(NODE, count)
    request(observer, 0.1)
    refusal = observer.wait_for_refusal(topics.JUMP_REQUEST, "wrong_phase", count)
    assert "compressed by" in refusal.message
    since = len(observer.listen(topics.JUMP_PHASE))
    assert observer.call(topics.JUMP_ABORT).success
    observer.wait_for_text(topics.JUMP_PHASE, JumpPhase.STANDBY, since=since)
    wait_for_compression(observer, -1.0, 1e-9)
    request(observer, 0.1, 0.4)
    observer.wait_for_event(PlantEvent.TOUCHDOWN, events)


def test_a_simulator_reset_returns_to_standby(harness: NodeHarness):
    _, observer = start_both(harness)
    request(observer, 0.2, 0.05)
    wait_for_compression(observer, 0.02)
    since = len(observer.listen(topics.JUMP_PHASE))
    assert observer.call(topics.SIM_RESET).success
    observer.wait_for_text(topics.JUMP_PHASE, JumpPhase.STANDBY, since=since)
    observer.wait_until_ready(NODE, len(observer.listen(topics.DIAGNOSTICS)))
    request(observer, 0.1, 0.4)
    observer.wait_for_event(PlantEvent.TOUCHDOWN)


def test_a_deactivated_node_sends_nothing_and_the_nut_stops(harness: NodeHarness):
    _, observer = start_both(harness)
    request(observer, 0.2, 0.05)
    wait_for_compression(observer, 0.02)
    assert observer.change_state(NODE, "deactivate")
    observer.wait_for_event(SimulationEvent.COMMAND_TIMEOUT, drive="jump_motor")
    count = len(observer.listen(topics.DIAGNOSTICS))
    assert observer.change_state(NODE, "activate")
    observer.wait_until_ready(NODE, count)
    assert observer.call(topics.JUMP_ABORT).success
    wait_for_compression(observer, -1.0, 1e-9)


def test_parameters_have_ranges_and_take_effect(harness: NodeHarness):
    _, observer = start_both(harness)
    assert not observer.set_parameter(NODE, "max_stroke", 0.5).successful
    assert observer.set_parameter(NODE, "max_stroke", 0.05).successful
    request(observer, 0.1)
    refusal = observer.wait_for_refusal(topics.JUMP_REQUEST, "out_of_limits")
    assert "limit 0.05 m" in refusal.message


def test_health_names_missing_sensors(harness: NodeHarness):
    harness.processes.start(MODULE, {"use_sim_time": True})
    observer = harness.observer()
    wait_until_waiting(observer, topics.CLOCK)
    # The clock stands still: received samples stay fresh.
    diagnostics = observer.listen(topics.DIAGNOSTICS)

    def knows_time() -> bool:
        observer.send(topics.CLOCK, ClockSample(NOW_NS))
        return bool(diagnostics.last.stamp_ns == NOW_NS)

    observer.wait_until(knows_time, "the node has no time")
    sensors: dict[str, Sample] = {
        topics.CONTACT: JointSample(NOW_NS, {machine.FLOOR_SWITCH: JointValue(1.0)}),
        topics.JUMP_MOTOR_STATE: JointSample(NOW_NS, {machine.JUMP_SCREW: JointValue(0.0)}),
        topics.IMU: ImuSample(NOW_NS, (0.0, 0.0, 0.0), (0.0, 0.0, 9.81)),
    }
    missing = list(sensors)
    for topic, sample in sensors.items():
        status = wait_until_waiting(observer, *missing)
        assert (status.name, status.level) == (f"{NODE}: node", Level.WARN)
        observer.send(topic, sample)
        missing.remove(topic)
    observer.wait_until_ready(NODE)


def wait_until_waiting(observer: Observer, *missing: str) -> Status:
    """Wait until the node's health reports these missing inputs."""
    waiting = Health(NODE, HealthState.WAITING, missing)
    return observer.wait_for_status(topics.DIAGNOSTICS, lambda s: read_health(s) == waiting)


def test_health_names_the_phase(shared_sim: Observer):
    feed = shared_sim.listen(topics.DIAGNOSTICS)
    found = shared_sim.wait_for_status(
        topics.DIAGNOSTICS, lambda s: s.name == f"{NODE}: sequence", len(feed)
    )
    assert found.level is Level.OK
    assert JumpPhase.STANDBY in found.message


@pytest.mark.parametrize("numbers", [[signal.SIGINT], [signal.SIGINT] * 2, [signal.SIGTERM]])
def test_a_signal_during_a_jump_ends_the_node_cleanly(
    harness: NodeHarness, numbers: list[signal.Signals]
):
    process, observer = start_both(harness)
    request(observer, 0.2, 0.05)
    wait_for_compression(observer, 0.02)
    for number in numbers:
        process.send(number)
    assert process.wait() == 0
    assert process.has_group_exited()
    assert "Traceback" not in process.output


def test_an_invalid_parameter_ends_the_node_with_code_2(processes: Processes):
    process = processes.start(MODULE, {"nut_speed": 7.0})
    assert process.wait() == 2
    assert "nut_speed" in process.output
