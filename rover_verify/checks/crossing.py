"""Crossings of rubble with different rules for choosing between wheels and jump.

The rover must cover 1.5 m straight ahead. Where its wheels get stuck, a rule chooses a detour by
wheels (left turn, straight segment, rest of the full turn) or a jump with turning wheels. The
motions are open loop; their ends and the results use the ground truth. The rules know the attitude
at rest, the position and the earlier attempts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from msg_schemas.events import PlantEvent
from rover_control.jump_prediction import PredictionParameters, PredictionRequest, RoverStance
from rover_control.jump_predictor import JumpPredictor
from rover_control.jump_spring import SpringEstimate, SpringParameters
from rover_control.locomotion import (
    JumpAssessment,
    LocomotionMode,
    LocomotionParameters,
    LocomotionSituation,
    choose,
    slack_value,
)
from rover_sim import (
    Command,
    JumpMotorCommand,
    SettlingError,
    SpatialPlant,
    WheelRateCommand,
    load_scenario,
)
from rover_sim.physics.jump_drive import Latch
from rover_verify.checks import Batch, Measured
from rover_verify.checks.flights import fly_batch

_RUNS = 20
_GOAL = 1.5  # distance ahead [m]
_LIMIT = 150.0  # [s]
_TICK = 0.05  # [s]
_RATE = 0.8  # wheel rate [rad/s]
_TORQUE = 2.0  # limit of the wheel motor [N m]
_PROGRESS = 0.02  # least progress [m],
_PATIENCE = 6.0  # within this time, else the wheels are stuck [s]
_CLEARANCE = 0.20  # of a jump [m]
_NUT_SPEED = 0.09  # [m/s]
_TOPPLED = 1.0  # tilt [rad]
_UPRIGHT = 0.35  # largest initial tilt [rad]
_FLOOR = 5.0  # depth below the fairlead [m]
_TURN = 0.8  # left turn of a detour [rad]
_DETOUR_TIME = 6.0  # driving time of a detour [s]
_RULES = ("wheels", "jump", "slack", "risk")
_BOULDERS = {"exponent": 2.5, "height_ratio": 0.4, "clear_radius": 0.3}
_GROUNDS = {
    "sparse": {"density": 1.0, "smallest": 0.1, "largest": 0.6},
    "dense": {"density": 3.0, "smallest": 0.15, "largest": 0.7},
}


class Crossing(NamedTuple):
    """Result of a crossing."""

    end: str  # "across", "toppled", "late" or another reason
    time: float  # [s]
    energy: float  # input by the motors [J]
    jumps: int
    detours: int
    stuck: int

    @property
    def has_failed(self) -> bool:
        """Whether the rover did not get across."""
        return self.end != "across"


class _CrossingRover:
    """A rover during a crossing."""

    def __init__(self, generator: np.random.Generator, ground: str) -> None:
        self.plant = SpatialPlant(
            load_scenario(
                "floor_rubble",
                {
                    "environment.seed": int(generator.integers(1, 2**31 - 1)),
                    "environment.boulders": {**_BOULDERS, **_GROUNDS[ground]},
                    "start.position": [round(float(generator.uniform(1.0, 6.0)), 3), 0.0],
                    "start.heading": round(float(generator.uniform(-180.0, 180.0)), 2),
                    "start.settling_time": 300.0,
                    "tether.length": 14.0,
                    "tether.element_length": 1.0,
                    "integration.h": 2.0e-3,
                },
            )
        )  # fmt: skip
        self.state = self.plant.initial_state()
        self._start = self.state.G1.copy()
        self._ahead = self.state.rotation[:2, 0] / np.linalg.norm(self.state.rotation[:2, 0])
        self.best = 0.0
        self.jumps = self.detours = self.stuck = 0
        self.energy = 0.0

    @property
    def progress(self) -> float:
        """Progress towards the goal [m]."""
        return float((self.state.G1 - self._start)[:2] @ self._ahead)

    @property
    def heading(self) -> float:
        x, y = self.state.rotation[:2, 0]
        return math.atan2(y, x)

    @property
    def end(self) -> str:
        """Why the crossing has ended; empty = it has not."""
        if self.state.phase.final:
            return self.state.phase.value
        if float(self.state.rotation[2, 2]) < math.cos(_TOPPLED):
            return "toppled"
        if self.progress >= _GOAL:
            return "across"
        return "late" if self.state.time >= _LIMIT else ""

    def step(self, rate: float | None, jump: JumpMotorCommand | None = None) -> bool:
        """Advance one tick; whether the latch tripped in it."""
        wheel = None if rate is None else WheelRateCommand(rate, _TORQUE)
        self.state, result = self.plant.step(self.state, Command(jump, None, wheel), _TICK)
        self.energy = result.energies.input
        return any(event.name == PlantEvent.LATCH_RELEASED for event in result.events)

    def go(self, rate: float | None, time: float, done: Callable[[], bool] = lambda: False) -> None:
        """Drive for a time [s], or until `done`."""
        deadline = self.state.time + time
        while self.state.time < deadline and not self.end and not done():
            self.step(rate)

    def drive(self) -> None:
        """Drive ahead until the goal or until the wheels are stuck."""
        since, reached = self.state.time, self.progress
        while not self.end and self.state.time - since < _PATIENCE:
            self.step(_RATE)
            if self.progress > reached + _PROGRESS:
                since, reached = self.state.time, self.progress
        self.best = max(self.best, reached)

    def detour(self) -> None:
        """Turn left, drive, and turn on to the initial heading."""
        self.detours += 1
        for turn in (_TURN, math.tau - _TURN):
            last, turned = self.heading, 0.0
            deadline = self.state.time + 1.5 * turn * 0.44 / (0.15 * _RATE)
            while turned < turn and self.state.time < deadline and not self.end:
                self.step(-_RATE)
                turned += math.remainder(self.heading - last, math.tau)
                last = self.heading
            if turn == _TURN:
                self.go(_RATE, _DETOUR_TIME)

    def jump(self, stroke: float) -> None:
        """Compress at rest, jump with turning wheels, hook the latch again."""
        self.jumps += 1
        deadline = self.state.time + 10.0
        tripped = False
        while not tripped and self.state.time < deadline and not self.end:
            tripped = self.step(None, JumpMotorCommand(stroke, _NUT_SPEED))
        self.go(_RATE, 2.5)
        deadline = self.state.time + 10.0
        hook = JumpMotorCommand(-0.03, _NUT_SPEED)
        while self.state.time < deadline and not self.end:
            self.step(None, hook)
            if self.state.latch is Latch.FREE and self.state.nut < -0.029:
                break

    def stance(self) -> RoverStance:
        """Pose of the rover and its tether."""
        x, y, _ = self.state.G1.tolist()
        up = self.state.rotation[2].tolist()
        return RoverStance(x, y, self.heading, (up[0], up[1], up[2]), self.state.length)


def cross(seed: int, index: int, rule: str, ground: str = "sparse") -> Crossing:
    """One crossing with `wheels` or `jump` only, or with a rule of `rover_control.locomotion`."""
    generator = np.random.default_rng([seed, index, 63])
    rover = None
    while rover is None:
        with suppress(SettlingError):  # it does not settle there: try another place
            candidate = _CrossingRover(generator, ground)
            rover = candidate if candidate.stance().tilt < _UPRIGHT else None
    settings = LocomotionParameters(locomotion_rule=rule if rule in ("slack", "risk") else "risk")
    parameters = PredictionParameters(floor_depth=_FLOOR, min_upright_probability=0.0)
    predictor, spring = JumpPredictor(parameters), SpringEstimate(SpringParameters())
    nominal_stroke = spring.stroke_for(_CLEARANCE)
    stuck = jumped = 0
    last_mode: LocomotionMode | None = None  # last choice at this place
    stuck_progress = -math.inf
    rover.drive()
    while not rover.end:
        if rover.best > stuck_progress + 0.1:
            stuck = jumped = 0
            last_mode = None
        stuck_progress = max(stuck_progress, rover.best)
        stuck += stuck == 0 or last_mode is LocomotionMode.WHEELS
        jumped += last_mode is LocomotionMode.JUMP
        rover.stuck += 1
        rover.go(None, 1.0)
        stance = rover.stance()
        prediction = None
        if rule == "risk":
            prediction_request = PredictionRequest(stance, _CLEARANCE, False, rover.stuck)
            prediction = predictor.predict(prediction_request, spring)
        drop = _FLOOR - parameters.attachment_height
        around = LocomotionSituation(
            slack_value(stance.x, stance.y, drop),
            rover.plant.scenario.tether.section.axial_stiffness,
            0.0,
            stuck,
            jumped,
            None
            if prediction is None
            else JumpAssessment(prediction.upright, prediction.rejection),
        )
        mode = LocomotionMode(rule) if rule in ("wheels", "jump") else choose(settings, around).mode
        if mode is LocomotionMode.JUMP:
            rover.jump(
                nominal_stroke if prediction is None or prediction.rejection else prediction.stroke
            )
        else:
            rover.detour()
        last_mode = mode
        rover.drive()
    return Crossing(
        rover.end, rover.state.time, rover.energy, rover.jumps, rover.detours, rover.stuck
    )


def risk_against_slack(batch: Batch) -> Measured:
    """Crossings of sparse rubble that fail with the rule `risk`, less those with the rule `slack`.

    The details also report dense rubble, which stops most rovers.
    """
    runs = batch.runs if batch.runs > 0 else _RUNS
    details: dict[str, float | str] = {}
    by_ground = {
        ground: {rule: fly_batch(batch, runs, cross, rule, ground) for rule in _RULES}
        for ground in _GROUNDS
    }
    for ground, by_rule in by_ground.items():
        details |= _table(ground, by_rule, runs)
    failed = {rule: sum(each.has_failed for each in by_ground["sparse"][rule]) for rule in _RULES}
    note = f"{runs} crossings: {failed['risk']} fail with risk, {failed['slack']} with slack"
    return Measured(float(failed["risk"] - failed["slack"]), note, details)


def _table(
    ground: str, by_rule: Mapping[str, Sequence[Crossing]], runs: int
) -> dict[str, float | str]:
    details: dict[str, float | str] = {}
    for rule, crossings in by_rule.items():
        across = [crossing for crossing in crossings if not crossing.has_failed]
        time = np.mean([crossing.time for crossing in across]) if across else math.nan
        energy = np.mean([crossing.energy for crossing in across]) if across else math.nan
        details[f"{ground}, {rule}"] = (
            f"{len(across)} of {runs} across, "
            f"{sum(crossing.end == 'toppled' for crossing in crossings)} toppled, "
            f"{sum(crossing.jumps for crossing in crossings)} jumps, "
            f"{sum(crossing.detours for crossing in crossings)} detours; mean of those across "
            f"{time:.0f} s, {energy:.0f} J"
        )
    for index in range(runs):
        deadline = ", ".join(f"{rule} {by_rule[rule][index].end}" for rule in _RULES)
        details[f"{ground}, crossing {index}"] = deadline
    return details
