"""Conservation of energy and momentum in the planar plant, robustness, reported divergence."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from msg_schemas.phases import PlantPhase
from rover_sim import Outcome, PlanarPlant, PlanarState, Scenario, load_scenario, run
from rover_sim.physics.tether import ancf
from rover_verify.checks import CheckBatch, Measured, worst_of
from rover_verify.checks.jumps import random_jump


@worst_of("{runs} random jumps up to 0.5 GPa, 0.5 s at 1 ms")
def energy(_index: int, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Largest change of the stored energy over random undamped flights, relative to the jump's."""
    scenario = random_jump(generator, **{"rover.slider_damping": 0.0, "after_landing": "fly_on"})
    plant = PlanarPlant(scenario)
    start = plant.take_off(plant.initial_state())
    flight = run(plant, start, 0.5, tick=0.05)
    stored = np.array([plant.energies(state).stored for state in flight.states])
    change = float(np.max(np.abs(stored - stored[0]))) / scenario.take_off_energy
    yield f"n = {scenario.tether.elements}", change


@worst_of("{runs} random damped jumps and landings, 0.8 s at 1 ms")
def balance(_index: int, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Largest drift of the energy balance over random damped jumps, relative to the jump's."""
    scenario = random_jump(
        generator,
        **{
            "tether.axial_damping_time": float(10.0 ** generator.uniform(-4.0, -2.0)),
            "tether.bending_damping_time": float(10.0 ** generator.uniform(-2.0, 0.0)),
        },
    )
    plant = PlanarPlant(scenario)
    flight = run(plant, plant.take_off(plant.initial_state()), 0.8, tick=0.02)
    yield f"n = {scenario.tether.elements}", flight.energy_drift / scenario.take_off_energy


class _Afloat(PlanarPlant):
    """Tether and rover without gravity and without the root's support."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        tether = self._model.tether._replace(gravity=(0.0, 0.0))
        self._model = self._model._replace(tether=tether, root_pinned=False)


@worst_of("{runs} random flights without gravity and root, 0.3 s")
def momentum(_index: int, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Largest change of linear and angular momentum of tether and rover afloat, relative."""
    velocity = [float(value) for value in generator.uniform(-2.0, 2.0, 2)]
    scenario = random_jump(
        generator,
        **{
            "take_off.compression": None,
            "take_off.velocity": velocity,
            "take_off.tether_rates": "linear",
            "after_landing": "fly_on",
            "integration.tolerance": 1e-12,
        },
    )
    start = PlanarPlant(scenario).initial_state()
    plant = _Afloat(scenario)
    state = plant.take_off(start)
    flight = run(plant, state, 0.3, tick=0.1)
    before = _momenta(scenario, state)
    assert scenario.rover is not None
    size = scenario.rover.mass * math.hypot(*velocity)
    for later in flight.states[1:]:
        change = float(np.max(np.abs(_momenta(scenario, later) - before)))
        yield f"at {later.time:.1f} s", change / size


def _momenta(scenario: Scenario, state: PlanarState) -> ancf.Array:
    """Linear momentum and angular momentum about the origin."""
    rover, density = scenario.rover, scenario.tether.section.line_density
    assert rover is not None
    length = scenario.tether.length / scenario.tether.elements
    e, rates = ancf.element_coordinates(state.nodes), ancf.element_coordinates(state.node_rates)
    tensor = np.einsum("eai,ab,ebj->ij", e, ancf.mass_matrix(density, length), rates)
    linear = np.einsum("a,eai->i", ancf.load_vector(density, length), rates)
    spin = (rover.inertia1 + rover.inertia2) * state.omega
    angular = float(tensor[0, 1] - tensor[1, 0]) + spin
    for weight, at, rate in (
        (rover.m1, state.G1, state.G1_rate),
        (rover.m2, state.G2, state.G2_rate),
    ):
        linear = linear + weight * rate
        angular += float(weight * (at[0] * rate[1] - at[1] * rate[0]))
    return np.array([*linear, angular])


def robustness(batch: CheckBatch) -> Measured:
    """Number of random hard jumps that diverged, gained energy or were not finite."""
    bad = {}
    for index, generator in enumerate(batch.generators()):
        scenario = random_jump(
            generator,
            **{
                "tether.youngs_modulus": float(10.0 ** generator.uniform(7.0, math.log10(70e9))),
                "tether.elements": int(generator.integers(2, 101)),
                "integration.h": float(generator.uniform(5e-4, 2e-3)),
            },
        )
        plant = PlanarPlant(scenario)
        flight = run(plant, plant.take_off(plant.initial_state()), 0.7, tick=0.05)
        final, drift = flight.final, flight.energy_drift
        finite = np.all(np.isfinite(final.nodes)) and math.isfinite(final.theta)
        diverged = any(result.outcome is Outcome.DIVERGED for result in flight.results)
        if diverged or not finite or abs(drift) > 1e-5 * scenario.take_off_energy:
            what = "diverged" if diverged else f"drift {drift:.2e} J"
            bad[f"run {index}"] = f"{what}, {scenario.tether.elements} elements"
    return Measured.number_of(bad, f"of {batch.runs} jumps, n to 100, E to 70 GPa, h to 2 ms")


def divergence_is_reported(_batch: CheckBatch) -> Measured:
    """Number of fulfilled conditions, of four, of a diverged plant."""
    overrides = {"integration.tolerance": 1e-30, "integration.max_halvings": 0}
    plant = PlanarPlant(load_scenario("paper_table1_high", overrides))
    start = plant.take_off(plant.initial_state())
    flight = run(plant, start, 0.1)
    again = run(plant, flight.final, 0.1)
    conditions = {
        "the phase is diverged": flight.final.phase is PlantPhase.DIVERGED,
        "an event reports it": flight.event("diverged") is not None,
        "the last converged state is kept": bool(np.all(np.isfinite(flight.final.nodes))),
        "further steps leave it unchanged": again.final is flight.final
        or bool(np.array_equal(again.final.nodes, flight.final.nodes)),
    }
    details = {name: "pass" if fulfilled else "fail" for name, fulfilled in conditions.items()}
    return Measured(sum(conditions.values()), "a plant made to diverge", details)
