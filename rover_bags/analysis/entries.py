"""Events and refusals that a bag holds, line by line."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from msg_schemas.samples import Level, Status
from rover_bags.read import TimeSeries


@dataclass(frozen=True)
class Entry:
    """One line of the events or refusals.

    Attributes:
        time_s: Simulated time [s].
        log_ns: When it was received [ns since 1970]: simulated time may be passed twice.
        node, name, message, level, values: What was said.
    """

    time_s: float
    log_ns: int
    node: str
    name: str
    message: str
    level: str
    values: Mapping[str, str]


def entries_of(track: TimeSeries | None) -> Iterable[Entry]:
    """Every status of a track with its time."""
    if track is None:
        return
    for time, log_ns, statuses in zip(track.time, track.log_ns, track.statuses, strict=True):
        for status in statuses:
            yield _entry(float(time), int(log_ns), status)


def _entry(time: float, log_ns: int, status: Status) -> Entry:
    level = Level(status.level).name.lower()
    said = (status.hardware_id, status.name, status.message, level, dict(status.values))
    return Entry(time, log_ns, *said)
