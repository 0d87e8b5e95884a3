"""Drive controller: requests, interlocks and supervision around the goal follower. Pure.

A request is refused with the reason if the mechanism cannot do it, the tether does not reach the
goal, the rover hangs, jumps or is under descent control, the winch is not armed, or a sensor is
stale. While the rover drives, the same conditions stop it. During a jump the wheels are held, and
in its flight they balance the rover.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from msg_schemas import topics
from msg_schemas.events import EventReport
from msg_schemas.faults import DriveFault, Reason
from msg_schemas.machine import (
    FLOOR_SWITCH,
    JUMP_AHEAD,
    JUMP_LEFT,
    PAYOUT,
    STRETCHED,
    TENSION,
    TETHER_OUT,
    WHEEL_LEFT,
    WHEEL_MOTOR,
    WHEEL_RIGHT,
)
from msg_schemas.parameters import parameter
from msg_schemas.phases import DescentPhase, DrivePhase, JumpPhase
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import (
    ImuSample,
    JointSample,
    PathSample,
    PoseEstimateSample,
    PoseSample,
    TwistSample,
)
from msg_schemas.table import TOPICS
from rover_control.coordination.motor_handover import MotorHandover
from rover_control.drive.drive_attitude import ROLLOVER_TILT
from rover_control.drive.drive_follower import DriveFollower, FollowerInput, FollowerParameters
from rover_control.drive.drive_odometry import (
    DeadReckoning,
    DriveOdometry,
    OdometryParameters,
    TetherMeasurement,
)
from rover_control.drive.drive_planner import DriveGoal, DrivePlanner, PlannerParameters
from rover_control.drive.drive_tether import TetherControl, TetherParameters, TetherRequest
from rover_control.drive.drive_watch import DriveWatch, WatchParameters
from rover_control.drive.flight_balance import FlightBalance, FlightBalanceParameters
from rover_control.drive.ratchet_kinematics import ChassisParameters, GroundPose, RatchetKinematics

_NANO = 1e9
_FREE_FALL = 0.3  # specific force over gravity below which the rover flies [-]
_AXES = 6  # of a pose's covariance
_MAX_STEP = 0.2  # upper bound of the controller's time step [s]
_ENCODER_NOISE = 1.5e-3  # wheel angle beyond the encoder's noise [rad]
_JUMPING = frozenset(phase for phase in JumpPhase if phase.uses_motor)
_HELD = _JUMPING - {JumpPhase.LETTING_DOWN}  # phases in which the rover stands or flies
STEERING_TIMEOUT = TOPICS[topics.CMD_VEL].stale.timeout
"""Time after which a velocity command that is not renewed ends [s]."""


@dataclass(frozen=True)
class DriveParameters:
    """Motor, gravity and supervision of the sensors."""

    torque_per_ampere: float = parameter(
        0.96, "N m/A", "wheel torque per ampere of motor current, gear included", 1e-3, 1e3
    )
    drive_gravity: float = parameter(1.62, "m/s^2", "gravity where the rover drives", 0.01, 100.0)
    sensor_timeout: float = parameter(
        0.5, "s", "age of the last sample at which a sensor is stale", 0.02, 60.0
    )
    sensor_timeout_steps: int = parameter(
        25, "-", "consecutive control steps with a stale sensor before the rover stops", 1, 10000
    )
    rollover_tilt: float = parameter(
        ROLLOVER_TILT, "rad", "tilt above which the rover counts as rolled over", 0.1, 3.2
    )
    floor_contact_timeout: float = parameter(
        1.0, "s", "time without floor contact after which the rover stops", 0.0, 60.0
    )


@dataclass(frozen=True)
class DriveSettings:
    """All parameters of the drive controller."""

    drive: DriveParameters = field(default_factory=DriveParameters)
    chassis: ChassisParameters = field(default_factory=ChassisParameters)
    odometry: OdometryParameters = field(default_factory=OdometryParameters)
    planner: PlannerParameters = field(default_factory=PlannerParameters)
    follower: FollowerParameters = field(default_factory=FollowerParameters)
    watch: WatchParameters = field(default_factory=WatchParameters)
    tether: TetherParameters = field(default_factory=TetherParameters)
    balance: FlightBalanceParameters = field(default_factory=FlightBalanceParameters)


class WheelCommands(NamedTuple):
    """Commands of one step; None = no command."""

    wheel_rate: float | None = None  # rate of the left wheel [rad/s]
    winch: TetherRequest | None = None


class DriveController:
    """Drive controller with supervision.

    Args:
        settings: all parameters.
    """

    def __init__(self, settings: DriveSettings) -> None:
        self.settings = settings
        self.kinematics = RatchetKinematics(settings.chassis)
        self.odometry = DriveOdometry(self.kinematics, settings.odometry)
        self.dead_reckoning = DeadReckoning(self.odometry)
        self.follower = DriveFollower(
            settings.follower,
            self.odometry,
            DrivePlanner(self.kinematics, settings.planner),
            DriveWatch(settings.watch),
        )
        self.tether = TetherControl(settings.tether)
        self.balance = FlightBalance(settings.balance)
        self.torque = 0.0  # wheel torque, low-pass filtered [N m]
        self._rates = (0.0, 0.0)
        self._angles: tuple[float, float, float] | None = None  # left, right [rad], time [s]
        self._last_motion = (0.0, 0.0, 0.0)  # wheel angles at the last motion [rad], its time [s]
        self._pitch_rate = 0.0  # [rad/s]
        self._forward = 0.0  # acceleration along base_link x without gravity [m/s^2]
        self._received_at: dict[str, float] = {}
        self._stale_steps = 0
        self._off_floor: float | None = None
        self._steered_at = -math.inf
        self._stepped: float | None = None
        self._jump = self._descent = ""
        self._wheels = MotorHandover()

    # --- state -----------------------------------------------------------------------------------

    @property
    def phase(self) -> DrivePhase:
        """Present phase."""
        return DrivePhase.BALANCING if self.is_balancing else self.follower.phase

    @property
    def distance(self) -> float:
        """Distance left to the last goal [m]; NaN without goals."""
        pose, left = self.odometry.pose, 0.0
        x, y = pose.x, pose.y
        for goal in self.follower.goals:
            left += math.hypot(goal.x - x, goal.y - y)
            x, y = goal.x, goal.y
        return left if self.follower.goals else math.nan

    @property
    def is_busy(self) -> bool:
        """Whether the rover is driving."""
        return not self.follower.phase.is_over

    @property
    def is_balancing(self) -> bool:
        """Whether the wheels are held during a jump, and balance the rover in its flight."""
        is_free = not self._wheels.is_used_by(topics.DESCENT_PHASE)
        return self._jump in _HELD and is_free and not self.is_busy and self.follower.rate == 0.0

    @property
    def uses_wheels(self) -> bool:
        """Whether the wheels are commanded: after a stop, until they are at rest."""
        return self.is_busy or self.follower.rate != 0.0

    @property
    def is_on_floor(self) -> bool:
        """Whether the contact switch reports the floor."""
        return topics.CONTACT in self._received_at and self._off_floor is None

    def waiting_for(self, now_ns: int) -> tuple[str, ...]:
        """Topics of stale inputs at a time [ns]."""
        now, p = now_ns / _NANO, self.settings.drive
        needed = [topics.IMU, topics.WHEEL_STATE, topics.CONTACT, topics.MOTOR_CURRENTS]
        if self.settings.tether.uses_winch:
            needed.append(topics.WINCH_ESTIMATE)
        stale = tuple(
            name
            for name in needed
            if now - self._received_at.get(name, -math.inf) > p.sensor_timeout
        )
        if self.settings.tether.uses_winch and not self.tether.mode:
            stale = (*stale, topics.WINCH_MODE)
        return stale

    def take_changes(self) -> list[EventReport]:
        """Return the transitions since the last call and clear them."""
        return self.follower.take_changes()

    # --- inputs ----------------------------------------------------------------------------------

    def on_imu(self, sample: ImuSample, now_ns: int) -> None:
        """Process an IMU sample."""
        self._received_at[topics.IMU] = now_ns / _NANO
        odometry, gravity = self.odometry, self.settings.drive.drive_gravity
        at_rest = self.follower.is_at_rest and self.is_on_floor
        flies = math.hypot(*sample.linear_acceleration) < _FREE_FALL * gravity
        for each in (odometry, self.dead_reckoning):
            each.on_gyro(
                sample.angular_velocity,
                sample.linear_acceleration,
                (sample.stamp_ns or now_ns) / _NANO,
                at_rest=at_rest,
                flies=flies,
            )
        self._forward = sample.linear_acceleration[0] - gravity * odometry.attitude.up[0]
        self._pitch_rate = sample.angular_velocity[1]

    def on_wheels(self, sample: JointSample, now_ns: int) -> None:
        """Process angles and rates of the wheels."""
        self._received_at[topics.WHEEL_STATE] = now_ns / _NANO
        left, right = sample.joints[WHEEL_LEFT], sample.joints[WHEEL_RIGHT]
        self._rates = (left.velocity, right.velocity)
        now = (sample.stamp_ns or now_ns) / _NANO
        before, self._angles = self._angles, (left.position, right.position, now)
        moved = max(
            abs(left.position - self._last_motion[0]), abs(right.position - self._last_motion[1])
        )
        if moved > _ENCODER_NOISE:
            self._last_motion = (left.position, right.position, now)
        # During a jump the wheels slip where they touch the ground.
        follows = self.is_on_floor and not self.is_balancing
        if before is not None and now > before[2] and follows:
            for each in (self.odometry, self.dead_reckoning):
                each.on_wheels(
                    left.position - before[0],
                    right.position - before[1],
                    now - before[2],
                    self.torque,
                )

    def on_currents(self, sample: JointSample, now_ns: int) -> None:
        """Process the motor currents; the wheel motor's gives the wheel torque."""
        self._received_at[topics.MOTOR_CURRENTS] = now_ns / _NANO
        current = sample.joints[WHEEL_MOTOR].effort
        self.torque += 0.1 * (current * self.settings.drive.torque_per_ampere - self.torque)

    def on_contact(self, sample: JointSample, now_ns: int) -> None:
        """Process the contact switches; only the floor's is used."""
        now = self._received_at[topics.CONTACT] = now_ns / _NANO
        if sample.joints[FLOOR_SWITCH].position >= 0.5:
            self._off_floor = None
        elif self._off_floor is None:
            self._off_floor = now

    def on_winch_mode(self, mode: str) -> None:
        """Process the winch mode."""
        self.tether.on_mode(mode)

    def on_winch_estimate(self, sample: JointSample, now_ns: int) -> None:
        """Process the winch estimate."""
        self._received_at[topics.WINCH_ESTIMATE] = now_ns / _NANO
        payout, tension = sample.joints[PAYOUT], sample.joints[TENSION]
        weight = sample.joints[TETHER_OUT].effort
        is_known = tension.position >= 0.5
        force = tension.effort if is_known else math.nan
        self.tether.on_estimate(payout.position, payout.velocity, force, weight)
        # During a jump the tether is slack, and the flight's displacement not known yet.
        if is_known and not self.is_in_turn and self._jump not in _JUMPING:
            measurement = TetherMeasurement(sample.joints[STRETCHED].position, force, weight)
            self.odometry.on_tether(measurement, is_taut=self.tether.is_taut)

    @property
    def is_in_turn(self) -> bool:
        """Whether the rover turns: the tether attachment then moves without odometric travel."""
        return self.follower.rate < 0.0

    def on_jump(self, phase: str) -> None:
        """Process the jump phase."""
        if phase == JumpPhase.RELEASING:
            self.odometry.on_release()
        self._jump = phase

    def on_flown(self, sample: JointSample) -> None:
        """Process a measured jump; `dead_reckoning` leaves it out, as it never jumps."""
        joints = sample.joints
        self.odometry.on_flown(joints[JUMP_AHEAD].position, joints[JUMP_LEFT].position)

    def on_descent(self, phase: str, now_ns: int) -> None:
        """Process the descent phase: the descent uses the same wheels and winch."""
        self._descent = phase
        self._wheels.on_phase(topics.DESCENT_PHASE, phase, now_ns / _NANO)

    # --- requests --------------------------------------------------------------------------------

    def continue_from(self, other: DriveController) -> None:
        """Take over the poses of another controller."""
        self.odometry.continue_from(other.odometry)
        self.dead_reckoning.continue_from(other.dead_reckoning)

    def set_pose(self, sample: PoseEstimateSample) -> None:
        """Set the pose of the rover in map.

        Raises:
            Refusal: the rover is driving.
        """
        if self.is_busy:
            raise Refusal(
                topics.DRIVE_START,
                RefusalCode.WRONG_PHASE,
                f"the rover is driving ({self.phase}); call {topics.DRIVE_STOP} first",
            )
        goal = goal_of(sample)
        heading = goal.heading if goal.has_heading else 0.0
        variances = sample.pose_covariance[:: _AXES + 1]
        errors = None
        if variances:
            errors = math.sqrt(variances[0]), math.sqrt(variances[1]), math.sqrt(variances[5])
        self.odometry.set_pose(
            GroundPose(goal.x, goal.y, heading), knows_heading=goal.has_heading, errors=errors
        )

    def request(self, sample: PoseSample, now_ns: int) -> None:
        """Drive to a pose.

        Raises:
            Refusal: the pose is out of reach, or the rover is not ready.
        """
        self._drive_to(topics.DRIVE_GOAL, (goal_of(sample),), now_ns)

    def request_path(self, sample: PathSample, now_ns: int) -> None:
        """Drive through poses.

        Raises:
            Refusal: the path is empty, a pose is out of reach, or the rover is not ready.
        """
        if not sample.poses:
            raise Refusal(
                topics.DRIVE_PATH,
                RefusalCode.WRONG_LENGTH,
                "the path has no poses; send at least one",
            )
        self._drive_to(topics.DRIVE_PATH, tuple(map(goal_of, sample.poses)), now_ns)

    def _drive_to(self, subject: str, goals: tuple[DriveGoal, ...], now_ns: int) -> None:
        self._check_ready(subject, now_ns)
        for goal in goals:
            self._check_reach(subject, goal)
        self.follower.drive_to(goals, now_ns / _NANO)

    def steer(self, sample: TwistSample, now_ns: int) -> None:
        """Drive at a twist of base_link until the twist times out.

        Raises:
            Refusal: the mechanism cannot, a limit is exceeded, or the rover is not ready.
        """
        forward, turn = sample.linear[0], sample.angular[2]
        rate = self.kinematics.wheel_rate(forward, turn)
        p = self.settings.follower
        for name, value, limit, unit in (
            ("linear.x", forward if turn == 0.0 else 0.0, p.drive_speed, "m/s"),
            ("angular.z", turn, p.turn_rate, "rad/s"),
        ):
            if value > limit * (1.0 + 1e-9):
                raise Refusal(
                    topics.CMD_VEL,
                    RefusalCode.OUT_OF_LIMITS,
                    f"{name} is {value:g} {unit}, limit {limit:g} {unit}",
                )
        if rate == 0.0:
            if self.phase is DrivePhase.STEERED:
                self._steered_at = now_ns / _NANO
                self.follower.steer(0.0, self._steered_at)
            elif self.is_busy:
                self.follower.stop("zero twist received", Reason.REQUESTED, now_ns / _NANO)
            return
        if self.phase is not DrivePhase.STEERED:
            self._check_ready(topics.CMD_VEL, now_ns)
        self._steered_at = now_ns / _NANO
        self.follower.steer(rate, self._steered_at)

    def stop(self, now_ns: int) -> str:
        """Stop and discard all goals; always accepted."""
        if self.is_busy:
            self.follower.stop("stop requested", Reason.REQUESTED, now_ns / _NANO)
        else:
            self.follower.phase = DrivePhase.RELEASED
        return "drive_node has released wheels and winch"

    def _check_reach(self, subject: str, goal: DriveGoal) -> None:
        distance, max_length = math.hypot(goal.x, goal.y), self.settings.tether.max_tether_length
        drop = self.odometry.drop
        reach = math.sqrt(max(max_length**2 - drop**2, 0.0))
        if distance > reach:
            raise Refusal(
                subject,
                RefusalCode.OUT_OF_LIMITS,
                f"({goal.x:g}, {goal.y:g}) m is {distance:.4g} m from the plumb line; the tether "
                f"of {max_length:g} m reaches {reach:.4g} m",
            )

    def _check_ready(self, subject: str, now_ns: int) -> None:
        stale = self.waiting_for(now_ns)
        if stale:
            raise Refusal(subject, RefusalCode.STALE, f"{', '.join(stale)} missing or stale")
        if self._off_floor is not None:
            raise Refusal(
                subject,
                RefusalCode.WRONG_PHASE,
                "the contact switch reports no floor; the rover must stand on the floor to drive",
            )
        tilt, limit_tilt = self.odometry.attitude.inclination, self.settings.drive.rollover_tilt
        if tilt > limit_tilt:
            raise Refusal(
                subject,
                RefusalCode.WRONG_PHASE,
                f"the rover has rolled over: tilt {math.degrees(tilt):.3g} deg, limit "
                f"{math.degrees(limit_tilt):.3g} deg; set it upright first",
            )
        conflict = self._conflict()
        if conflict:
            raise Refusal(subject, RefusalCode.WRONG_PHASE, conflict)
        not_ready_reason = self.tether.not_ready_reason()
        if not_ready_reason:
            raise Refusal(subject, RefusalCode.NOT_ARMED, not_ready_reason)

    def _conflict(self) -> str:
        """Which other controller uses the actuators; empty = none."""
        if self._jump in _JUMPING:
            return f"the rover is jumping ({self._jump})"
        if self._descent not in ("", DescentPhase.RELEASED):
            return (
                f"the descent controller holds wheels and winch (phase {self._descent}); call "
                f"{topics.DESCENT_RELEASE} first"
            )
        return ""

    # --- control step ----------------------------------------------------------------------------

    def step(self, now_ns: int) -> WheelCommands:
        """Advance to a time [ns] and return the commands."""
        now = now_ns / _NANO
        h = 0.0 if self._stepped is None else min(max(now - self._stepped, 0.0), _MAX_STEP)
        self._stepped = now
        if self.is_busy:
            self._supervise(now_ns)
        request = self.tether.step(now, h, is_driving=self.is_busy)
        follower = self.follower
        before = follower.rate
        idle_time = 0.0 if self._angles is None else self._angles[2] - self._last_motion[2]
        inputs = FollowerInput(self._rates, self.torque, self._forward, idle_time)
        is_handed_over = self._wheels.may_command(now)
        rate = follower.step(inputs, now, h, may_move=self.tether.is_ready and is_handed_over)
        commanded = (self.is_busy and is_handed_over) or before != 0.0 or rate != 0.0
        if self.is_balancing and is_handed_over and not commanded:
            return WheelCommands(self._balancing_rate(), request)
        return WheelCommands(rate if commanded else None, request)

    def _balancing_rate(self) -> float:
        """Wheel rate during a jump [rad/s]."""
        pitch = self.odometry.attitude.pitch
        if self._jump == JumpPhase.SETTLING:
            self.balance.stance = pitch
        if self._jump != JumpPhase.FLIGHT or self.is_on_floor:
            return 0.0
        return self.balance.wheel_rate(pitch, self._pitch_rate, self._rates[0])

    def _supervise(self, now_ns: int) -> None:
        now = now_ns / _NANO
        stale = self.waiting_for(now_ns)
        # Count steps, not time: after a late step the samples of the meantime are still queued.
        self._stale_steps = self._stale_steps + 1 if stale else 0
        reason = self.tether.fault_reason(now) or self._conflict()
        if self._stale_steps >= self.settings.drive.sensor_timeout_steps:
            reason = f"{', '.join(stale)} missing or stale"
        elif (
            self._off_floor is not None
            and now - self._off_floor > self.settings.drive.floor_contact_timeout
        ):
            reason = "the contact switch reports no floor"
        if reason:
            self.follower.fail(reason, DriveFault.INPUT_LOST, now)
        elif self.phase is DrivePhase.STEERED and now - self._steered_at > STEERING_TIMEOUT:
            text = f"no {topics.CMD_VEL} for {STEERING_TIMEOUT:g} s"
            self.follower.stop(text, Reason.RENEWAL_TIMEOUT, now)

    def halt(self) -> WheelCommands:
        """Last commands before the control steps end."""
        if not self.is_busy:
            return WheelCommands()
        self.follower.stop("the node is shutting down", Reason.SHUTDOWN, self._stepped or 0.0)
        self.follower.rate = 0.0
        return WheelCommands(0.0, self.tether.step(math.inf, 0.0, is_driving=False))


def goal_of(sample: PoseSample | PoseEstimateSample) -> DriveGoal:
    """Goal on the ground; an all-zero orientation leaves the heading open."""
    x, y, z, w = sample.orientation
    heading = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    is_open = not any(sample.orientation)
    return DriveGoal(sample.position[0], sample.position[1], math.nan if is_open else heading)
