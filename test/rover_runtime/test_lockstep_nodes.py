"""Lockstep over DDS: real processes publish what the loop host does, however they are disturbed."""

from __future__ import annotations

import signal
import threading
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from pilot_node import LENGTH, Pilot

from msg_schemas import machine, topics
from msg_schemas.events import NodeEvent
from msg_schemas.samples import JointSample, Sample
from rover_runtime.delays import Delays
from rover_runtime.loop_host import LoopHost
from rover_sim.node.mock_plant_node import MockPlantNode
from tether_winch.winch_node import WinchNode

if TYPE_CHECKING:
    from rover_verify.harness import Observer, Process, Processes

pytestmark = [pytest.mark.ros, pytest.mark.process]

TUTORIALS = Path(__file__).parents[2] / "docs" / "tutorials"
APART = "mock_plant,winch_node,pilot"
TOGETHER = "all=mock_plant+winch_node+pilot"
SEED = 5
STANDSTILL = 1.0  # wall time [s]
OVER = 20.0  # simulated time, after the motion [s]
STAMPED = (topics.WINCH_STATE, topics.WINCH_COMMAND, topics.WINCH_ESTIMATE, topics.LOAD_CELL)
MODULES = {"mock_plant": "rover_sim.node.mock_plant_node", "winch_node": "tether_winch.winch_node",
           "pilot": "pilot_node"}  # fmt: skip

ByStamp = dict[str, dict[int, Sample]]


@pytest.fixture(scope="module")
def expected() -> ByStamp:
    """What the loop host publishes."""
    host = LoopHost(Delays(SEED), order=APART.split(","))
    found: ByStamp = {name: {} for name in STAMPED}

    def listen(name: str, sample: Sample, _sender: str, _now_ns: int) -> None:
        assert isinstance(sample, JointSample) or name == topics.LOAD_CELL
        found[name][getattr(sample, "stamp_ns", 0)] = sample

    host.exchange.listen(listen, *STAMPED)
    for kind in (MockPlantNode, WinchNode, Pilot):
        host.start(kind)
    host.run(OVER + 1.0)
    state = max(found[topics.WINCH_STATE].items())[1]
    assert isinstance(state, JointSample)
    assert state.joints[machine.WINCH_DRUM].position == pytest.approx(LENGTH, abs=0.01)
    return found


def start(processes: Processes, *names: str, lockstep: str = APART) -> list[Process]:
    shared = {"lockstep": lockstep, "delay_seed": SEED}
    own = {"mock_plant": {"real_time_factor": 4.0}}
    return [processes.start(MODULES[name], {**shared, **own.get(name, {})}) for name in names]


def compared(observer: Observer, expected: ByStamp) -> int:
    """Compare what was received to the loop host, stamp by stamp; returns how many samples."""
    count = 0
    for name in STAMPED:
        for sample in observer.listen(name).samples:
            if sample.stamp_ns in expected[name]:
                assert sample == expected[name][sample.stamp_ns], name
                count += 1
    return count


def listen(observer: Observer) -> None:
    for name in (*STAMPED, topics.EVENTS):
        observer.listen(name)


def wait_for(observer: Observer, seconds: float) -> None:
    observer.listen(topics.WINCH_STATE).wait(lambda s: s.stamp_ns >= seconds * 1e9, timeout=120.0)


def test_three_processes_publish_what_the_loop_host_does(
    processes: Processes, observer: Observer, expected: ByStamp
):
    listen(observer)
    start(processes, *MODULES)
    wait_for(observer, OVER)
    assert compared(observer, expected) > 3000


def test_processes_that_stand_still_for_a_second_change_nothing(
    processes: Processes, observer: Observer, expected: ByStamp
):
    listen(observer)
    started = start(processes, *MODULES)
    for process, seconds in zip(started, (2.0, 4.0, 6.0), strict=True):
        wait_for(observer, seconds)
        process.send(signal.SIGSTOP)
        threading.Event().wait(STANDSTILL)
        process.send(signal.SIGCONT)
    wait_for(observer, OVER)
    assert compared(observer, expected) > 3000
    named = (NodeEvent.PARTICIPANT_EXCLUDED, NodeEvent.PARTICIPANT_JOINED)
    events = [s.name for each in observer.listen(topics.EVENTS).samples for s in each.statuses]
    assert not [name for name in events if name in named]


def test_one_process_publishes_what_three_do(
    processes: Processes, observer: Observer, expected: ByStamp
):
    listen(observer)
    parameters = {"lockstep": TOGETHER, "delay_seed": SEED}
    processes.start("composed_pilot", parameters)
    wait_for(observer, OVER)
    assert compared(observer, expected) > 3000


def test_time_waits_for_a_plain_node_that_joins(
    processes: Processes, observer: Observer, expected: ByStamp, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("PYTHONPATH", str(TUTORIALS))
    listen(observer)
    start(processes, "mock_plant", "winch_node")
    pilot = processes.start("plain_node", None, "mock_plant")
    wait_for(observer, OVER)
    assert compared(observer, expected) > 3000
    pilot.send(signal.SIGINT)
    observer.wait_for_event(NodeEvent.PARTICIPANT_EXCLUDED, process="pilot")
    assert pilot.wait() == 0, pilot.output
    assert "hold" in pilot.output


def test_time_waits_two_seconds_for_one_that_is_killed_and_takes_it_back(
    processes: Processes, observer: Observer
):
    listen(observer)
    started = start(processes, *MODULES)
    wait_for(observer, 3.0)
    started[1].send(signal.SIGKILL)
    observer.wait_for_event(NodeEvent.PARTICIPANT_EXCLUDED, process="winch_node")
    stamp_ns = observer.listen(topics.WINCH_STATE).last.stamp_ns
    wait_for(observer, stamp_ns * 1e-9 + 2.0)
    start(processes, "winch_node")
    observer.wait_for_event(NodeEvent.PARTICIPANT_JOINED, process="winch_node")
    stamp_ns = observer.listen(topics.WINCH_STATE).last.stamp_ns
    observer.listen(topics.WINCH_COMMAND).wait(lambda s: s.stamp_ns > stamp_ns)
    wait_for(observer, stamp_ns * 1e-9 + 2.0)
