"""Limits of the winch: tether ends, motor heat, bounds of the trim.

Also tracking with a layered drum, and the tension hold while the rover drives.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from msg_schemas.faults import WinchFault
from msg_schemas.machine import (
    WINCH_AT_RATE,
    WINCH_AT_TENSION,
    WINCH_SLACK,
    WINCH_TO_LENGTH,
)
from msg_schemas.phases import WinchMode
from rover_sim import WheelRateCommand
from rover_verify.checks import Batch, Measured
from rover_verify.checks.winch_rig import SensorErrors, Session
from rover_verify.checks.winch_spatial import SpatialRig
from tether_winch.winch import Winch, WinchParameters

_ERRORS = SensorErrors(cell_noise=0.05, cell_bias=0.05, rate_noise=0.002, current_noise=0.01)
_RENEWAL = 0.5  # [s]


def _session(rig: SpatialRig, batch: Batch, parameters: WinchParameters | None = None) -> Session:
    winch = Winch(WinchParameters() if parameters is None else parameters)
    session = Session(winch, rig, _ERRORS, np.random.default_rng(batch.seed))
    session.arm()
    session.run(0.5)
    return session


# --- layers -------------------------------------------------------------------------------------

_PITCH, _TURNS = 1.5e-3, 20.0  # of layers as thick as the tether; nine of them on the drum


@cache
def _layered(seed: int) -> Session:
    """Down over several layers and back."""
    rig = SpatialRig(
        {
            "tether.length": 2.2,
            "winch.layer_pitch": _PITCH,
            "winch.turns_per_layer": _TURNS,
        }
    )
    values = WinchParameters()
    drum = replace(values.drum, layer_pitch=_PITCH, turns_per_layer=_TURNS)
    winch = Winch(replace(values, drum=drum))
    session = Session(winch, rig, _ERRORS, np.random.default_rng(seed))
    session.arm()
    for goal in (30.0, 2.2):
        session.request(WINCH_TO_LENGTH, goal, 0.3)
        session.run_until_rest(150.0)
        session.run(1.0)
    return session


def layered_length_error(batch: Batch) -> Measured:
    """Largest distance [m] of the drum's length from its reference, on a drum with layers."""
    session = _layered(batch.seed)
    error = np.abs(session.column("length") - session.column("reference"))
    radii = [session.winch.drum.radius(length) for length in (2.2, 30.0)]
    note = f"2.2 to 30 m and back; radius {radii[0]:.4f} to {radii[1]:.4f} m"
    return Measured(float(error.max()), note)


# --- heat ---------------------------------------------------------------------------------------


def largest_heat(batch: Batch) -> Measured:
    """Largest heat of the winding over what it bears, lifting 98 N until the motor is too hot."""
    rig = SpatialRig(
        {"tether.length": 20.0, "environment.gravity": 9.81, "winch.brake_torque": 12.0}
    )
    values = WinchParameters()
    values = replace(
        values,
        drum=replace(values.drum, gravity=9.81),
        load=replace(values.load, reference_weight=98.1),
        servo=replace(values.servo, tension_limit=190.0),
    )
    session = _session(rig, batch, values)
    session.request(WINCH_TO_LENGTH, 5.0, 0.1, 190.0)
    heat = 0.0
    for _ in range(9000):
        session.tick()
        heat = max(heat, session.winch.heat.heat)
        if session.winch.mode is WinchMode.FAULT:
            break
    session.run(2.0)
    winch, state = session.winch, rig.state
    if winch.fault is not WinchFault.OVERHEATED or state.drives.drum.rate != 0.0:
        return Measured(math.inf, f"it ended in {winch.mode}, {winch.fault}")
    return Measured(heat, f"stood braked at {state.length:.3g} m: {winch.fault_reason}")


# --- ends ---------------------------------------------------------------------------------------


def beyond_ends(batch: Batch) -> Measured:
    """How far [m] the drum passes its soft ends, sent there at a rate; and the rate there."""
    beyond, details = 0.0, {}
    for start, rate in ((54.0, 0.35), (6.0, -0.35)):
        rig = SpatialRig({"tether.length": start})
        session = _session(rig, batch)
        p = session.winch.parameters.servo
        low, high = p.shortest_length + p.soft_margin, p.longest_length - p.soft_margin
        for _ in range(60):
            session.request(WINCH_AT_RATE, 0.0, rate)
            session.run(_RENEWAL)
        length, speed = session.column("length"), session.column("rate")
        over = max(float(length.max()) - high, low - float(length.min()))
        beyond = max(beyond, over)
        near = (length > high - 0.1) | (length < low + 0.1)
        end = high if rate > 0.0 else low
        details[f"from {start:g} m at {rate:g} m/s"] = (
            f"stands at {rig.state.length:.4f} m, the soft end is {end:g} m; at most "
            f"{float(np.abs(speed[near]).max()):.3f} m/s within 0.1 m of it; {session.winch.mode}"
        )
        if abs(rig.state.length - end) > 0.01 or session.winch.mode is WinchMode.FAULT:
            beyond = math.inf
    return Measured(beyond, details=details)


# --- trim ---------------------------------------------------------------------------------------


class _Trimmed(NamedTuple):
    rate: float  # most that was added to the reference [m/s]
    length: float  # [m]
    drum_rate: float  # most that the drum made of it [m/s]
    tracking: float  # amplitude of the drum's response over the setpoint


@cache
def _trimmed(seed: int) -> dict[str, _Trimmed]:
    found = {}
    for name, rate, period in (
        ("steadily out", 0.3, math.inf),
        ("steadily in", -0.3, math.inf),
        ("swing of 45 m", 0.05, 33.0),
        ("twice the swing of 10 m", 0.08, 7.8),
    ):
        rig = SpatialRig({"tether.length": 20.0})
        session = _session(rig, Batch(1, seed, None))  # type: ignore[arg-type]
        session.request(WINCH_TO_LENGTH, 20.0 + 1e-3, 0.3)
        begun = session.time
        lengths, rates, drum, setpoints = [], [], [], []
        while session.time - begun < max(20.0, 2.0 * min(period, 20.0)):
            at = session.time - begun
            setpoint = rate if math.isinf(period) else rate * math.cos(2.0 * math.pi * at / period)
            if round(at * 100.0) % 5 == 0:
                session.winch.trim(setpoint, session.now_ns)
            readings = session.tick()
            reference = session.winch.servo.reference
            lengths.append(reference.length - session.winch.servo.motion.length)
            rates.append(reference.rate - session.winch.servo.motion.rate)
            drum.append(readings.rate)
            setpoints.append(setpoint)
        after = slice(300, None)
        share = float(np.ptp(drum[after]) / np.ptp(setpoints[after])) if period < 100.0 else 1.0
        most = [float(np.max(np.abs(values))) for values in (rates, lengths, drum)]
        found[name] = _Trimmed(most[0], most[1], most[2], share)
    return found


def trim_excess(batch: Batch) -> Measured:
    """How far a trim passes the largest rate or length that it may add, over that bound."""
    p = WinchParameters().servo
    worst, details = -math.inf, {}
    for name, trimmed in _trimmed(batch.seed).items():
        worst = max(worst, trimmed.rate / p.trim_rate - 1.0, trimmed.length / p.trim_length - 1.0)
        details[name] = (
            f"added at most {trimmed.rate:.3f} m/s of {p.trim_rate:g} and {trimmed.length:.3f} m "
            f"of {p.trim_length:g}; the drum ran at up to {trimmed.drum_rate:.3f} m/s "
            f"and followed by {trimmed.tracking:.0%}"
        )
    return Measured(worst, details=details)


# --- tension ------------------------------------------------------------------------------------


def _driven_off(depth: float, away: float, tension: float, batch: Batch) -> tuple[float, float]:
    """RMS deviation of the held tension while the rover drives off [N], and its distance [m]."""
    rig = SpatialRig(
        {
            "environment.floor": {"height": -depth},
            "start.kind": "grounded",
            "start.position": [away, 0.0],
            "start.settling_time": 300.0,
            "tether.length": round(math.hypot(depth, away) + 0.5, 3),
        }
    )
    session = _session(rig, batch)
    session.run(2.5)
    session.request(WINCH_SLACK, 0.0)
    for _ in range(6000):
        session.tick()
        if session.winch.mode is WinchMode.HOLD and session.winch.servo.is_at_rest:
            break
    began, place = len(session.ticks), float(rig.state.G1[0])
    for step in range(30):
        session.request(WINCH_AT_TENSION, 0.0, 0.3, tension)
        if step >= 4:  # 0.1 m/s, after it has come to stand under the tension
            rig.wheel = WheelRateCommand(min(0.2 * (step - 3), 0.65))
        session.run(_RENEWAL)
    held = session.column("tension")[began + 400 :]
    distance = float(rig.state.G1[0]) - place
    if session.winch.mode is not WinchMode.TENSION:
        return math.inf, distance
    return float(np.sqrt(np.mean((held - tension) ** 2))), distance


def driven_tension_error(batch: Batch) -> Measured:
    """Largest RMS deviation [N] of a held tension while the rover drives away."""
    worst, details = 0.0, {}
    for depth, away, tension in (
        (5.0, 3.0, 0.5),
        (5.0, 3.0, 1.5),
        (15.0, 4.0, 1.0),
        (45.0, 5.0, 1.5),
    ):
        error, distance = _driven_off(depth, away, tension, batch)
        worst = max(worst, error)
        details[f"{tension:g} N at {depth:g} m"] = f"{error:.3f} N RMS over {distance:.2f} m"
    return Measured(worst, "at 0.1 m/s of the wheels", details)
