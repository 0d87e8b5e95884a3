"""Channel between one device and the bus, with impairments of the frames in each direction.

A channel has no thread: `step` delivers delayed frames when they are due. Random numbers are drawn
for each CAN identifier by itself, from the impairment's seed, so that the same frames are affected
in each run in which the device sends or receives the same ones.
"""

from __future__ import annotations

import math
import random
import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from rover_hil.canopen.devices import BRIDGE_NODE
from rover_hil.canopen.framing import Decoder, Frame, encode
from rover_hil.canopen.impairment import BOTH, TO_BRIDGE, TO_DEVICES, Impairment
from rover_hil.canopen.link import HEARTBEAT_ID, SYNC_ID, SendingNetwork
from rover_hil.canopen.objects import Device

_NMT_ID = 0
_NODES = 0x7F
_STANDARD = 0x7FF
_MOST_OVERTAKING = 5  # frames
_REORDER_TIMEOUT_NS = 100_000_000  # of a frame that no other frame follows

Deliver = Callable[[int, bytes], None]


class _DelayedFrame(NamedTuple):
    due_ns: int
    can_id: int
    data: bytes


@dataclass
class _ReorderedFrame:
    """A frame that waits until others have overtaken it."""

    due_ns: int
    can_id: int
    data: bytes
    overtaken_by: int


@dataclass
class ChannelImpairment:
    """An impairment that is active in one direction of a channel.

    Attributes:
        impairment: its definition.
        stream: name of channel and direction, part of the random seed.
        frames: number of frames that passed.
        affected: number of these that it changed.
    """

    impairment: Impairment
    stream: str
    frames: int = 0
    affected: int = 0
    decoder: Decoder = field(default_factory=Decoder)
    _generators: dict[int, random.Random] = field(default_factory=dict)

    def generator(self, can_id: int) -> random.Random:
        """Random number generator for frames of an identifier."""
        found = self._generators.get(can_id)
        if found is None:
            impairment = self.impairment
            found = random.Random(f"{impairment.seed} {impairment.kind} {self.stream} {can_id}")
            self._generators[can_id] = found
        return found

    def draw(self, can_id: int) -> bool:
        """Whether a frame is affected, with a probability of the magnitude."""
        self.frames += 1
        affects = self.generator(can_id).random() < self.impairment.magnitude
        self.affected += affects
        return affects


class Direction:
    """One direction of a channel.

    Args:
        name: of channel and direction.
        deliver: receives the frames that pass.
        clock: steady time [ns].
    """

    def __init__(self, name: str, deliver: Deliver, clock: Callable[[], int]) -> None:
        self._name = name
        self._deliver = deliver
        self._clock = clock
        self._active: list[ChannelImpairment] = []
        self._delayed: deque[_DelayedFrame] = deque()
        self._reordered: list[_ReorderedFrame] = []

    @property
    def is_impaired(self) -> bool:
        """Whether an impairment is active, or delayed frames are left."""
        return bool(self._active or self._delayed or self._reordered)

    def begin(self, impairment: Impairment) -> ChannelImpairment:
        """Activate an impairment."""
        made = ChannelImpairment(impairment, self._name)
        self._active.append(made)
        return made

    def end(self, impairment: ChannelImpairment) -> None:
        """Deactivate an impairment; delayed frames still arrive late."""
        self._active.remove(impairment)

    def send(self, can_id: int, data: bytes) -> None:
        """Pass a frame."""
        if not self.is_impaired:
            self._deliver(can_id, data)
            return
        for frame in self._impaired(Frame(can_id, data)):
            self._queue(frame.can_id, frame.data)
        self.step()

    def step(self) -> None:
        """Deliver the frames that are due."""
        now_ns = self._clock()
        for frame in [frame for frame in self._reordered if frame.due_ns <= now_ns]:
            self._release(frame)
        while self._delayed and self._delayed[0].due_ns <= now_ns:
            delayed = self._delayed.popleft()
            self._deliver(delayed.can_id, delayed.data)

    @property
    def due_ns(self) -> int | None:
        """When the next frame is due; None: no frame is delayed."""
        waiting = [frame.due_ns for frame in self._reordered]
        if self._delayed:
            waiting.append(self._delayed[0].due_ns)
        return min(waiting, default=None)

    def clear(self) -> None:
        """Lose all delayed frames."""
        self._delayed.clear()
        self._reordered.clear()

    def _impaired(self, frame: Frame) -> list[Frame]:
        """The frames that become of a frame: none, itself, or more."""
        frames = [frame]
        for active in self._active:
            change = _CHANGES.get(active.impairment.kind)
            if change is not None:
                frames = [left for each in frames for left in change(active, each)]
        return frames

    def _queue(self, can_id: int, data: bytes) -> None:
        now_ns = self._clock()
        overtaken_by = 0
        due_ns = now_ns
        for active in self._active:
            kind, magnitude = active.impairment.kind, active.impairment.magnitude
            if kind == "reorder" and active.draw(can_id):
                overtaken_by = active.generator(can_id).randint(1, _MOST_OVERTAKING)
            elif kind in ("delay", "jitter"):
                fraction = active.generator(can_id).random() if kind == "jitter" else 1.0
                due_ns += round(magnitude * fraction * 1e9)
                active.frames += 1
                active.affected += 1
        if overtaken_by:
            frame = _ReorderedFrame(now_ns + _REORDER_TIMEOUT_NS, can_id, data, overtaken_by)
            self._reordered.append(frame)
            return
        self._append(due_ns, can_id, data)
        for frame in self._reordered:
            frame.overtaken_by -= 1
        for frame in [frame for frame in self._reordered if frame.overtaken_by <= 0]:
            self._release(frame)

    def _release(self, frame: _ReorderedFrame) -> None:
        self._reordered.remove(frame)
        self._append(self._clock(), frame.can_id, frame.data)

    def _append(self, due_ns: int, can_id: int, data: bytes) -> None:
        # A delay keeps the order of the frames.
        last_ns = self._delayed[-1].due_ns if self._delayed else due_ns
        self._delayed.append(_DelayedFrame(max(due_ns, last_ns), can_id, data))


# ----------------------------------------------------------- changes of a frame, by kind


def _lost(active: ChannelImpairment, frame: Frame) -> list[Frame]:
    return [] if active.draw(frame.can_id) else [frame]


def _duplicated(active: ChannelImpairment, frame: Frame) -> list[Frame]:
    return [frame] * (2 if active.draw(frame.can_id) else 1)


def _cut(active: ChannelImpairment, _frame: Frame) -> list[Frame]:
    active.frames += 1
    active.affected += 1
    return []


def _corrupted(active: ChannelImpairment, frame: Frame) -> list[Frame]:
    """The frame as a serial line carries it, with random bits flipped.

    CAN controllers detect corruption and retransmit: they would lose fewer frames.
    """
    generator, probability = active.generator(frame.can_id), active.impairment.magnitude
    encoded = bytearray(encode(frame))
    active.frames += 1
    # The distance between flipped bits is geometrically distributed.
    at = _bits_to_next_error(generator, probability)
    active.affected += at < 8 * len(encoded)
    while at < 8 * len(encoded):
        encoded[at // 8] ^= 1 << at % 8
        at += 1 + _bits_to_next_error(generator, probability)
    return list(active.decoder.feed(bytes(encoded)))


def _bits_to_next_error(generator: random.Random, probability: float) -> int:
    return int(math.log(1.0 - generator.random()) / math.log1p(-probability))


_CHANGES: dict[str, Callable[[ChannelImpairment, Frame], list[Frame]]] = {
    "loss": _lost,
    "duplication": _duplicated,
    "bit_errors": _corrupted,
    # A device without supply, or off the bus, sends and receives nothing either.
    "cut": _cut,
    "brown_out": _cut,
    "bus_off": _cut,
}


class DeviceChannel:
    """The channel of one device, in both directions.

    Args:
        device: the device.
        send: puts a frame on the bus.
        clock: steady time [ns].

    Attributes:
        network: of the `canopen` library, as the device sees it.
        invalid: number of frames that the library could not decode.
        frame_age_ns: time since the frame that is being delivered arrived by the bus [ns].
    """

    def __init__(self, device: Device, send: Deliver, clock: Callable[[], int]) -> None:
        self._node_id = device.node_id
        self._to_bridge = Direction(f"{device.name} {TO_BRIDGE}", send, clock)
        self._to_device = Direction(f"{device.name} {TO_DEVICES}", self._notify, clock)
        self.network = SendingNetwork(self.send)
        self.invalid = 0
        self.frame_age_ns = 0

    def send(self, can_id: int, data: bytes) -> None:
        """Send a frame of the device."""
        self._to_bridge.send(can_id, data)

    def heartbeat(self, node_id: int, state: int) -> None:
        """Send a heartbeat of the device; state 0 is the boot-up message."""
        self.send(HEARTBEAT_ID + node_id, bytes([state]))

    def receive(self, can_id: int, data: bytes, frame_age_ns: int = 0) -> None:
        """Receive a frame from the bus; frames for other devices are ignored.

        Args:
            can_id: identifier of the frame.
            data: its bytes.
            frame_age_ns: time since it arrived [ns]; 0 for a frame that the channel delays.
        """
        for_all = can_id in (_NMT_ID, SYNC_ID, HEARTBEAT_ID + BRIDGE_NODE)
        if for_all or (can_id & _NODES == self._node_id and can_id <= _STANDARD):
            self.frame_age_ns = 0 if self._to_device.is_impaired else frame_age_ns
            self._to_device.send(can_id, data)
            self.frame_age_ns = 0

    def step(self) -> None:
        """Deliver the frames that are due."""
        self._to_device.step()
        self._to_bridge.step()

    def clear(self) -> None:
        """Lose all delayed frames."""
        self._to_device.clear()
        self._to_bridge.clear()

    @property
    def due_ns(self) -> int | None:
        """When the next frame is due; None: no frame is delayed."""
        due = [direction.due_ns for direction in (self._to_device, self._to_bridge)]
        return min((each for each in due if each is not None), default=None)

    def directions(self, direction: str) -> tuple[Direction, ...]:
        """The directions of an impairment's `direction`."""
        return {
            BOTH: (self._to_device, self._to_bridge),
            TO_DEVICES: (self._to_device,),
            TO_BRIDGE: (self._to_bridge,),
        }[direction]

    def _notify(self, can_id: int, data: bytes) -> None:
        try:
            self.network.notify(can_id, bytearray(data), 0.0)
        except (struct.error, ValueError, IndexError):
            # The library assumes frames of the right length.
            self.invalid += 1
