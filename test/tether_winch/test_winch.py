"""The winch without ROS, on a reduced hoist: modes, refusals, trim, tension, stalls."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from winch_hoist import Hoist, HoistParameters

from msg_schemas.events import WinchEvent
from msg_schemas.faults import Reason, WinchFault
from msg_schemas.machine import (
    WINCH_AT_RATE,
    WINCH_AT_TENSION,
    WINCH_SLACK,
    WINCH_TO_LENGTH,
    WINCH_WHILE_RENEWED,
)
from msg_schemas.phases import JumpPhase, WinchMode
from msg_schemas.refusal import Refusal, RefusalCode
from rover_verify.checks.winch_rig import TICK, TICK_NS, Session
from tether_winch.estimates import EstimateParameters, PayoutEstimate
from tether_winch.winch import Winch, WinchParameters


def session(length: float = 10.0, floor_depth: float = math.inf) -> Session:
    hoist = HoistParameters(start_length=length, floor_depth=floor_depth)
    made = Session(Winch(WinchParameters()), Hoist(hoist))
    made.arm()
    made.run(0.5)
    return made


def standing(slack: float = 0.5) -> Session:
    """The rover stands on a floor with a slack tether."""
    made = session(10.0 + slack, floor_depth=10.0)
    made.run(2.5)
    assert made.winch.load.is_supported
    return made


def refused(made: Session, *request: object) -> Refusal:
    with pytest.raises(Refusal) as caught:
        made.request(*request)  # type: ignore[arg-type]
    return caught.value


def test_a_length_is_reached_without_overshoot_and_braked():
    made = session()
    made.request(WINCH_TO_LENGTH, 14.0, 0.3)
    made.run_until_rest(30.0)
    made.run(0.5)
    lengths = made.column("length")
    assert made.winch.mode is WinchMode.HOLD
    assert lengths[-1] == pytest.approx(14.0, abs=0.003)
    assert lengths.max() < 14.003
    assert np.abs(made.column("length") - made.column("reference")).max() < 0.01
    assert made.ticks[-1].torque == 0.0


def test_a_second_step_at_the_same_time_returns_the_same_command():
    made = session()
    made.request(WINCH_TO_LENGTH, 14.0, 0.3)
    made.run(3.0)
    command = made.winch.step(made.now_ns)
    assert command is not None
    assert command.rate > 0.1
    assert made.winch.step(made.now_ns) == command


def test_a_length_request_that_is_not_renewed_in_motion_ends_in_a_hold():
    made = session()
    for _ in range(8):
        made.request(WINCH_WHILE_RENEWED, 14.0, 0.3)
        made.run(0.5)
    assert made.winch.mode is WinchMode.LENGTH
    assert len(made.times_of(WinchEvent.HOLD)) == 1  # when it was armed
    renewed, length = made.time, made.ticks[-1].length
    made.run_until_rest(10.0)
    (held,) = made.times_of(WinchEvent.MOTION_ABORTED)
    assert held - renewed == pytest.approx(made.winch.parameters.faults.command_timeout, abs=0.6)
    assert made.ticks[-1].length - length < 0.7
    assert made.winch.fault is None
    made.request(WINCH_WHILE_RENEWED, 14.0, 0.3)
    for _ in range(30):
        made.run(0.5)
        if made.winch.mode is WinchMode.LENGTH:
            made.request(WINCH_WHILE_RENEWED, 14.0, 0.3)
    assert made.ticks[-1].length == pytest.approx(14.0, abs=0.003)
    made.run(3.0)  # at the length it needs no renewal
    assert made.ticks[-1].mode is WinchMode.HOLD
    made.request(WINCH_TO_LENGTH, 12.0, 0.3)  # nor does a plain length request
    made.run(3.0)
    assert made.winch.mode is WinchMode.LENGTH


def test_small_changes_of_the_rate_publish_the_mode_once():
    made = session()
    for step in range(16):
        made.request(WINCH_WHILE_RENEWED, 14.0, 0.3 * 0.95**step)
        made.run(0.5)
    assert len(made.times_of("winch_length")) == 1
    assert made.ticks[-1].rate == pytest.approx(0.3 * 0.95**15, rel=0.05)
    made.request(WINCH_WHILE_RENEWED, 14.0, 0.05)
    made.run(0.1)
    assert len(made.times_of("winch_length")) == 2


def test_a_stalled_controller_does_not_end_a_motion_before_it_began():
    made = session()
    made.request(WINCH_TO_LENGTH, 11.0, 0.3)
    made.now_ns += 14 * TICK_NS  # no step in this time
    made.run(0.3)
    assert made.winch.mode is WinchMode.LENGTH
    made.run_until_rest(20.0)
    assert made.ticks[-1].length == pytest.approx(11.0, abs=0.003)


def test_a_stalled_controller_does_not_time_its_sensors_out():
    made = session()
    made.request(WINCH_TO_LENGTH, 14.0, 0.3)
    made.run(2.0)
    running = made.winch.step(made.now_ns)
    for _ in range(14):
        made.rig.step(running, TICK)
        made.now_ns += TICK_NS
    made.winch.step(made.now_ns)  # before it receives the queued samples
    assert made.winch.mode is WinchMode.LENGTH
    made.run(1.0)
    assert made.winch.fault is None
    for _ in range(12):  # sensors that stay silent time out
        made.now_ns += TICK_NS
        made.winch.step(made.now_ns)
    assert made.winch.fault is WinchFault.DRUM_LOST


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
    made = standing()
    own = made.winch.drum.hanging_weight(10.5)
    refusal = refused(made, WINCH_AT_TENSION, 0.0, 0.1, own)
    assert refusal.code is RefusalCode.OUT_OF_LIMITS
    assert "without end" in refusal.reason
    made.request(WINCH_AT_TENSION, 0.0, 0.1, own + 0.4)
    assert made.winch.mode is WinchMode.TENSION


def test_a_tension_hold_keeps_its_rate_limit():
    made = session()
    for tension, sign in ((12.0, 1.0), (22.0, -1.0)):
        begun = len(made.ticks)
        for _ in range(10):
            made.request(WINCH_AT_TENSION, 0.0, 0.1, tension)
            made.run(0.5)
        rates = made.column("rate")[begun:]
        assert np.abs(rates[200:] - sign * 0.1).max() < 0.02
    made.run(2.5)
    assert made.winch.fault is WinchFault.COMMAND_TIMEOUT
    assert made.ticks[-1].rate == 0.0


def test_slack_is_given_beyond_the_taut_length_and_taken_up_softly():
    made = standing()
    made.request(WINCH_SLACK, 0.0)
    made.run(20.0)
    assert made.transitions[-1][1].name == WinchEvent.HOLD
    taut = made.ticks[-1].length
    assert taut == pytest.approx(10.0, abs=0.01)
    assert made.column("tension")[300:].max() < 16.0
    made.request(WINCH_SLACK, 0.4)
    made.run(6.0)
    assert made.ticks[-1].length == pytest.approx(taut + 0.4, abs=0.01)
    assert made.winch.mode is WinchMode.SLACK


def test_reaching_the_requested_slack_is_reported_once_for_each_request():
    made = standing()
    reached: list[float] = []

    def run(amount: float) -> None:
        made.request(WINCH_SLACK, amount)
        made.run(20.0)
        found = [e for _, e in made.transitions if e.name is WinchEvent.SLACK_REACHED]
        for event in found[len(reached) :]:
            assert event.reason is Reason.COMPLETED
            assert event.values["length"] == pytest.approx(made.ticks[-1].length, abs=0.01)
            reached.append(float(str(event.values["slack"])))

    for amount in (0.0, 0.4, 0.4, 0.0):
        run(amount)
    assert reached == pytest.approx([0.0, 0.4, 0.4, 0.0], abs=0.01)


def test_slack_that_a_hold_interrupts_is_not_reported_as_reached():
    made = standing()
    made.request(WINCH_SLACK, 2.0)
    made.run(1.0)
    made.winch.hold(made.now_ns)
    made.run(10.0)
    assert WinchEvent.SLACK_REACHED not in [e.name for _, e in made.transitions]


def test_a_length_request_lifts_a_standing_rover():
    made = standing()
    made.request(WINCH_TO_LENGTH, 9.5, 0.1)
    made.run_until_rest(40.0)
    assert made.ticks[-1].length == pytest.approx(9.5, abs=0.003)
    assert not made.winch.load.is_supported


def test_nothing_is_reeled_in_during_a_jump():
    made = standing()
    made.request(WINCH_SLACK, 0.0)
    made.run(1.0)
    made.winch.on_jump(JumpPhase.COMPRESSING, made.now_ns)
    made.run(0.5)
    before = made.ticks[-1].length
    made.winch.on_jump(JumpPhase.FLIGHT, made.now_ns)
    made.run(3.0)
    assert made.ticks[-1].length >= before - 1e-6
    assert "a jump is in progress" in refused(made, WINCH_TO_LENGTH, 5.0, 0.1).reason


@pytest.mark.parametrize("at_rest", [JumpPhase.HOOKING, JumpPhase.STANDBY])
def test_the_slack_is_taken_up_when_the_rover_is_at_rest_after_its_jump(at_rest: JumpPhase):
    made = standing()
    made.request(WINCH_SLACK, 0.4)
    made.run(6.0)
    for phase in (JumpPhase.COMPRESSING, JumpPhase.FLIGHT, JumpPhase.LANDED):
        made.winch.on_jump(phase, made.now_ns)
        made.run(1.0)
    assert made.ticks[-1].length > 10.3
    made.winch.on_jump(at_rest, made.now_ns)
    made.run(20.0)
    assert made.ticks[-1].mode is WinchMode.HOLD
    assert made.ticks[-1].length == pytest.approx(10.0, abs=0.01)


def test_a_trim_is_bounded_times_out_and_is_refused_in_other_modes():
    made = session(20.0)
    with pytest.raises(Refusal, match="a trim requires"):
        made.winch.trim(0.05, made.now_ns)
    made.request(WINCH_TO_LENGTH, 20.003, 0.3)
    p = made.winch.parameters.servo
    for _ in range(400):
        made.winch.trim(0.4, made.now_ns)
        made.run(0.05)
        assert abs(made.winch.servo.trim_offset) <= p.trim_length
        assert made.winch.servo.reference.rate <= p.trim_rate + p.largest_rate
    assert made.winch.servo.trim_offset == pytest.approx(p.trim_length, abs=0.01)
    assert np.abs(made.column("reference_rate")).max() < p.trim_rate * 1.1
    made.run(25.0)
    assert made.winch.mode is WinchMode.HOLD
    assert made.ticks[-1].length == pytest.approx(20.003, abs=0.01)


def test_a_renewed_request_for_the_present_length_waits_for_a_trim():
    made = session(20.0)
    made.request(WINCH_WHILE_RENEWED, 20.0, 0.3)
    made.run(0.6)
    assert len(made.times_of(WinchEvent.HOLD)) == 2  # when armed, and when no trim came
    made.request(WINCH_WHILE_RENEWED, 20.0, 0.3)
    made.run(0.25)
    made.winch.trim(0.05, made.now_ns)
    made.run(0.4)
    assert made.winch.mode is WinchMode.LENGTH
    assert made.winch.servo.trim_offset > 0.005


def test_the_rate_falls_smoothly_before_a_soft_end():
    made = session(6.0)
    for _ in range(50):
        made.request(WINCH_AT_RATE, 0.0, -0.35)
        made.run(0.5)
    references = made.column("reference_rate")
    lengths = made.column("length")
    assert lengths.min() > 2.19
    near = lengths < 3.15
    assert np.abs(references[near]).max() < 0.12
    # Monotone: no chatter where the zone begins.
    braking = references[(lengths < 4.5) & (lengths > 3.2)]
    assert np.diff(braking).min() > -1e-6


def test_a_lower_rate_limit_is_reached_smoothly():
    made = session()
    made.request(WINCH_TO_LENGTH, 20.0, 0.3)
    made.run(5.0)
    made.request(WINCH_TO_LENGTH, 20.0, 0.1)
    begun = len(made.ticks)
    made.run(5.0)
    rates = made.column("reference_rate")[begun:]
    assert np.diff(rates).max() < 1e-5
    assert rates.min() == pytest.approx(0.1, abs=1e-3)


def test_a_hot_motor_brakes_before_it_overheats():
    drum = replace(WinchParameters().drum, motor_continuous_torque=0.01, motor_thermal_time=5.0)
    made = Session(Winch(replace(WinchParameters(), drum=drum)), Hoist(HoistParameters()))
    made.arm()
    made.run(0.5)
    made.request(WINCH_TO_LENGTH, 40.0, 0.3)
    made.run(5.0)
    made.winch.stop("enough", made.now_ns)
    made.run(1.0)
    made.winch.rearm(made.now_ns)
    made.request(WINCH_TO_LENGTH, 2.3, 0.3)
    hottest = 0.0
    for _ in range(2000):
        made.tick()
        hottest = max(hottest, made.winch.heat.heat)
    assert made.winch.fault is WinchFault.OVERHEATED
    assert hottest <= 1.0
    assert made.ticks[-1].rate == 0.0


def test_without_a_drum_state_nothing_is_known():
    winch = Winch(WinchParameters())
    assert winch.step(1_000_000_000) is None
    with pytest.raises(Refusal, match="no drum state received"):
        winch.rearm(1_000_000_000)
    assert math.isnan(winch.tension_now(1_000_000_000)[0])
