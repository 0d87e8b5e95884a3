"""Transport of the middleware: UDP only, without the shared memory of Fast DDS.

With the shared memory of Fast DDS 2.14 a participant that joins or leaves may block another for a
third of a second, which a moving winch treats as a lost drum; and a node that was killed and
started again may neither receive nor be received. With UDP neither was observed.

Processes with shared memory can still communicate, as they use UDP as well.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

LOOPBACK = Path(__file__).with_name("loopback.xml")
"""Profile that replaces `ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST` with UDP only."""
NETWORK = Path(__file__).with_name("network.xml")
"""Profile with UDP only for the range `SUBNET`, the default of ROS."""

_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
_BUILT_IN = "FASTDDS_BUILTIN_TRANSPORTS"
# A user who sets one of these has selected a transport or range that a profile would override.
_CHOICES = (_PROFILE, "FASTDDS_DEFAULT_PROFILES_FILE", "ROS_LOCALHOST_ONLY")
_PEERS = "ROS_STATIC_PEERS"


def settings(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the environment variables that turn shared memory off; none if the user has chosen.

    Under LOCALHOST rmw_fastrtps adds shared memory to any profile, so a profile replaces the range.

    Args:
        environment: of the process.
    """
    if not environment.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp").startswith("rmw_fastrtps"):
        return {}
    inherited = (
        "",
        "0",
        str(LOOPBACK),
        str(NETWORK),
    )  # the last two: set by a parent process
    if any(environment.get(name, "") not in inherited for name in _CHOICES):
        return {}
    discovery_range = environment.get(_RANGE, "") or "SUBNET"
    if discovery_range == "LOCALHOST" and not environment.get(_PEERS):
        return {_RANGE: "SYSTEM_DEFAULT", _PROFILE: str(LOOPBACK)}
    if discovery_range == "SUBNET" and not environment.get(_BUILT_IN):
        return {_PROFILE: str(NETWORK)}
    return {}


def select_transport() -> None:
    """Select UDP for this process and its children; call it before ROS is initialised."""
    os.environ.update(settings(os.environ))
