"""Streams of drive commands in simulated time, as a controller sends them."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from msg_schemas import machine, topics
from msg_schemas.samples import JointSample, JointValue
from msg_schemas.table import TOPICS
from rover_verify.harness import Observer

# Parameters of drive_node beside the mock plant, which has no slip, the grousers' radius on hard
# ground, no accelerations and no tension.
ON_MOCK_PLANT: Mapping[str, object] = {
    "uses_winch": False,
    "wheel_radius": 0.16,
    "driving_slip": 0.0,
    "slip_per_torque": 0.0,
    "slip_curvature": 0.0,
    "turning_slip": 0.0,
    "start_check_speed": 1.0,
    "drive_speed": 0.5,
    "turn_rate": 1.0,
    "wheel_acceleration": 5.0,
    "max_stop_time": 0.1,
}


def drive(
    observer: Observer,
    topic: str,
    joints: Mapping[str, JointValue],
    until: Callable[[], bool],
    limit: float = 60.0,
) -> None:
    """Command a drive at its contract's rate until a condition, checked before each command, holds.

    Args:
        observer: sends the commands.
        topic: of the command.
        joints: content of the command.
        until: the condition.
        limit: AssertionError after this much simulated time [s].
    """
    rate = TOPICS[topic].rate
    assert rate is not None
    period_ns = round(1e9 / rate)
    begin = now = observer.wait_for_time(1)
    while not until():
        assert now - begin < limit * 1e9, f"not reached within {limit:g} s of simulated time"
        observer.send(topic, JointSample(observer.time_ns(), joints))
        now = observer.wait_for_time(observer.time_ns() + period_ns)


def drive_nut(
    observer: Observer,
    compression: float,
    speed: float,
    until: Callable[[], bool],
    limit: float = 60.0,
) -> None:
    """Drive the nut to a compression [m] at a speed [m/s] until a condition holds; see `drive`."""
    joints = {machine.JUMP_SCREW: JointValue(compression, speed, 400.0)}
    drive(observer, topics.JUMP_MOTOR_COMMAND, joints, until, limit)


def has_event(observer: Observer, name: str, since: int = 0) -> Callable[[], bool]:
    """Condition for ``drive_nut``: whether an event has arrived."""
    return lambda: bool(observer.events(name, since=since))
