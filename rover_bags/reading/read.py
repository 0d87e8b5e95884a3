"""Read a bag into time series: numpy arrays by topic and field, as named by the contract.

Reads bags of this suite and of ``ros2 bag record``: MCAP or SQLite, split, compressed, closed or
interrupted, with or without ``metadata.yaml``. Chunks are checked against their checksums, messages
against the contract; what fails is counted and reported and never returned. Messages without a
checksum are counted as unverified.

The number of messages that a time series holds can be limited; windows of the bag can then be read
again in full. Nothing here needs ROS.
"""

import gc
import json
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

import numpy as np

from msg_schemas import topics
from msg_schemas.cdr import unpack
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.table import TOPICS
from rover_bags.files.records import ALL_TIMES, CDR, LAST_NS, Damage, RecordedMessage
from rover_bags.files.scan import BagScan
from rover_bags.files.store import IDENTITY_RECORD, LOSSES_RECORD, BagError
from rover_bags.reading.command_sources import CommandConflict, CommandSources
from rover_bags.reading.extraction import NumberExtractor, number_extractor
from rover_bags.reading.time_series import (
    LARGEST,
    Clock,
    Floats,
    MessageBlock,
    MessageTiming,
    Stamps,
    TimeSeries,
    TimeSeriesBuilder,
    blocks_of_samples,
    largest_tensions,
)

__all__ = [
    "NOT_SERIES",
    "Bag",
    "ContractMessage",
    "Floats",
    "ReadError",
    "Rejected",
    "Stamps",
    "TimeSeries",
    "portions",
    "read_bag",
    "received_messages",
    "windows",
]  # fmt: skip

NOT_SERIES: Final = frozenset({topics.MARKERS, topics.TRUTH_STATE})
"""Topics that are large and hold no series of numbers."""

Progress = Callable[[int], None]
"""Called with the number of bytes of the bag that have been read."""

_EXAMPLES: Final = 5
_BLOCK: Final = 512
"""Number of messages of a topic that are decoded at once."""
_PROGRESS_EVERY: Final = 4096
_OWNED: Final = frozenset(name for name, spec in TOPICS.items() if spec.owned)
_LEADING: Final = 4096
"""A recorder that writes an identity record does so before this many messages."""
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
"""Topics that distinguish activities: their time series may hold `_FINER` times more messages."""


class ReadError(BagError):
    """A bag that holds nothing readable; the message states the reason."""


@dataclass(frozen=True)
class Rejected:
    """A recorded message that violates the contract."""

    topic: str
    log_ns: int
    reason: str


@dataclass(frozen=True)
class Bag:
    """A bag in memory.

    Attributes:
        path: The bag's folder or file.
        namespace: Namespace of the rover that was read.
        start_ns: Log time of the first message [ns since 1970].
        duration: Wall time from the first to the last message [s].
        time_series: Time series by contract topic name.
        counts: Messages by full topic name, of every topic in the bag.
        types: Message type by full topic name.
        full_names: Full topic name by contract topic name, for topics in the bag.
        identity: Versions and settings written by this suite's recorder; empty for others.
        configurations: Latched configurations of the nodes, in recorded order.
        dropped: Messages that the recorder could not keep, by full topic name.
        lost_in_transport: Messages lost before they reached the recorder, by full topic name.
        closed: Whether the recorder closed the bag.
        damage: Damaged parts of the files, which were skipped.
        file_defects: Descriptions of what is missing or damaged in the files.
        unreadable: Messages that the bag's own index counts and that could not be read, by full
            topic name.
        unverified: Messages without a checksum, by full topic name.
        rejected: Messages that violate the contract, by contract topic name.
        rejected_examples: The first few rejected messages.
        command_conflicts: Motors that two sources have commanded at a time.
        timings: Rate and gap statistics of each topic read, by contract topic name.
        clock: Converts stamps into the time of the time series.
    """

    path: Path
    namespace: str
    start_ns: int
    duration: float
    time_series: Mapping[str, TimeSeries]
    counts: Mapping[str, int]
    types: Mapping[str, str]
    full_names: Mapping[str, str]
    identity: Mapping[str, str]
    configurations: tuple[Mapping[str, Any], ...]
    dropped: Mapping[str, int]
    lost_in_transport: Mapping[str, int]
    closed: bool
    damage: tuple[Damage, ...]
    file_defects: tuple[str, ...]
    unreadable: Mapping[str, int]
    unverified: Mapping[str, int]
    rejected: Mapping[str, int]
    rejected_examples: tuple[Rejected, ...]
    command_conflicts: tuple[CommandConflict, ...] = ()
    timings: Mapping[str, MessageTiming] = field(default_factory=dict)
    clock: Clock | None = None

    def series(self, topic: str) -> TimeSeries | None:
        """Return the time series of a topic, or None if the bag holds no valid message of it."""
        found = self.time_series.get(topic)
        return found if found is not None and len(found) else None

    def run_at(self, log_ns: int) -> Self:
        """Return the bag with the time series of the run at a log time: a reset repeats times."""
        runs = {name: series.run_at(log_ns) for name, series in self.time_series.items()}
        return replace(self, time_series=runs)

    @property
    def scenario(self) -> Mapping[str, Any]:
        """The configured scenario; empty if no configuration is recorded."""
        for configuration in self.configurations:
            scenario = configuration.get("scenario")
            if isinstance(scenario, Mapping):
                return scenario
        return {}

    @property
    def thinned(self) -> bool:
        """Whether any time series holds only a part of its messages."""
        return any(series.stride > 1 for series in self.time_series.values())

    @property
    def seed(self) -> int | None:
        """Seed of the simulation."""
        return next((c["seed"] for c in self.configurations if "seed" in c), None)

    @property
    def is_in_lockstep(self) -> bool:
        """Whether simulated time waited for the nodes: then no wall-clock rate is promised."""
        parameters = (c.get("parameters") for c in self.configurations)
        return any(isinstance(each, Mapping) and each.get("lockstep") for each in parameters)


@dataclass(frozen=True)
class ContractMessage:
    """One valid message of a contract topic.

    Attributes:
        name: Contract topic.
        log_ns, publish_ns: Time of reception and of publication [ns since 1970].
        sequence: The publisher's message count.
        sample: The decoded sample.
        data: The serialized message.
    """

    name: str
    log_ns: int
    publish_ns: int
    sequence: int
    sample: Any
    data: bytes


def received_messages(
    scan: BagScan, requested: Collection[str] | None = None, *, namespace: str | None = None
) -> Iterator[ContractMessage]:
    """Yield a bag's valid messages one by one, in file order.

    Args:
        scan: Scan of the bag; its attributes are complete after the iteration.
        requested: Contract topics to decode; all but `NOT_SERIES` by default.
        namespace: Namespace of the rover, if the bag holds several.

    Raises:
        ScanError: It is not a bag.
        ReadError: It holds several rovers and no ``namespace`` is given.
    """
    decoded = set(TOPICS) - NOT_SERIES if requested is None else set(requested)
    full_names, _ = _names(scan.path, namespace)
    by_full_name = {full: name for name, full in full_names.items() if name in decoded}
    for item in scan:
        name = by_full_name.get(item.topic.name)
        if name is None:
            continue
        try:
            sample = _sample(name, item)
        except Refusal:
            continue
        yield ContractMessage(name, item.log_ns, item.publish_ns, item.sequence, sample, item.data)


class _Decoder:
    """Decodes the messages of one topic, many at once if they have the same layout."""

    def __init__(self, name: str, builder: TimeSeriesBuilder) -> None:
        self.builder = builder
        self.rejected = 0
        self.rejected_examples: list[Rejected] = []
        self._name = name
        self._pending: list[RecordedMessage] = []
        self._extractors: dict[int, NumberExtractor | None] = {}

    def add(self, message: RecordedMessage) -> None:
        self._pending.append(message)
        if len(self._pending) >= _BLOCK:
            self.flush()

    def flush(self) -> None:
        """Decode the pending messages."""
        pending, self._pending = self._pending, []
        for length, group in groupby(pending, key=lambda message: len(message.data)):
            for rows in self._rows(length, list(group)):
                self.builder.add(rows)

    def _rows(self, length: int, group: list[RecordedMessage]) -> Iterator[MessageBlock]:
        first = group[0]
        spec = TOPICS[self._name]
        expected = (spec.message, CDR)
        if length not in self._extractors and (first.topic.type, first.topic.encoding) == expected:
            with suppress(Refusal):
                self._extractors[length] = number_extractor(spec, first.data)
        extractor = self._extractors.get(length)
        if extractor is None or not all(
            message.topic is first.topic and _has_time(message) for message in group
        ):
            yield from self._decoded_singly(group)
            return
        extracted = extractor.extract([message.data for message in group])
        log_ns = np.array([message.log_ns for message in group], dtype=np.int64)
        publish_ns = np.array([message.publish_ns for message in group], dtype=np.int64)
        edges = np.flatnonzero(np.diff(extracted.accepted)) + 1
        for part in np.split(np.arange(len(group)), edges):
            if not extracted.accepted[part[0]]:
                yield from self._decoded_singly([group[index] for index in part.tolist()])
                continue
            paths, values, shapes = extractor.paths, extracted.values[part], []
            if extracted.nodes is not None:
                shapes = list(extracted.nodes[part])
                paths, values = (LARGEST,), largest_tensions(extracted.nodes[part])
            yield MessageBlock(
                log_ns[part], publish_ns[part], extracted.stamp_ns[part], paths, values, shapes, []
            )

    def _decoded_singly(self, group: Iterable[RecordedMessage]) -> Iterator[MessageBlock]:
        items = []
        for message in group:
            sample = self._decoded(message)
            if sample is not None:
                items.append((message.log_ns, message.publish_ns, sample))
        yield from blocks_of_samples(items)

    def _decoded(self, message: RecordedMessage) -> Any:
        """The sample, or None if it violates the contract."""
        try:
            return _sample(self._name, message)
        except Refusal as refusal:
            self.rejected += 1
            if self.rejected <= _EXAMPLES:
                self.rejected_examples.append(Rejected(self._name, message.log_ns, str(refusal)))
            return None


def read_bag(
    path: Path,
    requested: Collection[str] | None = None,
    *,
    namespace: str | None = None,
    max_messages: int | None = None,
    progress: Progress | None = None,
) -> Bag:
    """Read a bag.

    Args:
        path: The bag's folder, or one of its files.
        requested: Contract topics to decode; all but `NOT_SERIES` by default. Others are counted.
        namespace: Namespace of the rover, if the bag holds several.
        max_messages: Time series are thinned when they exceed twice this number; None = never.
            Those of switches, encoders and currents, which distinguish activities, may hold 8 times
            as many.
        progress: Called with the number of bytes read.

    Raises:
        ScanError: It is not a bag, or of a format that cannot be read.
        ReadError: It holds no message, or several rovers and no ``namespace`` is given.
    """
    names = set(TOPICS) - NOT_SERIES if requested is None else set(requested)
    full_names, space = _names(path, namespace)
    by_full_name = {full: name for name, full in full_names.items() if name in names}
    scan = BagScan(path)
    decoded = _decode(_uncollected(_followed(scan, progress)), by_full_name, max_messages)
    if not decoded.types:
        why = "; ".join(item.reason for item in scan.damage) or "nothing was recorded"
        raise ReadError(f"the bag {path} holds no message that can be read: {why}")
    first_ns, decoders = decoded.first_ns, decoded.decoders
    builders = {name: decoder.builder for name, decoder in decoders.items()}
    clock = Clock(builders.get(topics.CLOCK), first_ns, _first_stamp(builders))
    time_series = {name: item.build(clock) for name, item in builders.items() if item.timing.count}
    records = list(scan.metadata)
    dropped, lost_in_transport = _losses(records)
    return Bag(
        path=path,
        namespace=space,
        start_ns=first_ns,
        duration=(decoded.last_ns - first_ns) * 1e-9,
        time_series=time_series,
        counts=dict(scan.counts),
        types=decoded.types,
        full_names={name: full for name, full in full_names.items() if full in scan.counts},
        identity=next((values for name, values in records if name == IDENTITY_RECORD), {}),
        configurations=tuple(_configurations(time_series.get(topics.CONFIG))),
        dropped=dropped,
        lost_in_transport=lost_in_transport,
        closed=scan.closed,
        damage=tuple(scan.damage),
        file_defects=tuple(scan.defects(first_ns)),
        unreadable=scan.lost,
        unverified=dict(scan.unverified),
        rejected={name: item.rejected for name, item in decoders.items() if item.rejected},
        rejected_examples=tuple(
            example for item in decoders.values() for example in item.rejected_examples
        ),
        command_conflicts=decoded.command_conflicts,
        timings={name: item.timing for name, item in builders.items() if item.timing.count},
        clock=clock,
    )


class _Decoded(NamedTuple):
    """What the messages of a bag hold."""

    decoders: Mapping[str, _Decoder]  # by contract topic name, flushed
    types: Mapping[str, str]  # by full topic name; empty: no message
    command_conflicts: tuple[CommandConflict, ...]
    first_ns: int  # log time
    last_ns: int


def _decode(
    messages: Iterable[RecordedMessage],
    by_full_name: Mapping[str, str],
    max_messages: int | None,
) -> _Decoded:
    """Decode the messages of the topics in `by_full_name`, and note the times and types of all."""
    types: dict[str, str] = {}
    decoders: dict[str, _Decoder] = {}
    sources = CommandSources()
    first_ns, last_ns = ALL_TIMES[1], 0
    for message in messages:
        topic, log_ns, *_ = message
        first_ns, last_ns = min(first_ns, log_ns), max(last_ns, log_ns)
        full = topic.name
        types[full] = topic.type
        name = by_full_name.get(full)
        if name is None:
            continue
        if name in _OWNED:
            sources.add_message(name, message.data)
        if name not in decoders:
            held = (
                max_messages if max_messages is None or name not in _FINE else _FINER * max_messages
            )
            decoders[name] = _Decoder(name, TimeSeriesBuilder(TOPICS[name], full, held))
        decoders[name].add(message)
    for decoder in decoders.values():
        decoder.flush()
    return _Decoded(decoders, types, sources.conflicts, first_ns, last_ns)


def _followed(scan: BagScan, progress: Progress | None) -> Iterator[RecordedMessage]:
    """Yield a bag's messages and report the progress."""
    for total, message in enumerate(scan, start=1):
        if progress is not None and total % _PROGRESS_EVERY == 0:
            progress(scan.done)
        yield message


def _uncollected(messages: Iterable[RecordedMessage]) -> Iterator[RecordedMessage]:
    """Pause the collection of garbage: it would traverse the many messages that wait, in vain."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield from messages
    finally:
        if was_enabled:
            gc.enable()


def windows(
    bag: Bag,
    spans: Sequence[tuple[int, int]],
    requested: Collection[str],
    *,
    progress: Progress | None = None,
) -> Iterator[Bag]:
    """Read time windows of a bag again, in full, in one pass.

    Args:
        bag: The thinned bag.
        spans: Log times [ns since 1970] of the windows, in order; they may overlap.
        requested: Contract topics to read.
        progress: Called with the number of bytes read.

    Yields:
        For each window, the bag with the requested time series restricted to the window.
    """
    by_full_name = {full: name for name, full in bag.full_names.items() if name in requested}
    remaining = list(spans)
    open_spans: list[tuple[int, dict[str, _Decoder]]] = []
    within = (min(begin for begin, _ in spans), max(end for _, end in spans))
    for message in _followed(BagScan(bag.path, within), progress):
        # The order of the file is nearly that of the log times.
        while open_spans and message.log_ns > open_spans[0][0] + _OUT_OF_ORDER_NS:
            yield _window(bag, open_spans.pop(0)[1])
        while remaining and message.log_ns >= remaining[0][0]:
            open_spans.append((remaining.pop(0)[1], {}))
        name = by_full_name.get(message.topic.name)
        if name is None:
            continue
        for end, decoders in open_spans:
            if message.log_ns <= end:
                if name not in decoders:
                    spec = TOPICS[name]
                    decoders[name] = _Decoder(name, TimeSeriesBuilder(spec, message.topic.name))
                decoders[name].add(message)
    for _, decoders in (*open_spans, *((end, {}) for _, end in remaining)):
        yield _window(bag, decoders)


def portions(
    bag: Bag, requested: Collection[str], size: int, *, progress: Progress | None = None
) -> Iterator[TimeSeries]:
    """Read a bag again, in full, in one pass.

    Args:
        bag: The bag, thinned or not.
        requested: Contract topics to read.
        size: Most messages in a portion.
        progress: Called with the number of bytes read.

    Yields:
        Portions of the topics' time series, those of one topic in the order of the file.
    """
    by_full_name = {full: name for name, full in bag.full_names.items() if name in requested}
    decoders: dict[str, _Decoder] = {}
    counts: Counter[str] = Counter()
    for message in _followed(BagScan(bag.path), progress):
        name = by_full_name.get(message.topic.name)
        if name is None:
            continue
        if name not in decoders:
            builder = TimeSeriesBuilder(TOPICS[name], message.topic.name)
            decoders[name] = _Decoder(name, builder)
        decoders[name].add(message)
        counts[name] += 1
        if counts[name] % size == 0:
            yield from _built(bag, {name: decoders.pop(name)}).values()
    yield from _built(bag, decoders).values()


_OUT_OF_ORDER_NS: Final = 1_000_000_000


def _window(bag: Bag, decoders: Mapping[str, _Decoder]) -> Bag:
    return replace(bag, time_series={**bag.time_series, **_built(bag, decoders)})


def _built(bag: Bag, decoders: Mapping[str, _Decoder]) -> dict[str, TimeSeries]:
    """Time series of what the decoders have, by contract topic."""
    for decoder in decoders.values():
        decoder.flush()
    if bag.clock is None:
        raise AssertionError("a bag that was read has a clock")
    return {
        name: decoder.builder.build(bag.clock)
        for name, decoder in decoders.items()
        if decoder.builder.timing.count
    }


def _first_stamp(builders: Mapping[str, TimeSeriesBuilder]) -> tuple[int, int] | None:
    """Stamp and log time of the first stamped message of a topic published by the plant only."""
    for name in (topics.TRUTH_BODY1, topics.IMU, topics.LOAD_CELL):
        if name in builders:
            log_ns, stamp_ns = builders[name].clock_stamps
            pairs = zip(stamp_ns.tolist(), log_ns.tolist(), strict=True)
            return next((pair for pair in pairs if pair[0] > 0), None)
    return None


def _sample(name: str, message: RecordedMessage) -> Any:
    spec = TOPICS[name]
    if message.topic.type != spec.message:
        raise Refusal(
            name,
            RefusalCode.WRONG_TYPE,
            f"recorded as {message.topic.type}, the contract requires {spec.message}",
        )
    if message.topic.encoding != CDR:
        raise Refusal(
            name,
            RefusalCode.WRONG_TYPE,
            f"encoded as {message.topic.encoding:.40}, ROS 2 requires {CDR}",
        )
    if not _has_time(message):
        last_ns = max(message.log_ns, message.publish_ns)
        raise Refusal(
            name,
            RefusalCode.OUT_OF_LIMITS,
            f"recorded at {last_ns} ns, should be at most {LAST_NS}",
        )
    return unpack(name, message.data)


def _has_time(message: RecordedMessage) -> bool:
    return message.log_ns <= LAST_NS and message.publish_ns <= LAST_NS


def _names(path: Path, namespace: str | None) -> tuple[dict[str, str], str]:
    """Full name of each contract topic and the namespace: from the identity record, or inferred."""
    scan = BagScan(path)
    present: set[tuple[str, str]] = set()
    for message in scan:
        present.add((message.topic.name, message.topic.type))
        identity = next((values for name, values in scan.metadata if name == IDENTITY_RECORD), {})
        if namespace is None and "topics" in identity:
            written = json_object(identity["topics"])
            names = {name: str(full) for name, full in written.items() if name in TOPICS}
            return names, identity.get("namespace", "/")
        if sum(scan.counts.values()) >= _LEADING and len(scan.files) == 1 and scan.closed:
            declared = {(topic.name, topic.type) for topic in scan.declared_topics}
            if declared:  # the index lists all topics, and there is no identity record
                present |= declared
                break
    # Other recorders than those of ROS may omit the first slash.
    written_as = {"/" + full.removeprefix("/"): full for full, _ in present}
    spaces = _namespaces(("/" + full.removeprefix("/"), kind) for full, kind in present)
    if namespace is None:
        if len(spaces) > 1:
            raise ReadError(
                f"the bag {path} holds several rovers: select one of the namespaces "
                f"{', '.join(sorted(spaces))}"
            )
        namespace = next(iter(spaces), "/")
    prefix = "/" + namespace.strip("/")
    prefix = prefix if prefix == "/" else prefix + "/"
    if written_as and not any(full.startswith(prefix) for full in written_as):
        raise ReadError(
            f"the bag {path} holds no topic in the namespace {namespace!r:.60}: should be "
            f"{' or '.join(sorted(spaces)) or 'that of its topics'}"
        )
    names = {name: name if name.startswith("/") else prefix + name for name in TOPICS}
    return {name: written_as.get(full, full) for name, full in names.items()}, namespace


def _namespaces(present: Iterable[tuple[str, str]]) -> set[str]:
    """Namespaces of topics that only a rover of this suite publishes."""
    marks = (topics.TRUTH_BODY1, topics.JUMP_MOTOR_STATE, topics.WINCH_STATE, topics.LOAD_CELL)
    return {
        full[: -len(name)].rstrip("/") or "/"
        for full, kind in present
        for name in marks
        if full.endswith("/" + name) and kind == TOPICS[name].message
    }


def _configurations(series: TimeSeries | None) -> Iterable[Mapping[str, Any]]:
    for text in dict.fromkeys(series.texts if series is not None else ()):
        content = json_object(text)
        if content:
            # Half a character, which JSON can hold by an escape, cannot be printed.
            yield json.loads(json.dumps(content, ensure_ascii=False).encode(errors="replace"))


def _losses(records: Iterable[tuple[str, dict[str, str]]]) -> tuple[dict[str, int], dict[str, int]]:
    latest: dict[str, str] = {}
    for name, values in records:
        if name == LOSSES_RECORD:
            latest = values
    dropped, lost = (
        {str(topic): count for topic, count in json_object(latest.get(name, "")).items()}
        for name in ("dropped_by_recorder", "lost_in_transport")
    )
    return dropped, lost


def json_object(text: str) -> dict[str, Any]:
    """Return the object of a JSON text; empty if the text holds none, as a foreign one may."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}
