"""Odometry from wheel encoders and gyro, corrected by the tether's length. Pure.

An extended Kalman filter estimates the position of the pivot (module `ratchet_kinematics`), the
heading, the gyro's bias, the deviation of the slip from its nominal value, and the height of the
fairlead above the tether attachment:

    x = (px, py, heading, bias, slip deviation, drop).

A turn leaves the pivot in place; only the gyro enters. Straight ahead the pivot moves along the
heading by the mean travel of the wheels less the slip, plus half of the difference between the
sides that the gyro measures. A wheel that overruns its axle rolls without slip. The nominal slip is
a function of the wheel torque: tail, slope and tether load both. It is linear up to a torque from
which it increases more steeply, to the soil's strength. The deviation from it is a first-order
Gauss-Markov process in the distance driven; its effect increases with the slope of that function.

A flight raises the variance of the position. Where the rover rests after a jump, the displacement
that the IMU measured from release to rest corrects it.

At rest a zero-rate update estimates the gyro's bias, and the pose is constant. A taut tether
measures the distance from the fairlead, corrected for its sag; a slack one bounds it from above.
The tether does not measure the heading.

Until a pose is given, the position is only known to be within the tether's length, and the heading
is unknown: the filter counts from a pose that it assumes, and `covariance` states what is known.

`DeadReckoning` is the same filter, with which nothing but the motion changes the pose.
`drive_attitude` integrates heading and up direction; the bias is that about base_link z.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_schemas.parameters import parameter
from msg_schemas.samples import Vector
from rover_control.drive.drive_attitude import DriveAttitude
from rover_control.drive.ratchet_kinematics import GroundPose, RatchetKinematics, wrapped

Floats = NDArray[np.float64]

_PX, _PY, _HEADING, _BIAS, _SLIP, _DROP = range(6)
_STATES = 6
_IDENTITY = np.eye(_STATES)
_MAX_STEP = 0.2  # longest gap between two gyro samples in which the rate is known [s]
_MAX_SLIP = 0.98  # upper bound of the slip [-]
_TORQUE_TIME = 1.0  # time constant of the mean torque [s]
_FORCE_FRACTION = 0.02  # weight of a tension sample in its mean
_REST_TIME = 1.0  # time constant of the mean rates at rest [s]
_LEARNING_TIME = 5.0  # age of the bias to which that is compared, at most, at rest [s]
_CREEP = 2.5e-4  # mean yaw rate above which the rover creeps [rad/s]
_LEVEL_MEMORY = 10.0  # averaging time of the biases about base_link x and y [s]
UNKNOWN_VARIANCE = 1e6
"""Variance of a length that nothing bounds [m^2]."""
UNKNOWN_ANGLE = math.pi**2 / 3.0
"""Variance of an angle of which nothing is known [rad^2]."""
_DISTURBANCE_SIGMAS = 7.0  # largest change between samples at rest, in noise std deviations
_QUIET_TIME = 0.5  # undisturbed time after which the rover is at rest [s]


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
    flight_speed_std: float = parameter(
        0.15, "m/s", "standard deviation of the speed in a flight, along x and y", 0.0, 10.0
    )
    flight_measurement_std: float = parameter(
        0.01, "m", "standard deviation of a jump's measured displacement, along x and y", 1e-4, 10.0
    )
    tilt_std: float = parameter(
        0.02, "rad", "standard deviation of the estimated roll and pitch", 1e-4, 4.0
    )
    initial_position_std: float = parameter(
        0.05,
        "m",
        "standard deviation of a position set without covariance",
        0.0,
        100.0,
    )
    initial_heading_std: float = parameter(
        0.01,
        "rad",
        "standard deviation of a heading set without covariance",
        0.0,
        7.0,
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


class TetherMeasurement(NamedTuple):
    """Measurement of the tether by the winch."""

    length: float  # stretched length from fairlead to rover [m]
    tension: float  # at the fairlead [N]
    weight: float  # of the paid-out tether [N]


def chord_of(tether: TetherMeasurement, horizontal: float) -> float:
    """Chord [m] of a taut tether: its length less the sag.

    L = c + w^2 c^3 cos^2(slope) / (24 T^2) with the weight per length w and the tension T at
    mid-length (Irvine 1981, Cable Structures, section 2.3, for an inclined chord).
    """
    length, tension = tether.length, tether.tension - 0.5 * tether.weight
    if length <= 0.0 or tension <= 0.0:
        return max(length, 0.0)
    across = min(horizontal / length, 1.0)
    sag = (tether.weight * across / tension) ** 2 * length / 24.0
    return length * max(1.0 - sag / length, 0.0)


class DriveOdometry:
    """Dead reckoning with covariance.

    Args:
        kinematics: of the chassis.
        parameters: noise of sensors and ground.
    """

    def __init__(self, kinematics: RatchetKinematics, parameters: OdometryParameters) -> None:
        self.kinematics = kinematics
        self.parameters = parameters
        self.travelled = 0.0  # distance driven straight ahead [m]
        self.speed = 0.0  # along base_link x [m/s]
        self.yaw_rate = 0.0  # rate of the heading [rad/s]
        self.attitude = DriveAttitude()
        self._level_bias = (0.0, 0.0)  # gyro bias about base_link x and y [rad/s]
        self._level_rate = (0.0, 0.0)  # mean rate about them, bias included [rad/s]
        self._rested = 0.0  # averaging time of the level bias so far [s]
        self.tether_range = 0.0  # last distance measured by the taut tether; 0 = none yet [m]
        self._tether_updated_at = -math.inf  # travel at the last tether update [m]
        self._rest_rate = 0.0  # mean yaw rate at rest, bias included [rad/s]
        self._bias_before = (0.0, 0.0)  # earlier bias and its standard deviation [rad/s]
        self._bias_age = 0.0  # time of rest since then [s]
        self._last_rate: Vector = (0.0, 0.0, 0.0)  # last rate sample [rad/s]
        self._moved_at = -math.inf  # time of the last motion or disturbance [s]
        self.mean_pull = 0.0  # mean force of the tether on the rover [N]
        self._is_driven = False  # both wheels drive straight ahead
        self._flown = 0.0  # duration of the present flight so far [s]
        self._released_at: GroundPose | None = None  # pose before the present jump
        self._flight_variance = 0.0  # of the displacement since then, along x and y [m^2]
        self._x = np.zeros(_STATES)
        self._p = np.zeros((_STATES, _STATES))
        self._gyro_at: float | None = None
        self._torque = kinematics.parameters.driving_torque  # low-pass filtered wheel torque [N m]
        self._p[_BIAS, _BIAS] = parameters.gyro_turn_on_bias**2
        self._p[_SLIP, _SLIP] = parameters.slip_std**2
        self._knows_drop = False
        self._length = math.nan  # of the tether from fairlead to rover [m]
        self._knows_heading = False
        self.set_pose(GroundPose(0.0, 0.0, 0.0))
        self._knows_place = self._knows_heading = False

    # --- state -----------------------------------------------------------------------------------

    @property
    def pose(self) -> GroundPose:
        """Pose of base_link in map."""
        x = self._x
        return self.kinematics.pose_at((float(x[_PX]), float(x[_PY])), wrapped(float(x[_HEADING])))

    @property
    def turned(self) -> float:
        """Unwrapped heading [rad]."""
        return float(self._x[_HEADING])

    @property
    def bias(self) -> float:
        """Gyro bias about base_link z [rad/s]."""
        return float(self._x[_BIAS])

    @property
    def bias_error(self) -> float:
        """Standard deviation of the gyro bias [rad/s]."""
        return math.sqrt(self._p[_BIAS, _BIAS])

    @property
    def slip(self) -> float:
        """Estimated slip of the driven wheels [-]."""
        p = self.kinematics.parameters
        by_torque = p.driving_slip + p.slip_per_torque * (self._torque - p.driving_torque)
        by_torque += p.slip_curvature * max(self._torque - p.steep_torque, 0.0) ** 2
        return min(max(by_torque + self._slip_gain * float(self._x[_SLIP]), 0.0), _MAX_SLIP)

    @property
    def _slip_gain(self) -> float:
        """Slope of the nominal slip over the torque, relative to that at low torques [-]."""
        p = self.kinematics.parameters
        steep = 2.0 * p.slip_curvature * max(self._torque - p.steep_torque, 0.0)
        return 1.0 + steep / p.slip_per_torque if p.slip_per_torque > 0.0 else 1.0

    @property
    def drop(self) -> float:
        """Height of the fairlead above the tether attachment [m]; 0 = not known yet."""
        return float(self._x[_DROP]) if self._knows_drop else 0.0

    @property
    def tether_direction(self) -> tuple[float, float]:
        """Components ahead and left of the unit vector away from the fairlead; 0 = unknown."""
        x, y, heading = self.pose
        reach = math.hypot(x, y, self.drop)
        if reach <= 0.0 or not self._knows_drop:
            return 0.0, 0.0
        c, s = math.cos(heading), math.sin(heading)
        return (c * x + s * y) / reach, (c * y - s * x) / reach

    @property
    def height(self) -> tuple[float, float]:
        """Height of base_link in map [m], from the tether alone, and its variance [m^2]."""
        above = self.kinematics.parameters.attachment_offset
        if self._knows_drop:
            return -self.drop - above, float(self._p[_DROP, _DROP])
        if math.isnan(self._length):
            return 0.0, UNKNOWN_VARIANCE
        pose = self.pose
        drop = math.sqrt(max(self._length**2 - pose.x**2 - pose.y**2, 0.0))
        return -drop - above, self._within_tether

    @property
    def _within_tether(self) -> float:
        """Variance of a coordinate of a point within the tether's length [m^2]."""
        return UNKNOWN_VARIANCE if math.isnan(self._length) else 0.25 * self._length**2

    def covariance(self) -> Floats:
        """Covariance of x [m], y [m] and heading [rad] of base_link, (3, 3)."""
        found = self._filtered_covariance()
        if not self._knows_place:
            found[:2, :] = found[:, :2] = 0.0
            found[0, 0] = found[1, 1] = self._within_tether
        if not self._knows_heading:
            found[2, :] = found[:, 2] = 0.0
            found[2, 2] = UNKNOWN_ANGLE
        return found

    def _filtered_covariance(self) -> Floats:
        heading = self.turned
        ahead, left = self.kinematics.pivot
        c, s = math.cos(heading), math.sin(heading)
        to_base = np.eye(3)
        to_base[0, 2], to_base[1, 2] = s * ahead + c * left, -c * ahead + s * left
        return np.asarray(to_base @ self._p[:3, :3] @ to_base.T)

    # --- inputs ----------------------------------------------------------------------------------

    def set_pose(
        self,
        pose: GroundPose,
        *,
        knows_heading: bool = True,
        errors: tuple[float, float, float] | None = None,
    ) -> None:
        """Set the pose of base_link; without a known heading the estimate is kept.

        Args:
            pose: of base_link in map.
            knows_heading: whether the heading is set too.
            errors: standard deviations of x [m], y [m] and heading [rad]; None = the parameters'.
        """
        p = self.parameters
        position, turn = p.initial_position_std, p.initial_heading_std
        x_error, y_error, heading_error = errors or (position, position, turn)
        self._knows_place = True
        self._released_at = None
        self._knows_heading |= knows_heading
        heading = pose.heading if knows_heading else self.turned
        heading_variance = float(self._p[_HEADING, _HEADING])
        self._x[_HEADING] = heading
        self._x[[_PX, _PY]] = self.kinematics.pivot_of(GroundPose(pose.x, pose.y, heading))
        for k, error in ((_PX, x_error), (_PY, y_error)):
            self._p[k, :] = self._p[:, k] = 0.0
            self._p[k, k] = error**2
        self._p[_HEADING, :] = self._p[:, _HEADING] = 0.0
        self._p[_HEADING, _HEADING] = heading_error**2 if knows_heading else heading_variance
        self._p[_DROP, :] = self._p[:, _DROP] = 0.0
        self._knows_drop = False
        self._tether_updated_at = -math.inf

    def continue_from(self, other: DriveOdometry) -> None:
        """Take over pose and covariance of another filter."""
        self._x[:3], self._p[:3, :3] = other._x[:3], other._p[:3, :3]
        self._knows_place, self._knows_heading = other._knows_place, other._knows_heading

    def on_gyro(
        self, rate: Vector, force: Vector, now: float, *, at_rest: bool, flies: bool = False
    ) -> None:
        """Process an IMU sample.

        Args:
            rate: angular rate in base_link [rad/s].
            force: specific force in base_link [m/s^2].
            now: time of the sample [s].
            at_rest: the wheels are at rest without command.
            flies: the rover is in free fall.
        """
        before, self._gyro_at = self._gyro_at, now
        if before is None and not flies:
            self.attitude.start(force)
        last, self._last_rate = self._last_rate, rate
        if before is None or now <= before:
            self._moved_at = now
            return
        h = now - before
        if h > _MAX_STEP:
            was_at_rest = at_rest and before - self._moved_at > _QUIET_TIME
            self._moved_at = now
            if was_at_rest:
                return
            missed = h * max(abs(rate[2] - self.bias), abs(last[2] - self.bias))
            self._p[_HEADING, _HEADING] += min(missed**2, UNKNOWN_ANGLE)
            rate = last
        self._drift(h, flies=flies)
        p = self.parameters
        self._p[_BIAS, _BIAS] += p.gyro_bias_random_walk**2 * h
        unbiased_rate = rate[2] - self.bias
        limit = _DISTURBANCE_SIGMAS * p.gyro_noise_density / math.sqrt(h) + _CREEP
        disturbed = max(abs(rate[2] - last[2]), self._rocking(rate, h)) > limit
        if disturbed or not at_rest:
            self._moved_at = now
        is_resting = now - self._moved_at > _QUIET_TIME
        creeps = self._creeps(rate[2], h, is_resting=is_resting)
        if is_resting:
            self._update_level_bias(rate, h)
        bias_x, bias_y = self._level_bias
        fraction = min(
            h / (p.tilt_time_constant if is_resting else p.tilt_time_constant_moving), 1.0
        )
        turned = self.attitude.turn(
            (rate[0] - bias_x, rate[1] - bias_y, unbiased_rate), force, h, fraction
        )
        if is_resting and not creeps:
            self.yaw_rate = 0.0
            jacobian = np.zeros(_STATES)
            jacobian[_BIAS] = 1.0
            self._update(jacobian, unbiased_rate, p.gyro_noise_density**2 / h)
            return
        self.yaw_rate = turned / h
        self._x[_HEADING] += turned
        self._propagate(_HEADING, _BIAS, -h * self.attitude.up[2])
        self._p[_HEADING, _HEADING] += p.gyro_noise_density**2 * h
        if self._is_driven:
            # The pivot lies half a track_width beside the middle of the axle.
            self._advance_pivot(0.5 * self.kinematics.parameters.track_width * turned)

    def _creeps(self, rate: float, h: float, *, is_resting: bool) -> bool:
        """Whether a rover turns whose wheels are at rest, as where the tether drags it.

        Such a rate must not enter the bias. It is compared to the bias as known some time before: a
        bias that a few samples have just given would let those alone pass that confirm it.
        """
        if not is_resting:
            self._rest_rate = self.bias
            self._bias_before, self._bias_age = (self.bias, self.bias_error), 0.0
            return False
        self._bias_age += h
        self._rest_rate += min(h / _REST_TIME, 1.0) * (rate - self._rest_rate)
        bias, error = self._bias_before
        walked = self.parameters.gyro_bias_random_walk * math.sqrt(self._bias_age)
        if abs(self._rest_rate - bias) > 3.0 * math.hypot(error, walked) + _CREEP:
            return True
        if self._bias_age > _LEARNING_TIME:
            self._bias_before, self._bias_age = (self.bias, self.bias_error), 0.0
        return False

    def _rocking(self, rate: Vector, h: float) -> float:
        """Deviation of the rates about base_link x and y from their means [rad/s].

        The tether rocks a rover at rest: a rate that must not enter the biases.
        """
        x, y = self._level_rate
        from_x, from_y = rate[0] - x, rate[1] - y
        fraction = min(h / _REST_TIME, 1.0)
        self._level_rate = (x + fraction * from_x, y + fraction * from_y)
        return max(abs(from_x), abs(from_y))

    def _update_level_bias(self, rate: Vector, h: float) -> None:
        self._rested = min(self._rested + h, _LEVEL_MEMORY)
        fraction = h / self._rested
        x, y = self._level_bias
        self._level_bias = (x + fraction * (rate[0] - x), y + fraction * (rate[1] - y))

    def _drift(self, h: float, *, flies: bool) -> None:
        """Widen the position's covariance in a flight, which has a constant unknown speed."""
        before, self._flown = self._flown, self._flown + h if flies else 0.0
        if flies:
            drift = self.parameters.flight_speed_std**2 * (self._flown**2 - before**2)
            self._p[_PX, _PX] += drift
            self._p[_PY, _PY] += drift
            self._flight_variance += drift

    def on_release(self) -> None:
        """Process the release of a jump from the present pose."""
        self._released_at, self._flight_variance = self.pose, 0.0

    def on_flown(self, ahead: float, left: float) -> None:
        """Process the measured displacement of a jump; without its release it is ignored.

        Args:
            ahead: along the heading at the release, from the release to rest [m].
            left: to the left of it [m].
        """
        before, self._released_at = self._released_at, None
        if before is None:
            return
        x, y = before.to_map(ahead, left)
        landed = GroundPose(x, y, self.turned)
        prior, error = self._flight_variance, self.parameters.flight_measurement_std**2
        gain = prior / (prior + error)
        self._x[[_PX, _PY]] += gain * (np.array(self.kinematics.pivot_of(landed)) - self._x[:2])
        for state in (_PX, _PY):
            self._p[state, state] -= gain * prior
        self._propagate(_PX, _HEADING, before.y - y)
        self._propagate(_PY, _HEADING, x - before.x)

    def on_wheels(self, left: float, right: float, h: float, torque: float | None = None) -> None:
        """Process an increment of the wheel angles.

        Args:
            left: left wheel [rad].
            right: right wheel [rad].
            h: duration of the increment [s].
            torque: wheel torque [N m]; None = nominal.
        """
        radius, slip = self.kinematics.parameters.wheel_radius, self.slip
        slips = self._is_driven = left > 0.0 and left > 0.5 * right
        turned = 0.5 * (left + right) if slips else max(right, 0.0)
        travel = radius * turned * ((1.0 - slip) if slips else 1.0)
        if slips and torque is not None:
            self._torque += min(h / _TORQUE_TIME, 1.0) * (torque - self._torque)
        if left < 0.0 and right <= 0.0:
            # The rover turns: the pivot is at rest and base_link moves about it.
            self.speed = self.kinematics.pivot[1] * self.yaw_rate
            return
        self.speed = travel / h if h > 0.0 and travel > 0.0 else 0.0
        if travel == 0.0:
            return
        self.travelled += travel
        self._advance_pivot(travel)
        if slips:
            self._propagate_slip(travel, radius * turned)

    def _advance_pivot(self, travel: float) -> None:
        c, s = math.cos(self.turned), math.sin(self.turned)
        lateral = self.kinematics.parameters.sideslip_per_force * self._lateral_force() * travel
        self._x[_PX] += c * travel - s * lateral
        self._x[_PY] += s * travel + c * lateral
        self._propagate(_PX, _HEADING, -s * travel)
        self._propagate(_PY, _HEADING, c * travel)
        # Lateral error of a direction that is correlated over the slip's distance.
        variance = (
            self.parameters.sideslip_std**2
            * abs(travel)
            * self.parameters.slip_correlation_distance
        )
        self._p[_PX, _PX] += s * s * variance
        self._p[_PY, _PY] += c * c * variance
        self._p[_PX, _PY] -= s * c * variance
        self._p[_PY, _PX] -= s * c * variance

    def doubt(self, travel: float) -> None:
        """Widen the covariance along the heading by a travel [m] that perhaps was none."""
        along = travel * np.array((math.cos(self.turned), math.sin(self.turned)))
        self._p[:2, :2] += np.outer(along, along)

    def _lateral_force(self) -> float:
        """Lateral force of the tether on the rover, left positive [N]."""
        return -self.mean_pull * self.tether_direction[1]

    def _propagate_slip(self, travel: float, rolled: float) -> None:
        """Propagate the slip's covariance and its effect on the position."""
        p = self.parameters
        rolled *= self._slip_gain
        self._propagate(_PX, _SLIP, -math.cos(self.turned) * rolled)
        self._propagate(_PY, _SLIP, -math.sin(self.turned) * rolled)
        decay = math.exp(-travel / p.slip_correlation_distance)
        self._x[_SLIP] *= decay
        self._p[_SLIP, :] *= decay
        self._p[:, _SLIP] *= decay
        self._p[_SLIP, _SLIP] += p.slip_std**2 * (1.0 - decay * decay)

    def _propagate(self, state: int, other: int, fraction: float) -> None:
        """Covariance after a state changed by a fraction of another's error: P = F P F^T."""
        self._p[state, :] += fraction * self._p[other, :]
        self._p[:, state] += fraction * self._p[:, other]

    def on_tether(self, tether: TetherMeasurement, *, is_taut: bool) -> None:
        """Process the tether measurement.

        Args:
            tether: as measured by the winch.
            is_taut: the winch controls the tension; otherwise the length only bounds the distance.
        """
        p = self.parameters
        self.tether_range = 0.0
        self._length = tether.length
        # Averaged: the winch controls the tension only roughly.
        force = max(tether.tension - tether.weight, 0.0)
        self.mean_pull += _FORCE_FRACTION * (force - self.mean_pull)
        if not p.uses_tether:
            return
        px, py = self.pose.x, self.pose.y
        horizontal = math.hypot(px, py)
        chord = chord_of(tether, horizontal)
        if is_taut:
            self.tether_range = chord
        if not self._knows_drop:
            if is_taut and chord > horizontal:
                self._initialize_drop(chord, horizontal)
            return
        distance = math.hypot(horizontal, self.drop)
        if is_taut and self.travelled - self._tether_updated_at < p.tether_update_distance:
            return
        beyond = distance - tether.length
        if not is_taut and beyond <= 3.0 * p.tether_range_std:
            return
        self._tether_updated_at = self.travelled
        jacobian = np.zeros(_STATES)
        ahead, left = self.kinematics.pivot
        c, s = math.cos(self.turned), math.sin(self.turned)
        jacobian[_PX], jacobian[_PY] = px / distance, py / distance
        jacobian[_HEADING] = jacobian[_PX] * (s * ahead + c * left) + jacobian[_PY] * (
            s * left - c * ahead
        )
        jacobian[_DROP] = self.drop / distance
        innovation = (chord if is_taut else tether.length) - distance
        expected = float(jacobian @ self._p @ jacobian) + p.tether_range_std**2
        if innovation * innovation < 16.0 * expected:
            self._update(jacobian, innovation, p.tether_range_std**2)

    def _initialize_drop(self, chord: float, horizontal: float) -> None:
        """Initialize the fairlead height from the first taut length at the known position."""
        self._x[_DROP] = math.sqrt(chord**2 - horizontal**2)
        self._p[_DROP, _DROP] = self.parameters.initial_drop_std**2
        self._knows_drop = True
        self._tether_updated_at = self.travelled

    def _gain(self, jacobian: Floats, variance: float) -> Floats:
        return np.asarray(self._p @ jacobian / (float(jacobian @ self._p @ jacobian) + variance))

    def _update(self, jacobian: Floats, innovation: float, variance: float) -> None:
        gain = self._gain(jacobian, variance)
        self._x = self._x + gain * innovation
        remaining = _IDENTITY - np.outer(gain, jacobian)
        self._p = remaining @ self._p @ remaining.T + variance * np.outer(gain, gain)


class DeadReckoning(DriveOdometry):
    """Pose since the start by encoders and gyro alone, in odom: it never jumps.

    A measurement corrects gyro bias and slip, and not the pose; the covariance is exact for any
    gain (Joseph's form).

    Args:
        corrected: gets the same inputs, and knows the force of the tether.
    """

    def __init__(self, corrected: DriveOdometry) -> None:
        super().__init__(corrected.kinematics, corrected.parameters)
        self._corrected = corrected
        self._knows_place = self._knows_heading = True
        self._p[:3, :3] = 0.0

    def _lateral_force(self) -> float:
        return self._corrected._lateral_force()

    def _gain(self, jacobian: Floats, variance: float) -> Floats:
        gain = super()._gain(jacobian, variance)
        gain[:3] = 0.0
        return gain
