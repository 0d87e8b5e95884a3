"""Predicts a jump by flying it many times with the simulator's plant, before it is flown.

The plant is built where the rover stands, on a plane floor that tilts as the rover does, its
tether as long as it is or is to be. The rover settles on it once. From there it jumps again and
again, each time with another spring, stroke and attitude, drawn as they may truly be. What the
heights are over those of the spring's formula is the place's own share; the rest of the uncertainty
of the height is that of the spring, which is known from the jumps that were flown.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import rover_sim
from rover_control.jump_prediction import (
    Band,
    Prediction,
    PredictionParameters,
    Question,
    Situation,
    refused_prediction,
)
from rover_control.jump_spring import SpringEstimate

_TICK = 0.05  # of the plant [s]
_RELEASE = 0.15  # from the release to the take-off [s]
_AFTER = 1.0  # watched from the touchdown on [s]
_NUT_SPEED = 0.05  # [m/s]
_SETTLES = 45.0  # longest, of the model [s]
_CREEP = 0.05  # with which it may go on rolling down a slope, or its tether to its place [m/s]
_ROUNDED = 3  # decimals of what a place is kept by


class _Place(NamedTuple):
    """A plant with the rover settled."""

    plant: rover_sim.SpatialPlant
    state: rover_sim.SpatialState
    chord: float  # from the fairlead to the attachment [m]


@dataclass(frozen=True)
class _Leap:
    """A jump of the model."""

    height: float  # [m]
    range: float  # [m]
    turn: float  # [rad]
    growth: float  # of the chord, at its largest [m]
    peak_tension: float  # [N]
    upright: bool


class JumpPredictor:
    """Predicts jumps.

    Args:
        parameters: how.
        workers: threads that fly at the same time.
    """

    def __init__(self, parameters: PredictionParameters, workers: int = 2) -> None:
        self.parameters = parameters
        self._workers = workers
        self._kept: tuple[tuple[float, ...], _Place] | None = None

    def predict(self, question: Question, spring: SpringEstimate) -> Prediction:
        """Predict a jump of the height that is wanted; picks stroke and slack.

        It takes about a second and may be called in another thread than what it is given.

        Args:
            question: where the rover stands and how high it is to jump.
            spring: what is known of the spring.
        """
        begun, p = time.monotonic(), self.parameters
        situation = question.situation
        guess = spring.stroke_for(question.height, situation.tilt)
        if guess > p.spring_travel * 1.15:
            return refused_prediction(self._too_high(question, spring, 1.0))
        try:
            slack, given = self._slack(situation, question.height)
            place = self._place(situation, slack)
            stroke = min(guess, p.spring_travel)
            drawn = spring.draw(np.random.default_rng(question.seed), p.rollouts)
            strokes = [spring.same_as(stroke, float(a), float(b)) for a, b in drawn]
            leaps = self._fly(place, strokes, question)
        except (rover_sim.ScenarioError, rover_sim.SettlingError, RuntimeError) as error:
            return refused_prediction(f"the jump cannot be predicted: {error}")
        formula = [spring.formula(x, situation.tilt) for x in strokes]
        heights = np.array([max(leap.height, 1e-3) for leap in leaps])
        logs = np.log(heights / np.array(formula))
        ratio, spread = math.exp(float(np.median(logs))), _spread(logs)
        stroke = spring.stroke_for(
            self._aim(question, spring, ratio, spread), situation.tilt, ratio
        )
        height = spring.expected(stroke, situation.tilt, ratio)
        low, high = height.spread_by(spread).interval()
        growth = float(np.quantile([leap.growth for leap in leaps], 0.95))
        peak = _band([leap.peak_tension for leap in leaps])
        upright = float(np.mean([leap.upright for leap in leaps]))
        refused = ""
        if stroke > p.spring_travel:
            refused = self._too_high(question, spring, ratio)
        elif slack <= p.max_slack < growth + p.slack_margin:
            refused = (
                f"the tether would need {growth + p.slack_margin:.3g} m of slack, "
                f"at most {p.max_slack:g} m are given"
            )
        elif peak.high > p.max_peak_tension:
            refused = (
                f"the tether would be jerked with up to {peak.high:.3g} N, "
                f"at most {p.max_peak_tension:g} N"
            )
        elif upright < p.min_upright_probability:
            refused = (
                f"the rover would land upright with a probability of {upright:.2f} alone, "
                f"{p.min_upright_probability:g} is needed"
            )
        return Prediction(
            stroke=stroke,
            slack=slack,
            gives_slack=given,
            height=Band(height.mean, low, high),
            range=_band([leap.range for leap in leaps]),
            turn=_band([leap.turn for leap in leaps]),
            peak_tension=peak,
            upright=upright,
            ratio=ratio,
            spread=spread,
            rollouts=len(leaps),
            took=time.monotonic() - begun,
            refused=refused,
        )

    def prepare(self, situation: Situation, height: float) -> None:
        """Build the place beforehand, so that the prediction comes sooner.

        Raises:
            ScenarioError: the parameters do not give one.
            SettlingError: the rover finds no rest there.
        """
        self._place(situation, self._slack(situation, height)[0])

    def _aim(
        self, question: Question, spring: SpringEstimate, ratio: float, spread: float
    ) -> float:
        """The mean height to go for [m]."""
        if not question.is_clearance:
            return question.height
        tilt = question.situation.tilt
        stroke = spring.stroke_for(question.height, tilt, ratio)
        height = spring.expected(stroke, tilt, ratio).spread_by(spread)
        return question.height * height.mean / height.quantile(self.parameters.clearance_risk)

    def _too_high(self, question: Question, spring: SpringEstimate, ratio: float) -> str:
        longest, tilt = self.parameters.spring_travel, question.situation.tilt
        most = spring.expected(longest, tilt, ratio).mean
        kind = "a clearance" if question.is_clearance else "a height"
        return (
            f"{kind} of {question.height:g} m is too much: with the longest stroke of "
            f"{longest:g} m the rover rises by about {most:.3g} m"
        )

    def _slack(self, situation: Situation, height: float) -> tuple[float, float]:
        """Slack for the jump [m], and how much of it is to be given."""
        p = self.parameters
        chord = math.hypot(situation.x, situation.y, self._drop(situation))
        # The rover goes aside with its tilt, up and down again, and rolls on a little.
        aside = 4.0 * height * math.tan(situation.tilt + 3.0 * p.stance_tilt_std)
        wanted = min(aside + p.slack_margin, p.max_slack)
        present = wanted if math.isnan(situation.length) else situation.length - chord
        return max(present, wanted), max(wanted - max(present, 0.0), 0.0)

    def _drop(self, situation: Situation) -> float:
        """Of the attachment below the fairlead [m]."""
        p = self.parameters
        return situation.drop if situation.drop > 0.0 else p.floor_depth - p.attachment_height

    def _place(self, situation: Situation, slack: float) -> _Place:
        drop = self._drop(situation)
        key = tuple(round(v, _ROUNDED) for v in (*_level(situation), slack, drop))
        if self._kept is None or self._kept[0] != key:
            self._kept = (key, self._built(situation, slack))
        return self._kept[1]

    def _built(self, situation: Situation, slack: float) -> _Place:
        p = self.parameters
        x, y, heading, slope, downhill = _level(situation)
        # The floor passes below the rover at its depth, so it is elsewhere below the fairlead.
        fall = math.tan(slope)
        drop = self._drop(situation)
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
                "start.settling_time": _SETTLES,
                "start.residual_speed": _CREEP,
                "tether.length": length,
                "tether.max_length": max(length + 1.0, 60.0),
                "tether.elements": None,
                "tether.element_length": max(length / p.prediction_elements, 0.3),
                "integration.h": p.prediction_time_step,
            },
        )
        plant = rover_sim.SpatialPlant(scenario)
        state = plant.initial_state()
        return _Place(plant, state, _chord(state))

    def _fly(self, place: _Place, strokes: list[float], question: Question) -> list[_Leap]:
        p = self.parameters
        generator = np.random.default_rng([question.seed, 1])
        tilts = p.stance_tilt_std * generator.standard_normal((len(strokes), 2))
        rover = place.plant.scenario.rover
        if rover is None:
            raise RuntimeError(f"the scenario {place.plant.scenario.name} has no rover")
        longest = min(p.spring_travel, rover.jump_drive.stroke)
        states, commands = [], []
        for stroke, (about_x, about_y) in zip(strokes, tilts, strict=True):
            within = min(stroke, 0.99 * rover.slider.lower_stop)
            tilt = (float(about_x), float(about_y))
            states.append(rover_sim.compressed(place.plant, place.state, within, tilt))
            told = rover_sim.JumpMotorCommand(min(within, longest), _NUT_SPEED)
            commands.append(rover_sim.Command(told))
        gravity = place.plant.scenario.gravity
        flight = 2.0 * math.sqrt(2.0 * 1.2 * question.height / gravity)
        runs = rover_sim.roll_out(
            place.plant,
            states,
            commands,
            _RELEASE + flight + _AFTER,
            tick=_TICK,
            workers=self._workers,
        )
        return [self._judged(place, run) for run in runs]

    def _judged(self, place: _Place, run: rover_sim.Run[rover_sim.SpatialState]) -> _Leap:
        if run.final.phase.final:
            raise RuntimeError(f"a jump of the model ended in {run.final.phase.value}")
        first, last = run.states[0], run.final
        top = max(
            (event.values["z"] for event in run.events if event.name == "apex"),
            default=float(first.G1[2]),
        )
        way = last.G1 - first.G1
        before, after = first.rotation[:2, 0], last.rotation[:2, 0]
        turn = math.atan2(
            before[0] * after[1] - before[1] * after[0],
            before[0] * after[0] + before[1] * after[1],
        )
        leaning = float(place.state.rotation[:, 2] @ last.rotation[:, 2])
        tilt = math.acos(max(-1.0, min(1.0, leaning)))
        return _Leap(
            height=top - float(first.G1[2]),
            range=math.hypot(float(way[0]), float(way[1])),
            turn=turn,
            growth=max(map(_chord, run.states)) - place.chord,
            peak_tension=run.peak_tension,
            upright=tilt < self.parameters.upright_tilt,
        )


def _level(situation: Situation) -> tuple[float, float, float, float, float]:
    """Place [m], heading, slope of the floor and where it falls to [rad]."""
    up = np.array(situation.up) / float(np.linalg.norm(situation.up))
    ahead = np.array([1.0, 0.0, 0.0]) - up[0] * up
    ahead /= np.linalg.norm(ahead)
    left = np.cross(up, ahead)
    # The floor's normal is base_link z, which points downhill in level axes.
    slope = math.acos(max(-1.0, min(1.0, float(up[2]))))
    downhill = situation.heading + math.atan2(float(left[2]), float(ahead[2]))
    downhill = math.remainder(downhill, math.tau)
    return situation.x, situation.y, situation.heading, slope, downhill


def _chord(state: rover_sim.SpatialState) -> float:
    return float(np.linalg.norm(state.nodes[-1, 0]))


def _spread(values: NDArray[np.float64]) -> float:
    """Standard deviation, by the middle 80 % of the values."""
    low, high = np.quantile(values, (0.1, 0.9))
    return float(high - low) / 2.563


def _band(values: list[float]) -> Band:
    low, middle, high = (float(v) for v in np.quantile(values, (0.05, 0.5, 0.95)))
    return Band(middle, low, high)
