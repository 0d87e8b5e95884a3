"""``mother_rover bag recover``: make a valid bag of a truncated or damaged one.

Copies intact messages byte by byte and reports damaged parts, which it skips. The damaged bag is
only read.
"""

import argparse
import json
import sys
from dataclasses import dataclass, replace
from enum import IntEnum
from itertools import chain
from pathlib import Path

from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.metadata import parse_qos

from rover_bags.files.folder import ScanError, stored_metadata
from rover_bags.files.records import Damage, DeclaredTopic
from rover_bags.files.scan import BagScan
from rover_bags.files.store import BagError, BagSummary, BagWriter, TopicType

RECOVERY_RECORD = "mother_rover.recovery"


class RecoverExitCode(IntEnum):
    """Exit codes of ``mother_rover bag recover``."""

    COMPLETE = 0
    LOSSES = 1
    REFUSED = 2
    NOT_WRITTEN = 3


@dataclass(frozen=True)
class RecoveredBag:
    """Result of the recovery of a bag.

    Attributes:
        source: The damaged bag.
        was_closed: Whether its recorder had closed it.
        had_metadata: Whether it had a valid ``metadata.yaml``.
        summary: Summary of the new bag.
        damage: Damaged parts, which were skipped.
        lost: Messages known to be lost, by topic. Without an index of the file, only those of
            damaged chunks that are followed by their own index.
        unverified: Recovered messages without a checksum, by topic.
        attachments: Number of skipped attachments; they carry no messages.
    """

    source: Path
    was_closed: bool
    had_metadata: bool
    summary: BagSummary
    damage: tuple[Damage, ...]
    lost: dict[str, int]
    unverified: dict[str, int]
    attachments: int

    @property
    def complete(self) -> bool:
        """Whether every message of the damaged bag was recovered."""
        return not (self.damage or self.lost or self.attachments)

    def text(self) -> str:
        """The report that the command prints."""
        summary = self.summary
        lines = [
            f"{self.source}: "
            + ("closed by its recorder" if self.was_closed else "never closed by its recorder")
            + ("" if self.had_metadata else ", without a valid metadata.yaml"),
        ]
        lines.append(
            f"recovered {summary.messages} messages on {len(summary.counts)} topics over "
            f"{summary.duration:.3f} s into {summary.path} ({summary.size / 1024:.1f} KiB)"
        )
        lines += [f"  {count:8d}  {topic}" for topic, count in sorted(summary.counts.items())]
        if self.unverified:
            total = sum(self.unverified.values())
            lines.append(
                f"{total} of them have no checksum in the source: they were copied unverified"
            )
        if self.complete:
            lines.append("every message of the bag was recovered")
            if not self.was_closed:
                lines.append(
                    "messages that its recorder had not written yet are not in the file "
                    "(mother_rover bag record: at most the last half second)"
                )
            return "\n".join(lines)
        lines.append("skipped:")
        for item in self.damage:
            where = f"{item.file}, byte {item.offset}" + (
                f" to {item.offset + item.length}" if item.length else ""
            )
            when = ""
            if item.span_ns is not None and summary.first_ns:
                begin, end = ((value - summary.first_ns) * 1e-9 for value in item.span_ns)
                when = f", messages {begin:.3f} s to {end:.3f} s after the first recovered one"
            lines.append(f"  {where}: {item.reason}{when}")
        if self.lost:
            lines.append(f"  {sum(self.lost.values())} messages are known to be lost:")
            lines += [f"  {count:8d}  {topic}" for topic, count in sorted(self.lost.items())]
        elif self.damage:
            lines.append("  number of lost messages unknown: the file has no index")
        if self.attachments:
            lines.append(f"  {self.attachments} attachments (they carry no messages)")
        return "\n".join(lines)


def recover(source: Path, target: Path, *, compression: str = "zstd") -> RecoveredBag:
    """Copy the intact messages of a bag into a new bag.

    Args:
        source: The damaged bag: its folder or one of its files. It is only read.
        target: Folder to create.
        compression: Compression of the new bag's chunks.

    Raises:
        ScanError: The source is not a bag, or nothing can be recovered from it.
        BagError: The target cannot be written; nothing of it is left.
    """
    scan = BagScan(source)
    if target.exists() and target.samefile(source):
        raise ScanError(
            f"{target} is the damaged bag itself, which is only read; choose a new folder"
        )
    messages = iter(scan)
    first = next(messages, None)
    if first is None:
        why = "; ".join(item.reason for item in scan.damage) or "it holds no message"
        raise ScanError(f"nothing can be recovered from {source}: {why}")
    with BagWriter(target, compression=compression, sync=False) as writer:
        channels: dict[DeclaredTopic, int] = {}
        copied = 0
        for message in chain([first], messages):
            copied = _copy_metadata(scan, writer, copied)
            if message.topic not in channels:
                channels[message.topic] = _declare(writer, message.topic)
            writer.write(
                channels[message.topic],
                message.log_ns,
                message.publish_ns,
                message.data,
                message.sequence,
            )
        _copy_metadata(scan, writer, copied)
        for topic in scan.declared_topics:
            if topic not in channels:
                channels[topic] = _declare(writer, topic)
        recovery = RecoveredBag(
            source=source,
            was_closed=scan.closed,
            had_metadata=stored_metadata(source) is not None,
            summary=writer.summary,
            damage=tuple(scan.damage),
            lost=scan.lost,
            unverified=dict(scan.unverified),
            attachments=sum(file.attachments for file in scan.files),
        )
        writer.add_metadata(RECOVERY_RECORD, {"source": str(source), "text": recovery.text()})
        summary = writer.close({"recovered_from": str(source)})
    return replace(recovery, summary=summary)


def _copy_metadata(scan: BagScan, writer: BagWriter, copied: int) -> int:
    """Copy the metadata records found since the last call, except rosbag2's own."""
    found = scan.metadata
    for name, values in found[copied:]:
        if name != "rosbag2":
            writer.add_metadata(name, values)
    return len(found)


def _declare(writer: BagWriter, topic: DeclaredTopic) -> int:
    kind = TopicType(
        topic.type,
        topic.schema.encode(),
        topic.schema_encoding or "ros2msg",
        topic.type_hash,
        topic.encoding,
    )
    try:
        profiles = parse_qos(topic.qos)
    except (ReaderError, KeyError, TypeError):
        profiles = []
    return writer.add_topic(topic.name, kind, profiles)


def as_json(recovery: RecoveredBag) -> str:
    """Return the recovery as JSON."""
    summary = recovery.summary
    content = {
        "source": str(recovery.source),
        "target": str(summary.path),
        "was_closed": recovery.was_closed,
        "complete": recovery.complete,
        "messages": summary.messages,
        "duration_s": summary.duration,
        "recovered": dict(summary.counts),
        "lost": recovery.lost,
        "unverified": recovery.unverified,
        "damage": [item.__dict__ for item in recovery.damage],
    }
    return json.dumps(content, indent=2)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = (
        "Make a valid bag of one whose recorder was killed, whose disk filled up or whose file is "
        "damaged. The damaged bag is only read."
    )
    parser.epilog = (
        "Exit codes: 0 every message was recovered, 1 damaged parts were skipped, 2 no bag or "
        "nothing to recover, 3 the new bag could not be written."
    )
    parser.add_argument("damaged", type=Path, help="the damaged bag: its folder or its file")
    parser.add_argument("out", type=Path, help="the new bag: a folder that does not exist yet")
    parser.add_argument("--compression", choices=("zstd", "lz4", "none"), default="zstd")
    parser.add_argument("--json", action="store_true", help="print the report as JSON")


def run(options: argparse.Namespace) -> int:
    """Run the command; return an :class:`RecoverExitCode`."""
    try:
        recovery = recover(options.damaged, options.out, compression=options.compression)
    except ScanError as error:
        print(f"mother_rover bag recover: {error}", file=sys.stderr)
        return RecoverExitCode.REFUSED
    except BagError as error:
        print(f"mother_rover bag recover: {error}", file=sys.stderr)
        return RecoverExitCode.NOT_WRITTEN
    print(as_json(recovery) if options.json else recovery.text())
    return RecoverExitCode.COMPLETE if recovery.complete else RecoverExitCode.LOSSES
