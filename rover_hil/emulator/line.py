"""What lies between one device and the bus: frames pass, and may suffer on their way.

Nothing here runs by itself: frames that are held back are let go by `step`. What is random is drawn
for each identifier by itself, from the impairment's seed, so that the same frames suffer in each
run in which the device is sent, or sends, the same ones.
"""

from __future__ import annotations

import math
import random
import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import canopen

from rover_hil.devices import BRIDGE_NODE
from rover_hil.framing import Decoder, Frame, encode
from rover_hil.impairment import BOTH, TO_BRIDGE, TO_DEVICES, Impairment
from rover_hil.link import HEARTBEAT_ID, SYNC_ID
from rover_hil.objects import Device

_NMT_ID = 0
_NODES = 0x7F
_STANDARD = 0x7FF
_MOST_OVERTAKING = 5  # frames
_LONGEST_HELD_NS = 100_000_000  # of a frame that no other one follows

Deliver = Callable[[int, bytes], None]


class _Late(NamedTuple):
    due_ns: int
    can_id: int
    data: bytes


@dataclass
class _Held:
    """A frame that others overtake."""

    due_ns: int
    can_id: int
    data: bytes
    overtaken_by: int


@dataclass
class ChannelImpairment:
    """An impairment at work on one way of one line.

    Attributes:
        impairment: which one.
        stream: name of what suffers, of which the draws depend.
        frames: that came by.
        hit: of these, those that suffered.
    """

    impairment: Impairment
    stream: str
    frames: int = 0
    hit: int = 0
    decoder: Decoder = field(default_factory=Decoder)
    _draws: dict[int, random.Random] = field(default_factory=dict)

    def draws(self, can_id: int) -> random.Random:
        """Random numbers for frames of an identifier."""
        found = self._draws.get(can_id)
        if found is None:
            asked = self.impairment
            found = random.Random(f"{asked.seed} {asked.what} {self.stream} {can_id}")
            self._draws[can_id] = found
        return found

    def strikes(self, can_id: int) -> bool:
        """Whether a frame suffers, of those of which a share does."""
        self.frames += 1
        struck = self.draws(can_id).random() < self.impairment.strength
        self.hit += struck
        return struck


class Way:
    """One direction of a line.

    Args:
        name: of the line and the direction.
        deliver: takes what gets through.
        clock: steady time [ns].
    """

    def __init__(self, name: str, deliver: Deliver, clock: Callable[[], int]) -> None:
        self._name = name
        self._deliver = deliver
        self._clock = clock
        self._standing: list[ChannelImpairment] = []
        self._late: deque[_Late] = deque()
        self._held: list[_Held] = []

    @property
    def is_impaired(self) -> bool:
        """Whether frames may suffer, or some still come late."""
        return bool(self._standing or self._late or self._held)

    def begin(self, impairment: Impairment) -> ChannelImpairment:
        """Frames suffer from now on."""
        made = ChannelImpairment(impairment, self._name)
        self._standing.append(made)
        return made

    def end(self, suffering: ChannelImpairment) -> None:
        """They no longer do; those that are late still come late."""
        self._standing.remove(suffering)

    def take(self, can_id: int, data: bytes) -> None:
        """Take a frame."""
        if not self.is_impaired:
            self._deliver(can_id, data)
            return
        for frame in self._through(Frame(can_id, data)):
            self._queue(frame.can_id, frame.data)
        self.step()

    def step(self) -> None:
        """Let go what is due."""
        now_ns = self._clock()
        for held in [held for held in self._held if held.due_ns <= now_ns]:
            self._let_go(held)
        while self._late and self._late[0].due_ns <= now_ns:
            late = self._late.popleft()
            self._deliver(late.can_id, late.data)

    @property
    def due_ns(self) -> int | None:
        """When the next frame is to be let go; None: none waits."""
        waiting = [held.due_ns for held in self._held]
        if self._late:
            waiting.append(self._late[0].due_ns)
        return min(waiting, default=None)

    def clear(self) -> None:
        """Lose what is on its way."""
        self._late.clear()
        self._held.clear()

    # --- what happens to frames ------------------------------------------------------------------

    def _through(self, frame: Frame) -> list[Frame]:
        """What is left of a frame: nothing, itself, or more."""
        frames = [frame]
        for suffering in self._standing:
            change = _CHANGES.get(suffering.impairment.what)
            if change is not None:
                frames = [left for each in frames for left in change(suffering, each)]
        return frames

    def _queue(self, can_id: int, data: bytes) -> None:
        now_ns = self._clock()
        overtaken_by = 0
        due_ns = now_ns
        for suffering in self._standing:
            what, strength = suffering.impairment.what, suffering.impairment.strength
            if what == "reorder" and suffering.strikes(can_id):
                overtaken_by = suffering.draws(can_id).randint(1, _MOST_OVERTAKING)
            elif what in ("delay", "jitter"):
                share = suffering.draws(can_id).random() if what == "jitter" else 1.0
                due_ns += round(strength * share * 1e9)
                suffering.frames += 1
                suffering.hit += 1
        if overtaken_by:
            self._held.append(_Held(now_ns + _LONGEST_HELD_NS, can_id, data, overtaken_by))
            return
        self._append(due_ns, can_id, data)
        for held in self._held:
            held.overtaken_by -= 1
        for held in [held for held in self._held if held.overtaken_by <= 0]:
            self._let_go(held)

    def _let_go(self, held: _Held) -> None:
        self._held.remove(held)
        self._append(self._clock(), held.can_id, held.data)

    def _append(self, due_ns: int, can_id: int, data: bytes) -> None:
        # A line keeps the order of what it carries.
        last_ns = self._late[-1].due_ns if self._late else due_ns
        self._late.append(_Late(max(due_ns, last_ns), can_id, data))


# -------------------------------------------------- what the kinds make of a frame, by its name


def _lost(suffering: ChannelImpairment, frame: Frame) -> list[Frame]:
    return [] if suffering.strikes(frame.can_id) else [frame]


def _doubled(suffering: ChannelImpairment, frame: Frame) -> list[Frame]:
    return [frame] * (2 if suffering.strikes(frame.can_id) else 1)


def _cut(suffering: ChannelImpairment, _frame: Frame) -> list[Frame]:
    suffering.frames += 1
    suffering.hit += 1
    return []


def _flipped(suffering: ChannelImpairment, frame: Frame) -> list[Frame]:
    """The frame as a serial line carries it, its bits flipped at random.

    CAN's controllers find damage too, and send again: they would lose less.
    """
    draws, share = suffering.draws(frame.can_id), suffering.impairment.strength
    line = bytearray(encode(frame))
    suffering.frames += 1
    # From one flipped bit to the next is a geometrically distributed way.
    at = _way_on(draws, share)
    suffering.hit += at < 8 * len(line)
    while at < 8 * len(line):
        line[at // 8] ^= 1 << at % 8
        at += 1 + _way_on(draws, share)
    return list(suffering.decoder.feed(bytes(line)))


def _way_on(draws: random.Random, share: float) -> int:
    return int(math.log(1.0 - draws.random()) / math.log1p(-share))


_CHANGES: dict[str, Callable[[ChannelImpairment, Frame], list[Frame]]] = {
    "loss": _lost,
    "duplication": _doubled,
    "bit_errors": _flipped,
    # A device without a supply, or that has left the bus, is cut off as well.
    "cut": _cut,
    "brown_out": _cut,
    "bus_off": _cut,
}


class _Network(canopen.Network):
    """The network of one device, which goes through its line."""

    def __init__(self, send: Deliver) -> None:
        super().__init__()
        self._send = send

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        if not remote:
            self._send(can_id, bytes(data))


class Line:
    """The line of one device, both ways.

    Args:
        device: which one.
        send: puts a frame on the bus.
        clock: steady time [ns].

    Attributes:
        network: of the `canopen` library, as the device sees it.
        strange: frames that the device could make nothing of.
        waited_ns: how long ago the frame that it is given now has come by the bus.
    """

    def __init__(self, device: Device, send: Deliver, clock: Callable[[], int]) -> None:
        self._node_id = device.node_id
        self._out = Way(f"{device.name} {TO_BRIDGE}", send, clock)
        self._in = Way(f"{device.name} {TO_DEVICES}", self._notify, clock)
        self.network = _Network(self.send)
        self.strange = 0
        self.waited_ns = 0

    def send(self, can_id: int, data: bytes) -> None:
        """The device sends a frame."""
        self._out.take(can_id, data)

    def heartbeat(self, node_id: int, state: int) -> None:
        """The device sends a heartbeat; state 0 is the boot-up message."""
        self.send(HEARTBEAT_ID + node_id, bytes([state]))

    def hear(self, can_id: int, data: bytes, waited_ns: int = 0) -> None:
        """A frame has come by the bus; what is not for the device passes it.

        Args:
            can_id: identifier of the frame.
            data: its bytes.
            waited_ns: how long ago it came [ns]; held back on its way, it comes when it is let go.
        """
        for_all = can_id in (_NMT_ID, SYNC_ID, HEARTBEAT_ID + BRIDGE_NODE)
        if for_all or (can_id & _NODES == self._node_id and can_id <= _STANDARD):
            self.waited_ns = 0 if self._in.is_impaired else waited_ns
            self._in.take(can_id, data)
            self.waited_ns = 0

    def step(self) -> None:
        """Let go frames that are due."""
        self._in.step()
        self._out.step()

    @property
    def due_ns(self) -> int | None:
        """When the next frame is to be let go; None: none waits."""
        due = [way.due_ns for way in (self._in, self._out)]
        return min((each for each in due if each is not None), default=None)

    def ways(self, way: str) -> tuple[Way, ...]:
        """The directions that an impairment's `way` means."""
        return {BOTH: (self._in, self._out), TO_DEVICES: (self._in,), TO_BRIDGE: (self._out,)}[way]

    def _notify(self, can_id: int, data: bytes) -> None:
        try:
            self.network.notify(can_id, bytearray(data), 0.0)
        except (struct.error, ValueError, IndexError):
            # The library takes a node's frames as long as they should be.
            self.strange += 1
