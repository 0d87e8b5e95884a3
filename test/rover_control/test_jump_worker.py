"""Predictions of jump_node's worker process, in lockstep over DDS and beside the loop host."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from jump_pilot_node import REQUESTED_AT, JumpPilot

from msg_schemas import topics
from msg_schemas.commands import CommandRecord, CommandState, read_command
from msg_schemas.events import JumpEvent
from msg_schemas.faults import Reason
from msg_schemas.samples import JointSample, Sample, StatusSample
from rover_control.drive.drive_node import DriveNode
from rover_control.jump.jump_node import JumpNode
from rover_runtime.delays import Delays
from rover_runtime.loop_host import LoopHost
from rover_sim.node.mock_plant_node import MockPlantNode

if TYPE_CHECKING:
    from rover_verify.harness import Observer, Process, Processes

pytestmark = [
    pytest.mark.ros,
    pytest.mark.process,
    pytest.mark.slow,
    pytest.mark.usefixtures("compiled_in_space"),
]

MEMBERS = ("mock_plant", "drive_node", "jump_node", "jump_pilot")
MODULES = {
    "mock_plant": "rover_sim.node.mock_plant_node",
    "drive_node": "rover_control.drive.drive_node",
    "jump_node": "rover_control.jump.jump_node",
    "jump_pilot": "jump_pilot_node",
}
ON_FLOOR: dict[str, object] = {
    "scenario": "floor_rubble",
    "overrides": json.dumps({"start.kind": "grounded"}),
}
PARAMETERS: dict[str, dict[str, object]] = {"mock_plant": ON_FLOOR, "jump_node": {"rollouts": 8}}
SEED = 3
DURATION = 2.0  # of a prediction, simulated [s]
TIMEOUT = 300.0  # wall time [s]


def start(processes: Processes, rollouts: int = 8) -> Process:
    """Start all processes in lockstep; returns that of jump_node."""
    own: dict[str, dict[str, object]] = {**PARAMETERS, "jump_node": {"rollouts": rollouts}}
    shared: dict[str, object] = {"lockstep": ",".join(MEMBERS), "delay_seed": SEED}
    started = {
        name: processes.start(MODULES[name], {**shared, **own.get(name, {})}) for name in MEMBERS
    }
    return started["jump_node"]


def worker_of(process: Process) -> int:
    """Number of the worker process of a node."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == process.pid and b"worker_process" in (folder / "cmdline").read_bytes():
                found.append(int(folder.name))
        except OSError:
            continue  # it has ended
    (only,) = found
    return only


def ended(samples: list[Sample]) -> list[CommandRecord]:
    """Records of requests for a prediction that have ended."""
    statuses = [s for each in samples if isinstance(each, StatusSample) for s in each.statuses]
    records = [record for s in statuses if (record := read_command(s)) is not None]
    return [r for r in records if r.subject == topics.JUMP_REQUEST and r.state.is_over]


def test_predictions_are_those_of_the_loop_host(processes: Processes, observer: Observer):
    predictions = observer.listen(topics.JUMP_PREDICTION)
    commands = observer.listen(topics.COMMANDS)
    start(processes)
    expected: dict[str, list[Sample]] = {topics.JUMP_PREDICTION: [], topics.COMMANDS: []}
    host = LoopHost(Delays(SEED), order=MEMBERS)
    host.exchange.listen(lambda name, sample, *_: expected[name].append(sample), *expected)
    for kind in (MockPlantNode, DriveNode, JumpNode, JumpPilot):
        host.start(kind, PARAMETERS.get(kind.NAME))
    host.run(REQUESTED_AT[1] + 2.0 * DURATION)
    predicted = expected[topics.JUMP_PREDICTION]
    stamps = [each.stamp_ns for each in predicted if isinstance(each, JointSample)]
    assert stamps == pytest.approx([1e9 * (at + DURATION) for at in REQUESTED_AT[:2]], abs=2e8)
    predictions.wait(lambda s: s.stamp_ns == stamps[1], timeout=TIMEOUT)
    assert predictions.samples[:2] == predicted
    observer.wait_until(lambda: len(ended(commands.samples)) >= 2, "no second record")
    assert ended(commands.samples)[:2] == ended(expected[topics.COMMANDS])


@pytest.mark.parametrize(
    ("number", "rollouts"),
    [(signal.SIGKILL, 48), (signal.SIGSTOP, 8)],  # the longer one is killed while it computes
)
def test_a_worker_that_dies_or_hangs_fails_one_prediction(
    processes: Processes, observer: Observer, number: signal.Signals, rollouts: int
):
    commands, events = observer.listen(topics.COMMANDS), observer.listen(topics.EVENTS)
    process = start(processes, rollouts)
    observer.wait_for_event(JumpEvent.PREDICTED)
    worker = worker_of(process)
    if number is signal.SIGKILL:
        observer.wait_for_event(JumpEvent.PREDICTING, since=len(events))
    os.kill(worker, number)
    event = observer.wait_for_event(JumpEvent.NOT_STARTED)
    assert "the worker process" in event.message
    observer.wait_until(lambda: len(ended(commands.samples)) >= 3, "no third record", TIMEOUT)
    first, second, third = ended(commands.samples)
    assert (second.state, second.reason) == (CommandState.FAILED, Reason.FAULT)
    assert first.state is third.state is CommandState.DONE
    assert first.result["upright"] == third.result["upright"]
    assert worker_of(process) != worker
