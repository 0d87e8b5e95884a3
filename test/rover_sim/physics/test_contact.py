import dataclasses
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from rover_sim.physics.ground import contact
from rover_sim.physics.ground.contact import REGOLITH, ROCK, ContactParameters
from rover_sim.physics.numerics.vectors import Matrix, Vector

UP = (0.0, 0.0, 1.0)
NO_BRISTLE = (0.0, 0.0, 0.0)


def unit(x: float, y: float, z: float) -> tuple[float, float, float]:
    length = math.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


class PointOnPlane:
    """A point mass on an inclined plane by the implicit midpoint rule, gravity and contact only.

    Axes: the plane falls towards +x and goes through the origin.
    """

    def __init__(
        self,
        parameters: ContactParameters,
        slope: float = 0.0,
        gravity: float = 9.81,
        h: float = 1e-3,
    ) -> None:
        self.law = parameters.law()
        self.mass, self.h = 10.0, h
        self.normal = (math.sin(slope), 0.0, math.cos(slope))
        self.weight = self.mass * gravity * np.array([0.0, 0.0, -1.0])
        depth = static_depth(self.law, self.mass * gravity * math.cos(slope))
        self.x = -depth * np.array(self.normal)
        self.v = np.zeros(3)
        self.bristle = NO_BRISTLE
        self.dissipated = 0.0

    def depth(self, x: np.ndarray) -> float:
        return -float(x @ np.array(self.normal))

    def energy(self) -> float:
        stored = contact.contact_energy(self.law, self.depth(self.x), self.bristle)
        return float(0.5 * self.mass * self.v @ self.v - self.weight @ self.x + stored)

    def step(self, push: Vector = (0.0, 0.0, 0.0)) -> np.ndarray:
        h, inertia = self.h, 2.0 * self.mass / self.h
        depth0 = self.depth(self.x)
        travel = self.v * h
        for _ in range(50):
            depth1 = self.depth(self.x + travel)
            arguments = (self.law, depth0, depth1, self.normal, tuple(travel), h, self.bristle)
            force, tangent = contact.contact_force(*arguments)
            residual = inertia * (travel / h - self.v) - np.array(force) - self.weight - push
            if np.max(np.abs(residual)) < 1e-9 * (1.0 + np.max(np.abs(self.weight))):
                break
            matrix = inertia / h * np.eye(3) - np.array(tangent).reshape(3, 3)
            travel = travel - np.linalg.solve(matrix, residual)
        else:
            raise AssertionError(f"Newton stands at {residual}")
        stored = contact.contact_energy(self.law, depth0, self.bristle)
        self.bristle = contact.advance_bristle(*arguments)
        lost = stored - contact.contact_energy(self.law, depth1, self.bristle) - force @ travel
        assert lost > -1e-12
        self.dissipated += lost
        self.x = self.x + travel
        self.v = 2.0 * travel / h - self.v
        return np.array(force)


def static_depth(law: contact.ContactLaw, load: float) -> float:
    """Depth [m] at which a point at rest carries the load [N]: (N/k)^(2/3)."""
    return float((load / law.stiffness) ** (2.0 / 3.0))


# ------------------------------------------------------------------------- normal force


@pytest.mark.parametrize("parameters", [ROCK, REGOLITH])
def test_a_point_at_rest_sinks_until_it_carries_the_weight(parameters: ContactParameters):
    law = parameters.law()
    depth = static_depth(law, 16.2)
    assert depth == pytest.approx((16.2 / parameters.stiffness) ** (2 / 3), rel=1e-12)
    assert contact.normal_force(law, depth, depth, 1e-3)[0] == pytest.approx(16.2, rel=1e-12)


def test_short_steps_give_hunt_and_crossleys_force():
    law = ROCK.law()
    depth, rate, h = 2e-3, 0.4, 1e-9
    force, _ = contact.normal_force(law, depth, depth + rate * h, h)
    assert force == pytest.approx(
        ROCK.stiffness * depth**1.5 * (1 + 1.5 * ROCK.damping * rate), rel=1e-6
    )


@pytest.mark.parametrize(
    ("depth0", "depth1"), [(1e-3, 3e-3), (3e-3, 1e-3), (-2e-3, 1e-3), (1e-3, -2e-3), (0.0, 1e-3)]
)
def test_the_work_of_an_undamped_step_is_the_change_of_the_stored_energy(
    depth0: float, depth1: float
):
    law = dataclasses.replace(ROCK, damping=0.0).law()
    force, _ = contact.normal_force(law, depth0, depth1, 1e-3)
    change = contact.contact_energy(law, depth1, NO_BRISTLE) - contact.contact_energy(
        law, depth0, NO_BRISTLE
    )
    assert force * (depth1 - depth0) == pytest.approx(change, rel=1e-13)


@settings(deadline=None)
@given(
    depth0=st.floats(-5e-3, 2e-2),
    depth1=st.floats(-5e-3, 2e-2),
    damping=st.sampled_from([0.0, 0.5]),
)
def test_the_normal_force_is_continuously_differentiable(
    depth0: float, depth1: float, damping: float
):
    law = dataclasses.replace(ROCK, damping=damping).law()
    h, step = 5e-3, 1e-7
    force, tangent = contact.normal_force(law, depth0, depth1, h)
    ahead = contact.normal_force(law, depth0, depth1 + step, h)[0]
    behind = contact.normal_force(law, depth0, depth1 - step, h)[0]
    assert force >= 0.0
    # the second derivative is bounded by about 1/sqrt(depth), which the tolerance allows for
    slope = (ahead - behind) / (2 * step)
    assert tangent == pytest.approx(slope, rel=2e-4, abs=6e-4 * law.stiffness)


@pytest.mark.parametrize("depth0", [-1e-3, 1e-3])
def test_force_and_tangent_do_not_jump_at_touchdown_and_lift_off(depth0: float):
    law = ROCK.law()
    below = contact.normal_force(law, depth0, -1e-13, 1e-3)
    above = contact.normal_force(law, depth0, 1e-13, 1e-3)
    np.testing.assert_allclose(below, above, rtol=1e-4, atol=1e-4)


def test_the_ground_never_pulls():
    law = dataclasses.replace(ROCK, damping=5.0).law()
    for rate in np.linspace(-5.0, 0.0, 101):
        force, _ = contact.normal_force(law, 1e-2, 1e-2 + rate * 1e-3, 1e-3)
        factor, _ = contact.damping_factor(5.0, rate)
        assert force >= 0.0
        assert 0.0 <= factor <= 1.0


@pytest.mark.parametrize("speed", [0.05, 0.3, 1.0, 2.0])
def test_restitution_obeys_the_relation_of_speeds(speed: float):
    parameters = dataclasses.replace(ROCK, damping=0.5)  # not where the law is smoothed
    law = parameters.law()
    body = PointOnPlane(parameters, gravity=0.0, h=1e-4)
    body.v[2] = -speed
    body.x[2] = 1e-3
    start = body.energy()
    while not (body.v[2] > 0.0 and body.x[2] > 0.0):
        body.step()
    assert body.v[2] / speed == pytest.approx(contact.restitution(law, speed), rel=2e-4)
    assert start - body.energy() == pytest.approx(body.dissipated, abs=1e-9)
    # the relation against the differential equation itself
    b = 1.5 * parameters.damping
    leaving = contact.restitution(law, speed) * speed
    assert b * speed - math.log1p(b * speed) == pytest.approx(
        -b * leaving - math.log1p(-b * leaving), rel=1e-9
    )
    answer = solve_ivp(
        lambda _, y: [y[1], -1e4 * max(y[0], 0.0) ** 1.5 * (1 + b * y[1])],
        (0.0, 1.0),
        [0.0, speed],
        events=_leaves,
        rtol=1e-10,
        atol=1e-12,
    )
    assert -answer.y[1, -1] == pytest.approx(leaving, rel=1e-5)


def _leaves(_: float, y: np.ndarray) -> float:
    return float(y[0])


_leaves.terminal = True  # type: ignore[attr-defined]
_leaves.direction = -1.0  # type: ignore[attr-defined]


def test_slow_impacts_lose_c_times_v():
    law = dataclasses.replace(ROCK, damping=0.5).law()
    for speed in (1e-3, 1e-2):
        assert 1 - contact.restitution(law, speed) == pytest.approx(0.5 * speed, rel=0.02)
    elastic = dataclasses.replace(ROCK, damping=0.0).law()
    assert contact.restitution(elastic, 1.0) == 1.0


def test_an_undamped_ball_bounces_back_to_its_height():
    body = PointOnPlane(dataclasses.replace(ROCK, damping=0.0), gravity=1.62)
    body.x[2] = 0.3
    start = body.energy()
    highest = []
    for _ in range(12000):
        rising = body.v[2] > 0.0
        body.step()
        if rising and body.v[2] <= 0.0:
            highest.append(body.x[2])
    assert len(highest) >= 8
    assert body.energy() == pytest.approx(start, rel=1e-9)
    np.testing.assert_allclose(highest, 0.3, rtol=1e-5)


# ----------------------------------------------------------------------------- friction

NORMALS = [UP, unit(0.3, -0.2, 0.9), unit(-1.0, 0.1, 0.05)]
BRISTLES = [(0.0, 0.0, 0.0), (2e-5, -1e-5, 3e-6), (9.4e-5, 2e-5, 0.0), (3e-4, 1e-4, -2e-4)]
TRAVELS = [(1e-9, 2e-9, 1e-9), (2e-6, 1e-6, -3e-6), (1e-4, -2e-4, 1e-5), (2e-3, 1e-3, -1e-3)]


@pytest.mark.parametrize("normal", NORMALS)
@pytest.mark.parametrize("anchor", [0.0, 1e5])
def test_the_tangent_is_the_derivative_of_the_force(normal: Vector, anchor: float):
    law = dataclasses.replace(ROCK, anchor_stiffness=anchor).law()
    h = 1e-3
    for bristle, travel, depth0 in itertools.product(BRISTLES, TRAVELS, (-1e-4, 2e-3)):

        def at(
            moved: np.ndarray, bristle: Vector = bristle, depth0: float = depth0
        ) -> tuple[Vector, Matrix]:
            depth1 = depth0 - float(np.dot(normal, moved)) + 1e-3
            answer: tuple[Vector, Matrix] = contact.contact_force(
                law, depth0, depth1, normal, tuple(moved), h, bristle
            )
            return answer

        middle = np.array(travel)
        _, tangent = at(middle)
        step = 1e-9
        numeric = np.column_stack(
            [
                (np.array(at(middle + d)[0]) - np.array(at(middle - d)[0])) / (2 * step)
                for d in step * np.eye(3)
            ]
        )
        scale = np.max(np.abs(numeric))
        np.testing.assert_allclose(np.reshape(tangent, (3, 3)), numeric, atol=2e-5 * scale)


@settings(deadline=None)
@given(
    share=st.floats(0.0, 1.0),
    turn=st.floats(0.0, 2 * math.pi),
    slip=st.floats(0.0, 2e-2),
    limit=st.floats(0.1, 20.0),
)
def test_friction_never_exceeds_its_limit_and_slides_at_it(
    share: float, turn: float, slip: float, limit: float
):
    size = share * limit / 1e5
    bristle = (size * math.cos(turn), size * math.sin(turn), 0.0)
    force, _, _ = contact.friction_force(limit, 1e5, 2e-3, UP, (slip, 0.0, 0.0), 1e-3, bristle)
    assert np.linalg.norm(force) <= limit * (1 + 1e-12)
    if slip > 5e-3:
        assert force[0] == pytest.approx(-limit, rel=0.01)


def test_without_anchor_it_is_regularised_coulomb_friction():
    force, _, _ = contact.friction_force(5.0, 0.0, 2e-3, UP, (3e-6, 4e-6, 0.0), 1e-3, NO_BRISTLE)
    speed = 5e-3
    size = 5.0 * speed / math.hypot(speed, 2e-3)
    np.testing.assert_allclose(force, (-0.6 * size, -0.8 * size, 0.0), rtol=1e-12, atol=1e-15)


def test_the_coefficient_falls_from_static_to_kinetic():
    law = ROCK.law()
    assert contact.friction_coefficient(law, 0.0)[0] == pytest.approx(0.6)
    assert contact.friction_coefficient(law, 0.05**2)[0] == pytest.approx(0.55)
    assert contact.friction_coefficient(law, 25.0)[0] == pytest.approx(0.5, abs=1e-4)


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_no_closed_cycle_of_motion_and_load_gains_energy(data: st.DataObject):
    """Random travel and load, then back to the start: the work done is never negative."""
    law = ROCK.law()
    h = 1e-3
    moves = data.draw(
        st.lists(
            st.tuples(*[st.floats(-2e-4, 2e-4)] * 2, st.floats(-1e-3, 1e-3)),
            min_size=1,
            max_size=25,
        )
    )
    travels = [np.array(move) for move in moves]
    travels.append(-np.sum(travels, axis=0))
    depth, bristle, work = 1e-3, NO_BRISTLE, 0.0
    stored = contact.contact_energy(law, depth, bristle)
    for travel in travels:
        depth1 = depth - travel[2]
        arguments = (law, depth, depth1, UP, tuple(travel), h, bristle)
        force, _ = contact.contact_force(*arguments)
        bristle = contact.advance_bristle(*arguments)
        done = -float(np.dot(force, travel))
        before, stored = stored, contact.contact_energy(law, depth1, bristle)
        assert done - (stored - before) >= -1e-12  # every single step dissipates
        work += done
        depth = depth1
    assert depth == pytest.approx(1e-3, abs=1e-12)
    assert work >= stored - contact.contact_energy(law, 1e-3, NO_BRISTLE) - 1e-12


# ----------------------------------------------------------------- a body on a slope


@pytest.mark.parametrize(("parameters", "gravity"), [(ROCK, 1.62), (ROCK, 9.81), (REGOLITH, 9.81)])
@pytest.mark.slow
def test_a_parked_body_does_not_creep(parameters: ContactParameters, gravity: float):
    slope = math.radians(15.0)
    body = PointOnPlane(parameters, slope=slope, gravity=gravity)
    start = body.x.copy()
    for _ in range(5000):
        body.step()
    settled = body.x.copy()
    for _ in range(15_000):
        body.step()
    assert np.linalg.norm(body.x - start) < 1e-3
    assert np.linalg.norm(body.x - start) == pytest.approx(
        10.0 * gravity * math.sin(slope) / 1e5, rel=0.05
    )
    assert np.linalg.norm(body.x - settled) < 2.5e-10  # holds, and does not creep


def test_without_the_anchor_a_parked_body_creeps():
    slope = math.radians(15.0)
    body = PointOnPlane(dataclasses.replace(ROCK, anchor_stiffness=0.0), slope=slope)
    for _ in range(5000):
        body.step()
    # mu v / sqrt(v^2 + v_s^2) = tan(alpha)
    share = math.tan(slope) / 0.6
    creep = 2e-3 * share / math.sqrt(1 - share**2)
    assert np.linalg.norm(body.v) == pytest.approx(creep, rel=0.01)


@pytest.mark.parametrize("degrees", [33.0, 40.0])
def test_a_body_slides_where_the_slope_exceeds_the_friction(degrees: float):
    slope = math.radians(degrees)
    parameters = dataclasses.replace(ROCK, static_friction=0.5, kinetic_friction=0.5)
    body = PointOnPlane(parameters, slope=slope, gravity=1.62)
    for _ in range(1000):
        body.step()
    down = np.array([math.cos(slope), 0.0, -math.sin(slope)])
    early = body.v @ down
    for _ in range(2000):
        body.step()
    expected = 1.62 * (math.sin(slope) - 0.5 * math.cos(slope))
    assert (body.v @ down - early) / 2.0 == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize(("degrees", "moves"), [(25.0, False), (28.0, True)])
def test_the_slope_of_repose_lies_at_the_friction_coefficient(degrees: float, moves: bool):
    parameters = dataclasses.replace(ROCK, static_friction=0.5, kinetic_friction=0.5)
    body = PointOnPlane(parameters, slope=math.radians(degrees), gravity=1.62)
    for _ in range(10_000):
        body.step()
    assert (np.linalg.norm(body.v) > 0.1) == moves
    if not moves:
        assert np.linalg.norm(body.v) < 1e-9


def test_a_sliding_body_stops_after_its_braking_distance_and_parks():
    parameters = dataclasses.replace(ROCK, static_friction=0.5, kinetic_friction=0.5)
    body = PointOnPlane(parameters, gravity=1.62)
    body.v[:] = (0.5, 0.3, 0.0)
    start = body.energy()
    for _ in range(3000):
        body.step()
    expected = (0.5**2 + 0.3**2) / (2 * 0.5 * 1.62)
    assert math.hypot(body.x[0], body.x[1]) == pytest.approx(expected, rel=0.01)
    assert body.x[1] / body.x[0] == pytest.approx(0.6, rel=1e-3)
    assert np.linalg.norm(body.v) < 1e-6
    assert start - body.energy() == pytest.approx(body.dissipated, abs=1e-9)


def test_a_body_returns_after_a_push_below_the_limit_and_not_above_it():
    for push, returns in ((5.0, True), (12.0, False)):
        body = PointOnPlane(ROCK, gravity=1.62)
        for force in (push, 0.0):
            for _ in range(1500):
                body.step(push=(force, 0.0, 0.0))
        assert (abs(body.x[0]) < 1e-6) == returns, push


# ------------------------------------------------------------------------ materials


def test_blending_is_linear():
    rock, regolith = ROCK.law(), REGOLITH.law()
    half = contact.blend_laws(rock, regolith, 0.25)
    np.testing.assert_allclose(half, 0.75 * np.array(rock) + 0.25 * np.array(regolith))
    assert contact.blend_laws(rock, regolith, 0.0) == rock


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"stiffness": 0.0}, "stiffness = 0.0"),
        ({"stiffness": math.nan}, "stiffness = nan"),
        ({"damping": -1.0}, "damping = -1.0"),
        ({"slip_speed": 0.0}, "slip_speed = 0.0"),
        ({"anchor_stiffness": math.inf}, "anchor_stiffness = inf"),
        ({"static_friction": 0.4}, "static_friction = 0.4"),
    ],
)
def test_impossible_materials_are_refused(change: dict[str, float], named: str):
    with pytest.raises(ValueError, match=named):
        dataclasses.replace(ROCK, **change)
