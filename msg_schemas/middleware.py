"""What the middleware sends by: UDP, never the shared memory of Fast DDS.

With the shared memory of Fast DDS 2.14 a participant that comes or goes may hold another up for a
third of a second, in which a winch that moves takes its drum for lost, and a node that was killed
and started again may stay deaf and unheard. With UDP neither was seen.

Processes of others that keep shared memory are understood, as they speak UDP as well.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

LOOPBACK = Path(__file__).with_name("loopback.xml")
"""The profile with which `ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST` is done over UDP alone."""
NETWORK = Path(__file__).with_name("network.xml")
"""The same for `SUBNET`, which is ROS's default."""

_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
_BUILT_IN = "FASTDDS_BUILTIN_TRANSPORTS"
# Somebody who sets one of these has chosen, or wants with LOCALHOST what a profile would undo.
_CHOICES = (_PROFILE, "FASTDDS_DEFAULT_PROFILES_FILE", "ROS_LOCALHOST_ONLY")
_PEERS = "ROS_STATIC_PEERS"


def settings(environment: Mapping[str, str]) -> dict[str, str]:
    """Environment variables to set so that no shared memory is used; none where somebody chose.

    Under LOCALHOST rmw_fastrtps adds shared memory to whatever a profile says, so that there a
    profile takes the place of the range.

    Args:
        environment: of the process.
    """
    if not environment.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp").startswith("rmw_fastrtps"):
        return {}
    inherited = ("", "0", str(LOOPBACK), str(NETWORK))  # the latter two from the suite's processes
    if any(environment.get(name, "") not in inherited for name in _CHOICES):
        return {}
    wanted = environment.get(_RANGE, "") or "SUBNET"
    if wanted == "LOCALHOST" and not environment.get(_PEERS):
        return {_RANGE: "SYSTEM_DEFAULT", _PROFILE: str(LOOPBACK)}
    if wanted == "SUBNET" and not environment.get(_BUILT_IN):
        return {_PROFILE: str(NETWORK)}
    return {}


def select_transport() -> None:
    """Choose for this process and those it starts; to be called before ROS is initialised."""
    os.environ.update(settings(os.environ))
