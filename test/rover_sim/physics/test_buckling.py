"""The law of an element in compression."""

import math
from dataclasses import replace

import numpy as np
import pytest

from rover_sim.physics.numerics.compiled import kernel
from rover_sim.physics.numerics.simd import fill, lane
from rover_sim.physics.tether import buckling
from rover_sim.physics.tether.tether_section import TetherSection

ARAMID = TetherSection(2.0e4, 1.0e-4, 5.0e-3, buckles=True)
LIMIT = 1.0e-3


@kernel
def mean_relief(strain: float, increment: float, delay: float, limit: float) -> tuple[float, float]:
    """`buckling.mean_relief` of one element."""
    tag = (0.0, 0.0)
    values, slopes = buckling.mean_relief(
        tag, fill(tag, strain), fill(tag, increment), delay, limit
    )
    return lane(values, 0), lane(slopes, 0)


def carried(strain: float) -> float:
    """Mean force per EA."""
    return float(strain + buckling.relief(strain, LIMIT))


def energy(strain: float) -> float:
    """Energy per EA and length."""
    return float(0.5 * strain**2 + buckling.released_energy(strain, LIMIT))


def test_the_limit_is_the_sum_of_two_euler_loads():
    element, weight = 0.9, 5.0e-3 * 1.62
    bending_length = (1.0e-4 / weight) ** (1.0 / 3.0)
    load = math.pi**2 * 1.0e-4 * (1.0 / element**2 + 1.0 / bending_length**2)
    assert buckling.buckling_strain(ARAMID, element, 1.62) == pytest.approx(load / 2.0e4)
    # Without gravity only the element's length counts.
    load = math.pi**2 * 1.0e-4 / element**2
    assert buckling.buckling_strain(ARAMID, element, 0.0) == pytest.approx(load / 2.0e4)


def test_in_tension_the_law_is_linear():
    for strain in (0.0, 1e-9, 0.1):
        assert carried(strain) == strain
        assert energy(strain) == 0.5 * strain**2


def test_in_compression_the_force_is_the_slope_of_the_energy():
    for strain in (-1e-5, -1e-3, -1e-2, -0.3):
        h = 1e-6 * abs(strain)
        slope = (energy(strain + h) - energy(strain - h)) / (2.0 * h)
        assert carried(strain) == pytest.approx(slope, rel=1e-6)
        slope = (carried(strain + h) - carried(strain - h)) / (2.0 * h)
        assert 1.0 + buckling.relief_slope(strain, LIMIT) == pytest.approx(slope, rel=1e-5)


def test_the_force_starts_with_ea_and_tends_to_the_post_buckling_load():
    assert carried(-1e-3 * LIMIT) == pytest.approx(-1e-3 * LIMIT, rel=1e-6)
    for strain in (-0.1, -0.2):
        assert carried(strain) == pytest.approx(LIMIT * (-1.0 + 0.5 * strain), rel=1e-3)


def test_a_tether_that_does_not_buckle_is_linear_exactly():
    limit = buckling.buckling_strain(replace(ARAMID, buckles=False), 0.9, 1.62)
    for strain in (-1e-6, -0.4, 0.1):
        assert buckling.relief(strain, limit) == 0.0
        assert buckling.released_energy(strain, limit) == 0.0


@pytest.mark.parametrize("delay", [0.0, 0.3, 2.0])
def test_a_step_spends_the_energy_plus_a_dissipation(delay: float):
    generator = np.random.default_rng(0)
    for _ in range(300):
        strain = generator.normal() * 10.0 ** generator.uniform(-5.0, -1.0)
        increment = generator.normal() * 10.0 ** generator.uniform(-5.0, -1.0)
        relief, _ = mean_relief(strain, increment, delay, LIMIT)
        force = strain + (0.5 + delay) * increment + relief
        change = energy(strain + increment) - energy(strain)
        rounding = 1e-12 * (strain**2 + increment**2)
        if delay == 0.0:
            assert force * increment == pytest.approx(change, abs=rounding)
        assert force * increment >= change - rounding
        # It pushes with at most what the buckled element carries.
        least = min(strain + delay * increment, strain + (1.0 + delay) * increment)
        assert force >= min(carried(least), 0.0) - 1e-15


def test_the_derivative_of_a_step_is_that_of_its_force():
    generator = np.random.default_rng(1)
    for _ in range(300):
        strain = generator.normal() * 10.0 ** generator.uniform(-4.0, -2.0)
        increment = generator.normal() * 10.0 ** generator.uniform(-7.0, -2.0)
        _, slope = mean_relief(strain, increment, 1.5, LIMIT)
        h = 1e-3 * min(abs(increment), LIMIT)
        after, _ = mean_relief(strain, increment + h, 1.5, LIMIT)
        before, _ = mean_relief(strain, increment - h, 1.5, LIMIT)
        assert slope == pytest.approx((after - before) / (2.0 * h), rel=2e-2, abs=2e-3)
