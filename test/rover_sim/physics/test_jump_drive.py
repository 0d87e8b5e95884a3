import dataclasses
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from two_bodies import JumpRun, Rig, advance, settled

from rover_sim.physics.mechanisms.jump_drive import (
    JumpCommand,
    JumpDrive,
    JumpDriveParameters,
    JumpEnergyBalance,
    JumpLoads,
    JumpState,
    Latch,
    at_trip,
    begin,
    end,
    initial_state,
    make_jump_drive,
    respond,
)
from rover_sim.physics.mechanisms.motor import MotorMode
from rover_sim.physics.mechanisms.shaft import FrictionParameters
from rover_sim.physics.mechanisms.slider import SliderParameters, make_slider

H = 1e-3
DRIVE = make_jump_drive(JumpDriveParameters())
SLIDER = make_slider(SliderParameters())
IDEAL = make_slider(SliderParameters(damping=0.0, friction=0.0))
RELAXED = JumpLoads(SLIDER.free_length, 0.0, 0.0)
OFF = JumpCommand(int(MotorMode.OFF), 0.0, 0.0, 0.0, math.inf, math.inf)


def torque(value: float) -> JumpCommand:
    return OFF._replace(mode=int(MotorMode.TORQUE), torque=value)


def run_to(position: float, rate: float = 0.02, trip: float = math.inf) -> JumpCommand:
    return JumpCommand(int(MotorMode.POSITION), 0.0, position, rate, math.inf, trip)


def residual(drive: JumpDrive, before: JumpState, balance: JumpEnergyBalance) -> float:
    """Residual of a step's energy balance [J]."""
    kinetic = 0.5 * drive.inertia * (before.rate + before.body_rate) ** 2
    heats = balance.screw_heat + balance.friction_heat + balance.stop_heat
    return (
        balance.kinetic
        - kinetic
        - (balance.motor_work + balance.body_work - balance.nut_work - heats)
    )


def momentum_of(state: JumpState) -> float:
    """Absolute momentum of the default drive's rotor [N m s]."""
    return DRIVE.inertia * (state.rate + state.body_rate)


def held_at(compression: float) -> JumpLoads:
    """A Body 2 that the nut at `compression` presses down with the spring's force."""
    depth = 824.0 * compression / SLIDER.nut_stiffness
    return JumpLoads(SLIDER.free_length - compression + depth, 0.0, 0.0)


# ------------------------------------------------------------------------------ the flywheel


def test_the_flywheel_coasts_down_by_the_closed_form() -> None:
    friction = FrictionParameters(5e-3, 5e-3, 5.0, 1e-4)
    drive = make_jump_drive(JumpDriveParameters(friction=friction, free_travel=0.2))
    start = initial_state(drive, -0.2)._replace(rate=200.0)
    state = start
    for _ in range(2000):
        state, _, _ = advance(drive, SLIDER, state, OFF, RELAXED, H)
    decay = math.exp(-1e-4 * 2.0 / drive.inertia)
    assert state.rate == pytest.approx((200.0 + 50.0) * decay - 50.0, rel=1e-6)
    turned = (250.0 / 0.1) * (1.0 - decay) - 50.0 * 2.0
    assert state.nut - start.nut == pytest.approx(turned * drive.pitch, rel=1e-6)


def test_the_flywheel_stops_by_stribecks_curve_and_stays_at_rest() -> None:
    # Rate from 5 rad/s by F(w): time = int J dw / F(w).
    friction = FrictionParameters(5e-3, 7e-3, 5.0, 0.0)
    drive = make_jump_drive(JumpDriveParameters(friction=friction))
    cells = 20_000
    exact = sum(
        5.0 / cells * drive.inertia / (5e-3 + 2e-3 * math.exp(-(((i + 0.5) / cells) ** 2)))
        for i in range(cells)
    )
    state, time = initial_state(drive)._replace(rate=5.0), 0.0
    while state.rate != 0.0:
        state, _, _ = advance(drive, SLIDER, state, OFF, RELAXED, H)
        time += H
    assert time == pytest.approx(exact, abs=2.0 * H)
    for drag in (6.99e-3, -6.99e-3):
        still, outputs, _ = advance(drive, SLIDER, state, torque(drag), RELAXED, H)
        assert still.rate == 0.0
        assert outputs.torque_on_body == 0.0
    assert advance(drive, SLIDER, state, torque(7.1e-3), RELAXED, H)[0].rate > 0.0


def test_flywheel_and_body_exchange_momentum() -> None:
    body, rate, state = 0.2, 0.0, initial_state(DRIVE)
    for command in [torque(0.1)] * 400 + [torque(-0.1)] * 700 + [OFF] * 15000:
        state, outputs, _ = advance(
            DRIVE, SLIDER, state, command, RELAXED._replace(body_rate=rate), H
        )
        rate += outputs.torque_on_body * H / body
        assert body * rate + momentum_of(state) == pytest.approx(0.0, abs=1e-13)
    # All friction and stops are internal: with the flywheel at rest the body is, too.
    assert state.rate == 0.0
    assert rate == pytest.approx(0.0, abs=1e-12)


def test_a_flywheel_at_rest_turns_with_the_body() -> None:
    state = initial_state(DRIVE)
    for i in range(300):
        loads = RELAXED._replace(body_rate=0.1 * math.sin(0.03 * i))
        state, _, balance = advance(DRIVE, SLIDER, state, OFF, loads, H)
        assert (state.rate, state.nut) == (0.0, -0.03)
        assert momentum_of(state) == pytest.approx(DRIVE.inertia * loads.body_rate, abs=1e-18)
        assert balance.friction_heat == 0.0


def test_thirty_turns_of_free_travel_are_the_bodys_54_degrees() -> None:
    body, rate, angle = 0.2, 0.0, 0.0
    state = initial_state(DRIVE, -DRIVE.free_travel)
    while state.nut < 0.0:
        command = torque(0.1 if state.nut < -0.03 else -0.08)
        state, outputs, _ = advance(
            DRIVE, SLIDER, state, command, RELAXED._replace(body_rate=rate), H
        )
        angle += H * (rate + 0.5 * outputs.torque_on_body * H / body)
        rate += outputs.torque_on_body * H / body
    turns = 60.0 * math.pi
    # The rotor turns back against the body: J (v + W) + I W = 0, so W = -J v/(I + J).
    assert angle == pytest.approx(-turns * DRIVE.inertia / (body + DRIVE.inertia), rel=2e-3)
    assert math.degrees(-angle) == pytest.approx(54.0, rel=0.01)


@pytest.mark.parametrize(
    ("start", "rate", "end", "flag"),
    [
        (-0.05995, -200.0, -DRIVE.free_travel, -1),
        (0.20995, 200.0, DRIVE.stroke + DRIVE.over_travel, 1),
    ],
)
def test_the_ends_of_the_screw_stop_the_nut_at_once(
    start: float, rate: float, end: float, flag: int
) -> None:
    latch = int(Latch.RELEASED if flag > 0 else Latch.FREE)
    before = JumpState(latch, start, rate, 0.0, 0.0, math.inf, 0.0)
    state, outputs, balance = advance(DRIVE, SLIDER, before, OFF, RELAXED, H)
    assert (state.nut, state.rate, outputs.hard_limit) == (end, 0.0, flag)
    assert outputs.torque_on_body * H == pytest.approx(DRIVE.inertia * rate, rel=1e-3)
    assert balance.stop_heat == pytest.approx(0.5 * DRIVE.inertia * rate**2, rel=1e-2)
    assert residual(DRIVE, before, balance) == pytest.approx(0.0, abs=1e-12)
    state, outputs, _ = advance(DRIVE, SLIDER, state, torque(-0.05 * flag), RELAXED, H)
    assert state.rate * flag < 0.0
    assert outputs.hard_limit == 0


# --------------------------------------------------------------------------------- the screw


@pytest.mark.parametrize(("force", "drive_torque"), [(165.0, 0.058), (165.0, 0.047)])
def test_drive_and_back_drive_torque_of_the_default_screw(
    force: float, drive_torque: float
) -> None:
    frictionless = make_jump_drive(
        JumpDriveParameters(stroke=0.3, friction=FrictionParameters(0.0, 0.0, 1.0, 0.0))
    )
    compression = force / 824.0
    state = JumpState(int(Latch.ENGAGED), compression, 0.0, 0.0, 0.0, math.inf, 0.0)
    loads = held_at(compression)

    def rate(value: float) -> float:
        return float(advance(frictionless, SLIDER, state, torque(value), loads, H)[0].rate)

    exact = force * 2e-3 / (2.0 * math.pi)
    if drive_torque > exact:
        exact /= 0.9
        assert rate(exact * 1.001) > 0.0
    else:
        exact *= 2.0 - 1.0 / 0.9
        assert rate(exact * 0.999) < 0.0
    assert exact == pytest.approx(drive_torque, abs=5e-4)
    assert rate(0.5 * (0.058 + 0.047)) == 0.0


def test_a_screw_of_low_efficiency_holds_by_itself() -> None:
    locking = make_jump_drive(JumpDriveParameters(efficiency=0.45))
    assert locking.back_efficiency < 0.0
    state = JumpState(int(Latch.ENGAGED), 0.19, 0.0, 0.0, 0.0, math.inf, 0.0)
    for drive, holds in ((locking, True), (DRIVE, False)):
        after = advance(drive, SLIDER, state, OFF, held_at(0.19), H)[0]
        assert (after.rate == 0.0) is holds
    assert advance(locking, SLIDER, state, torque(-0.04), held_at(0.19), H)[0].rate < 0.0


# ------------------------------------------------------------------------- latch and release


def test_the_trip_is_located_inside_the_step() -> None:
    trip = 0.15
    at = trip * (1.0 + 824.0 / SLIDER.nut_stiffness)
    rate = 0.02 / DRIVE.pitch
    for fraction in (0.2, 0.5, 0.9):
        nut = at - fraction * 0.02 * H
        state = JumpState(int(Latch.COMPRESSING), nut, rate, 0.0, 0.0, math.inf, 0.0)
        force = 824.0 * trip
        holding = torque(force * DRIVE.pitch / 0.9 + 5e-3 + 1e-5 * rate)
        loads = JumpLoads(SLIDER.free_length - nut + force / 2e6, -0.02, 0.0)
        command = holding._replace(trip=trip)
        step = begin(DRIVE, SLIDER, state, command, loads, H)
        assert step.tripped
        assert step.elapsed == pytest.approx(fraction * H, rel=1e-3)
        response = respond(DRIVE, SLIDER, state, step, loads)
        after, _, balance = end(DRIVE, SLIDER, state, step, loads, response)
        assert after.latch == Latch.RELEASED
        assert after.nut == pytest.approx(at, abs=1e-12)
        assert after.trip_force == pytest.approx(force, rel=1e-9)
        assert residual(DRIVE, state, balance) == pytest.approx(0.0, abs=1e-14)


def test_a_trip_that_is_already_due_ends_the_step_at_once() -> None:
    state = JumpState(int(Latch.COMPRESSING), 0.16, 10.0, 0.0, 0.0, math.inf, 0.0)
    command = run_to(0.2, trip=0.15)
    step = begin(DRIVE, SLIDER, state, command, held_at(0.16), H)
    assert step.tripped
    assert step.elapsed == 0.0
    after = at_trip(state, step)
    assert (after.nut, after.rate, after.latch) == (0.16, 10.0, Latch.RELEASED)
    assert after.trip_force == pytest.approx(824.0 * 0.16, rel=0.1)


def test_a_releasing_latch_gives_the_mean_of_its_force_over_each_step() -> None:
    state = JumpState(int(Latch.RELEASED), 0.2, 0.0, 0.0, 0.0, 0.0, 160.0)
    impulse, time = 0.0, 0.0
    for h in (0.4e-3, 1e-3, 1e-3):
        leaving = RELAXED._replace(slider_rate=0.1)
        state, outputs, _ = advance(DRIVE, SLIDER, state, OFF, leaving, h)
        impulse += outputs.nut_force * h
        time += h
    assert impulse == pytest.approx(0.5 * 160.0 * 1.5e-3, rel=1e-12)
    assert outputs.nut_force == pytest.approx(160.0 * 0.5 * 0.1e-3 / 1.5e-3 * 0.1)
    assert state.released_for == math.inf


@pytest.mark.parametrize(
    ("latch", "rate", "away"), [(Latch.RELEASED, 0.0, 1.0), (Latch.HOOKING, -30.0, -1.0)]
)
@pytest.mark.parametrize("h", [1e-3, 2e-2])
def test_a_latch_that_lets_go_resists_and_does_not_push(
    latch: Latch, rate: float, away: float, h: float
) -> None:
    state = JumpState(int(latch), 0.01, rate, 0.0, 0.0, 0.0, 160.0)
    loads = JumpLoads(SLIDER.free_length - 0.0095, 0.0, 0.0)
    step = begin(DRIVE, SLIDER, state, OFF, loads, h)
    assert step.latch_force * away > 0.0
    shaft = DRIVE.pitch * rate
    for relative in (-1.0, -0.1, -1e-3, -1e-4, 0.0, 1e-4, 1e-3, 0.1, 1.0):
        moving = loads._replace(slider_rate=relative - shaft)
        found = respond(DRIVE, SLIDER, state, step, moving)
        gap_rate = moving.slider_rate + DRIVE.pitch * (found.motion.first + found.motion.second) / h
        # against the direction that it resists it has a force only at some mm/s
        assert found.force * gap_rate > -abs(step.latch_force) * 1e-3
        if gap_rate * away > 0.0:
            assert found.force == step.latch_force
        if gap_rate * away < -3e-3:
            assert found.force == 0.0
        ahead = respond(
            DRIVE, SLIDER, state, step, moving._replace(slider_rate=moving.slider_rate + 1e-7)
        )
        assert (ahead.force - found.force) / (1e-7 * h) == pytest.approx(
            found.force_by_change, rel=1e-3, abs=1e-6
        )


def test_a_latch_that_trips_off_the_nut_has_no_force_to_release() -> None:
    # Body 2 approaches fast enough to press the nut with kilonewtons within the step.
    state = JumpState(int(Latch.COMPRESSING), 0.16, 10.0, 0.0, 0.0, math.inf, 0.0)
    loads = JumpLoads(SLIDER.free_length - 0.1601, 0.5, 0.0)
    step = begin(DRIVE, SLIDER, state, run_to(0.2, trip=0.15), loads, 2e-2)
    assert step.tripped
    assert step.elapsed == 0.0
    assert at_trip(state, step).trip_force == 0.0


def test_without_a_set_compression_the_latch_trips_at_the_strokes_end() -> None:
    run = JumpRun(Rig(6.0, 4.0, 1.62, True), DRIVE, SLIDER, settled(DRIVE, SLIDER, 0.195))
    run.until_tripped(run_to(0.21))
    assert run.compression == pytest.approx(0.2, abs=2e-5)


@pytest.mark.slow
def test_the_latch_passes_all_states_of_a_jump() -> None:
    rig = Rig(6.0, 4.0, 1.62, on_floor=True)
    run = JumpRun(rig, DRIVE, SLIDER, initial_state(DRIVE))
    run.steps(run_to(-1e-3), 3000)
    assert run.visited == [Latch.FREE]
    run.until_tripped(run_to(0.2, 0.05, trip=0.10))
    assert run.visited == [Latch.FREE, Latch.COMPRESSING, Latch.RELEASED]
    run.visited.clear()
    run.steps(OFF, 1500)
    assert set(run.visited) == {Latch.RELEASED}
    run.steps(run_to(-0.01, 0.05), 8000)
    assert run.visited == [Latch.RELEASED, Latch.HOOKING, Latch.FREE]
    assert run.state.nut == pytest.approx(-0.01, abs=1e-4)
    # After hooking, it compresses again.
    run.steps(run_to(0.02, 0.05), 3000)
    assert run.compression == pytest.approx(0.02, abs=1e-4)


@pytest.mark.slow
def test_an_interrupted_compression_is_held_and_let_down_softly() -> None:
    run = JumpRun(Rig(6.0, 4.0, 1.62, True), DRIVE, SLIDER, settled(DRIVE, SLIDER, 0.05))
    run.steps(run_to(0.10, 0.05), 3500)
    assert run.compression == pytest.approx(0.10, abs=2e-4)
    assert run.state.latch == Latch.ENGAGED
    run.visited.clear()
    fastest = run.steps(run_to(-0.02, 0.05), 6000)
    assert run.visited == [Latch.ENGAGED, Latch.FREE]
    # Body 2 is back on its spring, which its weight compresses by 8 mm.
    assert run.compression == pytest.approx(4.0 * 1.62 / 824.0, abs=1.3e-3)
    assert fastest == pytest.approx(0.05, rel=0.1)
    assert run.z1 == 0.0


@pytest.mark.slow
def test_a_compression_without_motor_torque_drives_the_screw_back() -> None:
    run = JumpRun(Rig(6.0, 4.0, 1.62, True), DRIVE, SLIDER, settled(DRIVE, SLIDER, 0.15))
    run.steps(OFF, 12000)
    assert run.state.latch == Latch.FREE
    assert run.state.rate == 0.0
    assert run.state.nut < 0.0
    assert run.drift == pytest.approx(0.0, abs=2e-3)


# ------------------------------------------------------------------------------------- jumps


@pytest.mark.parametrize(
    ("m1", "m2", "height", "h"),
    [
        (3.0, 2.0, 0.782, 2e-4),
        (10.0, 0.5, 0.0457, 5e-5),
        (10.0, 0.05, 0.0050, 1e-5),
        (6.0, 4.0, 0.3748, 2e-4),
    ],
)
@pytest.mark.slow
def test_jump_heights_of_the_closed_form(m1: float, m2: float, height: float, h: float) -> None:
    g, stroke = 1.62, 0.2
    energy = 0.5 * 824.0 * stroke**2
    v2 = math.sqrt(2.0 * (energy - m2 * g * stroke) / m2)
    take_off = m2 * v2 / (m1 + m2)
    exact = take_off**2 / (2.0 * g)
    assert exact == pytest.approx(height, rel=0.01)
    drive = make_jump_drive(JumpDriveParameters(release_time=0.0))
    run = JumpRun(Rig(m1, m2, g, True), drive, IDEAL, settled(drive, IDEAL, 0.1995), h=h)
    run.until_tripped(run_to(0.21, trip=stroke))
    run.until_airborne(OFF)
    assert run.fastest == pytest.approx(v2, rel=2e-3)
    assert run.take_off == pytest.approx(take_off, rel=5e-3)
    assert run.take_off**2 / (2.0 * g) == pytest.approx(exact, rel=0.01)


def test_the_default_rovers_full_cycle_at_steps_of_a_millisecond() -> None:
    rig = Rig(6.0, 4.0, 1.62, on_floor=True)
    run = JumpRun(rig, DRIVE, SLIDER, initial_state(DRIVE))
    run.until_tripped(run_to(0.21, 0.02, trip=0.2))
    # The nut's work: spring and nut compressed, Body 2 lowered from where it stood on its spring,
    # and the slider's friction of 1 N.
    x, n, sag = run.compression, run.state.trip_force, 4.0 * 1.62 / 824.0
    stored = 0.5 * 824.0 * (x**2 - sag**2) + n**2 / (2.0 * SLIDER.nut_stiffness)
    lowered = 4.0 * 1.62 * (x - sag)
    expected = stored - lowered + (1.0 + 0.2 * 0.02) * (x - sag)
    assert run.balance["nut_work"] == pytest.approx(expected, rel=5e-4)
    into_screw = run.balance["motor_work"] - run.balance["friction_heat"] - run.kinetic
    assert into_screw == pytest.approx(run.balance["nut_work"] / 0.9, rel=1e-9)
    run.until_airborne(OFF)
    height = run.take_off**2 / (2.0 * 1.62)
    assert height == pytest.approx(0.3748, rel=0.03)
    run.steps(OFF, 500)
    assert run.drift == pytest.approx(0.0, abs=1e-3 * run.balance["motor_work"])
    assert run.slider_heat >= 0.0


def test_a_release_in_free_flight_keeps_momentum_and_energy() -> None:
    drive = make_jump_drive(JumpDriveParameters(release_time=1.5e-3))
    run = JumpRun(Rig(6.0, 4.0, 0.0, on_floor=False), drive, IDEAL, settled(drive, IDEAL, 0.199))
    run.until_tripped(run_to(0.21, trip=0.2))
    run.h = 2e-4
    before = run.momentum
    while run.compression > 2e-3:
        run.steps(OFF, 1)
        assert run.momentum == pytest.approx(before, abs=1e-12)
    energy = 0.5 * 6.0 * run.v1**2 + 0.5 * 4.0 * run.v2**2 + 0.5 * 824.0 * run.compression**2
    # The latch's holding force and the nut's deflection take less than 1/300 of the spring's.
    assert energy == pytest.approx(0.5 * 824.0 * 0.2**2, rel=3e-3)
    run.steps(OFF, 2000)
    assert run.momentum == pytest.approx(before, abs=1e-12)


@pytest.mark.parametrize("h", [1e-3, 4e-3, 1e-2])
@pytest.mark.parametrize("m2", [0.05, 0.5, 4.0])
def test_a_light_body_2_under_a_stiff_nut_takes_no_energy_from_nowhere(m2: float, h: float) -> None:
    # The nut on Body 2 oscillates at sqrt(k/m2): up to 6300 rad/s, 60 rad in a step.
    run = JumpRun(Rig(6.0, m2, 1.62, True), DRIVE, SLIDER, settled(DRIVE, SLIDER, 0.01), h=h)
    run.steps(run_to(0.15, 0.06), round(4.0 / h))
    x = run.compression
    assert x == pytest.approx(0.15, abs=2e-3)
    assert run.drift == pytest.approx(0.0, abs=1e-9)
    # The spring, the nut, the weight of Body 2 and the friction of 1 N.
    work = 0.5 * 824.0 * (x**2 - 0.01**2) + (1.0 - m2 * 1.62) * (x - 0.01)
    assert run.balance["nut_work"] == pytest.approx(work, rel=2e-3)
    assert run.slider_heat == pytest.approx(x - 0.01, rel=0.02)


def test_the_response_has_the_derivatives_that_it_states() -> None:
    h, e = 1e-3, 1e-9
    state = JumpState(int(Latch.COMPRESSING), 0.1001, 30.0, 0.2, 0.0, math.inf, 0.0)
    loads = JumpLoads(SLIDER.free_length - 0.1, -0.01, 0.25)
    light = make_jump_drive(JumpDriveParameters(inertia=1e-5))
    step = begin(light, SLIDER, state, torque(0.1), loads, h)
    here = respond(light, SLIDER, state, step, loads)
    assert here.force > 100.0
    moved = respond(light, SLIDER, state, step, loads._replace(slider_rate=-0.01 + e / h))
    turned = respond(light, SLIDER, state, step, loads._replace(body_rate=0.25 + 1e-5))
    for ahead, step_size, by_force, by_momentum in (
        (moved, e, here.force_by_change, here.momentum_by_change),
        (turned, 1e-5, here.force_by_rate, here.momentum_by_rate),
    ):
        assert (ahead.force - here.force) / step_size == pytest.approx(by_force, rel=2e-2)
        assert (ahead.momentum - here.momentum) / step_size == pytest.approx(
            by_momentum, rel=5e-2, abs=1e-10
        )


@pytest.mark.parametrize("body", [0.01, 0.1])
def test_a_stop_of_the_screw_heats_by_its_relative_energy_alone(body: float) -> None:
    # The body takes over J v: of J v^2/2 it keeps the share J/(J + I).
    before = JumpState(int(Latch.FREE), -0.05999, -200.0, 0.0, 0.0, math.inf, 0.0)
    rate = 0.0
    for _ in range(50):
        loads = RELAXED._replace(body_rate=rate)
        state, outputs, balance = advance(DRIVE, SLIDER, before, OFF, loads, H)
        rate = outputs.torque_on_body * H / body
    moving = 0.5 * DRIVE.inertia * 200.0**2
    assert balance.kinetic + balance.stop_heat + balance.friction_heat + 0.5 * body * rate**2 == (
        pytest.approx(moving, rel=1e-9)
    )
    assert balance.stop_heat == pytest.approx(moving * body / (body + DRIVE.inertia), rel=1e-2)
    assert state.rate == 0.0


# ------------------------------------------------------------------------------ any and all

COMMANDS = st.builds(
    JumpCommand,
    st.sampled_from([int(mode) for mode in MotorMode]),
    st.floats(-0.2, 0.2),
    st.floats(-0.06, 0.21),
    st.floats(-0.08, 0.08),
    st.sampled_from([math.inf, 100.0]),
    st.sampled_from([math.inf, 0.02, 0.1]),
)


@settings(max_examples=40, deadline=None)
@given(
    efficiency=st.floats(0.3, 1.0),
    inertia=st.floats(1e-5, 1e-2),
    start=st.floats(0.0, 0.19),
    on_floor=st.booleans(),
    script=st.lists(st.tuples(COMMANDS, st.floats(-2.0, 2.0)), min_size=1, max_size=6),
)
def test_energy_balances_and_never_increases_over_random_runs(
    efficiency: float,
    inertia: float,
    start: float,
    on_floor: bool,
    script: list[tuple[JumpCommand, float]],
) -> None:
    drive = make_jump_drive(JumpDriveParameters(efficiency=efficiency, inertia=inertia))
    run = JumpRun(
        Rig(6.0, 4.0, 1.62 if on_floor else 0.0, on_floor),
        drive,
        SLIDER,
        settled(drive, SLIDER, start),
        h=5e-4,
    )
    turnover = 20.0
    for command, body_rate in script:
        run.body_rate = body_rate
        for _ in range(60):
            before = run.state
            run.steps(command, 1)
            balance = run.last
            heats = (balance.screw_heat, balance.friction_heat, balance.stop_heat)
            work = abs(balance.motor_work) + abs(balance.nut_work) + abs(balance.body_work)
            scale = balance.kinetic + work + balance.stop_heat + 1e-9
            assert min(heats) >= -1e-12 * scale
            assert abs(residual(drive, before, balance)) <= 1e-9 * scale
            assert -0.06 <= run.state.nut <= 0.21
            assert math.isfinite(run.state.rate)
            assert math.isfinite(run.v2)
            turnover += work
    assert run.slider_heat >= -1e-9 * turnover


@pytest.mark.parametrize(
    ("field", "value"),
    [("lead", 0.0), ("efficiency", 1.1), ("inertia", math.nan), ("release_time", -1e-3)],
)
def test_bad_values_are_refused_by_name(field: str, value: float) -> None:
    change: dict[str, Any] = {field: value}
    with pytest.raises(ValueError, match=field):
        dataclasses.replace(JumpDriveParameters(), **change)


def test_a_nut_outside_its_free_travel_is_refused() -> None:
    with pytest.raises(ValueError, match=r"nut = 0\.1"):
        initial_state(DRIVE, 0.1)
