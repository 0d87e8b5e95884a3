"""Planned turns and straight segments lead to the goal by left turns only."""

from __future__ import annotations

import math

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from ratchet_motions import driven, turned

from rover_control.drive.drive_planner import DriveGoal, DrivePlanner, PlannerParameters, course
from rover_control.drive.ratchet_kinematics import (
    ChassisParameters,
    GroundPose,
    RatchetKinematics,
    left_turn,
    wrapped,
)

RATCHETS = RatchetKinematics(ChassisParameters())
places = st.floats(-20.0, 20.0)
angles = st.floats(-math.pi, math.pi)
poses = st.builds(GroundPose, places, places, angles)


def executed(start: GroundPose, goal: DriveGoal) -> GroundPose:
    """The course to a goal, executed by the ideal mechanism."""
    heading, length = course(RATCHETS, start, goal)
    assert length >= 0.0
    pose = driven(turned(RATCHETS, start, left_turn(start.heading, heading)), length)
    assert wrapped(pose.heading - heading) == pytest.approx(0.0, abs=1e-9)
    if goal.has_heading:
        pose = turned(RATCHETS, pose, left_turn(pose.heading, goal.heading))
    return pose


@settings(deadline=None)
@given(poses, poses)
def test_two_turns_and_a_straight_segment_reach_every_pose(start: GroundPose, end: GroundPose):
    pose = executed(start, DriveGoal(*end))
    assert (pose.x, pose.y) == pytest.approx((end.x, end.y), abs=1e-9)
    assert wrapped(pose.heading - end.heading) == pytest.approx(0.0, abs=1e-9)


@settings(deadline=None)
@given(poses, places, places)
def test_a_turn_and_a_straight_segment_reach_every_position_not_under_the_wheel(
    start: GroundPose, x: float, y: float
):
    pivot = RATCHETS.pivot_of(start)
    assume(math.hypot(x - pivot[0], y - pivot[1]) > 0.22)
    pose = executed(start, DriveGoal(x, y))
    assert (pose.x, pose.y) == pytest.approx((x, y), abs=1e-7)


@settings(deadline=None)
@given(poses, angles, st.floats(0.0, 0.2199))
def test_a_position_under_the_wheel_is_reached_from_farther_away(
    start: GroundPose, towards: float, distance: float
):
    px, py = RATCHETS.pivot_of(start)
    goal = DriveGoal(px + distance * math.cos(towards), py + distance * math.sin(towards))
    away = planner().next_segment(start, goal, is_first=True)
    assert away.turn == 0.0
    pose = executed(driven(start, away.length), goal)
    assert (pose.x, pose.y) == pytest.approx((goal.x, goal.y), abs=1e-7)


def test_a_goal_ahead_of_the_rover_is_straight_ahead():
    start = GroundPose(1.0, 2.0, 0.5)
    heading, length = course(RATCHETS, start, DriveGoal(*driven(start, 3.0)))
    assert wrapped(heading - start.heading) == pytest.approx(0.0, abs=1e-9)
    assert length == pytest.approx(3.0)


def planner(**values: float) -> DrivePlanner:
    return DrivePlanner(RATCHETS, PlannerParameters(**values))


def test_a_long_path_has_segments_aimed_right_and_a_straight_last_one():
    made = planner(aim_offset=0.03, first_segment=1.0, segment_fraction=0.5, last_segment=1.5)
    goal = DriveGoal(10.0, 0.0, 0.0)
    first = made.next_segment(GroundPose(0.0, 0.0, -1.0), goal, is_first=True)
    assert first.length == pytest.approx(1.0)
    assert first.turn == pytest.approx(1.0 - 0.03, abs=0.05)
    second = made.next_segment(GroundPose(1.0, 0.0, -0.2), goal, is_first=False)
    assert second.length == pytest.approx(4.5, abs=0.1)
    last = made.next_segment(GroundPose(9.0, 0.0, 0.0), goal, is_first=False)
    assert last.length == pytest.approx(1.0)
    assert last.turn == 0.0


def test_a_heading_slightly_left_of_the_course_is_accepted():
    made, goal = planner(), DriveGoal(1.0, 0.0, 0.0)
    kept = made.next_segment(GroundPose(0.0, 0.0, 0.02), goal, is_first=True)
    assert kept.turn == 0.0
    away = made.next_segment(GroundPose(0.0, 0.0, 0.5), goal, is_first=True)
    assert away.turn > math.pi


def test_the_curvature_of_straight_driving_is_estimated_and_compensated():
    made = planner(curvature_memory=0.1)
    for _ in range(5):
        made.update_curvature(0.04, 2.0)
    assert made.curvature == pytest.approx(0.02, rel=0.01)
    # An arc of 0.02 rad/m over 1 m starts right of its chord.
    start, goal = GroundPose(0.0, 0.0, -1.0), DriveGoal(1.0, 0.0, 0.0)
    segment = made.next_segment(start, goal, is_first=True)
    straight = planner().next_segment(start, goal, is_first=True)
    assert segment.turn - straight.turn == pytest.approx(-0.5 * made.curvature * segment.length)


def test_a_goal_is_reached_if_the_last_turn_leads_there():
    made = planner(xy_goal_tolerance=0.05)
    goal = DriveGoal(3.0, 1.0, 2.0)
    before = turned(RATCHETS, GroundPose(3.0, 1.0, 2.0), -1.5)
    assert made.is_at_goal(before, goal)
    assert before.distance(3.0, 1.0) > 0.05
    assert made.last_turn(before, goal) == pytest.approx(1.5)
    assert made.last_turn(turned(RATCHETS, before, 1.49), goal) == 0.0
