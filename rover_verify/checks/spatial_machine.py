"""The spatial plant's drives: jumps from the floor, screw, flywheel."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from scipy.integrate import quad

from msg_schemas.events import PlantEvent
from rover_sim import (
    FlywheelCommand,
    JumpMotorCommand,
    PlantCommand,
    SpatialPlant,
    SpatialState,
    load_spatial,
)
from rover_sim.physics.mechanisms.shaft import FrictionParameters
from rover_sim.scenarios.hardware import RoverSettings, jump_height
from rover_verify.checks import CheckBatch, Measured, worst_of
from rover_verify.checks.spatial_cases import make_plant

_IDLE = PlantCommand()
_MOON = 1.62  # [m/s^2]

# A bare level floor with a standing rover and a slack tether.
_STANDING: dict[str, object] = {
    "environment.relief": None,
    "environment.boulders": None,
    "start.position": [1.5, 0.0],
    "tether.length": 8.0,
}


def _standing(overrides: Mapping[str, object], material: str = "rock") -> SpatialPlant:
    floor = {"height": -4.0, "material": material}
    return SpatialPlant(
        load_spatial("floor_rubble", {**_STANDING, "environment.floor": floor, **overrides})
    )


# --------------------------------------------------------------------------------------- jump

# The closed form has a rigid floor and no slider friction. A light Body 2 hits the end stop within
# a fraction of a millisecond.
_UNYIELDING: dict[str, object] = {
    "environment.rock": {"stiffness": 1.0e8, "damping": 1.0e3},
    "rover.slider.damping": 0.0,
    "rover.slider.friction": 0.0,
    "integration.h": 1.0e-4,
}
_NUT_RATE = 0.09  # a little below the flywheel's saturation [m/s]
# Masses of Bodies 1 and 2 [kg] and compression [m] of the default rover and the source paper.
_KNOWN = ((6.0, 4.0, 0.20), (3.0, 2.0, 0.20), (10.0, 0.5, 0.20), (10.0, 0.05, 0.20))


def jump_heights(batch: CheckBatch) -> Measured:
    """Largest relative deviation of a jump's height from the closed form, full cycle on a floor.

    The nut moves down to the latch and compresses to the stroke, the latch trips, and Body 2 pulls
    Body 1 along. The height is the rise of the common centre of mass above that of the standing
    rover with a relaxed spring.
    """
    worst, details = 0.0, {}
    for name, (m1, m2, compression) in _jumps(batch):
        overrides = {"rover.m1": m1, "rover.m2": m2}
        rover, found = _jump(_standing({**_UNYIELDING, **overrides}), compression)
        error = abs(found / jump_height(rover, _MOON, compression) - 1.0)
        details[f"{name}: {m1:.3g} + {m2:.3g} kg, {compression:.3f} m"] = error
        worst = max(worst, error)
    for material in ("rock", "regolith"):
        rover, found = _jump(_standing({}, material), 0.20)
        ratio = found / jump_height(rover, _MOON, 0.20)
        details[f"default rover on a yielding floor of {material}, height over closed form"] = ratio
    note = "unyielding floor, slider without friction, 0.1 ms"
    return Measured(worst, f"{len(_KNOWN)} known and {batch.runs} random cycles, {note}", details)


def _jumps(batch: CheckBatch) -> Iterator[tuple[str, tuple[float, float, float]]]:
    for case in _KNOWN:
        yield "known", case
    for index, generator in enumerate(batch.generators()):
        mass = float(generator.uniform(4.0, 15.0))
        share = float(generator.uniform(0.1, 0.5))
        compression = float(generator.uniform(0.12, 0.20))
        yield f"run {index}", ((1.0 - share) * mass, share * mass, compression)


def _jump(plant: SpatialPlant, compression: float) -> tuple[RoverSettings, float]:
    """The rover, and the rise of its centre of mass in a jump [m]."""
    rover = plant.scenario.rover
    assert rover is not None
    state = plant.initial_state()
    start = float(state.G1[2])
    charge = PlantCommand(jump=JumpMotorCommand(compression, _NUT_RATE))
    released = False
    while not released:
        state, result = plant.step(state, charge, 0.01)
        released = any(event.name == PlantEvent.LATCH_RELEASED for event in result.events)
        if state.time > 30.0:
            raise RuntimeError(f"the latch is {state.latch.name} after {state.time:.3g} s")
    best, until = -math.inf, state.time + 3.0
    while state.time < until:
        state, result = plant.step(state, _IDLE, 0.002)
        slide = state.s * float(state.rotation[2, 2]) - rover.slider.free_length
        rise = float(state.G1[2]) - start + rover.m2 / rover.mass * slide
        if rise < best - 1.0e-3:
            break
        best = max(best, rise)
    return rover, best


# -------------------------------------------------------------------------------------- screw

_FINE = 1.0e-3  # [s]


class _Stroke(NamedTuple):
    """Measured and expected work of the motor in a stroke of the nut."""

    motor: float  # measured [J]
    expected: float  # [J]


@worst_of("{runs} strokes down and up again, latch held")
def screw(_index: int, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Largest error of the screw's work balance, relative to the motor's work in compression.

    In compression the motor's work is the load's work over the efficiency; in let-down the load
    returns its work times 2 - 1/efficiency; the shaft's friction adds in both directions. The
    load's work is the energy change of spring, gravity and slider.
    """
    efficiency = float(generator.uniform(0.6, 0.95))
    lead = float(generator.uniform(1.5e-3, 3.0e-3))
    depth = float(generator.uniform(0.08, 0.19))
    rate = float(generator.uniform(0.02, 0.05))
    plant = _standing({"rover.jump_drive.efficiency": efficiency, "rover.jump_drive.lead": lead})
    hooked, _ = _sent(plant, plant.initial_state(), 0.015, rate)
    pressed, down = _sent(plant, hooked, depth, rate)
    _, up = _sent(plant, pressed, 0.015, rate)
    name = f"efficiency {efficiency:.2f}, lead {lead * 1e3:.2f} mm"
    for direction, stroke in (("compressing", down), ("letting down", up)):
        error = abs(stroke.motor - stroke.expected) / down.expected
        yield f"{name}, {direction} {stroke.motor:+.3f} J", error


def _sent(
    plant: SpatialPlant, state: SpatialState, position: float, rate: float
) -> tuple[SpatialState, _Stroke]:
    """Move the nut to a position and wait until all is at rest."""
    rover = plant.scenario.rover
    assert rover is not None
    drive = rover.jump_drive
    order = PlantCommand(jump=JumpMotorCommand(position, rate, trips=False))
    begin, start = state, plant.energies(state)
    friction, before = 0.0, state.flywheel_rate
    for _ in range(round((abs(position - state.nut) / rate + 4.0) / _FINE)):
        state, _ = plant.step(state, order, _FINE)
        mean = 0.5 * (before + state.flywheel_rate)
        before = state.flywheel_rate
        friction += abs(mean) * _friction(drive.friction, mean) * _FINE
    end = plant.energies(state)
    spent = {
        name: value - begin.energy_balance[name] for name, value in state.energy_balance.items()
    }
    # Work of the nut: energy stored and dissipated outside the drive.
    load = end.stored - start.stored
    load += sum(
        value
        for name, value in spent.items()
        if name.startswith("heat") and name != "heat_jump_drive"
    )
    share = 1.0 / drive.efficiency if load > 0.0 else 2.0 - 1.0 / drive.efficiency
    return state, _Stroke(spent["input_jump_motor"], load * share + friction)


def _friction(law: FrictionParameters, rate: float) -> float:
    """Friction torque of a turning shaft: Stribeck's curve plus a viscous part [N m]."""
    ratio = rate / law.stribeck_rate
    dry = law.coulomb + (law.breakaway - law.coulomb) * math.exp(-ratio * ratio)
    return dry + law.viscous * abs(rate)


# ----------------------------------------------------------------------------------- flywheel

_HEAVY = 1.0e3  # large moments of inertia of the rover [kg m^2]
_SPIN_TORQUE = 0.1  # at the shaft [N m]


@worst_of("{runs} flywheels, spun up and coasting")
def flywheel(_index: int, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Largest relative error of the flywheel's coast-down time, momentum and reaction.

    On a rover of large inertia it stops after the integral of J dv / friction(v). On the hanging
    default rover its absolute momentum falls by the friction's impulse, and during spin-up the
    rover gets the opposite momentum.
    """
    coulomb = float(generator.uniform(4.0e-3, 8.0e-3))
    law = {
        "coulomb": coulomb,
        "breakaway": coulomb * float(generator.uniform(1.05, 1.6)),
        "stribeck_rate": float(generator.uniform(2.0, 10.0)),
        "viscous": float(10.0 ** generator.uniform(-5.0, -4.0)),
    }
    spin = float(generator.uniform(15.0, 35.0))
    inertia = float(generator.uniform(0.8e-3, 1.2e-3))
    parts: dict[str, object] = {
        "rover.jump_drive.friction": law,
        "rover.jump_drive.inertia": inertia,
    }
    heavy = {"rover.inertia1": [_HEAVY, _HEAVY, _HEAVY]}
    errors = {
        "stop": _coast_error(make_plant({**parts, **heavy}), spin),
        "momentum": _momentum_error(make_plant(parts), spin),
        "reaction": _reaction_error(make_plant(parts)),
    }
    for name, error in errors.items():
        yield f"from {spin:.0f} rad/s, {name}", error


def _spun_up(plant: SpatialPlant, rate: float) -> SpatialState:
    """State with the nut near its upper end and the flywheel at about `rate`, downwards [rad/s]."""
    state = plant.initial_state()
    up = PlantCommand(jump=JumpMotorCommand(-0.056, 0.02))
    state, _ = plant.step(state, up, 3.0)
    while state.flywheel_rate < rate:
        state, _ = plant.step(state, PlantCommand(jump=FlywheelCommand(_SPIN_TORQUE)), _FINE)
    return state


def _coast_error(plant: SpatialPlant, spin: float) -> float:
    """Relative error of the time to standstill."""
    rover = plant.scenario.rover
    assert rover is not None
    drive = rover.jump_drive
    state = _spun_up(plant, spin)
    begin, before = state.time, state
    first = state.flywheel_rate
    expected, _ = quad(lambda v: drive.inertia / _friction(drive.friction, v), 0.0, first)
    while state.flywheel_rate > 0.0:
        before = state
        state, _ = plant.step(state, _IDLE, _FINE)
        if state.time > begin + 3.0 * expected:
            return math.inf
    # Within the last step the friction is that of rest.
    rest = before.flywheel_rate * drive.inertia / drive.friction.breakaway
    return abs((before.time + rest - begin) / expected - 1.0)


def _momentum_error(plant: SpatialPlant, spin: float) -> float:
    """Relative error of the momentum lost down to a quarter of the rate, against the impulse."""
    rover = plant.scenario.rover
    assert rover is not None
    drive = rover.jump_drive
    state = _spun_up(plant, spin)
    start, impulse = state, 0.0
    before = state.flywheel_rate
    while state.flywheel_rate > 0.25 * spin:
        state, _ = plant.step(state, _IDLE, _FINE)
        impulse += _FINE * _friction(drive.friction, 0.5 * (before + state.flywheel_rate))
        before = state.flywheel_rate
    lost = start.flywheel_rate + start.omega[0] - state.flywheel_rate - state.omega[0]
    return abs(drive.inertia * float(lost) / impulse - 1.0)


def _reaction_error(plant: SpatialPlant) -> float:
    """Relative error of the rover's momentum after 20 ms of torque."""
    rover = plant.scenario.rover
    assert rover is not None
    state = plant.initial_state()
    state, _ = plant.step(state, PlantCommand(jump=FlywheelCommand(_SPIN_TORQUE)), 0.02)
    # On a long tether the rover rotates about its centre of mass.
    across = rover.inertia[0] + rover.m1 * rover.m2 / rover.mass * state.s**2
    rotor = rover.jump_drive.inertia * (state.flywheel_rate + float(state.omega[0]))
    return abs(-across * float(state.omega[0]) / rotor - 1.0)
