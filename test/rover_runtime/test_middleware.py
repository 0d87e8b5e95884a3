"""No process uses shared memory; one bound to the loopback interface stays on it."""

from __future__ import annotations

import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from operator_console import operator_link
from rover_runtime.ros.middleware import LOOPBACK, NETWORK, settings
from rover_verify.harness import NodeHarness

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
BUILT_IN = "FASTDDS_BUILTIN_TRANSPORTS"
LOCAL = {RANGE: "LOCALHOST"}
BY_PROFILE = {RANGE: "SYSTEM_DEFAULT", PROFILE: str(LOOPBACK)}


@pytest.mark.parametrize(
    ("given", "changes"),
    [
        ({}, {PROFILE: str(NETWORK)}),
        ({RANGE: "SUBNET"}, {PROFILE: str(NETWORK)}),
        ({RANGE: "SUBNET", "ROS_STATIC_PEERS": "10.0.0.7"}, {PROFILE: str(NETWORK)}),
        ({BUILT_IN: "LARGE_DATA"}, {}),
        ({PROFILE: "/their/own.xml"}, {}),
        ({RANGE: "SYSTEM_DEFAULT"}, {}),
        ({RANGE: "OFF"}, {}),
        (LOCAL, BY_PROFILE),
        (LOCAL | {"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}, BY_PROFILE),
        (LOCAL | {"ROS_LOCALHOST_ONLY": "0"}, BY_PROFILE),
        (LOCAL | {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}, {}),
        (LOCAL | {PROFILE: "/their/own.xml"}, {}),
        (LOCAL | {"FASTDDS_DEFAULT_PROFILES_FILE": "/their/own.xml"}, {}),
        (LOCAL | {"ROS_STATIC_PEERS": "10.0.0.7"}, {}),
        (LOCAL | {"ROS_LOCALHOST_ONLY": "1"}, {}),
    ],
)
def test_shared_memory_is_switched_off_where_nobody_chose(
    given: dict[str, str], changes: dict[str, str]
):
    assert settings(given) == changes


@pytest.mark.parametrize("profile", [LOOPBACK, NETWORK])
def test_who_was_missed_announces_itself_before_the_console_takes_it_for_absent(profile: Path):
    period = ET.parse(profile).find(".//{*}leaseAnnouncement/{*}sec")
    assert period is not None
    assert float(str(period.text)) < operator_link._DISCOVERY_TIME


@pytest.mark.parametrize(
    ("anew", "then"),
    [
        ({}, BY_PROFILE),
        (LOCAL, BY_PROFILE),
        ({RANGE: "SUBNET"}, {RANGE: "SUBNET", PROFILE: str(NETWORK)}),
    ],
)
def test_what_a_process_inherits_from_another_is_no_choice(
    anew: dict[str, str], then: dict[str, str]
):
    inherited = LOCAL | settings(LOCAL) | anew
    assert inherited | settings(inherited) == then


@pytest.mark.process
@pytest.mark.ros
@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
@pytest.mark.parametrize(
    ("environment", "bound"),
    [
        ({RANGE: "LOCALHOST", PROFILE: ""}, True),
        # As on a network, but that nobody is looked for.
        ({RANGE: "OFF", PROFILE: str(NETWORK)}, False),
    ],
)
def test_a_node_maps_no_shared_memory_and_binds_the_configured_interface(
    harness: NodeHarness, environment: dict[str, str], bound: bool
):
    process = harness.processes.start(
        "rover_sim.node.mock_plant_node", {"scenario": "free_hang"}, extra_environment=environment
    )
    process.wait_for_output("mock_plant is active")
    own = Path("/proc", str(process.pid))
    mapped = {line.split()[-1] for line in (own / "maps").read_text().splitlines()}
    assert not [name for name in mapped if name.startswith("/dev/shm/fastrtps")]
    assert (addresses(own) == {"0100007F"}) is bound


def addresses(process: Path) -> set[str]:
    """What the UDP sockets of a process are bound to, as the kernel writes it."""
    inodes = {target.name for target in map(_target, (process / "fd").iterdir())}
    found = set()
    for line in (process / "net" / "udp").read_text().splitlines()[1:]:
        columns = line.split()
        if f"socket:[{columns[9]}]" in inodes:
            found.add(columns[1].partition(":")[0])
    return found


def _target(link: Path) -> Path:
    try:
        return link.readlink()
    except FileNotFoundError:  # closed meanwhile
        return link
