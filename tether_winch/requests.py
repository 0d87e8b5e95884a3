"""Motion requests: conversion to a servo goal, or refusal. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas import machine, topics
from msg_schemas.parameters import parameter
from msg_schemas.phases import JumpPhase, WinchMode
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointValue
from tether_winch.servo import GoalKind, ServoGoal, ServoParameters

JUMPING = frozenset(
    {
        JumpPhase.COMPRESSING,
        JumpPhase.SETTLING,
        JumpPhase.RELEASING,
        JumpPhase.FLIGHT,
        JumpPhase.LANDED,
    }
)
"""Phases of the jump in which nothing is reeled in."""

_SAME_LENGTH = 0.01  # the drum may move by this much while a request to stay is on its way [m]


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


class RequestContext(NamedTuple):
    """State of winch and rover at a request."""

    length: float  # payout [m]
    taut_length: float  # payout at which the tether was last taut [m]
    tension: float  # [N]; NaN = unknown
    tension_fault: str  # why it is unknown
    own_weight: float  # weight of the paid-out tether [N]
    load: float  # load of the hanging rover [N]
    is_supported: bool  # the ground carries most of the rover
    jump: str  # phase of a jump in progress; empty = none


class AcceptedRequest(NamedTuple):
    """Result of an accepted request."""

    mode: WinchMode
    goal: ServoGoal
    reason: str
    is_renewed: bool = False  # it must be renewed during the motion


class RequestInterpreter:
    """Converts requests to servo goals.

    Args:
        parameters: defaults of requests.
        servo: limits of motion.
        min_load_fraction: fraction of the load below which a tension hold would lower the rover.
    """

    def __init__(
        self, parameters: RequestParameters, servo: ServoParameters, min_load_fraction: float
    ) -> None:
        self.parameters = parameters
        self.servo = servo
        self.min_load_fraction = min_load_fraction

    def interpret(self, name: str, value: JointValue, now: RequestContext) -> AcceptedRequest:
        """Convert the request of a joint to a goal.

        Raises:
            Refusal: the request is out of limits, or not allowed in this state.
        """
        take = {
            machine.WINCH_TO_LENGTH: self._to_length,
            machine.WINCH_WHILE_RENEWED: self._while_renewed,
            machine.WINCH_AT_RATE: self._at_rate,
            machine.WINCH_AT_TENSION: self._at_tension,
            machine.WINCH_SLACK: self._slack,
        }[name]
        return take(value, now)

    def relax(self, now: RequestContext) -> AcceptedRequest:
        """Lower the tension until the tether is slack.

        Raises:
            Refusal: the tension is unknown, or the rover hangs.
        """
        subject = topics.WINCH_RELAX
        self._check_tension(now, subject)
        if not now.is_supported:
            raise Refusal(
                subject,
                RefusalCode.WRONG_PHASE,
                f"the tether carries the rover ({now.tension:.4g} N) and relaxing would lower it; "
                "set the rover down first",
            )
        p = self.parameters
        tension = now.own_weight + 0.5 * p.take_up_tension
        goal = ServoGoal(GoalKind.TENSION, rate=p.relax_rate, tension=tension, reels_in=False)
        return AcceptedRequest(WinchMode.RELAX, goal, f"relaxing from {now.tension:.4g} N")

    def take_up(self, rate: float, now: RequestContext, reason: str) -> AcceptedRequest:
        """Take up slack at a rate [m/s]; 0 selects `take_up_rate`."""
        p = self.parameters
        goal = ServoGoal(
            GoalKind.TENSION,
            rate=rate if rate > 0.0 else p.take_up_rate,
            tension=now.own_weight + p.take_up_tension,
            pays_out=False,
        )
        return AcceptedRequest(WinchMode.SLACK, goal, f"{reason}: taking up the slack")

    @property
    def soft_ends(self) -> tuple[float, float]:
        """Range of lengths [m] that a request may lead to."""
        p = self.servo
        return p.shortest_length + p.soft_margin, p.longest_length - p.soft_margin

    def _to_length(self, value: JointValue, now: RequestContext) -> AcceptedRequest:
        length, rate, tension = value
        low, high = self.soft_ends
        if not low <= length <= high:
            raise _refused(
                RefusalCode.OUT_OF_LIMITS,
                f"length is {length!r} m, it must be within {low:g} .. {high:g} m",
            )
        self._check_rate(rate)
        if abs(length - now.length) > _SAME_LENGTH:
            _check_direction(length - now.length, now)
        goal = ServoGoal(GoalKind.LENGTH, length=length, rate=rate, limit=self._limit(tension))
        return AcceptedRequest(WinchMode.LENGTH, goal, f"to {length:g} m")

    def _while_renewed(self, value: JointValue, now: RequestContext) -> AcceptedRequest:
        return self._to_length(value, now)._replace(is_renewed=True)

    def _at_rate(self, value: JointValue, now: RequestContext) -> AcceptedRequest:
        _, rate, tension = value
        self._check_rate(rate)
        _check_direction(rate, now)
        goal = ServoGoal(GoalKind.RATE, rate=rate, limit=self._limit(tension))
        return AcceptedRequest(WinchMode.RATE, goal, f"at {rate:g} m/s")

    def _at_tension(self, value: JointValue, now: RequestContext) -> AcceptedRequest:
        longest, rate, tension = value
        self._check_rate(rate)
        self._check_tension(now)
        least = now.own_weight + self.parameters.tension_margin
        if tension < least:
            raise _refused(
                RefusalCode.OUT_OF_LIMITS,
                f"tension is {tension!r} N, it must be at least {least:.4g} N: the paid-out tether "
                f"weighs {now.own_weight:.4g} N, a lower tension would pay out without end",
            )
        self._limit(tension)
        hanging = now.load + now.own_weight
        if not now.is_supported and tension < self.min_load_fraction * hanging:
            raise _refused(
                RefusalCode.WRONG_PHASE,
                f"the rover hangs with {hanging:.4g} N and a tension of {tension:g} N would let it "
                "fall; set the rover down first",
            )
        goal = ServoGoal(
            GoalKind.TENSION,
            length=longest if longest > 0.0 else math.inf,
            rate=rate,
            tension=tension,
        )
        return AcceptedRequest(WinchMode.TENSION, goal, f"holding {tension:g} N")

    def _slack(self, value: JointValue, now: RequestContext) -> AcceptedRequest:
        amount, rate, _ = value
        self._check_rate(rate)
        if amount == 0.0:
            _check_direction(-1.0, now)
            self._check_tension(now)
            return self.take_up(rate, now, "requested")
        if not now.is_supported:
            raise _refused(
                RefusalCode.WRONG_PHASE,
                "the tether carries the rover and giving slack would lower it; set it down first",
            )
        length = now.taut_length + amount
        _, high = self.soft_ends
        if length > high:
            raise _refused(
                RefusalCode.OUT_OF_LIMITS,
                f"slack of {amount!r} m leads to {length:.4g} m, the limit is {high:g} m",
            )
        goal = ServoGoal(
            GoalKind.LENGTH,
            length=length,
            rate=rate if rate > 0.0 else self.parameters.slack_rate,
            reels_in=False,
        )
        return AcceptedRequest(
            WinchMode.SLACK, goal, f"giving {amount:g} m of slack beyond {now.taut_length:.4g} m"
        )

    def _check_rate(self, rate: float) -> None:
        largest = self.servo.largest_rate
        if abs(rate) > largest:
            raise _refused(
                RefusalCode.OUT_OF_LIMITS,
                f"rate is {rate!r} m/s, it must be within {-largest:g} .. {largest:g} m/s",
            )

    def _limit(self, tension: float) -> float:
        most = self.servo.tension_limit
        if tension > most:
            raise _refused(
                RefusalCode.OUT_OF_LIMITS,
                f"tension is {tension!r} N, it must be at most {most:g} N",
            )
        return tension if tension > machine.SMALLEST_LIMIT else most

    def _check_tension(self, now: RequestContext, subject: str = topics.WINCH_REQUEST) -> None:
        if math.isnan(now.tension):
            reason = f"the tension is unknown: {now.tension_fault}"
            raise Refusal(subject, RefusalCode.STALE, reason)


def _check_direction(direction: float, now: RequestContext) -> None:
    if direction < 0.0 and now.jump:
        raise _refused(
            RefusalCode.WRONG_PHASE,
            f"a jump is in progress ({now.jump}); wait for the landing before reeling in",
        )
    if direction > 0.0 and now.is_supported:
        raise _refused(
            RefusalCode.WRONG_PHASE,
            f"touchdown at {now.length:.4g} m: the ground carries the rover; use a slack request "
            "or a tension hold to pay out",
        )


def _refused(code: RefusalCode, reason: str) -> Refusal:
    return Refusal(topics.WINCH_REQUEST, code, reason)
