"""Jump controller: requests, prediction, sequence and spring estimate. Pure.

A jump by stroke or height begins at once. A jump by clearance is predicted first:
`take_prediction_request` returns the request, `on_prediction` processes the result. If the tether
is too short, the winch is requested to give slack, and the jump begins when it has given it. A
prediction-only request ends with the prediction.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from msg_schemas import machine, topics
from msg_schemas.events import EventReport, JumpEvent
from msg_schemas.faults import Reason
from msg_schemas.parameters import parameter
from msg_schemas.phases import JumpPhase
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import ImuSample, JointSample, PoseEstimateSample, WrenchSample
from rover_control.coordination.motor_handover import MotorHandover
from rover_control.jump.jump_flight import FlightRecorder, MeasuredJump
from rover_control.jump.jump_parameters import JumpParameters
from rover_control.jump.jump_sensors import Sensors, seconds
from rover_control.jump.jump_sequence import JumpSequence, NutCommand, Transition
from rover_control.prediction.jump_prediction import (
    JumpPrediction,
    PredictionParameters,
    PredictionRequest,
    RoverStance,
)
from rover_control.prediction.jump_spring import Height, SpringEstimate, SpringParameters


@dataclass(frozen=True)
class FlightParameters:
    """IMU by which a flight is measured."""

    imu_offset: float = parameter(0.05, "m", "position of the IMU along base_link x", -1.0, 1.0)
    accelerometer_range: float = parameter(
        80.0, "m/s^2", "measuring range of the accelerometer", 1.0, 1e4
    )


class JumpRecord(NamedTuple):
    """A jump as predicted and as measured."""

    stamp_ns: int  # time of the landing
    stroke: float  # nut position at the release [m]
    requested_height: float  # [m]; nan = the request gave a stroke
    expected: Height | None  # expected before the release; None: stroke too short to lift off
    prediction: JumpPrediction | None  # prediction that selected the stroke, if any
    peak_tension: float  # at the rover, from release to rest [N]; nan = unknown
    flown: MeasuredJump
    gain: float  # of the spring estimate after the jump
    zero: float  # of the spring estimate after the jump [m]
    accepted: bool  # whether the spring estimate used the jump


@dataclass
class JumpSettings:
    """All parameters of the jump controller."""

    sequence: JumpParameters = field(default_factory=JumpParameters)
    spring: SpringParameters = field(default_factory=SpringParameters)
    flight: FlightParameters = field(default_factory=FlightParameters)
    prediction: PredictionParameters = field(default_factory=PredictionParameters)


@dataclass
class _Pending:
    """A jump by clearance before its start."""

    prediction_request: PredictionRequest
    speed: float  # nut speed [m/s]
    since_ns: int
    predict_only: bool = False  # no jump follows
    is_taken: bool = False  # whether the caller has taken the prediction request
    prediction: JumpPrediction | None = None
    has_slack: bool = False  # whether the winch has given the requested slack


class JumpController:
    """Jumps by stroke, height or clearance.

    Args:
        settings: parameters.

    Attributes:
        spring: estimate of the spring; kept from jump to jump.
    """

    def __init__(self, settings: JumpSettings) -> None:
        self.spring = SpringEstimate(settings.spring)
        self.sequence = JumpSequence(settings.sequence)
        self.sensors = Sensors()
        self._recorder = FlightRecorder()
        self._transitions: list[Transition] = []
        self._records: list[JumpRecord] = []
        self._pose: PoseEstimateSample | None = None
        self._drop = 0.0  # height of the fairlead above the attachment; 0 = unknown [m]
        self._tether_length = math.nan  # paid-out length [m]
        self._pending: _Pending | None = None
        self._slack_request: float | None = None
        self._prediction_count = 0  # number of prediction requests so far
        self._prediction: JumpPrediction | None = None  # of the present jump
        self._peak_tension = math.nan  # largest since the release [N]
        self._requested_height = math.nan
        self._tilt = 0.0  # before the release [rad]
        self._landed: tuple[int, float] | None = None  # time of the landing, flight time [s]
        self._motor = MotorHandover()
        self._claimed_at = math.inf  # since when the present phases use the motor [s]
        self.retune(settings)

    def retune(self, settings: JumpSettings) -> None:
        """Apply other parameters at once; the spring estimate stays."""
        self._settings = settings
        self.sequence.parameters = settings.sequence
        self.spring.parameters = settings.spring
        self._recorder.imu_offset = settings.flight.imu_offset
        self._recorder.accelerometer_range = settings.flight.accelerometer_range

    @property
    def phase(self) -> JumpPhase:
        """Present phase."""
        if self._pending is None:
            return self.sequence.phase
        if self._pending.prediction is None:
            return JumpPhase.PREDICTING
        return JumpPhase.GIVING_SLACK

    def start_over(self, now_ns: int) -> None:
        """Restart after a clock jump or a start of the node: all times are invalid."""
        self.sensors = Sensors()
        self.sequence.clock_jumped(now_ns)
        self._recorder.begin()
        self._landed = None
        self._motor.clock_jumped()
        self._claimed_at = math.inf
        if self._pending is not None:
            self._cancel(JumpEvent.RESET, Reason.CLOCK_JUMP, "the clock jumped back")
        self._process_transitions(now_ns)

    def waiting_for(self, now_ns: int) -> tuple[str, ...]:
        """Topics of the stale sensors."""
        return self.sequence.waiting_for(self.sensors, now_ns)

    # --- inputs ----------------------------------------------------------------------------------

    def on_contact(self, sample: JointSample, now_ns: int) -> None:
        """Process a contact switch sample."""
        self.sensors = self.sensors.with_contact(sample, now_ns)

    def on_jump_motor(self, sample: JointSample, now_ns: int) -> None:
        """Process a jump motor sample."""
        self.sensors = self.sensors.with_jump_motor(sample, now_ns)

    def on_imu(self, sample: ImuSample, now_ns: int) -> None:
        """Process an IMU sample."""
        self.sensors = self.sensors.with_imu(sample, now_ns)
        self._recorder.on_imu(sample, now_ns)

    def on_load_cell(self, sample: WrenchSample, now_ns: int) -> None:
        """Process a sample of the load cell at the tether's rover end."""
        self.sensors = self.sensors.with_load_cell(sample, now_ns)
        if self.sensors.tether_tension is not None:
            self._peak_tension = max(self._peak_tension, self.sensors.tether_tension.value)

    def on_pose(self, sample: PoseEstimateSample) -> None:
        """Process the estimated pose."""
        self._pose = sample

    def on_drive_state(self, sample: JointSample) -> None:
        """Process the estimates of the drive controller."""
        self._drop = sample.joints[machine.TETHER_DROP].position

    def on_winch_estimate(self, sample: JointSample) -> None:
        """Process the winch estimate."""
        self._tether_length = sample.joints[machine.PAYOUT].position

    def on_descent(self, phase: str, now_ns: int) -> None:
        """Process the phase of the descent, which uses the same motor."""
        self._motor.on_phase(topics.DESCENT_PHASE, phase, now_ns * 1e-9)

    def on_slack_ended(self, text: str, *, is_given: bool) -> None:
        """Process the end of the winch's motion that gives slack, or its refusal."""
        pending = self._pending
        if self.phase is not JumpPhase.GIVING_SLACK or pending is None:
            return
        pending.has_slack = is_given
        if not is_given:
            reason = f"no slack from the winch: {text}"
            self._cancel(JumpEvent.NOT_STARTED, Reason.FAULT, reason)

    # --- requests --------------------------------------------------------------------------------

    def request(self, sample: JointSample, now_ns: int) -> None:
        """Begin the requested jump or prediction.

        Raises:
            Refusal: the controller is not ready, the descent uses the motor, or the height is out
                of limits.
        """
        self._check_motor()
        ((joint, (value, speed, _)),) = sample.joints.items()
        if self._pending is not None:
            raise Refusal(
                topics.JUMP_REQUEST,
                RefusalCode.WRONG_PHASE,
                f"the jump controller is in phase {self.phase}; wait for standby or call "
                f"{topics.JUMP_ABORT}",
            )
        if joint in (machine.JUMP_CLEARANCE, machine.JUMP_PREDICTION):
            self._request_prediction(
                value, speed, now_ns, predict_only=joint == machine.JUMP_PREDICTION
            )
            return
        if joint == machine.JUMP_STROKE:
            self.sequence.request(value, speed, self.sensors, now_ns)
            self._requested_height = math.nan
        elif joint == machine.JUMP_HEIGHT:
            self.sequence.check_request(self.sensors, now_ns)
            stroke = self.spring.stroke_for(value, self.sensors.tilt)
            max_stroke = self.sequence.parameters.max_stroke
            if stroke > max_stroke:
                max_height = self.spring.reach(max_stroke, self.sensors.tilt)
                raise Refusal(
                    topics.JUMP_REQUEST,
                    RefusalCode.OUT_OF_LIMITS,
                    f"{joint}.position is {value!r} m and needs a stroke of {stroke:.4g} m; "
                    f"the limit of {max_stroke:g} m reaches {max_height:.3g} m",
                )
            self.sequence.request(stroke, speed, self.sensors, now_ns)
            self._requested_height = value
        else:
            raise AssertionError(f"unknown jump request {joint}")
        self._tilt = self.sensors.tilt
        self._prediction = None
        self._process_transitions(now_ns)

    def _check_motor(self) -> None:
        if self._motor.is_used_by(topics.DESCENT_PHASE):
            raise Refusal(
                topics.JUMP_REQUEST,
                RefusalCode.WRONG_PHASE,
                f"the descent controller uses the jump motor; call {topics.DESCENT_RELEASE} first",
            )

    def abort(self, now_ns: int) -> str:
        """Let the spring down; see `JumpSequence.abort`.

        Raises:
            Refusal: the latch has tripped already.
        """
        if self._pending is not None:
            self._cancel(JumpEvent.ABORTED, Reason.REQUESTED, f"aborted in {self.phase}")
            return "aborted before the spring was compressed"
        message = self.sequence.abort(self.sensors, now_ns)
        self._process_transitions(now_ns)
        return message

    def step(self, now_ns: int) -> NutCommand | None:
        """Advance to a time [ns]; returns the nut command, or None."""
        if self._pending is not None:
            self._step_pending(self._pending, now_ns)
        command = self.sequence.step(self.sensors, now_ns)
        self._process_transitions(now_ns)
        now = now_ns * 1e-9
        uses = self.sequence.phase.uses_motor
        self._claimed_at = min(self._claimed_at, now) if uses else math.inf
        return command if self._motor.may_command(now, self._claimed_at) else None

    def take_transitions(self) -> list[Transition]:
        """Return the transitions since the last call and clear them."""
        transitions, self._transitions = self._transitions, []
        return transitions

    def take_records(self) -> list[JumpRecord]:
        """Return the jumps measured since the last call and clear them."""
        taken, self._records = self._records, []
        return taken

    # --- prediction ------------------------------------------------------------------------------

    def take_prediction_request(self) -> PredictionRequest | None:
        """Return a new prediction request once; None = none."""
        if self._pending is None or self._pending.is_taken:
            return None
        self._pending.is_taken = True
        return self._pending.prediction_request

    def take_slack_request(self) -> float | None:
        """Return a new slack request [m] once; None = none."""
        taken, self._slack_request = self._slack_request, None
        return taken

    def on_prediction(
        self, prediction_request: PredictionRequest, prediction: JumpPrediction, now_ns: int
    ) -> None:
        """Process the result of a prediction; ignored if its request was cancelled."""
        pending = self._pending
        if (
            pending is None
            or pending.prediction_request is not prediction_request
            or pending.prediction is not None
        ):
            return
        values = {
            "height": prediction.height.median,
            "upright": prediction.upright,
            "stroke": prediction.stroke,
        }
        if prediction.rejection:
            text = f"jump rejected: {prediction.rejection}"
            self._cancel(JumpEvent.REJECTED, Reason.OUT_OF_LIMITS, text, values)
            return
        if pending.predict_only:
            text = f"predicted: probability of landing upright {prediction.upright:.2f}"
            self._cancel(JumpEvent.PREDICTED, Reason.COMPLETED, text, values)
            return
        pending.prediction, pending.since_ns = prediction, now_ns
        if prediction.extra_slack > 0.0:
            self._slack_request = prediction.slack
            text = f"{prediction.extra_slack:.3g} m more slack needed"
            event = EventReport(JumpEvent.GIVING_SLACK, text, values)
            self._transitions.append(Transition(JumpPhase.GIVING_SLACK, event))
        else:
            self._begin(pending, prediction, now_ns)

    def on_prediction_failed(self, prediction_request: PredictionRequest, reason: str) -> None:
        """Process a prediction without a result; ignored if its request was cancelled."""
        pending = self._pending
        if pending is not None and pending.prediction_request is prediction_request:
            self._cancel(JumpEvent.NOT_STARTED, Reason.FAULT, f"no prediction: {reason}")

    def _request_prediction(
        self, clearance: float, speed: float, now_ns: int, *, predict_only: bool
    ) -> None:
        self.sequence.check_request(self.sensors, now_ns)
        up = self._recorder.mean_specific_force()
        place = self._pose
        if place is None or up is None:
            raise Refusal(
                topics.JUMP_REQUEST,
                RefusalCode.STALE,
                f"{topics.POSE if place is None else topics.IMU} missing: the pose of the "
                "rover is unknown",
            )
        if not place.is_known:
            raise Refusal(
                topics.JUMP_REQUEST,
                RefusalCode.WRONG_PHASE,
                f"the pose of the rover is unknown: set it by a message on {topics.DRIVE_START}",
            )
        x, y, _ = place.position
        stance = RoverStance(x, y, place.heading, up, self._tether_length, self._drop)
        max_tilt = self.sequence.parameters.max_tilt
        if stance.tilt > max_tilt:
            raise Refusal(
                topics.JUMP_REQUEST,
                RefusalCode.OUT_OF_LIMITS,
                f"the tilt is {stance.tilt:.3g} rad; the latch is released up to {max_tilt:g} rad",
            )
        self._prediction_count += 1
        prediction_request = PredictionRequest(stance, clearance, self._prediction_count)
        self._pending = _Pending(prediction_request, speed, now_ns, predict_only)
        self._transitions.append(
            Transition(
                JumpPhase.PREDICTING,
                EventReport(
                    JumpEvent.PREDICTING,
                    f"requested clearance {clearance:g} m",
                    {"clearance": clearance, "tilt": stance.tilt},
                ),
            )
        )

    def _step_pending(self, pending: _Pending, now_ns: int) -> None:
        """Advance a jump that has not begun, or cancel it on a timeout."""
        limit = self._settings.prediction.prediction_timeout
        is_late = seconds(now_ns, pending.since_ns) > limit
        if pending.prediction is None:
            if is_late:
                text = f"no prediction within {limit:g} s"
                self._cancel(JumpEvent.NOT_STARTED, Reason.TIME_LIMIT, text)
            return
        if pending.has_slack:
            self._begin(pending, pending.prediction, now_ns)
        elif is_late:
            text = f"no slack from the winch within {limit:g} s"
            self._cancel(JumpEvent.NOT_STARTED, Reason.TIME_LIMIT, text)

    def _begin(self, pending: _Pending, prediction: JumpPrediction, now_ns: int) -> None:
        self._pending = None
        try:
            self._check_motor()
            self.sequence.request(prediction.stroke, pending.speed, self.sensors, now_ns)
        except Refusal as refusal:
            text = f"jump not started: {refusal.reason}"
            self._cancel(JumpEvent.NOT_STARTED, Reason.OUT_OF_LIMITS, text)
            return
        self._prediction, self._requested_height = prediction, pending.prediction_request.height
        self._tilt = pending.prediction_request.stance.tilt
        self._process_transitions(now_ns)

    def _cancel(
        self,
        name: JumpEvent,
        reason: Reason,
        text: str,
        values: Mapping[str, object] | None = None,
    ) -> None:
        self._pending = self._slack_request = None
        event = EventReport(name, text, values or {}, reason)
        self._transitions.append(Transition(JumpPhase.STANDBY, event))

    # --- transitions of the sequence -------------------------------------------------------------

    def _process_transitions(self, now_ns: int) -> None:
        for change in self.sequence.take_transitions():
            self._transitions.append(change)
            if change.phase is JumpPhase.SETTLING:
                self._recorder.begin()
            elif change.phase is JumpPhase.RELEASING:
                self._recorder.release(now_ns)
                self._peak_tension = math.nan if self.sensors.tether_tension is None else 0.0
                if self._prediction is None:
                    self._tilt = self.sensors.tilt
            elif change.phase is JumpPhase.LANDED:
                closed, flight = self.sensors.closed_ns, self.sensors.open_time
                took_off = change.event.name is JumpEvent.LANDED and closed is not None
                self._landed = (closed, flight) if took_off and closed is not None else None
            elif self._landed is not None:
                if change.phase in (JumpPhase.HOOKING, JumpPhase.STANDBY):
                    self._measure(*self._landed, now_ns)
                self._landed = None

    def _measure(self, landed_ns: int, flight_time: float, now_ns: int) -> None:
        flown = self._recorder.finish(landed_ns, flight_time, now_ns)
        if flown is None:
            return
        stroke = self.sequence.peak_compression
        prediction = self._prediction
        ratio, spread = (1.0, 0.0) if prediction is None else (prediction.ratio, prediction.spread)
        expected = None
        if stroke > self.spring.shortest_stroke:
            expected = self.spring.expected(stroke, self._tilt, ratio).spread_by(spread)
        accepted = self.spring.update(stroke, flown.height, self._tilt, ratio)
        self._records.append(
            JumpRecord(
                landed_ns,
                stroke,
                self._requested_height,
                expected,
                prediction,
                self._peak_tension,
                flown,
                self.spring.gain,
                self.spring.zero,
                accepted,
            )
        )
