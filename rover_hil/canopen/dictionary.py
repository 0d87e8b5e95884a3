"""Object dictionaries of the devices for the `canopen` library, and their EDS files.

``mother_rover hil dictionary`` writes ``rover_hil/canopen/eds/<device>.eds`` and the tables of
error codes and objects in ``docs/hil.md``; with ``--compare`` it compares another EDS file with a
device.
"""

from __future__ import annotations

import argparse
import configparser
import io
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import canopen
from canopen.objectdictionary import ObjectDictionary, ODArray, ODRecord, ODVariable, datatypes, eds

from msg_schemas.regular_files import file_problem, read_text
from rover_hil.canopen.devices import (
    BRIDGE_NODE,
    BY_NAME,
    DEVICES,
    HEARTBEAT_PERIOD,
    HEARTBEAT_TIMEOUT,
    REVISION,
    SYNC_PERIOD,
    VENDOR,
    ErrorCode,
)
from rover_hil.canopen.objects import Device, ObjectEntry, Pdo

EDS_FOLDER = Path(__file__).parent / "eds"
DOCUMENT = Path("docs/hil.md")
_MARKS = ("<!-- objects: generated -->", "<!-- objects: end -->")
_EVERY_SYNC, _ON_RECEPTION = 1, 255
_GROUP_NAMES = {
    0x2010: "Command set",
    0x2011: "Sample",
    0x2012: "Second encoder",
    0x6000: "Digital inputs",
    0x7130: "Process values",
    0x7131: "Specific forces",
    0x7132: "Analogue inputs",
    0x7133: "Angular rates",
}
# Fixed times, so that generated files do not change with each run.
_FILE_INFO = {
    "FileVersion": 1,
    "FileRevision": 0,
    "EdsVersion": "4.0",
    "CreationDate": "01-01-2026",
    "CreationTime": "12:00AM",
    "ModificationDate": "01-01-2026",
    "ModificationTime": "12:00AM",
}


def object_dictionary(device: Device) -> canopen.ObjectDictionary:
    """Dictionary of a device, with CiA 301's objects for heartbeat, SYNC, identity and PDOs."""
    made = canopen.ObjectDictionary()
    made.node_id = device.node_id
    made.bitrate = 1_000_000
    info: Any = made.device_information  # the library's annotations are wrong
    info.vendor_name, info.vendor_number = "mother_rover", VENDOR
    info.product_name, info.product_number = device.product, device.product_code
    info.revision_number = REVISION
    info.nr_of_RXPDO, info.nr_of_TXPDO = len(device.rpdos), len(device.tpdos)
    info.granularity = 8
    info.allowed_baudrates = {1_000_000}
    for plain in _communication(device):
        made.add_object(plain)
    for pdo in device.pdos:
        for record in _pdo_records(device, pdo):
            made.add_object(record)
    groups: dict[int, ODRecord] = {}
    for entry in device.entries:
        if entry.subindex == 0:
            made.add_object(_variable(entry))
            continue
        if entry.index not in groups:
            groups[entry.index] = ODRecord(_GROUP_NAMES[entry.index], entry.index)
            made.add_object(groups[entry.index])
        groups[entry.index].add_member(_variable(entry))
    for index, group in groups.items():
        count = _number(index, 0, "Highest sub-index supported", datatypes.UNSIGNED8, "const")
        count.default = max(group.subindices)
        group.add_member(count)
    return made


def export(device: Device) -> str:
    """Text of a device's EDS file."""
    text = io.StringIO()
    # The library keeps the mapping: each device needs its own.
    eds.export_eds(
        object_dictionary(device), text, {**_FILE_INFO, "FileName": f"{device.name}.eds"}
    )
    return "\n".join(line.rstrip() for line in text.getvalue().splitlines()).strip() + "\n"


def differences(device: Device, other: canopen.ObjectDictionary) -> list[str]:
    """Differences of another dictionary, such as a vendor's EDS file, from a device's."""
    found = []
    for mine in variables(object_dictionary(device)):
        where = f"{mine.index:04X}h:{mine.subindex:02X} {mine.name}"
        try:
            group = other[mine.index]
            theirs = group if isinstance(group, ODVariable) else group[mine.subindex]
        except KeyError:
            found.append(f"{where} is missing")
            continue
        for attribute, expected, actual in (
            ("data type", mine.data_type, theirs.data_type),
            ("access", mine.access_type, theirs.access_type),
            ("default", mine.default, theirs.default),
        ):
            if expected != actual:
                found.append(f"{where}: {attribute} is {actual!r}, should be {expected!r}")
        if mine.factor != theirs.factor or mine.unit != theirs.unit:
            found.append(
                f"{where}: a count is {theirs.factor:g} {theirs.unit}, should be {mine.factor:g} "
                f"{mine.unit}"
            )
    return found


def variables(of: canopen.ObjectDictionary) -> Iterator[ODVariable]:
    """Every variable of a dictionary, by address."""
    for index in of:
        held = of[index]
        if isinstance(held, ODVariable):
            yield held
        else:
            yield from (held[subindex] for subindex in sorted(held.subindices))


# --------------------------------------------------------------------------- parts of a dictionary


def _number(index: int, subindex: int, name: str, data_type: int, access: str) -> ODVariable:
    variable = ODVariable(name, index, subindex)
    variable.data_type, variable.access_type = data_type, access
    return variable


def _variable(entry: ObjectEntry) -> ODVariable:
    variable = _number(entry.index, entry.subindex, entry.name, entry.kind.code, entry.access)
    variable.default = entry.default
    variable.factor = entry.scale
    variable.unit = "" if entry.unit == "-" else entry.unit
    variable.description = entry.about
    variable.pdo_mappable = entry.access != "const"
    return variable


def _communication(device: Device) -> Iterator[ODVariable | ODRecord | ODArray]:
    def plain(index: int, name: str, kind: int, access: str, default: int | str) -> ODVariable:
        made = _number(index, 0, name, kind, access)
        made.default = default  # type: ignore[assignment]  # also strings, unlike the annotation
        return made

    u8, u16, u32 = datatypes.UNSIGNED8, datatypes.UNSIGNED16, datatypes.UNSIGNED32
    yield plain(0x1000, "Device type", u32, "const", device.device_type)
    yield plain(0x1001, "Error register", u8, "ro", 0)
    yield plain(0x1005, "COB-ID SYNC message", u32, "rw", 0x80)
    yield plain(0x1006, "Communication cycle period", u32, "rw", round(SYNC_PERIOD * 1e6))
    yield plain(
        0x1008, "Manufacturer device name", datatypes.VISIBLE_STRING, "const", device.product
    )
    yield plain(0x1014, "COB-ID EMCY", u32, "ro", 0x80 + device.node_id)
    yield _record(
        ODArray("Consumer heartbeat time", 0x1016),
        ("Bridge", u32, "rw", (BRIDGE_NODE << 16) | round(HEARTBEAT_TIMEOUT * 1e3)),
    )
    yield plain(0x1017, "Producer heartbeat time", u16, "rw", round(HEARTBEAT_PERIOD * 1e3))
    yield _record(
        ODRecord("Identity object", 0x1018),
        ("Vendor-ID", u32, "ro", VENDOR),
        ("Product code", u32, "ro", device.product_code),
        ("Revision number", u32, "ro", REVISION),
    )
    # The SYNC counter runs from 1 to this value.
    yield plain(0x1019, "Synchronous counter overflow value", u8, "rw", 240)


def _record(made: ODRecord | ODArray, *members: tuple[str, int, str, int]) -> ODRecord | ODArray:
    highest = ("Highest sub-index supported", datatypes.UNSIGNED8, "const", len(members))
    for subindex, (name, kind, access, default) in enumerate((highest, *members)):
        variable = _number(made.index, subindex, name, kind, access)
        variable.default = default
        made.add_member(variable)
    return made


def _pdo_records(device: Device, pdo: Pdo) -> tuple[ODRecord | ODArray, ODRecord | ODArray]:
    base = (0x1800 if pdo.sent_by_device else 0x1400) + pdo.number - 1
    transmission = _EVERY_SYNC if pdo.sent_by_device else _ON_RECEPTION
    parameter = _record(
        ODRecord(f"{pdo.name} communication parameter", base),
        ("COB-ID", datatypes.UNSIGNED32, "rw", pdo.can_id(device.node_id)),
        ("Transmission type", datatypes.UNSIGNED8, "rw", transmission),
    )
    mapped = tuple(
        (
            f"Mapping entry {k}",
            datatypes.UNSIGNED32,
            "rw",
            (entry.index << 16) | (entry.subindex << 8) | entry.kind.bits,
        )
        for k, entry in enumerate(pdo.entries, start=1)
    )
    mapping = _record(ODRecord(f"{pdo.name} mapping parameter", base + 0x200), *mapped)
    return parameter, mapping


# ------------------------------------------------------------------------------------ the document


def table() -> str:
    """Markdown tables of the error codes, and of the objects and PDOs of all devices."""
    lines = ["### Error codes", "", "| 603Fh | meaning |", "|---|---|"]
    lines += [f"| {code:04X}h | {code.about} |" for code in ErrorCode]
    for device in DEVICES:
        lines += [
            "",
            f"### Node {device.node_id}: {device.name}",
            "",
            (
                f"{device.product}; device type {device.device_type:08X}h, on the "
                f"{'rover' if device.is_on_rover else 'mother machine'}; "
                f"`rover_hil/canopen/eds/{device.name}.eds`."
            ),
            "",
            "| object | name | type | access | unit of a count | meaning |",
            "|---|---|---|---|---|---|",
        ]
        for entry in sorted(device.entries, key=lambda each: (each.index, each.subindex)):
            count = "-" if entry.unit == "-" else f"{entry.scale:.6g} {entry.unit}"
            lines.append(
                f"| {entry.index:04X}h:{entry.subindex:02X} | {entry.name} | "
                f"{entry.kind.name.lower()} | {entry.access} | {count} | {entry.about} |"
            )
        lines += ["", "| PDO | identifier | bytes | entries in order |", "|---|---|---|---|"]
        for pdo in device.pdos:
            names = ", ".join(f"{each.name} ({each.kind.name.lower()})" for each in pdo.entries)
            lines.append(
                f"| {pdo.name} | {pdo.can_id(device.node_id):03X}h | {pdo.layout.size} | {names} |"
            )
    return "\n".join(lines).strip()


def with_table(document: str) -> str:
    """The document with its tables regenerated."""
    begin, end = _MARKS
    pattern = re.compile(re.escape(begin) + ".*" + re.escape(end), re.DOTALL)
    return pattern.sub(lambda _: f"{begin}\n\n{table()}\n\n{end}", document)


def write_all() -> None:
    """Write the EDS files and the tables of the document."""
    EDS_FOLDER.mkdir(exist_ok=True)
    for device in DEVICES:
        (EDS_FOLDER / f"{device.name}.eds").write_text(export(device), encoding="utf-8")
    if DOCUMENT.exists():
        DOCUMENT.write_text(with_table(DOCUMENT.read_text(encoding="utf-8")), encoding="utf-8")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = (
        "Write the EDS file of every device and the tables of docs/hil.md, or compare "
        "another EDS file with a device."
    )
    parser.epilog = "Exit codes: 0 written or equal, 1 the EDS file differs, 2 it cannot be read."
    parser.add_argument(
        "--compare", nargs=2, metavar=("DEVICE", "EDS"),
        help=f"device ({', '.join(BY_NAME)}) and the EDS file to compare with it",
    )  # fmt: skip


def _read_dictionary(path: str) -> ObjectDictionary:
    """Read the EDS or DCF file of a device; raise OSError, or what its format violates."""
    if not path.lower().endswith((".eds", ".dcf")):
        msg = "it should be named .eds or .dcf"
        raise ValueError(msg)
    found: ObjectDictionary = eds.import_eds(io.StringIO(read_text(Path(path))), None)
    return found


def run(options: argparse.Namespace) -> int:
    """Run the command; return 1 where another dictionary differs, 2 where it cannot be read."""
    compared = options.compare
    if compared is None:
        write_all()
        print(f"wrote {', '.join(f'{device.name}.eds' for device in DEVICES)} in {EDS_FOLDER}")
        return 0
    name, path = compared
    if name not in BY_NAME:
        print(f"{name!r} is no device: should be one of {', '.join(BY_NAME)}", file=sys.stderr)
        return 2
    try:
        other = _read_dictionary(path)
    except OSError as error:
        print(f"cannot read {file_problem(error)}", file=sys.stderr)
        return 2
    except (ValueError, LookupError, configparser.Error) as error:
        print(f"{path} cannot be read: {error}", file=sys.stderr)
        return 2
    found = differences(BY_NAME[name], other)
    print("".join(f"{line}\n" for line in found), end="")
    return 1 if found else 0
