"""No frames of a stranger move a drive, whose dictionaries from files are compared or refused."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from functools import cache
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from damage import damaged_text
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rover_hil.canopen.devices import BRIDGE_NODE, DEVICES, DRIVES
from rover_hil.canopen.dictionary import export, run
from rover_hil.canopen.link import HEARTBEAT_ID, SYNC_ID
from rover_verify.checks.hil_safety import payout_rate, simulation
from rover_verify.harness.hil_bench import HilBench

LIFE = (HEARTBEAT_ID + BRIDGE_NODE, b"\x05")
"""The bridge's own heartbeat, which no receiver can tell from a stranger's."""


def identifiers() -> Iterator[int]:
    """Identifiers that a device listens to."""
    yield from (0, SYNC_ID, HEARTBEAT_ID + BRIDGE_NODE)
    for drive in DRIVES:
        yield 0x600 + drive.node_id
        yield from (pdo.can_id(drive.node_id) for pdo in drive.rpdos)


FRAMES = st.lists(
    st.tuples(st.sampled_from(sorted(identifiers())) | st.integers(0, 0x7FF), st.binary(max_size=8))
    .filter(lambda frame: frame != LIFE),
    max_size=30,
)  # fmt: skip


@cache
def bench() -> HilBench:
    """One machine at rest for all examples: what they leave behind is part of the attack."""
    made = HilBench(simulation(), rover_offset=3.0)
    made.cycles(0.1)
    return made


@pytest.mark.fuzz
@given(frames=FRAMES)
@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])
def test_no_frame_of_a_stranger_moves_a_disarmed_machine(frames: list[tuple[int, bytes]]):
    it = bench()
    for can_id, data in frames:
        it.put_on_bus(can_id, data)
    it.cycle()
    assert all(drive.setpoint is None for drive in it.machine.drives.values())
    assert not any(channel.armed for channel in it.bridge.channels.values())
    assert payout_rate(it) == 0.0


@cache
def dictionary(name: str) -> str:
    return export(next(device for device in DEVICES if device.name == name))


@pytest.mark.fuzz
@given(name=st.sampled_from([device.name for device in DEVICES]), data=st.data())
@settings(max_examples=40, suppress_health_check=[HealthCheck.too_slow])
def test_a_damaged_dictionary_is_compared_or_refused(name: str, data: st.DataObject):
    text = data.draw(damaged_text(dictionary(name), "=[]"))
    with TemporaryDirectory() as folder, redirect_stdout(StringIO()), redirect_stderr(StringIO()):
        path = Path(folder) / "device.eds"
        path.write_text(text, "utf-8", "surrogatepass")
        assert run(argparse.Namespace(compare=(name, str(path)))) in {0, 1, 2}
