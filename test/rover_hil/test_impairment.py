"""Impairments: their definition, and their effect on the frames of a channel."""

from __future__ import annotations

from pathlib import Path

import pytest

from msg_schemas.parameters import ParameterError
from rover_hil.canopen.devices import BRIDGE_NODE, WINCH
from rover_hil.canopen.impairment import KINDS, Impairment, read_impairments
from rover_hil.emulator.channel import DeviceChannel

Frame = tuple[int, bytes]
SYNC, RPDO, HEARTBEAT_PERIOD = 0x80, 0x203, 0x700 + BRIDGE_NODE
MANY = 4000


class Wire:
    """The winch's channel, the frames at both of its ends, and a clock set by the test."""

    def __init__(self) -> None:
        self.time = 0.0
        self.sent: list[Frame] = []
        self.received: list[Frame] = []
        self.line = DeviceChannel(WINCH, lambda *frame: self.sent.append(frame), self._now_ns)
        for can_id in (SYNC, RPDO, HEARTBEAT_PERIOD):
            self.line.network.subscribe(can_id, self._on_frame)

    def _now_ns(self) -> int:
        return round(self.time * 1e9)

    def _on_frame(self, can_id: int, data: bytearray, _timestamp: float) -> None:
        self.received.append((can_id, bytes(data)))

    def begin(self, text: str) -> None:
        for impairment in read_impairments(text):
            for direction in self.line.directions(impairment.direction):
                direction.begin(impairment)

    def send(self, frames: list[Frame], period: float = 0.0) -> list[Frame]:
        """Send frames of the device, one each period [s]; returns the frames on the bus."""
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


# --------------------------------------------------------------------------------------- definition


def test_a_list_is_written_as_it_was_read():
    text = (
        "[{kind: loss, target: rover, magnitude: 0.3, start: 5.0, duration: 10.0, seed: 7}, "
        "{kind: drive_fault, target: winch, cause: encoder}, {kind: bridge_kill, start: 1.0}]"
    )
    first, second, third = read = read_impairments(text)
    assert first == Impairment("loss", "rover", "both", 5.0, 10.0, 0.3, "", 7)
    assert [device.name for device in first.devices] == ["jump", "wheel", "imu"]
    assert [device.name for device in second.devices] == ["winch"]
    assert third.devices == ()
    assert read_impairments(f"[{', '.join(map(str, read))}]") == read


@pytest.mark.parametrize("text", ["", "[]", "  \n"])
def test_an_empty_text_has_no_impairments(text: str):
    assert read_impairments(text) == ()


def test_a_file_contains_the_same_as_a_text(tmp_path: Path):
    file = tmp_path / "storm.yaml"
    file.write_text(
        "- {kind: cut, target: rover, duration: 30}\n- {kind: jitter, magnitude: 0.01}\n"
    )
    assert [each.kind for each in read_impairments(str(file))] == ["cut", "jitter"]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("{kind: los, magnitude: 0.1}", "should be one of delay, jitter, loss"),
        ("{magnitude: 0.1}", "kind is missing: should be one of delay"),
        ("{kind: loss}", "from 0 to 1"),
        ("{kind: loss, magnitude: 1.5}", "from 0 to 1"),
        ("{kind: loss, magnitude: .nan}", "finite"),
        ("{kind: cut, magnitude: 0.5}", "cut has no magnitude"),
        ("{kind: cut, target: moon}", "should be one of all, rover"),
        ("{kind: frozen_encoder, target: imu}", "should target one of jump, wheel, winch"),
        (
            "{kind: drifted_load_cell, target: winch, magnitude: 1.0}",
            "should target one of imu, load_cell",
        ),
        ("{kind: drive_fault, target: winch}", "undervoltage, overtemperature, encoder"),
        ("{kind: emulator_kill, target: winch}", "target = 'winch': emulator_kill has no target"),
        ("{kind: cut, cause: encoder}", "cut has no cause"),
        ("{kind: brown_out, direction: to_bridge}", "brown_out has no direction"),
        ("{kind: cut, durations: 1.0}", "did you mean 'duration'"),
        ("[{kind: cut}, {kind: cut, start: -1}]", r"impairments\[1\].*at least 0"),
        ("cut", "should be names and values"),
        ("[cut", "is not YAML"),
        ("/nowhere/storm.yaml", "/nowhere/storm.yaml.*cannot be read"),
    ],
)
def test_an_invalid_impairment_is_refused_with_the_expected_value(text: str, complaint: str):
    with pytest.raises(ParameterError, match=complaint):
        read_impairments(text)


# ---------------------------------------------------------------------------- effect on frames


def test_an_unimpaired_channel_delivers_the_frames_of_its_device_at_once():
    wire = Wire()
    wire.send(numbered(3))
    assert wire.sent == numbered(3)
    for can_id in (SYNC, RPDO, HEARTBEAT_PERIOD, 0x202, 0x100203):
        wire.line.receive(can_id, b"\x01")
    assert [can_id for can_id, _ in wire.received] == [SYNC, RPDO, HEARTBEAT_PERIOD]
    assert wire.line.due_ns is None


def test_the_age_of_a_frame_is_known_unless_the_channel_delays_it():
    wire = Wire()
    ages: list[int] = []
    wire.line.network.subscribe(RPDO, lambda *_: ages.append(wire.line.frame_age_ns))
    wire.line.receive(RPDO, b"\x01", 700)
    wire.begin("[{kind: delay, magnitude: 0.5}]")
    wire.line.receive(RPDO, b"\x02", 700)
    wire.time = 0.6
    wire.line.step()
    assert ages == [700, 0]


def test_a_fraction_of_frames_is_lost_reproducibly():
    lost = "{kind: loss, magnitude: 0.3, seed: %d}"
    first = survivors(lost % 1)
    assert len(first) / MANY == pytest.approx(0.7, abs=0.03)
    assert survivors(lost % 1) == first
    assert survivors(lost % 2) != first
    other = [data for _, data in survivors(lost % 1, can_id=0x283)]
    assert other != [data for _, data in first]


def test_lost_frames_do_not_depend_on_other_identifiers():
    wire = Wire()
    wire.begin("{kind: loss, magnitude: 0.3}")
    for frame in numbered(500):
        wire.send([(0x583, bytes(8)), frame])
    assert [frame for frame in wire.sent if frame[0] == 0x183] == survivors(
        "{kind: loss, magnitude: 0.3}", 500
    )


def test_a_single_direction_may_be_impaired():
    wire = Wire()
    wire.begin("{kind: cut, direction: to_devices}")
    wire.line.receive(SYNC, b"\x01")
    wire.send(numbered(2))
    assert not wire.received
    assert wire.sent == numbered(2)


def test_delayed_frames_keep_their_order_and_arrive_when_due():
    wire = Wire()
    wire.begin("[{kind: delay, magnitude: 0.1}, {kind: jitter, magnitude: 0.05}]")
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


def test_frames_do_not_overtake_delayed_ones_after_the_end_of_the_delay():
    wire = Wire()
    (late,) = read_impairments("{kind: delay, magnitude: 0.5}")
    (direction,) = wire.line.directions("to_bridge")
    active = direction.begin(late)
    wire.send(numbered(2))
    direction.end(active)
    wire.send([(0x183, b"last")])
    assert wire.sent == []
    assert wire.line.due_ns == 500_000_000
    wire.time = 0.5
    wire.line.step()
    assert wire.sent == [*numbered(2), (0x183, b"last")]


def test_a_fraction_of_frames_is_duplicated():
    sent = survivors("{kind: duplication, magnitude: 0.25}")
    assert sorted(set(sent)) == sorted(numbered(MANY))
    assert len(sent) / MANY == pytest.approx(1.25, abs=0.03)


def test_a_frame_is_overtaken_by_at_most_five_and_none_is_lost():
    wire = Wire()
    wire.begin("{kind: reorder, magnitude: 0.2}")
    wire.send(numbered(MANY))
    wire.time += 1.0
    wire.line.step()
    order = [int.from_bytes(data, "little") for _, data in wire.sent]
    assert sorted(order) == list(range(MANY))
    ahead = [order.index(k) - k for k in range(MANY)]
    overtaken = [direction for direction in ahead if direction > 0]
    assert 0.1 * MANY < len(overtaken) < 0.3 * MANY
    # Other reordered frames do not count as overtaking.
    assert max(overtaken) <= 10


def test_a_reordered_frame_without_a_successor_is_delivered_after_a_timeout():
    wire = Wire()
    wire.begin("{kind: reorder, magnitude: 1.0}")
    wire.send(numbered(1))
    assert wire.sent == []
    assert wire.line.due_ns is not None
    wire.time = wire.line.due_ns * 1e-9
    wire.line.step()
    assert wire.sent == numbered(1)


def test_corrupted_frames_are_detected_and_only_sent_frames_pass():
    sent = survivors("{kind: bit_errors, magnitude: 0.002}")
    assert set(sent) <= set(numbered(MANY))
    # 4 bytes each of identifier, data and checksum, and 2 of stuffing.
    bits = 8 * (4 + 4 + 4 + 2)
    assert len(sent) / MANY == pytest.approx((1 - 0.002) ** bits, abs=0.04)


def test_a_magnitude_has_a_meaning_and_a_range():
    for name, kind in KINDS.items():
        assert bool(kind.magnitude) == (kind.maximum > 0.0), name
