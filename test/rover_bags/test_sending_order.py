"""Order of recorded messages."""

import pytest

from rover_bags.files.store import standard_type
from rover_bags.files.write_queue import Item, Source
from rover_bags.recording.sending_order import SendingOrder, times_in_batch

A, B = (Source(name, standard_type("std_msgs/msg/String")) for name in ("/a", "/b"))
LATER = 1_000_000


def batch(source: Source, times: tuple[int, ...], transport: int, data: bytes = b"") -> list[Item]:
    return [Item(source, sent + transport, sent, 0, data) for sent in times]


def test_a_batch_that_travels_slowly_keeps_its_place_before_the_next():
    order = SendingOrder()
    order.add(batch(A, (100, 110, 120), 9))
    order.add(batch(A, (121, 125, 135), 1))
    taken = order.take(LATER)
    assert [item.publish_ns for item in taken] == [100, 110, 120, 121, 125, 135]
    assert [item.log_ns for item in taken] == [109, 119, 129, 129, 129, 136]


def test_messages_of_two_publishers_come_in_the_order_of_sending():
    order = SendingOrder()
    order.add(batch(A, (130, 140), 2, b"second"))
    order.add(batch(A, (100, 110, 120), 50, b"first"))
    taken = order.take(LATER)
    assert [item.data for item in taken] == [b"first"] * 3 + [b"second"] * 2
    assert [item.log_ns for item in taken] == [150, 160, 170, 170, 170]


def test_topics_are_in_the_order_of_their_own_log_times():
    order = SendingOrder()
    order.add([*batch(A, (100,), 50), *batch(B, (101,), 1)])
    taken = [(item.source.name, item.log_ns) for item in order.take(LATER)]
    assert taken == [("/b", 102), ("/a", 150)]


def test_a_message_is_held_until_earlier_ones_can_have_arrived():
    order = SendingOrder()
    order.add(batch(A, (100, 200), 1))
    assert [item.publish_ns for item in order.take(150)] == [100]
    order.add(batch(A, (180,), 80))
    assert order.take(259) == []
    assert [(item.publish_ns, item.log_ns) for item in order.take(260)] == [(180, 260), (200, 260)]


def test_a_message_that_comes_too_late_is_logged_after_the_last_one():
    order = SendingOrder()
    order.add(batch(A, (100, 200), 1))
    assert len(order.take(300)) == 2
    order.add(batch(A, (150,), 2))
    assert [item.log_ns for item in order.take(300)] == [201]


def test_a_message_of_a_machine_whose_clock_is_ahead_is_not_held():
    order = SendingOrder()
    order.add([Item(A, 100, 10 * LATER, 0, b"")])
    assert [item.log_ns for item in order.take(150)] == [100]


def test_messages_are_not_held_while_a_clock_that_was_set_back_catches_up():
    order = SendingOrder()
    hour, second = 3600 * 10**9, 10**9
    order.add(batch(A, (hour,), 1))
    assert len(order.take(hour + second)) == 1
    order.add(batch(A, (second, 2 * second), 1))
    assert [item.log_ns for item in order.take(3 * second)] == [second + 1, 2 * second + 1]


@pytest.mark.parametrize(
    ("sent", "times"),
    [(90, (115, 90)), (2**64 - 1, (125, 100)), (0, (25, 0))],
)
def test_no_message_is_sent_after_its_batch(sent: int, times: tuple[int, int]):
    assert times_in_batch(sent, 100, 125) == times


def test_a_receiver_whose_clock_is_behind_logs_no_message_before_1970():
    assert times_in_batch(3, 100, 50) == (0, 3)
