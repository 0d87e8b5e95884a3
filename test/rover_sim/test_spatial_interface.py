"""Samples of the spatial plant, compared with independent derivations from its states."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from msg_schemas import machine, topics
from msg_schemas.access import ACCESS
from msg_schemas.cdr import pack, unpack
from msg_schemas.events import EventReport, PlantEvent, SimulationEvent
from msg_schemas.phases import PlantPhase
from msg_schemas.samples import JointSample, JointValue
from msg_schemas.table import TOPICS
from rover_runtime.pacing import NANO
from rover_sim import build_plant
from rover_sim.interface.interface_factory import build_interface
from rover_sim.interface.spatial_interface import SpatialInterface
from rover_sim.node.sim_loop import Simulation, Tick
from rover_sim.plants.plant import Outcome
from rover_sim.plants.spatial_plant import SpatialPlant
from rover_sim.plants.spatial_state import SpatialState
from rover_sim.scenarios.scenario import SpatialScenario, load_spatial

TICK = 0.01
MOON = 1.62
PERFECT = {"sensors.error_model": "ideal"}
TickSamples = dict[str, Any]


def simulate(scenario: SpatialScenario, seed: int = 1) -> Simulation[SpatialState]:
    return Simulation(build_interface(build_plant(scenario), seed), TICK)


def plant_of(simulation: Simulation[SpatialState]) -> SpatialPlant:
    assert isinstance(simulation.plant, SpatialPlant)
    return simulation.plant


def all_samples(simulation: Simulation[SpatialState]) -> TickSamples:
    return dict(simulation.interface.samples(simulation.interface.topics))


def run(
    simulation: Simulation[SpatialState],
    seconds: float,
    order: Callable[[Simulation[SpatialState]], None] | None = None,
) -> list[TickSamples]:
    """All samples of each tick, with the tick."""
    every: list[TickSamples] = []
    for _ in range(round(seconds / TICK)):
        if order is not None:
            order(simulation)
        tick = simulation.tick()
        every.append({**all_samples(simulation), "tick": tick})
    return every


def reports(every: list[TickSamples]) -> list[EventReport]:
    ticks: list[Tick[SpatialState]] = [each["tick"] for each in every]
    return [report for tick in ticks for report in tick.event_reports]


def event_names(every: list[TickSamples]) -> list[str]:
    return [report.name for report in reports(every)]


def joints(sample: JointSample, name: str) -> JointValue:
    return sample.joints[name]


def pay_out(rate: float, brake: float = 1.0, feed_forward: float = 16.2) -> JointSample:
    values = {
        machine.WINCH_DRUM: JointValue(10.0, rate, feed_forward),
        machine.WINCH_BRAKE: JointValue(brake),
        machine.WINCH_LIMIT: JointValue(effort=60.0),
    }
    return JointSample(0, values)


@pytest.fixture(scope="module")
def hanging() -> SpatialScenario:
    """A rover that swings and rotates, with ideal sensors."""
    changes = {"start.swing_angle": 3.0, "start.cone_rate": 2.0, "start.tilt": [1.0, 2.0, 0.0]}
    return load_spatial("free_hang", {**PERFECT, **changes})


OFFSET = (0.01, -0.02)  # of the slider [m]


@pytest.fixture(scope="module")
def swinging(hanging: SpatialScenario) -> list[TickSamples]:
    return run(simulate(hanging.with_overrides({"rover.slider_offset": OFFSET})), 2.0)


# ---------------------------------------------------------------------------------- what is told


@pytest.mark.parametrize("name", ["marius_hills", "floor_rubble", "spatial_pendulum"])
def test_all_samples_fit_the_contract_and_survive_a_round_trip(name: str):
    for each in run(simulate(load_spatial(name)), 0.3)[::5]:
        del each["tick"]
        for topic, sample in each.items():
            back = unpack(topic, pack(topic, sample))
            for (path, value), (read_back, published_value) in zip(
                back.scalars(), sample.scalars(), strict=True
            ):
                assert (topic, path, value) == (topic, read_back, published_value)


def test_every_timed_topic_of_the_sim_node_is_published(swinging: list[TickSamples]):
    timed = {
        name
        for name, row in TOPICS.items()
        if row.name in ACCESS["sim_node"].publishes and row.rate is not None
    }
    assert timed - {topics.SIM_STATUS} == {*swinging[0]} - {"tick"}


def test_before_the_first_tick_the_truth_is_published_and_no_sensor():
    simulation = simulate(load_spatial("free_hang"))
    outside = simulation.interface
    assert {*all_samples(simulation)} == {*outside.topics} - outside.available_after_tick
    assert topics.WINCH_STATE in outside.available_after_tick


def test_without_a_rover_no_topic_of_a_rover_is_published():
    outside = build_interface(build_plant(load_spatial("spatial_pendulum")), 1)
    assert topics.LOAD_CELL in outside.topics
    of_a_rover = {topics.IMU, topics.TRUTH_BODY1, topics.WHEEL_STATE, topics.JUMP_MOTOR_STATE}
    assert not of_a_rover & {*outside.topics}
    assert outside.equipment.nut is None
    assert outside.equipment.fixed_length == 5.0


def rotation(sample: Any) -> Rotation:
    return Rotation.from_quat(sample.orientation)


@pytest.mark.parametrize("body", [topics.TRUTH_BODY1, topics.TRUTH_BODY2])
def test_twist_is_the_pose_s_rate_in_the_body_s_own_frame(swinging: list[TickSamples], body: str):
    for a, b in itertools.pairwise(swinging):
        before, after = a[body], b[body]
        rate = np.subtract(after.position, before.position) / TICK
        middle = Rotation.concatenate([rotation(before), rotation(after)]).mean()
        twist = 0.5 * np.add(before.linear, after.linear)
        assert middle.inv().apply(rate) == pytest.approx(twist, abs=2e-4)
        turn = (rotation(before).inv() * rotation(after)).as_rotvec() / TICK
        assert turn == pytest.approx(0.5 * np.add(before.angular, after.angular), abs=2e-4)


def test_the_swing_moves_enough_to_distinguish_body_from_world(swinging: list[TickSamples]):
    last = swinging[-1][topics.TRUTH_BODY1]
    assert np.linalg.norm(last.linear) > 0.05
    assert np.linalg.norm(last.angular) > 0.01


def test_body_2_is_above_body_1_along_the_slider(swinging: list[TickSamples]):
    for each in swinging:
        one, two = each[topics.TRUTH_BODY1], each[topics.TRUTH_BODY2]
        between = rotation(one).inv().apply(np.subtract(two.position, one.position))
        assert between == pytest.approx([*OFFSET, each["tick"].after.s], abs=1e-9)


def test_the_tether_runs_from_the_fairlead_to_the_rover_s_attachment(
    hanging: SpatialScenario, swinging: list[TickSamples]
):
    assert hanging.rover is not None
    for each in swinging:
        nodes, body = each[topics.TRUTH_TETHER].nodes, each[topics.TRUTH_BODY1]
        assert nodes[0, :3] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
        attachment = body.position + rotation(body).apply(hanging.rover.attachment)
        assert nodes[-1, :3] == pytest.approx(attachment, abs=1e-8)
        assert np.linalg.norm(nodes[:, 3:6], axis=1) == pytest.approx(1.0, abs=0.01)


def test_the_drawn_tether_passes_through_every_node(swinging: list[TickSamples]):
    each = swinging[-1]
    line = next(s for s in each[topics.MARKERS].shapes if s.kind == "line")
    drawn = np.array(line.points)
    for node in each[topics.TRUTH_TETHER].nodes[:, :3]:
        assert np.min(np.linalg.norm(drawn - node, axis=1)) < 1e-12
    steps = np.linalg.norm(np.diff(drawn, axis=0), axis=1)
    assert steps.sum() == pytest.approx(
        joints(each[topics.WINCH_STATE], machine.WINCH_DRUM)[0], rel=2e-3
    )


def test_the_wheels_are_drawn_across_the_body(swinging: list[TickSamples]):
    each = swinging[-1]
    body = each[topics.TRUTH_BODY1]
    shapes = {s.namespace: s for s in each[topics.MARKERS].shapes}
    for name, y in ((machine.WHEEL_LEFT, 0.22), (machine.WHEEL_RIGHT, -0.22)):
        place = rotation(body).inv().apply(np.subtract(shapes[name].position, body.position))
        assert place == pytest.approx([0.08, y, 0.0])
        axis = Rotation.from_quat(shapes[name].orientation).apply([0.0, 0.0, 1.0])
        assert abs(rotation(body).inv().apply(axis)[1]) == pytest.approx(1.0)
        assert shapes[name].size == pytest.approx((0.3, 0.3, 0.06))


def test_ideal_sensors_measure_the_truth(hanging: SpatialScenario, swinging: list[TickSamples]):
    for a, b in itertools.pairwise(swinging):
        middle = 0.5 * np.add(a[topics.TRUTH_BODY1].angular, b[topics.TRUTH_BODY1].angular)
        assert b[topics.IMU].angular_velocity == pytest.approx(middle, abs=2e-4)
        tension = b[topics.TRUTH_TETHER].nodes[:, 6]
        fairlead, rover = b[topics.LOAD_CELL].force, b[topics.ROVER_LOAD_CELL].force
        assert fairlead == pytest.approx((0.0, 0.0, -tension[0]), abs=0.05)
        assert rover == pytest.approx((0.0, 0.0, tension[-1]), abs=0.05)
        assert joints(b[topics.WINCH_STATE], machine.WINCH_DRUM).position == hanging.tether.length


def test_a_hanging_accelerometer_reads_gravity_along_the_tether():
    each = run(simulate(load_spatial("free_hang", PERFECT)), 0.5)[-1]
    assert each[topics.IMU].linear_acceleration == pytest.approx((0.0, 0.0, MOON), abs=0.01)
    assert joints(each[topics.CONTACT], machine.FLOOR_SWITCH).position == 0.0
    assert each["tick"].after.phase is PlantPhase.HANGING


def test_a_rover_on_the_ground_closes_its_switches():
    each = run(simulate(load_spatial("floor_rubble", PERFECT)), 0.1)[-1]
    assert each["tick"].after.phase is PlantPhase.GROUNDED
    for name in (machine.FLOOR_SWITCH, machine.WHEEL_LEFT, machine.WHEEL_RIGHT):
        assert joints(each[topics.CONTACT], name).position == 1.0
    assert np.linalg.norm(each[topics.IMU].linear_acceleration) == pytest.approx(MOON, abs=1e-3)


def test_equal_seeds_give_equal_readings_and_different_seeds_different_ones():
    scenario = load_spatial("free_hang")
    one, same, other = (run(simulate(scenario, seed), 0.2)[-1] for seed in (3, 3, 4))
    for topic in (topics.IMU, topics.LOAD_CELL, topics.MOTOR_CURRENTS):
        assert one[topic] == same[topic]
        assert one[topic] != other[topic]
    assert np.array_equal(one["tick"].after.nodes, other["tick"].after.nodes)


# --------------------------------------------------------------------------------- what is done


def test_the_winch_pays_out_at_its_rate_and_the_length_is_its_integral():
    simulation = simulate(load_spatial("free_hang", PERFECT))
    every = run(simulation, 2.0, lambda s: s.accept_command(topics.WINCH_COMMAND, pay_out(0.3)))
    drum = [joints(each[topics.WINCH_STATE], machine.WINCH_DRUM) for each in every]
    assert drum[-1].velocity == pytest.approx(0.3, abs=0.01)
    distance = TICK * sum(value.velocity for value in drum)
    assert drum[-1].position - 20.0 == pytest.approx(distance, abs=0.005)
    assert drum[-1].position > 20.5
    assert joints(every[-1][topics.WINCH_STATE], machine.WINCH_BRAKE).position == 1.0
    # The motor carries a part of the weight; gear and friction carry the rest.
    assert 5.0 < drum[-1].effort < 16.5
    depth = -every[-1][topics.TRUTH_BODY1].position[2]
    assert depth - -every[0][topics.TRUTH_BODY1].position[2] == pytest.approx(distance, abs=0.02)


@pytest.mark.parametrize("rate", [0.3, -0.3])
@pytest.mark.parametrize("length", [5.0, 15.0, 45.0])
def test_a_winch_without_commands_stops_within_0_2_m_and_1_5_times_the_load(
    length: float, rate: float
):
    """By the bound 1 + 2 a/g = 1.494 of an undamped tether; the drive's ramp alone is 1.25."""
    scenario = load_spatial("free_hang", {**PERFECT, "tether.length": length})
    simulation = simulate(scenario)
    load = 10.0 * MOON + 0.005 * length * MOON
    ramp = [rate * min(k / 300.0, 1.0) for k in range(500)]
    for setpoint in ramp:
        command = pay_out(setpoint, feed_forward=load)
        simulation.accept_command(topics.WINCH_COMMAND, command)
        simulation.tick()
    before = simulation.state.length
    assert plant_of(simulation).payout_rate(simulation.state) == pytest.approx(rate, rel=0.02)
    every = run(simulation, 3.0)
    assert event_names(every) == [SimulationEvent.COMMAND_TIMEOUT]
    tensions = [each["tick"].result.peak_tension for each in every]
    assert 1.05 * load < max(tensions) < 1.5 * load
    assert min(each["tick"].result.forces.fairlead_tension for each in every) > 0.4 * load
    assert math.copysign(1.0, rate) * (simulation.state.length - before) == pytest.approx(
        0.3 * 0.26 + 0.3**2 / (2.0 * 0.4), abs=0.005
    )
    drums = [each[topics.WINCH_STATE] for each in every]
    standing = [joints(drum, machine.WINCH_DRUM).velocity == 0.0 for drum in drums]
    closed = [joints(drum, machine.WINCH_BRAKE).position == 0.0 for drum in drums]
    # The brake closes at rest: it does not brake a moving drum.
    assert closed.index(True) * TICK == pytest.approx(0.26 + 0.75 + 0.04, abs=0.1)
    before_it = drums[closed.index(True) - 3]
    assert abs(joints(before_it, machine.WINCH_DRUM).velocity) < 0.01
    assert all(standing[closed.index(True) :])
    assert joints(drums[-1], machine.WINCH_DRUM).effort == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("rate", [0.3, -0.3])
def test_a_brake_that_closes_on_a_moving_drum_jerks_the_rover(rate: float):
    simulation = simulate(load_spatial("free_hang", {**PERFECT, "tether.length": 15.0}))
    for k in range(500):
        command = pay_out(rate * min(k / 300.0, 1.0))
        simulation.accept_command(topics.WINCH_COMMAND, command)
        simulation.tick()
    simulation.switch_off(topics.WINCH_COMMAND)
    every = run(simulation, 2.0)
    load = 10.0 * MOON
    if rate > 0.0:
        assert max(each["tick"].result.peak_tension for each in every) > 2.0 * load
    else:
        assert min(each["tick"].result.forces.fairlead_tension for each in every) < 0.0
    assert joints(every[15][topics.WINCH_STATE], machine.WINCH_BRAKE).position == 0.0


def test_a_quick_stop_deceleration_of_the_scenario_decides_distance_and_tension():
    """Twice the deceleration: 0.056 m less, and a tension above the limit of the default."""
    peaks, lengths = [], []
    for deceleration in (0.4, 0.8):
        changes = {**PERFECT, "winch.quick_stop_deceleration": deceleration}
        simulation = simulate(load_spatial("free_hang", changes))
        run(simulation, 4.0, lambda s: s.accept_command(topics.WINCH_COMMAND, pay_out(0.3)))
        before = simulation.state.length
        every = run(simulation, 2.0)
        peaks.append(max(each["tick"].result.peak_tension for each in every) / (10.0 * MOON))
        lengths.append(simulation.state.length - before)
    assert lengths[0] - lengths[1] == pytest.approx(0.045 / 0.4 - 0.045 / 0.8, abs=0.005)
    assert peaks[0] < 1.5
    assert 1.7 < peaks[1] < 1.0 + 2.0 * 0.8 / MOON


def test_wheels_and_flywheel_without_commands_are_ramped_to_rest():
    simulation = simulate(load_spatial("free_hang", PERFECT))
    wheel = JointSample(0, {machine.WHEEL_DRIVE: JointValue(0.0, 3.0, 1.0)})
    spin = JointSample(0, {machine.FLYWHEEL: JointValue(effort=0.06)})

    def order(s: Simulation[SpatialState]) -> None:
        s.accept_command(topics.WHEEL_COMMAND, wheel)
        s.accept_command(topics.FLYWHEEL_COMMAND, spin if s.stamp_ns < NANO else idle)

    idle = JointSample(0, {machine.FLYWHEEL: JointValue(effort=1e-4)})
    run(simulation, 1.5, order)
    wheel_rate, rate = simulation.state.wheel_rates[0], simulation.state.flywheel_rate
    assert wheel_rate == pytest.approx(3.0, abs=0.1)
    assert rate > 35.0
    every = run(simulation, 2.0)
    assert event_names(every).count(SimulationEvent.COMMAND_TIMEOUT) == 2
    # After the timeout of 0.5 s the wheels take 3.0 / 3.0 s, the flywheel rate / 75 s.
    half = every[49 + 50][topics.WHEEL_STATE]
    assert joints(half, machine.WHEEL_LEFT).velocity == pytest.approx(0.5 * wheel_rate, abs=0.15)
    flywheels = [joints(each[topics.FLYWHEEL_STATE], machine.FLYWHEEL).velocity for each in every]
    assert flywheels[49] > 0.9 * rate
    begun = flywheels[50]
    assert flywheels[50 + 20] == pytest.approx(begun - 0.2 * 75.0, abs=4.0)
    assert abs(flywheels[50 + round(begun / 75.0 / TICK) + 15]) < 1.0
    assert joints(every[-1][topics.WHEEL_STATE], machine.WHEEL_LEFT).velocity == pytest.approx(
        0, abs=0.02
    )
    motors = every[-1][topics.MOTOR_CURRENTS]
    assert joints(motors, machine.JUMP_MOTOR).effort == pytest.approx(0.0, abs=1e-9)


def test_a_wheel_torque_turns_the_hanging_body_against_the_wheels():
    simulation = simulate(load_spatial("free_hang", PERFECT))
    command = JointSample(0, {machine.WHEEL_DRIVE: JointValue(effort=0.2)})
    every = run(simulation, 0.3, lambda s: s.accept_command(topics.WHEEL_TORQUE_COMMAND, command))
    wheels = every[-1][topics.WHEEL_STATE]
    assert joints(wheels, machine.WHEEL_LEFT).velocity > 0.5
    assert joints(wheels, machine.WHEEL_RIGHT).velocity == pytest.approx(
        joints(wheels, machine.WHEEL_LEFT).velocity, rel=1e-6
    )
    assert every[-1][topics.TRUTH_BODY1].angular[1] < -0.01
    assert joints(every[-1][topics.MOTOR_CURRENTS], machine.WHEEL_MOTOR).effort > 0.0


def test_backward_the_left_wheel_turns_alone():
    simulation = simulate(load_spatial("free_hang", PERFECT))
    command = JointSample(0, {machine.WHEEL_DRIVE: JointValue(0.0, -2.0, 1.0)})
    every = run(simulation, 0.5, lambda s: s.accept_command(topics.WHEEL_COMMAND, command))
    wheels = every[-1][topics.WHEEL_STATE]
    assert joints(wheels, machine.WHEEL_LEFT).velocity == pytest.approx(-2.0, abs=0.05)
    assert joints(wheels, machine.WHEEL_RIGHT).velocity == 0.0
    # Initially; later the body swings back about its attachment.
    assert every[10][topics.TRUTH_BODY1].angular[1] > 0.05


def test_the_flywheel_turns_the_body_about_x_and_moves_the_nut():
    simulation = simulate(load_spatial("free_hang", PERFECT))
    nut0 = simulation.state.nut
    command = JointSample(0, {machine.FLYWHEEL: JointValue(effort=0.05)})
    every = run(simulation, 0.4, lambda s: s.accept_command(topics.FLYWHEEL_COMMAND, command))
    value = joints(every[-1][topics.FLYWHEEL_STATE], machine.FLYWHEEL)
    assert value.velocity > 5.0
    screw = joints(every[-1][topics.JUMP_MOTOR_STATE], machine.JUMP_SCREW)
    pitch = plant_of(simulation).model.jump.pitch
    assert screw.velocity == pytest.approx(value.velocity * pitch)
    assert screw.position - nut0 == pytest.approx(
        pitch * (value.position - nut0 / pitch), abs=1e-12
    )
    assert every[-1][topics.TRUTH_BODY1].angular[0] < -0.005
    assert joints(every[-1][topics.MOTOR_CURRENTS], machine.JUMP_MOTOR).effort > 0.0
    assert joints(every[-1][topics.MOTOR_CURRENTS], machine.WINCH_MOTOR).effort == 0.0


def nut(position: float, latch: float = 1.0) -> JointSample:
    values = {
        machine.JUMP_SCREW: JointValue(position, 0.08, 400.0),
        machine.JUMP_LATCH: JointValue(latch),
    }
    return JointSample(0, values)


def test_a_rover_on_the_ground_compresses_waits_and_jumps():
    simulation = simulate(load_spatial("floor_rubble", {**PERFECT, "environment.boulders": None}))
    height = simulation.state.G1[2]

    def to(setpoint: float, latch: float) -> Callable[[Simulation[SpatialState]], None]:
        return lambda s: s.accept_command(topics.JUMP_MOTOR_COMMAND, nut(setpoint, latch))

    every = run(simulation, 5.0, to(0.1, 0.0))
    screw = joints(every[-1][topics.JUMP_MOTOR_STATE], machine.JUMP_SCREW)
    assert screw.position == pytest.approx(0.1, abs=2e-4)
    assert screw.effort == pytest.approx(824.0 * screw.position)
    assert PlantEvent.LATCH_COMPRESSING in event_names(every)
    # Without commands the drive holds its position, and the latch does not trip.
    quiet = run(simulation, 2.0)
    assert not event_names(quiet)
    assert joints(quiet[-1][topics.JUMP_MOTOR_STATE], machine.JUMP_SCREW).position == pytest.approx(
        0.1, abs=5e-4
    )
    with pytest.raises(ValueError, match="driven clear first"):
        simulation.accept_command(
            topics.FLYWHEEL_COMMAND, JointSample(0, {machine.FLYWHEEL: JointValue()})
        )
    flown = run(simulation, 0.5, to(0.102, 1.0))
    names = event_names(flown)
    assert names.index("latch_released") < names.index("take_off")
    take_off = next(r for r in reports(flown) if r.name is PlantEvent.TAKE_OFF)
    assert take_off.stamp_ns is not None
    bodies = [each[topics.TRUTH_BODY1] for each in flown]
    stamps = [body.stamp_ns for body in bodies]
    z = np.interp(take_off.stamp_ns, stamps, [body.position[2] for body in bodies])
    speed = np.interp(take_off.stamp_ns, stamps, [np.linalg.norm(body.linear) for body in bodies])
    assert take_off.values["z"] == pytest.approx(z, abs=1e-3)
    assert take_off.values["speed"] == pytest.approx(speed, rel=0.01)
    assert joints(flown[-1][topics.CONTACT], machine.FLOOR_SWITCH).position == 0.0
    assert joints(flown[-1][topics.JUMP_MOTOR_STATE], machine.JUMP_SCREW).effort == 0.0
    run(simulation, 3.0)
    assert simulation.phase is PlantPhase.GROUNDED
    assert simulation.state.G1[2] == pytest.approx(height, abs=0.05)


def test_commands_beyond_the_hardware_are_refused_and_the_plant_continues():
    simulation = simulate(load_spatial("free_hang", PERFECT))
    for setpoint in (-0.07, 0.21):
        with pytest.raises(ValueError, match="must be at"):
            simulation.accept_command(topics.JUMP_MOTOR_COMMAND, nut(setpoint))
    assert not event_names(run(simulation, 0.1))


# ---------------------------------------------------------------------------------- end and start


@pytest.mark.parametrize(
    ("share", "element_length", "swing"), [(0.3, 0.3, 0.0), (0.7, 0.9, 40.0), (0.99, 0.1, 60.0)]
)
def test_a_broken_tether_stops_the_plant_and_the_sensors_keep_their_last_readings(
    share: float, element_length: float, swing: float
):
    changes = {
        **PERFECT,
        "tether.length": 4.0,
        "tether.element_length": element_length,
        "start.swing_angle": swing,
    }
    whole = simulate(load_spatial("free_hang", changes))
    peak = max(each["tick"].result.peak_tension for each in run(whole, 2.0))

    def with_load(load: float) -> Simulation[SpatialState]:
        return simulate(load_spatial("free_hang", {**changes, "tether.breaking_load": load}))

    stronger, simulation = with_load(1.001 * peak), with_load(share * peak)
    assert not event_names(run(stronger, 2.0))
    np.testing.assert_array_equal(stronger.state.nodes, whole.state.nodes)
    every = run(simulation, 2.0)
    assert event_names(every) == [PlantEvent.TETHER_BROKEN]
    assert simulation.phase is PlantPhase.TETHER_BROKEN
    results = [each["tick"].result for each in every]
    (event,) = [event for result in results for event in result.events]
    assert event.values["tension"] > share * peak
    assert event.time == pytest.approx(simulation.state.time)
    assert np.isfinite(simulation.state.nodes).all()
    broken = next(k for k, each in enumerate(results) if each.events)
    assert all(each.peak_tension <= share * peak for each in results[:broken])
    assert {each.outcome for each in results[broken:]} == {Outcome.TETHER_BROKEN}
    assert len({each[topics.IMU].angular_velocity for each in every[broken + 1 :]}) == 1
    assert every[-1][topics.IMU].stamp_ns == simulation.stamp_ns == round(2.0 * NANO)
    with pytest.raises(ValueError, match="tether is broken"):
        simulation.accept_command(topics.WINCH_COMMAND, pay_out(0.1))
    simulation.reset_plant()
    assert simulation.state.phase is PlantPhase.HANGING


def test_a_run_after_a_reset_equals_the_first():
    simulation = simulate(load_spatial("free_hang"))

    def mission() -> list[TickSamples]:
        return run(simulation, 1.0, lambda s: s.accept_command(topics.WINCH_COMMAND, pay_out(0.3)))[
            -1:
        ]

    (first,) = mission()
    simulation.reset()
    (second,) = mission()
    for topic, sample in first.items():
        if topic not in (topics.TRUTH_TETHER, "tick"):
            assert sample == second[topic], topic
    assert np.array_equal(first[topics.TRUTH_TETHER].nodes, second[topics.TRUTH_TETHER].nodes)


def test_readings_saturate_at_the_contract_s_range():
    simulation = simulate(load_spatial("free_hang", {**PERFECT, "environment.hole": None}))
    outside = simulation.interface
    assert isinstance(outside, SpatialInterface)
    run(simulation, TICK)
    camera = all_samples(simulation)[topics.CAMERA]
    assert all(math.isfinite(value) for _, value in camera.scalars())
