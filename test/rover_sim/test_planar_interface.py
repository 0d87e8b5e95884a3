"""Samples of the planar plant, compared with independent derivations from its states."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from msg_schemas import machine, topics
from msg_schemas.access import ACCESS
from msg_schemas.cdr import pack, unpack
from msg_schemas.phases import PlantPhase
from msg_schemas.table import TOPICS
from rover_sim.interface.planar_interface import PlanarInterface
from rover_sim.plants.planar_plant import PlanarPlant
from rover_sim.plants.plant import JumpMotorCommand, PlantCommand
from rover_sim.scenarios.scenario import load_scenario

DT = 0.002
Tick = dict[str, Any]


def fly(plant: PlanarPlant, seconds: float, *, standing: float = 0.0) -> list[Tick]:
    """All samples of each tick: first on the ground, then a jump by the nut."""
    outside = PlanarInterface(plant)
    state, ticks, stamp = plant.initial_state(), [], 0
    outside.restart(state, stamp)
    for index in range(round(seconds / DT)):
        command = PlantCommand()
        if index * DT >= standing and state.phase is PlantPhase.HELD:
            command = PlantCommand(jump=JumpMotorCommand(0.2, machine.MAX_NUT_SPEED))
        before = state
        state, result = plant.step(before, command, DT)
        stamp += round(DT * 1e9)
        outside.measure(state, stamp, result)
        ticks.append({**dict(outside.samples(outside.topics)), "state": state})
    return ticks


@pytest.fixture(scope="module")
def turning_jump() -> list[Tick]:
    """A jump that starts tilted and rotates by a large angle."""
    scenario = load_scenario(
        "paper_table1_high", {"start.geometry": "+K", "start.slack": 2.0, "start.theta0": 10.0}
    )
    return fly(PlanarPlant(scenario), 0.98, standing=0.02)


def rotation(sample: Any) -> Rotation:
    return Rotation.from_quat(sample.orientation)


def in_flight(ticks: list[Tick]) -> list[tuple[Tick, Tick]]:
    return [
        (a, b)
        for a, b in itertools.pairwise(ticks)
        if a["state"].phase is b["state"].phase is PlantPhase.FLIGHT
    ]


@pytest.mark.parametrize("body", [topics.TRUTH_BODY1, topics.TRUTH_BODY2])
def test_twist_is_the_pose_s_rate_in_the_body_s_own_frame(turning_jump: list[Tick], body: str):
    for a, b in in_flight(turning_jump):
        before, after = a[body], b[body]
        rate = (np.subtract(after.position, before.position)) / DT
        middle = Rotation.concatenate([rotation(before), rotation(after)]).mean()
        twist = 0.5 * np.add(before.linear, after.linear)
        assert middle.inv().apply(rate) == pytest.approx(twist, abs=5e-4)
        turn = (rotation(before).inv() * rotation(after)).as_rotvec() / DT
        assert turn == pytest.approx(0.5 * np.add(before.angular, after.angular), abs=5e-3)


def test_the_jump_turns_far_enough_to_distinguish_body_from_world(turning_jump: list[Tick]):
    first, last = (turning_jump[i][topics.TRUTH_BODY1] for i in (0, -1))
    assert (rotation(first).inv() * rotation(last)).magnitude() > 0.3


def test_body_2_is_above_body_1_along_its_z(turning_jump: list[Tick]):
    for tick in turning_jump:
        one, two = tick[topics.TRUTH_BODY1], tick[topics.TRUTH_BODY2]
        between = rotation(one).inv().apply(np.subtract(two.position, one.position))
        assert between == pytest.approx([0.0, 0.0, tick["state"].s], abs=1e-12)


def test_leaning_counter_clockwise_in_the_plane_lifts_the_nose(turning_jump: list[Tick]):
    # theta0 = +10 deg: x axis of the body points up by 10 deg, z axis back.
    nose = rotation(turning_jump[0][topics.TRUTH_BODY1]).apply([1.0, 0.0, 0.0])
    assert nose == pytest.approx([np.cos(np.radians(10)), 0.0, np.sin(np.radians(10))])


def test_on_the_ground_the_accelerometer_reads_gravity_upwards(turning_jump: list[Tick]):
    tick = turning_jump[2]
    force = rotation(tick[topics.TRUTH_BODY1]).apply(tick[topics.IMU].linear_acceleration)
    assert force == pytest.approx([0.0, 0.0, 9.81], abs=1e-9)
    assert tick[topics.IMU].angular_velocity == pytest.approx([0.0, 0.0, 0.0])


def test_in_flight_with_a_slack_tether_the_accelerometer_reads_almost_zero():
    ticks = fly(PlanarPlant(load_scenario("paper_table1_low")), 0.8)
    readings = [np.linalg.norm(b[topics.IMU].linear_acceleration) for _, b in in_flight(ticks)]
    assert len(readings) > 100
    assert np.median(readings) < 0.1


def test_specific_force_and_gravity_integrate_to_the_change_of_velocity(turning_jump: list[Tick]):
    pairs = in_flight(turning_jump)
    velocity = np.zeros(3)
    for a, b in pairs:
        middle = Rotation.concatenate(
            [rotation(x[topics.TRUTH_BODY1]) for x in (a, b)]
        ).mean()  # fmt: skip
        force = middle.apply(b[topics.IMU].linear_acceleration)
        velocity += (force - np.array([0.0, 0.0, 9.81])) * DT

    def in_world(tick: Tick) -> Any:
        return rotation(tick[topics.TRUTH_BODY1]).apply(tick[topics.TRUTH_BODY1].linear)

    gained = in_world(pairs[-1][1]) - in_world(pairs[0][0])
    assert np.linalg.norm(gained) > 2.0
    assert velocity == pytest.approx(gained, abs=1e-6)


def test_gyro_and_odometry_agree(turning_jump: list[Tick]):
    for tick in turning_jump:
        assert tick[topics.IMU].angular_velocity == tick[topics.TRUTH_BODY1].angular


def test_contact_opens_at_take_off_and_closes_at_landing(turning_jump: list[Tick]):
    for tick in turning_jump:
        closed = tick[topics.CONTACT].joints[machine.FLOOR_SWITCH].position
        assert closed == (0.0 if tick["state"].phase is PlantPhase.FLIGHT else 1.0)
    assert {tick["state"].phase for tick in turning_jump} == {
        PlantPhase.HELD, PlantPhase.FLIGHT, PlantPhase.LANDED,
    }  # fmt: skip


def test_the_nut_s_state_has_position_speed_and_force_and_rests_in_flight(turning_jump: list[Tick]):
    driven = [t for t in turning_jump if 0.01 < t["state"].compression < 0.19]
    assert driven
    for tick in driven:
        position, velocity, effort = tick[topics.JUMP_MOTOR_STATE].joints[machine.JUMP_SCREW]
        assert position == tick["state"].compression
        assert velocity == pytest.approx(machine.MAX_NUT_SPEED)
        assert effort == pytest.approx(824.0 * position)
    for _, tick in in_flight(turning_jump):
        assert tick[topics.JUMP_MOTOR_STATE].joints[machine.JUMP_SCREW] == (0.0, 0.0, 0.0)


def test_fairlead_and_rover_carry_the_tether_s_weight():
    scenario = load_scenario("paper_table1_high", {"tether.elements": 20})
    tick = fly(PlanarPlant(scenario), DT, standing=1.0)[0]
    nodes = tick[topics.TRUTH_TETHER].nodes
    at_fairlead = tick[topics.LOAD_CELL].force
    at_rover = rotation(tick[topics.TRUTH_BODY1]).apply(tick[topics.ROVER_LOAD_CELL].force)
    weight = scenario.tether.section.line_density * scenario.tether.length * 9.81
    assert np.add(at_fairlead, at_rover) == pytest.approx([0.0, 0.0, -weight], abs=0.01 * weight)
    assert np.linalg.norm(at_rover) == pytest.approx(nodes[-1, 6])


def test_a_drum_without_a_motor_is_braked(turning_jump: list[Tick]):
    for tick in turning_jump:
        assert tick[topics.WINCH_STATE].joints == {
            machine.WINCH_DRUM: (5.0, 0.0, 0.0),
            machine.WINCH_BRAKE: (0.0, 0.0, 0.0),
        }


def test_the_tether_runs_from_the_fairlead_to_the_rover_s_attachment(turning_jump: list[Tick]):
    for tick in turning_jump:
        nodes, body = tick[topics.TRUTH_TETHER].nodes, tick[topics.TRUTH_BODY1]
        assert nodes[0, :3] == pytest.approx([0.0, 0.0, 0.0], abs=1e-15)
        attachment = np.add(body.position, rotation(body).apply([-0.15, 0.0, 0.0]))
        assert nodes[-1, :3] == pytest.approx(attachment, abs=1e-9)
        assert np.linalg.norm(nodes[:, 3:6], axis=1) == pytest.approx(1.0, abs=0.05)


def test_the_drawn_tether_passes_through_every_node(turning_jump: list[Tick]):
    tick = turning_jump[-1]
    line = next(s for s in tick[topics.MARKERS].shapes if s.kind == "line")
    nodes = tick[topics.TRUTH_TETHER].nodes[:, :3]
    drawn = np.array(line.points)
    assert len(drawn) > 3 * len(nodes)
    for node in nodes:
        assert np.min(np.linalg.norm(drawn - node, axis=1)) < 1e-12


def test_the_published_energies_balance(turning_jump: list[Tick]):
    start = turning_jump[0][topics.TRUTH_ENERGY].joints
    stored = ("kinetic", "gravity", "axial", "bending", "spring")
    for tick in turning_jump:
        now = {name: value.position for name, value in tick[topics.TRUTH_ENERGY].joints.items()}
        change = sum(now[name] - start[name].position for name in stored)
        assert change - now["input"] + now["dissipated"] == pytest.approx(now["drift"], abs=1e-9)
        assert abs(now["drift"]) < 1e-6 * 16.5


@pytest.mark.parametrize(
    "name", ["paper_table1_high", "paper_table2_case2", "tether_pendulum", "tether_with_weight"]
)
def test_all_samples_fit_the_contract_and_survive_a_round_trip(name: str):
    plant = PlanarPlant(load_scenario(name))
    for tick in fly(plant, 0.7)[::10]:
        del tick["state"]
        assert tick
        for topic, sample in tick.items():
            back = unpack(topic, pack(topic, sample))
            for (path, value), (read_back, published) in zip(
                back.scalars(), sample.scalars(), strict=True
            ):
                assert (topic, path, value) == (topic, read_back, published)


def test_without_a_rover_no_topic_of_a_rover_is_published():
    published = PlanarInterface(PlanarPlant(load_scenario("tether_pendulum"))).topics
    assert not {topics.IMU, topics.CONTACT, topics.TRUTH_BODY1, topics.JUMP_MOTOR_STATE} & {
        *published
    }
    assert {topics.TRUTH_TETHER, topics.LOAD_CELL, topics.CLOCK} < {*published}


def test_with_a_rover_every_timed_topic_of_the_sim_node_is_published():
    published = PlanarInterface(PlanarPlant(load_scenario("paper_table1_low"))).topics
    timed = {
        name
        for name, row in TOPICS.items()
        if row.name in ACCESS["sim_node"].publishes
        and row.rate is not None
        and not row.spatial_only
    }
    assert timed - {topics.SIM_STATUS} == {*published}
