"""Limits of the winch: bounds of the trim.

Also tracking with a layered drum, and the tension hold while the rover drives.
"""

from __future__ import annotations

import math

import numpy as np

from msg_schemas import machine, topics
from msg_schemas.events import DriveEvent
from msg_schemas.phases import WinchMode
from msg_schemas.samples import PoseEstimateSample, PoseSample
from rover_sim import SpatialState
from rover_sim.node.sim_loop import Tick
from rover_verify.checks import CheckBatch, Measured
from rover_verify.checks.winch_flights import fly_winch, is_at_rest, request
from rover_verify.checks.winch_record import TICK, WinchRecorder
from rover_verify.harness.flight import Flight
from tether_winch.servo import ServoParameters

_WINCH = "winch_node"
_RENEWAL = 0.5  # [s]


# --- layers -------------------------------------------------------------------------------------

_PITCH, _TURNS = 1.5e-3, 20.0  # of layers as thick as the tether; nine of them on the drum


def layered_length_error(batch: CheckBatch) -> Measured:
    """Largest distance [m] of the drum's length from its reference, on a drum with layers."""
    layers = {"layer_pitch": _PITCH, "turns_per_layer": _TURNS}
    overrides = {f"winch.{name}": value for name, value in layers.items()}
    flight = fly_winch({"tether.length": 2.2, **overrides}, batch.seed, parameters={_WINCH: layers})
    recorder = WinchRecorder(flight)
    for goal in (30.0, 2.2):
        request(flight, machine.WINCH_TO_LENGTH, goal, 0.3)
        flight.run(150.0, lambda: is_at_rest(flight))
        flight.run(1.0)
    radii = [flight.winch.drum.radius(length) for length in (2.2, 30.0)]
    note = f"2.2 to 30 m and back; radius {radii[0]:.4f} to {radii[1]:.4f} m"
    return Measured(recorder.record().length_error(), note)


# --- trim ---------------------------------------------------------------------------------------


def _trim(seed: int, rate: float, period: float) -> tuple[float, float]:
    """Most that is added to rate [m/s] and length [m] of a winch that holds 20 m.

    It is trimmed by a rate [m/s], or by its oscillation of a period [s].
    """
    flight = fly_winch({"tether.length": 20.0}, seed)
    rows: list[tuple[float, float]] = []

    def on_command(*_: object) -> None:
        aim, motion = flight.winch.servo.reference, flight.winch.servo.motion
        rows.append((aim.rate - motion.rate, aim.length - motion.length))

    flight.host.exchange.listen(on_command, topics.WINCH_COMMAND)
    flight.request(topics.WINCH_REQUEST, machine.WINCH_TO_LENGTH, 20.0 + 1e-3, 0.3)
    begun = flight.time
    while (at := flight.time - begun) < max(20.0, 2.0 * min(period, 20.0)):
        setpoint = rate if math.isinf(period) else rate * math.cos(2.0 * math.pi * at / period)
        flight.request(topics.WINCH_TRIM, machine.WINCH_DRUM, 0.0, setpoint)
        flight.run(5.0 * TICK)
    most_rate, most_length = np.abs(rows).max(axis=0)
    return float(most_rate), float(most_length)


def trim_excess(batch: CheckBatch) -> Measured:
    """How far a trim passes the largest rate or length that it may add, over that bound."""
    p = ServoParameters()
    worst, details = -math.inf, {}
    for name, rate, period in (
        ("steadily out", 0.3, math.inf),
        ("steadily in", -0.3, math.inf),
        ("swing of 45 m", 0.05, 33.0),
        ("twice the swing of 10 m", 0.08, 7.8),
    ):
        most_rate, length = _trim(batch.seed, rate, period)
        worst = max(worst, most_rate / p.trim_rate - 1.0, length / p.trim_length - 1.0)
        details[name] = (
            f"added at most {most_rate:.3f} m/s of {p.trim_rate:g} and {length:.3f} m of "
            f"{p.trim_length:g}"
        )
    return Measured(worst, details=details)


# --- tension ------------------------------------------------------------------------------------

# That the rover drives [m]; under the tension it slips, which its odometry cannot see.
_DISTANCE = 1.2
_LONGEST = 140  # renewals of the tension while it drives
_TURNING = 0.05  # rate of a wheel above which the rover drives [rad/s]


def _driven_off(
    depth: float, away: float, tension: float, batch: CheckBatch
) -> tuple[float, float]:
    """RMS deviation of the held tension while the rover drives off [N], and its distance [m]."""
    flight = fly_winch(
        {
            "environment.floor": {"height": -depth},
            "start.kind": "grounded",
            "start.position": [away, 0.0],
            "start.settling_time": 300.0,
            "tether.length": round(math.hypot(depth, away) + 0.5, 3),
        },
        batch.seed,
        controllers=(_WINCH, "drive_node"),
        parameters={"drive_node": {"uses_winch": False}},
    )
    flight.run(2.5)
    request(flight, machine.WINCH_SLACK, 0.0)
    flight.run(60.0, lambda: flight.winch.mode is WinchMode.HOLD and is_at_rest(flight))
    for _ in range(4):  # the rover comes to stand under the tension
        _hold_tension(flight, tension)
    place = float(flight.state.G1[0])
    flight.host.request(topics.DRIVE_START, PoseEstimateSample(0, (place, 0.0, 0.0)))
    flight.run(0.1)
    flight.host.request(topics.DRIVE_GOAL, PoseSample(0, (place + _DISTANCE, 0.0, 0.0)))
    errors: list[float] = []

    def on_tick(tick: Tick[SpatialState]) -> None:
        if max(map(abs, tick.after.wheel_rates)) > _TURNING:
            errors.append(tick.result.forces.fairlead_tension - tension)

    flight.sim.observers.append(on_tick)
    for _ in range(_LONGEST):
        _hold_tension(flight, tension)
        if flight.events_named(DriveEvent.COMPLETED):
            break
    distance = float(flight.state.G1[0]) - place
    if flight.winch.mode is not WinchMode.TENSION or distance < 0.5 * _DISTANCE:
        return math.inf, distance
    return float(np.sqrt(np.mean(np.square(errors)))), distance


def _hold_tension(flight: Flight, tension: float) -> None:
    flight.request(topics.WINCH_REQUEST, machine.WINCH_AT_TENSION, 0.0, 0.3, tension)
    flight.run(_RENEWAL)


def driven_tension_error(batch: CheckBatch) -> Measured:
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
    return Measured(worst, f"driving {_DISTANCE:g} m away by drive_node", details)
