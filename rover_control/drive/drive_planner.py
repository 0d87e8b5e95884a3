"""Path planning for the ratchet drive: left turn, straight segment, left turn. Pure.

A turn leaves the pivot in place (module `ratchet_kinematics`), so exactly one straight segment,
from pivot to pivot, leads to a goal pose. For a goal without heading the segment is the one that
takes base_link there, parallel to the pivot's path. If such a goal lies too close to the pivot, no
turn points at it: the rover drives on and approaches from farther away.

There are no right turns, so a heading slightly too far left costs a full turn. Three measures make
that rare: each segment aims slightly right of the goal, so that the next correction is a left turn;
a path is divided into segments that are aimed one by one; and the curvature of the rover's straight
driving, estimated on earlier segments, is compensated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas.parameters import parameter
from rover_control.drive.ratchet_kinematics import GroundPose, RatchetKinematics, left_turn, wrapped


@dataclass(frozen=True)
class PlannerParameters:
    """Goal tolerances, and how a path is divided into segments and aimed."""

    xy_goal_tolerance: float = parameter(0.10, "m", "position tolerance at a goal", 0.01, 10.0)
    yaw_goal_tolerance: float = parameter(0.05, "rad", "heading tolerance at a goal", 0.005, 1.0)
    aim_offset: float = parameter(
        0.03, "rad", "offset of the aim to the right of the goal, except on the last segment",
        0.0, 0.5,
    )  # fmt: skip
    first_segment: float = parameter(
        1.0, "m", "length of a path's first segment, which measures the rover's curvature", 0.1, 1e3
    )
    segment_fraction: float = parameter(
        0.5, "-", "length of a further segment as a fraction of the remaining path", 0.1, 0.9
    )
    last_segment: float = parameter(
        1.5, "m", "remaining path up to which one last segment follows", 0.1, 1e3
    )
    curvature_memory: float = parameter(
        1.0, "m", "distance over which the curvature estimate forgets", 0.01, 1e3
    )


class DriveGoal(NamedTuple):
    """Goal position of base_link, with an optional heading."""

    x: float
    y: float
    heading: float = math.nan  # NaN = any [rad]

    @property
    def has_heading(self) -> bool:
        """Whether the goal has a heading."""
        return not math.isnan(self.heading)


_ESCAPE_DISTANCE = 0.6  # length of the segment away from an unreachable goal [m]


def _is_unreachable(kinematics: RatchetKinematics, start: GroundPose, goal: DriveGoal) -> bool:
    """Whether no turn about the pivot points at a goal without heading."""
    px, py = kinematics.pivot_of(start)
    distance = math.hypot(goal.x - px, goal.y - py)
    return not goal.has_heading and distance <= abs(kinematics.pivot[1])


def course(
    kinematics: RatchetKinematics, start: GroundPose, goal: DriveGoal
) -> tuple[float, float]:
    """Heading [rad] and length [m] of the straight segment to a reachable goal."""
    px, py = kinematics.pivot_of(start)
    if goal.has_heading:
        gx, gy = kinematics.pivot_of(GroundPose(goal.x, goal.y, goal.heading))
        length = math.hypot(gx - px, gy - py)
        return (math.atan2(gy - py, gx - px) if length > 1e-9 else start.heading), length
    distance = math.hypot(goal.x - px, goal.y - py)
    ahead, left = kinematics.pivot
    heading = math.atan2(goal.y - py, goal.x - px) - math.asin(-left / distance)
    return wrapped(heading), math.sqrt(distance**2 - left**2) + ahead


class Segment(NamedTuple):
    """A left turn followed by a straight segment."""

    turn: float  # left turn before the segment [rad]
    length: float  # of the segment [m]


class DrivePlanner:
    """Plans the segments of a path, each from the estimated pose.

    Args:
        kinematics: of the chassis.
        parameters: tolerances and segmentation.
    """

    def __init__(self, kinematics: RatchetKinematics, parameters: PlannerParameters) -> None:
        self.kinematics = kinematics
        self.parameters = parameters
        self.curvature = 0.0  # of straight driving, left positive [rad/m]

    def update_curvature(self, turned: float, length: float) -> None:
        """Update the curvature estimate with the turn [rad] on a straight segment [m]."""
        if length > 0.0:
            fraction = length / (length + self.parameters.curvature_memory)
            self.curvature += fraction * (turned / length - self.curvature)

    def is_at_goal(self, pose: GroundPose, goal: DriveGoal) -> bool:
        """Whether the goal position is reached, whatever the heading."""
        if goal.has_heading:
            # A last turn moves base_link: compare the position after it.
            pivot = self.kinematics.pivot_of(pose)
            pose = self.kinematics.pose_at(pivot, goal.heading)
        return pose.distance(goal.x, goal.y) <= self.parameters.xy_goal_tolerance

    def last_turn(self, pose: GroundPose, goal: DriveGoal) -> float:
        """Left turn [rad] that remains to the goal's heading; 0 within the tolerance."""
        if not goal.has_heading:
            return 0.0
        if abs(wrapped(goal.heading - pose.heading)) <= self.parameters.yaw_goal_tolerance:
            return 0.0
        return left_turn(pose.heading, goal.heading)

    def next_segment(self, pose: GroundPose, goal: DriveGoal, *, is_first: bool) -> Segment:
        """Plan the next turn and straight segment, which may be the first to the goal."""
        p = self.parameters
        if _is_unreachable(self.kinematics, pose, goal):
            return Segment(0.0, _ESCAPE_DISTANCE)
        heading, remaining = course(self.kinematics, pose, goal)
        is_last = remaining <= p.last_segment
        length = remaining
        if not is_last:
            length = min(p.first_segment, remaining) if is_first else p.segment_fraction * remaining
        # The chord of an arc deviates from its first tangent by half the arc's angle.
        aim = heading - 0.5 * self.curvature * length - (0.0 if is_last else p.aim_offset)
        turn = left_turn(pose.heading, aim)
        if self._keeps_heading(wrapped(pose.heading - aim), remaining, is_last=is_last):
            turn = 0.0
        return Segment(turn, length)

    def _keeps_heading(self, excess: float, remaining: float, *, is_last: bool) -> bool:
        """Whether a heading `excess` [rad] left of the aim is accepted without a turn."""
        p = self.parameters
        if excess < 0.0:  # skip a left turn that gains less than a tenth of the tolerance
            return -excess * remaining < 0.1 * p.xy_goal_tolerance
        if is_last:
            return excess * remaining < 0.8 * p.xy_goal_tolerance
        return (excess - p.aim_offset) * remaining < 0.5 * p.xy_goal_tolerance
