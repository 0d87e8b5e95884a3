"""Poses of drive_node against the truth, flown with the simulated rover."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from msg_schemas import machine, topics
from msg_schemas.events import JumpEvent
from msg_schemas.samples import PoseEstimateSample, PoseSample
from rover_control.drive.drive_odometry import OdometryParameters
from rover_verify.checks.floor import Stand, start_on_floor, true_pose
from rover_verify.harness.flight import JUMP, Flight


def estimate(flight: Flight) -> PoseEstimateSample:
    sample = flight.last[topics.POSE]
    assert isinstance(sample, PoseEstimateSample)
    return sample


def start(stand: Stand, number: int) -> Flight:
    flight = start_on_floor(JUMP, stand.overrides(), number)
    flight.keep(topics.POSE)
    flight.run(1.0)
    return flight


def jump(flight: Flight, stroke: float) -> None:
    flight.request(topics.JUMP_REQUEST, machine.JUMP_STROKE, stroke)
    assert flight.run(60.0, lambda: bool(flight.events_named(JumpEvent.STANDBY)))
    flight.run(1.0)


@pytest.mark.slow
def test_the_pose_follows_jumps_within_its_standard_deviation():
    generator = np.random.default_rng(3)
    carried, errors, squares = [], [], []
    for number in range(1, 7):
        stand = Stand(
            x=generator.uniform(0.5, 3.0),
            heading=generator.uniform(-3.0, 3.0),
            slope=math.radians(generator.uniform(0.0, 10.0)),
            downhill=generator.uniform(-3.0, 3.0),
        )
        flight = start(stand, number)
        before, known = np.array(true_pose(flight.state)[:2]), estimate(flight)
        jump(flight, generator.uniform(0.08, 0.16))
        after = estimate(flight)
        carried.append(np.array(true_pose(flight.state)[:2]) - before)
        seen = np.subtract(after.position, known.position)[:2]
        added = np.subtract(after.pose_covariance, known.pose_covariance)[[0, 7]]
        errors.append(seen - carried[-1])
        squares.append(errors[-1] @ errors[-1] / added.sum())
    assert np.max(np.linalg.norm(carried, axis=1)) > 0.1
    assert np.max(np.linalg.norm(errors, axis=1)) < 0.03
    assert 0.1 < np.mean(squares) < 3.0


def test_a_driving_rover_publishes_its_tilt():
    # Across the slope and uphill: downhill its ratchets let it roll.
    flight = start(Stand(heading=-1.0, slope=math.radians(8.0), downhill=1.0), 1)
    errors = []

    def compare(_topic: str, sample: PoseEstimateSample, _sender: str, _now_ns: int) -> None:
        true = flight.state.rotation[2]
        seen = Rotation.from_quat(sample.orientation).as_matrix()[2]
        errors.append(math.acos(min(float(true @ seen), 1.0)))

    flight.host.exchange.listen(compare, topics.POSE)  # type: ignore[arg-type]
    x, y, _ = true_pose(flight.state)
    flight.host.request(topics.DRIVE_GOAL, PoseSample(flight.now_ns, (x + 0.6, y - 0.6, 0.0)))
    flight.run(40.0)
    assert math.hypot(*np.subtract(true_pose(flight.state)[:2], (x, y))) > 0.5
    assert math.sqrt(np.mean(np.square(errors))) < OdometryParameters().tilt_std
