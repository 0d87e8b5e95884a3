"""Real-time scheduling of a node's process by SCHED_RR of Linux."""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path

_THREADS = Path("/proc/self/task")


def set_realtime_priority(priority: int) -> str:
    """Schedule all threads of this process, and those that they start, by SCHED_RR.

    Args:
        priority: from 1, higher runs first; 0 = leave the scheduling unchanged.

    Returns:
        Why the kernel denied it, with the remedy; empty = no failure.
    """
    if not priority:
        return ""
    try:
        _schedule_all(priority)
    except OSError as error:
        return (
            f"realtime_priority {priority} was denied ({error.strerror}); the process keeps the "
            f"normal scheduling: permit its user rtprio {priority} in /etc/security/limits.conf"
        )
    return ""


def _schedule_all(priority: int) -> None:
    if sys.platform != "linux":
        raise OSError("SCHED_RR needs Linux")
    done: set[int] = set()
    while found := {int(thread.name) for thread in _THREADS.iterdir()} - done:
        for thread in found:
            with contextlib.suppress(ProcessLookupError):  # the thread has ended
                os.sched_setscheduler(thread, os.SCHED_RR, os.sched_param(priority))
        done |= found
