"""What an end of the link makes of the frames that it takes."""

from __future__ import annotations

import time

import can
import pytest

from rover_hil.devices import SYNC_PERIOD
from rover_hil.link import SYNC_ID, Link, frame_age_ns
from rover_hil.udp_bus import UdpBus


@pytest.mark.parametrize(("ago", "waited"), [(0.002, 0.002), (60.0, SYNC_PERIOD), (-60.0, 0.0)])
def test_how_long_a_frame_has_waited_is_told_up_to_a_period(ago: float, waited: float):
    begun = time.time()
    found = frame_age_ns(can.Message(timestamp=begun - ago)) * 1e-9
    late = time.time() - begun
    assert waited - 1e-5 <= found <= min(waited + late + 1e-5, SYNC_PERIOD + 1e-9)


def test_a_frame_without_a_stamp_has_not_waited():
    assert frame_age_ns(can.Message()) == 0


def test_a_frame_by_udp_bears_the_time_at_which_it_came_and_not_that_of_its_reading():
    ends = [Link(UdpBus("239.74.163.91", 45191)) for _ in range(2)]
    try:
        ends[0].send(SYNC_ID, b"\x01")
        sent = time.monotonic()
        while time.monotonic() - sent < 2.0 * SYNC_PERIOD:
            pass
        frame = ends[1].receive(1.0)
        assert frame is not None
        assert frame_age_ns(frame) == round(SYNC_PERIOD * 1e9)
    finally:
        for end in ends:
            end.close()
