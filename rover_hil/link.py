"""One end of the link: a bus with the `canopen` network on it, read frame by frame.

Nothing here runs by itself: who owns the end reads it, so that tests step both ends one after the
other, and a process that hangs sends nothing, its heartbeat included.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Mapping

import can
import canopen

from rover_hil.devices import SYNC_PERIOD
from rover_hil.objects import Pdo
from rover_hil.serial_bus import CobsSerialBus

SYNC_ID = 0x80
_MOST_AT_ONCE = 500
HEARTBEAT_ID = 0x700


class Link:
    """An end of the link.

    Args:
        bus: that carries it; closed with the link.

    Attributes:
        network: of the `canopen` library, for nodes, SDO, NMT, emergencies.
        sent, received: frames since the start.
        failed: frames that the bus did not take, and readings that it gave up.
    """

    def __init__(self, bus: can.BusABC) -> None:
        self.bus = bus
        self.network = canopen.Network(bus)
        self.sent = 0
        self.received = 0
        self.failed = 0

    def send(self, can_id: int, data: bytes) -> None:
        """Send a frame; one that the bus does not take is counted, and lost as on any bus."""
        try:
            self.network.send_message(can_id, data)
            self.sent += 1
        except (can.CanError, OSError):
            self.failed += 1

    def sync(self, counter: int) -> None:
        """Send SYNC with its counter (CiA 301, object 1019h)."""
        self.send(SYNC_ID, bytes([counter]))

    def heartbeat(self, node_id: int, state: int) -> None:
        """Send a heartbeat; state 0 is the boot-up message."""
        self.send(HEARTBEAT_ID + node_id, bytes([state]))

    def receive(self, timeout: float) -> can.Message | None:
        """Wait at most so long [s] for a frame."""
        try:
            frame = self.bus.recv(timeout)
        except (can.CanError, OSError, ValueError):
            # Not a frame, or a bus in trouble: whoever waits for frames will miss them.
            self.failed += 1
            return None
        if frame is not None and not (
            frame.is_error_frame or frame.is_remote_frame or frame.is_fd or frame.is_extended_id
        ):
            self.received += 1
            return frame
        return None

    def hand_on(self, frame: can.Message) -> None:
        """Give a frame to the network's nodes and to who else has subscribed."""
        try:
            self.network.notify(frame.arbitration_id, frame.data, frame.timestamp)
        except (struct.error, ValueError, IndexError):
            # The library takes a node's frames as long as they should be.
            self.failed += 1

    def poll(self, timeout: float) -> bool:
        """Wait at most so long [s] for a frame and hand it on; returns whether there was one."""
        frame = self.receive(timeout)
        if frame is not None:
            self.hand_on(frame)
        return frame is not None

    def waiting(self, first: can.Message) -> list[can.Message]:
        """A frame and all that wait behind it, without the SYNCs that another one follows.

        Who has fallen behind would answer ever older ones otherwise, and never catch up.
        """
        frames = [first]
        while len(frames) < _MOST_AT_ONCE and (frame := self.receive(0.0)) is not None:
            frames.append(frame)
        syncs = [frame for frame in frames if frame.arbitration_id == SYNC_ID]
        old = set(map(id, syncs[:-1]))
        return [frame for frame in frames if id(frame) not in old]

    def drain(self) -> int:
        """Hand on all frames that wait; returns how many."""
        count = 0
        while self.poll(0.0):
            count += 1
        return count

    @property
    def line_errors(self) -> int:
        """Frames that came damaged over a serial line and were thrown away."""
        return self.bus.decoder.errors.total if isinstance(self.bus, CobsSerialBus) else 0

    def close(self) -> None:
        """Close the bus."""
        self.bus.shutdown()


def waited_ns(frame: can.Message) -> int:
    """How long ago a frame has come by the bus [ns], by the system's stamp, where it bears one.

    No longer than a period of SYNC: an end that hangs has not taken it.
    """
    if not frame.timestamp:
        return 0
    waited = time.time_ns() - round(frame.timestamp * 1e9)
    return min(max(waited, 0), round(SYNC_PERIOD * 1e9))


def pack(pdo: Pdo, counts: Mapping[str, int]) -> bytes:
    """The bytes of a PDO, from counts by the keys of its entries."""
    return pdo.layout.pack(*(counts[key] for key in pdo.keys))


def unpack(pdo: Pdo, data: bytes) -> dict[str, int] | None:
    """Counts by keys; None: the frame has another length than the PDO, and is none of it."""
    layout = pdo.layout
    return (
        dict(zip(pdo.keys, layout.unpack(data), strict=True)) if len(data) == layout.size else None
    )
