"""Wait for the lock of a file, by which processes do a work once for all of them."""

from __future__ import annotations

import fcntl
import threading
from collections.abc import Callable
from typing import IO, Final

_POLL_PERIOD: Final = 0.02
"""Wall time between two trials [s]."""


def lock_file(file: IO[str], cancelled: Callable[[], bool]) -> bool:
    """Lock an open file until it is closed, once no other process has locked it.

    Args:
        file: to lock.
        cancelled: polled meanwhile; True ends the wait, as does what it raises.

    Returns:
        Whether the file is locked; if not, the wait was cancelled.
    """
    pause = threading.Event()
    while not cancelled():
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            pause.wait(_POLL_PERIOD)
        else:
            return True
    return False
