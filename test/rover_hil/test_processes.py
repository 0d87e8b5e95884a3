"""Emulator and bridge as processes, with the real winch_node, over DDS and a real transport."""

from __future__ import annotations

import os
import pty
import random
import signal
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest

from msg_schemas import topics
from msg_schemas.machine import WINCH_BRAKE, WINCH_DRUM, WINCH_LIMIT, WINCH_TO_LENGTH
from msg_schemas.samples import JointSample, JointValue, StatusSample
from rover_hil.devices import COMMANDS_LOST, HEARTBEAT_LOST

if TYPE_CHECKING:
    from rover_verify.stage import Observer, Process, Stage

pytestmark = [pytest.mark.ros, pytest.mark.process]

EMULATOR, BRIDGE = "rover_hil.emulator.emulator_node", "rover_hil.bridge_node"
WINCH = "tether_winch.winch_node"
LENGTH = 20.5
ATTEMPTS = 10


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


def start_bridge(stage: Stage, link: str, within: int) -> Process:
    """Start a bridge that waits for the winch's commander once that has begun.

    In lockstep a machine too busy for real time is slow, and not wrong.

    Args:
        stage: of its processes.
        link: its end.
        within: cycles within which a command must come.
    """
    parameters = {
        "link": link,
        "use_sim_time": True,
        "lockstep": True,
        "lockstep_commands": topics.WINCH_COMMAND,
        "lockstep_within": within,
        "lockstep_patience": 10.0,
    }
    return stage.processes.start(BRIDGE, parameters)


def start(
    stage: Stage, emulators_end: str, bridges_end: str, within: int
) -> tuple[Process, Observer]:
    """Start emulator and bridge; returns the bridge, and an observer when both are ready."""
    parameters = {"link": emulators_end, "lockstep": True, "lockstep_patience": 5.0}
    stage.processes.start(EMULATOR, parameters | {"scenario": "free_hang"})
    bridge = start_bridge(stage, bridges_end, within)
    observer = stage.observer()
    for name in (
        topics.CLOCK, topics.DIAGNOSTICS, topics.EVENTS, topics.WINCH_STATE, topics.WINCH_MODE,
        topics.LINK_STATUS,
    ):  # fmt: skip
        observer.listen(name)
    for node in ("drive_emulator", "hil_bridge"):
        observer.wait_until_ready(node)
    return bridge, observer


def drum(sample: JointSample) -> JointValue:
    return sample.joints[WINCH_DRUM]


def brake_is_open(sample: JointSample) -> bool:
    return sample.joints[WINCH_BRAKE].position == 1.0


def test_the_winch_moves_the_tether_through_a_serial_link(stage: Stage, compiled_in_space: None):
    with serial_line() as (one, other):
        bridge, observer = start(stage, one, other, within=2)
        stage.processes.start(WINCH, {"use_sim_time": True})
        observer.wait_until_ready("winch_node")
        assert observer.call(topics.DRIVES_ARM, True).success
        assert observer.call(topics.WINCH_REARM).success
        observer.wait_for_text(topics.WINCH_MODE, "hold")
        states, since = observer.listen(topics.WINCH_STATE), len(observer.listen(topics.WINCH_MODE))
        request = {WINCH_TO_LENGTH: JointValue(LENGTH, 0.3, 0.0)}
        observer.send(topics.WINCH_REQUEST, JointSample(observer.time_ns(), request))
        observer.wait_for_text(topics.WINCH_MODE, "hold", since=since)
        assert drum(states.last).position == pytest.approx(LENGTH, abs=0.02)
        told = observer.wait_for_status(
            topics.LINK_STATUS, lambda s: s.name == "hil_bridge: link" and s.message != ""
        )
        assert told.values["frames_damaged"] == "0"
        assert bridge.stop() == 0


class Holder:
    """Has the winch's motor hold the rover, brake open: a command to each state that is told."""

    def __init__(self, observer: Observer) -> None:
        self._observer = observer
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        joints = {
            WINCH_DRUM: JointValue(20.0, 0.0, 16.2),
            WINCH_BRAKE: JointValue(1.0),
            WINCH_LIMIT: JointValue(0.0, 0.0, 100.0),
        }
        states, answered = self._observer.listen(topics.WINCH_STATE), 0
        while not self._ending.wait(0.001):
            if len(states) > answered:
                answered = len(states)
                sample = JointSample(states.last.stamp_ns, joints)
                self._observer.send(topics.WINCH_COMMAND, sample)

    def stop(self) -> None:
        self._ending.set()
        self._thread.join()


def arm_until_it_holds(observer: Observer) -> None:
    """Arm until the motor holds: what is armed too early falls back into its fault."""
    states = observer.listen(topics.WINCH_STATE)
    for _ in range(ATTEMPTS):
        since = len(states)
        assert observer.call(topics.DRIVES_ARM, True).success
        end = observer.time_ns() + 1_000_000_000

        def is_over(sample: JointSample, end: int = end) -> bool:
            return brake_is_open(sample) or sample.stamp_ns > end

        if brake_is_open(states.wait(is_over, since)):
            return
    raise AssertionError("the motor never held the rover")


def test_a_killed_bridge_brakes_and_its_successor_moves_nothing_until_it_is_armed(
    stage: Stage, compiled_in_space: None
):
    link = f"udp_multicast:239.74.163.2:{random.SystemRandom().randrange(44000, 48000)}"
    bridge, observer = start(stage, link, link, within=20)
    holder = Holder(observer)
    try:
        arm_until_it_holds(observer)
        events = observer.listen(topics.EVENTS)
        since = len(events)
        bridge.send(signal.SIGKILL)
        bridge.wait()

        def tells_a_watchdog(sample: StatusSample) -> bool:
            codes = [s.values.get("error_code") for s in sample.statuses if s.name == "winch_drive"]
            return bool({str(COMMANDS_LOST), str(HEARTBEAT_LOST)} & set(codes))

        events.wait(tells_a_watchdog, since)
        states, told = observer.listen(topics.WINCH_STATE), observer.listen(topics.DIAGNOSTICS)
        back, since = len(states), len(told)
        start_bridge(stage, link, within=20)
        observer.wait_for_refusal(topics.WINCH_COMMAND, "not_armed", since)
        assert not any(brake_is_open(s) for s in states.samples[back:])
        observer.wait_until_ready("hil_bridge", since)
        arm_until_it_holds(observer)
    finally:
        holder.stop()
