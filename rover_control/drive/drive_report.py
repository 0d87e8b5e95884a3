"""Published samples of the drive controller. Pure."""

from __future__ import annotations

import math

from msg_schemas.machine import (
    FORWARD,
    GOAL_DISTANCE,
    GOALS_LEFT,
    GYRO_BIAS,
    HEADING_ERROR,
    PITCH,
    POSITION_ERROR,
    ROLL,
    SLIP,
    TETHER_RANGE,
    WHEEL_EFFORT,
    YAW,
)
from msg_schemas.samples import JointSample, JointValue, OdometrySample
from rover_control.drive.drive_controller import DriveController

_UNKNOWN = 1e6  # variance of quantities that are not estimated


def odometry_sample(drive: DriveController, stamp_ns: int) -> OdometrySample:
    """Pose, twist and covariance; z is the height of the tether attachment below the fairlead."""
    odometry = drive.odometry
    pose = odometry.pose
    half = 0.5 * pose.heading
    cov = odometry.covariance()
    full = [0.0] * 36
    # x, y and the rotation about z are rows 0, 1 and 5 of the message's 6 x 6 covariance.
    for i, jacobian in enumerate((0, 1, 5)):
        for j, column in enumerate((0, 1, 5)):
            full[6 * jacobian + column] = float(cov[i, j])
    for jacobian in (2, 3, 4):
        full[7 * jacobian] = _UNKNOWN
    return OdometrySample(
        stamp_ns,
        (pose.x, pose.y, -odometry.drop),
        (0.0, 0.0, math.sin(half), math.cos(half)),
        (odometry.speed, 0.0, 0.0),
        (0.0, 0.0, odometry.yaw_rate),
        tuple(full),
    )


def state_sample(drive: DriveController, stamp_ns: int) -> JointSample:
    """Estimates of the drive controller."""
    odometry, follower = drive.odometry, drive.follower
    pose, cov, goal = odometry.pose, odometry.covariance(), follower.goal
    distance = 0.0 if goal is None else pose.distance(goal.x, goal.y)
    waiting = max(len(follower.goals) - 1, 0)
    return JointSample(
        stamp_ns,
        {
            FORWARD: JointValue(odometry.travelled, odometry.speed),
            YAW: JointValue(pose.heading, odometry.yaw_rate),
            PITCH: JointValue(odometry.attitude.pitch),
            ROLL: JointValue(odometry.attitude.roll),
            SLIP: JointValue(odometry.slip),
            GYRO_BIAS: JointValue(velocity=odometry.bias),
            POSITION_ERROR: JointValue(math.sqrt(float(cov[0, 0] + cov[1, 1]))),
            HEADING_ERROR: JointValue(math.sqrt(float(cov[2, 2]))),
            GOAL_DISTANCE: JointValue(distance),
            GOALS_LEFT: JointValue(float(waiting)),
            WHEEL_EFFORT: JointValue(effort=drive.torque),
            TETHER_RANGE: JointValue(odometry.tether_range),
        },
    )
