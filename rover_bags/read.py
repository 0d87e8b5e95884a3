"""Reads a bag into typed tracks: numpy arrays by topic, as the contract's table names them.

Reads whatever its recorder left: bags of this suite and of ``ros2 bag record``, MCAP or SQLite,
split, compressed, closed or killed, with or without ``metadata.yaml``. Every chunk is checked
against its checksum, every message against the contract; what fails is counted and named, and
nothing wrong is returned. What no checksum protects is counted as such.

However long the bag is, tracks can be asked to hold no more than so many messages; stretches of it
are then read again in full.

Nothing here needs ROS.
"""

import json
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path
from typing import Any, Final

import numpy as np
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from msg_schemas import topics
from msg_schemas.codecs import decode
from msg_schemas.refusal import Refusal
from msg_schemas.table import TOPICS
from rover_bags.files.records import Damage, Message
from rover_bags.files.scan import BagScan
from rover_bags.files.store import IDENTITY_RECORD, LOSSES_RECORD, BagError
from rover_bags.layouts import Layout, layout_of
from rover_bags.time_series import (
    LARGEST,
    Clock,
    Floats,
    GrowingTimeSeries,
    Pace,
    Rows,
    Stamps,
    TimeSeries,
    largest_tensions,
    samples_topics,
)

__all__ = [
    "Arrival", "Bag", "Floats", "ReadError", "Rejected", "Stamps", "TimeSeries", "arrivals",
    "read_bag", "windows",
]  # fmt: skip

Progress = Callable[[int], None]
"""Told how many bytes of the bag have been read."""

_STORE: Final[Typestore] = get_typestore(Stores.ROS2_JAZZY)
_EXAMPLES: Final = 5
_BLOCK: Final = 512
"""So many messages of a topic are taken apart at once."""
_TOLD_EVERY: Final = 4096
_LEADING: Final = 4096
"""A recorder that tells who it is does so before so many messages."""
_FINER: Final = 8
_FINE: Final = frozenset(
    {
        topics.CONTACT,
        topics.WINCH_STATE,
        topics.WHEEL_STATE,
        topics.JUMP_MOTOR_STATE,
        topics.ROVER_LOAD_CELL,
        topics.MOTOR_CURRENTS,
    }
)
"""By these activities are told apart: their tracks may hold so many times more messages."""


class ReadError(BagError):
    """A bag from which nothing can be told; the text says why."""


@dataclass(frozen=True)
class Rejected:
    """A recorded message that the contract turns away."""

    topic: str
    log_ns: int
    reason: str


@dataclass(frozen=True)
class Bag:
    """A bag in memory.

    Attributes:
        path: Where it is.
        namespace: Of the rover that was read.
        start_ns: Log time of the first message [ns since 1970].
        duration: From the first to the last message, machine's time [s].
        tracks: What was read, by the contract's topic name.
        counts: Messages by full topic name, of every topic in the bag.
        types: Message type by full topic name.
        full_names: Full topic name by the contract's, for topics that are in the bag.
        identity: Versions and settings that the recorder wrote; empty for foreign bags.
        configurations: Latched configurations of the nodes, in their order.
        dropped, missed: Messages by full topic name that the recorder could not keep, and that
            were lost before they reached it.
        closed: Whether the recorder closed the bag.
        damage: Stretches of the files that were left out.
        remarks: What its files lack, in words.
        lost: Messages by full topic name that the bag should hold, as it counts them itself, and
            that could not be read.
        unverified: Messages that no checksum protects, by full topic name.
        rejected: Messages that the contract turns away, by its topic name.
        examples: The first few of those.
        paces: How the messages of each topic read followed one another, by the contract's name.
        clock: Turns stamps into the tracks' time.
    """

    path: Path
    namespace: str
    start_ns: int
    duration: float
    tracks: Mapping[str, TimeSeries]
    counts: Mapping[str, int]
    types: Mapping[str, str]
    full_names: Mapping[str, str]
    identity: Mapping[str, str]
    configurations: tuple[Mapping[str, Any], ...]
    dropped: Mapping[str, int]
    missed: Mapping[str, int]
    closed: bool
    damage: tuple[Damage, ...]
    remarks: tuple[str, ...]
    lost: Mapping[str, int]
    unverified: Mapping[str, int]
    rejected: Mapping[str, int]
    examples: tuple[Rejected, ...]
    paces: Mapping[str, Pace] = field(default_factory=dict)
    clock: Clock | None = None

    def track(self, topic: str) -> TimeSeries | None:
        """The track of a topic, None where the bag holds no good message of it."""
        found = self.tracks.get(topic)
        return found if found is not None and len(found) else None

    @property
    def scenario(self) -> Mapping[str, Any]:
        """The simulated scenario as configured, empty where no configuration tells."""
        for configuration in self.configurations:
            scenario = configuration.get("scenario")
            if isinstance(scenario, Mapping):
                return scenario
        return {}

    @property
    def thinned(self) -> bool:
        """Whether tracks hold only a part of their messages."""
        return any(track.stride > 1 for track in self.tracks.values())

    @property
    def seed(self) -> int | None:
        """Seed of the simulation."""
        return next((c["seed"] for c in self.configurations if "seed" in c), None)


@dataclass(frozen=True)
class Arrival:
    """One accepted message of a contract topic.

    Attributes:
        name: Contract topic.
        log_ns, publish_ns: When it was received and sent [ns since 1970].
        sequence: The publisher's count.
        sample: What it says.
        message: The message itself.
    """

    name: str
    log_ns: int
    publish_ns: int
    sequence: int
    sample: Any
    message: Any


def arrivals(
    scan: BagScan, wanted: Collection[str] | None = None, *, namespace: str | None = None
) -> Iterator[Arrival]:
    """Yields a bag's accepted messages one by one, in the order of the file.

    Args:
        scan: Of the bag; complete when the iteration is.
        wanted: Contract topics to decode; all but the markers by default.
        namespace: Which rover, where the bag holds several.

    Raises:
        ScanError: It is no bag.
        ReadError: It holds several rovers and no ``namespace``.
    """
    decoded = set(TOPICS) - {topics.MARKERS} if wanted is None else set(wanted)
    full_names, _ = _names(scan.path, namespace)
    by_full_name = {full: name for name, full in full_names.items() if name in decoded}
    for item in scan:
        name = by_full_name.get(item.topic.name)
        if name is None:
            continue
        try:
            message = _message(name, item)
            sample = decode(name, message)
        except (Refusal, SerdeError, KeyError):
            continue
        yield Arrival(name, item.log_ns, item.publish_ns, item.sequence, sample, message)


class _Decoder:
    """Takes the messages of one topic apart, many at once where they are alike."""

    def __init__(self, name: str, growing: GrowingTimeSeries) -> None:
        self.growing = growing
        self.rejected = 0
        self.examples: list[Rejected] = []
        self._name = name
        self._waiting: list[Message] = []
        self._layouts: dict[int, Layout | None] = {}

    def add(self, message: Message) -> None:
        self._waiting.append(message)
        if len(self._waiting) >= _BLOCK:
            self.flush()

    def flush(self) -> None:
        """Take apart what has come."""
        waiting, self._waiting = self._waiting, []
        for length, group in groupby(waiting, key=lambda message: len(message.data)):
            for rows in self._rows(length, list(group)):
                self.growing.add(rows)

    def _rows(self, length: int, group: list[Message]) -> Iterator[Rows]:
        first = group[0]
        if length not in self._layouts and first.topic.type == TOPICS[self._name].message:
            sample = self._decoded(first, counted=False)
            row = TOPICS[self._name]
            self._layouts[length] = None if sample is None else layout_of(row, first.data, sample)
        layout = self._layouts.get(length)
        if layout is None or any(message.topic is not first.topic for message in group):
            yield from self._one_by_one(group)
            return
        taken = layout.take([message.data for message in group])
        log_ns = np.array([message.log_ns for message in group], dtype=np.int64)
        publish_ns = np.array([message.publish_ns for message in group], dtype=np.int64)
        edges = np.flatnonzero(np.diff(taken.good)) + 1
        for part in np.split(np.arange(len(group)), edges):
            if not taken.good[part[0]]:
                yield from self._one_by_one([group[index] for index in part.tolist()])
                continue
            paths, values, shapes = layout.paths, taken.values[part], []
            if taken.nodes is not None:
                shapes = list(taken.nodes[part])
                paths, values = (LARGEST,), largest_tensions(taken.nodes[part])
            yield Rows(
                log_ns[part], publish_ns[part], taken.stamp_ns[part], paths, values, shapes, []
            )

    def _one_by_one(self, group: Iterable[Message]) -> Iterator[Rows]:
        items = []
        for message in group:
            sample = self._decoded(message)
            if sample is not None:
                items.append((message.log_ns, message.publish_ns, sample))
        yield from samples_topics(items)

    def _decoded(self, message: Message, *, counted: bool = True) -> Any:
        """The sample, None where it is turned away."""
        try:
            return decode(self._name, _message(self._name, message))
        except (Refusal, SerdeError, KeyError) as error:
            if counted:
                self.rejected += 1
                if self.rejected <= _EXAMPLES:
                    self.examples.append(Rejected(self._name, message.log_ns, str(error)))
            return None


def read_bag(
    path: Path,
    wanted: Collection[str] | None = None,
    *,
    namespace: str | None = None,
    most: int | None = None,
    progress: Progress | None = None,
) -> Bag:
    """Reads a bag.

    Args:
        path: Its folder, or one of its files.
        wanted: Contract topics to decode; all but the markers by default. Others are counted.
        namespace: Which rover, where the bag holds several.
        most: Tracks hold up to twice so many messages, thinned beyond; None = all. Those of
            switches, encoders and currents that tell activities apart may hold 8 times as many.
        progress: Told how far it has come.

    Raises:
        ScanError: It is no bag, or of a kind that cannot be read.
        ReadError: It holds no message, or several rovers and no ``namespace``.
    """
    names = set(TOPICS) - {topics.MARKERS} if wanted is None else set(wanted)
    full_names, space = _names(path, namespace)
    by_full_name = {full: name for name, full in full_names.items() if name in names}
    scan = BagScan(path)
    counts: Counter[str] = Counter()
    types: dict[str, str] = {}
    decoders: dict[str, _Decoder] = {}
    first_ns, last_ns, total = None, 0, 0
    for message in scan:
        full, kind = message.topic.name, message.topic.type
        counts[full] += 1
        types[full] = kind
        first_ns = message.log_ns if first_ns is None else min(first_ns, message.log_ns)
        last_ns = max(last_ns, message.log_ns)
        total += 1
        if progress is not None and total % _TOLD_EVERY == 0:
            progress(scan.done)
        name = by_full_name.get(full)
        if name is None:
            continue
        if name not in decoders:
            held = most if most is None or name not in _FINE else _FINER * most
            decoders[name] = _Decoder(name, GrowingTimeSeries(TOPICS[name], full, held))
        decoders[name].add(message)
    if first_ns is None:
        why = "; ".join(item.reason for item in scan.damage) or "nothing was recorded"
        raise ReadError(f"the bag {path} holds no message that can be read: {why}")
    for decoder in decoders.values():
        decoder.flush()
    growing = {name: decoder.growing for name, decoder in decoders.items()}
    clock = Clock(growing.get(topics.CLOCK), first_ns, _first_stamp(growing))
    tracks = {name: item.finished(clock) for name, item in growing.items() if item.pace.count}
    records = list(scan.metadata)
    dropped, missed = _losses(records)
    return Bag(
        path=path,
        namespace=space,
        start_ns=first_ns,
        duration=(last_ns - first_ns) * 1e-9,
        tracks=tracks,
        counts=dict(counts),
        types=types,
        full_names={name: full for name, full in full_names.items() if full in counts},
        identity=next((values for name, values in records if name == IDENTITY_RECORD), {}),
        configurations=tuple(_configurations(tracks.get(topics.CONFIG))),
        dropped=dropped,
        missed=missed,
        closed=scan.closed,
        damage=tuple(scan.damage),
        remarks=tuple(scan.remarks(first_ns)),
        lost=scan.lost,
        unverified=dict(scan.unverified),
        rejected={name: item.rejected for name, item in decoders.items() if item.rejected},
        examples=tuple(example for item in decoders.values() for example in item.examples),
        paces={name: item.pace for name, item in growing.items() if item.pace.count},
        clock=clock,
    )


def windows(
    bag: Bag,
    spans: Sequence[tuple[int, int]],
    wanted: Collection[str],
    *,
    progress: Progress | None = None,
) -> Iterator[Bag]:
    """Reads stretches of a bag again, in full, one after the other in one pass.

    Args:
        bag: As it was read, thinned.
        spans: Log times [ns since 1970] of the stretches, in order; they may overlap.
        wanted: Contract topics to read.
        progress: Told how far it has come.

    Yields:
        For each stretch the bag with these topics' tracks of the stretch alone.
    """
    by_full_name = {full: name for name, full in bag.full_names.items() if name in wanted}
    waiting = list(spans)
    open_spans: list[tuple[int, dict[str, _Decoder]]] = []
    scan = BagScan(bag.path)
    total = 0
    for message in scan:
        total += 1
        if progress is not None and total % _TOLD_EVERY == 0:
            progress(scan.done)
        # Messages are in the order of the file, which is nearly that of their log times.
        while open_spans and message.log_ns > open_spans[0][0] + _OUT_OF_ORDER_NS:
            yield _window(bag, open_spans.pop(0)[1])
        while waiting and message.log_ns >= waiting[0][0]:
            open_spans.append((waiting.pop(0)[1], {}))
        name = by_full_name.get(message.topic.name)
        if name is None:
            continue
        for end, decoders in open_spans:
            if message.log_ns <= end:
                if name not in decoders:
                    row = TOPICS[name]
                    decoders[name] = _Decoder(name, GrowingTimeSeries(row, message.topic.name))
                decoders[name].add(message)
    for _, decoders in open_spans:
        yield _window(bag, decoders)


_OUT_OF_ORDER_NS: Final = 1_000_000_000


def _window(bag: Bag, decoders: Mapping[str, _Decoder]) -> Bag:
    for decoder in decoders.values():
        decoder.flush()
    if bag.clock is None:
        raise AssertionError("a bag that was read has a clock")
    tracks = {
        name: decoder.growing.finished(bag.clock)
        for name, decoder in decoders.items()
        if decoder.growing.pace.count
    }
    return replace(bag, tracks={**bag.tracks, **tracks})


def _first_stamp(growing: Mapping[str, GrowingTimeSeries]) -> tuple[int, int] | None:
    """Stamp and log time of the first stamped message of a topic that only the plant sends."""
    for name in (topics.TRUTH_BODY1, topics.IMU, topics.LOAD_CELL):
        if name in growing:
            log_ns, stamp_ns = growing[name].clock_rows
            pairs = zip(stamp_ns.tolist(), log_ns.tolist(), strict=True)
            return next((pair for pair in pairs if pair[0] > 0), None)
    return None


def _message(name: str, message: Message) -> Any:
    row = TOPICS[name]
    if message.topic.type != row.message:
        raise SerdeError(f"{name} is recorded as {message.topic.type}, it must be {row.message}")
    return _STORE.deserialize_cdr(message.data, row.message)


def _names(path: Path, namespace: str | None) -> tuple[dict[str, str], str]:
    """Full name of each contract topic, and the namespace: as the recorder wrote, or guessed."""
    scan = BagScan(path)
    present: set[tuple[str, str]] = set()
    for message in scan:
        present.add((message.topic.name, message.topic.type))
        identity = next((values for name, values in scan.metadata if name == IDENTITY_RECORD), {})
        if namespace is None and "topics" in identity:
            written = json.loads(identity["topics"])
            names = {name: str(full) for name, full in written.items() if name in TOPICS}
            return names, identity.get("namespace", "/")
        if sum(scan.counts.values()) >= _LEADING and len(scan.files) == 1 and scan.closed:
            announced = {(topic.name, topic.type) for topic in scan.announced}
            if announced:  # its index tells all topics, and nobody wrote more about them
                present |= announced
                break
    spaces = _namespaces(present)
    if namespace is None:
        if len(spaces) > 1:
            raise ReadError(
                f"the bag {path} holds several rovers: choose one of the namespaces "
                f"{', '.join(sorted(spaces))}"
            )
        namespace = next(iter(spaces), "/")
    prefix = "/" + namespace.strip("/")
    prefix = prefix if prefix == "/" else prefix + "/"
    return {name: name if name.startswith("/") else prefix + name for name in TOPICS}, namespace


def _namespaces(present: Iterable[tuple[str, str]]) -> set[str]:
    """Namespaces under which the bag holds what only a rover of this suite publishes."""
    marks = (topics.TRUTH_BODY1, topics.JUMP_MOTOR_STATE, topics.WINCH_STATE, topics.LOAD_CELL)
    return {
        full[: -len(name)].rstrip("/") or "/"
        for full, kind in present
        for name in marks
        if full.endswith("/" + name) and kind == TOPICS[name].message
    }


def _configurations(track: TimeSeries | None) -> Iterable[Mapping[str, Any]]:
    for text in dict.fromkeys(track.texts if track is not None else ()):
        content = json.loads(text)
        if isinstance(content, dict):
            yield content


def _losses(records: Iterable[tuple[str, dict[str, str]]]) -> tuple[dict[str, int], dict[str, int]]:
    latest: dict[str, str] = {}
    for name, values in records:
        if name == LOSSES_RECORD:
            latest = values
    return (
        json.loads(latest.get("dropped_by_recorder", "{}")),
        json.loads(latest.get("lost_in_transport", "{}")),
    )
