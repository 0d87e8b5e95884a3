"""The report as terminal text and as JSON."""

import math
from collections.abc import Iterable
from typing import Any

from msg_schemas.specifications import Intent
from msg_schemas.table import TOPICS
from rover_bags.analysis.metrics import Metrics, TopicMetrics
from rover_bags.reading.read import Bag
from rover_bags.views.sections import (
    activity_sections,
    audit_sentences,
    metric_sections,
    momentum_sections,
    texts,
)
from rover_runtime.text_output import text_table

JUMP_METRICS = (
    ("jump_height_m", "jump height", "m", ".4f"),
    ("attitude_variation_rad", "attitude variation", "rad", "+.4f"),
    ("slack", "tether slack dh/df", "", ".3f"),
    ("flight_time_s", "flight time", "s", ".4f"),
    ("travel_m", "forward travel", "m", "+.4f"),
    ("range_m", "range", "m", ".4f"),
    ("rotation_rad", "total rotation", "rad", ".4f"),
    ("peak_tension_N", "peak tension", "N", ".2f"),
    ("energy_drift_J", "energy residual", "J", ".1e"),
)


def as_text(bag: Bag, metrics: Metrics) -> str:
    """Return the report for a terminal."""
    lines = [f"{bag.path}: {recording_summary(bag, metrics)}"]
    lines += [f"! {text}" for text in data_warnings(bag, metrics)]
    lines += texts([*activity_sections(metrics), *metric_sections(metrics)])
    if metrics.coverage is not None:
        lines += ["", f"wall coverage: {metrics.coverage.summary}"]
    for number, jump in enumerate(metrics.jumps, 1):
        lines += ["", f"jump {number}, take-off at {jump.take_off_s:.3f} s"]
        lines += [
            f"  {label:<20} {formatted(getattr(jump, name), unit, form)}"
            for name, label, unit, form in JUMP_METRICS
        ]
    if not metrics.jumps:
        lines += ["", "no jump in this bag"]
    lines += texts(momentum_sections(metrics))
    lines += ["", *audit_sentences(metrics)]
    lines += ["", _columns(metrics.topics.values())]
    if metrics.events:
        lines += ["", "events:"]
        lines += [f"  {e.time_s:10.3f} s  {e.node}  {e.name}: {e.message}" for e in metrics.events]
    if metrics.refusals:
        lines += ["", "refusals:"]
        lines += [f"  {e.time_s:10.3f} s  {e.name}: {e.message}" for e in metrics.refusals]
    return "\n".join(lines)


def recording_summary(bag: Bag, metrics: Metrics) -> str:
    """Return number of messages, topics and duration in one line."""
    simulated = (
        f", {metrics.simulated_s:.2f} s of simulated time"
        if metrics.simulated_s is not None
        else ""
    )
    return (
        f"{sum(bag.counts.values())} messages on {len(bag.counts)} topics over "
        f"{bag.duration:.2f} s{simulated}"
    )


def data_warnings(bag: Bag, metrics: Metrics) -> list[str]:
    """Return the warnings about lost, damaged or invalid data, and about conflicting commands."""
    found = [*bag.file_defects, *(conflict.text for conflict in bag.command_conflicts)]
    # Requests come from several senders, whose stamps may be out of order.
    streams = [name for name in bag.timings if name in TOPICS and TOPICS[name].rate is not None]
    resets = max((bag.timings[name].restarts for name in streams), default=0)
    if resets:
        times = "once" if resets == 1 else f"{resets} times"
        found.append(
            f"simulated time was reset {times}: plots over the whole bag draw its runs over one "
            "another"
        )
    found += [
        f"{name}: {count} messages counted in the bag's index cannot be read"
        for name, count in sorted(bag.unreadable.items())
    ]
    if bag.unverified:
        count = sum(bag.unverified.values())
        found.append(f"{count} messages carry no checksum: their contents cannot be verified")
    for losses, what in (
        (bag.dropped, "were dropped by the recorder"),
        (bag.lost_in_transport, "were lost in transport to the recorder"),
    ):
        for name, count in sorted(losses.items()):
            found.append(f"{name}: {count} messages {what}")
    for name, count in sorted(bag.rejected.items()):
        example = next((item.reason for item in bag.rejected_examples if item.topic == name), "")
        found.append(f"{name}: {count} messages violate the contract, for example: {example}")
    found += [
        f"{series.topic}: only the first {len(series)} of "
        f"{bag.timings[series.topic].count} messages are reported"
        for series in bag.time_series.values()
        if series.stride == 1
        and len(series) < bag.timings[series.topic].count
        # Of states those of note are reported.
        and TOPICS[series.topic].intent is not Intent.STATE
    ]
    slow = [
        f"{topic.topic} {topic.slow_hz:.3g} of {topic.expected_hz:.3g} Hz"
        for topic in metrics.topics.values()
        if topic.slow_hz is not None
    ]
    if slow:
        found.append(f"slower than the contract's rate throughout: {', '.join(slow)}")
    for topic in metrics.topics.values():
        if topic.gaps:
            gaps = "1 gap" if topic.gaps == 1 else f"{topic.gaps} gaps"
            found.append(
                f"{topic.topic}: {gaps}, the longest {topic.max_gap_s:.3f} s at "
                f"{topic.max_gap_at_s:.3f} s"
            )
    return found


def formatted(value: float | None, unit: str, form: str) -> str:
    """Return a number with its unit, or "-" if it is not known."""
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:{form}} {unit}".rstrip()


TOPIC_COLUMNS = (
    ("messages", "count", "d"),
    ("contract [Hz]", "expected_hz", ".4g"),
    ("rate [Hz]", "rate_hz", ".4g"),
    ("longest gap [s]", "max_gap_s", ".3f"),
    ("gaps", "gaps", "d"),
    ("latency p50 [ms]", "latency_p50_ms", ".2f"),
    ("p99 [ms]", "latency_p99_ms", ".2f"),
    ("max [ms]", "latency_max_ms", ".2f"),
    ("age p50 [ms]", "age_p50_ms", ".1f"),
    ("p99 [ms]", "age_p99_ms", ".1f"),
    ("lost", "lost_in_transport", "d"),
    ("dropped", "dropped", "d"),
    ("rejected", "rejected", "d"),
)


def _columns(items: Iterable[TopicMetrics]) -> str:
    rows = [["topic", *(label for label, _, _ in TOPIC_COLUMNS)]]
    rows += [[item.topic, *topic_cells(item)] for item in items]
    return "\n".join(text_table(rows))


def topic_cells(item: TopicMetrics) -> list[str]:
    """Return the table cells of a topic's metrics."""
    values = [(getattr(item, name), form) for _, name, form in TOPIC_COLUMNS]
    return ["" if value is None else f"{value:{form}}" for value, form in values]


def as_mapping(bag: Bag, metrics: Metrics) -> dict[str, Any]:
    """Return the report as plain values for JSON; every number is finite or null."""
    content = {
        "bag": str(bag.path),
        "seed": bag.seed,
        "contract_version": bag.identity.get("contract_version"),
        "package_version": bag.identity.get("package_version"),
        "closed": bag.closed,
        "warnings": data_warnings(bag, metrics),
        **metrics.to_mapping(),
    }
    cleaned: dict[str, Any] = finite(content)
    return cleaned


def finite(value: Any) -> Any:
    """Replace numbers that are not finite by None."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
