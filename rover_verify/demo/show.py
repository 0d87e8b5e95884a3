"""What demonstrations share: running processes that are followed, and the report of their bag."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from msg_schemas import topics
from msg_schemas.health import Health, read_health
from msg_schemas.phases import HealthState
from msg_schemas.samples import Status
from rover_verify.harness import Observer, Process
from rover_verify.harness.processes import environment

_REPORT_TIMEOUT = 300.0
_POLL_PERIOD = 0.1


class ShowError(RuntimeError):
    """The demonstration could not be shown; says why."""


class Running:
    """Processes, an observer of them and a progress bar.

    Args:
        processes: by name, in the order in which they are stopped.
        observer: of their nodes.
        bar: tqdm's.
    """

    def __init__(self, processes: Mapping[str, Process], observer: Observer, bar: Any) -> None:
        self.processes = processes
        self.observer = observer
        self.bar = bar

    def follow(
        self, step: str, done: Callable[[], object], status: Callable[[], str], timeout: float
    ) -> None:
        """Show the status of a step until it is done.

        Raises:
            ShowError: a process has ended, or the timeout [s] is over.
        """
        self.bar.set_description_str(step)
        deadline = time.monotonic() + timeout
        pause = threading.Event()
        while not done():
            for name, process in self.processes.items():
                if not process.is_running:
                    raise ShowError(f"{name} exited during {step}:\n{process.output}")
            if time.monotonic() > deadline:
                output = "\n".join(f"--- {n}:\n{p.output}" for n, p in self.processes.items())
                raise ShowError(f"{step} took longer than {timeout:g} s: {status()}\n{output}")
            self.bar.set_postfix_str(status())
            pause.wait(_POLL_PERIOD)
        self.bar.set_postfix_str("")

    def stop(self) -> None:
        """Stop the processes in order.

        Raises:
            ShowError: one ends with another code than 0.
        """
        self.bar.set_description_str("stopping")
        for name, process in self.processes.items():
            code = process.stop()
            if code != 0:
                raise ShowError(f"{name} ended with code {code}:\n{process.output}")

    def events(self, *names: str) -> list[Status]:
        """Received events with one of these names."""
        return [
            status
            for sample in self.observer.listen(topics.EVENTS).samples
            for status in sample.statuses
            if status.name in names
        ]

    def not_ready(self, nodes: tuple[str, ...]) -> list[str]:
        """Nodes whose last health is not ready, each with its message."""
        healths = {
            health.node: health
            for sample in self.observer.listen(topics.DIAGNOSTICS).samples
            for status in sample.statuses
            if (health := read_health(status)) is not None
        }
        return [
            f"{name} ({healths[name].message if name in healths else 'silent'})"
            for name in nodes
            if healths.get(name) != Health(name, HealthState.READY)
        ]

    def last(self, name: str) -> Any:
        """Last sample of a topic; None = none."""
        return self.observer.listen(name).last


def write_report(folder: Path, domain: int) -> None:
    """Have the bag of a folder reported into it by the suite's own command.

    Raises:
        ShowError: it could not be.
    """
    try:
        done = subprocess.run(
            [sys.executable, "-m", "rover_cli", "bag", "report", "bag", "--out", "."],
            cwd=folder,
            check=False,
            capture_output=True,
            text=True,
            timeout=_REPORT_TIMEOUT,
            env=environment(domain),
        )
    except subprocess.TimeoutExpired as error:
        raise ShowError(
            f"mother_rover bag report took longer than {_REPORT_TIMEOUT:g} s"
        ) from error
    if done.returncode != 0:
        raise ShowError(
            f"mother_rover bag report ended with code {done.returncode}:\n{done.stderr}"
        )
    (folder / "report.txt").write_text(done.stdout, encoding="utf-8")
