"""Published poses of the drive controller."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from msg_schemas import topics
from msg_schemas.samples import ImuSample, PoseEstimateSample
from rover_control.drive.drive_controller import DriveController
from rover_control.drive.drive_node import DriveNode
from rover_control.drive.drive_odometry import UNKNOWN_ANGLE
from rover_control.drive.drive_report import odometry_sample, pose_sample
from rover_control.drive.drive_requests import DriveRequests
from rover_control.drive.drive_settings import DriveSettings
from rover_runtime.loop_host import LoopHost

STEP = 10_000_000  # [ns]


@pytest.mark.parametrize(("pitch", "roll"), [(0.2, 0.0), (0.0, -0.3), (0.15, 0.25), (-0.4, 0.1)])
def test_a_standing_rover_publishes_its_tilt_and_heading(pitch: float, roll: float):
    heading = 1.2
    true = Rotation.from_euler("ZYX", [heading, pitch, roll])
    force = tuple(true.inv().apply([0.0, 0.0, 1.62]).tolist())
    drive = DriveController(DriveSettings())
    for step in range(20_000):
        sample = ImuSample(step * STEP, (0.0, 0.0, 0.0), force)
        drive.sensors.on_imu(sample, step * STEP)
    turned = (0.0, 0.0, math.sin(0.5 * heading), math.cos(0.5 * heading))
    DriveRequests(drive).set_pose(PoseEstimateSample(0, (2.0, 1.0, 0.0), turned))
    pose, odometry = pose_sample(drive, 0), odometry_sample(drive, 0)
    assert (Rotation.from_quat(pose.orientation).inv() * true).magnitude() < 1e-3
    assert pose.heading == pytest.approx(heading)
    # odom is map turned about the vertical.
    turn = Rotation.from_quat(pose.orientation) * Rotation.from_quat(odometry.orientation).inv()
    assert turn.apply([0.0, 0.0, 1.0]) == pytest.approx([0.0, 0.0, 1.0], abs=1e-9)
    spread = np.sqrt(np.reshape(pose.pose_covariance, (6, 6)).diagonal())
    assert spread[3:5] == pytest.approx(drive.odometry.parameters.tilt_std)


def test_a_node_that_was_inactive_knows_no_pose():
    host = LoopHost()
    node = host.start(DriveNode)
    poses: list[PoseEstimateSample] = []
    host.exchange.listen(lambda _name, sample, *_: poses.append(sample), topics.POSE)
    host.run(0.5)
    ahead = (0.0, 0.0, 0.0, 1.0)
    host.request(topics.DRIVE_START, PoseEstimateSample(host.now_ns(), (2.0, 1.0, 0.0), ahead))
    host.run(0.5)
    assert poses[-1].pose_covariance[35] < 0.01
    node.deactivate()
    node.activate()
    host.run(0.5)
    assert poses[-1].pose_covariance[35] == pytest.approx(UNKNOWN_ANGLE)
