"""The rover's jumps: sequence, prediction, report of each jump, learnt spring. Pure.

A jump by stroke or height begins at once. One by clearance is predicted first: `take_question` says
what is to be predicted, and what answers it tells `on_prediction`; then the winch is asked for
slack, where there is too little, and the jump begins. An outlook ends with the prediction.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from msg_schemas import topics
from msg_schemas.machine import JUMP_CLEARANCE, JUMP_HEIGHT, JUMP_PREDICTION, JUMP_STROKE, PAYOUT
from msg_schemas.parameters import parameter
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import ImuSample, JointSample, Level, OdometrySample, WrenchSample
from rover_control.jump_flight import FlightRecorder, Flown
from rover_control.jump_parameters import JumpParameters, JumpPhase
from rover_control.jump_prediction import Prediction, PredictionParameters, Question, Situation
from rover_control.jump_sensors import Sensors, seconds
from rover_control.jump_sequence import JumpSequence, NutCommand, Transition
from rover_control.jump_spring import Height, SpringEstimate, SpringParameters

_HOLD = "hold"  # mode of a winch that holds a length


@dataclass(frozen=True)
class FlightParameters:
    """IMU by which a flight is measured."""

    imu_offset: float = parameter(0.05, "m", "position of the IMU along base_link x", -1.0, 1.0)
    accelerometer_range: float = parameter(
        80.0, "m/s^2", "measuring range of the accelerometer", 1.0, 1e4
    )


class JumpRecord(NamedTuple):
    """A jump, predicted and flown."""

    stamp_ns: int  # of the landing
    stroke: float  # of the nut at the release [m]
    wanted: float  # height [m]; nan = a stroke was asked for
    expected: Height | None  # before the release; None: the stroke was to lift nothing
    prediction: Prediction | None  # that the jump was picked by
    peak_tension: float  # at the rover, from the release to the rest [N]; nan = not known
    flown: Flown
    gain: float  # of the spring's estimate after it
    zero: float  # [m]
    learnt: bool  # whether the spring's estimate took it


@dataclass
class JumpSettings:
    """All parameters of the jump."""

    sequence: JumpParameters = field(default_factory=JumpParameters)
    spring: SpringParameters = field(default_factory=SpringParameters)
    flight: FlightParameters = field(default_factory=FlightParameters)
    prediction: PredictionParameters = field(default_factory=PredictionParameters)


@dataclass
class _Pending:
    """A jump by clearance that has not begun yet."""

    question: Question
    speed: float  # of the nut [m/s]
    since_ns: int
    is_outlook: bool = False  # it is only predicted
    is_asked: bool = False  # whether the question was taken
    prediction: Prediction | None = None
    is_moving: bool = False  # whether the winch has begun to give slack


class Jump:
    """Jumps by stroke, by height or by clearance.

    Args:
        settings: parameters.

    Attributes:
        spring: what is known of the spring; kept from jump to jump.
    """

    def __init__(self, settings: JumpSettings) -> None:
        self.spring = SpringEstimate(settings.spring)
        self.sequence = JumpSequence(settings.sequence)
        self.sensors = Sensors()
        self._recorder = FlightRecorder(
            settings.flight.imu_offset, settings.flight.accelerometer_range
        )
        self._transitions: list[Transition] = []
        self._records: list[JumpRecord] = []
        self._settings = settings
        self._odometry: OdometrySample | None = None
        self._length = math.nan  # of the tether paid out [m]
        self._mode = ""  # of the winch
        self._pending: _Pending | None = None
        self._slack_request: float | None = None
        self._asked = 0  # predictions so far
        self._prediction: Prediction | None = None  # of the jump under way
        self._pull = math.nan  # largest since the release [N]
        self._wanted = math.nan
        self._tilt = 0.0  # before the release [rad]
        self._landed: tuple[int, float] | None = None  # when, and after what flight time [s]

    @property
    def phase(self) -> JumpPhase:
        """What the sequence is doing."""
        if self._pending is None:
            return self.sequence.phase
        if self._pending.prediction is None:
            return JumpPhase.PREDICTING
        return JumpPhase.GIVING_SLACK

    def start_over(self, now_ns: int) -> None:
        """The clock has jumped, or the node starts again: nothing that was timed holds."""
        self.sensors = Sensors()
        self.sequence.clock_jumped(now_ns)
        self._recorder.begin()
        self._landed = None
        if self._pending is not None:
            self._drop("the clock has jumped back", {})
        self._follow(now_ns)

    def forget(self) -> None:
        """Forget what was learnt of the spring, as after another one was built in."""
        self.spring = SpringEstimate(self.spring.parameters)

    def waiting_for(self, now_ns: int) -> tuple[str, ...]:
        """Return the topics of the sensors that are silent."""
        return self.sequence.waiting_for(self.sensors, now_ns)

    # --- what is heard ---------------------------------------------------------------------------

    def on_contact(self, sample: JointSample, now_ns: int) -> None:
        """Take a sample of the contact switches."""
        self.sensors = self.sensors.with_contact(sample, now_ns)

    def on_jump_motor(self, sample: JointSample, now_ns: int) -> None:
        """Take a sample of the jump motor's state."""
        self.sensors = self.sensors.with_jump_motor(sample, now_ns)

    def on_imu(self, sample: ImuSample, now_ns: int) -> None:
        """Take a sample of the IMU."""
        self.sensors = self.sensors.with_imu(sample, now_ns)
        self._recorder.on_imu(sample, now_ns)

    def on_load_cell(self, sample: WrenchSample, now_ns: int) -> None:
        """Take a sample of the load cell at the tether's rover end."""
        self.sensors = self.sensors.with_load_cell(sample, now_ns)
        if self.sensors.pull is not None:
            self._pull = max(self._pull, self.sensors.pull.value)

    def on_odometry(self, sample: OdometrySample) -> None:
        """Take where the rover is."""
        self._odometry = sample

    def on_winch_estimate(self, sample: JointSample) -> None:
        """Take what the winch knows of its tether."""
        self._length = sample.joints[PAYOUT].position

    def on_winch_mode(self, mode: str) -> None:
        """Take what the winch is doing."""
        self._mode = mode

    # --- what is asked for -----------------------------------------------------------------------

    def request(self, sample: JointSample, now_ns: int) -> None:
        """Begin the jump that a request asks for.

        Raises:
            Refusal: it cannot be begun now, or is too high.
        """
        ((joint, (value, speed, _)),) = sample.joints.items()
        if self._pending is not None:
            raise Refusal(
                topics.JUMP_REQUEST,
                RefusalCode.WRONG_PHASE,
                f"the jump is in {self.phase}, a jump starts from standby; {topics.JUMP_ABORT} "
                "ends it",
            )
        if joint in (JUMP_CLEARANCE, JUMP_PREDICTION):
            self._ask(value, speed, now_ns, is_outlook=joint == JUMP_PREDICTION)
            return
        if joint == JUMP_STROKE:
            self.sequence.request(value, speed, self.sensors, now_ns)
            self._wanted = math.nan
        elif joint == JUMP_HEIGHT:
            self.sequence.check_request(self.sensors, now_ns)
            stroke = self.spring.stroke_for(value, self.sensors.tilt)
            most = self.sequence.parameters.max_stroke
            if stroke > most:
                highest = self.spring.expected(most, self.sensors.tilt).mean
                raise Refusal(
                    topics.JUMP_REQUEST,
                    RefusalCode.OUT_OF_LIMITS,
                    f"{joint}.position is {value!r} m, which takes a stroke of {stroke:.4g} m; "
                    f"with at most {most:g} m the rover rises by {highest:.3g} m",
                )
            self.sequence.request(stroke, speed, self.sensors, now_ns)
            self._wanted = value
        else:
            raise AssertionError(f"no jump is asked for by {joint}")
        self._tilt = self.sensors.tilt
        self._prediction = None
        self._follow(now_ns)

    def abort(self, now_ns: int) -> str:
        """Let the spring down, as `JumpSequence.abort`.

        Raises:
            Refusal: it cannot be done now.
        """
        if self._pending is not None:
            self._drop(f"aborted in {self.phase}", {})
            return "nothing was compressed yet"
        done = self.sequence.abort(self.sensors, now_ns)
        self._follow(now_ns)
        return done

    def step(self, now_ns: int) -> NutCommand | None:
        """Advance to now; returns what the jump motor is to do, None = nothing."""
        if self._pending is not None:
            self._wait(self._pending, now_ns)
        command = self.sequence.step(self.sensors, now_ns)
        self._follow(now_ns)
        return command

    def take_transitions(self) -> list[Transition]:
        """Return what changed since the last call, and forget it."""
        taken, self._transitions = self._transitions, []
        return taken

    def take_records(self) -> list[JumpRecord]:
        """Return the jumps that were flown since the last call, and forget them."""
        taken, self._records = self._records, []
        return taken

    # --- before a jump by clearance --------------------------------------------------------------

    def take_question(self) -> Question | None:
        """Return what is to be predicted now; None = nothing, or it was taken already."""
        if self._pending is None or self._pending.is_asked:
            return None
        self._pending.is_asked = True
        return self._pending.question

    def take_slack_request(self) -> float | None:
        """Return the slack that the winch is to give now [m]; None = it is to do nothing."""
        taken, self._slack_request = self._slack_request, None
        return taken

    def on_prediction(self, question: Question, prediction: Prediction, now_ns: int) -> None:
        """Take the answer to a question; one to a question that was dropped is not heard."""
        pending = self._pending
        if pending is None or pending.question is not question or pending.prediction is not None:
            return
        values = {
            "height": prediction.height.middle,
            "upright": prediction.upright,
            "stroke": prediction.stroke,
            "took": prediction.took,
        }
        if prediction.refused:
            self._drop(f"better not: {prediction.refused}", values)
            return
        if pending.is_outlook:
            text = f"predicted: it lands upright with {prediction.upright:.2f}"
            self._drop(text, values, Level.OK)
            return
        pending.prediction, pending.since_ns = prediction, now_ns
        if prediction.gives_slack > 0.0:
            self._slack_request = prediction.slack
            text = f"the tether needs {prediction.gives_slack:.3g} m more slack"
            self._transitions.append(Transition(JumpPhase.GIVING_SLACK, text, values=values))
        else:
            self._begin(pending, prediction, now_ns)

    def _ask(self, clearance: float, speed: float, now_ns: int, *, is_outlook: bool) -> None:
        self.sequence.check_request(self.sensors, now_ns)
        up = self._recorder.standing()
        place = self._odometry
        if place is None or up is None:
            raise Refusal(
                topics.JUMP_REQUEST,
                RefusalCode.STALE,
                f"{topics.ODOMETRY if place is None else topics.IMU} was not heard, so it is not "
                "known how the rover stands",
            )
        x, y, z = place.position
        qx, qy, qz, qw = place.orientation
        heading = math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
        situation = Situation(x, y, heading, up, self._length, -z)
        self._asked += 1
        question = Question(situation, clearance, True, self._asked)
        self._pending = _Pending(question, speed, now_ns, is_outlook)
        self._transitions.append(
            Transition(
                JumpPhase.PREDICTING,
                f"a clearance of {clearance:g} m is wanted",
                values={"clearance": clearance, "tilt": situation.tilt},
            )
        )

    def _wait(self, pending: _Pending, now_ns: int) -> None:
        """Go on with a jump that has not begun, or give it up."""
        limit = self._settings.prediction.prediction_timeout
        late = seconds(now_ns, pending.since_ns) > limit
        if pending.prediction is None:
            if late:
                self._drop(f"not predicted within {limit:g} s", {})
            return
        pending.is_moving = pending.is_moving or self._mode != _HOLD
        if pending.is_moving and self._mode == _HOLD:
            self._begin(pending, pending.prediction, now_ns)
        elif late:
            text = f"the winch has not given slack within {limit:g} s, it is in '{self._mode}'"
            self._drop(text, {})

    def _begin(self, pending: _Pending, prediction: Prediction, now_ns: int) -> None:
        self._pending = None
        try:
            self.sequence.request(prediction.stroke, pending.speed, self.sensors, now_ns)
        except Refusal as refusal:
            self._transitions.append(
                Transition(JumpPhase.STANDBY, f"not begun: {refusal.reason}", Level.WARN)
            )
            return
        self._prediction, self._wanted = prediction, pending.question.height
        self._tilt = pending.question.situation.tilt
        self._follow(now_ns)

    def _drop(self, reason: str, values: Mapping[str, object], level: Level = Level.WARN) -> None:
        self._pending = self._slack_request = None
        self._transitions.append(Transition(JumpPhase.STANDBY, reason, level, values))

    # --- following the sequence ------------------------------------------------------------------

    def _follow(self, now_ns: int) -> None:
        for change in self.sequence.take_transitions():
            self._transitions.append(change)
            if change.phase is JumpPhase.SETTLING:
                self._recorder.begin()
            elif change.phase is JumpPhase.RELEASING:
                self._recorder.release(now_ns)
                self._pull = math.nan if self.sensors.pull is None else 0.0
                if self._prediction is None:
                    self._tilt = self.sensors.tilt
            elif change.phase is JumpPhase.LANDED:
                closed, flight = self.sensors.closed_ns, self.sensors.open_time
                took_off = change.level is Level.OK and closed is not None
                self._landed = (closed, flight) if took_off and closed is not None else None
            elif self._landed is not None:
                if change.phase in (JumpPhase.HOOKING, JumpPhase.STANDBY):
                    self._measure(*self._landed, now_ns)
                self._landed = None

    def _measure(self, landed_ns: int, flight_time: float, now_ns: int) -> None:
        flown = self._recorder.finish(landed_ns, flight_time, now_ns)
        if flown is None:
            return
        stroke = self.sequence.highest
        prediction = self._prediction
        ratio, spread = (1.0, 0.0) if prediction is None else (prediction.ratio, prediction.spread)
        expected = None
        if stroke > self.spring.shortest_stroke:
            expected = self.spring.expected(stroke, self._tilt, ratio).spread_by(spread)
        learnt = self.spring.learn(stroke, flown.height, self._tilt, ratio)
        self._records.append(
            JumpRecord(
                landed_ns,
                stroke,
                self._wanted,
                expected,
                prediction,
                self._pull,
                flown,
                self.spring.gain,
                self.spring.zero,
                learnt,
            )
        )
