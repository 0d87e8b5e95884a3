"""Jumps predicted by the plant: selection, rejection, and agreement with the flown jump."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from msg_schemas import machine, topics
from msg_schemas.events import JumpEvent
from msg_schemas.samples import JointSample
from rover_control.jump.jump_report import prediction_sample
from rover_control.prediction.jump_prediction import (
    JumpPrediction,
    PredictionParameters,
    PredictionRequest,
    RoverStance,
)
from rover_control.prediction.jump_predictor import JumpPredictor
from rover_control.prediction.jump_spring import SpringEstimate, SpringParameters
from rover_control.prediction.prediction_work import load_model, predict_jump
from rover_runtime.worker_process import WorkerProcess
from rover_verify.checks.floor import Stand, start_on_floor
from rover_verify.checks.jumping import Jumper
from rover_verify.harness.flight import JUMP

pytestmark = pytest.mark.usefixtures("compiled")

FEW = PredictionParameters(rollouts=8, floor_depth=6.0)
HERE = RoverStance(2.0, 0.3, 0.7, (0.03, 0.02, 1.0), math.nan)


def predicted(parameters: PredictionParameters = FEW) -> JumpPrediction:
    prediction_request = PredictionRequest(HERE, 0.15, 1)
    return JumpPredictor(parameters).predict(prediction_request, SpringEstimate(SpringParameters()))


@pytest.fixture(scope="module")
def usual() -> JumpPrediction:
    return predicted()


def test_a_prediction_selects_a_stroke(usual: JumpPrediction):
    assert usual.rejection == ""
    assert usual.rollouts == 8
    assert usual.height.median == pytest.approx(0.1587, abs=1e-3)
    assert 0.14 < usual.height.low < 0.15
    assert 0.165 < usual.height.high < 0.18
    assert usual.stroke == pytest.approx(0.13, abs=0.004)
    assert 0.95 < usual.ratio < 1.08
    assert 0.0 < usual.range.low <= usual.range.median <= usual.range.high < 0.5
    assert usual.turn.low <= usual.turn.median <= usual.turn.high
    assert 0.0 < usual.peak_tension.low < usual.peak_tension.high < 20.0
    assert usual.upright == 1.0
    assert usual.extra_slack == 0.0


def test_a_prediction_depends_on_its_arguments_alone(usual: JumpPrediction):
    predictor, spring = JumpPredictor(FEW), SpringEstimate(SpringParameters())
    nearly = HERE._replace(x=HERE.x + 2e-4)  # the same place, to the millimetre
    for stance in (nearly, HERE._replace(x=1.0)):
        predictor.predict(PredictionRequest(stance, 0.15, 1), spring)
        assert predictor.predict(PredictionRequest(HERE, 0.15, 1), spring) == usual


def test_a_worker_process_predicts_the_same_bits(usual: JumpPrediction):
    request, spring = PredictionRequest(HERE, 0.15, 1), SpringEstimate(SpringParameters())
    worker = WorkerProcess()
    try:
        worker.submit(partial(load_model, FEW)).result()
        assert worker.submit(partial(predict_jump, FEW, request, spring)).result() == usual
    finally:
        worker.close()


@pytest.mark.parametrize("ahead", [-0.16, 0.16])
def test_a_prediction_on_a_slope_with_rolling_wheels_succeeds(ahead: float):
    # The ratchets let it roll in one direction: it does not settle.
    slope = HERE._replace(x=1.4, y=0.0, heading=-2.545, up=(ahead, 0.0, 1.0))
    prediction_request = PredictionRequest(slope, 0.15, 1)
    found = JumpPredictor(FEW).predict(prediction_request, SpringEstimate(SpringParameters()))
    assert "cannot be predicted" not in found.rejection
    assert found.rollouts == 8


def test_a_jump_at_the_bottom_of_a_deep_pit_is_predicted():
    # Long elements: longer than the shortest length that the winch reels in to.
    deep = HERE._replace(drop=50.57, length=50.9)
    prediction_request = PredictionRequest(deep, 0.15, 1)
    found = JumpPredictor(FEW).predict(prediction_request, SpringEstimate(SpringParameters()))
    assert found.rejection == ""
    assert found.height.median == pytest.approx(0.1587, abs=1e-3)


def test_a_clearance_needs_a_median_above_it(usual: JumpPrediction):
    by_median = SpringEstimate(SpringParameters()).stroke_for(0.15, HERE.tilt, usual.ratio)
    assert usual.stroke > by_median
    deviation = math.log(usual.height.high / usual.height.median) / 1.645
    # 10 % of a normal distribution lie below 1.2816 standard deviations.
    assert usual.height.median == pytest.approx(0.15 * math.exp(1.2816 * deviation), rel=1e-3)


def test_a_better_spring_estimate_narrows_the_interval():
    spring = SpringEstimate(SpringParameters())
    prediction_request = PredictionRequest(HERE, 0.15, 1)
    predictor = JumpPredictor(FEW)
    before = predictor.predict(prediction_request, spring).height
    for stroke in (0.1, 0.13, 0.16, 0.19):
        assert spring.update(stroke, 1.05 * spring.nominal_height(stroke))
    after = predictor.predict(prediction_request, spring)
    assert after.height.high - after.height.low < 0.9 * (before.high - before.low)
    assert (
        after.stroke
        < predictor.predict(prediction_request, SpringEstimate(SpringParameters())).stroke
    )


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"max_peak_tension": 0.1}, r"tension would reach \d.* N, limit 0\.1 N"),
        ({"max_slack": 0.05}, r"would need 0\.\d+ m of slack, limit 0\.05 m"),
        (
            {"upright_tilt": 0.1, "stance_tilt_std": 0.2, "max_peak_tension": 1e4},
            r"probability of landing upright is 0\.\d+, minimum",
        ),
        ({"prediction_scenario": "nowhere"}, "cannot be predicted: .*nowhere"),
        ({"spring_travel": 0.12}, r"stroke of 0\.12 m reaches about 0\.1\d+ m"),
    ],
)
def test_a_jump_that_is_too_risky_is_rejected(changes: dict[str, float], reason: str):
    prediction = predicted(replace(FEW, **changes))  # type: ignore[arg-type]
    assert not np.isnan(prediction.stroke)
    with pytest.raises(AssertionError, match=reason):
        raise AssertionError(prediction.rejection)


def test_missing_slack_is_requested_from_the_winch():
    taut = HERE._replace(length=math.hypot(2.0, 0.3, 6.0 - 0.43) + 0.1)
    prediction = JumpPredictor(FEW).predict(
        PredictionRequest(taut, 0.15, 1), SpringEstimate(SpringParameters())
    )
    assert prediction.slack > FEW.slack_margin
    assert prediction.extra_slack == pytest.approx(prediction.slack - 0.1)


def test_a_prediction_is_a_sample_of_the_contract(usual: JumpPrediction):
    sample = prediction_sample(usual, 7)
    assert sample.stamp_ns == 7
    assert tuple(sample.joints["jump_height"]) == tuple(usual.height)
    assert sample.joints["rollouts"].position == 8.0


def test_a_jump_by_clearance_matches_its_prediction():
    stand = Stand(slope=0.04, downhill=1.0, heading=0.7)
    flight = start_on_floor(JUMP, stand.overrides(), 2, {"jump_node": {"rollouts": 16}})
    rover = Jumper(flight)
    height = rover.jump(0.15, machine.JUMP_CLEARANCE)
    prediction, record = flight.last[topics.JUMP_PREDICTION], flight.last[topics.JUMP_FLOWN]
    assert isinstance(prediction, JointSample)
    assert isinstance(record, JointSample)
    _, low, high = prediction.joints[machine.JUMP_HEIGHT]
    assert height >= 0.15
    assert low <= height <= high
    assert record.joints[machine.JUMP_REQUESTED].position == 0.15
    assert (
        tuple(record.joints[machine.JUMP_RANGE])[1:]
        == tuple(prediction.joints[machine.JUMP_RANGE])[1:]
    )
    # A prediction takes the simulated time of the parameter prediction_duration.
    begun, compressed = (
        flight.events_named(name)[0].time for name in (JumpEvent.PREDICTING, JumpEvent.COMPRESSING)
    )
    assert compressed - begun == pytest.approx(2.0, abs=0.15)
