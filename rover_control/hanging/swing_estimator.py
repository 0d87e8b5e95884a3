"""Kalman filter for swing, tilt and gyro bias. Pure.

Inputs are gyro, accelerometer, drum and rotor encoders, and the smear of the camera's images. On a
taut tether the accelerometer measures only the tether force: it shows the tilt against the tether,
not the swing. The gyro shows both; the model of `hanging_rover` separates them: motion at the
pendulum's frequency is swing, motion at the tilt's frequency or in response to the rotors is tilt,
and a constant is bias. The states of each horizontal axis of base_link are

    u, v = u'    direction of the tether against the plumb line [rad], [rad/s]
    p, q = p'    tilt against the tether [rad], [rad/s]
    b            bias of the gyro [rad/s]
    c            tilt offset of the accelerometer [rad]: its bias, an unbalanced load

The measurements are  gyro = v + q + b  and  specific force = g (p + c) + e phi''  with the height e
of the centre of mass above the IMU; the change of the rotor momentum is a known input. As base_link
yaws, u, v, p and q rotate in it at the gyro's rate about z less its bias. That bias is a state too:
a swing keeps its plane in space (but for the precession of an ellipse, 3/8 w a b), so its rotation
in base_link reveals the yaw. Of a calm rover it is the wall's image: the camera looks aft, and the
image moves sideways at  gyro_z - b - y'/D  with the swing's velocity y' and the wall's distance D.
Its smear is at least that rate, and so bounds the bias. A bound is no noise that averages out: the
variance of this rate falls to the square of the bound, and not below it with more images.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

from msg_schemas.parameters import parameter
from msg_schemas.samples import Vector
from rover_control.hanging.hanging_rover import HangingParameters

Array = NDArray[np.float64]

# States of the x axis; those of the y axis follow, and the bias about z.
_U, _V, _P, _Q, _B, _C = range(6)
_AXIS = 6
_YAW_BIAS = 12
_SIZE = 13
_SWINGING, _TILTING = (_U, _V), (_P, _Q)
_EYE = np.eye(_SIZE)
_YAW_TIME = 0.5  # low-pass of the gyro about z [s]
_NOISE_FACTOR = 8.0  # lasting process noise, in RMS, that a disturbance must exceed
_NOISE_TIME = 3.0  # low-pass of the lasting process noise [s]
_INNOVATION_TIME = 0.05  # averaging time of the gyro innovation [s]
_IMPACT_TIME = 0.5  # integration time of the accelerometer innovation [s]
_MODEL_ERROR = 0.2  # relative error of the modelled tilt motion
_INFLATION_TIME = 0.3  # adaptation time of the process noise [s]
_INITIAL_TILT_RATE = 0.1  # standard deviation [rad/s]
_EXPECTED_RATIO = 4.0  # mean square innovation over its variance that needs no added noise
_OUTLIER = 5.0  # standard deviations beyond which an accelerometer innovation is an impact
_TILT_ERROR = 0.05  # relative error of the tilt stiffness over inertia
_ROTOR_TORQUE_TIME = 1.0  # averaging time of the rotor torque [s]
_MASS_ERROR = 0.2  # relative error of the mass
_IMAGE_TIME = 0.5  # averaging time of the image's rate, and of the gyro with it [s]
_IMAGE_GAP = 0.3  # without a report, after which the averages start again [s]
_TAUT_FRACTION = 0.3  # of the weight, below which the tether is slack
_MAX_PULL = 3.0  # of the weight; larger forces are clipped
_MAX_ANGLE = 1.0  # largest plausible swing and tilt [rad]


@dataclass(frozen=True)
class EstimatorParameters:
    """Measurement and process noise of the swing estimator."""

    gyro_noise_density: float = parameter(
        8.7e-5, "rad/s/sqrt(Hz)", "noise density of the gyro", 1e-7, 1
    )
    gyro_turn_on_bias: float = parameter(
        2.0e-3, "rad/s", "standard deviation of the gyro's turn-on bias", 0.0, 1.0
    )
    gyro_bias_random_walk: float = parameter(
        5.0e-6, "rad/s/sqrt(s)", "random walk of the gyro bias about x and y", 0.0, 1.0
    )
    yaw_gyro_bias_random_walk: float = parameter(
        1.5e-5,
        "rad/s/sqrt(s)",
        "random walk of the gyro bias about z, errors of the swing model included",
        0.0,
        1.0,
    )
    accelerometer_noise_density: float = parameter(
        1.0e-3, "m/s^2/sqrt(Hz)", "noise density of the accelerometer", 1e-6, 1.0
    )
    tilt_offset: float = parameter(
        0.01,
        "rad",
        "initial standard deviation of the accelerometer's tilt offset",
        0.0,
        1.0,
    )
    tilt_offset_random_walk: float = parameter(
        2.0e-5, "rad/sqrt(s)", "random walk of the tilt offset", 0.0, 1.0
    )
    swing_process_noise: float = parameter(
        1.5e-5, "rad/s/sqrt(s)", "process noise of the swing rate", 0.0, 1.0
    )
    tilt_process_noise: float = parameter(
        1.0e-3, "rad/s/sqrt(s)", "process noise of the tilt rate", 0.0, 1.0
    )
    disturbance_threshold: float = parameter(
        1.5e-3, "rad/s", "mean gyro innovation above which a disturbance is detected", 1e-5, 1.0
    )
    image_rate: float = parameter(
        5.0e-3, "rad/s/px", "image rate per smear: the camera's pixel angle over its exposure time",
        1e-6, 1.0,
    )  # fmt: skip
    smear_error: float = parameter(
        0.02, "px", "systematic error of the camera's report of the smear", 1e-3, 10.0
    )
    initial_swing: float = parameter(
        0.05, "rad", "initial standard deviation of the swing", 1e-4, 1.0
    )


class Ellipse(NamedTuple):
    """Ellipse of the swing in a horizontal plane."""

    major: float  # amplitudes [rad], major >= |minor|
    minor: float  # > 0 counter-clockwise seen from above, 0 in one plane
    plane: float  # of the major axis, from base_link x to y [rad]


class SwingEstimate(NamedTuple):
    """Estimate of swing and tilt; pairs are along base_link x and y."""

    direction: tuple[float, float]  # u [rad]
    direction_rate: tuple[float, float]  # [rad/s]
    tilt: tuple[float, float]  # p [rad]
    tilt_rate: tuple[float, float]  # [rad/s]
    gyro_bias: tuple[float, float]  # of the rates along x and y [rad/s]
    yaw_rate: float  # [rad/s]
    frequency: float  # of the swing [rad/s]
    swing_error: float  # standard deviation of the swing's rate amplitude [rad/s]
    yaw_error: float  # standard deviation of the yaw rate [rad/s]
    lever_share: float = 0.0  # of the tilt in the swing: lever over the pendulum's length

    @property
    def ellipse(self) -> Ellipse:
        """Ellipse of the centre of mass about the plumb line, from its counter-rotating circles.

        The tether's force alone moves that centre sideways, so a tilting rover describes an
        ellipse too, while the tether's direction follows the tilt.
        """
        z = complex(*self.direction) + self.lever_share * complex(*self.tilt)
        rate = complex(*self.direction_rate) + self.lever_share * complex(*self.tilt_rate)
        turned = rate / (1j * self.frequency)
        ahead, back = 0.5 * (z + turned), 0.5 * (z - turned)
        plane = 0.5 * (cmath.phase(ahead) + cmath.phase(back)) if ahead and back else 0.0
        return Ellipse(abs(ahead) + abs(back), abs(ahead) - abs(back), plane)

    @property
    def camera_rate(self) -> float:
        """Magnitude of the rover's angular rate [rad/s]."""
        return math.hypot(
            self.direction_rate[0] + self.tilt_rate[0],
            self.direction_rate[1] + self.tilt_rate[1],
            self.yaw_rate,
        )


class SwingEstimator:
    """Estimates swing and tilt of a hanging rover.

    Args:
        parameters: noise densities.
        hanging: rover and tether.
    """

    def __init__(self, parameters: EstimatorParameters, hanging: HangingParameters) -> None:
        self.parameters = parameters
        self.hanging = hanging
        self.length = math.nan
        self.rate = 0.0
        self.freezes_yaw_bias = False  # while rotors cone the rover
        self.disturbances = 0  # number of detected disturbances
        self.divergences = 0  # number of restarts after an implausible estimate
        self.restart()

    def restart(self) -> None:
        """Restart with the initial uncertainty, once the payout is known."""
        p = self.parameters
        axis = [
            p.initial_swing,
            p.initial_swing * self.hanging.swing_frequency(self.length),
            p.initial_swing,
            _INITIAL_TILT_RATE,
            p.gyro_turn_on_bias,
            p.tilt_offset,
        ]
        self._state: Array = np.zeros(_SIZE)
        self._covariance: Array = np.diag(np.square([*axis, *axis, p.gyro_turn_on_bias]))
        self._gyro_z = 0.0
        self._turned = self._watched = 0.0  # by the gyro since the last image [rad], in [s]
        self._image_time = 0.0  # averaging time so far [s]
        self._image_gyro = self._square_image_rate = 0.0  # averages
        self._last_step = self._swept_rate = 0.0
        self.yaw_increment = 0.0  # about base_link z in the last step [rad]
        self._gyro_innovation = [0.0, 0.0]
        self._impact_speed = [0.0, 0.0]  # lateral, integrated accelerometer innovation [m/s]
        # Until the gyro shows otherwise, the rover shakes: one that was lifted off the floor does,
        # and without this noise its shaking would be taken for a swing.
        shaking = [_INITIAL_TILT_RATE**2, _INITIAL_TILT_RATE**2, 0.0, 0.0]
        self._excess = shaking.copy()  # of the innovations over their expected variance, low-pass
        self._process_noise = shaking  # added variance of the measurements
        self._filtered_noise = [0.0, 0.0]  # of the gyro, low-pass
        self._lasting_noise = [0.0, 0.0]  # second low-pass: a disturbance must not mask itself
        self._rotor_torque = [0.0, 0.0]  # rate of change of the rotor momenta [N m]
        process_noise = [
            0.0,
            p.swing_process_noise,
            0.0,
            p.tilt_process_noise,
            p.gyro_bias_random_walk,
            p.tilt_offset_random_walk,
        ]
        self._noise: Array = np.diag(
            np.square([*process_noise, *process_noise, p.yaw_gyro_bias_random_walk])
        )
        # _predict fills in the rest.
        self._system_matrix: Array = np.zeros((_SIZE, _SIZE))
        for at in (0, _AXIS):
            self._system_matrix[at + _U, at + _V] = self._system_matrix[at + _P, at + _Q] = 1.0
        stiffness, g = self.hanging.stiffness, self.hanging.rover_gravity
        # Gyro along x and y, then accelerometer along x and y.
        self._measurement_matrix: Array = np.zeros((4, _SIZE))
        for k, inertia in enumerate(self.hanging.inertias):
            at = k * _AXIS
            self._measurement_matrix[k, [at + _V, at + _Q, at + _B]] = 1.0
            self._measurement_matrix[2 + k, at + _P] = (
                g - self.hanging.com_above_imu * stiffness / inertia
            )
            self._measurement_matrix[2 + k, at + _C] = g

    def reset_swing(self, pause: float) -> None:
        """Reset swing and tilt, but keep the gyro biases, after a pause [s] without steps."""
        state, covariance = self._state, self._covariance
        self.restart()
        for at in (_B, _AXIS + _B, _YAW_BIAS):
            self._state[at] = state[at]
            walked = covariance[at, at] + pause * self._noise[at, at]
            self._covariance[at, at] = min(walked, self._covariance[at, at])

    @property
    def yaw_bias(self) -> float:
        """Bias of the gyro about base_link z [rad/s]."""
        return float(self._state[_YAW_BIAS])

    def correct_yaw_bias(self, change: float) -> None:
        """Change the bias about z [rad/s] by what the tether's twist shows."""
        self._state[_YAW_BIAS] += change

    def on_drum(self, length: float, rate: float) -> None:
        """Update payout [m] and payout rate [m/s]."""
        is_first = math.isnan(self.length)
        self.length, self.rate = length, rate
        if is_first:
            self.restart()

    @property
    def yaw_rate(self) -> float:
        """Yaw rate about the tether [rad/s]."""
        return self._gyro_z - float(self._state[_YAW_BIAS])

    @property
    def twist_increment(self) -> float:
        """Change of the tether's twist in the last step [rad].

        The turn of base_link about its z axis, corrected by the solid angle that this axis sweeps.
        """
        return self.yaw_increment + 0.5 * self._last_step * self._swept_rate

    def step(
        self,
        gyro: Vector,
        force: Vector,
        momentum_change: tuple[float, float],
        h: float,
    ) -> None:
        """Advance by h to a reading of the IMU.

        Args:
            gyro: angular velocity in base_link [rad/s].
            force: specific force in base_link [m/s^2].
            momentum_change: of the rotors since the last step, in the axes of `hanging_rover`
                [N m s].
            h: time since the last step [s], above 0.
        """
        if math.isnan(self.length):
            return
        # One gyro sample is as noisy as the steady limit; the increments sum up without a filter.
        self._gyro_z += min(h / _YAW_TIME, 1.0) * (gyro[2] - self._gyro_z)
        self.yaw_increment = (gyro[2] - float(self._state[_YAW_BIAS])) * h
        self._turned += gyro[2] * h
        self._watched += h
        # The tether force restores the tilt; winch acceleration changes it.
        pull = min(max(force[2] / self.hanging.rover_gravity, 0.0), _MAX_PULL)
        self._predict(momentum_change, pull, h)
        self._last_step = h
        # Winch and bounce change the magnitude of the force, not its direction.
        scale = self.hanging.rover_gravity / force[2] if self._is_taut(force) else math.nan
        measured = [-gyro[1], gyro[0]]
        variances = [self.parameters.gyro_noise_density**2 / h] * 2
        if not math.isnan(scale):
            for k, inertia in enumerate(self.hanging.inertias):
                known = -self.hanging.com_above_imu * momentum_change[k] / (h * inertia)
                measured.append(force[k] * scale - known)
                variances.append((self.parameters.accelerometer_noise_density * scale) ** 2 / h)
        rows = self._measurement_matrix[: len(measured)]
        innovation = np.array(measured) - rows @ self._state
        self._detect_disturbance(innovation.tolist(), h)
        self._update(rows, innovation, variances, h)
        if not self._is_plausible():
            self.restart()
            self.disturbances += 1
            self.divergences += 1

    def on_image(self, smear: float, distance: float) -> None:
        """Bound the bias about z by an image of the wall since the last one.

        The mean square of a rate is at least the square of its mean, so the averages bound it also
        while it changes.

        Args:
            smear: [px].
            distance: of the wall [m], above 0.
        """
        p = self.parameters
        turned, watched = self._turned, self._watched
        self._turned = self._watched = 0.0
        if math.isnan(self.length) or not 0.0 < watched < _IMAGE_GAP:
            self._image_time = 0.0
            return
        self._image_time = min(self._image_time + watched, _IMAGE_TIME)
        share = min(watched / self._image_time, 1.0)
        self._image_gyro += share * (turned / watched - self._image_gyro)
        square = (p.image_rate * smear) ** 2
        self._square_image_rate += share * (square - self._square_image_rate)
        bound = self._square_image_rate + (p.image_rate * p.smear_error) ** 2
        bound += p.gyro_noise_density**2 / self._image_time
        row = np.zeros(_SIZE)
        row[_YAW_BIAS], row[_AXIS + _V] = 1.0, (self.length + self.hanging.lever) / distance
        along = self._covariance @ row
        expected = float(row @ along)
        if expected <= bound:
            return
        # The gain that leaves the bound as the variance.
        gain = (1.0 - bound / expected) / expected * along
        self._state = self._state + gain * (self._image_gyro - float(row @ self._state))
        self._covariance = self._covariance - np.outer(gain, along)

    def _is_plausible(self) -> bool:
        """Whether the estimate is plausible for a hanging rover.

        The model does not hold for a standing rover or a slack tether; the estimate then diverges.
        """
        state = self._state.tolist()
        angles = (state[at + n] for at in (0, _AXIS) for n in (_U, _P))
        # A comparison with NaN is false.
        return all(-_MAX_ANGLE < angle < _MAX_ANGLE for angle in angles) and all(
            0.0 <= variance < math.inf for variance in self._covariance.diagonal().tolist()
        )

    @property
    def is_settled(self) -> bool:
        """Whether the swing rate is certain enough to detect a disturbance."""
        return float(self._covariance[_V, _V]) < self.parameters.disturbance_threshold**2

    @property
    def _is_calm(self) -> bool:
        """Whether there is no unmodelled motion."""
        return (
            self.is_settled
            and max(self._process_noise[:2]) < self.parameters.disturbance_threshold**2
        )

    def _is_taut(self, force: Vector) -> bool:
        return force[2] > _TAUT_FRACTION * self.hanging.rover_gravity

    def _detect_disturbance(self, innovation: list[float], h: float) -> None:
        """Detect a disturbance from the innovations of gyro and accelerometer.

        A force that starts a swing, at once or over a second, appears in the accelerometer as the
        speed that it gives; the gyro alone would first attribute it to the tilt.
        """
        # At the start and after a disturbance the innovations are uncertain.
        settled = self.is_settled
        reach = self.length + self.hanging.lever
        lateral = innovation[2:] or (0.0, 0.0)
        state = self._state.tolist()
        by_gyro = by_force = 0.0  # squares, over those of the limits
        for k, inertia in enumerate(self.hanging.inertias):
            self._gyro_innovation[k] += min(h / _INNOVATION_TIME, 1.0) * (
                innovation[k] - self._gyro_innovation[k]
            )
            # Model errors scale with the tilt motion.
            tilt, tilt_rate = state[k * _AXIS + _P], state[k * _AXIS + _Q]
            moving = math.hypot(tilt_rate, tilt * math.sqrt(self.hanging.stiffness / inertia))
            limit = self.parameters.disturbance_threshold + _MODEL_ERROR * moving
            # A disturbance raises the process noise itself: compare with the noise before it.
            share = min(h / _NOISE_TIME, 1.0)
            self._filtered_noise[k] += share * (self._process_noise[k] - self._filtered_noise[k])
            self._lasting_noise[k] += share * (self._filtered_noise[k] - self._lasting_noise[k])
            limit += _NOISE_FACTOR * math.sqrt(self._lasting_noise[k])
            self._impact_speed[k] += (
                h * lateral[k] - min(h / _IMPACT_TIME, 1.0) * self._impact_speed[k]
            )
            by_gyro += (self._gyro_innovation[k] / limit) ** 2
            by_force += (self._impact_speed[k] / (reach * limit)) ** 2
        if settled and max(by_gyro, by_force) > 1.0:
            self._on_disturbance()

    def _predict(self, momentum_change: tuple[float, float], pulled: float, h: float) -> None:
        d, length = self.hanging.lever, self.length
        share = d / length
        state = self._state.tolist()
        yaw = self.yaw_increment / h
        x, vx, phi_x, rate_x = _motion(state, 0)
        y, vy, phi_y, rate_y = _motion(state, _AXIS)
        self._swept_rate = phi_x * rate_y - phi_y * rate_x
        # Large swings: a^2 + b^2 lowers the frequency, a b precesses the ellipse.
        size = x * x + y * y + (vx * vx + vy * vy) / self.hanging.swing_frequency(length) ** 2
        pull = self.hanging.effective_gravity(length) * (1.0 - size / 8.0)
        # The solid angle that the z axis of base_link sweeps turns its x and y axes, too.
        heading_rate = yaw + 0.5 * self._swept_rate
        turning = heading_rate - 0.375 * (x * vy - y * vx)
        matrix, growth = self._system_matrix, 2.0 * self.rate / length
        for k, inertia in enumerate(self.hanging.inertias):
            at, other = k * _AXIS, (1 - k) * _AXIS
            restoring = pulled * self.hanging.stiffness / inertia
            matrix[at + _V, at + _U] = -pull / length
            matrix[at + _V, at + _V] = -growth
            matrix[at + _V, at + _P] = share * restoring
            matrix[at + _Q, at + _U] = pull / length
            matrix[at + _Q, at + _V] = growth
            matrix[at + _Q, at + _P] = -(1.0 + share) * restoring
            sign = 1.0 if k == 0 else -1.0
            for n in _SWINGING:
                matrix[at + n, other + n] = sign * turning
            for n in _TILTING:
                matrix[at + n, other + n] = sign * heading_rate
        step = matrix * h
        forward = _EYE + step + 0.5 * step @ step
        moved = forward @ self._state
        for k, inertia in enumerate(self.hanging.inertias):
            impulse = -momentum_change[k] / inertia  # change of phi', constant rate over the step
            at = k * _AXIS
            for swinging, tilting, part in ((_V, _Q, impulse), (_U, _P, 0.5 * h * impulse)):
                moved[at + swinging] -= share * part
                moved[at + tilting] += (1.0 + share) * part
        # The yaw bias rotates the swing: x' = ... + yaw y. The tilt is left out: with a mass error
        # the response to the rotors would be taken for a yaw.
        for n in _SWINGING:
            forward[n, _YAW_BIAS] = -h * state[_AXIS + n]
            forward[_AXIS + n, _YAW_BIAS] = h * state[n]
        self._state = moved
        covariance = forward @ self._covariance @ forward.T + h * self._noise
        # With a mass error the rotors excite the swing differently than modelled.
        reach = self.hanging.pendulum_inertia(length)
        for k, change in enumerate(momentum_change):
            self._rotor_torque[k] += min(h / _ROTOR_TORQUE_TIME, 1.0) * (
                change / h - self._rotor_torque[k]
            )
            unknown = _MASS_ERROR * self._rotor_torque[k] / reach
            covariance[k * _AXIS + _V, k * _AXIS + _V] += h * _ROTOR_TORQUE_TIME * unknown**2
        for k, inertia in enumerate(self.hanging.inertias):
            at = k * _AXIS
            square = pulled * self.hanging.stiffness / inertia
            moving = state[at + _Q] ** 2 + square * state[at + _P] ** 2
            process_noise = self._process_noise[k] + h * _TILT_ERROR**2 * math.sqrt(square) * moving
            # Noise of the tilt acts on the swing through the tether, as the tilt itself does.
            covariance[at + _V, at + _V] += process_noise * share**2
            covariance[at + _Q, at + _Q] += process_noise * (1.0 + share) ** 2
            covariance[at + _V, at + _Q] -= process_noise * share * (1.0 + share)
            covariance[at + _Q, at + _V] -= process_noise * share * (1.0 + share)
        self._covariance = 0.5 * (covariance + covariance.T)

    def _update(self, rows: Array, innovation: Array, variances: list[float], h: float) -> None:
        """Update with measurements: their rows (k, SIZE), innovations and variances.

        Joseph's form keeps the covariance positive over hours of updates. Innovations larger than
        model and sensor noise explain, as from tether vibration or inertia errors at large tilts,
        adapt the added noise: process noise of the tilt for the gyro, measurement noise for the
        accelerometer. Meanwhile the yaw bias is not updated.

        An impact on a wall or of a snatching tether gives many times the weight for a sample or
        two. Accelerometer innovations beyond 5 standard deviations are down-weighted, for the tilt
        and for the added noise, which still grows if they last.
        """
        along = self._covariance @ rows.T
        expected = rows @ along
        share = min(h / _INFLATION_TIME, 1.0)
        for k, (difference, own) in enumerate(
            zip(innovation.tolist(), expected.diagonal().tolist(), strict=True)
        ):
            square, added = difference * difference, 0.0
            is_force = k >= 2
            if is_force:
                variances[k] += self._process_noise[k]
            variance = own + variances[k]
            if is_force:
                outlier = _OUTLIER**2 * variance
                added = max(square - outlier, 0.0) / _OUTLIER**2
                square = min(square, outlier)
            excess = square - _EXPECTED_RATIO * variance
            self._excess[k] = max(self._excess[k] + share * (excess - self._excess[k]), 0.0)
            self._process_noise[k] += share * (self._excess[k] - self._process_noise[k])
            variances[k] += added
            expected[k, k] = variance + added
        _, solved, failed = dposv(expected, along.T)
        # A covariance that is not positive leaves no estimate, which is not plausible.
        gain = np.full_like(along, math.nan) if failed else solved.T
        if self.freezes_yaw_bias or not self._is_calm:
            gain[_YAW_BIAS] = 0.0
        self._state = self._state + gain @ innovation
        complement = _EYE - gain @ rows
        self._covariance = (
            complement @ self._covariance @ complement.T + (gain * variances) @ gain.T
        )

    def _on_disturbance(self) -> None:
        """Inflate the covariance of swing and tilt after a disturbance; keep the biases."""
        self.disturbances += 1
        self._gyro_innovation = [0.0, 0.0]
        self._impact_speed = [0.0, 0.0]
        rate = self.parameters.initial_swing * self.hanging.swing_frequency(self.length)
        angle = 0.1 * self.parameters.initial_swing
        for at in (0, _AXIS):
            for n, deviation in ((_V, rate), (_Q, rate), (_U, angle), (_P, angle)):
                self._covariance[at + n, at + n] = max(
                    self._covariance[at + n, at + n], deviation**2
                )

    @property
    def estimate(self) -> SwingEstimate:
        """Present estimate."""
        state = self._state.tolist()
        x, y = state[:_AXIS], state[_AXIS:_YAW_BIAS]
        covariance = self._covariance.diagonal()
        frequency = self.hanging.swing_frequency(self.length)
        errors = [covariance[at + _V] + frequency**2 * covariance[at + _U] for at in (0, _AXIS)]
        return SwingEstimate(
            (x[_U], y[_U]),
            (x[_V], y[_V]),
            (x[_P], y[_P]),
            (x[_Q], y[_Q]),
            (x[_B], y[_B]),
            self.yaw_rate,
            frequency,
            math.sqrt(max(errors)),
            math.sqrt(covariance[_YAW_BIAS]),
            self.hanging.lever / (self.length + self.hanging.lever),
        )


def _motion(state: list[float], at: int) -> tuple[float, float, float, float]:
    """u, u', phi and phi' of the axis whose states start at an index."""
    u, v, p, q = state[at : at + 4]
    return u, v, u + p, v + q
