import dataclasses
import itertools
import math
from collections.abc import Iterable

import numpy as np
import pytest
from operating_points import flat_plate, operating_point
from scipy.integrate import quad

from rover_sim.physics.ground.wheel_soil import (
    DEEPEST,
    Soil,
    Wheel,
    WheelOnSoil,
    stress_integral,
    wheel_on_soil,
)
from rover_sim.physics.ground.wheel_table import WheelTable, look_up, sinking_work, wheel_table

REGOLITH = Soil()
LOOSE_SAND = Soil(peak_offset=0.18, peak_slope=0.32)
SMOOTH = Wheel(radius=0.1, width=0.05, grouser_height=0.0)
GROUSERS = Wheel(radius=0.15, width=0.05, grouser_height=0.01)
LIGHT = 0.05  # largest entry of a light load; z = 0.5 % of r
LOAD = 8.1  # N, half of 10 kg on the Moon


def by_adaptive_quadrature(system: WheelOnSoil, entry: float, slip: float) -> np.ndarray:
    """Second implementation of Wong and Reece's integrals, zone by zone, with scipy."""
    theta1 = 2 * math.asin(entry)
    share = system.peak_offset + system.peak_slope * slip**2 / math.hypot(slip, 0.02)
    peak = share * theta1
    ratio = 1 - slip if slip >= 0 else 1 / (1 + slip)

    def stresses(theta: float) -> tuple[float, float]:
        mirrored = theta if theta >= peak else theta1 - theta / peak * (theta1 - peak)
        depth = system.radius * (math.cos(mirrored) - math.cos(theta1))
        pressure = system.modulus * max(depth, 0.0) ** system.exponent
        angular_travel = (theta1 - theta) - ratio * (math.sin(theta1) - math.sin(theta))
        shear = system.shear_radius * angular_travel
        strength = system.cohesion + pressure * system.friction
        mobilised = strength * (1 - math.exp(-abs(shear) / system.shear_modulus))
        return pressure, math.copysign(mobilised, shear)

    def pull(theta: float) -> float:
        p, tau = stresses(theta)
        return system.shear_radius * tau * math.cos(theta) - system.radius * p * math.sin(theta)

    def load(theta: float) -> float:
        p, tau = stresses(theta)
        return system.shear_radius * tau * math.sin(theta) + system.radius * p * math.cos(theta)

    def torque(theta: float) -> float:
        return system.shear_radius**2 * stresses(theta)[1]

    return system.width * np.array(
        [
            quad(f, 0.0, theta1, points=[peak], limit=400, epsabs=0.0, epsrel=1e-10)[0]
            for f in (pull, load, torque)
        ]
    )


# ----------------------------------------------------------- the numbers in the literature


@pytest.mark.parametrize(("slip", "pull"), [(0.2, -0.05), (0.3, 0.40), (0.5, 1.15)])
def test_the_flat_plate_has_bekkers_pull(slip: float, pull: float):
    """Bekker's flat plate, smooth wheel of 0.1 m RADIUS, sinkage 7.4 mm."""
    point = flat_plate(wheel_on_soil(SMOOTH, REGOLITH), LOAD, slip)
    assert point.sinkage == pytest.approx(7.43e-3, rel=2e-3)
    assert point.pull == pytest.approx(pull, abs=0.005)


@pytest.mark.parametrize(("slip", "pull"), [(0.2, 0.35), (0.3, 0.85), (0.5, 1.65)])
def test_the_stress_integral_has_wong_and_reeces_pull(slip: float, pull: float):
    """The stress integral with its peak under the axle, c1 = c2 = 0, same wheel and load."""
    point = operating_point(wheel_on_soil(SMOOTH, REGOLITH), LOAD, slip)
    assert point.sinkage == pytest.approx(7.4e-3, rel=0.02)
    assert point.pull == pytest.approx(pull, rel=0.025)


def test_0_1_m_is_the_radius_and_not_the_diameter():
    small = wheel_on_soil(dataclasses.replace(SMOOTH, radius=0.05), REGOLITH)
    assert operating_point(small, LOAD, 0.2).sinkage > 9e-3
    assert operating_point(small, LOAD, 0.3).pull < 0.3
    assert flat_plate(small, LOAD, 0.3).pull < 0.0


@pytest.mark.parametrize(("slip", "pull"), [(0.2, 0.104), (0.3, 0.538), (0.5, 1.193)])
def test_the_peak_measured_on_loose_sand_costs_pull(slip: float, pull: float):
    """With Wong and Reece's measured (0.18, 0.32) the wheel sinks deeper and pulls less."""
    point = operating_point(wheel_on_soil(SMOOTH, LOOSE_SAND), LOAD, slip)
    assert point.pull == pytest.approx(pull, abs=0.002)
    assert point.sinkage > 8.2e-3


@pytest.mark.parametrize(("slip", "times"), [(0.2, 3.0), (0.3, 2.2), (0.5, 1.8)])
def test_a_larger_wheel_with_grousers_pulls_far_more(slip: float, times: float):
    smooth = operating_point(wheel_on_soil(SMOOTH, REGOLITH), LOAD, slip)
    better = operating_point(wheel_on_soil(GROUSERS, REGOLITH), LOAD, slip)
    assert better.pull > times * smooth.pull
    assert better.sinkage < smooth.sinkage


def test_grousers_add_what_bekker_s_spuds_add():
    plain = wheel_on_soil(dataclasses.replace(GROUSERS, grouser_height=0.0), REGOLITH)
    spuds = wheel_on_soil(GROUSERS, REGOLITH)
    assert spuds.cohesion / plain.cohesion == pytest.approx(1.4)
    assert spuds.friction / plain.friction == pytest.approx(
        1 + 0.64 * 0.2 * math.atan(5.0), rel=1e-12
    )
    assert spuds.shear_radius == pytest.approx(0.16)
    half = dataclasses.replace(GROUSERS, grouser_engagement=0.5)
    assert half.shear_radius == pytest.approx(0.155)


# ------------------------------------------------------------------------- the integral


@pytest.mark.parametrize(
    "soil",
    [REGOLITH, LOOSE_SAND, Soil(exponent=0.8), Soil(exponent=1.4, shear_modulus=0.01)],
    ids=["regolith", "loose sand", "n = 0.8", "n = 1.4"],
)
@pytest.mark.parametrize("slip", [-0.9, -0.3, -0.05, 0.0, 0.02, 0.3, 1.0])
def test_the_fixed_quadrature_agrees_with_an_adaptive_one(soil: Soil, slip: float):
    system = wheel_on_soil(GROUSERS, soil)
    for entry in (0.05, 0.15, 0.4):
        found = np.array(stress_integral(system, entry, slip))
        exact = by_adaptive_quadrature(system, entry, slip)
        scale = exact[1] * np.array([1.0, 1.0, system.shear_radius])
        np.testing.assert_array_less(np.abs(found - exact) / scale, 3e-4)


def test_without_shear_the_pressure_alone_carries_the_load():
    """Bekker's closed form for the sinkage holds for small entry angles."""
    soil = Soil(cohesion=0.0, friction_angle=1e-3)
    system = wheel_on_soil(SMOOTH, soil)
    for load in (1.0, 8.1):
        exact = operating_point(system, load, 0.3)
        assert exact.sinkage == pytest.approx(flat_plate(system, load, 0.3).sinkage, rel=0.02)
        # the pull is the work of compaction, b k z^2 / 2 per metre
        assert exact.pull == pytest.approx(-0.05 * system.modulus * exact.sinkage**2 / 2, rel=1e-3)


def test_on_hard_ground_the_pull_is_coulomb_s():
    soil = Soil(frictional_modulus=1e10, cohesion=0.0, shear_modulus=1e-6)
    system = wheel_on_soil(SMOOTH, soil)
    for slip, sign in ((0.5, 1.0), (-0.5, -1.0)):
        point = operating_point(system, LOAD, slip)
        assert point.pull == pytest.approx(sign * LOAD * math.tan(math.radians(35)), rel=0.02)
        assert point.torque == pytest.approx(point.pull * 0.1, rel=0.02)


def test_pull_and_torque_rise_with_slip_from_braking_to_driving():
    system = wheel_on_soil(SMOOTH, REGOLITH)
    slips = np.linspace(-1.0, 1.0, 81)
    points = [operating_point(system, LOAD, slip) for slip in slips]
    pull = np.array([point.pull for point in points])
    torque = np.array([point.torque for point in points])
    assert np.all(np.diff(pull) > 0.0)
    assert np.all(np.diff(torque) > 0.0)
    towed = np.interp(0.0, torque, slips)
    driven = np.interp(0.0, pull, slips)
    assert (
        -0.2 < towed < 0.0 < driven < 0.3
    )  # a towed wheel skids, one that only drives itself slips
    assert np.interp(towed, slips, pull) < -0.5
    assert np.interp(driven, slips, torque) > 0.05


def test_a_wheel_never_delivers_more_than_its_drive_does():
    for wheel in (SMOOTH, GROUSERS):
        system = wheel_on_soil(wheel, REGOLITH)
        for slip in np.linspace(0.02, 0.98, 25):
            point = operating_point(system, LOAD, slip)
            assert point.pull * (1 - slip) * system.shear_radius < point.torque


def test_rolling_point_carries_its_load():
    system = wheel_on_soil(GROUSERS, REGOLITH)
    point = operating_point(system, 40.0, 0.4)
    entry = math.sqrt(point.sinkage / (2 * system.radius))
    assert 2.0 * system.radius * entry**2 == pytest.approx(point.sinkage)
    assert stress_integral(system, entry, 0.4)[1] == pytest.approx(40.0, rel=1e-9)


# --------------------------------------------------------------------------- the table

TABLES = {
    "regolith": (wheel_table(wheel_on_soil(GROUSERS, REGOLITH)), 5e-4),
    "loose sand": (wheel_table(wheel_on_soil(SMOOTH, LOOSE_SAND)), 5e-4),
    "n = 0.8": (wheel_table(wheel_on_soil(SMOOTH, Soil(exponent=0.8))), 1e-3),
    "K = 5 mm": (wheel_table(wheel_on_soil(SMOOTH, Soil(shear_modulus=0.005))), 5e-3),
}


def largest_error(table: WheelTable, points: Iterable[tuple[float, float]]) -> float:
    """Largest error of X, Z and M / r_s relative to Z or, for lighter loads, to Z at LIGHT."""
    system = table.system
    light = stress_integral(system, LIGHT, 0.0)[1]
    worst = 0.0
    for entry, slip in points:
        exact = np.array(stress_integral(system, entry, slip))
        found = np.array(look_up(table.nodes, entry, slip))[[0, 3, 6]]
        scale = max(exact[1], light) * np.array([1.0, 1.0, system.shear_radius])
        worst = max(worst, float(np.max(np.abs(found - exact) / scale)))
    return worst


@pytest.mark.parametrize("name", TABLES)
def test_the_table_is_exact_within_a_bound(name: str):
    """At the midpoints of all cells but those of the first row, z < 0.03 % of r, and elsewhere."""
    table, bound = TABLES[name]
    entries, slips = np.arange(1, 56) + 0.5, np.arange(96) + 0.5
    at_midpoints = largest_error(
        table, itertools.product(entries * DEEPEST / 56, slips * 2.0 / 96 - 1.0)
    )
    assert at_midpoints < bound
    rng = np.random.default_rng(2)
    anywhere = largest_error(
        table, [(rng.uniform(0.0125, 0.7), rng.uniform(-1.0, 1.0)) for _ in range(4000)]
    )
    assert 0.1 * at_midpoints < anywhere < 1.3 * at_midpoints


@pytest.mark.parametrize("name", TABLES)
def test_the_work_of_sinking_is_the_integral_of_the_load(name: str):
    table, bound = TABLES[name]
    radius = table.system.radius

    def by_entry(entry: float) -> float:
        return float(stress_integral(table.system, entry, 0.0)[1]) * 4.0 * radius * entry

    for sinkage in (1e-4, 7e-3, 0.02, 0.9 * radius):
        exact, _ = quad(by_entry, 0.0, math.sqrt(0.5 * sinkage / radius), epsabs=1e-12)
        assert sinking_work(table, sinkage) == pytest.approx(exact, rel=2.0 * bound, abs=1e-6)
    assert sinking_work(table, 0.0) == 0.0


def test_below_the_first_cell_the_error_is_some_millinewtons():
    table, _ = TABLES["regolith"]
    for entry in np.linspace(0.0, 0.0125, 20):
        for slip in np.linspace(-1.0, 1.0, 201):
            exact = np.array(stress_integral(table.system, entry, slip))
            found = np.array(look_up(table.nodes, entry, slip))[[0, 3]]
            np.testing.assert_allclose(found, exact[:2], atol=0.01)


@pytest.mark.parametrize("name", TABLES)
def test_the_table_s_derivatives_are_those_of_its_values(name: str):
    table, _ = TABLES[name]
    rng = np.random.default_rng(3)
    step = 1e-7
    for _ in range(300):
        entry, slip = rng.uniform(0.01, 0.55), rng.uniform(-0.999, 0.999)
        values = np.array(look_up(table.nodes, entry, slip)).reshape(3, 3)
        by_entry = (
            np.array(look_up(table.nodes, entry + step, slip))
            - np.array(look_up(table.nodes, entry - step, slip))
        ).reshape(3, 3)[:, 0] / (2 * step)
        by_slip = (
            np.array(look_up(table.nodes, entry, slip + step))
            - np.array(look_up(table.nodes, entry, slip - step))
        ).reshape(3, 3)[:, 0] / (2 * step)
        scale = np.abs(values).max()
        np.testing.assert_allclose(values[:, 1], by_entry, atol=1e-5 * scale)
        np.testing.assert_allclose(values[:, 2], by_slip, atol=1e-5 * scale)


def test_the_table_and_its_derivatives_do_not_jump_between_cells():
    table, _ = TABLES["regolith"]
    rng = np.random.default_rng(4)
    for _ in range(200):
        entry, slip = rng.uniform(0.02, 0.5), rng.uniform(-1.0, 1.0)
        for at in (
            (round(entry * 80) / 80, slip),
            (entry, round(slip * 48) / 48),
        ):
            below = look_up(table.nodes, at[0] - 1e-12, at[1] - 1e-12)
            above = look_up(table.nodes, at[0] + 1e-12, at[1] + 1e-12)
            np.testing.assert_allclose(below, above, rtol=1e-6, atol=1e-6)


def test_beyond_the_table_the_forces_go_on_growing():
    table, _ = TABLES["regolith"]
    load = [look_up(table.nodes, entry, 0.3)[3] for entry in np.linspace(0.45, 0.7, 26)]
    assert np.all(np.diff(load) > 0.0)
    assert look_up(table.nodes, 0.2, 1.5) == look_up(table.nodes, 0.2, 1.0)


# ------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("kind", "change", "named"),
    [
        (Soil, {"cohesion": -1.0}, "cohesion = -1.0"),
        (Soil, {"frictional_modulus": 0.0}, "frictional_modulus = 0.0"),
        (Soil, {"exponent": 3.0}, "exponent = 3.0"),
        (Soil, {"friction_angle": 80.0}, "friction_angle = 80.0"),
        (Soil, {"shear_modulus": math.nan}, "shear_modulus = nan"),
        (Soil, {"peak_offset": -0.1}, "peak_offset = -0.1"),
        (Wheel, {"radius": 0.0}, "radius = 0.0"),
        (Wheel, {"width": math.inf}, "width = inf"),
        (Wheel, {"grouser_height": 0.2}, "grouser_height = 0.2"),
        (Wheel, {"grouser_engagement": 1.2}, "grouser_engagement = 1.2"),
    ],
)
def test_impossible_wheels_and_soils_are_refused(kind: type, change: dict[str, float], named: str):
    with pytest.raises(ValueError, match=named):
        kind(**change)


@pytest.mark.parametrize(("load", "slip"), [(0.0, 0.2), (1e6, 0.2), (8.1, 1.5), (math.nan, 0.2)])
def test_impossible_loads_are_refused(load: float, slip: float):
    system = wheel_on_soil(SMOOTH, REGOLITH)
    with pytest.raises(ValueError, match="load = "):
        operating_point(system, load, slip)
    if not 0.0 < load < 1e5 or slip > 1.0:
        with pytest.raises(ValueError, match="load = "):
            flat_plate(system, math.nan if load > 1e5 else load, slip)
