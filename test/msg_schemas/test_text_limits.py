"""Every text of a message has a limit, and what is repeated of it is short and printable."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest
from contract_samples import samples_of
from hypothesis import Phase, find, settings
from rclpy.serialization import serialize_message
from ros_messages import message_of

from msg_schemas import topics
from msg_schemas.cdr import header, pack, unpack
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample, Level, PathSample, Sample, Status, StatusSample
from msg_schemas.specifications import Intent, Topic
from msg_schemas.table import TOPICS
from msg_schemas.text_limits import DOCUMENT_BYTES, LONGEST_REASON, LONGEST_STATUS, NAME_BYTES, cut
from rover_runtime.admission import read_message

pytestmark = pytest.mark.ros

LONG = "€" * (DOCUMENT_BYTES // 3 + 1)
LARGEST_ECHO = LONGEST_REASON + 100
# Found while tests are collected: shrinking would take seconds.
ANY_THAT_IS_FOUND = settings(phases=[Phase.generate], derandomize=True, database=None)

Change = Callable[[Any], object]


def sample_for(topic: Topic) -> Sample:
    """A sample with each kind of text that the topic has."""

    def has_all(sample: Sample) -> bool:
        if isinstance(sample, StatusSample):
            return bool(sample.statuses and sample.statuses[0].values)
        return not isinstance(sample, PathSample) or bool(sample.poses)

    found: Sample = find(samples_of(topic), has_all, settings=ANY_THAT_IS_FOUND)
    return found


def texts(message: Any) -> Iterator[tuple[str, Change]]:
    """Each text of a message: its path, and a function that makes it too long."""
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        if isinstance(value, str):
            yield name, partial(lengthen, name)
        elif isinstance(value, list) and value and isinstance(value[0], str):
            yield f"{name}[0]", partial(lengthen_first, name)
        elif isinstance(value, list) and value and hasattr(value[0], "get_fields_and_field_types"):
            for path, change in texts(value[0]):
                yield f"{name}[0].{path}", partial(within_first, name, change)
        elif hasattr(value, "get_fields_and_field_types"):
            for path, change in texts(value):
                yield f"{name}.{path}", partial(within, name, change)


def lengthen(name: str, message: Any) -> None:
    setattr(message, name, LONG)


def lengthen_first(name: str, message: Any) -> None:
    getattr(message, name)[0] = LONG


def within(name: str, change: Change, message: Any) -> None:
    change(getattr(message, name))


def within_first(name: str, change: Change, message: Any) -> None:
    change(getattr(message, name)[0])


def cases() -> Iterator[Any]:
    by_type = {topic.sample: (name, topic) for name, topic in TOPICS.items()}
    for name, topic in by_type.values():
        message = message_of(name, sample_for(topic))
        for path, change in texts(message):
            yield pytest.param(name, message, change, id=f"{name} {path}")


@pytest.mark.parametrize(("name", "message", "change"), list(cases()))
def test_a_text_that_is_too_long_is_refused_in_few_words(name: str, message: Any, change: Change):
    changed = copy.deepcopy(message)
    change(changed)
    data = bytes(serialize_message(changed))
    with pytest.raises(Refusal) as refusal:
        unpack(name, data)
    assert refusal.value.code is RefusalCode.MALFORMED
    assert "bytes, it may have at most" in refusal.value.reason
    received = read_message(TOPICS[name], data)
    assert isinstance(received.content, Refusal)
    assert len(received.sender) <= NAME_BYTES
    assert len(str(received.content)) <= LARGEST_ECHO


@pytest.mark.parametrize("count", [3, 500_000])
def test_however_many_names_a_message_has_its_refusal_is_short(count: int):
    for name, topic in TOPICS.items():
        if topic.sample is JointSample:
            message = message_of(name, sample_for(topic))
            message.name = ["a name"] * count
            with pytest.raises(Refusal) as refusal:
                unpack(name, bytes(serialize_message(message)))
            assert refusal.value.code is RefusalCode.WRONG_NAME
            assert len(str(refusal.value)) <= LARGEST_ECHO
            return
    raise AssertionError


def named_topics() -> list[str]:
    return [name for name, row in TOPICS.items() if row.intent is Intent.COMMAND and not row.frame]


@pytest.mark.parametrize("name", named_topics())
def test_a_sender_is_read_as_printable_text(name: str):
    sample = sample_for(TOPICS[name])
    data = pack(name, sample, "a\n\x1b[31mred#7")
    assert header(name, data).frame_id == "a\n\x1b[31mred#7"
    assert read_message(TOPICS[name], data).sender == "a??[31mred#7"


def test_a_status_of_our_own_is_cut_to_what_its_readers_accept():
    status = Status("node: part", LONG, Level.OK, "node", {"value": LONG})
    (read,) = unpack(topics.EVENTS, pack(topics.EVENTS, StatusSample(1, (status,)))).statuses
    assert read.message == read.values["value"] == cut(LONG, LONGEST_STATUS)
    assert len(read.message) == LONGEST_STATUS


def test_a_reason_is_printable_and_short():
    refusal = Refusal("topic", RefusalCode.BAD_TEXT, "a\nb" + LONG)
    assert refusal.reason.startswith("a?b€")
    assert len(refusal.reason) == LONGEST_REASON
