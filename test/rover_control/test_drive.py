"""Drive controller on a rolling rover with slip: goals, refusals and detection of problems."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from rolling_rover import RollingRover

from msg_schemas import machine, topics
from msg_schemas.events import DriveEvent
from msg_schemas.faults import DriveFault, Reason, StuckCause
from msg_schemas.phases import DescentPhase, DrivePhase, JumpPhase, WinchMode
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import PathSample, PoseEstimateSample, PoseSample, TwistSample
from rover_control.drive.drive_controller import DriveController
from rover_control.drive.drive_follower import FollowerParameters
from rover_control.drive.drive_odometry import OdometryParameters
from rover_control.drive.drive_requests import DriveRequests
from rover_control.drive.drive_settings import DriveSettings
from rover_control.drive.drive_tether import TetherParameters
from rover_control.drive.drive_watch import DriveWatch, WatchParameters

# The gyro's bias is estimated in less time and less accurately.
QUICK = DriveSettings(
    follower=replace(FollowerParameters(), max_stop_time=1.0),
    odometry=replace(OdometryParameters(), gyro_turn_on_bias=0.002),
)


def facing(heading: float) -> tuple[float, float, float, float]:
    return (0.0, 0.0, math.sin(0.5 * heading), math.cos(0.5 * heading))


def pose(x: float, y: float, heading: float | None = None) -> PoseSample:
    if heading is None:
        return PoseSample(0, (x, y, 0.0))
    return PoseSample(0, (x, y, 0.0), facing(heading))


def given(x: float, y: float, heading: float | None = None) -> PoseEstimateSample:
    goal = pose(x, y, heading)
    return PoseEstimateSample(0, goal.position, goal.orientation)


def twist(forward: float, turn: float) -> TwistSample:
    return TwistSample(0, (forward, 0.0, 0.0), (0.0, 0.0, turn))


def ready(rover: RollingRover, settings: DriveSettings = QUICK) -> DriveController:
    drive = DriveController(settings)
    for _ in range(25):
        rover.step(drive)
    DriveRequests(drive).set_pose(given(rover.x, rover.y, rover.heading))
    return drive


def phase_of(drive: DriveController) -> DrivePhase:
    return drive.wheels.phase


def event_names(drive: DriveController) -> list[str]:
    return [change.name for change in drive.follower.take_changes()]


def refused(code: RefusalCode, text: str, send: Any, *arguments: Any) -> None:
    with pytest.raises(Refusal, match=text) as refusal:
        send(*arguments)
    assert refusal.value.code is code


@pytest.mark.parametrize("slip", [(0.25, 0.26), (0.27, 0.25)])
def test_a_goal_pose_is_reached_with_unequal_slip_of_the_sides(slip: tuple[float, float]):
    rover = RollingRover(slip=slip, x=1.0, y=1.0, seed=3)
    drive = ready(rover)
    DriveRequests(drive).go_to(pose(3.0, 0.5, 1.2), rover.now_ns)
    rover.run(drive, 300.0)
    assert event_names(drive) == [DriveEvent.STARTED, DriveEvent.GOAL_REACHED, DriveEvent.COMPLETED]
    assert phase_of(drive) is DrivePhase.RELEASED
    assert math.hypot(rover.x - 3.0, rover.y - 0.5) < 0.2
    assert abs(math.remainder(rover.heading - 1.2, 2.0 * math.pi)) < 0.1
    estimate = drive.odometry.pose
    assert math.hypot(estimate.x - rover.x, estimate.y - rover.y) < 0.1


def test_a_turn_between_two_goals_is_no_curvature():
    rover = RollingRover(seed=3)
    drive = ready(rover)
    requests = DriveRequests(drive)
    requests.go_to(pose(4.0, 0.0), rover.now_ns)
    before = None
    while not (before is DrivePhase.DRIVING and phase_of(drive) is DrivePhase.STANDING):
        before = phase_of(drive)
        rover.step(drive)
    requests.stop(rover.now_ns)
    while drive.odometry.turned < 1.5:
        requests.steer(twist(0.0, 0.15), rover.now_ns)
        rover.step(drive)
    rover.run(drive, 10.0)
    requests.go_to(pose(1.0, 5.0), rover.now_ns)
    while phase_of(drive) is DrivePhase.STANDING:
        rover.step(drive)
    assert abs(drive.follower.planner.curvature) < 0.02


def test_the_last_turn_is_no_segment():
    rover = RollingRover(seed=3)
    drive = ready(rover, replace(QUICK, follower=replace(QUICK.follower, max_segments=1)))
    DriveRequests(drive).go_to(pose(1.0, 0.0, 1.2), rover.now_ns)
    rover.run(drive, 100.0)
    assert event_names(drive)[-1] == DriveEvent.COMPLETED
    DriveRequests(drive).go_to(pose(8.0, 0.0), rover.now_ns)
    rover.run(drive, 300.0)
    assert event_names(drive)[-1] == DriveEvent.FAILED


def test_a_path_is_driven_in_order_and_only_its_last_heading_counts():
    rover = RollingRover(seed=1)
    drive = ready(rover)
    path: Sequence[PoseSample] = (pose(1.5, 0.0, -3.0), pose(1.5, 1.5), pose(0.0, 1.0))
    DriveRequests(drive).follow_path(PathSample(0, tuple(path)), rover.now_ns)
    least = [math.inf] * 3
    while drive.wheels.is_driving and rover.now < 400.0:
        rover.step(drive)
        for k, each in enumerate(path):
            least[k] = min(least[k], math.dist(each.position[:2], (rover.x, rover.y)))
    assert event_names(drive).count(DriveEvent.GOAL_REACHED) == 3
    assert max(least) < 0.2
    # A turn to the first pose's heading would have been a full turn more.
    assert rover.heading < 2.0 * math.pi


def test_the_wheels_never_turn_the_rover_right():
    rover = RollingRover(seed=2)
    drive = ready(rover)
    DriveRequests(drive).go_to(pose(-1.0, -1.0), rover.now_ns)
    before = rover.heading
    while drive.wheels.is_driving and rover.now < 200.0:
        rover.step(drive)
        assert rover.heading >= before - 1e-9
        before = rover.heading
    assert event_names(drive)[-1] == DriveEvent.COMPLETED


def test_a_goal_under_the_right_wheel_is_reached_from_farther_away():
    rover = RollingRover(seed=3)
    drive = ready(rover)
    DriveRequests(drive).go_to(pose(0.08, -0.3), rover.now_ns)
    rover.run(drive, 200.0)
    assert event_names(drive) == [DriveEvent.STARTED, DriveEvent.GOAL_REACHED, DriveEvent.COMPLETED]
    assert math.hypot(rover.x - 0.08, rover.y + 0.3) < 0.12


def test_the_rover_stands_until_the_bias_may_spoil_the_next_motion_no_more():
    settings = DriveSettings()
    rover = RollingRover(seed=4)
    drive = ready(rover, settings)
    DriveRequests(drive).go_to(pose(10.0, 0.0), rover.now_ns)
    parameters, stands, begun = settings.follower, [], rover.now
    before = phase_of(drive)
    while drive.wheels.is_driving and rover.now < 600.0:
        rover.step(drive)
        phase = phase_of(drive)
        if before is DrivePhase.STANDING and phase is not before:
            stands.append((rover.now - begun, drive.odometry.bias_error))
        elif phase is DrivePhase.STANDING and phase is not before:
            begun = rover.now
        before = phase
    (first, first_error), (second, second_error) = stands[:2]
    # The first segment takes 10 s; the second 45 s, for which the bias is never known well enough.
    assert first < 8.0
    assert first_error * 10.0 < parameters.bias_heading_error
    assert second == pytest.approx(parameters.settle_time + parameters.max_stop_time, abs=0.1)
    assert second_error < 0.5 * first_error
    arrived = rover.now - begun
    assert arrived < 3.0  # no motion follows


# --- the tether -------------------------------------------------------------------------------


def test_the_winch_holds_tension_during_the_drive_and_a_length_afterwards():
    rover = RollingRover(drop=45.0)
    drive = ready(rover)
    assert rover.requests == []
    DriveRequests(drive).go_to(pose(1.0, -0.3), rover.now_ns)
    rover.run(drive, 100.0)
    joints = [joint for joint, _ in rover.requests]
    assert joints[0] == machine.WINCH_AT_TENSION
    assert joints[-1] == machine.WINCH_TO_LENGTH
    weight = 0.005 * 1.62 * 45.0
    margin = drive.tether.parameters.tension_margin
    efforts = [effort for joint, effort in rover.requests if joint == machine.WINCH_AT_TENSION]
    assert efforts == pytest.approx([weight + margin] * len(efforts), rel=1e-3)
    # Renewed well within the winch's timeout of one second.
    assert len(efforts) > 2.0 * 8.0


def test_the_drive_fails_if_the_winch_does_not_enter_mode_tension():
    rover = RollingRover(obeys=False)
    drive = ready(rover)
    DriveRequests(drive).go_to(pose(2.0, 0.0), rover.now_ns)
    rover.run(drive, 30.0)
    assert phase_of(drive) is DrivePhase.FAILED
    (failed,) = [c for c in drive.follower.take_changes() if c.name == DriveEvent.FAILED]
    assert failed.values["fault"] == DriveFault.INPUT_LOST
    assert rover.travelled == 0.0


def test_the_rover_stops_when_the_winch_leaves_mode_tension():
    rover = RollingRover()
    drive = ready(rover)
    DriveRequests(drive).go_to(pose(5.0, 0.0), rover.now_ns)
    while phase_of(drive) is not DrivePhase.DRIVING:
        rover.step(drive)
    rover.obeys, rover.mode = False, "fault"
    rover.step(drive)
    rover.step(drive)
    assert phase_of(drive) is DrivePhase.FAILED
    assert fault_of(drive) == DriveFault.INPUT_LOST


def test_the_rover_drives_without_winch_requests_if_configured():
    rover = RollingRover()
    settings = replace(QUICK, tether=replace(TetherParameters(), uses_winch=False))
    drive = ready(rover, settings)
    DriveRequests(drive).go_to(pose(1.5, 0.0), rover.now_ns)
    rover.run(drive, 100.0)
    assert event_names(drive)[-1] == DriveEvent.COMPLETED
    assert rover.requests == []


# --- detection of problems --------------------------------------------------------------------


def fault_of(drive: DriveController) -> object:
    """Fault of the last event."""
    failed = drive.follower.take_changes()[-1]
    assert failed.name is DriveEvent.FAILED
    return failed.values["fault"]


def stuck_after(rover: RollingRover, drive: DriveController, limit: float) -> tuple[object, float]:
    """Reported cause, and the distance [m] that the left wheel rolled until then."""
    started, turned = rover.now, rover.angles[0]
    while drive.wheels.is_driving and rover.now < started + limit:
        rover.step(drive)
    assert phase_of(drive) is DrivePhase.STUCK
    (change,) = [c for c in drive.follower.take_changes() if c.name == DriveEvent.STUCK]
    seen, spread = drive.odometry.pose, np.trace(drive.odometry.covariance()[:2, :2])
    assert seen.distance(rover.x, rover.y) < 2.0 * math.sqrt(spread)
    if change.values["cause"] == StuckCause.NO_START:
        assert np.trace(drive.sensors.dead_reckoning.covariance()[:2, :2]) > 0.5 * spread
    return change.values["cause"], abs(rover.angles[0] - turned) * 0.15


def test_the_accelerometer_detects_a_rover_stuck_at_the_start():
    rover = RollingRover(stuck=True)
    drive = ready(rover)
    DriveRequests(drive).go_to(pose(5.0, 0.0), rover.now_ns)
    cause, rolled = stuck_after(rover, drive, 60.0)
    assert cause == StuckCause.NO_START
    assert rolled < 0.6


def test_the_tether_detects_a_rover_that_gets_stuck_later():
    rover = RollingRover(x=6.0, drop=5.0)
    drive = ready(rover)
    DriveRequests(drive).go_to(pose(12.0, 0.0), rover.now_ns)
    while rover.x < 7.5:
        rover.step(drive)
    while phase_of(drive) is not DrivePhase.DRIVING or drive.odometry.speed < 0.09:
        rover.step(drive)
    for _ in range(200):  # beyond the start that the accelerometer checks
        rover.step(drive)
    rover.stuck = True
    cause, rolled = stuck_after(rover, drive, 60.0)
    assert cause == StuckCause.NO_TRAVEL
    assert rolled < 1.6


def test_one_failed_tether_check_does_not_stop_the_rover():
    watch = DriveWatch(WatchParameters())
    found, distance = [], 8.0
    for step in range(400):
        distance -= 0.01
        # While the winch takes up slack, from 0.6 to 1.1 m of travel, the range reads too long.
        estimate = distance + (0.6 if 60 < step < 110 else 0.0)
        found.append(watch.tether(0.01, -0.01, estimate))
    assert not any(found)
    found = [watch.tether(0.01, -0.01, distance) for _ in range(160)]
    assert {stuck.cause for stuck in found if stuck} == {StuckCause.NO_TRAVEL}


def test_the_gyro_detects_a_turn_without_rotation():
    rover = RollingRover(stuck=True)
    drive = ready(rover)
    DriveRequests(drive).go_to(pose(-3.0, 0.0), rover.now_ns)
    cause, rolled = stuck_after(rover, drive, 60.0)
    assert cause == StuckCause.NO_TURN
    assert rolled < 0.5


def test_a_blocked_motor_is_detected():
    rover = RollingRover(blocked=True)
    drive = ready(rover)
    DriveRequests(drive).go_to(pose(3.0, 0.0), rover.now_ns)
    cause, _ = stuck_after(rover, drive, 60.0)
    assert cause == StuckCause.MOTOR_BLOCKED


def test_wheels_that_dig_in_slow_down_and_then_stop():
    rover = RollingRover(current=0.87, slip=(0.53, 0.53))
    drive = ready(rover)
    DriveRequests(drive).go_to(pose(5.0, 0.0), rover.now_ns)
    fastest = 0.0
    for _ in range(600):
        rover.step(drive)
        fastest = max(fastest, drive.odometry.speed)
    assert drive.wheels.is_driving
    usual = drive.settings.follower.drive_speed
    assert fastest < 0.9 * usual
    rover.stuck, rover.current = True, 1.5
    cause, _ = stuck_after(rover, drive, 30.0)
    assert cause == StuckCause.DIGGING_IN


@pytest.mark.parametrize(("climb", "digs"), [(0.0, True), (0.15, False)])
def test_wheels_dig_in_at_a_torque_that_the_slope_does_not_explain(climb: float, digs: bool):
    rover = RollingRover(climb=climb)
    drive = ready(rover)
    DriveRequests(drive).go_to(pose(5.0, 0.0), rover.now_ns)
    while rover.x < 0.5:
        rover.step(drive)
    rover.current = 1.0
    for _ in range(300):
        rover.step(drive)
    stuck = [c.values["cause"] for c in drive.follower.take_changes() if c.name == DriveEvent.STUCK]
    assert stuck == ([StuckCause.DIGGING_IN] if digs else [])


def test_a_motion_that_takes_too_long_is_stuck():
    rover = RollingRover(x=3.0, heading=1.5, drop=5.0, climb=0.15)
    drive = ready(rover)
    DriveRequests(drive).go_to(pose(3.0, 2.0), rover.now_ns)
    while rover.y < 0.5:
        rover.step(drive)
    # Uphill, where neither the tether nor the accelerometer shows the travel.
    rover.stuck, rover.current = True, 1.1
    cause, rolled = stuck_after(rover, drive, 100.0)
    assert cause == StuckCause.TOO_SLOW
    assert drive.odometry.pose.y < 1.9
    assert rolled > 1.0


def test_a_new_goal_is_accepted_after_being_stuck():
    rover = RollingRover(stuck=True)
    drive = ready(rover)
    DriveRequests(drive).go_to(pose(1.5, 0.0), rover.now_ns)
    stuck_after(rover, drive, 60.0)
    rover.stuck = False
    DriveRequests(drive).set_pose(given(rover.x, rover.y, rover.heading))
    DriveRequests(drive).go_to(pose(1.5, 0.0), rover.now_ns)
    rover.run(drive, 100.0)
    assert event_names(drive)[-1] == DriveEvent.COMPLETED


# --- twists -----------------------------------------------------------------------------------


def test_the_rover_follows_twists_and_stops_when_they_time_out():
    rover = RollingRover()
    drive = ready(rover)
    for _ in range(300):
        DriveRequests(drive).steer(twist(0.1, 0.0), rover.now_ns)
        rover.step(drive)
    assert phase_of(drive) is DrivePhase.STEERED
    assert rover.x == pytest.approx(0.1 * 6.0, abs=0.15)
    for _ in range(300):
        DriveRequests(drive).steer(twist(0.0, 0.2), rover.now_ns)
        rover.step(drive)
    assert rover.heading == pytest.approx(0.2 * 6.0, abs=0.4)  # minus two ramps
    rover.run(drive, 20.0)
    assert phase_of(drive) is DrivePhase.RELEASED
    assert rover.rates == pytest.approx((0.0, 0.0), abs=1e-3)
    (stopped,) = [
        change for change in drive.follower.take_changes() if change.name is DriveEvent.STOPPED
    ]
    assert stopped.reason is Reason.RENEWAL_TIMEOUT


def test_a_twist_that_is_too_fast_or_impossible_is_refused():
    rover = RollingRover()
    drive = ready(rover)
    for forward, turn, code, text in (
        (0.5, 0.0, RefusalCode.OUT_OF_LIMITS, r"0\.5 m/s, limit 0\.1 m/s"),
        (0.5, 1e-9, RefusalCode.OUT_OF_LIMITS, r"0\.5 m/s, limit 0\.1 m/s"),
        (0.0, 2.0, RefusalCode.OUT_OF_LIMITS, "limit"),
        (-0.1, 0.0, RefusalCode.NOT_SUPPORTED, "ratchet"),
        (0.0, -0.1, RefusalCode.NOT_SUPPORTED, "left only"),
    ):
        refused(code, text, DriveRequests(drive).steer, twist(forward, turn), rover.now_ns)
    assert phase_of(drive) is DrivePhase.RELEASED


# --- refusals ---------------------------------------------------------------------------------


def test_unreachable_goals_are_refused_with_the_reason():
    rover = RollingRover()
    drive = ready(rover)
    far = pose(100.0, 0.0)
    refused(RefusalCode.OUT_OF_LIMITS, "reaches", DriveRequests(drive).go_to, far, rover.now_ns)
    none = PathSample(0, ())
    refused(
        RefusalCode.WRONG_LENGTH,
        "at least one",
        DriveRequests(drive).follow_path,
        none,
        rover.now_ns,
    )
    assert not drive.wheels.is_driving


@pytest.mark.parametrize(
    ("change", "code", "text"),
    [
        (lambda rover, drive: setattr(rover, "on_floor", False), RefusalCode.WRONG_PHASE, "floor"),
        (lambda rover, drive: drive.on_jump(JumpPhase.FLIGHT), RefusalCode.WRONG_PHASE, "jumping"),
        (
            lambda rover, drive: drive.wheels.on_descent(DescentPhase.HOLDING, rover.now_ns),
            RefusalCode.WRONG_PHASE,
            topics.DESCENT_RELEASE,
        ),
        (lambda rover, drive: setattr(rover, "mode", "disarmed"), RefusalCode.NOT_ARMED, "armed"),
    ],
)
def test_requests_are_refused_while_the_rover_is_not_ready(
    change: Any, code: RefusalCode, text: str
):
    rover = RollingRover()
    drive = ready(rover)
    change(rover, drive)
    rover.step(drive)
    refused(code, text, DriveRequests(drive).go_to, pose(2.0, 0.0), rover.now_ns)
    refused(code, text, DriveRequests(drive).steer, twist(0.1, 0.0), rover.now_ns)


@pytest.mark.parametrize("steps", [0, 300])
def test_a_rover_that_has_rolled_over_does_not_drive(steps: int):
    rover = RollingRover(roll=1.7)
    drive = ready(rover)
    for _ in range(steps):
        rover.step(drive)
    text = "rolled over: tilt 97.4 deg"
    refused(RefusalCode.WRONG_PHASE, text, DriveRequests(drive).go_to, pose(2.0, 0.0), rover.now_ns)
    refused(
        RefusalCode.WRONG_PHASE, text, DriveRequests(drive).steer, twist(0.1, 0.0), rover.now_ns
    )
    assert not drive.wheels.is_driving


def test_stale_sensors_are_named_and_stop_the_rover():
    drive = DriveController(QUICK)
    refused(RefusalCode.STALE, topics.IMU, DriveRequests(drive).go_to, pose(2.0, 0.0), 0)
    rover = RollingRover()
    drive = ready(rover)
    DriveRequests(drive).go_to(pose(5.0, 0.0), rover.now_ns)
    while phase_of(drive) is not DrivePhase.DRIVING:
        rover.step(drive)
    for _ in range(60):
        rover.now_ns += 20_000_000
        drive.step(rover.now_ns)
    assert phase_of(drive) is DrivePhase.FAILED
    failed = drive.follower.take_changes()[-1]
    assert failed.values["fault"] == DriveFault.INPUT_LOST
    assert topics.WHEEL_STATE in failed.message


@pytest.mark.parametrize("steps", [15, 45])
def test_a_turn_without_imu_samples_is_estimated_and_widens_the_heading(steps: int):
    rover = RollingRover()
    drive = ready(rover)
    DriveRequests(drive).go_to(pose(-4.0, 0.0), rover.now_ns)
    while rover.heading < 1.0:
        rover.step(drive)
    on_imu, drive.sensors.on_imu = drive.sensors.on_imu, lambda *_: None  # type: ignore[method-assign]
    for _ in range(steps):
        rover.step(drive)
    drive.sensors.on_imu = on_imu  # type: ignore[method-assign]
    rover.step(drive)
    assert drive.odometry.pose.heading == pytest.approx(rover.heading, abs=0.02)
    assert math.sqrt(drive.odometry.covariance()[2, 2]) > 0.9 * 0.02 * steps * 0.2


def test_the_noise_of_the_encoders_at_rest_is_no_travel():
    rover = RollingRover()
    drive = ready(rover)
    generator = np.random.default_rng(1)
    for _ in range(1500):
        rover.now_ns += 20_000_000
        rover.angles = tuple(generator.normal(0.0, 3e-4, 2))
        rover.send_samples(drive)
        drive.step(rover.now_ns)
    assert drive.odometry.travelled == 0.0
    assert drive.follower.is_at_rest


def test_a_rover_lifted_off_the_floor_stops_and_its_pose_stays():
    rover = RollingRover()
    drive = ready(rover)
    DriveRequests(drive).go_to(pose(5.0, 0.0), rover.now_ns)
    while rover.x < 0.3:
        rover.step(drive)
    rover.on_floor = False
    rover.step(drive)
    lifted = drive.odometry.pose
    rover.run(drive, 10.0)
    assert phase_of(drive) is DrivePhase.FAILED
    assert fault_of(drive) == DriveFault.INPUT_LOST
    assert (drive.odometry.pose.x, drive.odometry.pose.y) == pytest.approx(lifted[:2], abs=1e-3)


def test_a_pose_is_accepted_only_at_rest():
    rover = RollingRover()
    drive = ready(rover)
    DriveRequests(drive).set_pose(given(4.0, 3.0))
    assert drive.odometry.pose == pytest.approx((4.0, 3.0, 0.0), abs=1e-2)
    DriveRequests(drive).set_pose(given(4.0, 3.0, 2.0))
    assert drive.odometry.pose.heading == pytest.approx(2.0)
    DriveRequests(drive).go_to(pose(6.0, 3.0), rover.now_ns)
    refused(RefusalCode.WRONG_PHASE, "driving", DriveRequests(drive).set_pose, given(0.0, 0.0))


def test_a_stop_brings_the_rover_to_rest_and_the_winch_holds():
    rover = RollingRover()
    drive = ready(rover)
    DriveRequests(drive).go_to(pose(5.0, 0.0), rover.now_ns)
    while rover.x < 0.2:
        rover.step(drive)
    DriveRequests(drive).stop(rover.now_ns)
    assert phase_of(drive) is DrivePhase.RELEASED
    rover.run(drive, 10.0)
    assert rover.mode == WinchMode.HOLD
    assert rover.x < 0.4
    assert drive.step(rover.now_ns).wheel_rate is None
