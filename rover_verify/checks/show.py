"""The demonstration commands, and the help text of every executable."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import time
from pathlib import Path

from rover_verify.checks import CheckBatch, Measured
from rover_verify.demo import jump_show, mission_show
from rover_verify.harness import Process
from rover_verify.harness.processes import environment

_COMMANDS = (
    "rover_sim.node.sim_node", "rover_control.jump.jump_node", "tether_winch.winch_node",
    "rover_cli", "rover_cli bag record", "rover_cli bag recover", "rover_cli bag report",
    "rover_cli bag resim", "rover_cli study point", "rover_cli demo", "rover_cli verify",
    "rover_cli bench",
)  # fmt: skip


def _shown(batch: CheckBatch) -> dict[str, object]:
    folder = batch.folder / "demo"
    folder.mkdir()
    return jump_show.show_jump(folder, 1.0, quiet=True)


def demo(batch: CheckBatch, metric: str) -> Measured:
    """Deviation of a metric of the demonstration's jump from the independent code."""
    (reference,) = [each for each in jump_show.REFERENCES if each.key == metric]
    value = _shown(batch)[metric]
    assert isinstance(value, float)
    note = f"{value:.5f} {reference.unit}, other code {reference.value} {reference.unit}"
    return Measured(abs(value - reference.value), note)


def demo_time(batch: CheckBatch) -> Measured:
    """Wall time of the demonstration in an existing environment [s]."""
    began = time.monotonic()
    metrics = _shown(batch)
    return Measured(
        time.monotonic() - began, "compiled functions may come from the cache",
        {"ready after [s]": str(metrics["ready_after_s"])},
    )  # fmt: skip


def mission_time(batch: CheckBatch) -> Measured:
    """Wall time of the demonstration of the whole mission [s]; inf if it fails."""
    folder = batch.folder / "mission"
    folder.mkdir()
    metrics = mission_show.show_mission(folder, seed=batch.seed, quiet=True)
    mission = metrics["mission"]
    details = {key: str(mission[key]) for key in ("ready_after_s", "flown_in_s", "simulated_s")}
    missed = [item["text"] for item in metrics["verdict"] if not item["pass"]]
    taken = float(mission["wall_time_s"]) if not missed else math.inf
    return Measured(taken, "; ".join(missed) or mission_show.summary(metrics), details)


def demo_interrupted(batch: CheckBatch) -> Measured:
    """Number of processes left after interrupting the demonstration at random instants."""
    left, details = 0, {}
    runs = min(batch.runs, 3)
    for index, generator in enumerate(batch.generators(runs)):
        target = batch.folder / f"demo_{index}"
        process = Process(
            "rover_verify.demo.demo", ["jump", "--out", str(target)], environment(0), batch.folder
        )
        try:
            process.wait(float(generator.uniform(1.0, 12.0)))
        except AssertionError:
            process.send(signal.SIGINT)
        code = process.wait()
        mark = str(batch.folder)
        remaining = _processes_in(mark)
        left += len(remaining)
        details[f"run {index}"] = f"code {code}, left: {remaining or 'none'}"
    return Measured(left, f"{runs} interruptions after 1 to 12 s", details)


def _processes_in(folder: str) -> list[str]:
    """Command lines of processes whose working folder is a folder or below it."""
    found = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            if str((entry / "cwd").readlink()).startswith(folder):
                words = (entry / "cmdline").read_bytes().split(b"\0")
                found.append(" ".join(word.decode(errors="replace") for word in words)[:80])
        except OSError:
            continue
    return found


def help_texts(_batch: CheckBatch) -> Measured:
    """How many commands do not answer ``--help`` with code 0 and a text."""
    bad, details = 0, {}
    for command in _COMMANDS:
        done = subprocess.run(
            [sys.executable, "-m", *command.split(), "--help"],
            check=False,
            capture_output=True,
            text=True,
            timeout=120,
            env=environment(0),
        )
        fine = done.returncode == 0 and len(done.stdout) > 80
        bad += not fine
        details[command] = "fine" if fine else f"code {done.returncode}: {done.stderr[-200:]}"
    return Measured(bad, f"of {len(_COMMANDS)} commands", details)
