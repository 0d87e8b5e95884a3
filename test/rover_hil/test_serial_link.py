"""Emulator and bridge as processes, with the real winch_node, over DDS and a real transport."""

from __future__ import annotations

import os
import pty
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest

from msg_schemas import machine, topics
from msg_schemas.events import BridgeEvent, EmulatorEvent
from msg_schemas.phases import WinchMode
from msg_schemas.samples import JointSample, JointValue, Level

if TYPE_CHECKING:
    from rover_verify.harness import NodeHarness, Observer, Process

pytestmark = [pytest.mark.ros, pytest.mark.process]

EMULATOR, BRIDGE = "rover_hil.emulator.emulator_node", "rover_hil.bridge.bridge_node"
WINCH = "tether_winch.winch_node"
LENGTH = 20.5


@contextmanager
def serial_line() -> Iterator[tuple[str, str]]:
    """Two ends of a serial line made of pseudo-terminals."""
    ends = [pty.openpty() for _ in range(2)]
    for end in ends:
        for descriptor in end:
            tty.setraw(descriptor)
    (first, first_slave), (second, second_slave) = ends

    def carry(here: int, there: int) -> None:
        while True:
            try:
                os.write(there, os.read(here, 4096))
            except OSError:  # closed
                return

    carriers = [
        threading.Thread(target=carry, args=pair, daemon=True)
        for pair in ((first, second), (second, first))
    ]
    for carrier in carriers:
        carrier.start()
    try:
        yield f"serial:{os.ttyname(first_slave)}", f"serial:{os.ttyname(second_slave)}"
    finally:
        for descriptor in (first_slave, second_slave, first, second):
            os.close(descriptor)


LOCKSTEP = "drive_emulator,hil_bridge,winch_node"


def start(harness: NodeHarness, emulators_end: str, bridges_end: str) -> tuple[Process, Observer]:
    """Start emulator, bridge and winch in lockstep: a busy computer does not change the result.

    Returns the bridge, and an observer when all are ready.
    """
    shared: dict[str, object] = {"lockstep": LOCKSTEP}
    harness.processes.start(EMULATOR, {"link": emulators_end, "scenario": "free_hang"} | shared)
    bridge = harness.processes.start(BRIDGE, {"link": bridges_end} | shared)
    harness.processes.start(WINCH, shared)
    observer = harness.observer()
    for name in (topics.CLOCK, topics.DIAGNOSTICS, topics.WINCH_STATE, topics.WINCH_MODE,
                 topics.LINK_STATUS):  # fmt: skip
        observer.listen(name)
    for node in LOCKSTEP.split(","):
        observer.wait_until_ready(node)
    return bridge, observer


def drum(sample: JointSample) -> JointValue:
    return sample.joints[machine.WINCH_DRUM]


def test_the_winch_moves_the_tether_through_a_serial_link(
    harness: NodeHarness, compiled_in_space: None
):
    with serial_line() as (one, other):
        bridge, observer = start(harness, one, other)
        assert observer.call(topics.DRIVES_ARM, True).success
        assert observer.call(topics.WINCH_REARM).success
        observer.wait_for_text(topics.WINCH_MODE, WinchMode.HOLD)
        states, since = observer.listen(topics.WINCH_STATE), len(observer.listen(topics.WINCH_MODE))
        request = {machine.WINCH_TO_LENGTH: JointValue(LENGTH, 0.3, 0.0)}
        observer.send(topics.WINCH_REQUEST, JointSample(observer.time_ns(), request))
        observer.wait_for_text(topics.WINCH_MODE, WinchMode.HOLD, since=since)
        assert drum(states.last).position == pytest.approx(LENGTH, abs=0.02)
        status = observer.wait_for_status(
            topics.LINK_STATUS, lambda s: s.name == "hil_bridge: link" and s.level is Level.OK
        )
        assert status.values["frames_damaged"] == "0"
        assert_arms_after_a_deactivation(observer)
        assert bridge.stop() == 0


def assert_arms_after_a_deactivation(observer: Observer) -> None:
    observer.wait_for_time(round(12e9))
    events = observer.listen(topics.EVENTS)
    for transition in ("deactivate", "activate"):
        assert observer.change_state("hil_bridge", transition)
    since, begun_ns = len(events), observer.time_ns()
    assert observer.call(topics.DRIVES_ARM, True).success
    observer.wait_for_event(EmulatorEvent.DRIVE_STATE, since, device="jump", state="SWITCHED ON")
    assert events.last.stamp_ns - begun_ns < 6e9
    assert not observer.events(BridgeEvent.SILENT)


def test_real_devices_are_refused_in_lockstep(harness: NodeHarness):
    emulator = harness.processes.start(
        EMULATOR, {"real_devices": "load_cell", "lockstep": "drive_emulator,hil_bridge"}
    )
    assert emulator.wait() == 2
    assert "real_devices = 'load_cell': should be empty in lockstep" in emulator.output
