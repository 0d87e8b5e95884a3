"""Objects, PDOs and devices of CANopen, with the unit of one count."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

from canopen.objectdictionary import datatypes


class Kind(Enum):
    """Integer types of CiA 301.

    Attributes:
        code: of the data type.
        letter: for `struct`.
        bits: length.
        smallest, largest: range.
    """

    I8 = (datatypes.INTEGER8, "b")
    I16 = (datatypes.INTEGER16, "h")
    I32 = (datatypes.INTEGER32, "i")
    U8 = (datatypes.UNSIGNED8, "B")
    U16 = (datatypes.UNSIGNED16, "H")
    U32 = (datatypes.UNSIGNED32, "I")

    def __init__(self, code: int, letter: str) -> None:
        self.code = code
        self.letter = letter
        self.bits = 8 * struct.calcsize("<" + letter)
        signed = letter.islower()
        self.smallest = -(1 << (self.bits - 1)) if signed else 0
        self.largest = (1 << (self.bits - 1 if signed else self.bits)) - 1


@dataclass(frozen=True)
class ObjectEntry:
    """One object of a device.

    Attributes:
        key: short name within the suite.
        index, subindex: address in the dictionary.
        name: in CiA 301, CiA 402 or the device profile.
        kind: integer type.
        access: ro, rw or const.
        default: value at power-on, in counts.
        scale: value of one count, in `unit`.
        unit: SI unit, or ``-``.
        about: meaning, if the name is not enough.
    """

    key: str
    index: int
    subindex: int
    name: str
    kind: Kind
    access: str = "ro"
    default: int = 0
    scale: float = 1.0
    unit: str = "-"
    about: str = ""

    @cached_property
    def smallest(self) -> float:
        """Smallest value in the unit."""
        return self.kind.smallest * self.scale

    @cached_property
    def largest(self) -> float:
        """Largest value in the unit."""
        return self.kind.largest * self.scale

    def counts(self, value: float) -> int:
        """The nearest whole number of counts to a value in the unit.

        Raises:
            ValueError: it is not finite, or beyond the type's range.
        """
        if not math.isfinite(value):
            raise ValueError(f"{self.key} = {value}: should be a finite number")
        counts = round(value / self.scale)
        if not self.kind.smallest <= counts <= self.kind.largest:
            unit = "" if self.unit == "-" else f" {self.unit}"
            raise ValueError(
                f"{self.key} = {value:g}{unit}: should be from {self.smallest:g} to "
                f"{self.largest:g}{unit}"
            )
        return counts

    def saturated(self, value: float) -> int:
        """Like `counts`, saturated to the type's range."""
        return self.counts(min(max(value, self.smallest), self.largest))

    def value(self, counts: int) -> float:
        """The value in the unit."""
        return counts * self.scale


@dataclass(frozen=True)
class Pdo:
    """A process data object: entries in one frame of at most 8 bytes.

    Attributes:
        number: from 1.
        sent_by_device: True for a TPDO, False for an RPDO.
        entries: in the frame's order, without gaps.
    """

    number: int
    sent_by_device: bool
    entries: tuple[ObjectEntry, ...]

    def __post_init__(self) -> None:
        """Refuse entries that exceed a frame."""
        if self.layout.size > 8:
            raise ValueError(f"{self.name} has {self.layout.size} bytes: should be at most 8")

    @property
    def name(self) -> str:
        """TPDO1, RPDO2 ..."""
        return f"{'T' if self.sent_by_device else 'R'}PDO{self.number}"

    @cached_property
    def layout(self) -> struct.Struct:
        """Layout of its bytes."""
        return struct.Struct("<" + "".join(entry.kind.letter for entry in self.entries))

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """Keys of its entries."""
        return tuple(entry.key for entry in self.entries)

    def can_id(self, node_id: int) -> int:
        """Identifier of its frames, by CiA 301's predefined connection set."""
        return (0x80 if self.sent_by_device else 0x100) + 0x100 * self.number + node_id


@dataclass(frozen=True)
class Device:
    """A device on the link.

    Attributes:
        name: jump, wheel, winch, imu or load_cell.
        node_id: its CANopen node.
        product: description.
        product_code, device_type: objects 1018h:02 and 1000h.
        entries: of the profile and of the manufacturer.
        pdos: TPDOs and RPDOs.
        is_drive: whether it is a CiA 402 drive.
        is_on_rover: whether it has the rover's clock, not the mother machine's.
    """

    name: str
    node_id: int
    product: str
    product_code: int
    device_type: int
    entries: tuple[ObjectEntry, ...]
    pdos: tuple[Pdo, ...]
    is_drive: bool
    is_on_rover: bool

    @cached_property
    def by_key(self) -> dict[str, ObjectEntry]:
        """Entries by their keys."""
        return {entry.key: entry for entry in self.entries}

    @property
    def tpdos(self) -> tuple[Pdo, ...]:
        """Its TPDOs."""
        return tuple(pdo for pdo in self.pdos if pdo.sent_by_device)

    @property
    def rpdos(self) -> tuple[Pdo, ...]:
        """Its RPDOs."""
        return tuple(pdo for pdo in self.pdos if not pdo.sent_by_device)
