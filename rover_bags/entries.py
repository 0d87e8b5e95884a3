"""Events and refusals that a bag holds, line by line."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from msg_schemas.samples import Level, Status
from rover_bags.read import Track


@dataclass(frozen=True)
class Entry:
    """One line of the events or refusals."""

    time_s: float
    node: str
    name: str
    message: str
    level: str
    values: Mapping[str, str]


def entries_of(track: Track | None) -> Iterable[Entry]:
    """Every status of a track with its time."""
    if track is None:
        return
    for time, statuses in zip(track.time, track.statuses, strict=True):
        for status in statuses:
            yield _entry(float(time), status)


def _entry(time: float, status: Status) -> Entry:
    level = Level(status.level).name.lower()
    return Entry(time, status.hardware_id, status.name, status.message, level, dict(status.values))
