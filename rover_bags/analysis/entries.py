"""Events and refusals recorded in a bag."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from msg_schemas.samples import Level, Status
from rover_bags.reading.read import TimeSeries


@dataclass(frozen=True)
class TimelineEntry:
    """One recorded event or refusal.

    Attributes:
        time_s: Simulated time [s]; after a reset a bag may hold the same time twice.
        log_ns: Time of reception [ns since 1970].
        node, name, message, level, values: Fields of the recorded status.
    """

    time_s: float
    log_ns: int
    node: str
    name: str
    message: str
    level: str
    values: Mapping[str, str]


def entries_of(series: TimeSeries | None) -> Iterable[TimelineEntry]:
    """Yield every status of a series with its time."""
    if series is None:
        return
    for time, log_ns, statuses in zip(series.time, series.log_ns, series.statuses, strict=True):
        for status in statuses:
            yield _entry(float(time), int(log_ns), status)


def _entry(time: float, log_ns: int, status: Status) -> TimelineEntry:
    level = Level(status.level).name.lower()
    fields = (status.hardware_id, status.name, status.message, level, dict(status.values))
    return TimelineEntry(time, log_ns, *fields)
