"""The winch without ROS, on a reduced hoist: modes, refusals, trim, tension, stalls."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from winch_hoist import Hoist, HoistParameters

from msg_schemas.machine import (
    WINCH_AT_RATE,
    WINCH_AT_TENSION,
    WINCH_SLACK,
    WINCH_TO_LENGTH,
    WINCH_WHILE_RENEWED,
)
from msg_schemas.refusal import Refusal, RefusalCode
from rover_verify.checks.winch_rig import TICK, TICK_NS, Session
from tether_winch.estimates import EstimateParameters, PayoutEstimate
from tether_winch.guard import Fault
from tether_winch.requests import Mode
from tether_winch.winch import Winch, WinchParameters


def session(length: float = 10.0, floor_depth: float = math.inf) -> Session:
    hoist = HoistParameters(start_length=length, floor_depth=floor_depth)
    made = Session(Winch(WinchParameters()), Hoist(hoist))
    made.arm()
    made.run(0.5)
    return made


def standing(slack: float = 0.5) -> Session:
    """The rover on a floor, the tether longer than its way."""
    made = session(10.0 + slack, floor_depth=10.0)
    made.run(2.5)
    assert made.winch.load.is_supported
    return made


def refused(made: Session, *request: object) -> Refusal:
    with pytest.raises(Refusal) as caught:
        made.ask(*request)  # type: ignore[arg-type]
    return caught.value


def test_a_length_is_reached_without_overshoot_and_braked():
    made = session()
    made.ask(WINCH_TO_LENGTH, 14.0, 0.3)
    made.run_until_rest(30.0)
    made.run(0.5)
    lengths = made.column("length")
    assert made.winch.mode is Mode.HOLD
    assert lengths[-1] == pytest.approx(14.0, abs=0.003)
    assert lengths.max() < 14.003
    assert np.abs(made.column("length") - made.column("reference")).max() < 0.01
    assert made.ticks[-1].torque == 0.0


def test_stepped_twice_at_one_time_it_says_the_same_again():
    made = session()
    made.ask(WINCH_TO_LENGTH, 14.0, 0.3)
    made.run(3.0)
    told = made.winch.step(made.now_ns)
    assert told is not None
    assert told.rate > 0.1
    assert made.winch.step(made.now_ns) == told


def test_a_length_that_is_not_renewed_on_the_way_ends_in_a_hold():
    made = session()
    for _ in range(8):
        made.ask(WINCH_WHILE_RENEWED, 14.0, 0.3)
        made.run(0.5)
    assert made.winch.mode is Mode.LENGTH
    assert len(made.told("winch_hold")) == 1  # when it was armed
    renewed, length = made.time, made.ticks[-1].length
    made.run_until_rest(10.0)
    _, told = made.told("winch_hold")
    assert told - renewed == pytest.approx(made.winch.parameters.guard.command_timeout, abs=0.6)
    assert made.ticks[-1].length - length < 0.7
    assert made.winch.fault is None
    made.ask(WINCH_WHILE_RENEWED, 14.0, 0.3)
    for _ in range(30):
        made.run(0.5)
        if made.winch.mode is Mode.LENGTH:
            made.ask(WINCH_WHILE_RENEWED, 14.0, 0.3)
    assert made.ticks[-1].length == pytest.approx(14.0, abs=0.003)
    made.run(3.0)  # there it needs no renewal
    assert made.ticks[-1].mode is Mode.HOLD
    made.ask(WINCH_TO_LENGTH, 12.0, 0.3)  # nor does a length of the other kind
    made.run(3.0)
    assert made.winch.mode is Mode.LENGTH


def test_a_way_that_is_slowed_down_little_by_little_is_told_once():
    made = session()
    for step in range(16):
        made.ask(WINCH_WHILE_RENEWED, 14.0, 0.3 * 0.95**step)
        made.run(0.5)
    assert len(made.told("winch_length")) == 1
    assert made.ticks[-1].rate == pytest.approx(0.3 * 0.95**15, rel=0.05)
    made.ask(WINCH_WHILE_RENEWED, 14.0, 0.05)
    made.run(0.1)
    assert len(made.told("winch_length")) == 2


def test_a_stalled_controller_does_not_end_a_motion_before_it_began():
    made = session()
    made.ask(WINCH_TO_LENGTH, 11.0, 0.3)
    made.now_ns += 14 * TICK_NS  # it is not stepped for so long
    made.run(0.3)
    assert made.winch.mode is Mode.LENGTH
    made.run_until_rest(20.0)
    assert made.ticks[-1].length == pytest.approx(11.0, abs=0.003)


def test_a_controller_that_stalled_does_not_take_its_sensors_for_silent():
    made = session()
    made.ask(WINCH_TO_LENGTH, 14.0, 0.3)
    made.run(2.0)
    running = made.winch.step(made.now_ns)
    for _ in range(14):
        made.rig.step(running, TICK)
        made.now_ns += TICK_NS
    made.winch.step(made.now_ns)  # before it has heard what was said meanwhile
    assert made.winch.mode is Mode.LENGTH
    made.run(1.0)
    assert made.winch.fault is None
    for _ in range(12):  # but sensors that stay silent are lost
        made.now_ns += TICK_NS
        made.winch.step(made.now_ns)
    assert made.winch.fault is Fault.DRUM_LOST


def test_samples_that_were_lost_do_not_speak_against_the_encoder():
    estimate = PayoutEstimate(EstimateParameters())
    estimate.hear(10.0, 0.3, 0.0, 0.0)
    # Braked at once after the first sample, heard of 0.2 s later: 30 mm by the mean rate.
    estimate.hear(10.003, 0.0, 0.2, 0.2)
    assert estimate.fault(0.2) == ""
    assert estimate.length == pytest.approx(10.003, abs=0.02)
    for k in range(1, 40):  # but an encoder that tells a rate and does not move is found
        at = 0.2 + 0.01 * k
        estimate.hear(10.003, 0.3, at, at)
    assert "came apart" in estimate.fault(0.6)


def test_samples_that_a_stalled_node_hears_all_at_once_make_the_same_motion():
    prompt, late = (PayoutEstimate(EstimateParameters()) for _ in range(2))
    for k in range(100):
        at = 0.01 * k
        prompt.hear(10.0 + 0.3 * at, 0.3, at, at)
        late.hear(10.0 + 0.3 * at, 0.3, at, at if k < 50 else 1.0)
    assert late.length == prompt.length == pytest.approx(10.297)
    assert late.rate == prompt.rate
    assert late.fault(1.0) == ""
    assert abs(late.drift) < 1e-12
    assert late.length_at(0.99) == late.length
    assert late.length_at(1.0) == pytest.approx(10.3)
    assert late.length_at(9.0) == pytest.approx(10.297 + 0.3 * 0.05)


def test_a_sample_from_before_the_clock_went_back_does_not_silence_the_drum():
    estimate = PayoutEstimate(EstimateParameters())
    estimate.hear(10.0, 0.3, 20.0, 19.3)
    for k in range(5):
        at = 19.3 + 0.01 * k
        estimate.hear(10.0 + 0.003 * k, 0.3, at, at)
    assert estimate.silence(19.35) == pytest.approx(0.01)
    assert estimate.length == pytest.approx(10.012)
    assert estimate.fault(19.35) == ""


def test_holding_less_than_the_hanging_tether_weighs_is_refused():
    made = standing()
    own = made.winch.drum.hanging_weight(10.5)
    refusal = refused(made, WINCH_AT_TENSION, 0.0, 0.1, own)
    assert refusal.code is RefusalCode.OUT_OF_LIMITS
    assert "without end" in refusal.reason
    made.ask(WINCH_AT_TENSION, 0.0, 0.1, own + 0.4)
    assert made.winch.mode is Mode.TENSION


def test_a_held_tension_never_runs_faster_than_asked():
    made = session()
    for tension, sign in ((12.0, 1.0), (22.0, -1.0)):
        begun = len(made.ticks)
        for _ in range(10):
            made.ask(WINCH_AT_TENSION, 0.0, 0.1, tension)
            made.run(0.5)
        rates = made.column("rate")[begun:]
        assert np.abs(rates[200:] - sign * 0.1).max() < 0.02
    made.run(2.5)
    assert made.winch.fault is Fault.COMMAND_TIMEOUT
    assert made.ticks[-1].rate == 0.0


def test_slack_is_given_beyond_the_taut_length_and_taken_up_softly():
    made = standing()
    made.ask(WINCH_SLACK, 0.0)
    made.run(20.0)
    assert made.transitions[-1][1].name == "winch_hold"
    taut = made.ticks[-1].length
    assert taut == pytest.approx(10.0, abs=0.01)
    assert made.column("tension")[300:].max() < 16.0
    made.ask(WINCH_SLACK, 0.4)
    made.run(6.0)
    assert made.ticks[-1].length == pytest.approx(taut + 0.4, abs=0.01)
    assert made.winch.mode is Mode.SLACK


def test_a_rover_that_stands_is_lifted_by_a_length_at_a_rate():
    made = standing()
    made.ask(WINCH_TO_LENGTH, 9.5, 0.1)
    made.run_until_rest(40.0)
    assert made.ticks[-1].length == pytest.approx(9.5, abs=0.003)
    assert not made.winch.load.is_supported


def test_nothing_is_reeled_in_while_the_rover_jumps():
    made = standing()
    made.ask(WINCH_SLACK, 0.0)
    made.run(1.0)
    made.winch.on_jump("compressing", made.now_ns)
    made.run(0.5)
    before = made.ticks[-1].length
    made.winch.on_jump("flight", made.now_ns)
    made.run(3.0)
    assert made.ticks[-1].length >= before - 1e-6
    assert "jumps" in refused(made, WINCH_TO_LENGTH, 5.0, 0.1).reason


def test_a_trim_is_bounded_ends_by_itself_and_is_refused_elsewhere():
    made = session(20.0)
    with pytest.raises(Refusal, match="a trim adds to"):
        made.winch.trim(0.05, made.now_ns)
    made.ask(WINCH_TO_LENGTH, 20.003, 0.3)
    p = made.winch.parameters.servo
    for _ in range(400):
        made.winch.trim(0.4, made.now_ns)
        made.run(0.05)
        assert abs(made.winch.servo.trim_offset) <= p.trim_length
        assert made.winch.servo.reference.rate <= p.trim_rate + p.largest_rate
    assert made.winch.servo.trim_offset == pytest.approx(p.trim_length, abs=0.01)
    assert np.abs(made.column("reference_rate")).max() < p.trim_rate * 1.1
    made.run(25.0)
    assert made.winch.mode is Mode.HOLD
    assert made.ticks[-1].length == pytest.approx(20.003, abs=0.01)


def test_a_controller_s_request_for_where_it_is_waits_for_the_trim():
    made = session(20.0)
    made.ask(WINCH_WHILE_RENEWED, 20.0, 0.3)
    made.run(0.6)
    assert len(made.told("winch_hold")) == 2  # when it was armed, and as none came
    made.ask(WINCH_WHILE_RENEWED, 20.0, 0.3)
    made.run(0.25)
    made.winch.trim(0.05, made.now_ns)
    made.run(0.4)
    assert made.winch.mode is Mode.LENGTH
    assert made.winch.servo.trim_offset > 0.005


def test_before_its_ends_it_slows_down_smoothly():
    made = session(6.0)
    for _ in range(50):
        made.ask(WINCH_AT_RATE, 0.0, -0.35)
        made.run(0.5)
    references = made.column("reference_rate")
    lengths = made.column("length")
    assert lengths.min() > 2.19
    near = lengths < 3.15
    assert np.abs(references[near]).max() < 0.12
    # Monotone: no chatter where the zone begins.
    braking = references[(lengths < 4.5) & (lengths > 3.2)]
    assert np.diff(braking).min() > -1e-6


def test_a_lower_rate_is_taken_over_smoothly():
    made = session()
    made.ask(WINCH_TO_LENGTH, 20.0, 0.3)
    made.run(5.0)
    made.ask(WINCH_TO_LENGTH, 20.0, 0.1)
    begun = len(made.ticks)
    made.run(5.0)
    rates = made.column("reference_rate")[begun:]
    assert np.diff(rates).max() < 1e-5
    assert rates.min() == pytest.approx(0.1, abs=1e-3)


def test_a_hot_motor_brakes_before_it_takes_harm():
    drum = replace(WinchParameters().drum, motor_continuous_torque=0.01, motor_thermal_time=5.0)
    made = Session(Winch(replace(WinchParameters(), drum=drum)), Hoist(HoistParameters()))
    made.arm()
    made.run(0.5)
    made.ask(WINCH_TO_LENGTH, 40.0, 0.3)
    made.run(5.0)
    made.winch.stop("enough", made.now_ns)
    made.run(1.0)
    made.winch.rearm(made.now_ns)
    made.ask(WINCH_TO_LENGTH, 2.3, 0.3)
    hottest = 0.0
    for _ in range(2000):
        made.tick()
        hottest = max(hottest, made.winch.heat.heat)
    assert made.winch.fault is Fault.OVERHEATED
    assert hottest <= 1.0
    assert made.ticks[-1].rate == 0.0


def test_nothing_is_known_before_the_drum_has_spoken():
    winch = Winch(WinchParameters())
    assert winch.step(1_000_000_000) is None
    with pytest.raises(Refusal, match="never heard"):
        winch.rearm(1_000_000_000)
    assert math.isnan(winch.tension_now(1_000_000_000)[0])
