"""Time series: the messages of one topic as arrays; long ones are thinned and keep extremes."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_schemas.refusal import read_refusal
from msg_schemas.samples import (
    TETHER_COLUMNS,
    DrawingSample,
    Level,
    Status,
    StatusSample,
    TetherSample,
    TextSample,
)
from msg_schemas.specifications import Intent, Topic
from msg_schemas.table import TOPICS

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

GAP: Final = 1.75
"""Number of periods from which a pause is a gap."""
LARGEST: Final = "largest.tension"
"""Column of the tether's time series: the largest tension along the tether [N]."""
_TENSION: Final = TETHER_COLUMNS.index("tension")
_DAY_NS: Final = 86_400_000_000_000
_SHAPES_PER_ROW: Final = 4
"""Memory of one tether shape, in rows of seven numbers, at least."""
_RATE_STEPS: Final = 64  # steps from which a topic's typical period is estimated
_MIN_RATE_STEPS: Final = 8  # below this the typical period is unknown
_FEW_SHAPES: Final = 256
_MAX_STATUSES: Final = 20_000
_MAX_TEXTS: Final = 100_000


@dataclass(frozen=True)
class TimeSeries:
    """The messages of one topic, in order of reception.

    A thinned series holds every ``stride``-th message and the extremes of the omitted ones.

    Attributes:
        topic: Contract topic name.
        full_name: Topic name in the bag.
        time: Simulated time of each message [s], shape (N,): its stamp, or the recorded clock at
            reception. Without a recorded clock, stamps are used unchanged.
        log_ns: Time of reception [ns since 1970], shape (N,).
        publish_ns: Time of publication [ns since 1970], shape (N,).
        columns: Values by the contract's field path, shape (N,) each, in the field's unit; NaN if
            a message of a topic with several kinds of requests lacks the field.
        nodes: Nodes of the tether, shape (N, n + 1, 7), columns as ``TETHER_COLUMNS``; None for
            other topics and if the number of nodes changes.
        texts: Contents of a text topic.
        statuses: Contents of a status topic.
        shapes: Nodes of the tether in each message, shape (n + 1, 7) each.
        stride: One of this many messages is held.
        low, high: Extremes of each column from one held message to the next, shape (N,) each;
            empty if all messages are held.
        stamp_ns: Stamps as published; 0 if there is none.
    """

    topic: str
    full_name: str
    time: Floats
    log_ns: Stamps
    publish_ns: Stamps
    columns: Mapping[str, Floats] = field(default_factory=dict)
    nodes: Floats | None = None
    texts: tuple[str, ...] = ()
    statuses: tuple[tuple[Status, ...], ...] = ()
    shapes: tuple[Floats, ...] = ()
    stride: int = 1
    low: Mapping[str, Floats] = field(default_factory=dict)
    high: Mapping[str, Floats] = field(default_factory=dict)
    stamp_ns: Stamps = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def __len__(self) -> int:
        return len(self.log_ns)

    def run_at(self, log_ns: int) -> TimeSeries:
        """Return the messages from the last reset of the clock before a log time to the next."""
        starts = np.flatnonzero(np.diff(self.time) < 0.0) + 1
        run = int(np.searchsorted(self.log_ns[starts], log_ns, side="right"))
        edges = [0, *starts.tolist(), len(self)]
        part = slice(edges[run], edges[run + 1])

        def cut(columns: Mapping[str, Floats]) -> dict[str, Floats]:
            return {path: column[part] for path, column in columns.items()}

        return replace(
            self,
            time=self.time[part],
            log_ns=self.log_ns[part],
            publish_ns=self.publish_ns[part],
            columns=cut(self.columns),
            nodes=None if self.nodes is None else self.nodes[part],
            texts=self.texts[part],
            statuses=self.statuses[part],
            shapes=self.shapes[part],
            low=cut(self.low),
            high=cut(self.high),
            stamp_ns=self.stamp_ns[part],
        )

    def vector(self, prefix: str, axes: str = "xyz") -> Floats:
        """Return the columns ``prefix.x``, ``prefix.y`` ... as one array, shape (N, len(axes))."""
        return np.stack([self.columns[f"{prefix}.{axis}"] for axis in axes], axis=1)

    def lowest(self, path: str) -> Floats:
        """Return the smallest value of a column from each held message to the next."""
        return self.low.get(path, self.columns[path])

    def highest(self, path: str) -> Floats:
        """Return the largest value of a column from each held message to the next."""
        return self.high.get(path, self.columns[path])

    def largest(self, prefix: str, axes: str = "xyz") -> Floats:
        """Return the largest norm of a vector from each held message to the next, shape (N,).

        For a thinned series with more than one axis this is an upper bound.
        """
        parts = [
            np.maximum(np.abs(self.lowest(path)), np.abs(self.highest(path)))
            for path in (f"{prefix}.{axis}" for axis in axes)
        ]
        return np.asarray(np.linalg.norm(np.stack(parts, axis=1), axis=1))

    @property
    def units(self) -> Mapping[str, str]:
        """Units of the table's columns; none for texts."""
        fields = {each.path: each.unit for each in TOPICS[self.topic].fields}
        units = {"time": "s", "log_ns": "ns", "publish_ns": "ns", "stamp_ns": "ns"}
        if self.shapes:
            units[LARGEST] = fields["tension"]
            return units | {f"nodes.{name}": fields[name] for name in TETHER_COLUMNS}
        return units | {path: fields[path] for path in self.columns}

    def table(self) -> dict[str, Any]:
        """Return the messages as columns of equal length, in the order of reception.

        The columns are the times, then the values by the contract's field path. A tether's message
        has a list over its nodes in each of ``nodes.x`` ... ``nodes.tension``, a text topic's the
        column ``text``. Each status of a status topic is a row, with its values as JSON.
        """
        times = {
            "time": self.time,
            "log_ns": self.log_ns,
            "publish_ns": self.publish_ns,
            "stamp_ns": self.stamp_ns,
        }
        if self.statuses:
            rows = np.repeat(np.arange(len(self)), [len(each) for each in self.statuses])
            statuses = [status for each in self.statuses for status in each]
            return {name: value[rows] for name, value in times.items()} | {
                "name": [each.name for each in statuses],
                "level": [each.level.name for each in statuses],
                "hardware_id": [each.hardware_id for each in statuses],
                "message": [each.message for each in statuses],
                "values": [json.dumps(dict(each.values)) for each in statuses],
            }
        nodes = {
            f"nodes.{name}": [shape[:, index] for shape in self.shapes]
            for index, name in enumerate(TETHER_COLUMNS)
            if self.shapes
        }
        texts = {"text": list(self.texts)} if self.texts else {}
        return {**times, **self.columns, **nodes, **texts}

    def to_pandas(self) -> Any:
        """Return the table as a pandas data frame; ``attrs["units"]`` has the units.

        Raises:
            ModuleNotFoundError: pandas is not installed.
        """
        import pyarrow as pa  # noqa: PLC0415 - slow, and seldom used

        frame = pa.table(self.table()).to_pandas()
        frame.attrs["units"] = dict(self.units)
        return frame


@dataclass
class MessageTiming:
    """Rate and gap statistics of a topic, from all of its messages.

    The pacing clock is simulated time, or the wall clock for status topics and unstamped messages.

    Attributes:
        count: Number of messages.
        first_log, last_log: Reception of the first and the last message [ns since 1970].
        first, last: Their times by the pacing clock [ns].
        widest: Longest pause by the pacing clock [ns].
        widest_at: Stamp and log time of the message before it.
        running: Total time of all runs by the pacing clock [ns].
        restarts: Number of resets of the pacing clock.
        delay: Longest time from publication to reception [ns] of messages published while the
            recorder was subscribed; None before the first.
        stamps: Smallest and largest stamp.
        by_log: Whether the pacing clock is the time of reception.
    """

    count: int = 0
    first_log: int = 0
    last_log: int = 0
    first: int = 0
    last: int = 0
    widest: int | None = None
    widest_at: tuple[int, int] = (0, 0)
    running: int = 0
    restarts: int = 0
    delay: int | None = None
    stamps: tuple[int, int] | None = None
    by_log: bool = False
    _promised: float = 0.0  # period [ns]
    _first_steps: Stamps = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    _typical: float = 0.0  # period of the first messages, if slower than the contract's
    _late_by_contract: int = 0  # steps of more than GAP contract periods
    _late_by_typical: int = 0  # steps of more than GAP typical periods

    def add(self, spec: Topic, stamp_ns: Stamps, log_ns: Stamps, publish_ns: Stamps) -> None:
        """Add messages."""
        # Nodes publish their status by the wall clock, which runs while simulated time is paused.
        if not self.count:
            self.by_log = spec.sample is StatusSample or not bool((stamp_ns > 0).any())
        by_log = self.by_log
        pacing = log_ns if by_log else stamp_ns
        if self.count:
            steps = np.diff(pacing, prepend=self.last)
        else:
            self.first_log, self.first = int(log_ns[0]), int(pacing[0])
            steps = np.diff(pacing)
        if len(steps):
            widest = int(np.argmax(steps))
            if self.widest is None or steps[widest] > self.widest:
                self.widest = int(steps[widest])
                before = widest - (1 if self.count else 0)
                if before >= 0:
                    self.widest_at = (int(stamp_ns[before]), int(log_ns[before]))
                else:
                    self.widest_at = (0 if by_log else self.last, self.last_log)
            self.running += int(np.maximum(steps, 0).sum())
            self.restarts += int((steps < 0).sum())
            if spec.rate is not None:
                self._count_gaps(steps, 1e9 / spec.rate)
        while_listening = publish_ns >= self.first_log
        if while_listening.any():
            longest = int((log_ns - publish_ns)[while_listening].max())
            self.delay = longest if self.delay is None else max(self.delay, longest)
        low, high = int(stamp_ns.min()), int(stamp_ns.max())
        if self.stamps is not None:
            low, high = min(low, self.stamps[0]), max(high, self.stamps[1])
        self.stamps = (low, high)
        self.last, self.last_log = int(pacing[-1]), int(log_ns[-1])
        self.count += len(log_ns)

    @property
    def is_slow(self) -> bool:
        """Whether most messages came more slowly than the contract's rate, from the first on."""
        return self._typical > self._promised and 2 * self._late_by_contract > self.count - 1

    @property
    def period(self) -> float:
        """The contract's period, or the typical period of a slow topic [ns]."""
        return self._typical if self.is_slow else self._promised

    @property
    def gaps(self) -> int:
        """Number of pauses of more than 1.75 periods."""
        return self._late_by_typical if self.is_slow else self._late_by_contract

    def _count_gaps(self, steps: Stamps, promised: float) -> None:
        """Count pauses against the contract's period and the typical period of the first steps."""
        self._promised = promised
        self._late_by_contract += int((steps > GAP * promised).sum())
        if len(self._first_steps) >= _RATE_STEPS:
            self._late_by_typical += int((steps > GAP * self._typical).sum())
            return
        self._first_steps = np.concatenate([self._first_steps, steps])
        self._typical = typical_period(self._first_steps, promised)
        self._late_by_typical = int((self._first_steps > GAP * self._typical).sum())


class MessageBlock(NamedTuple):
    """Decoded messages of one topic with the same fields."""

    log_ns: Stamps
    publish_ns: Stamps
    stamp_ns: Stamps
    paths: tuple[str, ...]
    values: Floats
    shapes: list[Floats]
    samples: list[Any]  # of text and status topics


class TimeSeriesBuilder:
    """Builds a time series while its bag is read.

    Args:
        spec: The topic in the contract.
        full_name: Topic name in the bag.
        max_messages: Messages to hold; None = all.
    """

    def __init__(self, spec: Topic, full_name: str, max_messages: int | None = None) -> None:
        self.spec = spec
        self.full_name = full_name
        self.timing = MessageTiming()
        self.stride = 1
        self._is_tether = spec.sample is TetherSample
        self._max_messages = max_messages
        self._count = 0
        self._paths: list[str] = []
        # Columns that the contract fixes at 0 are not stored.
        self._zero = {f.path for f in spec.fields if f.minimum == 0.0 == f.maximum}
        self._published_zero: list[str] = []
        self._order: list[str] = []
        self._log: list[Stamps] = []
        self._publish: list[Stamps] = []
        self._stamp: list[Stamps] = []
        self._values: list[Floats] = []
        self._low: list[Floats] = []
        self._high: list[Floats] = []
        self._shapes: list[Floats] = []
        self._texts: list[str] = []
        self._statuses: list[tuple[Status, ...]] = []
        self._held = 0

    def add(self, block: MessageBlock) -> None:
        """Add a block of messages."""
        if not len(block.log_ns):
            return
        self.timing.add(self.spec, block.stamp_ns, block.log_ns, block.publish_ns)
        if block.samples:
            block = self._chosen(block)
            if not len(block.log_ns):
                return
        values = self._placed(block)
        kept = np.flatnonzero((self._count + np.arange(len(block.log_ns))) % self.stride == 0)
        if block.samples:
            kept = np.arange(len(block.log_ns))  # already selected
        if self.stride > 1 and values.shape[1]:
            self._note_extremes(values, kept)
        self._count += len(block.log_ns)
        if not len(kept):
            return
        self._log.append(block.log_ns[kept])
        self._publish.append(block.publish_ns[kept])
        self._stamp.append(block.stamp_ns[kept])
        self._values.append(values[kept])
        if block.shapes:
            # Copy, so that a held shape does not keep its whole block in memory.
            self._shapes += [block.shapes[index].copy() for index in kept.tolist()]
        self._held += len(kept)
        while self._too_long():
            self._halve()

    def _chosen(self, block: MessageBlock) -> MessageBlock:
        """Select the text and status messages to keep; of many statuses, only those of note."""
        chosen = []
        for index, sample in enumerate(block.samples):
            if isinstance(sample, TextSample):
                if self._max_messages is None or len(self._texts) < _MAX_TEXTS:
                    self._texts.append(sample.text)
                    chosen.append(index)
            elif self._max_messages is None or self._is_notable(sample, self._count + index):
                self._statuses.append(sample.statuses)
                chosen.append(index)
        part = np.array(chosen, dtype=np.intp)
        return block._replace(
            log_ns=block.log_ns[part],
            publish_ns=block.publish_ns[part],
            stamp_ns=block.stamp_ns[part],
            values=block.values[part],
            samples=[block.samples[index] for index in chosen],
        )

    def _is_notable(self, sample: StatusSample, count: int) -> bool:
        if len(self._statuses) >= _MAX_STATUSES:
            return False
        if self.spec.intent is Intent.EVENT or count < _FEW_SHAPES:
            return True
        return any(s.level is not Level.OK or read_refusal(s) is not None for s in sample.statuses)

    def _placed(self, block: MessageBlock) -> Floats:
        """Values arranged in this series' columns."""
        for path in block.paths:
            if path not in self._order:
                self._order.append(path)
                if path in self._zero:
                    self._published_zero.append(path)
                else:
                    self._paths.append(path)
                    for tables in (self._values, self._low, self._high):
                        for index, table in enumerate(tables):
                            tables[index] = np.pad(
                                table, ((0, 0), (0, 1)), constant_values=math.nan
                            )
        own_paths = list(self._paths)
        if list(block.paths) == own_paths:
            return block.values
        place = {path: column for column, path in enumerate(block.paths)}
        values = np.full((len(block.log_ns), len(own_paths)), math.nan)
        for column, path in enumerate(own_paths):
            if path in place:
                values[:, column] = block.values[:, place[path]]
        return values

    # --- thinning --------------------------------------------------------------------------------

    def _too_long(self) -> bool:
        if self._max_messages is None or self._texts or self._statuses:
            return False
        if self._is_tether:
            room = sum(shape.size for shape in self._shapes[:1]) * len(self._shapes)
            if room > 2 * _SHAPES_PER_ROW * self._max_messages * _NODE_NUMBERS:
                return len(self._shapes) > _FEW_SHAPES
        return self._held > 2 * self._max_messages

    def _note_extremes(self, values: Floats, kept: NDArray[np.intp]) -> None:
        """Update the extremes from each kept message to the next."""
        lead = int(kept[0]) if len(kept) else len(values)
        if lead and self._low:
            before = values[:lead]
            self._low[-1][-1] = np.fmin(self._low[-1][-1], np.fmin.reduce(before, axis=0))
            self._high[-1][-1] = np.fmax(self._high[-1][-1], np.fmax.reduce(before, axis=0))
        if len(kept):
            self._low.append(np.fmin.reduceat(values, kept, axis=0))
            self._high.append(np.fmax.reduceat(values, kept, axis=0))

    def _halve(self) -> None:
        """Keep every second message only."""
        values = np.concatenate(self._values)
        low = np.concatenate(self._low) if self._low else values
        high = np.concatenate(self._high) if self._high else values
        if values.shape[1]:
            pairs = np.arange(0, len(values), 2)
            self._low = [np.fmin.reduceat(low, pairs, axis=0)]
            self._high = [np.fmax.reduceat(high, pairs, axis=0)]
        self._values = [values[::2].copy()]
        for stamps in (self._log, self._publish, self._stamp):
            stamps[:] = [np.concatenate(stamps)[::2].copy()]
        self._shapes = self._shapes[::2]
        self._held = len(self._log[0])
        self.stride *= 2

    # --- result ------------------------------------------------------------------------------

    @property
    def clock_stamps(self) -> tuple[Stamps, Stamps]:
        """Log times and stamps held so far [ns]."""
        return _joined(self._log), _joined(self._stamp)

    def build(self, clock: Clock) -> TimeSeries:
        """Return the time series."""
        log_ns, stamp_ns = self.clock_stamps
        columns, low, high = self._columns(len(log_ns))
        same = len({shape.shape for shape in self._shapes}) == 1
        return TimeSeries(
            topic=self.spec.name,
            full_name=self.full_name,
            time=clock.times(stamp_ns, log_ns),
            log_ns=log_ns,
            publish_ns=_joined(self._publish),
            columns=columns,
            nodes=np.stack(self._shapes) if same else None,
            texts=tuple(self._texts),
            statuses=tuple(self._statuses),
            shapes=tuple(self._shapes),
            stride=self.stride,
            low=low,
            high=high,
            stamp_ns=stamp_ns,
        )

    def _columns(
        self, count: int
    ) -> tuple[dict[str, Floats], dict[str, Floats], dict[str, Floats]]:
        found = []
        for tables in (self._values, self._low, self._high):
            table = np.concatenate(tables) if tables else np.zeros((0, len(self._paths)))
            tables.clear()
            found.append({path: table[:, column] for column, path in enumerate(self._paths)})
        values, low, high = found
        zeros = np.broadcast_to(0.0, (count,))
        columns = {path: values.get(path, zeros) for path in self._order}
        if self.stride == 1:
            return columns, {}, {}
        return columns, low, high


_NODE_NUMBERS: Final = len(TETHER_COLUMNS)


def typical_period(steps: NDArray[Any], promised: float) -> float:
    """Return the period against which gaps are counted.

    It is the contract's period, or the median period of a topic that is slower throughout.

    Args:
        steps: Time from each message to the next, in any unit, shape (N,).
        promised: The contract's period, in the same unit.
    """
    ahead = steps[steps > 0]
    typical = float(np.median(ahead)) if len(ahead) >= _MIN_RATE_STEPS else 0.0
    return typical if typical > GAP * promised else promised


def pacing_times(series: TimeSeries) -> Floats:
    """Return message times [s], shape (N,), by the pacing clock.

    Status topics are paced by the wall clock, all others by simulated time.
    """
    if TOPICS[series.topic].sample is StatusSample:
        since: Floats = (series.log_ns - series.log_ns[0]) * 1e-9
        return since
    return series.time


def _joined(parts: list[Stamps]) -> Stamps:
    return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)


def blocks_of_samples(items: Iterable[tuple[int, int, Any]]) -> list[MessageBlock]:
    """Convert decoded messages (log time, publication time, sample) into blocks of one each."""
    found: list[MessageBlock] = []
    for log_ns, publish_ns, sample in items:
        stamp = getattr(sample, "stamp_ns", 0)
        shapes: list[Floats] = []
        samples: list[Any] = []
        pairs: dict[str, float] = {}
        if isinstance(sample, TetherSample):
            shapes = [sample.nodes]
            pairs = {LARGEST: float(sample.nodes[:, _TENSION].max())}
        elif isinstance(sample, TextSample | StatusSample):
            samples = [sample]
        elif not isinstance(sample, DrawingSample):
            pairs = dict(sample.scalars())
        found.append(
            MessageBlock(
                np.array([log_ns], dtype=np.int64),
                np.array([publish_ns], dtype=np.int64),
                np.array([stamp], dtype=np.int64),
                tuple(pairs),
                np.array([list(pairs.values())]),
                shapes,
                samples,
            )
        )
    return found


def largest_tensions(nodes: Floats) -> Floats:
    """Return the largest tension along the tether [N], shape (N, 1), of nodes (N, n + 1, 7)."""
    return np.asarray(nodes[:, :, _TENSION].max(axis=1)[:, None])


class Clock:
    """Converts stamps and log times into seconds on one time axis.

    With a recorded clock the axis is simulated time. A stamp far outside the clock's range comes
    from a node that does not use simulated time; its time of reception is used instead.

    Args:
        builder: The clock topic; None if it is not recorded.
        start_ns: Log time of the bag's first message.
        first: Stamp and log time of the first stamped message.
    """

    _SLACK_NS = 1_000_000_000

    def __init__(
        self, builder: TimeSeriesBuilder | None, start_ns: int, first: tuple[int, int] | None
    ) -> None:
        self._start_ns = start_ns
        empty = np.zeros(0, dtype=np.int64)
        logs, stamps = builder.clock_stamps if builder else (empty, empty)
        # Time jumps at a reset: what follows the last message before it is after it.
        back = np.flatnonzero(np.diff(stamps) < 0)
        self._log = np.insert(logs, back + 1, logs[back] + 1)
        self._stamp = np.insert(stamps, back + 1, stamps[back + 1])
        self._range = (builder.timing.stamps if builder else None) or (0, 0)
        stamp, log = first or (start_ns, start_ns)
        self._behind = log - stamp
        # Stamps near the wall time are wall time; others count from their own zero.
        self._origin = start_ns if abs(self._behind) < _DAY_NS else 0

    @property
    def is_recorded(self) -> bool:
        """Whether the bag holds a clock."""
        return bool(len(self._stamp))

    def at_reception(self, log_ns: Stamps) -> Floats:
        """Return simulated time at the reception of messages [ns]."""
        clock_ns: Floats = np.interp(
            (log_ns - self._start_ns).astype(np.float64),
            (self._log - self._start_ns).astype(np.float64),
            self._stamp.astype(np.float64),
        )
        return clock_ns

    def reception(self, times: Floats) -> Floats:
        """Return when times of the axis were received [s], since the bag's start, shape (N,).

        For a clock that never restarts; without a recorded one the times themselves.
        """
        if not self.is_recorded:
            return times
        received_ns = (self._log - self._start_ns).astype(np.float64)
        return np.asarray(np.interp(times, self._stamp * 1e-9, received_ns) * 1e-9)

    def times(self, stamp_ns: Stamps, log_ns: Stamps) -> Floats:
        """Return the times of messages [s], shape (N,), from stamps and log times [ns]."""
        if not self.is_recorded:
            clock_ns = np.where(stamp_ns > 0, stamp_ns, log_ns - self._behind)
            return np.asarray((clock_ns - self._origin) * 1e-9)
        low, high = self._range[0] - self._SLACK_NS, self._range[1] + self._SLACK_NS
        follows = (stamp_ns > 0) & (stamp_ns >= low) & (stamp_ns <= high)
        arrived = self.at_reception(log_ns)
        return np.asarray(np.where(follows, stamp_ns.astype(np.float64), arrived) * 1e-9)
