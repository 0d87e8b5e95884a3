"""The ``hil_bridge`` executable: the contract's topics on one side, the link on the other.

It knows no simulator: the same process runs against an emulator and against the real machine.
"""

from __future__ import annotations

import os
import queue
import socket
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import canopen
from canopen.profiles.p402 import BaseNode402

from msg_schemas import topics
from msg_schemas.node import ContractNode, ExitCode
from msg_schemas.node_process import run
from msg_schemas.parameters import ParameterError, parameter
from msg_schemas.samples import JointSample, Level, Status, StatusSample
from msg_schemas.table import TOPICS
from rover_hil.bridge import Bridge
from rover_hil.commissioning import mismatch
from rover_hil.devices import BRIDGE_NODE, CYCLE_OVER_ID, DEVICES, HEARTBEAT, SYNC_PERIOD
from rover_hil.dictionary import object_dictionary
from rover_hil.link import Link
from rover_hil.link_report import device_status, link_status
from rover_hil.lockstep import Lockstep
from rover_hil.objects import Device
from rover_hil.transport import open_bus
from rover_hil.wiring import COMMANDED, TOLD

# Threads of this process take turns this often [s]: what comes by the link is handed on at once.
SWITCH_INTERVAL = 0.0005
_OPERATIONAL = 5
_COUNTERS = 240  # of SYNC
_NANO = 1_000_000_000
_PERIOD_NS = round(SYNC_PERIOD * _NANO)
_ASK_AGAIN = 0.2  # after a device that does not answer [s]
_LOOK = 0.001  # in lockstep, at commands by the others' thread [s]


@dataclass(frozen=True)
class BridgeParameters:
    """Which link, and how it goes."""

    link: str = parameter(
        "udp_multicast:239.74.163.2",
        "-",
        "transport and channel: socketcan:NAME of the real machine's CAN, "
        "udp_multicast:GROUP[:PORT], serial:PORT[:BAUD]",
        read_only=True,
    )
    lockstep: bool = parameter(
        False,
        "-",
        "a SYNC waits until the devices have answered the last one, and for commands",
        read_only=True,
    )
    lockstep_commands: str = parameter(
        "",
        "-",
        "topics, with commas between, whose commander is waited for once it has begun",
        read_only=True,
    )
    lockstep_within: int = parameter(
        1, "-", "cycles within which each of these commands must come", 1, 100, read_only=True
    )
    lockstep_patience: float = parameter(
        1.0,
        "s",
        "wall time after which who has not been heard is waited for no more",
        0.01,
        600.0,
        read_only=True,
    )


class BridgeNode(ContractNode):
    """Joins controllers to drives and sensors over CANopen, and keeps the drives safe."""

    NAME = "hil_bridge"
    PARAMETERS = (BridgeParameters,)

    _link: Link | None = None

    # --- life ------------------------------------------------------------------------------------

    def setup(self) -> None:
        """Open the link, topics and services."""
        wanted = self.parameters_of(BridgeParameters)
        self._awaited = awaited_topics(wanted.lockstep_commands)
        self._link = link = Link(open_bus(wanted.link))
        self._lock = threading.RLock()
        self._nodes: dict[str, canopen.RemoteNode] = {}
        self._bridge = Bridge(link.send, self._start_device)
        for device in DEVICES:
            kind = BaseNode402 if device.is_drive else canopen.RemoteNode
            node = kind(device.node_id, object_dictionary(device))
            link.network.add_node(node)
            node.nmt.add_heartbeat_callback(partial(self._on_heartbeat, device))
            node.emcy.add_callback(partial(self._on_emergency, device))
            self._nodes[device.name] = node
        for can_id in self._bridge.can_ids:
            link.network.subscribe(can_id, self._on_pdo)
        link.network.subscribe(CYCLE_OVER_ID, self._on_cycle_over)
        self._contract_publishers = {name: self.publisher(name) for name in TOLD}
        self._status_publisher = self.publisher(topics.LINK_STATUS)
        for name in COMMANDED:
            self.subscribe(name, partial(self._on_command, name))
        self.serve(topics.DRIVES_ARM, self._on_arm)

    def start(self) -> None:
        """Let SYNC run; nothing is armed."""
        self._ending = threading.Event()
        self._unchecked: queue.SimpleQueue[Device | None] = queue.SimpleQueue()
        self._asked: set[str] = set()  # devices, what they are
        self._stamp_ns = 0
        self._counter = 0
        self._beat_ns = 0
        self._cycle = 0
        self._lockstep = Lockstep(self.parameters_of(BridgeParameters).lockstep_patience)
        self._over: int | None = None  # counter of the last SYNC upon which all has come
        jobs: tuple[Callable[[], None], ...] = (self._run_link, self._commission)
        self._threads = [
            threading.Thread(target=self._guarded, args=(job,), name=job.__name__) for job in jobs
        ]
        for thread in self._threads:
            thread.start()
        rate = TOPICS[topics.LINK_STATUS].rate
        if rate is None:
            raise AssertionError("the link's status has no rate")
        self.every(1.0 / rate, self._publish_status, by_wall_clock=True)

    def stop(self) -> None:
        """Switch the drives off, and fall silent."""
        with self._lock:
            self._bridge.disarm("the bridge stops", self._now_ns())
        self._ending.set()
        self._unchecked.put(None)
        for thread in self._threads:
            thread.join()
        self._publish_transitions()

    def release(self) -> None:
        """Close the link."""
        if self._link is not None:
            self._link.close()
        self._link = None

    def configuration(self) -> Mapping[str, Any]:
        """The process, so that a rehearsal can end it as a power cut would."""
        return {"process": os.getpid(), "host": socket.gethostname()}

    def waiting_for(self) -> tuple[str, ...]:
        """Devices that are not heard, or not what they should be."""
        with self._lock:
            silent = self._bridge.silent(self._now_ns())
            wrong = tuple(
                name for name, each in self._bridge.stations.items() if each.mismatch != ""
            )
        return tuple(dict.fromkeys((*silent, *wrong)))

    # --- the link's thread -----------------------------------------------------------------------

    def _guarded(self, job: Callable[[], None]) -> None:
        try:
            job()
        except Exception as error:  # noqa: BLE001 - a bug must reach the process, not end here
            self.get_logger().fatal("".join(traceback.format_exception(error)))
            self.exit_code = ExitCode.CRASH

    def _now_ns(self) -> int:
        """The bridge's own clock [ns]: steady, or in lockstep as many periods as there were."""
        if self.parameters_of(BridgeParameters).lockstep:
            return self._cycle * _PERIOD_NS
        return time.monotonic_ns()

    def _run_link(self) -> None:
        lockstep = self.parameters_of(BridgeParameters).lockstep
        due_ns = time.monotonic_ns()
        while not self._ending.is_set():
            now_ns = time.monotonic_ns()
            if self._may_go_on(now_ns, due_ns) if lockstep else now_ns >= due_ns:
                # What has come by now still belongs to the cycle that ends.
                while self._hand_on(0.0):
                    pass
                self._begin_cycle()
                due_ns += _PERIOD_NS
                if lockstep or now_ns - due_ns > _PERIOD_NS:
                    due_ns = now_ns + _PERIOD_NS  # what was missed is counted, not made up for
                continue
            wait = _LOOK if lockstep else (due_ns - now_ns) / _NANO
            self._hand_on(wait)

    def _hand_on(self, wait: float) -> bool:
        """Take a frame, if one comes within a time [s], and tell what it completes."""
        link = self._joined
        frame = link.receive(wait)
        if frame is None:
            return False
        with self._lock:
            link.hand_on(frame)
            told = self._bridge.samples()
        for name, sample in told:
            publisher = self._contract_publishers[name]
            if publisher.is_heard:
                publisher.send(sample)
        return True

    def _begin_cycle(self) -> None:
        link, bridge = self._joined, self._bridge
        with self._lock:
            self._cycle += 1
            self._counter = self._counter % _COUNTERS + 1
            now_ns = self._now_ns()
            bridge.begin_cycle(self._counter, self._next_stamp(), now_ns)
            link.sync(self._counter)
            if now_ns - self._beat_ns >= HEARTBEAT * _NANO:
                self._beat_ns = now_ns
                link.heartbeat(BRIDGE_NODE, _OPERATIONAL)
            bridge.supervise(now_ns)
        self._publish_transitions()

    def _next_stamp(self) -> int | None:
        """Time of the samples that a SYNC brings, that of its sending; None: none has passed.

        Simulated time comes in ticks, and may come late by one: stamps go on all the same, as the
        samples do. A clock that stands brings no new samples.
        """
        now_ns = self.now_ns()
        if now_ns < self._stamp_ns - _NANO or now_ns > self._stamp_ns:
            self._stamp_ns = now_ns
        elif now_ns + _PERIOD_NS > self._stamp_ns:
            self._stamp_ns += _PERIOD_NS
        else:
            return None
        return self._stamp_ns

    def _may_go_on(self, now_ns: int, due_ns: int) -> bool:
        """In lockstep, whether the next SYNC may go out."""
        with self._lock:
            for name, station in self._bridge.stations.items():
                if station.complete or self._over == self._counter:
                    self._lockstep.heard(name, self._cycle)
            waited = (now_ns - due_ns + _PERIOD_NS) / _NANO
            return self._lockstep.may_go_on(self._cycle, waited)

    @property
    def _joined(self) -> Link:
        if self._link is None:
            raise AssertionError("not configured")
        return self._link

    def _on_pdo(self, can_id: int, data: bytearray, _timestamp: float) -> None:
        self._bridge.heard(can_id, bytes(data), self._now_ns())

    def _on_cycle_over(self, _can_id: int, data: bytearray, _timestamp: float) -> None:
        self._over = data[0] if len(data) == 1 else None

    def _on_heartbeat(self, device: Device, state: int) -> None:
        station = self._bridge.stations[device.name]
        # Not by whether it was heard: one that is operational already answers SYNC before it beats.
        if state == 0 or device.name not in self._asked:
            self._asked.add(device.name)
            station.mismatch = None
            self._unchecked.put(device)
        self._bridge.heartbeat(device, state, self._now_ns())

    def _on_emergency(self, device: Device, error: Any) -> None:
        self._bridge.emergency(device, int(error.code))

    def _start_device(self, device: Device) -> None:
        self._nodes[device.name].nmt.state = "OPERATIONAL"

    def _publish_transitions(self) -> None:
        with self._lock:
            changes = self._bridge.take_transitions()
        for change in changes:
            self.event(change.name, change.reason, change.level, change.values)
            if change.level is not Level.OK:
                name = f"{self.NAME}: {change.name}"
                self.report(Status(name, change.reason, change.level, self.NAME))

    # --- commissioning ---------------------------------------------------------------------------

    def _commission(self) -> None:
        while True:
            device = self._unchecked.get()
            if device is None:
                return
            try:
                found = mismatch(self._nodes[device.name], device)
            except canopen.SdoCommunicationError:
                # It is slow or gone; what it is will be asked again while the node lives.
                if self._ending.wait(_ASK_AGAIN):
                    return
                self._unchecked.put(device)
                continue
            with self._lock:
                self._bridge.checked(device, found)

    # --- commands and requests -------------------------------------------------------------------

    def _on_command(self, topic: str, sample: JointSample) -> None:
        with self._lock:
            if topic in self._awaited:
                within = self.parameters_of(BridgeParameters).lockstep_within
                self._lockstep.heard(topic, self._cycle, within)
            self._bridge.take(topic, sample, self._now_ns())

    def _on_arm(self, arm: bool) -> tuple[bool, str]:
        with self._lock:
            now_ns = self._now_ns()
            done = (
                self._bridge.arm(now_ns) if arm else self._bridge.disarm("asked to disarm", now_ns)
            )
        self._publish_transitions()
        return True, done

    # --- status ----------------------------------------------------------------------------------

    def _publish_status(self) -> None:
        self._status_publisher.send(StatusSample(self.now_ns(), self.health()))

    def health(self) -> tuple[Status, ...]:
        """The link, and each device on it."""
        if not self.active:
            return ()
        with self._lock:
            now_ns = self._now_ns()
            return (
                link_status(self.NAME, self._bridge, self._joined, now_ns),
                *(
                    device_status(self.NAME, self._bridge, name, now_ns)
                    for name in self._bridge.stations
                ),
            )


def awaited_topics(names: str) -> tuple[str, ...]:
    """Topics from a parameter's text.

    Raises:
        ParameterError: one is no command of a drive.
    """
    found = tuple(name.strip() for name in names.split(",") if name.strip())
    for name in found:
        if name not in COMMANDED:
            raise ParameterError(
                f"lockstep_commands holds {name!r}, it should hold some of {', '.join(COMMANDED)}"
            )
    return found


def main() -> int:
    """Run the node."""
    sys.setswitchinterval(SWITCH_INTERVAL)
    return run(BridgeNode)


if __name__ == "__main__":
    sys.exit(main())
