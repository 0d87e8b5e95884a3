"""Kill another process, after a check of its host and command line."""

from __future__ import annotations

import os
import signal
import socket
from collections.abc import Sequence
from pathlib import Path


def kill_process(process: int, host: str, marks: Sequence[str]) -> None:
    """Kill a process of this computer.

    Args:
        process: its identifier.
        host: name of the computer that it runs on.
        marks: texts, of which its command line must contain one.

    Raises:
        OSError: it runs elsewhere or no longer, or the identifier is another process.
    """
    if host != socket.gethostname():
        raise ProcessLookupError(f"it runs on {host}, this is {socket.gethostname()}")
    line = Path(f"/proc/{process}/cmdline").read_bytes().decode(errors="replace")
    if not any(mark in line for mark in marks):
        raise ProcessLookupError(f"process {process} is another one now")
    os.kill(process, signal.SIGKILL)
