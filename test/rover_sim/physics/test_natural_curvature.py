"""Natural curvature: forces and energy, twist between held ends, rest shapes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rover_sim.physics.tether.air_drag import AirDrag, drag_force
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.carried_frames import (
    carry_director,
    carry_frames,
    end_natural_curvature,
    hold_root,
    relax_bending,
)
from rover_sim.physics.tether.energy_momentum import make_workspace
from rover_sim.physics.tether.natural_curvature import (
    NO_EXIT,
    BendingRelaxation,
    ExitSpan,
    NaturalCurvature,
    add_exit_curvature,
    begin_natural_curvature,
    exit_energy_by_length,
    fairlead_curvature,
    make_natural_curvature,
    natural_curvature_force,
    natural_energies,
    natural_vector,
)
from rover_sim.physics.tether.tether import Tether, make_tether, row_width
from rover_sim.physics.tether.tether_section import TetherSection
from rover_sim.plants.end_motion import EndMotion
from rover_sim.plants.held_cable import CableLaws, HeldCable

ELEMENTS = 4


def bent(seed: int, guided: bool = False) -> tuple[Tether, Array, NaturalCurvature]:
    """A crooked, twisted tether with natural curvature."""
    generator = np.random.default_rng(seed)
    tether = make_tether(TetherSection(100.0, 1.3, 0.02), 0.4, ELEMENTS, (0.0, 0.0, -9.81))
    width = row_width(ELEMENTS, 3)
    nodes = ELEMENTS + 1
    law = make_natural_curvature(width, 0.8, 5.0 * generator.normal(size=(2, nodes)), guided)
    q = np.zeros((6, width))
    q[3:, :nodes] = 0.3 * generator.normal(size=(3, nodes)) - np.array([[0.0], [0.0], [1.0]])
    slopes = q[3:, :nodes] / np.linalg.norm(q[3:, :nodes], axis=0)
    directors = generator.normal(size=(3, nodes))
    directors -= slopes * np.sum(directors * slopes, axis=0)
    law.director[:, :nodes] = directors / np.linalg.norm(directors, axis=0)
    if guided:
        hold_root(law, q)
    return tether, q, law


def forces(tether: Tether, q: Array, increment: Array, law: NaturalCurvature) -> Array:
    """Gradients by the slopes of each element's two nodes, (n, 2, 3)."""
    work = make_workspace(ELEMENTS, 3)
    work.increment[:] = increment
    begin_natural_curvature(tether, q, law)
    return np.array([natural_curvature_force(tether, q, e, work, law)[:2] for e in range(ELEMENTS)])


def energy_of(tether: Tether, q: Array, law: NaturalCurvature) -> float:
    """Energy of bending and torsion [J]."""
    bending, torsion = natural_energies(tether, q, NO_EXIT, law)
    return float(bending + torsion)


def carried_energy(tether: Tether, q: Array, q1: Array, law: NaturalCurvature) -> float:
    """Energy at q1 with frames carried there without relaxing, as the energy before it says."""
    kept = law.director.copy()
    carry_frames(tether, q1, q1 - q, law)
    if law.guided:
        hold_root(law, q1)
    energy = energy_of(tether, q1, law)
    law.director[:] = kept
    energy_of(tether, q, law)
    return float(energy)


@pytest.mark.parametrize("guided", [False, True])
def test_forces_are_the_gradient_of_the_energy(guided: bool):
    tether, q, law = bent(0, guided)
    each = forces(tether, q, np.zeros_like(q), law)
    total = np.zeros((ELEMENTS + 1, 3))
    total[:-1] += each[:, 0]
    total[1:] += each[:, 1]
    step = 1e-5
    for node in range(ELEMENTS + 1):
        for k in range(3):
            energies = []
            for sign in (1.0, -1.0):
                moved = q.copy()
                moved[3 + k, node] += sign * step
                energies.append(carried_energy(tether, q, moved, law))
            slope = (energies[0] - energies[1]) / (2.0 * step)
            assert total[node, k] == pytest.approx(slope, abs=2e-6)


@pytest.mark.parametrize("guided", [False, True])
def test_the_work_of_a_large_step_is_the_change_of_the_energy(guided: bool):
    tether, q, law = bent(1, guided)
    increment = np.zeros_like(q)
    increment[3:, : ELEMENTS + 1] = 0.1 * np.random.default_rng(2).normal(size=(3, ELEMENTS + 1))
    before = energy_of(tether, q, law)
    each = forces(tether, q, increment, law)
    work = sum(
        float(each[e, side] @ increment[3:, e + side]) for e in range(ELEMENTS) for side in range(2)
    )
    after = carried_energy(tether, q, q + increment, law)
    assert work == pytest.approx(after - before, rel=1e-10)


def test_the_exit_element_s_energy_changes_by_its_length_and_the_work_of_its_force():
    """While tether is paid out, its natural curvature at the fairlead changes with the length."""
    tether, _, law = bent(6)
    law.curvature[:] = 5.0 * np.random.default_rng(7).normal(size=law.curvature.shape)
    generator = np.random.default_rng(8)
    start, change = np.zeros((4, 4)), np.zeros((4, 4))
    for row in (1, 3):
        start[row, :3] = 0.3 * generator.normal(size=3) - np.array([0.0, 0.0, 1.0])
        change[row, :3] = 0.1 * generator.normal(size=3)
    lengths = (0.09, 0.13)
    q = np.zeros((6, row_width(ELEMENTS, 3)))
    q[3:, 0] = start[3, :3]
    q[5, 1 : ELEMENTS + 1] = -1.0
    carry_director(law, 0, _unit(np.array([0.0, 0.0, -1.0])), _unit(start[3, :3]))
    law.natural[:, 0] = natural_vector(tether, law, q, 0)

    def exit_part(length: float, slope: Array) -> tuple[float, float]:
        """Energy of the exit element, and its twist."""
        span = ExitSpan(length, tuple(slope))
        with_exit = sum(natural_energies(tether, q, span, law))
        return with_exit - sum(natural_energies(tether, q, NO_EXIT, law)), float(law.exit[0])

    before, twist0 = exit_part(lengths[0], start[1, :3])
    residual, tangent = np.zeros((4, 4)), np.zeros((4, 4, 3, 4))
    add_exit_curvature(tether, sum(lengths) / 2.0, start, change, law, residual, tangent)
    work = float(np.sum(residual * change))
    q[3:, 0] = start[3, :3] + change[3, :3]
    carry_director(law, 0, _unit(start[3, :3]), _unit(q[3:, 0]))
    after, twist1 = exit_part(lengths[1], start[1, :3] + change[1, :3])
    by_length = exit_energy_by_length(tether, lengths, start, change, (twist0, twist1), law)
    assert abs(by_length) > 0.1 * abs(after - before)
    assert work + by_length == pytest.approx(after - before, rel=1e-10)


def test_the_curvature_at_a_fairlead_is_linear_between_places_counted_from_the_tip():
    tether, _, law = bent(9)
    law.curvature[:] = np.random.default_rng(1).normal(size=law.curvature.shape)
    length, count = tether.element_length, law.curvature.shape[1]
    for beyond, part in ((0, 1.0), (1, 0.5), (1, 1.0), (2, 0.25)):
        here = fairlead_curvature(tether, (beyond - 1 + part) * length, law)
        ends = law.curvature[:, ELEMENTS + beyond - 1], law.curvature[:, ELEMENTS + beyond]
        assert here == pytest.approx((1.0 - part) * ends[0] + part * ends[1])
    last = fairlead_curvature(tether, 3.0 * count * length, law)
    assert last == pytest.approx(law.curvature[:, -1])


def _unit(vector: Array) -> tuple[float, float, float]:
    x, y, z = vector / np.linalg.norm(vector)
    return float(x), float(y), float(z)


def test_twist_relaxes_to_the_least_energy_between_held_ends():
    tether, q, law = bent(3)
    ends = law.director[:, [0, ELEMENTS]].copy()
    energies = [energy_of(tether, q, law)]
    for _ in range(12):
        end_natural_curvature(tether, q, q, law)
        energies.append(energy_of(tether, q, law))
    heats = -np.diff(energies)
    assert min(heats) > -1e-9
    assert abs(heats[-1]) < 1e-9 < heats[0]
    assert law.director[:, [0, ELEMENTS]] == pytest.approx(ends)
    energy = energy_of(tether, q, law)
    kept = law.director.copy()
    for node in range(1, ELEMENTS):
        for angle in (0.05, -0.05):
            law.director[:] = kept
            slope = q[3:, node] / np.linalg.norm(q[3:, node])
            d = kept[:, node]
            law.director[:, node] = math.cos(angle) * d + math.sin(angle) * np.cross(slope, d)
            assert energy_of(tether, q, law) > energy


def test_the_moment_of_a_held_arc_relaxes_exponentially():
    """A standard linear solid that is bent at once: M = B kappa + B1 kappa exp(-t/tau)."""
    size, share, time, h = 1.5, 0.4, 3.0, 0.01
    tether = make_tether(TetherSection(100.0, 1.3, 0.02), 0.4, ELEMENTS, (0.0, 0.0, 0.0))
    width = row_width(ELEMENTS, 3)
    relaxation = BendingRelaxation(share, time)
    law = make_natural_curvature(width, 0.8, np.zeros((2, 1)), False, relaxation)
    q = np.zeros((6, width))
    arcs = np.linspace(0.0, 0.4, ELEMENTS + 1)
    q[0, : ELEMENTS + 1] = (1.0 - np.cos(size * arcs)) / size
    q[2, : ELEMENTS + 1] = -np.sin(size * arcs) / size
    q[3, : ELEMENTS + 1] = np.sin(size * arcs)
    q[5, : ELEMENTS + 1] = -np.cos(size * arcs)
    law.director[0, : ELEMENTS + 1] = np.cos(size * arcs)
    law.director[2, : ELEMENTS + 1] = np.sin(size * arcs)
    elastic = 0.5 * 1.3 * 0.4 * size**2  # of both parts, before anything relaxes
    heat = 0.0
    for step in range(1, 501):
        heat += relax_bending(tether, q, h, law)
        left = math.exp(-step * h / time)
        assert (
            pytest.approx(
                np.tile([size * (1.0 - left), 0.0], (ELEMENTS + 1, 1)), rel=1e-3, abs=1e-12
            )
            == law.relaxed[:, : ELEMENTS + 1].T
        )
        assert heat == pytest.approx(share * elastic * (1.0 - left**2), rel=2e-3)
    bending, _ = natural_energies(tether, q, NO_EXIT, law)
    assert elastic + bending == pytest.approx(elastic * (1.0 - share + share * left**2), rel=2e-3)


@pytest.mark.parametrize("h", [0.002, 0.5, 100.0])
def test_what_relaxes_dissipates_the_energy_that_it_sets_free(h: float):
    tether, q, law = bent(9)
    generator = np.random.default_rng(10)
    law = law._replace(relaxation=BendingRelaxation(0.3, 0.7))
    law.elastic[:] = law.curvature
    law.relaxed[:, : ELEMENTS + 1] = 5.0 * generator.normal(size=(2, ELEMENTS + 1))
    law.curvature[:] = 0.7 * law.elastic + 0.3 * law.relaxed
    before = energy_of(tether, q, law)
    heat = relax_bending(tether, q, h, law)
    assert heat > 0.0
    assert before - energy_of(tether, q, law) == pytest.approx(heat, rel=1e-9)
    if h == 100.0:  # wholly relaxed: the least energy of all relaxed curvatures
        least = energy_of(tether, q, law)
        for _ in range(5):
            law.relaxed[:, : ELEMENTS + 1] += 0.1 * generator.normal(size=(2, ELEMENTS + 1))
            law.curvature[:] = 0.7 * law.elastic + 0.3 * law.relaxed
            assert energy_of(tether, q, law) > least
            assert relax_bending(tether, q, h, law) > 0.0


def test_a_coiled_cable_rests_on_its_own_shape():
    """Without gravity a cable of the shape of its natural curvature is free of load, and stays.

    The curvature turns over along it: clamped ends hold a uniform one, and one that grows linearly.
    """
    length, largest = 0.6, 6.0
    turns = 2.0 * math.pi / length
    fine = np.linspace(0.0, length, 3001)
    angle = largest / turns * (1.0 - np.cos(turns * fine))
    tangent = np.stack([np.cos(angle), np.zeros_like(fine), np.sin(angle)], axis=1)
    middles = 0.5 * (tangent[1:] + tangent[:-1]) * (fine[1] - fine[0])
    shape = np.concatenate([np.zeros((1, 3)), np.cumsum(middles, axis=0)])[::600]
    times = np.linspace(0.0, 0.59, 60)
    still = np.ones((len(times), 1))
    ends = [
        EndMotion.from_table(
            times, still * shape[place], still * tangent[place], 15.0, np.array([0.0, 0.0, 1.0])
        )
        for place in (0, -1)
    ]
    cable = HeldCable(fine[::600], 24, gravity=0.0)
    motion = cable.motion(shape, shape, (ends[0], ends[1]), times, 0.005)
    laws = CableLaws(0.05, 0.02, 0.0, 0.0, 0.8)
    natural = np.zeros((2, 25))
    natural[0] = largest * np.sin(turns * cable.nodes)  # towards z, the reference of the frame
    own, reached = cable.simulate(laws, natural, motion)
    assert reached == len(times)
    off = np.abs(own[-1] - shape[1:-1]).max()
    assert off < 5e-4
    straight, _ = cable.simulate(laws, np.zeros((2, 25)), motion)
    assert np.abs(straight[-1] - shape[1:-1]).max() > max(5.0 * off, 2e-3)


def test_drag_follows_the_cross_flow_principle():
    drag = AirDrag(0.4, 0.02, (0.0, 0.0, 0.0))
    axis = (0.0, 0.0, 1.0)
    assert drag_force(drag, (3.0, 0.0, 0.0), axis)[0] == pytest.approx((-3.6, 0.0, 0.0))
    assert drag_force(drag, (0.0, 0.0, -2.0), axis)[0] == pytest.approx((0.0, 0.0, 0.08))
    oblique = drag_force(drag, (3.0, 4.0, 1.0), axis)[0]
    assert oblique == pytest.approx((-0.4 * 5.0 * 3.0, -0.4 * 5.0 * 4.0, -0.02))


def test_the_drag_s_derivative_is_that_of_the_force():
    drag = AirDrag(0.4, 0.1, (0.0, 0.0, 0.0))
    axis = (0.6, 0.0, 0.8)
    velocity = np.array([1.0, -2.0, 0.5])
    tangent = drag_force(drag, tuple(velocity), axis)[1]
    matrix = np.array([
        [tangent[0], tangent[1], tangent[2]],
        [tangent[1], tangent[3], tangent[4]],
        [tangent[2], tangent[4], tangent[5]],
    ])  # fmt: skip
    for k in range(3):
        move = np.zeros(3)
        move[k] = 1e-6
        ahead = np.array(drag_force(drag, tuple(velocity + move), axis)[0])
        behind = np.array(drag_force(drag, tuple(velocity - move), axis)[0])
        assert matrix[:, k] == pytest.approx((ahead - behind) / 2e-6, abs=1e-6)
