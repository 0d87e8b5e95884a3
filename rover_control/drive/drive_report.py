"""Published samples of the drive controller. Pure."""

from __future__ import annotations

import math

import numpy as np

from msg_schemas import machine
from msg_schemas.samples import (
    JointSample,
    JointValue,
    OdometrySample,
    PoseEstimateSample,
    Quaternion,
)
from rover_control.drive.drive_controller import DriveController
from rover_control.drive.drive_odometry import UNKNOWN_VARIANCE, DriveOdometry


def odometry_sample(drive: DriveController, stamp_ns: int) -> OdometrySample:
    """Pose of base_link in odom, and its twist."""
    odometry = drive.sensors.dead_reckoning
    x, y, heading = odometry.pose
    return OdometrySample(
        stamp_ns,
        (x, y, 0.0),
        _orientation(drive, heading),
        (odometry.speed, 0.0, 0.0),
        (0.0, 0.0, odometry.yaw_rate),
        _covariance(odometry, UNKNOWN_VARIANCE),
    )


def pose_sample(drive: DriveController, stamp_ns: int) -> PoseEstimateSample:
    """Pose of base_link in map."""
    odometry = drive.odometry
    x, y, heading = odometry.pose
    z, variance = odometry.height
    covariance = _covariance(odometry, variance)
    return PoseEstimateSample(stamp_ns, (x, y, z), _orientation(drive, heading), covariance)


def _orientation(drive: DriveController, heading: float) -> Quaternion:
    """Heading, pitch and roll, in this order about z, y and x.

    The tilt is the same in odom and map, so that these two differ by a heading.
    """
    attitude = drive.odometry.attitude
    halves = [0.5 * angle for angle in (heading, attitude.pitch, attitude.roll)]
    (cz, cy, cx), (sz, sy, sx) = map(math.cos, halves), map(math.sin, halves)
    return (
        cz * cy * sx - sz * sy * cx,
        cz * sy * cx + sz * cy * sx,
        sz * cy * cx - cz * sy * sx,
        cz * cy * cx + sz * sy * sx,
    )


def _covariance(odometry: DriveOdometry, of_height: float) -> tuple[float, ...]:
    """Return 6 x 6 values."""
    tilt = odometry.parameters.tilt_std**2
    full = np.diag([0.0, 0.0, of_height, tilt, tilt, 0.0])
    planar = (0, 1, 5)
    full[np.ix_(planar, planar)] = odometry.covariance()
    return tuple(full.ravel().tolist())


def state_sample(drive: DriveController, stamp_ns: int) -> JointSample:
    """Estimates of the drive controller."""
    odometry, follower = drive.odometry, drive.follower
    pose, cov, goal = odometry.pose, odometry.covariance(), follower.goal
    distance = 0.0 if goal is None else pose.distance(goal.x, goal.y)
    waiting = max(len(follower.goals) - 1, 0)
    return JointSample(
        stamp_ns,
        {
            machine.FORWARD: JointValue(odometry.travelled, odometry.speed),
            machine.YAW: JointValue(pose.heading, odometry.yaw_rate),
            machine.PITCH: JointValue(odometry.attitude.pitch),
            machine.ROLL: JointValue(odometry.attitude.roll),
            machine.SLIP: JointValue(odometry.slip),
            machine.GYRO_BIAS: JointValue(velocity=odometry.bias),
            machine.POSITION_ERROR: JointValue(math.sqrt(float(cov[0, 0] + cov[1, 1]))),
            machine.HEADING_ERROR: JointValue(math.sqrt(float(cov[2, 2]))),
            machine.GOAL_DISTANCE: JointValue(distance),
            machine.GOALS_LEFT: JointValue(float(waiting)),
            machine.WHEEL_EFFORT: JointValue(effort=drive.sensors.torque),
            machine.TETHER_RANGE: JointValue(odometry.tether_range),
            machine.TETHER_DROP: JointValue(odometry.drop),
        },
    )
