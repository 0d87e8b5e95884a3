"""Requests for a motion: what each asks of the servo, or why it is refused. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from msg_schemas import topics
from msg_schemas.machine import (
    SMALLEST_LIMIT,
    WINCH_AT_RATE,
    WINCH_AT_TENSION,
    WINCH_SLACK,
    WINCH_TO_LENGTH,
    WINCH_WHILE_RENEWED,
)
from msg_schemas.parameters import parameter
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointValue
from tether_winch.servo import Goal, GoalKind, ServoParameters


class Mode(StrEnum):
    """What the winch is doing; the words of the contract."""

    DISARMED = "disarmed"
    HOLD = "hold"
    LENGTH = "length"
    RATE = "rate"
    TENSION = "tension"
    SLACK = "slack"
    RELAX = "relax"
    STOP = "stop"
    FAULT = "fault"

    @property
    def is_armed(self) -> bool:
        """Whether requests are taken."""
        return self not in (Mode.DISARMED, Mode.STOP, Mode.FAULT)


@dataclass(frozen=True)
class RequestParameters:
    """Values that a request may leave to the winch."""

    slack_rate: float = parameter(0.2, "m/s", "payout rate when giving slack", 1e-3, 0.5)
    take_up_rate: float = parameter(0.05, "m/s", "rate when taking up slack", 1e-3, 0.5)
    take_up_tension: float = parameter(
        1.0, "N", "tension beyond the tether's own weight at which it is taut", 0.05, 100.0
    )
    relax_rate: float = parameter(0.05, "m/s", "payout rate when relaxing the tether", 1e-3, 0.5)
    tension_margin: float = parameter(
        0.3, "N", "least excess of a tension setpoint over the tether's own weight", 0.0, 100.0
    )
    jump_timeout: float = parameter(
        30.0, "s", "longest jump; without an end reported it is over after this time", 1.0, 600.0
    )


class Situation(NamedTuple):
    """What a request is judged by."""

    length: float  # paid out [m]
    taut_length: float  # at which the tether was last taut [m]
    tension: float  # [N]; NaN = not known
    tension_fault: str  # why it is not
    own_weight: float  # of the tether that is out [N]
    load: float  # of the rover where it hangs [N]
    is_supported: bool  # something else carries most of the rover
    jump: str  # phase of the jump that is under way; empty = none


class Accepted(NamedTuple):
    """What a request turns into."""

    mode: Mode
    goal: Goal
    reason: str
    is_renewed: bool = False  # it ends where it is not renewed on the way


class RequestJudge:
    """Turns requests into goals.

    Args:
        parameters: what requests may leave to the winch.
        servo: limits of motion.
        light: part of the load below which a tension would let a hanging rover fall.
    """

    def __init__(self, parameters: RequestParameters, servo: ServoParameters, light: float) -> None:
        self.parameters = parameters
        self.servo = servo
        self.light = light

    def judge(self, name: str, value: JointValue, now: Situation) -> Accepted:
        """Take a request by its joint's name.

        Raises:
            Refusal: out of limits, or not now; says what would be right.
        """
        take = {
            WINCH_TO_LENGTH: self._to_length,
            WINCH_WHILE_RENEWED: self._while_renewed,
            WINCH_AT_RATE: self._at_rate,
            WINCH_AT_TENSION: self._at_tension,
            WINCH_SLACK: self._slack,
        }[name]
        return take(value, now)

    def relax(self, now: Situation) -> Accepted:
        """Let the pull down.

        Raises:
            Refusal: the tension is not known, or the rover hangs.
        """
        subject = topics.WINCH_RELAX
        self._check_tension(now, subject)
        if not now.is_supported:
            raise Refusal(
                subject,
                RefusalCode.WRONG_PHASE,
                f"the tether carries the rover ({now.tension:.4g} N), relaxing would lower it to "
                "the ground; it must stand first",
            )
        p = self.parameters
        tension = now.own_weight + 0.5 * p.take_up_tension
        goal = Goal(GoalKind.TENSION, rate=p.relax_rate, tension=tension, reels_in=False)
        return Accepted(Mode.RELAX, goal, f"letting {now.tension:.4g} N down")

    def take_up(self, rate: float, now: Situation, reason: str) -> Accepted:
        """Take slack up, at a rate [m/s] or, where that is 0, at the winch's own."""
        p = self.parameters
        goal = Goal(
            GoalKind.TENSION,
            rate=rate if rate > 0.0 else p.take_up_rate,
            tension=now.own_weight + p.take_up_tension,
            pays_out=False,
        )
        return Accepted(Mode.SLACK, goal, f"{reason}: taking the slack up")

    @property
    def ends(self) -> tuple[float, float]:
        """Lengths [m] between which requests may lead."""
        p = self.servo
        return p.shortest_length + p.soft_margin, p.longest_length - p.soft_margin

    def _to_length(self, value: JointValue, now: Situation) -> Accepted:
        length, rate, tension = value
        low, high = self.ends
        if not low <= length <= high:
            raise _refused(
                RefusalCode.OUT_OF_LIMITS,
                f"length is {length!r} m, it must lie in {low:g} .. {high:g} m",
            )
        self._check_rate(rate)
        _check_direction(length - now.length, now)
        goal = Goal(GoalKind.LENGTH, length=length, rate=rate, limit=self._limit(tension))
        return Accepted(Mode.LENGTH, goal, f"to {length:g} m")

    def _while_renewed(self, value: JointValue, now: Situation) -> Accepted:
        return self._to_length(value, now)._replace(is_renewed=True)

    def _at_rate(self, value: JointValue, now: Situation) -> Accepted:
        _, rate, tension = value
        self._check_rate(rate)
        _check_direction(rate, now)
        goal = Goal(GoalKind.RATE, rate=rate, limit=self._limit(tension))
        return Accepted(Mode.RATE, goal, f"at {rate:g} m/s")

    def _at_tension(self, value: JointValue, now: Situation) -> Accepted:
        longest, rate, tension = value
        self._check_rate(rate)
        self._check_tension(now)
        least = now.own_weight + self.parameters.tension_margin
        if tension < least:
            raise _refused(
                RefusalCode.OUT_OF_LIMITS,
                f"tension is {tension!r} N, it must be at least {least:.4g} N: the tether that is "
                f"out weighs {now.own_weight:.4g} N, holding less would pay out without end",
            )
        self._limit(tension)
        hanging = now.load + now.own_weight
        if not now.is_supported and tension < self.light * hanging:
            raise _refused(
                RefusalCode.WRONG_PHASE,
                f"the rover hangs with {hanging:.4g} N, holding {tension:g} N would let it fall; "
                "it must stand first",
            )
        goal = Goal(
            GoalKind.TENSION,
            length=longest if longest > 0.0 else math.inf,
            rate=rate,
            tension=tension,
        )
        return Accepted(Mode.TENSION, goal, f"holding {tension:g} N")

    def _slack(self, value: JointValue, now: Situation) -> Accepted:
        amount, rate, _ = value
        self._check_rate(rate)
        if amount == 0.0:
            _check_direction(-1.0, now)
            self._check_tension(now)
            return self.take_up(rate, now, "asked for")
        if not now.is_supported:
            raise _refused(
                RefusalCode.WRONG_PHASE,
                "the tether carries the rover, giving slack would lower it; it must stand first",
            )
        length = now.taut_length + amount
        _, high = self.ends
        if length > high:
            raise _refused(
                RefusalCode.OUT_OF_LIMITS,
                f"slack of {amount!r} m leads to {length:.4g} m, it may lead to {high:g} m",
            )
        goal = Goal(
            GoalKind.LENGTH,
            length=length,
            rate=rate if rate > 0.0 else self.parameters.slack_rate,
            reels_in=False,
        )
        return Accepted(Mode.SLACK, goal, f"giving {amount:g} m beyond {now.taut_length:.4g} m")

    def _check_rate(self, rate: float) -> None:
        largest = self.servo.largest_rate
        if abs(rate) > largest:
            raise _refused(
                RefusalCode.OUT_OF_LIMITS,
                f"rate is {rate!r} m/s, it must lie in {-largest:g} .. {largest:g} m/s",
            )

    def _limit(self, tension: float) -> float:
        most = self.servo.tension_limit
        if tension > most:
            raise _refused(
                RefusalCode.OUT_OF_LIMITS,
                f"tension is {tension!r} N, it must be at most {most:g} N",
            )
        return tension if tension > SMALLEST_LIMIT else most

    def _check_tension(self, now: Situation, subject: str = topics.WINCH_REQUEST) -> None:
        if math.isnan(now.tension):
            reason = f"the tension is not known: {now.tension_fault}"
            raise Refusal(subject, RefusalCode.STALE, reason)


def _check_direction(way: float, now: Situation) -> None:
    if way < 0.0 and now.jump:
        raise _refused(
            RefusalCode.WRONG_PHASE,
            f"the rover jumps ({now.jump}), nothing is reeled in until it has landed",
        )
    if way > 0.0 and now.is_supported:
        raise _refused(
            RefusalCode.WRONG_PHASE,
            f"touchdown at {now.length:.4g} m: something carries the rover, only slack or a "
            "tension hold pay out now",
        )


def _refused(code: RefusalCode, reason: str) -> Refusal:
    return Refusal(topics.WINCH_REQUEST, code, reason)
