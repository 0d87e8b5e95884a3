"""Attitude of the driving rover at any tilt, integrated from the gyro. Pure.

The filter keeps two world-fixed directions in base_link coordinates: up and one horizontal. The
gyro rotates both; the accelerometer gives the first up and corrects it, and the other one is kept
orthogonal to it. The heading is that of base_link x projected onto the horizontal plane. In a
pitch-over onto the back the projection vanishes for an instant; the heading is correct again
afterwards.
"""

from __future__ import annotations

import math

from msg_schemas.samples import Vector

ROLLOVER_TILT = 1.05
"""Tilt [rad] above which the rover counts as rolled over."""


class DriveAttitude:
    """World-fixed up and horizontal directions in base_link."""

    def __init__(self) -> None:
        self.up: Vector = (0.0, 0.0, 1.0)
        self._level: Vector = (1.0, 0.0, 0.0)

    @property
    def pitch(self) -> float:
        """Pitch, nose down positive [rad]."""
        return math.atan2(-self.up[0], math.hypot(self.up[1], self.up[2]))

    @property
    def roll(self) -> float:
        """Roll, right side down positive [rad]."""
        return math.atan2(self.up[1], self.up[2])

    @property
    def inclination(self) -> float:
        """Angle of base_link z to the vertical [rad]."""
        return math.acos(min(max(self.up[2], -1.0), 1.0))

    def start(self, force: Vector) -> None:
        """Take up from a specific force in base_link [m/s^2]."""
        self.up = _normalized(force)
        x, y, z = self.up
        # The horizontal direction of base_link x; where that is vertical, of base_link y.
        self._level = _normalized(
            (1.0 - x * x, -x * y, -x * z) if abs(x) < 0.9 else (-x * y, 1.0 - y * y, -y * z)
        )

    def turn(self, rate: Vector, force: Vector, h: float, fraction: float) -> float:
        """Process an IMU sample; returns the change of the heading [rad].

        Args:
            rate: angular rate without bias, in base_link [rad/s].
            force: specific force, in base_link [m/s^2].
            h: time since the last sample [s].
            fraction: weight of the accelerometer in the correction of up, 0 to 1.
        """
        before = self._heading()
        up, level = _rotate(self.up, rate, h), _rotate(self._level, rate, h)
        size = math.hypot(*force)
        if size > 0.0:
            x, y, z = (u + fraction * (f / size - u) for u, f in zip(up, force, strict=True))
            up = _normalized((x, y, z))
        tilted = sum(a * b for a, b in zip(level, up, strict=True))
        x, y, z = (a - tilted * u for a, u in zip(level, up, strict=True))
        self.up, self._level = up, _normalized((x, y, z))
        return math.remainder(self._heading() - before, math.tau)

    def _heading(self) -> float:
        """Heading of base_link x against the horizontal direction [rad]."""
        (_, uy, uz), (x, y, z) = self.up, self._level
        return math.atan2(uy * z - uz * y, x)


def _rotate(vector: Vector, rate: Vector, h: float) -> Vector:
    """A world-fixed direction in body axes after a rotation of the body (Rodrigues' formula)."""
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


def _normalized(vector: Vector) -> Vector:
    x, y, z = vector
    size = math.hypot(x, y, z)
    return (x / size, y / size, z / size)
