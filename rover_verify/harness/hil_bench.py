"""Test bench: bridge and emulated machine on one link in one process, without ROS and threads.

Time is the plant's: a cycle is one period of SYNC, whatever the speed of the computer.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any
from uuid import uuid4

import can

from msg_schemas.events import EventName, EventReport
from msg_schemas.refusal import Refusal
from msg_schemas.samples import JointSample, Sample
from rover_hil.bridge.bridge import Bridge
from rover_hil.canopen.devices import BRIDGE_NODE, DEVICES, HEARTBEAT_PERIOD, SYNC_PERIOD
from rover_hil.canopen.impairment import read_impairments
from rover_hil.canopen.link import HEARTBEAT_ID, Link
from rover_hil.canopen.objects import Device
from rover_hil.canopen.transport import open_bus
from rover_hil.emulator.emulated_machine import EmulatedMachine
from rover_sim import Simulation

PERIOD_NS = round(SYNC_PERIOD * 1e9)
Controller = Callable[[], Mapping[str, JointSample]]
_COUNTERS = 240
_EMERGENCY_ID = 0x80
_HEARTBEAT_CYCLES = round(HEARTBEAT_PERIOD / SYNC_PERIOD)  # cycles
_OPERATIONAL = 5


class HilBench:
    """Bridge and emulated machine on one link.

    Args:
        simulation: of a plant with rover and winch; its tick is a SYNC period.
        rover_offset: of the rover's clock [s].
        command_delay: see `EmulatedMachine`.

    Attributes:
        bridge: the bridge.
        machine: the emulated machine.
        published: last sample of each topic published by the bridge.
        changes: transitions of both, in order, with their times [s].
        driven: drives with a setpoint during the last tick.
        bridge_is_on: whether the bridge sends anything; False: as if it were dead.
    """

    def __init__(
        self, simulation: Simulation[Any], rover_offset: float = 0.0, command_delay: float = 0.0
    ) -> None:
        channel = f"virtual:{uuid4()}"
        self._bridge_link, self._device_link = Link(open_bus(channel)), Link(open_bus(channel))
        self.simulation = simulation
        self.machine = EmulatedMachine(
            self._device_link,
            simulation,
            self._now_ns,
            lambda: self._now_ns() + round(rover_offset * 1e9),
            command_delay,
        )
        self.published: dict[str, Sample] = {}
        self.changes: list[tuple[float, EventReport]] = []
        self.driven: frozenset[str] = frozenset()
        self.bridge_is_on = True
        self._cycles = 0
        self.bridge = self._make_bridge()
        self.machine.power_on()

    def _make_bridge(self) -> Bridge:
        bridge = Bridge(self._send, self._start, lambda each: bridge.on_device_checked(each, ""))
        network = self._bridge_link.network
        for can_id in bridge.can_ids:
            network.subscribe(can_id, partial(self._on_tpdo, bridge))
        for device in DEVICES:
            heartbeat, emergency = HEARTBEAT_ID + device.node_id, _EMERGENCY_ID + device.node_id
            network.subscribe(heartbeat, partial(self._on_heartbeat, bridge, device))
            network.subscribe(emergency, partial(self._on_emergency, bridge, device))
            bridge.on_device_checked(device, "")
        return bridge

    def close(self) -> None:
        """Close the link."""
        self._bridge_link.close()
        self._device_link.close()

    def restart_bridge(self) -> None:
        """Replace the bridge by a new one without any state."""
        self._bridge_link.network.subscribers.clear()
        self.bridge = self._make_bridge()

    # --- time ------------------------------------------------------------------------------------

    def _now_ns(self) -> int:
        return self.simulation.stamp_ns

    @property
    def time(self) -> float:
        """Plant's time [s]."""
        return self.simulation.stamp_ns * 1e-9

    def cycle(
        self,
        commands: Mapping[str, JointSample] | Controller | None = None,
        refused: list[Refusal] | None = None,
    ) -> Any:
        """One period: SYNC, answers, commands, and the plant's tick, which is returned.

        Args:
            commands: by topic; or a function that computes them after the answers.
            refused: collects refusals.

        Raises:
            Refusal: a command was refused and `refused` is None; no tick is made.
        """
        self._cycles += 1
        if self.bridge_is_on:
            now_ns = self._now_ns()
            counter = self._cycles % _COUNTERS + 1
            self.bridge.begin_cycle(counter, now_ns, now_ns)
            self._bridge_link.sync(counter)
            if self._cycles % _HEARTBEAT_CYCLES == 1:
                self._bridge_link.heartbeat(BRIDGE_NODE, _OPERATIONAL)
            self.settle()
            self.published |= dict(self.bridge.samples())
            self.bridge.supervise(now_ns)
            stamped_commands = commands() if callable(commands) else commands or {}
            for topic, sample in stamped_commands.items():
                try:
                    self.bridge.on_command(topic, sample, now_ns)
                except Refusal as refusal:
                    if refused is None:
                        raise
                    refused.append(refusal)
        self.settle()
        drives = self.machine.drives.items()
        self.driven = frozenset(name for name, drive in drives if drive.setpoint is not None)
        tick = self.machine.tick()
        self.settle()
        transitions = (*self.bridge.take_transitions(), *self.machine.take_transitions())
        self.changes += [(self.time, change) for change in transitions]
        return tick

    def cycles(
        self,
        seconds: float,
        commands: Mapping[str, JointSample] | None = None,
        refused: list[Refusal] | None = None,
    ) -> None:
        """Run cycles for a time [s], with the same commands and new stamps in each."""
        for _ in range(round(seconds / SYNC_PERIOD)):
            stamped = {
                topic: JointSample(self._now_ns(), sample.joints)
                for topic, sample in (commands or {}).items()
            }
            self.cycle(stamped, refused)

    def put_on_bus(self, can_id: int, data: bytes) -> None:
        """Deliver a foreign frame to both ends."""
        self._bridge_link.send(can_id, data)
        self._device_link.send(can_id, data)
        self.settle()

    def settle(self) -> None:
        """Deliver all frames, including those sent in response."""
        while self._deliver_to_devices() + self._bridge_link.dispatch_pending():
            pass

    def _deliver_to_devices(self) -> int:
        frames: list[can.Message] = []
        while (frame := self._device_link.receive(0.0)) is not None:
            frames.append(frame)
        self.machine.receive(frames)
        return len(frames)

    def arm(self) -> None:
        """Wait for the devices, arm the drives, and wait until they are switched on."""
        self.cycles(0.05)
        self.bridge.arm(self._now_ns())
        self.cycles(0.05)

    def impair(self, text: str) -> None:
        """Replace the impairments."""
        self.machine.impair(read_impairments(text))

    def has_event(self, name: EventName, device: str) -> bool:
        """Whether a transition of this name has occurred."""
        return any(
            change.name is name and change.values.get("device") == device
            for _, change in self.changes
        )

    # --- bridge ----------------------------------------------------------------------------------

    def _send(self, can_id: int, data: bytes) -> None:
        if self.bridge_is_on:
            self._bridge_link.send(can_id, data)

    def _start(self, device: Device) -> None:
        self._send(0, bytes([1, device.node_id]))

    def _on_tpdo(self, bridge: Bridge, can_id: int, data: bytearray, _timestamp: float) -> None:
        bridge.on_tpdo(can_id, bytes(data), self._now_ns())

    def _on_heartbeat(
        self, bridge: Bridge, device: Device, _can_id: int, data: bytearray, _timestamp: float
    ) -> None:
        bridge.on_heartbeat(device, data[0], self._now_ns())

    def _on_emergency(
        self, bridge: Bridge, device: Device, _can_id: int, data: bytearray, _timestamp: float
    ) -> None:
        bridge.on_emergency(device, data[0] | data[1] << 8)
