"""An end of the link: age of received frames, other frames, failures of the bus."""

from __future__ import annotations

import time
from uuid import uuid4

import can
import canopen
import pytest

from rover_hil.bridge.commissioning import mismatch
from rover_hil.canopen.devices import SYNC_PERIOD, WINCH
from rover_hil.canopen.dictionary import object_dictionary
from rover_hil.canopen.link import SYNC_ID, Link, frame_age_ns
from rover_hil.canopen.transport import open_bus
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


def test_other_frames_on_the_bus_are_skipped():
    channel = f"virtual:{uuid4()}"
    link, other = Link(open_bus(channel)), open_bus(channel)
    other.send(can.Message(is_error_frame=True, arbitration_id=0x40, is_extended_id=False))
    other.send(can.Message(is_remote_frame=True, arbitration_id=0x703, is_extended_id=False))
    other.send(can.Message(arbitration_id=0x18FF0000, is_extended_id=True))
    other.send(can.Message(arbitration_id=SYNC_ID, data=b"\x01", is_extended_id=False))
    frame = link.receive(0.0)
    assert frame is not None
    assert frame.arbitration_id == SYNC_ID
    link.close()
    other.shutdown()


def test_a_bus_that_does_not_send_raises_nowhere(monkeypatch: pytest.MonkeyPatch):
    bus = open_bus(f"virtual:{uuid4()}")

    def fail(message: can.Message, timeout: float | None = None) -> None:
        raise can.CanOperationError("Failed to transmit: No buffer space available")

    monkeypatch.setattr(bus, "send", fail)
    monkeypatch.setattr("rover_hil.bridge.commissioning._TIMEOUT", 0.01)
    link = Link(bus)
    node = canopen.RemoteNode(WINCH.node_id, object_dictionary(WINCH))
    link.network.add_node(node)
    node.nmt.add_heartbeat_callback(lambda _: setattr(node.nmt, "state", "OPERATIONAL"))
    link.dispatch(can.Message(arbitration_id=0x703, data=b"\x7f", is_extended_id=False))
    with pytest.raises(canopen.SdoCommunicationError):
        mismatch(node, WINCH)
    assert link.problem == "Failed to transmit: No buffer space available"
    assert link.failed >= 2
    link.close()
