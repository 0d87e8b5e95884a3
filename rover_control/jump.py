"""The rover's jumps: sequence, what each came to, and what the spring is learnt to be. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from msg_schemas import topics
from msg_schemas.machine import JUMP_HEIGHT, JUMP_STROKE
from msg_schemas.parameters import parameter
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import ImuSample, JointSample, Level, WrenchSample
from rover_control.jump_flight import FlightRecorder, Flown
from rover_control.jump_parameters import JumpParameters, JumpPhase
from rover_control.jump_sensors import Sensors
from rover_control.jump_sequence import JumpSequence, NutCommand, Transition
from rover_control.jump_spring import Height, SpringEstimate, SpringParameters

NINETY = 1.645  # standard deviations either side of the mean that hold 90 %


@dataclass(frozen=True)
class FlightParameters:
    """How a flight is measured."""

    imu_ahead: float = parameter(0.05, "m", "of the IMU along base_link x", -1.0, 1.0)
    imu_range: float = parameter(80.0, "m/s^2", "of the accelerometer", 1.0, 1e4)


class JumpRecord(NamedTuple):
    """A jump, foretold and flown."""

    stamp_ns: int  # of the landing
    stroke: float  # of the nut at the release [m]
    wanted: float  # height [m]; nan = a stroke was asked for
    expected: Height | None  # by the spring's estimate before the release
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


class Jump:
    """Jumps by stroke or by height.

    Args:
        settings: parameters.

    Attributes:
        spring: what is known of the spring; kept from jump to jump.
    """

    def __init__(self, settings: JumpSettings) -> None:
        self.spring = SpringEstimate(settings.spring)
        self.sequence = JumpSequence(settings.sequence)
        self.sensors = Sensors()
        self._recorder = FlightRecorder(settings.flight.imu_ahead, settings.flight.imu_range)
        self._transitions: list[Transition] = []
        self._records: list[JumpRecord] = []
        self._wanted = math.nan
        self._tilt = 0.0  # before the release [rad]
        self._landed: tuple[int, float] | None = None  # when, and after what flight time [s]

    @property
    def phase(self) -> JumpPhase:
        """What the sequence is doing."""
        return self.sequence.phase

    def start_over(self, now_ns: int) -> None:
        """The clock has jumped, or the node starts again: nothing that was timed holds."""
        self.sensors = Sensors()
        self.sequence.clock_jumped(now_ns)
        self._recorder.begin()
        self._landed = None
        self._follow(now_ns)

    def forget(self) -> None:
        """Forget what was learnt of the spring, as after another one was built in."""
        self.spring = SpringEstimate(self.spring.parameters)

    def waiting_for(self, now_ns: int) -> tuple[str, ...]:
        """Return the topics of the sensors that are silent."""
        return self.sequence.waiting_for(self.sensors, now_ns)

    # --- what is heard ---------------------------------------------------------------------------

    def hear_contact(self, sample: JointSample, now_ns: int) -> None:
        """Take a sample of the contact switches."""
        self.sensors = self.sensors.with_contact(sample, now_ns)

    def hear_jump_motor(self, sample: JointSample, now_ns: int) -> None:
        """Take a sample of the jump motor's state."""
        self.sensors = self.sensors.with_jump_motor(sample, now_ns)

    def hear_imu(self, sample: ImuSample, now_ns: int) -> None:
        """Take a sample of the IMU."""
        self.sensors = self.sensors.with_imu(sample, now_ns)
        self._recorder.hear_imu(sample, now_ns)

    def hear_load_cell(self, sample: WrenchSample, now_ns: int) -> None:
        """Take a sample of the load cell at the tether's rover end."""
        self.sensors = self.sensors.with_load_cell(sample, now_ns)

    # --- what is asked for -----------------------------------------------------------------------

    def request(self, sample: JointSample, now_ns: int) -> None:
        """Begin the jump that a request asks for.

        Raises:
            Refusal: it cannot be begun now, or is too high.
        """
        ((joint, (value, speed, _)),) = sample.joints.items()
        if joint == JUMP_STROKE:
            self.sequence.request(value, speed, self.sensors, now_ns)
            self._wanted = math.nan
        elif joint == JUMP_HEIGHT:
            self.sequence.check_request(self.sensors, now_ns)
            stroke = self.spring.stroke_for(value, self.sensors.tilt)
            most = self.sequence.parameters.largest_stroke
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
        self._follow(now_ns)

    def abort(self, now_ns: int) -> str:
        """Let the spring down, as `JumpSequence.abort`.

        Raises:
            Refusal: it cannot be done now.
        """
        done = self.sequence.abort(self.sensors, now_ns)
        self._follow(now_ns)
        return done

    def step(self, now_ns: int) -> NutCommand | None:
        """Advance to now; returns what the jump motor is to do, None = nothing."""
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

    # --- following the sequence ------------------------------------------------------------------

    def _follow(self, now_ns: int) -> None:
        for change in self.sequence.take_transitions():
            self._transitions.append(change)
            if change.phase is JumpPhase.SETTLING:
                self._recorder.begin()
            elif change.phase is JumpPhase.RELEASING:
                self._recorder.release(now_ns)
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
        expected = None
        if stroke > self.spring.shortest_stroke:
            expected = self.spring.expected(stroke, self._tilt)
        learnt = self.spring.learn(stroke, flown.height, self._tilt)
        self._records.append(
            JumpRecord(
                landed_ns,
                stroke,
                self._wanted,
                expected,
                flown,
                self.spring.gain,
                self.spring.zero,
                learnt,
            )
        )
