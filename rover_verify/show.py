"""What demonstrations share: their error, and the report of their bag."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from rover_verify.harness.processes import environment

_REPORT_TIMEOUT = 300.0


class ShowError(RuntimeError):
    """The demonstration could not be shown; says why."""


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
