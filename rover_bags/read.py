"""Reads a bag into typed tracks: numpy arrays by topic, as the contract's table names them.

Reads whatever its recorder left: bags of this suite and of ``ros2 bag record``, MCAP or SQLite,
split, compressed, closed or killed, with or without ``metadata.yaml``. Every chunk is checked
against its checksum, every message against the contract; what fails is counted and named, and
nothing wrong is returned. What no checksum protects is counted as such.

Nothing here needs ROS.
"""

import json
import math
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from msg_schemas import topics
from msg_schemas.codecs import decode
from msg_schemas.refusal import Refusal
from msg_schemas.samples import DrawingSample, Status, StatusSample, TetherSample, TextSample
from msg_schemas.table import TOPICS, Topic
from rover_bags.records import Damage, Message
from rover_bags.scan import BagScan
from rover_bags.store import IDENTITY_RECORD, LOSSES_RECORD, BagError

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

_STORE: Final[Typestore] = get_typestore(Stores.ROS2_JAZZY)
_EXAMPLES: Final = 5
_DAY_NS: Final = 86_400_000_000_000


class ReadError(BagError):
    """A bag from which nothing can be told; the text says why."""


@dataclass(frozen=True)
class Rejected:
    """A recorded message that the contract turns away."""

    topic: str
    log_ns: int
    reason: str


@dataclass(frozen=True)
class Track:
    """All that one topic said, in the order of its arrival.

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

    def __len__(self) -> int:
        return len(self.log_ns)

    def vector(self, prefix: str, axes: str = "xyz") -> Floats:
        """Columns ``prefix.x``, ``prefix.y`` ... side by side, shape (N, len(axes))."""
        return np.stack([self.columns[f"{prefix}.{axis}"] for axis in axes], axis=1)


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
        lost: Messages by full topic name that the bag should hold, as it counts them itself, and
            that could not be read.
        unverified: Messages that no checksum protects, by full topic name.
        rejected: Messages that the contract turns away, by its topic name.
        examples: The first few of those.
    """

    path: Path
    namespace: str
    start_ns: int
    duration: float
    tracks: Mapping[str, Track]
    counts: Mapping[str, int]
    types: Mapping[str, str]
    full_names: Mapping[str, str]
    identity: Mapping[str, str]
    configurations: tuple[Mapping[str, Any], ...]
    dropped: Mapping[str, int]
    missed: Mapping[str, int]
    closed: bool
    damage: tuple[Damage, ...]
    lost: Mapping[str, int]
    unverified: Mapping[str, int]
    rejected: Mapping[str, int]
    examples: tuple[Rejected, ...]

    def track(self, topic: str) -> Track | None:
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
    path: Path, wanted: Collection[str] | None = None, *, namespace: str | None = None
) -> Iterator[Arrival]:
    """Yields a bag's accepted messages one by one, in the order of the file.

    Args:
        path: Its folder, or one of its files.
        wanted: Contract topics to decode; all but the markers by default.
        namespace: Which rover, where the bag holds several.

    Raises:
        ScanError: It is no bag.
        ReadError: It holds several rovers and no ``namespace``.
    """
    decoded = set(TOPICS) - {topics.MARKERS} if wanted is None else set(wanted)
    full_names, _ = _names(path, namespace)
    by_full_name = {full: name for name, full in full_names.items() if name in decoded}
    for item in BagScan(path):
        name = by_full_name.get(item.topic.name)
        if name is None:
            continue
        try:
            message = _message(name, item)
            sample = decode(name, message)
        except (Refusal, SerdeError, KeyError):
            continue
        yield Arrival(name, item.log_ns, item.publish_ns, item.sequence, sample, message)


class _Growing:
    """A track while it is read."""

    def __init__(self, row: Topic, full_name: str) -> None:
        self.row = row
        self.full_name = full_name
        self.log_ns: list[int] = []
        self.publish_ns: list[int] = []
        self.stamp_ns: list[int] = []
        self.values: list[list[float]] = []
        self.paths: list[str] = []
        self.nodes: list[Floats] = []
        self.texts: list[str] = []
        self.statuses: list[tuple[Status, ...]] = []

    def add(self, message: Message, sample: Any) -> None:
        self.log_ns.append(message.log_ns)
        self.publish_ns.append(message.publish_ns)
        self.stamp_ns.append(getattr(sample, "stamp_ns", 0))
        if isinstance(sample, TetherSample):
            self.nodes.append(sample.nodes)
        elif isinstance(sample, TextSample):
            self.texts.append(sample.text)
        elif isinstance(sample, StatusSample):
            self.statuses.append(sample.statuses)
        elif not isinstance(sample, DrawingSample):
            pairs = dict(sample.scalars())
            # Messages of one topic may carry different fields, as requests of several kinds do.
            self.paths += [path for path in pairs if path not in self.paths]
            self.values.append([pairs.get(path, math.nan) for path in self.paths])

    def finished(self, clock: "_Clock") -> Track:
        log_ns = np.array(self.log_ns, dtype=np.int64)
        stamp_ns = np.array(self.stamp_ns, dtype=np.int64)
        table = np.full((len(self.values), len(self.paths)), math.nan)
        for row, values in zip(table, self.values, strict=True):
            row[: len(values)] = values
        same = len({nodes.shape for nodes in self.nodes}) == 1
        return Track(
            topic=self.row.name,
            full_name=self.full_name,
            time=clock.times(stamp_ns, log_ns),
            log_ns=log_ns,
            publish_ns=np.array(self.publish_ns, dtype=np.int64),
            columns={path: table[:, column].copy() for column, path in enumerate(self.paths)},
            nodes=np.stack(self.nodes) if same else None,
            texts=tuple(self.texts),
            statuses=tuple(self.statuses),
        )


class _Clock:
    """Turns stamps and log times into seconds of one time axis.

    With a recorded clock that axis is simulated time; a stamp far outside the clock's range
    comes from a node that does not follow it, and the time of arrival is taken instead.
    """

    _SLACK_NS = 1_000_000_000

    def __init__(
        self, growing: _Growing | None, start_ns: int, first: tuple[int, int] | None
    ) -> None:
        self._start_ns = start_ns
        self._log = np.array(growing.log_ns if growing else [], dtype=np.int64)
        self._stamp = np.array(growing.stamp_ns if growing else [], dtype=np.int64)
        stamp, log = first or (start_ns, start_ns)
        self._behind = log - stamp
        # Stamps near the machine's time are that time; others count from their own zero.
        self._origin = start_ns if abs(self._behind) < _DAY_NS else 0

    def times(self, stamp_ns: Stamps, log_ns: Stamps) -> Floats:
        if not len(self._stamp):
            told = np.where(stamp_ns > 0, stamp_ns, log_ns - self._behind)
            return (told - self._origin) * 1e-9
        arrived = np.interp(
            (log_ns - self._start_ns).astype(np.float64),
            (self._log - self._start_ns).astype(np.float64),
            self._stamp.astype(np.float64),
        )
        low, high = self._stamp.min() - self._SLACK_NS, self._stamp.max() + self._SLACK_NS
        follows = (stamp_ns > 0) & (stamp_ns >= low) & (stamp_ns <= high)
        return np.where(follows, stamp_ns.astype(np.float64), arrived) * 1e-9


def read_bag(
    path: Path, wanted: Collection[str] | None = None, *, namespace: str | None = None
) -> Bag:
    """Reads a bag.

    Args:
        path: Its folder, or one of its files.
        wanted: Contract topics to decode; all but the markers by default. Others are counted.
        namespace: Which rover, where the bag holds several.

    Raises:
        ScanError: It is no bag, or of a kind that cannot be read.
        ReadError: It holds no message, or several rovers and no ``namespace``.
    """
    decoded = set(TOPICS) - {topics.MARKERS} if wanted is None else set(wanted)
    full_names, space = _names(path, namespace)
    by_full_name = {full: name for name, full in full_names.items()}
    scan = BagScan(path)
    counts: Counter[str] = Counter()
    types: dict[str, str] = {}
    growing: dict[str, _Growing] = {}
    rejected: Counter[str] = Counter()
    examples: list[Rejected] = []
    first_ns, last_ns = None, 0
    for message in scan:
        full = message.topic.name
        counts[full] += 1
        types[full] = message.topic.type
        first_ns = message.log_ns if first_ns is None else min(first_ns, message.log_ns)
        last_ns = max(last_ns, message.log_ns)
        name = by_full_name.get(full)
        if name is None or name not in decoded:
            continue
        try:
            sample = _decoded(name, message)
        except (Refusal, SerdeError, KeyError) as error:
            rejected[name] += 1
            if rejected[name] <= _EXAMPLES:
                examples.append(Rejected(name, message.log_ns, str(error)))
            continue
        growing.setdefault(name, _Growing(TOPICS[name], full)).add(message, sample)
    if first_ns is None:
        why = "; ".join(item.reason for item in scan.damage) or "nothing was recorded"
        raise ReadError(f"the bag {path} holds no message that can be read: {why}")
    clock = _Clock(growing.get(topics.CLOCK), first_ns, _first_stamp(growing))
    tracks = {name: item.finished(clock) for name, item in growing.items()}
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
        lost=scan.lost,
        unverified=dict(scan.unverified),
        rejected=dict(rejected),
        examples=tuple(examples),
    )


def _first_stamp(growing: Mapping[str, _Growing]) -> tuple[int, int] | None:
    """Stamp and log time of the first stamped message of a topic that only the plant sends."""
    for name in (topics.TRUTH_BODY1, topics.IMU, topics.LOAD_CELL):
        if name in growing:
            pairs = zip(growing[name].stamp_ns, growing[name].log_ns, strict=True)
            return next((pair for pair in pairs if pair[0] > 0), None)
    return None


def _decoded(name: str, message: Message) -> Any:
    return decode(name, _message(name, message))


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


def _configurations(track: Track | None) -> Iterable[Mapping[str, Any]]:
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
