"""What is asked for as an impairment, and what a line makes of frames: no bus, no ROS."""

from __future__ import annotations

from pathlib import Path

import pytest

from msg_schemas.parameters import ParameterError
from rover_hil.devices import BRIDGE_NODE, WINCH
from rover_hil.emulator.line import Line
from rover_hil.impairment import KINDS, Impairment, read_impairments

Frame = tuple[int, bytes]
SYNC, RPDO, HEARTBEAT = 0x80, 0x203, 0x700 + BRIDGE_NODE
MANY = 4000


class Wire:
    """A line of the winch, with what came out of it at both ends and a clock set by hand."""

    def __init__(self) -> None:
        self.time = 0.0
        self.sent: list[Frame] = []
        self.heard: list[Frame] = []
        self.line = Line(WINCH, lambda *frame: self.sent.append(frame), self._now_ns)
        for can_id in (SYNC, RPDO, HEARTBEAT):
            self.line.network.subscribe(can_id, self._hear)

    def _now_ns(self) -> int:
        return round(self.time * 1e9)

    def _hear(self, can_id: int, data: bytearray, _timestamp: float) -> None:
        self.heard.append((can_id, bytes(data)))

    def begin(self, text: str) -> None:
        for impairment in read_impairments(text):
            for way in self.line.ways(impairment.way):
                way.begin(impairment)

    def send(self, frames: list[Frame], period: float = 0.0) -> list[Frame]:
        """Send frames outwards, one each period [s]; returns what came by the end."""
        for frame in frames:
            self.line.send(*frame)
            self.time += period
            self.line.step()
        return self.sent


def numbered(count: int, can_id: int = 0x183) -> list[Frame]:
    return [(can_id, k.to_bytes(4, "little")) for k in range(count)]


def survivors(text: str, count: int = MANY, can_id: int = 0x183) -> list[Frame]:
    wire = Wire()
    wire.begin(text)
    return wire.send(numbered(count, can_id))


# -------------------------------------------------------------------------------- what is asked for


def test_a_list_is_read_and_written_as_it_was():
    text = (
        "[{what: loss, on: rover, strength: 0.3, at: 5.0, duration: 10.0, seed: 7}, "
        "{what: drive_fault, on: winch, cause: encoder}, {what: bridge_kill, at: 1.0}]"
    )
    first, second, third = read = read_impairments(text)
    assert first == Impairment("loss", "rover", "both", 5.0, 10.0, 0.3, "", 7)
    assert [device.name for device in first.devices] == ["jump", "wheel", "imu"]
    assert [device.name for device in second.devices] == ["winch"]
    assert third.devices == ()
    assert read_impairments(f"[{', '.join(map(str, read))}]") == read


@pytest.mark.parametrize("text", ["", "[]", "  \n"])
def test_nothing_is_no_impairment(text: str):
    assert read_impairments(text) == ()


def test_a_file_holds_what_a_text_may(tmp_path: Path):
    file = tmp_path / "storm.yaml"
    file.write_text("- {what: cut, on: rover, duration: 30}\n- {what: jitter, strength: 0.01}\n")
    assert [each.what for each in read_impairments(str(file))] == ["cut", "jitter"]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("{what: los, strength: 0.1}", "should be one of delay, jitter, loss"),
        ("{strength: 0.1}", "should say what: one of delay"),
        ("{what: loss}", "from 0 to 1"),
        ("{what: loss, strength: 1.5}", "from 0 to 1"),
        ("{what: loss, strength: .nan}", "finite"),
        ("{what: cut, strength: 0.5}", "cut has none"),
        ("{what: cut, on: moon}", "should be one of all, rover"),
        ("{what: frozen_encoder, on: imu}", "should be on jump, wheel, winch"),
        ("{what: drifted_load_cell, on: winch, strength: 1.0}", "should be on imu, load_cell"),
        ("{what: drive_fault, on: winch}", "undervoltage, overtemperature, encoder"),
        ("{what: cut, cause: encoder}", "cut has no cause"),
        ("{what: brown_out, way: to_bridge}", "brown_out has none"),
        ("{what: cut, durations: 1.0}", "did you mean 'duration'"),
        ("[{what: cut}, {what: cut, at: -1}]", r"impairments\[1\].*at least 0"),
        ("cut", "should be names and values"),
        ("[cut", "is not YAML"),
        ("/nowhere/storm.yaml", "/nowhere/storm.yaml.*cannot be read"),
    ],
)
def test_what_makes_no_sense_is_refused_with_what_would_be_right(text: str, complaint: str):
    with pytest.raises(ParameterError, match=complaint):
        read_impairments(text)


# ---------------------------------------------------------------------- what becomes of frames


def test_a_line_that_is_well_hands_on_at_once_what_is_for_its_device():
    wire = Wire()
    wire.send(numbered(3))
    assert wire.sent == numbered(3)
    for can_id in (SYNC, RPDO, HEARTBEAT, 0x202, 0x100203):
        wire.line.hear(can_id, b"\x01")
    assert [can_id for can_id, _ in wire.heard] == [SYNC, RPDO, HEARTBEAT]
    assert wire.line.due_ns is None


def test_how_long_a_frame_has_waited_is_known_where_nothing_held_it_back():
    wire = Wire()
    waited: list[int] = []
    wire.line.network.subscribe(RPDO, lambda *_: waited.append(wire.line.waited_ns))
    wire.line.hear(RPDO, b"\x01", 700)
    wire.begin("[{what: delay, strength: 0.5}]")
    wire.line.hear(RPDO, b"\x02", 700)
    wire.time = 0.6
    wire.line.step()
    assert waited == [700, 0]


def test_frames_are_lost_by_their_share_and_the_same_ones_each_time():
    lost = "{what: loss, strength: 0.3, seed: %d}"
    first = survivors(lost % 1)
    assert len(first) / MANY == pytest.approx(0.7, abs=0.03)
    assert survivors(lost % 1) == first
    assert survivors(lost % 2) != first
    other = [data for _, data in survivors(lost % 1, can_id=0x283)]
    assert other != [data for _, data in first]


def test_the_frames_that_are_lost_do_not_depend_on_what_else_is_sent():
    wire = Wire()
    wire.begin("{what: loss, strength: 0.3}")
    for frame in numbered(500):
        wire.send([(0x583, bytes(8)), frame])
    assert [frame for frame in wire.sent if frame[0] == 0x183] == survivors(
        "{what: loss, strength: 0.3}", 500
    )


def test_one_way_alone_may_suffer():
    wire = Wire()
    wire.begin("{what: cut, way: to_devices}")
    wire.line.hear(SYNC, b"\x01")
    wire.send(numbered(2))
    assert not wire.heard
    assert wire.sent == numbered(2)


def test_late_frames_keep_their_order_and_come_when_they_are_due():
    wire = Wire()
    wire.begin("[{what: delay, strength: 0.1}, {what: jitter, strength: 0.05}]")
    early: list[float] = []
    for number, frame in enumerate(numbered(200)):
        before = len(wire.sent)
        wire.send([frame], 0.005)
        early += [wire.time - k * 0.005 for k in range(before, len(wire.sent))]
        assert len(wire.sent) <= number
    assert wire.sent == numbered(200)[: len(wire.sent)]
    assert min(early) >= 0.1
    assert max(early) <= 0.1 + 0.05 + 0.005 + 1e-9
    wire.time += 1.0
    wire.line.step()
    assert wire.sent == numbered(200)


def test_frames_behind_late_ones_do_not_overtake_them_when_the_delay_is_over():
    wire = Wire()
    (late,) = read_impairments("{what: delay, strength: 0.5}")
    (way,) = wire.line.ways("to_bridge")
    standing = way.begin(late)
    wire.send(numbered(2))
    way.end(standing)
    wire.send([(0x183, b"last")])
    assert wire.sent == []
    assert wire.line.due_ns == 500_000_000
    wire.time = 0.5
    wire.line.step()
    assert wire.sent == [*numbered(2), (0x183, b"last")]


def test_frames_come_twice_by_their_share():
    sent = survivors("{what: duplication, strength: 0.25}")
    assert sorted(set(sent)) == sorted(numbered(MANY))
    assert len(sent) / MANY == pytest.approx(1.25, abs=0.03)


def test_frames_are_overtaken_by_at_most_five_and_none_is_lost():
    wire = Wire()
    wire.begin("{what: reorder, strength: 0.2}")
    wire.send(numbered(MANY))
    wire.time += 1.0
    wire.line.step()
    order = [int.from_bytes(data, "little") for _, data in wire.sent]
    assert sorted(order) == list(range(MANY))
    ahead = [order.index(k) - k for k in range(MANY)]
    overtaken = [way for way in ahead if way > 0]
    assert 0.1 * MANY < len(overtaken) < 0.3 * MANY
    # Of a frame that waits, those that wait as well are not counted among those that pass.
    assert max(overtaken) <= 10


def test_a_frame_that_nothing_follows_is_not_held_back_for_ever():
    wire = Wire()
    wire.begin("{what: reorder, strength: 1.0}")
    wire.send(numbered(1))
    assert wire.sent == []
    assert wire.line.due_ns is not None
    wire.time = wire.line.due_ns * 1e-9
    wire.line.step()
    assert wire.sent == numbered(1)


def test_damaged_frames_are_found_and_nothing_but_what_was_sent_gets_through():
    sent = survivors("{what: bit_errors, strength: 0.002}")
    assert set(sent) <= set(numbered(MANY))
    # 4 bytes of identifier and data each, as many of the checksum, and what stuffing adds.
    bits = 8 * (4 + 4 + 4 + 2)
    assert len(sent) / MANY == pytest.approx((1 - 0.002) ** bits, abs=0.04)


def test_every_kind_is_described():
    for name, kind in KINDS.items():
        assert kind.about, name
        assert bool(kind.strength) == (kind.largest > 0.0), name
