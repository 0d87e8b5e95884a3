"""The redundant DAE by itself, and the assembled integrator against it."""

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from mass_matrix import mass_matrix

from rover_sim.physics.references.planar_dae import DEFAULT_STABILISATION, DaeTrajectory, PlanarDae
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.statics import nodal_forces
from rover_sim.plants.planar_plant import PlanarPlant, PlanarState
from rover_sim.plants.plant import PlantCommand
from rover_sim.scenarios.scenario import Scenario, load_planar

Record = Callable[[str, object], None]
UNDAMPED_SLIDER = {"rover.slider_damping": 0.0}
EVERYTHING_DAMPED = {
    "tether.axial_damping_time": 2e-3,
    "tether.bending_damping_time": 0.5,
    "rover.slider_damping": 30.0,
    "rover.attachment": [-0.10, 0.07],
    "start.slack": 0.5,
}


def dae_of(scenario: Scenario, stabilisation: float = DEFAULT_STABILISATION) -> PlanarDae:
    assert scenario.rover is not None
    return PlanarDae(
        scenario.tether.section,
        scenario.tether.length,
        scenario.tether.elements,
        scenario.rover,
        scenario.gravity,
        stabilisation=stabilisation,
    )


def take_off(scenario: Scenario) -> PlanarState:
    plant = PlanarPlant(scenario)
    return plant.take_off(plant.initial_state())


@pytest.fixture
def disturbed() -> tuple[PlanarDae, Array, Array]:
    """A damped DAE at coordinates and rates that fulfil no constraint."""
    scenario = load_planar("paper_table1_high", EVERYTHING_DAMPED)
    dae = dae_of(scenario)
    generator = np.random.default_rng(11)
    q, _ = dae.coordinates(take_off(scenario))
    return (
        dae,
        q + 0.05 * generator.standard_normal(q.shape),
        generator.standard_normal(q.shape),
    )


class TestEquations:
    def test_counts(self, disturbed: tuple[PlanarDae, Array, Array]):
        dae, q, _ = disturbed
        n = dae.elements
        assert q.shape == (8 * n + 6,)
        jacobian = dae.jacobian(q)
        assert jacobian.shape == (4 * n + 2, 8 * n + 6)
        assert np.linalg.matrix_rank(jacobian) == 4 * n + 2

    def test_derivatives_of_the_constraints(self, disturbed: tuple[PlanarDae, Array, Array]):
        dae, q, rate = disturbed
        small = 1e-6
        there, back = q + small * rate, q - small * rate
        change = (dae.constraints(there) - dae.constraints(back)) / (2.0 * small)
        assert change == pytest.approx(dae.jacobian(q) @ rate, abs=1e-8)
        turn = (dae.jacobian(there) - dae.jacobian(back)) @ rate / (2.0 * small)
        assert turn == pytest.approx(dae.quadratic_velocity_terms(q, rate), abs=1e-8)
        assert np.max(np.abs(turn)) > 0.1

    def test_forces_at_rest_are_the_slope_of_the_energy(
        self, disturbed: tuple[PlanarDae, Array, Array]
    ):
        dae, q, move = disturbed
        rest, small = np.zeros_like(q), 1e-6
        slope = dae.energy(q + small * move, rest) - dae.energy(q - small * move, rest)
        force = dae.forces(q, rest)
        assert slope / (2.0 * small) == pytest.approx(-force @ move, rel=1e-6)

    def test_damping_dissipates_energy_but_not_in_a_rigid_motion(
        self, disturbed: tuple[PlanarDae, Array, Array]
    ):
        dae, q, rate = disturbed
        rest = np.zeros_like(q)
        assert (dae.forces(q, rate) - dae.forces(q, rest)) @ rate < -1e-3
        spin = 3.0
        rigid = np.empty_like(q)
        vectors = q[:-6].reshape(-1, 2, 2)
        rigid[:-6] = (spin * np.stack([-vectors[..., 1], vectors[..., 0]], axis=-1)).ravel()
        for body in (-6, -3):
            x, y, _ = q[body : body + 3 or None]
            rigid[body : body + 3 or None] = (-spin * y, spin * x, spin)
        difference = dae.forces(q, rigid) - dae.forces(q, rest)
        assert difference == pytest.approx(0.0, abs=1e-9)

    def test_element_matrices_agree_with_the_quadrature_of_the_assembled_model(self):
        scenario = load_planar("paper_table1_high")
        dae, section = dae_of(scenario), scenario.tether.section
        generator = np.random.default_rng(5)
        e = generator.standard_normal((5, 4, 2))
        q = np.concatenate([e.ravel(), np.zeros(6)])
        q[-2] = 0.2
        held = [nodal_forces(each.reshape(2, 2, 2), section, 1.0, (0.0, -9.81)) for each in e]
        forces = dae.forces(q, np.zeros_like(q))[:-6].reshape(5, 2, 2, 2)
        assert forces == pytest.approx(-np.array(held), rel=1e-11, abs=1e-9)
        moving = np.concatenate([e.ravel(), np.zeros(6)])
        kinetic = dae.energy(np.zeros_like(q), moving) - dae.energy(np.zeros_like(q), 0 * moving)
        mass = mass_matrix(section.line_density, 1.0)
        assert kinetic == pytest.approx(0.5 * np.einsum("nai,ab,nbi->", e, mass, e), rel=1e-12)


class TestMotion:
    @pytest.mark.parametrize("stabilisation", [5.0, 20.0, 100.0])
    def test_constraints_hold_over_four_seconds(self, stabilisation: float):
        scenario = load_planar("paper_table1_high")
        flight = dae_of(scenario, stabilisation).integrate(take_off(scenario), 4.0, 1e-3, 100)
        assert flight.largest_constraint < 1e-8
        assert flight.bodies[-1, 0, 1] < -4.0  # it fell past its start and the tether caught it

    def test_too_strong_a_stabilisation_fails(self):
        scenario = load_planar("paper_table1_high")
        with pytest.raises(ArithmeticError, match="not finite at"):
            dae_of(scenario, 3000.0).integrate(take_off(scenario), 4.0, 1e-3)

    def test_the_error_falls_with_the_fourth_power_of_the_step(self):
        scenario = load_planar("paper_table1_low", UNDAMPED_SLIDER)
        dae, start = dae_of(scenario), take_off(scenario)
        ends = [dae.integrate(start, 0.2, h).nodes[-1] for h in (4e-3, 2e-3, 1e-3)]
        ratio = np.max(np.abs(ends[0] - ends[1])) / np.max(np.abs(ends[1] - ends[2]))
        assert 12.0 < ratio < 40.0

    def test_energy_without_damping_is_conserved_to_the_order_of_the_method(self):
        scenario = load_planar("paper_table1_low", UNDAMPED_SLIDER)
        dae, start = dae_of(scenario), take_off(scenario)
        drifts = []
        for h in (4e-3, 2e-3, 1e-3):
            energy = dae.integrate(start, 0.2, h).energy
            drifts.append(np.max(np.abs(energy - energy[0])))
        assert drifts[2] < 2e-5
        assert drifts[0] > 10.0 * drifts[1] > 100.0 * drifts[2]

    def test_energy_with_damping_never_increases(self):
        scenario = load_planar("paper_table1_high", EVERYTHING_DAMPED)
        energy = dae_of(scenario).integrate(take_off(scenario), 0.2, 2.5e-4).energy
        assert np.all(np.diff(energy) < 0.0)
        assert energy[0] - energy[-1] > 1e-3

    @pytest.mark.slow
    def test_the_taut_jump_agrees_with_independent_codes(self):
        scenario = load_planar("taut_jump", {"tether.elements": 10})
        flight = dae_of(scenario).integrate(take_off(scenario), 0.3, 2.5e-4, 1200)
        body1 = flight.bodies[-1, 0]
        assert body1[:2] == pytest.approx([4.82477, -1.98151], abs=3e-5)
        assert body1[2] == pytest.approx(-0.04219, abs=2e-4)

    @pytest.mark.parametrize("duration", [0.0, -1.0, 0.00037])
    def test_a_duration_that_is_not_a_whole_number_of_steps_is_refused(self, duration: float):
        scenario = load_planar("paper_table1_low")
        with pytest.raises(ValueError, match="whole number of steps"):
            dae_of(scenario).integrate(take_off(scenario), duration, 1e-3)


class TestAgainstTheAssembledModel:
    """Two codes that share only the tether's constants, over 0.2 s."""

    duration = 0.2

    def reference(self, scenario: Scenario, h: float) -> DaeTrajectory:
        steps = round(self.duration / h)
        return dae_of(scenario).integrate(take_off(scenario), self.duration, h, steps)

    def assembled(self, scenario: Scenario, h: float) -> PlanarState:
        plant = PlanarPlant(scenario.with_overrides({"integration.h": h}))
        state, _ = plant.step(take_off(scenario), PlantCommand(), self.duration)
        return state

    def difference(self, state: PlanarState, reference: DaeTrajectory) -> float:
        """Largest difference of nodes' positions, bodies' centres [m] and angles [rad]."""
        bodies = np.array([[*state.G1, state.theta], [*state.G2, state.theta]])
        return max(
            float(np.max(np.abs(state.nodes[:, 0] - reference.nodes[-1, :, 0]))),
            float(np.max(np.abs(bodies - reference.bodies[-1]))),
        )

    @pytest.mark.parametrize(
        ("name", "overrides", "reference_step", "steps"),
        [
            pytest.param(
                "paper_table1_low",
                {"start.geometry": "+K", "start.slack": 2.0, "start.theta0": 20.0},
                2.5e-4,
                (2.5e-4, 1.25e-4, 6.25e-5),
                id="soft and slack",
            ),
            pytest.param(
                "paper_table1_high", EVERYTHING_DAMPED, 2.5e-4, (5e-4, 2.5e-4, 1.25e-4), id="damped"
            ),
            pytest.param(
                "taut_jump", {"tether.elements": 8}, 2.5e-4, (5e-4, 2.5e-4, 1.25e-4), id="taut"
            ),
            pytest.param(
                "paper_table1_high",
                {},
                1.25e-4,
                (6.25e-5, 3.125e-5, 1.5625e-5),
                id="stiff and undamped",
            ),
        ],
    )
    def test_the_difference_falls_with_the_square_of_the_step(
        self,
        name: str,
        overrides: dict[str, Any],
        reference_step: float,
        steps: tuple[float, ...],
        record_property: Record,
    ):
        scenario = load_planar(name, {**overrides, "integration.tolerance": 1e-12})
        reference = self.reference(scenario, reference_step)
        assert reference.largest_constraint < 1e-10
        differences = [self.difference(self.assembled(scenario, h), reference) for h in steps]
        assert differences[-1] < 1e-6
        for coarse, fine in itertools.pairwise(differences):
            record_property("order", math.log2(coarse / fine))
            assert 3.0 < coarse / fine < 5.2

    def test_the_comparison_detects_a_wrong_parameter(self):
        scenario = load_planar("paper_table1_high", EVERYTHING_DAMPED)
        reference = self.reference(scenario, 2.5e-4)
        for path, value in (
            ("rover.body2_size", [0.25, 0.10]),
            ("rover.attachment", [-0.10, 0.069]),
            ("tether.axial_damping_time", 2.1e-3),
            ("tether.bending_damping_time", 0.55),
            ("gravity", 9.811),
        ):
            other = scenario.with_overrides({path: value})
            plant = PlanarPlant(other.with_overrides({"integration.h": 1.25e-4}))
            start = take_off(scenario)
            state, _ = plant.step(start, PlantCommand(), self.duration)
            assert self.difference(state, reference) > 1e-6, path
