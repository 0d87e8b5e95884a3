"""Requests to the drive: what is executed, and why the rest is refused. Pure.

A request is refused with the reason if the mechanism cannot do it, the tether does not reach the
goal, the rover hangs, jumps or is under descent control, the winch is not armed, or a sensor is
stale.
"""

from __future__ import annotations

import math

from msg_schemas import topics
from msg_schemas.faults import Reason
from msg_schemas.phases import DrivePhase
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import PathSample, PoseEstimateSample, PoseSample, TwistSample
from rover_control.drive.drive_controller import DriveController
from rover_control.drive.drive_planner import DriveGoal
from rover_control.drive.ratchet_kinematics import GroundPose

_NANO = 1e9
_AXES = 6  # of a pose's covariance


class DriveRequests:
    """Executes or refuses each request to the drive.

    Args:
        drive: that executes them.
    """

    def __init__(self, drive: DriveController) -> None:
        self.drive = drive

    def set_pose(self, sample: PoseEstimateSample) -> None:
        """Set the pose of the rover in map.

        Raises:
            Refusal: the rover is driving.
        """
        drive = self.drive
        if drive.wheels.is_driving:
            raise Refusal(
                topics.DRIVE_START,
                RefusalCode.WRONG_PHASE,
                f"the rover is driving ({drive.wheels.phase}); call {topics.DRIVE_STOP} first",
            )
        goal = goal_of(sample)
        heading = goal.heading if goal.has_heading else 0.0
        variances = sample.pose_covariance[:: _AXES + 1]
        errors = None
        if variances:
            errors = math.sqrt(variances[0]), math.sqrt(variances[1]), math.sqrt(variances[5])
        drive.odometry.set_pose(
            GroundPose(goal.x, goal.y, heading), knows_heading=goal.has_heading, errors=errors
        )

    def go_to(self, sample: PoseSample, now_ns: int) -> None:
        """Drive to a pose.

        Raises:
            Refusal: the pose is out of reach, or the rover is not ready.
        """
        self._drive_to(topics.DRIVE_GOAL, (goal_of(sample),), now_ns)

    def follow_path(self, sample: PathSample, now_ns: int) -> None:
        """Drive through poses.

        Raises:
            Refusal: the path is empty, a pose is out of reach, or the rover is not ready.
        """
        if not sample.poses:
            raise Refusal(
                topics.DRIVE_PATH,
                RefusalCode.WRONG_LENGTH,
                "the path has no poses; send at least one",
            )
        self._drive_to(topics.DRIVE_PATH, tuple(map(goal_of, sample.poses)), now_ns)

    def steer(self, sample: TwistSample, now_ns: int) -> None:
        """Drive at a twist of base_link until the twist times out.

        Raises:
            Refusal: the mechanism cannot, a limit is exceeded, or the rover is not ready.
        """
        drive = self.drive
        forward, turn = sample.linear[0], sample.angular[2]
        rate = drive.kinematics.wheel_rate(forward, turn)
        p = drive.settings.follower
        for name, value, limit, unit in (
            ("linear.x", forward if rate >= 0.0 else 0.0, p.drive_speed, "m/s"),
            ("angular.z", turn, p.turn_rate, "rad/s"),
        ):
            if value > limit * (1.0 + 1e-9):
                raise Refusal(
                    topics.CMD_VEL,
                    RefusalCode.OUT_OF_LIMITS,
                    f"{name} is {value:g} {unit}, limit {limit:g} {unit}",
                )
        if rate == 0.0:
            if drive.wheels.phase is DrivePhase.STEERED:
                drive.steered_at = now_ns / _NANO
                drive.follower.steer(0.0, drive.steered_at)
            elif drive.wheels.is_driving:
                drive.follower.stop("zero twist received", Reason.REQUESTED, now_ns / _NANO)
            return
        if drive.wheels.phase is not DrivePhase.STEERED:
            self._check_ready(topics.CMD_VEL, now_ns)
        drive.steered_at = now_ns / _NANO
        drive.follower.steer(rate, drive.steered_at)

    def stop(self, now_ns: int) -> str:
        """Stop and discard all goals; always accepted."""
        drive = self.drive
        if drive.wheels.is_driving:
            drive.follower.stop("stop requested", Reason.REQUESTED, now_ns / _NANO)
        else:
            drive.follower.phase = DrivePhase.RELEASED
        return "drive_node has released wheels and winch"

    def _drive_to(self, subject: str, goals: tuple[DriveGoal, ...], now_ns: int) -> None:
        self._check_ready(subject, now_ns)
        for goal in goals:
            self._check_reach(subject, goal)
        self.drive.follower.drive_to(goals, now_ns / _NANO)

    def _check_reach(self, subject: str, goal: DriveGoal) -> None:
        distance = math.hypot(goal.x, goal.y)
        max_length = self.drive.settings.tether.max_tether_length
        drop = self.drive.odometry.drop
        reach = math.sqrt(max(max_length**2 - drop**2, 0.0))
        if distance > reach:
            raise Refusal(
                subject,
                RefusalCode.OUT_OF_LIMITS,
                f"({goal.x:g}, {goal.y:g}) m is {distance:.4g} m from the plumb line; the tether "
                f"of {max_length:g} m reaches {reach:.4g} m",
            )

    def _check_ready(self, subject: str, now_ns: int) -> None:
        drive = self.drive
        stale = drive.sensors.waiting_for(now_ns)
        if stale:
            raise Refusal(subject, RefusalCode.STALE, f"{', '.join(stale)} missing or stale")
        if drive.sensors.off_floor_since is not None:
            raise Refusal(
                subject,
                RefusalCode.WRONG_PHASE,
                "the contact switch reports no floor; the rover must stand on the floor to drive",
            )
        tilt, limit_tilt = drive.odometry.attitude.inclination, drive.settings.drive.rollover_tilt
        if tilt > limit_tilt:
            raise Refusal(
                subject,
                RefusalCode.WRONG_PHASE,
                f"the rover has rolled over: tilt {math.degrees(tilt):.3g} deg, limit "
                f"{math.degrees(limit_tilt):.3g} deg; set it upright first",
            )
        conflict = drive.wheels.conflict()
        if conflict:
            raise Refusal(subject, RefusalCode.WRONG_PHASE, conflict)
        not_ready_reason = drive.tether.not_ready_reason()
        if not_ready_reason:
            raise Refusal(subject, RefusalCode.NOT_ARMED, not_ready_reason)


def goal_of(sample: PoseSample | PoseEstimateSample) -> DriveGoal:
    """Goal on the ground; an all-zero orientation leaves the heading open."""
    x, y, z, w = sample.orientation
    heading = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    is_open = not any(sample.orientation)
    return DriveGoal(sample.position[0], sample.position[1], math.nan if is_open else heading)
