"""Byte layouts of messages, to extract the numbers of many messages at once.

Messages of one topic mostly differ in their stamp and their numbers only. The layout of the first
message is derived from its type (CDR, https://www.omg.org/spec/DDSI-RTPS), checked against the
contract's decoder and applied to messages whose names, lengths and frames are the same, byte by
byte. Every number is checked for finiteness and the contract's limits. A message that differs or
fails a check goes to the decoder, which accepts it or states the reason for its rejection.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from msg_schemas.samples import TETHER_COLUMNS, ClockSample, OdometrySample, TetherSample
from msg_schemas.table import Topic

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]

_HEAD: Final = 4  # bytes of the CDR encapsulation header
_LITTLE_ENDIAN: Final = b"\x00\x01"
_FLOAT: Final = 8
_NANO: Final = 1_000_000_000
_QUATERNION_TOLERANCE: Final = 1e-3
_NODE: Final = len(TETHER_COLUMNS)


class _LayoutMismatch(Exception):
    """A message whose bytes do not match the layout of its type."""


@dataclass(frozen=True)
class ExtractedNumbers:
    """Numbers of several messages.

    Attributes:
        accepted: Which messages match the layout and its limits, shape (N,).
        stamp_ns: Stamps, shape (N,).
        values: Numbers, shape (N, columns), in the order of `Layout.paths`.
        nodes: Nodes of the tether, shape (N, n + 1, 7); None for other topics.
    """

    accepted: NDArray[np.bool_]
    stamp_ns: NDArray[np.int64]
    values: Floats
    nodes: Floats | None


@dataclass(frozen=True)
class Layout:
    """Offsets of a message's numbers.

    Attributes:
        paths: Field paths of the numbers, as in the sample.
        stamp: Offset of the stamp [byte].
        offsets: Offset of each number [byte].
        nodes: Offset and count of the tether's nodes; None for other topics.
        fixed: Offsets of the bytes that must equal those of the first message.
        expected: Those bytes.
        spec: The topic in the contract.
    """

    paths: tuple[str, ...]
    stamp: int
    offsets: tuple[int, ...]
    nodes: tuple[int, int] | None
    fixed: NDArray[np.intp]
    expected: Bytes
    spec: Topic

    def extract(self, messages: Sequence[bytes]) -> ExtractedNumbers:
        """Extract the numbers of messages that have the length of the first."""
        table = np.frombuffer(b"".join(messages), dtype=np.uint8).reshape(len(messages), -1)
        accepted = (table[:, self.fixed] == self.expected).all(axis=1)
        seconds = _column(table, self.stamp, "<i4").astype(np.int64)
        nanos = _column(table, self.stamp + 4, "<u4").astype(np.int64)
        accepted &= nanos < _NANO
        values = np.empty((len(messages), len(self.paths)))
        for column, offset in enumerate(self.offsets):
            values[:, column] = _column(table, offset, "<f8")
        if self.spec.sample is ClockSample:  # it holds a stamp only
            values[:, 0] = (seconds * _NANO + nanos) * 1e-9
        accepted &= self._allowed(self.paths, values)
        if self.spec.sample is OdometrySample:
            squares = [i for i, path in enumerate(self.paths) if path.startswith("orientation.")]
            norm = np.linalg.norm(values[:, squares], axis=1)
            accepted &= np.abs(norm - 1.0) <= 0.9 * _QUATERNION_TOLERANCE
        nodes = None
        if self.nodes is not None:
            offset, count = self.nodes
            block = table[:, offset : offset + count * _NODE * _FLOAT]
            nodes = np.ascontiguousarray(block).view("<f8").reshape(-1, count, _NODE)
            for extreme in (nodes.min(axis=1), nodes.max(axis=1)):
                accepted &= self._allowed(TETHER_COLUMNS, extreme)
        return ExtractedNumbers(accepted, seconds * _NANO + nanos, values, nodes)

    def _allowed(self, paths: Sequence[str], values: Floats) -> NDArray[np.bool_]:
        limits = self.spec.by_path
        low = np.array([limits[path].minimum if path in limits else -np.inf for path in paths])
        high = np.array([limits[path].maximum if path in limits else np.inf for path in paths])
        with np.errstate(invalid="ignore"):
            inside = (values >= low) & (values <= high) & np.isfinite(values)
        return np.asarray(inside.all(axis=1))


def _column(table: Bytes, offset: int, kind: str) -> NDArray[Any]:
    width = np.dtype(kind).itemsize
    column: NDArray[Any] = np.ascontiguousarray(table[:, offset : offset + width]).view(kind)[:, 0]
    return column


def layout_of(spec: Topic, data: bytes, sample: Any) -> Layout | None:
    """Derive the layout of a message, or None if it disagrees with the decoder.

    Args:
        spec: The topic in the contract.
        data: The serialised message.
        sample: The message as decoded by the contract's decoder.
    """
    walk = _WALKS.get(spec.message)
    if walk is None or data[:2] != _LITTLE_ENDIAN:
        return None
    cursor = _Cursor(data)
    try:
        walk(cursor)
    except (_LayoutMismatch, struct.error, UnicodeDecodeError):
        return None
    fixed = np.flatnonzero(cursor.fixed)
    names = tuple(cursor.numbers) or (("clock",) if spec.sample is ClockSample else ())
    layout = Layout(
        names, cursor.stamp, tuple(cursor.numbers.values()), cursor.nodes, fixed,
        np.frombuffer(data, dtype=np.uint8)[fixed], spec,
    )  # fmt: skip
    extracted = layout.extract([data])
    if not extracted.accepted[0] or int(extracted.stamp_ns[0]) != sample.stamp_ns:
        return None
    if isinstance(sample, TetherSample):
        same = extracted.nodes is not None and np.array_equal(extracted.nodes[0], sample.nodes)
        return layout if same else None
    extracted_numbers = dict(zip(names, extracted.values[0].tolist(), strict=True))
    return layout if extracted_numbers == dict(sample.scalars()) else None


class _Cursor:
    """Parses a message and notes the offsets of its numbers and its fixed bytes."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.at = _HEAD
        self.stamp = 0
        self.numbers: dict[str, int] = {}
        self.nodes: tuple[int, int] | None = None
        self.fixed = np.zeros(len(data), dtype=bool)
        self.fixed[:_HEAD] = True

    def align(self, width: int) -> None:
        self.at += -(self.at - _HEAD) % width

    def time(self) -> None:
        self.align(4)
        self.stamp = self.at
        self.skip(8)

    def skip(self, count: int) -> None:
        self.at += count
        if self.at > len(self.data):
            raise _LayoutMismatch

    def integer(self, kind: str = "I") -> int:
        width = struct.calcsize(kind)
        self.align(width)
        (value,) = struct.unpack_from("<" + kind, self.data, self.at)
        self.fixed[self.at : self.at + width] = True
        self.skip(width)
        return int(value)

    def text(self) -> str:
        length = self.integer()
        begin = self.at
        self.skip(length)
        self.fixed[begin : self.at] = True
        return self.data[begin : self.at].rstrip(b"\0").decode()

    def floats(self, *names: str) -> None:
        self.align(_FLOAT)
        for name in names:
            self.numbers[name] = self.at
            self.skip(_FLOAT)

    def vector(self, prefix: str, axes: str = "xyz") -> None:
        self.floats(*(f"{prefix}.{axis}" for axis in axes))

    def covariance(self, count: int) -> None:
        self.align(_FLOAT)
        self.skip(count * _FLOAT)

    def header(self) -> None:
        self.time()
        self.text()


def _joints(cursor: _Cursor) -> None:
    cursor.header()
    names = [cursor.text() for _ in range(cursor.integer())]
    if len(set(names)) != len(names):
        raise _LayoutMismatch
    places: dict[str, int] = {}
    for part in ("position", "velocity", "effort"):
        if cursor.integer() != len(names):
            raise _LayoutMismatch
        cursor.align(_FLOAT)
        for name in names:
            places[f"{name}.{part}"] = cursor.at
            cursor.skip(_FLOAT)
    parts = ("position", "velocity", "effort")
    order = [f"{name}.{part}" for name in names for part in parts]
    cursor.numbers = {path: places[path] for path in order}


def _odometry(cursor: _Cursor) -> None:
    cursor.header()
    cursor.text()
    cursor.vector("position")
    cursor.vector("orientation", "xyzw")
    cursor.covariance(36)
    cursor.vector("linear")
    cursor.vector("angular")
    cursor.covariance(36)


def _imu(cursor: _Cursor) -> None:
    cursor.header()
    cursor.covariance(4 + 9)
    cursor.vector("angular_velocity")
    cursor.covariance(9)
    cursor.vector("linear_acceleration")
    cursor.covariance(9)


def _wrench(cursor: _Cursor) -> None:
    cursor.header()
    cursor.vector("force")
    cursor.vector("torque")


def _clock(cursor: _Cursor) -> None:
    cursor.time()


def _tether(cursor: _Cursor) -> None:
    cursor.header()
    height, width = cursor.integer(), cursor.integer()
    for _ in range(cursor.integer()):
        cursor.text()
        cursor.integer()
        cursor.integer("B")
        cursor.integer()
    cursor.integer("B")
    cursor.integer()
    cursor.integer()
    size = cursor.integer()
    if size != height * width * _NODE * _FLOAT or not size:
        raise _LayoutMismatch
    cursor.nodes = (cursor.at, height * width)
    cursor.skip(size)


_WALKS: Final[Mapping[str, Callable[[_Cursor], None]]] = MappingProxyType(
    {
        "sensor_msgs/msg/JointState": _joints,
        "nav_msgs/msg/Odometry": _odometry,
        "sensor_msgs/msg/Imu": _imu,
        "geometry_msgs/msg/WrenchStamped": _wrench,
        "rosgraph_msgs/msg/Clock": _clock,
        "sensor_msgs/msg/PointCloud2": _tether,
    }
)
