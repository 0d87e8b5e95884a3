"""An emulated CANopen device: answers to SYNC, heartbeat, emergencies.

It has no thread: its owner steps it, and it reads the time from its clock.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import canopen
from canopen.nmt import NmtSlave
from canopen.objectdictionary import ODVariable
from canopen.sdo.server import SdoServer

from rover_hil.canopen.devices import HEARTBEAT_PERIOD, IMU, ErrorCode
from rover_hil.canopen.dictionary import object_dictionary
from rover_hil.canopen.impairment import Impairment
from rover_hil.canopen.link import SYNC_ID, pack, sync_counter
from rover_hil.canopen.objects import Device, ObjectEntry
from rover_hil.emulator.channel import DeviceChannel

_INITIALISING, _OPERATIONAL = 0, 5
_PRE_OPERATIONAL = 128  # command of NMT
_RESET_NODE, _RESET_COMMUNICATION = 129, 130  # commands of NMT
_COMMUNICATION = range(0x1000, 0x2000)  # objects of the communication profile
_SDO_LENGTH = 8  # [byte]
_SPECIFIER = 0xE0  # bits of an SDO's first byte; their values follow
_DOWNLOAD_SEGMENT, _DOWNLOAD, _UPLOAD, _UPLOAD_SEGMENT = 0x00, 0x20, 0x40, 0x60
_BLOCK_DOWNLOAD = 0xC0
_ABORT_SPECIFIER, _ABORT_TOO_LONG, _ABORT_SUBINDEX = 0x0504_0001, 0x0607_0012, 0x0609_0011
_LONGEST_VALUE = 256  # of an object [byte]
_ANGLES, _RATES = ("position", "right_position"), ("velocity", "right_velocity")
_TENSIONS = ("tension", "rover_tension")
_REPLY_COUNT = IMU.by_key["reply_delay"].scale  # the same in all devices [s]


class _SteppedSlave(NmtSlave):
    """NMT state of a device whose `step` sends the heartbeat, instead of a thread."""

    def on_command(self, can_id: int, data: bytearray, timestamp: float) -> None:
        """Process a command; a reset restores what was written by SDO (CiA 301)."""
        super().on_command(can_id, data, timestamp)  # type: ignore[no-untyped-call]
        command, node_id = data[:2]
        if node_id in (self.id, 0) and command in (_RESET_NODE, _RESET_COMMUNICATION):
            written: dict[int, Any] = self._local_node.data_store
            for index in tuple(written):
                if command == _RESET_NODE or index in _COMMUNICATION:
                    del written[index]

    def start_heartbeat(self, heartbeat_time_ms: int) -> None:
        self._heartbeat_time_ms = heartbeat_time_ms

    def update_heartbeat(self) -> None:
        """The next heartbeat carries the state."""

    @property
    def code(self) -> int:
        return int(self._state)


class _StrictServer(SdoServer):
    """SDO server that answers malformed requests with an abort.

    The library logs a traceback for each, and keeps any number of segments.
    """

    def on_request(self, can_id: int, data: bytearray, timestamp: float) -> None:
        """Answer a request.

        Raises:
            ValueError: it has not eight bytes.
        """
        if len(data) != _SDO_LENGTH:
            raise ValueError(f"an SDO has {len(data)} bytes, it must have {_SDO_LENGTH}")
        specifier = data[0] & _SPECIFIER
        is_segment = specifier in (_DOWNLOAD_SEGMENT, _UPLOAD_SEGMENT)
        if not is_segment:
            self._index, self._subindex = int.from_bytes(data[1:3], "little"), data[3]
        if specifier in (_DOWNLOAD, _UPLOAD) and not self._has_subindex():
            self._refuse(_ABORT_SUBINDEX)
        elif specifier == _BLOCK_DOWNLOAD or (is_segment and self._buffer is None):
            self._refuse(_ABORT_SPECIFIER)
        elif specifier == _DOWNLOAD_SEGMENT and len(self._buffer or b"") > _LONGEST_VALUE:
            self._refuse(_ABORT_TOO_LONG)
        else:
            super().on_request(can_id, data, timestamp)  # type: ignore[no-untyped-call]

    def _has_subindex(self) -> bool:
        """Whether the object has the subindex; of a single variable the library ignores it."""
        return not (self._subindex and isinstance(self.od.get(self._index), ODVariable))

    def _refuse(self, code: int) -> None:
        self._buffer = None
        self._index, self._subindex = self._index or 0, self._subindex or 0
        self.abort(code)  # type: ignore[no-untyped-call]


class _SteppedNode(canopen.LocalNode):
    def __init__(self, device: Device) -> None:
        super().__init__(device.node_id, object_dictionary(device))
        addresses = 0x600 + device.node_id, 0x580 + device.node_id
        self.sdo = _StrictServer(*addresses, self)  # type: ignore[no-untyped-call]
        self.slave = _SteppedSlave(device.node_id, self)
        self.nmt = self.slave
        self._write_callbacks = [self.slave.on_write]


class EmulatedDevice:
    """One device.

    Args:
        device: its definition.
        channel: its connection to the bus.
        clock: the device's own clock [ns]; may have offset and drift.
    """

    def __init__(self, device: Device, channel: DeviceChannel, clock: Callable[[], int]) -> None:
        self.device = device
        self._channel = channel
        self._clock = clock
        self.values: dict[str, float] = {}
        self._counts: dict[str, int] = {entry.key: entry.default for entry in device.entries}
        self._by_address: dict[tuple[int, int], ObjectEntry] = {
            (entry.index, entry.subindex): entry for entry in device.entries
        }
        self._sampled_ns = 0
        self._heartbeat_ns: int | None = None
        self._impairments: list[tuple[Impairment, int]] = []  # with their start by its clock
        self.node = _SteppedNode(device)
        self.node.add_read_callback(self._read)  # type: ignore[no-untyped-call]
        channel.network.add_node(self.node)
        channel.network.subscribe(SYNC_ID, self._on_sync)

    @property
    def is_operational(self) -> bool:
        """Whether it sends and receives PDOs."""
        return self.is_on and self.node.slave.code == _OPERATIONAL

    @property
    def is_on(self) -> bool:
        """Whether it has a supply."""
        return not self._has("brown_out")

    def power_on(self) -> None:
        """Restart, with the boot-up message; nothing that was written is left."""
        self.node.data_store.clear()
        self._boot()

    def _boot(self) -> None:
        """Restart, with what was written."""
        self.node.nmt.state = "INITIALISING"
        self.node.nmt.state = "PRE-OPERATIONAL"
        self._heartbeat_ns = None

    def step(self) -> None:
        """Do what is due: a requested reset, the heartbeat."""
        if not self.is_on:
            return
        if self.node.slave.code == _INITIALISING:
            self._boot()
        now_ns = self._clock()
        if self._heartbeat_ns is None or now_ns - self._heartbeat_ns >= HEARTBEAT_PERIOD * 1e9:
            self._heartbeat_ns = now_ns
            self._channel.heartbeat(self.device.node_id, self.node.slave.code)

    def synchronise(self, counter: int) -> None:
        """Answer a SYNC: sample, and send every TPDO."""
        if not self.is_operational:
            return
        self._sampled_ns = self._clock()
        self.sample()
        self._counts["sync_counter"] = counter
        sample_age_ns = sum(round(each.magnitude * 1e9) for each in self._active("stale_stamps"))
        self._counts["sample_time"] = ((self._sampled_ns - sample_age_ns) // 1000) & 0xFFFF_FFFF
        for pdo in self.device.tpdos:
            if "reply_delay" in pdo.keys:
                delay = (self._clock() - self._sampled_ns) * 1e-9
                self._counts["reply_delay"] = min(int(delay / _REPLY_COUNT), 0xFF)
            self._channel.send(pdo.can_id(self.device.node_id), pack(pdo, self._counts))

    def sample(self) -> None:
        """Convert the values to counts, saturated to their range."""
        entries = self.device.by_key
        for key, value in self.values.items():
            self._counts[key] = entries[key].saturated(value)

    def set_measurements(self, values: Mapping[str, float]) -> None:
        """Set the true values to measure, in the units of the entries."""
        measured = dict(values)
        if self._has("frozen_encoder"):
            measured |= {key: self.values[key] for key in _ANGLES if key in self.values}
            measured |= {key: 0.0 for key in _RATES if key in measured}
        for impairment, since_ns in self._impairments:
            if impairment.kind == "drifted_load_cell":
                drift = impairment.magnitude * (self._clock() - since_ns) * 1e-9
                measured |= {key: measured[key] + drift for key in _TENSIONS if key in measured}
        self.values.update(measured)

    def emergency(self, code: ErrorCode) -> None:
        """Send an emergency; `ErrorCode.NO_ERROR` reports that the fault is gone."""
        self.node.emcy.send(code, 0x01 if code else 0x00)

    # --- impairments -----------------------------------------------------------------------------

    def begin_impairment(self, impairment: Impairment) -> None:
        """Apply an impairment from now on."""
        self._impairments.append((impairment, self._clock()))
        if impairment.kind == "bus_off":
            self.leave_bus()
        elif impairment.kind == "brown_out":
            self.power_off()

    def end_impairment(self, impairment: Impairment) -> None:
        """End an impairment."""
        index = next(i for i, (each, _) in enumerate(self._impairments) if each is impairment)
        del self._impairments[index]
        if impairment.kind == "bus_off" and not self._has("bus_off"):
            self.emergency(ErrorCode.BUS_OFF_RECOVERED)
        elif impairment.kind == "brown_out" and self.is_on:
            self.power_on()

    def leave_bus(self) -> None:
        """Go bus-off: no longer operational (1029h: pre-operational)."""
        self.node.slave.send_command(_PRE_OPERATIONAL)

    def power_off(self) -> None:
        """Lose the supply."""

    def _active(self, kind: str) -> list[Impairment]:
        return [impairment for impairment, _ in self._impairments if impairment.kind == kind]

    def _has(self, kind: str) -> bool:
        return bool(self._active(kind))

    def _on_sync(self, _can_id: int, data: bytearray, _timestamp: float) -> None:
        self.synchronise(sync_counter(data))

    def _read(self, *, index: int, subindex: int, od: Any) -> int | None:
        del od
        entry = self._by_address.get((index, subindex))
        if entry is None or "w" in entry.access:
            return None
        return self._counts[entry.key]
