"""CAN frames on a serial line: COBS (Consistent Overhead Byte Stuffing) with a CRC.

A frame is [identifier, 4 bytes, big-endian, flags in the upper 3 bits][data, 0 to 8 bytes][CRC-32],
stuffed so that it contains no zero byte, and terminated by one. A receiver resynchronises at the
next zero byte. The CRC-32 of Ethernet misses one in 4e9 of the errors that keep the stuffing valid.
"""

from __future__ import annotations

import binascii
import struct
from collections.abc import Iterator
from dataclasses import dataclass

from cobs import cobs

_ID = struct.Struct(">I")
_CRC = struct.Struct(">I")
_EXTENDED, _REMOTE, _ERROR = 1 << 31, 1 << 30, 1 << 29
_FLAGS = _EXTENDED | _REMOTE | _ERROR
_MOST_DATA = 8
_SHORTEST = _ID.size + _CRC.size
# Stuffing adds one byte.
_LONGEST = _SHORTEST + _MOST_DATA + 1


@dataclass(frozen=True)
class Frame:
    """A classic CAN frame.

    Attributes:
        can_id: 11 bits, or 29 when `extended`.
        data: at most 8 bytes.
        extended, remote, error: kinds of frames.
    """

    can_id: int
    data: bytes
    extended: bool = False
    remote: bool = False
    error: bool = False


def encode(frame: Frame) -> bytes:
    """Encode a frame, including the terminating zero byte.

    Raises:
        ValueError: the identifier or the data are too long.
    """
    limit = 1 << (29 if frame.extended else 11)
    if not 0 <= frame.can_id < limit:
        raise ValueError(f"identifier = {frame.can_id:X}h: should be below {limit:X}h")
    if len(frame.data) > _MOST_DATA:
        raise ValueError(f"data has {len(frame.data)} bytes: should be at most {_MOST_DATA}")
    head = frame.can_id
    head |= _EXTENDED * frame.extended | _REMOTE * frame.remote | _ERROR * frame.error
    body = _ID.pack(head) + bytes(frame.data)
    return bytes(cobs.encode(body + _CRC.pack(binascii.crc32(body)))) + b"\x00"


class Decoder:
    """Decodes a stream of bytes, in pieces of any length.

    Attributes:
        errors: dropped frames, which had invalid stuffing, a wrong length or CRC, or no CAN frame.
    """

    def __init__(self) -> None:
        self.errors = 0
        self._pending = bytearray()
        self._overflown = False

    def feed(self, received: bytes) -> Iterator[Frame]:
        """Yield the frames that these bytes complete."""
        *complete, rest = received.split(b"\x00")
        for piece in complete:
            self._take(piece)
            frame = self._finish()
            if frame is not None:
                yield frame
        self._take(rest)

    def _take(self, piece: bytes) -> None:
        # Bound the memory for a line without zero bytes.
        room = _LONGEST + 1 - len(self._pending)
        self._overflown |= len(piece) > room
        self._pending += piece[: max(room, 0)]

    def _finish(self) -> Frame | None:
        stuffed, overflown = bytes(self._pending), self._overflown
        self._pending.clear()
        self._overflown = False
        if not stuffed:  # consecutive zeros are allowed
            return None
        frame = None if overflown else _decoded(stuffed)
        self.errors += frame is None
        return frame


def _decoded(stuffed: bytes) -> Frame | None:
    """The frame in stuffed bytes; None: they are damaged."""
    try:
        body = cobs.decode(stuffed)
    except cobs.DecodeError:
        return None
    if not _SHORTEST <= len(body) <= _SHORTEST + _MOST_DATA:
        return None
    content, (crc,) = body[: -_CRC.size], _CRC.unpack(body[-_CRC.size :])
    if binascii.crc32(content) != crc:
        return None
    (head,) = _ID.unpack_from(content)
    frame = Frame(
        head & ~_FLAGS,
        content[_ID.size :],
        bool(head & _EXTENDED),
        bool(head & _REMOTE),
        bool(head & _ERROR),
    )
    return frame if frame.extended or frame.can_id < 1 << 11 else None
