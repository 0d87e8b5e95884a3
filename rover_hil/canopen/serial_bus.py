"""A serial line as a bus of `python-can`: interface `cobs_serial`, see `framing`.

The channel is the path of a port or pseudo-terminal, as `/dev/ttyUSB0`. A port that is unplugged is
opened again when it is back; frames sent meanwhile are lost.
"""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from typing import Any

import can
import serial

from rover_hil.canopen.framing import Decoder, Frame, encode

_READ_AT_ONCE = 4096  # bytes
_ERROR_PAUSE = 0.005  # at most, after a failed read [s]
_REOPEN_PERIOD = 0.5  # of attempts to open a lost port [s]
_ERRORS = serial.SerialException, OSError, TypeError  # TypeError: closed in another thread


class CobsSerialBus(can.BusABC):
    """CAN frames over a serial line.

    Args:
        channel: path of the port.
        baudrate: of the line [bit/s].

    Attributes:
        decoder: counts the dropped frames.

    Raises:
        can.CanInitializationError: the port cannot be opened.
    """

    def __init__(self, channel: str, baudrate: int = 3_000_000, **kwargs: Any) -> None:
        try:
            # Exclusive: two readers of one line would take each other's bytes.
            self._port = serial.Serial(channel, baudrate, timeout=0.0, exclusive=True)
        except (serial.SerialException, ValueError, OSError) as error:
            raise can.CanInitializationError(f"{channel} cannot be opened: {error}") from error
        self.decoder = Decoder()
        self._closed = threading.Event()
        self._closing = threading.Lock()  # not while another thread writes to its descriptor
        self._reopen_at = 0.0  # steady time [s]
        self._received: deque[can.Message] = deque()
        self.channel_info = f"COBS on {channel}"
        self._can_protocol = can.CanProtocol.CAN_20
        super().__init__(channel=channel, **kwargs)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Write a frame to the line.

        Raises:
            can.CanOperationError: not a classic CAN frame, or the line is gone or full.
        """
        del timeout  # a frame is written at once, or not at all
        if msg.is_fd:
            raise can.CanOperationError("a CAN FD frame: this line carries classic CAN only")
        frame = Frame(
            msg.arbitration_id,
            b"" if msg.is_remote_frame else bytes(msg.data),
            msg.is_extended_id,
            msg.is_remote_frame,
            msg.is_error_frame,
        )
        line = encode(frame)
        try:
            # Without a wait: a line that is full must not hold up the cycle.
            with self._closing:
                written = os.write(self.fileno(), line)
        except BlockingIOError:
            written = 0
        except _ERRORS as error:
            raise can.CanOperationError(self._reason(error)) from error
        if written < len(line):
            raise can.CanOperationError(f"{self.channel_info}: the line is full")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._received:
            self._read(timeout)
        return (self._received.popleft() if self._received else None), False

    def _read(self, timeout: float | None) -> None:
        try:
            self._reopen()
            self._port.timeout = timeout
            first = self._port.read(1)
            rest = self._port.read(min(self._port.in_waiting, _READ_AT_ONCE)) if first else b""
        except _ERRORS as error:
            with self._closing:
                self._port.close()
            # A line that is gone fails at once: its reader must not busy a core.
            self._closed.wait(min(timeout or 0.0, _ERROR_PAUSE))
            raise can.CanOperationError(self._reason(error)) from error
        now = time.time()
        for frame in self.decoder.feed(first + rest):
            self._received.append(
                can.Message(
                    timestamp=now,
                    arbitration_id=frame.can_id,
                    is_extended_id=frame.extended,
                    is_remote_frame=frame.remote,
                    is_error_frame=frame.error,
                    data=frame.data,
                )
            )

    def _reopen(self) -> None:
        """Open a lost port, if an attempt is due."""
        now = time.monotonic()
        if not self._port.is_open and now >= self._reopen_at and not self._closed.is_set():
            self._reopen_at = now + _REOPEN_PERIOD
            self._port.open()

    def _reason(self, error: Exception) -> str:
        why = error if self._port.is_open else "the port is gone, it is opened when it is back"
        return f"{self.channel_info}: {why}"

    def fileno(self) -> int:
        """The port's file descriptor."""
        return int(self._port.fileno())

    def shutdown(self) -> None:
        """Close the port."""
        super().shutdown()
        self._closed.set()
        self._port.close()
