"""Frames on a serial line: nothing damaged gets through, and the place is found again."""

from __future__ import annotations

import os
import pty
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rover_hil.canopen.framing import Decoder, Frame, encode
from rover_hil.canopen.link import Link
from rover_hil.canopen.serial_bus import CobsSerialBus
from rover_hil.canopen.transport import TransportError, open_bus

DATA = st.binary(max_size=8)
PLAIN = st.builds(Frame, st.integers(0, 0x7FF), DATA, st.just(False), st.booleans(), st.booleans())
EXTENDED = st.builds(Frame, st.integers(0, (1 << 29) - 1), DATA, st.just(True))
FRAMES = st.lists(PLAIN | EXTENDED, min_size=1, max_size=12)


def decode(line: bytes) -> tuple[list[Frame], Decoder]:
    decoder = Decoder()
    return list(decoder.feed(line)), decoder


@given(FRAMES)
def test_frames_come_as_they_were_sent(frames: list[Frame]):
    received, decoder = decode(b"".join(map(encode, frames)))
    assert received == frames
    assert decoder.errors == 0


@given(FRAMES, st.lists(st.integers(1, 7), min_size=1))
def test_it_does_not_matter_how_the_stream_is_cut(frames: list[Frame], cuts: list[int]):
    line, decoder, at = b"".join(map(encode, frames)), Decoder(), 0
    received: list[Frame] = []
    while at < len(line):
        step = cuts[at % len(cuts)]
        received += decoder.feed(line[at : at + step])
        at += step
    assert received == frames


@given(FRAMES, st.data())
def test_bit_errors_are_found_counted_and_survived(frames: list[Frame], data: st.DataObject):
    line = bytearray(b"".join(map(encode, frames)))
    for bit in data.draw(st.lists(st.integers(0, 8 * len(line) - 1), min_size=1, max_size=3)):
        line[bit // 8] ^= 1 << bit % 8
    last = Frame(0x181, b"\x00\x01")
    received, decoder = decode(bytes(line) + encode(last) + encode(last))
    # Damage may join or part frames; whatever comes was sent, and the line is found again.
    assert all(frame in frames or frame == last for frame in received)
    assert received[-1] == last
    missing = len(frames) + 2 - len(received)
    assert missing <= 0 or decoder.errors > 0


@pytest.mark.fuzz
@given(st.binary(max_size=200))
def test_noise_gives_no_frame_and_no_error_but_a_count(noise: bytes):
    frame = Frame(0x80, b"\x07")
    received, decoder = decode(noise + b"\x00" + encode(frame))
    assert received[-1] == frame
    pieces = [piece for piece in noise.split(b"\x00") if piece]
    assert decoder.errors + len(received) - 1 == len(pieces)


def test_who_joins_in_the_middle_finds_the_next_frame():
    frames = [Frame(0x181, bytes(range(8))), Frame(0x281, b"\x00" * 8), Frame(0x381, b"x")]
    line = b"".join(map(encode, frames))
    received, decoder = decode(line[5:])
    assert received == frames[1:]
    assert decoder.errors == 1


def test_a_line_that_babbles_fills_no_memory():
    decoder = Decoder()
    for _ in range(1000):
        assert not list(decoder.feed(b"\x55" * 1000))
    assert len(decoder._pending) < 64
    assert list(decoder.feed(b"\x00" + encode(Frame(1, b"")))) == [Frame(1, b"")]
    assert decoder.errors == 1


@pytest.mark.parametrize("frame", [Frame(0x800, b""), Frame(-1, b""), Frame(1, b"123456789")])
def test_what_is_no_can_frame_is_not_sent(frame: Frame):
    with pytest.raises(ValueError, match="should be"):
        encode(frame)


# ------------------------------------------------------------------------------------ a real line


@pytest.fixture
def line() -> Iterator[tuple[CobsSerialBus, int]]:
    """A bus on a pseudo-terminal, and the other end of the line."""
    master, slave = pty.openpty()
    tty.setraw(master)
    tty.setraw(slave)
    bus = CobsSerialBus(os.ttyname(slave))
    yield bus, master
    bus.shutdown()
    os.close(master)
    os.close(slave)


def test_a_serial_line_is_a_bus_in_both_directions(line: tuple[CobsSerialBus, int]):
    bus, far = line
    message = can.Message(arbitration_id=0x203, data=b"\x00\x0f\x00", is_extended_id=False)
    bus.send(message)
    (sent,) = Decoder().feed(os.read(far, 100))
    assert (sent.can_id, sent.data) == (0x203, b"\x00\x0f\x00")
    os.write(far, b"\x11noise\x00" + encode(Frame(0x183, b"\x27\x02")))
    received = bus.recv(5.0)
    assert received is not None
    assert (received.arbitration_id, bytes(received.data)) == (0x183, b"\x27\x02")
    assert bus.recv(0.0) is None
    assert bus.decoder.errors == 1


def test_a_can_fd_frame_is_refused(line: tuple[CobsSerialBus, int]):
    with pytest.raises(can.CanOperationError, match="classic CAN"):
        line[0].send(can.Message(arbitration_id=1, data=bytes(12), is_fd=True))


def test_a_line_that_is_gone_does_not_busy_its_reader():
    master, slave = pty.openpty()
    bus = CobsSerialBus(os.ttyname(slave))
    os.close(master)
    since = time.process_time()
    end = time.monotonic() + 0.2
    while time.monotonic() < end:
        with pytest.raises(can.CanOperationError):
            bus.recv(0.1)
    assert time.process_time() - since < 0.1
    bus.shutdown()
    os.close(slave)


def test_a_line_that_takes_nothing_does_not_hold_up_its_sender(line: tuple[CobsSerialBus, int]):
    message = can.Message(arbitration_id=0x203, data=bytes(8), is_extended_id=False)
    failed, longest = 0, 0.0
    while failed < 3:  # nobody reads the other end: its buffer is full in the end
        since = time.monotonic()
        try:
            line[0].send(message)
        except can.CanOperationError:
            failed += 1
        longest = max(longest, time.monotonic() - since)
    assert longest < 0.5


def test_a_port_that_is_plugged_in_again_is_opened(tmp_path: Path):
    port = tmp_path / "ttyUSB0"

    def plug_in() -> tuple[int, int]:
        ends = pty.openpty()
        for end in ends:
            tty.setraw(end)
        port.symlink_to(os.ttyname(ends[1]))
        return ends

    def unplug(ends: tuple[int, int]) -> None:
        port.unlink()
        for end in ends:
            os.close(end)

    ends = plug_in()
    link = Link(CobsSerialBus(str(port)))
    unplug(ends)
    assert link.receive(0.1) is None
    link.send(0x80, b"\x01")
    assert "the port is gone" in link.problem
    ends = plug_in()
    deadline = time.monotonic() + 5.0
    while link.problem and time.monotonic() < deadline:
        link.receive(0.05)
        link.send(0x80, b"\x02")
    (sent,) = Decoder().feed(os.read(ends[0], 18))
    assert (sent.can_id, sent.data) == (0x80, b"\x02")
    os.write(ends[0], encode(Frame(0x183, b"\x27")))
    received = link.receive(1.0)
    assert received is not None
    assert received.arbitration_id == 0x183
    link.close()
    unplug(ends)


# ------------------------------------------------------------------------------------- transports


@pytest.mark.parametrize(
    "link", ["", "can0", "udp:1.2.3.4", "virtual:", "serial", "socketcan:can0:500000"]
)
def test_an_unknown_link_is_refused_with_the_known_ones(link: str):
    with pytest.raises(TransportError, match=r"link|socketcan"):
        open_bus(link)


@pytest.mark.parametrize("number", ["0", "65536", "99999", "9" * 5000])
def test_a_number_that_is_no_port_is_refused(number: str):
    with pytest.raises(TransportError, match=r"should be 1 to 65535|cannot be opened"):
        open_bus(f"udp_multicast:239.74.163.2:{number}")


def test_a_baud_rate_that_overflows_is_refused(line: tuple[CobsSerialBus, int]):
    channel = line[0].channel_info.removeprefix("COBS on ")
    line[0].shutdown()
    with pytest.raises(TransportError, match="cannot be opened"):
        open_bus(f"serial:{channel}:99999999999")


@pytest.mark.parametrize("rate", [9600, 115200, 460800])
def test_a_line_that_is_too_slow_for_the_devices_is_refused(
    line: tuple[CobsSerialBus, int], rate: int
):
    channel = line[0].channel_info.removeprefix("COBS on ")
    line[0].shutdown()
    with pytest.raises(TransportError, match=f"{rate}: the bit rate should be at least 566000"):
        open_bus(f"serial:{channel}:{rate}")
    open_bus(f"serial:{channel}:921600").shutdown()


def test_a_missing_port_is_reported():
    with pytest.raises(TransportError, match="/dev/no_such_port"):
        open_bus("serial:/dev/no_such_port")


@pytest.mark.parametrize("kind", ["virtual", "udp_multicast"])
def test_two_ends_of_a_link_receive_each_other(kind: str, own_multicast: str):
    link = own_multicast if kind == "udp_multicast" else "virtual:here"
    one, other = open_bus(link), open_bus(link)
    try:
        one.send(can.Message(arbitration_id=0x80, data=b"\x01", is_extended_id=False))
        received = other.recv(5.0)
        assert received is not None
        assert bytes(received.data) == b"\x01"
    finally:
        one.shutdown()
        other.shutdown()


def test_a_udp_bus_receives_other_frames_but_not_its_own(own_multicast: str):
    frame = can.Message(arbitration_id=0x80, data=b"\x01", is_extended_id=False)
    _, group, port = own_multicast.split(":")
    foreign = can.Bus(interface="udp_multicast", channel=group, port=int(port), fd=False)
    one, other = (open_bus(own_multicast) for _ in range(2))
    try:
        for sender in (one, other, foreign):
            sender.send(frame)
        for bus, others in ((one, 2), (other, 2)):
            assert [bus.recv(5.0) is not None for _ in range(others)] == [True] * others
            assert bus.recv(0.1) is None
        with pytest.raises(can.CanOperationError, match="classic CAN"):
            one.send(can.Message(arbitration_id=1, data=bytes(12), is_fd=True))
    finally:
        for bus in (one, other, foreign):
            bus.shutdown()


def test_socketcan_carries_frames():
    try:
        one, other = open_bus("socketcan:vcan0"), open_bus("socketcan:vcan0")
    except TransportError as error:
        pytest.skip(f"no CAN interface vcan0 on this machine: {error}")
    try:
        one.send(can.Message(arbitration_id=0x80, data=b"\x01", is_extended_id=False))
        assert other.recv(5.0) is not None
    finally:
        one.shutdown()
        other.shutdown()
