"""An emulated CiA 402 drive: complete command sets, watchdogs, faults."""

from __future__ import annotations

import enum
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

from canopen import SdoAbortedError

from msg_schemas.faults import DriveFaultCause
from msg_schemas.table import TOPICS
from rover_hil.bridge.wiring import COMMANDED, Values
from rover_hil.canopen.devices import (
    BRIDGE_NODE,
    HEARTBEAT_TIMEOUT,
    NUMBER_SHIFT,
    WINCH,
    ErrorCode,
    reference_count,
)
from rover_hil.canopen.impairment import ERROR_CODES
from rover_hil.canopen.link import HEARTBEAT_ID, unpack
from rover_hil.canopen.objects import Device
from rover_hil.emulator.channel import DeviceChannel
from rover_hil.emulator.cia402 import Automaton, DriveState
from rover_hil.emulator.device import EmulatedDevice

_MAX_SAMPLE_AGE = 0.5  # of the sample from which a command was computed [s]
_STANDSTILL_RATE = 1e-3  # of the winch [m/s], of others [rad/s, m/s]
_OPERATIONAL = b"\x05"  # NMT state in the bridge's heartbeat
_KEPT_SETS = 8  # incomplete sets
_ABORT_STATE = 0x0800_0022  # SDO abort: not in the present device state
# Faults of the communication: supply, motor and encoder are sound.
_QUICK_STOP_FAULTS = frozenset(
    {ErrorCode.RPDO_TIMEOUT, ErrorCode.HEARTBEAT_ERROR, ErrorCode.BUS_OFF_RECOVERED}
)


class Setpoint(NamedTuple):
    """Present setpoint of a drive."""

    values: Values
    received_ns: int  # plant's time of the first reception


class StopReaction(enum.Enum):
    """How a drive without a setpoint stops."""

    QUICK_STOP = enum.auto()
    OFF = enum.auto()  # drive function off at once; the winch's brake closes


Demand: TypeAlias = Setpoint | StopReaction


class EmulatedDrive(EmulatedDevice):
    """One drive.

    Args:
        device, channel, clock: see `EmulatedDevice`.
        plant_ns: the plant's time [ns], for its watchdogs.
        deceleration: of its quick stop, in the unit of its rate per second.

    Attributes:
        automaton: its CiA 402 state.
        setpoint: present setpoint; None: none.
        has_stopped: whether the motor has executed the drive's last stop.
    """

    def __init__(
        self,
        device: Device,
        channel: DeviceChannel,
        clock: Callable[[], int],
        plant_ns: Callable[[], int],
        deceleration: float,
    ) -> None:
        super().__init__(device, channel, clock)
        entry = device.by_key["quick_stop_deceleration"]
        variable: Any = self.node.object_dictionary[entry.index]
        variable.default = entry.saturated(deceleration)
        self.automaton = Automaton()
        self.setpoint: Setpoint | None = None
        self.has_stopped = True
        self._plant_ns = plant_ns
        self._parts: dict[int, dict[int, dict[str, int]] | None] = {}  # None: contradictory
        self._executed: int | None = None
        self._executed_ns = 0  # by the device's clock
        self._watchdog_fed_ns = 0  # by the plant's time: last set executed
        self._sample_ns = 0  # by the plant's time: sample from which that set was computed
        self._number: int | None = None  # of the last command
        self._bridge_heartbeat_ns = 0
        stale = [TOPICS[name].stale for name, which in COMMANDED.items() if which is device]
        self._timeout = min(policy.timeout for policy in stale)
        self._timeout_moving = min(policy.timeout_moving for policy in stale)
        self._rpdos = {pdo.can_id(device.node_id): pdo for pdo in device.rpdos}
        self._control = frozenset(
            (entry.index, entry.subindex) for pdo in device.rpdos for entry in pdo.entries
        )
        for can_id in self._rpdos:
            channel.network.subscribe(can_id, self._on_rpdo)
        channel.network.subscribe(HEARTBEAT_ID + BRIDGE_NODE, self._on_bridge_heartbeat)
        self.node.add_write_callback(self._refuse_write)  # type: ignore[no-untyped-call]

    @property
    def demand(self) -> Demand:
        """What the motor shall do."""
        automaton = self.automaton
        if automaton.enabled:
            return StopReaction.QUICK_STOP if self.setpoint is None else self.setpoint
        if automaton.state is DriveState.QUICK_STOP:
            return StopReaction.QUICK_STOP
        reacts = automaton.state is DriveState.FAULT_REACTION
        return (
            StopReaction.QUICK_STOP
            if reacts and automaton.error_code in _QUICK_STOP_FAULTS
            else StopReaction.OFF
        )

    def _boot(self) -> None:
        """Restart in switch on disabled, without setpoint."""
        self.automaton.power_on()
        self.setpoint = None
        self._parts.clear()
        self._executed = self._number = None
        self._counts["executed_sequence"] = self._counts["rejected_sets"] = 0
        self._bridge_heartbeat_ns = self._plant_ns()
        super()._boot()

    def power_off(self) -> None:
        """Lose the supply: motor off, brake closed."""
        self.automaton.power_off()
        self.setpoint = None

    def leave_bus(self) -> None:
        """Go bus-off and into fault."""
        super().leave_bus()
        self.fail(ErrorCode.BUS_OFF_RECOVERED)

    def fail(self, code: ErrorCode) -> None:
        """Go into fault and send the emergency."""
        if self.automaton.fail(code):
            self.setpoint = None
            self.emergency(code)

    def reject(self) -> None:
        """Drop a setpoint that the plant rejects, and send an emergency."""
        self.setpoint = None
        self.emergency(ErrorCode.SETPOINT_REJECTED)

    def complete(self) -> None:
        """Drop a setpoint that has been reached; its repetitions have no effect."""
        self.setpoint = None

    def step(self) -> None:
        """Do what is due: watchdogs, end of a fault reaction, heartbeat."""
        if not self.is_on:
            return
        for impairment in self._active("drive_fault"):
            self.fail(ERROR_CODES[DriveFaultCause(impairment.cause)])
        if self.automaton.enabled:
            self._check_watchdogs()
        if not self.automaton.enabled:
            self.setpoint = None
        # A brake that closes at once takes its time to stop the drum; other drives coast.
        is_still = abs(self.values.get("velocity", 0.0)) < _STANDSTILL_RATE
        if self.has_stopped and (is_still or self.device is not WINCH):
            self.automaton.on_standstill()
        super().step()

    def sample(self) -> None:
        """Add the drive's state to the measurements."""
        super().sample()
        since_us = (self._sampled_ns - self._executed_ns) // 1000
        self._counts |= {
            "statusword": self.automaton.statusword,
            "error_code": self.automaton.error_code,
            "executed_sequence": self._executed or 0,
            "execution_age": min(max(since_us // 10, 0), 0xFFFF),
            "mode_shown": round(self.setpoint.values["mode"]) if self.setpoint else 0,
        }

    # --- commands --------------------------------------------------------------------------------

    def _on_bridge_heartbeat(self, _can_id: int, data: bytearray, _timestamp: float) -> None:
        if data == _OPERATIONAL:
            self._bridge_heartbeat_ns = self._plant_ns()

    def _on_rpdo(self, can_id: int, data: bytearray, _timestamp: float) -> None:
        pdo = self._rpdos[can_id]
        counts = unpack(pdo, bytes(data))
        if counts is None or not self.is_operational:
            return
        number = counts["sequence"]
        parts = self._parts.setdefault(number, {})
        if parts is None:
            return
        if parts.setdefault(pdo.number, counts) != counts:
            # Contradictory frames: one of them is not the bridge's.
            self._parts[number] = None
            self._counts["rejected_sets"] = (self._counts["rejected_sets"] + 1) & 0xFF
        elif len(parts) == len(self._rpdos):
            del self._parts[number]
            self._execute({key: value for part in parts.values() for key, value in part.items()})
        while len(self._parts) > _KEPT_SETS:
            del self._parts[next(iter(self._parts))]

    def _execute(self, counts: dict[str, int]) -> None:
        """Execute a complete command set, unless it is old."""
        # A real drive receives frames at once, without waiting for the plant's tick.
        now_ns = self._clock() - self._channel.frame_age_ns
        sequence = counts["sequence"]
        age = ((reference_count(now_ns) - counts["reference_time"]) & 0xFFFF) * self.device.by_key[
            "reference_time"
        ].scale
        is_newer = self._executed is None or 0 < ((sequence - self._executed) & 0xFFFF) < 0x8000
        if not is_newer or age > _MAX_SAMPLE_AGE:
            self._counts["rejected_sets"] = (self._counts["rejected_sets"] + 1) & 0xFF
            return
        self._executed, self._executed_ns = sequence, now_ns
        self._watchdog_fed_ns = self._plant_ns()
        self._sample_ns = self._watchdog_fed_ns - round(age * 1e9)
        before = self.automaton.error_code
        self.automaton.command(counts["controlword"])
        if before and not self.automaton.error_code:
            self.emergency(ErrorCode.NO_ERROR)
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
        """Refuse commands by SDO: they lack sequence number and reference time."""
        del od, data
        if (index, subindex) in self._control:
            raise SdoAbortedError(_ABORT_STATE)

    # --- watchdogs -------------------------------------------------------------------------------

    def _check_watchdogs(self) -> None:
        is_moving = abs(self.values.get("velocity", 0.0)) > _STANDSTILL_RATE or (
            self.setpoint is not None and self.setpoint.values["target_velocity"] != 0.0
        )
        limit = min(self._timeout, self._timeout_moving) if is_moving else self._timeout
        now_ns = self._plant_ns()
        if now_ns - self._bridge_heartbeat_ns >= HEARTBEAT_TIMEOUT * 1e9:
            self.fail(ErrorCode.HEARTBEAT_ERROR)
        elif (
            now_ns - self._watchdog_fed_ns >= limit * 1e9
            # Late sets must not keep the drive active for longer than sets in time.
            or now_ns - self._sample_ns >= _MAX_SAMPLE_AGE * 1e9
            or not self.is_operational
        ):
            self.fail(ErrorCode.RPDO_TIMEOUT)
