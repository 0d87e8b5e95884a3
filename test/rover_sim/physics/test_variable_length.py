"""The exit element against the lengthening pendulum, hanging weights and the energy flux."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from spatial_march import PAYING_OUT, March

from rover_sim.physics.tether import variable_length
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.tether import make_tether
from rover_sim.physics.tether.tether_section import TetherSection

LUNAR = 1.62
ARAMID = TetherSection(2e4, 1e-4, 5e-3, axial_damping_time=2e-3)


def hanging(
    length: float, rate: float, angle: float = 0.0, section: TetherSection = ARAMID
) -> March:
    """A straight tether with a point mass, one first element of 1 m and a chain behind it."""
    mass, element = 10.0, 2.0
    elements = round((length - 1.0) / element)
    cable = make_tether(section, elements * element, elements, (0.0, 0.0, -LUNAR))
    stretch = 1.0 + mass * LUNAR * np.cos(angle) / ARAMID.axial_stiffness
    d = stretch * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    s = (1.0 + element * np.arange(elements + 1.0))[:, None]
    nodes = np.stack([s * d, np.broadcast_to(d, (elements + 1, 3))], axis=1)
    rates = np.zeros_like(nodes)
    rates[:, 0] = rate * d
    return March(
        cable, nodes, rates, mass=mass, root=PAYING_OUT, length=1.0, slope=d, payout_rate=rate
    )


@pytest.mark.parametrize("rate", [0.5, -0.3])
def test_a_lengthening_pendulum_swings_by_its_equation(rate: float):
    length, angle, duration = 9.0, np.radians(5.0), 1.5
    march = hanging(length, rate, angle)
    march.run(duration, 1e-3)
    flown = solve_ivp(
        lambda t, y: [
            y[1], -(2.0 * rate * y[1] + LUNAR * np.sin(y[0])) / (length + rate * t)
        ],
        (0.0, duration), [angle, 0.0], rtol=1e-10, atol=1e-12,
    )  # fmt: skip
    # The mass stretches the tether by 8e-4 of its length, which shifts the angle's phase.
    assert np.arctan2(march.tip[0], -march.tip[2]) == pytest.approx(flown.y[0, -1], abs=1e-5)
    assert abs(march.tip[1]) < 1e-12


def test_energy_changes_by_the_flux_through_the_fairlead():
    gaps = []
    for h in (8e-3, 4e-3):
        march = hanging(9.0, 0.5, np.radians(5.0))
        start = march.energy
        march.run(1.0, h)
        assert abs(march.energy - start) > 1.0
        gaps.append(abs(march.energy - start - march.flowed_in + march.dissipated))
    assert gaps[0] < 1e-8
    assert 3.0 < gaps[0] / gaps[1] < 5.0


@pytest.mark.parametrize("acceleration", [0.0, 0.2, -0.2])
def test_tension_is_the_weight_minus_the_inertia_of_the_payout(acceleration: float):
    # Damped so much that the shake of the start is gone after a second.
    march = hanging(9.0, 0.0, section=TetherSection(2e4, 1e-4, 5e-3, axial_damping_time=0.05))
    march.run(2.0, 1e-3, acceleration)
    hung = 10.0 + ARAMID.line_density * (9.0 + 0.5 * acceleration * 2.0**2)
    assert march.fairlead_tension == pytest.approx(hung * (LUNAR - acceleration), rel=2e-4)


def split(
    length: float, cut: float, payout_rate: float, e: Array, rate: Array
) -> tuple[Array, Array]:
    """The node (r, r') that splits an exit element at `cut` from the fairlead, and its rates."""
    fields = np.array(
        [
            variable_length.field_at(length, cut, payout_rate, tuple(column), tuple(rates))
            for column, rates in zip(e.T.tolist(), rate.T.tolist(), strict=True)
        ]
    )
    return fields[:, :2].T.ravel(), fields[:, 2:].T.ravel()


def test_splitting_keeps_position_velocity_and_energy():
    rng = np.random.default_rng(3)
    length, cut, rate = 3.0, 1.1, 0.4
    e = np.array([[0.0, 0.0, 0.0], [0.1, 0.05, -1.0], [0.4, 0.2, -2.9], [0.2, 0.0, -0.98]])
    e_rate = 0.1 * rng.standard_normal((4, 3))
    e_rate[0] = 0.0
    node, node_rate = split(length, cut, rate, e, e_rate)
    cable = make_tether(ARAMID, length - cut, 1, (0.0, 0.0, -LUNAR))
    whole = variable_length.exit_energies(cable, length, rate, e, e_rate)
    first = np.array([e[0], e[1], node[:3], node[3:]])
    first_rate = np.array([e_rate[0], e_rate[1], node_rate[:3], node_rate[3:]])
    above = variable_length.exit_energies(cable, cut, rate, first, first_rate)
    # The part below is Lagrangian: its nodes' rates are material, a payout of zero.
    below_e = np.array([node[:3], node[3:], e[2], e[3]])
    below_rate = np.array([node_rate[:3], node_rate[3:], e_rate[2], e_rate[3]])
    below = variable_length.exit_energies(cable, length - cut, 0.0, below_e, below_rate)
    for index in (0, 1, 3):
        assert above[index] + below[index] == pytest.approx(whole[index], rel=1e-12)
    # Green's strain squared is of degree 8; five Gauss points are exact in each part.
    assert above[2] + below[2] == pytest.approx(whole[2], rel=1e-9)


def test_the_material_flows_with_the_payout_at_the_fairlead():
    e = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 0.0, -2.0], [0.0, 0.0, -1.0]])
    _, node_rate = split(2.0, 1e-12, 0.3, e, np.zeros((4, 3)))
    np.testing.assert_allclose(node_rate[:3], [0.0, 0.0, -0.3], atol=1e-9)
