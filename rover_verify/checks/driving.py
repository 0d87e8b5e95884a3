"""Accuracy of driven squares."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from msg_schemas import topics
from msg_schemas.events import DriveEvent
from msg_schemas.samples import PathSample, PoseEstimateSample, PoseSample
from rover_sim.node.sim_loop import Tick
from rover_sim.physics.rover import spatial_rover
from rover_verify.checks import CheckBatch, Measured, per_run
from rover_verify.checks.flights import fly_batch
from rover_verify.checks.floor import Stand, start_on_floor, true_pose
from rover_verify.harness.flight import Flight

_SIDE = 10.0  # side of the square [m]
_LIMIT = 2500.0  # time limit of a square [s]
_CONTROLLERS = ("winch_node", "drive_node")
_SLACK = 0.3  # of the tether at the start [m]
_AT_REST = 1.0e-3  # wheel rate [rad/s]
_ENDS = (DriveEvent.COMPLETED, DriveEvent.STOPPED, DriveEvent.STUCK, DriveEvent.FAILED)


class Square(NamedTuple):
    """Result of a driven square."""

    closing: float  # distance from the true end to the true start [m]; inf = not finished
    estimate_error: float  # distance from the estimated to the true end [m]
    reported_std: float  # standard deviation of that distance, from the odometry [m]
    time: float  # [s]
    peak_tension: float  # [N]
    end: str  # last event


class _SlippingWheels:
    """Moves the rover back along each wheel's path, as a slip that no sensor measures would.

    The slip is a fraction of each wheel's travel, in addition to that on the ground.

    Args:
        flight: of the rover.
        scatter: standard deviation of the slip of each side, drawn anew at each corner.
        generator: of the draws.
    """

    def __init__(self, flight: Flight, scatter: float, generator: np.random.Generator) -> None:
        self._flight, self._scatter, self._generator = flight, scatter, generator
        self._corners = -1
        self._slip = (0.0, 0.0)
        flight.sim.observers.append(self._on_tick)

    def _on_tick(self, tick: Tick[Any]) -> None:
        corners = len(self._flight.events_named(DriveEvent.GOAL_REACHED))
        if corners != self._corners:
            self._corners = corners
            left, right = self._scatter * self._generator.standard_normal(2)
            self._slip = (float(left), float(right))
        state, rover = tick.after, self._flight.plant.scenario.rover
        assert rover is not None
        radius, track_width = rover.wheels.radius, rover.wheels.track_width
        angles = zip(tick.before.wheel_angles, state.wheel_angles, strict=True)
        slipped = [radius * max(now - was, 0.0) * fraction for (was, now), fraction in
                zip(angles, self._slip, strict=True)]  # fmt: skip
        if not any(slipped):
            return
        turn = (slipped[0] - slipped[1]) / track_width
        shift = -0.5 * (slipped[0] + slipped[1])
        # About the middle of the axle, which lies ahead of base_link's origin.
        ahead = state.rotation[:, 0] * np.array([1.0, 1.0, 0.0])
        middle = state.G1 + rover.wheels.axle_x * ahead
        c, s = math.cos(turn), math.sin(turn)
        rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

        def displaced(place: np.ndarray) -> np.ndarray:
            return np.asarray(middle + rotation @ (place - middle) + shift * ahead)

        body, nodes = state.body.copy(), state.nodes.copy()
        at = spatial_rover.POSITION
        body[at : at + 3] = displaced(state.G1)
        for start in (spatial_rover.VELOCITY1, spatial_rover.VELOCITY2):
            body[start : start + 3] = rotation @ body[start : start + 3]
        at = spatial_rover.ORIENTATION
        w, x, y, z = body[at : at + 4]
        c, s = math.cos(0.5 * turn), math.sin(0.5 * turn)
        body[at : at + 4] = c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w
        nodes[-1, 0] = displaced(nodes[-1, 0])
        self._flight.simulation.state = state.replaced(body=body, nodes=nodes)


def drive_square(seed: int, index: int, scatter: float) -> Square:
    """One square around the plumb line; the slip of each side changes randomly at each corner."""
    generator = np.random.default_rng([seed, index, round(1e4 * scatter)])
    corner = -0.5 * _SIDE
    stand = Stand(corner, corner, slack=_SLACK)
    flight = start_on_floor(_CONTROLLERS, stand.overrides(), 1000 * seed + index)
    _SlippingWheels(flight, scatter, generator)
    flight.keep(topics.POSE)
    x, y, heading = true_pose(flight.state)
    turned = (0.0, 0.0, math.sin(0.5 * heading), math.cos(0.5 * heading))
    path = (
        PoseSample(0, (x + _SIDE, y, 0.0)),
        PoseSample(0, (x + _SIDE, y + _SIDE, 0.0)),
        PoseSample(0, (x, y + _SIDE, 0.0)),
        PoseSample(0, (x, y, 0.0), turned),
    )
    flight.host.request(topics.DRIVE_PATH, PathSample(flight.now_ns, path))
    flight.run(_LIMIT, lambda: any(flight.events_named(name) for name in _ENDS))
    flight.run(5.0, lambda: max(map(abs, flight.state.wheel_rates)) < _AT_REST)
    end_x, end_y, _ = true_pose(flight.state)
    pose = flight.last[topics.POSE]
    assert isinstance(pose, PoseEstimateSample)
    estimated_x, estimated_y, _ = pose.position
    has_closed = bool(flight.events_named(DriveEvent.COMPLETED))
    last = [each.status for each in flight.events if each.node == "drive_node"][-1]
    return Square(
        math.hypot(end_x - x, end_y - y) if has_closed else math.inf,
        math.hypot(estimated_x - end_x, estimated_y - end_y),
        math.sqrt(pose.pose_covariance[0] + pose.pose_covariance[7]),
        flight.time,
        flight.peak_tension,
        f"{last.name}: {last.message}",
    )


def closing(batch: CheckBatch, scatter: float, limit: float) -> Measured:
    """Share of squares that close within a limit [m], at a scatter of the slip per side."""
    runs = batch.runs
    squares = fly_batch(batch, runs, drive_square, scatter)
    distances = np.array([square.closing for square in squares])
    fraction = float(np.mean(distances <= limit))
    note = f"{runs} squares on level regolith, median {float(np.median(distances)):.3f} m"
    return Measured(fraction, note, per_run(squares))
