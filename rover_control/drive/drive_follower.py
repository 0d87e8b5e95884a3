"""Goal follower: executes turns, straight segments and stops until each goal is reached. Pure.

Between two motions the rover stops, the gyro's bias is estimated at rest, and the next segment is
planned from the estimated pose. A motion ends when the odometry reports its angle or length, or
when the motion watch finds that the rover is stuck; then it stops and waits for the next request.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas.events import DriveEvent, EventReport
from msg_schemas.faults import DriveFault, Reason
from msg_schemas.parameters import parameter
from msg_schemas.phases import DrivePhase
from rover_control.drive.drive_odometry import DriveOdometry
from rover_control.drive.drive_planner import DriveGoal, DrivePlanner, Segment
from rover_control.drive.drive_watch import DriveWatch

_CREEP = 0.15  # fraction of the full speed at which a motion ends
_AT_REST = 0.02  # wheel rate below which a wheel is at rest [rad/s]


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
    bias_heading_error: float = parameter(
        0.001, "rad", "heading error of a motion from the gyro's bias at which the rover drives on",
        1e-5, 1.0,
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


class FollowerInput(NamedTuple):
    """Measurements of one control step."""

    rates: tuple[float, float]  # left and right wheel [rad/s]
    torque: float  # wheel torque from the motor current [N m]
    forward: float  # acceleration along base_link x without gravity [m/s^2]
    idle_time: float  # time since an encoder last moved [s]


class DriveFollower:
    """Follows goals one after the other.

    Args:
        parameters: speeds and time limits.
        odometry: pose estimate, updated by the caller.
        planner: of the segments.
        watch: motion watch.
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
        self.goals: deque[DriveGoal] = deque()
        self.rate = 0.0  # commanded rate of the left wheel [rad/s]
        self.unconfirmed = 0.0  # travel that the end of a motion in this step leaves in doubt [m]
        self._changes: list[EventReport] = []
        self._segment: Segment | None = None
        self._segment_start: tuple[float, float] | None = None  # heading [rad] and travel [m]
        self._steered = 0.0
        self._segments = 0
        self._rested = 0.0  # time since all wheels are at rest without command [s]
        self._begin(DrivePhase.RELEASED, 0.0)

    # --- state -----------------------------------------------------------------------------------

    @property
    def goal(self) -> DriveGoal | None:
        """The present goal."""
        return self.goals[0] if self.goals else None

    @property
    def is_at_rest(self) -> bool:
        """Whether the rover has come to rest without command."""
        return self._rested >= self.parameters.settle_time

    def take_changes(self) -> list[EventReport]:
        """Return the transitions since the last call and clear them."""
        transitions, self._changes = self._changes, []
        return transitions

    # --- requests --------------------------------------------------------------------------------

    def drive_to(self, goals: Sequence[DriveGoal], now: float) -> None:
        """Drive to goals in order; discards earlier goals."""
        self.goals = deque(goals)
        self._segments = 0
        self._segment_start = None
        self._begin(DrivePhase.STANDING, now)
        text = f"{len(goals)} goals" if len(goals) > 1 else "1 goal"
        self._emit(DriveEvent.STARTED, text, goals=len(goals))

    def steer(self, rate: float, now: float) -> None:
        """Set the rate of the driven wheel [rad/s]."""
        self.goals.clear()
        if self.phase is not DrivePhase.STEERED or (rate < 0.0) != (self._steered < 0.0):
            self._begin(DrivePhase.STEERED, now)
        self._steered = rate

    def stop(self, text: str, reason: Reason, now: float) -> None:
        """Stop and discard all goals."""
        self._end(DrivePhase.RELEASED, DriveEvent.STOPPED, text, reason, now)

    def fail(self, text: str, fault: DriveFault, now: float) -> None:
        """Stop and discard all goals because of a failure."""
        self._end(DrivePhase.FAILED, DriveEvent.FAILED, text, Reason.FAULT, now, fault=fault.value)

    def _end(
        self,
        phase: DrivePhase,
        name: DriveEvent,
        text: str,
        reason: Reason,
        now: float,
        **values: object,
    ) -> None:
        remaining = len(self.goals)
        self.goals.clear()
        self._begin(phase, now)
        pose = self.odometry.pose
        place = {"x": pose.x, "y": pose.y, "heading": pose.heading}
        self._emit(name, text, reason, goals_left=remaining, **place, **values)

    # --- control step ----------------------------------------------------------------------------

    def step(self, inputs: FollowerInput, now: float, h: float, *, may_move: bool = True) -> float:
        """Advance by h; returns the commanded rate of the left wheel [rad/s].

        Args:
            inputs: measurements.
            now: time [s].
            h: time since the last step [s].
            may_move: False delays the start of a motion.
        """
        self.unconfirmed = 0.0
        moves = max(map(abs, inputs.rates)) > _AT_REST or self.rate != 0.0
        self._rested = 0.0 if moves else min(self._rested + h, inputs.idle_time)
        setpoint = 0.0
        if self.phase is DrivePhase.STANDING:
            if may_move:
                self._step_standing(now)
        elif self.phase in (DrivePhase.TURNING, DrivePhase.DRIVING):
            setpoint = self._step_motion(inputs, now, h)
        elif self.phase is DrivePhase.STEERED and may_move:
            setpoint = self._follow_steering(inputs, now, h)
        change = self.parameters.wheel_acceleration * h
        self.rate += min(max(setpoint - self.rate, -change), change)
        return self.rate

    def _step_standing(self, now: float) -> None:
        p = self.parameters
        waited = now - self._since > p.settle_time + p.max_stop_time
        if not (waited and self.rate == 0.0) and not self._knows_bias():
            return
        self._end_segment()
        goal = self.goal
        if goal is None:
            text = "all goals reached"
            self._end(DrivePhase.RELEASED, DriveEvent.COMPLETED, text, Reason.COMPLETED, now)
            return
        pose, segment = self.odometry.pose, self._next_segment(goal)
        if segment is None:
            self.goals.popleft()
            self._emit(
                DriveEvent.GOAL_REACHED,
                f"{pose.distance(goal.x, goal.y):.3f} m from ({goal.x:.3f}, {goal.y:.3f}) m",
                x=pose.x, y=pose.y, heading=pose.heading, goals_left=len(self.goals),
            )  # fmt: skip
            self._segments = 0
            return
        if segment.length > 0.0:
            if self._segments >= p.max_segments:
                text = f"goal not reached within {self._segments} segments, the limit"
                self.fail(text, DriveFault.UNREACHABLE, now)
                return
            self._segments += 1
        self._start(segment, now)

    def _knows_bias(self) -> bool:
        """Whether the gyro's bias is known well enough, at rest, for the next motion."""
        if not self.is_at_rest:
            return False
        segment = self._next_segment(self.goal) if self.goal else None
        if segment is None:
            return True
        p = self.parameters
        duration = segment.turn / p.turn_rate + segment.length / p.drive_speed
        return self.odometry.bias_error * duration <= p.bias_heading_error

    def _next_segment(self, goal: DriveGoal) -> Segment | None:
        """Plan the next motion to a goal; None: the goal is reached."""
        pose = self.odometry.pose
        if len(self.goals) > 1:  # on a path only the last heading counts
            goal = goal._replace(heading=math.nan)
        if not self.planner.is_at_goal(pose, goal):
            return self.planner.next_segment(pose, goal, is_first=self._segments == 0)
        turn = self.planner.last_turn(pose, goal)
        return Segment(turn, 0.0) if turn > 0.0 else None

    def _start(self, segment: Segment, now: float) -> None:
        self._segment = segment
        self._begin(DrivePhase.TURNING if segment.turn > 0.0 else DrivePhase.DRIVING, now)

    def _begin(self, phase: DrivePhase, now: float) -> None:
        self.phase = phase
        self._since = now
        self._rested = 0.0
        self._from = (self.odometry.turned, self.odometry.travelled)
        self._last = (self.odometry.turned, self.odometry.travelled)
        self.watch.begin()

    def _end_segment(self) -> None:
        """Update the planner's curvature estimate with the straight segment just driven."""
        if self._segment_start is not None:
            turned, travel = self._segment_start
            self.planner.update_curvature(
                self.odometry.turned - turned, self.odometry.travelled - travel
            )
        self._segment_start = None

    def _step_motion(self, inputs: FollowerInput, now: float, h: float) -> float:
        segment = self._segment
        assert segment is not None
        p, odometry = self.parameters, self.odometry
        fraction = self.watch.speed_fraction(inputs.torque)
        turning = self.phase is DrivePhase.TURNING
        if turning:
            full, amount = p.turn_rate, segment.turn
            travelled = odometry.turned - self._from[0]
            moving = abs(odometry.yaw_rate)
            per_rate = odometry.kinematics.yaw_rate(-1.0)
        else:
            full, amount = p.drive_speed, segment.length
            travelled = odometry.travelled - self._from[1]
            moving = odometry.speed
            per_rate = odometry.kinematics.speed(1.0)
        remaining = amount - travelled - moving * p.command_delay
        limit = p.motion_timeout_factor * amount / full + 10.0
        if self._check_motion(inputs, now, h, limit):
            return 0.0
        bent = not turning and abs(odometry.turned - self._from[0]) > p.max_heading_drift
        if remaining <= 0.0 or bent:
            self._finish(turning, now)
            return 0.0
        # The ramp ends at creep speed, not at zero, so that the motion ends in finite time.
        braking = math.sqrt(2.0 * p.wheel_acceleration * per_rate * remaining)
        speed = min(full * fraction, max(braking - 0.5 * _CREEP * full, _CREEP * full))
        rate = speed / per_rate
        return -rate if turning else rate

    def _finish(self, turning: bool, now: float) -> None:
        segment = self._segment
        assert segment is not None
        if turning and segment.length > 0.0:
            # The wheels stop between two motions: the ratchets change over at rest.
            self._segment = segment._replace(turn=0.0)
            self._begin(DrivePhase.DRIVING, now)
        else:
            if not turning:
                self._segment_start = self._from
            self._begin(DrivePhase.STANDING, now)

    def _follow_steering(self, inputs: FollowerInput, now: float, h: float) -> float:
        return 0.0 if self._check_motion(inputs, now, h) else self._steered

    def _check_motion(
        self, inputs: FollowerInput, now: float, h: float, limit: float = math.inf
    ) -> bool:
        """Run the motion watch, with a time limit [s]; whether it has ended the motion."""
        odometry, watch = self.odometry, self.watch
        rate, (outward, _) = inputs.rates[0], odometry.tether_direction
        load = watch.parameters.weight_torque * odometry.attitude.up[0]
        load += odometry.kinematics.parameters.wheel_radius * odometry.mean_pull * outward
        found = watch.common(self.rate, rate, odometry.attitude.inclination, h)
        turned, travel = odometry.turned - self._last[0], odometry.travelled - self._last[1]
        self._last = (odometry.turned, odometry.travelled)
        found = found or watch.strain(inputs.torque, load, travel, h)
        if found is None and self.rate < 0.0:
            found = watch.turn(odometry.kinematics.yaw_rate(min(rate, 0.0)) * h, turned)
        elif found is None and self.rate > 0.0:
            found = watch.straight(odometry.speed, inputs.forward, h)
            found = found or watch.tether(travel, travel * outward, odometry.tether_range)
        found = found or watch.duration(now - self._since, limit)
        if found is not None:
            self.unconfirmed = found.unconfirmed
            values = {"turning": int(self.rate < 0.0), "cause": found.cause.value}
            reason = Reason.OUT_OF_LIMITS
            self._end(DrivePhase.STUCK, DriveEvent.STUCK, found.text, reason, now, **values)
        return found is not None

    def _emit(
        self, name: DriveEvent, text: str, reason: Reason | None = None, **values: object
    ) -> None:
        self._changes.append(EventReport(name, text, values, reason))
