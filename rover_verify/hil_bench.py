"""Bridge and emulated machine on one link in one process, cycle by cycle: no ROS, no waiting.

Time is the plant's: a cycle is one period of SYNC, and nothing depends on how fast the machine is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any
from uuid import uuid4

import can

from msg_schemas.refusal import Refusal
from msg_schemas.samples import JointSample, Sample
from msg_schemas.transition import Transition
from rover_hil.bridge import Bridge
from rover_hil.devices import BRIDGE_NODE, DEVICES, HEARTBEAT, SYNC_PERIOD
from rover_hil.emulator.machine import EmulatedMachine
from rover_hil.impairment import read_impairments
from rover_hil.link import HEARTBEAT_ID, Link
from rover_hil.objects import Device
from rover_hil.transport import open_bus
from rover_sim import Simulation

PERIOD_NS = round(SYNC_PERIOD * 1e9)
Controller = Callable[[], Mapping[str, JointSample]]
_COUNTERS = 240
_EMERGENCY_ID = 0x80
_BEAT = round(HEARTBEAT / SYNC_PERIOD)  # cycles
_OPERATIONAL = 5


class HilBench:
    """Both ends of a link.

    Args:
        simulation: of a plant with rover and winch, with a tick of a SYNC period.
        rover_offset: of the rover's clock [s].
        command_delay: see `EmulatedMachine`.

    Attributes:
        bridge: one end.
        machine: the other.
        told: what the bridge tells, by topic: the last sample of each.
        changes: what has changed at both ends, in order, with the time of each [s].
        driven: drives that were to do something during the last cycle's tick.
        bridge_is_on: whether the bridge sends anything; False: as if it were dead.
    """

    def __init__(
        self, simulation: Simulation[Any], rover_offset: float = 0.0, command_delay: float = 0.0
    ) -> None:
        channel = f"virtual:{uuid4()}"
        self._near, self._far = Link(open_bus(channel)), Link(open_bus(channel))
        self.simulation = simulation
        self.machine = EmulatedMachine(
            self._far,
            simulation,
            self._now_ns,
            lambda: self._now_ns() + round(rover_offset * 1e9),
            command_delay,
        )
        self.told: dict[str, Sample] = {}
        self.changes: list[tuple[float, Transition]] = []
        self.driven: frozenset[str] = frozenset()
        self.bridge_is_on = True
        self._cycles = 0
        self.bridge = self._make_bridge()
        self.machine.power_on()

    def _make_bridge(self) -> Bridge:
        bridge = Bridge(self._send, self._start)
        network = self._near.network
        for can_id in bridge.can_ids:
            network.subscribe(can_id, partial(self._hear, bridge))
        for device in DEVICES:
            beat, emergency = HEARTBEAT_ID + device.node_id, _EMERGENCY_ID + device.node_id
            network.subscribe(beat, partial(self._beat, bridge, device))
            network.subscribe(emergency, partial(self._emergency, bridge, device))
            bridge.checked(device, "")
        return bridge

    def close(self) -> None:
        """Close the link."""
        self._near.close()
        self._far.close()

    def restart_bridge(self) -> None:
        """The bridge dies and is started again: it knows nothing of what was."""
        self._near.network.subscribers.clear()
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
        """One period: SYNC, answers, commands upon them, and the plant's tick, which is returned.

        Args:
            commands: by topic; or who makes them of what is told by then.
            refused: takes refusals.

        Raises:
            Refusal: a command was refused, and nothing takes it; the tick is not made then.
        """
        self._cycles += 1
        if self.bridge_is_on:
            now_ns = self._now_ns()
            counter = self._cycles % _COUNTERS + 1
            self.bridge.begin_cycle(counter, now_ns, now_ns)
            self._near.sync(counter)
            if self._cycles % _BEAT == 1:
                self._near.heartbeat(BRIDGE_NODE, _OPERATIONAL)
            self.settle()
            self.told |= dict(self.bridge.samples())
            self.bridge.supervise(now_ns)
            given = commands() if callable(commands) else commands or {}
            for topic, sample in given.items():
                try:
                    self.bridge.take(topic, sample, now_ns)
                except Refusal as refusal:
                    if refused is None:
                        raise
                    refused.append(refusal)
        self.settle()
        drives = self.machine.drives.items()
        self.driven = frozenset(name for name, drive in drives if drive.setpoint is not None)
        tick = self.machine.tick()
        self.settle()
        found = (*self.bridge.take_transitions(), *self.machine.take_transitions())
        self.changes += [(self.time, change) for change in found]
        return tick

    def cycles(
        self,
        seconds: float,
        commands: Mapping[str, JointSample] | None = None,
        refused: list[Refusal] | None = None,
    ) -> None:
        """Cycles for so long [s], with the same commands in each, stamped anew."""
        for _ in range(round(seconds / SYNC_PERIOD)):
            stamped = {
                topic: JointSample(self._now_ns(), sample.joints)
                for topic, sample in (commands or {}).items()
            }
            self.cycle(stamped, refused)

    def put_on_bus(self, can_id: int, data: bytes) -> None:
        """A frame that is neither end's comes to both."""
        self._near.send(can_id, data)
        self._far.send(can_id, data)
        self.settle()

    def settle(self) -> None:
        """Hand on all frames, and what they bring about."""
        while self._on_far() + self._near.drain():
            pass

    def _on_far(self) -> int:
        frames: list[can.Message] = []
        while (frame := self._far.receive(0.0)) is not None:
            frames.append(frame)
        self.machine.hear(frames)
        return len(frames)

    def arm(self) -> None:
        """Let the devices be heard, arm the drives, and wait until they are switched on."""
        self.cycles(0.05)
        self.bridge.arm(self._now_ns())
        self.cycles(0.05)

    def impair(self, text: str) -> None:
        """Have these impairments and no others, from now on."""
        self.machine.impair(read_impairments(text))

    def happened(self, name: str) -> bool:
        """Whether something of this name has changed."""
        return any(change.name == name for _, change in self.changes)

    # --- the bridge's end ------------------------------------------------------------------------

    def _send(self, can_id: int, data: bytes) -> None:
        if self.bridge_is_on:
            self._near.send(can_id, data)

    def _start(self, device: Device) -> None:
        self._send(0, bytes([1, device.node_id]))

    def _hear(self, bridge: Bridge, can_id: int, data: bytearray, _timestamp: float) -> None:
        bridge.heard(can_id, bytes(data), self._now_ns())

    def _beat(
        self, bridge: Bridge, device: Device, _can_id: int, data: bytearray, _timestamp: float
    ) -> None:
        bridge.heartbeat(device, data[0], self._now_ns())

    def _emergency(
        self, bridge: Bridge, device: Device, _can_id: int, data: bytearray, _timestamp: float
    ) -> None:
        bridge.emergency(device, data[0] | data[1] << 8)
