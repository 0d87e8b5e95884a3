import dataclasses
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msg_schemas.fields import SMALLEST_SIZE
from rover_sim.physics.mechanisms import drum as drums
from rover_sim.physics.mechanisms.drum import (
    Drum,
    DrumCommand,
    DrumEnergyBalance,
    DrumParameters,
    DrumState,
    advance,
    initial_state,
    make_drum,
)
from rover_sim.physics.mechanisms.motor import MotorMode
from rover_sim.physics.mechanisms.shaft import FrictionParameters

H = 1e-3
LONGEST = 60.0  # [m]
SMOOTH = FrictionParameters(0.0, 0.0, 1.0, 0.0)
OFF, TORQUE, RATE = int(MotorMode.OFF), int(MotorMode.TORQUE), int(MotorMode.RATE)
COAST = DrumCommand(OFF, 0.0, 0.0, math.inf, True)
HOLD = DrumCommand(OFF, 0.0, 0.0, math.inf, False)


def from_zero_to(most: float) -> st.SearchStrategy[float]:
    """Numbers of a size that a configuration accepts."""
    return st.just(0.0) | st.floats(SMALLEST_SIZE, most)


def pay_out(rate: float, feed_forward: float = 0.0) -> DrumCommand:
    return DrumCommand(RATE, feed_forward, rate, math.inf, True)


def opened(drum: Drum, length: float, rate: float = 0.0) -> DrumState:
    return initial_state(drum, length)._replace(braked=False, rate=rate)


def residual(drum: Drum, before: DrumState, balance: DrumEnergyBalance) -> float:
    """Residual of a step's energy balance [J]."""
    change = balance.kinetic - 0.5 * drum.inertia * before.rate**2
    heats = balance.gear_heat + balance.friction_heat + balance.brake_heat + balance.stop_heat
    return change - (balance.motor_work + balance.tension_work - heats)


def test_a_mass_on_a_free_drum_falls_by_the_closed_form() -> None:
    # The mass hangs on a rigid tether: T = m (g - a), a = R w'. (J + m R^2) w' = m g R.
    parameters = DrumParameters(friction=SMOOTH)
    drum = make_drum(parameters, LONGEST)
    mass, g = 10.0, 1.62
    expected = mass * g / (mass + drum.inertia / drum.radius**2)
    state = opened(drum, 1.0)
    tension = mass * (g - expected)
    for _ in range(1000):
        state, _, _ = advance(drum, state, COAST, tension, H)
    assert state.length - 1.0 == pytest.approx(0.5 * expected, rel=1e-9)
    assert state.rate * drum.radius == pytest.approx(expected, rel=1e-9)


def test_vertical_payout_tension_and_speed_with_a_lumped_mass() -> None:
    # T = (m + rho L)(g - a) with a from the drum's own acceleration, staggered by one step.
    drum = make_drum(DrumParameters(friction=SMOOTH), LONGEST)
    mass, density, g = 10.0, 5e-3, 1.62
    state, previous = opened(drum, 2.0), 0.0
    command = DrumCommand(TORQUE, -0.01, 0.0, math.inf, True)
    tension = mass * g
    for _ in range(400):
        state, _, _ = advance(drum, state, command, tension, H)
        acceleration = (state.rate * drum.radius - previous) / H
        previous = state.rate * drum.radius
        # Relaxed: reflected, drum and rover weigh about the same.
        expected = (mass + density * state.length) * (g - acceleration)
        tension += 0.5 * (expected - tension)
    hanging = mass + density * state.length
    torque = -0.01 * drum.gear_ratio / drum.back_efficiency
    exact = (drum.radius * hanging * g + torque) / (drum.inertia + hanging * drum.radius**2)
    assert acceleration == pytest.approx(exact * drum.radius, rel=1e-4)
    assert tension == pytest.approx(hanging * (g - exact * drum.radius), rel=1e-4)
    assert tension < hanging * g


def test_constant_torque_accelerates_the_drum_by_the_closed_form() -> None:
    drum = make_drum(DrumParameters(friction=FrictionParameters(0.05, 0.05, 1.0, 0.0)), LONGEST)
    state = opened(drum, 1.0)
    command = DrumCommand(TORQUE, 0.01, 0.0, math.inf, True)
    for _ in range(500):
        state, outputs, _ = advance(drum, state, command, 0.0, H)
    expected = (0.85 * 50.0 * 0.01 - 0.05) / drum.inertia * 0.5
    assert state.rate == pytest.approx(expected, rel=1e-12)
    assert outputs.current == pytest.approx(0.01 / 0.04)


def test_a_braking_motor_needs_less_torque_than_one_that_lifts() -> None:
    # 16 N at 0.05 m = 0.8 N m: lifting takes 0.8/(N eta), holding while lowering 0.8 eta_b/N.
    drum = make_drum(DrumParameters(friction=SMOOTH), LONGEST)
    lifts = -0.8 / (50.0 * 0.85)
    holds = -0.8 * 0.82 / 50.0
    for torque, moves in (
        (lifts * 1.01, -1),
        (lifts * 0.99, 0),
        (holds * 1.01, 0),
        (holds * 0.99, 1),
    ):
        command = DrumCommand(TORQUE, torque, 0.0, math.inf, True)
        state, outputs, _ = advance(drum, opened(drum, 5.0), command, 16.0, H)
        assert math.copysign(moves, state.rate) == moves if moves else state.rate == 0.0
        assert outputs.stuck == (moves == 0)


def test_the_brake_stops_a_falling_load_within_the_distance_of_the_closed_form() -> None:
    drum = make_drum(DrumParameters(friction=SMOOTH, engage_delay=0.02), LONGEST)
    pull = 16.2
    state = opened(drum, 5.0, rate=0.3 / drum.radius)
    distance, time = 0.0, 0.0
    while state.rate != 0.0:
        state, outputs, _ = advance(drum, state, HOLD, pull, H)
        distance += outputs.payout_rate * H
        time += H
    falling = pull * drum.radius / drum.inertia
    rate = 0.3 / drum.radius
    after_delay = rate + falling * 0.02
    braking = (drum.brake_torque - pull * drum.radius) / drum.inertia
    delay_angle = rate * 0.02 + 0.5 * falling * 0.02**2
    exact = drum.radius * (delay_angle + after_delay**2 / (2.0 * braking))
    assert distance == pytest.approx(exact, rel=1e-9)
    assert time == pytest.approx(0.02 + after_delay / braking, abs=H)
    assert distance < 0.08


def test_the_brake_holds_its_capacity_exactly_and_slips_above_it() -> None:
    drum = make_drum(DrumParameters(friction=SMOOTH), LONGEST)
    capacity = drum.brake_torque / drum.radius
    start = initial_state(drum, 5.0)
    state = start
    for _ in range(1000):
        state, outputs, balance = advance(drum, state, HOLD, capacity, H)
    assert state == start
    assert outputs.stuck
    assert (balance.brake_heat, balance.tension_work, balance.kinetic) == (0.0, 0.0, 0.0)
    state, outputs, balance = advance(drum, start, HOLD, capacity + 1.0, H)
    assert state.rate == pytest.approx(drum.radius / drum.inertia * H, rel=1e-9)
    assert balance.brake_heat == pytest.approx(2.0 * drum.radius / drum.inertia * H * H / 2.0)
    assert not outputs.stuck


def test_the_brake_switches_after_its_delays_and_a_changed_command_restarts_the_delay() -> None:
    drum = make_drum(DrumParameters(engage_delay=0.02, release_delay=0.04), LONGEST)
    state = initial_state(drum, 5.0)

    def run(command: DrumCommand, steps: int) -> list[bool]:
        nonlocal state
        closed = []
        for _ in range(steps):
            state, _, _ = advance(drum, state, command, 16.0, H)
            closed.append(state.braked)
        return closed

    assert run(COAST, 30) == [True] * 30
    assert run(HOLD, 1) == [True]
    assert run(COAST, 45) == [True] * 40 + [False] * 5
    assert run(HOLD, 25) == [False] * 20 + [True] * 5
    assert run(HOLD, 300)[-1]
    assert state.rate == 0.0


def test_a_tether_in_compression_turns_the_drum_backward() -> None:
    drum = make_drum(DrumParameters(friction=SMOOTH), LONGEST)
    start = opened(drum, 5.0)
    state, outputs, balance = advance(drum, start, COAST, -50.0, H)
    assert state.rate == pytest.approx(-50.0 * drum.radius / drum.inertia * H, rel=1e-6)
    assert balance.tension_work == pytest.approx(-50.0 * outputs.payout_rate * H, rel=1e-9)
    assert residual(drum, start, balance) == pytest.approx(0.0, abs=1e-14)


@pytest.mark.parametrize(("length", "rate", "stop"), [(59.9999, 6.0, 1), (2.0001, -6.0, -1)])
def test_a_stop_is_located_inside_the_step_and_its_kinetic_energy_becomes_heat(
    length: float, rate: float, stop: int
) -> None:
    drum = make_drum(DrumParameters(min_length=2.0), LONGEST)
    start = opened(drum, length, rate)
    state, outputs, balance = advance(drum, start, COAST, 16.0, H)
    end = 60.0 if stop == 1 else 2.0
    assert (state.length, state.rate, outputs.stop) == (end, 0.0, stop)
    assert start.length + outputs.payout_rate * H == pytest.approx(end, abs=1e-12)
    assert balance.stop_heat == pytest.approx(0.5 * drum.inertia * 36.0, rel=0.01)
    assert residual(drum, start, balance) == pytest.approx(0.0, abs=1e-14)
    # It leaves the stop as freely as it came.
    command = DrumCommand(TORQUE, -0.1 * stop, 0.0, math.inf, True)
    state, outputs, _ = advance(drum, state, command, 0.0, H)
    assert state.rate * stop < 0.0
    assert outputs.stop == 0


def test_the_rate_servo_follows_its_setpoint_under_load() -> None:
    drum = make_drum(DrumParameters(), LONGEST)
    state = initial_state(drum, 5.0)
    for _ in range(2000):
        state, outputs, _ = advance(drum, state, pay_out(0.3), 16.0, H)
    assert outputs.payout_rate == pytest.approx(0.3, abs=1e-4)
    for _ in range(1000):
        state, outputs, _ = advance(drum, state, pay_out(-0.3), 16.0, H)
    assert outputs.payout_rate == pytest.approx(-0.3, abs=1e-4)


def test_layers_change_the_radius_and_length_stays_consistent_with_angle() -> None:
    drum = make_drum(DrumParameters(layer_pitch=1.3e-3, turns_per_layer=30.0), LONGEST)
    assert drums.radius_at(drum, 0.0) == 0.05
    assert drums.radius_at(drum, 45.0) == pytest.approx(0.0513)
    assert drums.radius_at(drum, 29.875) == pytest.approx(0.05065)
    # Length is the integral of the radius over the angle.
    steps = 200_000
    width = drum.full_turns / steps
    total = sum(drums.radius_at(drum, (i + 0.5) * width) for i in range(steps))
    assert total * width * 2.0 * math.pi == pytest.approx(60.0, rel=1e-8)
    state = initial_state(drum, 3.0)
    assert drums.length_at(drum, state.angle) == pytest.approx(3.0, abs=1e-12)
    length = state.length
    while state.length < 55.0:
        state, outputs, _ = advance(drum, state, pay_out(0.6), 16.0, 4.0 * H)
        length += outputs.payout_rate * 4.0 * H
    assert state.length == pytest.approx(length, abs=1e-11)
    assert drums.length_at(drum, state.angle) == pytest.approx(state.length, abs=1e-6)


COMMANDS = st.builds(
    DrumCommand,
    st.sampled_from([OFF, TORQUE, RATE]),
    st.floats(-0.5, 0.5),
    st.floats(-1.0, 1.0),
    st.sampled_from([math.inf, 0.1]),
    st.booleans(),
)


@settings(max_examples=60, deadline=None)
@given(
    parameters=st.builds(
        DrumParameters,
        drum_inertia=st.floats(1e-4, 0.1),
        efficiency=st.floats(0.3, 1.0),
        back_efficiency=st.floats(0.3, 1.0),
        friction=st.builds(
            lambda coulomb, more, viscous: FrictionParameters(
                coulomb, coulomb + more, 0.2, viscous
            ),
            from_zero_to(0.5),
            from_zero_to(0.2),
            from_zero_to(0.05),
        ),
        layer_pitch=st.sampled_from([0.0, 1.5e-3]),
        turns_per_layer=st.floats(0.5, 30.0),
    ),
    max_length=st.floats(2.5, 20.0),
    script=st.lists(st.tuples(COMMANDS, st.floats(-50.0, 100.0)), min_size=1, max_size=8),
)
def test_energy_balances_and_heat_is_never_negative_over_random_runs(
    parameters: DrumParameters, max_length: float, script: list[tuple[DrumCommand, float]]
) -> None:
    drum = make_drum(parameters, max_length)
    state = initial_state(drum, 2.0)
    turnover, drift, length = 0.0, 0.0, state.length
    for command, tension in script:
        for _ in range(60):
            before = state
            state, outputs, balance = advance(drum, state, command, tension, H)
            scale = balance.kinetic + abs(balance.motor_work) + abs(balance.tension_work) + 1e-12
            scale += 0.5 * drum.inertia * before.rate**2
            turnover += scale
            drift += residual(drum, before, balance)
            length += outputs.payout_rate * H
            assert abs(residual(drum, before, balance)) <= 1e-9 * scale
            heats = (
                balance.gear_heat,
                balance.friction_heat,
                balance.brake_heat,
                balance.stop_heat,
            )
            assert min(heats) >= -1e-12 * scale
            assert 0.0 <= state.length <= drum.max_length
            assert math.isfinite(state.rate)
    assert abs(drift) <= 1e-9 * turnover
    assert length == pytest.approx(state.length, abs=1e-9)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("radius", 0.0),
        ("efficiency", 1.2),
        ("brake_torque", -1.0),
        ("min_length", -1.0),
        ("gear_ratio", math.nan),
    ],
)
def test_bad_values_are_refused_by_name(field: str, value: float) -> None:
    change: dict[str, Any] = {field: value}
    with pytest.raises(ValueError, match=field):
        dataclasses.replace(DrumParameters(), **change)


def test_layers_shorter_than_the_climb_to_the_next_are_refused() -> None:
    with pytest.raises(ValueError, match=r"turns_per_layer = 0\.25: should be above 0\.25"):
        DrumParameters(layer_pitch=1e-3, turns_per_layer=0.25)


@pytest.mark.parametrize("max_length", [2.0, math.inf, math.nan])
def test_a_longest_payout_that_is_no_more_than_the_shortest_is_refused(max_length: float) -> None:
    with pytest.raises(ValueError, match="max_length = "):
        make_drum(DrumParameters(min_length=2.0), max_length)


def test_a_length_outside_the_stops_is_refused() -> None:
    with pytest.raises(ValueError, match=r"length = 61"):
        initial_state(make_drum(DrumParameters(), LONGEST), 61.0)
