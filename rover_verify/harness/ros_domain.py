"""Locks between test runs, and ROS domains that no other test uses at the same time.

A domain is reserved by an exclusive lock on a file named after it, in a folder
that all users of the machine share. The lock belongs to the open file: the kernel
gives it back when its process ends, however it ends.
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

# 0..101 are safe on Linux (above, the ports run into the ephemeral ones); the lower half is left
# to people.
DOMAINS = range(50, 102)

# Above the ephemeral ports of Linux, one of which another socket may have.
_FIRST_PORT = 61000

_LOCKS = Path(tempfile.gettempdir()) / "ros_test_domains"
_PATIENCE = 300.0
_RETRY = 0.5


def multicast_link(domain: int) -> str:
    """The link to drives that belongs to a reserved domain: no other test uses it."""
    return f"udp_multicast:239.74.163.2:{_FIRST_PORT + domain}"


def _open_shared(path: Path) -> int:
    """Open a lock file that every user may lock."""
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


@contextmanager
def locked(name: str) -> Iterator[None]:
    """Let one test run at a time into the block."""
    _make_folder()
    descriptor = _open_shared(_LOCKS / f"{name}.lock")
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


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
    """Reserve a ROS_DOMAIN_ID for as long as the context lasts.

    Raises:
        TimeoutError: all domains stayed taken.
    """
    _make_folder()
    # A random order: a domain just left is not the next one taken, so that what its participants
    # still say finds nobody.
    order = random.sample(DOMAINS, len(DOMAINS))
    give_up = time.monotonic() + _PATIENCE
    while time.monotonic() < give_up:
        for domain in order:
            descriptor = _try_lock(domain)
            if descriptor is None:
                continue
            try:
                yield domain
            finally:
                os.close(descriptor)
            return
        threading.Event().wait(_RETRY)
    msg = f"all ROS domains {DOMAINS.start}..{DOMAINS.stop - 1} stayed taken for {_PATIENCE:g} s"
    raise TimeoutError(msg)
