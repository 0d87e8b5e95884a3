"""Accuracy of driven squares."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from msg_schemas.events import DriveEvent
from msg_schemas.samples import PathSample, PoseSample
from rover_control.drive import DriveSettings
from rover_verify.checks import Batch, Measured
from rover_verify.checks.driving_rig import DrivenRover, level_floor
from rover_verify.checks.flights import fly_batch

_SIDE = 10.0  # side of the square [m]
_LIMIT = 2500.0  # time limit of a square [s]
_RUNS = 20
_SCATTERS = (0.01, 0.02)


class Square(NamedTuple):
    """Result of a driven square."""

    closing: float  # distance from the true end to the true start [m]; inf = not finished
    estimate_error: float  # distance from the estimated to the true end [m]
    reported_std: float  # standard deviation of that distance, from the odometry [m]
    time: float  # [s]
    peak_tension: float  # [N]
    end: str  # last event


def drive_square(seed: int, index: int, scatter: float) -> Square:
    """One square around the plumb line; the slip of each side changes randomly at each corner."""
    generator = np.random.default_rng([seed, index, round(1e4 * scatter)])
    corner = -0.5 * _SIDE
    rover = DrivenRover(level_floor(corner, corner), DriveSettings(), seed=1000 * seed + index)
    rover.begin()
    start = rover.pose
    x, y = start.x, start.y
    turned = (0.0, 0.0, math.sin(0.5 * start.heading), math.cos(0.5 * start.heading))
    corners = [
        PoseSample(0, (x + _SIDE, y, 0.0)),
        PoseSample(0, (x + _SIDE, y + _SIDE, 0.0)),
        PoseSample(0, (x, y + _SIDE, 0.0)),
        PoseSample(0, (x, y, 0.0), turned),
    ]
    rover.drive.request_path(PathSample(0, tuple(corners)), rover.now_ns)
    reached = -1
    while rover.drive.is_busy and rover.time < _LIMIT:
        if len(rover.events_named(DriveEvent.GOAL_REACHED)) != reached:
            reached = len(rover.events_named(DriveEvent.GOAL_REACHED))
            left, right = (float(scatter * each) for each in generator.standard_normal(2))
            rover.slip = (left, right)
        rover.tick()
    rover.run(5.0)
    end, odometry = rover.pose, rover.drive.odometry
    done = bool(rover.events_named(DriveEvent.COMPLETED))
    cov = odometry.covariance()
    last = rover.changes[-1][1]
    return Square(
        math.hypot(end.x - x, end.y - y) if done else math.inf,
        math.hypot(odometry.pose.x - end.x, odometry.pose.y - end.y),
        math.sqrt(float(cov[0, 0] + cov[1, 1])),
        rover.time,
        rover.peak_tension,
        f"{last.name}: {last.message}",
    )


def _closing(batch: Batch, scatter: float, limit: float) -> Measured:
    runs = batch.runs if batch.runs > 0 else _RUNS
    squares = fly_batch(batch, runs, drive_square, scatter)
    closing = np.array([square.closing for square in squares])
    fraction = float(np.mean(closing <= limit))
    details: dict[str, float | str] = {
        f"run {index}": (
            f"closes within {square.closing:.3f} m after {square.time:.0f} s, estimation error "
            f"{square.estimate_error:.3f} m (standard deviation {square.reported_std:.3f} m), "
            f"tension up to {square.peak_tension:.1f} N; {square.end}"
        )
        for index, square in enumerate(squares)
    }
    note = f"{runs} squares on level regolith, median {float(np.median(closing)):.3f} m"
    return Measured(fraction, note, details)


def square_at_1_percent(batch: Batch) -> Measured:
    """Share of squares of 10 m that close within 0.5 m at 1 % slip scatter per side."""
    return _closing(batch, _SCATTERS[0], 0.5)


def square_at_2_percent(batch: Batch) -> Measured:
    """Share of squares of 10 m that close within 1 m at 2 % slip scatter per side."""
    return _closing(batch, _SCATTERS[1], 1.0)
