"""Bytes as a serialized ``std_msgs/msg/UInt8MultiArray``, which carries them on a topic."""

from __future__ import annotations

import struct

_HEAD = struct.Struct("<4sIII")  # encapsulation, empty layout, length
_LITTLE_ENDIAN = bytes((0, 1, 0, 0))


def to_array(data: bytes) -> bytes:
    """Return the serialized array that holds the bytes."""
    return _HEAD.pack(_LITTLE_ENDIAN, 0, 0, len(data)) + data


def from_array(message: bytes) -> bytes:
    """Return the bytes that a serialized array holds.

    Raises:
        ValueError: it is no array of bytes without a layout.
    """
    try:
        *_, length = _HEAD.unpack_from(message)
    except struct.error as error:
        raise ValueError(str(error)) from error
    data = message[_HEAD.size : _HEAD.size + length]
    if len(data) < length:
        msg = f"the array should have {length} bytes, it has {len(data)}"
        raise ValueError(msg)
    return data
