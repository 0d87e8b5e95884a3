"""What demonstrations share: launched processes that are followed, and the report of their bag."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from msg_schemas import topics
from msg_schemas.health import Health, read_health
from msg_schemas.phases import HealthState
from rover_verify.harness.launching import RECORDER, Launched
from rover_verify.harness.processes import environment

_REPORT_TIMEOUT = 300.0
_POLL_PERIOD = 0.1


class ShowError(RuntimeError):
    """The demonstration could not be shown; the message has the reason."""


class Show:
    """The processes of a launch plan, followed with a progress bar.

    Args:
        launched: the processes.
        bar: tqdm's.
    """

    def __init__(self, launched: Launched, bar: Any) -> None:
        self.processes, self.observer = launched.processes, launched.observer
        self.bar = bar
        self._planned = launched.planned

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
        """Stop the processes, the recorder first: it must have all messages.

        Raises:
            ShowError: one ends with another code than 0.
        """
        self.bar.set_description_str("stopping")
        for name in sorted(self.processes, key=lambda each: each != RECORDER):
            process = self.processes[name]
            code = process.stop()
            if code != 0:
                raise ShowError(f"{name} ended with code {code}:\n{process.output}")

    def not_ready(self) -> list[str]:
        """Nodes whose last health is not ready, each with its message."""
        healths = {
            health.node: health
            for sample in self.observer.listen(topics.DIAGNOSTICS).samples
            for status in sample.statuses
            if (health := read_health(status)) is not None
        }
        return [
            f"{name} ({healths[name].message if name in healths else 'silent'})"
            for each in self._planned.started
            for name in each.node_names
            if healths.get(name) != Health(name, HealthState.READY)
        ]

    def last(self, name: str) -> Any:
        """Last sample of a topic; None = none."""
        return self.observer.listen(name).last


def write_report(folder: Path, domain: int) -> dict[str, Any]:
    """Have the bag of a folder reported into it by the suite's own command; returns its metrics.

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
    metrics: dict[str, Any] = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    return metrics


def completed(
    folder: Path,
    metrics: Mapping[str, Any],
    verdict: Sequence[tuple[str, bool]],
    **more: object,
) -> dict[str, Any]:
    """Write the metrics of a report anew, with more values and the verdict, and return them."""
    whole = {
        **metrics,
        "bag": "bag",
        **more,
        "verdict": [{"text": text, "pass": holds} for text, holds in verdict],
        "pass": all(holds for _, holds in verdict),
    }
    (folder / "metrics.json").write_text(json.dumps(whole, indent=2) + "\n", encoding="utf-8")
    return whole
