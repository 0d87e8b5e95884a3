"""Reservation of ROS domains.

A socket that is bound to a port of the domain reserves it. The kernel closes the socket when its
process exits.
"""

from __future__ import annotations

import random
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

# 0..101 are safe on Linux (above, ports collide with ephemeral ones); the lower half is for
# interactive use.
DOMAINS = range(50, 102)

# Above the ephemeral ports of Linux, which other sockets may use.
_FIRST_PORT = 61000

_TIMEOUT = 300.0
_RETRY_PERIOD = 0.5


def multicast_link(domain: int) -> str:
    """The link of a reserved domain; no other test uses it."""
    return f"udp_multicast:239.74.163.2:{_FIRST_PORT + domain}"


def _reserved() -> tuple[int, socket.socket] | None:
    """A free domain and the socket that reserves it; None = all are in use."""
    # Random order: a released domain is not reused at once, while its participants may still send.
    for domain in random.sample(DOMAINS, len(DOMAINS)):
        holder = socket.socket()
        try:
            holder.bind(("127.0.0.1", _FIRST_PORT + domain))
        except OSError:
            holder.close()
        else:
            return domain, holder
    return None


@contextmanager
def reserved_domain() -> Iterator[int]:
    """Reserve a ROS_DOMAIN_ID while the context lasts.

    Raises:
        TimeoutError: all domains are in use.
    """
    deadline = time.monotonic() + _TIMEOUT
    while (found := _reserved()) is None:
        if time.monotonic() > deadline:
            raise TimeoutError(f"all ROS domains of {DOMAINS} were in use for {_TIMEOUT:g} s")
        threading.Event().wait(_RETRY_PERIOD)
    domain, holder = found
    with holder:
        yield domain
