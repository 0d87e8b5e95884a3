"""Wait until a recorder has written every stream of the simulator to its bag."""

from __future__ import annotations

import threading
import time
from pathlib import Path

from msg_schemas.access import ACCESS
from msg_schemas.table import TOPICS
from rover_bags.files.scan import BagScan
from rover_bags.files.store import BagError
from rover_verify.harness.processes import DEFAULT_TIMEOUT

STREAMS = frozenset(
    row.name.strip("/")
    for row in TOPICS.values()
    if row.name in ACCESS["sim_node"].publishes and row.rate and not row.spatial_only
)
_POLL_PERIOD = 0.2


def recorded_topics(bag: Path) -> set[str]:
    """Topics with messages on disk in a bag, finished or not."""
    try:
        return {message.topic.name.strip("/") for message in BagScan(bag)}
    except BagError:
        return set()


def missing_streams(bag: Path) -> list[str]:
    """Streams of the simulator without messages in the bag."""
    return sorted(STREAMS - recorded_topics(bag))


def wait_until_recording(bag: Path, timeout: float = DEFAULT_TIMEOUT) -> None:
    """Wait until every stream of the simulator is in the bag; AssertionError if it is not."""
    deadline = time.monotonic() + timeout
    pause = threading.Event()
    while missing := missing_streams(bag):
        assert time.monotonic() < deadline, f"{bag} has no {missing} after {timeout:g} s"
        pause.wait(_POLL_PERIOD)
