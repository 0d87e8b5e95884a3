"""Metrics of the bridge as diagnostic statuses: numbers in full precision, times in s."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from msg_schemas.samples import Level, Status
from rover_hil.bridge.bridge import Bridge
from rover_hil.bridge.drive_channel import FAULT
from rover_hil.bridge.statistics import Floats, percentiles
from rover_hil.canopen.devices import SYNC_RATE
from rover_hil.canopen.link import Link


def link_status(node: str, bridge: Bridge, link: Link, now_ns: int) -> Status:
    """Status of the link: deadlines and frames; `with_times` adds the measured times."""
    missing = bridge.missing_devices(now_ns)
    values = {
        "devices_missing": str(len(missing)),
        "cycles": str(bridge.cycles),
        "sync_rate": repr(SYNC_RATE),
        "late_cycles": str(bridge.late_cycles),
        "incomplete_cycles": str(bridge.incomplete_cycles),
        "overdue_round_trips": str(bridge.overdue_round_trips),
        "missed_deadlines": str(
            bridge.late_cycles + bridge.incomplete_cycles + bridge.overdue_round_trips
        ),
        "frames_sent": str(link.sent),
        "frames_received": str(link.received),
        "frames_lost": str(sum(each.lost for each in bridge.stations.values())),
        "frames_stale": str(sum(each.stale for each in bridge.stations.values())),
        "frames_invalid": str(sum(each.invalid for each in bridge.stations.values())),
        "frames_damaged": str(link.line_errors),
        "frames_failed": str(link.failed),
    }
    problems = [f"cannot send: {link.problem}"] if link.problem else []
    if bridge.has_other_bridge(now_ns):
        problems.append("another bridge is on the link")
    if missing:
        problems.append(f"no answer: {', '.join(missing)}")
    if problems:
        return Status(f"{node}: link", "; ".join(problems), Level.ERROR, node, values)
    return Status(f"{node}: link", "all devices answer", Level.OK, node, values)


def measured_times(bridge: Bridge) -> dict[str, Floats]:
    """Copies of the last measured times of the link [s], by name."""
    return {
        "round_trip": bridge.round_trip.copied_values(),
        "command_time": bridge.command_time.copied_values(),
        "answer_time": bridge.answer_time.copied_values(),
    }


def with_times(status: Status, times: Mapping[str, Floats]) -> Status:
    """Add the percentiles of measured times to the status of the link."""
    values = dict(status.values)
    for name, measured in times.items():
        values |= _percentile_values(name, measured)
    return replace(status, values=values)


def device_status(node: str, bridge: Bridge, name: str, now_ns: int) -> Status:
    """Status of one device: state, clock offset, frames."""
    station, channel = bridge.stations[name], bridge.channels.get(name)
    offset = station.clock.now(now_ns)
    values = {
        "node_id": str(station.device.node_id),
        "on": "rover" if station.device.is_on_rover else "mother",
        "clock_offset": "" if offset is None else repr(offset.value),
        "clock_uncertainty": "" if offset is None else repr(offset.uncertainty),
        "frames_lost": str(station.lost),
        "frames_stale": str(station.stale),
        "frames_invalid": str(station.invalid),
    }
    alive = station.is_alive(now_ns)
    level, message = (Level.OK, "answers") if alive else (Level.ERROR, "no answer")
    if station.mismatch:
        level, message = Level.ERROR, f"not the expected device: {station.mismatch}"
    elif alive and channel is not None:
        message = channel.state.lower() or "state unknown"
        level = Level.ERROR if channel.state == FAULT else Level.OK
        values |= {
            "armed": str(channel.armed).lower(),
            "rejected_sets": str(station.counts.get("rejected_sets", 0)),
        }
    return Status(f"{node}: {name}", message, level, node, values)


def _percentile_values(name: str, measured: Floats) -> dict[str, str]:
    found = percentiles(measured)
    if found is None:
        return {f"{name}_count": "0"}
    return {
        f"{name}_count": str(found.number),
        f"{name}_p50": repr(found.p50),
        f"{name}_p99": repr(found.p99),
        f"{name}_max": repr(found.largest),
    }
