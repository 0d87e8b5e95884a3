"""What can be wrong with a link, its devices and processes: one impairment, and a list as YAML.

    - {what: loss, on: rover, strength: 0.3, at: 5.0, duration: 10.0, seed: 7}
    - {what: drive_fault, on: winch, cause: overtemperature}

Here is only what may be asked for; who emulates the devices carries it out. Who writes procedures
reads the same texts by `read_impairments`.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from msg_schemas.fields import FieldError
from msg_schemas.parameters import ParameterError, from_mapping, parameter
from msg_schemas.yaml_reader import read_yaml
from rover_hil.devices import (
    DEVICES,
    DRIVES,
    ENCODER_FAULT,
    IMU,
    LOAD_CELL,
    OVERTEMPERATURE,
    UNDERVOLTAGE,
)
from rover_hil.objects import Device

CAUSES = {
    "undervoltage": UNDERVOLTAGE,
    "overtemperature": OVERTEMPERATURE,
    "encoder": ENCODER_FAULT,
}
"""Causes of a drive's fault, with their error codes."""

ALL, ROVER, MOTHER = "all", "rover", "mother"
BOTH, TO_DEVICES, TO_BRIDGE = "both", "to_devices", "to_bridge"


class Place(enum.Enum):
    """What suffers."""

    LINE = "frames between the bus and a device"
    DEVICE = "a device itself"
    PROCESS = "a whole process"


@dataclass(frozen=True)
class Kind:
    """One kind of impairment.

    Attributes:
        place: what suffers.
        about: what happens.
        strength: what the strength is; empty: there is none.
        unit: of the strength.
        smallest, largest: strengths.
        devices: that it can be on.
    """

    place: Place
    about: str
    strength: str = ""
    unit: str = "-"
    smallest: float = 0.0
    largest: float = 0.0
    devices: tuple[Device, ...] = DEVICES


KINDS: Mapping[str, Kind] = {
    "delay": Kind(Place.LINE, "frames come later, in their order", "delay", "s", 0.0, 10.0),
    "jitter": Kind(
        Place.LINE, "frames come later by a random time, in their order", "longest", "s", 0.0, 10.0
    ),
    "loss": Kind(Place.LINE, "frames get lost", "share of frames", "-", 0.0, 1.0),
    "duplication": Kind(Place.LINE, "frames come twice", "share of frames", "-", 0.0, 1.0),
    "reorder": Kind(
        Place.LINE, "1 to 5 later frames overtake a frame", "share of frames", "-", 0.0, 1.0
    ),
    "bit_errors": Kind(
        Place.LINE,
        "bits of frames flip, as on a serial line with its checksum",
        "share of bits",
        "-",
        0.0,
        0.1,
    ),
    "cut": Kind(Place.LINE, "no frame gets through"),
    "bus_off": Kind(
        Place.DEVICE, "the device's controller leaves the bus; it stops its motor and knows why"
    ),
    "stale_stamps": Kind(
        Place.DEVICE, "samples bear times that are too old", "by how much", "s", 0.0, 3600.0
    ),
    "frozen_encoder": Kind(
        Place.DEVICE, "the encoder stands still, whatever the motor does", devices=DRIVES
    ),
    "drifted_load_cell": Kind(
        Place.DEVICE, "the reading drifts away", "rate", "N/s", -100.0, 100.0, (IMU, LOAD_CELL)
    ),
    "brown_out": Kind(
        Place.DEVICE, "the supply fails: silent, motor off, brake closed; then it begins anew"
    ),
    "drive_fault": Kind(Place.DEVICE, "a cause of a fault, which stays", devices=DRIVES),
    "emulator_kill": Kind(Place.PROCESS, "the emulator is killed", devices=()),
    "bridge_kill": Kind(
        Place.PROCESS, "the bridge is killed, where it runs on the same machine", devices=()
    ),
}


@dataclass(frozen=True)
class Impairment:
    """What is wrong, with whom, from when, how long, how much."""

    what: str = parameter("loss", "-", "kind", choices=tuple(KINDS))
    on: str = parameter(
        ALL,
        "-",
        "the devices: one by its name, those on the rover or on the mother machine, or all",
        choices=(ALL, ROVER, MOTHER, *(device.name for device in DEVICES)),
    )
    way: str = parameter(
        BOTH, "-", "of frames, where frames suffer", choices=(BOTH, TO_DEVICES, TO_BRIDGE)
    )
    at: float = parameter(0.0, "s", "begins so long after it was asked for", 0.0, 1e6)
    duration: float = parameter(
        0.0, "s", "ends by itself after so long; 0 = when it is no longer asked for", 0.0, 1e6
    )
    strength: float = parameter(0.0, "-", "how much, in the unit of its kind", -1e6, 1e6)
    cause: str = parameter("", "-", "of a drive's fault", choices=("", *CAUSES))
    seed: int = parameter(1, "-", "of what is random in it", 0, 2**31 - 1)

    @property
    def kind(self) -> Kind:
        """What is known of its kind."""
        return KINDS[self.what]

    @property
    def devices(self) -> tuple[Device, ...]:
        """The devices that it is on."""
        return tuple(device for device in self.kind.devices if self._is_on(device))

    def _is_on(self, device: Device) -> bool:
        if self.on in (ROVER, MOTHER):
            return device.is_on_rover is (self.on == ROVER)
        return self.on in (ALL, device.name)

    def said(self) -> dict[str, object]:
        """What is said of it: all that matters to its kind, by the fields' names."""
        kind = self.kind
        found: dict[str, object] = {"what": self.what}
        if kind.devices:
            found["on"] = self.on
        if kind.place is Place.LINE:
            found |= {"way": self.way, "seed": self.seed}
        if kind.strength:
            found["strength"] = self.strength
        if self.cause:
            found["cause"] = self.cause
        found |= {key: value for key in ("at", "duration") if (value := getattr(self, key))}
        return found

    def __str__(self) -> str:
        """As YAML, in one line."""
        return "{" + ", ".join(f"{key}: {value!r}" for key, value in self.said().items()) + "}"


def _checked(impairment: Impairment, where: str) -> Impairment:
    """Refuse what does not go together."""
    kind, what = impairment.kind, impairment.what
    if kind.devices and not impairment.devices:
        names = ", ".join(device.name for device in kind.devices)
        raise ParameterError(f"{where}on = {impairment.on!r}: {what} should be on {names}")
    if not kind.strength and impairment.strength:
        raise ParameterError(f"{where}strength = {impairment.strength:g}: {what} has none")
    if kind.strength and not (
        kind.smallest <= impairment.strength <= kind.largest and impairment.strength
    ):
        raise ParameterError(
            f"{where}strength = {impairment.strength:g}: of {what} ({kind.strength}) it should be "
            f"from {kind.smallest:g} to {kind.largest:g} {kind.unit}, and not 0"
        )
    if (what == "drive_fault") != bool(impairment.cause):
        right = f"should be one of {', '.join(CAUSES)}" if not impairment.cause else "has no cause"
        raise ParameterError(f"{where}cause = {impairment.cause!r}: {what} {right}")
    if impairment.way != BOTH and kind.place is not Place.LINE:
        raise ParameterError(f"{where}way = {impairment.way!r}: {what} has none")
    return impairment


def impairment_from(mapping: object, where: str = "") -> Impairment:
    """One impairment from names and values.

    Raises:
        ParameterError: a name or value is wrong; with what would be right.
    """
    if not isinstance(mapping, Mapping):
        raise ParameterError(
            f"{where}{mapping!r}: should be names and values, as {{what: loss, strength: 0.3}}"
        )
    if "what" not in mapping:
        raise ParameterError(f"{where}should say what: one of {', '.join(KINDS)}")
    return _checked(from_mapping(Impairment, mapping, where), where)


def read_impairments(text: str) -> tuple[Impairment, ...]:
    """Impairments from YAML, or from the file that a text ending in .yaml names; empty: none.

    Raises:
        ParameterError: the file cannot be read, or holds something else; with what would be right.
    """
    name = text.strip()
    try:
        content = (
            read_yaml(Path(name)) if name.endswith(".yaml") else read_yaml(text, "impairments")
        )
    except FieldError as error:
        raise ParameterError(str(error)) from None
    if content is None:
        return ()
    entries = content if isinstance(content, list) else [content]
    return tuple(
        impairment_from(entry, f"impairments[{index}]: ") for index, entry in enumerate(entries)
    )
