"""Handover of jump motor and wheels between the controllers, stepped without ROS."""

from __future__ import annotations

import math

import pytest
from rolling_rover import RollingRover

from msg_schemas import machine, topics
from msg_schemas.phases import DescentPhase, DrivePhase, JumpPhase
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import ImuSample, JointSample, JointValue, TwistSample
from msg_schemas.table import TOPICS
from rover_control.coordination.motor_handover import HANDOVER_TIME, MotorHandover
from rover_control.drive.drive_controller import DriveController
from rover_control.drive.drive_requests import DriveRequests
from rover_control.drive.drive_settings import DriveSettings
from rover_control.jump.jump_controller import JumpController, JumpSettings
from rover_control.jump.jump_sequence import NutCommand

NANO = 1_000_000_000


def test_a_motor_is_free_a_while_after_its_user_has_released_it():
    handover = MotorHandover()
    assert handover.may_command(0.0)
    handover.on_phase(topics.DESCENT_PHASE, DescentPhase.STANDBY, 10.0)
    handover.on_phase(topics.JUMP_PHASE, JumpPhase.STANDBY, 10.0)
    assert handover.is_used_by(topics.DESCENT_PHASE)
    assert not handover.is_used_by(topics.JUMP_PHASE)
    assert not handover.may_command(100.0)
    handover.on_phase(topics.DESCENT_PHASE, DescentPhase.RELEASED, 100.0)
    handover.on_phase(topics.DESCENT_PHASE, DescentPhase.RELEASED, 100.5)
    assert not handover.may_command(100.0 + 0.99 * HANDOVER_TIME)
    assert handover.may_command(100.0 + HANDOVER_TIME)
    handover.clock_jumped()
    assert handover.may_command(1.0)


def test_a_claim_takes_a_motor_that_is_in_use():
    handover = MotorHandover()
    handover.on_phase(topics.DESCENT_PHASE, DescentPhase.STANDBY, 10.0)
    assert not handover.may_command(20.0, 20.0)
    assert not handover.may_command(19.99 + HANDOVER_TIME, 20.0)
    assert handover.may_command(20.01 + HANDOVER_TIME, 20.0)


@pytest.mark.parametrize(
    ("topic", "used", "released"),
    [
        (topics.DESCENT_PHASE, DescentPhase.HOLDING, DescentPhase.RELEASED),
        (topics.DRIVE_PHASE, DrivePhase.STEERED, DrivePhase.STUCK),
        (topics.DRIVE_PHASE, DrivePhase.STANDING, DrivePhase.FAILED),
        (topics.JUMP_PHASE, JumpPhase.LETTING_DOWN, JumpPhase.FAULT),
        (topics.JUMP_PHASE, JumpPhase.FLIGHT, JumpPhase.PREDICTING),
    ],
)
def test_phases_announce_the_use_of_motors(topic: str, used: str, released: str):
    handover = MotorHandover()
    for phase in (used, released, ""):
        handover.on_phase(topic, phase, 0.0)
        assert handover.is_used_by(topic) is (phase == used)


def test_a_drive_has_timed_out_when_the_next_owner_begins():
    owned = [topic for topic in TOPICS.values() if topic.owned]
    assert all(topic.stale.timeout + 0.2 < HANDOVER_TIME < 1.0 for topic in owned)


# ----------------------------------------------------------------------------------------- wheels


def steered(drive: DriveController, rover: RollingRover) -> float | None:
    """Wheel rate of the next step of a rover that an operator steers ahead."""
    DriveRequests(drive).steer(TwistSample(0, (0.1, 0.0, 0.0), (0.0, 0.0, 0.0)), rover.now_ns)
    rover.step(drive)
    return drive.step(rover.now_ns).wheel_rate


def test_a_drive_begins_when_the_descent_has_released_the_wheels():
    rover, drive = RollingRover(), DriveController(DriveSettings())
    for phase in (DescentPhase.STANDBY, DescentPhase.RELEASED):
        drive.wheels.on_descent(phase, rover.now_ns)
        for _ in range(25):
            rover.step(drive)
    drive.wheels.on_descent(DescentPhase.STANDBY, rover.now_ns)
    rover.step(drive)
    drive.wheels.on_descent(DescentPhase.RELEASED, rover.now_ns)
    released = rover.now
    while rover.now < released + HANDOVER_TIME - 0.03:
        assert steered(drive, rover) is None
    for _ in range(5):
        rate = steered(drive, rover)
    assert rate is not None
    assert rate > 0.0


def test_the_wheels_are_in_use_until_they_stand():
    rover, drive = RollingRover(), DriveController(DriveSettings())
    for _ in range(25):
        rover.step(drive)
    for _ in range(100):
        steered(drive, rover)
    DriveRequests(drive).stop(rover.now_ns)
    assert not drive.wheels.is_driving
    steps = 0
    while drive.wheels.is_commanded:
        assert drive.step(rover.now_ns).wheel_rate is not None
        rover.step(drive)
        steps += 1
    assert steps > 10
    assert drive.step(rover.now_ns).wheel_rate is None


# ------------------------------------------------------------------------------------- jump motor


class Standing:
    """A rover whose nut follows its commands, and its jump controller."""

    def __init__(self, nut: float = -0.03) -> None:
        self.jump = JumpController(JumpSettings())
        self.now_ns = NANO
        self.nut = nut
        self.sent: list[NutCommand | None] = []
        self.run(0.5)

    def run(self, time: float) -> None:
        for _ in range(round(time * 100)):
            self.now_ns += NANO // 100
            now = self.now_ns
            self.jump.on_contact(JointSample(now, {machine.FLOOR_SWITCH: JointValue(1.0)}), now)
            force = 824.0 * max(self.nut, 0.0)
            nut = {machine.JUMP_SCREW: JointValue(self.nut, 0.0, force)}
            self.jump.on_jump_motor(JointSample(now, nut), now)
            self.jump.on_imu(ImuSample(now, (0.0, 0.0, 0.0), (0.0, 0.0, 1.62)), now)
            command = self.jump.step(now)
            self.sent.append(command)
            if command is not None:
                distance = command.compression - self.nut
                self.nut += math.copysign(min(abs(distance), 0.01 * command.rate), distance)

    def on_descent(self, phase: DescentPhase) -> None:
        self.jump.on_descent(phase, self.now_ns)

    def request(self) -> None:
        self.jump.request(JointSample(0, {machine.JUMP_STROKE: JointValue(0.1)}), self.now_ns)


def phase_of(rover: Standing) -> JumpPhase:
    return rover.jump.phase


def test_a_jump_is_refused_while_the_descent_uses_the_motor():
    rover = Standing()
    rover.on_descent(DescentPhase.STANDBY)
    with pytest.raises(Refusal, match=topics.DESCENT_RELEASE) as caught:
        rover.request()
    assert caught.value.code is RefusalCode.WRONG_PHASE
    assert phase_of(rover) is JumpPhase.STANDBY


def test_a_jump_begins_when_the_descent_has_released_the_motor():
    rover = Standing()
    rover.on_descent(DescentPhase.STANDBY)
    rover.on_descent(DescentPhase.RELEASED)
    rover.request()
    rover.sent.clear()
    rover.run(HANDOVER_TIME - 0.02)
    assert phase_of(rover) is JumpPhase.COMPRESSING
    assert set(rover.sent) == {None}
    rover.run(1.0)
    assert rover.nut > 0.0
    assert None not in rover.sent[-90:]


def test_the_spring_is_let_down_from_a_descent_that_retreats():
    rover = Standing(nut=0.05)
    rover.on_descent(DescentPhase.STANDBY)
    rover.run(1.0)
    rover.sent.clear()
    rover.jump.abort(rover.now_ns)
    assert phase_of(rover) is JumpPhase.LETTING_DOWN
    rover.run(HANDOVER_TIME - 0.02)
    assert set(rover.sent) == {None}
    rover.run(3.0)
    assert phase_of(rover) is JumpPhase.STANDBY
    assert rover.nut < 1e-3
    assert rover.sent[-1] is None
