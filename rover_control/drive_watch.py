"""Whether the rover goes where its wheels say: stuck, blocked, bogged, too steep. Pure.

No sensor tells the speed over ground, so several witnesses are heard, each where it can see:

* the encoder against the command: a wheel that does not turn is blocked;
* the gyro in a turn: the left wheel turns, the heading does not;
* the accelerometer at the start of a way: integrated over a few seconds it must show the speed;
* the tether, held taut: the winch must pay out or take in as the way says, where the way leads
  away from the fairlead or towards it; twice in a row, as its tension and with it the distance that
  it tells change where the winch takes slack up;
* the motor's current: on soft ground the torque rises with the slip, to the soil's strength.

Slip and sinkage cannot be measured apart; both show in the torque. It bounds the speed: the rover
slows down as the torque comes near its limit, and gives up where it stays there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from msg_schemas.parameters import parameter

_DOUBTS = 2  # ways in a row over which the tether does not follow


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
    torque_limit_time: float = parameter(
        3.0, "s", "time above it after which the motion ends", 0.1, 60.0
    )
    min_speed_fraction: float = parameter(
        0.3, "-", "fraction of the speed that remains at the torque limit", 0.05, 1.0
    )
    max_slope: float = parameter(0.30, "rad", "largest slope that the rover drives on", 0.02, 1.5)
    slope_time: float = parameter(0.5, "s", "time above it after which the motion ends", 0.0, 60.0)


class DriveWatch:
    """Watches one motion at a time.

    Args:
        parameters: when.
    """

    def __init__(self, parameters: WatchParameters) -> None:
        self.parameters = parameters
        self.begin()

    def begin(self) -> None:
        """A motion begins from rest."""
        self._blocked = self._steep = self._strained = 0.0
        self._turn = self._turned = 0.0
        self._age = 0.0
        self._inertial = 0.0  # speed by the accelerometer [m/s]
        self._bogged = 0.0
        self._range_from: float | None = None
        self._range_expected = 0.0
        self._way = 0.0
        self._doubts = 0  # of the tether, one after the other

    def speed_share(self, torque: float) -> float:
        """What part of its speed the rover may use at a torque [N m]."""
        p = self.parameters
        span = max(p.torque_limit - p.slowdown_torque, 1e-9)
        over = min(max((abs(torque) - p.slowdown_torque) / span, 0.0), 1.0)
        return 1.0 - over * (1.0 - p.min_speed_fraction)

    def common(self, commanded: float, rate: float, torque: float, slope: float, h: float) -> str:
        """Watch what every motion shows; returns the reason to end it, empty = none.

        Args:
            commanded: rate of the left wheel [rad/s].
            rate: that its encoder shows.
            torque: at the wheels, by the current [N m].
            slope: inclination of base_link [rad].
            h: time since the last call [s].
        """
        p = self.parameters
        asked = abs(commanded) > 0.05
        slow = asked and abs(rate) < p.blocked_fraction * abs(commanded)
        self._blocked = self._blocked + h if slow else 0.0
        if self._blocked > p.blocked_time:
            return (
                f"the wheel motor is blocked: {rate:.3g} rad/s for {commanded:.3g} rad/s commanded"
            )
        self._strained = self._strained + h if abs(torque) > p.torque_limit else 0.0
        if self._strained > p.torque_limit_time:
            return (
                f"the wheels dig in: {abs(torque):.3g} N m for {p.torque_limit_time:g} s, "
                f"{p.torque_limit:g} N m are allowed"
            )
        self._steep = self._steep + h if slope > p.max_slope else 0.0
        if self._steep > p.slope_time:
            return (
                f"the ground is too steep: {math.degrees(slope):.3g} deg, "
                f"{math.degrees(p.max_slope):.3g} deg are allowed"
            )
        return ""

    def turn(self, expected: float, turned: float) -> str:
        """Watch a turn; angles [rad] since the last call, by the wheel and by the gyro."""
        p = self.parameters
        self._turn += expected
        self._turned += turned
        if self._turn < p.turn_check_angle:
            return ""
        expected, turned = self._turn, self._turned
        self._turn = self._turned = 0.0
        if turned < p.stuck_fraction * expected:
            return (
                f"the wheel turns and the rover does not: {math.degrees(turned):.3g} deg of "
                f"{math.degrees(expected):.3g} deg by the gyro"
            )
        return ""

    def straight(self, speed: float, forward: float, h: float) -> str:
        """Watch the start of a straight way.

        Args:
            speed: over ground, as the wheels and their usual slip have it [m/s].
            forward: acceleration along base_link x, gravity taken off [m/s^2].
            h: time since the last call [s].
        """
        p = self.parameters
        if self._age > p.start_check_time:
            return ""
        self._age += h
        self._inertial += forward * h
        seen = speed >= p.start_check_speed
        self._bogged = (
            self._bogged + h if seen and self._inertial < p.stuck_fraction * speed else 0.0
        )
        if self._bogged > 0.4 * p.start_check_time:
            return (
                f"the wheels turn and the rover does not move: {self._inertial:.3g} m/s of "
                f"{speed:.3g} m/s by the accelerometer"
            )
        return ""

    def tether(self, way: float, expected: float, distance: float) -> str:
        """Watch a straight way by the tether's length.

        Args:
            way: driven since the last call [m].
            expected: change of the distance from the fairlead by it [m].
            distance: by the tether, held taut [m]; 0 = not known.
        """
        p = self.parameters
        if distance <= 0.0:
            self._range_from = None
            return ""
        if self._range_from is None:
            self._range_from, self._range_expected, self._way = distance, 0.0, 0.0
            return ""
        self._way += way
        self._range_expected += expected
        if self._way < p.tether_check_distance or abs(self._range_expected) < p.min_range_change:
            return ""
        moved, wanted = distance - self._range_from, self._range_expected
        self._range_from, self._range_expected, self._way = distance, 0.0, 0.0
        doubted = moved * math.copysign(1.0, wanted) < p.stuck_fraction * abs(wanted)
        self._doubts = self._doubts + 1 if doubted else 0
        if self._doubts >= _DOUBTS:
            return (
                f"the wheels turn and the tether does not follow: {moved:.3g} m of {wanted:.3g} m"
            )
        return ""
