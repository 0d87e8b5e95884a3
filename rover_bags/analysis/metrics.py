"""All metrics of a bag, including those of its topics' recording."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from msg_schemas import topics
from msg_schemas.samples import StatusSample
from msg_schemas.specifications import Intent, Topic
from msg_schemas.table import TOPICS
from rover_bags.analysis.activities import (
    DrivenInterval,
    DrumMotion,
    ImagingStop,
    Traverse,
    descents_of,
    drives_of,
    imaging_stops_of,
    traverses_of,
)
from rover_bags.analysis.audits import Audits, audits_of
from rover_bags.analysis.commands import RecordedCommand, commands_of
from rover_bags.analysis.entries import TimelineEntry, entries_of
from rover_bags.analysis.jumps import RecordedJump, jumps_of
from rover_bags.analysis.timeline import Timeline, timeline_of
from rover_bags.analysis.wall_coverage import Coverage, measure_coverage, observations_of
from rover_bags.reading.read import Bag, TimeSeries


@dataclass(frozen=True)
class TopicMetrics:
    """Recording metrics of one topic.

    Rates and gaps are by the topic's pacing clock: wall time for status topics, otherwise simulated
    time.

    Attributes:
        topic: Contract name, or the full name of a topic outside the contract.
        type: Message type.
        count: Number of messages.
        expected_hz: Rate required by the contract; None if it requires none.
        rate_hz: Messages per second between the first and the last message of each run.
        wall_rate_hz: Messages per second of wall time.
        max_gap_s: Longest time between consecutive messages.
        max_gap_at_s: Simulated time at which it started.
        slow_hz: Typical rate of a topic that was slower than the contract throughout, because of
            its publisher or its recorder; None otherwise.
        gaps: Number of pauses of more than 1.75 periods, of the contract's or the typical period;
            None without a promised rate, as for status topics of a run in lockstep.
        latency_p50_ms, latency_p99_ms, latency_max_ms: Wall time from publication to reception.
            Messages published before the recorder subscribed do not count; None for latched topics.
        age_p50_ms, age_p99_ms: Time from stamp to reception by the clock of the stamps, within that
            clock's resolution.
        dropped: Messages that the recorder could not keep.
        lost_in_transport: Messages lost before they reached the recorder.
        rejected: Messages that violate the contract.
        unverified: Messages without a checksum.
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
    """All metrics of a bag."""

    timeline: Timeline
    descents: tuple[DrumMotion, ...]
    drives: tuple[DrivenInterval, ...]
    traverses: tuple[Traverse, ...]
    imaging_stops: tuple[ImagingStop, ...]
    coverage: Coverage | None
    audits: Audits
    jumps: tuple[RecordedJump, ...]
    topics: Mapping[str, TopicMetrics]
    commands: tuple[RecordedCommand, ...]
    events: tuple[TimelineEntry, ...]
    refusals: tuple[TimelineEntry, ...]
    duration_s: float
    simulated_s: float | None

    def to_mapping(self) -> dict[str, Any]:
        """Return plain values for JSON; metrics of the first jump are repeated at the top level."""
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
            "commands": [asdict(command) for command in self.commands],
            "events": [asdict(entry) for entry in self.events],
            "refusals": [asdict(entry) for entry in self.refusals],
        }


def measure(bag: Bag) -> Metrics:
    """Compute all metrics of a bag."""
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
        commands=commands_of(bag),
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
            if spec is not None and spec.rate and _has_promised_rate(bag, spec):
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


def _has_promised_rate(bag: Bag, spec: Topic) -> bool:
    """Whether the publisher of a topic keeps the contract's rate by the pacing clock."""
    return spec.intent is not Intent.COMMAND and not (
        bag.is_in_lockstep and spec.sample is StatusSample
    )


def _ages(bag: Bag, series: TimeSeries) -> list[float | None]:
    """Median and 99th percentile of the time from stamp to reception [ms]."""
    stamped = series.stamp_ns > 0
    if series.topic == topics.CLOCK or not stamped.any() or bag.clock is None:
        return [None, None]
    log_ns, stamp_ns = series.log_ns[stamped], series.stamp_ns[stamped]
    if bag.clock.is_recorded:
        received = bag.clock.at_reception(log_ns)
        # Nodes that do not use simulated time have stamps far from it.
        follows = np.abs(received - stamp_ns) < _FOLLOWS_NS
        ages = np.asarray((received - stamp_ns)[follows] * 1e-6, dtype=np.float64)
    else:
        ages = np.asarray((log_ns - stamp_ns) * 1e-6, dtype=np.float64)
        ages = ages[np.abs(ages) < _FOLLOWS_NS * 1e-6]
    if not len(ages):
        return [None, None]
    return [float(np.percentile(ages, q)) for q in (50, 99)]


_FOLLOWS_NS: Final = 60_000_000_000


def _rate(count: int, span_ns: int) -> float | None:
    return (count - 1) / (span_ns * 1e-9) if count > 1 and span_ns > 0 else None
