"""Batches of messages: contents, completion, bytes that are none."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from msg_schemas import topics
from msg_schemas.table import TOPICS
from rover_runtime.batches import STREAMS, Batch, Entry, from_bytes, to_bytes
from rover_runtime.byte_array import from_array, to_array

MS = 1_000_000
NAMES = st.sampled_from([topics.CLOCK, f"/rover1/{topics.IMU}", topics.WINCH_STATE])
ENTRIES = st.lists(
    st.builds(
        Entry, NAMES, st.integers(0, 2**32 - 1), st.integers(0, 2**63), st.binary(max_size=40)
    )
)


class Sender:
    """Keeps the batches that are sent."""

    def __init__(self) -> None:
        self.sent: list[list[Entry]] = []
        self.batch = Batch(lambda data: self.sent.append(from_bytes(data)))


@given(ENTRIES)
def test_a_batch_is_read_as_it_was_written(entries: list[Entry]):
    assert from_bytes(from_array(to_array(to_bytes(entries)))) == entries


@given(ENTRIES, st.data())
def test_bytes_that_are_no_batch_are_refused(entries: list[Entry], data: st.DataObject):
    good = to_bytes(entries)
    cut = data.draw(st.integers(0, len(good) - 1))
    with pytest.raises(ValueError, match="batch"):
        from_bytes(good[:cut])


@pytest.mark.fuzz
@given(st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(data: bytes):
    try:
        entries = from_bytes(data)
    except ValueError:
        return
    assert sum(len(each.data) for each in entries) <= len(data)


@pytest.mark.parametrize("message", [b"", to_array(b"abc")[:-1]])
def test_a_cut_array_is_refused(message: bytes):
    with pytest.raises(ValueError):  # noqa: PT011 - whose text is that of struct
        from_array(message)


def test_a_batch_is_sent_when_it_is_full_or_flushed():
    sender = Sender()
    for tick in range(7):
        sender.batch.add(topics.CLOCK, tick * 10 * MS, bytes([tick]) * 7000)
    assert [[each.data[0] for each in batch] for batch in sender.sent] == [[0, 1, 2, 3, 4]]
    sender.batch.flush()
    assert [each.data[0] for each in sender.sent[1]] == [5, 6]
    sender.batch.flush()
    assert len(sender.sent) == 2


def test_a_batch_fits_into_a_datagram():
    sender = Sender()
    for _ in range(100):
        sender.batch.add(topics.TRUTH_TETHER, 0, bytes(5000))
    sizes = [sum(len(each.data) for each in batch) for batch in sender.sent]
    assert sizes
    assert max(sizes) < 60_000


def test_messages_are_numbered_by_topic_across_batches():
    sender = Sender()
    for tick in range(15):
        sender.batch.add(topics.CLOCK, tick * 10 * MS, b"")
        if tick % 2:
            sender.batch.add(topics.ODOMETRY, tick * 10 * MS, b"")
        if tick % 4 == 0:
            sender.batch.flush()
    sender.batch.flush()
    entries = [each for batch in sender.sent for each in batch]
    assert len(sender.sent) > 2
    for topic, count in ((topics.CLOCK, 15), (topics.ODOMETRY, 7)):
        numbers = [each.number for each in entries if each.topic == topic]
        assert numbers == list(range(1, count + 1))


def test_the_streams_are_what_is_sent_periodically():
    assert {topics.CLOCK, topics.IMU, topics.WINCH_STATE, topics.TRUTH_TETHER} <= STREAMS
    assert {topics.WINCH_COMMAND, topics.JUMP_MOTOR_COMMAND, topics.WINCH_TRIM} <= STREAMS
    assert topics.DIAGNOSTICS not in STREAMS
    assert all(TOPICS[name].rate is not None for name in STREAMS)
    assert not STREAMS & {topics.WINCH_REQUEST, topics.DRIVE_GOAL, topics.EVENTS}
