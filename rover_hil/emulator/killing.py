"""Ending another process at once, as a power cut would: only where it surely is the one meant."""

from __future__ import annotations

import os
import signal
import socket
from collections.abc import Sequence
from pathlib import Path


def kill_process(process: int, host: str, marks: Sequence[str]) -> None:
    """Kill a process of this machine.

    Args:
        process: its number.
        host: the machine that it told to run on.
        marks: of which its command line must hold one.

    Raises:
        OSError: it runs on another machine, or no longer, or is another one by now.
    """
    if host != socket.gethostname():
        raise ProcessLookupError(f"it runs on {host}, this is {socket.gethostname()}")
    line = Path(f"/proc/{process}/cmdline").read_bytes().decode(errors="replace")
    if not any(mark in line for mark in marks):
        raise ProcessLookupError(f"process {process} is another one by now")
    os.kill(process, signal.SIGKILL)
