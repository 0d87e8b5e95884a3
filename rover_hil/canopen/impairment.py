"""Impairments of the link, its devices and processes, and their list as YAML.

    - {kind: loss, target: rover, magnitude: 0.3, start: 5.0, duration: 10.0, seed: 7}
    - {kind: drive_fault, target: winch, cause: overtemperature}

This module only defines them: the emulator applies them, and procedures contain the same texts.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from msg_schemas.faults import DriveFaultCause
from msg_schemas.fields import FieldError, shown
from msg_schemas.parameters import ParameterError, from_mapping, parameter
from msg_schemas.yaml_reader import read_yaml
from rover_hil.canopen.devices import DEVICES, DRIVES, IMU, LOAD_CELL, ErrorCode
from rover_hil.canopen.objects import Device

ERROR_CODES: Mapping[DriveFaultCause, ErrorCode] = {
    DriveFaultCause.UNDERVOLTAGE: ErrorCode.DC_LINK_UNDERVOLTAGE,
    DriveFaultCause.OVERTEMPERATURE: ErrorCode.DRIVE_OVERTEMPERATURE,
    DriveFaultCause.ENCODER: ErrorCode.INCREMENTAL_SENSOR_FAULT,
}
"""Error codes of the causes of a drive fault."""

ALL, ROVER, MOTHER = "all", "rover", "mother"
BOTH, TO_DEVICES, TO_BRIDGE = "both", "to_devices", "to_bridge"


class Scope(enum.Enum):
    """What an impairment acts on."""

    CHANNEL = "frames between the bus and a device"
    DEVICE = "a device"
    PROCESS = "a process"


@dataclass(frozen=True)
class ImpairmentKind:
    """Definition of one kind of impairment; `docs/hil.md` describes the effects.

    Attributes:
        scope: what it acts on.
        magnitude: meaning of the magnitude; empty: it has none.
        unit: of the magnitude.
        minimum, maximum: range of the magnitude.
        devices: possible targets.
    """

    scope: Scope
    magnitude: str = ""
    unit: str = "-"
    minimum: float = 0.0
    maximum: float = 0.0
    devices: tuple[Device, ...] = DEVICES


_FRAMES = "fraction of frames"
KINDS: Mapping[str, ImpairmentKind] = {
    "delay": ImpairmentKind(Scope.CHANNEL, "delay", "s", 0.0, 10.0),
    "jitter": ImpairmentKind(Scope.CHANNEL, "maximum", "s", 0.0, 10.0),
    "loss": ImpairmentKind(Scope.CHANNEL, _FRAMES, "-", 0.0, 1.0),
    "duplication": ImpairmentKind(Scope.CHANNEL, _FRAMES, "-", 0.0, 1.0),
    "reorder": ImpairmentKind(Scope.CHANNEL, _FRAMES, "-", 0.0, 1.0),
    "bit_errors": ImpairmentKind(Scope.CHANNEL, "fraction of bits", "-", 0.0, 0.1),
    "cut": ImpairmentKind(Scope.CHANNEL),
    "bus_off": ImpairmentKind(Scope.DEVICE),
    "stale_stamps": ImpairmentKind(Scope.DEVICE, "age", "s", 0.0, 3600.0),
    "frozen_encoder": ImpairmentKind(Scope.DEVICE, devices=DRIVES),
    "drifted_load_cell": ImpairmentKind(
        Scope.DEVICE, "rate", "N/s", -100.0, 100.0, (IMU, LOAD_CELL)
    ),
    "brown_out": ImpairmentKind(Scope.DEVICE),
    "drive_fault": ImpairmentKind(Scope.DEVICE, devices=DRIVES),
    "emulator_kill": ImpairmentKind(Scope.PROCESS, devices=()),
    "bridge_kill": ImpairmentKind(Scope.PROCESS, devices=()),
}


@dataclass(frozen=True)
class Impairment:
    """One impairment: kind, target, start, duration and magnitude."""

    kind: str = parameter("loss", "-", "kind", choices=tuple(KINDS))
    target: str = parameter(
        ALL,
        "-",
        "one device by name, those on the rover or on the mother machine, or all",
        choices=(ALL, ROVER, MOTHER, *(device.name for device in DEVICES)),
    )
    direction: str = parameter(
        BOTH, "-", "of the impaired frames", choices=(BOTH, TO_DEVICES, TO_BRIDGE)
    )
    start: float = parameter(0.0, "s", "time from the request to the start", 0.0, 1e6)
    duration: float = parameter(
        0.0, "s", "time from start to end; 0 = until it is removed from the list", 0.0, 1e6
    )
    magnitude: float = parameter(0.0, "-", "in the unit of its kind", -1e6, 1e6)
    cause: str = parameter("", "-", "of a drive fault", choices=("", *DriveFaultCause))
    seed: int = parameter(1, "-", "of the random numbers", 0, 2**31 - 1)

    @property
    def definition(self) -> ImpairmentKind:
        """Definition of its kind."""
        return KINDS[self.kind]

    @property
    def devices(self) -> tuple[Device, ...]:
        """The targeted devices."""
        return tuple(device for device in self.definition.devices if self._targets(device))

    def _targets(self, device: Device) -> bool:
        if self.target in (ROVER, MOTHER):
            return device.is_on_rover is (self.target == ROVER)
        return self.target in (ALL, device.name)

    def as_mapping(self) -> dict[str, object]:
        """The fields that apply to its kind, by name."""
        definition = self.definition
        found: dict[str, object] = {"kind": self.kind}
        if definition.devices:
            found["target"] = self.target
        if definition.scope is Scope.CHANNEL:
            found |= {"direction": self.direction, "seed": self.seed}
        if definition.magnitude:
            found["magnitude"] = self.magnitude
        if self.cause:
            found["cause"] = self.cause
        found |= {key: value for key in ("start", "duration") if (value := getattr(self, key))}
        return found

    def __str__(self) -> str:
        """The impairment as one line of YAML."""
        return (
            "{" + ", ".join(f"{key}: {value!r}" for key, value in self.as_mapping().items()) + "}"
        )


def _checked(impairment: Impairment, where: str) -> Impairment:
    """Refuse fields that do not apply to the kind."""
    definition, kind = impairment.definition, impairment.kind
    if not definition.devices and impairment.target != ALL:
        raise ParameterError(f"{where}target = {shown(impairment.target)}: {kind} has no target")
    if definition.devices and not impairment.devices:
        names = ", ".join(device.name for device in definition.devices)
        raise ParameterError(
            f"{where}target = {shown(impairment.target)}: {kind} should target one of {names}"
        )
    if not definition.magnitude and impairment.magnitude:
        raise ParameterError(
            f"{where}magnitude = {impairment.magnitude:g}: {kind} has no magnitude"
        )
    if definition.magnitude and not (
        definition.minimum <= impairment.magnitude <= definition.maximum and impairment.magnitude
    ):
        raise ParameterError(
            f"{where}magnitude = {impairment.magnitude:g}: {kind} ({definition.magnitude}) should "
            f"be from {definition.minimum:g} to {definition.maximum:g} {definition.unit}, and not 0"
        )
    if (kind == "drive_fault") != bool(impairment.cause):
        causes = ", ".join(DriveFaultCause)
        expected = "has no cause" if impairment.cause else f"should be one of {causes}"
        raise ParameterError(f"{where}cause = {shown(impairment.cause)}: {kind} {expected}")
    if impairment.direction != BOTH and definition.scope is not Scope.CHANNEL:
        raise ParameterError(
            f"{where}direction = {shown(impairment.direction)}: {kind} has no direction"
        )
    return impairment


def impairment_from(mapping: object, where: str = "") -> Impairment:
    """One impairment from names and values.

    Raises:
        ParameterError: a name or value is invalid; the text gives the expected one.
    """
    if not isinstance(mapping, Mapping):
        raise ParameterError(
            f"{where}{shown(mapping)}: should be names and values, "
            "as {kind: loss, magnitude: 0.3}"
        )
    if "kind" not in mapping:
        raise ParameterError(f"{where}kind is missing: should be one of {', '.join(KINDS)}")
    return _checked(from_mapping(Impairment, mapping, where), where)


def read_impairments(text: str) -> tuple[Impairment, ...]:
    """Impairments from YAML, or from the file that a text ending in .yaml names; empty: none.

    Raises:
        ParameterError: the file cannot be read, or its content is invalid.
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
