"""Drives from goal to goal: turns, straight ways and stops in turn, each until it is done. Pure.

Between two motions the rover stands: it comes to rest, the gyro tells its bias, and the next piece
is planned from where the rover is now. A motion ends at its amount by the odometry, in time, or by
what the watch finds; then the rover stops, says so, and does nothing more until it is asked.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from msg_schemas.parameters import parameter
from msg_schemas.samples import Level
from msg_schemas.transition import Transition
from rover_control.drive_odometry import DriveOdometry
from rover_control.drive_planner import DrivePlanner, Goal, Piece
from rover_control.drive_watch import DriveWatch

_CREEP = 0.15  # part of the full speed at which a motion ends
_AT_REST = 0.02  # rate below which a wheel rests [rad/s]


class DrivePhase(StrEnum):
    """What is being done; words of the contract."""

    RELEASED = "released"
    STANDING = "standing"
    TURNING = "turning"
    DRIVING = "driving"
    STEERED = "steered"
    STUCK = "stuck"
    FAILED = "failed"

    @property
    def is_over(self) -> bool:
        """Nothing is done any more."""
        return self in (DrivePhase.RELEASED, DrivePhase.STUCK, DrivePhase.FAILED)


@dataclass(frozen=True)
class FollowerParameters:
    """Speeds and time limits of the motions."""

    drive_speed: float = parameter(0.10, "m/s", "speed straight ahead", 0.005, 1.0)
    turn_rate: float = parameter(0.20, "rad/s", "yaw rate of a turn", 0.01, 3.0)
    wheel_acceleration: float = parameter(
        0.8, "rad/s^2", "acceleration limit of the driven wheel", 0.05, 20.0
    )
    command_delay: float = parameter(
        0.05, "s", "delay from a command to the wheel's rate", 0.0, 1.0
    )
    settle_time: float = parameter(
        0.5, "s", "time at rest before the gyro's bias is estimated", 0.0, 10.0
    )
    gyro_bias_tolerance: float = parameter(
        2.5e-5, "rad/s", "standard deviation of the gyro's bias at which the rover drives on",
        1e-6, 0.1,
    )  # fmt: skip
    max_stop_time: float = parameter(
        20.0, "s", "longest stop for the estimate of the gyro's bias", 0.1, 100.0
    )
    max_heading_drift: float = parameter(
        0.15, "rad", "heading change on a straight segment at which it is planned again", 0.01, 3.0
    )
    max_segments: int = parameter(40, "-", "most segments on the path to one goal", 1, 1000)
    motion_timeout_factor: float = parameter(
        3.0, "-", "time limit of a motion over its nominal time, plus 10 s", 1.0, 100.0
    )


class Sensed(NamedTuple):
    """What the follower hears in a step."""

    rates: tuple[float, float]  # of the wheels, left and right [rad/s]
    torque: float  # at the wheels, by the motor's current [N m]
    forward: float  # acceleration along base_link x, gravity taken off [m/s^2]
    still: float  # for so long no encoder has moved [s]


class DriveFollower:
    """Carries out goals.

    Args:
        parameters: speeds and patience.
        odometry: heard by somebody else, read here.
        planner: of the pieces.
        watch: of the motions.
    """

    def __init__(
        self,
        parameters: FollowerParameters,
        odometry: DriveOdometry,
        planner: DrivePlanner,
        watch: DriveWatch,
    ) -> None:
        self.parameters = parameters
        self.odometry = odometry
        self.planner = planner
        self.watch = watch
        self.phase = DrivePhase.RELEASED
        self.goals: deque[Goal] = deque()
        self.rate = 0.0  # commanded of the left wheel [rad/s]
        self._changes: list[Transition] = []
        self._piece: Piece | None = None
        self._steered = 0.0
        self._pieces = 0
        self._rested = 0.0  # all the wheels, nothing commanded [s]
        self._begin(DrivePhase.RELEASED, 0.0)

    # --- what is known ---------------------------------------------------------------------------

    @property
    def goal(self) -> Goal | None:
        """The present goal."""
        return self.goals[0] if self.goals else None

    @property
    def is_at_rest(self) -> bool:
        """Whether nothing drives the rover, and it has come to rest."""
        return self._rested >= self.parameters.settle_time

    def take_changes(self) -> list[Transition]:
        """Return what changed since the last call, and forget it."""
        taken, self._changes = self._changes, []
        return taken

    # --- asked from outside ----------------------------------------------------------------------

    def drive_to(self, goals: Sequence[Goal], now: float) -> None:
        """Drive to goals, one after the other; what was driven to before is forgotten."""
        self.goals = deque(goals)
        self._new_goal()
        self._begin(DrivePhase.STANDING, now)
        self._tell("drive_begun", f"{len(goals)} goals" if len(goals) > 1 else "a goal")

    def steer(self, rate: float, now: float) -> None:
        """Turn the motor's wheel at a rate [rad/s] until another is asked for."""
        self.goals.clear()
        if self.phase is not DrivePhase.STEERED or (rate < 0.0) != (self._steered < 0.0):
            self._begin(DrivePhase.STEERED, now)
        self._steered = rate

    def stop(self, reason: str, now: float) -> None:
        """Come to rest and forget all goals."""
        self._end(DrivePhase.RELEASED, "drive_stopped", reason, now)

    def fail(self, reason: str, now: float) -> None:
        """The same, because something does not go."""
        self._end(DrivePhase.FAILED, "drive_failed", reason, now, Level.WARN)

    def _end(
        self,
        phase: DrivePhase,
        name: str,
        reason: str,
        now: float,
        level: Level = Level.OK,
        **values: object,
    ) -> None:
        left = len(self.goals)
        self.goals.clear()
        self._begin(phase, now)
        pose = self.odometry.pose
        place = {"x": pose.x, "y": pose.y, "heading": pose.heading}
        self._tell(name, reason, level, goals_left=left, **place, **values)

    # --- stepped by time -------------------------------------------------------------------------

    def step(self, sensed: Sensed, now: float, h: float, *, may_move: bool = True) -> float:
        """Advance by h; returns the rate to command [rad/s].

        Args:
            sensed: what is heard.
            now: [s].
            h: since the last step [s].
            may_move: false: no motion is begun yet.
        """
        moves = max(map(abs, sensed.rates)) > _AT_REST or self.rate != 0.0
        self._rested = 0.0 if moves else min(self._rested + h, sensed.still)
        wanted = 0.0
        if self.phase is DrivePhase.STANDING:
            if may_move:
                self._stand(now)
        elif self.phase in (DrivePhase.TURNING, DrivePhase.DRIVING):
            wanted = self._move(sensed, now, h)
        elif self.phase is DrivePhase.STEERED and may_move:
            wanted = self._follow_steering(sensed, now, h)
        change = self.parameters.wheel_acceleration * h
        self.rate += min(max(wanted - self.rate, -change), change)
        return self.rate

    def _stand(self, now: float) -> None:
        p = self.parameters
        known = self.is_at_rest and self.odometry.bias_error <= p.gyro_bias_tolerance
        waited = now - self._since > p.settle_time + p.max_stop_time
        if not known and not (waited and self.rate == 0.0):
            return
        self._end_piece()
        goal = self.goal
        if goal is None:
            self._end(DrivePhase.RELEASED, "drive_done", "all goals are reached", now)
            return
        pose = self.odometry.pose
        if len(self.goals) > 1:  # of a path's poses the last one's heading counts alone
            goal = goal._replace(heading=math.nan)
        if self.planner.is_there(pose, goal):
            turn = self.planner.last_turn(pose, goal)
            if turn > 0.0:
                self._start(Piece(turn, 0.0, pose.heading + turn, True), now)
                return
            self.goals.popleft()
            self._tell(
                "goal_reached",
                f"{pose.distance(goal.x, goal.y):.3f} m from ({goal.x:.3f}, {goal.y:.3f}) m",
                x=pose.x, y=pose.y, heading=pose.heading, goals_left=len(self.goals),
            )  # fmt: skip
            self._new_goal()
            return
        if self._pieces >= p.max_segments:
            self.fail(f"the goal is not reached in {self._pieces} pieces", now)
            return
        piece = self.planner.next_piece(pose, goal)
        self._pieces += 1
        self._start(piece, now)

    def _new_goal(self) -> None:
        self._pieces = 0
        self.planner.begin()

    def _start(self, piece: Piece, now: float) -> None:
        self._piece = piece
        self._begin(DrivePhase.TURNING if piece.turn > 0.0 else DrivePhase.DRIVING, now)

    def _begin(self, phase: DrivePhase, now: float) -> None:
        self.phase = phase
        self._since = now
        self._rested = 0.0
        self._from = (self.odometry.turned, self.odometry.way)
        self._last = (self.odometry.turned, self.odometry.way)
        self.watch.begin()

    def _end_piece(self) -> None:
        """A straight way is over: what it bent by itself is learnt."""
        if self._driven is not None:
            turned, way = self._driven
            self.planner.learn(self.odometry.turned - turned, self.odometry.way - way)
        self._driven = None

    _driven: tuple[float, float] | None = None  # heading and way at the start of a straight way

    def _move(self, sensed: Sensed, now: float, h: float) -> float:
        piece = self._piece
        assert piece is not None
        p, odometry = self.parameters, self.odometry
        share = self.watch.speed_share(sensed.torque)
        turning = self.phase is DrivePhase.TURNING
        if turning:
            full, amount = p.turn_rate, piece.turn
            done = odometry.turned - self._from[0]
            moving = abs(odometry.yaw_rate)
            per_rate = odometry.kinematics.yaw_rate(-1.0)
        else:
            full, amount = p.drive_speed, piece.way
            done = odometry.way - self._from[1]
            moving = odometry.speed
            per_rate = odometry.kinematics.speed(1.0)
        left = amount - done - moving * p.command_delay
        if self._watched(sensed, now, h) or self._took_too_long(amount / full, now):
            return 0.0
        bent = not turning and abs(odometry.turned - self._from[0]) > p.max_heading_drift
        if left <= 0.0 or bent:
            self._finish(turning, now)
            return 0.0
        # The ramp down ends at a creep, not at rest, so that it ends at all.
        braking = math.sqrt(2.0 * p.wheel_acceleration * per_rate * left)
        speed = min(full * share, max(braking - 0.5 * _CREEP * full, _CREEP * full))
        rate = speed / per_rate
        return -rate if turning else rate

    def _finish(self, turning: bool, now: float) -> None:
        piece = self._piece
        assert piece is not None
        if turning and piece.way > 0.0:
            # From one motion to the other through rest: the ratchets take over there.
            self._piece = piece._replace(turn=0.0)
            self._begin(DrivePhase.DRIVING, now)
        else:
            if not turning:
                self._driven = self._from
            self._begin(DrivePhase.STANDING, now)

    def _took_too_long(self, usual: float, now: float) -> bool:
        limit = self.parameters.motion_timeout_factor * usual + 10.0
        if now - self._since <= limit:
            return False
        self.fail(f"{self.phase} takes longer than {limit:.3g} s", now)
        return True

    def _follow_steering(self, sensed: Sensed, now: float, h: float) -> float:
        return 0.0 if self._watched(sensed, now, h) else self._steered

    def _watched(self, sensed: Sensed, now: float, h: float) -> bool:
        """Whether the watch has ended the motion."""
        odometry, watch = self.odometry, self.watch
        rate = sensed.rates[0]
        reason = watch.common(self.rate, rate, sensed.torque, odometry.attitude.inclination, h)
        turned, way = odometry.turned - self._last[0], odometry.way - self._last[1]
        self._last = (odometry.turned, odometry.way)
        if not reason and self.rate < 0.0:
            reason = watch.turn(odometry.kinematics.yaw_rate(min(rate, 0.0)) * h, turned)
        elif not reason and self.rate > 0.0:
            reason = watch.straight(odometry.speed, sensed.forward, h)
            pose = odometry.pose
            distance = math.hypot(pose.x, pose.y, odometry.drop)
            outward = pose.x * math.cos(pose.heading) + pose.y * math.sin(pose.heading)
            expected = way * outward / distance if distance > 0.0 and odometry.drop > 0.0 else 0.0
            reason = reason or watch.tether(way, expected, odometry.tether_range)
        if reason:
            turning = int(self.rate < 0.0)
            self._end(DrivePhase.STUCK, "drive_stuck", reason, now, Level.WARN, turning=turning)
        return bool(reason)

    def _tell(self, name: str, reason: str, level: Level = Level.OK, **values: object) -> None:
        self._changes.append(Transition(name, reason, level, values))
