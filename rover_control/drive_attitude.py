"""Which way is up, and how the heading turns, at any tilt: carried by the gyro. Pure.

Two directions that stand still in the world are kept in base_link: up, and one that is level. The
gyro turns both; gravity in the accelerometer corrects up, and the other one stays level. The
heading is that of base_link x seen from above. A rover that falls onto its back over its nose
passes where x has no heading, and comes out with the right one.
"""

from __future__ import annotations

import math

from msg_schemas.samples import Vector

ROLLOVER_TILT = 1.05
"""Tilt [rad] from which on a rover lies on its side."""


class DriveAttitude:
    """Up and a level direction, in base_link."""

    def __init__(self) -> None:
        self.up: Vector = (0.0, 0.0, 1.0)
        self._level: Vector = (1.0, 0.0, 0.0)

    @property
    def pitch(self) -> float:
        """Nose down positive [rad]."""
        return math.atan2(-self.up[0], math.hypot(self.up[1], self.up[2]))

    @property
    def roll(self) -> float:
        """Right side down positive [rad]."""
        return math.atan2(self.up[1], self.up[2])

    @property
    def inclination(self) -> float:
        """Of base_link z against the vertical [rad]."""
        return math.acos(min(max(self.up[2], -1.0), 1.0))

    def turn(self, rate: Vector, force: Vector, h: float, share: float) -> float:
        """Take a reading of the IMU; returns by how much the heading has turned [rad].

        Args:
            rate: of the gyro, its bias taken off [rad/s].
            force: of the accelerometer [m/s^2].
            h: since the last reading [s].
            share: that the accelerometer has in where up is.
        """
        before = self._heading()
        up, level = _carried(self.up, rate, h), _carried(self._level, rate, h)
        size = math.hypot(*force)
        if size > 0.0:
            x, y, z = (u + share * (f / size - u) for u, f in zip(up, force, strict=True))
            up = _unit((x, y, z))
        tilted = sum(a * b for a, b in zip(level, up, strict=True))
        x, y, z = (a - tilted * u for a, u in zip(level, up, strict=True))
        self.up, self._level = up, _unit((x, y, z))
        return math.remainder(self._heading() - before, math.tau)

    def _heading(self) -> float:
        """Of base_link x against the level direction, seen from above [rad]."""
        (_, uy, uz), (x, y, z) = self.up, self._level
        return math.atan2(uy * z - uz * y, x)


def _carried(vector: Vector, rate: Vector, h: float) -> Vector:
    """A direction that stands still, seen from a body that turns (Rodrigues' formula)."""
    speed = math.hypot(*rate)
    if speed == 0.0:
        return vector
    ax, ay, az = (w / speed for w in rate)
    x, y, z = vector
    c, s = math.cos(speed * h), -math.sin(speed * h)
    along = (1.0 - c) * (ax * x + ay * y + az * z)
    return (
        c * x + s * (ay * z - az * y) + along * ax,
        c * y + s * (az * x - ax * z) + along * ay,
        c * z + s * (ax * y - ay * x) + along * az,
    )


def _unit(vector: Vector) -> Vector:
    x, y, z = vector
    size = math.hypot(x, y, z)
    return (x / size, y / size, z / size)
