"""Prediction of a jump by Monte Carlo rollouts of the simulator's plant.

The model places the rover at its estimated pose, on a plane floor with the rover's inclination and
with the present or future tether length, and lets it settle once. From there it simulates many
jumps, each with an own spring, stroke and attitude drawn from their distributions. The ratio of the
simulated heights to the nominal ones is attributed to the place; the remaining uncertainty of the
height is that of the spring, estimated from earlier jumps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import rover_sim
from msg_schemas.events import PlantEvent
from rover_control.prediction.jump_prediction import (
    Interval,
    JumpPrediction,
    PredictionParameters,
    PredictionRequest,
    RoverStance,
    rejected_prediction,
)
from rover_control.prediction.jump_spring import SpringEstimate

_TICK = 0.05  # tick of the plant [s]
_RELEASE = 0.15  # time from release to take-off [s]
_AFTER_TOUCHDOWN = 1.0  # simulated time after the touchdown [s]
_NUT_SPEED = 0.05  # [m/s]
_SETTLE_LIMIT = 45.0  # time limit for settling, in model time [s]
_CREEP = 0.05  # residual speed that counts as settled: rolling down a slope, sliding tether [m/s]
_WORKERS = 2  # threads that simulate in parallel
_DECIMALS = 3  # of a placement: the rover stands still, its estimates do not quite


class _Placement(NamedTuple):
    """Where the model places the rover."""

    x: float  # [m]
    y: float
    heading: float  # [rad]
    slope: float  # of the floor [rad]
    downhill: float  # direction [rad]
    slack: float  # [m]
    drop: float  # depth of the attachment below the fairlead [m]


class _SettledModel(NamedTuple):
    """A plant with the rover settled."""

    plant: rover_sim.SpatialPlant
    state: rover_sim.SpatialState
    chord: float  # distance from fairlead to attachment [m]


@dataclass(frozen=True)
class _SimulatedJump:
    """Result of one simulated jump."""

    height: float  # [m]
    range: float  # [m]
    turn: float  # [rad]
    chord_growth: float  # largest increase of the chord [m]
    peak_tension: float  # [N]
    upright: bool


class JumpPredictor:
    """Predicts jumps.

    Args:
        parameters: model and limits.
    """

    def __init__(self, parameters: PredictionParameters) -> None:
        self.parameters = parameters
        self._cached: tuple[_Placement, _SettledModel] | None = None

    def predict(self, request: PredictionRequest, spring: SpringEstimate) -> JumpPrediction:
        """Predict a jump by the required clearance; selects stroke and slack.

        Takes about a second. Equal arguments give equal results, whatever was predicted before.

        Args:
            request: pose of the rover and required clearance.
            spring: estimate of the spring.
        """
        p = self.parameters
        stance = request.stance
        initial_stroke = spring.stroke_for(request.height, stance.tilt)
        if initial_stroke > p.spring_travel * 1.15:
            return rejected_prediction(self._out_of_reach(request, spring, 1.0))
        try:
            slack, extra_slack = self._slack(stance, request.height)
            model = self._settled_model(stance, slack)
            stroke = min(initial_stroke, p.spring_travel)
            errors = spring.sample_errors(np.random.default_rng(request.seed), p.rollouts)
            strokes = [spring.equivalent_stroke(stroke, float(a), float(b)) for a, b in errors]
            jumps = self._simulate(model, strokes, request)
        except (rover_sim.ScenarioError, rover_sim.SettlingError, RuntimeError) as error:
            return rejected_prediction(f"the jump cannot be predicted: {error}")
        nominal_heights = [spring.nominal_height(x, stance.tilt) for x in strokes]
        heights = np.array([max(jump.height, 1e-3) for jump in jumps])
        logs = np.log(heights / np.array(nominal_heights))
        ratio, spread = math.exp(float(np.median(logs))), _spread(logs)
        stroke = spring.stroke_for(self._aim(request, spring, ratio, spread), stance.tilt, ratio)
        height = spring.expected(stroke, stance.tilt, ratio)
        low, high = height.spread_by(spread).interval()
        chord_growth = float(np.quantile([jump.chord_growth for jump in jumps], 0.95))
        peak = _interval([jump.peak_tension for jump in jumps])
        upright = float(np.mean([jump.upright for jump in jumps]))
        rejection = ""
        if stroke > p.spring_travel:
            rejection = self._out_of_reach(request, spring, ratio)
        elif slack <= p.max_slack < chord_growth + p.slack_margin:
            rejection = (
                f"the tether would need {chord_growth + p.slack_margin:.3g} m of slack, limit "
                f"{p.max_slack:g} m"
            )
        elif peak.high > p.max_peak_tension:
            rejection = (
                f"the tether tension would reach {peak.high:.3g} N, limit {p.max_peak_tension:g} N"
            )
        elif upright < p.min_upright_probability:
            rejection = (
                f"the probability of landing upright is {upright:.2f}, minimum "
                f"{p.min_upright_probability:g}"
            )
        return JumpPrediction(
            stroke=stroke,
            slack=slack,
            extra_slack=extra_slack,
            height=Interval(height.mean, low, high),
            range=_interval([jump.range for jump in jumps]),
            turn=_interval([jump.turn for jump in jumps]),
            peak_tension=peak,
            upright=upright,
            ratio=ratio,
            spread=spread,
            rollouts=len(jumps),
            rejection=rejection,
        )

    def _aim(
        self,
        request: PredictionRequest,
        spring: SpringEstimate,
        ratio: float,
        spread: float,
    ) -> float:
        """Mean height [m] to aim at."""
        tilt = request.stance.tilt
        stroke = spring.stroke_for(request.height, tilt, ratio)
        height = spring.expected(stroke, tilt, ratio).spread_by(spread)
        return request.height * height.mean / height.quantile(self.parameters.clearance_risk)

    def _out_of_reach(
        self, request: PredictionRequest, spring: SpringEstimate, ratio: float
    ) -> str:
        max_stroke, tilt = self.parameters.spring_travel, request.stance.tilt
        max_height = spring.reach(max_stroke, tilt, ratio)
        return (
            f"clearance {request.height:g} m is out of reach: the longest stroke of "
            f"{max_stroke:g} m reaches about {max_height:.3g} m"
        )

    def _slack(self, stance: RoverStance, height: float) -> tuple[float, float]:
        """Required slack [m], and the part of it that the winch must give [m]."""
        p = self.parameters
        chord = math.hypot(stance.x, stance.y, self._drop(stance))
        # A tilted jump moves sideways on the way up and down; then the rover rolls on a little.
        lateral = 4.0 * height * math.tan(stance.tilt + 3.0 * p.stance_tilt_std)
        required = min(lateral + p.slack_margin, p.max_slack)
        present = required if math.isnan(stance.length) else stance.length - chord
        return max(present, required), max(required - max(present, 0.0), 0.0)

    def _drop(self, stance: RoverStance) -> float:
        """Depth of the attachment below the fairlead [m]."""
        p = self.parameters
        return stance.drop if stance.drop > 0.0 else p.floor_depth - p.attachment_height

    def _settled_model(self, stance: RoverStance, slack: float) -> _SettledModel:
        exact = _Placement(*_level(stance), slack, self._drop(stance))
        placement = _Placement(*(round(value, _DECIMALS) for value in exact))
        if self._cached is None or self._cached[0] != placement:
            self._cached = (placement, self._build(placement))
        return self._cached[1]

    def _build(self, placement: _Placement) -> _SettledModel:
        p = self.parameters
        x, y, heading, slope, downhill, slack, drop = placement
        # The floor plane passes through the rover's contact, so its height below the fairlead
        # differs.
        fall = math.tan(slope)
        depth = drop + p.attachment_height
        height = -depth + fall * (x * math.cos(downhill) + y * math.sin(downhill))
        chord = math.hypot(x, y, drop)
        length = chord + max(slack, 0.05)
        scenario = rover_sim.load_spatial(
            p.prediction_scenario,
            {
                "environment.hole": None,
                "environment.relief": None,
                "environment.boulders": None,
                "environment.floor": {
                    "height": height,
                    "slope": math.degrees(slope),
                    "downhill": math.degrees(downhill),
                },
                "start.kind": "grounded",
                "start.position": [x, y],
                "start.heading": math.degrees(heading),
                "start.settling_time": _SETTLE_LIMIT,
                "start.residual_speed": _CREEP,
                "tether.length": length,
                "tether.max_length": max(length + 1.0, 60.0),
                # Nothing is reeled in: the shortest length may suit the long elements.
                "winch.min_length": 0.5 * length,
                "tether.elements": None,
                "tether.element_length": max(length / p.prediction_elements, 0.3),
                "integration.h": p.prediction_time_step,
            },
        )
        plant = rover_sim.SpatialPlant(scenario)
        state = plant.initial_state()
        return _SettledModel(plant, state, _chord(state))

    def _simulate(
        self, model: _SettledModel, strokes: list[float], request: PredictionRequest
    ) -> list[_SimulatedJump]:
        p = self.parameters
        generator = np.random.default_rng([request.seed, 1])
        tilts = p.stance_tilt_std * generator.standard_normal((len(strokes), 2))
        rover = model.plant.scenario.rover
        if rover is None:
            raise RuntimeError(f"scenario {model.plant.scenario.name} has no rover")
        max_stroke = min(p.spring_travel, rover.jump_drive.stroke)
        states, commands = [], []
        for stroke, (about_x, about_y) in zip(strokes, tilts, strict=True):
            within = min(stroke, 0.99 * rover.slider.lower_stop)
            tilt = (float(about_x), float(about_y), 0.0)
            states.append(model.plant.compressed(model.state, within, tilt))
            setpoint = rover_sim.JumpMotorCommand(min(within, max_stroke), _NUT_SPEED)
            commands.append(rover_sim.PlantCommand(setpoint))
        gravity = model.plant.scenario.gravity
        flight = 2.0 * math.sqrt(2.0 * 1.2 * request.height / gravity)
        runs = rover_sim.roll_out(
            model.plant,
            states,
            commands,
            _RELEASE + flight + _AFTER_TOUCHDOWN,
            tick=_TICK,
            workers=_WORKERS,
        )
        return [self._evaluate(model, run) for run in runs]

    def _evaluate(
        self, model: _SettledModel, run: rover_sim.Run[rover_sim.SpatialState]
    ) -> _SimulatedJump:
        if run.final.phase.final:
            raise RuntimeError(f"a simulated jump ended in {run.final.phase.value}")
        first, last = run.states[0], run.final
        top = max(
            (event.values["z"] for event in run.events if event.name is PlantEvent.APEX),
            default=float(first.G1[2]),
        )
        displacement = last.G1 - first.G1
        return _SimulatedJump(
            height=top - float(first.G1[2]),
            range=math.hypot(float(displacement[0]), float(displacement[1])),
            turn=last.turn_from(first),
            chord_growth=max(map(_chord, run.states)) - model.chord,
            peak_tension=run.peak_tension,
            upright=last.tilt_from(model.state) < self.parameters.upright_tilt,
        )


def _level(stance: RoverStance) -> tuple[float, float, float, float, float]:
    """Position [m], heading [rad], slope of the floor [rad] and its downhill direction [rad]."""
    up = np.array(stance.up) / float(np.linalg.norm(stance.up))
    ahead = np.array([1.0, 0.0, 0.0]) - up[0] * up
    ahead /= np.linalg.norm(ahead)
    left = np.cross(up, ahead)
    # The floor's normal is base_link z, whose horizontal part points downhill.
    slope = math.acos(max(-1.0, min(1.0, float(up[2]))))
    downhill = stance.heading + math.atan2(float(left[2]), float(ahead[2]))
    downhill = math.remainder(downhill, math.tau)
    return stance.x, stance.y, stance.heading, slope, downhill


def _chord(state: rover_sim.SpatialState) -> float:
    return float(np.linalg.norm(state.nodes[-1, 0]))


def _spread(values: NDArray[np.float64]) -> float:
    """Standard deviation from the central 80 % of the values."""
    low, high = np.quantile(values, (0.1, 0.9))
    return float(high - low) / 2.563


def _interval(values: list[float]) -> Interval:
    low, median, high = (float(v) for v in np.quantile(values, (0.05, 0.5, 0.95)))
    return Interval(median, low, high)
