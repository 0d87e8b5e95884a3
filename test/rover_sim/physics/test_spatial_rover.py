"""Tether and rover in space against references, conservation laws and the planar model."""

import numpy as np
import pytest
from spatial_march import FREE, March, rotation, rover_at

from rover_sim.physics.rover.spatial_rover import ROTORS, SPIN, SpatialRover
from rover_sim.physics.tether.tether import make_tether
from rover_sim.physics.tether.tether_section import TetherSection
from rover_sim.plants.planar_plant import PlanarPlant
from rover_sim.plants.plant import PlantCommand
from rover_sim.scenarios.scenario import load_planar

TABLE1 = TetherSection.round(0.5e9, 3.45e-4, 1e4, axial_damping_time=2e-3)


def swung_body(elements: int) -> March:
    """Tether and one rigid body, straight along d at 30 deg, the tip moving sideways at 1 m/s."""
    cable = make_tether(TABLE1, 5.0, elements, (0.0, 0.0, -9.81))
    tilt = np.pi / 6
    d = np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    s = np.linspace(0.0, 5.0, elements + 1)[:, None]
    nodes = np.stack([s * d, np.broadcast_to(d, (elements + 1, 3))], axis=1)
    sideways = np.array([0.0, 1.0, 0.0])
    rates = np.stack(
        [s / 5.0 * sideways, np.broadcast_to(sideways / 5.0, (elements + 1, 3))], axis=1
    )
    rover = SpatialRover(5.0, 0.0, (0.05, 0.06, 0.04), (0.0, 0.0, 0.1))
    spin = np.cross(d, sideways) / 5.0
    body = rover_at(rover, 5.0 * d, sideways, np.array([0.0, -tilt, 0.0]), spin, 0.2)
    return March(cable, nodes, rates, rover, body, spring=(1000.0, 0.2, 0.0))


# Converged values of an independent code: time, attachment point, rotation vector.
SWUNG = [
    (0.5, (2.42096, 0.49079, -5.39337), (0.08939, -0.47007, 0.02575)),
    (1.0, (1.46705, 0.76093, -6.62295), (0.11497, -0.25946, 0.03871)),
    (1.5, (-0.49081, 0.52346, -5.74523), (0.10413, 0.02897, 0.05226)),
    (2.0, (-2.38286, 0.08565, -5.15715), (0.02568, 0.50837, 0.07983)),
]


def test_swinging_body_follows_the_independent_reference():
    march = swung_body(40)
    for _, place, attitude in SWUNG:
        march.run(0.5, 2.5e-4)
        np.testing.assert_allclose(march.tip, place, atol=1.2e-5)
        np.testing.assert_allclose(march.attitude, attitude, atol=1.2e-5)


def test_swinging_body_converges_with_the_square_of_the_step():
    ends = []
    for h in (1e-3, 5e-4, 2.5e-4):
        march = swung_body(5)
        march.run(0.5, h)
        ends.append(np.concatenate([march.tip, march.attitude]))
    ratio = np.linalg.norm(ends[0] - ends[1]) / np.linalg.norm(ends[1] - ends[2])
    assert 3.6 < ratio < 4.4


def test_dissipation_and_energy_balance():
    march = swung_body(20)
    start = march.energy
    march.run(2.0, 1e-3)
    assert march.dissipated > 1e-3
    assert abs(march.energy - start + march.dissipated) < 1e-8


def free_gyrostat(offset: tuple[float, float, float]) -> March:
    """A rover with spinning rotors on a short limp tether, free of everything."""
    section = TetherSection(100.0, 1e-6, 1e-3)
    cable = make_tether(section, 0.5, 2, (0.0, 0.0, 0.0))
    direction = np.array([0.6, 0.0, 0.8])
    s = np.linspace(0.0, 0.5, 3)[:, None]
    nodes = np.stack([s * direction, np.broadcast_to(direction, (3, 3))], axis=1)
    rover = SpatialRover(6.0, 4.0, (0.2, 0.3, 0.15), (0.05, -0.1, 0.2), offset)
    spin = np.array([0.5, -0.8, 1.2])
    body = rover_at(rover, nodes[-1, 0], np.zeros(3), np.array([0.3, 0.2, -0.4]), spin, 0.21)
    body[ROTORS:] = (0.05, -0.2, 0.0)
    rates = np.zeros_like(nodes)
    return March(cable, nodes, rates, rover, body, spring=(800.0, 0.2, 0.0), root=FREE)


def momenta(march: March) -> tuple[np.ndarray, np.ndarray]:
    """Linear and angular momentum about the origin of tether and rover together."""
    rover, body = march.rover, march.body
    assert rover is not None
    turned = rotation(march.attitude)
    g1 = body[:3]
    g2 = g1 + body[16] * turned[:, 2] + turned @ np.array(rover.offset)
    p1, p2 = rover.m1 * body[10:13], rover.m2 * body[13:16]
    spin = np.array(rover.inertia) * body[SPIN : SPIN + 3] + body[ROTORS:]
    linear = p1 + p2
    angular = np.cross(g1, p1) + np.cross(g2, p2) + turned @ spin
    points, weights = np.polynomial.legendre.leggauss(6)
    length = march.cable.element_length
    for e in range(march.cable.elements):
        for x, w in zip((points + 1) / 2, weights / 2, strict=True):
            shape = np.array(
                [1 - 3 * x**2 + 2 * x**3, length * (x - 2 * x**2 + x**3),
                 3 * x**2 - 2 * x**3, length * (x**3 - x**2)]
            )  # fmt: skip
            place = shape @ element(march.q, e)
            rate = shape @ element(march.v, e)
            mass = w * length * march.cable.line_density
            linear = linear + mass * rate
            angular = angular + mass * np.cross(place, rate)
    return linear, angular


def element(rows: np.ndarray, e: int) -> np.ndarray:
    return np.array([rows[:3, e], rows[3:, e], rows[:3, e + 1], rows[3:, e + 1]])


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (0.06, -0.09, 0.0)])
def test_free_gyrostat_keeps_energy_and_momenta(offset: tuple[float, float, float]):
    march = free_gyrostat(offset)
    energy, (linear, angular) = march.energy, momenta(march)
    march.run(20.0, 1e-3)
    after_linear, after_angular = momenta(march)
    assert abs(march.energy - energy) < 1e-9
    np.testing.assert_allclose(after_linear, linear, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(after_angular, angular, rtol=0.0, atol=1e-10)


def spatial_jump(azimuth: float, h: float, duration: float) -> tuple[March, np.ndarray]:
    """The planar taut jump's start, standing in the vertical plane of that azimuth."""
    overrides = {"tether.elements": 5, "integration.h": h, "integration.tolerance": 1e-12}
    scenario = load_planar("taut_jump", overrides)
    plant = PlanarPlant(scenario)
    state = plant.take_off(plant.initial_state())
    made = scenario.rover
    assert made is not None
    east = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    side = np.cross(east, [0.0, 0.0, 1.0])

    def lift(planar: np.ndarray) -> np.ndarray:
        return np.asarray(planar[..., :1] * east + planar[..., 1:] * np.array([0.0, 0.0, 1.0]))

    # Body x along `east`: the planar angle turns about -y of the body, which is `side`.
    planar_inertia = made.inertia1 + made.inertia2
    a, b = made.attachment
    rover = SpatialRover(made.m1, made.m2, (0.03, planar_inertia, 0.05), (a, 0.0, b))
    spring = (made.spring_rate, made.spring_free_length, made.slider_damping)
    cable = make_tether(scenario.tether.section, 5.0, 5, (0.0, 0.0, -scenario.gravity))
    attitude = np.array([0.0, 0.0, azimuth])
    tip_rate = lift(state.node_rates[-1, 0])
    body = rover_at(rover, lift(state.nodes[-1, 0]), tip_rate, attitude, np.zeros(3), state.s)
    march = March(cable, lift(state.nodes), lift(state.node_rates), rover, body, spring=spring)
    march.run(duration, h)
    end, _ = plant.step(state, PlantCommand(), duration)
    turn = -(rotation(march.attitude) @ np.array([0.0, 0.0, 1.0]))
    theta = np.arctan2(float(turn @ east), -float(turn[2]))
    difference = np.concatenate(
        [march.tip - lift(end.nodes[-1, 0]), march.body[:3] - lift(end.G1), [theta - end.theta]]
    )
    out_of_plane = np.abs(march.q[:3].T @ side).max()
    return march, np.append(difference, out_of_plane)


@pytest.mark.parametrize("azimuth", [0.0, 0.7, np.pi / 2, -2.5])
def test_a_jump_in_any_vertical_plane_is_the_planar_jump(azimuth: float):
    _, difference = spatial_jump(azimuth, 1e-3, 0.3)
    assert np.abs(difference[:-1]).max() < 1e-10
    assert difference[-1] < 1e-11
