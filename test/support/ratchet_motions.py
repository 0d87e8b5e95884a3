"""Poses after the motions of an ideal mechanism with two ratchets."""

from __future__ import annotations

from rover_control.drive.ratchet_kinematics import GroundPose, RatchetKinematics


def turned(ratchets: RatchetKinematics, pose: GroundPose, angle: float) -> GroundPose:
    """Pose after a left turn [rad]."""
    return ratchets.pose_at(ratchets.pivot_of(pose), pose.heading + angle)


def driven(pose: GroundPose, travel: float) -> GroundPose:
    """Pose after a straight segment [m]."""
    return GroundPose(*pose.to_map(travel, 0.0), pose.heading)
