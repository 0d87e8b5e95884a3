"""Reservation of ROS domains.

An exclusive lock on a file named after the domain reserves it, in a folder shared by all users of
the computer. The kernel releases the lock when its process exits.
"""

from __future__ import annotations

import fcntl
import os
import random
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# 0..101 are safe on Linux (above, ports collide with ephemeral ones); the lower half is for
# interactive use.
DOMAINS = range(50, 102)

# Above the ephemeral ports of Linux, which other sockets may use.
_FIRST_PORT = 61000

_LOCKS = Path(tempfile.gettempdir()) / "ros_test_domains"
_TIMEOUT = 300.0
_RETRY_PERIOD = 0.5


def multicast_link(domain: int) -> str:
    """The link of a reserved domain; no other test uses it."""
    return f"udp_multicast:239.74.163.2:{_FIRST_PORT + domain}"


def _open_shared(path: Path) -> int:
    """Open a lock file with access for every user."""
    try:
        return os.open(path, os.O_RDWR)
    except FileNotFoundError:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        os.fchmod(descriptor, 0o666)
        return descriptor


def _make_folder() -> None:
    try:
        _LOCKS.mkdir(mode=0o777)
        _LOCKS.chmod(0o1777)
    except FileExistsError:
        pass


def _try_lock(domain: int) -> int | None:
    descriptor = _open_shared(_LOCKS / f"{domain}.lock")
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        return None
    return descriptor


@contextmanager
def reserved_domain() -> Iterator[int]:
    """Reserve a ROS_DOMAIN_ID while the context lasts.

    Raises:
        TimeoutError: all domains are in use.
    """
    _make_folder()
    # Random order: a released domain is not reused at once, while its participants may still send.
    order = random.sample(DOMAINS, len(DOMAINS))
    deadline = time.monotonic() + _TIMEOUT
    while time.monotonic() < deadline:
        for domain in order:
            descriptor = _try_lock(domain)
            if descriptor is None:
                continue
            try:
                yield domain
            finally:
                os.close(descriptor)
            return
        threading.Event().wait(_RETRY_PERIOD)
    msg = f"all ROS domains {DOMAINS.start}..{DOMAINS.stop - 1} were in use for {_TIMEOUT:g} s"
    raise TimeoutError(msg)
