"""Tracks: all that one topic said, as arrays; long ones thinned, with their extremes kept."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_schemas.samples import (
    TETHER_COLUMNS,
    DrawingSample,
    Level,
    Status,
    StatusSample,
    TetherSample,
    TextSample,
)
from msg_schemas.table import TOPICS, Intent, Topic

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

GAP: Final = 1.75
"""A pause longer than so many periods is a gap."""
LARGEST: Final = "largest.tension"
"""Column of the tether's track: the largest tension along it [N]."""
_TENSION: Final = TETHER_COLUMNS.index("tension")
_DAY_NS: Final = 86_400_000_000_000
_SHAPES_PER_ROW: Final = 4
"""A shape of the tether takes as much room as so many rows, at least."""
_TELLING: Final = 64  # steps that tell how often a topic comes
_FEWEST: Final = 8  # steps without which that is not known
_FEW_SHAPES: Final = 256
_MOST_STATUSES: Final = 20_000
_MOST_TEXTS: Final = 100_000


@dataclass(frozen=True)
class TimeSeries:
    """All that one topic said, in the order of its arrival.

    A track that was asked to be no longer than so many messages holds every ``stride``-th one of
    them, and of those left out the extremes.

    Attributes:
        topic: Name in the contract's table.
        full_name: Name in the bag.
        time: Simulated time of each message [s], shape (N,): its own stamp, or the recorded
            clock's time when it came. Without a recorded clock stamps are taken as they are.
        log_ns: When it was received [ns since 1970], shape (N,).
        publish_ns: When it was sent [ns since 1970], shape (N,).
        columns: Numbers by the contract's field path, shape (N,) each, in the field's unit; NaN
            where a message of a topic with several kinds of requests had no such field.
        nodes: The tether's nodes, shape (N, n + 1, 7), columns as ``TETHER_COLUMNS``; None for
            other topics and where the number of nodes changes.
        texts: What a text topic said.
        statuses: What a status topic said.
        shapes: The tether's nodes of each message, shape (n + 1, 7) each, whatever their number.
        stride: Of so many messages one is held.
        low, high: Extremes of each column from one message held to the next, shape (N,) each;
            empty where all are held.
        stamp_ns: Stamps as sent; 0 where there is none.
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

    def vector(self, prefix: str, axes: str = "xyz") -> Floats:
        """Columns ``prefix.x``, ``prefix.y`` ... side by side, shape (N, len(axes))."""
        return np.stack([self.columns[f"{prefix}.{axis}"] for axis in axes], axis=1)

    def lowest(self, path: str) -> Floats:
        """Smallest value of a column from each message to the next one held."""
        return self.low.get(path, self.columns[path])

    def highest(self, path: str) -> Floats:
        """Largest value of a column from each message to the next one held."""
        return self.high.get(path, self.columns[path])

    def largest(self, prefix: str, axes: str = "xyz") -> Floats:
        """Largest length of a vector from each message to the next one held, shape (N,).

        Of a thinned track of more than one axis an upper bound.
        """
        parts = [
            np.maximum(np.abs(self.lowest(path)), np.abs(self.highest(path)))
            for path in (f"{prefix}.{axis}" for axis in axes)
        ]
        return np.asarray(np.linalg.norm(np.stack(parts, axis=1), axis=1))


@dataclass
class Pace:
    """How the messages of a topic followed one another, told of every one.

    Attributes:
        count: Messages.
        first_log, last_log: When the first and the last were received [ns since 1970].
        first, last: The same by the clock that paces the topic [ns].
        widest: Longest pause by that clock [ns].
        widest_at: Stamp and log time of the message before it.
        running: Time that all runs took by that clock [ns], from each first message to its last.
        restarts: How often that clock was put back.
        delay: Longest time from sending to reception [ns], of what was sent while the recorder
            listened; None before the first.
        stamps: Smallest and largest stamp.
        by_log: Whether the time of reception paces the topic, as it has no stamps.
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
    _early: Stamps = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    _usual: float = 0.0  # period of the first messages, where they came more slowly than promised
    _late: int = 0  # steps of more than GAP of the promised period
    _later: int = 0  # of more than GAP of the usual one

    def add(self, row: Topic, stamp_ns: Stamps, log_ns: Stamps, publish_ns: Stamps) -> None:
        """Take further messages."""
        # Nodes tell how they are by the machine's clock, which runs while simulated time stands.
        if not self.count:
            self.by_log = row.sample is StatusSample or not bool((stamp_ns > 0).any())
        by_log = self.by_log
        paced = log_ns if by_log else stamp_ns
        if self.count:
            steps = np.diff(paced, prepend=self.last)
        else:
            self.first_log, self.first = int(log_ns[0]), int(paced[0])
            steps = np.diff(paced)
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
            if row.rate is not None:
                self._look_for_gaps(steps, 1e9 / row.rate)
        heard = publish_ns >= self.first_log
        if heard.any():
            longest = int((log_ns - publish_ns)[heard].max())
            self.delay = longest if self.delay is None else max(self.delay, longest)
        low, high = int(stamp_ns.min()), int(stamp_ns.max())
        if self.stamps is not None:
            low, high = min(low, self.stamps[0]), max(high, self.stamps[1])
        self.stamps = (low, high)
        self.last, self.last_log = int(paced[-1]), int(log_ns[-1])
        self.count += len(log_ns)

    @property
    def is_slow(self) -> bool:
        """Whether most messages came more slowly than promised, from the first on."""
        return self._usual > self._promised and 2 * self._late > self.count - 1

    @property
    def period(self) -> float:
        """Promised, or the usual one of a topic that is slow [ns]."""
        return self._usual if self.is_slow else self._promised

    @property
    def gaps(self) -> int:
        """Pauses of more than 1.75 of these periods."""
        return self._later if self.is_slow else self._late

    def _look_for_gaps(self, steps: Stamps, promised: float) -> None:
        """Count pauses, once the first steps have told how often the topic comes at all."""
        self._promised = promised
        self._late += int((steps > GAP * promised).sum())
        if len(self._early) >= _TELLING:
            self._later += int((steps > GAP * self._usual).sum())
            return
        self._early = np.concatenate([self._early, steps])
        self._usual = usual_period(self._early, promised)
        self._later = int((self._early > GAP * self._usual).sum())


class Rows(NamedTuple):
    """Some messages of one topic, taken apart."""

    log_ns: Stamps
    publish_ns: Stamps
    stamp_ns: Stamps
    paths: tuple[str, ...]
    values: Floats
    shapes: list[Floats]
    samples: list[Any]  # of text and status topics


class GrowingTimeSeries:
    """A track while it is read.

    Args:
        row: Of the contract's table.
        full_name: Name in the bag.
        most: Messages to hold; None = all.
    """

    def __init__(self, row: Topic, full_name: str, most: int | None = None) -> None:
        self.row = row
        self.full_name = full_name
        self.pace = Pace()
        self.stride = 1
        self._is_tether = row.sample is TetherSample
        self._most = most
        self._count = 0
        self._paths: list[str] = []
        # A number that the contract holds at 0 needs no room.
        self._zero = {f.path for f in row.fields if f.minimum == 0.0 == f.maximum}
        self._told_zero: list[str] = []
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

    def add(self, rows: Rows) -> None:
        """Take further messages, all of one kind."""
        if not len(rows.log_ns):
            return
        self.pace.add(self.row, rows.stamp_ns, rows.log_ns, rows.publish_ns)
        if rows.samples:
            rows = self._chosen(rows)
            if not len(rows.log_ns):
                return
        values = self._placed(rows)
        kept = np.flatnonzero((self._count + np.arange(len(rows.log_ns))) % self.stride == 0)
        if rows.samples:
            kept = np.arange(len(rows.log_ns))  # chosen already
        if self.stride > 1 and values.shape[1]:
            self._note_extremes(values, kept)
        self._count += len(rows.log_ns)
        if not len(kept):
            return
        self._log.append(rows.log_ns[kept])
        self._publish.append(rows.publish_ns[kept])
        self._stamp.append(rows.stamp_ns[kept])
        self._values.append(values[kept])
        if rows.shapes:
            # A copy, so that no block of messages is kept for the sake of one of them.
            self._shapes += [rows.shapes[index].copy() for index in kept.tolist()]
        self._held += len(kept)
        while self._too_long():
            self._halve()

    def _chosen(self, rows: Rows) -> Rows:
        """Text and status messages that are kept; what is well and tells nothing new is not."""
        chosen = []
        for index, sample in enumerate(rows.samples):
            if isinstance(sample, TextSample):
                if self._most is None or len(self._texts) < _MOST_TEXTS:
                    self._texts.append(sample.text)
                    chosen.append(index)
            elif self._most is None or self._is_of_note(sample, self._count + index):
                self._statuses.append(sample.statuses)
                chosen.append(index)
        part = np.array(chosen, dtype=np.intp)
        return rows._replace(
            log_ns=rows.log_ns[part],
            publish_ns=rows.publish_ns[part],
            stamp_ns=rows.stamp_ns[part],
            values=rows.values[part],
            samples=[rows.samples[index] for index in chosen],
        )

    def _is_of_note(self, sample: StatusSample, count: int) -> bool:
        if len(self._statuses) >= _MOST_STATUSES:
            return False
        if self.row.intent is Intent.EVENT or count < _FEW_SHAPES:
            return True
        return any(s.level is not Level.OK or "code" in s.values for s in sample.statuses)

    def _placed(self, rows: Rows) -> Floats:
        """Values in this track's columns."""
        for path in rows.paths:
            if path not in self._order:
                self._order.append(path)
                if path in self._zero:
                    self._told_zero.append(path)
                else:
                    self._paths.append(path)
                    for tables in (self._values, self._low, self._high):
                        for index, table in enumerate(tables):
                            tables[index] = np.pad(
                                table, ((0, 0), (0, 1)), constant_values=math.nan
                            )
        wanted = list(self._paths)
        if list(rows.paths) == wanted:
            return rows.values
        place = {path: column for column, path in enumerate(rows.paths)}
        values = np.full((len(rows.log_ns), len(wanted)), math.nan)
        for column, path in enumerate(wanted):
            if path in place:
                values[:, column] = rows.values[:, place[path]]
        return values

    # --- thinning --------------------------------------------------------------------------------

    def _too_long(self) -> bool:
        if self._most is None or self._texts or self._statuses:
            return False
        if self._is_tether:
            room = sum(shape.size for shape in self._shapes[:1]) * len(self._shapes)
            if room > 2 * _SHAPES_PER_ROW * self._most * _NODE_NUMBERS:
                return len(self._shapes) > _FEW_SHAPES
        return self._held > 2 * self._most

    def _note_extremes(self, values: Floats, kept: NDArray[np.intp]) -> None:
        """Extremes from each message that is kept to the next."""
        lead = int(kept[0]) if len(kept) else len(values)
        if lead and self._low:
            before = values[:lead]
            self._low[-1][-1] = np.fmin(self._low[-1][-1], np.fmin.reduce(before, axis=0))
            self._high[-1][-1] = np.fmax(self._high[-1][-1], np.fmax.reduce(before, axis=0))
        if len(kept):
            self._low.append(np.fmin.reduceat(values, kept, axis=0))
            self._high.append(np.fmax.reduceat(values, kept, axis=0))

    def _halve(self) -> None:
        """Hold every second message only."""
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

    # --- the end ---------------------------------------------------------------------------------

    @property
    def clock_rows(self) -> tuple[Stamps, Stamps]:
        """Log times and stamps held so far."""
        return _joined(self._log), _joined(self._stamp)

    def finished(self, clock: Clock) -> TimeSeries:
        """The track."""
        log_ns, stamp_ns = self.clock_rows
        columns, low, high = self._columns(len(log_ns))
        same = len({shape.shape for shape in self._shapes}) == 1
        return TimeSeries(
            topic=self.row.name,
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


def usual_period(steps: NDArray[Any], promised: float) -> float:
    """Period by which gaps are judged: what was promised, or longer where all come more slowly.

    Args:
        steps: From each message to the next, in any unit of time, shape (N,).
        promised: Period, in the same unit.
    """
    ahead = steps[steps > 0]
    usual = float(np.median(ahead)) if len(ahead) >= _FEWEST else 0.0
    return usual if usual > GAP * promised else promised


def paced(track: TimeSeries) -> Floats:
    """Times [s] by the clock that paces a topic.

    Nodes tell how they are by the machine's clock, so that they do also while simulated time
    stands still; everything else goes by simulated time.
    """
    if TOPICS[track.topic].sample is StatusSample:
        since: Floats = (track.log_ns - track.log_ns[0]) * 1e-9
        return since
    return track.time


def _joined(parts: list[Stamps]) -> Stamps:
    return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)


def samples_topics(items: Iterable[tuple[int, int, Any]]) -> list[Rows]:
    """Decoded messages (log time, publish time, sample) as rows; neighbours of a kind together."""
    found: list[Rows] = []
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
            Rows(
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
    """Largest tension along the tether, shape (N, 1), of nodes, shape (N, n + 1, 7)."""
    return np.asarray(nodes[:, :, _TENSION].max(axis=1)[:, None])


class Clock:
    """Turns stamps and log times into seconds of one time axis.

    With a recorded clock that axis is simulated time; a stamp far outside the clock's range
    comes from a node that does not follow it, and the time of arrival is taken instead.

    Args:
        growing: What the clock told; None where it is not recorded.
        start_ns: Log time of the bag's first message.
        first: Stamp and log time of the first stamped message.
    """

    _SLACK_NS = 1_000_000_000

    def __init__(
        self, growing: GrowingTimeSeries | None, start_ns: int, first: tuple[int, int] | None
    ) -> None:
        self._start_ns = start_ns
        empty = np.zeros(0, dtype=np.int64)
        self._log, self._stamp = growing.clock_rows if growing else (empty, empty)
        self._range = (growing.pace.stamps if growing else None) or (0, 0)
        stamp, log = first or (start_ns, start_ns)
        self._behind = log - stamp
        # Stamps near the machine's time are that time; others count from their own zero.
        self._origin = start_ns if abs(self._behind) < _DAY_NS else 0

    @property
    def is_recorded(self) -> bool:
        """Whether the bag holds a clock."""
        return bool(len(self._stamp))

    def arrivals(self, log_ns: Stamps) -> Floats:
        """What the clock told when messages arrived [ns]."""
        told: Floats = np.interp(
            (log_ns - self._start_ns).astype(np.float64),
            (self._log - self._start_ns).astype(np.float64),
            self._stamp.astype(np.float64),
        )
        return told

    def times(self, stamp_ns: Stamps, log_ns: Stamps) -> Floats:
        """Seconds of messages by stamp and time of arrival, shape (N,)."""
        if not self.is_recorded:
            told = np.where(stamp_ns > 0, stamp_ns, log_ns - self._behind)
            return np.asarray((told - self._origin) * 1e-9)
        low, high = self._range[0] - self._SLACK_NS, self._range[1] + self._SLACK_NS
        follows = (stamp_ns > 0) & (stamp_ns >= low) & (stamp_ns <= high)
        arrived = self.arrivals(log_ns)
        return np.asarray(np.where(follows, stamp_ns.astype(np.float64), arrived) * 1e-9)
