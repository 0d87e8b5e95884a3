"""The bridge between contract and link, stepped by its owner: no ROS, no waiting, no clock.

Commands of the contract come in by `take`, frames by `heard`; every cycle begins with SYNC and
`begin_cycle`, after which `supervise` does what is due. What has happened is asked for: samples,
transitions, figures. Nothing moves before `arm`, nor after a drive was lost, has failed or has
begun anew, until it is armed again. A drive whose controller falls silent is switched off, its
brake closed, and goes on with the next command.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable

from msg_schemas import topics
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample, Level, Sample
from msg_schemas.transition import Transition
from rover_hil.devices import (
    DEVICES,
    DRIVES,
    HEARTBEAT_LIMIT,
    REFUSED,
    SYNC_PERIOD,
    UNHEARD_LIMIT,
)
from rover_hil.drive_channel import FAULT, UNKNOWN, DriveChannel, state_of
from rover_hil.link import unpack
from rover_hil.objects import Device, Pdo
from rover_hil.station import Station
from rover_hil.statistics import Window
from rover_hil.wiring import COMMANDED, TOLD, asks_for_rest, sample_of, setpoint_of

_REMEMBERED = 400  # cycles
_OPERATIONAL = 5


class Bridge:
    """All of the bridge that needs no ROS.

    Args:
        send: puts a frame on the link.
        start: has a device go operational (NMT).

    Attributes:
        stations: what is known of each device, by its name.
        channels: each drive's commands, by its name.
        round_trip: from the sampling of a state to the execution, by the drive, of a command that
            bears the state's stamp [s].
        command_time: from a command's arrival here to its execution, by estimated clocks [s].
        answer_time: from SYNC to the last device's answer [s].
        cycles: begun since the start.
        late: cycles that were due and began more than half a period late, or not at all.
        incomplete: cycles that a device did not answer fully.
        overdue: round trips longer than a period.
    """

    def __init__(self, send: Callable[[int, bytes], None], start: Callable[[Device], None]) -> None:
        self.stations = {device.name: Station(device) for device in DEVICES}
        self.channels = {device.name: DriveChannel(device, send) for device in DRIVES}
        self.round_trip, self.command_time, self.answer_time = Window(), Window(), Window()
        self.cycles = self.late = self.incomplete = self.overdue = 0
        self._start = start
        self._pdos: dict[int, tuple[Station, Pdo]] = {
            pdo.can_id(station.device.node_id): (station, pdo)
            for station in self.stations.values()
            for pdo in station.device.tells
        }
        self._stamp_ns: int | None = None
        self._cycle_ns: int | None = None
        self._counter = 0
        self._news = False  # a device has answered fully since the last look
        self._told: set[str] = set()
        # Stamps of told states, with the sample times of the drives by their own clocks.
        self._states: OrderedDict[int, dict[str, int]] = OrderedDict()
        self._transitions: list[Transition] = []

    # --- what is heard ---------------------------------------------------------------------------

    @property
    def can_ids(self) -> tuple[int, ...]:
        """Identifiers of the frames that `heard` takes."""
        return tuple(self._pdos)

    def heard(self, can_id: int, data: bytes, now_ns: int) -> None:
        """Take a TPDO; one that is none, or of another cycle, is counted and thrown away."""
        station, pdo = self._pdos[can_id]
        counts = unpack(pdo, data)
        if counts is None or self._cycle_ns is None:
            station.strange += 1
            return
        if not station.take(pdo, counts, self._counter, self._cycle_ns, now_ns):
            return
        if not station.complete:
            return
        self._news = True
        if station.device.is_drive:
            self._follow(self.channels[station.device.name], station, now_ns)
        if all(each.complete for each in self.stations.values()):
            self.answer_time.add((now_ns - self._cycle_ns) * 1e-9)

    def heartbeat(self, device: Device, state: int, now_ns: int) -> None:
        """Take a heartbeat; state 0 is a boot-up: the device begins anew."""
        station = self.stations[device.name]
        if state == 0:
            if station.heard_ns is not None:
                self._tell(f"{device.name}_restarted", "the device has begun anew", Level.WARN)
            station.restarted()
            if device.is_drive:
                self._disarm(device.name, "the device has begun anew")
                self.channels[device.name].restarted()
        station.nmt_state = state
        # A device that is operational is heard by its answers: one without them is of no use.
        if state != _OPERATIONAL:
            station.hear(now_ns)
            self._start(device)

    def emergency(self, device: Device, code: int) -> None:
        """Take an emergency message."""
        if code == 0:
            self._tell(f"{device.name}_fault_reset", "the device says that its fault is gone")
        elif code == REFUSED:
            self._tell(
                f"{device.name}_refuses", "the drive cannot do what it was told, and lets go",
                Level.WARN,
            )  # fmt: skip
        else:
            self._tell(
                f"{device.name}_emergency", f"error {code:04X}h", Level.ERROR, error_code=code
            )
            if device.is_drive:
                self._disarm(device.name, f"the drive tells error {code:04X}h")

    def take(self, topic: str, sample: JointSample, now_ns: int) -> None:
        """Take a command of the contract, and send it.

        Raises:
            Refusal: its drive is not armed, silent or in fault, or cannot be told so.
        """
        device = COMMANDED[topic]
        channel, station = self.channels[device.name], self.stations[device.name]
        setpoint = setpoint_of(topic, sample)
        if not channel.armed:
            if asks_for_rest(topic, setpoint):
                return
            raise Refusal(
                topic,
                RefusalCode.NOT_ARMED,
                f"the {device.name} drive is not armed, {topics.DRIVES_ARM} arms it",
            )
        if station.sampled_ns is None or not station.was_heard_within(UNHEARD_LIMIT, now_ns):
            raise Refusal(
                topic, RefusalCode.NOT_ACTIVE, f"the {device.name} drive is not heard on the link"
            )
        channel.command(topic, setpoint, now_ns)
        channel.send(station.sampled_ns, now_ns, sample.stamp_ns)

    # --- what is done ----------------------------------------------------------------------------

    def begin_cycle(self, counter: int, stamp_ns: int | None, now_ns: int) -> None:
        """A SYNC goes out.

        Args:
            counter: that it carries.
            stamp_ns: of the samples that it brings; None: they are not told.
            now_ns: bridge's clock.
        """
        if self._cycle_ns is not None:
            self.cycles += 1
            periods = (now_ns - self._cycle_ns) * 1e-9 / SYNC_PERIOD
            self.late += max(0, math.floor(periods - 0.5))
            # What never was there, or is known to be lost, is not missed again in each cycle.
            lost = [station.end_cycle(now_ns) for station in self.stations.values()]
            self.incomplete += any(lost)
        self._counter, self._stamp_ns, self._cycle_ns = counter, stamp_ns, now_ns
        self._told.clear()

    def supervise(self, now_ns: int) -> None:
        """Watch over devices and commands, and send what is due."""
        for station in self.stations.values():
            if station.was_heard and not station.is_heard(now_ns):
                station.was_heard = False
                name = station.device.name
                self._tell(
                    f"{name}_silent",
                    f"nothing heard of the device for {HEARTBEAT_LIMIT:g} s",
                    Level.ERROR,
                )
                if station.device.is_drive:
                    self._disarm(name, "it is silent")
        for name, channel in self.channels.items():
            station = self.stations[name]
            age = channel.ceased(station.values.get("velocity", 0.0), now_ns)
            if age is not None:
                self._tell(
                    f"{name}_commands_ceased",
                    f"no command for {age:.3g} s: the drive is switched off",
                    Level.WARN,
                    timeout=age,
                )
            sampled_ns = station.sampled_ns
            if channel.setpoint is not None and not station.was_heard_within(UNHEARD_LIMIT, now_ns):
                self._tell(
                    f"{name}_unheard",
                    f"nothing heard of the drive for {UNHEARD_LIMIT:g} s: it is switched off",
                    Level.WARN,
                )
                channel.setpoint = None
                if sampled_ns is not None:
                    channel.send(sampled_ns, now_ns)
            if sampled_ns is not None and station.is_heard(now_ns) and channel.is_due(now_ns):
                channel.send(sampled_ns, now_ns)

    def arm(self, now_ns: int) -> str:
        """Arm all drives; a fault whose cause is gone is reset; returns what was done.

        Raises:
            Refusal: a drive is not heard; none is armed then.
        """
        silent = [name for name in self.silent(now_ns) if name in self.channels]
        if silent:
            raise Refusal(
                topics.DRIVES_ARM,
                RefusalCode.NOT_ACTIVE,
                f"not heard on the link: {', '.join(silent)}",
            )
        for name in self.channels:
            found = self.stations[name].mismatch
            if found != "":
                why = "was not asked yet what it is" if found is None else found
                raise Refusal(topics.DRIVES_ARM, RefusalCode.NOT_SUPPORTED, f"{name}: {why}")
        for channel in self.channels.values():
            channel.armed = True
            channel.resets = channel.state == FAULT
        self._tell("drives_armed", "all drives may move on command")
        return "armed"

    def disarm(self, reason: str, now_ns: int) -> str:
        """Switch all drives off, motors to zero and brake closed; returns what was done."""
        for name, channel in self.channels.items():
            self._disarm(name, reason)
            station = self.stations[name]
            if station.sampled_ns is not None:
                channel.send(station.sampled_ns, now_ns)
        return "disarmed"

    def checked(self, device: Device, mismatch: str) -> None:
        """A device was asked what it is.

        Args:
            device: which one.
            mismatch: what it is otherwise than its dictionary says; empty: nothing.
        """
        self.stations[device.name].mismatch = mismatch
        if mismatch:
            self._tell(f"{device.name}_is_another", mismatch, Level.ERROR)
        else:
            self._tell(f"{device.name}_checked", "the device is what its dictionary says")

    def _disarm(self, name: str, reason: str) -> None:
        channel = self.channels[name]
        if channel.armed:
            self._tell(f"{name}_disarmed", reason, Level.WARN)
        channel.disarm()

    def _follow(self, channel: DriveChannel, station: Station, now_ns: int) -> None:
        """Take what a drive's complete answer says of it."""
        before, counts = channel.state, station.counts
        channel.state = state_of(counts["statusword"])
        if channel.state == FAULT != before and channel.armed:
            self._disarm(channel.device.name, "the drive is in fault")
        sent = channel.executed(counts["executed"])
        if sent is None or not sent.command_ns or station.sampled_ns is None:
            return
        executed_ns = station.sampled_ns - counts["since"] * 10_000
        sampled_ns = self._states.get(sent.command_ns, {}).get(channel.device.name)
        if sampled_ns is not None:
            taken = (executed_ns - sampled_ns) * 1e-9
            self.round_trip.add(taken)
            self.overdue += taken > SYNC_PERIOD
        offset = station.clock.now(now_ns)
        if offset is not None:
            self.command_time.add((executed_ns - sent.taken_ns) * 1e-9 - offset.value)

    # --- what is told ----------------------------------------------------------------------------

    def samples(self) -> list[tuple[str, Sample]]:
        """Topics whose devices have all answered this cycle's SYNC, each once."""
        stamp_ns = self._stamp_ns
        if stamp_ns is None or not self._news:
            return []
        self._news = False
        ready = [
            topic
            for topic, devices in TOLD.items()
            if topic not in self._told
            and all(self.stations[device.name].complete for device in devices)
        ]
        if not ready:
            return []
        self._told.update(ready)
        for name in self.channels:
            station = self.stations[name]
            if station.complete and station.sampled_ns is not None:
                self._states.setdefault(stamp_ns, {})[name] = station.sampled_ns
        while len(self._states) > _REMEMBERED:
            self._states.popitem(last=False)
        values = {
            name: station.values for name, station in self.stations.items() if station.complete
        }
        return [(topic, sample_of(topic, stamp_ns, values)) for topic in ready]

    def take_transitions(self) -> tuple[Transition, ...]:
        """What has changed since the last call."""
        taken = tuple(self._transitions)
        self._transitions.clear()
        return taken

    def silent(self, now_ns: int) -> tuple[str, ...]:
        """Devices that are not heard, or drives that have not told their state yet."""
        return tuple(
            name
            for name, station in self.stations.items()
            if not station.is_heard(now_ns)
            or (station.device.is_drive and self.channels[name].state == UNKNOWN)
        )

    def _tell(self, name: str, reason: str, level: Level = Level.OK, **values: object) -> None:
        self._transitions.append(Transition(name, reason, level, values))
