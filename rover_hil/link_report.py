"""The bridge's figures as statuses: numbers are written with full precision, times in s."""

from __future__ import annotations

from msg_schemas.samples import Level, Status
from rover_hil.bridge import Bridge
from rover_hil.devices import SYNC_RATE
from rover_hil.drive_channel import FAULT
from rover_hil.link import Link
from rover_hil.statistics import Window


def link_status(node: str, bridge: Bridge, link: Link, now_ns: int) -> Status:
    """How the loop goes: round trips, deadlines, frames."""
    values = {
        "cycles": str(bridge.cycles),
        "sync_rate": repr(SYNC_RATE),
        "late_cycles": str(bridge.late),
        "incomplete_cycles": str(bridge.incomplete),
        "overdue_round_trips": str(bridge.overdue),
        "missed_deadlines": str(bridge.late + bridge.incomplete + bridge.overdue),
        "frames_sent": str(link.sent),
        "frames_received": str(link.received),
        "frames_lost": str(sum(each.lost for each in bridge.stations.values())),
        "frames_stale": str(sum(each.stale for each in bridge.stations.values())),
        "frames_strange": str(sum(each.strange for each in bridge.stations.values())),
        "frames_damaged": str(link.line_errors),
        "frames_failed": str(link.failed),
        **_window("round_trip", bridge.round_trip),
        **_window("command_time", bridge.command_time),
        **_window("answer_time", bridge.answer_time),
    }
    silent = bridge.silent(now_ns)
    if silent:
        return Status(f"{node}: link", f"not heard: {', '.join(silent)}", Level.ERROR, node, values)
    return Status(f"{node}: link", "all devices answer", Level.OK, node, values)


def device_status(node: str, bridge: Bridge, name: str, now_ns: int) -> Status:
    """One device: state, clock, what it missed."""
    station, channel = bridge.stations[name], bridge.channels.get(name)
    offset = station.clock.now(now_ns)
    values = {
        "node_id": str(station.device.node_id),
        "on": "rover" if station.device.is_on_rover else "mother",
        "clock_offset": "" if offset is None else repr(offset.value),
        "clock_uncertainty": "" if offset is None else repr(offset.uncertainty),
        "frames_lost": str(station.lost),
        "frames_stale": str(station.stale),
        "frames_strange": str(station.strange),
    }
    heard = station.is_heard(now_ns)
    level, message = (Level.OK, "answers") if heard else (Level.ERROR, "silent")
    if station.mismatch:
        level, message = Level.ERROR, f"not what it should be: {station.mismatch}"
    elif heard and channel is not None:
        message = channel.state.lower() or "state unknown"
        level = Level.ERROR if channel.state == FAULT else Level.OK
        values |= {
            "armed": str(channel.armed).lower(),
            "rejected_sets": str(station.counts.get("rejected", 0)),
        }
    return Status(f"{node}: {name}", message, level, node, values)


def _window(name: str, window: Window) -> dict[str, str]:
    found = window.percentiles()
    if found is None:
        return {f"{name}_count": "0"}
    return {
        f"{name}_count": str(found.number),
        f"{name}_p50": repr(found.p50),
        f"{name}_p99": repr(found.p99),
        f"{name}_max": repr(found.largest),
    }
