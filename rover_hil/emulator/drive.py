"""An emulated drive: CiA 402, complete command sets alone, watchdogs, faults."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from canopen import SdoAbortedError

from msg_schemas.table import TOPICS
from rover_hil.devices import (
    BRIDGE_NODE,
    BUS_OFF,
    COMMANDS_LOST,
    HEARTBEAT_LIMIT,
    HEARTBEAT_LOST,
    NO_ERROR,
    NUMBER_SHIFT,
    REFUSED,
    WINCH,
    upon_count,
)
from rover_hil.emulator.cia402 import Automaton
from rover_hil.emulator.device import EmulatedDevice
from rover_hil.emulator.line import Line
from rover_hil.impairment import CAUSES
from rover_hil.link import HEARTBEAT_ID, unpack
from rover_hil.objects import Device
from rover_hil.wiring import COMMANDED, Values

_OLDEST = 0.5  # sample that a command may be given upon [s]
_STANDING = 1e-3  # rate that counts as standing, of the winch [m/s], of others [rad/s, m/s]
_OPERATIONAL = b"\x05"  # heartbeat of a bridge at work
_KEPT = 8  # incomplete sets
_NOT_NOW = 0x0800_0022  # SDO abort: not in the present state of the device


class Setpoint(NamedTuple):
    """What a drive is to do now."""

    values: Values
    taken_ns: int  # plant's time at which the command came first


class EmulatedDrive(EmulatedDevice):
    """One drive.

    Args:
        device, line, clock: see `EmulatedDevice`.
        plant_ns: the plant's time [ns], by which its watchdogs go.

    Attributes:
        automaton: its state by CiA 402.
        setpoint: what it is to do; None: nothing, motor off and brake closed.
    """

    def __init__(
        self, device: Device, line: Line, clock: Callable[[], int], plant_ns: Callable[[], int]
    ) -> None:
        super().__init__(device, line, clock)
        self.automaton = Automaton()
        self.setpoint: Setpoint | None = None
        self._plant_ns = plant_ns
        self._parts: dict[int, dict[int, dict[str, int]] | None] = {}  # None: contradictory
        self._executed: int | None = None
        self._executed_ns = 0  # by the device's clock
        self._fed_ns = 0  # by the plant's time: last set executed
        self._number: int | None = None  # of the last command
        self._heard_bridge_ns = 0
        stale = [TOPICS[name].stale for name, which in COMMANDED.items() if which is device]
        self._silence = min(policy.timeout for policy in stale)
        self._timeout_moving = min(policy.timeout_moving for policy in stale)
        self._hears = {pdo.can_id(device.node_id): pdo for pdo in device.hears}
        self._control = frozenset(
            (entry.index, entry.subindex) for pdo in device.hears for entry in pdo.entries
        )
        for can_id in self._hears:
            line.network.subscribe(can_id, self._on_rpdo)
        line.network.subscribe(HEARTBEAT_ID + BRIDGE_NODE, self._on_bridge)
        self.node.add_write_callback(self._refuse_write)  # type: ignore[no-untyped-call]

    def power_on(self) -> None:
        """Begin anew: switch on disabled, nothing remembered."""
        self.automaton.power_on()
        self.setpoint = None
        self._parts.clear()
        self._executed = self._number = None
        self._counts["executed"] = self._counts["rejected"] = 0
        self._heard_bridge_ns = self._plant_ns()
        super().power_on()

    def power_off(self) -> None:
        """The supply is gone: motor off, brake closed."""
        self.automaton.power_off()
        self.setpoint = None

    def leave_bus(self) -> None:
        """The bus controller gives up: what is moved is no longer to be trusted."""
        super().leave_bus()
        self.fail(BUS_OFF)

    def fail(self, code: int) -> None:
        """Go into fault, and tell."""
        if self.automaton.fail(code):
            self.setpoint = None
            self.emergency(code)

    def refuse(self) -> None:
        """The machine behind the drive cannot do what it was told: it lets go, and tells."""
        self.setpoint = None
        self.emergency(REFUSED)

    def finish(self) -> None:
        """What was commanded is done: repetitions of it mean nothing."""
        self.setpoint = None

    def step(self) -> None:
        """Do what is due: watchdogs, end of a reaction, heartbeat."""
        if not self.is_on:
            return
        for impairment in self._all("drive_fault"):
            self.fail(CAUSES[impairment.cause])
        if self.automaton.enabled:
            self._watch()
        if not self.automaton.enabled:
            self.setpoint = None
        # The winch's brake stops the drum; the others coast, which needs no waiting for.
        if self.device is not WINCH or abs(self.values.get("velocity", 0.0)) < _STANDING:
            self.automaton.come_to_rest()
        super().step()

    def sample(self) -> None:
        """Add what the drive knows of itself."""
        super().sample()
        since_us = (self._sampled_ns - self._executed_ns) // 1000
        self._counts |= {
            "statusword": self.automaton.statusword,
            "error_code": self.automaton.error_code,
            "executed": self._executed or 0,
            "since": min(max(since_us // 10, 0), 0xFFFF),
            "mode_shown": round(self.setpoint.values["mode"]) if self.setpoint else 0,
        }

    # --- commands --------------------------------------------------------------------------------

    def _on_bridge(self, _can_id: int, data: bytearray, _timestamp: float) -> None:
        if data == _OPERATIONAL:
            self._heard_bridge_ns = self._plant_ns()

    def _on_rpdo(self, can_id: int, data: bytearray, _timestamp: float) -> None:
        pdo = self._hears[can_id]
        counts = unpack(pdo, bytes(data))
        if counts is None or not self.operational:
            return
        number = counts["sequence"]
        parts = self._parts.setdefault(number, {})
        if parts is None:
            return
        if parts.setdefault(pdo.number, counts) != counts:
            # Two that differ: one is not the bridge's, and none can say which.
            self._parts[number] = None
            self._counts["rejected"] = (self._counts["rejected"] + 1) & 0xFF
        elif len(parts) == len(self._hears):
            del self._parts[number]
            self._take({key: value for part in parts.values() for key, value in part.items()})
        while len(self._parts) > _KEPT:
            del self._parts[next(iter(self._parts))]

    def _take(self, counts: dict[str, int]) -> None:
        """Execute a complete set, unless it is old."""
        # A drive takes its frames as they come: it does not wait for a plant to be computed.
        now_ns = self._clock() - self._line.waited_ns
        sequence = counts["sequence"]
        age = ((upon_count(now_ns) - counts["upon"]) & 0xFFFF) * self.device.by_key["upon"].scale
        is_newer = self._executed is None or 0 < ((sequence - self._executed) & 0xFFFF) < 0x8000
        if not is_newer or age > _OLDEST:
            self._counts["rejected"] = (self._counts["rejected"] + 1) & 0xFF
            return
        self._executed, self._executed_ns = sequence, now_ns
        self._fed_ns = self._plant_ns()
        before = self.automaton.error_code
        self.automaton.command(counts["controlword"])
        if before and not self.automaton.error_code:
            self.emergency(NO_ERROR)
        number = counts["switches"] >> NUMBER_SHIFT
        if not self.automaton.enabled or not counts["mode"]:
            self.setpoint = None
            self._number = number
        elif number != self._number:
            self._number = number
            entries = self.device.by_key
            values = {key: entries[key].value(count) for key, count in counts.items()}
            self.setpoint = Setpoint(values, self._plant_ns())

    def _refuse_write(self, *, index: int, subindex: int, od: Any, data: bytes) -> None:
        """Commands come in sets by PDO; a single one by SDO says not what it was given upon."""
        del od, data
        if (index, subindex) in self._control:
            raise SdoAbortedError(_NOT_NOW)

    # --- watchdogs -------------------------------------------------------------------------------

    def _watch(self) -> None:
        moves = abs(self.values.get("velocity", 0.0)) > _STANDING or (
            self.setpoint is not None and self.setpoint.values["target_velocity"] != 0.0
        )
        limit = min(self._silence, self._timeout_moving) if moves else self._silence
        now_ns = self._plant_ns()
        if now_ns - self._heard_bridge_ns >= HEARTBEAT_LIMIT * 1e9:
            self.fail(HEARTBEAT_LOST)
        elif now_ns - self._fed_ns >= limit * 1e9 or not self.operational:
            self.fail(COMMANDS_LOST)
