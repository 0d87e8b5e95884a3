"""The bridge between contract and link, stepped by its owner: no ROS, no threads, no clock.

`on_command` receives commands of the contract, `on_tpdo` frames of devices. Every cycle starts with
SYNC and `begin_cycle`; `supervise` then checks timeouts and sends what is due. The owner fetches
samples, transitions and metrics. Nothing moves before `arm`; a drive that is lost, in fault or
restarted must be armed again. If a command source times out, its drive is switched off with its
brake closed, and continues with the next command.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable

from msg_schemas import topics
from msg_schemas.events import BridgeEvent, EventReport
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample, Sample
from rover_hil.bridge.drive_channel import FAULT, UNKNOWN, DriveChannel, state_of
from rover_hil.bridge.station import Station
from rover_hil.bridge.statistics import SlidingWindow
from rover_hil.bridge.wiring import COMMANDED, PUBLISHED, requests_rest, sample_of, setpoint_of
from rover_hil.canopen.devices import (
    ANSWER_TIMEOUT,
    BRIDGE_NODE,
    DEVICES,
    DRIVES,
    HEARTBEAT_TIMEOUT,
    SYNC_PERIOD,
    ErrorCode,
    error_text,
)
from rover_hil.canopen.link import unpack
from rover_hil.canopen.objects import Device, Pdo

_KEPT_CYCLES = 400  # cycles
_BOOT_UP, _OPERATIONAL = 0, 5  # NMT states


class Bridge:
    """The bridge, without ROS.

    Args:
        send: puts a frame on the link.
        start: commands a device to NMT state operational.
        check: has a device compared with its object dictionary, for `on_device_checked`.

    Attributes:
        stations: state of each device, by name.
        channels: command channel of each drive, by name.
        round_trip: from the sampling of a state to the execution, by the drive, of a command with
            the state's stamp [s].
        command_time: from the reception of a command to its execution, by estimated clocks [s].
        answer_time: from SYNC to the last device's answer [s].
        cycles: started cycles.
        late_cycles: cycles that started more than half a period late, or not at all.
        incomplete_cycles: cycles with a missing answer of a device.
        overdue_round_trips: round trips longer than a period.
    """

    def __init__(
        self,
        send: Callable[[int, bytes], None],
        start: Callable[[Device], None],
        check: Callable[[Device], None],
    ) -> None:
        self.stations = {device.name: Station(device) for device in DEVICES}
        self.channels = {device.name: DriveChannel(device, send) for device in DRIVES}
        self.round_trip, self.command_time, self.answer_time = (
            SlidingWindow(),
            SlidingWindow(),
            SlidingWindow(),
        )
        self.cycles = self.late_cycles = self.incomplete_cycles = self.overdue_round_trips = 0
        self._start = start
        self._check = check
        self._pdos: dict[int, tuple[Station, Pdo]] = {
            pdo.can_id(station.device.node_id): (station, pdo)
            for station in self.stations.values()
            for pdo in station.device.tpdos
        }
        self._other_bridge_ns: int | None = None  # last heartbeat of another bridge
        self._stamp_ns: int | None = None
        self._cycle_ns: int | None = None
        self._counter = 0
        self._has_new_answers = False  # a device has answered completely since the last `samples`
        self._published: set[str] = set()
        # Stamp of each published state -> sample times of the drives by their own clocks.
        self._sample_times: OrderedDict[int, dict[str, int]] = OrderedDict()
        self._transitions: list[EventReport] = []

    # --- inputs ----------------------------------------------------------------------------------

    @property
    def can_ids(self) -> tuple[int, ...]:
        """CAN identifiers of the TPDOs."""
        return tuple(self._pdos)

    def on_tpdo(self, can_id: int, data: bytes, now_ns: int) -> None:
        """Process a TPDO; an invalid one, or one of another cycle, is counted and dropped."""
        station, pdo = self._pdos[can_id]
        counts = unpack(pdo, data)
        if counts is None or self._cycle_ns is None:
            station.invalid += 1
            return
        if not station.on_tpdo(pdo, counts, self._counter, self._cycle_ns, now_ns):
            return
        if not station.complete:
            return
        self._has_new_answers = True
        if station.device.is_drive:
            self._on_drive_answer(self.channels[station.device.name], station, now_ns)
        if all(each.complete for each in self.stations.values()):
            self.answer_time.add((now_ns - self._cycle_ns) * 1e-9)

    def on_heartbeat(self, device: Device, state: int, now_ns: int) -> None:
        """Process a heartbeat; the first one, or a restart, has the device checked.

        Its boot-up message (state 0) reports a restart. Because that may be lost, so does any state
        but operational of a device that has answered.
        """
        station = self.stations[device.name]
        has_restarted = state == _BOOT_UP or (state != _OPERATIONAL and station.has_answered)
        if has_restarted:
            text = "the device has restarted"
            if state != _BOOT_UP:
                text += (
                    f" or was stopped: its NMT state is {state}, not {_OPERATIONAL} (operational)"
                )
            if station.received_ns is not None:
                self._add_event(BridgeEvent.RESTARTED, device.name, text)
            station.restarted()
            if device.is_drive:
                self._disarm(device.name, text)
                self.channels[device.name].restarted()
        is_new, station.nmt_state = station.nmt_state is None, state
        # An operational device is alive by its answers to SYNC, not by its heartbeat.
        if state != _OPERATIONAL:
            station.mark_alive(now_ns)
            self._start(device)
        if has_restarted or is_new:
            station.mismatch = None
            self._check(device)

    def on_other_bridge(self, now_ns: int) -> None:
        """Process the heartbeat of another bridge; each would stop the other's drives."""
        self._other_bridge_ns = now_ns

    def on_emergency(self, device: Device, code: int) -> None:
        """Process an emergency message; `ErrorCode.NO_ERROR` reports that the fault is gone."""
        if code == ErrorCode.NO_ERROR:
            text = "the device reports that its fault is gone"
            self._add_event(BridgeEvent.FAULT_RESET, device.name, text)
        elif code == ErrorCode.SETPOINT_REJECTED:
            text = "the drive cannot execute the command and stops"
            self._add_event(BridgeEvent.SETPOINT_REJECTED, device.name, text)
        else:
            text = f"error {error_text(code)}"
            self._add_event(BridgeEvent.EMERGENCY, device.name, text, error_code=code)
            if device.is_drive:
                self._disarm(device.name, f"the drive reports {text}")

    def on_command(self, topic: str, sample: JointSample, now_ns: int) -> None:
        """Send a command of the contract to its drive.

        Raises:
            Refusal: the drive is not armed, is in fault, does not answer, or cannot represent the
                command.
        """
        device = COMMANDED[topic]
        channel, station = self.channels[device.name], self.stations[device.name]
        setpoint = setpoint_of(topic, sample)
        if not channel.armed or channel.state == FAULT:
            if requests_rest(topic, setpoint):
                return
            code, why = (
                (RefusalCode.NOT_ACTIVE, "is in fault")
                if channel.armed
                else (RefusalCode.NOT_ARMED, f"is not armed: call {topics.DRIVES_ARM}")
            )
            raise Refusal(topic, code, f"the {device.name} drive {why}")
        if station.sampled_ns is None or not station.received_within(ANSWER_TIMEOUT, now_ns):
            raise Refusal(
                topic,
                RefusalCode.NOT_ACTIVE,
                f"the {device.name} drive does not answer on the link",
            )
        channel.command(topic, setpoint, now_ns)
        channel.send(station.sampled_ns, now_ns, sample.stamp_ns)

    # --- cycle -----------------------------------------------------------------------------------

    def begin_cycle(self, counter: int, stamp_ns: int | None, now_ns: int) -> None:
        """Start a cycle with a SYNC.

        Args:
            counter: of the SYNC.
            stamp_ns: of the samples that it triggers; None: they are not published.
            now_ns: bridge's clock.
        """
        if self._cycle_ns is not None:
            self.cycles += 1
            periods = (now_ns - self._cycle_ns) * 1e-9 / SYNC_PERIOD
            self.late_cycles += max(0, math.floor(periods - 0.5))
            # A device that never answered, or is known to be lost, is not counted in each cycle.
            lost = [station.end_cycle(now_ns) for station in self.stations.values()]
            self.incomplete_cycles += any(lost)
        self._counter, self._stamp_ns, self._cycle_ns = counter, stamp_ns, now_ns
        self._published.clear()

    def supervise(self, now_ns: int) -> None:
        """Check the timeouts of devices and commands, and send what is due."""
        for station in self.stations.values():
            if station.connected and not station.is_alive(now_ns):
                station.connected = False
                name = station.device.name
                text = f"no message from the device for {HEARTBEAT_TIMEOUT:g} s"
                self._add_event(BridgeEvent.SILENT, name, text)
                if station.device.is_drive:
                    self._disarm(name, "the device timed out")
        for name, channel in self.channels.items():
            station = self.stations[name]
            age = channel.expire_setpoint(station.values.get("velocity", 0.0), now_ns)
            if age is not None:
                text = f"no command for {age:.3g} s: the drive is switched off"
                self._add_event(BridgeEvent.COMMANDS_CEASED, name, text, timeout=age)
            if channel.keeps_fault(now_ns):
                self._disarm(name, "its fault cannot be reset: arm again when its cause is gone")
            sampled_ns = station.sampled_ns
            if channel.setpoint is not None and not station.received_within(ANSWER_TIMEOUT, now_ns):
                text = f"no answer from the drive for {ANSWER_TIMEOUT:g} s: it is switched off"
                self._add_event(BridgeEvent.FEEDBACK_LOST, name, text)
                channel.setpoint = None
                if sampled_ns is not None:
                    channel.send(sampled_ns, now_ns)
            if sampled_ns is not None and station.is_alive(now_ns) and channel.is_due(now_ns):
                channel.send(sampled_ns, now_ns)

    def arm(self, now_ns: int) -> str:
        """Arm all drives and reset faults whose cause is gone; returns a message.

        A drive that differs from its object dictionary is checked again: its cause may be gone.

        Raises:
            Refusal: a drive is missing or not the expected one, or there is another bridge; no
                drive is armed then.
        """
        if self.has_other_bridge(now_ns):
            raise Refusal(
                topics.DRIVES_ARM,
                RefusalCode.NOT_ACTIVE,
                f"another bridge is on the link (it sends the heartbeats of node {BRIDGE_NODE}): "
                "stop one of them",
            )
        missing_devices = [name for name in self.missing_devices(now_ns) if name in self.channels]
        if missing_devices:
            raise Refusal(
                topics.DRIVES_ARM,
                RefusalCode.NOT_ACTIVE,
                f"no answer on the link: {', '.join(missing_devices)}",
            )
        for name in self.channels:
            mismatch = self.stations[name].mismatch
            if mismatch != "":
                why = "its identity is not checked yet" if mismatch is None else mismatch
                self._check(self.stations[name].device)
                raise Refusal(
                    topics.DRIVES_ARM,
                    RefusalCode.NOT_SUPPORTED,
                    f"{name}: {why}; it is checked again now",
                )
        for channel in self.channels.values():
            channel.arm(now_ns)
        self._transitions.append(EventReport(BridgeEvent.DRIVES_ARMED, "all drives are armed"))
        return "armed"

    def disarm(self, reason: str, now_ns: int) -> str:
        """Switch all drives off, with zero torque and closed brake; returns a message."""
        for name, channel in self.channels.items():
            self._disarm(name, reason, BridgeEvent.DISARMED)
            station = self.stations[name]
            if station.sampled_ns is not None:
                channel.send(station.sampled_ns, now_ns)
        return "disarmed"

    def on_device_checked(self, device: Device, mismatch: str) -> None:
        """Process the comparison of a device with its object dictionary.

        Args:
            device: the device.
            mismatch: the first difference; empty: none.
        """
        self.stations[device.name].mismatch = mismatch
        if mismatch:
            self._add_event(BridgeEvent.MISMATCH, device.name, mismatch)
        else:
            text = "the device matches its object dictionary"
            self._add_event(BridgeEvent.IDENTIFIED, device.name, text)

    def _disarm(self, name: str, reason: str, event: BridgeEvent = BridgeEvent.TRIPPED) -> None:
        channel = self.channels[name]
        if channel.armed:
            self._add_event(event, name, reason)
        channel.disarm()

    def _on_drive_answer(self, channel: DriveChannel, station: Station, now_ns: int) -> None:
        """Process the complete answer of a drive to a SYNC."""
        before, counts = channel.state, station.counts
        is_off_by_itself = channel.on_state(state_of(counts["statusword"]))
        if channel.state == FAULT != before and channel.armed:
            self._disarm(channel.device.name, "the drive is in fault")
        elif is_off_by_itself and channel.armed:
            after = channel.state.lower() or "an unknown state"
            text = f"the drive went from {before.lower()} to {after} without a command"
            self._disarm(channel.device.name, text)
        sent = channel.on_executed(counts["executed_sequence"])
        if sent is None or not sent.command_ns or station.sampled_ns is None:
            return
        executed_ns = station.sampled_ns - counts["execution_age"] * 10_000
        sampled_ns = self._sample_times.get(sent.command_ns, {}).get(channel.device.name)
        if sampled_ns is not None:
            round_trip_time = (executed_ns - sampled_ns) * 1e-9
            self.round_trip.add(round_trip_time)
            self.overdue_round_trips += round_trip_time > SYNC_PERIOD
        offset = station.clock.now(now_ns)
        if offset is not None:
            self.command_time.add((executed_ns - sent.sent_ns) * 1e-9 - offset.value)

    # --- outputs ---------------------------------------------------------------------------------

    def samples(self) -> list[tuple[str, Sample]]:
        """Samples of the topics whose devices have all answered this SYNC, each once."""
        stamp_ns = self._stamp_ns
        if stamp_ns is None or not self._has_new_answers:
            return []
        self._has_new_answers = False
        ready = [
            topic
            for topic, devices in PUBLISHED.items()
            if topic not in self._published
            and all(self.stations[device.name].complete for device in devices)
        ]
        if not ready:
            return []
        self._published.update(ready)
        for name in self.channels:
            station = self.stations[name]
            if station.complete and station.sampled_ns is not None:
                self._sample_times.setdefault(stamp_ns, {})[name] = station.sampled_ns
        while len(self._sample_times) > _KEPT_CYCLES:
            self._sample_times.popitem(last=False)
        values = {
            name: station.values for name, station in self.stations.items() if station.complete
        }
        return [(topic, sample_of(topic, stamp_ns, values)) for topic in ready]

    def take_transitions(self) -> tuple[EventReport, ...]:
        """Transitions since the last call."""
        taken = tuple(self._transitions)
        self._transitions.clear()
        return taken

    def missing_devices(self, now_ns: int) -> tuple[str, ...]:
        """Devices that do not answer, and drives whose state is unknown."""
        return tuple(
            name
            for name, station in self.stations.items()
            if not station.is_alive(now_ns)
            or (station.device.is_drive and self.channels[name].state == UNKNOWN)
        )

    def has_other_bridge(self, now_ns: int) -> bool:
        """Whether another bridge was received within the heartbeat timeout."""
        other_ns = self._other_bridge_ns
        return other_ns is not None and now_ns - other_ns < HEARTBEAT_TIMEOUT * 1e9

    def _add_event(self, name: BridgeEvent, device: str, text: str, **values: object) -> None:
        self._transitions.append(EventReport(name, text, {"device": device, **values}))
