"""The emulated machine: five devices on one end of the link, played against a simulation.

All of it is stepped: `hear` takes the frames that come, `tick` lets the plant go on by one tick
under what the drives were told. Each device has a line of its own to the bus, which may be
impaired, as the device may. The plant's own drives are those of a direct run, so that torque-speed
curves, brake, friction and the sensors' errors are the same; here come the link, its counts, its
rates and its rules.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any

import can

from msg_schemas.parameters import ParameterError
from msg_schemas.refusal import Refusal
from msg_schemas.samples import JointSample, Level, Sample
from msg_schemas.transition import Transition
from rover_hil.devices import DEVICES, DRIVES, JUMP, WHEEL, WINCH
from rover_hil.emulator.cia402 import DriveState
from rover_hil.emulator.device import EmulatedDevice
from rover_hil.emulator.drive import EmulatedDrive, Setpoint
from rover_hil.emulator.impairer import Impairer
from rover_hil.emulator.line import Line
from rover_hil.impairment import Impairment
from rover_hil.link import SYNC_ID, Link
from rover_hil.objects import Device
from rover_hil.wiring import COMMANDED, TOLD, command_of, values_of
from rover_sim import Simulation, SpatialScenario

_LATCH_RELEASED = "latch_released"


def played_beside(real: Collection[str]) -> tuple[Device, ...]:
    """The devices that are left to be played beside those that are there.

    Raises:
        ParameterError: there is no device of a name.
    """
    names = [device.name for device in DEVICES]
    for name in real:
        if name not in names:
            raise ParameterError(f"{name!r} is no device: should be of {', '.join(names)}")
    return tuple(device for device in DEVICES if device.name not in real)


class EmulatedMachine:
    """The devices and the plant behind them.

    Args:
        link: the devices' end; whoever owns it receives from it, and hands on by `hear`.
        simulation: of a plant with a rover and a winch.
        clock: steady time [ns], by which mother's devices go.
        rover_clock: the rover's.
        command_delay: from a set's execution to its effect [s].
        real: names of devices that are on the link themselves, and are not played.

    Attributes:
        on_sync: called when a SYNC has come by the bus, before the devices hear it.
        synchronised: how many SYNCs have come.
        lock: held while frames are handed on; a tick takes it where devices are touched.

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
        played = played_beside(real)
        missing = [topic for topic in TOLD if topic not in simulation.interface.topics]
        scenario = simulation.plant.scenario
        held = simulation.interface.equipment.fixed_length is not None
        if missing or held or not isinstance(scenario, SpatialScenario) or scenario.rover is None:
            raise ValueError(
                f"the scenario {scenario.name} lacks what the devices tell "
                f"({', '.join(missing) or 'a winch'}): should be a spatial one with rover and winch"
            )
        self.simulation = simulation
        wheel = scenario.rover.wheel_drive
        self._wheel_torque = wheel.motor.torque_constant * wheel.gear_ratio  # per current [N m/A]
        self.lock = threading.RLock()
        self.on_sync: Callable[[], None] = lambda: None
        self._delay_ns = round(command_delay * 1e9)
        self._transitions: list[Transition] = []
        self._past: dict[str, deque[tuple[int, Setpoint | None]]] = {
            device.name: deque([(0, None)]) for device in DRIVES
        }
        self._let_go: dict[str, bool] = {device.name: True for device in DRIVES}
        self._told: dict[str, DriveState] = {}

        def clock_of(device: Device) -> Callable[[], int]:
            return rover_clock if device.is_on_rover else clock

        def plant_ns() -> int:
            return simulation.stamp_ns

        # They hear in this order: the winch first, whose loop is the tightest.
        self.lines = {
            device.name: Line(device, link.send, clock)
            for device in sorted(played, key=lambda device: device is not WINCH)
        }
        self.drives = {
            device.name: EmulatedDrive(device, self.lines[device.name], clock_of(device), plant_ns)
            for device in played
            if device.is_drive
        }
        others = {
            device.name: EmulatedDevice(device, self.lines[device.name], clock_of(device))
            for device in played
            if not device.is_drive
        }
        self.devices: Mapping[str, EmulatedDevice] = {**self.drives, **others}
        self._impairer = Impairer(self.lines, self.devices)
        self._clock = clock
        self.synchronised = 0

    def power_on(self) -> None:
        """Switch all devices on: they do so in the first tick, which gives them what to measure."""
        self.tick()

    def tick(self) -> Any:
        """Let the plant go on by one tick; returns it."""
        with self.lock:
            self._impairer.step(self.simulation.stamp_ns)
            for name, drive in self.drives.items():
                self._drive(name, drive)
        tick = self.simulation.tick()
        samples: dict[str, Sample] = dict(self.simulation.interface.samples(TOLD))
        values = values_of(samples)
        # The contract has no topic for it.
        values[WHEEL.name]["torque"] = self._wheel_torque * values[WHEEL.name]["current"]
        with self.lock:
            tripped = any(happening.name == _LATCH_RELEASED for happening in tick.event_reports)
            if tripped and JUMP.name in self.drives:
                self.drives[JUMP.name].finish()
            for name, device in self.devices.items():
                device.show(values[name])
                device.step()
            self._publish_states()
        self.let_go_frames()
        return tick

    def hear(
        self,
        frames: Iterable[can.Message],
        waited_ns: Callable[[can.Message], int] = lambda _: 0,
    ) -> None:
        """Take frames that have come by the bus.

        Args:
            frames: in their order.
            waited_ns: how long ago each has come [ns].
        """
        with self.lock:
            for frame in frames:
                waited = waited_ns(frame)
                if frame.arbitration_id == SYNC_ID:
                    self.synchronised += 1
                    self.on_sync()
                data = bytes(frame.data)
                for line in self.lines.values():
                    line.hear(frame.arbitration_id, data, waited)

    def let_go_frames(self) -> None:
        """Hand on what impaired lines have held back, and is due."""
        with self.lock:
            for line in self.lines.values():
                line.step()

    def wait(self) -> float:
        """How long it is until a line has something to hand on [s]; inf: nothing is held back."""
        with self.lock:
            due = [line.due_ns for line in self.lines.values() if line.due_ns is not None]
        return max(min(due) - self._clock(), 0) * 1e-9 if due else math.inf

    def impair(self, wanted: Sequence[Impairment]) -> None:
        """Have these impairments and no others; see `Impairer.want`."""
        with self.lock:
            self._impairer.want(wanted, self.simulation.stamp_ns)

    @property
    def impairments(self) -> tuple[Impairment, ...]:
        """Those that are at work."""
        return self._impairer.at_work

    def restart(self) -> None:
        """The plant was put back to its start: the devices are switched on anew."""
        with self.lock:
            self._impairer.restart(self.simulation.stamp_ns)
        for past in self._past.values():
            past.clear()
            past.append((self.simulation.stamp_ns, None))
        self.tick()
        with self.lock:
            for device in self.devices.values():
                if device.is_on:
                    device.power_on()

    def take_transitions(self) -> tuple[Transition, ...]:
        """What has changed since the last call."""
        with self.lock:
            taken = (*self._impairer.take_transitions(), *self._transitions)
            self._transitions.clear()
        return taken

    def take_kills(self) -> tuple[str, ...]:
        """Kinds of processes that impairments kill, since the last call."""
        with self.lock:
            return self._impairer.take_kills()

    def _drive(self, name: str, drive: EmulatedDrive) -> None:
        """Have the plant's drive do what the device was told so long ago as its delay is."""
        now_ns, past = self.simulation.stamp_ns, self._past[name]
        past.append((now_ns, drive.setpoint))
        while len(past) > 1 and past[1][0] <= now_ns - self._delay_ns:
            past.popleft()
        setpoint = past[0][1]
        command = None if setpoint is None else command_of(drive.device, setpoint.values)
        if setpoint is None or command is None:
            if not self._let_go[name]:
                topic = next(t for t, device in COMMANDED.items() if device is drive.device)
                self.simulation.stop_drive(topic)
                self._let_go[name] = True
            return
        topic, joints = command
        try:
            self.simulation.accept_command(topic, JointSample(setpoint.taken_ns, joints))
            self._let_go[name] = False
        except Refusal as refusal:
            drive.refuse()
            self._transitions.append(Transition(f"{name}_drive_refuses", str(refusal), Level.WARN))

    def _publish_states(self) -> None:
        for name, drive in self.drives.items():
            state = drive.automaton.state
            if state is self._told.get(name):
                continue
            self._told[name] = state
            code = drive.automaton.error_code
            reason = f"{state.value.lower()}" + (f", error {code:04X}h" if code else "")
            level = Level.ERROR if code else Level.OK
            self._transitions.append(
                Transition(f"{name}_drive", reason, level, {"error_code": code})
            )
