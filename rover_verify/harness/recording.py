"""What a recorder has written to its bag."""

from __future__ import annotations

from pathlib import Path

from msg_schemas.access import ACCESS
from msg_schemas.table import TOPICS
from rover_bags.files.scan import BagScan
from rover_bags.files.store import BagError

STREAMS = frozenset(
    row.name.strip("/")
    for row in TOPICS.values()
    if row.name in ACCESS["sim_node"].publishes and row.rate and not row.spatial_only
)


def recorded_topics(bag: Path) -> set[str]:
    """Topics with messages on disk in a bag, finished or not."""
    try:
        return {message.topic.name.strip("/") for message in BagScan(bag)}
    except BagError:
        return set()


def missing_streams(bag: Path) -> list[str]:
    """Streams of the simulator without messages in the bag."""
    return sorted(STREAMS - recorded_topics(bag))
