"""Payout and reel-in by the drum: pendulums, tensions, long payouts and back."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np
from scipy.integrate import solve_ivp

from msg_schemas.phases import PlantPhase
from rover_sim import PlantCommand, SpatialPlant, SpatialState, WinchCommand
from rover_sim.physics.tether.ancf import Array
from rover_verify.checks import CheckBatch, Measured, worst_of
from rover_verify.checks.spatial_cases import IDEAL_WINCH, make_plant

_MOON = 1.62  # [m/s^2]
_TICK = 0.01  # [s]
_ARAMID: Mapping[str, object] = {
    "axial_stiffness": 2.0e4,
    "bending_stiffness": 1.0e-4,
    "axial_damping_time": 15.0e-3,
    "bending_damping_time": 50.0e-3,
}


def _weight_on_drum(
    mass: float, length: float, longest: float, element: float, **tether: object
) -> dict[str, object]:
    """A weight instead of the rover, on a tether with elements of `element` [m]."""
    return {
        "rover": None,
        "tip": {"mass": mass},
        "tether": {
            "contact": None,
            "length": length,
            "max_length": longest,
            "element_length": element,
            **_ARAMID,
            **tether,
        },
        "winch.min_length": 1.5 * element,
    }


# ---------------------------------------------------------------- pendulums that change in length


def _pendulum(
    mass: float, line_density: float, stretch: float, start: float, rate: float, angle: float
) -> float:
    """Angle [rad] after 30 m of payout of a pendulum on a straight tether with mass and stretch.

    A massless tether gives l th'' + 2 l' th' + g sin th = 0; the tether adds inertia and weight.
    """
    duration = 30.0 / abs(rate)
    rho = line_density / stretch

    def motion(t: float, y: Array) -> list[float]:
        length, grows = (start + rate * t) * stretch, rate * stretch
        inertia = mass * length**2 + rho * length**3 / 3.0
        drag = (2.0 * mass * length + rho * length**2) * grows
        pull = (mass * length + 0.5 * rho * length**2) * _MOON
        return [y[1], -(drag * y[1] + pull * math.sin(y[0])) / inertia]

    end = solve_ivp(motion, (0.0, duration), [angle, 0.0], rtol=1e-10, atol=1e-12)
    return float(end.y[0, -1])


def _swung(
    mass: float, line_density: float, start: float, rate: float, angle: float, heading: float
) -> tuple[float, float]:
    """Angles along and across the heading [rad] after paying out or reeling in 30 m."""
    duration = 30.0 / abs(rate)
    plant = make_plant(
        IDEAL_WINCH,
        _weight_on_drum(mass, start, 41.0, 2.0, line_density=line_density),
        {
            "start": {
                "kind": "hanging",
                "swing_angle": math.degrees(angle),
                "swing_heading": math.degrees(heading),
                "payout_rate": rate,
            },
            "integration.h": 2.0e-3,
        },
    )
    command = PlantCommand(winch=WinchCommand(start, rate, feed_forward=mass * _MOON))
    state = plant.initial_state()
    for _ in range(30):
        state, _ = plant.step(state, command, duration / 30.0)
    if abs(state.length - start - rate * duration) > 1e-3:
        raise RuntimeError(
            f"paid-out length {state.length:.4f} m, expected {start + rate * duration:.4f} m"
        )
    x, y, z = state.tip
    along, across = (
        x * math.cos(heading) + y * math.sin(heading),
        y * math.cos(heading) - x * math.sin(heading),
    )
    return math.atan2(along, -z), math.atan2(across, -z)


def lengthening(batch: CheckBatch) -> Measured:
    """Largest deviation of the angle from the pendulum's equation, paying out and reeling in."""
    reference = _pendulum(10.0, 0.0, 1.0, 10.0, 0.25, math.radians(5.0))
    worst, details = 0.0, {"l th'' + 2 l' th' + g sin th = 0, 10 to 40 m [rad]": reference}
    # The reference case on a light tether, and random ones with the aramid's mass.
    cases = [(10.0, 5.0e-5, 10.0, 0.25, math.radians(5.0), 0.0)]
    for generator in batch.generators(min(batch.runs, 4)):
        reels_in = len(cases) % 2 == 1
        cases.append(
            (
                float(generator.uniform(5.0, 15.0)),
                5.0e-3,
                40.0 if reels_in else 10.0,
                float(generator.uniform(0.2, 0.4)) * (-1.0 if reels_in else 1.0),
                math.radians(float(generator.uniform(1.0, 3.0) if reels_in else 5.0)),
                float(generator.uniform(0.0, 2.0 * math.pi)),
            )
        )
    for mass, line_density, start, rate, angle, heading in cases:
        found, across = _swung(mass, line_density, start, rate, angle, heading)
        stretch = 1.0 + mass * _MOON / float(str(_ARAMID["axial_stiffness"]))
        expected = _pendulum(mass, line_density, stretch, start, rate, angle)
        if line_density < 1e-3:
            worst = max(worst, abs(found - reference))
        name = f"{start:g} m at {rate:+.3f} m/s, {mass:.1f} kg, {line_density * 1e3:g} g/m"
        details[f"{name}: angle [rad]"] = found
        details[f"{name}: deviation from the equation with tether mass [rad]"] = found - expected
        worst = max(worst, abs(found - expected), abs(across))
    return Measured(worst, f"{len(cases)} pendulums over splits and mergers", details)


# --------------------------------------------------------------------------------------- payout


@worst_of("winch with friction, mean over 2 s of acceleration", 6)
def vertical_tension(index: int, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Largest relative deviation of the fairlead's tension from (m + rho L)(g - a)."""
    mass = float(generator.uniform(5.0, 12.0))
    line_density = float(generator.uniform(0.02, 0.1))
    pays_out = index % 2 == 0
    acceleration = float(generator.uniform(0.05, 0.12)) * (1.0 if pays_out else -1.0)
    plant = make_plant(
        _weight_on_drum(mass, 5.0 if pays_out else 15.0, 30.0, 1.0, line_density=line_density),
        {"start": {"kind": "hanging"}},
    )
    state = plant.initial_state()
    lengths, rates, tensions = [], [], []
    for k in range(400):
        rate = acceleration * max(k * _TICK - 0.5, 0.0)
        command = PlantCommand(winch=WinchCommand(state.length, rate, feed_forward=mass * _MOON))
        state, result = plant.step(state, command, _TICK)
        lengths.append(state.length)
        rates.append(plant.payout_rate(state))
        tensions.append(result.forces.fairlead_tension)
    window = slice(200, 400)
    found = float(np.mean(tensions[window]))
    grown = float(np.polyfit(_TICK * np.arange(200), rates[window], 1)[0])
    expected = (mass + line_density * float(np.mean(lengths[window]))) * (_MOON - grown)
    off = found / expected - 1.0
    yield f"{mass:.1f} kg, {1e3 * line_density:.0f} g/m, a = {grown:+.3f}", off


# A massless inextensible rope from 2 m at 0.5 m/s with 5 kg that start sideways at 0.2 m/s:
# position in the x-z plane at t [s]; two other codes agree within 3 mm.
_PAID_OUT = {5.0: (-0.1165, -4.4985), 10.0: (-0.0119, -7.0000)}


def stiff_cable(_batch: CheckBatch) -> Measured:
    """Largest distance of a weight on the stiff cable from the rope's solution."""
    cable = {
        "axial_stiffness": None, "bending_stiffness": None, "bending_damping_time": 0.0,
        "youngs_modulus": 70.0e9, "radius": 3.45e-4, "density": 2700.0,
        "axial_damping_time": 2.0e-3,
    }  # fmt: skip
    plant = make_plant(
        IDEAL_WINCH,
        _weight_on_drum(5.0, 2.0, 10.0, 0.5, **cable),
        {
            "start": {
                "kind": "hanging",
                "swing_rate": math.degrees(0.1),
                "payout_rate": 0.5,
            },
        },
    )
    command = PlantCommand(winch=WinchCommand(2.0, 0.5, feed_forward=5.0 * _MOON))
    state, details = plant.initial_state(), {}
    for time, expected in _PAID_OUT.items():
        state, _ = plant.step(state, command, time - state.time)
        off = math.hypot(float(state.tip[0]) - expected[0], float(state.tip[2]) - expected[1])
        details[f"at {time:g} s, {state.length:.4f} m out [m]"] = off
    return Measured.largest(details, "elements of 0.5 m, 1 ms")


_FAR, _NEAR = 300.0, 2.0  # [m]
# A winch for 1 m/s.
_FAST_WINCH: Mapping[str, object] = {
    "winch.gear_ratio": 25.0,
    "winch.motor.max_torque": 0.4,
    "winch.motor.stall_torque": 1.2,
}


def _sound(plant: SpatialPlant, state: SpatialState) -> str:
    """Fault of a state of a taut hanging tether, or an empty string."""
    nodes = plant.to_full_nodes(state)
    if not (np.all(np.isfinite(nodes)) and np.all(np.isfinite(state.body))):
        return "not finite"
    reach = float(np.linalg.norm(state.tip))
    if not abs(reach - state.length) < 0.01 * state.length + 0.02:
        return f"the tip is {reach:.2f} m away with {state.length:.2f} m paid out"
    stretch = np.linalg.norm(nodes[:, 1], axis=1)
    if not np.all(np.abs(stretch - 1.0) < 0.05):
        return f"a slope of {stretch.min():.3f} to {stretch.max():.3f}"
    return ""


def far_out_and_back(batch: CheckBatch) -> Measured:
    """Number of runs from 2 m to 300 m of tether and back with any fault."""
    bad, details = 0, {}
    count = min(batch.runs, 2)
    for index, generator in enumerate(batch.generators(count)):
        rate = float(generator.uniform(0.9, 1.0))
        plant = make_plant(
            _FAST_WINCH,
            {
                "tether.length": _NEAR,
                "tether.max_length": _FAR + 1.0,
                "tether.element_length": 1.25,
                "winch.min_length": 1.9,
                "start.swing_angle": float(generator.uniform(0.5, 2.0)),
                "start.cone_rate": float(generator.uniform(-1.0, 1.0)),
                "integration.h": 2.0e-3,
            },
        )
        state = plant.initial_state()
        largest, wrong, halved, moved, drift, commanded_rate = _NEAR, "", 0, 0.0, 0.0, 0.0
        for goal in (_FAR, _NEAR):
            while abs(goal - state.length) > 0.01 and not wrong and state.time < 1e3:
                # Limited acceleration, as of any winch: a jerk would throw the rover.
                remaining = goal - state.length
                speed = math.copysign(min(rate, 0.02 + 0.3 * abs(remaining)), remaining)
                commanded_rate += min(max(speed - commanded_rate, -0.02), 0.02)
                command = WinchCommand(goal, commanded_rate, feed_forward=17.0)
                state, result = plant.step(state, PlantCommand(winch=command), 0.1)
                largest = max(largest, state.length)
                moved = max(moved, abs(result.energies.gravity))
                drift = max(drift, abs(result.energies.drift))
                halved += result.smallest_step < 1.9e-3
                wrong = state.phase.value if state.phase is not PlantPhase.HANGING else ""
                wrong = wrong or _sound(plant, state)
        if not wrong and abs(state.length - _NEAR) > 0.02:
            wrong = f"ends at {state.length:.2f} m"
        if not wrong and drift > 1e-4 * moved:
            wrong = f"energy drift {drift:.2g} of {moved:.0f} J"
        bad += bool(wrong)
        x, y, _ = state.tip
        swing = math.degrees(math.atan2(math.hypot(float(x), float(y)), float(-state.tip[2])))
        details[f"run {index}"] = (
            wrong
            or f"{largest:.1f} m and back in {state.time:.0f} s, drift {drift:.2g} of {moved:.0f} J"
            f" moved, {halved} ticks halved, ends {swing:.2f} deg from plumb"
        )
    return Measured(bad, f"of {count} runs at 2 ms, up to 240 elements", details)
