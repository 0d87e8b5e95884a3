"""The wheel-soil law beyond straight rolling: skids, side slip, deep sinkage."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.integrate import quad

from rover_sim.physics.ground.wheel_soil import (
    LOCKED,
    Soil,
    Wheel,
    steady_sinkage,
    stress_integral,
    wheel_forces,
    wheel_on_soil,
)

WHEEL = Wheel(radius=0.06, width=0.05, grouser_height=0.005, grouser_engagement=0.0)
SAND = Soil(
    cohesive_modulus=0.0,
    frictional_modulus=7.0e6,
    exponent=1.4,
    cohesion=0.0,
    friction_angle=27.0,
    shear_modulus=0.012,
    slip_weakening=2.2,
    side_weakening=1.8,
    slip_saturation=0.55,
    ploughing=3.4e5,
    front_ploughing=4.0,
    ploughing_decay=1.2,
    shear_release=1.8,
    rear_contact=0.26,
    excavation=0.3,
    grouser_thrust=0.5,
)
SYSTEM = wheel_on_soil(WHEEL, SAND)
LOAD = 20.0
ANGLES = (0.0, 30.0, 60.0, 75.0, 90.0)
RIMS = (0.0, 0.02, 0.3, 1.0, 2.0, 9.0)


def motion(degrees: float) -> tuple[float, float]:
    return max(math.cos(math.radians(degrees)), 0.0), math.sin(math.radians(degrees))


def test_every_term_is_absent_from_the_default_soil():
    plain = wheel_on_soil(WHEEL, Soil())
    for name in ("slip_saturation", "ploughing_decay", "front_ploughing"):
        changed = wheel_on_soil(WHEEL, dataclasses.replace(Soil(), **{name: 3.0}))
        for slip in (-1.0, -0.3, 0.0, 0.6, 1.0):
            assert stress_integral(changed, 0.2, slip) == stress_integral(plain, 0.2, slip)


def test_the_wheel_sinks_with_slip_with_skid_and_askew():
    def sinkage(degrees: float, rim: float) -> float:
        return float(steady_sinkage(SYSTEM, LOAD, *motion(degrees), rim))

    rolling = sinkage(0.0, 1.0)
    assert 0.1 < rolling / WHEEL.radius < 0.3
    assert sinkage(0.0, 2.0) > 1.2 * rolling
    assert sinkage(0.0, 9.0) > sinkage(0.0, 2.0)
    assert sinkage(0.0, 0.0) > 2.5 * rolling
    askew = [sinkage(degrees, 1.0) for degrees in (0.0, 30.0, 60.0, 75.0)]
    assert np.all(np.diff(askew) > 0.0)
    assert askew[-1] > 0.5 * WHEEL.radius


def test_a_smooth_wheel_excavates_nothing():
    smooth = wheel_on_soil(dataclasses.replace(WHEEL, grouser_height=0.0), SAND)
    deeper = [
        steady_sinkage(system, LOAD, 1.0, 0.0, 9.0) - steady_sinkage(system, LOAD, 1.0, 0.0, 2.0)
        for system in (SYSTEM, smooth)
    ]
    assert deeper[0] > deeper[1] + 0.8 * 7.0 * SYSTEM.excavation


@pytest.mark.parametrize("degrees", ANGLES)
def test_forces_dissipate_in_every_motion(degrees: float):
    """The drive's power and the towing power are never less than zero together."""
    forward, side = motion(degrees)
    for rim in RIMS:
        for sinkage in (0.005, 0.02, 0.05, 0.08):
            pull, across, _, torque = wheel_forces(SYSTEM, sinkage, forward, side, rim)
            power = torque * rim / SYSTEM.shear_radius - pull * forward + across * side
            assert power >= 0.0


@pytest.mark.parametrize("degrees", ANGLES)
def test_a_steady_sinkage_carries_its_load(degrees: float):
    for rim in RIMS:
        sinkage = steady_sinkage(SYSTEM, LOAD, *motion(degrees), rim)
        load = wheel_forces(SYSTEM, sinkage, *motion(degrees), rim)[2]
        assert load == pytest.approx(LOAD, rel=1e-6)


def test_a_load_that_buries_the_wheel_has_no_sinkage():
    assert math.isnan(steady_sinkage(SYSTEM, 1.0e5, 1.0, 0.0, 1.0))


@pytest.mark.parametrize("degrees", ANGLES)
def test_forces_are_continuous_from_rolling_to_locked(degrees: float):
    forward, side = motion(degrees)
    rims = np.linspace(0.0, 1.5, 3001)
    forces = np.array([wheel_forces(SYSTEM, 0.03, forward, side, rim) for rim in rims])
    steps = np.abs(np.diff(forces, axis=0)).max(axis=0)
    assert np.all(steps < 0.01 * np.ptp(forces, axis=0).max())
    near = wheel_forces(SYSTEM, 0.03, forward, side, LOCKED * (1.0 + 1e-9))
    at = wheel_forces(SYSTEM, 0.03, forward, side, LOCKED * (1.0 - 1e-9))
    np.testing.assert_allclose(near, at, rtol=1e-6, atol=1e-8)


def test_forces_do_not_depend_on_the_unit_of_speed_and_mirror_with_the_side():
    found = wheel_forces(SYSTEM, 0.03, 0.4, 0.7, 1.3)
    np.testing.assert_allclose(wheel_forces(SYSTEM, 0.03, 4.0, 7.0, 13.0), found, rtol=1e-12)
    mirrored = wheel_forces(SYSTEM, 0.03, 0.4, -0.7, 1.3)
    assert mirrored == (found[0], -found[1], found[2], found[3])


def test_a_wheel_pushed_sideways_feels_the_pressure_on_its_side():
    """Closed form: the first moment of the buried segment times N, without decay."""
    soil = Soil(frictional_modulus=1e-3, cohesive_modulus=0.0, cohesion=0.0, friction_angle=1e-3)
    soil = dataclasses.replace(soil, ploughing=2.0e5, ploughing_decay=0.0, front_ploughing=0.0)
    r = WHEEL.radius

    def depth_times_chord(below: float, surface: float) -> float:
        return (below - surface) * 2.0 * math.sqrt(max(r * r - below * below, 0.0))

    for sinkage in (0.01, 0.05, 0.09):
        moment, _ = quad(depth_times_chord, r - sinkage, r, args=(r - sinkage,))
        across = wheel_forces(wheel_on_soil(WHEEL, soil), sinkage, 0.0, 1.0, 0.0)[1]
        assert across == pytest.approx(soil.ploughing * moment, rel=0.01)


def test_grousers_of_a_wheel_that_spins_in_place_push_soil_back():
    """Closed form: the stress g_f (h/b) N d over the buried rim, without any other."""
    soil = Soil(frictional_modulus=1e-3, cohesive_modulus=0.0, cohesion=0.0, friction_angle=1e-3)
    soil = dataclasses.replace(soil, ploughing=2.0e5, front_ploughing=0.0, grouser_thrust=0.7)
    r, b, h = WHEEL.radius, WHEEL.width, WHEEL.grouser_height
    for sinkage in (0.01, 0.03, 0.05):
        entry = math.acos(1.0 - sinkage / r)

        def depth(theta: float, along_x: bool, sinkage: float = sinkage) -> float:
            below = r * (math.cos(theta) - 1.0) + sinkage
            return below * (math.cos(theta) if along_x else 1.0)

        stress = 0.7 * h / b * 2.0e5
        pull, across, _, torque = wheel_forces(wheel_on_soil(WHEEL, soil), sinkage, 0.0, 0.0, 1.0)
        expected = b * r * stress * quad(depth, 0.0, entry, args=(True,))[0]
        assert pull == pytest.approx(expected, rel=1e-3)
        assert torque == pytest.approx(
            b * r * r * stress * quad(depth, 0.0, entry, args=(False,))[0], rel=1e-3
        )
        assert across == 0.0
        smooth = wheel_on_soil(dataclasses.replace(WHEEL, grouser_height=0.0), soil)
        assert wheel_forces(smooth, sinkage, 0.0, 0.0, 1.0)[0] < 1e-3 * expected


def test_only_a_skid_releases_the_soil_in_front():
    released = wheel_on_soil(WHEEL, dataclasses.replace(SAND, shear_release=3.6))
    for forward, side, rim, differs in (
        (1.0, 0.0, 1.0, False),
        (1.0, 0.0, 3.0, False),
        (1.0, 0.0, 0.6, True),
        (0.8, 0.6, 3.0, True),
    ):
        found = [wheel_forces(one, 0.03, forward, side, rim) for one in (SYSTEM, released)]
        assert (found[0] != found[1]) is differs


def test_a_locked_wheel_is_pushed_back_more_than_it_is_loaded():
    sinkage = steady_sinkage(SYSTEM, LOAD, 1.0, 0.0, 0.0)
    pull, across, _, torque = wheel_forces(SYSTEM, sinkage, 1.0, 0.0, 0.0)
    assert pull < -1.5 * LOAD
    assert across == 0.0
    assert torque < 0.0


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"slip_weakening": -0.1}, "slip_weakening = -0.1"),
        ({"slip_saturation": 0.0}, "slip_saturation = 0.0"),
        ({"rear_contact": 1.5}, "rear_contact = 1.5"),
        ({"ploughing": math.nan}, "ploughing = nan"),
    ],
)
def test_impossible_soils_are_refused(change: dict[str, float], named: str):
    with pytest.raises(ValueError, match=named):
        Soil(**change)
