"""Bench of messages: CPU time to pack a sample into bytes, and to unpack it, with all checks."""

from __future__ import annotations

import time
import timeit
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

import numpy as np

from msg_schemas.cdr import pack, unpack
from msg_schemas.samples import (
    IDENTITY,
    TETHER_COLUMNS,
    ClockSample,
    ImuSample,
    JointSample,
    JointValue,
    OdometrySample,
    Sample,
    TetherSample,
    WrenchSample,
)
from msg_schemas.specifications import Topic
from msg_schemas.table import TOPICS
from rover_verify.bench.bench_row import Row, bench_row, text_table

CASE: Final = "messages"
HOT_RATE: Final = 50.0
"""Topics of this rate and above are measured [Hz]."""

_STAMP_NS: Final = 1_234_567_890
_VECTOR: Final = (0.0, 0.0, 0.0)
_NODES: Final = 51
_CALLS: Final = 500
_BATCHES: Final = 20  # for each repetition; the shortest counts


def hot_topics() -> list[Topic]:
    """Topics whose messages are sent often."""
    return [row for row in TOPICS.values() if row.rate is not None and row.rate >= HOT_RATE]


def sample_of(row: Topic) -> Sample:
    """Return a valid sample of a topic that is measured, with all its joints."""
    if row.sample is JointSample:
        names = (*row.joints, *row.optional_joints)
        return row.saturated(_STAMP_NS, {name: JointValue(0.1, 0.2, 0.3) for name in names})
    samples: tuple[Sample, ...] = (
        ClockSample(_STAMP_NS),
        ImuSample(_STAMP_NS, _VECTOR, _VECTOR),
        OdometrySample(_STAMP_NS, _VECTOR, IDENTITY, _VECTOR, _VECTOR),
        TetherSample(_STAMP_NS, np.ones((_NODES, len(TETHER_COLUMNS)))),
        WrenchSample(_STAMP_NS, _VECTOR),
    )
    return next(sample for sample in samples if isinstance(sample, row.sample))


def measure(repetitions: int) -> list[Row]:
    """One row for each hot topic."""
    rows = []
    for row in hot_topics():
        sample = sample_of(row)
        data = pack(row.name, sample)
        rows.append(
            bench_row(
                CASE,
                len(data),
                topic=row.name,
                message=row.message,
                pack_us=_microseconds(partial(pack, row.name, sample), repetitions),
                unpack_us=_microseconds(partial(unpack, row.name, data), repetitions),
            )
        )
    return rows


def _microseconds(call: Callable[[], object], repetitions: int) -> float:
    times = timeit.repeat(
        call, timer=time.process_time, number=_CALLS, repeat=_BATCHES * repetitions
    )
    return min(times) / _CALLS * 1e6


def table(rows: Sequence[Row]) -> str:
    """The rows as text for a terminal."""
    columns = (
        ("message", "topic", ""), ("bytes", "n", ""), ("pack us", "pack_us", ".1f"),
        ("unpack us", "unpack_us", ".1f"),
    )  # fmt: skip
    heading = f"messages of {HOT_RATE:g} Hz and more, checks included"
    return "\n".join([heading, *text_table(columns, rows)])
