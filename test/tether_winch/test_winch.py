"""The winch: modes, refusals, trim, tension and stalls of winch_node with the simulator."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from msg_schemas import machine, topics
from msg_schemas.events import WinchEvent
from msg_schemas.faults import Reason, WinchFault
from msg_schemas.phases import JumpPhase, WinchMode
from msg_schemas.refusal import Refusal, RefusalCode, RefusalReport
from msg_schemas.samples import JointSample, JointValue, TextSample, WrenchSample
from rover_verify.checks.winch_flights import chord, fly_winch, is_at_rest, request
from rover_verify.checks.winch_record import WinchRecord, WinchRecorder
from rover_verify.harness.flight import Flight
from tether_winch.estimates import EstimateParameters, PayoutEstimate
from tether_winch.winch import WinchController
from tether_winch.winch_parameters import WinchParameters

DEPTH, AWAY = 10.0, 1.0  # of a floor below the fairlead; of the rover from the plumb line [m]
TICK_NS = 10_000_000


def hanging(length: float = 10.0, **parameters: object) -> Flight:
    overrides = {"tether.length": length, "sensors.error_model": "ideal"}
    return fly_winch(overrides, 1, parameters={"winch_node": parameters})


def standing(slack: float = 0.5) -> Flight:
    """The rover stands on a floor with a slack tether."""
    overrides = {
        "environment.floor": {"height": -DEPTH, "material": "rock"},
        "start.kind": "grounded",
        "start.position": [AWAY, 0.0],
        "start.settling_time": 300.0,
        "tether.length": round(math.hypot(DEPTH - 0.44, AWAY) + slack, 3),
        "sensors.error_model": "ideal",
    }
    flight = fly_winch(overrides, 1)
    flight.run(2.5)
    assert flight.winch.sensing.load.is_supported
    return flight


def run_until_rest(flight: Flight, limit: float) -> None:
    assert flight.run(limit, lambda: is_at_rest(flight))


def renew(flight: Flight, times: int, joint: str, *value: float) -> None:
    """Request a motion each half second."""
    for _ in range(times):
        flight.request(topics.WINCH_REQUEST, joint, *value)
        flight.run(0.5)


def report_jump(flight: Flight, phase: JumpPhase) -> None:
    flight.host.request(topics.JUMP_PHASE, TextSample(phase))
    flight.run(1.0)


def refused(flight: Flight, *value: object) -> RefusalReport:
    request(flight, *value)  # type: ignore[arg-type]
    return flight.refusals[-1][1]


def reported(flight: Flight, event: WinchEvent) -> list[float]:
    return [each.time for each in flight.events_named(event)]


def test_a_length_is_reached_without_overshoot_and_braked():
    flight = hanging()
    recorder = WinchRecorder(flight)
    request(flight, machine.WINCH_TO_LENGTH, 14.0, 0.3)
    run_until_rest(flight, 30.0)
    flight.run(0.5)
    record = recorder.record()
    assert flight.winch.mode is WinchMode.HOLD
    assert flight.state.length == pytest.approx(14.0, abs=0.003)
    assert record["length"].max() < 14.003
    assert record.length_error() < 0.01
    assert flight.state.drives.drum.braked
    assert flight.result.forces.winch_current == 0.0


def test_a_second_step_at_the_same_time_returns_the_same_command():
    flight = hanging()
    request(flight, machine.WINCH_TO_LENGTH, 14.0, 0.3)
    flight.run(3.0)
    command = flight.winch.step(flight.now_ns)
    assert command is not None
    assert command.rate > 0.1
    assert flight.winch.step(flight.now_ns) == command


def test_a_length_request_that_is_not_renewed_in_motion_ends_in_a_hold():
    flight = hanging()
    renew(flight, 8, machine.WINCH_WHILE_RENEWED, 14.0, 0.3)
    assert flight.phases[topics.WINCH_MODE] == WinchMode.LENGTH
    assert len(reported(flight, WinchEvent.HOLD)) == 1  # when it was armed
    renewed, length = flight.time - 0.5, flight.state.length
    run_until_rest(flight, 10.0)
    (held,) = reported(flight, WinchEvent.MOTION_ABORTED)
    timeout = flight.winch.parameters.faults.command_timeout
    assert held - renewed == pytest.approx(timeout, abs=0.1)
    assert flight.state.length - length < 0.7
    assert flight.winch.fault is None
    renew(flight, 26, machine.WINCH_WHILE_RENEWED, 14.0, 0.3)
    assert flight.state.length == pytest.approx(14.0, abs=0.003)
    flight.run(2.0)  # at the length it needs no renewal
    assert flight.phases[topics.WINCH_MODE] == WinchMode.HOLD
    request(flight, machine.WINCH_TO_LENGTH, 12.0, 0.3)  # nor does a plain length request
    flight.run(3.0)
    assert flight.phases[topics.WINCH_MODE] == WinchMode.LENGTH


def test_changes_of_the_rate_to_the_same_length_publish_the_mode_once():
    flight = hanging()
    for step in range(12):
        renew(flight, 1, machine.WINCH_WHILE_RENEWED, 14.0, 0.3 * 0.95**step)
    assert len(reported(flight, WinchEvent.LENGTH)) == 1
    assert flight.plant.payout_rate(flight.state) == pytest.approx(0.3 * 0.95**11, rel=0.05)
    renew(flight, 8, machine.WINCH_WHILE_RENEWED, 14.0, 0.05)
    assert flight.plant.payout_rate(flight.state) == pytest.approx(0.05, rel=0.1)
    assert len(reported(flight, WinchEvent.LENGTH)) == 1
    request(flight, machine.WINCH_WHILE_RENEWED, 13.9, 0.05)
    assert len(reported(flight, WinchEvent.LENGTH)) == 2


@pytest.mark.parametrize(
    ("joint", "value"),
    [
        (machine.WINCH_WHILE_RENEWED, (14.0, 0.3)),
        (machine.WINCH_AT_RATE, (0.0, 0.1)),
        (machine.WINCH_AT_TENSION, (0.0, 0.1, 12.0)),
    ],
)
def test_a_renewal_in_transit_does_not_move_a_held_winch(joint: str, value: tuple[float, ...]):
    flight = hanging()
    renew(flight, 2, joint, *value)
    flight.host.call(topics.WINCH_HOLD)
    flight.run(0.05)
    refusal = refused(flight, joint, *value)
    assert refusal.code is RefusalCode.WRONG_PHASE
    assert "held 0.0" in refusal.reason
    assert flight.phases[topics.WINCH_MODE] == WinchMode.HOLD
    request(flight, machine.WINCH_WHILE_RENEWED, 9.0, 0.3)  # another motion
    assert flight.phases[topics.WINCH_MODE] == WinchMode.LENGTH
    flight.call(topics.WINCH_HOLD)
    flight.run(0.3)
    request(flight, joint, *value)
    assert flight.phases[topics.WINCH_MODE] != WinchMode.HOLD


def test_a_stop_closes_the_brake_of_a_winch_that_slows_down_after_a_fault():
    flight = hanging()
    renew(flight, 6, machine.WINCH_AT_RATE, 0.0, 0.3)
    assert flight.run(2.0, lambda: flight.winch.fault is WinchFault.COMMAND_TIMEOUT)
    flight.run(0.05)
    flight.call(topics.WINCH_STOP)
    assert flight.winch.mode is WinchMode.FAULT
    command = flight.winch.step(flight.now_ns)
    assert command is not None
    assert not command.release_brake


def test_another_continuous_torque_of_the_motor_applies_at_once():
    parameters = WinchParameters()
    winch = WinchController(parameters)
    drum = parameters.drum
    winch.sensing.heat.step(drum.motor_continuous_torque, 1e6)
    assert winch.sensing.heat.allowed == pytest.approx(drum.motor_continuous_torque)
    winch.retune(
        replace(parameters, drum=replace(drum, motor_continuous_torque=0.5 * drum.motor_torque))
    )
    assert winch.sensing.heat.heat == pytest.approx(1.0)
    assert winch.sensing.heat.allowed == pytest.approx(0.5 * drum.motor_torque)


def test_small_changes_of_a_rate_publish_the_mode_once():
    flight = hanging()
    for rate in (0.1, 0.105, 0.1):
        renew(flight, 3, machine.WINCH_AT_RATE, 0.0, rate)
        assert flight.plant.payout_rate(flight.state) == pytest.approx(rate, abs=0.003)
    assert len(reported(flight, WinchEvent.RATE)) == 1
    renew(flight, 1, machine.WINCH_AT_RATE, 0.0, 0.05)
    assert len(reported(flight, WinchEvent.RATE)) == 2


def test_a_stalled_node_does_not_end_a_motion_before_it_began():
    flight = hanging()
    request(flight, machine.WINCH_TO_LENGTH, 11.0, 0.3)
    flight.host.freeze("winch_node")
    flight.run(0.14)
    flight.host.thaw("winch_node")
    flight.run(0.3)
    assert flight.phases[topics.WINCH_MODE] == WinchMode.LENGTH
    run_until_rest(flight, 20.0)
    assert flight.state.length == pytest.approx(11.0, abs=0.003)


def test_a_stalled_controller_does_not_time_its_sensors_out():
    winch = WinchController(WinchParameters())

    def receive(now_ns: int) -> None:
        drum = {machine.WINCH_DRUM: JointValue(10.0), machine.WINCH_BRAKE: JointValue()}
        winch.sensing.on_drum(JointSample(now_ns, drum), now_ns)
        winch.sensing.on_load_cell(WrenchSample(now_ns, (0.0, 0.0, -16.2)), now_ns)

    for tick in range(20):
        receive(tick * TICK_NS)
        winch.step(tick * TICK_NS)
    winch.rearm(19 * TICK_NS)
    winch.step(34 * TICK_NS)  # before it receives the queued samples
    assert winch.fault is None
    receive(34 * TICK_NS)
    for tick in range(35, 47):  # sensors that stay silent time out
        winch.step(tick * TICK_NS)
    assert winch.fault is WinchFault.DRUM_LOST


def test_lost_samples_do_not_raise_the_drift():
    estimate = PayoutEstimate(EstimateParameters())
    estimate.update(10.0, 0.3, 0.0, 0.0)
    # A brake right after the first sample, next sample 0.2 s later: 30 mm by the mean rate.
    estimate.update(10.003, 0.0, 0.2, 0.2)
    assert estimate.fault(0.2) == ""
    assert estimate.length == pytest.approx(10.003, abs=0.02)
    for k in range(1, 40):  # an encoder that reports a rate without moving is detected
        at = 0.2 + 0.01 * k
        estimate.update(10.003, 0.3, at, at)
    assert "length and integrated rate" in estimate.fault(0.6)


def test_queued_samples_that_arrive_at_once_give_the_same_estimate():
    prompt, late = (PayoutEstimate(EstimateParameters()) for _ in range(2))
    for k in range(100):
        at = 0.01 * k
        prompt.update(10.0 + 0.3 * at, 0.3, at, at)
        late.update(10.0 + 0.3 * at, 0.3, at, at if k < 50 else 1.0)
    assert late.length == prompt.length == pytest.approx(10.297)
    assert late.rate == prompt.rate
    assert late.fault(1.0) == ""
    assert abs(late.drift) < 1e-12
    assert late.length_at(0.99) == late.length
    assert late.length_at(1.0) == pytest.approx(10.3)
    assert late.length_at(9.0) == pytest.approx(10.297 + 0.3 * 0.05)


def test_a_sample_from_before_a_clock_reset_does_not_block_the_drum():
    estimate = PayoutEstimate(EstimateParameters())
    estimate.update(10.0, 0.3, 20.0, 19.3)
    for k in range(5):
        at = 19.3 + 0.01 * k
        estimate.update(10.0 + 0.003 * k, 0.3, at, at)
    assert estimate.age(19.35) == pytest.approx(0.01)
    assert estimate.length == pytest.approx(10.012)
    assert estimate.fault(19.35) == ""


def test_a_tension_below_the_tether_weight_is_refused():
    flight = standing()
    own = flight.winch.drum.hanging_weight(flight.state.length)
    refusal = refused(flight, machine.WINCH_AT_TENSION, 0.0, 0.1, own)
    assert refusal.code is RefusalCode.OUT_OF_LIMITS
    assert "without end" in refusal.reason
    request(flight, machine.WINCH_AT_TENSION, 0.0, 0.1, own + 0.4)
    assert flight.winch.mode is WinchMode.TENSION


def test_a_tension_hold_keeps_its_rate_limit():
    flight = hanging()
    for tension, sign in ((12.0, 1.0), (22.0, -1.0)):
        recorder = WinchRecorder(flight)
        renew(flight, 8, machine.WINCH_AT_TENSION, 0.0, 0.1, tension)
        assert np.abs(recorder.record()["rate"][200:] - sign * 0.1).max() < 0.02
    flight.run(2.5)
    assert flight.winch.fault is WinchFault.COMMAND_TIMEOUT
    assert flight.plant.payout_rate(flight.state) == 0.0


def test_slack_is_given_beyond_the_taut_length_and_taken_up_softly():
    flight = standing()
    recorder = WinchRecorder(flight)
    request(flight, machine.WINCH_SLACK, 0.0)
    assert flight.run(20.0, lambda: flight.winch.mode is WinchMode.HOLD)
    taut = flight.state.length
    assert taut == pytest.approx(chord(flight), abs=0.02)
    assert recorder.record()["tension"].max() < 16.0
    request(flight, machine.WINCH_SLACK, 0.4)
    flight.run(6.0)
    assert flight.state.length == pytest.approx(taut + 0.4, abs=0.02)
    assert flight.phases[topics.WINCH_MODE] == WinchMode.SLACK


def test_reaching_the_requested_slack_is_reported_once_for_each_request():
    flight = standing(0.2)
    reached: list[float] = []
    for amount in (0.0, 0.2, 0.2, 0.0):
        request(flight, machine.WINCH_SLACK, amount)
        flight.run(10.0)
        for event in flight.events_named(WinchEvent.SLACK_REACHED)[len(reached) :]:
            assert event.values["reason"] == Reason.COMPLETED
            assert float(event.values["length"]) == pytest.approx(flight.state.length, abs=0.01)
            reached.append(float(event.values["slack"]))
    assert reached == pytest.approx([0.0, 0.2, 0.2, 0.0], abs=0.01)


def test_slack_that_a_hold_interrupts_is_not_reported_as_reached():
    flight = standing()
    request(flight, machine.WINCH_SLACK, 2.0)
    flight.run(1.0)
    flight.call(topics.WINCH_HOLD)
    flight.run(5.0)
    assert not flight.events_named(WinchEvent.SLACK_REACHED)


def test_a_hold_is_reported_also_at_rest():
    flight = standing()
    for _ in range(2):
        flight.call(topics.WINCH_HOLD)
        flight.run(1.0)
    held = [event.values["reason"] for event in flight.events_named(WinchEvent.HOLD)]
    assert held[-2:] == [Reason.REQUESTED, Reason.REQUESTED]


def test_a_length_request_lifts_a_standing_rover():
    flight = standing(0.2)
    request(flight, machine.WINCH_TO_LENGTH, 9.0, 0.1)
    run_until_rest(flight, 40.0)
    assert flight.state.length == pytest.approx(9.0, abs=0.003)
    assert not flight.winch.sensing.load.is_supported


def test_a_standing_rover_may_request_the_present_length_but_no_payout():
    flight = standing(0.2)
    present = flight.winch.sensing.payout.length
    request(flight, machine.WINCH_TO_LENGTH, present + 0.005, 0.1)
    assert not flight.refusals
    assert (
        refused(flight, machine.WINCH_TO_LENGTH, present + 0.05, 0.1).code
        is RefusalCode.WRONG_PHASE
    )


def test_nothing_is_reeled_in_during_a_jump():
    flight = standing()
    request(flight, machine.WINCH_SLACK, 0.0)
    flight.run(1.0)
    report_jump(flight, JumpPhase.COMPRESSING)
    before = flight.state.length
    report_jump(flight, JumpPhase.FLIGHT)
    assert flight.state.length >= before - 1e-6
    assert "a jump is in progress" in refused(flight, machine.WINCH_TO_LENGTH, 5.0, 0.1).reason


@pytest.mark.parametrize("at_rest", [JumpPhase.HOOKING, JumpPhase.STANDBY])
def test_the_slack_is_taken_up_when_the_rover_is_at_rest_after_its_jump(at_rest: JumpPhase):
    flight = standing(0.1)
    request(flight, machine.WINCH_SLACK, 0.0)
    assert flight.run(20.0, lambda: flight.winch.mode is WinchMode.HOLD)
    taut = flight.state.length
    request(flight, machine.WINCH_SLACK, 0.2)
    flight.run(3.0)
    for phase in (JumpPhase.COMPRESSING, JumpPhase.FLIGHT, JumpPhase.LANDED):
        report_jump(flight, phase)
    assert flight.state.length > taut + 0.15
    report_jump(flight, at_rest)
    assert flight.run(20.0, lambda: flight.winch.mode is WinchMode.HOLD)
    assert flight.state.length == pytest.approx(taut, abs=0.02)


def trim(flight: Flight, rate: float) -> None:
    flight.request(topics.WINCH_TRIM, machine.WINCH_DRUM, 0.0, rate)
    flight.run(0.05)


def test_a_trim_is_bounded_times_out_and_is_refused_in_other_modes():
    flight = hanging()
    trim(flight, 0.05)
    assert "a trim requires" in flight.refusals[-1][1].reason
    recorder = WinchRecorder(flight)
    request(flight, machine.WINCH_TO_LENGTH, 10.003, 0.3)
    p = flight.winch.parameters.servo
    for _ in range(360):
        trim(flight, 0.3)
        assert abs(flight.winch.servo.trim_offset) <= p.trim_length
    assert flight.winch.servo.trim_offset == pytest.approx(p.trim_length, abs=0.01)
    assert np.abs(recorder.record()["reference_rate"]).max() < p.trim_rate * 1.1
    run_until_rest(flight, 25.0)
    assert flight.winch.mode is WinchMode.HOLD
    assert flight.state.length == pytest.approx(10.003, abs=0.01)


def test_a_renewed_request_for_the_present_length_waits_for_a_trim():
    flight = hanging()
    request(flight, machine.WINCH_WHILE_RENEWED, 10.0, 0.3)
    flight.run(0.6)
    assert len(reported(flight, WinchEvent.HOLD)) == 2  # when armed, and when no trim came
    request(flight, machine.WINCH_WHILE_RENEWED, 10.0, 0.3)
    flight.run(0.22)
    trim(flight, 0.05)
    flight.run(0.4)
    assert flight.winch.mode is WinchMode.LENGTH
    assert flight.winch.servo.trim_offset > 0.005


def test_a_motion_after_a_trim_accelerates_no_faster_than_without():
    flight = hanging()
    request(flight, machine.WINCH_TO_LENGTH, 10.003, 0.3)
    for _ in range(40):
        trim(flight, 0.1)
    assert flight.winch.servo.reference.rate == pytest.approx(0.1, abs=0.02)
    recorder = WinchRecorder(flight)
    request(flight, machine.WINCH_TO_LENGTH, 5.0, 0.3)
    flight.run(3.0)
    rates = recorder.record()["reference_rate"]
    assert rates[-1] == pytest.approx(-0.3, abs=0.01)
    steepest = np.abs(np.diff(rates)).max() / (TICK_NS * 1e-9)
    assert steepest < 1.05 * flight.winch.parameters.servo.acceleration


@pytest.mark.parametrize(("start", "rate"), [(6.0, -0.35), (54.0, 0.35)])
def test_the_rate_falls_smoothly_before_a_soft_end(
    start: float, rate: float, record_property: Callable[[str, object], None]
):
    flight = fly_winch({"tether.length": start}, 1)
    recorder = WinchRecorder(flight)
    renew(flight, 60, machine.WINCH_AT_RATE, 0.0, rate)
    record: WinchRecord = recorder.record()
    servo = flight.winch.parameters.servo
    end = servo.shortest_length + servo.soft_margin
    if rate > 0.0:
        end = servo.longest_length - servo.soft_margin
    left = (end - record["length"]) * math.copysign(1.0, rate)
    references = np.abs(record["reference_rate"])
    record_property("beyond", -left.min())
    assert -left.min() < 0.005
    assert left[-1] == pytest.approx(0.0, abs=0.01)
    assert references[left < 0.95].max() < 0.12
    # Monotone: no chatter where the zone begins.
    assert np.diff(references[(left < 2.3) & (left > 1.0)]).max() < 1e-6
    assert flight.winch.mode is not WinchMode.FAULT


def test_a_lower_rate_limit_is_reached_smoothly():
    flight = hanging()
    request(flight, machine.WINCH_TO_LENGTH, 20.0, 0.3)
    flight.run(5.0)
    recorder = WinchRecorder(flight)
    request(flight, machine.WINCH_TO_LENGTH, 20.0, 0.1)
    flight.run(4.0)
    references = recorder.record()["reference_rate"]
    assert np.diff(references).max() < 1e-5
    assert references.min() == pytest.approx(0.1, abs=1e-3)


def lifting_98_n() -> Flight:
    on_earth = {"gravity": 9.81, "reference_weight": 98.1, "tension_limit": 190.0}
    flight = fly_winch(
        {"tether.length": 20.0, "environment.gravity": 9.81, "winch.brake_torque": 12.0},
        1,
        parameters={"winch_node": on_earth},
    )
    request(flight, machine.WINCH_TO_LENGTH, 5.0, 0.1, 190.0)
    return flight


def with_a_small_motor() -> Flight:
    flight = hanging(9.0, motor_continuous_torque=0.01, motor_thermal_time=15.0)
    request(flight, machine.WINCH_TO_LENGTH, 2.3, 0.3)
    return flight


@pytest.mark.parametrize("start", [lifting_98_n, with_a_small_motor])
def test_a_hot_motor_brakes_before_it_overheats(
    start: Callable[[], Flight], record_property: Callable[[str, object], None]
):
    flight = start()
    heat = [0.0]
    flight.sim.observers.append(lambda _: heat.append(flight.winch.sensing.heat.heat))
    assert flight.run(90.0, lambda: flight.winch.fault is WinchFault.OVERHEATED)
    flight.run(2.0)
    record_property("heat", max(heat))
    assert max(heat) <= 1.0
    assert flight.state.drives.drum.braked
    assert flight.plant.payout_rate(flight.state) == 0.0


def test_without_a_drum_state_nothing_is_known():
    winch = WinchController(WinchParameters())
    assert winch.step(1_000_000_000) is None
    with pytest.raises(Refusal, match="no drum state received"):
        winch.rearm(1_000_000_000)
    assert math.isnan(winch.sensing.tension_now(1_000_000_000)[0])


@pytest.mark.parametrize("reeled", [0.1, 0.17, 0.2])
def test_reeling_in_a_slack_tether_completes_at_its_length(reeled: float):
    flight = standing()
    flight.call(topics.WINCH_REARM)
    goal = flight.winch.sensing.payout.length - reeled
    renew(flight, 20, machine.WINCH_WHILE_RENEWED, goal, 0.05)
    ends = {each.reason for each in flight.commands if each.state.is_over}
    assert ends == {Reason.COMPLETED}
    assert flight.winch.sensing.payout.length == pytest.approx(goal, abs=0.003)
