"""The tether at rest against closed forms, balance of forces and mesh refinement."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from scipy.integrate import solve_bvp
from scipy.optimize import fsolve

from rover_sim.physics.tether import ancf
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.buckling import NO_BUCKLING, buckling_strain
from rover_sim.physics.tether.starting_shapes import Catenary, arc_nodes, straight_nodes
from rover_sim.physics.tether.static_minimum import (
    StaticLaw,
    derivatives,
    elastic_energy,
    make_work,
)
from rover_sim.physics.tether.statics import (
    StaticsError,
    nodal_forces,
    static_equilibrium,
    static_problem,
)
from rover_sim.physics.tether.tether_section import TetherSection

Record = Callable[[str, object], None]
GRAVITY = (0.0, -9.81)
LENGTH = 5.0
ROOT = (0.0, 0.0)
LOW = TetherSection.round(0.01e9, 3.45e-4, 1e4)
HIGH = TetherSection.round(0.5e9, 3.45e-4, 1e4)
STIFF = TetherSection.round(70e9, 3.45e-4, 2700.0)


def potential_energy(
    nodes: Array, section: TetherSection, length: float, gravity: ArrayLike
) -> tuple[float, float, float]:
    """Axial, bending and gravitational energy [J]; the last is zero at the origin."""
    law, work = static_problem(nodes, section, length, gravity)
    axial, bending, weight = elastic_energy(law, np.ascontiguousarray(nodes), work)
    return axial, bending, weight


def tip_of(geometry: str, slack: float):
    if geometry == "-H":
        return (2.2 / slack, -2.2)
    angle = math.atan(slack) * (1 if geometry == "+K" else -1)
    return (0.99 * LENGTH * math.cos(angle), 0.99 * LENGTH * math.sin(angle))


def stretches(nodes: Array, length: float = LENGTH):
    element = length / (nodes.shape[0] - 1)
    functions = ancf.slope_functions(np.linspace(0.0, 1.0, 9), element)
    return np.linalg.norm(functions @ ancf.element_coordinates(nodes), axis=-1)


class TestDerivatives:
    """Gradient and Hessian against differences of the energy."""

    @staticmethod
    def law(dim: int, *, buckles: bool, moment: float) -> StaticLaw:
        section = TetherSection(axial_stiffness=30.0, bending_stiffness=0.2, line_density=0.5)
        functions = ancf.slope_functions(ancf.GAUSS_POINTS, 0.7)
        return StaticLaw(
            element_length=0.7,
            axial_stiffness=section.axial_stiffness * 0.7,
            buckling_limit=0.05 if buckles else NO_BUCKLING,
            functions=functions,
            gauss_weights=ancf.GAUSS_WEIGHTS,
            mean=(functions.T * ancf.GAUSS_WEIGHTS) @ functions,
            bending=ancf.bending_matrix(section.bending_stiffness, 0.7),
            weight=np.outer(ancf.load_vector(0.5, 0.7), [0.3, -1.6, 0.2][:dim]),
            force=np.array([1.0, -2.0, 0.5])[:dim],
            moment=moment,
        )

    @pytest.mark.parametrize(
        ("dim", "buckles", "moment"),
        [(2, False, 0.0), (2, True, 0.3), (2, False, -0.4), (3, False, 0.0), (3, True, 0.0)],
    )
    def test_they_are_those_of_the_energy(self, dim: int, buckles: bool, moment: float):
        generator = np.random.default_rng(4)
        nodes = straight_nodes(np.zeros(dim), 1.9 * np.eye(dim)[0], 3, 2.1)
        nodes += 0.1 * generator.normal(size=nodes.shape)
        law, work = self.law(dim, buckles=buckles, moment=moment), make_work(3, dim)
        before = nodes.copy()

        def gradient(at: Array) -> Array:
            derivatives(law, at, work)
            return work.gradient.copy()

        def energy(at: Array) -> float:
            x, y = at[-1, 1, :2]
            x0, y0 = before[-1, 1, :2]
            turned = math.atan2(x0 * y - y0 * x, x0 * x + y0 * y)
            elastic: float = sum(elastic_energy(law, at, work))
            return elastic - float(law.force @ at[-1, 0]) - moment * turned

        found, banded = gradient(nodes), work.banded.copy()
        count, step = nodes.size, 1e-5
        hessian = np.zeros((count, count))
        for offset in range(4 * dim):
            for column in range(count - offset):
                hessian[column + offset, column] = banded[offset, column]
                hessian[column, column + offset] = banded[offset, column]
        for index in range(count):
            move = np.zeros(count)
            move[index] = step
            ahead, behind = (nodes + sign * move.reshape(nodes.shape) for sign in (1.0, -1.0))
            slope = (energy(ahead) - energy(behind)) / (2.0 * step)
            assert slope == pytest.approx(found[index], rel=1e-5, abs=1e-7)
            curvature = (gradient(ahead) - gradient(behind)) / (2.0 * step)
            assert curvature == pytest.approx(hessian[index], rel=1e-5, abs=1e-6)


class TestBeam:
    """A clamped beam without gravity."""

    section = TetherSection(axial_stiffness=1e6, bending_stiffness=1.0, line_density=1.0)

    def bend(self, elements: int = 32, **load: Any):
        return static_equilibrium(
            self.section, 1.0, elements, (0.0, 0.0), ROOT, root_slope=(1.0, 0.0), **load
        )

    def test_a_rigid_rotation_needs_no_force(self):
        for degrees in (0, 37, 90, 201):
            angle = math.radians(degrees)
            tip = (3.0 + math.cos(angle), -1.0 + math.sin(angle))
            nodes = straight_nodes((3.0, -1.0), tip, 7, 1.0)
            forces = nodal_forces(nodes, self.section, 1.0, (0.0, 0.0))
            assert np.max(np.abs(forces)) < 1e-15 * 1e6 * 100
            assert potential_energy(nodes, self.section, 1.0, (0.0, 0.0))[:2] == pytest.approx(
                (0.0, 0.0), abs=1e-9
            )

    def test_a_stretched_or_bent_beam_needs_force(self):
        stretched = straight_nodes((0.0, 0.0), (1.001, 0.0), 7, 1.0)
        strain = (1.001**2 - 1.0) / 2.0
        forces = nodal_forces(stretched, self.section, 1.0, (0.0, 0.0))
        assert forces[-1, 0] == pytest.approx([1e6 * strain * 1.001, 0.0], abs=1e-6)
        bent = arc_nodes((0.0, 0.0), (0.9, 0.0), 32, 1.0, (0.0, -1.0))
        angle = 2.0 * math.acos(bent[0, 1] @ np.array([1.0, 0.0]))
        assert potential_energy(bent, self.section, 1.0, (0.0, 0.0))[1] == pytest.approx(
            0.5 * angle**2, rel=1e-4
        )

    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_a_tip_moment_of_2_pi_ei_over_l_closes_a_circle(
        self, sign: float, record_property: Record
    ):
        nodes = self.bend(tip_moment=sign * 2.0 * math.pi)
        record_property("gap", np.linalg.norm(nodes[-1, 0]))
        assert nodes[-1, 0] == pytest.approx([0.0, 0.0], abs=1e-4)
        assert nodes[-1, 1] == pytest.approx([1.0, 0.0], abs=1e-3)
        assert nodes[16, 0] == pytest.approx([0.0, sign / math.pi], abs=1e-4)
        angles = 2.0 * math.pi * np.linspace(0.0, 1.0, 33)
        circle = np.stack([np.sin(angles), sign * (1.0 - np.cos(angles))], axis=1)
        assert nodes[:, 0] == pytest.approx(circle / (2.0 * math.pi), abs=1e-4)

    @pytest.mark.parametrize(
        ("load", "deflection", "shortening"),
        [(1.0, 0.30172, 0.05643), (3.0, 0.60325, 0.25442), (10.0, 0.81061, 0.55500)],
    )
    def test_the_tip_loaded_elastica(
        self, load: float, deflection: float, shortening: float, record_property: Record
    ):
        nodes = self.bend(tip_force=(0.0, -load))
        error = np.abs(nodes[-1, 0] - [1.0 - shortening, -deflection]).max()
        record_property("error", error)
        assert error < 1.5e-5

        def elastica(_: Array, y: Array) -> Array:
            return np.array([y[1], load * np.cos(y[0])])

        def ends(start: Array, end: Array) -> Array:
            return np.array([start[0], end[1]])

        arc_length = np.linspace(0.0, 1.0, 33)
        exact = solve_bvp(elastica, ends, arc_length, np.zeros((2, 33)), tol=1e-9)
        angle = exact.sol(arc_length)[0]
        assert np.arctan2(nodes[:, 1, 1], nodes[:, 1, 0]) == pytest.approx(angle, abs=2e-4)

    def test_the_error_falls_with_refinement(self):
        errors = [
            abs(-self.bend(elements=n, tip_force=(0.0, -3.0))[-1, 0, 1] - 0.603254)
            for n in (8, 16, 32)
        ]
        assert errors[0] > 1e-3 > errors[1] > 5.0 * errors[2]

    def test_the_load_bends_alike_in_space(self):
        flat = self.bend(elements=8, tip_force=(0.0, -3.0))
        space = static_equilibrium(
            self.section,
            1.0,
            8,
            (0.0, 0.0, 0.0),
            (0.0, 0.0, 0.0),
            root_slope=(0.0, 1.0, 0.0),
            tip_force=(3.0, 0.0, 0.0),
        )
        assert space[..., 1] == pytest.approx(flat[..., 0], abs=1e-9)
        assert space[..., 0] == pytest.approx(-flat[..., 1], abs=1e-9)


class Chain(NamedTuple):
    """Position by arc length [m], and the horizontal and vertical force at the root [N]."""

    position: Callable[[ArrayLike], Array]
    across: float
    up: float


@pytest.fixture(scope="module")
def elastic_chain() -> Chain:
    """The elastic chain of Irvine (1981), in closed form."""
    stiffness, weight = HIGH.axial_stiffness, HIGH.line_density * 9.81

    def position(across: float, up: float, s: ArrayLike) -> Array:
        s = np.asarray(s)
        end = up + weight * s
        return np.array(
            [
                across * s / stiffness
                + across / weight * (np.arcsinh(end / across) - np.arcsinh(up / across)),
                (up * s + weight * s**2 / 2.0) / stiffness
                + (np.hypot(across, end) - np.hypot(across, up)) / weight,
            ]
        )

    def missed(force: Array) -> Array:
        return np.asarray(position(force[0], force[1], LENGTH) - np.array([4.0, 1.0]))

    across, up = fsolve(missed, [0.06, -0.07], xtol=1e-13)
    return Chain(lambda s: position(across, up, s), across, up)


class TestSag:
    """A tether hung between (0, 0) and (4, 1)."""

    tip = (4.0, 1.0)
    weight = HIGH.line_density * 9.81

    def hang(self, elements: int):
        return static_equilibrium(HIGH, LENGTH, elements, GRAVITY, ROOT, self.tip)

    def test_forces(self, record_property: Record):
        forces = nodal_forces(self.hang(20), HIGH, LENGTH, GRAVITY)
        first, last = np.linalg.norm(forces[[0, -1], 0], axis=1)
        for found, exact, limit in (
            (forces[-1, 0, 0], 0.0651011, 1e-4),
            (first, 0.0949152, 5e-5),
            (last, 0.1315753, 5e-5),
        ):
            error = abs(found / exact - 1.0)
            record_property("error", error)
            assert error < limit

    def test_lowest_point(self):
        nodes = self.hang(20)
        element = LENGTH / 20
        fine = np.linspace(0.0, 1.0, 2001)
        curve = ancf.shape_functions(fine, element) @ ancf.element_coordinates(nodes)
        points = curve.reshape(-1, 2)
        lowest = points[np.argmin(points[:, 1])]
        assert lowest == pytest.approx([1.64021, -0.81311], abs=2e-4)
        assert lowest[1] == pytest.approx(-0.81311, abs=3e-5)

    def test_nodes_against_the_elastic_chain(self, elastic_chain: Chain, record_property: Record):
        position = elastic_chain.position
        errors = {}
        for elements in (5, 20):
            chain = position(np.linspace(0.0, LENGTH, elements + 1)).T
            errors[elements] = np.max(np.linalg.norm(self.hang(elements)[:, 0] - chain, axis=1))
        assert errors[5] == pytest.approx(2.2e-3, rel=0.05)
        record_property("error in 20 elements", errors[20])
        assert errors[20] < 1.4e-5

    def test_the_closed_form_of_the_inextensible_chain(self, elastic_chain: Chain):
        catenary = Catenary.between(ROOT, self.tip, LENGTH, GRAVITY)
        ends = np.array([0.0, LENGTH])
        assert catenary.position(ends) == pytest.approx(np.array([ROOT, self.tip]), abs=1e-12)
        fine = np.linspace(0.0, LENGTH, 20001)
        steps = np.linalg.norm(np.diff(catenary.position(fine), axis=0), axis=1)
        assert np.sum(steps) == pytest.approx(LENGTH, abs=1e-8)
        assert np.linalg.norm(catenary.tangent(fine), axis=1) == pytest.approx(1.0, abs=1e-14)
        difference = (catenary.position(fine[1:]) - catenary.position(fine[:-1])) / steps[:, None]
        assert difference == pytest.approx(catenary.tangent(0.5 * (fine[1:] + fine[:-1])), abs=1e-7)
        across, up = elastic_chain.across, elastic_chain.up
        assert self.weight * catenary.parameter == pytest.approx(across, rel=2e-3)
        below = self.weight * np.hypot(catenary.parameter, catenary.lowest)
        assert below == pytest.approx(np.hypot(across, up), rel=2e-3)

    def test_stiff_thin_tether_approaches_the_closed_form(self):
        section = TetherSection(1e6, 1e-9, HIGH.line_density)
        catenary = Catenary.between(ROOT, self.tip, LENGTH, GRAVITY)
        nodes = static_equilibrium(section, LENGTH, 40, GRAVITY, ROOT, self.tip)
        difference = np.abs(nodes - catenary.nodes(40))
        assert np.max(difference[:, 0]) < 2e-5
        assert np.max(difference[:, 1]) < 5e-4

    def test_the_end_force_converges_fast_in_the_number_of_elements(self):
        def pull(elements: int) -> float:
            return float(nodal_forces(self.hang(elements), HIGH, LENGTH, GRAVITY)[-1, 0, 0])

        exact = pull(80)
        errors = [abs(pull(n) - exact) for n in (5, 10, 20)]
        assert errors[0] > 10.0 * errors[1] > 100.0 * errors[2]


class TestStudyGrid:
    """Equilibria of all starting configurations of the paper's study."""

    @pytest.mark.parametrize("section", [LOW, HIGH, STIFF], ids=["low", "high", "stiff"])
    @pytest.mark.parametrize("elements", [5, 20, 100])
    def test_equilibrium(self, section: TetherSection, elements: int):
        rounding = 1e-14 * section.axial_stiffness * elements
        for geometry in ("-H", "-K", "+K"):
            for slack in (0.5, 1.0, 1.5, 2.0, 3.5) + ((0.3,) if geometry != "-H" else ()):
                tip = tip_of(geometry, slack)
                nodes = static_equilibrium(section, LENGTH, elements, GRAVITY, ROOT, tip)
                assert tuple(nodes[0, 0]) == ROOT
                assert tuple(nodes[-1, 0]) == tip
                forces = nodal_forces(nodes, section, LENGTH, GRAVITY)
                assert np.max(np.abs(forces[1:-1])) < rounding
                assert np.max(np.abs(forces[[0, -1], 1])) < rounding
                weight = section.line_density * LENGTH * 9.81
                assert forces[0, 0] + forces[-1, 0] == pytest.approx([0.0, weight], abs=1e-9)
                strain = np.max(np.linalg.norm(forces[[0, -1], 0], axis=1))
                strain /= section.axial_stiffness
                stretch = stretches(nodes)
                assert np.max(stretch) < 1.0 + strain + 0.03
                assert np.min(stretch) > 0.97

    def test_the_tether_hangs_below_its_chord(self):
        for slack in (0.5, 2.0, 3.5):
            tip = np.array(tip_of("+K", slack))
            nodes = static_equilibrium(HIGH, LENGTH, 20, GRAVITY, ROOT, tip)
            across = nodes[1:-1, 0] @ np.array([-tip[1], tip[0]])
            assert np.all(across < 0.0)

    def test_energy_is_a_minimum(self):
        tip = tip_of("-H", 1.5)
        nodes = static_equilibrium(HIGH, LENGTH, 10, GRAVITY, ROOT, tip)
        least = sum(potential_energy(nodes, HIGH, LENGTH, GRAVITY))
        generator = np.random.default_rng(3)
        for _ in range(50):
            move = 1e-3 * generator.standard_normal(nodes.shape)
            move[[0, -1], 0] = 0.0
            assert sum(potential_energy(nodes + move, HIGH, LENGTH, GRAVITY)) > least

    @pytest.mark.parametrize(
        ("slack", "coarse", "fine"), [(1.0, 13.0, 0.01), (1.5, 132.0, 0.16), (3.5, 887.0, 18.6)]
    )
    def test_the_unrelaxed_catenary_stores_spurious_axial_energy(
        self, slack: float, coarse: float, fine: float, record_property: Record
    ):
        catenary = Catenary.between(ROOT, tip_of("-H", slack), LENGTH, GRAVITY)
        for elements, expected in ((5, coarse), (20, fine)):
            stored = potential_energy(catenary.nodes(elements), STIFF, LENGTH, GRAVITY)[0]
            record_property(f"energy in {elements} elements", stored)
            assert stored == pytest.approx(expected, rel=0.08)
            nodes = static_equilibrium(STIFF, LENGTH, elements, GRAVITY, ROOT, tip_of("-H", slack))
            assert potential_energy(nodes, STIFF, LENGTH, GRAVITY)[0] < 0.01


class TestOtherSupports:
    def test_a_hanging_weight_stretches_the_tether_by_green_strain(self):
        nodes = static_equilibrium(HIGH, LENGTH, 4, (0.0, 0.0), ROOT, tip_force=(0.0, -9.81))
        stretch = -nodes[-1, 0, 1] / LENGTH
        force = HIGH.axial_stiffness * 0.5 * (stretch**2 - 1.0) * stretch
        assert force == pytest.approx(9.81, rel=1e-12)

    def test_its_own_weight_stretches_a_hanging_tether(self):
        nodes = static_equilibrium(HIGH, LENGTH, 20, GRAVITY, ROOT)
        weight = HIGH.line_density * 9.81
        expected = weight * LENGTH**2 / (2.0 * HIGH.axial_stiffness)
        assert -nodes[-1, 0, 1] - LENGTH == pytest.approx(expected, rel=2e-3)
        assert nodes[:, 0, 0] == pytest.approx(0.0, abs=1e-9)

    def test_sag_alike_in_space(self):
        flat = static_equilibrium(HIGH, LENGTH, 10, GRAVITY, ROOT, (4.0, 1.0))
        heading = np.array([math.cos(0.7), math.sin(0.7)])
        space = static_equilibrium(
            HIGH, LENGTH, 10, (0.0, 0.0, -9.81), (0.0, 0.0, 0.0), (*(4.0 * heading), 1.0)
        )
        assert space[..., :2] == pytest.approx(flat[..., :1] * heading, abs=1e-9)
        assert space[..., 2] == pytest.approx(flat[..., 1], abs=1e-9)

    def test_taut_beyond_its_length(self):
        nodes = static_equilibrium(HIGH, LENGTH, 20, GRAVITY, ROOT, (5.05, 0.0))
        pull = nodal_forces(nodes, HIGH, LENGTH, GRAVITY)[-1, 0, 0]
        # the sag of the parabola takes the rest of the length
        sag = (HIGH.line_density * 9.81 * LENGTH / pull) ** 2 / 24.0
        stretch = 5.05 / LENGTH + sag
        assert 0.5 * (stretch**2 - 1.0) * stretch * HIGH.axial_stiffness == pytest.approx(
            pull, rel=5e-4
        )

    def test_a_buckled_tether_carries_its_load_at_less_energy(self):
        # Pushed together by a fifth of the strain at the buckling load, and by ten times it.
        buckles = replace(HIGH, buckles=True)
        limit = buckling_strain(buckles, 1.0, 9.81)
        for strain in (0.2 * limit, 10.0 * limit):
            nodes = straight_nodes((0.0, 0.0), (LENGTH * (1.0 - strain), 0.0), 5, LENGTH)
            nodes[:, 1, 0] = 1.0 - strain
            move = 1e-6 * strain * np.random.default_rng(0).normal(size=nodes.shape)
            forces = nodal_forces(nodes, buckles, LENGTH, GRAVITY)
            after = sum(potential_energy(nodes + move, buckles, LENGTH, GRAVITY))
            before = sum(potential_energy(nodes - move, buckles, LENGTH, GRAVITY))
            assert np.sum(forces * move) == pytest.approx(0.5 * (after - before), rel=1e-4)
            linear = nodal_forces(nodes, HIGH, LENGTH, GRAVITY)[0, 0, 0]
            assert forces[0, 0, 0] < linear
        assert forces[0, 0, 0] == pytest.approx(HIGH.axial_stiffness * limit, rel=0.01)

    def test_it_leaves_an_unstable_equilibrium(self):
        nodes = static_equilibrium(HIGH, LENGTH, 20, GRAVITY, ROOT, (0.0, -LENGTH))
        assert np.max(np.abs(nodes[:, 0, 0])) > 1e-3
        assert np.min(stretches(nodes)) > 0.999

    def test_a_kinked_mesh_is_refused(self):
        start = arc_nodes(ROOT, (2.2, -2.2), 5, LENGTH, GRAVITY)
        start[2, 1] *= -1.0
        with pytest.raises(StaticsError, match="close to 1"):
            static_equilibrium(HIGH, LENGTH, 5, GRAVITY, ROOT, (2.2, -2.2), start_nodes=start)

    @pytest.mark.parametrize(
        ("arguments", "reason"),
        [
            ({"start_nodes": np.zeros((5, 2, 2)), "tip": (4.0, 1.0)}, "shape"),
            ({"gravity": (0.0, 0.0)}, "needs a clamp"),
            ({"tip_force": (0.0, 0.0, 1.0)}, "tip_force"),
            ({"gravity": (0.0, 0.0, -9.81), "root": (0.0, 0.0, 0.0), "tip_moment": 1.0}, "plane"),
        ],
    )
    def test_bad_arguments(self, arguments: dict[str, Any], reason: str):
        given_ = {"gravity": GRAVITY, "root": ROOT} | arguments
        with pytest.raises(ValueError, match=reason):
            static_equilibrium(HIGH, LENGTH, 10, **given_)

    @pytest.mark.parametrize("tip", [(0.0, 0.0), (6.0, 0.0), (math.nan, 1.0)])
    def test_shapes_refuse_ends_out_of_reach(self, tip: tuple[float, float]):
        with pytest.raises(ValueError, match="must be"):
            arc_nodes(ROOT, tip, 5, LENGTH, GRAVITY)
        with pytest.raises(ValueError, match="must be"):
            Catenary.between(ROOT, tip, LENGTH, GRAVITY)

    def test_a_catenary_needs_a_horizontal_distance(self):
        with pytest.raises(ValueError, match="horizontal distance"):
            Catenary.between(ROOT, (0.0, -2.0), LENGTH, GRAVITY)


@settings(max_examples=40, deadline=None)
@given(
    angle=st.floats(-math.pi, math.pi),
    ratio=st.floats(0.15, 0.995),
    elements=st.integers(5, 30),
    modulus=st.floats(7.0, 10.9),
)
def test_any_span_balances_its_weight(angle: float, ratio: float, elements: int, modulus: float):
    section = replace(
        HIGH,
        axial_stiffness=HIGH.axial_stiffness * 10**modulus / 0.5e9,
        bending_stiffness=HIGH.bending_stiffness * 10**modulus / 0.5e9,
    )
    tip = (ratio * LENGTH * math.cos(angle), ratio * LENGTH * math.sin(angle))
    nodes = static_equilibrium(section, LENGTH, elements, GRAVITY, ROOT, tip)
    forces = nodal_forces(nodes, section, LENGTH, GRAVITY)
    assert forces[0, 0] + forces[-1, 0] == pytest.approx(
        [0.0, section.line_density * LENGTH * 9.81], abs=1e-8
    )
    assert np.max(np.abs(forces[1:-1])) < 1e-8
