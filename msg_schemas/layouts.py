"""Byte layouts of the contract's message types in the common data representation (CDR).

`LAYOUTS` is their one home: publishers, subscribers and bags use it. A message is read into the
values of its parts, in their order, and written from them: version 1 of CDR, little-endian
(OMG DDSI-RTPS 10.2). A header of 4 bytes precedes the parts; each number is aligned to its size,
counted from the end of that header.

Messages of one topic mostly differ in their numbers only. A `Template` holds the strings and
lengths of such messages, and reads or writes one of them by a single call of `struct`.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from itertools import chain
from math import inf
from operator import le
from sys import float_info
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from msg_schemas.specifications import Field
from msg_schemas.text_limits import DOCUMENT_BYTES, NAME_BYTES, STATUS_BYTES

NANO: Final = 1_000_000_000
_HEAD: Final = 4
_LITTLE_ENDIAN: Final = b"\x00\x01\x00\x00"
_MAX_PADDING: Final = 12
"""Bytes after a message: rclpy serializes up to 4 for each empty array of a JointState."""
_COUNT: Final = struct.Struct("<I")
_STAMP: Final = struct.Struct("<iI")
_LARGEST: Final = float_info.max


class CdrError(ValueError):
    """Bytes that are no message of the layout, or values that no message can hold."""


class _Cursor:
    """Position in a message that is read; ``begin`` .. ``end`` were taken last."""

    def __init__(self, data: bytes) -> None:
        head = bytes(data[:_HEAD])
        if head[:2] != _LITTLE_ENDIAN[:2] or len(head) < _HEAD:
            kind = "big-endian CDR" if head[:2] == b"\0\0" else "no little-endian CDR of version 1"
            raise CdrError(f"it begins with {head.hex(' ')!r}: {kind}")
        self.data = data
        self.begin = self.end = _HEAD

    def take(self, size: int, alignment: int = 1) -> int:
        begin = self.end + (_HEAD - self.end) % alignment
        if begin + size > len(self.data):
            raise CdrError(f"it has {len(self.data)} bytes, and {begin + size} are needed")
        self.begin, self.end = begin, begin + size
        return begin

    def count(self) -> int:
        (count,) = _COUNT.unpack_from(self.data, self.take(4, 4))
        return int(count)

    def byte_array(self, limit: float = inf) -> bytes:
        count = self.count()
        if count > limit:
            raise _too_long(count - 1, limit - 1)
        begin = self.take(count)
        return bytes(self.data[begin : self.end])

    def check_end(self) -> None:
        left = len(self.data) - self.end
        if left > _MAX_PADDING:
            raise CdrError(f"it has {len(self.data)} bytes, {left} more than its parts")


def _too_long(size: int, limit: float) -> CdrError:
    return CdrError(f"a string has {size} bytes, it may have at most {limit}")


def _align(out: bytearray, alignment: int) -> None:
    out += bytes((_HEAD - len(out)) % alignment)


class _Part:
    """One part of a layout.

    Attributes:
        name: attribute of the sample that holds its value; empty = none.
        varies: whether it differs between messages of the same strings and lengths.
    """

    name = ""
    varies = False

    def read(self, cursor: _Cursor) -> Any:
        raise NotImplementedError

    def write(self, out: bytearray, value: Any) -> None:
        raise NotImplementedError


class _Stamp(_Part):
    """A time; its value is in nanoseconds."""

    name = "stamp_ns"
    varies = True

    def read(self, cursor: _Cursor) -> int:
        seconds, nanoseconds = _STAMP.unpack_from(cursor.data, cursor.take(8, 4))
        return int(seconds * NANO + nanoseconds)

    def write(self, out: bytearray, value: int) -> None:
        _align(out, 4)
        out += _STAMP.pack(*divmod(value, NANO))


class _Text(_Part):
    """A string of at most `limit` bytes in UTF-8."""

    def __init__(self, limit: int) -> None:
        self._limit = limit

    def read(self, cursor: _Cursor) -> str:
        raw = cursor.byte_array(self._limit + 1).removesuffix(b"\0")
        if b"\0" in raw:
            raise CdrError(f"a string holds a NUL: {raw[:60]!r}")
        return raw.decode()

    def write(self, out: bytearray, value: str) -> None:
        raw = value.encode()
        if b"\0" in raw:
            raise CdrError(f"a string holds a NUL: {raw[:60]!r}")
        if len(raw) > self._limit:
            raise _too_long(len(raw), self._limit)
        _align(out, 4)
        out += _COUNT.pack(len(raw) + 1) + raw + b"\0"


class _Numbers(_Part):
    """A tuple of numbers of one type, as `struct` names it; doubles vary."""

    def __init__(self, code: str, count: int = 1, name: str = "") -> None:
        self.code, self.count, self.name = code, count, name
        self.width = struct.calcsize(code)
        self.varies = code == "d"
        keys = [f".{axis}" for axis in "xyzw"] if count <= 4 else [f"[{n}]" for n in range(count)]
        self.paths = tuple(name + key for key in keys[:count])

    def read(self, cursor: _Cursor) -> Any:
        return self.read_several(cursor, 1)

    def write(self, out: bytearray, value: Any) -> None:
        self.write_several(out, value, 1)

    def read_several(self, cursor: _Cursor, length: int) -> tuple[Any, ...]:
        begin = cursor.take(length * self.count * self.width, self.width)
        return struct.unpack_from(f"<{length * self.count}{self.code}", cursor.data, begin)

    def write_several(self, out: bytearray, value: Iterable[Any], length: int) -> None:
        _align(out, self.width)
        out += struct.pack(f"<{length * self.count}{self.code}", *value)


class _Array(_Part):
    """A sequence of numbers; its value is a tuple of them, or of their tuples."""

    def __init__(self, element: _Numbers) -> None:
        self.element, self.name, self.varies = element, element.name, element.varies

    def read(self, cursor: _Cursor) -> tuple[Any, ...]:
        length, width = cursor.count(), self.element.count
        numbers = self.element.read_several(cursor, length) if length else ()
        return numbers if width == 1 else tuple(zip(*[iter(numbers)] * width, strict=True))

    def write(self, out: bytearray, value: Sequence[Any]) -> None:
        _align(out, 4)
        out += _COUNT.pack(len(value))
        if value:
            flat = value if self.element.count == 1 else chain.from_iterable(value)
            self.element.write_several(out, flat, len(value))


class _Bytes(_Part):
    """A sequence of bytes; its value is a tuple of one bytes object."""

    varies = True

    def __init__(self, name: str = "") -> None:
        self.name = name

    def read(self, cursor: _Cursor) -> tuple[bytes]:
        return (cursor.byte_array(),)

    def write(self, out: bytearray, value: tuple[bytes]) -> None:
        _align(out, 4)
        out += _COUNT.pack(len(value[0])) + value[0]


class _Record(_Part):
    """A structure; its value is a tuple of the values of its parts."""

    def __init__(self, *parts: _Part) -> None:
        self.parts = parts

    def read(self, cursor: _Cursor) -> tuple[Any, ...]:
        return tuple([part.read(cursor) for part in self.parts])

    def write(self, out: bytearray, value: Sequence[Any]) -> None:
        for part, item in zip(self.parts, value, strict=True):
            part.write(out, item)


class _Items(_Part):
    """A sequence of strings or structures; its value is a tuple of theirs."""

    def __init__(self, item: _Part) -> None:
        self.item = item

    def read(self, cursor: _Cursor) -> tuple[Any, ...]:
        # A false length ends with the message: each item has at least four bytes.
        return tuple([self.item.read(cursor) for _ in range(cursor.count())])

    def write(self, out: bytearray, value: Sequence[Any]) -> None:
        _align(out, 4)
        out += _COUNT.pack(len(value))
        for each in value:
            self.item.write(out, each)


class Layout(_Record):
    """Layout of a message type; the values of a message are those of its parts, in their order.

    The value of a structure is a tuple, a stamp is in nanoseconds, numbers of one name are a tuple.
    """

    def parse(self, data: bytes, *, whole: bool = True) -> list[Any]:
        """Read a message, or the beginning of one.

        Raises:
            CdrError: it has another representation, is too short or too long, or a string is no
                UTF-8.
        """
        cursor = _Cursor(data)
        try:
            values = [part.read(cursor) for part in self.parts]
        except UnicodeDecodeError as error:
            raise CdrError(f"a string is no UTF-8: {error}") from None
        if whole:
            cursor.check_end()
        return values

    def serialize(self, values: Sequence[Any]) -> bytes:
        """Write a message.

        Raises:
            CdrError: a value has no representation.
        """
        out = bytearray(_LITTLE_ENDIAN)
        try:
            self.write(out, values)
        except (struct.error, OverflowError, UnicodeEncodeError) as error:
            raise CdrError(str(error)) from None
        return bytes(out)

    def numbers(self, values: Sequence[Any]) -> Iterator[tuple[str, float]]:
        """Yield field path and value of each number that has a name, in the message's order."""
        for part, value in zip(self.parts, values, strict=True):
            if isinstance(part, _Numbers) and part.name:
                yield from zip(part.paths, value, strict=True)

    @cached_property
    def blank(self) -> list[Any]:
        """Values of an empty message."""
        return [(0.0,) * part.count if isinstance(part, _Numbers) else "" for part in self.parts]


class _Unlimited:
    """Limit of a value that is compared with nothing."""

    def __le__(self, other: object) -> bool:
        return True

    __ge__ = __le__


_UNLIMITED: Final = _Unlimited()


class Number(NamedTuple):
    """A number of a template: its offset [byte] and its limits."""

    offset: int
    low: float
    high: float


class Template:
    """Messages of a layout that have the same strings and lengths, while named parts vary.

    The layout begins with a stamp. Numbers without a name are not looked at in messages that are
    read; in those that are written they are as in the first message.

    Args:
        layout: of the message type.
        data: the first message.
        paths: field paths of the named numbers, in the message's order.
        fields: limits of numbers; any other number must be finite.
        reads: whether messages are read; otherwise they are written.

    Attributes:
        data: the first message.
        numbers: each named number, by its path.
        arrays: begin and end of the named byte arrays [byte].
        varying: begin and end of all bytes that may differ from those of the first message.
    """

    def __init__(
        self,
        layout: Layout,
        data: bytes,
        paths: Iterable[str],
        fields: Mapping[str, Field],
        *,
        reads: bool,
    ) -> None:
        self.data = bytes(data)
        self.numbers: dict[str, Number] = {}
        self.arrays: list[tuple[int, int]] = []
        self.varying: list[tuple[int, int]] = []
        self._values: list[Any] = []
        self._places: list[tuple[slice, int]] = []
        # What `struct` packs and unpacks: numbers, and the constant bytes between them.
        self._format = "<"
        self._items: list[Any] = []
        # A constant is its own lower and upper limit: one comparison checks it and the numbers.
        self._low: list[Any] = []
        self._high: list[Any] = []
        remaining, cursor, done = iter(paths), _Cursor(data), 0
        for index, part in enumerate(layout.parts):
            value = part.read(cursor)
            self._values.append(value)
            begin, end = cursor.begin, cursor.end
            if not part.varies or value == () or not (part.name or reads):
                continue
            self._add_constant(done, begin)
            self.varying.append((begin, end))
            done, first = end, len(self._items)
            if isinstance(part, _Stamp):
                self._add("i", 0, -(2**31), 2**31 - 1)
                self._add("I", 0, 0, 2**32 - 1)
            elif isinstance(part, _Bytes):
                self._add(f"{end - begin}s", b"", _UNLIMITED, _UNLIMITED)
                self.arrays.append((begin, end))
            elif part.name:
                for offset in range(begin, end, 8):
                    path = next(remaining)
                    number = self.numbers[path] = Number(offset, *finite_limits(fields.get(path)))
                    self._add("d", 0.0, number.low, number.high)
            else:
                self._format += f"{end - begin}x"
            if index and part.name:
                self._places.append((slice(first, len(self._items)), index))
        self._add_constant(done, cursor.end)
        self.varying.append((cursor.end, len(data)))
        cursor.check_end()
        self._struct = struct.Struct(f"{self._format}{len(data) - cursor.end}x")

    def _add(self, code: str, item: Any, low: Any, high: Any) -> None:
        self._format += code
        self._items.append(item)
        self._low.append(low)
        self._high.append(high)

    def _add_constant(self, begin: int, end: int) -> None:
        if begin < end:
            constant = self.data[begin:end]
            self._add(f"{end - begin}s", constant, constant, constant)

    def parse(self, data: bytes) -> list[Any] | None:
        """Read a message as long as the first one into the values of the layout.

        None: other bytes differ than those that may, or a number is not within its limits.
        """
        items = self._struct.unpack(data)
        if not (all(map(le, self._low, items)) and all(map(le, items, self._high))):
            return None
        values = self._values.copy()
        values[0] = items[1] * NANO + items[2]
        for place, index in self._places:
            values[index] = items[place]
        return values

    def serialize(self, values: Sequence[Any]) -> bytes | None:
        """Write the varying values of the layout; None: a number is not within its limits."""
        items = self._items.copy()
        items[1:3] = divmod(values[0], NANO)
        for place, index in self._places:
            items[place] = values[index]
        if all(map(le, self._low, items)) and all(map(le, items, self._high)):
            return self._struct.pack(*items)
        return None


def finite_limits(field: Field | None) -> tuple[float, float]:
    """Return the smallest and the largest value of a number, NaN and infinities excluded."""
    if field is None:
        return -_LARGEST, _LARGEST
    return max(field.minimum, -_LARGEST), min(field.maximum, _LARGEST)


# --- the message types of the contract ------------------------------------------------------------

_NAME: Final = _Text(NAME_BYTES)
_MESSAGE: Final = _Text(STATUS_BYTES)
_STAMPED: Final = (_Stamp(), _NAME)  # with frame_id
_POSITION: Final = _Numbers("d", 3, "position")
_ORIENTATION: Final = _Numbers("d", 4, "orientation")
_LINEAR: Final = _Numbers("d", 3, "linear")
_ANGULAR: Final = _Numbers("d", 3, "angular")

HEADER: Final = Layout(*_STAMPED)

LAYOUTS: Final[Mapping[str, Layout]] = MappingProxyType(
    {
        "rosgraph_msgs/msg/Clock": Layout(_Stamp()),
        "std_msgs/msg/String": Layout(_Text(DOCUMENT_BYTES)),
        "sensor_msgs/msg/JointState": Layout(
            *_STAMPED,
            _Items(_NAME),
            _Array(_Numbers("d", name="position")),
            _Array(_Numbers("d", name="velocity")),
            _Array(_Numbers("d", name="effort")),
        ),
        "nav_msgs/msg/Odometry": Layout(
            *_STAMPED,
            _NAME,  # child_frame_id
            _POSITION,
            _ORIENTATION,
            _Numbers("d", 36, "pose_covariance"),
            _LINEAR,
            _ANGULAR,
            _Numbers("d", 36),  # covariance of the twist
        ),
        "geometry_msgs/msg/PoseStamped": Layout(*_STAMPED, _POSITION, _ORIENTATION),
        "geometry_msgs/msg/PoseWithCovarianceStamped": Layout(
            *_STAMPED, _POSITION, _ORIENTATION, _Numbers("d", 36, "pose_covariance")
        ),
        "nav_msgs/msg/Path": Layout(*_STAMPED, _Items(_Record(*_STAMPED, _POSITION, _ORIENTATION))),
        "geometry_msgs/msg/TwistStamped": Layout(*_STAMPED, _LINEAR, _ANGULAR),
        "sensor_msgs/msg/Imu": Layout(
            *_STAMPED,
            _Numbers("d", 4),  # orientation
            _Numbers("d", 9),  # its covariance, and those of the others
            _Numbers("d", 3, "angular_velocity"),
            _Numbers("d", 9),
            _Numbers("d", 3, "linear_acceleration"),
            _Numbers("d", 9),
        ),
        "geometry_msgs/msg/WrenchStamped": Layout(
            *_STAMPED, _Numbers("d", 3, "force"), _Numbers("d", 3, "torque")
        ),
        "sensor_msgs/msg/PointCloud2": Layout(
            *_STAMPED,
            _Numbers("I", 2),  # height, width
            _Items(_Record(_NAME, _Numbers("I"), _Numbers("B"), _Numbers("I"))),  # fields
            _Numbers("?"),  # is_bigendian
            _Numbers("I", 2),  # point_step, row_step
            _Bytes("nodes"),
            _Numbers("?"),  # is_dense
        ),
        "diagnostic_msgs/msg/DiagnosticArray": Layout(
            *_STAMPED,
            # level, name, message, hardware_id, values
            _Items(
                _Record(_Numbers("B"), _NAME, _MESSAGE, _NAME, _Items(_Record(_NAME, _MESSAGE)))
            ),
        ),
        "visualization_msgs/msg/MarkerArray": Layout(
            _Items(
                _Record(
                    *_STAMPED,
                    _NAME,  # ns
                    _Numbers("i", 3),  # id, type, action
                    _POSITION,
                    _ORIENTATION,
                    _Numbers("d", 3),  # scale
                    _Numbers("f", 4),  # color
                    _Numbers("i", 2),  # lifetime
                    _Numbers("?"),  # frame_locked
                    _Array(_Numbers("d", 3)),  # points
                    _Array(_Numbers("f", 4)),  # colors
                    _NAME,  # texture_resource
                    _Record(*_STAMPED, _NAME, _Bytes()),  # texture
                    _Array(_Numbers("f", 2)),  # uv_coordinates
                    _NAME,  # text
                    _NAME,  # mesh_resource
                    _Record(_NAME, _Bytes()),  # mesh_file
                    _Numbers("?"),  # mesh_use_embedded_materials
                )
            )
        ),
    }
)
