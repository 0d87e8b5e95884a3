"""Hard use of the spatial tether: throws with slack, snatches, whips."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from rover_sim import (
    Outcome,
    PlantCommand,
    SpatialPlant,
    SpatialState,
    StepResult,
    WinchCommand,
    load_spatial,
)
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.buckling import buckling_strain
from rover_verify.checks import CheckBatch, Measured
from rover_verify.checks.spatial_cases import make_plant, without_winch

_IDLE = PlantCommand()
_RADIUS = 3.45e-4  # of the source paper's tether [m]
_TICK = 0.02  # [s]
_FASTEST = 1.0  # beyond the winch's largest rate [m/s]
_TIGHT_BY = 6.0  # the slack is reeled in, and the rover hangs [s]
_STIFFEST = 70.0e9  # [Pa]


def _direction(generator: np.random.Generator) -> Array:
    """Random direction within 60 deg of the horizontal."""
    up, around = generator.uniform(-1.0, 1.0) * math.pi / 3.0, generator.uniform(0.0, 2.0 * math.pi)
    return np.array(
        [math.cos(up) * math.cos(around), math.cos(up) * math.sin(around), math.sin(up)]
    )


def thrown(generator: np.random.Generator, kind: str, **fixed: object) -> tuple[SpatialPlant, str]:
    """Plant with a straight tether, its tip (rover, weight, free) thrown towards the fairlead.

    Ranges: 2 to 100 elements, E from 10 MPa to 70 GPa, 2 to 10 m, axial damping 0 or 0.1 to 10 ms,
    1.62 or 9.81 m/s^2, thrown at up to 4 m/s; a `whip` has a free end and is released at rest.
    """
    elements = int(generator.integers(2, 101))
    modulus = float(10.0 ** generator.uniform(7.0, math.log10(_STIFFEST)))
    if generator.uniform() < 0.3:
        elements, modulus = 100, _STIFFEST
    length = float(generator.uniform(2.0, 10.0))
    damping = float(generator.choice([0.0, 10.0 ** generator.uniform(-4.0, -2.0)], p=[0.2, 0.8]))
    direction = _direction(generator)
    aside = generator.normal(size=3)
    speed = float(generator.uniform(0.5, 4.0))
    velocity = speed * (0.3 * aside / np.linalg.norm(aside) - direction)
    start: dict[str, object] = {"kind": "straight", "direction": direction.tolist()}
    overrides: dict[str, object] = {"environment.gravity": float(generator.choice([1.62, 9.81]))}
    if kind != "whip":
        start["tip_velocity"] = velocity.tolist()
    if kind != "rover":
        overrides["rover"] = None
        overrides["tip"] = {"mass": 0.0 if kind == "whip" else float(generator.uniform(1.0, 20.0))}
    plant = make_plant(
        without_winch(
            length,
            elements,
            youngs_modulus=modulus,
            radius=_RADIUS,
            density=float(generator.choice([1.0e3, 2.7e3, 1.0e4])),
            axial_damping_time=damping,
            bending_damping_time=float(10.0 ** generator.uniform(-3.0, -1.0)),
        ),
        overrides,
        {"start": start},
        fixed,
    )
    name = (
        f"{kind}, n = {elements}, {modulus / 1e9:.3g} GPa, {length:.1f} m, {damping * 1e3:.2g} ms"
    )
    return plant, name


def is_finite(state: SpatialState) -> bool:
    """Whether the state's arrays are finite."""
    arrays = (state.nodes, state.node_rates, state.fairlead_slope, state.body, state.memory)
    return all(bool(np.all(np.isfinite(array))) for array in arrays)


def fault(result: StepResult, state: SpatialState, scale: float, gain: float, loss: float) -> str:
    """Fault of a tick, or an empty string.

    The drift of the energy balance may reach the fractions `gain` and `loss` of the energy scale
    `scale` [J]. Losses are larger: rotors held by friction follow the body's rate one step later,
    which dissipates energy in proportion to the step.
    """
    if not is_finite(state):
        return "not finite"
    if result.outcome is Outcome.DIVERGED:
        return "diverged"
    drift = result.energies.drift
    if not -loss * scale <= drift <= gain * scale:
        return f"energy drift {drift:.2g} of {scale:.2g} J"
    if not result.constraint_drift < 1e-6:
        return f"distance of tether and rover attachment {result.constraint_drift:.2g} m"
    return ""


def _energy_scale(plant: SpatialPlant, state: SpatialState) -> float:
    """Energy scale [J]: energy of the throw, and of a fall by twice the tether's length."""
    scenario = plant.scenario
    weight = scenario.tip_mass + 0.5 * scenario.tether.section.line_density * scenario.tether.length
    energies = plant.energies(state)
    return energies.kinetic + 2.0 * weight * scenario.gravity * scenario.tether.length


def snatch(batch: CheckBatch) -> Measured:
    """Number of throws and whips at 1 ms that diverge, gain energy, or are not finite."""
    details: dict[str, float | str] = {}
    bad, most, least = 0, 0.0, 0.0
    for index, generator in enumerate(batch.generators()):
        plant, name = thrown(generator, ("rover", "weight", "whip")[index % 3])
        state = plant.initial_state()
        scale = _energy_scale(plant, state)
        wrong, peak, halved, smallest = "", 0.0, 0, math.inf
        for _ in range(round(3.0 / _TICK)):
            state, result = plant.step(state, _IDLE, _TICK)
            wrong = fault(result, state, scale, gain=1e-5, loss=1e-2)
            peak = max(peak, result.peak_tension)
            halved += result.outcome is Outcome.HALVED
            smallest = min(smallest, result.smallest_step)
            most = max(most, result.energies.drift / scale)
            least = min(least, result.energies.drift / scale)
            if wrong:
                break
        bad += bool(wrong)
        summary = f"peak {peak:.3g} N, {halved} ticks halved, to {smallest * 1e3:.3g} ms"
        details[f"run {index}: {name}"] = wrong or summary
    details["drift of the energy balance, largest gain, relative"] = most
    details["drift of the energy balance, largest loss, relative"] = least
    return Measured(bad, f"of {batch.runs} runs of 3 s at 1 ms, n to 100, E to 70 GPa", details)


_MESHES = (0.9, 0.45, 0.225)  # the demonstration's elements, and the converged ones [m]


def _peak(element_length: float) -> float:
    """Peak tension [N] of a snatch: the rover, thrown up the hanging tether, falls back into it."""
    plant = make_plant(
        {
            "winch": None,
            "tether.length": 45.0,
            "tether.max_length": None,
            "tether.element_length": element_length,
            "start": {
                "kind": "straight", "direction": [0.0, 0.0, -1.0], "tip_velocity": [0.0, 0.0, 1.0],
            },
        }
    )  # fmt: skip
    state, _ = plant.step(plant.initial_state(), _IDLE, 0.5)
    _, result = plant.step(state, _IDLE, 1.3)
    return result.peak_tension


def coarse_snatch(_batch: CheckBatch) -> Measured:
    """Relative error of a snatch's peak tension in elements of 0.9 m."""
    return _compared({length: _peak(length) for length in _MESHES}, 0.9)


def _compared(peaks: Mapping[float, float], coarse: float) -> Measured:
    """Relative error of the peak tension [N] in elements of a length [m] beside the shortest."""
    converged = peaks[min(peaks)]
    details = {f"peak in elements of {length:g} m [N]": peak for length, peak in peaks.items()}
    note = f"peak {peaks[coarse]:.2f} N, converged {converged:.2f} N"
    return Measured(abs(peaks[coarse] / converged - 1.0), note, details)


_TIGHTENING_MESHES = ((0.9, 2e-3), (0.5, 2e-3), (0.25, 2e-3), (0.1, 5e-4))  # [m], step [s]


def _tightening_peak(element_length: float, h: float) -> float:
    """Peak tension [N] where the winch tightens the tether that lies slack on a floor of rock."""
    overrides: dict[str, object] = {
        "environment.floor.material": "rock",
        "environment.relief": None,
        "environment.boulders": None,
        "tether.length": 8.0,
        "tether.element_length": element_length,
        "integration.h": h,
    }
    plant = SpatialPlant(load_spatial("floor_rubble", overrides))
    state, peak = plant.initial_state(), 0.0
    command = PlantCommand(winch=WinchCommand(length=0.0, rate=-_FASTEST))
    while state.time < _TIGHT_BY:
        state, result = plant.step(state, command, _TICK)
        peak = max(peak, result.peak_tension)
    return peak


def tightening(_batch: CheckBatch) -> Measured:
    """Relative error of the peak tension of a tether that is tightened, in elements of 0.25 m."""
    return _compared({size: _tightening_peak(size, h) for size, h in _TIGHTENING_MESHES}, 0.25)


def push(_batch: CheckBatch) -> Measured:
    """Largest push of a tether paid out at 3 m/s for 0.4 s, over its buckling load."""
    details: dict[str, float | str] = {}
    worst = 0.0
    for length in (1.0, 0.25, 0.05):
        plant = make_plant({"tether.element_length": length})
        state, least = plant.initial_state(), 0.0
        command = PlantCommand(winch=WinchCommand(length=40.0, rate=3.0))
        for _ in range(20):
            state, _ = plant.step(state, command, _TICK)
            least = min(least, float(plant.tension(state).min()))
        section = plant.scenario.tether.section
        load = section.axial_stiffness * buckling_strain(section, length, plant.scenario.gravity)
        worst = max(worst, -least / load)
        details[f"push in elements of {length:g} m [N]"] = -least
        details[f"buckling load in elements of {length:g} m [N]"] = load
    return Measured(worst, "in elements of 0.05, 0.25 and 1 m", details)
