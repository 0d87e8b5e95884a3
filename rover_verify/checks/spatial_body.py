"""A rigid body on the tether, on a pivot and free, against other codes and closed forms."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Literal

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from rover_sim import FlywheelCommand, PlantCommand, SpatialPlant, SpatialState, WheelTorqueCommand
from rover_sim.physics.rover import spatial_rover
from rover_sim.physics.tether.ancf import Array
from rover_verify.checks import CheckBatch, Measured, worst_of
from rover_verify.checks.spatial_cases import ENDLESS_SLIDER, NO_ROTORS, make_plant, without_winch

_IDLE = PlantCommand()
_WEIGHTLESS = 1.0e-6  # negligible mass of a body [kg]

# Tether of Table 1 with one body of 5 kg, converged to 1e-5 by two codes: t [s] -> attachment [m]
# and rotation vector [rad], body to map.
_SWUNG = {
    0.5: (2.42096, 0.49079, -5.39337, 0.08939, -0.47007, 0.02575),
    1.0: (1.46705, 0.76093, -6.62295, 0.11497, -0.25946, 0.03871),
    1.5: (-0.49081, 0.52346, -5.74523, 0.10413, 0.02897, 0.05226),
    2.0: (-2.38286, 0.08565, -5.15715, 0.02568, 0.50837, 0.07983),
}


def one_body(
    mass: float, inertia: tuple[float, float, float], attachment: float
) -> dict[str, object]:
    """A rover that is one rigid body, the attachment `attachment` [m] above its centre of mass."""
    return {
        **NO_ROTORS,
        **ENDLESS_SLIDER,
        "rover.m1": mass - _WEIGHTLESS,
        "rover.m2": _WEIGHTLESS,
        "rover.inertia1": list(inertia),
        "rover.inertia2": [1.0e-9] * 3,
        "rover.attachment": [0.0, 0.0, attachment],
        "rover.slider.free_length": 0.0,
        "rover.slider.spring_rate": 1.0,
        "rover.slider.damping": 0.0,
    }


def swung_body(_batch: CheckBatch) -> Measured:
    """Largest deviation of attachment and attitude from two other codes."""
    tilt = math.pi / 6.0
    direction = np.array([math.sin(tilt), 0.0, -math.cos(tilt)])
    plant = make_plant(
        one_body(5.0, (0.05, 0.06, 0.04), 0.1),
        without_winch(
            5.0, 40, youngs_modulus=0.5e9, radius=3.45e-4, density=1.0e4, axial_damping_time=2.0e-3
        ),
        {
            "environment.gravity": 9.81,
            "start": {
                "kind": "straight",
                "direction": direction.tolist(),
                "tip_velocity": [0.0, 1.0, 0.0],
                "attitude": [0.0, -tilt, 0.0],
                "angular_velocity": (np.cross(direction, [0.0, 1.0, 0.0]) / 5.0).tolist(),
            },
            "integration.h": 2.5e-4,
            "integration.tolerance": 1.0e-9,
        },
    )
    state, details = plant.initial_state(), {}
    for time, expected in _SWUNG.items():
        state, _ = plant.step(state, _IDLE, time - state.time)
        attitude = Rotation.from_quat(state.orientation).as_rotvec()
        off = np.abs(np.concatenate([state.tip, attitude]) - np.array(expected))
        details[f"attachment at {time:g} s [m]"] = float(np.max(off[:3]))
        details[f"attitude at {time:g} s [rad]"] = float(np.max(off[3:]))
    return Measured.largest(details, "40 elements, 0.25 ms")


# --------------------------------------------------------------------------- pendulums in space

# A nearly inextensible and massless rope that damps the oscillation of its tension.
_ROPE = {
    "axial_stiffness": 1.0e9,
    "bending_stiffness": 1.0e-9,
    "line_density": 1.0e-6,
    "axial_damping_time": 1.0e-3,
    "bending_damping_time": 1.0e-3,
}


def _bob(length: float, gravity: float, mass: float, h: float, **start: object) -> SpatialPlant:
    return make_plant(
        {"rover": None, "tip": {"mass": mass}},
        without_winch(length, 4, **_ROPE),
        {
            "environment.gravity": gravity,
            "start": {"kind": "hanging", **start},
            "integration.h": h,
            "integration.tolerance": 1.0e-10,
        },
    )


@worst_of("ten turns each, masses, lengths and angles at random", 6)
def conical(_index: int, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Largest relative deviation of a conical pendulum's phase rate from sqrt(g/(l cos a))."""
    angle = math.radians(float(generator.uniform(10.0, 70.0)))
    length, gravity = float(generator.uniform(3.0, 20.0)), float(generator.choice([1.62, 9.81]))
    mass = float(generator.uniform(5.0, 20.0))
    tension = mass * gravity / math.cos(angle)
    stretched = length * (1.0 + tension / _ROPE["axial_stiffness"])
    share = _ROPE["line_density"] * length / mass  # a straight rod of that weight
    rate = math.sqrt(gravity / (stretched * math.cos(angle)))
    rate *= math.sqrt((1.0 + share / 2.0) / (1.0 + share / 3.0))
    sense = float(generator.choice([-1.0, 1.0]))
    plant = _bob(
        length, gravity, mass, 5.0e-4,
        swing_angle=math.degrees(angle), cone_rate=sense * math.degrees(rate),
        swing_heading=float(generator.uniform(0.0, 360.0)),
    )  # fmt: skip
    state = plant.initial_state()
    places = [state.tip]
    turn = 2.0 * math.pi / rate
    for _ in range(80):
        state, _ = plant.step(state, _IDLE, turn / 8.0)
        places.append(state.tip)
    x, y, _ = np.array(places).T
    swept = np.unwrap(np.arctan2(y, x))
    off = abs(sense * float(swept[-1] - swept[0]) / (20.0 * math.pi) - 1.0)
    yield f"{math.degrees(angle):.1f} deg, {length:.1f} m", off


def _cone_rate(length: float, gravity: float, lowest: float, highest: float) -> float:
    """Rate of the azimuth at the highest point of a spherical pendulum [rad/s]."""
    u1, u2 = math.cos(highest), math.cos(lowest)
    energy = (1.0 - u1**2 - u2**2 - u1 * u2) / (u1 + u2)  # over m g l
    return math.sqrt(2.0 * gravity / length * (energy + u1) / (1.0 - u1**2))


def _apsidal_angle(length: float, gravity: float, lowest: float, highest: float) -> float:
    """Change of azimuth from the lowest to the highest point of a spherical pendulum [rad].

    With u the cosine of the angle from the downward vertical, from u1 (highest) to u2 (lowest),
    u'^2 = 2 g/l (u - u1)(u2 - u)(u + (1 + u1 u2)/(u1 + u2)) and the azimuth's rate is
    K/(1 - u^2) (Whittaker 1937, Analytical Dynamics, 55), integrated with u = mean + half cos p.
    """
    u1, u2 = math.cos(highest), math.cos(lowest)
    third = (1.0 + u1 * u2) / (u1 + u2)
    spin = (1.0 - u1**2) * _cone_rate(length, gravity, lowest, highest)

    def rate(p: float) -> float:
        u = 0.5 * (u1 + u2) - 0.5 * (u2 - u1) * math.cos(p)
        return 1.0 / (1.0 - u * u) / math.sqrt(u + third)

    swept, _ = quad(rate, 0.0, math.pi, epsabs=1e-13, epsrel=1e-13)
    return float(spin / math.sqrt(2.0 * gravity / length) * swept)


@worst_of("six swings each, lengths and ellipses at random", 6)
def spherical(_index: int, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Largest relative deviation of a spherical pendulum's precession from the closed form."""
    length, gravity = float(generator.uniform(5.0, 20.0)), 1.62
    highest = math.radians(float(generator.uniform(30.0, 70.0)))
    lowest = math.radians(float(generator.uniform(8.0, 25.0)))
    cone = _cone_rate(length, gravity, lowest, highest)
    plant = _bob(
        length, gravity, 10.0, 5.0e-4,
        swing_angle=math.degrees(highest), cone_rate=math.degrees(cone),
    )  # fmt: skip
    state = plant.initial_state()
    tops = [0.0]
    before = state
    while len(tops) < 7:
        state, _ = plant.step(before, _IDLE, 0.02)
        rates = [float(s.node_rates[-1, 0, 2]) for s in (before, state)]
        if rates[0] > 0.0 >= rates[1]:
            tops.append(_azimuth_at_top(plant, before))
        before = state
    # From one top to the next: half a turn plus the precession of the ellipse.
    found = float(np.mean(np.mod(np.diff(tops), 2.0 * math.pi))) - math.pi
    expected = 2.0 * _apsidal_angle(length, gravity, lowest, highest) - math.pi
    off = abs(found / expected - 1.0)
    yield f"{expected:.4f} rad a swing", off


def _azimuth_at_top(plant: SpatialPlant, before: SpatialState) -> float:
    """Azimuth of the tip where its vertical rate crosses zero within the next 0.02 s."""

    def vertical_rate(time: float) -> float:
        return float(plant.step(before, _IDLE, time)[0].node_rates[-1, 0, 2])

    state, _ = plant.step(before, _IDLE, brentq(vertical_rate, 1.0e-6, 0.02, xtol=1.0e-9))
    return math.atan2(float(state.tip[1]), float(state.tip[0]))


# ------------------------------------------------------------------------------- the gyrostat


def _gyrostat(generator: np.random.Generator) -> tuple[SpatialPlant, SpatialState]:
    """A free rover that rotates about a random axis, its rotors spun up.

    Every scenario has a tether; this one has negligible mass and stiffness.
    """
    inertia = generator.uniform(0.15, 0.25, 3)
    masses = generator.uniform(3.0, 7.0, 2)
    nothing = {
        "axial_stiffness": 1.0e-16, "bending_stiffness": 1.0e-18, "line_density": 1.0e-16,
    }  # fmt: skip
    free = {**NO_ROTORS, **ENDLESS_SLIDER}
    free["rover.jump_drive.inertia"] = 1.0e-3
    free["rover.wheel_drive.wheel_inertia"] = 6.0e-3
    plant = make_plant(
        free,
        without_winch(0.5, 2, **nothing),
        {
            "environment.gravity": 0.0,
            "rover.m1": float(masses[0]),
            "rover.m2": float(masses[1]),
            "rover.inertia1": inertia.tolist(),
            "rover.attachment": generator.uniform(-0.2, 0.2, 3).tolist(),
            "rover.slider.damping": 0.0,
            "start": {"kind": "straight", "direction": [1.0, 0.0, 0.0]},
            "integration.tolerance": 1.0e-15,
        },
    )
    direction = generator.normal(size=3)
    direction /= np.linalg.norm(direction)
    s = np.linspace(0.0, 0.5, 3)[:, None]
    nodes = np.stack([s * direction, np.broadcast_to(direction, (3, 3))], axis=1)
    quaternion = generator.normal(size=4)
    state = plant.state_at(
        nodes,
        orientation=quaternion / np.linalg.norm(quaternion),
        angular_velocity=generator.uniform(-1.0, 1.0, 3),
        slide=0.21,
    )
    spin_up = PlantCommand(
        jump=FlywheelCommand(float(generator.uniform(0.03, 0.08))),
        # Forward, where the ratchets leave both wheels free.
        wheel=WheelTorqueCommand(float(generator.uniform(0.05, 0.1))),
    )
    state, _ = plant.step(state, spin_up, 1.0)
    return plant, state


def _angular_momentum(plant: SpatialPlant, state: SpatialState) -> Array:
    """Angular momentum of the rover about its centre of mass, rotors included."""
    rover = plant.model.rover
    masses = (rover.m1, rover.m2)
    centre2 = state.G1 + state.rotation @ (rover.offset + np.array([0.0, 0.0, state.s]))
    middle = (rover.m1 * state.G1 + rover.m2 * centre2) / sum(masses)
    angular = np.zeros(3)
    for mass, place, rate in zip(
        masses, (state.G1, centre2), (state.G1_rate, state.G2_rate), strict=True
    ):
        angular = angular + mass * np.cross(place - middle, rate)
    rotors = state.body[spatial_rover.ROTORS : spatial_rover.ROTORS + 3]
    inside = np.array(rover.inertia) * state.omega + rotors
    return angular + state.rotation @ inside


def gyrostat(batch: CheckBatch, quantity: Literal["energy", "momentum"]) -> Measured:
    """Largest change of a free gyrostat's energy [J] or angular momentum [N m s] over 20 s.

    The angular momentum is that about its centre of mass.
    """

    def value_of(plant: SpatialPlant, state: SpatialState) -> Array | float:
        if quantity == "energy":
            return plant.energies(state).stored
        return _angular_momentum(plant, state)

    details = {}
    for index, generator in enumerate(batch.generators(min(batch.runs, 5))):
        plant, state = _gyrostat(generator)
        before, largest = value_of(plant, state), 0.0
        rate = float(np.linalg.norm(state.omega))
        for _ in range(20):
            state, _ = plant.step(state, _IDLE, 1.0)
            largest = max(largest, float(np.max(np.abs(value_of(plant, state) - before))))
        details[f"run {index}: turning at {rate:.2f} rad/s"] = largest
    return Measured.largest(details, "rotors and slider free, 20 s at 1 ms")


# ----------------------------------------------------------------------------------- coning

_STRONG_MOTOR = {
    "max_torque": 10.0, "stall_torque": 1.0e3, "no_load_rate": 1.0e5, "torque_constant": 1.0,
    "servo_bandwidth": 10.0,
}  # fmt: skip
_PIVOT = {
    "axial_stiffness": 1.0e5, "bending_stiffness": 1.0e-9, "line_density": 1.0e-3,
    "axial_damping_time": 1.0e-3,
}  # fmt: skip
_ARAMID = {
    "axial_stiffness": 2.0e4, "bending_stiffness": 1.0e-4, "line_density": 5.0e-3,
    "axial_damping_time": 15.0e-3, "bending_damping_time": 50.0e-3,
}  # fmt: skip
_LEVER, _MASS, _MOON = 0.2, 10.0, 1.62  # attachment above the centre of mass [m], [kg], [m/s^2]
_RAMP, _TURNS, _CONING_TICK = 60.0, 16, 0.01  # [s], measured turns, [s]


def _coning_plant(
    length: float, elements: int, inertia: float, about_z: float, **tether: object
) -> SpatialPlant:
    return make_plant(
        one_body(_MASS, (inertia, inertia, about_z), _LEVER),
        without_winch(length, elements, **tether),
        {
            "environment.gravity": _MOON,
            "rover.jump_drive.inertia": 1.0e-3,
            "rover.jump_drive.motor": _STRONG_MOTOR,
            "rover.wheel_drive.wheel_inertia": 6.0e-3,
            "rover.wheel_drive.efficiency": 1.0,
            "rover.wheel_drive.back_efficiency": 1.0,
            "rover.wheel_drive.motor": _STRONG_MOTOR,
            "start": {"kind": "hanging"},
            "integration.tolerance": 1.0e-8,
        },
    )


def _cone(plant: SpatialPlant, momentum: float, rate: float) -> tuple[float, float]:
    """Rms tilt from the vertical [rad] and yaw rate about +z [rad/s] of a coning rover.

    The amplitude of the momenta h (cos Wt, sin Wt) about x and y rises smoothly, then is constant.
    """

    def expected(time: float) -> Array:
        part = min(time / _RAMP, 1.0)
        size = momentum * part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
        return size * np.array([math.cos(rate * time), math.sin(rate * time)])

    state = plant.initial_state()
    measured = round(_TURNS * 2.0 * math.pi / abs(rate) / _CONING_TICK)
    first = round((_RAMP + 20.0) / _CONING_TICK)
    tilts: list[float] = []
    twists: list[float] = []
    for k in range(first + measured):
        now = k * _CONING_TICK
        torque = (expected(now + _CONING_TICK) - expected(now)) / _CONING_TICK
        command = PlantCommand(
            jump=FlywheelCommand(float(torque[0])), wheel=WheelTorqueCommand(float(torque[1]))
        )
        state, _ = plant.step(state, command, _CONING_TICK)
        if k >= first:
            tilts.append(float(1.0 - state.rotation[2, 2]))
            twists.append(state.twist)
    # 1 - cos is half the squared tilt; the twist is positive about -z.
    tilt = math.sqrt(2.0 * float(np.mean(tilts)))
    time = _CONING_TICK * np.arange(len(twists))
    return tilt, -float(np.polyfit(time, twists, 1)[0])


def _coned(
    length: float, inertia: float, about_z: float, momentum: float, rate: float
) -> tuple[float, float]:
    """Closed form of tilt th [rad] and yaw rate [rad/s] on a massless tether, to second order.

    In a cone of the rate O in the world, O = W + yaw, the centre of mass has the radius k d th with
    k = 1/(1 - O^2 l/g), and the tether's inclination is O^2 k d th/g. The moments about the centre
    of mass, and zero angular momentum about the vertical (start from rest), give

        th = h O/(q - I O^2),     q = m g d (1 - O^2 k d/g),
        yaw = th^2 [O/2 - (q + m k^2 d^2 O^2)/(I_z O)].

    The yaw is the rate of the swing-twist angle, of which O th^2/2 is kinematic. If O^2 I_z is
    small against m g d it is -(I/I_z) th^2 w_b^2/W with w_b^2 = m g d/I; on a pivot (l = 0) the
    tilt is h W/(I_p |w_p^2 - W^2|) with the moment I_p and the frequency w_p about the pivot.
    """
    tilt, yaw = 0.0, 0.0
    for _ in range(50):
        cone = rate + yaw
        k = 1.0 / (1.0 - cone**2 * length / _MOON)
        q = _MASS * _MOON * _LEVER * (1.0 - cone**2 * k * _LEVER / _MOON)
        tilt = momentum * cone / (q - inertia * cone**2)
        moved = q + _MASS * (k * _LEVER * cone) ** 2
        yaw = tilt**2 * (0.5 * cone - moved / (about_z * cone))
    return tilt, yaw


def coning(batch: CheckBatch) -> Measured:
    """Largest relative deviation of the yaw rate due to coning from its closed form."""
    worst, details = 0.0, {}
    count = min(batch.runs, 3)
    for index, generator in enumerate(batch.generators(count)):
        inertia, about_z, momentum, rate = 0.2, 0.2, 0.05, 1.0
        if index > 0:
            inertia = float(generator.uniform(0.15, 0.3))
            about_z = float(generator.uniform(0.8, 1.5)) * inertia
            momentum = float(generator.uniform(0.03, 0.06))
            rate = float(generator.choice([-1.0, 1.0]) * generator.uniform(0.8, 1.2))
        for name, length, elements, tether in (
            ("pivot", 1.0e-3, 1, _PIVOT),
            ("tether", 10.0, 5, _ARAMID),
        ):
            plant = _coning_plant(length, elements, inertia, about_z, **tether)
            tilt, yaw = _cone(plant, momentum, rate)
            expected_tilt, expected = _coned(length, inertia, about_z, momentum, rate)
            leading = -_MASS * _MOON * _LEVER * tilt**2 / (about_z * rate)
            what = f"run {index}, {name}: "
            details[what + "tilt [deg]"] = math.degrees(tilt)
            details[what + "tilt of the closed form [deg]"] = math.degrees(abs(expected_tilt))
            details[what + "yaw rate [deg/s]"] = math.degrees(yaw)
            details[what + "yaw rate of the closed form [deg/s]"] = math.degrees(expected)
            details[what + "yaw rate of its leading term at this tilt [deg/s]"] = math.degrees(
                leading
            )
            worst = max(worst, abs(yaw / expected - 1.0))
    return Measured(worst, f"{count} rovers, {_TURNS} turns of the cone each", details)
