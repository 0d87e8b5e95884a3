"""The ``hil_bridge`` executable: joins the contract's topics to the devices on the link.

It does not depend on a simulator: the same process runs against an emulator and a real machine.
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
from msg_schemas.parameters import parameter
from msg_schemas.samples import JointSample, Status, StatusSample
from msg_schemas.table import TOPICS
from rover_hil.bridge.bridge import Bridge
from rover_hil.bridge.commissioning import mismatch
from rover_hil.bridge.link_report import device_status, link_status, measured_times, with_times
from rover_hil.bridge.sync_source import SYNC_PERIOD_NS, SyncSource
from rover_hil.bridge.wiring import COMMANDED, PUBLISHED
from rover_hil.canopen.devices import BRIDGE_NODE, DEVICES, HEARTBEAT_PERIOD, LOCKSTEP_ID
from rover_hil.canopen.dictionary import object_dictionary
from rover_hil.canopen.link import HEARTBEAT_ID, Link
from rover_hil.canopen.objects import Device
from rover_hil.canopen.transport import open_bus
from rover_runtime.component import ExitCode
from rover_runtime.ros.node import RosComponent
from rover_runtime.ros.process import run

# Interval of thread switches [s]: short, so that frames are processed at once.
SWITCH_INTERVAL = 0.0005
_OPERATIONAL = 5
_COUNTERS = 240  # values of the SYNC counter
_NANO = 1_000_000_000
_RETRY_PERIOD = 0.2  # of the identity check of a device that does not respond [s]
_ALIVE_PERIOD = 0.5  # of signs of life on the link in lockstep [s]


@dataclass(frozen=True)
class BridgeParameters:
    """Link."""

    link: str = parameter(
        "udp_multicast:239.74.163.2",
        "-",
        "transport and channel: socketcan:NAME for the real machine's CAN, "
        "udp_multicast:GROUP[:PORT], serial:PORT[:BAUD]",
        read_only=True,
    )


class BridgeNode(RosComponent):
    """Joins controllers to drives and sensors over CANopen, and supervises the drives."""

    NAME = "hil_bridge"
    PARAMETERS = (BridgeParameters,)

    _link: Link | None = None

    # --- lifecycle -------------------------------------------------------------------------------

    def setup(self) -> None:
        """Open link, topics and services."""
        settings = self.parameters_of(BridgeParameters)
        self._link = link = Link(open_bus(settings.link))
        self._lock = threading.RLock()
        self._nodes: dict[str, canopen.RemoteNode] = {}
        # They go on after a deactivation: the bridge keeps times of this clock.
        self._stamp_ns = self._counter = self._heartbeat_ns = self._cycle = 0
        self._bridge = Bridge(link.send, self._start_device, self._check_device)
        for device in DEVICES:
            kind = BaseNode402 if device.is_drive else canopen.RemoteNode
            node = kind(device.node_id, object_dictionary(device))
            link.network.add_node(node)
            node.nmt.add_heartbeat_callback(partial(self._on_heartbeat, device))
            node.emcy.add_callback(partial(self._on_emergency, device))
            self._nodes[device.name] = node
        for can_id in self._bridge.can_ids:
            link.network.subscribe(can_id, self._on_pdo)
        link.network.subscribe(HEARTBEAT_ID + BRIDGE_NODE, self._on_other_bridge)
        self._source: SyncSource | None = None
        if self.is_in_lockstep:
            self._source = SyncSource(self._begin_cycle, self._dispatch, self.clock_went_back)
            self._stepper = self.time_stepper(self._source, 0.0)
            link.network.subscribe(LOCKSTEP_ID, self._on_cycle_over)
        self._contract_publishers = {name: self.publisher(name) for name in PUBLISHED}
        self._status_publisher = self.publisher(topics.LINK_STATUS)
        for name in COMMANDED:
            self.subscribe(name, partial(self._on_command, name))
        self.serve(topics.DRIVES_ARM, self._on_arm)

    def start(self) -> None:
        """Start SYNC, with all drives disarmed."""
        self._stopping = threading.Event()
        self._unchecked: queue.Queue[Device | None] = queue.Queue()
        self._threads: list[threading.Thread] = []
        for station in self._bridge.stations.values():
            station.connected = False  # nothing was received while the node was inactive
        jobs: list[Callable[[], None]] = [self._commission]
        if self._source is None:
            jobs.append(self._run_link)
        else:
            self._wait_for_devices(self._source)
            self._stepper.start()
        self._threads = [
            threading.Thread(target=self._run_thread, args=(job,), name=job.__name__)
            for job in jobs
        ]
        for thread in self._threads:
            thread.start()
        rate = TOPICS[topics.LINK_STATUS].rate
        if rate is None:
            raise AssertionError("the link's status has no rate")
        self.every(1.0 / rate, self._publish_status, by_wall_clock=True)

    def stop(self) -> None:
        """Switch the drives off and stop SYNC."""
        with self._lock:
            self._bridge.disarm("the bridge stops", self._now_ns())
        self._stopping.set()
        if self._source is not None:
            self._stepper.stop()
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
        """Process and host, so that the impairment `bridge_kill` can kill it."""
        return {"process": os.getpid(), "host": socket.gethostname()}

    def waiting_for(self) -> tuple[str, ...]:
        """Devices that do not answer, or are not the expected ones."""
        with self._lock:
            missing = self._bridge.missing_devices(self._now_ns())
            wrong = tuple(
                name for name, each in self._bridge.stations.items() if each.mismatch != ""
            )
        return tuple(dict.fromkeys((*missing, *wrong)))

    # --- the link's thread -----------------------------------------------------------------------

    def _run_thread(self, job: Callable[[], None]) -> None:
        try:
            job()
        except Exception as error:  # noqa: BLE001 - a bug must reach the process, not end here
            self.ros.get_logger().fatal("".join(traceback.format_exception(error)))
            self.exit_code = ExitCode.CRASH

    def _wait_for_devices(self, source: SyncSource) -> None:
        """Wait in lockstep until the devices' end has reported its time."""
        while not source.is_known:
            self.check_shutdown()
            self._open_link.send(LOCKSTEP_ID, b"")
            self._dispatch(_RETRY_PERIOD)

    def _now_ns(self) -> int:
        """The bridge's clock [ns]: steady time, or in lockstep the elapsed periods."""
        return time.monotonic_ns() if self._source is None else self._cycle * SYNC_PERIOD_NS

    def _run_link(self) -> None:
        due_ns = time.monotonic_ns()
        while not self._stopping.is_set():
            now_ns = time.monotonic_ns()
            if now_ns < due_ns:
                self._dispatch((due_ns - now_ns) / _NANO)
                continue
            # Frames received so far belong to the ending cycle.
            while self._dispatch(0.0):
                pass
            self._begin_cycle(self._next_stamp())
            due_ns += SYNC_PERIOD_NS
            if now_ns - due_ns > SYNC_PERIOD_NS:
                due_ns = now_ns + SYNC_PERIOD_NS  # missed cycles are counted, not repeated

    def _dispatch(self, wait: float) -> bool:
        """Process a frame received within a time [s], and publish the samples that it completes."""
        link = self._open_link
        frame = link.receive(wait)
        if frame is None:
            return False
        with self._lock:
            link.dispatch(frame)
            samples = self._bridge.samples()
        for name, sample in samples:
            publisher = self._contract_publishers[name]
            if publisher.has_subscribers:
                publisher.send(sample)
        return True

    def _begin_cycle(self, stamp_ns: int | None) -> int:
        """Send a SYNC whose answers have a stamp [ns]; returns its counter."""
        link, bridge = self._open_link, self._bridge
        with self._lock:
            self._cycle += 1
            self._counter = self._counter % _COUNTERS + 1
            now_ns = self._now_ns()
            bridge.begin_cycle(self._counter, stamp_ns, now_ns)
            link.sync(self._counter)
            if now_ns - self._heartbeat_ns >= HEARTBEAT_PERIOD * _NANO:
                self._heartbeat_ns = now_ns
                link.heartbeat(BRIDGE_NODE, _OPERATIONAL)
            bridge.supervise(now_ns)
        self._publish_transitions()
        return self._counter

    def _next_stamp(self) -> int | None:
        """Stamp of the samples of the next SYNC, its time of sending; None: time stands still.

        Simulated time advances in ticks and may be late by one: the stamps advance nevertheless.
        """
        now_ns = self.now_ns()
        if now_ns < self._stamp_ns - _NANO:
            # Also the time of day is set back: commands must not count as old until then.
            self.reception.forget_stamps()
            self._stamp_ns = now_ns
        elif now_ns > self._stamp_ns:
            self._stamp_ns = now_ns
        elif now_ns + SYNC_PERIOD_NS > self._stamp_ns:
            self._stamp_ns += SYNC_PERIOD_NS
        else:
            return None
        return self._stamp_ns

    @property
    def _open_link(self) -> Link:
        if self._link is None:
            raise AssertionError("not configured")
        return self._link

    def _on_pdo(self, can_id: int, data: bytearray, _timestamp: float) -> None:
        self._bridge.on_tpdo(can_id, bytes(data), self._now_ns())

    def _on_cycle_over(self, _can_id: int, data: bytearray, _timestamp: float) -> None:
        if self._source is not None:
            self._source.on_cycle_over(bytes(data))

    def _on_heartbeat(self, device: Device, state: int) -> None:
        self._bridge.on_heartbeat(device, state, self._now_ns())

    def _on_other_bridge(self, _can_id: int, _data: bytearray, _timestamp: float) -> None:
        self._bridge.on_other_bridge(self._now_ns())

    def _on_emergency(self, device: Device, error: Any) -> None:
        self._bridge.on_emergency(device, int(error.code))

    def _start_device(self, device: Device) -> None:
        self._nodes[device.name].nmt.state = "OPERATIONAL"

    def _check_device(self, device: Device) -> None:
        self._unchecked.put(device)

    def _publish_transitions(self) -> None:
        with self._lock:
            changes = self._bridge.take_transitions()
        for change in changes:
            self.event(change, diagnoses=True)

    # --- commissioning ---------------------------------------------------------------------------

    def _commission(self) -> None:
        while True:
            if self._source is not None:
                self._open_link.send(LOCKSTEP_ID, b"")
            try:
                device = self._unchecked.get(timeout=_ALIVE_PERIOD)
            except queue.Empty:
                continue
            if device is None:
                return
            try:
                difference = mismatch(self._nodes[device.name], device)
            except canopen.SdoCommunicationError:
                # The device is slow or gone: try again.
                if self._stopping.wait(_RETRY_PERIOD):
                    return
                self._unchecked.put(device)
                continue
            with self._lock:
                self._bridge.on_device_checked(device, difference)

    # --- commands and requests -------------------------------------------------------------------

    def _on_command(self, topic: str, sample: JointSample) -> None:
        with self._lock:
            self._bridge.on_command(topic, sample, self._now_ns())

    def _on_arm(self, arm: bool) -> tuple[bool, str]:
        with self._lock:
            now_ns = self._now_ns()
            done = (
                self._bridge.arm(now_ns) if arm else self._bridge.disarm("disarm request", now_ns)
            )
        self._publish_transitions()
        return True, done

    # --- status ----------------------------------------------------------------------------------

    def _publish_status(self) -> None:
        self._status_publisher.send(StatusSample(self.now_ns(), self.health()))

    def health(self) -> tuple[Status, ...]:
        """Status of the link and of each device."""
        if not self.active:
            return ()
        with self._lock:
            now_ns = self._now_ns()
            link = link_status(self.NAME, self._bridge, self._open_link, now_ns)
            devices = [
                device_status(self.NAME, self._bridge, name, now_ns)
                for name in self._bridge.stations
            ]
            times = measured_times(self._bridge)
        # Their percentiles take as long as a cycle, which must not wait for them.
        return with_times(link, times), *devices


def main() -> int:
    """Run the node."""
    sys.setswitchinterval(SWITCH_INTERVAL)
    return run(BridgeNode)


if __name__ == "__main__":
    sys.exit(main())
