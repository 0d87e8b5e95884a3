"""Age of received frames at an end of the link."""

from __future__ import annotations

import time

import can
import pytest

from rover_hil.canopen.devices import SYNC_PERIOD
from rover_hil.canopen.link import SYNC_ID, Link, frame_age_ns
from rover_hil.canopen.udp_bus import UdpBus


@pytest.mark.parametrize(("age", "expected"), [(0.002, 0.002), (60.0, SYNC_PERIOD), (-60.0, 0.0)])
def test_the_age_of_a_frame_is_at_most_a_period(age: float, expected: float):
    begun = time.time()
    found = frame_age_ns(can.Message(timestamp=begun - age)) * 1e-9
    late = time.time() - begun
    assert expected - 1e-5 <= found <= min(expected + late + 1e-5, SYNC_PERIOD + 1e-9)


def test_a_frame_without_a_stamp_has_age_zero():
    assert frame_age_ns(can.Message()) == 0


def test_a_frame_by_udp_has_the_time_of_its_arrival_not_of_its_reading(own_multicast: str):
    _, group, port = own_multicast.split(":")
    ends = [Link(UdpBus(group, int(port))) for _ in range(2)]
    # The kernel stamps arrivals from a moment on after the first socket that wants it.
    deadline, age_ns = time.monotonic() + 10.0, 0
    try:
        while age_ns < round(SYNC_PERIOD * 1e9) and time.monotonic() < deadline:
            ends[0].send(SYNC_ID, b"\x01")
            sent = time.monotonic()
            while time.monotonic() - sent < 2.0 * SYNC_PERIOD:
                pass
            frame = ends[1].receive(1.0)
            assert frame is not None
            age_ns = frame_age_ns(frame)
        assert age_ns == round(SYNC_PERIOD * 1e9)
    finally:
        for end in ends:
            end.close()
