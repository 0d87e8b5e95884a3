"""Drive controller: supervision around the goal follower. Pure.

While the rover drives, what would refuse a request stops it: a sensor that is stale, the tether, a
missing floor, or another controller that uses the wheels. During a jump the wheels are held, and in
its flight they balance the rover.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from msg_schemas import topics
from msg_schemas.faults import DriveFault, Reason
from msg_schemas.phases import DrivePhase, JumpPhase
from msg_schemas.table import TOPICS
from rover_control.drive.drive_follower import DriveFollower, FollowerInput
from rover_control.drive.drive_odometry import DriveOdometry
from rover_control.drive.drive_planner import DrivePlanner
from rover_control.drive.drive_sensors import DriveSensors
from rover_control.drive.drive_settings import DriveSettings
from rover_control.drive.drive_tether import TetherControl, TetherRequest
from rover_control.drive.drive_watch import DriveWatch
from rover_control.drive.flight_balance import FlightBalance
from rover_control.drive.ratchet_kinematics import RatchetKinematics
from rover_control.drive.wheel_use import WheelUse

_NANO = 1e9
_MAX_STEP = 0.2  # upper bound of the controller's time step [s]
STEERING_TIMEOUT = TOPICS[topics.CMD_VEL].stale.timeout
"""Time after which a velocity command that is not renewed ends [s]."""


class WheelCommands(NamedTuple):
    """Commands of one step; None = no command."""

    wheel_rate: float | None = None  # rate of the left wheel [rad/s]
    winch: TetherRequest | None = None


class DriveController:
    """Steps the goal follower under supervision, and balances the rover in a jump.

    Args:
        settings: all parameters.

    Attributes:
        odometry: estimate of the pose in map.
        follower: of the goals.
        wheels: what they are used for.
        tether: requests to the winch.
        sensors: that update the odometry.
        balance: of the rover in a jump's flight.
        steered_at: time of the last twist [s].
    """

    def __init__(self, settings: DriveSettings) -> None:
        self.settings = settings
        self.kinematics = RatchetKinematics(settings.chassis)
        self.odometry = DriveOdometry(self.kinematics, settings.odometry)
        self.follower = DriveFollower(
            settings.follower,
            self.odometry,
            DrivePlanner(self.kinematics, settings.planner),
            DriveWatch(settings.watch),
        )
        self.wheels = WheelUse(self.follower)
        self.tether = TetherControl(settings.tether)
        self.sensors = DriveSensors(settings.drive, self.odometry, self.tether, self.wheels)
        self.balance = FlightBalance(settings.balance)
        self._stale_steps = 0
        self.steered_at = -math.inf
        self._stepped: float | None = None

    @property
    def distance(self) -> float:
        """Distance left to the last goal [m]; NaN without goals."""
        pose, left = self.odometry.pose, 0.0
        x, y = pose.x, pose.y
        for goal in self.follower.goals:
            left += math.hypot(goal.x - x, goal.y - y)
            x, y = goal.x, goal.y
        return left if self.follower.goals else math.nan

    def on_jump(self, phase: str) -> None:
        """Process the jump phase."""
        if phase == JumpPhase.RELEASING:
            self.odometry.on_release()
        self.wheels.jump = phase

    def continue_from(self, other: DriveController) -> None:
        """Take over the poses of another controller."""
        self.odometry.continue_from(other.odometry)
        self.sensors.dead_reckoning.continue_from(other.sensors.dead_reckoning)

    def step(self, now_ns: int) -> WheelCommands:
        """Advance to a time [ns] and return the commands."""
        now = now_ns / _NANO
        h = 0.0 if self._stepped is None else min(max(now - self._stepped, 0.0), _MAX_STEP)
        self._stepped = now
        follower, wheels = self.follower, self.wheels
        if wheels.is_driving:
            self._supervise(now_ns)
        request = self.tether.step(now, h, is_driving=wheels.is_driving)
        before = follower.rate
        sensors = self.sensors
        inputs = FollowerInput(sensors.rates, sensors.torque, sensors.forward, sensors.idle_time)
        is_handed_over = wheels.motors.may_command(now)
        rate = follower.step(inputs, now, h, may_move=self.tether.is_ready and is_handed_over)
        if follower.unconfirmed > 0.0:
            self.odometry.doubt(follower.unconfirmed)
            sensors.dead_reckoning.doubt(follower.unconfirmed)
        commanded = (wheels.is_driving and is_handed_over) or before != 0.0 or rate != 0.0
        if wheels.is_balancing and is_handed_over and not commanded:
            return WheelCommands(self._balancing_rate(), request)
        return WheelCommands(rate if commanded else None, request)

    def _balancing_rate(self) -> float:
        """Wheel rate during a jump [rad/s]."""
        sensors, jump = self.sensors, self.wheels.jump
        pitch = self.odometry.attitude.pitch
        if jump == JumpPhase.SETTLING:
            self.balance.stance = pitch
        if jump != JumpPhase.FLIGHT or sensors.is_on_floor:
            return 0.0
        return self.balance.wheel_rate(pitch, sensors.pitch_rate, sensors.rates[0])

    def _supervise(self, now_ns: int) -> None:
        now = now_ns / _NANO
        stale = self.sensors.waiting_for(now_ns)
        off_floor_since = self.sensors.off_floor_since
        # Count steps, not time: after a late step the samples of the meantime are still queued.
        self._stale_steps = self._stale_steps + 1 if stale else 0
        reason = self.tether.fault_reason(now) or self.wheels.conflict()
        if self._stale_steps >= self.settings.drive.sensor_timeout_steps:
            reason = f"{', '.join(stale)} missing or stale"
        elif (
            off_floor_since is not None
            and now - off_floor_since > self.settings.drive.floor_contact_timeout
        ):
            reason = "the contact switch reports no floor"
        if reason:
            self.follower.fail(reason, DriveFault.INPUT_LOST, now)
        elif self.wheels.phase is DrivePhase.STEERED and now - self.steered_at > STEERING_TIMEOUT:
            text = f"no {topics.CMD_VEL} for {STEERING_TIMEOUT:g} s"
            self.follower.stop(text, Reason.RENEWAL_TIMEOUT, now)

    def halt(self) -> WheelCommands:
        """Last commands before the control steps end."""
        if not self.wheels.is_driving:
            return WheelCommands()
        self.follower.stop("the node is shutting down", Reason.SHUTDOWN, self._stepped or 0.0)
        self.follower.rate = 0.0
        return WheelCommands(0.0, self.tether.step(math.inf, 0.0, is_driving=False))
