"""From a goal on the ground to what ratchets can do: turn left, drive straight, turn left. Pure.

In the pivot's coordinates (module `ratchet_kinematics`) the two turns stand still, so a goal pose
takes exactly one straight way, from pivot to pivot; a goal that leaves the heading open takes the
straight way on which base_link comes there, which is beside the pivot's. Where that goal is under
the pivot no turn points at it: the rover drives on, and comes back from farther away.

No turn goes right, so a heading that has come out a little too far left costs a full turn. Three
things keep that rare: a straight way is aimed a little to the right of its goal, so that the next
correction is a left one; it is made in pieces, each aimed anew; and what the rover bends off by
itself, as learnt on the ways before, is allowed for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas.parameters import parameter
from rover_control.ratchet_kinematics import GroundPose, RatchetKinematics, left_turn, wrapped


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


class Goal(NamedTuple):
    """Where base_link is to be."""

    x: float
    y: float
    heading: float = math.nan  # NaN = left open [rad]

    @property
    def wants_heading(self) -> bool:
        """Whether a heading is asked for."""
        return not math.isnan(self.heading)


_AWAY = 0.6  # way from a goal that is too near to be turned to [m]


def _is_too_near(kinematics: RatchetKinematics, start: GroundPose, goal: Goal) -> bool:
    """Whether no turn about the right wheel points at a goal that leaves its heading open."""
    px, py = kinematics.pivot_of(start)
    distance = math.hypot(goal.x - px, goal.y - py)
    return not goal.wants_heading and distance <= abs(kinematics.pivot[1])


def course(kinematics: RatchetKinematics, start: GroundPose, goal: Goal) -> tuple[float, float]:
    """Heading [rad] and length [m] of the straight way to a goal that is not too near."""
    px, py = kinematics.pivot_of(start)
    if goal.wants_heading:
        gx, gy = kinematics.pivot_of(GroundPose(goal.x, goal.y, goal.heading))
        way = math.hypot(gx - px, gy - py)
        return (math.atan2(gy - py, gx - px) if way > 1e-9 else start.heading), way
    distance = math.hypot(goal.x - px, goal.y - py)
    ahead, left = kinematics.pivot
    heading = math.atan2(goal.y - py, goal.x - px) - math.asin(-left / distance)
    return wrapped(heading), math.sqrt(distance**2 - left**2) + ahead


class Piece(NamedTuple):
    """What to do next on the way to a goal."""

    turn: float  # left, at first [rad]
    way: float  # then straight [m]
    heading: float  # after the turn [rad]
    is_last: bool  # the way ends at the goal


class DrivePlanner:
    """Cuts the way to a goal into pieces, from the estimated pose each time.

    Args:
        kinematics: of the chassis.
        parameters: how.
    """

    def __init__(self, kinematics: RatchetKinematics, parameters: PlannerParameters) -> None:
        self.kinematics = kinematics
        self.parameters = parameters
        self.bend = 0.0  # turn by itself over the way, left positive [rad/m]
        self._pieces = 0

    def begin(self) -> None:
        """A new goal."""
        self._pieces = 0

    def learn(self, turned: float, way: float) -> None:
        """Take how far the rover has turned [rad] by itself on a straight way [m]."""
        if way > 0.0:
            share = way / (way + self.parameters.curvature_memory)
            self.bend += share * (turned / way - self.bend)

    def is_there(self, pose: GroundPose, goal: Goal) -> bool:
        """Whether the place is reached, whatever the heading."""
        if goal.wants_heading:
            # What a last turn makes of it.
            pivot = self.kinematics.pivot_of(pose)
            pose = self.kinematics.pose_at(pivot, goal.heading)
        return pose.distance(goal.x, goal.y) <= self.parameters.xy_goal_tolerance

    def last_turn(self, pose: GroundPose, goal: Goal) -> float:
        """Left turn [rad] that the goal's heading still needs, 0 where it is near enough."""
        if not goal.wants_heading:
            return 0.0
        if abs(wrapped(goal.heading - pose.heading)) <= self.parameters.yaw_goal_tolerance:
            return 0.0
        return left_turn(pose.heading, goal.heading)

    def next_piece(self, pose: GroundPose, goal: Goal) -> Piece:
        """The next turn and straight way."""
        p = self.parameters
        if _is_too_near(self.kinematics, pose, goal):
            return Piece(0.0, _AWAY, pose.heading, False)
        heading, left = course(self.kinematics, pose, goal)
        is_last = left <= p.last_segment
        way = left
        if not is_last:
            way = min(p.first_segment, left) if self._pieces == 0 else p.segment_fraction * left
        self._pieces += 1
        # The chord of an arc lies half its bend off its first tangent.
        aim = heading - 0.5 * self.bend * way - (0.0 if is_last else p.aim_offset)
        turn = left_turn(pose.heading, aim)
        if self._may_stay(wrapped(pose.heading - aim), left, is_last=is_last):
            turn = 0.0
        return Piece(turn, way, pose.heading + turn, is_last)

    def _may_stay(self, beyond: float, left: float, *, is_last: bool) -> bool:
        """Whether a heading may be left as it is that lies `beyond` [rad] left of the aim."""
        p = self.parameters
        if beyond < 0.0:  # a left turn is cheap, but not for nothing
            return -beyond * left < 0.1 * p.xy_goal_tolerance
        if is_last:
            return beyond * left < 0.8 * p.xy_goal_tolerance
        return (beyond - p.aim_offset) * left < 0.5 * p.xy_goal_tolerance
