"""Kinematics of one wheel motor with two ratchets. Pure.

The motor turns the left wheel. One ratchet couples the right wheel to it in forward rotation,
another holds the right wheel against backward rotation. The rover has two motions:

    motor forward    both wheels turn at the motor's rate: straight ahead;
    motor backward   the left wheel turns back, the right one is held: a left turn about the
                     contact point of the right wheel, the `pivot`.

It cannot drive backward or turn right; a right turn is a left turn by the rest of a full circle.
Two left turns with a straight segment between them reach every pose. In coordinates of the pivot
they decouple: a turn leaves the pivot in place, a straight segment moves it along the heading.

Poses are those of base_link on the ground: x, y in map [m], heading about z [rad]. On soft ground
a driven wheel slips: it covers (1 - slip) of its rolled distance. The slip is larger in a turn,
because the tail is dragged sideways and the other wheel is twisted on the spot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas import topics
from msg_schemas.parameters import parameter
from msg_schemas.refusal import Refusal, RefusalCode

_STILL = 1e-6  # speed [m/s] or rate [rad/s] that counts as zero


class GroundPose(NamedTuple):
    """Pose of base_link on the ground."""

    x: float
    y: float
    heading: float

    def to_map(self, ahead: float, left: float) -> tuple[float, float]:
        """Position in map [m] of a point given in base_link [m]."""
        c, s = math.cos(self.heading), math.sin(self.heading)
        return self.x + c * ahead - s * left, self.y + s * ahead + c * left

    def distance(self, x: float, y: float) -> float:
        """Distance to a point [m]."""
        return math.hypot(x - self.x, y - self.y)


def wrapped(angle: float) -> float:
    """The angle in (-pi, pi]."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


def left_turn(start: float, end: float) -> float:
    """Left turn [rad] from one heading to another, in [0, 2 pi)."""
    return (end - start) % (2.0 * math.pi)


@dataclass(frozen=True)
class ChassisParameters:
    """Geometry of the chassis and nominal slip of its wheels."""

    wheel_radius: float = parameter(0.15, "m", "radius of the wheels", 0.01, 2.0)
    track_width: float = parameter(0.44, "m", "distance between the wheels", 0.05, 5.0)
    axle_offset: float = parameter(
        0.08, "m", "distance of the axle ahead of base_link's origin", -2.0, 2.0
    )
    attachment_offset: float = parameter(
        0.28, "m", "height of the tether attachment above base_link's origin", -2.0, 2.0
    )
    driving_slip: float = parameter(
        0.256, "-", "nominal slip straight ahead on level regolith", 0.0, 0.9
    )
    driving_torque: float = parameter(
        0.575, "N m", "wheel torque at the nominal slip straight ahead", 0.0, 100.0
    )
    slip_per_torque: float = parameter(
        1.05, "1/(N m)", "increase of the slip per wheel torque", 0.0, 100.0
    )
    steep_torque: float = parameter(
        0.8, "N m", "wheel torque above which the slip increases more than linearly", 0.0, 100.0
    )
    slip_curvature: float = parameter(
        4.0, "1/(N m)^2", "increase of the slip per square of the torque above that", 0.0, 1e3
    )
    sideslip_per_force: float = parameter(
        0.115, "rad/N", "sideslip angle per lateral force on the rover", 0.0, 10.0
    )
    turning_slip: float = parameter(
        0.33, "-", "nominal slip of the left wheel in a turn on level regolith", 0.0, 0.9
    )


class RatchetKinematics:
    """Motions of the rover as functions of the motor's.

    Args:
        parameters: geometry and nominal slip.
    """

    def __init__(self, parameters: ChassisParameters) -> None:
        self.parameters = parameters

    @property
    def pivot(self) -> tuple[float, float]:
        """Position of the pivot in base_link: ahead and left [m]."""
        return self.parameters.axle_offset, -0.5 * self.parameters.track_width

    def pivot_of(self, pose: GroundPose) -> tuple[float, float]:
        """Position of the pivot in map [m]."""
        return pose.to_map(*self.pivot)

    def pose_at(self, pivot: tuple[float, float], heading: float) -> GroundPose:
        """Pose of base_link for a position of the pivot [m] and a heading [rad]."""
        ahead, left = self.pivot
        x, y = GroundPose(*pivot, heading).to_map(-ahead, -left)
        return GroundPose(x, y, heading)

    def speed(self, wheel_rate: float, slip: float | None = None) -> float:
        """Speed [m/s] of a wheel at a rate [rad/s]; slip None = nominal."""
        slip = self.parameters.driving_slip if slip is None else slip
        return self.parameters.wheel_radius * (1.0 - slip) * wheel_rate

    def driving_rate(self, speed: float) -> float:
        """Wheel rate [rad/s] for a speed straight ahead [m/s]."""
        return speed / self.speed(1.0)

    def yaw_rate(self, wheel_rate: float) -> float:
        """Yaw rate [rad/s] at a rate of the left wheel [rad/s] <= 0."""
        p = self.parameters
        return -self.speed(wheel_rate, p.turning_slip) / p.track_width

    def turning_rate(self, yaw_rate: float) -> float:
        """Rate of the left wheel [rad/s], <= 0, for a yaw rate [rad/s] >= 0."""
        return yaw_rate / self.yaw_rate(1.0)

    def wheel_rate(self, forward: float, yaw_rate: float) -> float:
        """Rate of the driven wheel [rad/s] for a twist of base_link.

        Args:
            forward: linear.x [m/s]; in a turn either 0 or the speed that the turn implies.
            yaw_rate: angular.z [rad/s].

        Raises:
            Refusal: the mechanism cannot do it; names the possible alternative.
        """
        if abs(yaw_rate) < _STILL:
            if forward < -_STILL:
                raise _impossible(
                    f"linear.x is {forward:g} m/s: a ratchet prevents driving backward; use "
                    "linear.x >= 0, after a half turn (angular.z > 0) if needed"
                )
            return self.driving_rate(max(forward, 0.0))
        if yaw_rate < 0.0:
            raise _impossible(
                f"angular.z is {yaw_rate:g} rad/s: the rover turns left only; use angular.z > "
                "0 for the rest of a full turn"
            )
        about_pivot = self.pivot[1] * yaw_rate
        if abs(forward) > _STILL and abs(forward - about_pivot) > 0.01 * abs(about_pivot):
            raise _impossible(
                f"linear.x is {forward:g} m/s with angular.z {yaw_rate:g} rad/s: the rover "
                "drives straight or turns about its right wheel; use angular.z 0, or linear.x "
                f"0 (or {about_pivot:.4g} m/s, which this turn implies)"
            )
        return self.turning_rate(yaw_rate)


def _impossible(reason: str) -> Refusal:
    return Refusal(topics.CMD_VEL, RefusalCode.NOT_SUPPORTED, reason)
