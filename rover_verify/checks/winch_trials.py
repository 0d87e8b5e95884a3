"""Random descents that test the winch's load monitor.

A descent has legs: lowering at a rate, ended smoothly or by a hard stop, raising by a little,
sometimes until the rover is caught under a lip, and at last lowering at 0.1 m/s to the floor.
Meanwhile the rover swings and scrapes along the wall. The winch knows neither payload nor friction
nor its load cell's errors. Its reports are compared with the ground truth of the plant.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple, Protocol

import numpy as np

from msg_schemas.machine import WINCH_TO_LENGTH
from msg_schemas.phases import WinchMode
from msg_schemas.refusal import Refusal
from rover_verify.checks.winch_rig import TICK, Rig, SensorErrors, Session
from tether_winch.winch import Winch, WinchParameters

APPROACH_RATE = 0.1  # [m/s]
_SETTLE = 2.0  # [s]
_AFTER = 1.5  # time after a true condition in which its alarm is not false [s]
_PATIENCE = 4.0  # detection time limit of a true condition [s]
_SWING_BELOW_LIP = 0.3  # largest swing speed of a rover that a lip shall catch [m/s]
_SWING_PERIODS = 1.2  # swing periods in which the tether must pass the plumb line
_LUNAR_GRAVITY = 1.62  # [m/s^2]


class LegKind(StrEnum):
    """What a leg of the descent is."""

    LOWER = "lower"
    RAISE = "raise"


class Leg(NamedTuple):
    """One leg of a descent."""

    kind: LegKind
    distance: float  # [m], above 0
    rate: float  # [m/s]
    hard_stop_after: float | None = None  # [s]
    lip_above: float | None = None  # distance [m] after which the rover is caught


@dataclass(frozen=True)
class TrialPlan:
    """One descent.

    Attributes:
        start_length: paid out at the start [m].
        payload: mass of the rover over the nominal one.
        friction: friction of the drum over the controller's value.
        swing: angle at the start [rad].
        floor_below: depth of the floor below the lowest leg [m].
        wall_distance: of the plumb line from the wall, for plants that have one [m].
    """

    start_length: float
    payload: float
    friction: float
    swing: float
    legs: tuple[Leg, ...]
    errors: SensorErrors
    floor_below: float
    wall_distance: float

    @property
    def swing_speed(self) -> float:
        """Greatest speed of the swing that it starts with [m/s]."""
        return self.swing * math.sqrt(_LUNAR_GRAVITY * self.start_length)

    @property
    def floor_depth(self) -> float:
        """Of the floor below the fairlead [m]."""
        lowest = at = self.start_length
        for leg in self.legs:
            at += leg.distance if leg.kind is LegKind.LOWER else -leg.distance
            lowest = max(lowest, at)
        return lowest + self.floor_below


class TrialRig(Rig, Protocol):
    """A plant that knows what is true."""

    @property
    def is_supported(self) -> bool:
        """Whether the floor carries more than half of the rover."""

    @property
    def is_caught(self) -> bool:
        """Whether the rover is held under a lip."""

    @property
    def slack(self) -> float:
        """Length by which the tether is longer than its way [m]."""

    @property
    def depth(self) -> float:
        """Of the rover below the fairlead [m]."""

    @property
    def has_room_for_lip(self) -> bool:
        """Whether the tether is so near the plumb line that a lip may appear about it."""

    def place_lip(self, depth: float) -> None:
        """Put a lip at a depth [m], under which the rover is caught when pulled up."""


class TrialResult(NamedTuple):
    """What one descent showed."""

    touchdown_missed: bool
    touchdown_false: bool
    slack_false: bool
    snags: int  # true number
    snag_missed: bool
    snag_false: bool
    slack_at_stop: float  # [m]
    hard_stops: int
    faults: tuple[str, ...]


def draw_plan(rng: np.random.Generator) -> TrialPlan:
    """Draw a descent."""
    legs: list[Leg] = []
    for _ in range(int(rng.integers(2, 5))):
        distance, rate = float(rng.uniform(0.8, 3.0)), float(rng.uniform(0.1, 0.3))
        hard = rng.random() < 0.6
        after = float(rng.uniform(0.4, 0.95) * distance / rate) if hard else None
        legs.append(Leg(LegKind.LOWER, distance, rate, after))
        if rng.random() < 0.5:
            lift, lift_rate = float(rng.uniform(0.3, 0.8)), float(rng.uniform(0.05, 0.3))
            caught = rng.random() < 0.4
            lip = float(rng.uniform(0.3, 0.8) * lift) if caught else None
            hard = lip is None and rng.random() < 0.3
            after = float(rng.uniform(0.4, 0.9) * lift / lift_rate) if hard else None
            legs.append(Leg(LegKind.RAISE, lift, lift_rate, after, lip))
    errors = SensorErrors(
        cell_noise=float(rng.uniform(0.05, 0.4)),
        cell_bias=float(rng.uniform(-0.5, 0.5)),
        cell_gain=float(rng.uniform(0.97, 1.03)),
        rate_noise=float(rng.uniform(0.001, 0.004)),
        current_noise=0.01,
    )
    start_length = float(rng.uniform(3.0, 40.0))
    payload = float(rng.uniform(0.7, 1.3))
    friction = float(rng.uniform(0.5, 2.0))
    swing = float(rng.uniform(0.0, np.radians(10.0)))
    if any(leg.lip_above is not None for leg in legs):
        # The lip holds the tether: below it the rover swings as a short pendulum.
        fastest = _SWING_BELOW_LIP / math.sqrt(_LUNAR_GRAVITY * start_length)
        swing *= min(1.0, fastest / math.radians(10.0))
    return TrialPlan(
        start_length=start_length,
        payload=payload,
        friction=friction,
        swing=swing,
        legs=tuple(legs),
        errors=errors,
        floor_below=float(rng.uniform(0.3, 1.5)),
        wall_distance=float(rng.uniform(0.4, 1.2)),
    )


def run_trial(
    plan: TrialPlan,
    rig: TrialRig,
    rng: np.random.Generator,
    parameters: WinchParameters | None = None,
) -> TrialResult:
    """Let the winch make one descent."""
    session = Session(
        Winch(WinchParameters() if parameters is None else parameters),
        rig,
        plan.errors,
        rng,
        keeps=False,
    )
    trial = _Trial(session, rig)
    session.arm()
    trial.go(1.0)
    for leg in plan.legs:
        trial.do(leg)
    trial.approach()
    return trial.result()


class _Trial:
    """A descent under way, with a tally of what was true and what was told."""

    def __init__(self, session: Session, rig: TrialRig) -> None:
        self.session = session
        self.rig = rig
        self.hard_stops = 0
        self.faults: list[str] = []
        self._supported = _Truth()
        self._caught = _Truth()
        self._slack = _Truth()

    def go(self, duration: float, until: Callable[[], bool] = lambda: False) -> None:
        """Go on for so long [s] at most."""
        for _ in range(round(duration / TICK)):
            self.session.tick()
            now, winch, rig = self.session.time, self.session.winch, self.rig
            touchdown, slack, snag, _ = winch.alarms.values()
            self._supported.step(rig.is_supported, touchdown, now)
            self._slack.step(rig.is_supported or rig.slack > 0.0, slack, now)
            self._caught.step(rig.is_caught, snag, now)
            if until():
                return

    def do(self, leg: Leg) -> None:
        """Make one leg."""
        winch, session = self.session.winch, self.session
        self._ready()
        sign = 1.0 if leg.kind is LegKind.LOWER else -1.0
        goal = max(winch.payout.length + sign * leg.distance, 2.5)
        comes_by = self._waits_for_plumb() if leg.lip_above is not None else True
        try:
            session.request(WINCH_TO_LENGTH, goal, leg.rate)
        except Refusal:  # touchdown reported; the tally decides whether it is true
            return
        if leg.lip_above is not None and comes_by:
            self.rig.place_lip(self.rig.depth - leg.lip_above)

        def done() -> bool:
            return winch.mode is not WinchMode.LENGTH and winch.servo.is_at_rest

        if leg.hard_stop_after is not None:
            self.go(leg.hard_stop_after, done)
            if not done():
                winch.stop("a hard stop", session.now_ns)
                self.hard_stops += 1
        self.go(leg.distance / leg.rate + 10.0, done)
        if leg.lip_above is not None:
            self.go(_PATIENCE)
            self.rig.place_lip(-1e9)
        self.go(_SETTLE)

    def _waits_for_plumb(self) -> bool:
        """Wait until the swinging tether leaves room for a lip about it; whether it does."""
        period = 2.0 * math.pi * math.sqrt(self.session.winch.payout.length / _LUNAR_GRAVITY)
        if not self.rig.has_room_for_lip:
            self.go(_SWING_PERIODS * period, lambda: self.rig.has_room_for_lip)
        return self.rig.has_room_for_lip

    def approach(self) -> None:
        """Go down to the floor and stop there."""
        winch, session = self.session.winch, self.session
        self._ready()
        with contextlib.suppress(Refusal):
            session.request(WINCH_TO_LENGTH, winch.payout.length + 12.0, APPROACH_RATE)
        self.go(140.0, lambda: winch.mode is not WinchMode.LENGTH and winch.servo.is_at_rest)
        self.go(_SETTLE)

    def _ready(self) -> None:
        """Arm again what has stopped."""
        winch = self.session.winch
        if winch.mode is WinchMode.FAULT:
            self.faults.append(winch.fault_reason)
        for _ in range(5):
            if winch.mode.is_armed:
                break
            self.go(1.0)
            winch.rearm(self.session.now_ns)
        if winch.load.is_supported:  # a false touchdown must not end the trial
            self.go(_PATIENCE)

    def result(self) -> TrialResult:
        """What the descent showed."""
        return TrialResult(
            self._supported.missed or not self._supported.found,
            self._supported.false,
            self._slack.false,
            self._caught.count,
            self._caught.missed,
            self._caught.false,
            self.rig.slack,
            self.hard_stops,
            tuple(self.faults),
        )


class _Truth:
    """Holds an alarm against what is true: told without, or not told in time."""

    def __init__(self) -> None:
        self.found = False
        self.missed = False
        self.false = False
        self.count = 0
        self._true_since: float | None = None
        self._last_true = -np.inf
        self._is_reported = False

    def step(self, is_true: bool, is_reported: bool, now: float) -> None:
        """Take one instant."""
        if is_true:
            if self._true_since is None and now - self._last_true > _AFTER:
                self.count += 1
                self._is_reported = False
            if self._true_since is None:
                self._true_since = now
            self._last_true = now
            self._is_reported |= is_reported
            self.found |= is_reported
            self.missed |= not self._is_reported and now - self._true_since > _PATIENCE
        else:
            self._true_since = None
            self.false |= is_reported and now - self._last_true > _AFTER
