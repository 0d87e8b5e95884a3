"""The descent's supervision with the winch's own controller on a reduced hoist, without ROS."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import pytest
from hanging_machine import WALL, HangingMachine
from winch_hoist import TICK, Hoist, HoistParameters, Readings
from winch_session import Session

from msg_schemas import machine, topics
from msg_schemas.events import DescentEvent, EventReport, WinchEvent
from msg_schemas.faults import Reason
from msg_schemas.parameters import ParameterError
from msg_schemas.phases import DescentPhase, DrivePhase, JumpPhase, WinchMode
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample, JointValue, WrenchSample
from msg_schemas.table import TOPICS
from rover_control.coordination.motor_handover import HANDOVER_TIME
from rover_control.hanging.attitude import RotorParameters
from rover_control.hanging.descent import DescentCommands, DescentController
from rover_control.hanging.descent_parameters import DescentParameters, ProfileParameters
from rover_control.hanging.descent_report import observation_sample, state_sample
from rover_control.hanging.descent_requests import DescentRequests
from rover_control.hanging.descent_settings import DescentSettings
from rover_control.hanging.descent_stop import DescentStop
from rover_control.hanging.hanging_controller import HangingControllerParameters
from rover_control.hanging.observations import Observation
from tether_winch.winch import WinchController
from tether_winch.winch_parameters import WinchParameters

QUICK = ProfileParameters(
    estimator_settling_time=0.5, steady_dwell=0.3, exposures=2, exposure_interval=0.2
)
NOTHING = DescentCommands()


class World:
    """A descent with a simulated winch and hanging rover."""

    def __init__(self, length: float = 5.0, swing: float = 0.0) -> None:
        self.winch = Session(
            WinchController(WinchParameters()), Hoist(HoistParameters(start_length=length))
        )
        self.rover = HangingMachine(length, swing)
        self.descent = DescentController(
            DescentSettings(hanging_controller=HangingControllerParameters(profile=QUICK))
        )
        self.requests = DescentRequests(self.descent)
        self.silent: set[str] = set()
        self.sent: list[DescentCommands] = []
        self.changes: list[EventReport] = []
        self.observations: list[Observation] = []
        self.readings: Readings | None = None
        self._mode = ""

    @property
    def length(self) -> float:
        assert self.readings is not None
        return self.readings.length

    def tick(self, *, is_alive: bool = True) -> None:
        self.readings = readings = self.winch.tick()
        self.rover.step(readings.length, readings.rate)
        if not is_alive:
            return
        now, descent = self.winch.now_ns, self.descent
        handlers: dict[str, Callable[..., None]] = {
            topics.IMU: descent.on_imu,
            topics.WHEEL_STATE: descent.on_wheels,
            topics.FLYWHEEL_STATE: descent.on_flywheel,
        }
        for name, sample in self.rover.samples(now):
            if name in self.silent:
                continue
            if name == topics.CAMERA:
                descent.on_camera(sample)  # type: ignore[arg-type]
            else:
                handlers[name](sample, now)
        drum = {
            machine.WINCH_DRUM: JointValue(readings.length, readings.rate),
            machine.WINCH_BRAKE: JointValue(float(readings.brake_is_open)),
        }
        if topics.WINCH_STATE not in self.silent:
            descent.controller.on_drum(JointSample(now, drum), now)
        if self.winch.winch.mode.value != self._mode:
            self._mode = self.winch.winch.mode.value
            descent.on_winch_mode(self._mode, now)
        if len(self.winch.ticks) % 2 == 0:
            self.control()

    def control(self) -> None:
        commands = self.descent.step(self.winch.now_ns)
        self.sent.append(commands)
        self.changes += self.descent.take_changes()
        self.observations += self.descent.observations.take()
        coasts = self.rover.wheel_rate * 0.9
        self.rover.wheel_rate = coasts if commands.wheel_rate is None else commands.wheel_rate
        self.rover.flywheel_torque = commands.flywheel_torque or 0.0
        if commands.winch is not None:
            self.winch.request(machine.WINCH_WHILE_RENEWED, *commands.winch)
        if commands.trim is not None and self.winch.winch.mode is WinchMode.LENGTH:
            self.winch.winch.trim(commands.trim, self.winch.now_ns)

    def run(self, duration: float, *, is_alive: bool = True) -> None:
        for _ in range(round(duration / TICK)):
            self.tick(is_alive=is_alive)

    def run_until(self, condition: Callable[[], bool], limit: float = 60.0) -> None:
        for _ in range(round(limit / TICK)):
            if condition():
                return
            self.tick()
        raise AssertionError(f"not within {limit:g} s; transitions: {self.changes}")

    def arm(self) -> None:
        self.run(0.2)
        self.winch.winch.rearm(self.winch.now_ns)
        self.run(0.2)

    def request(self, depth: float, *, observes: bool = True, rate: float = 0.0) -> None:
        self.requests.add_stop(DescentStop(depth, observes, rate), self.winch.now_ns)

    def travel(self) -> None:
        self.arm()
        self.request(9.0, rate=0.2)
        self.run_until(lambda: self.length > 5.5)

    def events(self, name: DescentEvent) -> list[EventReport]:
        return [change for change in self.changes if change.name is name]

    def reasons(self, name: DescentEvent) -> list[Reason | None]:
        return [event.reason for event in self.events(name)]

    @property
    def done(self) -> bool:
        return self.descent.is_engaged and self.descent.controller.profile.is_idle


@pytest.fixture
def world() -> World:
    return World()


def refused(act: Callable[[], object]) -> Refusal:
    with pytest.raises(Refusal) as caught:
        act()
    return caught.value


# ---------------------------------------------------------------------------------------- sequence


def test_a_stop_publishes_each_picture_with_the_camera_report(world: World):
    world.arm()
    assert world.descent.phase == DescentPhase.RELEASED
    world.request(6.0)
    world.run_until(lambda: world.done)
    world.run(0.5)
    assert world.length == pytest.approx(6.0, abs=0.01)
    assert [o.number for o in world.observations] == [1, 2]
    for observation in world.observations:
        assert observation.exposure.depth == pytest.approx(6.0, abs=0.01)
        # The first report whose exposure began at the command or later.
        of = observation.smear * 1e3
        assert 0.1 - 1e-9 <= of - observation.exposure.time < 0.2 + TICK
        assert observation.wall_distance == WALL


def test_nothing_is_driven_before_the_first_stop_and_after_the_release(world: World):
    world.arm()
    world.run(1.0)
    assert set(world.sent) == {NOTHING}
    world.request(5.5, observes=False)
    world.run_until(lambda: world.done)
    assert refused(lambda: world.request(5.5, rate=1.0)).code is RefusalCode.OUT_OF_LIMITS
    world.run(0.5)
    assert world.sent[-1].wheel_rate is not None
    angle = world.descent.controller.turn.angle = 7.0
    assert "released" in world.requests.release()
    before = world.rover.wheel_rate
    assert before < -0.5
    world.run(0.1)
    assert world.descent.phase == DescentPhase.STANDBY  # its wheels still come to rest
    world.run_until(lambda: world.descent.phase == DescentPhase.RELEASED)
    assert abs(world.rover.wheel_rate) < 0.05
    released = len(world.sent)
    world.run(3.0)
    assert set(world.sent[released:]) == {NOTHING}
    assert world.reasons(DescentEvent.RELEASED) == [Reason.REQUESTED]
    assert world.sent[-1] == NOTHING
    assert world.rover.wheel_rate == 0.0
    rates = [d.wheel_rate for d in world.sent if d.wheel_rate is not None][-40:]
    assert max(abs(b - a) for a, b in pairwise(rates)) < 0.03
    assert world.descent.controller.turn.angle == pytest.approx(angle, abs=1e-3)


@pytest.mark.parametrize("stood_since", ["the start", "other parameters"])
def test_a_stance_on_a_slope_does_not_mislead_the_hanging_estimate(world: World, stood_since: str):
    world.arm()
    if stood_since == "other parameters":
        world.request(5.5, observes=False)
        world.run_until(lambda: world.done)
        world.requests.release()
        world.descent.retune(world.descent.settings)
    world.rover.stance = (0.3, 0.1, 1.6)
    world.run(10.0)
    world.rover.stance = None
    world.run(0.5)
    world.request(6.0, observes=False)
    world.run(30.0)
    assert world.done
    assert world.descent.controller.estimator.disturbances == 0


@pytest.mark.parametrize("stood", [False, True])
def test_the_suspended_mass_of_a_rover_that_has_hung_is_kept(world: World, stood: bool):
    world.arm()
    world.run(1.0)
    controller = world.descent.controller
    hanging = controller.parameters.hanging
    mass = 1.2 * hanging.rover_mass + hanging.tether_density * controller.length
    loads = [mass * hanging.rover_gravity] * 2000
    for k, load in enumerate(([0.0] if stood else []) + loads):
        sample = WrenchSample(k * 10_000_000, (0.0, 0.0, load))
        controller.on_load_cell(sample, sample.stamp_ns)
    assert controller.suspended_mass.ratio > 1.1
    world.request(5.5, observes=False)
    assert (controller.suspended_mass.ratio == 1.0) == stood


def test_stops_are_visited_in_order(world: World):
    world.arm()
    for depth in (5.4, 5.8, 5.6):
        world.request(depth)
    assert len(world.descent.controller.profile.stops) == 3
    world.run_until(lambda: world.done)
    world.run(0.5)
    depths = [round(o.exposure.depth, 1) for o in world.observations]
    assert depths == [5.4, 5.4, 5.8, 5.8, 5.6, 5.6]


def test_a_travel_is_held_resumed_and_aborted(world: World):
    world.travel()
    assert "holding" in world.requests.hold(world.winch.now_ns)
    world.run(4.0)
    held = world.length
    assert held == pytest.approx(5.5, abs=0.1)
    assert world.winch.winch.mode is WinchMode.HOLD
    assert refused(lambda: world.request(6.0)).subject == topics.DESCENT_REQUEST
    assert "1 stops" in world.requests.resume(world.winch.now_ns)
    world.run_until(lambda: world.length > 6.5)
    assert "1 stops" in world.requests.abort(world.winch.now_ns)
    assert world.done
    world.run(0.1)
    world.requests.release()  # while the winch still comes to rest
    world.run(4.0)
    assert world.length == pytest.approx(6.5, abs=0.1)
    assert world.winch.winch.mode is WinchMode.HOLD
    assert not [t for _, t in world.winch.transitions if t.reason is Reason.RENEWAL_TIMEOUT]
    assert all(commands.winch is None for commands in world.sent[-50:])


def test_a_turn_requires_that_no_stop_is_left(world: World):
    world.arm()
    now = world.winch.now_ns
    # Without a swing the gyro bias is unobservable, so a hold is short.
    pointing = world.descent.controller.pointing
    pointing.parameters = replace(pointing.parameters, min_hold_time=5.0)
    assert refused(lambda: world.requests.turn(math.pi, now)).subject == topics.DESCENT_REQUEST
    world.requests.turn(0.05, now)
    assert world.descent.is_engaged
    world.run(0.5)
    (begun,) = world.events(DescentEvent.POINTING_STARTED)
    assert "turn by 3 deg" in begun.message
    state = state_sample(world.descent, world.winch.now_ns)
    assert state is not None
    goal = state.joints[machine.HEADING_GOAL].position - state.joints[machine.HEADING].position
    assert goal == pytest.approx(0.05, abs=0.01)
    world.request(5.5, observes=False)
    assert refused(lambda: world.requests.turn(0.05, now)).code is RefusalCode.WRONG_PHASE
    world.run_until(lambda: world.done)
    assert len(world.reasons(DescentEvent.POINTING_RELEASED)) == 1
    world.run(0.5)
    world.requests.turn(0.05, world.winch.now_ns)
    world.silent.add(topics.IMU)
    world.run(1.5)
    (lost,) = world.events(DescentEvent.POINTING_LOST)
    assert lost.reason is Reason.SENSOR_TIMEOUT
    assert topics.IMU in lost.message
    assert not world.descent.controller.pointing.is_active


def test_the_rotors_begin_from_rest_after_a_turn_that_a_release_ended(world: World):
    world.arm()
    pointing = world.descent.controller.pointing
    pointing.parameters = replace(pointing.parameters, min_hold_time=0.0)
    world.requests.turn(0.3, world.winch.now_ns)
    world.run(4.0)
    assert pointing.is_coning
    world.requests.release()
    world.run_until(lambda: world.descent.phase == DescentPhase.RELEASED)
    world.request(5.5, observes=False)
    world.run(0.1)
    assert not world.descent.controller.pointing.is_coning


# --------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize("depth", [1.0, 60.0, math.nan])
def test_a_depth_out_of_limits_is_refused_with_the_limits(world: World, depth: float):
    world.arm()
    refusal = refused(lambda: world.request(depth))
    assert (refusal.subject, refusal.code) == (topics.DESCENT_REQUEST, RefusalCode.OUT_OF_LIMITS)
    assert "1.6 .. 48 m" in refusal.reason
    assert not world.descent.is_engaged


def test_a_request_in_a_wrong_state_is_refused_with_the_reason(world: World):
    assert refused(lambda: world.request(6.0)).code is RefusalCode.STALE
    world.run(0.5)
    unarmed = refused(lambda: world.request(6.0))
    assert unarmed.code is RefusalCode.NOT_ARMED
    assert topics.WINCH_REARM in unarmed.reason
    world.arm()
    now = world.winch.now_ns
    assert refused(lambda: world.requests.hold(now)).code is RefusalCode.WRONG_PHASE
    assert refused(lambda: world.requests.resume(now)).code is RefusalCode.WRONG_PHASE
    world.descent.rotors.on_phase(topics.JUMP_PHASE, JumpPhase.FLIGHT, world.winch.now_ns)
    assert "a jump is in progress" in refused(lambda: world.request(6.0)).reason
    world.descent.rotors.on_phase(topics.JUMP_PHASE, JumpPhase.STANDBY, world.winch.now_ns)
    nut = world.descent.nut
    screw, nut.screw = nut.screw, 20.0
    assert topics.JUMP_ABORT in refused(lambda: world.request(6.0)).reason
    nut.screw = screw
    world.request(6.0)
    assert refused(world.requests.release).code is RefusalCode.WRONG_PHASE


def test_rotors_follow_when_jump_and_drive_have_released_their_motors(world: World):
    world.arm()
    world.descent.rotors.on_phase(topics.DRIVE_PHASE, DrivePhase.DRIVING, world.winch.now_ns)
    driving = refused(lambda: world.request(6.0))
    assert driving.code is RefusalCode.WRONG_PHASE
    assert topics.DRIVE_STOP in driving.reason
    for topic, used, released in (
        (topics.DRIVE_PHASE, DrivePhase.DRIVING, DrivePhase.RELEASED),
        (topics.JUMP_PHASE, JumpPhase.LETTING_DOWN, JumpPhase.STANDBY),
    ):
        world.descent.rotors.on_phase(topic, used, world.winch.now_ns)
        world.run(0.1)
        world.descent.rotors.on_phase(topic, released, world.winch.now_ns)
        if not world.descent.is_engaged:
            world.request(6.0, observes=False)
        world.sent.clear()
        world.run(HANDOVER_TIME - 0.05)
        assert {(sent.wheel_rate, sent.flywheel_torque, sent.nut) for sent in world.sent} == {
            (None, None, None)
        }
        world.run(0.1)
        assert world.sent[-1].wheel_rate is not None


TURNING = 2.0
"""Rate of a wheel that descent leaves to another controller [rad/s]."""


def leave_to(world: World, topic: str, phase: str, *, released: bool) -> list[DescentCommands]:
    """Commands after another controller takes a motor from a descent whose wheel turns."""
    world.arm()
    pointing = world.descent.controller.pointing
    pointing.parameters = replace(pointing.parameters, min_hold_time=0.0)
    world.requests.turn(0.3, world.winch.now_ns)
    world.run_until(lambda: abs(world.sent[-1].wheel_rate or 0.0) > TURNING)
    if released:
        world.requests.release()
    world.descent.rotors.on_phase(topic, phase, world.winch.now_ns)
    world.sent.clear()
    world.run(4.0)
    return world.sent


@pytest.mark.parametrize("released", [False, True])
def test_the_wheel_comes_to_rest_while_the_spring_is_let_down(world: World, released: bool):
    sent = leave_to(world, topics.JUMP_PHASE, JumpPhase.LETTING_DOWN, released=released)
    rates = [commands.wheel_rate for commands in sent if commands.wheel_rate is not None]
    change = world.descent.settings.hanging_controller.rotors.wheel_acceleration * 2.0 * TICK
    assert abs(rates[0]) > TURNING - 2.0 * change
    assert all(abs(b - a) <= change + 1e-9 for a, b in pairwise(rates))
    assert rates[-1] == 0.0
    assert {(commands.flywheel_torque, commands.nut) for commands in sent} == {(None, None)}
    assert world.sent[-1].wheel_rate is None


@pytest.mark.parametrize("released", [False, True])
def test_a_wheel_that_another_controller_drives_is_left_to_it(world: World, released: bool):
    sent = leave_to(world, topics.DRIVE_PHASE, DrivePhase.DRIVING, released=released)
    assert {commands.wheel_rate for commands in sent} == {None}


def test_a_wheel_that_coasts_is_not_driven_by_a_release_with_other_parameters(world: World):
    world.arm()
    pointing = world.descent.controller.pointing
    pointing.parameters = replace(pointing.parameters, min_hold_time=0.0)
    world.requests.turn(0.3, world.winch.now_ns)
    world.run_until(lambda: abs(world.sent[-1].wheel_rate or 0.0) > TURNING)
    world.silent.add(topics.IMU)
    world.run_until(lambda: world.sent[-1].wheel_rate is None, 5.0)
    world.descent.retune(world.descent.settings)
    world.requests.release()
    world.sent.clear()
    world.run(1.0)
    assert {commands.wheel_rate for commands in world.sent} == {None}


def test_a_nut_is_not_driven_clear_while_the_spring_is_let_down(world: World):
    world.arm()
    world.rover.screw = 0.0
    world.run(0.1)
    world.request(6.0, observes=False)
    world.run(0.2)
    assert world.sent[-1].nut is not None
    world.descent.rotors.on_phase(topics.JUMP_PHASE, JumpPhase.LETTING_DOWN, world.winch.now_ns)
    world.sent.clear()
    world.run(5.0)
    assert {sent.nut for sent in world.sent} == {None}


def test_a_nut_on_the_latch_is_driven_clear_before_the_rotors_are_used(world: World):
    world.arm()
    world.rover.screw = 0.0
    world.run(0.1)
    world.request(6.0, observes=False)
    world.run(0.2)
    ordered = [commands for commands in world.sent if commands.nut is not None]
    assert ordered[-1].nut == pytest.approx(-0.030, abs=1e-4)
    assert all(commands.flywheel_torque is None for commands in ordered)
    assert all(commands.wheel_rate is None for commands in ordered)
    world.rover.screw = RotorParameters().screw_travel_centre + 5.0
    world.run_until(lambda: world.done)
    assert world.reasons(DescentEvent.NUT_CLEARING_COMPLETED)
    assert world.sent[-1].nut is None
    assert world.sent[-1].flywheel_torque is not None


def test_estimation_pauses_after_a_release_and_restarts_with_the_next_stop(world: World):
    world.arm()
    world.request(6.0, observes=False)
    world.run_until(lambda: world.done)
    world.requests.release()
    world.run(1.0)
    estimator, angle = world.descent.controller.estimator, world.descent.controller.turn.angle
    known, bias = estimator.estimate, estimator.yaw_bias
    world.run(5.0)
    assert estimator.estimate == known
    assert world.descent.controller.turn.angle == pytest.approx(angle, abs=0.05)
    begun = len(world.changes)
    world.request(5.0, observes=False)
    assert estimator.yaw_bias == bias
    assert estimator.estimate.swing_error > known.swing_error
    world.run(0.5 * world.descent.settings.hanging_controller.profile.estimator_settling_time)
    names = [change.name for change in world.changes[begun:]]
    assert DescentEvent.TRAVELLING not in names
    world.run_until(lambda: world.length < 5.01)


def test_a_nut_that_stays_on_the_latch_ends_in_a_hold(world: World):
    quick = replace(world.descent.settings, descent=DescentParameters(nut_timeout=2.0))
    world.descent.retune(quick)
    world.arm()
    world.rover.screw = 0.0
    world.run(0.1)
    world.request(6.0)
    world.run_until(lambda: world.descent.interruption != "")
    assert "is not clear of the latch" in world.descent.interruption


def test_depth_limits_in_the_wrong_order_are_refused():
    with pytest.raises(ParameterError, match="less than max_depth"):
        DescentParameters(min_depth=10.0, max_depth=9.0)


# ---------------------------------------------------------------------------------- interruptions


@pytest.mark.parametrize(
    "topic", [topics.IMU, topics.WINCH_STATE, topics.WHEEL_STATE, topics.FLYWHEEL_STATE]
)
def test_a_sensor_timeout_interrupts_until_a_resume(world: World, topic: str):
    world.travel()
    world.silent.add(topic)
    world.run_until(lambda: world.descent.phase == DescentPhase.HOLDING, 2.0)
    assert world.reasons(DescentEvent.INTERRUPTED) == [Reason.SENSOR_TIMEOUT]
    assert topic in world.descent.interruption
    world.run(3.0)
    assert world.winch.winch.mode is WinchMode.HOLD
    assert set(world.sent[-50:]) == {NOTHING}
    assert refused(lambda: world.requests.resume(world.winch.now_ns)).code is RefusalCode.STALE
    world.silent.clear()
    length, begun = world.length, len(world.sent)
    world.run(0.2)
    assert (
        "estimate settles in" in refused(lambda: world.requests.resume(world.winch.now_ns)).reason
    )
    world.run(3.0)
    assert world.length == length
    world.requests.resume(world.winch.now_ns)
    world.run_until(lambda: world.length > length + 0.5)
    rates = [d.wheel_rate for d in world.sent[begun:] if d.wheel_rate is not None]
    assert abs(rates[0]) < 0.1  # the wheel continues from rest
    assert max(abs(b - a) for a, b in pairwise(rates[:10])) < 0.03


def test_a_late_step_does_not_time_its_sensors_out(world: World):
    world.travel()
    for _ in range(3):
        world.run(0.6, is_alive=False)
        world.control()  # before it receives the queued samples
        world.run(0.2)
    assert not world.reasons(DescentEvent.INTERRUPTED)
    assert world.descent.phase == DescentPhase.TRAVELLING


def test_rotors_do_not_follow_a_delayed_gyro(world: World):
    world.travel()
    rate = world.rover.wheel_rate
    for _ in range(3):
        world.run(0.2, is_alive=False)
        world.control()
        assert world.sent[-1][:2] == (rate, 0.0)
        world.run(0.04)
    assert len(world.reasons(DescentEvent.ROTORS_SUSPENDED)) == 1
    world.run(1.8)
    assert {d[:2] for d in world.sent[-90:]} == {(rate, 0.0)}
    world.run(4.0)
    assert len(world.reasons(DescentEvent.ROTORS_RESUMED)) == 1
    rates = [d.wheel_rate for d in world.sent[-300:] if d.wheel_rate is not None]
    assert max(abs(b - a) for a, b in pairwise(rates)) < 0.05
    assert rates[-1] == world.rover.wheel_rate != rate
    assert world.descent.phase == DescentPhase.TRAVELLING


def stopped(world: World) -> None:
    world.winch.winch.stop("stop requested", world.winch.now_ns)


def held(world: World) -> None:
    world.winch.winch.hold(world.winch.now_ns)


def driven_by_hand(world: World) -> None:
    world.winch.request(machine.WINCH_AT_RATE, 0.0, -0.05)


@pytest.mark.parametrize(
    ("act", "reason"),
    [
        (stopped, Reason.FAULT),
        (held, Reason.TAKEN_OVER),
        (driven_by_hand, Reason.TAKEN_OVER),
    ],
)
def test_a_winch_that_others_use_is_left_alone_until_a_resume(
    world: World, act: Callable[[World], None], reason: Reason
):
    world.travel()
    act(world)
    world.run_until(lambda: world.descent.phase == DescentPhase.HOLDING, 2.0)
    assert world.reasons(DescentEvent.INTERRUPTED) == [reason]
    requests = [d.winch for d in world.sent[-10:] if d.winch is not None]
    world.run(3.0)
    assert [d.winch for d in world.sent[-100:] if d.winch is not None] == []
    assert len(requests) <= 1
    if not world.winch.winch.mode.is_armed:
        assert (
            refused(lambda: world.requests.resume(world.winch.now_ns)).code is RefusalCode.NOT_ARMED
        )
        world.winch.winch.rearm(world.winch.now_ns)
    length = world.length
    world.run(2.0)
    assert world.length == length
    world.requests.resume(world.winch.now_ns)
    world.run_until(lambda: world.length > length + 0.5)


def test_a_winch_that_is_stopped_during_a_trim_is_left_alone():
    world = World(swing=math.radians(3.0))
    world.arm()
    world.request(8.0)
    world.run_until(lambda: world.descent.phase == DescentPhase.DAMPING)
    world.run_until(lambda: world.winch.winch.mode is WinchMode.LENGTH)
    world.run(2.0)
    assert max(abs(d.trim or 0.0) for d in world.sent) > 0.05
    assert not world.reasons(DescentEvent.INTERRUPTED)
    held(world)
    world.run_until(lambda: world.descent.phase == DescentPhase.HOLDING, 2.0)
    assert world.reasons(DescentEvent.INTERRUPTED) == [Reason.TAKEN_OVER]
    world.run(3.0)
    assert {(d.winch, d.trim) for d in world.sent[-100:]} == {(None, None)}


def test_a_winch_that_does_not_accept_the_request_ends_in_a_hold(world: World):
    world.arm()
    world.request(6.0)
    world.winch.request = lambda *_, **__: None  # type: ignore[method-assign]
    world.run_until(lambda: world.descent.phase == DescentPhase.HOLDING, 10.0)
    assert world.reasons(DescentEvent.INTERRUPTED) == [Reason.NOT_ACCEPTED]


def test_a_winch_moved_by_others_between_two_stops_is_not_moved_back(world: World):
    world.arm()
    world.request(5.5, observes=False)
    world.run_until(lambda: world.done)
    world.run(1.0)
    world.winch.request(machine.WINCH_TO_LENGTH, 7.0, 0.3)
    world.run(10.0)
    assert world.length == pytest.approx(7.0, abs=0.01)
    world.request(6.5, observes=False)
    world.run_until(lambda: world.done)
    assert world.length == pytest.approx(6.5, abs=0.02)
    assert min(t.length for t in world.winch.ticks[-500:]) > 6.4


def test_a_winch_whose_controller_dies_comes_to_rest(world: World):
    world.travel()
    length = world.length
    world.run(3.0, is_alive=False)
    assert world.winch.winch.mode is WinchMode.HOLD
    assert length < world.length < length + 0.2 * 1.1 + 0.1
    aborted = [t for _, t in world.winch.transitions if t.name is WinchEvent.MOTION_ABORTED]
    assert [t.reason for t in aborted] == [Reason.RENEWAL_TIMEOUT]


def test_a_halt_stops_the_winch_and_switches_the_motors_off(world: World):
    world.travel()
    last = world.descent.halt()
    assert (last.wheel_rate, last.flywheel_torque) == (0.0, 0.0)
    assert last.winch is not None
    assert last.winch.length == world.length
    assert world.descent.halt() == NOTHING


# ------------------------------------------------------------------------------------------ output


def test_its_samples_follow_the_contract(world: World):
    assert state_sample(world.descent, 0) is None
    world.arm()
    world.run(0.1)
    sample = state_sample(world.descent, world.winch.now_ns)
    assert sample is not None
    assert set(sample.joints) == set(TOPICS[topics.DESCENT_STATE].joints)
    assert sample.joints[machine.DEPTH].position == pytest.approx(5.0, abs=0.01)
    world.request(5.5)
    world.run_until(lambda: world.done)
    world.run(0.5)
    sample = observation_sample(world.observations[0])
    assert sample.joints[machine.PICTURE].position == 1.0
    assert sample.stamp_ns == round(world.observations[0].exposure.time * 1e9)
    without = observation_sample(world.observations[0]._replace(smear=math.nan))
    assert machine.SMEAR not in without.joints
    assert machine.WALL_DISTANCE in without.joints


def test_a_camera_that_falls_silent_leaves_pictures_without_smear(world: World):
    world.arm()
    world.request(5.5)
    world.run_until(lambda: world.descent.phase == DescentPhase.EXPOSING)
    world.silent.add(topics.CAMERA)
    world.run_until(lambda: len(world.observations) == 2)
    assert all(math.isnan(o.smear) for o in world.observations)


def test_a_calm_rover_without_a_camera_takes_no_pictures_before_its_yaw_rate_is_known(
    world: World,
):
    world.silent.add(topics.CAMERA)
    world.arm()
    world.request(5.5)
    world.run(30.0)
    assert not world.observations
    swing = world.descent.controller.swing
    assert swing is not None
    assert swing.yaw_error > QUICK.steady_rate
    world.silent.clear()
    world.run_until(lambda: len(world.observations) == 2)
