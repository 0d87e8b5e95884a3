"""What a jump came to, by the rover's own IMU. Pure.

While the rover holds its spring compressed it stands still: that tells which way is up, the gyro's
bias and, with gravity, most of the accelerometer's. From there on rates and specific forces are
integrated up to where it lies still again. The velocity that is then left over came from samples
beyond the accelerometer's range, as when Body 2 takes Body 1 along; where there are none, it grew
linearly. It is taken out, which leaves a few millimetres over the second or two of a jump.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_schemas.samples import ImuSample

_NANO = 1e9
_STILL = 0.25  # at least so long before the release, and after the landing [s]
_FEW = 3  # fewer samples are no mean
_GAP = 0.06  # a flight with a longer gap between two samples is not measured [s]
_SATURATED = 0.98  # part of the accelerometer's range from which on a sample counts as beyond it
_LONGEST = 60.0  # what is older is forgotten [s]


class Flown(NamedTuple):
    """A jump as it was flown."""

    height: float  # largest rise of base_link [m]
    range: float  # horizontal way of base_link from the release to the rest [m]
    turn: float  # about the vertical, from the release to the rest [rad]
    tilt: float  # of base_link z at rest, against before the release [rad]
    flight_time: float  # from the contact's opening to its closing [s]


@dataclass
class FlightRecorder:
    """Listens to the IMU while a jump is under way.

    Args:
        imu_offset: place of the IMU along base_link x [m].
        accelerometer_range: of the accelerometer [m/s^2].
    """

    imu_offset: float = 0.05
    accelerometer_range: float = 80.0
    _samples: list[tuple[int, tuple[float, ...]]] = field(default_factory=list)
    _released_ns: int | None = None

    def begin(self) -> None:
        """The rover stands still, the spring compressed."""
        self._samples.clear()
        self._released_ns = None

    def release(self, now_ns: int) -> None:
        """The latch is told to trip."""
        self._released_ns = now_ns

    def standing(self) -> tuple[float, float, float] | None:
        """Mean specific force of the last while [m/s^2]; None = not heard for long enough."""
        last = self._samples[-1][0] if self._samples else 0
        forces = [row[3:] for stamp, row in self._samples if stamp > last - int(_STILL * _NANO)]
        if len(forces) < _FEW:
            return None
        x, y, z = np.mean(forces, axis=0).tolist()
        return (x, y, z)

    def on_imu(self, sample: ImuSample, now_ns: int) -> None:
        """Take a sample."""
        stamp = sample.stamp_ns or now_ns
        if self._samples and stamp <= self._samples[-1][0]:
            return
        self._samples.append((stamp, (*sample.angular_velocity, *sample.linear_acceleration)))
        if self._samples[-1][0] - self._samples[0][0] > _LONGEST * _NANO:
            del self._samples[: len(self._samples) // 2]

    def finish(self, landed_ns: int, flight_time: float, now_ns: int) -> Flown | None:
        """What the jump came to.

        Args:
            landed_ns: when the contact closed.
            flight_time: from the contact's opening to its closing [s].
            now_ns: the rover has been at rest for a while.

        Returns:
            None if samples are missing.
        """
        if self._released_ns is None or len(self._samples) < _FEW:
            return None
        times = np.array([stamp for stamp, _ in self._samples], dtype=np.int64)
        values = np.array([row for _, row in self._samples])
        released = int(np.searchsorted(times, self._released_ns))
        first = int(np.searchsorted(times, self._released_ns - int(_STILL * _NANO)))
        last = int(np.searchsorted(times, now_ns, side="right"))
        resting = int(np.searchsorted(times, max(now_ns - int(_STILL * _NANO), landed_ns)))
        t = (times[released:last] - times[released]) / _NANO
        if released - first < _FEW or last - resting < _FEW or t.size < _FEW:
            return None
        if float(np.max(np.diff(t))) > _GAP:
            return None
        still = values[first:released].mean(axis=0)
        flown = values[released:last] - np.concatenate([still[:3], np.zeros(3)])
        turns, places = self._integrated(t, flown, still[3:], resting - released)
        rise = places[:, 2]
        up = _level(still[3:])[:, 2]
        end = turns[-1]
        forward = end[:, 0]
        before = turns[0][:, 0]
        turn = math.atan2(
            before[0] * forward[1] - before[1] * forward[0],
            before[0] * forward[0] + before[1] * forward[1],
        )
        tilt = math.acos(max(-1.0, min(1.0, float(end[:, 2] @ up))))
        way = places[-1, :2] - places[0, :2]
        return Flown(float(rise.max()), math.hypot(*way), turn, tilt, flight_time)

    def _integrated(
        self,
        t: NDArray[np.float64],
        values: NDArray[np.float64],
        standing: NDArray[np.float64],
        resting: int,
    ) -> tuple[list[NDArray[np.float64]], NDArray[np.float64]]:
        """Attitudes, body to level axes, and places of base_link [m] at the samples."""
        gravity = np.array([0.0, 0.0, float(np.linalg.norm(standing))])
        turned = _level(standing)
        turns, rates = [turned], np.zeros((t.size, 3))
        for k in range(1, t.size):
            dt = t[k] - t[k - 1]
            half = turned @ _rotation(0.5 * dt * values[k, :3])
            turned = turned @ _rotation(dt * values[k, :3])
            turns.append(turned)
            rates[k] = rates[k - 1] + dt * (half @ values[k, 3:] - gravity)
        left_over = rates[resting:].mean(axis=0)
        rates -= self._grown(t, values[:, 3:], resting)[:, None] * left_over
        steps = 0.5 * np.diff(t)[:, None] * (rates[1:] + rates[:-1])
        places = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
        lever = np.array([self.imu_offset, 0.0, 0.0])
        places -= np.array([(turn - turns[0]) @ lever for turn in turns])
        return turns, places

    def _grown(
        self, t: NDArray[np.float64], forces: NDArray[np.float64], resting: int
    ) -> NDArray[np.float64]:
        """Share of the velocity left over at rest that there is at each sample already."""
        beyond = np.abs(forces[:resting]).max(axis=1) >= _SATURATED * self.accelerometer_range
        if not beyond.any():
            return t / float(t[resting:].mean())
        share = np.ones(t.size)
        share[:resting] = np.cumsum(beyond) / float(beyond.sum())
        return share


def _level(standing: NDArray[np.float64]) -> NDArray[np.float64]:
    """Attitude, body to axes with z up, of a rover that stands with this specific force."""
    up = standing / np.linalg.norm(standing)
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
