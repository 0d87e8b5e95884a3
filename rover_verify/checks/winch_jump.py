"""Jump with the winch, compared with the same jump without a tether, on the spatial plant.

The rover stands on a slope that falls away from the mother machine, so that it jumps down and away
and the chord to the fairlead grows. The winch takes the tether up until it is taut, gives the
slack that the chord will need, stands still during the flight, and takes up the rest after the
landing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Literal, NamedTuple

import numpy as np

from msg_schemas import machine, topics
from msg_schemas.events import JumpEvent, PlantEvent
from msg_schemas.phases import WinchMode
from rover_sim import Event, SpatialState
from rover_sim.node.sim_loop import Tick
from rover_verify.checks import CheckBatch, Measured, described
from rover_verify.checks.winch_flights import chord, fly_winch, request, slack
from rover_verify.harness.flight import JUMP

_NUT_SPEED = 0.05  # [m/s]
_MARGIN = 0.15  # of the slack beyond the chord's growth [m]
_HELD = 1.5  # constant tension of the comparison [N]
# A tether without influence: a thousandth of the default's weight.
_NO_TETHER = {"tether.line_density": 5e-6, "tether.bending_stiffness": 1e-7}
_RENEWAL = 0.5  # of the constant tension [s]
_PATIENCE = 60.0  # [s]


class AssistedJump(NamedTuple):
    """One jump.

    Attributes:
        depth: of the floor below the fairlead, where the rover stands [m].
        away: from the plumb line [m].
        slope: [deg].
        stroke: compression of the spring [m].
    """

    depth: float
    away: float
    slope: float
    stroke: float

    def overrides(self) -> dict[str, object]:
        """Of the scenario."""
        chord = math.hypot(self.depth, self.away)
        height = -self.depth + self.away * math.tan(math.radians(self.slope))
        return {
            "environment.floor": {"height": height, "slope": self.slope, "downhill": 0.0},
            "start.kind": "grounded",
            "start.position": [self.away, 0.0],
            "start.settling_time": 300.0,
            "start.heading": 180.0,  # the tail downhill: so it does not topple
            "tether.length": round(chord + 0.8, 3),
            "tether.element_length": 0.5 if self.depth < 20.0 else 1.0,
        }


class Jumped(NamedTuple):
    """Result of a jump.

    Attributes:
        range: distance of Body 1 over the ground from take-off to touchdown [m].
        time: from take-off to touchdown [s].
        growth: of the chord from the fairlead to the attachment, at its largest until the rover has
            come to rest [m].
        peak_tension: from the release until the slack is taken up [N].
        reeled_in: while the rover flew [m].
        slack_left: when the winch had taken it up [m]; NaN = it has not.
    """

    range: float
    time: float
    growth: float
    peak_tension: float = 0.0
    reeled_in: float = 0.0
    slack_left: float = math.nan


class Trip:
    """A jump by jump_node, with the winch at work or without a tether.

    Args:
        jump: to fly.
        seed: of the sensors' errors.
        tethered: False = the tether has no influence.
    """

    def __init__(self, jump: AssistedJump, seed: int, *, tethered: bool = True) -> None:
        self._jump = jump
        self.flight = fly_winch(
            {**jump.overrides(), **({} if tethered else _NO_TETHER)}, seed, controllers=JUMP
        )
        self._take_off: Event | None = None
        self._landing: Event | None = None
        self._longest = self._peak = 0.0
        self._lengths: list[float] = []  # paid out while the rover flies [m]
        self.flight.sim.observers.append(self._on_tick)
        self.flight.run(3.0)  # touchdown is detected

    def _on_tick(self, tick: Tick[SpatialState]) -> None:
        for event in tick.result.events:
            if event.name == PlantEvent.LATCH_RELEASED:
                self._peak = 0.0
            elif event.name == PlantEvent.TAKE_OFF:
                self._take_off = self._take_off or event
            elif event.name == PlantEvent.TOUCHDOWN and self._take_off is not None:
                self._landing = self._landing or event
        self._longest = max(self._longest, chord(self.flight))
        self._peak = max(self._peak, tick.result.peak_tension)
        if self._take_off is not None and self._landing is None:
            self._lengths.append(tick.after.length)

    def take_up(self) -> None:
        """Reel in until the tether is taut."""
        request(self.flight, machine.WINCH_SLACK, 0.0)
        self._until(
            lambda: self.flight.winch.mode is WinchMode.HOLD and self.flight.winch.servo.is_at_rest,
            "the slack is not taken up",
        )

    def give(self, slack: float) -> None:
        """Give slack, and wait until the drum stands."""
        request(self.flight, machine.WINCH_SLACK, slack)
        self.flight.run(0.2)
        self._until(lambda: self.flight.winch.servo.is_at_rest, "the slack is not given")

    def fly(self, renew: Callable[[], None] = lambda: None) -> Jumped:
        """Compress, take off, land and come to rest."""
        begun = self._longest = chord(self.flight)
        self.flight.request(topics.JUMP_REQUEST, machine.JUMP_STROKE, self._jump.stroke, _NUT_SPEED)
        ended = JumpEvent.HOOKING, JumpEvent.STANDBY, JumpEvent.FAULT

        def is_over() -> bool:
            renew()
            return any(self.flight.events_named(name, "jump_node") for name in ended)

        self._until(is_over, "the jump does not end")
        self._until(lambda: not self.flight.winch.motion.jump, "the winch does not receive the end")
        take_off, landing = self._take_off, self._landing
        if take_off is None or landing is None:
            raise RuntimeError("the rover has not flown")
        places = [(event.values["x"], event.values["y"]) for event in (take_off, landing)]
        distance, time = math.dist(*places), landing.time - take_off.time
        reeled_in = float(np.max(np.maximum.accumulate(self._lengths) - self._lengths))
        return Jumped(distance, time, self._longest - begun, self._peak, reeled_in)

    def after(self, jumped: Jumped) -> Jumped:
        """Wait until the slack is taken up, as the winch does by itself after the landing."""
        winch = self.flight.winch
        self._until(
            lambda: winch.mode is WinchMode.HOLD and winch.servo.is_at_rest,
            "the slack is not taken up",
        )
        return jumped._replace(peak_tension=self._peak, slack_left=slack(self.flight))

    def _until(self, done: Callable[[], bool], complaint: str) -> None:
        if not self.flight.run(_PATIENCE, done):
            last = self.flight.events[-1].status.message
            raise RuntimeError(f"{complaint} within {_PATIENCE:g} s: {self._jump}; {last}")


@cache
def free_jump(jump: AssistedJump, seed: int) -> Jumped:
    """The jump without a tether."""
    return Trip(jump, seed, tethered=False).fly()


@cache
def helped_jump(jump: AssistedJump, seed: int) -> Jumped:
    """The jump with slack given before, as much as the chord will grow and a margin."""
    trip = Trip(jump, seed)
    trip.take_up()
    trip.give(max(free_jump(jump, seed).growth, 0.0) + _MARGIN)
    return trip.after(trip.fly())


@cache
def held_jump(jump: AssistedJump, seed: int, tension: float) -> Jumped:
    """The same under a constant tension [N] instead, for comparison."""
    trip = Trip(jump, seed)
    trip.take_up()
    flight, renewed = trip.flight, -math.inf

    def renew() -> None:
        nonlocal renewed
        if flight.time - renewed > _RENEWAL:
            renewed = flight.time
            flight.request(topics.WINCH_REQUEST, machine.WINCH_AT_TENSION, 0.0, 0.3, tension)

    return trip.fly(renew)


def draw_jump(generator: np.random.Generator) -> AssistedJump:
    """Draw a jump."""
    return AssistedJump(
        depth=float(generator.choice([5.0, 15.0, 45.0])),
        away=round(float(generator.uniform(1.0, 4.0)), 3),
        slope=round(float(generator.uniform(8.0, 13.0)), 2),
        stroke=round(float(generator.uniform(0.12, 0.2)), 3),
    )


def assisted(
    batch: CheckBatch, quantity: Literal["range", "time", "peak_tension", "reeled_in"]
) -> Measured:
    """Largest value of a field of `Jumped`; of range and time, relative to that without a tether.

    The details compare the first jump with one under a constant tension.
    """
    details, values, growth, left = {}, [], 0.0, 0.0
    for index, generator in enumerate(batch.generators()):
        jump = draw_jump(generator)
        free, helped = free_jump(jump, batch.seed), helped_jump(jump, batch.seed)
        value, without = getattr(helped, quantity), getattr(free, quantity)
        values.append(abs(value / without - 1.0) if quantity in ("range", "time") else value)
        growth = max(growth, free.growth)
        left = max(left, helped.slack_left)
        where = f"{index}: {described(jump)}"
        details[f"{where}, with slack"] = described(helped)
        details[f"{where}, without tether"] = described(free)
        if index == 0:
            held = held_jump(jump, batch.seed, _HELD)
            details[f"{where}, with {_HELD:g} N held"] = described(held)
    note = (
        f"{len(values)} jumps down slopes at 5, 15 and 45 m; the chord grows by up to "
        f"{growth:.2f} m, {left:.2f} m of slack remain at most after it is taken up"
    )
    return Measured(max(values), note, details)
