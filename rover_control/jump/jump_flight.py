"""Height, range and rotation of a jump from the rover's IMU. Pure.

At rest with the spring compressed, the IMU gives the up direction, the gyro's bias and, with
gravity, most of the accelerometer's. From there to the next rest, rates and specific forces are
integrated. The velocity that remains at rest is the error of samples beyond the accelerometer's
range, as when Body 2 hits Body 1; if there are none, the error is assumed to grow linearly. It is
removed, which leaves an error of a few millimetres over a jump of one to two seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_schemas.samples import ImuSample

_NANO = 1e9
_REST_TIME = 0.25  # rest time needed before the release and after the landing [s]
_MIN_SAMPLES = 3  # least number of samples for a mean
_MAX_GAP = 0.06  # largest gap between two samples of a flight [s]
_SATURATION = 0.98  # fraction of the accelerometer's range above which a sample is saturated
_MAX_AGE = 60.0  # age at which samples are discarded [s]


class MeasuredJump(NamedTuple):
    """A jump as measured by the IMU."""

    height: float  # largest rise of base_link [m]
    ahead: float  # displacement of base_link from release to rest, along its heading before [m]
    left: float  # the same to the left [m]
    turn: float  # about the vertical, from release to rest [rad]
    tilt: float  # of base_link z at rest, against before the release [rad]
    flight_time: float  # from opening to closing of the contact [s]

    @property
    def range(self) -> float:
        """Horizontal distance of base_link from release to rest [m]."""
        return math.hypot(self.ahead, self.left)


@dataclass
class FlightRecorder:
    """Records the IMU during a jump.

    Args:
        imu_offset: position of the IMU along base_link x [m].
        accelerometer_range: measuring range [m/s^2].
    """

    imu_offset: float = 0.05
    accelerometer_range: float = 80.0
    _samples: list[tuple[int, tuple[float, ...]]] = field(default_factory=list)
    _released_ns: int | None = None

    def begin(self) -> None:
        """Start recording: the rover is at rest with the spring compressed."""
        self._samples.clear()
        self._released_ns = None

    def release(self, now_ns: int) -> None:
        """Mark the trip command of the latch."""
        self._released_ns = now_ns

    def mean_specific_force(self) -> tuple[float, float, float] | None:
        """Mean specific force of the last samples [m/s^2]; None = too few samples."""
        last = self._samples[-1][0] if self._samples else 0
        forces = [row[3:] for stamp, row in self._samples if stamp > last - int(_REST_TIME * _NANO)]
        if len(forces) < _MIN_SAMPLES:
            return None
        x, y, z = np.mean(forces, axis=0).tolist()
        return (x, y, z)

    def on_imu(self, sample: ImuSample, now_ns: int) -> None:
        """Process an IMU sample."""
        stamp = sample.stamp_ns or now_ns
        if self._samples and stamp <= self._samples[-1][0]:
            return
        self._samples.append((stamp, (*sample.angular_velocity, *sample.linear_acceleration)))
        if self._samples[-1][0] - self._samples[0][0] > _MAX_AGE * _NANO:
            del self._samples[: len(self._samples) // 2]

    def finish(self, landed_ns: int, flight_time: float, now_ns: int) -> MeasuredJump | None:
        """Evaluate the jump.

        Args:
            landed_ns: time at which the contact closed.
            flight_time: from opening to closing of the contact [s].
            now_ns: present time; the rover has come to rest.

        Returns:
            None if samples are missing.
        """
        if self._released_ns is None or len(self._samples) < _MIN_SAMPLES:
            return None
        times = np.array([stamp for stamp, _ in self._samples], dtype=np.int64)
        values = np.array([row for _, row in self._samples])
        released = int(np.searchsorted(times, self._released_ns))
        first = int(np.searchsorted(times, self._released_ns - int(_REST_TIME * _NANO)))
        last = int(np.searchsorted(times, now_ns, side="right"))
        resting = int(np.searchsorted(times, max(now_ns - int(_REST_TIME * _NANO), landed_ns)))
        t = (times[released:last] - times[released]) / _NANO
        if (
            released - first < _MIN_SAMPLES
            or last - resting < _MIN_SAMPLES
            or t.size < _MIN_SAMPLES
        ):
            return None
        if float(np.max(np.diff(t))) > _MAX_GAP:
            return None
        at_rest = values[first:released].mean(axis=0)
        flown = values[released:last] - np.concatenate([at_rest[:3], np.zeros(3)])
        turns, places = self._integrate(t, flown, at_rest[3:], resting - released)
        rise = places[:, 2]
        up = _level(at_rest[3:])[:, 2]
        final = turns[-1]
        forward = final[:, 0]
        before = turns[0][:, 0]
        turn = math.atan2(
            before[0] * forward[1] - before[1] * forward[0],
            before[0] * forward[0] + before[1] * forward[1],
        )
        tilt = math.acos(max(-1.0, min(1.0, float(final[:, 2] @ up))))
        ahead, left = (places[-1, :2] - places[0, :2]).tolist()
        return MeasuredJump(float(rise.max()), ahead, left, turn, tilt, flight_time)

    def _integrate(
        self,
        t: NDArray[np.float64],
        values: NDArray[np.float64],
        mean_specific_force: NDArray[np.float64],
        resting: int,
    ) -> tuple[list[NDArray[np.float64]], NDArray[np.float64]]:
        """Attitudes, body to level axes, and positions of base_link [m] at the samples."""
        gravity = np.array([0.0, 0.0, float(np.linalg.norm(mean_specific_force))])
        turned = _level(mean_specific_force)
        turns, rates = [turned], np.zeros((t.size, 3))
        for k in range(1, t.size):
            dt = t[k] - t[k - 1]
            half = turned @ _rotation(0.5 * dt * values[k, :3])
            turned = turned @ _rotation(dt * values[k, :3])
            turns.append(turned)
            rates[k] = rates[k - 1] + dt * (half @ values[k, 3:] - gravity)
        final_velocity = rates[resting:].mean(axis=0)
        rates -= self._residual_fraction(t, values[:, 3:], resting)[:, None] * final_velocity
        steps = 0.5 * np.diff(t)[:, None] * (rates[1:] + rates[:-1])
        places = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
        lever = np.array([self.imu_offset, 0.0, 0.0])
        places -= np.array([(turn - turns[0]) @ lever for turn in turns])
        return turns, places

    def _residual_fraction(
        self, t: NDArray[np.float64], forces: NDArray[np.float64], resting: int
    ) -> NDArray[np.float64]:
        """Fraction of the final velocity error that is present at each sample."""
        saturated = np.abs(forces[:resting]).max(axis=1) >= _SATURATION * self.accelerometer_range
        if not saturated.any():
            return t / float(t[resting:].mean())
        fraction = np.ones(t.size)
        fraction[:resting] = np.cumsum(saturated) / float(saturated.sum())
        return fraction


def _level(mean_specific_force: NDArray[np.float64]) -> NDArray[np.float64]:
    """Attitude, body axes to axes with z up, at rest with this specific force."""
    up = mean_specific_force / np.linalg.norm(mean_specific_force)
    ahead = np.array([1.0, 0.0, 0.0]) - up[0] * up
    ahead /= np.linalg.norm(ahead)
    return np.stack([ahead, np.cross(up, ahead), up])


def _rotation(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matrix of a rotation vector [rad]."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross)
