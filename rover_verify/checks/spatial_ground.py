"""Ground contact of the spatial plant: parking on a slope, a sliding block, restitution."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from rover_sim import PlantCommand, SpatialPlant, SpatialState, WheelRateCommand, load_spatial
from rover_sim.physics.ground.contact import ContactParameters, restitution
from rover_sim.physics.tether.ancf import Array
from rover_verify.checks import worst_of
from rover_verify.checks.spatial_cases import NO_ROTORS, make_plant, without_winch

_IDLE = PlantCommand()

# ------------------------------------------------------------------------------------- parked

_PARKED = 60.0  # [s]
_SLOPE = 15.0  # [deg]


@worst_of(f"{{runs}} slopes of {_SLOPE:g} deg in random directions, {_PARKED:g} s")
def parked(index: int, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Largest displacement of a parked rover on a slope within a minute [m].

    The ratchets hold a rover that faces uphill within 90 degrees; facing downhill, its right wheel
    is free to roll. In every other run the rover drives before and keeps its motor at zero rate; in
    the others it has settled with the motor off. The ground is regolith or bare rock at random.
    """
    downhill = float(generator.uniform(0.0, 360.0))
    off = float(generator.uniform(-80.0, 80.0))
    drives = index % 2 == 1
    material = str(generator.choice(["regolith", "rock"]))
    fall = math.radians(downhill)
    plant = SpatialPlant(
        load_spatial(
            "slope_15deg",
            {
                "environment.floor": {
                    "height": -4.0, "slope": _SLOPE, "downhill": downhill, "material": material,
                },
                "tether.length": 8.0,
                "start.position": [-2.0 * math.cos(fall), -2.0 * math.sin(fall)],
                "start.heading": math.remainder(downhill + 180.0 + off, 360.0),
            },
        )
    )  # fmt: skip
    state = plant.initial_state()
    brake = _IDLE
    if drives:
        brake = PlantCommand(wheel=WheelRateCommand(0.0))
        forward = PlantCommand(wheel=WheelRateCommand(float(generator.uniform(0.5, 2.0))))
        state, _ = plant.step(state, forward, 2.0)
        state, _ = plant.step(state, brake, 3.0)  # it comes to rest
    start, moved = state, 0.0
    for _ in range(round(_PARKED)):
        state, _ = plant.step(state, brake, 1.0)
        moved = max(moved, float(np.linalg.norm(state.G1 - start.G1)))
    how = f"{material}, {off:+.0f} deg from uphill, {'driven there' if drives else 'settled'}"
    yield how, moved


# -------------------------------------------------------------------------------------- block

# A block: the rover's box without effective wheels, Body 2 of negligible mass. Its massless tether
# passes through the ground and is always slack.
_BLOCK: dict[str, object] = {
    **NO_ROTORS,
    "rover.tail": None,
    "rover.body1_centre": [0.0, 0.0, 0.0],
    "rover.wheels.radius": 0.01,
    "rover.wheels.grouser_height": 0.0,
    "rover.wheels.axle_z": 0.05,
    "rover.m1": 10.0,
    "rover.m2": 0.01,
    "rover.inertia2": [1.0e-4, 1.0e-4, 1.0e-4],
    "rover.slider.damping": 5.0,
}
_MASS = 10.01  # [kg]
_HALF_HEIGHT = 0.075  # [m]
_ATTACHMENT = 0.28  # above its centre [m]
_THREAD = {"line_density": 1.0e-4, "axial_stiffness": 100.0, "bending_stiffness": 1.0e-4}
# Friction does not depend on the contact's damping; this value prevents rocking [s/m].
_QUIET = 30.0
_OFFSETS = (-0.1, -0.01, 0.01, 0.1, 0.3)  # of tan(alpha) from mu
# Before and during the measurement on the Moon; with more gravity shorter for the same travel [s].
_SETTLED, _WATCHED = 1.2, 0.8
_MOON = 1.62  # [m/s^2]


@worst_of(f"{{runs}} blocks, tan(alpha) - mu = {_OFFSETS}")
def block(_index: int, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Error in mu of a block on slopes below and above the friction angle.

    Its acceleration should be 0 for tan(alpha) < mu and g (sin(alpha) - mu cos(alpha)) above; the
    deviation over g cos(alpha) is the error in mu.
    """
    mu = float(generator.uniform(0.15, 0.9))
    gravity = float(generator.choice([1.62, 3.71, 9.81]))
    material = str(generator.choice(["regolith", "rock"]))
    downhill = float(generator.uniform(-math.pi, math.pi))
    largest = 0.0
    for offset in _OFFSETS:
        alpha = math.atan(mu + offset)
        found = _acceleration(mu, alpha, downhill, gravity, material)
        scale = gravity * math.cos(alpha)
        largest = max(largest, abs(found / scale - max(offset, 0.0)))
    yield f"mu = {mu:.3f}, {gravity:g} m/s^2, {material}", largest


def _acceleration(mu: float, alpha: float, downhill: float, gravity: float, material: str) -> float:
    """Acceleration of a settled block down the slope [m/s^2]."""
    flat = np.array([math.cos(downhill), math.sin(downhill), 0.0])
    along = math.cos(alpha) * flat - np.array([0.0, 0.0, math.sin(alpha)])
    turn = Rotation.from_rotvec(alpha * np.cross([0.0, 0.0, 1.0], flat))
    # It starts 3 m uphill of the fairlead's plumb line and slides towards it.
    stiffness = 1.0e5 if material == "rock" else 2.0e4
    depth = (0.25 * _MASS * gravity * math.cos(alpha) / stiffness) ** (2.0 / 3.0)
    base = np.array([*(-3.0 * flat[:2]), -1.0])
    law = {
        "stiffness": stiffness,
        "damping": _QUIET,
        "static_friction": mu,
        "kinetic_friction": mu,
    }
    plant, state = _placed_block(
        {
            "environment.gravity": gravity,
            "environment.floor": {
                "height": -1.0 - 3.0 * math.tan(alpha),
                "slope": math.degrees(alpha),
                "downhill": math.degrees(downhill),
                "material": material,
            },
            f"environment.{material}": law,
        },
        base + (_HALF_HEIGHT - depth) * turn.as_matrix()[:, 2],
        turn,
        np.zeros(3),
    )
    pace = math.sqrt(_MOON / gravity)
    state, _ = plant.step(state, _IDLE, _SETTLED * pace)
    before = float(state.G1_rate @ along)
    state, _ = plant.step(state, _IDLE, _WATCHED * pace)
    return (float(state.G1_rate @ along) - before) / (_WATCHED * pace)


def _placed_block(
    overrides: dict[str, object], centre: Array, turn: Rotation, velocity: Array
) -> tuple[SpatialPlant, SpatialState]:
    """A block at a position with a velocity and no rotation; its tether is straight."""
    tip = centre + _ATTACHMENT * turn.as_matrix()[:, 2]
    start = {
        "kind": "straight",
        "direction": tip.tolist(),
        "attitude": turn.as_rotvec().tolist(),
        "tip_velocity": velocity.tolist(),
    }
    tether = without_winch(float(np.linalg.norm(tip)), 4, **_THREAD)
    plant = make_plant(_BLOCK, tether, overrides, {"start": start})
    return plant, plant.initial_state()


# -------------------------------------------------------------------------------- restitution

_CORNER_STIFFNESS = 1.0e10  # a corner's impact ends before the block has rotated
_CORNER_STEP = 2.0e-5  # [s]


@worst_of("{runs} impacts each, flat at 1 ms and on one corner")
def bounce(_index: int, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Largest error of the speed after an impact, flat on four corners or on one, relative.

    By Hunt and Crossley's law the restitution depends on the speed alone, not on mass and inertia.
    """
    damping = float(generator.uniform(0.2, 1.2))
    speed = float(generator.uniform(0.1, 1.0))
    yaw = float(generator.uniform(-180.0, 180.0))
    for kind in ("flat", "corner"):
        stiffness, step = float(generator.choice([1.0e5, 2.0e4])), 1.0e-3
        turn = Rotation.from_euler("z", yaw, degrees=True)
        if kind == "corner":
            stiffness, step = _CORNER_STIFFNESS, _CORNER_STEP
            sides = generator.choice([-1.0, 1.0], 2)
            lean = sides * generator.uniform(20.0, 40.0, 2)
            turn = turn * Rotation.from_euler("xy", lean, degrees=True)
        law = ContactParameters(stiffness, damping, 0.0, 0.0, anchor_stiffness=0.0)
        found = _rebound(law, turn, speed, step)
        error = abs(found / restitution(law.law(), speed) - 1.0)
        yield f"{kind}, {speed:.2f} m/s, c = {damping:.2f} s/m", error


def _rebound(law: ContactParameters, turn: Rotation, speed: float, step: float) -> float:
    """Ratio of the lowest corner's speeds after and before the impact."""
    corners = np.array([[x, y, -_HALF_HEIGHT] for x in (-0.15, 0.15) for y in (-0.12, 0.12)])
    low = corners[int(np.argmin(turn.apply(corners)[:, 2]))]
    height = 2.0 * step * speed - float(turn.apply(low)[2])
    plant, state = _placed_block(
        {
            "environment.gravity": 0.0,
            "environment.floor": {"height": 0.0, "material": "rock"},
            "environment.rock": {
                "stiffness": law.stiffness,
                "damping": law.damping,
                "static_friction": 0.0,
                "kinetic_friction": 0.0,
                "anchor_stiffness": 0.0,
            },
            "integration.h": step,
        },
        np.array([3.0, 0.0, height]),
        turn,
        np.array([0.0, 0.0, -speed]),
    )
    touched = False
    for _ in range(round(0.5 / step)):
        state, result = plant.step(state, _IDLE, step)
        if touched and result.forces.body == 0.0:
            break
        touched = touched or result.forces.body > 0.0
    rate = state.G1_rate + state.rotation @ np.cross(state.omega, low)
    return float(rate[2]) / speed
