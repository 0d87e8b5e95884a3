"""The emulated machine: five devices on one end of the link, connected to a simulated plant.

The owner steps it: `receive` processes frames, `tick` advances the plant by one tick with the
drives' setpoints. Each device has its own channel to the bus; channels and devices can be impaired.
Motors, brake, friction and sensor errors are those of the plant's own drives; this module adds
devices, counts, rates and rules of the link.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any

import can

from msg_schemas.cdr import check
from msg_schemas.events import EmulatorEvent, EventReport, PlantEvent
from msg_schemas.parameters import ParameterError
from msg_schemas.refusal import Refusal
from msg_schemas.samples import JointSample, Sample
from rover_hil.bridge.wiring import COMMANDED, PUBLISHED, command_of, values_of
from rover_hil.canopen.devices import DEVICES, DRIVES, JUMP, WHEEL, WINCH, error_text
from rover_hil.canopen.impairment import Impairment
from rover_hil.canopen.link import SYNC_ID, Link
from rover_hil.canopen.objects import Device
from rover_hil.emulator.channel import DeviceChannel
from rover_hil.emulator.cia402 import DriveState
from rover_hil.emulator.device import EmulatedDevice
from rover_hil.emulator.drive import Demand, EmulatedDrive, Setpoint, StopReaction
from rover_hil.emulator.impairment_schedule import ImpairmentSchedule
from rover_sim import Simulation, SpatialScenario


def emulated_devices(real: Collection[str]) -> tuple[Device, ...]:
    """The devices to emulate beside the real ones.

    Raises:
        ParameterError: there is no device of that name.
    """
    names = [device.name for device in DEVICES]
    for name in real:
        if name not in names:
            raise ParameterError(f"{name!r} is no device: should be one of {', '.join(names)}")
    return tuple(device for device in DEVICES if device.name not in real)


class EmulatedMachine:
    """The devices and the plant behind them.

    Args:
        link: the devices' end; its owner passes the frames to `receive`.
        simulation: of a plant with a rover and a winch.
        clock: steady time [ns], clock of the mother machine's devices.
        rover_clock: clock of the rover's devices [ns].
        command_delay: from the execution of a command set to its effect [s].
        real: names of devices that are real and not emulated.

    Attributes:
        on_sync: called when a SYNC has arrived, before the devices receive it.
        sync_count: number of received SYNCs.
        lock: held while frames or devices are processed.

    Raises:
        ValueError: the plant has no rover or no winch, or there is no device of that name.
    """

    def __init__(
        self,
        link: Link,
        simulation: Simulation[Any],
        clock: Callable[[], int],
        rover_clock: Callable[[], int],
        command_delay: float = 0.0,
        real: Collection[str] = (),
    ) -> None:
        emulated = emulated_devices(real)
        missing = [topic for topic in PUBLISHED if topic not in simulation.interface.topics]
        scenario = simulation.plant.scenario
        fixed = simulation.interface.equipment.fixed_length is not None
        if missing or fixed or not isinstance(scenario, SpatialScenario) or scenario.rover is None:
            raise ValueError(
                f"the scenario {scenario.name} lacks {', '.join(missing) or 'a winch'}: should be "
                "a spatial one with rover and winch"
            )
        self.simulation = simulation
        wheel = scenario.rover.wheel_drive
        self._wheel_torque = wheel.motor.torque_constant * wheel.gear_ratio  # per current [N m/A]
        self.lock = threading.RLock()
        self.on_sync: Callable[[], None] = lambda: None
        self._delay_ns = round(command_delay * 1e9)
        self._transitions: list[EventReport] = []
        self._demands: dict[str, deque[tuple[int, Demand]]] = {
            device.name: deque([(0, StopReaction.OFF)]) for device in DRIVES
        }
        self._applied: dict[str, Demand] = {device.name: StopReaction.OFF for device in DRIVES}
        self._reported_states: dict[str, DriveState] = {}

        def clock_of(device: Device) -> Callable[[], int]:
            return rover_clock if device.is_on_rover else clock

        def plant_ns() -> int:
            return simulation.stamp_ns

        # They receive in this order: the winch first, because its loop is the fastest.
        self.channels = {
            device.name: DeviceChannel(device, link.send, clock)
            for device in sorted(emulated, key=lambda device: device is not WINCH)
        }
        stop = simulation.interface.equipment.quick_stop
        decelerations = {JUMP.name: stop.nut, WHEEL.name: stop.wheels, WINCH.name: stop.winch}
        self.drives = {
            device.name: EmulatedDrive(
                device,
                self.channels[device.name],
                clock_of(device),
                plant_ns,
                decelerations[device.name],
            )
            for device in emulated
            if device.is_drive
        }
        others = {
            device.name: EmulatedDevice(device, self.channels[device.name], clock_of(device))
            for device in emulated
            if not device.is_drive
        }
        self.devices: Mapping[str, EmulatedDevice] = {**self.drives, **others}
        self._schedule = ImpairmentSchedule(self.channels, self.devices)
        self._clock = clock
        self.sync_count = 0

    def power_on(self) -> None:
        """Switch all devices on: in the first tick, which provides their measurements."""
        self.tick()

    def tick(self) -> Any:
        """Advance the plant by one tick; returns it."""
        with self.lock:
            self._schedule.step(self.simulation.stamp_ns)
            for name, drive in self.drives.items():
                self._drive(name, drive)
        tick = self.simulation.tick()
        samples: dict[str, Sample] = dict(self.simulation.interface.samples(PUBLISHED))
        values = values_of(samples)
        # No topic of the contract carries it.
        values[WHEEL.name]["torque"] = self._wheel_torque * values[WHEEL.name]["current"]
        with self.lock:
            latch_released = any(
                report.name is PlantEvent.LATCH_RELEASED for report in tick.event_reports
            )
            if latch_released and JUMP.name in self.drives:
                self.drives[JUMP.name].complete()
            for name, device in self.devices.items():
                device.set_measurements(values[name])
                device.step()
            self._publish_states()
        self.release_due_frames()
        return tick

    def receive(
        self,
        frames: Iterable[can.Message],
        frame_age_ns: Callable[[can.Message], int] = lambda _: 0,
    ) -> None:
        """Process frames from the bus.

        Args:
            frames: in their order.
            frame_age_ns: time since the arrival of each [ns].
        """
        with self.lock:
            for frame in frames:
                frame_age = frame_age_ns(frame)
                if frame.arbitration_id == SYNC_ID:
                    self.sync_count += 1
                    self.on_sync()
                data = bytes(frame.data)
                for channel in self.channels.values():
                    channel.receive(frame.arbitration_id, data, frame_age)

    def release_due_frames(self) -> None:
        """Deliver delayed frames of impaired channels that are due."""
        with self.lock:
            for channel in self.channels.values():
                channel.step()

    def time_to_next_frame(self) -> float:
        """Time until a delayed frame is due [s]; inf: none is delayed."""
        with self.lock:
            due = [
                channel.due_ns for channel in self.channels.values() if channel.due_ns is not None
            ]
        return max(min(due) - self._clock(), 0) * 1e-9 if due else math.inf

    def impair(self, requested: Sequence[Impairment]) -> None:
        """Replace the impairments; see `ImpairmentSchedule.set`."""
        with self.lock:
            self._schedule.set(requested, self.simulation.stamp_ns)

    def restart(self) -> None:
        """Restart the devices after a reset of the plant."""
        with self.lock:
            # Their due times are of the clock before the reset.
            for channel in self.channels.values():
                channel.clear()
            self._schedule.restart(self.simulation.stamp_ns)
            # Before the tick, so that it does not execute setpoints from before the reset.
            for device in self.devices.values():
                if device.is_on:
                    device.power_on()
        for demands in self._demands.values():
            demands.clear()
            demands.append((self.simulation.stamp_ns, StopReaction.OFF))
        self.tick()

    def take_transitions(self) -> tuple[EventReport, ...]:
        """Transitions since the last call."""
        with self.lock:
            taken = (*self._schedule.take_transitions(), *self._transitions)
            self._transitions.clear()
        return taken

    def take_kills(self) -> tuple[str, ...]:
        """Process kills requested since the last call."""
        with self.lock:
            return self._schedule.take_kills()

    def _drive(self, name: str, drive: EmulatedDrive) -> None:
        """Apply the device's demand to the plant's drive, with the command delay."""
        now_ns, demands = self.simulation.stamp_ns, self._demands[name]
        demands.append((now_ns, drive.demand))
        while len(demands) > 1 and demands[1][0] <= now_ns - self._delay_ns:
            demands.popleft()
        demand = demands[0][1]
        topic = next(t for t, device in COMMANDED.items() if device is drive.device)
        command = command_of(drive.device, demand.values) if isinstance(demand, Setpoint) else None
        if isinstance(demand, Setpoint) and command is not None:
            sample = JointSample(demand.received_ns, command[1])
            try:
                check(command[0], sample)
                self.simulation.accept_command(command[0], sample)
            except Refusal as refusal:
                drive.reject()
                event = EventReport(EmulatorEvent.SETPOINT_REFUSED, str(refusal), {"device": name})
                self._transitions.append(event)
        elif demand is not self._applied[name]:
            if demand is StopReaction.OFF:
                self.simulation.switch_off(topic)
            else:
                self.simulation.quick_stop(topic)
        self._applied[name] = demand
        drive.has_stopped = demand is drive.demand and not self.simulation.is_stopping(topic)

    def _publish_states(self) -> None:
        for name, drive in self.drives.items():
            state = drive.automaton.state
            if state is self._reported_states.get(name):
                continue
            self._reported_states[name] = state
            code = drive.automaton.error_code
            reason = f"{state.value.lower()}" + (f", error {error_text(code)}" if code else "")
            event = EmulatorEvent.DRIVE_FAULT if code else EmulatorEvent.DRIVE_STATE
            self._transitions.append(
                EventReport(event, reason, {"device": name, "state": state, "error_code": code})
            )
