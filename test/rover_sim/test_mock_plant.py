"""The mock plant: commands are followed exactly, all topics are published, drives refuse."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from msg_schemas import machine, topics
from msg_schemas.access import ACCESS
from msg_schemas.cdr import pack, unpack
from msg_schemas.events import PlantEvent, SimulationEvent
from msg_schemas.phases import PlantPhase
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import ImuSample, JointSample, JointValue
from msg_schemas.table import TOPICS
from rover_sim.interface.mock_interface import MockInterface
from rover_sim.node.sim_loop import Simulation
from rover_sim.plants.mock_plant import MockPlant, MockState
from rover_sim.plants.plant import (
    Event,
    FlywheelCommand,
    JumpMotorCommand,
    PlantCommand,
    WheelRateCommand,
    WheelTorqueCommand,
    WinchCommand,
)
from rover_sim.scenarios.hardware import jump_height
from rover_sim.scenarios.scenario import ScenarioError, load_overridden

DT = 0.01
TICK_NS = 10_000_000


def build(name: str = "marius_hills", overrides: str = "") -> MockPlant:
    return MockPlant(load_overridden(name, overrides))


def on_ground(length: float = 52.0) -> tuple[MockPlant, MockState]:
    plant = build(overrides=f'{{"tether.length": {length}}}')
    state = plant.initial_state()
    assert state.phase is PlantPhase.GROUNDED
    return plant, state


def follow(
    plant: MockPlant, state: MockState, command: PlantCommand, seconds: float
) -> tuple[MockState, list[Event]]:
    events: list[Event] = []
    for _ in range(round(seconds / DT)):
        state, result = plant.step(state, command, DT)
        assert abs(result.energies.drift) < 1e-9
        events += result.events
    return state, events


def out(rate: float) -> PlantCommand:
    return PlantCommand(winch=WinchCommand(0.0, rate))


# ----------------------------------------------------------------------------------------- winch


def test_the_drum_pays_out_at_its_rate_and_the_rover_hangs_at_its_length():
    plant = build()
    state, events = follow(plant, plant.initial_state(), out(0.3), 5.0)
    assert state.length == pytest.approx(11.5)
    assert state.payout_rate == 0.3
    assert (state.phase, plant.drop(state)) == (PlantPhase.HANGING, state.length)
    assert not events


def test_the_fairlead_carries_rover_and_tether():
    plant = build()
    scenario = plant.scenario
    state, _ = follow(plant, plant.initial_state(), out(0.5), 4.0)
    above, below = plant.tension(state)
    assert below == pytest.approx(plant.rover.mass * scenario.gravity)
    own = scenario.tether.section.line_density * state.length * scenario.gravity
    assert above - below == pytest.approx(own)


@pytest.mark.parametrize(
    "command", [PlantCommand(), PlantCommand(winch=WinchCommand(0, 0.3, 0.0, False))]
)
def test_a_closed_brake_holds(command: PlantCommand):
    plant = build()
    state, _ = follow(plant, plant.initial_state(), command, 1.0)
    assert (state.length, state.payout_rate, state.brake_released) == (10.0, 0.0, False)


@pytest.mark.parametrize(("rate", "end", "side"), [(-0.5, 2.0, -1.0), (0.5, 60.0, 1.0)])
def test_the_drum_stops_at_its_ends_and_reports_it_once(rate: float, end: float, side: float):
    plant = build()
    state, events = follow(plant, plant.initial_state(), out(rate), 105.0)
    assert (state.length, state.payout_rate) == (end, 0.0)
    stops = [event.values["side"] for event in events if event.name == PlantEvent.DRUM_STOP]
    assert stops == [side]


def test_the_rover_touches_down_and_lifts_off_again():
    plant = build(overrides='{"tether.length": 50.0}')
    state, down = follow(plant, plant.initial_state(), out(0.5), 2.0)
    assert state.phase is PlantPhase.GROUNDED
    assert plant.tension(state)[1] == 0.0
    assert plant.drop(state) == pytest.approx(plant.floor_drop)
    assert [event.name for event in down] == [PlantEvent.TOUCHDOWN]
    state, up = follow(plant, state, out(-0.5), 2.0)
    assert state.phase is PlantPhase.HANGING
    assert [event.name for event in up] == [PlantEvent.TAKE_OFF]


def test_increasing_slack_unloads_the_tether_gradually():
    plant = build(overrides='{"tether.length": 50.0}')
    state, _ = follow(plant, plant.initial_state(), out(0.5), 2.0)
    weight = plant.rover.mass * plant.scenario.gravity
    for slack, share in ((0.0, 1.0), (0.075, 0.75), (0.3, 0.0), (0.5, 0.0)):
        stands = replace(state, length=plant.floor_drop + slack)
        assert plant.tension(stands)[1] == pytest.approx(share * weight, abs=1e-9)
    aside = replace(state, x=3.0, length=math.hypot(3.0, plant.floor_drop) + 0.15)
    assert plant.tension(aside)[1] == pytest.approx(0.5 * weight)


def test_a_low_tension_limit_holds_that_tension_with_the_rover_on_the_ground():
    plant = build(overrides='{"tether.length": 50.0}')
    state, _ = follow(plant, plant.initial_state(), out(0.5), 2.0)
    winch = plant.scenario.winch
    assert winch is not None
    friction = winch.friction.breakaway / winch.radius
    holds = PlantCommand(winch=WinchCommand(0.0, -0.1, 0.0, True, 4.0))
    held, _ = follow(plant, state, holds, 20.0)
    assert plant.tension(held)[0] == pytest.approx(4.0 - friction, rel=1e-6)
    assert held.payout_rate == 0.0
    # Driving away pulls tether off the drum.
    away, _ = follow(plant, held, replace(holds, wheel=WheelRateCommand(1.0)), 60.0)
    assert away.x == pytest.approx(60.0 * plant.rover.wheels.tip_radius)
    assert away.length > held.length + 0.5
    assert plant.tension(away)[0] == pytest.approx(4.0 + friction, rel=0.05)
    # A motor force below the friction does not turn the drum.
    weak = PlantCommand(winch=WinchCommand(0.0, 0.1, 0.0, True, 0.1))
    slack = replace(held, length=held.length + 1.0)
    assert follow(plant, slack, weak, 1.0)[0].length == slack.length


def test_without_gravity_a_drum_follows_at_any_tension_limit():
    plant = build(overrides='{"environment.gravity": 0.0}')
    weak = PlantCommand(winch=WinchCommand(0.0, -0.3, 0.0, True, 0.1))
    state, _ = follow(plant, plant.initial_state(), weak, 1.0)
    assert state.length == pytest.approx(9.7)


def test_a_tension_limit_below_the_weight_does_not_lift_the_rover():
    plant = build()
    weak = PlantCommand(winch=WinchCommand(0.0, -0.3, 0.0, True, 10.0))
    state, _ = follow(plant, plant.initial_state(), weak, 1.0)
    assert (state.length, state.payout_rate) == (10.0, 0.0)


# ---------------------------------------------------------------------------------------- wheels


def test_forward_the_rover_rolls_straight_ahead():
    plant, state = on_ground(60.0)
    state, _ = follow(plant, state, PlantCommand(wheel=WheelRateCommand(2.0)), 3.0)
    assert state.wheel_angles == pytest.approx((6.0, 6.0))
    assert state.x == pytest.approx(6.0 * plant.rover.wheels.tip_radius)
    assert state.y == 0.0


def test_the_imu_s_acceleration_integrates_to_the_change_of_speed():
    plant, state = on_ground(60.0)
    interface, gained = MockInterface(plant), 0.0
    for rate in (0.5, 1.0, 0.0):
        for number in range(round(2.0 / DT)):
            state, result = plant.step(state, PlantCommand(wheel=WheelRateCommand(rate)), DT)
            interface.measure(state, number, result)
            ((_, sample),) = interface.samples([topics.IMU])
            assert isinstance(sample, ImuSample)
            assert abs(sample.linear_acceleration[0]) < 2.0
            gained += sample.linear_acceleration[0] * DT
        assert gained == pytest.approx(rate * plant.rover.wheels.tip_radius, abs=1e-6)


def test_backward_the_rover_turns_left_about_its_right_wheel():
    plant, state = on_ground(60.0)
    state, _ = follow(plant, state, PlantCommand(wheel=WheelRateCommand(-1.0)), 2.0)
    assert state.wheel_rates == (-1.0, 0.0)
    wheels = plant.rover.wheels
    assert state.heading == pytest.approx(2.0 * wheels.tip_radius / wheels.track_width)


def test_a_torque_accelerates_the_wheels_up_to_the_motor_s_limit():
    plant = build()
    drive = plant.rover.wheel_drive
    command = PlantCommand(wheel=WheelTorqueCommand(0.006))
    state, _ = follow(plant, plant.initial_state(), command, 2.0)
    assert state.wheel_rates[0] == pytest.approx(0.006 / drive.wheel_inertia * 2.0)
    state, _ = follow(plant, state, PlantCommand(wheel=WheelTorqueCommand(20.0)), 2.0)
    assert state.wheel_rates[0] == drive.motor.no_load_rate / drive.gear_ratio
    state, _ = follow(plant, state, PlantCommand(), DT)
    assert state.wheel_rates == (0.0, 0.0)


def test_the_rover_drives_no_further_than_its_tether():
    plant, state = on_ground(52.0)
    state, _ = follow(plant, state, PlantCommand(wheel=WheelRateCommand(20.0)), 8.0)
    reach = math.sqrt(52.0**2 - plant.floor_drop**2)
    assert math.hypot(state.x, state.y) == pytest.approx(reach)


def test_reeling_in_drags_the_rover_below_the_fairlead_and_lifts_it_continuously():
    plant, state = on_ground(52.0)
    interface = MockInterface(plant)
    state, _ = follow(plant, state, PlantCommand(wheel=WheelRateCommand(20.0)), 8.0)
    places = []
    for tick in range(400):
        state, result = plant.step(state, out(-0.5), DT)
        interface.measure(state, tick * TICK_NS, result)
        ((_, body),) = interface.samples([topics.TRUTH_BODY1])
        places.append(body.position)  # type: ignore[attr-defined]
    assert state.phase is PlantPhase.HANGING
    assert places[-1][:2] == (0.0, 0.0)
    steps = [math.dist(*pair) for pair in itertools.pairwise(places)]
    # Near the plumb line a short length of tether moves the rover far: sqrt(2 * 50.6 m * 5 mm).
    assert max(steps) < 0.75
    assert np.median(steps) < 0.1


# ---------------------------------------------------------------------------------- jump and nut


def test_a_jump_has_the_height_of_the_spring_s_energy_and_lands_where_it_started():
    plant, state = on_ground()
    jump = PlantCommand(jump=JumpMotorCommand(0.2, 0.1))
    state, released = follow(plant, state, jump, 2.3)
    assert [event.name for event in released] == [PlantEvent.LATCH_RELEASED, PlantEvent.TAKE_OFF]
    assert released[0].time == pytest.approx(2.3)
    assert state.phase is PlantPhase.FLIGHT
    state, flown = follow(plant, state, PlantCommand(), 3.0)
    assert [event.name for event in flown] == [PlantEvent.APEX, PlantEvent.TOUCHDOWN]
    height = jump_height(plant.rover, plant.scenario.gravity, 0.2)
    assert flown[0].values["height"] == pytest.approx(height)
    assert height == pytest.approx(0.375, abs=0.001)
    assert (state.phase, state.nut) == (PlantPhase.GROUNDED, 0.0)


def test_a_latch_commanded_to_hold_holds():
    plant, state = on_ground()
    held = PlantCommand(jump=JumpMotorCommand(0.1, 0.5, trips=False))
    state, events = follow(plant, state, held, 1.0)
    assert state.nut == pytest.approx(0.1)
    assert state.nut_rate == 0.0
    assert not events
    spring = plant.rover.slider.spring_rate
    assert plant.energies(state).spring == pytest.approx(0.5 * spring * 0.01)


def test_a_latch_that_trips_while_hanging_causes_no_flight():
    plant = build()
    jump = PlantCommand(jump=JumpMotorCommand(0.1, 0.5))
    state, events = follow(plant, plant.initial_state(), jump, 0.3)
    assert [event.name for event in events] == [PlantEvent.LATCH_RELEASED]
    assert state.phase is PlantPhase.HANGING


def test_the_flywheel_turns_the_screw_until_its_end():
    plant = build()
    state = plant.initial_state()
    after, _ = follow(plant, state, PlantCommand(jump=FlywheelCommand(0.01)), 0.5)
    rate = 0.01 / plant.rover.jump_drive.inertia * 0.5
    assert after.nut_rate / plant.pitch == pytest.approx(rate)
    after, _ = follow(plant, after, PlantCommand(jump=FlywheelCommand(0.01)), 60.0)
    assert (after.nut, after.nut_rate) == (0.0, 0.0)


# ------------------------------------------------------------------------------------ its outside


def test_every_topic_of_a_plant_is_published_within_the_contract():
    plant = build()
    interface = MockInterface(plant)
    published = {
        row.name
        for row in TOPICS.values()
        if row.name in ACCESS["sim_node"].publishes and row.rate and row.name != topics.SIM_STATUS
    }
    assert set(interface.topics) == published
    state, _ = follow(plant, plant.initial_state(), out(0.3), 1.0)
    interface.restart(state, 5)
    for name, sample in interface.samples(interface.topics):
        unpack(name, pack(name, sample), 5)
    assert interface.environment_markers(0).shapes


def test_the_tether_runs_from_the_fairlead_to_its_attachment():
    plant, state = on_ground()
    state, _ = follow(plant, state, PlantCommand(wheel=WheelRateCommand(2.0)), 3.0)
    interface = MockInterface(plant)
    interface.restart(state, 0)
    samples = dict(interface.samples([topics.TRUTH_TETHER, topics.TRUTH_BODY1]))
    nodes = samples[topics.TRUTH_TETHER].nodes  # type: ignore[attr-defined]
    position = samples[topics.TRUTH_BODY1].position  # type: ignore[attr-defined]
    assert nodes[0, :3].tolist() == [0.0, 0.0, 0.0]
    assert nodes[-1, :3] == pytest.approx(np.add(position, plant.rover.attachment))
    floor = plant.scenario.environment.floor_height
    assert position[2] - plant.rover.wheels.tip_radius == pytest.approx(floor)


def test_the_imu_measures_gravity_except_in_flight():
    plant, state = on_ground()
    interface = MockInterface(plant)
    flying, _ = follow(plant, state, PlantCommand(jump=JumpMotorCommand(0.2, 0.1)), 2.5)
    for each, force, contact in ((state, 1.62, 1.0), (flying, 0.0, 0.0)):
        interface.restart(each, 0)
        samples = dict(interface.samples([topics.IMU, topics.CONTACT]))
        assert samples[topics.IMU].linear_acceleration == (0.0, 0.0, force)  # type: ignore[attr-defined]
        switch = samples[topics.CONTACT].joints[machine.FLOOR_SWITCH]  # type: ignore[attr-defined]
        assert switch.position == contact


def test_refusals_and_timeouts_are_those_of_every_plant():
    simulation = Simulation(MockInterface(build()), DT)
    joints = {
        machine.WINCH_DRUM: JointValue(10.0, 0.3),
        machine.WINCH_BRAKE: JointValue(1.0),
        machine.WINCH_LIMIT: JointValue(effort=40.0),
    }
    simulation.accept_command(topics.WINCH_COMMAND, JointSample(0, joints))
    happened = [h.name for _ in range(120) for h in simulation.tick().event_reports]
    assert happened == [SimulationEvent.COMMAND_TIMEOUT]
    assert simulation.state.length == pytest.approx(10.19, abs=0.005)  # by its quick stop
    assert not simulation.state.brake_released
    simulation.accept_command(
        topics.JUMP_MOTOR_COMMAND, JointSample(0, {machine.JUMP_SCREW: JointValue(0.1, 0.5, 400.0)})
    )
    for _ in range(20):
        simulation.tick()
    with pytest.raises(Refusal, match="driven clear first") as refused:
        simulation.accept_command(
            topics.FLYWHEEL_COMMAND, JointSample(0, {machine.FLYWHEEL: JointValue(effort=0.1)})
        )
    assert refused.value.code is RefusalCode.WRONG_PHASE
    simulation.reset()
    assert simulation.state == build().initial_state()


@pytest.mark.parametrize(
    ("name", "complaint"),
    [("paper_table1_low", "should be spatial"), ("spatial_pendulum", "with a rover")],
)
def test_an_unsuitable_scenario_is_refused(name: str, complaint: str):
    with pytest.raises(ScenarioError, match=complaint):
        build(name)


def test_an_invalid_tick_is_refused():
    plant = build()
    with pytest.raises(ValueError, match="must be finite and above 0"):
        plant.step(plant.initial_state(), PlantCommand(), math.nan)
