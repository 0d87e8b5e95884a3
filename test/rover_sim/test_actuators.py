"""Watchdogs and refusals of the drives, without ROS and with a cheap plant."""

from __future__ import annotations

import itertools
import math
from typing import Any

import pytest
from fake_plant import (
    DECELERATIONS,
    EVERYTHING,
    HELD_BY_THE_GROUND,
    FakePlant,
    FakeState,
    fake_interface,
)

from msg_schemas import machine, topics
from msg_schemas.events import EventReport, PlantEvent, SimulationEvent
from msg_schemas.phases import PlantPhase
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample, JointValue
from msg_schemas.table import TOPICS
from rover_runtime.pacing import NANO
from rover_sim.devices.actuators import COMMANDS, Actuators, DriveFeedback
from rover_sim.devices.equipment import Equipment
from rover_sim.node.sim_loop import Simulation
from rover_sim.plants.plant import (
    FlywheelCommand,
    FlywheelRateCommand,
    JumpMotorCommand,
    PlantCommand,
    WheelRateCommand,
    WheelTorqueCommand,
    WinchCommand,
)

TICK = 0.01
PAYING_OUT = 0.3
TIMEOUT = TOPICS[topics.WINCH_COMMAND].stale.timeout_moving
STOPPING_TIME = PAYING_OUT / DECELERATIONS.winch
HANGING = DriveFeedback(PlantPhase.HANGING, -0.03)


def nut(position: float) -> JointSample:
    return JointSample(0, {machine.JUMP_SCREW: JointValue(position, 0.1, 400.0)})


def held_nut(position: float, latch: float = 0.0) -> JointSample:
    joints = {
        machine.JUMP_SCREW: JointValue(position, 0.1, 400.0),
        machine.JUMP_LATCH: JointValue(latch),
    }
    return JointSample(0, joints)


def flywheel(torque: float) -> JointSample:
    return JointSample(0, {machine.FLYWHEEL: JointValue(effort=torque)})


def wheels(rate: float, torque: float = 2.0) -> JointSample:
    return JointSample(0, {machine.WHEEL_DRIVE: JointValue(0.0, rate, torque)})


def wheel_torque(torque: float) -> JointSample:
    return JointSample(0, {machine.WHEEL_DRIVE: JointValue(effort=torque)})


def drum(rate: float, brake: float = 1.0, feed_forward: float = 16.0) -> JointSample:
    joints = {
        machine.WINCH_DRUM: JointValue(5.0, rate, feed_forward),
        machine.WINCH_BRAKE: JointValue(brake),
        machine.WINCH_LIMIT: JointValue(effort=40.0),
    }
    return JointSample(0, joints)


GOOD = {
    topics.JUMP_MOTOR_COMMAND: nut(0.2),
    topics.FLYWHEEL_COMMAND: flywheel(0.01),
    topics.WHEEL_COMMAND: wheels(3.0),
    topics.WHEEL_TORQUE_COMMAND: wheel_torque(0.1),
    topics.WINCH_COMMAND: drum(PAYING_OUT),
}


@pytest.fixture
def actuators() -> Actuators:
    return Actuators(EVERYTHING, round(TICK * NANO))


@pytest.fixture
def simulation() -> Simulation[FakeState]:
    return Simulation(fake_interface(EVERYTHING), TICK)


def run_to(simulation: Simulation[FakeState], time: float) -> list[EventReport]:
    happened: list[EventReport] = []
    while simulation.stamp_ns < round(time * NANO):
        happened += simulation.tick().event_reports
    return happened


def applied_commands(simulation: Simulation[FakeState]) -> list[PlantCommand]:
    """Commands of the plant, tick by tick."""
    assert isinstance(simulation.plant, FakePlant)
    return simulation.plant.commands


def refusal_of(
    actuators: Actuators, topic: str, sample: JointSample, states: DriveFeedback = HANGING
) -> Refusal:
    with pytest.raises(Refusal) as caught:
        actuators.accept_command(topic, sample, states, 0)
    assert caught.value.subject == topic
    assert actuators.command == PlantCommand()
    return caught.value


# ------------------------------------------------------------------------------- what reaches them


def test_every_command_reaches_the_plant_with_its_values(actuators: Actuators):
    for topic in (topics.JUMP_MOTOR_COMMAND, topics.WHEEL_COMMAND, topics.WINCH_COMMAND):
        actuators.accept_command(topic, GOOD[topic], HANGING, 0)
    command = actuators.command
    assert command.jump == JumpMotorCommand(0.2, 0.1, 400.0)
    assert command.wheel == WheelRateCommand(3.0, 2.0)
    assert command.winch == WinchCommand(5.0, PAYING_OUT, 16.0, True, 40.0)


def test_a_motor_follows_its_latest_command(actuators: Actuators):
    for topic in (topics.JUMP_MOTOR_COMMAND, topics.FLYWHEEL_COMMAND):
        actuators.accept_command(topic, GOOD[topic], HANGING, 0)
    for topic in (topics.WHEEL_COMMAND, topics.WHEEL_TORQUE_COMMAND):
        actuators.accept_command(topic, GOOD[topic], HANGING, 0)
    assert actuators.command == PlantCommand(FlywheelCommand(0.01), None, WheelTorqueCommand(0.1))
    actuators.accept_command(topics.JUMP_MOTOR_COMMAND, nut(-0.05), HANGING, 0)
    actuators.accept_command(topics.WHEEL_COMMAND, wheels(-1.0), HANGING, 0)
    assert actuators.command == PlantCommand(
        JumpMotorCommand(-0.05, 0.1, 400.0), None, WheelRateCommand(-1.0, 2.0)
    )


def test_the_drives_topics_are_those_of_the_contract():
    assert set(COMMANDS) == {n for n, r in TOPICS.items() if n.endswith("command") and r.joints}


# ------------------------------------------------------------------------------------- watchdogs


@pytest.mark.parametrize("rate", [PAYING_OUT, -PAYING_OUT])
def test_a_winch_without_commands_ramps_down_and_closes_its_brake_at_rest(
    simulation: Simulation[FakeState], rate: float
):
    simulation.accept_command(topics.WINCH_COMMAND, drum(rate))
    happened = run_to(simulation, 2.0)
    assert [(h.name, h.values["drive"]) for h in happened] == [
        (SimulationEvent.COMMAND_TIMEOUT, "winch")
    ]
    assert happened[0].stamp_ns == round(TIMEOUT * NANO)
    assert happened[0].values["rate"] == rate
    commands = [c.winch for c in applied_commands(simulation) if c.winch is not None]
    begin = round(TIMEOUT / TICK)
    rates = [c.rate for c in commands]
    assert rates[:begin] == [rate] * begin
    ramp = [after - before for before, after in itertools.pairwise(rates[begin - 1 :])]
    steps = round(STOPPING_TIME / TICK)
    down = -math.copysign(DECELERATIONS.winch * TICK, rate)
    assert ramp[:steps] == pytest.approx([down] * steps)
    assert not any(rates[begin + steps :])
    # The motor holds the load until the brake is closed, then it is off.
    assert [c.brake_released for c in commands] == [True] * (len(commands) - 1) + [False]
    assert commands[-1].feed_forward == 16.0
    assert len(commands) <= begin + steps + 3
    assert applied_commands(simulation)[-1].winch is None
    assert not simulation.state.brake_released
    distance = abs(simulation.state.length - 5.0)
    expected = PAYING_OUT * TIMEOUT + 0.5 * PAYING_OUT * STOPPING_TIME
    assert distance == pytest.approx(expected, abs=PAYING_OUT * TICK)
    assert distance < 0.2


@pytest.mark.parametrize("tick", [0.003, 0.007, 0.03, 0.05])
def test_no_tick_is_long_enough_to_stop_late(tick: float):
    simulation = Simulation(fake_interface(EVERYTHING), tick)
    simulation.accept_command(topics.WINCH_COMMAND, drum(PAYING_OUT))
    run_to(simulation, 2.0)
    time = (simulation.state.length - 5.0) / PAYING_OUT - 0.5 * STOPPING_TIME
    assert TIMEOUT - 2.0 * tick < time <= TIMEOUT + 1e-9


def test_a_gap_of_a_quarter_of_a_second_does_not_stop_the_winch(
    simulation: Simulation[FakeState],
):
    happened = []
    for step in range(20):
        simulation.accept_command(topics.WINCH_COMMAND, drum(PAYING_OUT))
        happened += run_to(simulation, 0.25 * (step + 1))
    assert not happened
    assert simulation.state.length == pytest.approx(5.0 + 20 * 0.25 * PAYING_OUT)


def test_a_winch_in_its_quick_stop_refuses_motion_and_starts_again_from_rest(
    simulation: Simulation[FakeState],
):
    simulation.accept_command(topics.WINCH_COMMAND, drum(PAYING_OUT))
    run_to(simulation, 0.5)
    for rate in (PAYING_OUT, 0.0):
        with pytest.raises(Refusal, match="quick stop") as caught:
            simulation.accept_command(topics.WINCH_COMMAND, drum(rate))
        assert caught.value.code is RefusalCode.WRONG_PHASE
    run_to(simulation, 1.5)
    assert not simulation.state.brake_released
    for _ in range(2):
        with pytest.raises(Refusal, match="it must be 0 first"):
            simulation.accept_command(topics.WINCH_COMMAND, drum(PAYING_OUT))
        # A command that leaves the brake closed is none to rest.
        simulation.accept_command(topics.WINCH_COMMAND, drum(PAYING_OUT, brake=0.0))
    simulation.accept_command(topics.WINCH_COMMAND, drum(0.0))
    simulation.accept_command(topics.WINCH_COMMAND, drum(PAYING_OUT))
    run_to(simulation, 1.6)
    assert simulation.state.payout_rate == PAYING_OUT


def test_a_command_to_close_the_brake_ends_a_quick_stop(simulation: Simulation[FakeState]):
    simulation.accept_command(topics.WINCH_COMMAND, drum(PAYING_OUT))
    run_to(simulation, 0.5)
    assert simulation.is_stopping(topics.WINCH_COMMAND)
    simulation.accept_command(topics.WINCH_COMMAND, drum(0.0, brake=0.0))
    run_to(simulation, 0.51)
    assert not simulation.state.brake_released
    simulation.accept_command(topics.WINCH_COMMAND, drum(PAYING_OUT))


def test_a_winch_at_rest_with_its_brake_open_stays_so_until_the_timeout(
    simulation: Simulation[FakeState],
):
    simulation.accept_command(topics.WINCH_COMMAND, drum(0.0))
    happened = run_to(simulation, 1.0)
    assert [h.values["drive"] for h in happened] == ["winch"]
    assert happened[0].stamp_ns == round(0.5 * NANO)


def test_a_drum_that_turns_against_its_command_has_the_timeout_of_a_moving_one(
    actuators: Actuators,
):
    actuators.accept_command(topics.WINCH_COMMAND, drum(0.0), HANGING, 0)
    at = round(0.26 * NANO)
    assert not actuators.step(HANGING, at)
    dragged = HANGING._replace(payout_rate=0.05)
    assert [s.values["drive"] for s in actuators.step(dragged, at)] == ["winch"]
    assert actuators.command.winch is not None
    # It slows down from the rate at which it turns, not from the commanded one.
    slower = 0.05 - DECELERATIONS.winch * TICK
    assert actuators.command.winch.rate == pytest.approx(slower)


def test_a_winch_with_its_brake_closed_needs_no_commands(simulation: Simulation[FakeState]):
    simulation.accept_command(topics.WINCH_COMMAND, drum(0.0, brake=0.0))
    assert not run_to(simulation, 2.0)
    assert applied_commands(simulation)[-1].winch is None


def test_commands_at_the_contract_s_rate_keep_every_drive_active(
    simulation: Simulation[FakeState],
):
    for topic in (topics.FLYWHEEL_COMMAND, topics.WHEEL_COMMAND, topics.WINCH_COMMAND):
        rate = TOPICS[topic].rate
        assert rate is not None
        period, happened = 1.0 / rate, []
        begin = simulation.stamp_ns / NANO
        for step in range(100):
            if step % 10 != 5:  # one in ten is lost
                simulation.accept_command(topic, GOOD[topic])
            happened += run_to(simulation, begin + (step + 1) * period)
        assert not happened
        run_to(simulation, simulation.stamp_ns / NANO + 1.0)


@pytest.mark.parametrize(
    ("topic", "drive", "deceleration"),
    [
        (topics.FLYWHEEL_COMMAND, "flywheel", DECELERATIONS.flywheel),
        (topics.WHEEL_COMMAND, "wheel_motor", DECELERATIONS.wheels),
        (topics.WHEEL_TORQUE_COMMAND, "wheel_motor", DECELERATIONS.wheels),
    ],
)
def test_other_rotors_ramp_down_after_the_contract_s_timeout_and_are_off_at_rest(
    simulation: Simulation[FakeState], topic: str, drive: str, deceleration: float
):
    simulation.accept_command(topic, GOOD[topic])
    happened = run_to(simulation, 4.0)
    assert [h.values["drive"] for h in happened] == [drive]
    timeout = TOPICS[topic].stale.timeout
    assert happened[0].stamp_ns == round(timeout * NANO)
    rate = float(str(happened[0].values["rate"]))
    assert rate > 0.01
    commands = [c.jump or c.wheel for c in applied_commands(simulation)]
    ramp = [
        c.rate
        for c in commands[round(timeout / TICK) :]
        if isinstance(c, FlywheelRateCommand | WheelRateCommand)
    ]
    assert ramp[0] == pytest.approx(max(rate - deceleration * TICK, 0.0))
    assert len(ramp) * TICK == pytest.approx(rate / deceleration, abs=2.0 * TICK)
    assert ramp == sorted(ramp, reverse=True)
    assert commands[-1] is None
    assert simulation.state.wheel_rate == simulation.state.flywheel_rate == 0.0


@pytest.mark.parametrize(
    ("topic", "released"),
    [
        (topics.FLYWHEEL_COMMAND, flywheel(0.0)),
        (topics.WHEEL_COMMAND, wheels(0.0)),
        (topics.WHEEL_TORQUE_COMMAND, wheel_torque(0.0)),
    ],
)
def test_a_rotor_that_turns_after_the_command_zero_is_stopped_too(
    actuators: Actuators, topic: str, released: JointSample
):
    spinning = HANGING._replace(flywheel_rate=20.0, wheel_rate=20.0)
    actuators.accept_command(topic, released, spinning, 0)
    assert not actuators.step(spinning, NANO)
    assert actuators.is_stopping(topic)
    command = actuators.command.jump or actuators.command.wheel
    assert isinstance(command, FlywheelRateCommand | WheelRateCommand)
    assert 19.0 < command.rate < 20.0


def test_a_wheel_that_does_not_come_to_rest_is_switched_off(actuators: Actuators):
    actuators.accept_command(topics.WHEEL_COMMAND, wheels(1.0), HANGING, 0)
    rolling = HANGING._replace(wheel_rate=1.0)
    actuators.quick_stop(topics.WHEEL_COMMAND, rolling)
    ticks = 0
    while actuators.command.wheel is not None:
        actuators.step(rolling, 0)
        ticks += 1
    assert ticks * TICK == pytest.approx(1.0 / DECELERATIONS.wheels + 0.2, abs=3.0 * TICK)


def test_a_new_command_replaces_the_quick_stop_of_a_rotor(actuators: Actuators):
    for topic in (topics.WHEEL_COMMAND, topics.FLYWHEEL_COMMAND):
        spinning = HANGING._replace(wheel_rate=5.0, flywheel_rate=50.0)
        actuators.accept_command(topic, GOOD[topic], spinning, 0)
        actuators.quick_stop(topic, spinning)
        actuators.step(spinning, 0)
        assert actuators.is_stopping(topic)
        actuators.accept_command(topic, GOOD[topic], spinning, 0)
        assert not actuators.is_stopping(topic)
    assert actuators.command == PlantCommand(
        FlywheelCommand(0.01), None, WheelRateCommand(3.0, 2.0)
    )


def test_a_nut_without_commands_comes_to_rest_where_its_deceleration_allows_it(
    simulation: Simulation[FakeState],
):
    simulation.accept_command(topics.JUMP_MOTOR_COMMAND, nut(0.3))
    happened = run_to(simulation, 5.0)
    assert [h.values["drive"] for h in happened] == ["jump_motor"]
    assert happened[0].stamp_ns == round(0.5 * NANO)
    at = 0.05 + 0.1**2 / (2.0 * DECELERATIONS.nut)
    assert simulation.state.compression == pytest.approx(at)
    held = applied_commands(simulation)[-1].jump
    assert isinstance(held, JumpMotorCommand)
    assert held.compression == pytest.approx(at)
    assert (held.rate, held.max_force, held.trips) == (0.1, 400.0, False)


@pytest.mark.parametrize(
    ("setpoint", "rate", "held"),
    [(0.11, 0.1, 0.11), (0.09, -0.1, 0.09), (0.2, -0.05, 0.095), (0.0, 0.05, 0.105)],
)
def test_a_stopping_nut_does_not_pass_its_setpoint(
    actuators: Actuators, setpoint: float, rate: float, held: float
):
    actuators.accept_command(topics.JUMP_MOTOR_COMMAND, nut(setpoint), HANGING, 0)
    moving = HANGING._replace(compression=0.1, nut_rate=rate)
    actuators.quick_stop(topics.JUMP_MOTOR_COMMAND, moving)
    command = actuators.command.jump
    assert isinstance(command, JumpMotorCommand)
    assert command.compression == pytest.approx(held)
    assert not command.trips


@pytest.mark.parametrize(
    ("topic", "sample"),
    [
        (topics.WINCH_COMMAND, drum(PAYING_OUT)),
        (topics.WHEEL_COMMAND, wheels(2.0)),
        (topics.WHEEL_TORQUE_COMMAND, wheel_torque(0.5)),
        (topics.FLYWHEEL_COMMAND, flywheel(0.1)),
    ],
)
def test_a_motor_is_switched_off_at_once(actuators: Actuators, topic: str, sample: JointSample):
    actuators.accept_command(topic, sample, HANGING, 0)
    assert actuators.command != PlantCommand()
    actuators.switch_off(topic, HANGING)
    assert actuators.command == PlantCommand()


def test_a_jump_motor_switched_off_holds_its_nut(actuators: Actuators):
    actuators.accept_command(topics.JUMP_MOTOR_COMMAND, nut(0.2), HANGING, 0)
    actuators.switch_off(topics.JUMP_MOTOR_COMMAND, HANGING._replace(compression=0.1))
    held = actuators.command.jump
    assert isinstance(held, JumpMotorCommand)
    assert (held.compression, held.trips) == (0.1, False)


def test_a_nut_at_a_held_setpoint_stays_without_renewal(simulation: Simulation[FakeState]):
    simulation.accept_command(topics.JUMP_MOTOR_COMMAND, held_nut(0.02))
    assert not run_to(simulation, 5.0)
    assert simulation.state.phase is PlantPhase.HELD
    assert simulation.state.compression == pytest.approx(0.02)
    simulation.accept_command(topics.JUMP_MOTOR_COMMAND, held_nut(0.025, latch=1.0))
    assert [h.name for h in run_to(simulation, 5.2)] == [PlantEvent.TAKE_OFF]
    assert applied_commands(simulation)[-1].jump is None


@pytest.mark.parametrize("at", [-0.065, 0.36])
def test_a_nut_held_beyond_its_travel_gets_the_travel_s_end_as_setpoint(
    actuators: Actuators, at: float
):
    actuators.accept_command(topics.JUMP_MOTOR_COMMAND, nut(0.0), HANGING, 0)
    actuators.step(HANGING._replace(compression=at), NANO)
    held = actuators.command.jump
    assert isinstance(held, JumpMotorCommand)
    assert held.compression == (-0.06 if at < 0.0 else 0.35)
    assert not held.trips


@pytest.mark.parametrize(
    ("topic", "sample"),
    [
        (topics.FLYWHEEL_COMMAND, flywheel(0.0)),
        (topics.WHEEL_COMMAND, wheels(0.0)),
        (topics.WHEEL_TORQUE_COMMAND, wheel_torque(0.0)),
    ],
)
def test_a_drive_at_rest_needs_no_commands(
    simulation: Simulation[FakeState], topic: str, sample: JointSample
):
    simulation.accept_command(topic, sample)
    assert not run_to(simulation, 2.0)


def test_a_reset_clears_every_command(simulation: Simulation[FakeState]):
    for topic in (topics.JUMP_MOTOR_COMMAND, topics.WHEEL_COMMAND, topics.WINCH_COMMAND):
        simulation.accept_command(topic, GOOD[topic])
    simulation.reset()
    assert not run_to(simulation, 1.0)
    assert set(applied_commands(simulation)) == {PlantCommand()}


# --------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize("topic", COMMANDS)
@pytest.mark.parametrize("phase", [PlantPhase.DIVERGED, PlantPhase.TETHER_BROKEN])
def test_a_stopped_plant_refuses_commands(actuators: Actuators, topic: str, phase: PlantPhase):
    refusal = refusal_of(actuators, topic, GOOD[topic], DriveFeedback(phase))
    assert refusal.code is RefusalCode.WRONG_PHASE
    assert topics.SIM_RESET in refusal.reason


@pytest.mark.parametrize("topic", [t for t in COMMANDS if t != topics.WINCH_COMMAND])
def test_a_plant_without_the_drive_refuses_its_commands(topic: str):
    bare = Actuators(Equipment("bare_tether", fixed_length=5.0), round(TICK * NANO))
    refusal = refusal_of(bare, topic, GOOD[topic])
    assert refusal.code is RefusalCode.NOT_SUPPORTED
    assert "bare_tether" in refusal.reason


def test_the_flywheel_needs_a_nut_that_is_clear_of_the_latch(actuators: Actuators):
    hooked = HANGING._replace(compression=0.05, nut_free=False, spring_held=True)
    refusal = refusal_of(actuators, topics.FLYWHEEL_COMMAND, flywheel(0.01), hooked)
    assert refusal.code is RefusalCode.WRONG_PHASE
    assert "0.05 m" in refusal.reason


@pytest.mark.parametrize(
    ("position", "states", "words"),
    [
        (-0.07, HANGING, "free travel is 0.06 m"),
        (0.36, HANGING, "the stroke of 0.35 m"),
        (0.01, HANGING._replace(compression=0.05, spring_held=True), "0 to unload the spring"),
    ],
)
def test_the_nut_s_setpoint_must_be_within_reach(
    actuators: Actuators, position: float, states: DriveFeedback, words: str
):
    refusal = refusal_of(actuators, topics.JUMP_MOTOR_COMMAND, nut(position), states)
    assert refusal.code is RefusalCode.OUT_OF_LIMITS
    assert words in refusal.reason


def test_a_nut_past_the_latch_may_move_back(actuators: Actuators):
    released = HANGING._replace(compression=0.2, nut_free=False)
    actuators.accept_command(topics.JUMP_MOTOR_COMMAND, nut(0.1), released, 0)
    assert actuators.command.jump == JumpMotorCommand(0.1, 0.1, 400.0)


@pytest.mark.parametrize("brake", [0.5, 1e-9, 0.999])
def test_a_brake_is_open_or_closed(actuators: Actuators, brake: float):
    refusal = refusal_of(actuators, topics.WINCH_COMMAND, drum(0.0, brake))
    assert refusal.code is RefusalCode.OUT_OF_LIMITS
    assert repr(brake) in refusal.reason


def test_the_latch_trips_or_holds(actuators: Actuators):
    refusal = refusal_of(actuators, topics.JUMP_MOTOR_COMMAND, held_nut(0.1, latch=0.5))
    assert refusal.code is RefusalCode.OUT_OF_LIMITS
    simple = Actuators(HELD_BY_THE_GROUND, round(TICK * NANO))
    standing = DriveFeedback(PlantPhase.HELD)
    refusal = refusal_of(simple, topics.JUMP_MOTOR_COMMAND, held_nut(0.1), standing)
    assert refusal.code is RefusalCode.NOT_SUPPORTED
    simple.accept_command(topics.JUMP_MOTOR_COMMAND, held_nut(0.1, latch=1.0), standing, 0)
    assert simple.command.jump == JumpMotorCommand(0.1, 0.1, 400.0)


def test_a_refused_command_does_not_reset_the_watchdog(simulation: Simulation[FakeState]):
    simulation.accept_command(topics.WINCH_COMMAND, drum(PAYING_OUT))
    happened: list[Any] = []
    for step in range(1, 20):
        with pytest.raises(Refusal):
            simulation.accept_command(topics.WINCH_COMMAND, drum(PAYING_OUT, brake=0.5))
        happened += run_to(simulation, 0.02 * step)
    assert [h.values["drive"] for h in happened] == ["winch"]
    assert happened[0].stamp_ns == round(TIMEOUT * NANO)
