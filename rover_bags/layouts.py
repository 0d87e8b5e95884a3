"""Where the numbers of a message lie in its bytes, so that many are taken out at once.

Messages of one topic mostly differ in nothing but their stamp and their numbers. The layout of the
first is worked out from its type (CDR, https://www.omg.org/spec/DDSI-RTPS), held against what the
contract's decoder makes of that message, and taken for those whose names, lengths and frames are
the same, byte by byte. Every number is tested for finiteness and the contract's limits. What
differs in anything, or fails a test, is left to the decoder, which accepts it or says why not.
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

_HEAD: Final = 4  # bytes before the message: how it is encoded
_LITTLE_ENDIAN: Final = b"\x00\x01"
_FLOAT: Final = 8
_NANO: Final = 1_000_000_000
_QUATERNION_TOLERANCE: Final = 1e-3
_NODE: Final = len(TETHER_COLUMNS)


class _Unlike(Exception):
    """A message that is not laid out as its type says."""


@dataclass(frozen=True)
class Taken:
    """Numbers of several messages.

    Attributes:
        good: Which messages were taken, shape (N,); the others are for the decoder.
        stamp_ns: Their stamps.
        values: Their numbers, shape (N, columns), in the order of `Layout.paths`.
        nodes: Nodes of the tether, shape (N, n + 1, 7); None for other topics.
    """

    good: NDArray[np.bool_]
    stamp_ns: NDArray[np.int64]
    values: Floats
    nodes: Floats | None


@dataclass(frozen=True)
class Layout:
    """Where the numbers lie.

    Attributes:
        paths: Names of the numbers, as the sample's.
        stamp: Offset of the stamp.
        offsets: Of each number.
        nodes: Offset and count of the tether's nodes; None for other topics.
        fixed: Offsets of the bytes that must be those of the first message.
        like: Those bytes.
        row: Of the contract's table.
    """

    paths: tuple[str, ...]
    stamp: int
    offsets: tuple[int, ...]
    nodes: tuple[int, int] | None
    fixed: NDArray[np.intp]
    like: Bytes
    row: Topic

    def take(self, messages: Sequence[bytes]) -> Taken:
        """Numbers of messages that all have the length of the first."""
        table = np.frombuffer(b"".join(messages), dtype=np.uint8).reshape(len(messages), -1)
        good = (table[:, self.fixed] == self.like).all(axis=1)
        seconds = _column(table, self.stamp, "<i4").astype(np.int64)
        nanos = _column(table, self.stamp + 4, "<u4").astype(np.int64)
        good &= nanos < _NANO
        values = np.empty((len(messages), len(self.paths)))
        for column, offset in enumerate(self.offsets):
            values[:, column] = _column(table, offset, "<f8")
        if self.row.sample is ClockSample:  # its stamp is all that it says
            values[:, 0] = (seconds * _NANO + nanos) * 1e-9
        good &= self._allowed(self.paths, values)
        if self.row.sample is OdometrySample:
            squares = [i for i, path in enumerate(self.paths) if path.startswith("orientation.")]
            norm = np.linalg.norm(values[:, squares], axis=1)
            good &= np.abs(norm - 1.0) <= 0.9 * _QUATERNION_TOLERANCE
        nodes = None
        if self.nodes is not None:
            offset, count = self.nodes
            block = table[:, offset : offset + count * _NODE * _FLOAT]
            nodes = np.ascontiguousarray(block).view("<f8").reshape(-1, count, _NODE)
            for extreme in (nodes.min(axis=1), nodes.max(axis=1)):
                good &= self._allowed(TETHER_COLUMNS, extreme)
        return Taken(good, seconds * _NANO + nanos, values, nodes)

    def _allowed(self, paths: Sequence[str], values: Floats) -> NDArray[np.bool_]:
        limits = self.row.by_path
        low = np.array([limits[path].minimum if path in limits else -np.inf for path in paths])
        high = np.array([limits[path].maximum if path in limits else np.inf for path in paths])
        with np.errstate(invalid="ignore"):
            inside = (values >= low) & (values <= high) & np.isfinite(values)
        return np.asarray(inside.all(axis=1))


def _column(table: Bytes, offset: int, kind: str) -> NDArray[Any]:
    width = np.dtype(kind).itemsize
    column: NDArray[Any] = np.ascontiguousarray(table[:, offset : offset + width]).view(kind)[:, 0]
    return column


def layout_of(row: Topic, data: bytes, sample: Any) -> Layout | None:
    """The layout of a message, None where it cannot be relied on.

    Args:
        row: Of its topic.
        data: Its bytes.
        sample: What the contract's decoder makes of it.
    """
    walk = _WALKS.get(row.message)
    if walk is None or data[:2] != _LITTLE_ENDIAN:
        return None
    cursor = _Cursor(data)
    try:
        walk(cursor)
    except (_Unlike, struct.error, UnicodeDecodeError):
        return None
    fixed = np.flatnonzero(cursor.fixed)
    names = tuple(cursor.numbers) or (("clock",) if row.sample is ClockSample else ())
    layout = Layout(
        names, cursor.stamp, tuple(cursor.numbers.values()), cursor.nodes, fixed,
        np.frombuffer(data, dtype=np.uint8)[fixed], row,
    )  # fmt: skip
    taken = layout.take([data])
    if not taken.good[0] or int(taken.stamp_ns[0]) != sample.stamp_ns:
        return None
    if isinstance(sample, TetherSample):
        same = taken.nodes is not None and np.array_equal(taken.nodes[0], sample.nodes)
        return layout if same else None
    told = dict(zip(names, taken.values[0].tolist(), strict=True))
    return layout if told == dict(sample.scalars()) else None


class _Cursor:
    """Walks through a message, noting where its numbers are and what must not change."""

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
            raise _Unlike

    def whole(self, kind: str = "I") -> int:
        width = struct.calcsize(kind)
        self.align(width)
        (value,) = struct.unpack_from("<" + kind, self.data, self.at)
        self.fixed[self.at : self.at + width] = True
        self.skip(width)
        return int(value)

    def text(self) -> str:
        length = self.whole()
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
    names = [cursor.text() for _ in range(cursor.whole())]
    if len(set(names)) != len(names):
        raise _Unlike
    places: dict[str, int] = {}
    for part in ("position", "velocity", "effort"):
        if cursor.whole() != len(names):
            raise _Unlike
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
    height, width = cursor.whole(), cursor.whole()
    for _ in range(cursor.whole()):
        cursor.text()
        cursor.whole()
        cursor.whole("B")
        cursor.whole()
    cursor.whole("B")
    cursor.whole()
    cursor.whole()
    size = cursor.whole()
    if size != height * width * _NODE * _FLOAT or not size:
        raise _Unlike
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
