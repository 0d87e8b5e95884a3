"""One end of the link: a bus with a `canopen` network, read frame by frame.

It has no thread: its owner reads it. Tests can step both ends in turn, and a process that hangs
sends nothing, not even its heartbeat.
"""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable, Mapping

import can
import canopen

from rover_hil.canopen.devices import SYNC_PERIOD
from rover_hil.canopen.objects import Pdo
from rover_hil.canopen.serial_bus import CobsSerialBus

SYNC_ID = 0x80
_MOST_PENDING = 500
HEARTBEAT_ID = 0x700


class SendingNetwork(canopen.Network):
    """Network of the `canopen` library that sends by a function of its owner.

    The library's own raises an error of the bus wherever a node sends, also in a callback.
    """

    def __init__(self, send: Callable[[int, bytes], None]) -> None:
        super().__init__()
        self._send = send

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Send a data frame; remote frames are not used."""
        if not remote:
            self._send(can_id, bytes(data))


class Link:
    """An end of the link.

    Args:
        bus: closed with the link.

    Attributes:
        network: of the `canopen` library, for nodes, SDO, NMT, emergencies.
        sent, received: frames since the start.
        failed: failed writes and reads of the bus.
        problem: why the last frame could not be sent; empty: it was.
    """

    def __init__(self, bus: can.BusABC) -> None:
        self.bus = bus
        self.network = SendingNetwork(self.send)
        self.sent = 0
        self.received = 0
        self.failed = 0
        self.problem = ""
        self._lock = threading.Lock()  # of the bus' sending end

    def send(self, can_id: int, data: bytes) -> None:
        """Send a frame; a failure is counted, and the frame is lost."""
        message = can.Message(arbitration_id=can_id, data=data, is_extended_id=False)
        with self._lock:
            try:
                self.bus.send(message)
                self.sent += 1
                self.problem = ""
            except (can.CanError, OSError) as error:
                self.failed += 1
                self.problem = str(error)

    def sync(self, counter: int) -> None:
        """Send SYNC with its counter (CiA 301, object 1019h)."""
        self.send(SYNC_ID, bytes([counter]))

    def heartbeat(self, node_id: int, state: int) -> None:
        """Send a heartbeat; state 0 is the boot-up message."""
        self.send(HEARTBEAT_ID + node_id, bytes([state]))

    def receive(self, timeout: float) -> can.Message | None:
        """Wait for a frame, for a timeout [s] at most.

        Others than data frames with 11 bits of identifier are skipped: the bus may carry them, and
        SocketCAN reports errors of the bus by them.
        """
        try:
            while (frame := self.bus.recv(timeout)) is not None:
                if not (
                    frame.is_error_frame
                    or frame.is_remote_frame
                    or frame.is_fd
                    or frame.is_extended_id
                ):
                    self.received += 1
                    return frame
                timeout = 0.0
        except (can.CanError, OSError, ValueError):
            # An invalid frame or a bus error: the timeouts of the receivers act.
            self.failed += 1
        return None

    def dispatch(self, frame: can.Message) -> None:
        """Pass a frame to the network's nodes and subscribers."""
        try:
            self.network.notify(frame.arbitration_id, frame.data, frame.timestamp)
        except (struct.error, ValueError, IndexError):
            # The library assumes frames of the right length.
            self.failed += 1

    def poll(self, timeout: float) -> bool:
        """Receive and dispatch a frame within a timeout [s]; returns whether there was one."""
        frame = self.receive(timeout)
        if frame is not None:
            self.dispatch(frame)
        return frame is not None

    def pending_frames(self, first: can.Message) -> list[can.Message]:
        """A frame and all that wait behind it, with only the newest SYNC.

        A device that has fallen behind would never catch up if it answered every SYNC.
        """
        frames = [first]
        while len(frames) < _MOST_PENDING and (frame := self.receive(0.0)) is not None:
            frames.append(frame)
        syncs = [frame for frame in frames if frame.arbitration_id == SYNC_ID]
        old = set(map(id, syncs[:-1]))
        return [frame for frame in frames if id(frame) not in old]

    def dispatch_pending(self) -> int:
        """Dispatch all waiting frames; returns their number."""
        count = 0
        while self.poll(0.0):
            count += 1
        return count

    @property
    def line_errors(self) -> int:
        """Corrupted frames dropped from a serial line."""
        return self.bus.decoder.errors if isinstance(self.bus, CobsSerialBus) else 0

    def close(self) -> None:
        """Close the bus."""
        self.bus.shutdown()


def sync_counter(data: bytes | bytearray) -> int:
    """Counter of a SYNC; 0: it has none, so it is not the bridge's."""
    return data[0] if len(data) == 1 else 0


def frame_age_ns(frame: can.Message) -> int:
    """Time since a frame arrived [ns], by the system's stamp; 0 without a stamp.

    At most a period of SYNC: an end that hangs did not receive the frame in time.
    """
    if not frame.timestamp:
        return 0
    age = time.time_ns() - round(frame.timestamp * 1e9)
    return min(max(age, 0), round(SYNC_PERIOD * 1e9))


def pack(pdo: Pdo, counts: Mapping[str, int]) -> bytes:
    """Encode a PDO, from counts by the keys of its entries."""
    return pdo.layout.pack(*(counts[key] for key in pdo.keys))


def unpack(pdo: Pdo, data: bytes) -> dict[str, int] | None:
    """Decode a PDO to counts by keys; None: the frame has another length."""
    layout = pdo.layout
    return (
        dict(zip(pdo.keys, layout.unpack(data), strict=True)) if len(data) == layout.size else None
    )
