"""winch_node as a process of its own, with the simulator or with a mother machine of the test's."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
from graph import forbidden_to_controllers, subscriptions_of

from msg_schemas import topics
from msg_schemas.codecs import encode
from msg_schemas.samples import JointSample, JointValue, Level, WrenchSample
from msg_schemas.table import WINCH_BRAKE, WINCH_DRUM, WINCH_LIMIT

if TYPE_CHECKING:
    from rover_verify.stage import Observer, Process, Processes, Stage

pytestmark = [pytest.mark.ros, pytest.mark.process]

MODULE, NODE = "tether_winch.winch_node", "winch_node"


class LoadCell:
    """Speaks at 50 Hz in a thread of its own, what it is told to say."""

    def __init__(self, observer: Observer) -> None:
        self._observer = observer
        self._publisher = observer.publisher(topics.LOAD_CELL)
        self._ended = threading.Event()
        self.tension: float | None = 10.0  # None = silent
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._ended.wait(0.02):
            tension = self.tension
            if tension is None:
                continue
            message = encode(topics.LOAD_CELL, WrenchSample(time.time_ns(), (0.0, 0.0, -1.0)))
            message.wrench.force.z = -tension
            self._publisher.publish(message)

    def end(self) -> None:
        self._ended.set()
        self._thread.join()


@pytest.fixture
def winch(stage: Stage) -> tuple[Process, Observer]:
    process = stage.processes.start(MODULE, {"weight_reference": 10.0})
    observer = stage.observer()
    observer.listen(topics.DIAGNOSTICS)
    observer.wait_for_text(topics.TENSION_WATCH, "unknown")
    return process, observer


@pytest.fixture
def load_cell(winch: tuple[Process, Observer]) -> Iterator[LoadCell]:
    made = LoadCell(winch[1])
    yield made
    made.end()


def words(observer: Observer) -> int:
    return len(observer.listen(topics.TENSION_WATCH))


def test_tension_is_watched_and_each_change_told_with_its_reason(
    winch: tuple[Process, Observer], load_cell: LoadCell
):
    _, observer = winch
    observer.wait_for_text(topics.TENSION_WATCH, "normal")
    for tension, word, level in (
        (1.0, "slack", Level.OK),
        (10.0, "normal", Level.OK),
        (45.0, "over_tension", Level.ERROR),
        (10.0, "normal", Level.OK),
    ):
        since, events = words(observer), len(observer.listen(topics.EVENTS))
        load_cell.tension = tension
        observer.wait_for_text(topics.TENSION_WATCH, word, since=since)
        event = observer.wait_for_event(f"tension_{word}", events)
        assert event.level is level
        assert float(event.values["tension"]) == pytest.approx(tension)


@pytest.mark.parametrize("tension", [None, math.nan, -math.inf])
def test_a_load_cell_that_is_silent_or_says_nonsense_makes_it_unknown(
    winch: tuple[Process, Observer], load_cell: LoadCell, tension: float | None
):
    process, observer = winch
    observer.wait_for_text(topics.TENSION_WATCH, "normal")
    since = words(observer)
    load_cell.tension = tension
    observer.wait_for_text(topics.TENSION_WATCH, "unknown", since=since)
    if tension is not None:
        observer.wait_for_refusal(topics.LOAD_CELL, "not_finite")
    since = words(observer)
    load_cell.tension = 10.0
    observer.wait_for_text(topics.TENSION_WATCH, "normal", since=since)
    assert process.is_running


def test_the_drum_is_held_at_the_length_at_which_it_first_stood(
    winch: tuple[Process, Observer],
):
    _, observer = winch
    commands = observer.listen(topics.WINCH_COMMAND)
    observer.wait_for_status(
        topics.DIAGNOSTICS, lambda s: s.name == f"{NODE}: drum" and s.level is Level.WARN
    )
    assert not commands.samples
    for length in (12.5, 13.0):
        value = {WINCH_DRUM: JointValue(length, 0.0, 10.0), WINCH_BRAKE: JointValue()}
        observer.send(topics.WINCH_STATE, JointSample(time.time_ns(), value))
    held = commands.wait_for_count(20)
    assert {s.joints[WINCH_DRUM] for s in held} == {JointValue(12.5)}
    assert {s.joints[WINCH_BRAKE].position for s in held} == {0.0}
    assert {s.joints[WINCH_LIMIT].effort for s in held} == {1000.0}
    stamps = [s.stamp_ns for s in held]
    assert (stamps[-1] - stamps[0]) / 19e9 == pytest.approx(0.05, rel=0.5)


def test_it_hears_no_truth_of_the_simulator(winch: tuple[Process, Observer]):
    heard = subscriptions_of(winch[1], NODE)
    assert topics.LOAD_CELL in heard
    assert not heard & forbidden_to_controllers()


def test_thresholds_are_checked_together_also_when_changed(winch: tuple[Process, Observer]):
    _, observer = winch
    result = observer.set_parameter(NODE, "over_above", 1.0)
    assert result.successful
    result = observer.set_parameter(NODE, "slack_below", 0.9)
    assert not result.successful
    assert "further apart" in result.reason
    assert observer.get_parameter(NODE, "slack_below") == 0.5


def test_thresholds_that_cross_end_it_with_code_2(processes: Processes):
    process = processes.start(MODULE, {"slack_below": 1.0, "over_above": 1.0})
    assert process.wait() == 2
    assert "further apart" in process.output
    assert "Traceback" not in process.output


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_cleanly(winch: tuple[Process, Observer], number: signal.Signals):
    process, _ = winch
    assert process.stop(number) == 0
    assert process.group_is_gone()
    assert "Traceback" not in process.output


# ------------------------------------------------------------------------------ with the simulator


@pytest.mark.usefixtures("compiled")
def test_with_the_simulator_it_holds_and_sees_the_slack_tether_and_the_simulator_s_death(
    stage: Stage,
):
    observer = stage.observer()
    observer.listen(topics.DIAGNOSTICS)
    stage.processes.start(MODULE, {"use_sim_time": True, "weight_reference": 49.0})
    sim = stage.processes.start("rover_sim.sim_node", {"scenario": "paper_table1_high"})
    observer.wait_for_text(topics.TENSION_WATCH, "slack")
    observer.listen(topics.WINCH_COMMAND).wait_for_count(20)
    refused = [
        status
        for sample in observer.listen(topics.DIAGNOSTICS).samples
        for status in sample.statuses
        if "refused" in status.name
    ]
    assert not refused
    since = words(observer)
    sim.send(signal.SIGKILL)
    observer.wait_for_text(topics.TENSION_WATCH, "unknown", since=since)
