"""Real-time scheduling of a node's process: its threads go before those of other processes."""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path

_THREADS = Path("/proc/self/task")
_THIS_THREAD = 0


def set_realtime_priority(priority: int) -> str:
    """Have the kernel run all threads of this process by SCHED_RR, and those that they start.

    Args:
        priority: from 1, a higher one goes first; 0: none is wanted.

    Returns:
        Why it is not had, and what would help; empty: it is, or none is wanted.
    """
    if not priority:
        return ""
    try:
        _schedule_all(priority)
    except OSError as error:
        return (
            f"realtime_priority {priority} is not had ({error}), the process is scheduled as any "
            f"other: whoever runs it should be permitted rtprio {priority}"
        )
    return ""


def _schedule_all(priority: int) -> None:
    if sys.platform != "linux":
        raise OSError("only Linux has it")
    done: set[int] = set()
    while found := {int(thread.name) for thread in _THREADS.iterdir()} - done:
        for thread in found:
            with contextlib.suppress(ProcessLookupError):  # it may end meanwhile
                os.sched_setscheduler(thread, os.SCHED_RR, os.sched_param(priority))
        done |= found


def reset_thread_priority() -> None:
    """Have this thread scheduled as those of any process, and what it starts: it computes long."""
    if sys.platform == "linux":
        os.sched_setscheduler(_THIS_THREAD, os.SCHED_OTHER, os.sched_param(0))
