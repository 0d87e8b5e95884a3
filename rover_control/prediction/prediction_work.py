"""What a worker process computes: predictions by a model that it loads once."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

from rover_control.prediction.jump_prediction import (
    JumpPrediction,
    PredictionParameters,
    PredictionRequest,
    RoverStance,
)
from rover_control.prediction.jump_spring import SpringEstimate, SpringParameters

if TYPE_CHECKING:
    from rover_control.prediction.jump_predictor import JumpPredictor

_FEW = 8  # simulated jumps that call every function of the model


def predict_jump(
    parameters: PredictionParameters, request: PredictionRequest, spring: SpringEstimate
) -> JumpPrediction:
    """See ``JumpPredictor.predict``."""
    return _predictor(parameters).predict(request, spring)


@cache
def load_model(parameters: PredictionParameters) -> None:
    """Load the simulator and predict a jump, so that the first prediction is as fast as later."""
    stance = RoverStance(1.0, 0.0, 0.0, (0.0, 0.0, 1.0), float("nan"))
    request = PredictionRequest(stance, 0.1, seed=0)
    predict_jump(replace(parameters, rollouts=_FEW), request, SpringEstimate(SpringParameters()))


@cache
def _predictor(parameters: PredictionParameters) -> JumpPredictor:
    # Takes seconds, and the node's process runs without the simulator.
    from rover_control.prediction.jump_predictor import JumpPredictor  # noqa: PLC0415

    return JumpPredictor(parameters)
