"""sim_node with the spatial plant: a process, observed and commanded over DDS."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from driving import drive
from ros_messages import message_of

from msg_schemas import machine, topics
from msg_schemas.access import ACCESS
from msg_schemas.events import SimulationEvent
from msg_schemas.phases import PlantPhase
from msg_schemas.samples import JointSample, JointValue, Level
from msg_schemas.table import TOPICS

if TYPE_CHECKING:
    from rover_verify.harness import NodeHarness, Observer, Process

    Sim = tuple[Process, Observer]

pytestmark = [pytest.mark.ros, pytest.mark.process, pytest.mark.usefixtures("compiled_in_space")]

MODULE = "rover_sim.node.sim_node"
NODE = "sim_node"
NANO = 1_000_000_000
TICK_NS = 10_000_000
PERFECT = '{"sensors.error_model": "ideal"}'
# Slow, so that a moving winch is not braked by a timeout on a busy machine.
SLOW = 0.2


def start(harness: NodeHarness, **parameters: object) -> Sim:
    given = {"scenario": "free_hang", "overrides": PERFECT, **parameters}
    process = harness.processes.start(MODULE, given)
    observer = harness.observer()
    observer.listen(topics.CLOCK)
    observer.wait_until_ready(NODE)
    return process, observer


def winch(rate: float, brake: float = 1.0, limit: float = 60.0) -> dict[str, JointValue]:
    return {
        machine.WINCH_DRUM: JointValue(20.0, rate, 16.2),
        machine.WINCH_BRAKE: JointValue(brake),
        machine.WINCH_LIMIT: JointValue(effort=limit),
    }


COMMANDS: Mapping[str, dict[str, JointValue]] = {
    topics.JUMP_MOTOR_COMMAND: {machine.JUMP_SCREW: JointValue(-0.03, 0.05, 400.0)},
    topics.FLYWHEEL_COMMAND: {machine.FLYWHEEL: JointValue(effort=0.05)},
    topics.WHEEL_COMMAND: {machine.WHEEL_DRIVE: JointValue(0.0, 1.0, 1.0)},
    topics.WHEEL_TORQUE_COMMAND: {machine.WHEEL_DRIVE: JointValue(effort=0.2)},
    topics.WINCH_COMMAND: winch(0.3),
}


def drum(observer: Observer) -> JointValue:
    value = observer.listen(topics.WINCH_STATE).last.joints[machine.WINCH_DRUM]
    assert isinstance(value, JointValue)
    return value


# ---------------------------------------------------------------------------------- topics


def test_it_logs_its_scenario_and_its_readiness_and_hangs(harness: NodeHarness):
    process, observer = start(harness)
    process.wait_for_output("scenario free_hang: compiling")
    process.wait_for_output(r"compiled and at rest after \d+\.\d s")
    observer.wait_for_text(topics.TRUTH_PHASE, PlantPhase.HANGING)
    content = json.loads(observer.listen(topics.CONFIG).wait().text)
    assert content["scenario"]["model"] == "spatial"
    assert content["scenario"]["winch"]["brake_torque"] == 2.0
    assert content["parameters"]["model"] == "scenario"


def test_every_topic_of_the_plant_is_received_at_its_rate(
    harness: NodeHarness, record_property: Callable[[str, object], None]
):
    _, observer = start(harness)
    rows = [
        row
        for row in TOPICS.values()
        if row.name in ACCESS["sim_node"].publishes
        and row.rate
        and row.name not in (topics.SIM_STATUS, topics.TRUTH_STATE)
    ]
    feeds = {row.name: observer.listen(row.name) for row in rows}
    for row in rows:
        assert row.rate is not None
        stamps = [sample.stamp_ns for sample in feeds[row.name].wait_for_count(12)]
        gaps = np.diff(stamps[1:])
        record_property("error", np.abs(gaps * row.rate / NANO - 1.0).max())
        assert set(gaps) == {round(NANO / row.rate)}, row.name
    switch = feeds[topics.CONTACT].last.joints[machine.FLOOR_SWITCH]
    assert switch.position == 0.0


def test_a_scenario_of_the_other_model_is_refused(harness: NodeHarness):
    process = harness.processes.start(MODULE, {"scenario": "free_hang", "model": "planar"})
    assert process.wait() == 2
    assert "free_hang is spatial: should be spatial" in process.output
    assert "Traceback" not in process.output


# ------------------------------------------------------------------------------------- it is moved


def test_the_winch_pays_out_until_a_timeout_stops_it_and_closes_its_brake(harness: NodeHarness):
    _, observer = start(harness, real_time_factor=SLOW)
    states = observer.listen(topics.WINCH_STATE)
    states.wait()
    drive(observer, topics.WINCH_COMMAND, winch(0.3), lambda: drum(observer).position > 20.3)
    assert drum(observer).velocity == pytest.approx(0.3, abs=0.02)
    lengths = [sample.joints[machine.WINCH_DRUM].position for sample in states.samples]
    assert lengths == sorted(lengths)
    silent = observer.wait_for_event(SimulationEvent.COMMAND_TIMEOUT, drive="winch")
    assert silent.level is Level.ERROR
    assert 0.2 < float(silent.values["age"]) <= 0.26
    states.wait(lambda s: s.joints[machine.WINCH_BRAKE].position == 0.0, since=len(lengths))
    stopped = states.wait(
        lambda s: s.joints[machine.WINCH_DRUM].velocity == 0.0, since=len(lengths)
    )
    run_on = stopped.joints[machine.WINCH_DRUM].position - float(silent.values["length"])
    assert run_on == pytest.approx(0.3**2 / (2.0 * 0.4), abs=0.02)
    name = f"{NODE}: {SimulationEvent.COMMAND_TIMEOUT}"
    observer.wait_for_status(topics.DIAGNOSTICS, lambda s: s.name == name)


@pytest.mark.parametrize(
    ("command", "state", "joint", "rate", "axis", "turn"),
    [
        (topics.WHEEL_TORQUE_COMMAND, topics.WHEEL_STATE, machine.WHEEL_LEFT, 1.0, 1, -0.02),
        (topics.FLYWHEEL_COMMAND, topics.FLYWHEEL_STATE, machine.FLYWHEEL, 5.0, 0, -0.01),
    ],
    ids=["wheels, about y", "flywheel, about x"],
)
def test_a_rotor_turns_the_hanging_body_in_the_opposite_direction(
    harness: NodeHarness, command: str, state: str, joint: str, rate: float, axis: int, turn: float
):
    _, observer = start(harness, real_time_factor=SLOW)
    bodies, drives = observer.listen(topics.TRUTH_BODY1), observer.listen(state)
    for feed in (bodies, drives):
        feed.wait()
    drive(
        observer,
        command,
        COMMANDS[command],
        lambda: drives.last.joints[joint].velocity > rate,
    )
    assert min(sample.angular[axis] for sample in bodies.samples) < turn


# ------------------------------------------------------------------------- bad commands are refused


@pytest.fixture(scope="module")
def sim(shared_harness: NodeHarness) -> Sim:
    """A running simulation for tests without motion."""
    running = start(shared_harness, real_time_factor=SLOW)
    running[1].listen(topics.WINCH_STATE).wait()
    return running


def nan(message: Any) -> None:
    message.effort[0] = math.nan


def infinite(message: Any) -> None:
    message.velocity[-1] = -math.inf


def wrong_joint(message: Any) -> None:
    message.name[0] = "propeller"


def too_short(message: Any) -> None:
    message.position.pop()


def too_much(message: Any) -> None:
    message.effort[-1] = 1e9


def late(message: Any) -> None:
    message.header.stamp.sec -= 1


def unstamped(message: Any) -> None:
    message.header.stamp.sec = message.header.stamp.nanosec = 0


BAD: list[tuple[Callable[[Any], None], str]] = [
    (nan, "not_finite"),
    (infinite, "not_finite"),
    (wrong_joint, "wrong_name"),
    (too_short, "wrong_length"),
    (too_much, "out_of_limits"),
    (late, "stale"),
    (unstamped, "unstamped"),
]


@pytest.mark.parametrize("topic", COMMANDS)
@pytest.mark.parametrize(("change", "code"), BAD)
def test_a_bad_command_is_refused_with_its_reason_and_nothing_moves(
    sim: Sim, topic: str, change: Callable[[Any], None], code: str
):
    process, observer = sim
    received = len(observer.listen(topics.DIAGNOSTICS))
    before = drum(observer)
    message = message_of(topic, JointSample(observer.wait_for_time(2 * NANO), COMMANDS[topic]))
    change(message)
    observer.publisher(topic).publish(message)
    refusal = observer.wait_for_refusal(topic, code, received)
    assert refusal.level is Level.WARN
    assert len(refusal.message) > 20
    assert drum(observer) == before
    assert process.is_running


@pytest.mark.parametrize(
    ("topic", "joints", "words"),
    [
        (
            topics.JUMP_MOTOR_COMMAND,
            {machine.JUMP_SCREW: JointValue(0.25, 0.05, 400.0)},
            "stroke of 0.2 m",
        ),
        (
            topics.JUMP_MOTOR_COMMAND,
            {machine.JUMP_SCREW: JointValue(-0.08, 0.05, 400.0)},
            "free travel",
        ),
        (topics.WINCH_COMMAND, winch(0.0, brake=0.5), "1 (release) or 0 (close)"),
    ],
)
def test_commands_beyond_the_drives_are_refused_with_the_reason(
    sim: Sim, topic: str, joints: dict[str, JointValue], words: str
):
    _, observer = sim
    received = len(observer.listen(topics.DIAGNOSTICS))
    observer.send(topic, JointSample(observer.wait_for_time(1), joints))
    assert words in observer.wait_for_refusal(topic, "out_of_limits", received).message


# ------------------------------------------------------------------------------ reset -------------


def test_both_resets_reset_tether_and_rover_and_one_the_clock(harness: NodeHarness):
    _, observer = start(harness, real_time_factor=SLOW)
    bodies = observer.listen(topics.TRUTH_BODY1)
    begin = bodies.wait().position
    for service in (topics.SIM_RESET_PLANT, topics.SIM_RESET):
        drive(observer, topics.WINCH_COMMAND, winch(0.3), lambda: bodies.last.position[2] < -20.5)
        stamp, count = observer.time_ns(), len(bodies)
        assert observer.call(service).success
        back = bodies.wait(lambda s: s.position == begin, count)
        if service == topics.SIM_RESET:
            assert back.stamp_ns == 0
        else:
            assert back.stamp_ns >= stamp
    observer.wait_for_text(topics.TRUTH_PHASE, PlantPhase.HANGING)
