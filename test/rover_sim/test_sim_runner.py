"""The simulation in its thread: pacing, requests, pause, end; without ROS, with a cheap plant."""

from __future__ import annotations

import math
import threading
import time
from typing import Any

import pytest
from fake_plant import fake_interface

from msg_schemas import machine, topics
from msg_schemas.events import EventReport, SimulationEvent
from msg_schemas.phases import PlantPhase
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample, JointValue
from rover_runtime.pacing import NANO, PacedThread
from rover_sim.node.sim_loop import Simulation, Tick
from rover_sim.node.sim_runner import SimRunner

PATIENCE = 30.0


class Listening:
    """Records the callbacks and their times."""

    def __init__(self) -> None:
        self.changed = threading.Condition()
        self.ticks: list[int] = []
        self.walls: list[float] = []
        self.event_reports: list[str] = []
        self.restarts = 0
        self.ends = 0
        self.error: Exception | None = None

    def _note(self, act: Any) -> None:
        with self.changed:
            act()
            self.changed.notify_all()

    def on_tick(self, tick: Tick[Any], before_ns: int) -> None:
        def note() -> None:
            self.ticks.append(tick.stamp_ns)
            self.walls.append(time.monotonic())
            self.event_reports.extend(h.name for h in tick.event_reports)

        self._note(note)

    def on_restart(self) -> None:
        self._note(lambda: setattr(self, "restarts", self.restarts + 1))

    def on_event(self, report: EventReport) -> None:
        self._note(lambda: self.event_reports.append(report.name))

    def on_finish(self) -> None:
        self._note(lambda: setattr(self, "ends", self.ends + 1))

    def on_crash(self, error: Exception) -> None:
        self._note(lambda: setattr(self, "error", error))

    def wait(self, condition: Any) -> None:
        with self.changed:
            assert self.changed.wait_for(condition, PATIENCE)


@pytest.fixture
def listening() -> Listening:
    return Listening()


class Running:
    """Starts a runner and stops it at the end of the block."""

    def __init__(self, listening: Listening, factor: float, **options: Any) -> None:
        outside = fake_interface(diverges_at=options.pop("diverges_at", math.inf))
        self.plant = outside.plant
        self.runner = SimRunner(
            Simulation(outside, 0.01), factor, listening, PacedThread, **options
        )

    def __enter__(self) -> SimRunner:
        self.runner.start()
        return self.runner

    def __exit__(self, *_: object) -> None:
        self.runner.stop()


def nut(position: float, stamp_ns: int = 0) -> JointSample:
    return JointSample(stamp_ns, {machine.JUMP_SCREW: JointValue(position, 0.1, 400.0)})


def test_as_fast_as_possible_ends_after_the_duration(listening: Listening):
    with Running(listening, 0.0, duration=5.0) as runner:
        listening.wait(lambda: listening.ends == 1)
        assert runner.stamp_ns == 5 * NANO
        assert runner.paused
    assert listening.ticks == [i * 10_000_000 for i in range(1, 501)]


def test_ticks_keep_the_real_time_factor(listening: Listening):
    with Running(listening, 2.0, duration=1.0) as runner:
        listening.wait(lambda: listening.ends == 1)
        # It cannot be too fast; how slow it is depends on the machine.
        first, last = listening.walls[0], listening.walls[-1]
        assert last - first >= 0.49 - runner.pacer.CATCH_UP
        assert runner.pacer.measured is not None


def test_a_request_is_served_while_the_thread_waits_for_a_tick(listening: Listening):
    with Running(listening, 1e-3) as runner:  # a tick every ten seconds
        listening.wait(lambda: listening.ticks)
        begin = time.monotonic()
        runner.command(topics.JUMP_MOTOR_COMMAND, nut(0.1))
        assert time.monotonic() - begin < 5.0


def test_a_refusal_reaches_the_caller_and_the_simulation_continues(listening: Listening):
    with Running(listening, 0.0) as runner:
        with pytest.raises(Refusal) as caught:
            runner.command(
                topics.JUMP_MOTOR_COMMAND,
                JointSample(0, {machine.JUMP_SCREW: JointValue(0.2, 0.1, 1.0)}),
            )
        assert caught.value.code is RefusalCode.OUT_OF_LIMITS
        count = len(listening.ticks)
        listening.wait(lambda: len(listening.ticks) > count)


def test_a_paused_simulation_steps_by_single_ticks(listening: Listening):
    with Running(listening, 0.0, paused=True) as runner:
        listening.wait(lambda: listening.restarts == 1)
        assert runner.step() == "at 0.01 s"
        assert runner.step() == "at 0.02 s"
        assert listening.ticks == [10_000_000, 20_000_000]
        assert runner.pause(True) == "already paused"
        assert runner.pause(False) == "resumed at 0.02 s"
        listening.wait(lambda: len(listening.ticks) > 10)
        runner.pause(True)
        count = len(listening.ticks)
        runner.step()
        assert len(listening.ticks) == count + 1
    assert listening.event_reports == [SimulationEvent.RESUMED, SimulationEvent.PAUSED]


def test_a_step_while_running_is_refused(listening: Listening):
    with Running(listening, 1.0) as runner, pytest.raises(Refusal) as caught:
        runner.step()
    assert caught.value.code is RefusalCode.WRONG_PHASE


def test_reset_goes_back_to_zero_and_reset_plant_does_not(listening: Listening):
    with Running(listening, 0.0, paused=True) as runner:
        for _ in range(3):
            runner.step()
        runner.reset(clock=False)
        assert runner.stamp_ns == 30_000_000
        assert runner._stepper.call(lambda: runner.simulation.state.time) == 0.0
        runner.reset(clock=True)
        assert runner.stamp_ns == 0
        assert listening.restarts == 3
    assert listening.event_reports == [SimulationEvent.PLANT_RESET, SimulationEvent.RESET]


def test_with_a_diverged_plant_time_continues_in_real_time(listening: Listening):
    running = Running(listening, 0.0, diverges_at=0.05)
    with running as runner:
        listening.wait(lambda: "diverged" in listening.event_reports)
        count = len(listening.ticks)
        listening.wait(lambda: len(listening.ticks) > count + 3)
        assert runner.pacer.factor == 1.0
        assert runner.simulation.phase is PlantPhase.DIVERGED
        running.plant.diverges_at = math.inf
        runner.reset(clock=True)
        assert runner.pacer.factor == 0.0


def test_a_diverged_plant_ends_a_run_of_given_duration(listening: Listening):
    with Running(listening, 0.0, diverges_at=0.05, duration=1e6):
        listening.wait(lambda: listening.ends == 1)


def test_stopped_and_started_again_it_continues(listening: Listening):
    running = Running(listening, 0.0)
    with running as runner:
        listening.wait(lambda: len(listening.ticks) > 10)
    stamp = runner.stamp_ns
    assert stamp == listening.ticks[-1]
    with pytest.raises(Refusal) as caught:
        runner.pause(True)
    assert caught.value.code is RefusalCode.NOT_ACTIVE
    with running:
        listening.wait(lambda: listening.ticks[-1] > stamp)
    assert listening.ticks == sorted(listening.ticks)


def test_an_error_in_the_plant_is_reported(listening: Listening):
    running = Running(listening, 0.0)
    with running as runner:
        running.plant.error = RuntimeError("a bug")
        listening.wait(lambda: listening.error is not None)
        assert "a bug" in str(listening.error)
        # No caller waits for an answer that cannot come.
        with pytest.raises(Refusal):
            runner.pause(True)


def test_a_request_to_a_stopped_simulation_is_not_served_after_a_restart(
    listening: Listening,
):
    running = Running(listening, 0.0, paused=True)
    with running as runner:
        listening.wait(lambda: listening.restarts == 1)
    with pytest.raises(Refusal):
        runner.step()
    with running:
        listening.wait(lambda: listening.restarts == 2)
        assert runner._stepper.call(lambda: runner.stamp_ns) == 0
