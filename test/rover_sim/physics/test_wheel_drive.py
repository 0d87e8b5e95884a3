import dataclasses
import math
from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from msg_schemas.fields import SMALLEST_SIZE
from rover_sim.physics.mechanisms.motor import MotorMode
from rover_sim.physics.mechanisms.shaft import FrictionParameters
from rover_sim.physics.mechanisms.wheel_drive import (
    Ratchet,
    WheelCommand,
    WheelDrive,
    WheelDriveParameters,
    WheelEnergyBalance,
    WheelLoads,
    WheelOutputs,
    WheelState,
    advance,
    make_wheel_drive,
)

H = 1e-3
NO_FRICTION = FrictionParameters(0.0, 0.0, 1.0, 0.0)
SMOOTH = make_wheel_drive(
    WheelDriveParameters(
        efficiency=1.0, back_efficiency=1.0, left_friction=NO_FRICTION, right_friction=NO_FRICTION
    )
)
DEFAULT = make_wheel_drive(WheelDriveParameters())
OFF = WheelCommand(int(MotorMode.OFF), 0.0, 0.0, math.inf)
HANGING = WheelLoads(0.0, 0.0, 0.0)


def torque(value: float) -> WheelCommand:
    return WheelCommand(int(MotorMode.TORQUE), value, 0.0, math.inf)


def rate(value: float) -> WheelCommand:
    return WheelCommand(int(MotorMode.RATE), 0.0, value, math.inf)


def run(
    drive: WheelDrive, state: WheelState, command: WheelCommand, loads: WheelLoads, steps: int
) -> tuple[WheelState, WheelOutputs, WheelEnergyBalance]:
    for _ in range(steps):
        state, outputs, balance = advance(drive, state, command, loads, H)
    return state, outputs, balance


def residual(drive: WheelDrive, before: WheelState, balance: WheelEnergyBalance) -> float:
    """Residual of a step's energy balance [J]."""
    inertia = drive.wheel_inertia
    kinetic = 0.5 * inertia * (before.left + before.body_rate) ** 2
    kinetic += 0.5 * inertia * (before.right + before.body_rate) ** 2
    kinetic += 0.5 * drive.motor_inertia * (drive.gear_ratio * before.left) ** 2
    put_in = balance.motor_work + balance.load_work + balance.body_work
    heat = balance.gear_heat + balance.friction_heat + balance.ratchet_heat
    return balance.kinetic - kinetic - put_in + heat


def test_a_forward_motor_drives_both_wheels_forward_as_one() -> None:
    state, outputs, _ = run(SMOOTH, WheelState(), torque(0.02), HANGING, 100)
    expected = 60.0 * 0.02 / (SMOOTH.train_inertia + SMOOTH.wheel_inertia) * 0.1
    assert state.left == state.right == pytest.approx(expected, rel=1e-12)
    assert state.left_angle == state.right_angle == pytest.approx(expected * 0.05, rel=1e-12)
    assert outputs.ratchet == Ratchet.DRIVEN


def test_a_reverse_motor_drives_the_left_wheel_alone_and_the_right_one_is_held() -> None:
    state, outputs, _ = run(SMOOTH, WheelState(), torque(-0.01), HANGING, 100)
    assert state.left == pytest.approx(-60.0 * 0.01 / SMOOTH.train_inertia * 0.1, rel=1e-12)
    assert (state.right, state.right_angle) == (0.0, 0.0)
    assert outputs.ratchet == Ratchet.HELD
    # A rover that pivots about it pushes the right wheel backward: it still stays.
    pushed = WheelLoads(1.0, -1.0, 0.0)
    state, outputs, _ = run(DEFAULT, WheelState(), torque(-0.05), pushed, 300)
    assert state.left < -1.0
    assert (state.right, outputs.ratchet) == (0.0, Ratchet.HELD)


def test_on_the_ground_a_forward_motor_holds_both_wheels_at_its_rate() -> None:
    loads = WheelLoads(-0.3, -0.3, 0.0)
    _, outputs, _ = run(DEFAULT, WheelState(), rate(4.0), loads, 3000)
    assert outputs.left_rate == pytest.approx(4.0, abs=0.01)
    assert outputs.right_rate == outputs.left_rate
    assert not outputs.stalled


def test_a_braking_motor_leaves_the_right_wheel_overrunning() -> None:
    spun, _, _ = run(SMOOTH, WheelState(), torque(0.02), HANGING, 100)
    state, outputs, _ = run(SMOOTH, spun, torque(-0.02), HANGING, 100)
    assert outputs.ratchet == Ratchet.OVERRUNNING
    assert state.right == spun.right
    slowed = spun.left - 60.0 * 0.02 / SMOOTH.train_inertia * 0.1
    assert state.left == pytest.approx(slowed, rel=1e-12)
    assert state.left < 0.0


def test_the_right_wheel_never_rolls_backward_but_forward_freely() -> None:
    pushed = WheelLoads(0.0, -5.0, 0.0)
    state, outputs, _ = run(DEFAULT, WheelState(), OFF, pushed, 100)
    assert (state.left, state.right, state.right_angle) == (0.0, 0.0, 0.0)
    assert outputs.ratchet == Ratchet.HELD
    pulled = WheelLoads(0.0, 0.05, 0.0)
    state, outputs, _ = run(DEFAULT, WheelState(), OFF, pulled, 100)
    assert state.left == 0.0
    assert state.right == pytest.approx((0.05 - 0.008) / 6e-3 * 0.1, rel=0.08)
    assert outputs.ratchet == Ratchet.OVERRUNNING


def test_the_left_wheel_drives_the_motor_back_in_both_directions() -> None:
    for sign in (1.0, -1.0):
        loads = WheelLoads(0.2 * sign, 0.0, 0.0)
        state, _, _ = run(DEFAULT, WheelState(), OFF, loads, 50)
        assert state.left * sign > 0.0
        assert state.right == max(state.left, 0.0)


def test_a_load_on_the_right_wheel_stalls_a_forward_motor_but_not_a_reverse_one() -> None:
    heavy = WheelLoads(0.0, -4.0, 0.0)
    state, outputs, balance = run(DEFAULT, WheelState(), torque(0.05), heavy, 50)
    assert (state.left, state.right) == (0.0, 0.0)
    assert outputs.stalled
    assert outputs.current == pytest.approx(2.5)
    assert (balance.motor_work, balance.friction_heat) == (0.0, 0.0)
    state, outputs, _ = run(DEFAULT, WheelState(), torque(-0.05), heavy, 50)
    assert state.left < 0.0
    assert not outputs.stalled
    # 60 x 0.06 x 0.8 = 2.88 N m at the wheels carry 2.8 N m and the friction.
    state, outputs, _ = run(DEFAULT, WheelState(), torque(0.06), WheelLoads(0.0, -2.8, 0.0), 50)
    assert state.right > 0.0


def test_a_hanging_body_and_its_wheels_exchange_momentum() -> None:
    # Body of 0.2 kg m^2 about the axle, stepped with the wheels; total momentum stays zero.
    body, rate_y, state = 0.2, 0.0, WheelState()
    commands = [torque(0.02)] * 300 + [torque(-0.03)] * 300 + [OFF] * 8000
    rates = []
    for command in commands:
        loads = HANGING._replace(body_rate=rate_y)
        before = DEFAULT.wheel_inertia * (state.left + state.right + 2.0 * state.body_rate)
        state, outputs, _ = advance(DEFAULT, state, command, loads, H)
        assert outputs.torque_on_body == pytest.approx((before - outputs.momentum) / H, abs=1e-12)
        rate_y += outputs.torque_on_body * H / body
        rates.append(rate_y)
        assert body * rate_y + outputs.momentum == pytest.approx(0.0, abs=1e-12)
    assert rates[299] < -0.1  # a forward motor pitches the body backward
    assert rates[599] > rates[299] + 0.1  # and a reverse one forward again
    # Friction is internal: as the wheels come to rest the body does, too.
    assert (state.left, state.right) == (0.0, 0.0)
    assert rates[-1] == pytest.approx(0.0, abs=1e-9)


def test_from_rest_the_wheels_give_reaction_torques_of_both_signs() -> None:
    reactions = []
    for sign in (1.0, -1.0):
        _, outputs, _ = run(SMOOTH, WheelState(), torque(0.01 * sign), HANGING, 100)
        assert outputs.torque_on_body * sign < 0.0
        reactions.append(outputs.momentum)
    inertia, train = SMOOTH.wheel_inertia, SMOOTH.train_inertia
    assert reactions[0] == pytest.approx(0.06 * 2.0 * inertia / (train + inertia), rel=1e-12)
    assert reactions[1] == pytest.approx(-0.06 * inertia / train, rel=1e-12)


def test_a_right_wheel_that_coasts_bleeds_its_momentum_by_friction_alone() -> None:
    drive = make_wheel_drive(
        WheelDriveParameters(right_friction=FrictionParameters(5e-3, 5e-3, 1.0, 5e-4))
    )
    state = WheelState(right=8.0)
    state, _, _ = run(drive, state, OFF, HANGING, 3000)
    inertia, dry, viscous = drive.wheel_inertia, 5e-3, 5e-4
    exact = (8.0 + dry / viscous) * math.exp(-viscous * 3.0 / inertia) - dry / viscous
    assert state.right == pytest.approx(exact, rel=1e-5)
    assert state.left == 0.0


def test_wheels_at_rest_follow_a_turning_body_exactly() -> None:
    state = WheelState()
    for i in range(200):
        loads = HANGING._replace(body_rate=0.02 * math.sin(0.05 * i))
        state, outputs, balance = advance(DEFAULT, state, OFF, loads, H)
        assert (state.left, state.right) == (0.0, 0.0)
        assert outputs.momentum == pytest.approx(2.0 * 6e-3 * loads.body_rate, rel=1e-12)
        assert balance.friction_heat == 0.0


def test_the_motor_saturates_at_its_no_load_rate() -> None:
    state, outputs, _ = run(SMOOTH, WheelState(), torque(0.06), HANGING, 5000)
    assert state.left == pytest.approx(10.0, rel=1e-3)
    assert state.left < 10.0
    assert outputs.motor_torque < 1e-3
    assert outputs.motor_momentum == pytest.approx(1e-6 * 60.0 * state.left)


def test_an_overtaken_wheel_engages_without_impact() -> None:
    state = WheelState(left=1.0, right=1.5)
    total = SMOOTH.train_inertia * 1.0 + SMOOTH.wheel_inertia * 1.5
    time, losses = 0.0, 0.0
    while True:
        state, outputs, balance = advance(SMOOTH, state, torque(0.02), HANGING, H)
        time += H
        losses += balance.ratchet_heat
        if outputs.ratchet == Ratchet.DRIVEN:
            break
    after = SMOOTH.train_inertia * state.left + SMOOTH.wheel_inertia * state.right
    assert after == pytest.approx(total + 60.0 * 0.02 * time, rel=1e-12)
    assert 0.0 <= losses < 1e-4
    assert time == pytest.approx(0.5 * SMOOTH.train_inertia / 1.2, abs=H)


COMMANDS = st.builds(
    WheelCommand,
    st.sampled_from([int(mode) for mode in (MotorMode.OFF, MotorMode.TORQUE, MotorMode.RATE)]),
    st.floats(-0.1, 0.1),
    st.floats(-12.0, 12.0),
    st.just(math.inf),
)
LOADS = st.builds(
    WheelLoads,
    st.floats(-3.0, 3.0),
    st.floats(-3.0, 3.0),
    st.floats(-2.0, 2.0),
)


@settings(max_examples=80, deadline=None)
@given(
    parameters=st.builds(
        WheelDriveParameters,
        wheel_inertia=st.floats(1e-4, 0.1),
        motor_inertia=st.just(0.0) | st.floats(SMALLEST_SIZE, 1e-5),
        efficiency=st.floats(0.3, 1.0),
        back_efficiency=st.floats(0.3, 1.0),
        right_friction=st.sampled_from([NO_FRICTION, FrictionParameters(0.01, 0.02, 0.2, 1e-3)]),
    ),
    script=st.lists(st.tuples(COMMANDS, LOADS), min_size=1, max_size=10),
)
def test_energy_balances_and_ratchets_hold_over_random_runs(
    parameters: WheelDriveParameters, script: list[tuple[WheelCommand, WheelLoads]]
) -> None:
    drive = make_wheel_drive(parameters)
    state = WheelState()
    for command, loads in script:
        for _ in range(40):
            before = state
            state, outputs, balance = advance(drive, state, command, loads, H)
            gross = abs(balance.motor_work) + abs(balance.load_work) + abs(balance.body_work)
            scale = balance.kinetic + gross + balance.friction_heat + 1e-9
            assert abs(residual(drive, before, balance)) <= 1e-9 * scale
            heats = (balance.gear_heat, balance.friction_heat, balance.ratchet_heat)
            assert min(heats) >= -1e-12 * scale
            assert state.right >= max(state.left, 0.0) - 1e-12
            assert state.right_angle >= before.right_angle
            assert math.isfinite(state.left)
            assert math.isfinite(outputs.torque_on_body)


@settings(max_examples=40, deadline=None)
@given(left=st.floats(-10.0, 10.0), more=st.floats(0.0, 10.0))
def test_without_input_the_energy_never_increases(left: float, more: float) -> None:
    state = WheelState(left=left, right=max(left, 0.0) + more)
    energy = math.inf
    for _ in range(200):
        state, _, balance = advance(DEFAULT, state, OFF, HANGING, H)
        assert balance.kinetic <= energy
        energy = balance.kinetic


@settings(max_examples=200, deadline=None)
@given(
    # Engaged wheels do not stop within the step.
    left=st.one_of(st.floats(-5.0, -0.01), st.floats(1.0, 5.0)),
    more=st.one_of(st.just(0.0), st.floats(0.01, 5.0)),
    loads=st.builds(WheelLoads, st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.just(0.0)),
)
def test_the_response_is_the_derivative_of_the_motion(
    left: float, more: float, loads: WheelLoads
) -> None:
    state = WheelState(left=left, right=max(left, 0.0) + more)
    # A wheel at rest without a torque begins to turn one way alone.
    assume(state.right > 0.0 or abs(loads.right_torque) > 1e-3)
    step = 1e-7
    found = advance(SMOOTH, state, OFF, loads, H)[1]
    response = found.response
    for side, rates, momentum in (
        ("left_torque", (response.left, response.cross), response.momentum_left),
        ("right_torque", (response.cross, response.right), response.momentum_right),
    ):
        load = getattr(loads, side)
        ahead = advance(SMOOTH, state, OFF, loads._replace(**{side: load + step}), H)[1]
        behind = advance(SMOOTH, state, OFF, loads._replace(**{side: load - step}), H)[1]
        if not ahead.ratchet == found.ratchet == behind.ratchet:
            continue  # a wheel engages or is held between the two
        slopes = (
            (ahead.left_rate - behind.left_rate) / 2 / step,
            (ahead.right_rate - behind.right_rate) / 2 / step,
        )
        assert slopes == pytest.approx(rates, rel=1e-5, abs=1e-6)
        slope = (ahead.momentum - behind.momentum) / 2 / step
        assert slope == pytest.approx(momentum, rel=1e-5, abs=1e-8)


@pytest.mark.parametrize(
    ("field", "value"), [("wheel_inertia", 0.0), ("efficiency", 0.0), ("motor_inertia", -1.0)]
)
def test_bad_values_are_refused_by_name(field: str, value: float) -> None:
    change: dict[str, Any] = {field: value}
    with pytest.raises(ValueError, match=field):
        dataclasses.replace(WheelDriveParameters(), **change)
