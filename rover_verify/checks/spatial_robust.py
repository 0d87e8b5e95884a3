"""Random machines, environments and commands in space: no divergence, no energy from nowhere."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from msg_schemas.events import PlantEvent
from msg_schemas.phases import PlantPhase
from rover_sim import (
    FlywheelCommand,
    JumpMotorCommand,
    Outcome,
    PlantCommand,
    SettlingError,
    SpatialPlant,
    SpatialState,
    WheelRateCommand,
    WheelTorqueCommand,
    WinchCommand,
    load_spatial,
)
from rover_verify.checks import CheckBatch, Measured
from rover_verify.checks.flights import fly_batch
from rover_verify.checks.spatial_snatch import fault, is_finite

# Ranges of the random values by dotted path; log-uniform where `LOGARITHMIC`, else uniform. The
# longest step is the longest that a scenario accepts with the servos of the default machine.
RANGES: Mapping[str, tuple[float, float]] = {
    "tether.axial_stiffness": (2.0e3, 1.0e5),  # [N]
    "tether.bending_stiffness": (1.0e-6, 1.0e-2),  # [N m^2]
    "tether.line_density": (1.0e-3, 5.0e-2),  # [kg/m]
    "tether.axial_damping_time": (1.0e-3, 5.0e-2),  # [s]
    "tether.bending_damping_time": (1.0e-3, 0.2),  # [s]
    "tether.element_length": (0.3, 1.2),  # [m]
    "tether.twist_stiffness": (1.0e-6, 1.0e-2),  # [N m^2]
    "tether.swivel_friction": (1.0e-7, 1.0e-2),  # [N m]
    "environment.gravity": (0.5, 10.0),  # [m/s^2]
    "rover.m1": (0.2, 12.0),  # [kg]
    "rover.m2": (0.05, 6.0),  # [kg]
    "rover.slider.spring_rate": (300.0, 2.0e3),  # [N/m]
    "winch.friction.viscous": (1.0e-3, 2.0e-2),  # [N m s/rad]
    "winch.drum_inertia": (1.0e-4, 2.0e-3),  # [kg m^2]
    "winch.motor_inertia": (1.0e-9, 1.0e-5),  # [kg m^2]
    "integration.h": (2.5e-4, 2.0e-2),  # [s]
}
# The same for machines and steps whose energy balance shall close well.
RESOLVED: Mapping[str, tuple[float, float]] = {
    **RANGES,
    "rover.m1": (4.0, 12.0),
    "rover.m2": (0.5, 6.0),
    "integration.h": (2.5e-4, 4.0e-3),
}
MACHINES: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "accepted": RANGES,
    "resolved": RESOLVED,
}
LOGARITHMIC = frozenset(RANGES) - {"environment.gravity"}
STARTS: Mapping[str, tuple[float, float]] = {
    "start.swing_angle": (-60.0, 60.0),  # [deg]
    "start.swing_heading": (-180.0, 180.0),
    "start.swing_rate": (-20.0, 20.0),  # [deg/s]
    "start.cone_rate": (-20.0, 20.0),
    "start.heading": (-180.0, 180.0),
    "start.twist": (-180.0, 180.0),
    "start.payout_rate": (-0.5, 0.5),  # [m/s]
}
# Commands, redrawn or kept at every tick of 0.2 s: rates and torques within the contract's limits.
PAYOUT_RATE, WHEEL_RATE, WHEEL_TORQUE, FLYWHEEL_TORQUE = 0.5, 8.0, 2.0, 0.15
DURATION, TICK = 5.0, 0.2  # [s]
# Events by which the plant reports that the results from then on are doubtful.
_REPORTS = {PlantEvent.DIVERGED, PlantEvent.ENERGY_DRIFT}
# Largest drift of the energy balance, relative to the energy scale, as gain and as loss; a smaller
# drift has its own requirement.
GAIN, LOSS = 1.0e-2, 1.0e-2


@dataclass(frozen=True)
class MachineTrial:
    """A scenario by name and overrides, and the seed of its commands."""

    scenario: str
    overrides: Mapping[str, object]
    seed: int

    def __str__(self) -> str:
        """One line that reproduces the trial."""
        values = ", ".join(
            f"{path}: {value:.6g}" if isinstance(value, float) else f"{path}: {value}"
            for path, value in self.overrides.items()
        )
        return f"{self.scenario} seed {self.seed} {{{values}}}"


def random_trial(
    generator: np.random.Generator, ranges: Mapping[str, tuple[float, float]] = RANGES
) -> MachineTrial:
    """Random trial: the rover hangs free, hangs over a floor, or stands in rubble."""

    def drawn(low: float, high: float) -> float:
        return float(generator.uniform(low, high))

    overrides: dict[str, Any] = {}
    for path, (low, high) in ranges.items():
        if path in LOGARITHMIC:
            overrides[path] = math.exp(drawn(math.log(low), math.log(high)))
        else:
            overrides[path] = drawn(low, high)
    kind = str(generator.choice(["free", "floor", "rubble"]))
    if kind == "rubble":
        overrides["environment.seed"] = int(generator.integers(1000))
        overrides["start.heading"] = drawn(-180.0, 180.0)
        return MachineTrial("floor_rubble", overrides, int(generator.integers(2**31)))
    for path, bounds in STARTS.items():
        overrides[path] = drawn(*bounds)
    overrides["start.tilt"] = generator.uniform(-30.0, 30.0, 3).tolist()
    overrides["start.body_rate"] = generator.uniform(-60.0, 60.0, 3).tolist()
    length = drawn(3.0, 20.0)
    overrides["tether.length"] = length
    if kind == "floor":
        # Near enough below the rover for an impact or a swing into it.
        clearance, slope = drawn(0.8, 2.0), drawn(0.0, 20.0)
        material, swing = str(generator.choice(["rock", "regolith"])), drawn(-20.0, 20.0)
        angle, heading = math.radians(swing), math.radians(overrides["start.swing_heading"])
        rise = -math.tan(math.radians(slope)) * math.sin(angle) * math.cos(heading)
        height = -length * (math.cos(angle) + rise) - clearance
        overrides["environment.floor"] = {"height": height, "slope": slope, "material": material}
        overrides["start.swing_angle"] = swing
    return MachineTrial("free_hang", overrides, int(generator.integers(2**31)))


def random_command(generator: np.random.Generator, plant: SpatialPlant) -> PlantCommand:
    """Random command to all drives or some of them."""

    def drawn(limit: float) -> float:
        return float(generator.uniform(-limit, limit))

    jump: JumpMotorCommand | FlywheelCommand | None = None
    wheel: WheelRateCommand | WheelTorqueCommand | None = None
    winch = None
    if generator.uniform() < 0.8:
        weight = plant.scenario.tip_mass * plant.scenario.gravity
        winch = WinchCommand(
            10.0,
            drawn(PAYOUT_RATE),
            feed_forward=float(generator.uniform(0.0, 1.5)) * weight,
            brake_released=bool(generator.uniform() < 0.9),
        )
    choice = generator.uniform()
    if choice < 0.4:
        jump = FlywheelCommand(drawn(FLYWHEEL_TORQUE))
    elif choice < 0.8:
        jump = JumpMotorCommand(float(generator.uniform(-0.05, 0.15)), 0.1)
    choice = generator.uniform()
    if choice < 0.4:
        wheel = WheelRateCommand(drawn(WHEEL_RATE))
    elif choice < 0.8:
        wheel = WheelTorqueCommand(drawn(WHEEL_TORQUE))
    return PlantCommand(jump=jump, winch=winch, wheel=wheel)


def _implausible(plant: SpatialPlant, state: SpatialState) -> str:
    """Implausible property of a state's tether, or an empty string."""
    nodes = plant.to_full_nodes(state)
    stretch = np.linalg.norm(nodes[:, 1], axis=1)
    if not np.all((stretch > 0.3) & (stretch < 2.0)):
        return f"a slope of {stretch.min():.3f} to {stretch.max():.3f}"
    gaps = np.linalg.norm(np.diff(nodes[:, 0], axis=0), axis=1)
    arcs = np.diff(plant.to_arc_lengths(state))
    if not np.all(gaps < 1.5 * arcs):
        return f"an element stretched to {np.max(gaps / arcs):.3f}"
    return ""


def faults(trial: MachineTrial, duration: float = DURATION) -> tuple[str, dict[str, float]]:
    """Run a trial for `duration` [s]; returns its fault (or an empty string) and metrics.

    A fault is what the plant does not report: a run ends without one where the plant reports that
    it diverged or that its energy balance does not close.
    """
    plant = SpatialPlant(load_spatial(trial.scenario, trial.overrides))
    metrics = {"gain": 0.0, "loss": 0.0, "halved": 0.0, "touched": 0.0}
    try:
        state = plant.initial_state()
    except SettlingError as error:
        # A reported refusal is not a fault.
        metrics["unsettled"] = 1.0
        return ("" if str(error) else "a refusal without a message"), metrics
    generator = np.random.default_rng(trial.seed)
    start = plant.energies(state)
    mass, gravity = plant.scenario.tip_mass, plant.scenario.gravity
    scale = start.kinetic + start.rotors + mass * gravity * 0.5 * plant.scenario.tether.length
    command, heats = PlantCommand(), dict(state.energy_balance)
    for _ in range(round(duration / TICK)):
        if generator.uniform() < 0.5:
            command = random_command(generator, plant)
        before = state
        state, result = plant.step(state, command, TICK)
        energies = result.energies
        scale = max(scale, energies.kinetic + energies.rotors, energies.dissipated)
        metrics["gain"] = max(metrics["gain"], energies.drift / scale)
        metrics["loss"] = min(metrics["loss"], energies.drift / scale)
        metrics["halved"] += result.outcome is Outcome.HALVED
        metrics["touched"] += state.phase is PlantPhase.GROUNDED
        if state.phase is PlantPhase.TETHER_BROKEN:
            has_event = any(event.name == PlantEvent.TETHER_BROKEN for event in result.events)
            return ("" if has_event else "broken without an event"), metrics
        if is_finite(state) and _REPORTS & {event.name for event in result.events}:
            metrics["reported"] = 1.0
            return "", metrics
        wrong = fault(result, state, scale, GAIN, LOSS) or _implausible(plant, state)
        if not wrong and not math.isclose(state.time, before.time + TICK, abs_tol=1e-9):
            wrong = f"the tick ended at {state.time - before.time:.6f} s"
        for name, heat in state.energy_balance.items():
            if name.startswith("heat") and heat < heats[name] - 1e-3 * scale:
                wrong = wrong or f"{name} fell by {heats[name] - heat:.2g} J"
        heats = dict(state.energy_balance)
        if wrong:
            return f"{wrong} at {state.time:.2f} s", metrics
    return "", metrics


class RobustRun(NamedTuple):
    """A random trial, its fault (or an empty string), and its metrics."""

    trial: MachineTrial
    fault: str
    metrics: Mapping[str, float]


def fly_random(seed: int, index: int, machines: str) -> RobustRun:
    """Run one random trial of `MACHINES`."""
    trial = random_trial(np.random.default_rng([seed, index]), MACHINES[machines])
    return RobustRun(trial, *faults(trial))


def random_machines(batch: CheckBatch) -> Measured:
    """Number of random runs that give NaN, create energy or fail otherwise without a report."""
    flown = fly_batch(batch, batch.runs, fly_random, "accepted")
    details: dict[str, float | str] = {
        f"run {index}: {run.trial}": run.fault for index, run in enumerate(flown) if run.fault
    }
    bad = len(details)
    details |= {
        "runs with ground contact": sum(run.metrics["touched"] > 0.0 for run in flown),
        "runs with halved steps": sum(run.metrics["halved"] > 0.0 for run in flown),
        "runs refused because settling failed": sum("unsettled" in run.metrics for run in flown),
        "runs that reported their end": sum("reported" in run.metrics for run in flown),
        "largest gain of the energy balance, relative": max(r.metrics["gain"] for r in flown),
        "largest loss of the energy balance, relative": min(r.metrics["loss"] for r in flown),
    }
    return Measured(bad, f"of {batch.runs} machines, {DURATION:g} s of random commands", details)


def energy_gap(batch: CheckBatch) -> Measured:
    """Largest drift of the energy balance in resolved random runs, relative to the energy scale."""
    gaps = {
        f"run {index}: {run.trial}": max(run.metrics["gain"], -run.metrics["loss"])
        for index, run in enumerate(fly_batch(batch, batch.runs, fly_random, "resolved"))
    }
    return Measured.largest(gaps, f"{batch.runs} machines, {DURATION:g} s of random commands")
