"""Admission: commands in order, one command source per drive; needs message types only."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from msg_schemas import machine, topics
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample, JointValue
from msg_schemas.table import TOPICS
from rover_runtime.admission import UNNAMED, Admission
from rover_runtime.port import Message

ROW = TOPICS[topics.WINCH_COMMAND]
MINE, ANOTHER = "/winch_node#1", "/winch_node#2"
SECOND = 1_000_000_000
JOINTS = {
    machine.WINCH_DRUM: JointValue(20.0, 0.1, 16.0),
    machine.WINCH_BRAKE: JointValue(1.0),
    machine.WINCH_LIMIT: JointValue(0.0, 0.0, 100.0),
}


def command(stamp_ns: int, who: str) -> Message:
    return Message(who, stamp_ns, JointSample(stamp_ns, JOINTS))


def give(admission: Admission, stamp_ns: int, who: str, now_ns: int | None = None) -> None:
    message, now_ns = command(stamp_ns, who), stamp_ns if now_ns is None else now_ns
    admission.admit(ROW, message, now_ns)
    admission.accepted(ROW, message, now_ns)


def refused(admission: Admission, stamp_ns: int, who: str, now_ns: int | None = None) -> Refusal:
    with pytest.raises(Refusal) as found:
        give(admission, stamp_ns, who, now_ns)
    return found.value


def test_the_first_accepted_command_source_owns_the_drive_and_others_are_refused():
    admission = Admission()
    give(admission, SECOND, MINE)
    for after in (0, 20_000_000, 499_000_000):
        why = refused(admission, SECOND + after, ANOTHER)
        assert why.code is RefusalCode.OWNED
        assert MINE in why.reason
        assert ANOTHER in why.reason
    assert admission.owners(SECOND) == {machine.WINCH_MOTOR: MINE}


def test_an_owner_that_goes_on_keeps_it_and_one_that_falls_silent_loses_it():
    admission = Admission()
    for k in range(50):
        give(admission, SECOND + k * 20_000_000, MINE)
        assert refused(admission, SECOND + k * 20_000_000, ANOTHER).code is RefusalCode.OWNED
    silent = SECOND + 49 * 20_000_000 + 500_000_000
    assert admission.owners(silent) == {}
    give(admission, silent, ANOTHER)
    assert refused(admission, silent, MINE).code is RefusalCode.OWNED


def test_who_was_refused_owns_nothing_and_keeps_nobody_out():
    admission = Admission()
    admission.admit(ROW, command(SECOND, MINE), SECOND)  # but its callback refused it
    give(admission, SECOND, ANOTHER)


def test_a_stranger_s_stamps_do_not_make_the_owner_s_late():
    admission = Admission()
    give(admission, SECOND, MINE)
    ahead = SECOND + 90_000_000
    assert refused(admission, ahead, ANOTHER, SECOND).code is RefusalCode.OWNED
    give(admission, SECOND + 20_000_000, MINE)


def test_stamps_that_go_back_are_refused():
    admission = Admission()
    give(admission, SECOND, MINE)
    why = refused(admission, SECOND - 1_000_000, MINE, SECOND)
    assert why.code is RefusalCode.OUT_OF_ORDER
    admission.forget()
    give(admission, SECOND - 1_000_000, ANOTHER, SECOND)


def test_unnamed_command_sources_count_as_one():
    admission = Admission()
    give(admission, SECOND, "")
    give(admission, SECOND, "")
    assert UNNAMED in refused(admission, SECOND, MINE).reason


def test_the_order_is_that_of_each_command_source():
    row = TOPICS[topics.JUMP_REQUEST]
    admission, sample = Admission(), JointSample(SECOND, {machine.JUMP_STROKE: JointValue(0.1)})
    for who, late_ns in ((MINE, 0), (ANOTHER, 10_000_000), (MINE, 5_000_000)):
        stamp_ns = SECOND - late_ns
        message = Message(who, stamp_ns, replace(sample, stamp_ns=stamp_ns))
        if late_ns == 5_000_000:
            with pytest.raises(Refusal, match="stamps must not go back"):
                admission.admit(row, message, SECOND)
        else:
            admission.admit(row, message, SECOND)
            admission.accepted(row, message, SECOND)


def test_operators_may_be_many():
    row = TOPICS[topics.JUMP_REQUEST]
    admission = Admission()
    for who in (MINE, ANOTHER):
        message = Message(who, SECOND, JointSample(SECOND, {machine.JUMP_STROKE: JointValue(0.1)}))
        admission.admit(row, message, SECOND)
        admission.accepted(row, message, SECOND)


NUT = (topics.JUMP_MOTOR_COMMAND, {machine.JUMP_SCREW: JointValue(0.1, 0.05, 400.0)})
FLYWHEEL_TORQUE = (topics.FLYWHEEL_COMMAND, {machine.FLYWHEEL: JointValue(0.0, 0.0, 0.1)})
WHEEL_RATE = (topics.WHEEL_COMMAND, {machine.WHEEL_DRIVE: JointValue(0.0, 1.0, 2.0)})
WHEEL_TORQUE = (topics.WHEEL_TORQUE_COMMAND, {machine.WHEEL_DRIVE: JointValue(0.0, 0.0, 0.5)})


@pytest.mark.parametrize(
    ("motor", "one", "other", "unrelated"),
    [
        (machine.JUMP_MOTOR, NUT, FLYWHEEL_TORQUE, WHEEL_RATE),
        (machine.JUMP_MOTOR, FLYWHEEL_TORQUE, NUT, WHEEL_TORQUE),
        (machine.WHEEL_MOTOR, WHEEL_RATE, WHEEL_TORQUE, NUT),
        (machine.WHEEL_MOTOR, WHEEL_TORQUE, WHEEL_RATE, FLYWHEEL_TORQUE),
    ],
)
def test_an_owner_owns_its_motor_on_all_topics(motor: str, one: Any, other: Any, unrelated: Any):
    admission = Admission()

    def send(command: Any, who: str, now_ns: int) -> None:
        name, joints = command
        message = Message(who, now_ns, JointSample(now_ns, joints))
        admission.admit(TOPICS[name], message, now_ns)
        admission.accepted(TOPICS[name], message, now_ns)

    send(one, MINE, SECOND)
    send(other, MINE, SECOND + 20_000_000)
    assert admission.owners(SECOND + 20_000_000) == {motor: MINE}
    for each in (one, other):
        with pytest.raises(Refusal, match=motor) as caught:
            send(each, ANOTHER, SECOND + 519_000_000)
        assert caught.value.code is RefusalCode.OWNED
    send(unrelated, ANOTHER, SECOND + 519_000_000)
    send(one, ANOTHER, SECOND + 520_000_000)
    assert admission.owners(SECOND + 520_000_000)[motor] == ANOTHER


def test_every_drive_has_one_owner():
    owned: dict[str, set[str]] = {}
    for name, row in TOPICS.items():
        if row.owned:
            owned.setdefault(row.owned, set()).add(name)
            assert row.stale.timeout <= 0.5
    assert owned == {
        machine.JUMP_MOTOR: {topics.JUMP_MOTOR_COMMAND, topics.FLYWHEEL_COMMAND},
        machine.WHEEL_MOTOR: {topics.WHEEL_COMMAND, topics.WHEEL_TORQUE_COMMAND},
        machine.WINCH_MOTOR: {topics.WINCH_COMMAND},
        "winch_trim": {topics.WINCH_TRIM},
    }


def test_what_cannot_be_read_is_refused_as_it_was_read():
    refusal = Refusal(ROW.name, RefusalCode.NOT_FINITE, "velocity is nan")
    with pytest.raises(Refusal) as found:
        Admission().admit(ROW, Message(MINE, SECOND, refusal), SECOND)
    assert found.value is refusal


def test_a_refused_command_does_not_move_the_stamp_of_the_last_accepted_one():
    admission = Admission()
    give(admission, SECOND, MINE)
    late = SECOND + 50_000_000
    admission.admit(ROW, command(late, MINE), late)  # but its callback refused it
    give(admission, late - 10_000_000, MINE, late)
    assert refused(admission, SECOND, MINE, late).code is RefusalCode.OUT_OF_ORDER


def test_an_unstamped_command_counts_as_sent_on_its_arrival():
    row, now_ns = TOPICS[topics.WINCH_REQUEST], 2 * SECOND
    sample = JointSample(0, {machine.WINCH_TO_LENGTH: JointValue(5.0, 0.1, 0.0)})
    admission = Admission()
    message = Message(MINE, 0, sample)
    admission.admit(row, message, now_ns)
    admission.accepted(row, message, now_ns)
    earlier = Message(MINE, now_ns - 1, JointSample(now_ns - 1, sample.joints))
    with pytest.raises(Refusal) as found:
        admission.admit(row, earlier, now_ns)
    assert found.value.code is RefusalCode.OUT_OF_ORDER
