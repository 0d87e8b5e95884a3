"""Jump sequence without ROS, on a minimal model of the rover."""

from __future__ import annotations

import math
from collections import defaultdict, deque
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msg_schemas import machine, topics
from msg_schemas.events import JumpEvent
from msg_schemas.faults import JumpFailure, JumpFault
from msg_schemas.parameters import from_mapping
from msg_schemas.phases import JumpPhase
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import ImuSample, JointSample, JointValue, Level, WrenchSample
from msg_schemas.table import TOPICS
from rover_control.jump.jump_parameters import JumpParameters
from rover_control.jump.jump_sensors import Sensors
from rover_control.jump.jump_sequence import JumpSequence, NutCommand, Transition

NANO = 1_000_000_000
PARAMETERS = from_mapping(JumpParameters, {"max_stroke": 0.3, "nut_time_margin": 1.5})
SPRING = 824.0
GRAVITY = 9.81


class Rover:
    """A rover that stands, compresses, flies for half a second and lands.

    Sensors publish at 100 Hz, the sequence is stepped at 20 Hz. After a release the nut of a
    rover that `springs_back` is above the latch again; otherwise it must be driven past it.
    """

    def __init__(self, parameters: JumpParameters = PARAMETERS) -> None:
        self.sequence = JumpSequence(parameters)
        self.sensors = Sensors()
        self.now_ns = 1_000 * NANO
        self.compression = 0.0
        self.contact = 1.0
        self.force = GRAVITY
        self.tilt = self.rate = self.tension = 0.0
        self.hooked = True
        self.springs_back = self.lifts = True
        self.flight_left = 0.0
        self.flight_time = 0.5
        self.command: NutCommand | None = None
        self.transitions: list[Transition] = []
        self.stale: set[str] = set()
        self.lag: dict[str, float] = {}  # of a topic [s]
        self.underway: defaultdict[str, deque[JointSample | ImuSample]] = defaultdict(deque)
        self.stuck = False
        self.latch_works = True
        self.run(0.1)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 100)):
            self.now_ns += NANO // 100
            self._move(0.01)
            self._sense()
            if self.now_ns % (5 * NANO // 100) == 0:
                self.command = self.sequence.step(self.sensors, self.now_ns)
                self.transitions += self.sequence.take_transitions()

    def _move(self, dt: float) -> None:
        if self.flight_left > 0.0:
            self.flight_left -= dt
            if self.flight_left <= 0.0:
                self.contact, self.force = 1.0, GRAVITY
            return
        if self.command is None or self.stuck:
            return
        distance = self.command.compression - self.compression
        if abs(distance) > self.command.rate * dt:
            self.compression += math.copysign(self.command.rate * dt, distance)
            return
        self.compression = self.command.compression
        self.hooked = self.hooked or self.compression <= 0.0
        if self.compression > 0.0 and self.command.trips and self.latch_works:
            if self.springs_back:
                self.compression = 0.0
            self.hooked = self.springs_back
            self.command = None
            if self.lifts:
                self.contact, self.force = 0.0, 0.2
                self.flight_left = self.flight_time

    def _sense(self) -> None:
        contact = JointSample(self.now_ns, {machine.FLOOR_SWITCH: JointValue(self.contact)})
        held = SPRING * max(self.compression, 0.0) if self.hooked else 0.0
        nut = JointSample(
            self.now_ns, {machine.JUMP_SCREW: JointValue(self.compression, 0.0, held)}
        )
        up = (self.force * math.sin(self.tilt), 0.0, self.force * math.cos(self.tilt))
        imu = ImuSample(self.now_ns, (0.0, 0.0, self.rate), up)
        cell = WrenchSample(self.now_ns, (0.0, 0.0, self.tension))
        self.sensors = self.sensors.with_load_cell(cell, self.now_ns)
        for topic, sample in (
            (topics.CONTACT, contact),
            (topics.JUMP_MOTOR_STATE, nut),
            (topics.IMU, imu),
        ):
            if topic not in self.stale:
                self.underway[topic].append(sample)
        for topic, waiting in self.underway.items():
            due = self.now_ns - round(self.lag.get(topic, 0.0) * NANO)
            while waiting and waiting[0].stamp_ns <= due:
                self._receive(waiting.popleft())

    def _receive(self, sample: JointSample | ImuSample) -> None:
        if isinstance(sample, ImuSample):
            self.sensors = self.sensors.with_imu(sample, self.now_ns)
        elif machine.FLOOR_SWITCH in sample.joints:
            self.sensors = self.sensors.with_contact(sample, self.now_ns)
        else:
            self.sensors = self.sensors.with_jump_motor(sample, self.now_ns)

    def request(self, stroke: float = 0.2, speed: float = 0.1) -> None:
        self.sequence.request(stroke, speed, self.sensors, self.now_ns)

    def abort(self) -> str:
        return self.sequence.abort(self.sensors, self.now_ns)

    @property
    def phases(self) -> list[JumpPhase]:
        return [change.phase for change in self.transitions]

    @property
    def last_fault(self) -> object:
        return self.transitions[-1].event.values["fault"]


@pytest.fixture
def rover() -> Rover:
    return Rover()


COMPRESSING, LETTING_DOWN = JumpPhase.COMPRESSING, JumpPhase.LETTING_DOWN
SETTLING, RELEASING, HOOKING = JumpPhase.SETTLING, JumpPhase.RELEASING, JumpPhase.HOOKING
FLIGHT, LANDED, STANDBY, FAULT = (
    JumpPhase.FLIGHT, JumpPhase.LANDED, JumpPhase.STANDBY, JumpPhase.FAULT,
)  # fmt: skip
JUMPS = [COMPRESSING, SETTLING, RELEASING, FLIGHT]


def test_a_jump_goes_through_its_phases_and_back_to_standby(rover: Rover):
    rover.request(0.2, 0.1)
    rover.run(1.0)
    assert rover.command == (0.2, 0.1, PARAMETERS.max_nut_force, False)
    rover.run(3.0)
    assert rover.phases == [*JUMPS, LANDED, STANDBY]
    assert all(change.event.level is Level.OK for change in rover.transitions)
    assert rover.command is None
    landed = rover.transitions[4]
    assert landed.event.values["flight_time"] == pytest.approx(0.5, abs=0.015)


def test_a_nut_below_the_latch_is_driven_past_it_after_landing(rover: Rover):
    rover.springs_back = False
    for jumps in (1, 2):
        rover.request()
        rover.run(12.0)
        assert rover.phases == [*JUMPS, LANDED, HOOKING, STANDBY] * jumps
        assert rover.hooked
        assert rover.compression == PARAMETERS.nut_park_position


def test_a_nut_that_does_not_move_up_is_a_fault(rover: Rover):
    rover.springs_back = False
    rover.request()
    rover.run(3.5)
    rover.stuck = True
    rover.run(15.0)
    assert rover.phases == [*JUMPS, LANDED, HOOKING, FAULT]
    assert rover.last_fault == JumpFault.LATCH_NOT_HOOKED


def test_an_unhooked_latch_is_detected_early_and_hooked_by_letting_down(rover: Rover):
    rover.hooked = False
    rover.request()
    rover.run(4.0)
    assert rover.phases == [COMPRESSING, LETTING_DOWN, STANDBY]
    assert rover.transitions[1].event.values["cause"] == JumpFailure.NOT_HOOKED
    assert rover.transitions[1].event.values["compression"] == pytest.approx(
        PARAMETERS.hook_check_stroke, abs=0.006
    )


@pytest.mark.parametrize(
    ("attribute", "value", "cause"),
    [("tilt", 0.5, JumpFailure.TILTED), ("tension", 3.0, JumpFailure.TAUT)],
)
def test_tilt_or_tension_beyond_the_limit_prevents_the_release(
    rover: Rover, attribute: str, value: float, cause: JumpFailure
):
    setattr(rover, attribute, value)
    rover.request()
    rover.run(15.0)
    assert rover.phases == [COMPRESSING, SETTLING, LETTING_DOWN, STANDBY]
    cancelled = rover.transitions[2].event
    assert cancelled.values["cause"] == cause
    assert cancelled.values[attribute] == value
    assert rover.compression == 0.0


def test_a_restless_rover_is_not_released(rover: Rover):
    rover.rate = 0.2
    rover.request()
    rover.run(15.0)
    assert rover.phases == [COMPRESSING, SETTLING, LETTING_DOWN, STANDBY]
    assert rover.transitions[2].event.values["cause"] == JumpFailure.NOT_QUIET


def test_the_release_waits_until_the_rover_is_quiet(rover: Rover):
    rover.rate = 0.2
    rover.request()
    rover.run(4.0)
    assert rover.phases == [COMPRESSING, SETTLING]
    rover.rate = 0.0
    rover.run(0.5)
    assert rover.phases == JUMPS


def test_an_abort_while_the_spring_is_held_lets_it_down(rover: Rover):
    rover.rate = 0.2
    rover.request()
    rover.run(3.0)
    assert rover.sequence.phase is SETTLING
    rover.abort()
    rover.run(6.0)
    assert rover.phases == [COMPRESSING, SETTLING, LETTING_DOWN, STANDBY]


def test_a_release_without_take_off_is_reported_and_hooked_again(rover: Rover):
    rover.springs_back = rover.lifts = False
    rover.request(0.1, 0.1)
    rover.run(10.0)
    assert rover.phases == [*JUMPS, LANDED, HOOKING, STANDBY]
    assert rover.transitions[4].event.name is JumpEvent.NO_TAKE_OFF


def test_a_toppled_rover_is_a_fault(rover: Rover):
    rover.request()
    rover.run(2.9)
    rover.tilt = 1.5
    rover.run(3.0)
    assert rover.phases == [*JUMPS, LANDED, FAULT]
    assert rover.last_fault == JumpFault.TOPPLED


def test_a_second_jump_follows_the_first(rover: Rover):
    for _ in range(2):
        rover.request()
        rover.run(4.0)
    assert rover.phases == [*JUMPS, LANDED, STANDBY] * 2


def test_no_command_is_sent_in_standby_and_flight(rover: Rover):
    assert rover.command is None
    rover.flight_time = 2.0
    rover.request()
    rover.run(3.0)
    assert rover.sequence.phase is FLIGHT
    assert rover.command is None


@given(
    stroke=st.floats(0.005, 0.3),
    speed=st.floats(0.01, 0.5),
    flight_time=st.floats(0.03, 3.0),
)
@settings(max_examples=60, deadline=None)
def test_every_stroke_speed_and_flight_time_completes(
    stroke: float, speed: float, flight_time: float
):
    rover = Rover()
    rover.flight_time = flight_time
    rover.request(stroke, speed)
    rover.run(stroke / speed + flight_time + 3.0)
    assert rover.phases == [*JUMPS, LANDED, STANDBY]


def refusal(rover: Rover, stroke: float = 0.2) -> Refusal:
    before = rover.sequence.phase
    with pytest.raises(Refusal) as caught:
        rover.request(stroke)
    assert rover.sequence.phase is before
    return caught.value


def test_a_request_during_a_jump_is_refused(rover: Rover):
    rover.request()
    rover.run(0.5)
    assert refusal(rover).code is RefusalCode.WRONG_PHASE


def test_a_request_without_ground_contact_is_refused(rover: Rover):
    rover.contact = 0.0
    rover.run(0.1)
    assert "contact switch is open" in refusal(rover).reason


def test_a_request_with_a_compressed_spring_is_refused_until_an_abort(rover: Rover):
    rover.compression = 0.05
    rover.run(0.1)
    assert "compressed by 0.05 m" in refusal(rover).reason
    assert rover.abort() == "letting the spring down"
    rover.run(2.0)
    assert (rover.compression, rover.sequence.phase) == (0.0, STANDBY)
    rover.request()


def test_a_stroke_beyond_the_limit_is_refused(rover: Rover):
    raised = refusal(rover, 0.31)
    assert raised.code is RefusalCode.OUT_OF_LIMITS
    assert "limit 0.3 m" in raised.reason


@pytest.mark.parametrize("sensor", [topics.CONTACT, topics.JUMP_MOTOR_STATE, topics.IMU])
def test_a_request_without_a_sensor_is_refused(rover: Rover, sensor: str):
    assert "never received" in _refused_without_sensors()
    rover.stale = {sensor}
    rover.run(0.3)
    raised = refusal(rover)
    assert raised.code is RefusalCode.STALE
    assert sensor in raised.reason


def _refused_without_sensors() -> str:
    with pytest.raises(Refusal) as caught:
        JumpSequence(PARAMETERS).request(0.1, 0.0, Sensors(), NANO)
    return caught.value.reason


def test_stale_sensors_are_named():
    everything = (topics.CONTACT, topics.JUMP_MOTOR_STATE, topics.IMU)
    assert JumpSequence(PARAMETERS).waiting_for(Sensors(), NANO) == everything
    rover = Rover()
    assert rover.sequence.waiting_for(rover.sensors, rover.now_ns) == ()
    rover.stale = {topics.JUMP_MOTOR_STATE}
    rover.run(2.0 * PARAMETERS.sensor_timeout)
    assert rover.sequence.waiting_for(rover.sensors, rover.now_ns) == (topics.JUMP_MOTOR_STATE,)


def test_late_samples_count_at_their_time_stamps(rover: Rover):
    rover.lag = dict.fromkeys((topics.CONTACT, topics.JUMP_MOTOR_STATE, topics.IMU), 0.2)
    rover.run(0.3)
    rover.request()
    rover.run(6.0)
    assert rover.phases == [*JUMPS, LANDED, STANDBY]
    assert rover.transitions[4].event.values["flight_time"] == pytest.approx(0.5, abs=0.015)


@pytest.mark.parametrize("late", [topics.CONTACT, topics.JUMP_MOTOR_STATE])
def test_unequal_sensor_delays_do_not_change_the_sequence(rover: Rover, late: str):
    rover.lag = {late: 2.0 * PARAMETERS.contact_loss_time}
    rover.run(0.3)
    rover.request()
    rover.run(6.0)
    assert rover.phases == [*JUMPS, LANDED, STANDBY]


def test_a_sensor_with_another_clock_is_stale(rover: Rover):
    ahead = ImuSample(rover.now_ns + 3 * NANO, (0.0, 0.0, 0.0), (0.0, 0.0, GRAVITY))
    rover.sensors = rover.sensors.with_imu(ahead, rover.now_ns)
    assert "stamped 3 s ahead" in refusal(rover).reason


def test_an_abort_lets_the_spring_down_slowly(rover: Rover):
    rover.request()
    rover.run(1.0)
    rover.abort()
    rover.run(0.1)
    assert rover.command == (0.0, PARAMETERS.let_down_speed, PARAMETERS.max_nut_force, False)
    assert rover.abort() == "the spring is already being let down"
    rover.run(3.0)
    assert rover.phases == [COMPRESSING, LETTING_DOWN, STANDBY]
    assert rover.compression == 0.0
    assert rover.sequence.step(rover.sensors, rover.now_ns) is None


def test_an_abort_in_standby_does_nothing(rover: Rover):
    assert rover.abort() == "the spring is already let down"
    assert rover.phases == []


def test_an_abort_in_standby_is_refused_while_the_nut_position_is_unknown(rover: Rover):
    rover.stale = {topics.JUMP_MOTOR_STATE}
    rover.run(1.0)
    with pytest.raises(Refusal, match="s old") as caught:
        rover.abort()
    assert caught.value.code is RefusalCode.STALE
    assert rover.phases == []


def test_an_abort_while_compressing_needs_no_nut_position(rover: Rover):
    rover.request()
    rover.run(0.5)
    rover.stale = {topics.JUMP_MOTOR_STATE}
    rover.abort()
    rover.run(0.1)
    assert rover.command == (0.0, PARAMETERS.let_down_speed, PARAMETERS.max_nut_force, False)
    rover.run(20.0)
    assert rover.phases[-1] is FAULT


def test_an_abort_in_flight_is_refused(rover: Rover):
    rover.flight_time = 3.0
    rover.request()
    rover.run(2.5)
    assert rover.sequence.phase is FLIGHT
    with pytest.raises(Refusal, match="latch has tripped"):
        rover.abort()


def test_a_stuck_nut_is_a_fault_that_an_abort_clears(
    rover: Rover,
):
    rover.request()
    rover.run(0.5)
    rover.stuck = True
    rover.run(4.0)
    assert rover.phases == [COMPRESSING, LETTING_DOWN]
    assert rover.transitions[-1].event.values["cause"] == JumpFailure.NOT_COMPRESSED
    rover.run(10.0)
    assert rover.phases[-1] is FAULT
    assert rover.command is None
    assert topics.JUMP_ABORT in refusal(rover).reason
    rover.stuck = False
    rover.abort()
    rover.run(3.0)
    assert rover.sequence.phase is STANDBY
    rover.request()


def test_a_latch_that_does_not_trip_lets_the_spring_down(rover: Rover):
    rover.latch_works = False
    rover.request()
    rover.run(15.0)
    assert rover.phases == [COMPRESSING, SETTLING, RELEASING, LETTING_DOWN, STANDBY]
    assert rover.transitions[3].event.values["cause"] == JumpFailure.NOT_TRIPPED
    assert rover.compression == 0.0


@pytest.mark.parametrize("sensor", [topics.CONTACT, topics.JUMP_MOTOR_STATE, topics.IMU])
def test_a_stale_sensor_while_compressing_ends_the_jump(rover: Rover, sensor: str):
    rover.request()
    rover.run(0.5)
    rover.stale = {sensor}
    rover.run(1.0)
    assert rover.phases == [COMPRESSING, LETTING_DOWN]
    failed = rover.transitions[-1].event
    assert failed.name is JumpEvent.FAILED
    assert failed.values["cause"] == JumpFailure.SENSOR_TIMEOUT
    assert sensor in failed.message


def test_lifting_the_rover_with_the_spring_held_is_no_take_off(rover: Rover):
    rover.request()
    rover.run(1.0)
    rover.contact = 0.0
    rover.run(0.5)
    assert rover.phases == [COMPRESSING, LETTING_DOWN]
    assert rover.transitions[-1].event.values["cause"] == JumpFailure.LIFTED


def test_contact_bounce_is_no_lift(rover: Rover):
    rover.request()
    rover.run(0.5)
    for _ in range(10):
        rover.contact = 0.0
        rover.run(0.05)
        rover.contact = 1.0
        rover.run(0.05)
    assert rover.phases == [COMPRESSING]


def test_a_flight_without_landing_is_a_fault(rover: Rover):
    rover.flight_time = 1000.0
    rover.request()
    rover.run(PARAMETERS.flight_timeout + 3.0)
    assert rover.phases == [*JUMPS, FAULT]
    assert rover.last_fault == JumpFault.NO_LANDING


def test_a_landing_without_rest_is_a_fault(rover: Rover):
    rover.request()
    rover.run(3.0)
    for _ in range(60):
        rover.force = 5.0
        rover.run(0.05)
        rover.force = GRAVITY
        rover.run(0.05)
    assert rover.phases == [*JUMPS, LANDED, FAULT]
    assert rover.last_fault == JumpFault.NOT_AT_REST


def test_a_clock_jump_back_restarts_the_sequence(rover: Rover):
    rover.request()
    rover.run(0.5)
    rover.sequence.clock_jumped(0)
    changes = rover.sequence.take_transitions()
    assert [change.phase for change in changes] == [STANDBY]
    assert rover.sequence.step(Sensors(), NANO) is None


def test_the_requested_speed_overrides_the_parameter(rover: Rover):
    rover.request(0.1, 0.0)
    rover.run(0.1)
    assert rover.command is not None
    assert rover.command.rate == PARAMETERS.nut_speed


def test_changed_limits_apply():
    rover = Rover(replace(PARAMETERS, max_stroke=0.1))
    assert "limit 0.1 m" in refusal(rover, 0.2).reason


def test_every_phase_is_in_the_contract():
    assert {phase.value for phase in JumpPhase} == {*TOPICS[topics.JUMP_PHASE].words}
