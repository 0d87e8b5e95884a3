"""Bench of the mission: share of a core of each process at real time, and speed by host.

At real time all processes of `mission.launch.py` run with the recorder while the rover descends, in
lockstep, as they do by default, and with time that runs by itself.
As fast as possible, time waits for all nodes (lockstep); the recorder and the page, if any, listen.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from msg_schemas import topics
from rover_launch.loop import Parameters, make_plan, start_plan
from rover_launch.plan import FALSE, HANGING_DEFAULTS, LOCKSTEP, TRUE
from rover_runtime.loop_host import LoopHost
from rover_verify.bench.bench_row import Row, bench_row
from rover_verify.demo import all_nodes
from rover_verify.harness import open_harness
from rover_verify.harness.flight import MISSION
from rover_verify.harness.launching import Launched
from rover_verify.harness.observer import Feed

CASE: Final = "mission"
LOOP_HOST, ONE_PROCESS, COMPOSED, ALONE = "loop host", "one process", "composed", "each alone"
BY_ITSELF: Final = ", time by itself"
RECORDED, SHOWN = ", recorder", ", recorder, page"
_AT_REAL_TIME: Final = (COMPOSED, COMPOSED + BY_ITSELF, ALONE)
_PAGE: Final = "operator_console"
_NODES: Final = {"mission_node": {"plan": "demonstration", "checkpoint": "none"}}
_AT_REST: Final = 1.0  # simulated time before the mission [s]
_SETTLED: Final = 5.0  # simulated time of the mission before a measurement [s]
_PATIENCE: Final = 600.0  # wall time of a measurement [s]
_TICKS_PER_SECOND: Final = os.sysconf("SC_CLK_TCK")
_REAL_TIME: Final = {"real_time_factor": "1"}
_SPEED: Final = {"real_time_factor": "0", LOCKSTEP: TRUE, "frames": FALSE}


def measure(duration: float) -> list[Row]:
    """Measure shares over a wall time and speeds over a simulated time of `duration` [s]."""
    rows = [row for host in _AT_REAL_TIME for row in _shares(host, duration)]
    rows.append(_speed_row(LOOP_HOST, _loop_host_speed(duration)))
    for host, audience in (
        (ONE_PROCESS, ""),
        (COMPOSED, ""),
        (ALONE, ""),
        (COMPOSED, RECORDED),
        (ONE_PROCESS, SHOWN),
    ):
        rows.append(_speed_row(host + audience, _speed(host, audience, duration)))
    return rows


def _speed_row(host: str, speed: float) -> Row:
    return bench_row(CASE, len(MISSION) + 1, host=host, rtf=speed)


def _shares(host: str, duration: float) -> list[Row]:
    with tempfile.TemporaryDirectory() as name, open_harness(Path(name)) as harness:
        given = {
            **_REAL_TIME,
            "composed": FALSE if host == ALONE else TRUE,
            LOCKSTEP: FALSE if host.endswith(BY_ITSELF) else TRUE,
            "record": f"{name}/bag",
        }
        launched = Launched(harness, MISSION, given, _NODES)
        feed = _fly(launched)
        processes = launched.processes.values()
        began, before = time.monotonic(), [cpu_time(each.pid) for each in processes]
        _wait(feed, duration)
        spent = time.monotonic() - began
        after = [cpu_time(each.pid) for each in processes]
    return [
        bench_row(
            CASE, len(each.node_names), host=host, process=each.executable, share=(b - a) / spent
        )
        for each, a, b in zip(launched.planned.started, before, after, strict=True)
    ]


def _speed(host: str, audience: str, duration: float) -> float:
    """Simulated seconds per second of wall time."""
    with tempfile.TemporaryDirectory() as name, open_harness(Path(name)) as harness:
        given = {
            **_SPEED,
            "composed": FALSE if host == ALONE else TRUE,
            "record": f"{name}/bag" if audience else "",
            "console": TRUE if audience == SHOWN else FALSE,
        }
        arrange = all_nodes.merged if host == ONE_PROCESS else lambda planned: planned
        changed: Parameters = {**_NODES, _PAGE: {"port": 0}}
        feed = _fly(Launched(harness, MISSION, given, changed, arrange=arrange))
        began = time.monotonic()
        return _wait(feed, duration) / (time.monotonic() - began)


def _fly(launched: Launched) -> Feed:
    """Start the mission; returns the feed of its state, which is sent seldom."""
    observer = launched.observer
    feed = observer.listen(topics.MISSION_STATE)
    launched.wait_until_ready()
    feed.wait(lambda sample: sample.stamp_ns > _AT_REST * 1e9)
    answer = observer.call(topics.MISSION_GO)
    assert answer.success, answer.message
    _wait(feed, _SETTLED)
    return feed


def _wait(feed: Feed, duration: float) -> float:
    """Wait for a simulated time [s]; returns how much has passed."""
    begin_ns = feed.wait(since=len(feed)).stamp_ns
    end_ns = begin_ns + round(duration * 1e9)
    last = feed.wait(lambda sample: sample.stamp_ns >= end_ns, len(feed) - 1, _PATIENCE)
    return float(last.stamp_ns - begin_ns) * 1e-9


def _loop_host_speed(duration: float) -> float:
    host = LoopHost()
    start_plan(host, make_plan(MISSION, HANGING_DEFAULTS, _SPEED), _NODES)
    host.run(_AT_REST)
    host.call(topics.MISSION_GO)
    host.run(_SETTLED)
    began = time.monotonic()
    host.run(duration)
    return duration / (time.monotonic() - began)


def cpu_time(pid: int) -> float:
    """CPU time of a process and its children, running or ended [s]."""
    total = 0.0
    for task in Path(f"/proc/{pid}/task").iterdir():
        children = (task / "children").read_text().split()
        total += sum(cpu_time(int(child)) for child in children)
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return total + sum(map(int, fields[11:15])) / _TICKS_PER_SECOND


def table(rows: Sequence[Row]) -> str:
    """The rows as text for a terminal."""
    lines = ["mission at real time with the recorder: share of a core of each process"]
    for host in _AT_REAL_TIME:
        shares = {
            str(row["process"]): float(str(row["share"]))
            for row in rows
            if row["host"] == host and "share" in row
        }
        lines += [f"{host:26}{name:18}{share:8.1%}" for name, share in shares.items()]
        lines.append(f"{host:26}{'all':18}{sum(shares.values()):8.1%}")
    lines.append("mission in lockstep: simulated seconds per second")
    lines += [f"{row['host']!s:30}{row['rtf']:8.2f}" for row in rows if row["rtf"] is not None]
    return "\n".join(lines)
