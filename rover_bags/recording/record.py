"""The recorder node: `mother_rover bag record`, and the executable `bag_record` of launch files.

Records the contract's topics (or a selection, or every discovered topic) in serialised form. The
bag remains readable if the recorder is killed, the disk fills up or the machine loses power.

Streams are received in batches (``rover_runtime.batches``) from publishers that send them,
otherwise on their topics. All topics but requests are subscribed to once somebody publishes them:
so `ros2 topic list` shows what there is.

Log time is the reception by the middleware, publication time the time of sending, both by the wall
clock; the time that a message waits in its batch is no part of its log time. So no message has time
0 before the first ``/clock``, times increase across resets of simulated time, and transport latency
can be measured. Simulated time is in the messages' headers and in the recorded clock.
"""

import argparse
import json
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSProfile
from std_msgs.msg import UInt8MultiArray

from msg_schemas import qos, topics
from msg_schemas.cdr import unpack
from msg_schemas.message_types import message_class
from msg_schemas.name_arguments import topic_name
from msg_schemas.number_arguments import positive, whole_number
from msg_schemas.package import package_version
from msg_schemas.parameters import parameter
from msg_schemas.refusal import Refusal
from msg_schemas.samples import Level, Status
from msg_schemas.specifications import Intent
from msg_schemas.table import CONTRACT_VERSION, TOPICS
from msg_schemas.text_limits import printable
from rover_bags.files.store import (
    IDENTITY_RECORD,
    BagError,
    BagWriter,
    standard_type,
    with_checksum,
)
from rover_bags.files.write_queue import Item, Source, WriteQueue
from rover_bags.recording.offered_qos import QUEUE_DEPTH, are_equal, as_rosbags, strongest_profile
from rover_bags.recording.recorded_topic import RecordedTopic
from rover_bags.recording.sending_order import SendingOrder, times_in_batch
from rover_runtime.batches import STREAMS
from rover_runtime.component import ExitCode, Groups
from rover_runtime.port import Port
from rover_runtime.ros import process
from rover_runtime.ros.arguments import parse_node_arguments
from rover_runtime.ros.batches import BatchSubscription
from rover_runtime.ros.endpoint_matching import publisher_counts
from rover_runtime.ros.node import RosComponent
from rover_runtime.ros.timers import steady_timer
from rover_runtime.ros.waiting_messages import taken
from rover_runtime.text_output import print_or_discard

CONFIG_RECORD = "mother_rover.config"
_DISCOVERY_PERIOD = 0.2
_TAKE_PERIOD = 0.05
_ORDERING_NS = 150_000_000  # longest wait in a batch and for its transport [ns]
_WATCH_PERIOD = 0.1
DISK_FAILED = 4
"""Exit code of a recording that ended because the disk failed."""


@dataclass(frozen=True)
class RecordParameters:
    """Parameters of the recorder."""

    output: str = parameter(
        "", "-", "folder of the new bag; empty = named by date and time", read_only=True
    )
    topics: str = parameter(
        "", "-", "topics to record, separated by blanks; empty = all topics of the contract",
        read_only=True,
    )  # fmt: skip
    discover: bool = parameter(
        False, "-", "also record every discovered topic of a standard type", read_only=True
    )
    duration: float = parameter(
        0.0,
        "s",
        "wall time after which recording ends; 0 = until a signal",
        0.0,
        1e7,
        read_only=True,
    )
    compression: str = parameter(
        "zstd",
        "-",
        "compression of the bag's chunks",
        choices=("zstd", "lz4", "none"),
        read_only=True,
    )
    chunk_period: float = parameter(
        0.25, "s", "longest time before a message is written to disk", 0.02, 60.0, read_only=True
    )
    sync: bool = parameter(
        True, "-", "force every chunk onto the disk, against loss of power", read_only=True
    )
    queue_mib: int = parameter(
        64,
        "MiB",
        "queue size for a stalled disk, beyond which messages are dropped",
        1,
        4096,
        read_only=True,
    )
    min_free_mib: int = parameter(
        16, "MiB", "free space at which the disk counts as full", 0, 1_000_000, read_only=True
    )


class RecordNode(RosComponent):
    """Records topics into an MCAP bag."""

    NAME = "bag_record"
    PARAMETERS = (RecordParameters,)
    END_TIMEOUT = 600.0  # a slow disk takes its time to write what waits for it
    disk_failed: ClassVar[bool] = False

    def __init__(self, port: Port, groups: Groups) -> None:
        super().__init__(port, groups)
        self._recorded: dict[str, RecordedTopic] = {}
        self._refused_topics: set[str] = set()
        self._by_name: list[str] = []
        self._queue: WriteQueue | None = None
        self._path = Path()
        self._batches: BatchSubscription | None = None
        self._received = SendingOrder()
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
        self._path = Path(options.output or f"rover_bag_{stamp}").expanduser()
        writer = BagWriter(
            self._path,
            compression=options.compression,
            chunk_period=options.chunk_period,
            sync=options.sync,
            reserve=options.min_free_mib << 20,
        )
        writer.add_metadata(IDENTITY_RECORD, with_checksum(self._identity()))
        self._queue = WriteQueue(
            writer, limit=options.queue_mib << 20, metadata_of=self._configuration_record
        )
        self._began = time.monotonic()
        self._batches = BatchSubscription(self.ros)
        for topic in STREAMS & {*selected.values()}:
            self._batches.add(topic)
        for subscription in self._batches.subscriptions:
            self.ros.poll(subscription)
        for name, contract_name in selected.items():
            if contract_name is not None:
                self._add(
                    name,
                    TOPICS[contract_name].message,
                    qos.profile(TOPICS[contract_name].intent, QUEUE_DEPTH),
                    first=contract_name == topics.CONFIG,
                    waits=_waits_for_publisher(contract_name),
                )
        self._by_name = [name for name, contract_name in selected.items() if contract_name is None]
        for name in self._by_name:
            self.ros.get_logger().warning(
                f"{name} is no topic of the contract; it is recorded if somebody publishes it"
            )
        self._recording_timers = [
            steady_timer(self.ros, _DISCOVERY_PERIOD, self._discover),
            steady_timer(self.ros, _WATCH_PERIOD, self._watch),
            steady_timer(self.ros, _TAKE_PERIOD, self._take_messages),
        ]
        self._discover()
        self.ros.get_logger().info(f"recording into {self._path}")

    def release(self) -> None:
        """Take the received messages, unsubscribe, close the bag and print its summary."""
        for timer in self._recording_timers:
            self.ros.destroy_timer(timer)
        self._recording_timers.clear()
        self._take_messages(at_end=True)
        if self._batches is not None:
            self._batches.close()
        for recorded in self._recorded.values():
            if recorded.subscription is not None:
                self.ros.destroy_subscription(recorded.subscription)
        queue, self._queue = self._queue, None
        if queue is None:
            return
        failed = queue.error
        # What is printed may go to the disk that is full.
        try:
            summary = queue.close(self._identity())
        except BagError as error:
            RecordNode.disk_failed = True
            print_or_discard(f"bag_record: {error}", sys.stderr)
            summary = queue.summary
        if failed is not None:
            RecordNode.disk_failed = True
            print_or_discard(f"bag_record: {failed}", sys.stderr)
        lines = []
        lines.append(
            f"recorded {summary.messages} messages on {len(summary.counts)} topics over "
            f"{summary.duration:.1f} s into {self._path} ({summary.size / 2**20:.2f} MiB)"
        )
        lines += [f"  {count:8d}  {name}" for name, count in sorted(summary.counts.items())]
        empty = sorted({*self._recorded, *self._by_name} - set(summary.counts))
        if empty:
            lines.append(f"  no message received on: {', '.join(empty)}")
        for losses, what in zip(queue.losses, ("dropped by the recorder", "lost in transport"),
                                strict=True):  # fmt: skip
            for name, count in sorted(losses.items()):
                lines.append(f"  {count:8d}  {name}: {what}")
        print_or_discard("\n".join(lines), sys.stdout)
        self._recorded.clear()

    def health(self) -> tuple[Status, ...]:
        """Return the state of bag, queue and disk, and losses by topic."""
        queue = self._queue
        if queue is None:
            return ()
        dropped, lost = queue.losses
        summary = queue.summary
        values = {
            "bag": str(self._path),
            "messages": str(summary.messages),
            "bytes_on_disk": str(summary.size),
            "bytes_waiting": str(queue.waiting),
            **{f"dropped {name}": str(count) for name, count in sorted(dropped.items())},
            **{f"lost in transport {name}": str(count) for name, count in sorted(lost.items())},
        }
        error = queue.error
        if error is not None:
            return (Status(f"{self.NAME}: bag", str(error), Level.ERROR, self.NAME, values),)
        level = Level.WARN if dropped or lost else Level.OK
        text = "messages were lost" if dropped or lost else "recording"
        return (Status(f"{self.NAME}: bag", text, level, self.NAME, values),)

    # --- selection of topics ----------------------------------------------------------------------

    def _selected(self, names: Sequence[str]) -> dict[str, str | None]:
        """Full topic names and their contract names (None: a topic outside the contract)."""
        contract = {self.ros.resolve_topic_name(name): name for name in TOPICS}
        if not names:
            return dict(contract)
        chosen = []
        for name in names:
            try:
                chosen.append(self.ros.resolve_topic_name(name))
            except RuntimeError as error:  # base class of rclpy's errors
                reason = str(error).split(", at ", maxsplit=1)[0]
                raise ValueError(f"topics: {name!r} is not a valid topic name: {reason}") from error
        return {name: contract.get(name) for name in chosen}

    def _discover(self) -> None:
        """Subscribe to new topics, and relax the QoS of subscriptions that do not match."""
        discover = self.parameters_of(RecordParameters).discover
        searched = discover or self._by_name
        present = dict(self.ros.get_topic_names_and_types()) if searched else {}
        for name in present if discover else self._by_name:
            if name in self._recorded or name in self._refused_topics or not present.get(name):
                continue
            offers = self.ros.get_publishers_info_by_topic(name)
            if offers:
                self._add(name, offers[0].topic_type, strongest_profile(offers))
        counts = publisher_counts(self.ros, self._recorded)
        self._follow_publishers(counts)
        for name, recorded in self._recorded.items():
            if counts[name] == recorded.compared:
                continue
            offers = self.ros.get_publishers_info_by_topic(name)
            recorded.compared = len(offers)
            for offer in offers:
                if offer.topic_type != recorded.source.kind.name:
                    self._refuse_topic(
                        f"{name} ({offer.topic_type})",
                        f"{name} is also published as {offer.topic_type}; only "
                        f"{recorded.source.kind.name} is recorded",
                    )
            matching = strongest_profile(offers, recorded.profile)
            if not are_equal(matching, recorded.profile):
                self.ros.get_logger().warning(
                    f"{name}: a publisher offers a weaker QoS than the contract requires; "
                    "recording with the offered QoS"
                )
                recorded.profile = matching
                if recorded.subscription is not None:
                    self.ros.destroy_subscription(recorded.subscription)
                    recorded.subscription = self._open(recorded)

    def _follow_publishers(self, counts: Mapping[str, int]) -> None:
        """Subscribe to what is published, but to the streams that arrive in batches."""
        assert self._batches is not None
        self._batches.look()
        for name, recorded in self._recorded.items():
            is_covered = name in self._batches.covered
            if is_covered and recorded.subscription is not None:
                self._received.add(self._waiting(recorded))
                self.ros.destroy_subscription(recorded.subscription)
                recorded.subscription = None
            is_needed = not is_covered and (not recorded.waits or counts[name] > 0)
            if is_needed and recorded.subscription is None:
                recorded.subscription = self._open(recorded)

    def _add(
        self,
        name: str,
        type_name: str,
        profile: QoSProfile,
        *,
        first: bool = False,
        waits: bool = False,
    ) -> None:
        try:
            kind = standard_type(type_name)
            message_class(type_name)
        except (BagError, ImportError, AttributeError, TypeError, ValueError) as error:
            self._refuse_topic(name, f"{name} cannot be recorded: {error}")
            return
        self._recorded[name] = RecordedTopic(
            Source(name, kind, (), first),
            profile,
            partial(self.ros.count_publishers, name),
            waits,
        )

    def _open(self, recorded: RecordedTopic) -> Any:
        subscription = self.ros.create_subscription(
            message_class(recorded.source.kind.name),
            recorded.source.name,
            _never_called,
            recorded.profile,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            raw=True,
        )
        self.ros.poll(subscription)
        return subscription

    def _take_messages(self, *, at_end: bool = False) -> None:
        """Take the received messages of all topics and queue them in order of their log times."""
        queue = self._queue
        if queue is None:
            return
        for recorded in self._recorded.values():
            self._received.add(self._waiting(recorded))
        self._received.add(self._in_batches())
        until_ns = sys.maxsize if at_end else time.time_ns() - _ORDERING_NS
        for item in self._received.take(until_ns):
            queue.offer(item)
            if item.source.first and "scenario" in _configuration(item.data):
                queue.release()

    def _waiting(self, recorded: RecordedTopic) -> Iterator[Item]:
        """Received messages of one topic."""
        if recorded.subscription is None:
            return
        kind = message_class(recorded.source.kind.name)
        for data, info in taken(recorded.subscription, kind, QUEUE_DEPTH):
            received = info["received_timestamp"] or time.time_ns()
            sent = max(info["source_timestamp"], 0) or received
            number = info["publication_sequence_number"] or 0
            recorded.sent_ns = sent
            self._count_lost(recorded, recorded.lost_on_topic(number))
            yield self._item(recorded, received, sent, number, data)

    def _in_batches(self) -> Iterator[Item]:
        """Received messages of streams."""
        assert self._batches is not None
        for subscription in self._batches.subscriptions:
            for batch, info in taken(subscription, UInt8MultiArray, QUEUE_DEPTH):
                received = info["received_timestamp"] or time.time_ns()
                batch_sent = info["source_timestamp"] or received
                for name, number, given, data in self._batches.read(batch):
                    logged, sent = times_in_batch(given, batch_sent, received)
                    recorded = self._recorded[name]
                    self._count_lost(recorded, recorded.lost_in_batches(number))
                    # Not again what has arrived on the topic, a little after this time of sending.
                    if recorded.subscription is None and sent > recorded.sent_ns:
                        yield self._item(recorded, logged, sent, number, data)

    def _item(
        self, recorded: RecordedTopic, log_ns: int, publish_ns: int, number: int, data: bytes
    ) -> Item:
        name = recorded.source.name
        if not recorded.received:
            recorded.received = True
            offers = self.ros.get_publishers_info_by_topic(name)
            profiles = tuple(as_rosbags(offer.qos_profile) for offer in offers)
            recorded.source = replace(recorded.source, qos=profiles)
        return Item(recorded.source, log_ns, publish_ns, number, data)

    def _count_lost(self, recorded: RecordedTopic, count: int) -> None:
        if count and self._queue is not None:
            self._queue.count_lost(recorded.source.name, count)

    def _refuse_topic(self, key: str, reason: str) -> None:
        if key not in self._refused_topics:
            self._refused_topics.add(key)
            self.ros.get_logger().warning(reason)

    # --- identity of the bag -------------------------------------------------------------------

    def _identity(self) -> dict[str, str]:
        names = {name: self.ros.resolve_topic_name(name) for name in TOPICS}
        return {
            "contract_version": CONTRACT_VERSION,
            "package_version": package_version(),
            "namespace": self.ros.get_namespace(),
            "topics": json.dumps(names, sort_keys=True),
            "log_time": "reception by the machine's clock",
        }

    @staticmethod
    def _configuration_record(data: bytes) -> tuple[str, dict[str, str]] | None:
        content = _configuration(data)
        if not content:
            return None
        values = {
            "node": printable(str(content.get("node", ""))),
            "json": json.dumps(content, sort_keys=True),
        }
        if "seed" in content:
            values["seed"] = printable(str(content["seed"]))
        return CONFIG_RECORD, with_checksum(values)

    # --- end of the recording ---------------------------------------------------------------------

    def _watch(self) -> None:
        duration = self.parameters_of(RecordParameters).duration
        over = duration > 0.0 and time.monotonic() - self._began >= duration
        if over or (self._queue is not None and self._queue.error is not None):
            self.exit_code = ExitCode.OK


def _never_called(_message: object) -> None:
    raise AssertionError("the executor executed a subscription that the recorder polls")


def _waits_for_publisher(topic: str) -> bool:
    """Whether to subscribe once somebody publishes; of a request the only message would be lost."""
    return bool(TOPICS[topic].owned) or TOPICS[topic].intent is not Intent.COMMAND


def _configuration(data: bytes) -> dict[str, Any]:
    """Contents of a configuration message; empty if it is not valid."""
    try:
        content: dict[str, Any] = json.loads(unpack(topics.CONFIG, data).text)
    except Refusal:
        return {}
    return content


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
    parser.add_argument("-o", "--output", metavar="DIR", help="folder of the new bag")
    parser.add_argument(
        "--topics",
        nargs="+",
        action="extend",
        type=topic_name,
        metavar="TOPIC",
        help="record only these topics (default: those of the contract)",
    )
    parser.add_argument(
        "-a", "--all", action="store_true", help="also record every other topic of a standard type"
    )
    parser.add_argument("-d", "--duration", type=float, metavar="S", help="end after S seconds")
    parser.add_argument("--compression", choices=("zstd", "lz4", "none"))
    parser.add_argument("--no-sync", action="store_true", help="do not force chunks onto the "
                        "disk (faster, less safe on power loss)")  # fmt: skip
    parser.add_argument(
        "--queue-mib", type=positive, metavar="N", help="queue size for a stalled disk"
    )
    parser.add_argument(
        "--min-free-mib", type=whole_number(0), metavar="N", help="free space to leave on the disk"
    )


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
            # Quote texts, so that one that looks like a number stays a text.
            assignments += ["-p", f"{name}:={json.dumps(value)}"]
    return ["--ros-args", *assignments] if assignments else []


def run(options: argparse.Namespace) -> int:
    """Record until a signal or the duration ends it; return an exit code."""
    code = process.run(RecordNode, arguments=[*options.ros_arguments, *_as_ros_arguments(options)])
    return DISK_FAILED if RecordNode.disk_failed and code == ExitCode.OK else code


def main() -> int:
    """Run the node as `ros2 run` and launch files start it."""
    return run(parse_node_arguments(RecordNode.NAME, add_arguments))


if __name__ == "__main__":
    sys.exit(main())
