"""Random descents that test the winch's load monitor.

A descent has legs: lowering at a rate, ended smoothly or by a hard stop, raising by a little,
sometimes until the rover is caught under a lip, and at last lowering at 0.1 m/s to the floor.
Meanwhile the rover swings and scrapes along the wall. The winch knows neither payload nor friction
nor its load cell's errors. Its reports are compared with the ground truth of the plant.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from msg_schemas import machine, topics
from msg_schemas.phases import WinchMode
from rover_sim.node.sim_loop import Tick
from rover_verify.checks.winch_flights import (
    ATTACHMENT,
    arm,
    fly_winch,
    is_at_rest,
    request,
    sensor_errors,
    slack,
)

APPROACH_RATE = 0.1  # [m/s]
_SETTLE = 2.0  # [s]
_AFTER = 1.5  # time after a true condition in which its alarm is not false [s]
_PATIENCE = 4.0  # detection time limit of a true condition [s]
_SWING_BELOW_LIP = 0.3  # largest swing speed of a rover that a lip shall catch [m/s]
_SWING_PERIODS = 1.2  # swing periods in which the tether must pass the plumb line
_LUNAR_GRAVITY = 1.62  # [m/s^2]
_HIGHEST = 2.5  # shortest length of a leg's end [m]
_WALL_RADIUS = 30.0  # of the hole [m]
_SHAFT = 0.24  # diameter of the shaft under which the rover is caught [m]
# Softer than rock: the rover may be some centimetres within the lip where it appears [N/m^1.5].
_LIP_STIFFNESS = 1.0e5
_LIP_ROOM = 0.3 * _SHAFT  # largest offset of the tether when a lip appears [m]
_PULLS = 1.15  # fraction of the weight
_APART = 0.5  # wall contacts within this time count as one [s]
_NEAR_FLOOR = 0.3  # a contact below this height is with the floor [m]


class TrialLeg(NamedTuple):
    """One leg of a descent."""

    distance: float  # to lower, below 0: to raise [m]
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
        cell_noise: standard deviation of a reading of the load cell [N].
        cell_bias: standard deviation of its bias [N].
        cell_scale: its reading over the tension.
        rate_noise: standard deviation of a reading of the payout rate [m/s].
        floor_below: depth of the floor below the lowest leg [m].
        wall_distance: of the plumb line from the wall [m].
    """

    start_length: float
    payload: float
    friction: float
    swing: float
    legs: tuple[TrialLeg, ...]
    cell_noise: float
    cell_bias: float
    cell_scale: float
    rate_noise: float
    floor_below: float
    wall_distance: float

    @property
    def floor_depth(self) -> float:
        """Of the floor below the fairlead [m]."""
        lowest = at = self.start_length
        for leg in self.legs:
            at += leg.distance
            lowest = max(lowest, at)
        return lowest + self.floor_below

    def overrides(self) -> dict[str, object]:
        """Overrides of the scenario: a hole along whose wall the rover swings."""
        hole = {
            "diameter": 2.0 * _WALL_RADIUS,
            "depth": self.floor_depth + ATTACHMENT - 1.0,
            "wall_distance": self.wall_distance,
            "fairlead_height": 1.0,
            "rim_radius": 0.3,
        }
        return {
            **sensor_errors(self.cell_noise, self.rate_noise),
            "sensors.fairlead_load_cell.bias": self.cell_bias,
            "sensors.fairlead_load_cell.scale": self.cell_scale,
            "tether.length": round(self.start_length, 6),
            "start.swing_angle": math.degrees(self.swing),
            "rover.m1": 6.0 * self.payload,
            "rover.m2": 4.0 * self.payload,
            "winch.friction.coulomb": 0.05 * self.friction,
            "winch.friction.breakaway": 0.07 * self.friction,
            "winch.friction.viscous": 0.005 * self.friction,
            "environment.floor": {"material": "rock"},
            "environment.hole": hole,
        }


class TrialResult(NamedTuple):
    """What one descent showed."""

    touchdown_missed: bool
    touchdown_false: bool
    slack_false: bool
    snags: int  # true number
    snag_missed: bool
    snag_false: bool
    hard_stops: int
    touches: int  # wall contacts while the tether carries the rover
    faults: tuple[str, ...]


def draw_plan(rng: np.random.Generator) -> TrialPlan:
    """Draw a descent."""
    legs: list[TrialLeg] = []
    for _ in range(int(rng.integers(2, 5))):
        distance, rate = float(rng.uniform(0.8, 3.0)), float(rng.uniform(0.1, 0.3))
        hard = rng.random() < 0.6
        after = float(rng.uniform(0.4, 0.95) * distance / rate) if hard else None
        legs.append(TrialLeg(distance, rate, after))
        if rng.random() < 0.5:
            lift, lift_rate = float(rng.uniform(0.3, 0.8)), float(rng.uniform(0.05, 0.3))
            caught = rng.random() < 0.4
            lip = float(rng.uniform(0.3, 0.8) * lift) if caught else None
            hard = lip is None and rng.random() < 0.3
            after = float(rng.uniform(0.4, 0.9) * lift / lift_rate) if hard else None
            legs.append(TrialLeg(-lift, lift_rate, after, lip))
    cell_noise = float(rng.uniform(0.05, 0.4))
    cell_bias = abs(float(rng.uniform(-0.5, 0.5)))
    cell_scale = float(rng.uniform(0.97, 1.03))
    rate_noise = float(rng.uniform(0.001, 0.004))
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
        cell_noise=cell_noise,
        cell_bias=cell_bias,
        cell_scale=cell_scale,
        rate_noise=rate_noise,
        floor_below=float(rng.uniform(0.3, 1.5)),
        wall_distance=float(rng.uniform(0.4, 1.2)),
    )


def fly_trial(plan: TrialPlan, seed: int) -> TrialResult:
    """Fly one descent, with this seed of the sensors' errors."""
    trial = _Trial(plan, seed)
    trial.flight.run(1.0)
    for leg in plan.legs:
        trial.do(leg)
    trial.approach()
    return trial.result()


class _Trial:
    """A flight, with a tally of what was true and what the winch reported."""

    def __init__(self, plan: TrialPlan, seed: int) -> None:
        self.flight = fly_winch(plan.overrides(), seed)
        self._floor_depth = plan.floor_depth
        self._weight = self.flight.plant.scenario.tip_mass * self.flight.plant.scenario.gravity
        self._hard_stops = 0
        self._faults: list[str] = []
        self._touches = 0
        self._last_touch = -math.inf
        self._has_lip = False
        self._supported = _Truth()
        self._caught = _Truth()
        self._slack = _Truth()
        self.flight.sim.observers.append(self._on_tick)

    def _on_tick(self, tick: Tick[Any]) -> None:
        """Compare the winch's alarms with the truth."""
        now, forces, weight = tick.stamp_ns * 1e-9, tick.result.forces, self._weight
        touch = forces.left_wheel + forces.right_wheel + forces.body
        # A swinging rover knocks against a lip; a caught one pulls at it.
        caught = self._has_lip and touch > 0.1 * weight and forces.rover_tension > _PULLS * weight
        on_floor = not self._has_lip and forces.rover_tension < 0.5 * weight < touch * 2.0
        if touch > 0.0 and not self._has_lip and self._depth < self._floor_depth - _NEAR_FLOOR:
            self._touches += now - self._last_touch > _APART
            self._last_touch = now
        touchdown, slackness, snag, _ = self.flight.winch.sensing.load.alarms.values()
        self._supported.step(on_floor, touchdown, now)
        self._slack.step(on_floor or slack(self.flight) > 0.0, slackness, now)
        self._caught.step(caught, snag, now)

    @property
    def _depth(self) -> float:
        """Of the tether's attachment below the fairlead [m]."""
        return -float(self.flight.state.nodes[-1, 0, 2])

    def _place_lip(self, depth: float) -> None:
        """Place a lip at a depth [m], under which the rover is caught when pulled up."""
        # A shaft too narrow for the rover, widening below the lip like a funnel.
        shaft = {
            "diameter": _SHAFT,
            "depth": depth + 30.0,
            "overhang": 20.0,
            "overhang_depth": depth - 1.0,
            "wall_distance": 0.5 * _SHAFT,
            "fairlead_height": 0.5,
            "rim_radius": 0.05,
        }
        self.flight.exchange_plant(
            {"environment.rock.stiffness": _LIP_STIFFNESS, "environment.hole": shaft}
        )
        self._has_lip = True

    def _remove_lip(self) -> None:
        self.flight.exchange_plant({})
        self._has_lip = False

    def do(self, leg: TrialLeg) -> None:
        """Make one leg."""
        flight, winch = self.flight, self.flight.winch
        self._ready()
        goal = max(winch.sensing.payout.length + leg.distance, _HIGHEST)
        comes_by = self._waits_for_plumb() if leg.lip_above is not None else True
        request(flight, machine.WINCH_TO_LENGTH, goal, leg.rate)
        if winch.mode is not WinchMode.LENGTH:  # touchdown reported; the tally decides on it
            return
        if leg.lip_above is not None and comes_by:
            self._place_lip(self._depth - leg.lip_above)

        def done() -> bool:
            return is_at_rest(flight)

        if leg.hard_stop_after is not None and not flight.run(leg.hard_stop_after, done):
            flight.call(topics.WINCH_STOP)
            self._hard_stops += 1
        flight.run(abs(leg.distance) / leg.rate + 10.0, done)
        if leg.lip_above is not None:
            flight.run(_PATIENCE)
            self._remove_lip()
        flight.run(_SETTLE)

    def _waits_for_plumb(self) -> bool:
        """Wait until the swinging tether leaves room for a lip about it; whether it does."""
        flight = self.flight
        period = 2.0 * math.pi * math.sqrt(flight.winch.sensing.payout.length / _LUNAR_GRAVITY)
        return flight.run(
            _SWING_PERIODS * period, lambda: math.hypot(*flight.state.nodes[-1, 0, :2]) < _LIP_ROOM
        )

    def approach(self) -> None:
        """Go down to the floor and stop there."""
        self._ready()
        flight = self.flight
        request(
            flight,
            machine.WINCH_TO_LENGTH,
            flight.winch.sensing.payout.length + 12.0,
            APPROACH_RATE,
        )
        flight.run(140.0, lambda: is_at_rest(flight))
        flight.run(_SETTLE)

    def _ready(self) -> None:
        """Arm again what has stopped."""
        flight, winch = self.flight, self.flight.winch
        if winch.mode is WinchMode.FAULT:
            self._faults.append(winch.fault_reason)
        for _ in range(5):
            if winch.mode.is_armed:
                break
            flight.run(1.0)
            arm(flight)
        if winch.sensing.load.is_supported:  # a false touchdown must not end the trial
            flight.run(_PATIENCE)

    def result(self) -> TrialResult:
        """What the descent showed."""
        return TrialResult(
            self._supported.missed or not self._supported.found,
            self._supported.false,
            self._slack.false,
            self._caught.count,
            self._caught.missed,
            self._caught.false,
            self._hard_stops,
            self._touches,
            tuple(self._faults),
        )


class _Truth:
    """Compares an alarm with the truth: false, or missed."""

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
