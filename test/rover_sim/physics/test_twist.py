"""Twist of the tether against closed forms, its power, and the swivel's energy balance."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rover_sim.physics.tether import twist
from rover_sim.physics.tether.tether import to_rows

DOWN = np.array([0.0, 0.0, -1.0])


def smallest(start: np.ndarray, end: np.ndarray) -> Rotation:
    """The smallest rotation from one unit vector to another."""
    axis = np.cross(start, end)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-15:
        return Rotation.identity()
    return Rotation.from_rotvec(axis / sine * math.atan2(sine, float(start @ end)))


def tilted(angle: float, heading: float) -> np.ndarray:
    """Unit vector at an angle from straight down."""
    return np.array(
        [
            math.sin(angle) * math.cos(heading),
            math.sin(angle) * math.sin(heading),
            -math.cos(angle),
        ]
    )


def angle_of(slopes: np.ndarray, attitude: Rotation, before: float = 0.0) -> float:
    """Twist of a tether whose fairlead and nodes have these slopes."""
    nodes = np.zeros((len(slopes) - 1, 2, 3))
    nodes[:, 1] = slopes[1:]
    x, y, z, w = attitude.as_quat()
    q = to_rows(nodes)
    return float(twist.twist_angle(len(nodes) - 1, tuple(slopes[0]), q, (w, x, y, z), before))


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.2, 2.8])
@pytest.mark.parametrize("spin", [-2.0, 0.0, 0.4, 3.0])
def test_straight_tether_gives_the_swing_twist_angle(angle: float, spin: float):
    t = tilted(angle, 0.7)
    slopes = np.broadcast_to(1.01 * t, (7, 3))
    attitude = Rotation.from_rotvec(spin * t) * smallest(DOWN, t)
    assert angle_of(slopes, attitude) == pytest.approx(spin, abs=1e-12)


@pytest.mark.parametrize("tilt", [(0.0, 0.0, 0.0), (0.2, -0.3, 0.0)])
def test_the_rovers_tilt_against_the_tether_is_no_twist(tilt: tuple[float, float, float]):
    t = tilted(0.5, -1.0)
    body_axis = Rotation.from_rotvec(tilt).apply(t)
    attitude = smallest(t, body_axis) * Rotation.from_rotvec(0.6 * t) * smallest(DOWN, t)
    assert angle_of(np.broadcast_to(t, (4, 3)), attitude) == pytest.approx(0.6, abs=1e-12)


def test_bending_in_a_plane_gives_no_twist():
    # Down, then bent round to level, then up a little: all in one vertical plane.
    angles = np.linspace(0.0, 2.2, 12)
    slopes = np.array([tilted(a, 0.9) for a in angles])
    attitude = smallest(DOWN, slopes[0])
    for one, other in itertools.pairwise(slopes):
        attitude = smallest(one, other) * attitude
    assert angle_of(slopes, attitude) == pytest.approx(0.0, abs=1e-12)


def test_coning_on_a_straight_tether_does_not_drift():
    angle, turns, steps = 0.25, 3, 3000
    twisted, integral = 0.0, 0.0
    heading = np.linspace(0.0, 2.0 * math.pi * turns, turns * steps + 1)
    last = smallest(DOWN, tilted(angle, 0.0))
    for k in range(1, heading.size):
        t = tilted(angle, heading[k])
        attitude = smallest(DOWN, t)
        twisted = angle_of(np.broadcast_to(t, (3, 3)), attitude, twisted)
        assert abs(twisted) < 1e-12
        middle = tilted(angle, 0.5 * (heading[k - 1] + heading[k]))
        integral += float((attitude * last.inv()).as_rotvec() @ middle)
        last = attitude
    # The integral of w.t drifts by the solid angle of the cone each time round.
    assert abs(integral) == pytest.approx(turns * 2.0 * math.pi * (1.0 - math.cos(angle)), rel=1e-4)


def test_the_angle_counts_full_turns():
    t = tilted(0.4, 2.0)
    slopes = np.broadcast_to(t, (5, 3))
    angle = 0.0
    for spin in np.arange(0.0, 40.0, 0.5):
        angle = angle_of(slopes, Rotation.from_rotvec(spin * t) * smallest(DOWN, t), angle)
        assert angle == pytest.approx(spin, abs=1e-11)


unit_vectors = (
    st.tuples(*[st.floats(-1.0, 1.0)] * 3)
    .map(np.array)
    .filter(lambda v: np.linalg.norm(v) > 0.1)
    .map(lambda v: v / np.linalg.norm(v))
)


@settings(deadline=None, max_examples=60)
@given(
    start=unit_vectors, bend=unit_vectors, tilt=st.floats(0.0, 2.0), spin=st.floats(-3.0, 3.0),
    turn=unit_vectors,
)  # fmt: skip
def test_the_twist_changes_at_the_rate_about_the_twist_axis(
    start: np.ndarray, bend: np.ndarray, tilt: float, spin: float, turn: np.ndarray
):
    if 1.0 + start @ DOWN < 0.1 or 1.0 + start @ bend < 0.1:
        return
    slopes = np.array([start, start + bend, bend])
    slopes /= np.linalg.norm(slopes, axis=1)[:, None]
    attitude = Rotation.from_rotvec(spin * bend) * smallest(DOWN, bend)
    attitude = Rotation.from_rotvec(tilt * np.array([1.0, 0.0, 0.0])) * attitude
    if 1.0 - attitude.as_matrix()[:, 2] @ bend < 0.1:
        return
    nodes = np.zeros((2, 2, 3))
    nodes[:, 1] = slopes[1:]
    x, y, z, w = attitude.as_quat()
    axis = np.array(twist.twist_axis(1, to_rows(nodes), (w, x, y, z)))
    before = angle_of(slopes, attitude)
    step = 1e-6
    after = angle_of(slopes, Rotation.from_rotvec(step * turn) * attitude, before)
    back = angle_of(slopes, Rotation.from_rotvec(-step * turn) * attitude, before)
    assert (after - back) / (2.0 * step) == pytest.approx(float(turn @ axis), abs=1e-6)


def test_a_folded_tether_keeps_its_last_angle():
    t = tilted(0.3, 0.0)
    slopes = np.array([t, t, -t, -t])
    assert angle_of(slopes, Rotation.identity(), 1.25) == 1.25
    upside_down = Rotation.from_rotvec([math.pi, 0.0, 0.0])
    assert angle_of(np.broadcast_to(DOWN, (3, 3)), upside_down, -0.5) == -0.5


@settings(deadline=None, max_examples=100)
@given(
    slopes=st.lists(
        st.tuples(
            *[
                st.one_of(
                    st.floats(-2.0, 2.0),
                    st.sampled_from([0.0, 1.0, -1.0, math.nan, math.inf, 1e300, 1e-300]),
                )
            ]
            * 3
        ),
        min_size=3, max_size=8,
    ),
    attitude=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    before=st.floats(-100.0, 100.0),
)  # fmt: skip
def test_any_slopes_give_an_angle_within_half_a_turn_of_the_last(
    slopes: list[tuple[float, float, float]], attitude: tuple[float, float, float], before: float
):
    angle = angle_of(np.array(slopes), Rotation.from_rotvec(attitude), before)
    assert abs(angle - before) <= math.pi + 1e-12


@settings(deadline=None, max_examples=25)
@given(
    path=st.lists(st.floats(-20.0, 20.0), min_size=1, max_size=20),
    stiffness=st.floats(1e-6, 1e-2), friction=st.sampled_from([0.0, 1e-5, 1e-3, math.inf]),
)  # fmt: skip
@pytest.mark.slow
def test_the_swivel_creates_no_energy_and_reports_its_heat(
    path: list[float], stiffness: float, friction: float
):
    angle, slip, work, heat, steps = 0.0, 0.0, 0.0, 0.0, 400
    for goal in path:
        for k in range(1, steps + 1):
            turned = angle + (goal - angle) * k / steps
            last = angle + (goal - angle) * (k - 1) / steps
            before = twist.twist_energy(stiffness, last, slip)
            first, _, _ = twist.swivel_torque(stiffness, friction, last, slip)
            torque, slip, hot = twist.swivel_torque(stiffness, friction, turned, slip)
            assert abs(torque) <= friction
            assert hot >= 0.0
            work -= 0.5 * (first + torque) * (turned - last)
            heat += hot
            # slip turns elastic energy into heat, up to second order in the step
            stored = twist.twist_energy(stiffness, turned, slip)
            largest = stiffness * (turned - last) ** 2
            mean = -0.5 * (first + torque) * (turned - last)
            assert abs(stored - before + hot - mean) <= largest + 1e-18
        angle = goal
    stored = twist.twist_energy(stiffness, angle, slip)
    assert work == pytest.approx(stored + heat, abs=stiffness * 40.0**2 / steps * len(path))


def test_free_swivels_carry_nothing_and_clamped_ones_never_slip():
    assert twist.swivel_torque(1e-4, 0.0, 3.0, 0.0) == (0.0, 3.0, 0.0)
    torque, slip, heat = twist.swivel_torque(1e-4, math.inf, 3.0, 0.0)
    assert torque == pytest.approx(-3e-4)
    assert (slip, heat) == (0.0, 0.0)
    torque, slip, heat = twist.swivel_torque(1e-4, 1e-4, -3.0, 0.0)
    assert torque == pytest.approx(1e-4)
    assert slip == pytest.approx(-2.0)
    assert heat == pytest.approx(2e-4)
