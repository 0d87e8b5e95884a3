"""winch_node: its cases on the loop host, and as a process beside a plant in lockstep."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from graph import forbidden_to_controllers, subscriptions_of

from msg_schemas import machine, topics
from msg_schemas.events import NodeEvent, SimulationEvent
from msg_schemas.phases import LoadState, WinchMode
from msg_schemas.refusal import read_refusal
from msg_schemas.samples import JointSample, Level
from rover_launch.plan import LOCKSTEP, MOCK, TRUE
from rover_verify.checks import CheckBatch, winch
from rover_verify.harness.flight import WINCH

if TYPE_CHECKING:
    from rover_verify.harness import NodeHarness, Observer, Process
    from rover_verify.harness.launching import Launched

MODULE, NODE = "tether_winch.winch_node", "winch_node"
START, FAR, RATE = 5.0, 45.0, 0.3  # [m], [m], [m/s]
PROCESS = "mother_nodes"


# ------------------------------------------------------------------------------------ the loop host


@pytest.mark.parametrize(
    "check", [winch.unsafe_cases, winch.motions_after_fault, winch.refusals_without_reason]
)
def test_unsafe_states_brake_until_rearmed_and_refusals_have_a_reason(check: Any, tmp_path: Path):
    measured = check(CheckBatch(1, 1, tmp_path))
    assert measured.value == 0.0, measured.note


# -------------------------------------------------------------------------------------- processes


class Bench:
    """A plant and a winch node in lockstep."""

    def __init__(self, harness: NodeHarness, plant: str = MOCK) -> None:
        from rover_verify.harness.launching import Launched

        overrides = json.dumps({"tether.length": START})
        given = {"plant": plant, "scenario": "free_hang", "overrides": overrides, LOCKSTEP: TRUE}
        given |= {"real_time_factor": "4"}
        self.launched: Launched = Launched(harness, WINCH, given, defaults={})
        self.observer: Observer = self.launched.observer
        self.process: Process = self.launched.processes[PROCESS]
        for name in (topics.CLOCK, topics.WINCH_MODE, topics.WINCH_COMMAND, topics.WINCH_STATE):
            self.observer.listen(name)
        self.launched.wait_until_ready()

    @property
    def state(self) -> JointSample:
        last = self.observer.listen(topics.WINCH_STATE).last
        assert isinstance(last, JointSample)
        return last

    def lower(self) -> None:
        """Arm, and wait until the tether is paid out."""
        from rover_verify.harness.launching import arm_winch

        arm_winch(self.observer)
        # Unstamped: at 4 times real time the clock of a busy machine runs ahead of the observer.
        self.observer.send_joint(
            topics.WINCH_REQUEST, machine.WINCH_TO_LENGTH, FAR, RATE, stamp_ns=0
        )
        states = self.observer.listen(topics.WINCH_STATE)
        states.wait(lambda s: s.joints[machine.WINCH_DRUM].velocity > 0.95 * RATE, len(states))

    def wait_until_braked(self) -> None:
        states = self.observer.listen(topics.WINCH_STATE)
        states.wait(is_braked, len(states))


def is_braked(state: JointSample) -> bool:
    return (
        state.joints[machine.WINCH_DRUM].velocity == 0.0
        and state.joints[machine.WINCH_BRAKE].position == 0.0
    )


@pytest.fixture
def bench(harness: NodeHarness) -> Bench:
    return Bench(harness)


def order(harness: NodeHarness, *words: str) -> dict[str, Any]:
    """How a command ended that an operator waits for."""
    process = harness.processes.start(
        "operator_console.command_line", None, *words, "--wait", "--json", "--timeout", "60"
    )
    process.wait()
    completion = json.loads(process.output.splitlines()[-1])["completion"]
    assert isinstance(completion, dict), process.output
    return completion


@pytest.mark.ros
@pytest.mark.process
@pytest.mark.parametrize(
    "numbers", [[signal.SIGINT], [signal.SIGINT] * 2, [signal.SIGTERM], [signal.SIGHUP]]
)
def test_a_node_that_is_stopped_leaves_the_drum_braked(bench: Bench, numbers: list[signal.Signals]):
    subscribed = subscriptions_of(bench.observer, NODE)
    assert topics.WINCH_REQUEST in subscribed
    assert not subscribed & forbidden_to_controllers()
    bench.lower()
    commands = bench.observer.listen(topics.WINCH_COMMAND)
    since = len(commands)
    for number in numbers:
        bench.process.send(number)
    assert bench.process.wait() == 0
    commands.wait(lambda sample: sample.joints[machine.WINCH_DRUM][1:] == (0.0, 0.0), since)
    bench.wait_until_braked()
    # The plant received the stop: its drive did not have to stop by itself.
    events = bench.observer.listen(topics.EVENTS).samples
    names = {status.name for sample in events for status in sample.statuses}
    assert NodeEvent.PARTICIPANT_EXCLUDED in names
    assert SimulationEvent.COMMAND_TIMEOUT not in names
    assert bench.process.has_group_exited()
    assert "Traceback" not in bench.process.output


@pytest.mark.ros
@pytest.mark.process
def test_deactivated_it_brakes_and_thresholds_are_checked_together(bench: Bench):
    assert bench.observer.set_parameter(NODE, "snag_threshold", 1.1).successful
    result = bench.observer.set_parameter(NODE, "touchdown_threshold", 0.9)
    assert not result.successful
    assert "further apart" in result.reason
    assert bench.observer.get_parameter(NODE, "touchdown_threshold") == 0.5
    bench.lower()
    assert bench.observer.change_state(NODE, "deactivate")
    bench.wait_until_braked()


@pytest.mark.ros
@pytest.mark.process
def test_killed_while_it_pays_out_the_drive_stops_the_drum(bench: Bench):
    bench.lower()
    bench.process.send(signal.SIGKILL)
    bench.process.wait()
    bench.observer.wait_for_event(SimulationEvent.COMMAND_TIMEOUT)
    bench.wait_until_braked()
    assert bench.state.joints[machine.WINCH_DRUM].position < FAR - 1.0


@pytest.mark.ros
@pytest.mark.process
def test_an_operator_waits_for_a_length_and_reads_a_refusal(bench: Bench, harness: NodeHarness):
    from rover_verify.harness.launching import arm_winch

    bench.observer.send_joint(topics.WINCH_REQUEST, machine.WINCH_TO_LENGTH, FAR, RATE)
    refusal = bench.observer.wait_for_refusal(topics.WINCH_REQUEST, "not_armed")
    assert topics.WINCH_REARM in refusal.message
    arm_winch(bench.observer)
    completion = order(harness, "payout", f"{START + 0.5}", "--rate", "0.1")
    assert completion["is_done"], completion
    bench.observer.listen(topics.WINCH_STATE).wait(
        lambda s: s.joints[machine.WINCH_DRUM].position == pytest.approx(START + 0.5, abs=0.01)
    )
    bench.observer.wait_for_text(topics.WINCH_MODE, WinchMode.HOLD)


@pytest.mark.ros
@pytest.mark.process
def test_crossing_thresholds_end_it_with_code_2(harness: NodeHarness):
    process = harness.processes.start(MODULE, {"touchdown_threshold": 0.9, "snag_threshold": 1.1})
    assert process.wait() == 2
    assert "further apart" in process.output
    assert "Traceback" not in process.output


@pytest.mark.ros
@pytest.mark.process
@pytest.mark.usefixtures("compiled")
def test_it_detects_slack_and_loss_of_the_planar_simulator(
    harness: NodeHarness,
):
    observer = harness.observer()
    observer.listen(topics.DIAGNOSTICS)
    harness.processes.start(MODULE, {"use_sim_time": True, "reference_weight": 49.0})
    sim = harness.processes.start("rover_sim.node.sim_node", {"scenario": "paper_table1_high"})
    observer.wait_for_text(topics.TENSION_WATCH, LoadState.SLACK)
    observer.listen(topics.WINCH_COMMAND).wait_for_count(20)
    refused = [
        status
        for sample in observer.listen(topics.DIAGNOSTICS).samples
        for status in sample.statuses
        if read_refusal(status) is not None
    ]
    assert not refused
    since = len(observer.listen(topics.TENSION_WATCH))
    sim.send(signal.SIGKILL)
    observer.wait_for_text(topics.TENSION_WATCH, LoadState.UNKNOWN, since=since)
    assert not [
        s for e in observer.listen(topics.EVENTS).samples for s in e.statuses
        if s.hardware_id == NODE and s.level is Level.ERROR
    ]  # fmt: skip
