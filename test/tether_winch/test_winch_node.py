"""winch_node as a process of its own, with a simulated mother machine or with the simulator."""

from __future__ import annotations

import json
import math
import signal
import threading
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import pytest
from graph import forbidden_to_controllers, subscriptions_of
from ros_messages import message_of
from winch_hoist import Hoist, HoistParameters
from winch_mother import Mother

from msg_schemas import topics
from msg_schemas.events import WinchEvent
from msg_schemas.faults import Reason, WinchFault
from msg_schemas.phases import LoadState, WinchMode
from msg_schemas.refusal import read_refusal
from msg_schemas.samples import JointSample, JointValue, Level, Status
from msg_schemas.table import (
    PAYOUT,
    TENSION,
    TETHER_OUT,
    WINCH_AT_RATE,
    WINCH_AT_TENSION,
    WINCH_DRUM,
    WINCH_SLACK,
    WINCH_TO_LENGTH,
)

if TYPE_CHECKING:
    from rover_verify.harness import NodeHarness, Observer, Process

pytestmark = [pytest.mark.ros, pytest.mark.process]

MODULE, NODE = "tether_winch.winch_node", "winch_node"
WEIGHT = 16.2


class Bench:
    """A winch node and its mother machine."""

    def __init__(self, process: Process, observer: Observer, mother: Mother) -> None:
        self.process = process
        self.observer = observer
        self.mother = mother
        self._since = 0  # events before the last one that was waited for

    def request(
        self, joint: str, position: float, velocity: float = 0.0, effort: float = 0.0
    ) -> None:
        value = JointValue(position, velocity, effort)
        sample = JointSample(self.mother.now_ns, {joint: value})
        self.observer.send(topics.WINCH_REQUEST, sample)

    def modes(self) -> int:
        return len(self.observer.listen(topics.WINCH_MODE))

    def arm(self) -> None:
        answer = self.observer.call(topics.WINCH_REARM)
        assert answer.success, answer.message
        self.observer.wait_for_text(topics.WINCH_MODE, WinchMode.HOLD)

    def lower(self, rate: float = 0.3) -> None:
        """Arm, and wait until the tether is paid out at a rate."""
        self.arm()
        self.request(WINCH_TO_LENGTH, 45.0, rate)
        self.mother.wait(lambda: self.mother.last.rate > 0.95 * rate, "the drum does not pay out")

    def wait_for_fault(self, fault: str, since: int) -> str:
        """Wait for the fault; returns its reason."""
        self.observer.wait_for_text(topics.WINCH_MODE, WinchMode.FAULT, since=since)
        return self.observer.wait_for_status(
            topics.EVENTS,
            lambda s: s.name == WinchEvent.FAULT and s.values.get("fault") == fault,
        ).message

    def wait_for_next(self, event: WinchEvent, reason: Reason) -> Status:
        """Wait for an event after the one that was waited for before."""
        found = self.observer.wait_for_event(event, self._since, reason=reason)
        self._since = len(self.observer.listen(topics.EVENTS))
        return found

    def wait_until_braked(self) -> None:
        """Wait until the drum stands, its brake closed and its motor without torque."""

        def braked() -> bool:
            last = self.mother.last
            return last.rate == 0.0 and not last.brake_is_open and last.current == 0.0

        self.mother.wait(braked, "the drum is not braked")


@pytest.fixture
def bench(harness: NodeHarness) -> Iterator[Bench]:
    yield from make_bench(harness, Hoist(HoistParameters(start_length=5.0)))


def make_bench(harness: NodeHarness, hoist: Hoist) -> Iterator[Bench]:
    hoist.step(None, 0.01)  # compile before time runs
    process = harness.processes.start(MODULE, {"use_sim_time": True})
    observer = harness.observer()
    observer.listen(topics.DIAGNOSTICS)
    observer.listen(topics.WINCH_MODE)
    mother = Mother(observer, hoist)
    mother.begin()
    observer.wait_for_text(topics.WINCH_MODE, WinchMode.DISARMED)
    observer.wait_until_ready(NODE)
    try:
        yield Bench(process, observer, mother)
    finally:
        mother.end()


# ------------------------------------------------------------------------------ arms and requests


def test_it_starts_disarmed_and_refuses_motion_with_the_reason(bench: Bench):
    bench.request(WINCH_TO_LENGTH, 10.0, 0.3)
    refusal = bench.observer.wait_for_refusal(topics.WINCH_REQUEST, "not_armed")
    assert topics.WINCH_REARM in refusal.message
    answer = bench.observer.call(topics.WINCH_HOLD)
    assert not answer.success
    assert "disarmed" in answer.message
    assert all(s.joints[WINCH_DRUM].velocity == 0.0 for s in commands(bench))


def commands(bench: Bench) -> list[JointSample]:
    return list(bench.observer.listen(topics.WINCH_COMMAND).samples)


def test_a_length_is_reached_and_held_by_the_brake(bench: Bench):
    bench.arm()
    since = bench.modes()
    bench.request(WINCH_TO_LENGTH, 6.0, 0.3)
    bench.observer.wait_for_text(topics.WINCH_MODE, WinchMode.LENGTH, since=since)
    bench.observer.wait_for_text(topics.WINCH_MODE, WinchMode.HOLD, since=since)
    bench.wait_until_braked()
    assert bench.mother.last.length == pytest.approx(6.0, abs=0.005)
    estimate = bench.observer.listen(topics.WINCH_ESTIMATE)
    bench.mother.wait_for(0.5)
    joints = estimate.last.joints
    assert joints[PAYOUT].position == pytest.approx(bench.mother.last.length, abs=1e-3)
    assert joints[TENSION][:2] == (1.0, 0.0)
    assert joints[TENSION].effort == pytest.approx(bench.mother.last.tension, rel=0.1)
    assert joints[TETHER_OUT].position == pytest.approx(0.005 * 6.0, rel=1e-3)


def test_each_refusal_states_value_limit_and_remedy(bench: Bench):
    bench.arm()
    for joint, value, code, words in (
        (WINCH_TO_LENGTH, (59.0, 0.3, 0.0), "out_of_limits", "2.2 .. 57.8 m"),
        (WINCH_TO_LENGTH, (10.0, 0.4, 0.0), "out_of_limits", "0.35 m/s"),
        (WINCH_AT_RATE, (0.0, 0.1, 100.0), "out_of_limits", "at most 40 N"),
        (WINCH_AT_TENSION, (0.0, 0.1, 0.1), "out_of_limits", "pay out without end"),
        (WINCH_AT_TENSION, (0.0, 0.1, 3.0), "wrong_phase", "set the rover down first"),
        (WINCH_SLACK, (1.0, 0.1, 0.0), "wrong_phase", "set it down first"),
    ):
        since = len(bench.observer.listen(topics.DIAGNOSTICS))
        bench.request(joint, *value)
        refusal = bench.observer.wait_for_refusal(topics.WINCH_REQUEST, code, since)
        assert words in refusal.message
    bad = JointSample(bench.mother.now_ns, {WINCH_AT_RATE: JointValue(0.0, 0.1)})
    message = message_of(topics.WINCH_REQUEST, bad)
    message.velocity[0] = math.nan
    bench.observer.publisher(topics.WINCH_REQUEST).publish(message)
    refusal = bench.observer.wait_for_refusal(topics.WINCH_REQUEST, "not_finite")
    assert "winch_rate.velocity is nan" in refusal.message
    message = message_of(topics.WINCH_REQUEST, bad)
    message.name = ["winch_somewhere"]
    bench.observer.publisher(topics.WINCH_REQUEST).publish(message)
    refusal = bench.observer.wait_for_refusal(topics.WINCH_REQUEST, "wrong_name")
    assert "winch_length" in refusal.message
    bench.mother.wait(lambda: bench.mother.time > 6.5, "time does not run")
    stale = JointSample(bench.mother.now_ns - 5_000_000_000, {WINCH_AT_RATE: JointValue(0.0, 0.1)})
    bench.observer.send(topics.WINCH_REQUEST, stale)
    bench.observer.wait_for_refusal(topics.WINCH_REQUEST, "stale")
    answer = bench.observer.call(topics.WINCH_RELAX)
    assert not answer.success
    assert "set the rover down first" in answer.message
    trim = JointSample(bench.mother.now_ns, {WINCH_DRUM: JointValue(0.0, 0.05, 0.0)})
    bench.observer.send(topics.WINCH_TRIM, trim)
    refusal = bench.observer.wait_for_refusal(topics.WINCH_TRIM, "wrong_phase")
    assert "in hold" in refusal.message
    assert bench.mother.last.rate == 0.0


def test_every_mode_works_with_the_rover_on_the_floor(harness: NodeHarness):
    hoist = Hoist(HoistParameters(start_length=5.4, floor_depth=5.6))
    for bench in make_bench(harness, hoist):
        use_every_mode(bench)


def use_every_mode(bench: Bench) -> None:
    bench.arm()
    bench.request(WINCH_TO_LENGTH, 10.0, 0.1)
    bench.wait_for_next(WinchEvent.HOLD, Reason.TOUCHDOWN)
    bench.request(WINCH_SLACK, 0.0)
    bench.wait_for_next(WinchEvent.HOLD, Reason.COMPLETED)
    mother, taut = bench.mother, bench.mother.last.length
    assert taut == pytest.approx(5.6, abs=0.01)

    bench.request(WINCH_SLACK, 0.3)
    bench.observer.wait_for_text(topics.WINCH_MODE, WinchMode.SLACK)
    reached = bench.wait_for_next(WinchEvent.SLACK_REACHED, Reason.COMPLETED)
    assert float(reached.values["slack"]) == pytest.approx(0.3, abs=0.01)
    bench.wait_until_braked()
    assert mother.last.length == pytest.approx(taut + 0.3, abs=0.01)

    since = bench.modes()
    for _ in range(16):
        bench.request(WINCH_AT_TENSION, 0.0, 0.2, 4.0)
        mother.wait_for(0.25)
    assert {s.text for s in bench.observer.listen(topics.WINCH_MODE).samples[since:]} == {"tension"}
    assert mother.last.tension == pytest.approx(4.0, abs=1.0)
    assert mother.last.length == pytest.approx(taut, abs=0.02)

    answer = bench.observer.call(topics.WINCH_RELAX)
    assert answer.success, answer.message
    bench.wait_for_next(WinchEvent.HOLD, Reason.COMPLETED)
    bench.wait_until_braked()
    assert mother.last.tension < 0.6
    assert mother.last.length == pytest.approx(taut, abs=0.03)

    begun = len(mother.history)
    bench.request(WINCH_AT_RATE, 0.0, -0.1)
    mother.wait(lambda: mother.last.rate < -0.095, "it does not reel in")
    assert bench.observer.call(topics.WINCH_HOLD).success
    bench.wait_for_next(WinchEvent.HOLD, Reason.REQUESTED)
    bench.wait_until_braked()
    rates = [r.rate for _, r, _ in mother.history[begun:]]
    assert max(abs(a - b) for a, b in pairwise(rates)) < 0.02

    assert bench.observer.call(topics.WINCH_STOP).success
    bench.observer.wait_for_text(topics.WINCH_MODE, WinchMode.STOP)


def test_an_operator_waits_until_the_slack_is_given_and_until_it_is_taken_up(
    harness: NodeHarness,
):
    hoist = Hoist(HoistParameters(start_length=5.8, floor_depth=5.6))
    for bench in make_bench(harness, hoist):
        bench.arm()
        for amount in (0.0, 0.3, 0.3, 0.0):
            completion = order(harness, "slack", str(amount))
            assert completion["is_done"], completion
            assert bench.mother.last.length == pytest.approx(5.6 + amount, abs=0.02)


def test_a_payout_that_another_operator_holds_near_its_goal_is_not_done(harness: NodeHarness):
    hoist = Hoist(HoistParameters(start_length=5.0))
    for bench in make_bench(harness, hoist):
        bench.arm()
        held = threading.Thread(target=hold_near, args=(bench, 5.5))
        held.start()
        completion = order(harness, "payout", "5.5", "--rate", "0.02")
        held.join()
        assert not completion["is_done"], completion
        assert bench.mother.last.length == pytest.approx(5.5, abs=0.05)


def hold_near(bench: Bench, goal: float) -> None:
    mother = bench.mother
    mother.wait(lambda: mother.last.length > goal - 0.03, "the drum does not come near the goal")
    assert bench.observer.call(topics.WINCH_HOLD).success


def order(harness: NodeHarness, *words: str) -> dict[str, Any]:
    """How a command ended that an operator waits for."""
    process = harness.processes.start(
        "operator_console.command_line", None, *words, "--wait", "--json", "--timeout", "60"
    )
    process.wait()
    completion = json.loads(process.output.splitlines()[-1])["completion"]
    assert isinstance(completion, dict), process.output
    return completion


# ------------------------------------------------------------------------------------------- safety


def silent_drum(bench: Bench) -> None:
    bench.mother.spoil = lambda name, m: None if name == topics.WINCH_STATE else m


def silent_cell(bench: Bench) -> None:
    bench.mother.spoil = lambda name, m: None if name == topics.LOAD_CELL else m


def corrupt_load_cell(value: float) -> Callable[[Bench], None]:
    def spoil(name: str, message: Any) -> Any:
        if name == topics.LOAD_CELL:
            message.wrench.force.z = -value
        return message

    def apply(bench: Bench) -> None:
        bench.mother.spoil = spoil

    return apply


def corrupt_drum(field: str, value: float) -> Callable[[Bench], None]:
    def spoil(name: str, message: Any) -> Any:
        if name == topics.WINCH_STATE:
            getattr(message, field)[0] = value
        return message

    def apply(bench: Bench) -> None:
        bench.mother.spoil = spoil

    return apply


def drum_runs_away(bench: Bench) -> None:
    begun: list[float] = []

    def spoil(name: str, message: Any) -> Any:
        if name == topics.WINCH_STATE:
            begun.append(message.position[0])
            message.velocity[0] = 1.0
            message.position[0] = begun[0] + 0.01 * len(begun)
        return message

    bench.mother.spoil = spoil


def clock_jumps_back(bench: Bench) -> None:
    bench.mother.jump(-0.7)


def clock_jumps_ahead(bench: Bench) -> None:
    bench.mother.jump(3.0)


def tether_ends(bench: Bench) -> None:
    assert bench.observer.set_parameter(NODE, "soft_margin", 0.0).successful
    assert bench.observer.set_parameter(NODE, "longest_length", bench.mother.last.length).successful


CASES = {
    "drum_lost": silent_drum,
    "tension_lost": silent_cell,
    "bad_reading": corrupt_load_cell(math.nan),
    "bad_reading ": corrupt_drum("position", math.nan),
    "overspeed": drum_runs_away,
    "drum_lost ": corrupt_drum("velocity", 0.1),
    "over_tension": corrupt_load_cell(5.0 * WEIGHT),
    "tether_end": tether_ends,
    "clock_jump": clock_jumps_back,
    "node_late": clock_jumps_ahead,
}


@pytest.mark.parametrize("case", list(CASES))
def test_an_unsafe_state_brakes_and_latches_a_fault_until_rearmed(bench: Bench, case: str):
    bench.lower(0.2)
    since = bench.modes()
    CASES[case](bench)
    reason = bench.wait_for_fault(case.strip(), since)
    assert reason.startswith(case.strip())
    assert len(reason) > len(case) + 10
    bench.wait_until_braked()
    begun = len(bench.mother.history)
    bench.mother.spoil = lambda _, message: message
    bench.mother.wait_for(0.5)
    bench.request(WINCH_TO_LENGTH, 2.5, 0.2)
    refusal = bench.observer.wait_for_refusal(topics.WINCH_REQUEST, "not_armed")
    assert case.strip() in refusal.message
    assert all(r.rate == 0.0 for _, r, _ in bench.mother.history[begun:])
    if case == "tether_end":
        bench.observer.set_parameter(NODE, "longest_length", 58.0)
    since = bench.modes()
    bench.arm()
    bench.request(WINCH_TO_LENGTH, 2.5, 0.2)
    bench.mother.wait(lambda: bench.mother.last.rate < -0.1, "it does not reel in again")


@pytest.mark.parametrize("mode", [WINCH_AT_RATE, WINCH_AT_TENSION])
def test_a_request_that_is_not_renewed_ends_in_a_fault(bench: Bench, mode: str):
    bench.arm()
    since = bench.modes()
    for _ in range(8):
        bench.request(mode, 0.0, 0.1, 0.0 if mode == WINCH_AT_RATE else 15.0)
        bench.mother.wait_for(0.25)
    assert "fault" not in {s.text for s in bench.observer.listen(topics.WINCH_MODE).samples[since:]}
    assert bench.mother.last.brake_is_open
    bench.wait_for_fault(WinchFault.COMMAND_TIMEOUT, since)
    bench.wait_until_braked()


def test_the_stop_service_brakes_at_once_and_stays_so(bench: Bench):
    bench.lower()
    since = bench.modes()
    assert bench.observer.call(topics.WINCH_STOP).success
    bench.observer.wait_for_text(topics.WINCH_MODE, WinchMode.STOP, since=since)
    bench.wait_until_braked()
    bench.request(WINCH_TO_LENGTH, 2.5, 0.2)
    bench.observer.wait_for_refusal(topics.WINCH_REQUEST, "not_armed")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_node_that_is_stopped_leaves_the_drum_braked(bench: Bench, number: signal.Signals):
    bench.lower()
    assert bench.process.stop(number) == 0
    last = commands(bench)[-1]
    assert last.joints[WINCH_DRUM][1:] == (0.0, 0.0)
    bench.wait_until_braked()
    assert bench.process.has_group_exited()
    assert "Traceback" not in bench.process.output


def test_deactivated_it_brakes(bench: Bench):
    bench.lower()
    assert bench.observer.change_state(NODE, "deactivate")
    bench.wait_until_braked()


@pytest.mark.parametrize("length", [5.0, 15.0, 45.0])
def test_killed_while_it_pays_out_the_drum_stops_in_time_and_softly(
    harness: NodeHarness, length: float
):
    for bench in make_bench(harness, Hoist(HoistParameters(start_length=length))):
        kill_while_paying_out(bench, length)


def kill_while_paying_out(bench: Bench, length: float) -> None:
    bench.arm()
    bench.request(WINCH_TO_LENGTH, length + 8.0, 0.3)
    mother = bench.mother
    mother.wait(lambda: mother.last.rate > 0.295, "the drum does not pay out")
    killed = len(mother.history)
    bench.process.send(signal.SIGKILL)
    bench.process.wait()
    mother.is_alone = True
    mother.wait(lambda: mother.last.rate == 0.0, "the drum does not stop")
    mother.wait_for(3.0)
    after = mother.history[killed:]
    stopped = next(t for t, r, _ in after if r.rate == 0.0)
    # The timeout, the ramp and the brake's delay; the drive may have the command of one tick more.
    assert stopped - after[0][0] == pytest.approx(0.26 + 0.3 / 0.4 + 0.02, abs=0.06)
    assert mother.last.length - after[0][1].length < 0.2
    assert not mother.last.brake_is_open
    load = WEIGHT + 0.005 * 1.62 * mother.last.length
    assert max(r.tension for _, r, _ in after) < 1.5 * load


# ----------------------------------------------------------------------------------------- the rest


def test_touchdown_is_reported_and_stops_the_payout(harness: NodeHarness):
    hoist = Hoist(HoistParameters(start_length=5.0, floor_depth=5.6))
    for bench in make_bench(harness, hoist):
        bench.arm()
        bench.request(WINCH_TO_LENGTH, 10.0, 0.1)
        event = bench.observer.wait_for_event(WinchEvent.TOUCHDOWN)
        assert float(event.values["length"]) == pytest.approx(5.65, abs=0.05)
        bench.wait_until_braked()
        assert hoist.slack < 0.15
        alarms = bench.observer.listen(topics.WINCH_ALARMS)
        alarms.wait(lambda s: s.joints["touchdown"].position == 1.0)
        alarms.wait(lambda s: s.joints["slack"].position == 1.0)
        bench.observer.wait_for_text(topics.TENSION_WATCH, LoadState.SLACK)
        bench.request(WINCH_TO_LENGTH, 10.0, 0.1)
        bench.observer.wait_for_refusal(topics.WINCH_REQUEST, "wrong_phase")


def test_it_subscribes_to_no_ground_truth(bench: Bench):
    subscribed = subscriptions_of(bench.observer, NODE)
    assert {topics.LOAD_CELL, topics.WINCH_STATE, topics.MOTOR_CURRENTS} <= subscribed
    assert not subscribed & forbidden_to_controllers()


def test_thresholds_are_checked_together_also_when_changed(bench: Bench):
    result = bench.observer.set_parameter(NODE, "snag_threshold", 1.1)
    assert result.successful
    result = bench.observer.set_parameter(NODE, "touchdown_threshold", 0.9)
    assert not result.successful
    assert "further apart" in result.reason
    assert bench.observer.get_parameter(NODE, "touchdown_threshold") == 0.5


def test_crossing_thresholds_end_it_with_code_2(harness: NodeHarness):
    process = harness.processes.start(MODULE, {"touchdown_threshold": 0.9, "snag_threshold": 1.1})
    assert process.wait() == 2
    assert "further apart" in process.output
    assert "Traceback" not in process.output


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
