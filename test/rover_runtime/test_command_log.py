"""The life of a command: taken, under way, ended."""

import math

import pytest

from msg_schemas import machine, topics
from msg_schemas.commands import (
    CommandRecord,
    CommandState,
    content_of,
    read_command,
    split_name,
    state_after,
)
from msg_schemas.faults import Reason
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample, JointValue, PathSample, PoseSample
from msg_schemas.table import find_topic
from rover_runtime.command_log import CommandLog

SUBJECT = topics.DESCENT_REQUEST


class Kept:
    """A log, its clock and what it has published."""

    def __init__(self) -> None:
        self.now_ns = 5
        self.records: list[CommandRecord] = []
        self.log = CommandLog("a_node", lambda: self.now_ns, self.records.append)

    def begin(
        self,
        name: str,
        kind: str = "",
        *,
        expiry: float = math.inf,
        renews: bool = False,
        queues: bool = False,
    ) -> None:
        self.log.take(SUBJECT, name, kind=kind)
        self.log.begin(expiry=expiry, renews=renews, queues=queues)
        self.log.finish_taking()

    @property
    def states(self) -> list[tuple[str, CommandState]]:
        return [(record.identifier, record.state) for record in self.records]

    @property
    def last(self) -> CommandRecord:
        return self.records[-1]


def test_a_command_that_needs_no_time_is_done_when_it_was_taken():
    kept = Kept()
    kept.log.take(topics.WINCH_REARM, what="now")
    kept.log.finish_taking("armed")
    assert kept.records == [
        CommandRecord(
            "a_node", topics.WINCH_REARM, "", "5", 5, CommandState.DONE, "now",
            Reason.COMPLETED, "armed", 1.0,
        )
    ]  # fmt: skip


def test_a_refused_command_keeps_the_code():
    kept = Kept()
    refusal = Refusal(SUBJECT, RefusalCode.WRONG_PHASE, "not now")
    kept.log.take(SUBJECT, "me#7", 3)
    kept.log.refuse(refusal)
    assert kept.states == [("7", CommandState.REFUSED)]
    assert (kept.last.sender, kept.last.reason, kept.last.text) == ("me", refusal.code, "not now")
    kept.log.take(SUBJECT, "me#8")
    kept.log.refuse(refusal, publishes=False)
    assert len(kept.records) == 1


def test_a_command_runs_and_reports_each_step_of_its_progress_once():
    kept = Kept()
    kept.begin("me#1")
    for distance in (10.0, 9.5, 4.0, 4.1, 6.0, 0.0):
        kept.log.progress("travelling", distance)
    assert [record.progress for record in kept.records[1:]] == [0.0, 0.6, 1.0]
    kept.log.progress("settling", 0.0)
    kept.log.end(Reason.COMPLETED, "there", result={"length": "3.5"})
    assert kept.last.number("length") == 3.5
    assert math.isnan(kept.last.number("pictures"))
    assert [record.state for record in kept.records] == [
        CommandState.ACCEPTED, *[CommandState.RUNNING] * 4, CommandState.DONE,
    ]  # fmt: skip
    assert kept.last.text == "there"
    assert not kept.log.open


def test_progress_may_be_unknown():
    kept = Kept()
    kept.log.progress("nothing is open")
    kept.begin("me#1")
    for _ in range(3):
        kept.log.progress("holding a tension")
    assert len(kept.records) == 2
    assert math.isnan(kept.last.progress)


@pytest.mark.parametrize("reason", list(Reason))
def test_the_reason_determines_the_last_state(reason: Reason):
    kept = Kept()
    kept.begin("me#1")
    kept.log.end(reason, "why")
    assert kept.last.state is state_after(reason)
    assert kept.last.state.is_over
    assert kept.last.reason is reason


def test_a_new_command_supersedes_the_open_ones_unless_it_queues():
    kept = Kept()
    kept.begin("me#1")
    kept.begin("me#2", queues=True)
    kept.begin("you#3")
    assert kept.states == [
        ("1", CommandState.ACCEPTED),
        ("2", CommandState.ACCEPTED),
        ("1", CommandState.SUPERSEDED),
        ("2", CommandState.SUPERSEDED),
        ("3", CommandState.ACCEPTED),
    ]
    assert kept.records[2].text == f"replaced by {SUBJECT} of you"


def test_only_the_sender_renews_its_command():
    kept = Kept()
    kept.begin("me", expiry=1.0)
    assert kept.last.expiry == 1.0
    kept.now_ns = 6
    kept.begin("me", renews=True)
    assert kept.states == [("5", CommandState.ACCEPTED)]
    kept.now_ns = 7
    kept.begin("you", renews=True)
    assert kept.states[1:] == [("5", CommandState.SUPERSEDED), ("7", CommandState.ACCEPTED)]
    kept.begin("you#1", renews=True)
    assert kept.states[-1] == ("1", CommandState.ACCEPTED)
    kept.begin("you#1", renews=True)
    assert len(kept.records) == 5


def test_commands_end_in_order_and_by_their_kind():
    kept = Kept()
    kept.begin("me#1", "turn")
    kept.begin("me#2", "stop", queues=True)
    kept.begin("me#3", "stop", queues=True)
    kept.log.end(Reason.COMPLETED, "", "stop")
    kept.log.end(Reason.SUPERSEDED, "", "turn")
    kept.log.end(Reason.SUPERSEDED, "no turn is open", "turn")
    kept.log.end(Reason.FAULT, "", "turn", "stop")
    assert kept.states[3:] == [
        ("2", CommandState.DONE),
        ("1", CommandState.SUPERSEDED),
        ("3", CommandState.FAILED),
    ]


def test_a_hold_ends_commands_and_a_resume_takes_them_anew():
    kept = Kept()
    kept.begin("me#1")
    kept.begin("me#2", queues=True)
    kept.log.progress("travelling", 2.0)
    kept.log.hold(Reason.REQUESTED, "held")
    kept.log.hold(Reason.REQUESTED, "held twice")
    assert not kept.log.open
    kept.now_ns = 9
    kept.log.resume()
    assert [record.key for record in kept.log.open] == [
        ("a_node", SUBJECT, "me", "1", 9),
        ("a_node", SUBJECT, "me", "2", 10),
    ]
    kept.log.hold(Reason.REQUESTED, "held")
    kept.log.discard(Reason.REQUESTED, "aborted")
    kept.log.resume()
    assert not kept.log.open


def test_an_empty_command_leaves_no_record():
    kept = Kept()
    kept.log.take(topics.CMD_VEL)
    kept.log.drop()
    kept.log.finish_taking()
    assert not kept.records


@pytest.mark.parametrize(
    "record",
    [
        CommandRecord("n", SUBJECT, "me", "1", 4, CommandState.ACCEPTED, "stop 3 m", expiry=1.5),
        CommandRecord("n", SUBJECT, "", "4", 4, CommandState.RUNNING, text="on", progress=0.3),
        CommandRecord(
            "n", SUBJECT, "a#b", "1", 4, CommandState.REFUSED, "", RefusalCode.STALE, "old"
        ),
        CommandRecord("n", SUBJECT, "me", "1", 4, CommandState.DONE, result={"pictures": "3"}),
        CommandRecord("n", SUBJECT, "me", "1", 4, CommandState.EXPIRED, "", Reason.RENEWAL_TIMEOUT),
    ],
)
def test_a_record_is_read_as_it_was_published(record: CommandRecord):
    read = read_command(record.status())
    assert read is not None
    assert repr(read) == repr(record)  # NaN differs from itself
    assert read_command(record.status().__class__("name", "text")) is None


def test_names_from_outside_are_cut():
    assert split_name("rover#12") == ("rover", "12")
    assert split_name("/a#b/rover#12") == ("/a#b/rover", "12")
    assert split_name("rover") == ("rover", "")
    sender, identifier = split_name("r" * 1000 + "\n#" + "7" * 1000)
    assert (len(sender), len(identifier)) == (128, 128)
    assert split_name("a\nb\x1b#c\t") == ("a?b?", "c?")


def test_the_content_shows_what_was_requested():
    row = find_topic(topics.DESCENT_REQUEST)
    stop = JointSample(0, {machine.PLAIN_STOP: JointValue(12.5, 0.1)})
    assert content_of(row, stop) == "plain_stop 12.5 m"
    row = find_topic(topics.WINCH_REQUEST)
    pull = JointSample(0, {machine.WINCH_AT_TENSION: JointValue(0.0, 0.0, 8.0)})
    assert content_of(row, pull) == "winch_tension 8 N"
    pose = PoseSample(0, (1.0, -2.5, 0.0))
    assert content_of(find_topic(topics.DRIVE_GOAL), pose) == "(1, -2.5) m"
    assert content_of(find_topic(topics.DRIVE_PATH), PathSample(0, (pose, pose))) == "2 poses"


def test_commands_at_one_time_have_records_of_their_own():
    kept = Kept()
    for _ in range(3):
        kept.log.take(SUBJECT)
        kept.log.finish_taking()
    assert len({record.key for record in kept.records}) == 3
    kept.now_ns = 2  # the clock has gone back
    kept.begin("me")
    assert kept.last.taken_ns == 2
    kept.log.hold(Reason.REQUESTED, "held")
    kept.log.resume()
    assert kept.last.taken_ns == 3
