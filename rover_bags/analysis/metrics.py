"""Everything that a bag tells in numbers, and how well its topics were recorded."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from msg_schemas import topics
from msg_schemas.table import TOPICS, Intent
from rover_bags.analysis.activities import (
    Descent,
    Drive,
    ImagingStop,
    Traverse,
    descents_of,
    drives_of,
    imaging_stops_of,
    traverses_of,
)
from rover_bags.analysis.audits import Audits, audits_of
from rover_bags.analysis.entries import Entry, entries_of
from rover_bags.analysis.jumps import Jump, jumps_of
from rover_bags.analysis.timeline import Timeline, timeline_of
from rover_bags.analysis.wall_coverage import Coverage, measure_coverage, observations_of
from rover_bags.read import Bag, TimeSeries


@dataclass(frozen=True)
class TopicMetrics:
    """How one topic was recorded.

    Rates and gaps are by the clock that paces the topic: simulated time, or the machine's for
    what nodes say of their health.

    Attributes:
        topic: Name in the contract, or the full name of a topic outside it.
        type: Message type.
        count: Messages.
        expected_hz: Rate that the contract promises; None where it promises none.
        rate_hz: Messages per second between the first and the last, of each run where the clock
            was put back.
        wall_rate_hz: The same by the machine's clock.
        max_gap_s: Longest pause between messages.
        max_gap_at_s: When it began, in simulated time.
        slow_hz: Usual rate of a topic that came more slowly than promised all the time, as who sent
            it did not keep the promise or who recorded it did not take all; None otherwise.
        gaps: Pauses of more than 1.75 periods, promised or usual.
        latency_p50_ms, latency_p99_ms, latency_max_ms: From sending to reception, machine's
            clock; without messages sent before the recorder was listening, and None for latched
            topics, which may be received long after they were sent.
        age_p50_ms, age_p99_ms: From the stamp to the reception, by the clock that the stamps
            follow (simulated time, or the machine's); to within what that clock resolves.
        dropped: Messages that the recorder could not keep.
        lost_in_transport: Messages lost before they reached the recorder.
        rejected: Messages that break the contract.
        unverified: Messages that no checksum protects.
    """

    topic: str
    type: str
    count: int
    expected_hz: float | None
    rate_hz: float | None
    wall_rate_hz: float | None
    max_gap_s: float | None
    max_gap_at_s: float | None
    slow_hz: float | None
    gaps: int | None
    latency_p50_ms: float | None
    latency_p99_ms: float | None
    latency_max_ms: float | None
    age_p50_ms: float | None
    age_p99_ms: float | None
    dropped: int
    lost_in_transport: int
    rejected: int
    unverified: int


@dataclass(frozen=True)
class Metrics:
    """Everything that a bag tells in numbers."""

    timeline: Timeline
    descents: tuple[Descent, ...]
    drives: tuple[Drive, ...]
    traverses: tuple[Traverse, ...]
    imaging_stops: tuple[ImagingStop, ...]
    coverage: Coverage | None
    audits: Audits
    jumps: tuple[Jump, ...]
    topics: Mapping[str, TopicMetrics]
    events: tuple[Entry, ...]
    refusals: tuple[Entry, ...]
    duration_s: float
    simulated_s: float | None

    def to_mapping(self) -> dict[str, Any]:
        """Plain values for JSON; the figures of the first jump stand at the top as well."""
        first = asdict(self.jumps[0]) if self.jumps else {}
        names = (
            "jump_height_m", "attitude_variation_rad", "slack", "peak_tension_N",
            "energy_drift_J", "flight_time_s", "travel_m",
        )  # fmt: skip
        return {
            **{name: first.get(name) for name in names},
            "duration_s": self.duration_s,
            "simulated_s": self.simulated_s,
            "activities": [
                {"activity": p.activity.value, "begin_s": p.begin_s, "end_s": p.end_s}
                for p in self.timeline.intervals
            ],
            "timeline_events": [
                {"event": m.kind.value, "time_s": m.time_s, "reason": m.reason}
                for m in self.timeline.events
            ],
            "descents": [asdict(descent) for descent in self.descents],
            "drives": [asdict(drive) for drive in self.drives],
            "traverses": [asdict(traverse) for traverse in self.traverses],
            "imaging_stops": [asdict(stop) for stop in self.imaging_stops],
            "coverage": None if self.coverage is None else asdict(self.coverage),
            "audits": asdict(self.audits),
            "jumps": [asdict(jump) for jump in self.jumps],
            "topics": {name: asdict(topic) for name, topic in self.topics.items()},
            "events": [asdict(entry) for entry in self.events],
            "refusals": [asdict(entry) for entry in self.refusals],
        }


def measure(bag: Bag) -> Metrics:
    """All figures of a bag."""
    clock = bag.timings.get(topics.CLOCK)
    events = tuple(entries_of(bag.series(topics.EVENTS)))
    timeline = timeline_of(bag)
    images = bag.series(topics.DESCENT_OBSERVATION)
    return Metrics(
        timeline=timeline,
        descents=descents_of(bag, timeline),
        drives=drives_of(bag, timeline),
        traverses=traverses_of(bag, timeline),
        imaging_stops=imaging_stops_of(bag, timeline),
        coverage=None if images is None else measure_coverage(observations_of(images)),
        audits=audits_of(bag, timeline),
        jumps=tuple(jumps_of(bag, events, timeline)),
        topics=_topic_metrics(bag),
        events=events,
        refusals=tuple(
            entry for entry in entries_of(bag.series(topics.DIAGNOSTICS)) if "code" in entry.values
        ),
        duration_s=bag.duration,
        simulated_s=clock.running * 1e-9 if clock is not None else None,
    )


# --- topics -------------------------------------------------------------------------------------


def _topic_metrics(bag: Bag) -> dict[str, TopicMetrics]:
    contract = {full: name for name, full in bag.full_names.items()}
    names = sorted(set(bag.counts) | set(bag.dropped) | set(bag.lost_in_transport))
    return {contract.get(full, full): _metrics(bag, full, contract.get(full)) for full in names}


def _metrics(bag: Bag, full: str, name: str | None) -> TopicMetrics:
    spec = TOPICS.get(name) if name is not None else None
    series = bag.series(name) if name is not None else None
    timing = bag.timings.get(name) if name is not None else None
    rate = wall = gap = gap_at = longest = slow = None
    gaps = None
    latency: list[float | None] = [None, None]
    age: list[float | None] = [None, None]
    if series is not None and timing is not None:
        rate = _rate(timing.count - timing.restarts, timing.running)
        wall = _rate(timing.count, timing.last_log - timing.first_log)
        if timing.widest is not None and bag.clock is not None:
            stamp, log = (np.array([value], dtype=np.int64) for value in timing.widest_at)
            gap, gap_at = timing.widest * 1e-9, float(bag.clock.times(stamp, log)[0])
            if spec is not None and spec.rate and spec.intent is not Intent.COMMAND:
                gaps = timing.gaps
                slow = 1e9 / timing.period if timing.is_slow else None
        if spec is not None and spec.intent not in {Intent.LATCHED, Intent.EVENT}:
            while_listening = series.publish_ns >= series.log_ns[0]
            while_listening[0] |= len(series) == 1
            delay = (series.log_ns - series.publish_ns)[while_listening] * 1e-6
            if len(delay):
                latency = [float(np.percentile(delay, q)) for q in (50, 99)]
                longest = max(float(delay.max()), (timing.delay or 0) * 1e-6)
            age = _ages(bag, series)
    return TopicMetrics(
        topic=name or full,
        type=bag.types.get(full, ""),
        count=bag.counts.get(full, 0),
        expected_hz=spec.rate if spec is not None else None,
        rate_hz=rate,
        wall_rate_hz=wall,
        max_gap_s=gap,
        max_gap_at_s=gap_at,
        slow_hz=slow,
        gaps=gaps,
        latency_p50_ms=latency[0],
        latency_p99_ms=latency[1],
        latency_max_ms=longest,
        age_p50_ms=age[0],
        age_p99_ms=age[1],
        dropped=bag.dropped.get(full, 0),
        lost_in_transport=bag.lost_in_transport.get(full, 0),
        rejected=bag.rejected.get(name, 0) if name else 0,
        unverified=bag.unverified.get(full, 0),
    )


def _ages(bag: Bag, series: TimeSeries) -> list[float | None]:
    """Median and 99th percentile of the time from stamp to reception [ms]."""
    stamped = series.stamp_ns > 0
    if series.topic == topics.CLOCK or not stamped.any() or bag.clock is None:
        return [None, None]
    log_ns, stamp_ns = series.log_ns[stamped], series.stamp_ns[stamped]
    if bag.clock.is_recorded:
        came = bag.clock.at_reception(log_ns)
        # Who does not follow the clock has stamps far from it.
        follows = np.abs(came - stamp_ns) < _FOLLOWS_NS
        ages = np.asarray((came - stamp_ns)[follows] * 1e-6, dtype=np.float64)
    else:
        ages = np.asarray((log_ns - stamp_ns) * 1e-6, dtype=np.float64)
        ages = ages[np.abs(ages) < _FOLLOWS_NS * 1e-6]
    if not len(ages):
        return [None, None]
    return [float(np.percentile(ages, q)) for q in (50, 99)]


_FOLLOWS_NS: Final = 60_000_000_000


def _rate(count: int, span_ns: int) -> float | None:
    return (count - 1) / (span_ns * 1e-9) if count > 1 and span_ns > 0 else None
