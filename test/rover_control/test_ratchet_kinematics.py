"""Feasible and infeasible motions of one motor with two ratchets."""

from __future__ import annotations

import math

import pytest
from ratchet_motions import turned

from msg_schemas.refusal import Refusal, RefusalCode
from rover_control.drive.ratchet_kinematics import (
    ChassisParameters,
    GroundPose,
    RatchetKinematics,
    left_turn,
    wrapped,
)

CHASSIS = ChassisParameters(wheel_radius=0.15, track_width=0.44, axle_offset=0.08)
RATCHETS = RatchetKinematics(CHASSIS)


def test_a_turn_leaves_the_right_wheel_where_it_is():
    pose = GroundPose(2.0, -1.0, 0.7)
    after = turned(RATCHETS, pose, 1.9)
    assert RATCHETS.pivot_of(after) == pytest.approx(RATCHETS.pivot_of(pose))
    assert after.heading == pytest.approx(2.6)
    # base_link moves on a circle about the right wheel, radius sqrt(0.08^2 + 0.22^2) m.
    chord = 2.0 * math.hypot(0.08, 0.22) * math.sin(0.95)
    assert pose.distance(after.x, after.y) == pytest.approx(chord)


def test_a_left_turn_moves_base_link_back():
    after = turned(RATCHETS, GroundPose(0.0, 0.0, 0.0), 0.01)
    # dr/dheading = z x (r - pivot) = (-0.22, -0.08) m.
    assert after.x == pytest.approx(-0.0022, rel=0.02)
    assert after.y == pytest.approx(-0.0008, rel=0.1)


def test_rates_follow_from_radius_width_and_slip():
    assert RATCHETS.driving_rate(0.1) == pytest.approx(0.1 / (0.15 * (1.0 - 0.256)))
    # The left wheel moves back on a circle with the radius of the track width.
    assert RATCHETS.turning_rate(0.2) == pytest.approx(-0.2 * 0.44 / (0.15 * (1.0 - 0.33)))


@pytest.mark.parametrize(
    ("forward", "turn", "rate"),
    [
        (0.0, 0.0, 0.0),
        (0.1, 0.0, RATCHETS.driving_rate(0.1)),
        (0.0, 0.2, RATCHETS.turning_rate(0.2)),
        (-0.22 * 0.2, 0.2, RATCHETS.turning_rate(0.2)),
    ],
)
def test_a_feasible_twist_gives_a_wheel_rate(forward: float, turn: float, rate: float):
    assert RATCHETS.wheel_rate(forward, turn) == pytest.approx(rate)


@pytest.mark.parametrize(
    ("forward", "turn", "reason"),
    [
        (-0.1, 0.0, r"-0\.1 m/s.*ratchet.*use linear\.x >= 0"),
        (0.0, -0.2, r"-0\.2 rad/s.*left only; use angular\.z > 0"),
        (0.1, -0.2, r"left only"),
        (
            0.1,
            0.2,
            r"0\.1 m/s with angular\.z 0\.2.*use angular\.z 0, or linear\.x 0 \(or -0\.044 m/s",
        ),
    ],
)
def test_an_infeasible_twist_is_refused_with_the_alternative(
    forward: float, turn: float, reason: str
):
    with pytest.raises(Refusal, match=reason) as refused:
        RATCHETS.wheel_rate(forward, turn)
    assert refused.value.code is RefusalCode.NOT_SUPPORTED


def test_angles_are_wrapped_and_left_turns_are_never_negative():
    assert wrapped(3.0 * math.pi) == pytest.approx(math.pi)
    assert wrapped(-0.1) == pytest.approx(-0.1)
    assert left_turn(0.1, 0.0) == pytest.approx(2.0 * math.pi - 0.1)
    assert left_turn(3.0, -3.0) == pytest.approx(2.0 * math.pi - 6.0)
