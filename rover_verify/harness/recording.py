"""When a recorder can be relied on: every stream of the simulator has reached its file."""

from __future__ import annotations

import threading
import time
from pathlib import Path

from msg_schemas.table import TOPICS
from rover_bags.files.scan import BagScan
from rover_bags.files.store import BagError
from rover_verify.harness.processes import PATIENCE

STREAMS = frozenset(
    row.name.strip("/")
    for row in TOPICS.values()
    if "sim_node" in row.publisher and row.rate and not row.spatial_only
)
_LOOK = 0.2


def recorded_topics(bag: Path) -> set[str]:
    """Names of the topics of which a bag, finished or not, holds messages on disk."""
    try:
        return {message.topic.name.strip("/") for message in BagScan(bag)}
    except BagError:
        return set()


def missing_streams(bag: Path) -> list[str]:
    """Streams of the simulator of which the bag holds nothing yet."""
    return sorted(STREAMS - recorded_topics(bag))


def wait_until_recording(bag: Path, timeout: float = PATIENCE) -> None:
    """Wait until every stream of the simulator is in the bag; AssertionError if it is not."""
    give_up = time.monotonic() + timeout
    pause = threading.Event()
    while missing := missing_streams(bag):
        assert time.monotonic() < give_up, f"{bag} holds nothing of {missing} after {timeout:g} s"
        pause.wait(_LOOK)
