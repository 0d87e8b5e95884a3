"""The simulation loop, tick by tick, without ROS and without waiting."""

from __future__ import annotations

from typing import Any

import pytest
from fake_plant import fake_interface

from msg_schemas import machine, topics
from msg_schemas.events import EventReport, PlantEvent, SimulationEvent
from msg_schemas.phases import PlantPhase
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample, JointValue, Level
from rover_runtime.pacing import NANO, Pacer
from rover_sim.devices.equipment import Equipment
from rover_sim.node.sim_loop import Schedule, Simulation

TICK = 0.01
NUT, DRUM = topics.JUMP_MOTOR_COMMAND, topics.WINCH_COMMAND


def nut(position: float, velocity: float = 0.1, effort: float = 400.0, at: float = 0.0):
    return JointSample(
        round(at * NANO), {machine.JUMP_SCREW: JointValue(position, velocity, effort)}
    )


def drum(length: float, rate: float = 0.0, brake: float = 0.0):
    joints = {
        machine.WINCH_DRUM: JointValue(length, rate),
        machine.WINCH_BRAKE: JointValue(brake),
        machine.WINCH_LIMIT: JointValue(effort=10.0),
    }
    return JointSample(0, joints)


@pytest.fixture
def simulation() -> Simulation[Any]:
    return Simulation(fake_interface(), TICK)


def run_to(simulation: Simulation[Any], time: float) -> list[EventReport]:
    """All events up to a time."""
    happened: list[EventReport] = []
    while simulation.stamp_ns < round(time * NANO):
        happened += simulation.tick().event_reports
    return happened


# -------------------------------------------------------------------------------------- schedule


def count(rate: float, tick: float, seconds: float) -> int:
    schedule = Schedule({"it": rate})
    ticks = range(round(seconds / tick))
    tick_ns = round(tick * NANO)
    return sum(len(schedule.due(i * tick_ns, (i + 1) * tick_ns)) for i in ticks)


@pytest.mark.parametrize("rate", [0.5, 1.0, 3.0, 7.0, 29.97, 30.0, 33.0, 50.0, 99.0, 100.0])
def test_a_topic_has_its_rate_even_if_the_tick_rate_is_no_multiple(rate: float):
    assert count(rate, TICK, 100.0) == int(rate * 100.0)


def test_a_topic_at_the_tick_rate_is_due_after_every_tick():
    for tick in (1e-3, 0.003, 0.007, 0.01):
        assert count(1.0 / tick, tick, 5000 * tick) == pytest.approx(5000, abs=1)


def test_rates_are_exact_late_in_a_long_run():
    far = 10**6 * NANO
    schedule = Schedule({"it": 100.0})
    assert all(schedule.due(far + i * 10**7, far + (i + 1) * 10**7) == ["it"] for i in range(1000))


# ----------------------------------------------------------------------------------------- pacer


def test_ticks_have_absolute_deadlines():
    pacer = Pacer(1.0)
    assert pacer.wait(100.0, 0) == 0.0
    assert pacer.wait(100.001, 10_000_000) == pytest.approx(0.009)
    # A late tick shortens the next wait: no drift.
    assert pacer.wait(100.015, 20_000_000) == pytest.approx(0.005)
    assert pacer.wait(100.035, 30_000_000) == 0.0
    assert pacer.keeps_up(100.035)


def test_a_short_delay_is_caught_up_at_no_more_than_twice_the_factor():
    pacer = Pacer(1.0)
    pacer.wait(0.0, 0)
    wall = 0.1  # nine ticks late
    waits = []
    for tick in range(1, 25):
        waits.append(pacer.wait(wall, tick * 10_000_000))
        wall += waits[-1]
    assert waits[0] == 0.0
    assert waits[1:18] == pytest.approx([0.005] * 17)
    assert waits[20:] == pytest.approx([0.01] * 4)
    assert wall == pytest.approx(0.24)
    assert pacer.dropped == 0.0


@pytest.mark.parametrize("factor", [0.1, 1.0, 5.0])
def test_the_factor_scales_the_deadlines(factor: float):
    pacer = Pacer(factor)
    pacer.wait(0.0, 0)
    assert pacer.wait(0.0, NANO) == pytest.approx(1.0 / factor)


def test_no_factor_means_no_waiting():
    pacer = Pacer(0.0)
    assert [pacer.wait(0.0, i * NANO) for i in range(5)] == [0.0] * 5
    assert pacer.keeps_up(0.0)


def test_a_long_delay_is_dropped_and_counted():
    pacer = Pacer(1.0)
    pacer.wait(0.0, 0)
    pacer.wait(1.0, 10_000_000)
    assert pacer.dropped == pytest.approx(0.99)
    assert not pacer.keeps_up(1.0)
    # It does not catch up: the next tick is due a tick later.
    assert pacer.wait(1.0, 20_000_000) == pytest.approx(0.01)
    assert pacer.keeps_up(1.0 + Pacer.WINDOW + 0.1)


def test_ticks_run_in_bursts_that_keep_the_factor():
    pacer, wall, waits = Pacer(1.0, burst=0.05), 100.0, []
    pacer.wait(wall, 0)
    for tick in range(1, 501):
        wall += 0.001  # of the tick's own
        waits.append(pacer.wait(wall, tick * 10_000_000))
        wall += waits[-1]
        assert -1e-9 < tick * 0.01 - (wall - 100.0) < 0.051
    # Six ticks take 0.006 s, and wait for the rest of 0.06 s.
    assert waits[:6] == pytest.approx([0.0] * 5 + [0.054])
    assert sum(wait > 0.0 for wait in waits) == 500 // 6
    assert pacer.keeps_up(wall)


def test_the_factor_reached_is_measured():
    pacer = Pacer(10.0)
    for i in range(600):
        pacer.wait(0.01 * i, 30_000_000 * i)
    assert pacer.measured == pytest.approx(3.0)
    pacer.restart()
    assert pacer.measured is None


# ---------------------------------------------------------------------------- simulation, commands


def test_simulated_time_advances_by_exact_ticks(simulation: Simulation[Any]):
    run_to(simulation, 10.0)
    assert simulation.stamp_ns == 10 * NANO
    assert simulation.ticks == 1000


def test_a_compression_ends_in_a_take_off_at_its_instant(simulation: Simulation[Any]):
    simulation.accept_command(NUT, nut(0.0255))
    happened = run_to(simulation, 0.3)
    assert [h.name for h in happened] == [PlantEvent.TAKE_OFF]
    assert happened[0].stamp_ns == pytest.approx(0.255 * NANO, abs=2)
    assert happened[0].values == {"speed": 1.0}
    assert simulation.phase is PlantPhase.FLIGHT


def test_after_a_take_off_the_nut_waits_for_a_new_command(simulation: Simulation[Any]):
    simulation.accept_command(NUT, nut(0.0255))
    happened = run_to(simulation, 2.0)
    assert [h.name for h in happened] == [PlantEvent.TAKE_OFF]
    assert simulation.phase is PlantPhase.LANDED
    simulation.accept_command(NUT, nut(0.02, at=2.0))
    assert [h.name for h in run_to(simulation, 2.4)] == [PlantEvent.TAKE_OFF]


def test_a_timeout_stops_the_nut_at_its_position(simulation: Simulation[Any]):
    simulation.accept_command(NUT, nut(0.2))
    happened = run_to(simulation, 1.0)
    assert [(h.name, h.level) for h in happened] == [(SimulationEvent.COMMAND_TIMEOUT, Level.ERROR)]
    assert happened[0].stamp_ns == pytest.approx(0.5 * NANO, abs=0.02 * NANO)
    assert simulation.state.compression == pytest.approx(0.05, abs=0.002)


def test_renewed_commands_keep_the_nut_moving(simulation: Simulation[Any]):
    happened = []
    for step in range(1, 16):
        simulation.accept_command(NUT, nut(0.3, at=simulation.stamp_ns / NANO))
        happened += run_to(simulation, 0.1 * step)
    assert not happened
    assert simulation.state.compression == pytest.approx(0.15)


def test_a_nut_at_its_setpoint_needs_no_commands(simulation: Simulation[Any]):
    simulation.accept_command(NUT, nut(0.0))
    assert not run_to(simulation, 2.0)


def refusal_of(simulation: Simulation[Any], topic: str, sample: JointSample) -> Refusal:
    with pytest.raises(Refusal) as caught:
        simulation.accept_command(topic, sample)
    return caught.value


def test_commands_in_flight_are_refused_but_not_those_in_transit_at_the_take_off(
    simulation: Simulation[Any],
):
    simulation.accept_command(NUT, nut(0.02))
    run_to(simulation, 0.25)
    assert simulation.phase is PlantPhase.FLIGHT
    simulation.accept_command(NUT, nut(0.02, at=0.19))
    refusal = refusal_of(simulation, NUT, nut(0.02, at=0.35))
    assert refusal.code is RefusalCode.WRONG_PHASE
    assert "flight" in refusal.reason
    run_to(simulation, 1.0)
    # A command in transit at the take-off has no effect after the landing either.
    simulation.accept_command(NUT, nut(0.02, at=0.19))
    assert not run_to(simulation, 1.2)
    assert simulation.state.phase is PlantPhase.LANDED


def test_a_setpoint_beyond_the_force_is_refused(simulation: Simulation[Any]):
    refusal = refusal_of(simulation, NUT, nut(0.2, effort=100.0))
    assert refusal.code is RefusalCode.OUT_OF_LIMITS
    assert "164.8 N" in refusal.reason
    assert not run_to(simulation, 0.1)
    assert simulation.state.compression == 0.0


def test_a_setpoint_below_the_present_compression_is_refused_except_unloading(
    simulation: Simulation[Any],
):
    simulation.accept_command(NUT, nut(0.2))
    run_to(simulation, 0.3)
    refusal = refusal_of(simulation, NUT, nut(0.01))
    assert "0 to unload the spring" in refusal.reason
    simulation.accept_command(NUT, nut(0.0))
    run_to(simulation, 0.7)
    assert simulation.state.compression == 0.0
    assert simulation.phase is PlantPhase.HELD


def test_a_scenario_without_a_rover_has_no_jump_motor():
    simulation = Simulation(fake_interface(Equipment("pendulum", fixed_length=5.0)), TICK)
    refusal = refusal_of(simulation, NUT, nut(0.1))
    assert refusal.code is RefusalCode.NOT_SUPPORTED
    assert "pendulum has no rover" in refusal.reason


def test_a_drum_without_a_motor_only_holds(simulation: Simulation[Any]):
    simulation.accept_command(DRUM, drum(5.0))
    for bad in (drum(5.0, 0.1), drum(4.9), drum(5.1, -0.1), drum(5.0, brake=1.0)):
        refusal = refusal_of(simulation, DRUM, bad)
        assert refusal.code is RefusalCode.NOT_SUPPORTED
        assert "5 m at 0 m/s" in refusal.reason


def test_divergence_keeps_the_last_state_and_is_reported():
    simulation = Simulation(fake_interface(diverges_at=0.3), TICK)
    simulation.accept_command(NUT, nut(0.2))
    happened = run_to(simulation, 1.0)
    assert [(h.name, h.level) for h in happened] == [("diverged", Level.ERROR)]
    assert "0.3 s" in happened[0].message
    assert simulation.phase is PlantPhase.DIVERGED
    assert simulation.state.time == pytest.approx(0.3)
    assert simulation.state.compression == pytest.approx(0.03)
    assert simulation.stamp_ns == NANO
    for topic, sample in ((NUT, nut(0.1)), (DRUM, drum(5))):
        assert refusal_of(simulation, topic, sample).code is RefusalCode.WRONG_PHASE


def test_reset_resets_everything_and_reset_plant_all_but_the_clock(simulation: Simulation[Any]):
    simulation.accept_command(NUT, nut(0.2))
    run_to(simulation, 0.3)
    simulation.reset_plant()
    assert (simulation.stamp_ns, simulation.state.compression) == (round(0.3 * NANO), 0.0)
    assert not run_to(simulation, 1.5)
    assert simulation.state.compression == 0.0
    simulation.reset()
    assert (simulation.stamp_ns, simulation.ticks, simulation.halved_ticks) == (0, 0, 0)


def test_event_times_follow_the_clock_after_a_reset_of_the_plant(simulation: Simulation[Any]):
    run_to(simulation, 3.0)
    simulation.reset_plant()
    simulation.accept_command(NUT, nut(0.02, at=3.0))
    happened = run_to(simulation, 3.5)
    assert happened[0].stamp_ns == pytest.approx(3.2 * NANO, abs=2)


def test_statistics_have_halved_ticks_and_the_peak_tension(simulation: Simulation[Any]):
    simulation.accept_command(NUT, nut(0.2))
    run_to(simulation, 0.2)
    assert simulation.halved_ticks == 20
    assert simulation.peak_tension == 2.0


def test_accepted_commands_are_counted_and_refused_ones_are_not(simulation: Simulation[Any]):
    simulation.accept_command(NUT, nut(0.2))
    refusal_of(simulation, NUT, nut(0.2, effort=1.0))
    simulation.accept_command(DRUM, drum(5.0))
    assert simulation.commands == 2


def test_the_sensors_measure_every_tick_independent_of_subscriptions():
    outside = fake_interface()
    simulation = Simulation(outside, TICK)
    run_to(simulation, 0.1)
    assert outside.measured == pytest.approx([i * TICK for i in range(11)])
    simulation.reset()
    assert outside.measured == [0.0]
