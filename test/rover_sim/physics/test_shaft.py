import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rover_sim.physics.mechanisms import shaft
from rover_sim.physics.mechanisms.motor import (
    MotorParameters,
    limited_torque,
    make_motor,
    rate_servo,
)
from rover_sim.physics.mechanisms.shaft import (
    FrictionParameters,
    ShaftMotion,
    advance_shaft,
    make_friction,
)

TORQUES = st.floats(-5.0, 5.0)


def step(
    inertia: float,
    rate: float,
    drive: float,
    dry: float,
    viscous: float = 0.0,
    h: float = 1e-3,
) -> ShaftMotion:
    """One inertia under a drive with Coulomb friction."""
    motion: ShaftMotion = advance_shaft(
        inertia, rate, drive - dry, drive + dry, drive - dry, drive + dry, viscous, h
    )
    return motion


def test_coulomb_friction_stops_a_shaft_after_the_time_and_angle_of_the_closed_form() -> None:
    inertia, rate, dry, h = 2e-3, 3.0, 0.5, 1e-3
    angle, time = 0.0, 0.0
    while rate != 0.0:
        motion = step(inertia, rate, 0.0, dry, h=h)
        angle += motion.first + motion.second
        time += motion.first_time
        rate = motion.rate
    assert time == pytest.approx(inertia * 3.0 / dry, rel=1e-12)
    assert angle == pytest.approx(inertia * 9.0 / (2.0 * dry), rel=1e-12)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_stuck_shaft_stays_exactly_still_up_to_its_breakaway_torque(sign: float) -> None:
    drive = sign * 0.5
    assert step(1e-3, 0.0, drive, 0.5) == (0.0, 0.0, 0.0, 0.0, 0.0)
    moved = step(1e-3, 0.0, drive * 1.000001, 0.5)
    assert moved.rate * sign > 0.0
    assert moved.rate == pytest.approx(sign * 0.5e-6, rel=1e-6)


def test_a_reversing_shaft_passes_through_rest_within_the_step() -> None:
    inertia, rate, drive, dry, h = 1e-3, 0.2, -1.0, 0.4, 1e-3
    motion = step(inertia, rate, drive, dry, h=h)
    stopping = inertia * rate / 1.4
    assert motion.first_time == pytest.approx(stopping, rel=1e-12)
    assert motion.first == pytest.approx(rate * stopping / 2.0, rel=1e-12)
    assert motion.rate == pytest.approx(-0.6 / inertia * (h - stopping), rel=1e-12)
    assert motion.second == pytest.approx(-0.3 / inertia * (h - stopping) ** 2, rel=1e-12)


def test_coast_down_by_dry_and_viscous_friction() -> None:
    inertia, dry, viscous, rate = 1e-3, 5e-3, 2e-4, 100.0
    h, steps = 1e-3, 2000
    for _ in range(steps):
        rate = step(inertia, rate, 0.0, dry, viscous, h).rate
    exact = (100.0 + dry / viscous) * math.exp(-viscous * steps * h / inertia) - dry / viscous
    assert rate == pytest.approx(exact, rel=1e-6)


def test_stribecks_curve_falls_from_breakaway_to_coulomb() -> None:
    friction = make_friction(FrictionParameters(5e-3, 7e-3, 5.0, 0.0))
    assert shaft.sliding_torque(friction, 0.0) == pytest.approx(7e-3)
    assert shaft.sliding_torque(friction, -5.0) == pytest.approx(5e-3 + 2e-3 * math.exp(-1.0))
    assert shaft.sliding_torque(friction, 50.0) == pytest.approx(5e-3)


@settings(max_examples=300, deadline=None)
@given(
    inertia=st.floats(1e-4, 1.0),
    rate=st.floats(-100.0, 100.0),
    drive=TORQUES,
    dry=st.floats(0.0, 2.0),
    viscous=st.floats(0.0, 0.1),
    h=st.floats(1e-6, 1e-2),
)
def test_work_and_kinetic_energy_agree_to_rounding(
    inertia: float, rate: float, drive: float, dry: float, viscous: float, h: float
) -> None:
    motion = step(inertia, rate, drive, dry, viscous, h)
    change = 0.5 * inertia * (motion.rate**2 - rate**2)
    drive_work = drive * (motion.first + motion.second)
    heat = shaft.dry_heat(motion, dry, dry) + shaft.viscous_heat(motion, viscous)
    scale = 0.5 * inertia * (motion.rate**2 + rate**2) + abs(drive_work) + heat
    assert heat >= 0.0
    assert change == pytest.approx(drive_work - heat, abs=1e-12 * scale + 1e-300)


@settings(max_examples=100, deadline=None)
@given(
    rates=st.tuples(*[st.floats(-50.0, 50.0)] * 2),
    bases=st.tuples(*[st.floats(-5.0, 5.0)] * 2),
    angle=st.floats(-1.0, 1.0),
)
def test_the_base_motion_work_closes_a_rotors_energy_balance(
    rates: tuple[float, float], bases: tuple[float, float], angle: float
) -> None:
    inertia, h = 1e-3, 1e-3
    work = shaft.base_motion_work(inertia, *rates, angle, *bases, h)
    absolute = 0.5 * inertia * ((rates[1] + bases[1]) ** 2 - (rates[0] + bases[0]) ** 2)
    relative = 0.5 * inertia * (rates[1] ** 2 - rates[0] ** 2)
    inertial = -inertia * (bases[1] - bases[0]) / h * angle
    assert absolute == pytest.approx(relative - inertial + work, abs=1e-12)


def test_gears_hold_between_driving_and_being_driven() -> None:
    assert shaft.geared_torques(2.0, 0.8, 0.5) == (1.6, 4.0)
    assert shaft.geared_torques(-2.0, 0.8, 0.5) == (-4.0, -1.6)


MOTOR = MotorParameters(0.2, 0.6, 600.0, 0.04, 40.0)


@pytest.mark.parametrize(
    ("requested", "rate", "limit", "given"),
    [
        (0.1, 0.0, math.inf, 0.1),
        (0.5, 0.0, math.inf, 0.2),
        (-0.5, 0.0, math.inf, -0.2),
        (0.5, 0.0, 0.05, 0.05),
        (0.5, 500.0, math.inf, 0.1),  # the back-EMF leaves 0.6 (1 - 5/6)
        (0.5, 700.0, math.inf, 0.0),
        (-0.5, 700.0, math.inf, -0.2),  # braking is not limited by the voltage
        (math.nan, 0.0, math.inf, 0.0),
        (math.inf, 0.0, math.inf, 0.2),
        (0.1, 0.0, -1.0, 0.0),
    ],
)
def test_motor_torque_is_limited_by_current_and_voltage(
    requested: float, rate: float, limit: float, given: float
) -> None:
    assert limited_torque(make_motor(MOTOR), requested, rate, limit) == pytest.approx(given)


def test_the_rate_servo_settles_without_windup_against_a_load() -> None:
    motor, inertia, h = make_motor(MOTOR), 1e-4, 1e-3
    rate, integral, peak = 0.0, 0.0, 0.0
    for _ in range(1000):
        torque, integral = rate_servo(motor, inertia, 300.0, rate, 0.0, math.inf, integral, h)
        rate += (torque - 0.05) / inertia * h
        peak = max(peak, rate)
    assert rate == pytest.approx(300.0, abs=0.1)
    assert peak < 300.0 * 1.15


@pytest.mark.parametrize("field", ["max_torque", "no_load_rate", "servo_bandwidth"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_bad_motor_values_are_refused_by_name(field: str, value: float) -> None:
    good = {"max_torque": 1.0, "stall_torque": 1.0, "no_load_rate": 1.0, "torque_constant": 1.0}
    with pytest.raises(ValueError, match=field):
        MotorParameters(**{**good, "servo_bandwidth": 1.0, field: value})


def test_a_breakaway_torque_below_the_sliding_one_is_refused() -> None:
    with pytest.raises(ValueError, match="breakaway"):
        FrictionParameters(0.2, 0.1, 1.0, 0.0)
