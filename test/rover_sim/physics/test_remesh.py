"""Splitting and merging at the fairlead, in single steps and in long payouts."""

import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from spatial_march import PAYING_OUT, March

from rover_sim.physics.tether import remesh
from rover_sim.physics.tether.tether import Tether, make_tether, row_width
from rover_sim.physics.tether.tether_section import TetherSection

LUNAR = 1.62
ARAMID = TetherSection(2e4, 1e-4, 5e-3, axial_damping_time=0.015, bending_damping_time=0.05)


def state(nodes: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows for a chain with room for five elements more."""
    n = len(nodes) - 1
    q, v = np.zeros((6, row_width(n + 5, 3))), np.zeros((6, row_width(n + 5, 3)))
    q[:, : n + 1] = nodes.reshape(n + 1, 6).T
    v[:, : n + 1] = rates.reshape(n + 1, 6).T
    return q, v


@settings(deadline=None, max_examples=50)
@given(
    seed=st.integers(0, 2**32 - 1), nominal=st.floats(0.1, 3.0), share=st.floats(1.05, 1.9),
    payout_rate=st.floats(-1.0, 1.0),
)  # fmt: skip
def test_merging_after_splitting_reproduces_the_state(
    seed: int, nominal: float, share: float, payout_rate: float
):
    rng = np.random.default_rng(seed)
    cable = make_tether(ARAMID, 2 * nominal, 2, (0.0, 0.0, -LUNAR))
    s = share * nominal + nominal * np.arange(3.0)
    nodes = np.zeros((3, 2, 3))
    nodes[:, 0] = s[:, None] * [0.0, 0.1, -0.98] + 0.05 * nominal * rng.standard_normal((3, 3))
    nodes[:, 1] = [0.0, 0.1, -0.98] + 0.1 * rng.standard_normal((3, 3))
    q, v = state(nodes, 0.5 * rng.standard_normal((3, 2, 3)))
    fairlead_slope = np.array([[0.0, 0.1, -0.98], [0.0, 0.0, 0.0]]) + 0.1 * rng.standard_normal(
        (2, 3)
    )
    anchors = rng.standard_normal((14, 3))
    anchors[4:] = 0.0
    before = [array.copy() for array in (fairlead_slope, q[:, :3], v[:, :3], anchors)]

    length = (share - 1.0) * nominal
    remesh.split_first(
        cable, share * nominal, payout_rate, np.zeros((3, 3)), fairlead_slope, q, v, anchors
    )
    np.testing.assert_array_equal(q[:, 1:4], before[1])
    np.testing.assert_array_equal(anchors[2:6], before[3][:4])
    assert not anchors[:2].any()
    longer = cable._replace(elements=3)
    change = remesh.merge_first(
        longer, length, payout_rate, np.zeros((3, 3)), fairlead_slope, q, v, anchors
    )
    # A short remainder of an element determines the whole shape up to rounding over its length.
    scale = 1e-13 / (share - 1.0) ** 3
    assert abs(change) < 1e4 * nominal * scale
    for array, old in zip((fairlead_slope, q[:, :3], v[:, :3], anchors), before, strict=True):
        np.testing.assert_allclose(array, old, atol=100.0 * scale / nominal)


def bent(s: float, payout_rate: float) -> tuple[np.ndarray, ...]:
    """Place, slope, curvature, material velocity and its slope of a smooth moving curve."""
    a, k = 0.6, 0.8
    place = np.array([np.sin(a * s) / a, 0.1 * (1.0 - np.cos(k * s)), -1.0005 * s + 0.1 * s**2])
    slope = np.array([np.cos(a * s), 0.1 * k * np.sin(k * s), -1.0005 + 0.2 * s])
    curvature = np.array([-a * np.sin(a * s), 0.1 * k**2 * np.cos(k * s), 0.2])
    spin = np.array([[0.0, -0.3, 0.2], [0.3, 0.0, 0.5], [-0.2, -0.5, 0.0]])
    velocity = payout_rate * slope + spin @ place
    return place, slope, curvature, velocity, payout_rate * curvature + spin @ slope


def merging_step(nominal: float, payout_rate: float = 0.3) -> float:
    """Change of energy [J] by merging elements of the lengths 0.5 and 1 nominal on that curve."""
    length = 0.5 * nominal
    cable = make_tether(ARAMID, 2 * nominal, 2, (0.0, 0.0, -LUNAR))
    field = [bent(s, payout_rate) for s in length + nominal * np.arange(3.0)]
    q, v = state(np.array([[f[0], f[1]] for f in field]), np.array([[f[3], f[4]] for f in field]))
    _, slope, curvature, _, slope_speed = bent(0.0, payout_rate)
    fairlead_slope = np.array([slope, slope_speed - payout_rate * curvature])
    return float(
        remesh.merge_first(
            cable, length, payout_rate, np.zeros((3, 3)), fairlead_slope, q, v, np.zeros((14, 3))
        )
    )


def test_the_energy_change_of_a_merger_falls_with_a_high_power_of_the_length():
    steps = [abs(merging_step(nominal)) for nominal in (1.0, 0.5, 0.25)]
    # This curve is stretched and bent much more than a tether in use: it holds joules a metre.
    assert steps[1] < 1e-2
    for coarse, fine in itertools.pairwise(steps):
        assert coarse / fine > 2.0**5


def hanging(
    total: float, nominal: float, angle: float, room: int,
    section: TetherSection = ARAMID, mass: float = 10.0, rate: float = 0.0,
) -> March:  # fmt: skip
    """A straight tether with a mass, stretched by it, paid out or at rest."""
    n = max(1, round(total / nominal) - 1)
    first = total - n * nominal
    cable: Tether = make_tether(section, n * nominal, n, (0.0, 0.0, -LUNAR))
    stretch = 1.0 + mass * LUNAR * np.cos(angle) / section.axial_stiffness
    d = stretch * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    s = (first + nominal * np.arange(n + 1.0))[:, None]
    nodes = np.stack([s * d, np.broadcast_to(d, (n + 1, 3))], axis=1)
    rates = np.zeros_like(nodes)
    rates[:, 0] = rate * d
    return March(
        cable, nodes, rates, mass=mass, root=PAYING_OUT, length=first, slope=d,
        payout_rate=rate, room=room,
    )  # fmt: skip


def out_and_back(nominal: float) -> tuple[March, float]:
    """2 m to 60 m and back to 2 m at 2 m/s, swinging; and the energy at the start [J]."""
    march = hanging(2.0, nominal, np.radians(10.0), room=round(62.0 / nominal))
    start = march.energy
    for duration, acceleration in (
        (2.0, 1.0), (27.0, 0.0), (2.0, -1.0), (2.0, -1.0), (27.0, 0.0), (2.0, 1.0),
    ):  # fmt: skip
        march.run(duration, 4e-3, acceleration)
    return march, start


def test_payout_and_reel_in_balance_the_energy_through_the_fairlead():
    coarse, start = out_and_back(1.0)
    assert coarse.splits == 58
    assert len(coarse.remeshed) == 2 * 58
    assert coarse.length == pytest.approx(1.0)
    gap = coarse.energy - start - coarse.flowed_in + coarse.dissipated
    assert abs(gap) < 1e-4  # of 955 J that go out and come back
    assert max(map(abs, coarse.remeshed)) < 1e-5
    # No tension that a mesh twice as fine does not have as well, at no time.
    fine, _ = out_and_back(0.5)
    difference = np.abs(np.array(coarse.tensions) - fine.tensions)
    assert max(coarse.tensions) == pytest.approx(max(fine.tensions), rel=1e-4)
    assert difference.max() < 0.02 * max(fine.tensions)
    np.testing.assert_allclose(coarse.tip, fine.tip, atol=2e-3)


def lengthening(line_density: float, stretch: float) -> float:
    """Angle after 120 s of a straight massive pendulum that lengthens from 10 m at 0.25 m/s."""
    mass, rho = 10.0, line_density / stretch

    def motion(t: float, y: Any) -> list[float]:
        length, rate = (10.0 + 0.25 * t) * stretch, 0.25 * stretch
        inertia = mass * length**2 + rho * length**3 / 3.0
        drag = (2.0 * mass * length + rho * length**2) * rate
        pull = (mass * length + 0.5 * rho * length**2) * LUNAR
        return [y[1], -(drag * y[1] + pull * np.sin(y[0])) / inertia]

    flown = solve_ivp(motion, (0.0, 120.0), [np.radians(5.0), 0.0], rtol=1e-10, atol=1e-12)
    return float(flown.y[0, -1])


@pytest.mark.parametrize(("line_density", "limit"), [(5e-5, 4e-4), (5e-3, 6e-4)])
def test_lengthening_pendulum_through_splits(line_density: float, limit: float):
    assert lengthening(0.0, 1.0) == pytest.approx(0.02311, abs=5e-6)
    section = TetherSection(2e4, 1e-4, line_density, axial_damping_time=0.015)
    march = hanging(10.0, 2.0, np.radians(5.0), room=20, section=section, rate=0.25)
    march.run(120.0, 4e-3)
    assert march.splits == 15
    angle = float(np.arctan2(march.tip[0], -march.tip[2]))
    assert angle == pytest.approx(0.02311, abs=limit)
    # The tether's own mass and stretch explain the rest.
    assert angle == pytest.approx(lengthening(line_density, 1.0 + 10.0 * LUNAR / 2e4), abs=2e-5)


def test_payout_of_a_stiff_cable_through_splits():
    section = TetherSection.round(7e10, 3.45e-4, 2700.0, axial_damping_time=2e-3)
    march = hanging(2.0, 0.5, 0.0, room=14, section=section, mass=5.0, rate=0.5)
    n = march.cable.elements + 1
    sideways = 0.2 / float(np.linalg.norm(march.tip))
    march.v[0, :n] = -sideways * march.q[2, :n]
    march.v[3, :n] = sideways
    march.slope_rate = np.array([sideways, 0.0, 0.0])
    for place in ((-0.1165, -4.4985), (-0.0119, -7.0000)):
        march.run(5.0, 1e-3)
        assert march.tip[[0, 2]] == pytest.approx(place, abs=3e-3)
    assert march.splits == 10
