"""Jump with the winch, compared with the same jump without a tether, on the spatial plant.

The rover stands on a slope that falls away from the mother machine, so that it jumps down and away
and the chord to the fairlead grows. The winch takes the tether up until it is taut, gives the
slack that the chord will need, stands still during the flight, and takes up the rest after the
landing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_schemas.events import PlantEvent
from msg_schemas.machine import WINCH_AT_TENSION, WINCH_SLACK
from msg_schemas.phases import JumpPhase, WinchMode
from rover_sim import Event, JumpMotorCommand
from rover_verify.checks import Batch, Measured
from rover_verify.checks.winch_rig import SensorErrors, Session
from rover_verify.checks.winch_spatial import SpatialRig
from tether_winch.winch import Winch, WinchParameters

_ERRORS = SensorErrors(cell_noise=0.05, cell_bias=0.05, rate_noise=0.002, current_noise=0.01)
_NUT_SPEED = 0.05  # [m/s]
_MARGIN = 0.15  # of the slack beyond the chord's growth [m]
_HELD = 1.5  # constant tension of the comparison [N]
# A tether without influence: a thousandth of the default's weight.
_NO_TETHER = {"tether.line_density": 5e-6, "tether.bending_stiffness": 1e-7}
_SETTLING = 3.0  # from the landing until the rover stands [s]
_PATIENCE = 60.0  # [s]


class Jump(NamedTuple):
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


class Flight(NamedTuple):
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


@cache
def free_jump(jump: Jump) -> Flight:
    """The jump without a tether."""
    rig = SpatialRig({**jump.overrides(), **_NO_TETHER})
    rig.step(None, 0.01)
    chord = _chord(rig)
    rig.jump = JumpMotorCommand(jump.stroke, _NUT_SPEED)
    longest = chord
    for _ in range(round(_PATIENCE / 0.01)):
        rig.step(None, 0.01)
        if _event(rig.events, PlantEvent.TAKE_OFF) is not None:
            rig.jump = None
            longest = max(longest, _chord(rig))
        if _landing(rig.events) is not None:
            break
    distance, time = _flown(rig.events)
    for _ in range(round(_SETTLING / 0.01)):  # the rover still slides
        rig.step(None, 0.01)
        longest = max(longest, _chord(rig))
    return Flight(distance, time, longest - chord)


class _Trip:
    """A jump with the winch at work."""

    def __init__(self, jump: Jump, seed: int) -> None:
        self.jump = jump
        self.rig = SpatialRig(jump.overrides())
        winch = Winch(WinchParameters())
        self.session = Session(winch, self.rig, _ERRORS, np.random.default_rng(seed))
        self.session.arm()
        self.session.run(3.0)  # touchdown is detected

    def take_up(self) -> None:
        """Reel in until the tether is taut."""
        self.session.request(WINCH_SLACK, 0.0)
        self._until(lambda: self.session.winch.mode is WinchMode.HOLD, "the slack is not taken up")
        self._until(lambda: self.session.winch.servo.is_at_rest, "the brake does not close")

    def give(self, slack: float) -> None:
        """Give slack, and wait until the drum stands."""
        self.session.request(WINCH_SLACK, slack)
        self.session.run(0.2)
        self._until(lambda: self.session.winch.servo.is_at_rest, "the slack is not given")

    def fly(self, renew: Callable[[], None] = lambda: None) -> Flight:
        """Compress, take off, land, settle; with the phases reported to the winch."""
        session, rig, winch = self.session, self.rig, self.session.winch
        winch.on_jump(JumpPhase.COMPRESSING, session.now_ns)
        chord = longest = _chord(rig)
        rig.jump = JumpMotorCommand(self.jump.stroke, _NUT_SPEED)

        def go(done: Callable[[], bool], complaint: str) -> None:
            nonlocal longest

            def look() -> bool:
                nonlocal longest
                renew()
                longest = max(longest, _chord(rig))
                return done()

            self._until(look, complaint)

        go(
            lambda: _event(rig.events, PlantEvent.LATCH_RELEASED) is not None,
            "the latch does not trip",
        )
        rig.peak_tension = 0.0
        go(lambda: _event(rig.events, PlantEvent.TAKE_OFF) is not None, "it does not take off")
        rig.jump = None
        winch.on_jump(JumpPhase.FLIGHT, session.now_ns)
        begun = len(session.ticks)
        go(lambda: _landing(rig.events) is not None, "it does not land")
        distance, time = _flown(rig.events)
        lengths: NDArray[np.float64] = session.column("length")[begun - 1 :]
        reeled_in = float(np.max(np.maximum.accumulate(lengths) - lengths))
        winch.on_jump(JumpPhase.LANDED, session.now_ns)
        session.run(_SETTLING)
        winch.on_jump(JumpPhase.STANDBY, session.now_ns)
        return Flight(distance, time, longest - chord, rig.peak_tension, reeled_in)

    def after(self, flight: Flight) -> Flight:
        """Wait until the slack is taken up, as the winch does by itself after the landing."""
        self._until(
            lambda: self.session.winch.mode is not WinchMode.SLACK, "the slack is not taken up"
        )
        self._until(lambda: self.session.winch.servo.is_at_rest, "the brake does not close")
        return flight._replace(peak_tension=self.rig.peak_tension, slack_left=self.rig.slack)

    def _until(self, done: Callable[[], bool], complaint: str) -> None:
        for _ in range(round(_PATIENCE / 0.01)):
            if done():
                return
            self.session.tick()
        raise RuntimeError(f"{complaint} within {_PATIENCE:g} s: {self.jump}")


@cache
def helped_jump(jump: Jump, seed: int) -> Flight:
    """The jump with slack given before, as much as the chord will grow and a margin."""
    trip = _Trip(jump, seed)
    trip.take_up()
    trip.give(max(free_jump(jump).growth, 0.0) + _MARGIN)
    return trip.after(trip.fly())


@cache
def held_jump(jump: Jump, seed: int, tension: float) -> Flight:
    """The same under a constant tension [N] instead, for comparison."""
    trip = _Trip(jump, seed)
    trip.take_up()

    def renew() -> None:
        if round(trip.session.time * 100.0) % 50 == 0:
            trip.session.request(WINCH_AT_TENSION, 0.0, 0.3, tension)

    trip.session.request(WINCH_AT_TENSION, 0.0, 0.3, tension)
    return trip.fly(renew)


def draw_jump(generator: np.random.Generator) -> Jump:
    """Draw a jump."""
    return Jump(
        depth=float(generator.choice([5.0, 15.0, 45.0])),
        away=round(float(generator.uniform(1.0, 4.0)), 3),
        slope=round(float(generator.uniform(8.0, 13.0)), 2),
        stroke=round(float(generator.uniform(0.12, 0.2)), 3),
    )


def _measured(batch: Batch, figure: Callable[[Flight, Flight], float]) -> Measured:
    details: dict[str, float | str] = {}
    values, growth, left = [], 0.0, 0.0
    for index, generator in enumerate(batch.generators()):
        jump = draw_jump(generator)
        free, helped = free_jump(jump), helped_jump(jump, batch.seed)
        values.append(figure(free, helped))
        growth = max(growth, free.growth)
        left = max(left, helped.slack_left)
        details[f"{index}: {_text(jump)}"] = (
            f"range {helped.range:.4f} m, without tether {free.range:.4f} m; flight "
            f"{helped.time:.3f} s, {free.time:.3f} s; peak {helped.peak_tension:.2f} N; reeled in "
            f"in flight {helped.reeled_in:.2g} m"
        )
        if index == 0:
            held = held_jump(jump, batch.seed, _HELD)
            details[f"{index}: the same with {_HELD:g} N held instead of slack"] = (
                f"range {held.range:.4f} m, flight {held.time:.3f} s, reeled in in flight "
                f"{held.reeled_in:.2g} m, peak {held.peak_tension:.2f} N"
            )
    note = (
        f"{len(values)} jumps down slopes at 5, 15 and 45 m; the chord grows by up to "
        f"{growth:.2f} m, {left:.2f} m of slack remain at most after it is taken up"
    )
    return Measured(max(values), note, details)


def _text(jump: Jump) -> str:
    return f"{jump.depth:g} m deep, {jump.away:g} m away, {jump.slope:g} deg, {jump.stroke:g} m"


def range_error(batch: Batch) -> Measured:
    """Largest relative deviation of the range from that without a tether."""
    return _measured(batch, lambda free, helped: abs(helped.range / free.range - 1.0))


def time_error(batch: Batch) -> Measured:
    """Largest relative deviation of the flight time from that without a tether."""
    return _measured(batch, lambda free, helped: abs(helped.time / free.time - 1.0))


def peak_tension(batch: Batch) -> Measured:
    """Largest tension [N] from the release until the slack is taken up again."""
    return _measured(batch, lambda _free, helped: helped.peak_tension)


def reeled_in_flight(batch: Batch) -> Measured:
    """Most tether [m] that was reeled in while the rover flew."""
    return _measured(batch, lambda _free, helped: helped.reeled_in)


def _chord(rig: SpatialRig) -> float:
    x, y, z = rig.state.nodes[-1, 0]
    return math.sqrt(x * x + y * y + z * z)


def _event(events: list[Event], name: str, after: str = "") -> Event | None:
    """The first event of a name, after the first of another."""
    begun = not after
    for event in events:
        if begun and event.name == name:
            return event
        begun = begun or event.name == after
    return None


def _landing(events: list[Event]) -> Event | None:
    return _event(events, PlantEvent.TOUCHDOWN, after=PlantEvent.TAKE_OFF)


def _flown(events: list[Event]) -> tuple[float, float]:
    """Range [m] and time [s] of the first flight."""
    begun, ended = _event(events, PlantEvent.TAKE_OFF), _landing(events)
    if begun is None or ended is None:
        raise RuntimeError("the rover has not flown")
    return math.dist(_place(begun.values), _place(ended.values)), ended.time - begun.time


def _place(values: Mapping[str, float]) -> tuple[float, float]:
    return values["x"], values["y"]
