"""Object dictionaries: what the devices are, their EDS files, and how counts carry units."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import canopen
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rover_cli.command_line import main
from rover_hil.canopen.devices import (
    BRIDGE_NODE,
    DEVICES,
    DRIVES,
    JUMP,
    WINCH,
    ErrorCode,
    error_text,
)
from rover_hil.canopen.dictionary import (
    DOCUMENT,
    EDS_FOLDER,
    differences,
    export,
    object_dictionary,
    with_table,
)
from rover_hil.canopen.link import pack, unpack
from rover_hil.canopen.objects import Device, Kind, ObjectEntry, Pdo

ROOT = Path(__file__).parents[2]
ENTRIES = [(device, entry) for device in DEVICES for entry in device.entries]
PDOS = [(device, pdo) for device in DEVICES for pdo in device.pdos]
CIA_402 = {
    0x603F, 0x6040, 0x6041, 0x605A, 0x6060, 0x6061, 0x6064, 0x606C, 0x6072, 0x6076, 0x6077, 0x6078,
    0x607A, 0x6085, 0x6502,
}  # fmt: skip


def of(item: tuple[Device, object]) -> str:
    device, part = item
    return f"{device.name}-{getattr(part, 'key', getattr(part, 'name', ''))}"


@pytest.mark.parametrize("device", DEVICES, ids=lambda device: device.name)
def test_the_eds_file_read_back_by_the_library_is_the_dictionary(device: Device):
    read = canopen.import_od(str(EDS_FOLDER / f"{device.name}.eds"))
    assert differences(device, read) == []
    assert len(read) == len(object_dictionary(device))


@pytest.mark.parametrize("device", DEVICES, ids=lambda device: device.name)
def test_the_eds_file_is_what_the_dictionary_generates(device: Device):
    committed = (EDS_FOLDER / f"{device.name}.eds").read_text(encoding="utf-8")
    assert committed == export(device), "run: mother_rover hil dictionary"


def test_the_document_s_table_is_what_the_dictionary_generates():
    text = (ROOT / DOCUMENT).read_text(encoding="utf-8")
    assert text == with_table(text), "run: mother_rover hil dictionary"
    assert "60FFh" in text


def test_differences_of_a_dictionary_are_listed_by_object():
    other: Any = object_dictionary(WINCH)
    other[0x60FF].factor = 1e-3
    other[0x6076].default = 1
    del other[0x6072]
    found = "\n".join(differences(WINCH, other))
    assert "60FFh:00 Target velocity: a count is 0.001 m/s, should be 1e-06 m/s" in found
    assert "6076h:00 Motor rated torque: default is 1, should be 5000" in found
    assert "6072h:00 Max torque is missing" in found


def test_drives_have_the_objects_of_cia_402_and_all_devices_those_of_cia_301():
    for device in DEVICES:
        held = set(object_dictionary(device))
        assert {0x1000, 0x1001, 0x1005, 0x1014, 0x1016, 0x1017, 0x1018} <= held
        assert not device.is_drive or held >= CIA_402
    assert all(0x60FF in object_dictionary(device) for device in DRIVES if device is not JUMP)


def test_nodes_and_identifiers_are_unique():
    nodes = [device.node_id for device in DEVICES]
    assert len(set(nodes)) == len(nodes)
    assert BRIDGE_NODE not in nodes
    identifiers = [pdo.can_id(device.node_id) for device, pdo in PDOS]
    assert len(set(identifiers)) == len(identifiers)


@pytest.mark.parametrize("item", PDOS, ids=of)
def test_a_pdo_is_packed_as_by_the_library(item: tuple[Device, Pdo]):
    device, pdo = item
    node = canopen.LocalNode(device.node_id, object_dictionary(device))
    node.associate_network(canopen.Network())
    maps = node.tpdo if pdo.sent_by_device else node.rpdo
    mapped = maps[pdo.number]
    mapped.read(from_od=True)
    counts = {entry.key: entry.kind.smallest + 3 * k + 1 for k, entry in enumerate(pdo.entries)}
    for variable, entry in zip(mapped, pdo.entries, strict=True):
        variable.raw = counts[entry.key]
    assert bytes(mapped.data) == pack(pdo, counts)
    assert mapped.cob_id == pdo.can_id(device.node_id)
    assert unpack(pdo, bytes(mapped.data)) == counts


def test_a_frame_of_another_length_is_not_decoded():
    pdo = WINCH.rpdos[0]
    assert unpack(pdo, bytes(pdo.layout.size - 1)) is None
    assert unpack(pdo, b"") is None


@given(item=st.sampled_from(ENTRIES), share=st.floats(0.0, 1.0))
def test_a_value_survives_its_counts_to_half_a_count(
    item: tuple[Device, ObjectEntry], share: float
):
    entry = item[1]
    value = entry.smallest + share * (entry.largest - entry.smallest)
    back = entry.value(entry.counts(value))
    assert abs(back - value) <= 0.5 * entry.scale * (1.0 + 1e-6) + 1e-12 * abs(value)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 3276.8, -3276.9])
def test_a_value_beyond_the_type_is_refused_with_its_range(value: float):
    torque = WINCH.by_key["target_torque"]
    with pytest.raises(ValueError, match="target_torque = "):
        torque.counts(value)


def test_a_sensor_saturates_at_its_range():
    torque = WINCH.by_key["torque"]
    assert torque.saturated(1e9) == Kind.I16.largest
    assert torque.saturated(-1e9) == Kind.I16.smallest


@pytest.mark.parametrize(
    ("device", "address", "kind"),
    [
        (JUMP, (0x6081, 0), Kind.U32),
        (JUMP, (0x6071, 0), Kind.I16),
        (JUMP, (0x606C, 0), Kind.I32),
        (WINCH, (0x60FF, 0), Kind.I32),
        (WINCH, (0x60B2, 0), Kind.I16),
        (WINCH, (0x6072, 0), Kind.U16),
        (WINCH, (0x605A, 0), Kind.I16),
        (WINCH, (0x6085, 0), Kind.U32),
        (WINCH, (0x6502, 0), Kind.U32),
    ],
)
def test_an_object_of_a_drive_has_the_type_of_cia_402(
    device: Device, address: tuple[int, int], kind: Kind
):
    kinds = {(each.index, each.subindex): each.kind for each in device.entries}
    assert kinds[address] is kind


def test_a_pdo_longer_than_a_frame_is_refused():
    with pytest.raises(ValueError, match="TPDO1 has 12 bytes"):
        Pdo(1, True, tuple(ObjectEntry(f"e{k}", 0x2000, k, "x", Kind.U32) for k in range(3)))


def test_the_command_compares_a_vendor_s_file_with_a_device(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    own = EDS_FOLDER / "winch.eds"
    assert main(["hil", "dictionary", "--compare", "winch", str(own)]) == 0
    assert capsys.readouterr().out == ""
    other = tmp_path / "vendor.eds"
    text = own.read_text(encoding="utf-8")
    other.write_text(text.replace("[60FF]", "[60FE]").replace("0x60FF", "0x60FE"), encoding="utf-8")
    assert main(["hil", "dictionary", "--compare", "winch", str(other)]) == 1
    assert "60FFh:00 Target velocity is missing" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        (("camera", "some.eds"), "'camera' is no device: should be one of jump, wheel"),
        (("winch", "there_is_none.eds"), "cannot read there_is_none.eds: No such file"),
        (("winch", "device.txt"), "device.txt cannot be read: it should be named .eds or .dcf"),
        (("winch", "/dev/zero"), "/dev/zero cannot be read: it should be named"),
    ],
)
def test_an_unknown_device_or_missing_file_is_refused(
    given: tuple[str, str], complaint: str, capsys: pytest.CaptureFixture[str]
):
    assert main(["hil", "dictionary", "--compare", *given]) == 2
    assert complaint in capsys.readouterr().err


def test_a_fifo_is_no_dictionary(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    os.mkfifo(tmp_path / "fifo.eds")
    assert main(["hil", "dictionary", "--compare", "winch", str(tmp_path / "fifo.eds")]) == 2
    assert "fifo.eds: it is no regular file" in capsys.readouterr().err


def test_an_error_code_is_shown_with_its_meaning():
    assert error_text(ErrorCode.RPDO_TIMEOUT).startswith("8250h (RPDO timeout")
    assert error_text(0x8210) == "8210h (monitoring)"
    assert error_text(0xA000) == "A000h (not defined by CiA 301)"


def test_a_dictionary_without_the_object_of_a_part_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    device = next(each for each in DEVICES if "[1018sub1]" in export(each))
    path = tmp_path / "device.eds"
    path.write_text(export(device).replace("[1018]", "[nothing]"), encoding="utf-8")
    assert main(["hil", "dictionary", "--compare", device.name, str(path)]) == 2
    assert "cannot be read" in capsys.readouterr().err
