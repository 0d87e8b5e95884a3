"""Accuracy of jumps with an unknown spring, and of their predictions."""

from __future__ import annotations

import math
import time
from typing import Literal, NamedTuple

import numpy as np
from scipy.stats import binomtest

from msg_schemas import machine, topics
from msg_schemas.phases import JumpPhase
from msg_schemas.samples import JointSample, Sample, TextSample
from rover_control.prediction.jump_prediction import (
    Interval,
    PredictionParameters,
    PredictionRequest,
    RoverStance,
)
from rover_control.prediction.jump_predictor import JumpPredictor
from rover_control.prediction.jump_spring import SpringEstimate, SpringParameters
from rover_verify.checks import CheckBatch, Measured, per_run
from rover_verify.checks.flights import fly_batch
from rover_verify.checks.floor import Stand, start_on_floor
from rover_verify.harness.flight import JUMP, Flight

_JUMPS = 6  # per rover
_CONFIDENCE = 0.99
_OPEN_LOOP = 5  # rovers without spring adaptation, for comparison
_STROKE_ERROR = 2.0e-3  # [m]
_HEIGHTS = (0.08, 0.35)  # requested [m]
_NEAR = 0.10
_TILT = math.radians(5.0)  # largest inclination of the floor [rad]
_ACCEPTED = 0.3  # time until a request is accepted [s]
_CLEARANCES = (0.08, 0.30)  # [m]
_PREDICTIONS = 10  # timed predictions


class FlownJump(NamedTuple):
    """A requested jump and its result."""

    requested_height: float  # [m]
    flown: float  # true [m]; nan = no take-off
    measured: float  # measured by the rover [m]; nan = not measured
    reason: str  # why there was no jump, or how it ended

    @property
    def is_near(self) -> bool:
        """Whether the height is within 10 % of the requested one."""
        return abs(self.flown / self.requested_height - 1.0) <= _NEAR


class Jumper:
    """Lets a rover jump and measures its true heights.

    Args:
        flight: of the rover, with ``jump_node``.

    Attributes:
        stroke_error: true nut position less the measured one [m].
        heights: true rise of Body 1 in each jump [m].
    """

    def __init__(self, flight: Flight) -> None:
        self.flight = flight
        self.stroke_error = 0.0
        self.heights: list[float] = []
        self._standing = self._top = math.nan
        flight.sim.observers.append(lambda tick: self._on_height(float(tick.after.G1[2])))
        flight.keep(topics.JUMP_FLOWN, topics.JUMP_PREDICTION)
        host = flight.host
        host.exchange.listen(self._on_phase, topics.JUMP_PHASE)
        host.exchange.impair(topics.JUMP_MOTOR_COMMAND, lambda each: self._displaced(each, 1.0))
        host.exchange.impair(topics.JUMP_MOTOR_STATE, lambda each: self._displaced(each, -1.0))

    @property
    def phase(self) -> str:
        """Phase of the jump controller."""
        return self.flight.phases[topics.JUMP_PHASE]

    @property
    def reason(self) -> str:
        """How the last jump ended, or why there was none."""
        texts = [(e.time, e.status.message) for e in self.flight.events if e.node == "jump_node"]
        texts += [(at, str(each)) for at, each in self.flight.refusals]
        return max(texts)[1] if texts else ""

    def jump(self, value: float, joint: str = machine.JUMP_HEIGHT, limit: float = 60.0) -> float:
        """Request a jump; returns its true height [m] after its end, nan = no take-off."""
        flown = len(self.heights)
        self.flight.request(topics.JUMP_REQUEST, joint, value)
        self.flight.run(_ACCEPTED, lambda: self.phase != JumpPhase.STANDBY)
        self.flight.run(limit, lambda: self.phase in (JumpPhase.STANDBY, JumpPhase.FAULT))
        return self.heights[-1] if len(self.heights) > flown else math.nan

    def _on_height(self, height: float) -> None:
        self._top = max(self._top, height)

    def _on_phase(self, _name: str, sample: Sample, _sender: str, _now_ns: int) -> None:
        assert isinstance(sample, TextSample)
        if sample.text == JumpPhase.RELEASING:
            self._standing = self._top = float(self.flight.state.G1[2])
        elif sample.text == JumpPhase.LANDED:
            self.heights.append(self._top - self._standing)

    def _displaced(self, sample: Sample, sign: float) -> Sample:
        """Displace the nut's setpoint, and its measured position back."""
        assert isinstance(sample, JointSample)
        nut = sample.joints[machine.JUMP_SCREW]
        largest = self.flight.plant.model.jump.stroke  # beyond it the plant refuses
        position = min(nut.position + sign * self.stroke_error, largest)
        joints = {**sample.joints, machine.JUMP_SCREW: nut._replace(position=position)}
        return JointSample(sample.stamp_ns, joints)


def _rover(seed: int, index: int, purpose: int) -> tuple[np.random.Generator, Jumper]:
    """A rover at a random place on a tilted floor, with a spring off by up to 5 %."""
    generator = np.random.default_rng([seed, index, purpose])
    stand = Stand(
        x=round(float(generator.uniform(0.5, 3.0)), 3),
        heading=round(float(generator.uniform(-math.pi, math.pi)), 3),
        slope=round(float(generator.uniform(0.0, _TILT)), 5),
        downhill=round(float(generator.uniform(-math.pi, math.pi)), 3),
        spring=round(float(generator.uniform(0.95, 1.05)), 5),
    )
    return generator, Jumper(start_on_floor(JUMP, stand.overrides(), 1000 * seed + index))


def jumps_of(seed: int, index: int, adapts: bool) -> tuple[FlownJump, ...]:
    """The jumps of one rover: its spring off by up to 5 %, each stroke by up to 2 mm."""
    generator, rover = _rover(seed, index, 61)
    flight, found = rover.flight, []
    for _ in range(_JUMPS):
        requested_height = float(generator.uniform(*_HEIGHTS))
        rover.stroke_error = float(generator.uniform(-_STROKE_ERROR, _STROKE_ERROR))
        if not adapts:  # the spring estimate lasts as long as the node
            flight.kill("jump_node")
            flight.restart("jump_node")
            flight.run(1.0)
        flight.last.pop(topics.JUMP_FLOWN, None)
        flown, record = rover.jump(requested_height), flight.last.get(topics.JUMP_FLOWN)
        measured = math.nan
        if isinstance(record, JointSample):
            measured = record.joints[machine.JUMP_HEIGHT].position
        found.append(FlownJump(requested_height, flown, measured, rover.reason))
    return tuple(found)


def height_reached(batch: CheckBatch) -> Measured:
    """Share of jumps within 10 % of the requested height."""
    runs = batch.runs
    rovers = fly_batch(batch, runs, jumps_of, True)
    open_loop = fly_batch(batch, min(runs, _OPEN_LOOP), jumps_of, False)
    jumps = [jump for rover in rovers for jump in rover]
    first = [rover[0] for rover in rovers]
    errors = np.array([abs(jump.measured - jump.flown) for jump in jumps])
    details: dict[str, float | str] = {
        "without adaptation": _share([jump for rover in open_loop for jump in rover]),
        "first jumps": _share(first),
        "later jumps": _share([jump for rover in rovers for jump in rover[1:]]),
        "largest error of the measured height [m]": float(np.nanmax(errors)),
        "jumps not measured": float(np.isnan(errors).sum()),
        **per_run(jumps),
    }
    note = f"{len(jumps)} jumps of {runs} rovers, {_HEIGHTS[0]:g} to {_HEIGHTS[1]:g} m"
    return Measured(_share(jumps), note, details)


class Predicted(NamedTuple):
    """A jump by clearance, predicted and flown."""

    clearance: float  # [m]
    height: Interval  # predicted [m]
    flown: float  # true [m]; nan = no jump
    upright: float  # predicted probability of landing upright
    landed_upright: bool  # whether the rover landed upright
    reason: str  # how it ended

    @property
    def is_held(self) -> bool:
        """Whether the flown height lies in the 90 % interval."""
        return self.height.low <= self.flown <= self.height.high


def predicted_of(seed: int, index: int) -> tuple[Predicted, ...]:
    """The jumps of one rover by clearance, with the same spring errors as in `jumps_of`."""
    generator, rover = _rover(seed, index, 62)
    flight, found = rover.flight, []
    for _ in range(_JUMPS):
        clearance = float(generator.uniform(*_CLEARANCES))
        rover.stroke_error = float(generator.uniform(-_STROKE_ERROR, _STROKE_ERROR))
        flown = rover.jump(clearance, machine.JUMP_CLEARANCE)
        prediction = flight.last[topics.JUMP_PREDICTION]
        assert isinstance(prediction, JointSample)
        height = Interval(*prediction.joints[machine.JUMP_HEIGHT])
        upright = prediction.joints[machine.UPRIGHT].position
        landed_upright = rover.phase != JumpPhase.FAULT
        found.append(Predicted(clearance, height, flown, upright, landed_upright, rover.reason))
        if not landed_upright:
            break
    return tuple(found)


def interval_share(batch: CheckBatch, end: Literal["low", "high"]) -> Measured:
    """Smallest or largest plausible share of flown heights in the predicted 90 % interval.

    Too narrow an interval holds few of them, too wide a one all.
    """
    runs = batch.runs
    rovers = fly_batch(batch, runs, predicted_of)
    jumps = [jump for rover in rovers for jump in rover]
    flown = [jump for jump in jumps if not math.isnan(jump.flown)]
    details: dict[str, float | str] = {
        "refused": float(len(jumps) - len(flown)),
        "clearances reached": float(np.mean([jump.flown >= jump.clearance for jump in flown])),
        "landed upright": float(np.mean([jump.landed_upright for jump in flown])),
        "predicted share upright": float(np.mean([jump.upright for jump in flown])),
        "half width of the interval over its median, mean": float(
            np.mean([0.5 * (j.height.high - j.height.low) / j.height.median for j in flown])
        ),
        **per_run(jumps),
    }
    held = sum(jump.is_held for jump in flown)
    # Few jumps show the share roughly: it is judged by what they do not exclude.
    interval = binomtest(held, len(flown)).proportion_ci(_CONFIDENCE)
    note = (
        f"{held} of {len(flown)} jumps of {runs} rovers, {len(jumps) - len(flown)} refused; "
        f"{100 * _CONFIDENCE:g} % interval of the share {interval.low:.2f} to {interval.high:.2f}"
    )
    return Measured(float(getattr(interval, end)), note, details)


def prediction_time(batch: CheckBatch) -> Measured:
    """Longest wall time [s] of predictions at new places, with the model loaded."""
    predictor = JumpPredictor(PredictionParameters(floor_depth=6.0))
    spring = SpringEstimate(SpringParameters())
    wall_time, used, rollouts = [], [], math.inf
    for index, generator in enumerate(batch.generators(_PREDICTIONS + 1)):
        lean = generator.uniform(-0.08, 0.08, 2)
        stance = RoverStance(
            x=float(generator.uniform(0.5, 3.0)),
            y=float(generator.uniform(-1.0, 1.0)),
            heading=float(generator.uniform(-math.pi, math.pi)),
            up=(float(lean[0]), float(lean[1]), 1.0),
            length=math.nan,
        )
        height = float(generator.uniform(*_CLEARANCES))
        started, processor = time.monotonic(), time.process_time()
        prediction = predictor.predict(PredictionRequest(stance, height, index), spring)
        if index > 0:  # the first one loads compiled code
            wall_time.append(time.monotonic() - started)
            used.append(time.process_time() - processor)
            rollouts = min(rollouts, prediction.rollouts)
    details: dict[str, float | str] = {
        "wall time, median [s]": float(np.median(wall_time)),
        "processor time, largest [s]": max(used),
        "rollouts, fewest": rollouts,
    }
    return Measured(max(wall_time), f"{_PREDICTIONS} predictions, 2 threads", details)


def _share(jumps: list[FlownJump]) -> float:
    return float(np.mean([jump.is_near for jump in jumps]))
