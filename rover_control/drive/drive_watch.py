"""Motion watch: detects blocked wheels, immobilization, digging in and steep slopes. Pure.

No sensor measures the speed over ground. The watch compares several measurements, each where it is
observable:

* encoder against command: a wheel that does not turn is blocked;
* gyro in a turn: the left wheel turns, the heading must change;
* accelerometer after a start: its integral over a few seconds must show the speed;
* tether held taut, while driving away from or towards the fairlead: its length must change with the
  travel. Two failed checks in a row are needed, as taking up slack changes the tension and with it
  the measured distance;
* motor current: on soft ground the torque rises with the slip, up to the soil's strength. Driving
  straight ahead, the torque that slope and tether do not explain must stay below that strength;
* time: a rover that a large torque slows down for long slips more than the odometry assumes.

Slip and sinkage cannot be separated; both raise the torque. Near the torque limit the rover slows
down; if the torque stays above it, the motion ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas.faults import StuckCause
from msg_schemas.parameters import parameter

_MAX_FAILED_CHECKS = 2  # failed tether checks in a row that end the motion


class StuckRover(NamedTuple):
    """The end of a motion."""

    cause: StuckCause
    text: str
    unconfirmed: float = 0.0  # odometric travel that no measurement has confirmed [m]


@dataclass(frozen=True)
class WatchParameters:
    """Thresholds of the detection of blocked wheels, immobilization, strain and slope."""

    blocked_fraction: float = parameter(
        0.3, "-", "fraction of the commanded rate below which a wheel is blocked", 0.0, 1.0
    )
    blocked_time: float = parameter(
        1.5, "s", "time below it after which the motion ends", 0.1, 60.0
    )
    stuck_fraction: float = parameter(
        0.35, "-", "fraction of the expected motion below which the rover is stuck", 0.0, 1.0
    )
    turn_check_angle: float = parameter(
        0.25, "rad", "expected turn between two checks by the gyro", 0.05, 7.0
    )
    tether_check_distance: float = parameter(
        0.5, "m", "expected travel between two checks by the tether", 0.05, 10.0
    )
    min_range_change: float = parameter(
        0.25, "m", "least expected change of the range for a check by the tether", 0.02, 10.0
    )
    start_check_time: float = parameter(
        3.0, "s", "time after a start during which the accelerometer is checked", 0.5, 20.0
    )
    start_check_speed: float = parameter(
        0.06, "m/s", "least expected speed for a check by the accelerometer", 0.005, 1.0
    )
    slowdown_torque: float = parameter(
        0.75, "N m", "wheel torque above which the rover slows down", 0.01, 100.0
    )
    torque_limit: float = parameter(1.1, "N m", "largest sustained wheel torque", 0.01, 100.0)
    digging_torque: float = parameter(
        0.85, "N m", "largest sustained wheel torque beyond that of slope and tether", 0.01, 100.0
    )
    torque_limit_time: float = parameter(
        4.0, "s", "time above one of them after which the motion ends", 0.1, 60.0
    )
    weight_torque: float = parameter(
        2.43, "N m", "wheel torque of the rover's weight on a vertical slope", 0.0, 1e4
    )
    min_speed_fraction: float = parameter(
        0.3, "-", "fraction of the speed that remains at the torque limit", 0.05, 1.0
    )
    max_slope: float = parameter(0.30, "rad", "largest slope that the rover drives on", 0.02, 1.5)
    slope_time: float = parameter(0.5, "s", "time above it after which the motion ends", 0.0, 60.0)


class DriveWatch:
    """Watches one motion at a time.

    Args:
        parameters: thresholds.
    """

    def __init__(self, parameters: WatchParameters) -> None:
        self.parameters = parameters
        self.begin()

    def begin(self) -> None:
        """Reset at the start of a motion from rest."""
        self._blocked_time = self._over_slope_time = 0.0
        self._over_torque_time = self._over_torque_travel = 0.0
        self._unconfirmed = 0.0  # travel since the start or the last passed check by the tether [m]
        self._turn = self._turned = 0.0
        self._age = 0.0
        self._inertial_speed = 0.0  # integral of the acceleration [m/s]
        self._not_moving_time = 0.0
        self._range_from: float | None = None
        self._range_expected = 0.0
        self._travel = 0.0
        self._failed_checks = 0  # failed tether checks in a row

    def speed_fraction(self, torque: float) -> float:
        """Fraction of the speed that the rover may use at a wheel torque [N m]."""
        p = self.parameters
        span = max(p.torque_limit - p.slowdown_torque, 1e-9)
        excess = min(max((abs(torque) - p.slowdown_torque) / span, 0.0), 1.0)
        return 1.0 - excess * (1.0 - p.min_speed_fraction)

    def common(self, commanded: float, rate: float, slope: float, h: float) -> StuckRover | None:
        """Check slope and blocked wheels; returns why to stop, None = go on.

        Args:
            commanded: commanded rate of the left wheel [rad/s].
            rate: measured rate of the left wheel [rad/s].
            slope: inclination of base_link [rad].
            h: time since the last call [s].
        """
        p = self.parameters
        is_commanded = abs(commanded) > 0.05
        is_blocked = is_commanded and abs(rate) < p.blocked_fraction * abs(commanded)
        self._blocked_time = self._blocked_time + h if is_blocked else 0.0
        if self._blocked_time > p.blocked_time:
            text = f"wheel motor blocked: {rate:.3g} rad/s at a command of {commanded:.3g} rad/s"
            return StuckRover(StuckCause.MOTOR_BLOCKED, text)
        self._over_slope_time = self._over_slope_time + h if slope > p.max_slope else 0.0
        if self._over_slope_time > p.slope_time:
            return StuckRover(
                StuckCause.TOO_STEEP,
                f"ground too steep: {math.degrees(slope):.3g} deg, limit "
                f"{math.degrees(p.max_slope):.3g} deg",
            )
        return None

    def strain(self, torque: float, load: float, travel: float, h: float) -> StuckRover | None:
        """Check the wheel torque.

        Args:
            torque: from the motor current, negative in a turn [N m].
            load: torque that slope and tether explain, driving straight ahead [N m].
            travel: odometric travel since the last call [m].
            h: time since the last call [s].
        """
        p = self.parameters
        is_over = abs(torque) > p.torque_limit or torque - load > p.digging_torque
        self._over_torque_time = self._over_torque_time + h if is_over else 0.0
        self._over_torque_travel = self._over_torque_travel + travel if is_over else 0.0
        self._unconfirmed += travel
        if self._over_torque_time <= p.torque_limit_time:
            return None
        return StuckRover(
            StuckCause.DIGGING_IN,
            f"wheels dig in: {abs(torque):.3g} N m for {p.torque_limit_time:g} s, limit "
            f"{p.torque_limit:g} N m, or {p.digging_torque:g} N m beyond the {load:.3g} N m that "
            "slope and tether explain",
            self._over_torque_travel,
        )

    def duration(self, time: float, limit: float) -> StuckRover | None:
        """Check the time [s] since the start of a motion against its limit [s]."""
        if time <= limit:
            return None
        text = f"the motion takes longer than its limit of {limit:.3g} s"
        return StuckRover(StuckCause.TOO_SLOW, text, self._unconfirmed)

    def turn(self, expected: float, turned: float) -> StuckRover | None:
        """Check a turn; angle increments [rad] by the wheel and by the gyro."""
        p = self.parameters
        self._turn += expected
        self._turned += turned
        if self._turn < p.turn_check_angle:
            return None
        expected, turned = self._turn, self._turned
        self._turn = self._turned = 0.0
        if turned < p.stuck_fraction * expected:
            return StuckRover(
                StuckCause.NO_TURN,
                f"the wheel turns but not the rover: {math.degrees(turned):.3g} deg of "
                f"{math.degrees(expected):.3g} deg by the gyro",
            )
        return None

    def straight(self, speed: float, forward: float, h: float) -> StuckRover | None:
        """Check the start of a straight segment.

        Args:
            speed: odometric speed over ground [m/s].
            forward: acceleration along base_link x without gravity [m/s^2].
            h: time since the last call [s].
        """
        p = self.parameters
        if self._age > p.start_check_time:
            return None
        self._age += h
        self._inertial_speed += forward * h
        is_observable = speed >= p.start_check_speed
        self._not_moving_time = (
            self._not_moving_time + h
            if is_observable and self._inertial_speed < p.stuck_fraction * speed
            else 0.0
        )
        if self._not_moving_time > 0.4 * p.start_check_time:
            return StuckRover(
                StuckCause.NO_START,
                f"the wheels turn but the rover does not move: {self._inertial_speed:.3g} m/s "
                f"of {speed:.3g} m/s by the accelerometer",
                self._unconfirmed,
            )
        return None

    def tether(self, travel: float, expected: float, distance: float) -> StuckRover | None:
        """Check a straight segment by the length of the tether.

        Args:
            travel: odometric travel since the last call [m].
            expected: change of the distance from the fairlead by that travel [m].
            distance: measured by the taut tether [m]; 0 = unknown.
        """
        p = self.parameters
        if distance <= 0.0:
            self._range_from = None
            return None
        if self._range_from is None:
            self._range_from, self._range_expected, self._travel = distance, 0.0, 0.0
            return None
        self._travel += travel
        self._range_expected += expected
        if self._travel < p.tether_check_distance or abs(self._range_expected) < p.min_range_change:
            return None
        moved, expected_change = distance - self._range_from, self._range_expected
        self._range_from, self._range_expected, self._travel = distance, 0.0, 0.0
        doubted = moved * math.copysign(1.0, expected_change) < p.stuck_fraction * abs(
            expected_change
        )
        self._failed_checks = self._failed_checks + 1 if doubted else 0
        if not doubted:
            self._unconfirmed = 0.0
        if self._failed_checks >= _MAX_FAILED_CHECKS:
            return StuckRover(
                StuckCause.NO_TRAVEL,
                f"the wheels turn but the tether does not follow: {moved:.3g} m of "
                f"{expected_change:.3g} m",
                self._unconfirmed,
            )
        return None
