"""The recorder node: `mother_rover bag record`, and the executable `bag_record` of launch files.

It records the contract's topics (or a selection, or everything it can discover) exactly as they
come over the wire, into a bag that survives the death of the recorder, of the disk's free space,
and of the machine's power.

Times in the bag: each message's log time is when the middleware received it and its publish time
is when its publisher sent it, both by the machine's clock, never by simulated time. So no message
carries time 0 because ``/clock`` had not come yet, times only grow when simulated time is
reset, and transport latency can be told. Simulated time stands in the messages' own headers and
in the recorded clock.
"""

import argparse
import json
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any, ClassVar

from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.typesys import Stores, get_typestore

from msg_schemas import node_process, qos, topics
from msg_schemas.codecs import message_class
from msg_schemas.node import ContractNode, ExitCode, package_version
from msg_schemas.parameters import parameter
from msg_schemas.ros_arguments import parse_node_arguments
from msg_schemas.samples import Level, Status
from msg_schemas.table import CONTRACT_VERSION, TOPICS
from rover_bags.files.spool import Continuity, Item, Source, Spool
from rover_bags.files.store import (
    IDENTITY_RECORD,
    BagError,
    BagWriter,
    sealed,
    standard_type,
)

CONFIG_RECORD = "mother_rover.config"
_DISCOVERY_PERIOD = 0.2
_QUEUE_DEPTH = 1000
_TAKE_PERIOD = 0.01
_WATCH_PERIOD = 0.1
DISK_FAILED = 4
"""Exit code of a recording that the disk ended, beyond the exit codes of every node."""
_NANO = 1_000_000_000
_STRING = TOPICS[topics.CONFIG].message
_STORE = get_typestore(Stores.ROS2_JAZZY)


@dataclass(frozen=True)
class RecordParameters:
    """Parameters of the recorder."""

    output: str = parameter(
        "", "-", "folder to create for the bag; empty = named by date and time", read_only=True
    )
    topics: str = parameter(
        "", "-", "topics to record, separated by blanks; empty = all of the contract",
        read_only=True,
    )  # fmt: skip
    discover: bool = parameter(
        False, "-", "record every topic of a standard type that appears, too", read_only=True
    )
    duration: float = parameter(
        0.0, "s", "wall time after which recording ends; 0 = until told", 0.0, 1e7, read_only=True
    )
    compression: str = parameter(
        "zstd", "-", "of the bag's chunks", choices=("zstd", "lz4", "none"), read_only=True
    )
    chunk_period: float = parameter(
        0.25, "s", "longest wait of a message before it is on disk", 0.02, 60.0, read_only=True
    )
    sync: bool = parameter(
        True, "-", "force every chunk onto the disk, against loss of power", read_only=True
    )
    queue_mib: int = parameter(
        64, "MiB", "what may wait for a stalled disk before messages drop", 1, 4096, read_only=True
    )
    min_free_mib: int = parameter(
        16, "MiB", "free room at which the disk counts as full", 0, 1_000_000, read_only=True
    )


class _PolledGroup(CallbackGroup):
    """What the executor does not wait for.

    It looks at every subscription for every message that comes on any of them, which costs ten
    times what the message does: 1.2 cores at 3000 messages a second.
    """

    def can_execute(self, entity: object) -> bool:  # noqa: ARG002 - rclpy's signature
        """Never by the executor."""
        return False


@dataclass
class _Recorded:
    """A topic that is being recorded."""

    source: Source
    profile: QoSProfile
    subscription: Any = None
    publishers: int = 1
    continuity: Continuity = field(default_factory=Continuity)
    received: bool = False


class RecordNode(ContractNode):
    """Records topics into an MCAP bag."""

    NAME = "bag_record"
    PARAMETERS = (RecordParameters,)
    EXECUTOR = SingleThreadedExecutor  # the other asks no group what is to be left
    disk_failed: ClassVar[bool] = False

    def __init__(self, **node_options: Any) -> None:
        super().__init__(**node_options)
        self._recorded: dict[str, _Recorded] = {}
        self._refused_topics: set[str] = set()
        self._spool: Spool | None = None
        self._path = Path()
        self._wall = Clock(clock_type=ClockType.STEADY_TIME)
        self._polled_group = _PolledGroup()
        self._recording_timers: list[Any] = []
        self._began = 0.0

    def setup(self) -> None:
        """Open the bag and subscribe.

        Raises:
            BagError: the bag cannot be written.
            ValueError: a topic name is not one.
        """
        options = self.parameters_of(RecordParameters)
        selected = self._selected(options.topics.split())
        stamp = datetime.now().astimezone().strftime("%Y_%m_%d-%H_%M_%S")
        self._path = Path(options.output or f"rover_bag_{stamp}")
        writer = BagWriter(
            self._path,
            compression=options.compression,
            chunk_period=options.chunk_period,
            sync=options.sync,
            reserve=options.min_free_mib << 20,
        )
        writer.add_metadata(IDENTITY_RECORD, sealed(self._identity()))
        self._spool = Spool(writer, limit=options.queue_mib << 20, notes=self._note_configuration)
        self._began = time.monotonic()
        for name, row_name in selected.items():
            if row_name is not None:
                row = TOPICS[row_name]
                self._subscribe(
                    name,
                    row.message,
                    qos.profile(row.intent, _QUEUE_DEPTH),
                    first=row_name == topics.CONFIG,
                )
        self._by_name = [name for name, row_name in selected.items() if row_name is None]
        self._recording_timers = [
            self.create_timer(_DISCOVERY_PERIOD, self._discover, clock=self._wall),
            self.create_timer(_WATCH_PERIOD, self._watch, clock=self._wall),
            self.create_timer(_TAKE_PERIOD, self._take_messages, clock=self._wall),
        ]
        self._discover()
        self.get_logger().info(f"recording into {self._path}")

    def release(self) -> None:
        """Take what has arrived, unsubscribe, close the bag and say what is in it."""
        for timer in self._recording_timers:
            self.destroy_timer(timer)
        self._recording_timers.clear()
        self._take_messages()
        for recorded in self._recorded.values():
            self.destroy_subscription(recorded.subscription)
        spool, self._spool = self._spool, None
        if spool is None:
            return
        failed = spool.error
        try:
            summary = spool.close(self._identity())
        except BagError as error:
            RecordNode.disk_failed = True
            print(f"bag_record: {error}", file=sys.stderr)
            summary = spool.summary
        if failed is not None:
            RecordNode.disk_failed = True
            print(f"bag_record: {failed}", file=sys.stderr)
        lines = []
        lines.append(
            f"recorded {summary.messages} messages on {len(summary.counts)} topics over "
            f"{summary.duration:.1f} s into {self._path} ({summary.size / 2**20:.2f} MiB)"
        )
        lines += [f"  {count:8d}  {name}" for name, count in sorted(summary.counts.items())]
        silent = sorted(set(self._recorded) - set(summary.counts))
        if silent:
            lines.append(f"  nothing came on: {', '.join(silent)}")
        for losses, what in zip(spool.losses, ("dropped by the recorder", "lost on the way"),
                                strict=True):  # fmt: skip
            for name, count in sorted(losses.items()):
                lines.append(f"  {count:8d}  {name}: {what}")
        print("\n".join(lines), flush=True)
        self._recorded.clear()

    def health(self) -> tuple[Status, ...]:
        """State of bag, queue and disk, and losses by topic."""
        spool = self._spool
        if spool is None:
            return ()
        dropped, lost = spool.losses
        summary = spool.summary
        values = {
            "bag": str(self._path),
            "messages": str(summary.messages),
            "bytes_on_disk": str(summary.size),
            "bytes_waiting": str(spool.waiting),
            **{f"dropped {name}": str(count) for name, count in sorted(dropped.items())},
            **{f"lost in transport {name}": str(count) for name, count in sorted(lost.items())},
        }
        error = spool.error
        if error is not None:
            return (Status(f"{self.NAME}: bag", str(error), Level.ERROR, self.NAME, values),)
        level = Level.WARN if dropped or lost else Level.OK
        text = "messages were lost" if dropped or lost else "recording"
        return (Status(f"{self.NAME}: bag", text, level, self.NAME, values),)

    # --- what to record ---------------------------------------------------------------------------

    def _selected(self, names: Sequence[str]) -> dict[str, str | None]:
        """Full topic names and their rows in the contract (None: a topic outside it)."""
        rows = {self.resolve_topic_name(name): name for name in TOPICS}
        if not names:
            return dict(rows)
        chosen = []
        for name in names:
            try:
                chosen.append(self.resolve_topic_name(name))
            except RuntimeError as error:  # what rclpy's own errors have in common
                reason = str(error).split(", at ", maxsplit=1)[0]
                raise ValueError(f"topics: {name!r} is no topic name: {reason}") from error
        return {name: rows.get(name) for name in chosen}

    def _discover(self) -> None:
        """Takes on topics that have appeared and weakens subscriptions that do not match."""
        discover = self.parameters_of(RecordParameters).discover
        present = dict(self.get_topic_names_and_types())
        for name in present if discover else self._by_name:
            if name in self._recorded or name in self._refused_topics or not present.get(name):
                continue
            offers = self.get_publishers_info_by_topic(name)
            if offers:
                self._subscribe(name, offers[0].topic_type, _matching(offers, _strong_profile()))
        for name, recorded in list(self._recorded.items()):
            offers = self.get_publishers_info_by_topic(name)
            recorded.publishers = len(offers)
            for offer in offers:
                if offer.topic_type != recorded.source.kind.name:
                    self._refuse_topic(
                        f"{name} ({offer.topic_type})",
                        f"{name} is also published as {offer.topic_type}; only "
                        f"{recorded.source.kind.name} is recorded",
                    )
            matching = _matching(offers, recorded.profile)
            if not _same(matching, recorded.profile):
                self.get_logger().warning(
                    f"{name}: a publisher offers less than the contract asks for; recording "
                    "with what it offers"
                )
                self.destroy_subscription(recorded.subscription)
                recorded.profile = matching
                recorded.subscription = self._open(recorded)

    def _subscribe(
        self, name: str, type_name: str, profile: QoSProfile, *, first: bool = False
    ) -> None:
        try:
            kind = standard_type(type_name)
            message_class(type_name)
        except (BagError, ImportError, AttributeError, TypeError, ValueError) as error:
            self._refuse_topic(name, f"{name} cannot be recorded: {error}")
            return
        recorded = _Recorded(Source(name, kind, (), first), profile)
        recorded.subscription = self._open(recorded)
        self._recorded[name] = recorded

    def _open(self, recorded: _Recorded) -> Any:
        return self.create_subscription(
            message_class(recorded.source.kind.name),
            recorded.source.name,
            _never_called,
            recorded.profile,
            callback_group=self._polled_group,
            raw=True,
        )

    def _take_messages(self) -> None:
        """Take what waits on all topics, in the order in which it has come."""
        items = [item for recorded in self._recorded.values() for item in self._waiting(recorded)]
        spool = self._spool
        if spool is None:
            return
        for item in sorted(items, key=lambda item: item.log_ns):
            spool.offer(item)
            if item.source.first and "scenario" in _configuration(item.data):
                spool.release()

    def _waiting(self, recorded: _Recorded) -> Iterator[Item]:
        """What waits on one topic, up to what its queue holds."""
        message_type = message_class(recorded.source.kind.name)
        subscription = recorded.subscription.handle
        for _ in range(_QUEUE_DEPTH):
            with subscription:
                taken = subscription.take_message(message_type, True)
            if taken is None:
                return
            yield self._item(recorded, *taken)

    def _item(self, recorded: _Recorded, data: bytes, info: Mapping[str, Any]) -> Item:
        name = recorded.source.name
        if not recorded.received:
            recorded.received = True
            offers = self.get_publishers_info_by_topic(name)
            recorded.publishers = len(offers)
            profiles = tuple(_as_rosbags(offer.qos_profile) for offer in offers)
            recorded.source = replace(recorded.source, qos=profiles)
        received = info["received_timestamp"] or time.time_ns()
        sequence = info["publication_sequence_number"] or 0
        if sequence and self._spool is not None:
            gap = recorded.continuity.gap_before(sequence, recorded.publishers)
            if gap:
                self._spool.missed(name, gap)
        sent = info["source_timestamp"] or received
        return Item(recorded.source, received, sent, sequence, data)

    def _refuse_topic(self, key: str, reason: str) -> None:
        if key not in self._refused_topics:
            self._refused_topics.add(key)
            self.get_logger().warning(reason)

    # --- what the bag says of itself --------------------------------------------------------------

    def _identity(self) -> dict[str, str]:
        names = {name: self.resolve_topic_name(name) for name in TOPICS}
        return {
            "contract_version": CONTRACT_VERSION,
            "package_version": package_version(),
            "namespace": self.get_namespace(),
            "topics": json.dumps(names, sort_keys=True),
            "log_time": "reception by the machine's clock",
        }

    @staticmethod
    def _note_configuration(data: bytes) -> tuple[str, dict[str, str]] | None:
        content = _configuration(data)
        if not content:
            return None
        note = {"node": str(content.get("node", "")), "json": json.dumps(content, sort_keys=True)}
        if "seed" in content:
            note["seed"] = str(content["seed"])
        return CONFIG_RECORD, sealed(note)

    # --- when to end ------------------------------------------------------------------------------

    def _watch(self) -> None:
        duration = self.parameters_of(RecordParameters).duration
        over = duration > 0.0 and time.monotonic() - self._began >= duration
        if over or (self._spool is not None and self._spool.error is not None):
            self.exit_code = ExitCode.OK


def _never_called(_message: object) -> None:
    raise AssertionError("the executor has taken what is left to the recorder")


def _configuration(data: bytes) -> dict[str, Any]:
    """Contents of a configuration message; empty where it holds none."""
    try:
        text = getattr(_STORE.deserialize_cdr(data, _STRING), "data", "")
        content = json.loads(text)
    except (ValueError, KeyError):
        return {}
    return content if isinstance(content, dict) else {}


def _strong_profile() -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=_QUEUE_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


def _matching(offers: Sequence[Any], requested: QoSProfile) -> QoSProfile:
    """The strongest profile, at most as strong as ``asked``, that every publisher satisfies."""
    reliable = requested.reliability == ReliabilityPolicy.RELIABLE and all(
        offer.qos_profile.reliability == ReliabilityPolicy.RELIABLE for offer in offers
    )
    latched = requested.durability == DurabilityPolicy.TRANSIENT_LOCAL and all(
        offer.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers
    )
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=requested.depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def _same(one: QoSProfile, other: QoSProfile) -> bool:
    return bool(one.reliability == other.reliability and one.durability == other.durability)


def _as_rosbags(profile: QoSProfile) -> Qos:
    """A profile as bags write it; rmw says infinite where nothing is set."""

    def span(duration: Any) -> QosTime:
        return QosTime(duration.nanoseconds // _NANO, duration.nanoseconds % _NANO)

    return Qos(
        history=_named(QosHistory, profile.history),
        depth=profile.depth,
        reliability=_named(QosReliability, profile.reliability),
        durability=_named(QosDurability, profile.durability),
        deadline=span(profile.deadline),
        lifespan=span(profile.lifespan),
        liveliness=_named(QosLiveliness, profile.liveliness),
        liveliness_lease_duration=span(profile.liveliness_lease_duration),
        avoid_ros_namespace_conventions=bool(profile.avoid_ros_namespace_conventions),
    )


def _named(kind: Any, policy: Any) -> Any:
    return kind.__members__.get(policy.name, kind.UNKNOWN)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = (
        "Record the suite's topics into an MCAP bag. Ctrl-C ends it cleanly. After a kill the file "
        "lacks at most the last half second; `mother_rover bag recover` makes a valid bag of it."
    )
    parser.epilog = (
        "Namespace, remapping and parameters as for every node: --ros-args -r __ns:=/rover1 -r "
        "config:=settings. Exit codes: 0 recorded, 1 crashed, 2 refused (arguments, or a bag that "
        "cannot be written), 4 the disk is full or failed (what was recorded until then is kept)."
    )
    parser.add_argument("-o", "--output", metavar="DIR", help="folder to create for the bag")
    parser.add_argument(
        "--topics", nargs="+", metavar="TOPIC", help="record only these (default: the contract's)"
    )
    parser.add_argument(
        "-a", "--all", action="store_true", help="also every other topic of a standard type"
    )
    parser.add_argument("-d", "--duration", type=float, metavar="S", help="end after S seconds")
    parser.add_argument("--compression", choices=("zstd", "lz4", "none"))
    parser.add_argument("--no-sync", action="store_true", help="leave it to the system when "
                        "chunks are forced onto the disk")  # fmt: skip
    parser.add_argument("--queue-mib", type=int, metavar="N", help="what may wait for a disk")
    parser.add_argument("--min-free-mib", type=int, metavar="N", help="room to leave on the disk")


def _as_ros_arguments(options: argparse.Namespace) -> list[str]:
    """Command line options as parameter assignments of the node."""
    given: dict[str, Any] = {
        "output": options.output,
        "topics": " ".join(options.topics) if options.topics else None,
        "discover": options.all or None,
        "duration": options.duration,
        "compression": options.compression,
        "sync": False if options.no_sync else None,
        "queue_mib": options.queue_mib,
        "min_free_mib": options.min_free_mib,
    }
    assignments: list[str] = []
    for name, value in given.items():
        if value is not None:
            # A quoted text stays one, even where it reads like a number.
            assignments += ["-p", f"{name}:={json.dumps(value)}"]
    return ["--ros-args", *assignments] if assignments else []


def run(options: argparse.Namespace) -> int:
    """Record until a signal or the duration ends it; return an exit code."""
    code = node_process.run(RecordNode, [*options.ros_arguments, *_as_ros_arguments(options)])
    return DISK_FAILED if RecordNode.disk_failed and code == ExitCode.OK else code


def main() -> int:
    """Run the node as `ros2 run` and launch files start it."""
    return run(parse_node_arguments(RecordNode.NAME, add_arguments))


if __name__ == "__main__":
    sys.exit(main())
