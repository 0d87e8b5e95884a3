"""Numbers of many messages at once.

Messages of one topic mostly differ in their stamp and their numbers only. The template of the first
message (`msg_schemas.layouts`) is applied to messages of its length whose other bytes are the same.
Every number is checked for finiteness and the contract's limits. A message that differs or fails a
check goes to the codec, which accepts it or states the reason for its rejection.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from msg_schemas.cdr import template, unpack
from msg_schemas.layouts import NANO, Template, finite_limits
from msg_schemas.samples import TETHER_COLUMNS, ClockSample, TetherSample
from msg_schemas.specifications import Topic

Floats = NDArray[np.float64]

_STAMP: Final = 4  # offset [byte]
_NORM_TOLERANCE: Final = 0.9e-3
"""Of a unit quaternion, less than that of the codec."""


@dataclass(frozen=True)
class ExtractedNumbers:
    """Numbers of several messages.

    Attributes:
        accepted: Which messages match the template and its limits, shape (N,).
        stamp_ns: Stamps, shape (N,).
        values: Numbers, shape (N, columns), in the order of `NumberExtractor.paths`.
        nodes: Nodes of the tether, shape (N, n + 1, 7); None for other topics.
    """

    accepted: NDArray[np.bool_]
    stamp_ns: NDArray[np.int64]
    values: Floats
    nodes: Floats | None


class NumberExtractor:
    """Extracts the numbers of messages that match a template.

    Args:
        spec: The topic in the contract.
        found: Template of its messages.
        paths: Field paths of the numbers to extract, in the sample's order.

    Attributes:
        paths: Field paths of the extracted numbers.
    """

    def __init__(self, spec: Topic, found: Template, paths: Sequence[str]) -> None:
        self.paths = tuple(paths)
        self._is_clock = spec.sample is ClockSample
        same = np.ones(len(found.data), dtype=bool)
        for begin, end in found.varying:
            same[begin:end] = False
        self._same = np.flatnonzero(same)
        self._expected = np.frombuffer(found.data, dtype=np.uint8)[self._same]
        self._offsets = [number.offset for number in found.numbers.values()]
        self._low, self._high = _columns(number[1:] for number in found.numbers.values())
        names = list(found.numbers)
        self._columns = [names.index(path) for path in paths if path in found.numbers]
        self._orientation = [names.index(name) for name in names if name.startswith("orientation.")]
        self._nodes = slice(*found.arrays[0]) if found.arrays else None
        self._node_limits = _columns(finite_limits(spec.by_path.get(n)) for n in TETHER_COLUMNS)

    def extract(self, messages: Sequence[bytes]) -> ExtractedNumbers:
        """Extract the numbers of messages that have the length of the first."""
        table = np.frombuffer(b"".join(messages), dtype=np.uint8).reshape(len(messages), -1)
        accepted = (table[:, self._same] == self._expected).all(axis=1)
        seconds = _column(table, _STAMP, "<i4").astype(np.int64)
        stamp_ns = seconds * NANO + _column(table, _STAMP + 4, "<u4").astype(np.int64)
        numbers = np.empty((len(messages), len(self._offsets)))
        for column, offset in enumerate(self._offsets):
            numbers[:, column] = _column(table, offset, "<f8")
        accepted &= _within(numbers, self._low, self._high)
        if self._orientation:
            norm = np.linalg.norm(numbers[:, self._orientation], axis=1)
            accepted &= np.abs(norm - 1.0) <= _NORM_TOLERANCE
        values, nodes = numbers[:, self._columns], None
        if self._is_clock:
            values = np.asarray(stamp_ns[:, None] * 1e-9, dtype=np.float64)
            accepted &= stamp_ns >= 0
        if self._nodes is not None:
            block = np.ascontiguousarray(table[:, self._nodes]).view("<f8")
            nodes = block.reshape(len(messages), -1, len(TETHER_COLUMNS))
            for extreme in (nodes.min(axis=1), nodes.max(axis=1)):
                accepted &= _within(extreme, *self._node_limits)
        return ExtractedNumbers(accepted, stamp_ns, values, nodes)


def number_extractor(spec: Topic, data: bytes) -> NumberExtractor | None:
    """Return the extractor of the messages of a topic that match a valid one; None: there is none.

    Raises:
        Refusal: The message is not valid.
    """
    found = template(spec.name, data)
    if found is None:
        return None
    if spec.sample is TetherSample:
        return NumberExtractor(spec, found, ())
    paths = [path for path, _ in unpack(spec.name, data).scalars()]
    if spec.sample is not ClockSample and not found.numbers.keys() >= set(paths):
        return None  # the message leaves out numbers that have defaults
    return NumberExtractor(spec, found, paths)


def _columns(limits: Iterable[tuple[float, ...]]) -> tuple[Floats, Floats]:
    low, high = np.array(list(limits)).reshape(-1, 2).T
    return low, high


def _within(values: Floats, low: Floats, high: Floats) -> NDArray[np.bool_]:
    with np.errstate(invalid="ignore"):
        return np.asarray(((values >= low) & (values <= high)).all(axis=1))


def _column(table: NDArray[np.uint8], offset: int, kind: str) -> NDArray[Any]:
    width = np.dtype(kind).itemsize
    column: NDArray[Any] = np.ascontiguousarray(table[:, offset : offset + width]).view(kind)[:, 0]
    return column
