"""Two command sources of one motor are found in a bag and named in its report."""

from __future__ import annotations

from pathlib import Path

import pytest

from msg_schemas import machine, topics
from msg_schemas.samples import JointSample, JointValue
from rover_bags.analysis.metrics import measure
from rover_bags.reading.command_sources import CommandConflict
from rover_bags.reading.read import read_bag
from rover_bags.views.summary import data_warnings
from rover_verify.harness.tape import Tape

DESCENT, DRIVE, JUMP = "/descent_node#1", "/drive_node#2", "/jump_node#3"
JOINTS = {
    topics.JUMP_MOTOR_COMMAND: {machine.JUMP_SCREW: JointValue(0.1, 0.05, 400.0)},
    topics.FLYWHEEL_COMMAND: {machine.FLYWHEEL: JointValue(0.0, 0.0, 0.1)},
    topics.WHEEL_COMMAND: {machine.WHEEL_DRIVE: JointValue(0.0, 1.0, 2.0)},
    topics.WHEEL_TORQUE_COMMAND: {machine.WHEEL_DRIVE: JointValue(0.0, 0.0, 0.5)},
    topics.JUMP_REQUEST: {machine.JUMP_STROKE: JointValue(0.1)},
}

Command = tuple[float, str, str]
"""Time [s], topic and source."""


def recorded(folder: Path, *commands: Command) -> tuple[CommandConflict, ...]:
    tape = Tape(folder / "bag")
    for time, topic, source in commands:
        stamp_ns = round(time * 1e9)
        tape.write(topic, JointSample(stamp_ns, JOINTS[topic]), source, stamp_ns)
    tape.close()
    return read_bag(folder / "bag").command_conflicts


def test_commands_of_one_source_at_a_time_are_no_conflict(tmp_path: Path):
    assert not recorded(
        tmp_path,
        *((10.0 + 0.1 * k, topics.FLYWHEEL_COMMAND, DESCENT) for k in range(10)),
        (10.95, topics.WHEEL_COMMAND, DRIVE),
        (11.40, topics.JUMP_MOTOR_COMMAND, JUMP),
        (11.45, topics.JUMP_REQUEST, "rover"),
        (11.46, topics.JUMP_REQUEST, "mission"),
        (1.0, topics.JUMP_MOTOR_COMMAND, DESCENT),  # the clock has gone back
    )


@pytest.mark.parametrize(
    ("motor", "one", "other", "source"),
    [
        (machine.JUMP_MOTOR, topics.FLYWHEEL_COMMAND, topics.JUMP_MOTOR_COMMAND, JUMP),
        (machine.JUMP_MOTOR, topics.JUMP_MOTOR_COMMAND, topics.JUMP_MOTOR_COMMAND, JUMP),
        (machine.WHEEL_MOTOR, topics.WHEEL_COMMAND, topics.WHEEL_TORQUE_COMMAND, DRIVE),
    ],
)
def test_two_sources_of_one_motor_are_a_conflict(
    tmp_path: Path, motor: str, one: str, other: str, source: str
):
    found = recorded(
        tmp_path,
        (10.0, one, DESCENT),
        (10.4, other, source),
        (10.5, one, DESCENT),
        (10.7, other, source),
        (11.3, one, DESCENT),
    )
    assert found == (CommandConflict(motor, (DESCENT, source), 3, 10.4, 10.7),)


def test_the_report_names_motor_sources_and_time(tmp_path: Path):
    recorded(
        tmp_path,
        (10.0, topics.FLYWHEEL_COMMAND, DESCENT),
        (10.4, topics.JUMP_MOTOR_COMMAND, JUMP),
    )
    bag = read_bag(tmp_path / "bag")
    assert data_warnings(bag, measure(bag))[0] == (
        "jump_motor was commanded by /descent_node#1 and /jump_node#3 at a time: 1 commands from "
        "10.400 s to 10.400 s"
    )
