"""The tether kernel in the plane and in space, without anything at its ends."""

import math
from dataclasses import replace

import numpy as np
import pytest
from mass_matrix import mass_matrix

from rover_sim.physics.tether import ancf, energy_momentum, tether
from rover_sim.physics.tether.energy_momentum import Workspace
from rover_sim.physics.tether.tether_section import TetherSection

TABLE_1 = TetherSection.round(0.5e9, 3.45e-4, 1e4)
DAMPED = TetherSection.round(0.5e9, 3.45e-4, 1e4, 2e-3, 0.5)
LENGTH = 5.0


class Chain:
    """A tether stepped by plain Newton iterations to rounding."""

    def __init__(
        self,
        nodes: np.ndarray,
        rates: np.ndarray,
        section: TetherSection,
        gravity: tuple[float, ...],
        root_held: bool,
        numerical_damping: float = 0.0,
    ) -> None:
        self.count, _, self.dim = nodes.shape
        self.section = section
        self.length = LENGTH / (self.count - 1)
        self.tether: tether.Tether = tether.make_tether(
            section, LENGTH, self.count - 1, gravity, numerical_damping
        )
        self.work: Workspace = energy_momentum.make_workspace(self.count - 1, self.dim)
        self.work.end_fixed[0, : self.dim] = float(root_held)
        energy_momentum.begin_ends(self.tether, self.work)
        self.q = tether.to_rows(nodes)
        self.v = tether.to_rows(rates)
        self.dissipated = 0.0

    def step(self, h: float) -> None:
        q1, v1 = np.zeros_like(self.q), np.zeros_like(self.v)
        self.work.increment[:] = h * self.v
        energy_momentum.begin_step(self.tether, h, self.q, self.v, self.work)
        for _ in range(30):
            if energy_momentum.newton_increment(self.tether, h, self.work) < 1e-13:
                break
        else:
            pytest.fail("Newton's iteration did not converge")
        loss, _ = energy_momentum.end_step(self.tether, h, self.q, self.v, self.work, q1, v1)
        self.dissipated += loss
        self.q, self.v = q1, v1

    @property
    def nodes(self) -> np.ndarray:
        return tether.to_nodes(self.q, self.count - 1)

    @property
    def rates(self) -> np.ndarray:
        return tether.to_nodes(self.v, self.count - 1)

    def energy(self) -> float:
        return float(sum(tether.tether_energies(self.tether, self.q, self.v)))

    def momentum(self) -> np.ndarray:
        load = ancf.load_vector(self.section.line_density, self.length)
        return np.asarray(np.einsum("a,eai->i", load, ancf.element_coordinates(self.rates)))

    def angular_momentum(self) -> np.ndarray:
        mass = mass_matrix(self.section.line_density, self.length)
        e = ancf.element_coordinates(self.nodes)
        rates = ancf.element_coordinates(self.rates)
        tensor = np.einsum("eai,ab,ebj->ij", e, mass, rates)
        return np.asarray(tensor - tensor.T)


def bent(dim: int, count: int = 9, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A curved, slightly stretched tether in motion."""
    x = np.linspace(0.0, 1.0, count)
    generator = np.random.default_rng(seed)
    nodes = np.zeros((count, 2, dim))
    rates = np.zeros((count, 2, dim))
    angle = 1.5 * x**2
    direction = np.stack([np.cos(angle), np.sin(angle), 0.2 * x][:dim], axis=1)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    nodes[:, 1] = 1.001 * direction
    steps = 0.5 * (direction[1:] + direction[:-1]) * LENGTH / (count - 1)
    nodes[1:, 0] = np.cumsum(steps, axis=0)
    rates[:, 0] = generator.normal(size=(count, dim))
    rates[:, 1] = generator.normal(size=(count, dim))
    return nodes, rates


def carried(strain: np.ndarray, limit: float) -> np.ndarray:
    """Force per EA of an element at this mean strain."""
    share = 0.5 * limit
    buckled = (1.0 - share) * strain / np.sqrt(1.0 + (strain / limit) ** 2) + share * strain
    return np.asarray(np.where(strain > 0.0, strain, buckled))


def mean_relief(
    section: TetherSection,
    length: float,
    gravity: float,
    strain0: np.ndarray,
    strain1: np.ndarray,
    x: float,
    h: float,
) -> np.ndarray:
    """Average of carried force minus linear force over a step, by quadrature, (n, 1)."""
    rigidity = section.bending_stiffness
    weight = section.line_density * gravity
    load = math.pi**2 * rigidity * (1.0 / length**2 + (weight / rigidity) ** (2.0 / 3.0))
    before, after = strain0 @ ancf.GAUSS_WEIGHTS, strain1 @ ancf.GAUSS_WEIGHTS
    points, weights = np.polynomial.legendre.leggauss(2000)
    share = 0.5 * (1.0 + points) + 0.5 * x + section.axial_damping_time / h
    strain = before[:, None] + share * (after - before)[:, None]
    excess = carried(strain, load / section.axial_stiffness) - strain
    return np.asarray(excess @ weights / 2.0)[:, None]


@pytest.mark.parametrize("count", [2, 3, 4, 5, 6, 9, 10, 18])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("buckles", [False, True])
def test_a_step_satisfies_the_midpoint_equation_written_out_with_the_elements(
    buckles: bool, dim: int, count: int
) -> None:
    nodes, rates = bent(dim, count)
    gravity = (0.3, -9.81, 1.1)[:dim]
    x, h = 0.3, 1e-3
    section = TetherSection.round(0.5e9, 3.45e-4, 1e4, axial_damping_time=2e-3)
    section = replace(section, buckles=buckles)
    chain = Chain(nodes, rates, section, gravity, root_held=False, numerical_damping=x)
    chain.step(h)
    e0, e1 = ancf.element_coordinates(nodes), ancf.element_coordinates(chain.nodes)
    v0, v1 = ancf.element_coordinates(rates), ancf.element_coordinates(chain.rates)
    functions = ancf.slope_functions(ancf.GAUSS_POINTS, chain.length)
    strain0, strain1 = (0.5 * (np.sum((functions @ e) ** 2, axis=-1) - 1.0) for e in (e0, e1))
    average = 0.5 * (1 + x) * strain1 + 0.5 * (1 - x) * strain0
    average += section.axial_damping_time * (strain1 - strain0) / h
    if buckles:
        average += mean_relief(section, chain.length, math.hypot(*gravity), strain0, strain1, x, h)
    middle = 0.5 * (e0 + e1)
    weights = chain.length * ancf.GAUSS_WEIGHTS * section.axial_stiffness * average
    terms = [
        mass_matrix(section.line_density, chain.length) @ (v1 - v0) / h,
        ancf.bending_matrix(section.bending_stiffness, chain.length) @ middle,
        functions.T @ (weights[..., None] * (functions @ middle)),
        -ancf.load_vector(section.line_density, chain.length)[None, :, None] * np.array(gravity),
    ]
    of_elements = sum(terms[1:], terms[0])
    residual = np.zeros_like(nodes)
    residual[:-1] += of_elements[:, :2]
    residual[1:] += of_elements[:, 2:]
    # The quadrature of the average is less exact than the closed form of the step.
    tolerance = 1e-7 if buckles else 1e-10
    assert np.abs(residual).max() < tolerance * np.abs(terms[2]).max()
    assert chain.rates == pytest.approx(2.0 * (chain.nodes - nodes) / h - rates, abs=1e-9)


@pytest.mark.parametrize("dim", [2, 3])
def test_newton_converges_quadratically(dim: int) -> None:
    nodes, rates = bent(dim)
    chain = Chain(nodes, rates, TABLE_1, (0.0, -9.81, 0.0)[:dim], root_held=True)
    chain.v[:dim, 0] = 0.0
    h = 4e-3
    energy_momentum.begin_step(chain.tether, h, chain.q, chain.v, chain.work)
    chain.work.increment[:] = h * chain.v
    sizes = [energy_momentum.newton_increment(chain.tether, h, chain.work) for _ in range(9)]
    orders = [
        math.log(sizes[i + 1] / sizes[i]) / math.log(sizes[i] / sizes[i - 1])
        for i in range(1, 8)
        if sizes[i + 1] > 1e-13
    ]
    assert len(orders) >= 2
    assert max(orders) > 1.7


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("buckles", [False, True])
def test_free_flight_conserves_energy_and_momenta(buckles: bool, dim: int) -> None:
    nodes, rates = bent(dim)
    section = replace(TABLE_1, buckles=buckles)
    chain = Chain(nodes, rates, section, (0.0,) * dim, root_held=False)
    energy, momentum, angular = chain.energy(), chain.momentum(), chain.angular_momentum()
    for _ in range(200):
        chain.step(1e-3)
    assert chain.energy() == pytest.approx(energy, rel=1e-10)
    assert chain.momentum() == pytest.approx(momentum, rel=1e-10)
    assert chain.angular_momentum() == pytest.approx(angular, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(("dim", "bending_time"), [(2, 0.5), (3, 0.0)])
@pytest.mark.parametrize("buckles", [False, True])
def test_damping_conserves_momenta_and_reports_its_dissipation(
    buckles: bool, dim: int, bending_time: float
) -> None:
    nodes, rates = bent(dim)
    section = TetherSection.round(0.5e9, 3.45e-4, 1e4, 2e-3, bending_time)
    section = replace(section, buckles=buckles)
    chain = Chain(nodes, rates, section, (0.0,) * dim, root_held=False, numerical_damping=0.4)
    energy, momentum, angular = chain.energy(), chain.momentum(), chain.angular_momentum()
    for _ in range(200):
        chain.step(1e-3)
    assert chain.dissipated > 0.1 * energy
    assert chain.energy() + chain.dissipated == pytest.approx(energy, rel=1e-10)
    assert chain.momentum() == pytest.approx(momentum, rel=1e-10)
    assert chain.angular_momentum() == pytest.approx(angular, rel=1e-8, abs=1e-12)


def test_bending_damping_in_space_balances_the_energy() -> None:
    nodes, rates = bent(3)
    chain = Chain(nodes, rates, DAMPED, (0.0, 0.0, 0.0), root_held=False)
    energy, momentum = chain.energy(), chain.momentum()
    for _ in range(200):
        chain.step(1e-3)
    assert chain.dissipated > 0.1 * energy
    assert chain.energy() + chain.dissipated == pytest.approx(energy, rel=1e-10)
    assert chain.momentum() == pytest.approx(momentum, rel=1e-10)


@pytest.mark.parametrize("dim", [2, 3])
def test_turning_a_bent_tether_rigidly_is_not_damped(dim: int) -> None:
    nodes, _ = bent(dim)
    nodes[..., 2:] = 0.0
    nodes[:, 0] -= nodes[:, 0].mean(axis=0)
    spin = np.zeros((dim, dim))
    spin[0, 1], spin[1, 0] = -2.0, 2.0
    section = TetherSection(1e-12, 1e-12, 1.0, 0.0, bending_damping_time=1e12)
    chain = Chain(nodes, nodes @ spin.T, section, (0.0,) * dim, root_held=False)
    kinetic = chain.energy()
    # a rigid turn about the origin by Cayley's map, which the step must reproduce
    h = 1e-2
    turn = np.linalg.solve(np.eye(dim) - 0.5 * h * spin, np.eye(dim) + 0.5 * h * spin)
    chain.work.increment[:] = tether.to_rows(nodes @ turn.T - nodes)
    energy_momentum.begin_step(chain.tether, h, chain.q, chain.v, chain.work)
    loss, _ = energy_momentum.end_step(
        chain.tether, h, chain.q, chain.v, chain.work, chain.q.copy(), chain.v.copy()
    )
    assert abs(loss) < 1e-10 * kinetic


def test_space_holds_the_plane_in_any_attitude() -> None:
    nodes, rates = bent(2)
    rates[0, 0] = 0.0
    flat = Chain(nodes, rates, DAMPED, (0.0, -9.81), root_held=True)
    axis = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0][:, :2]
    gravity = tuple(float(g) for g in axis @ np.array([0.0, -9.81]))
    tilted = Chain(nodes @ axis.T, rates @ axis.T, DAMPED, gravity, root_held=True)
    for _ in range(100):
        flat.step(1e-3)
        tilted.step(1e-3)
    assert tilted.nodes == pytest.approx(flat.nodes @ axis.T, abs=1e-9)
    assert tilted.energy() == pytest.approx(flat.energy(), abs=1e-9)


def test_a_nan_is_returned_as_nan() -> None:
    nodes, rates = bent(2)
    chain = Chain(nodes, rates, TABLE_1, (0.0, -9.81), root_held=False)
    chain.work.increment[:] = 0.0
    chain.v[1, 4] = math.nan
    energy_momentum.begin_step(chain.tether, 1e-3, chain.q, chain.v, chain.work)
    assert math.isnan(energy_momentum.newton_increment(chain.tether, 1e-3, chain.work))


def test_tension_of_a_stretched_and_stretching_tether() -> None:
    stretch, rate = 1.01, 0.05
    x = np.linspace(0.0, LENGTH, 6)
    nodes = np.zeros((6, 2, 2))
    nodes[:, 0, 0], nodes[:, 1, 0] = stretch * x, stretch
    rates = np.zeros_like(nodes)
    rates[:, 0, 0], rates[:, 1, 0] = rate * x, rate
    chain = Chain(nodes, rates, DAMPED, (0.0, 0.0), root_held=False)
    tensions = np.empty(5)
    tether.element_tensions(chain.tether, chain.q, chain.v, tensions)
    strain = 0.5 * (stretch**2 - 1.0) + DAMPED.axial_damping_time * stretch * rate
    assert tensions == pytest.approx(np.full(5, DAMPED.axial_stiffness * strain * stretch))


def test_nodal_tensions_follow_a_linear_course() -> None:
    middles = np.array([0.5, 1.5, 2.5])
    assert tether.nodal_tensions(middles) == pytest.approx([0.0, 1.0, 2.0, 3.0])
    assert tether.nodal_tensions(np.array([2.0])) == pytest.approx([2.0, 2.0])
