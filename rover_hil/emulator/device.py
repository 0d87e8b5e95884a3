"""A device on the link that is not there: CANopen node, answers to SYNC, heartbeat, emergencies.

It runs by nothing of its own: it is stepped, and reads its clock where it needs the time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import canopen
from canopen.nmt import NmtSlave

from rover_hil.devices import BUS_OFF, HEARTBEAT, IMU
from rover_hil.dictionary import object_dictionary
from rover_hil.emulator.line import Line
from rover_hil.impairment import Impairment
from rover_hil.link import SYNC_ID, pack
from rover_hil.objects import Device, Entry

_INITIALISING, _OPERATIONAL = 0, 5
_PRE_OPERATIONAL = 128  # command of NMT
_ANGLES, _RATES = ("position", "right_position"), ("velocity", "right_velocity")
_TENSIONS = ("tension", "rover_tension")
_REPLY_COUNT = IMU.by_key["replied"].scale  # the same in all devices [s]


class _SteppedSlave(NmtSlave):
    """The NMT state of a device whose heartbeat its own steps send, and no thread beside it."""

    def start_heartbeat(self, heartbeat_time_ms: int) -> None:
        self._heartbeat_time_ms = heartbeat_time_ms

    def update_heartbeat(self) -> None:
        """The next heartbeat tells the state."""

    @property
    def code(self) -> int:
        return int(self._state)


class _SteppedNode(canopen.LocalNode):
    def __init__(self, device: Device) -> None:
        super().__init__(device.node_id, object_dictionary(device))
        self.slave = _SteppedSlave(device.node_id, self)
        self.nmt = self.slave
        self._write_callbacks = [self.slave.on_write]


class EmulatedDevice:
    """One device.

    Args:
        device: which one.
        line: by which it is on the link.
        clock: the device's own clock [ns]; may be set wrongly and run fast.
    """

    def __init__(self, device: Device, line: Line, clock: Callable[[], int]) -> None:
        self.device = device
        self._line = line
        self._clock = clock
        self.values: dict[str, float] = {}
        self._counts: dict[str, int] = {entry.key: entry.default for entry in device.entries}
        self._by_address: dict[tuple[int, int], Entry] = {
            (entry.index, entry.subindex): entry for entry in device.entries
        }
        self._sampled_ns = 0
        self._beat_ns: int | None = None
        self._suffers: list[tuple[Impairment, int]] = []  # and since when, by its clock
        self.node = _SteppedNode(device)
        self.node.add_read_callback(self._read)  # type: ignore[no-untyped-call]
        line.network.add_node(self.node)
        line.network.subscribe(SYNC_ID, self._on_sync)

    @property
    def operational(self) -> bool:
        """Whether PDOs travel."""
        return self.is_on and self.node.slave.code == _OPERATIONAL

    @property
    def is_on(self) -> bool:
        """Whether it has a supply."""
        return not self._has("brown_out")

    def power_on(self) -> None:
        """Begin anew, with the boot-up message."""
        self.node.nmt.state = "INITIALISING"
        self.node.nmt.state = "PRE-OPERATIONAL"
        self._beat_ns = None

    def step(self) -> None:
        """Do what is due: a reset that was asked for, the heartbeat."""
        if not self.is_on:
            return
        if self.node.slave.code == _INITIALISING:
            self.power_on()
        now_ns = self._clock()
        if self._beat_ns is None or now_ns - self._beat_ns >= HEARTBEAT * 1e9:
            self._beat_ns = now_ns
            self._line.heartbeat(self.device.node_id, self.node.slave.code)

    def synchronise(self, counter: int) -> None:
        """SYNC has come: sample, and send every TPDO."""
        if not self.operational:
            return
        self._sampled_ns = self._clock()
        self.sample()
        self._counts["cycle"] = counter
        lag_ns = sum(round(each.strength * 1e9) for each in self._all("stale_stamps"))
        self._counts["sampled"] = ((self._sampled_ns - lag_ns) // 1000) & 0xFFFF_FFFF
        for pdo in self.device.tells:
            if "replied" in pdo.keys:
                delay = (self._clock() - self._sampled_ns) * 1e-9
                self._counts["replied"] = min(int(delay / _REPLY_COUNT), 0xFF)
            self._line.send(pdo.can_id(self.device.node_id), pack(pdo, self._counts))

    def sample(self) -> None:
        """Take over the values as counts; what the range does not hold stays at its end."""
        entries = self.device.by_key
        for key, value in self.values.items():
            self._counts[key] = entries[key].saturated(value)

    def show(self, values: Mapping[str, float]) -> None:
        """Take what there is to measure now, in the units of the entries."""
        measured = dict(values)
        if self._has("frozen_encoder"):
            measured |= {key: self.values[key] for key in _ANGLES if key in self.values}
            measured |= {key: 0.0 for key in _RATES if key in measured}
        for impairment, since_ns in self._suffers:
            if impairment.what == "drifted_load_cell":
                drift = impairment.strength * (self._clock() - since_ns) * 1e-9
                measured |= {key: measured[key] + drift for key in _TENSIONS if key in measured}
        self.values.update(measured)

    def emergency(self, code: int) -> None:
        """Send an emergency; code 0 tells that the fault is gone."""
        self.node.emcy.send(code, 0x01 if code else 0x00)

    # --- what is wrong with it -------------------------------------------------------------------

    def suffer(self, impairment: Impairment) -> None:
        """Something is wrong from now on."""
        self._suffers.append((impairment, self._clock()))
        if impairment.what == "bus_off":
            self.leave_bus()
        elif impairment.what == "brown_out":
            self.power_off()

    def recover(self, impairment: Impairment) -> None:
        """It no longer is."""
        index = next(i for i, (each, _) in enumerate(self._suffers) if each is impairment)
        del self._suffers[index]
        if impairment.what == "bus_off" and not self._has("bus_off"):
            self.emergency(BUS_OFF)  # CiA 301: recovered from bus off
        elif impairment.what == "brown_out" and self.is_on:
            self.power_on()

    def leave_bus(self) -> None:
        """The bus controller gives up: no longer operational (1029h: pre-operational)."""
        self.node.slave.send_command(_PRE_OPERATIONAL)

    def power_off(self) -> None:
        """The supply is gone."""

    def _all(self, what: str) -> list[Impairment]:
        return [impairment for impairment, _ in self._suffers if impairment.what == what]

    def _has(self, what: str) -> bool:
        return bool(self._all(what))

    def _on_sync(self, _can_id: int, data: bytearray, _timestamp: float) -> None:
        self.synchronise(data[0] if len(data) == 1 else 0)

    def _read(self, *, index: int, subindex: int, od: Any) -> int | None:
        del od
        entry = self._by_address.get((index, subindex))
        if entry is None or "w" in entry.access:
            return None
        return self._counts[entry.key]
