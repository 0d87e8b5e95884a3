"""What one wheel motor behind two ratchets can make the rover do, from its geometry. Pure.

The motor turns the left wheel. A ratchet takes the right wheel along when it turns forward, another
holds it when it would turn backward. So there are two motions, and rest:

    motor forward    both wheels drive at the motor's rate: straight ahead;
    motor backward   the left wheel goes back, the right one is held: a left turn about the point
                     where the right wheel stands, the `pivot`.

Neither backward nor right: a right turn by an angle is a left turn by what is left of a full one.
Two left turns with a straight way between them reach every pose, and in the coordinates of the
pivot they come apart: turns leave it where it is, a straight way moves it along the heading.

Poses are those of base_link on the ground: x, y in map [m], heading about z [rad]. On soft ground
a driven wheel slips: it covers (1 - slip) of what it turns. That it slips much more in a turn is
the tail's doing, which it drags sideways, and the twisting of the other wheel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas import topics
from msg_schemas.parameters import parameter
from msg_schemas.refusal import Refusal, RefusalCode

_STILL = 1e-6  # a speed [m/s] or rate [rad/s] that asks for nothing


class GroundPose(NamedTuple):
    """Where base_link is on the ground."""

    x: float
    y: float
    heading: float

    def place(self, ahead: float, left: float) -> tuple[float, float]:
        """A point given in base_link, in map [m]."""
        c, s = math.cos(self.heading), math.sin(self.heading)
        return self.x + c * ahead - s * left, self.y + s * ahead + c * left

    def distance(self, x: float, y: float) -> float:
        """To a point [m]."""
        return math.hypot(x - self.x, y - self.y)


def wrapped(angle: float) -> float:
    """The same direction, in (-pi, pi]."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


def left_turn(start: float, end: float) -> float:
    """How far to turn left from one heading to another, in [0, 2 pi)."""
    return (end - start) % (2.0 * math.pi)


@dataclass(frozen=True)
class ChassisParameters:
    """Geometry of the chassis and nominal slip of its wheels."""

    wheel_radius: float = parameter(0.15, "m", "radius of the wheels", 0.01, 2.0)
    track: float = parameter(0.44, "m", "distance between the wheels", 0.05, 5.0)
    axle_offset: float = parameter(
        0.08, "m", "distance of the axle ahead of base_link's origin", -2.0, 2.0
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
    sideslip_per_force: float = parameter(
        0.115, "rad/N", "sideslip angle per lateral force on the rover", 0.0, 10.0
    )
    turning_slip: float = parameter(
        0.33, "-", "nominal slip of the left wheel in a turn on level regolith", 0.0, 0.9
    )


class RatchetKinematics:
    """The rover's motions over the motor's.

    Args:
        parameters: geometry and usual slip.
    """

    def __init__(self, parameters: ChassisParameters) -> None:
        self.parameters = parameters

    @property
    def pivot(self) -> tuple[float, float]:
        """Where the right wheel stands, in base_link: ahead and left [m]."""
        return self.parameters.axle_offset, -0.5 * self.parameters.track

    def pivot_of(self, pose: GroundPose) -> tuple[float, float]:
        """The same in map."""
        return pose.place(*self.pivot)

    def pose_at(self, pivot: tuple[float, float], heading: float) -> GroundPose:
        """Pose of a rover whose pivot stands there."""
        ahead, left = self.pivot
        x, y = GroundPose(*pivot, heading).place(-ahead, -left)
        return GroundPose(x, y, heading)

    def turned(self, pose: GroundPose, angle: float) -> GroundPose:
        """Pose after a left turn [rad]."""
        return self.pose_at(self.pivot_of(pose), pose.heading + angle)

    def driven(self, pose: GroundPose, way: float) -> GroundPose:
        """Pose after a straight way [m]."""
        return GroundPose(*pose.place(way, 0.0), pose.heading)

    def speed(self, wheel_rate: float, slip: float | None = None) -> float:
        """Speed [m/s] of a wheel that drives straight at a rate [rad/s]."""
        slip = self.parameters.driving_slip if slip is None else slip
        return self.parameters.wheel_radius * (1.0 - slip) * wheel_rate

    def driving_rate(self, speed: float) -> float:
        """Rate of the motor's wheel [rad/s] for a speed straight ahead [m/s]."""
        return speed / self.speed(1.0)

    def yaw_rate(self, wheel_rate: float) -> float:
        """Rate of a turn [rad/s] when the left wheel turns back at a rate [rad/s] <= 0."""
        p = self.parameters
        return -self.speed(wheel_rate, p.turning_slip) / p.track

    def turning_rate(self, yaw_rate: float) -> float:
        """Rate of the left wheel [rad/s], <= 0, for a rate of a left turn [rad/s]."""
        return yaw_rate / self.yaw_rate(1.0)

    def wheel_rate(self, forward: float, yaw_rate: float) -> float:
        """Rate of the motor's wheel [rad/s] that does as a twist of base_link says.

        Args:
            forward: linear.x [m/s]; in a turn 0 or what the turn about the pivot gives.
            yaw_rate: angular.z [rad/s].

        Raises:
            Refusal: the mechanism cannot; says what it could do instead.
        """
        if abs(yaw_rate) < _STILL:
            if forward < -_STILL:
                raise _impossible(
                    f"linear.x is {forward:g} m/s, a ratchet holds the right wheel against turning "
                    "backward; possible are linear.x >= 0, and a half turn (angular.z > 0) first"
                )
            return self.driving_rate(max(forward, 0.0))
        if yaw_rate < 0.0:
            raise _impossible(
                f"angular.z is {yaw_rate:g} rad/s, the motor turns the rover left only; possible "
                "is angular.z > 0, a right turn as the rest of a full one"
            )
        about_pivot = self.pivot[1] * yaw_rate
        if abs(forward) > _STILL and abs(forward - about_pivot) > 0.01 * abs(about_pivot):
            raise _impossible(
                f"linear.x is {forward:g} m/s with angular.z {yaw_rate:g} rad/s, one motor drives "
                "straight or turns about the right wheel; possible are angular.z 0, or linear.x 0 "
                f"(or {about_pivot:.4g} m/s, as this turn has it)"
            )
        return self.turning_rate(yaw_rate)


def _impossible(reason: str) -> Refusal:
    return Refusal(topics.CMD_VEL, RefusalCode.NOT_SUPPORTED, reason)
