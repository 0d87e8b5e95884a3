"""Jumps by clearance: prediction request, result and every cancellation. Without a plant."""

from __future__ import annotations

import math

import pytest

from msg_schemas import machine, topics
from msg_schemas.events import EventName, JumpEvent
from msg_schemas.faults import Reason
from msg_schemas.phases import JumpPhase
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import ImuSample, JointSample, JointValue, PoseEstimateSample
from rover_control.jump.jump_controller import JumpController, JumpSettings
from rover_control.jump.jump_parameters import JumpParameters
from rover_control.jump.jump_sequence import Transition
from rover_control.prediction.jump_prediction import (
    Interval,
    JumpPrediction,
    PredictionParameters,
    PredictionRequest,
    rejected_prediction,
)
from rover_control.prediction.jump_spring import SpringParameters

NANO = 1_000_000_000
GOOD = JumpPrediction(
    stroke=0.12,
    slack=0.8,
    extra_slack=0.0,
    height=Interval(0.13, 0.12, 0.14),
    range=Interval(0.1, 0.0, 0.2),
    turn=Interval(0.0, -0.1, 0.1),
    peak_tension=Interval(1.0, 0.5, 2.0),
    upright=1.0,
    ratio=1.02,
    spread=0.01,
    rollouts=32,
    rejection="",
)


def pose(heading_variance: float) -> PoseEstimateSample:
    turned = (0.0, 0.0, math.sin(0.35), math.cos(0.35))
    variances = (*(0.0 for _ in range(35)), heading_variance)
    return PoseEstimateSample(1, (2.0, 1.0, 0.0), turned, variances)


class Standing:
    """A standing rover and its jump controller."""

    def __init__(self, *, knows_place: bool = True) -> None:
        self.jump = JumpController(JumpSettings())
        self.now_ns = NANO
        self.changes: list[Transition] = []
        self.force = (0.1, 0.0, 1.6)
        if knows_place:
            self.jump.on_pose(pose(0.01))
        self.run(0.5)

    def run(self, time: float) -> None:
        for _ in range(round(time * 100)):
            self.now_ns += NANO // 100
            now = self.now_ns
            contact = JointSample(now, {machine.FLOOR_SWITCH: JointValue(1.0)})
            self.jump.on_contact(contact, now)
            self.jump.on_jump_motor(JointSample(now, {machine.JUMP_SCREW: JointValue(-0.03)}), now)
            self.jump.on_imu(ImuSample(now, (0.0, 0.0, 0.0), self.force), now)
            self.jump.step(now)
        self.changes += self.jump.take_transitions()

    def request(self, clearance: float = 0.12, joint: str = machine.JUMP_CLEARANCE) -> None:
        sample = JointSample(self.now_ns, {joint: JointValue(clearance)})
        self.jump.request(sample, self.now_ns)

    def prediction_request(self) -> PredictionRequest:
        prediction_request = self.jump.take_prediction_request()
        assert prediction_request is not None
        return prediction_request

    def answer(self, prediction: JumpPrediction) -> None:
        self.jump.on_prediction(self.prediction_request(), prediction, self.now_ns)
        self.run(0.02)

    @property
    def phases(self) -> list[str]:
        return [change.phase for change in self.changes]

    @property
    def last(self) -> tuple[JumpPhase, EventName, Reason | None]:
        phase, event = self.changes[-1]
        return phase, event.name, event.reason


@pytest.fixture
def rover() -> Standing:
    return Standing()


def test_a_prediction_request_contains_the_stance(rover: Standing):
    rover.jump.on_winch_estimate(JointSample(1, {machine.PAYOUT: JointValue(7.5)}))
    rover.request(0.12)
    prediction_request = rover.prediction_request()
    assert prediction_request.height == 0.12
    x, y, heading, up, length, _ = prediction_request.stance
    assert (x, y, length) == (2.0, 1.0, 7.5)
    assert heading == pytest.approx(0.7)
    assert up == pytest.approx((0.1, 0.0, 1.6))
    assert rover.jump.take_prediction_request() is None
    assert rover.jump.phase.value == "predicting"


def test_an_accepted_prediction_begins_the_jump_with_its_stroke(rover: Standing):
    rover.request()
    rover.answer(GOOD)
    assert rover.phases == ["predicting", "compressing"]
    assert rover.changes[1].event.values["stroke"] == GOOD.stroke
    assert rover.jump.take_slack_request() is None


def test_a_rejected_prediction_returns_to_standby_with_its_reason(rover: Standing):
    rover.request()
    rover.answer(rejected_prediction("it would topple"))
    assert rover.last == (JumpPhase.STANDBY, JumpEvent.REJECTED, Reason.OUT_OF_LIMITS)
    assert "it would topple" in rover.changes[-1].event.message
    rover.request()


def test_slack_is_requested_once_and_awaited(rover: Standing):
    rover.request()
    rover.jump.on_slack_ended("of an earlier request", is_given=True)
    rover.answer(GOOD._replace(extra_slack=0.5))
    assert rover.jump.take_slack_request() == GOOD.slack
    assert rover.jump.take_slack_request() is None
    rover.run(1.0)
    assert rover.phases == ["predicting", "giving_slack"]
    rover.run(3.0)
    assert rover.phases == ["predicting", "giving_slack"]
    rover.jump.on_slack_ended("0.5 m of slack", is_given=True)
    rover.run(0.02)
    assert rover.phases == ["predicting", "giving_slack", "compressing"]


def test_a_winch_that_gives_no_slack_cancels_the_jump_at_once(rover: Standing):
    rover.request()
    rover.answer(GOOD._replace(extra_slack=0.5))
    rover.run(1.0)
    rover.jump.on_slack_ended("the winch is in fault", is_given=False)
    rover.run(0.02)
    assert rover.last == (JumpPhase.STANDBY, JumpEvent.NOT_STARTED, Reason.FAULT)
    rover.run(1.0)
    rover.request()


def test_a_winch_without_slack_in_time_cancels_the_jump(rover: Standing):
    rover.request()
    rover.answer(GOOD._replace(extra_slack=0.5))
    rover.run(61.0)
    assert rover.phases == ["predicting", "giving_slack", "standby"]
    assert rover.last == (JumpPhase.STANDBY, JumpEvent.NOT_STARTED, Reason.TIME_LIMIT)


def test_a_late_prediction_cancels_the_jump_and_is_ignored(rover: Standing):
    rover.request()
    prediction_request = rover.prediction_request()
    rover.run(61.0)
    assert rover.last == (JumpPhase.STANDBY, JumpEvent.NOT_STARTED, Reason.TIME_LIMIT)
    rover.jump.on_prediction(prediction_request, GOOD, rover.now_ns)
    rover.request()
    rover.jump.on_prediction(prediction_request, GOOD, rover.now_ns)
    assert rover.jump.phase.value == "predicting"


def test_an_abort_during_the_prediction_cancels_the_jump(rover: Standing):
    rover.request()
    assert rover.jump.abort(rover.now_ns) == "aborted before the spring was compressed"
    rover.run(0.02)
    assert rover.last == (JumpPhase.STANDBY, JumpEvent.ABORTED, Reason.REQUESTED)


@pytest.mark.parametrize("joint", [machine.JUMP_CLEARANCE, machine.JUMP_STROKE])
def test_another_request_during_the_prediction_is_refused(rover: Standing, joint: str):
    rover.request()
    with pytest.raises(Refusal, match="in phase predicting") as caught:
        rover.request(0.1, joint)
    assert caught.value.code is RefusalCode.WRONG_PHASE


def test_a_prediction_is_refused_without_a_pose():
    rover = Standing(knows_place=False)
    with pytest.raises(Refusal, match=topics.POSE) as caught:
        rover.request()
    assert caught.value.code is RefusalCode.STALE
    rover.jump.on_pose(pose(3.0))
    with pytest.raises(Refusal, match=f"unknown: set it by a message on {topics.DRIVE_START}"):
        rover.request()


def test_a_prediction_is_refused_where_the_latch_would_not_be_released(rover: Standing):
    max_tilt = JumpSettings().sequence.max_tilt
    rover.force = (1.6 * math.tan(max_tilt + 0.01), 0.0, 1.6)
    rover.run(5.0)
    with pytest.raises(Refusal, match=f"up to {max_tilt:g} rad") as caught:
        rover.request(0.12, machine.JUMP_PREDICTION)
    assert caught.value.code is RefusalCode.OUT_OF_LIMITS
    rover.force = (1.6 * math.tan(max_tilt - 0.01), 0.0, 1.6)
    rover.run(5.0)
    rover.request(0.12, machine.JUMP_PREDICTION)


def test_a_clock_jump_cancels_the_jump(rover: Standing):
    rover.request()
    rover.jump.start_over(0)
    changes = rover.jump.take_transitions()
    assert changes[-1].phase.value == "standby"
    assert rover.jump.phase.value == "standby"


def test_a_predicted_jump_that_is_then_refused_is_reported(rover: Standing):
    rover.request()
    rover.answer(GOOD._replace(stroke=0.25))
    assert rover.phases[-1] == "standby"
    assert rover.last == (JumpPhase.STANDBY, JumpEvent.NOT_STARTED, Reason.OUT_OF_LIMITS)


def test_a_jump_without_a_prediction_is_not_started(rover: Standing):
    rover.request()
    rover.jump.on_prediction_failed(rover.prediction_request(), "the worker process died")
    rover.run(0.1)
    assert rover.last == (JumpPhase.STANDBY, JumpEvent.NOT_STARTED, Reason.FAULT)
    assert "the worker process died" in rover.changes[-1].event.message
    rover.request()  # the next one is not affected
    rover.answer(GOOD)
    assert rover.phases[-1] == "compressing"


def test_a_prediction_only_request_moves_nothing(rover: Standing):
    rover.request(0.12, machine.JUMP_PREDICTION)
    rover.answer(GOOD)
    rover.run(1.0)
    assert rover.phases == ["predicting", "standby"]
    assert rover.last == (JumpPhase.STANDBY, JumpEvent.PREDICTED, Reason.COMPLETED)
    assert rover.changes[-1].event.values["upright"] == 1.0
    assert rover.jump.take_slack_request() is None


def test_a_rejected_prediction_only_request_gives_the_reason(rover: Standing):
    rover.request(0.12, machine.JUMP_PREDICTION)
    rover.answer(rejected_prediction("it would topple"))
    assert rover.last == (JumpPhase.STANDBY, JumpEvent.REJECTED, Reason.OUT_OF_LIMITS)


def test_the_depth_is_taken_from_the_drive_controller(rover: Standing):
    rover.jump.on_drive_state(JointSample(1, {machine.TETHER_DROP: JointValue(49.5)}))
    rover.request(0.12)
    assert rover.prediction_request().stance.drop == 49.5


@pytest.mark.parametrize(
    "settings",
    [
        JumpSettings(sequence=JumpParameters(max_stroke=0.01)),
        JumpSettings(spring=SpringParameters(spring_rate=50.0)),
    ],
)
def test_a_height_that_no_stroke_reaches_is_refused(rover: Standing, settings: JumpSettings):
    rover.jump.retune(settings)
    with pytest.raises(Refusal, match="reaches 0 m") as caught:
        rover.request(0.1, machine.JUMP_HEIGHT)
    assert caught.value.code is RefusalCode.OUT_OF_LIMITS


def test_another_time_limit_applies_to_a_running_prediction(rover: Standing):
    rover.request()
    rover.jump.retune(JumpSettings(prediction=PredictionParameters(prediction_timeout=1.0)))
    rover.run(1.5)
    assert rover.last == (JumpPhase.STANDBY, JumpEvent.NOT_STARTED, Reason.TIME_LIMIT)
