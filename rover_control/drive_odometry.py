"""Where the rover is: wheel encoders and gyro, with the tether's length as a help. Pure.

An extended Kalman filter for the pivot's place (module `ratchet_kinematics`), the heading, the
gyro's bias, the slip and the fairlead's height above the tether's attachment:

    x = (px, py, heading, bias, slip over the expected, drop).

A turn leaves the pivot where it is, so only the gyro counts there. Straight ahead the pivot goes
along the heading by the wheels' mean way, less the slip, and by half of what the gyro sees of a
difference between the sides. A wheel that overruns its axle rolls freely, without slip. The slip
follows the torque at the wheels, nearly on a line: tail, slope and tether that hold the rover back
ask for both. About that it wanders over some metres (a Gauss-Markov process over the way).

At rest the gyro tells its bias (a zero-rate update) and the pose stands still. A tether that is
taut tells the distance from the fairlead, with its sag taken off; one that is slack tells at least
that the rover is not farther away than it reaches. The tether says nothing of the heading.

How the heading turns and where up is, `drive_attitude` tells; the bias is the gyro's about z.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_schemas.parameters import parameter
from msg_schemas.samples import Vector
from rover_control.drive_attitude import DriveAttitude
from rover_control.ratchet_kinematics import GroundPose, RatchetKinematics, wrapped

Floats = NDArray[np.float64]

_PX, _PY, _HEADING, _BIAS, _SLIP, _DROP = range(6)
_STATES = 6
_IDENTITY = np.eye(_STATES)
_LONGEST_STEP = 0.2  # between two readings of the gyro that is still bridged [s]
_LARGEST_SLIP = 0.95  # that is counted on
_TORQUE_TIME = 1.0  # of the torque's mean [s]
_PULL_SHARE = 0.02  # that a reading of the tension has in its mean
_REST_TIME = 1.0  # of the mean rate at rest [s]
_CREEP = 2.5e-4  # mean rate at which a rover does not rest [rad/s]
_LEVEL_MEMORY = 10.0  # of the biases about the level axes [s]
_ROCKS = 0.05  # rate about a level axis at which a rover does not rest [rad/s]
_JOLT = 7.0  # standard deviations of the noise between two readings at rest, at most
_QUIET = 0.5  # without rocking and jolts, after which the rover rests [s]


@dataclass(frozen=True)
class OdometryParameters:
    """Noise of sensors and ground, as the odometry's filter assumes it."""

    gyro_noise_density: float = parameter(
        1.0e-4, "rad/s/sqrt(Hz)", "noise density of the gyro", 0.0, 1.0
    )
    gyro_turn_on_bias: float = parameter(
        0.005, "rad/s", "standard deviation of the gyro's turn-on bias", 0.0, 1.0
    )
    gyro_bias_random_walk: float = parameter(
        5.0e-6, "rad/s/sqrt(s)", "random walk of the gyro's bias", 0.0, 1.0
    )
    slip_std: float = parameter(
        0.03, "-", "standard deviation of the slip about its nominal value", 0.0, 0.5
    )
    slip_correlation_distance: float = parameter(
        5.0, "m", "correlation distance of the slip", 0.01, 1e3
    )
    sideslip_std: float = parameter(
        0.01, "rad", "standard deviation of the sideslip angle", 0.0, 1.0
    )
    tilt_time_constant: float = parameter(
        0.5, "s", "time constant of the accelerometer's tilt correction at rest", 0.05, 100.0
    )
    tilt_time_constant_moving: float = parameter(
        20.0, "s", "time constant of the accelerometer's tilt correction in motion", 0.05, 1e3
    )
    initial_position_std: float = parameter(
        0.05, "m", "standard deviation of a position from drive/initial_pose", 0.0, 100.0
    )
    initial_heading_std: float = parameter(
        0.01, "rad", "standard deviation of a heading from drive/initial_pose", 0.0, 7.0
    )
    tether_range_std: float = parameter(
        0.05, "m", "standard deviation of the distance measured by a taut tether", 1e-3, 10.0
    )
    tether_update_distance: float = parameter(
        0.5, "m", "distance driven between two updates by the tether's length", 0.01, 100.0
    )
    initial_drop_std: float = parameter(
        0.1, "m", "initial standard deviation of the fairlead's height above the rover", 1e-3, 100.0
    )
    uses_tether: bool = parameter(True, "-", "correct the odometry by the tether's length")


class Tether(NamedTuple):
    """What the winch tells of the tether."""

    length: float  # from fairlead to rover along the tether, stretched [m]
    tension: float  # at the fairlead [N]
    weight: float  # of what is out [N]


def chord_of(tether: Tether, horizontal: float) -> float:
    """Straight distance [m] that a taut tether spans: its length less its sag.

    L = c + w^2 c^3 cos^2(slope) / (24 T^2) with the weight w by length and the tension T at
    mid-length (Irvine 1981, Cable Structures, section 2.3, for an inclined chord).
    """
    length, tension = tether.length, tether.tension - 0.5 * tether.weight
    if length <= 0.0 or tension <= 0.0:
        return max(length, 0.0)
    across = min(horizontal / length, 1.0)
    sag = (tether.weight * across / tension) ** 2 * length / 24.0
    return length * max(1.0 - sag / length, 0.0)


class DriveOdometry:
    """Dead reckoning with its covariance.

    Args:
        kinematics: of the chassis.
        parameters: trust.
    """

    def __init__(self, kinematics: RatchetKinematics, parameters: OdometryParameters) -> None:
        self.kinematics = kinematics
        self.parameters = parameters
        self.way = 0.0  # driven, without sign of turns [m]
        self.speed = 0.0  # along base_link x [m/s]
        self.yaw_rate = 0.0  # of the heading [rad/s]
        self.attitude = DriveAttitude()
        self._level_bias = (0.0, 0.0)  # of the gyro about base_link x and y [rad/s]
        self._rested = 0.0  # by which that is known [s]
        self.tether_range = 0.0  # distance by the taut tether as last taken; 0 = none yet [m]
        self._seen_at = -math.inf  # way at the last look at the tether [m]
        self._rest_rate = 0.0  # over the bias, as a mean [rad/s]
        self._last_rate = 0.0  # about z, of the last reading [rad/s]
        self._moved_at = -math.inf  # [s]
        self._pull = 0.0  # of the tether on the rover, as a mean [N]
        self._is_driven = False  # both wheels, straight ahead
        self._x = np.zeros(_STATES)
        self._p = np.zeros((_STATES, _STATES))
        self._gyro_at: float | None = None
        self._torque = kinematics.parameters.driving_torque  # mean of the way [N m]
        self._p[_BIAS, _BIAS] = parameters.gyro_turn_on_bias**2
        self._p[_SLIP, _SLIP] = parameters.slip_std**2
        self._knows_drop = False
        self.place(GroundPose(0.0, 0.0, 0.0))

    # --- what is known ---------------------------------------------------------------------------

    @property
    def pose(self) -> GroundPose:
        """Of base_link."""
        x = self._x
        return self.kinematics.pose_at((float(x[_PX]), float(x[_PY])), wrapped(float(x[_HEADING])))

    @property
    def turned(self) -> float:
        """Heading without wrapping [rad]."""
        return float(self._x[_HEADING])

    @property
    def bias(self) -> float:
        """Of the gyro about base_link z [rad/s]."""
        return float(self._x[_BIAS])

    @property
    def bias_error(self) -> float:
        """Its standard deviation [rad/s]."""
        return math.sqrt(self._p[_BIAS, _BIAS])

    @property
    def slip(self) -> float:
        """Of the driven wheels, as counted on [-]."""
        p = self.kinematics.parameters
        by_torque = p.driving_slip + p.slip_per_torque * (self._torque - p.driving_torque)
        return min(max(by_torque + float(self._x[_SLIP]), 0.0), _LARGEST_SLIP)

    @property
    def drop(self) -> float:
        """Height of the fairlead above the tether's attachment [m]; 0 = not known yet."""
        return float(self._x[_DROP]) if self._knows_drop else 0.0

    def covariance(self) -> Floats:
        """Of x, y and heading of base_link, (3, 3)."""
        heading = self.turned
        ahead, left = self.kinematics.pivot
        c, s = math.cos(heading), math.sin(heading)
        to_base = np.eye(3)
        to_base[0, 2], to_base[1, 2] = s * ahead + c * left, -c * ahead + s * left
        return np.asarray(to_base @ self._p[:3, :3] @ to_base.T)

    # --- what is told ----------------------------------------------------------------------------

    def place(self, pose: GroundPose, *, knows_heading: bool = True) -> None:
        """Take where the rover stands; without a heading it keeps its own."""
        p = self.parameters
        heading = pose.heading if knows_heading else self.turned
        own = float(self._p[_HEADING, _HEADING])
        self._x[_HEADING] = heading
        self._x[[_PX, _PY]] = self.kinematics.pivot_of(GroundPose(pose.x, pose.y, heading))
        for k, error in ((_PX, p.initial_position_std), (_PY, p.initial_position_std)):
            self._p[k, :] = self._p[:, k] = 0.0
            self._p[k, k] = error**2
        self._p[_HEADING, :] = self._p[:, _HEADING] = 0.0
        self._p[_HEADING, _HEADING] = p.initial_heading_std**2 if knows_heading else own
        self._p[_DROP, :] = self._p[:, _DROP] = 0.0
        self._knows_drop = False
        self._seen_at = -math.inf

    def on_gyro(self, rate: Vector, force: Vector, now: float, *, at_rest: bool) -> None:
        """Take a reading of the IMU.

        Args:
            rate: of the gyro [rad/s].
            force: of the accelerometer [m/s^2].
            now: its time [s].
            at_rest: nothing drives the rover, and it has come to rest.
        """
        before, self._gyro_at = self._gyro_at, now
        if before is None or not 0.0 < now - before <= _LONGEST_STEP:
            self._moved_at = now
            return
        h = now - before
        p = self.parameters
        self._p[_BIAS, _BIAS] += p.gyro_bias_random_walk**2 * h
        left = rate[2] - self.bias
        # A rover that creeps under the tether's pull does not rest, whatever its encoders say.
        self._rest_rate += min(h / _REST_TIME, 1.0) * (left - self._rest_rate)
        creeps = abs(self._rest_rate) > 3.0 * self.bias_error + _CREEP
        jolt = abs(rate[2] - self._last_rate) > _JOLT * p.gyro_noise_density / math.sqrt(h) + _CREEP
        self._last_rate = rate[2]
        if jolt or not at_rest or max(abs(rate[0]), abs(rate[1])) > _ROCKS:
            self._moved_at = now
        rests = now - self._moved_at > _QUIET
        if rests:
            self._learn_level(rate, h)
        bx, by = self._level_bias
        share = min(h / (p.tilt_time_constant if rests else p.tilt_time_constant_moving), 1.0)
        turned = self.attitude.turn((rate[0] - bx, rate[1] - by, left), force, h, share)
        if rests and not creeps:
            self.yaw_rate = 0.0
            row = np.zeros(_STATES)
            row[_BIAS] = 1.0
            self._update(row, left, p.gyro_noise_density**2 / h)
            return
        self.yaw_rate = turned / h
        self._x[_HEADING] += turned
        self._follow(_HEADING, _BIAS, -h * self.attitude.up[2])
        self._p[_HEADING, _HEADING] += p.gyro_noise_density**2 * h
        if self._is_driven:
            # Half of what the sides differ by belongs to the right one.
            self._advance_pivot(0.5 * self.kinematics.parameters.track * turned)

    def _learn_level(self, rate: Vector, h: float) -> None:
        self._rested = min(self._rested + h, _LEVEL_MEMORY)
        share = h / self._rested
        x, y = self._level_bias
        self._level_bias = (x + share * (rate[0] - x), y + share * (rate[1] - y))

    def on_wheels(self, left: float, right: float, h: float, torque: float | None = None) -> None:
        """Take how far the wheels have turned.

        Args:
            left: the left one [rad].
            right: the right one [rad].
            h: in a time [s].
            torque: at the wheels [N m]; None = as usual.
        """
        radius, slip = self.kinematics.parameters.wheel_radius, self.slip
        slips = self._is_driven = left > 0.0 and left > 0.5 * right
        turned = 0.5 * (left + right) if slips else max(right, 0.0)
        way = radius * turned * ((1.0 - slip) if slips else 1.0)
        if slips and torque is not None:
            self._torque += min(h / _TORQUE_TIME, 1.0) * (torque - self._torque)
        if left < 0.0 and right <= 0.0:
            # The pivot stands; base_link goes round it.
            self.speed = self.kinematics.pivot[1] * self.yaw_rate
            return
        self.speed = way / h if h > 0.0 and way > 0.0 else 0.0
        if way == 0.0:
            return
        self.way += way
        self._advance_pivot(way)
        if slips:
            self._slip_on(way, radius * turned)

    def _advance_pivot(self, way: float) -> None:
        c, s = math.cos(self.turned), math.sin(self.turned)
        aside = self.kinematics.parameters.sideslip_per_force * self._side_pull() * way
        self._x[_PX] += c * way - s * aside
        self._x[_PY] += s * way + c * aside
        self._follow(_PX, _HEADING, -s * way)
        self._follow(_PY, _HEADING, c * way)
        # Of a direction that wanders over the slip's distance, what a way leaves aside.
        spread = (
            self.parameters.sideslip_std**2 * abs(way) * self.parameters.slip_correlation_distance
        )
        self._p[_PX, _PX] += s * s * spread
        self._p[_PY, _PY] += c * c * spread
        self._p[_PX, _PY] -= s * c * spread
        self._p[_PY, _PX] -= s * c * spread

    def _side_pull(self) -> float:
        """Of the tether on the rover, to its left [N]; it leads to the fairlead."""
        pose = self.pose
        reach = math.hypot(pose.x, pose.y, self.drop)
        if reach <= 0.0 or not self._knows_drop:
            return 0.0
        left = pose.x * math.sin(pose.heading) - pose.y * math.cos(pose.heading)
        return self._pull * left / reach

    def _slip_on(self, way: float, rolled: float) -> None:
        """The way's error by the slip, and the slip's own wandering."""
        p = self.parameters
        self._follow(_PX, _SLIP, -math.cos(self.turned) * rolled)
        self._follow(_PY, _SLIP, -math.sin(self.turned) * rolled)
        keep = math.exp(-way / p.slip_correlation_distance)
        self._x[_SLIP] *= keep
        self._p[_SLIP, :] *= keep
        self._p[:, _SLIP] *= keep
        self._p[_SLIP, _SLIP] += p.slip_std**2 * (1.0 - keep * keep)

    def _follow(self, state: int, other: int, share: float) -> None:
        """A state has changed by a share of another's error: P = F P F^T with F one entry off I."""
        self._p[state, :] += share * self._p[other, :]
        self._p[:, state] += share * self._p[:, other]

    def on_tether(self, tether: Tether, *, is_taut: bool) -> None:
        """Take the tether's length.

        Args:
            tether: what the winch tells.
            is_taut: the winch holds it at a tension; otherwise it only bounds the distance.
        """
        p = self.parameters
        self.tether_range = 0.0
        # A mean: the winch holds its tension roughly.
        pull = max(tether.tension - tether.weight, 0.0)
        self._pull += _PULL_SHARE * (pull - self._pull)
        if not p.uses_tether:
            return
        px, py = self.pose.x, self.pose.y
        horizontal = math.hypot(px, py)
        chord = chord_of(tether, horizontal)
        if is_taut:
            self.tether_range = chord
        if not self._knows_drop:
            if is_taut and chord > horizontal:
                self._begin_drop(chord, horizontal)
            return
        distance = math.hypot(horizontal, self.drop)
        if is_taut and self.way - self._seen_at < p.tether_update_distance:
            return
        beyond = distance - tether.length
        if not is_taut and beyond <= 3.0 * p.tether_range_std:
            return
        self._seen_at = self.way
        row = np.zeros(_STATES)
        ahead, left = self.kinematics.pivot
        c, s = math.cos(self.turned), math.sin(self.turned)
        row[_PX], row[_PY] = px / distance, py / distance
        row[_HEADING] = row[_PX] * (s * ahead + c * left) + row[_PY] * (s * left - c * ahead)
        row[_DROP] = self.drop / distance
        miss = (chord if is_taut else tether.length) - distance
        expected = float(row @ self._p @ row) + p.tether_range_std**2
        if miss * miss < 16.0 * expected:
            self._update(row, miss, p.tether_range_std**2)

    def _begin_drop(self, chord: float, horizontal: float) -> None:
        """The height is what the first taut length leaves beside the known place."""
        self._x[_DROP] = math.sqrt(chord**2 - horizontal**2)
        self._p[_DROP, _DROP] = self.parameters.initial_drop_std**2
        self._knows_drop = True
        self._seen_at = self.way

    def _update(self, row: Floats, miss: float, variance: float) -> None:
        gain = self._p @ row / (float(row @ self._p @ row) + variance)
        self._x = self._x + gain * miss
        keep = _IDENTITY - np.outer(gain, row)
        self._p = keep @ self._p @ keep.T + variance * np.outer(gain, gain)
