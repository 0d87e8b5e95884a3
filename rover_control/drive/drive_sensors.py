"""What the drive senses and estimates: samples in, odometry and freshness out. Pure."""

from __future__ import annotations

import math

from msg_schemas import machine, topics
from msg_schemas.samples import ImuSample, JointSample
from rover_control.drive.drive_odometry import DeadReckoning, DriveOdometry, TetherMeasurement
from rover_control.drive.drive_settings import DriveParameters
from rover_control.drive.drive_tether import TetherControl
from rover_control.drive.wheel_use import WheelUse

_NANO = 1e9
_FREE_FALL = 0.3  # specific force over gravity below which the rover flies [-]
_PLAY = 1.5e-3  # largest wheel angle that is the encoder's noise [rad]


class DriveSensors:
    """Updates the odometry with the samples, and knows which are stale.

    Args:
        parameters: motor, gravity and supervision of the sensors.
        odometry: of the pose in map.
        tether: that receives the winch's estimates.
        wheels: what they are used for; they do not measure a travel while they balance the rover.

    Attributes:
        dead_reckoning: pose in odom, which never jumps.
        torque: wheel torque, low-pass filtered [N m].
        rates: of left and right wheel [rad/s].
        forward: acceleration along base_link x without gravity [m/s^2].
        pitch_rate: [rad/s].
        off_floor_since: time since which the contact switch reports no floor [s]; None = floor.
    """

    def __init__(
        self,
        parameters: DriveParameters,
        odometry: DriveOdometry,
        tether: TetherControl,
        wheels: WheelUse,
    ) -> None:
        self.parameters = parameters
        self.odometry = odometry
        self.dead_reckoning = DeadReckoning(odometry)
        self.tether = tether
        self.wheels = wheels
        self.torque = 0.0
        self.rates = (0.0, 0.0)
        self.forward = 0.0
        self.pitch_rate = 0.0
        self.off_floor_since: float | None = None
        self._angles: tuple[float, float, float] | None = None  # left, right [rad], time [s]
        self._moved_at = 0.0  # time of the last motion of an encoder [s]
        self._received_at: dict[str, float] = {}

    def on_imu(self, sample: ImuSample, now_ns: int) -> None:
        """Process an IMU sample."""
        self._received_at[topics.IMU] = now_ns / _NANO
        odometry, gravity = self.odometry, self.parameters.drive_gravity
        at_rest = self.wheels.follower.is_at_rest and self.is_on_floor
        flies = math.hypot(*sample.linear_acceleration) < _FREE_FALL * gravity
        for each in (odometry, self.dead_reckoning):
            each.on_gyro(
                sample.angular_velocity,
                sample.linear_acceleration,
                (sample.stamp_ns or now_ns) / _NANO,
                at_rest=at_rest,
                flies=flies,
            )
        self.forward = sample.linear_acceleration[0] - gravity * odometry.attitude.up[0]
        self.pitch_rate = sample.angular_velocity[1]

    def on_wheels(self, sample: JointSample, now_ns: int) -> None:
        """Process angles and rates of the wheels."""
        self._received_at[topics.WHEEL_STATE] = now_ns / _NANO
        left, right = sample.joints[machine.WHEEL_LEFT], sample.joints[machine.WHEEL_RIGHT]
        self.rates = (left.velocity, right.velocity)
        now = (sample.stamp_ns or now_ns) / _NANO
        before = self._angles
        if before is None:
            self._angles, self._moved_at = (left.position, right.position, now), now
            return
        angles = _with_play(before[0], left.position), _with_play(before[1], right.position)
        self._angles = (*angles, now)
        if angles != before[:2]:
            self._moved_at = now
        # During a jump the wheels slip where they touch the ground.
        if now > before[2] and self.is_on_floor and not self.wheels.is_balancing:
            for each in (self.odometry, self.dead_reckoning):
                each.on_wheels(
                    angles[0] - before[0], angles[1] - before[1], now - before[2], self.torque
                )

    def on_currents(self, sample: JointSample, now_ns: int) -> None:
        """Process the motor currents; the wheel motor's gives the wheel torque."""
        self._received_at[topics.MOTOR_CURRENTS] = now_ns / _NANO
        current = sample.joints[machine.WHEEL_MOTOR].effort
        self.torque += 0.1 * (current * self.parameters.torque_per_ampere - self.torque)

    def on_contact(self, sample: JointSample, now_ns: int) -> None:
        """Process the contact switches; only the floor's is used."""
        now = self._received_at[topics.CONTACT] = now_ns / _NANO
        if sample.joints[machine.FLOOR_SWITCH].position >= 0.5:
            self.off_floor_since = None
        elif self.off_floor_since is None:
            self.off_floor_since = now

    def on_winch_estimate(self, sample: JointSample, now_ns: int) -> None:
        """Process the winch estimate."""
        self._received_at[topics.WINCH_ESTIMATE] = now_ns / _NANO
        payout, tension = sample.joints[machine.PAYOUT], sample.joints[machine.TENSION]
        weight = sample.joints[machine.TETHER_OUT].effort
        is_known = tension.position >= 0.5
        force = tension.effort if is_known else math.nan
        self.tether.on_estimate(payout.position, payout.velocity, force, weight)
        # In a turn the tether's attachment moves without odometric travel.
        is_in_turn = self.wheels.follower.rate < 0.0
        # During a jump the tether is slack, and the flight's displacement not known yet.
        if is_known and not is_in_turn and not self.wheels.is_jumping:
            measurement = TetherMeasurement(
                sample.joints[machine.STRETCHED].position, force, weight
            )
            self.odometry.on_tether(measurement, is_taut=self.tether.is_taut)

    def on_flown(self, sample: JointSample) -> None:
        """Process a measured jump; `dead_reckoning` leaves it out, as it never jumps."""
        joints = sample.joints
        self.odometry.on_flown(
            joints[machine.JUMP_AHEAD].position, joints[machine.JUMP_LEFT].position
        )

    @property
    def is_on_floor(self) -> bool:
        """Whether the contact switch reports the floor."""
        return topics.CONTACT in self._received_at and self.off_floor_since is None

    @property
    def idle_time(self) -> float:
        """Time since an encoder last moved [s]."""
        return 0.0 if self._angles is None else self._angles[2] - self._moved_at

    def waiting_for(self, now_ns: int) -> tuple[str, ...]:
        """Topics of stale inputs at a time [ns]."""
        now, p = now_ns / _NANO, self.parameters
        needed = [topics.IMU, topics.WHEEL_STATE, topics.CONTACT, topics.MOTOR_CURRENTS]
        if self.tether.parameters.uses_winch:
            needed.append(topics.WINCH_ESTIMATE)
        stale = tuple(
            name
            for name in needed
            if now - self._received_at.get(name, -math.inf) > p.sensor_timeout
        )
        if self.tether.parameters.uses_winch and not self.tether.mode:
            stale = (*stale, topics.WINCH_MODE)
        return stale


def _with_play(angle: float, measured: float) -> float:
    """A wheel's angle that follows the measured one with a play [rad]."""
    return min(max(angle, measured - _PLAY), measured + _PLAY)
