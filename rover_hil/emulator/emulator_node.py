"""The ``drive_emulator`` executable: emulated drives, IMU and load cell with a simulated plant."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

import can

from msg_schemas import qos, topics
from msg_schemas.events import EmulatorEvent, EventReport, SimulationEvent
from msg_schemas.parameters import ParameterError, parameter
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import Level, Status, StatusSample, TextSample
from rover_hil.bridge.clock_offset import LARGEST_DRIFT
from rover_hil.bridge.sync_source import ANSWER_LIMIT, cycle_over
from rover_hil.bridge.wiring import PUBLISHED
from rover_hil.canopen.devices import LOCKSTEP_ID, SYNC_PERIOD, SYNC_RATE
from rover_hil.canopen.impairment import read_impairments
from rover_hil.canopen.link import SYNC_ID, Link, frame_age_ns, sync_counter
from rover_hil.canopen.transport import open_bus
from rover_hil.emulator.emulated_machine import EmulatedMachine, emulated_devices
from rover_hil.emulator.process_kill import kill_process
from rover_hil.emulator.tick_scheduler import TickScheduler
from rover_runtime.component import ExitCode
from rover_runtime.ros.node import RosComponent
from rover_runtime.ros.process import run
from rover_sim import (
    StatePublisher,
    Tick,
    TruthRates,
    build_simulation,
    load_overridden,
    run_statistics,
    start_of,
)

# Interval of thread switches [s]: short, so that frames are answered at once.
SWITCH_INTERVAL = 0.0005
_POLL_PERIOD = 0.1  # of the link [s]
_RESET_TIMEOUT = 5.0  # [s]
_STATUS_PERIOD = 0.1  # [s]
BRIDGE_NAME = "hil_bridge"
BRIDGE_MARKS = (BRIDGE_NAME, "rover_hil.bridge.bridge_node")
"""Texts in the command line of a bridge's process, however it was started."""


@dataclass(frozen=True)
class EmulatorParameters:
    """Scenario, link, and impairments."""

    link: str = parameter(
        "udp_multicast:239.74.163.2",
        "-",
        "transport and channel: udp_multicast:GROUP[:PORT], serial:PORT[:BAUD], socketcan:NAME",
        read_only=True,
    )
    scenario: str = parameter(
        "free_hang",
        "-",
        "name of a spatial scenario of the package, or path of a .yaml file",
        read_only=True,
    )
    overrides: str = parameter(
        "", "-", "changes to the scenario as YAML or JSON, by dotted path", read_only=True
    )
    start_state: str = parameter(
        "",
        "-",
        "file of a saved state, in which the plant starts and to which it is reset; empty: the "
        "scenario's start",
        read_only=True,
    )
    seed: int = parameter(1, "-", "seed of the sensors' errors", 0, 2**31 - 1, read_only=True)
    real_devices: str = parameter(
        "",
        "-",
        "names of real devices on the link, which are not emulated, separated by commas",
        read_only=True,
    )
    command_delay: float = parameter(
        0.0, "s", "from a command's execution by a drive to its effect", 0.0, 0.5, read_only=True
    )
    rover_clock_offset: float = parameter(
        0.0, "s", "clock of the rover's devices minus that of the mother machine's", -1e6, 1e6,
        read_only=True,
    )  # fmt: skip
    rover_clock_drift: float = parameter(
        0.0, "-", "relative rate error of the rover's clock", -LARGEST_DRIFT, LARGEST_DRIFT,
        read_only=True,
    )  # fmt: skip
    impairments: str = parameter(
        "",
        "-",
        "impairments as a list in YAML, as [{kind: loss, target: rover, magnitude: 0.3}], or the "
        "path of a .yaml file with one; an unchanged entry continues; empty: none",
    )

    def __post_init__(self) -> None:
        """Refuse unknown devices and impairments of real devices."""
        emulated_devices(self.real)
        for impairment in read_impairments(self.impairments):
            there = [each.name for each in impairment.devices if each.name in self.real]
            if there:
                raise ParameterError(
                    f"impairments: {impairment} targets {there[0]}, one of the real_devices: "
                    "should target emulated devices"
                )

    @property
    def real(self) -> tuple[str, ...]:
        """Names of the real devices."""
        names = (name.strip() for name in self.real_devices.split(","))
        return tuple(name for name in names if name)


class EmulatorNode(RosComponent):
    """Emulates the devices on the link; publishes clock and ground truth like sim_node."""

    NAME = "drive_emulator"
    PARAMETERS = (EmulatorParameters, TruthRates)

    _machine: EmulatedMachine | None = None
    _link: Link | None = None
    _scenario: Mapping[str, Any] | None = None

    # --- lifecycle -------------------------------------------------------------------------------

    def setup(self) -> None:
        """Load the scenario, compile and build the plant, open the link."""
        settings = self.parameters_of(EmulatorParameters)
        if settings.real and self.is_in_lockstep:
            raise ParameterError(
                f"real_devices = {settings.real_devices!r}: should be empty in lockstep, whose "
                "time does not wait for real devices"
            )
        scenario = load_overridden(settings.scenario, settings.overrides)
        rates = self.parameters_of(TruthRates)
        rates.check(SYNC_PERIOD)
        simulation = build_simulation(
            scenario, settings.seed, SYNC_PERIOD, self, settings.start_state
        )
        link = Link(open_bus(settings.link))
        try:
            machine = EmulatedMachine(
                link,
                simulation,
                self._mother_clock,
                self._rover_clock,
                settings.command_delay,
                settings.real,
            )
        except ValueError:
            link.close()
            raise
        self._link, self._machine, self._scenario = link, machine, scenario.to_mapping()
        self._scheduler = TickScheduler(SYNC_PERIOD)
        self._counter = 0  # of the last SYNC
        machine.on_sync = self._on_sync
        own = [name for name in simulation.interface.topics if name not in PUBLISHED]
        self._publisher = StatePublisher(self, simulation, rates.of_topics(own, SYNC_RATE))
        self._status_publisher = self.publisher(topics.SIM_STATUS)
        self._bridge_process: tuple[int, str] | None = None
        self.subscribe(topics.CONFIG, self._on_config, qos.LATCHED_NODES)
        self.serve(topics.SIM_RESET, lambda: (True, self._request_reset(clock=True)))
        self.serve(topics.SIM_RESET_PLANT, lambda: (True, self._request_reset(clock=False)))

    def start(self) -> None:
        """Switch the devices on and start the plant."""
        machine = self._emulated
        self._publisher.publish_static()
        self._stopping = threading.Event()
        self._received_at: float | None = None  # wall time of the bridge's last frame, in lockstep
        self._published = threading.Event()  # the last tick, in lockstep
        self._published.set()
        self._is_joined = True  # ticks of the lockstep publish; time stands until they do
        self._reset: tuple[bool, Future[str]] | None = None
        machine.power_on()
        self._impair()
        self._thread = threading.Thread(target=self._run_thread, name="machine")
        self._thread.start()
        self.every(_STATUS_PERIOD, self._publish_status, by_wall_clock=True)
        if self.is_in_lockstep:
            self.every(SYNC_PERIOD, self._publish_in_lockstep)

    def stop(self) -> None:
        """Stop the plant."""
        self._stopping.set()
        self._thread.join()

    def release(self) -> None:
        """Release plant and link."""
        if self._link is not None:
            self._link.close()
        self._link = self._machine = self._scenario = None

    def configuration(self) -> Mapping[str, Any]:
        """Scenario with all values, the seed, and the saved state of the start, if any."""
        seed = self.parameters_of(EmulatorParameters).seed
        content = {"scenario": self._scenario or {}, "seed": seed}
        return content if self._machine is None else content | start_of(self._machine.simulation)

    def now_ns(self) -> int:
        """Simulated time [ns]: this node is the clock."""
        return 0 if self._machine is None else self._machine.simulation.stamp_ns

    def knows_time(self) -> bool:
        """Always: this node is the clock."""
        return True

    def parameters_changed(self) -> None:
        """Apply changed impairments."""
        self._impair()

    def _impair(self) -> None:
        self._emulated.impair(read_impairments(self.parameters_of(EmulatorParameters).impairments))

    @property
    def _emulated(self) -> EmulatedMachine:
        if self._machine is None:
            raise AssertionError("not configured")
        return self._machine

    # --- clocks of the devices -------------------------------------------------------------------

    def _mother_clock(self) -> int:
        return self.now_ns() if self.is_in_lockstep else time.monotonic_ns()

    def _rover_clock(self) -> int:
        settings, mother = self.parameters_of(EmulatorParameters), self._mother_clock()
        drifted = round(mother * settings.rover_clock_drift)
        return mother + drifted + round(settings.rover_clock_offset * 1e9)

    # --- the machine's thread --------------------------------------------------------------------

    def _run_thread(self) -> None:
        try:
            self._run_machine()
        except Exception as error:  # noqa: BLE001 - a bug must reach the process, not end here
            self.ros.get_logger().fatal("".join(traceback.format_exception(error)))
            self.exit_code = ExitCode.CRASH

    def _run_machine(self) -> None:
        """Process frames and advance the plant, in one thread."""
        machine, link = self._emulated, self._link
        if link is None:
            raise AssertionError("no link")
        in_lockstep = self.is_in_lockstep
        self._unpublished: tuple[Tick[Any], int] | None = None
        while not self._stopping.is_set():
            wait = _POLL_PERIOD if self._follows_sync() else self._scheduler.wait(time.monotonic())
            frame = link.receive(min(wait, _POLL_PERIOD, machine.time_to_next_frame()))
            if frame is not None:
                frames = link.pending_frames(frame)
                if in_lockstep:
                    for each in frames:
                        self._answer(each)
                else:
                    machine.receive(frames, frame_age_ns)
                    if frame.arbitration_id == SYNC_ID:
                        self._publish_tick()
            machine.release_due_frames()
            self._serve_reset()
            if not self._follows_sync():
                for _ in range(self._scheduler.due(time.monotonic())):
                    self._publish_tick()
                    self._tick()
        self._publish_tick()

    def _answer(self, frame: can.Message) -> None:
        """Process a frame in lockstep, and report when all answers to a SYNC are sent."""
        machine, link = self._emulated, self._link
        assert link is not None
        self._received_at = time.monotonic()
        if frame.arbitration_id == SYNC_ID:
            self._counter = sync_counter(frame.data)
            if self._is_joined:
                self._is_joined = self._published.wait(0.5 * ANSWER_LIMIT)
        if frame.arbitration_id != LOCKSTEP_ID:
            machine.receive([frame])
        if frame.arbitration_id in (SYNC_ID, LOCKSTEP_ID):
            link.send(LOCKSTEP_ID, cycle_over(self._counter, machine.simulation.stamp_ns))

    def _follows_sync(self) -> bool:
        """Whether SYNC advances the time: in lockstep, unless the bridge is gone."""
        if not self.is_in_lockstep or self._received_at is None:
            return self.is_in_lockstep
        return time.monotonic() - self._received_at <= ANSWER_LIMIT

    def _on_sync(self) -> None:
        """Advance or synchronise the plant before the devices answer a SYNC."""
        if self.is_in_lockstep:
            self._scheduler = TickScheduler(SYNC_PERIOD)  # takes over if the bridge goes
            self._tick()
        else:
            self._scheduler.synchronise(time.monotonic())

    def _tick(self) -> None:
        before_ns = self._emulated.simulation.stamp_ns
        self._published.clear()
        self._unpublished = self._emulated.tick(), before_ns

    def _publish_in_lockstep(self) -> None:
        self._is_joined = True
        self._publish_tick()

    def _publish_tick(self) -> None:
        """Publish the last tick and what has happened in it.

        In real time after the next SYNC has been answered: answers are urgent, and publishing takes
        as long as a tick. In lockstep in the tick of this stamp, which the next SYNC waits for.
        """
        unpublished, self._unpublished = self._unpublished, None
        if unpublished is None:
            return
        self._publisher.on_tick(*unpublished)
        for change in self._emulated.take_transitions():
            self.event(change)
        for subject in self._emulated.take_kills():
            if subject == "emulator_kill":
                self.ros.wait_for_delivery()
                os.kill(os.getpid(), signal.SIGKILL)
            self._kill_bridge()
        self._published.set()

    def _kill_bridge(self) -> None:
        """Kill the bridge, whose process is in its configuration, if it runs on this computer."""
        reported = self._bridge_process
        try:
            if reported is None:
                raise ProcessLookupError("no bridge has published its process")
            kill_process(*reported, BRIDGE_MARKS)
        except OSError as error:
            text = f"the bridge cannot be killed: {error}"
            self.event(EventReport(EmulatorEvent.KILL_FAILED, text))

    def _on_config(self, sample: TextSample) -> None:
        reported = json.loads(sample.text)
        bridge = f"{self.ros.get_namespace().rstrip('/')}/{BRIDGE_NAME}"
        if reported.get("node") == bridge and {"process", "host"} <= reported.keys():
            self._bridge_process = (int(reported["process"]), str(reported["host"]))

    # --- requests --------------------------------------------------------------------------------

    def _request_reset(self, *, clock: bool) -> str:
        answer: Future[str] = Future()
        self._reset = (clock, answer)
        try:
            return answer.result(_RESET_TIMEOUT)
        except TimeoutError:
            raise Refusal(
                topics.SIM_RESET, RefusalCode.NOT_ACTIVE, "the plant does not respond"
            ) from None

    def _serve_reset(self) -> None:
        request, self._reset = self._reset, None
        if request is None:
            return
        clock, answer = request
        machine, simulation = self._emulated, self._emulated.simulation
        before = simulation.stamp_ns * 1e-9
        self._publish_tick()
        with machine.lock:
            if clock:
                simulation.reset()
                self.reception.forget_stamps()
            else:
                simulation.reset_plant()
            machine.restart()
        self._publisher.on_restart()
        subject = "plant and clock" if clock else "plant"
        message = f"{subject} reset at {before:g} s, devices restarted"
        name = SimulationEvent.RESET if clock else SimulationEvent.PLANT_RESET
        self.event(EventReport(name, message))
        answer.set_result(message)

    # --- status ----------------------------------------------------------------------------------

    def _publish_status(self) -> None:
        self._status_publisher.send(StatusSample(self.now_ns(), (self._status(),)))

    def health(self) -> tuple[Status, ...]:
        """State of the plant and its real-time factor."""
        return (self._status(),) if self.active else ()

    def _status(self) -> Status:
        machine, link, scheduler = self._emulated, self._link, self._scheduler
        lockstep = self.is_in_lockstep
        real_time = not lockstep and scheduler.is_real_time(time.monotonic())
        measured = "" if scheduler.measured is None else f"{scheduler.measured:.4g}"
        values = run_statistics(machine.simulation) | {
            "real_time": str(real_time).lower(),
            "real_time_factor": "lockstep" if lockstep else "1.0",
            "measured_real_time_factor": measured,
            "wall_time_dropped": f"{scheduler.dropped:.4g}",
            "sync_count": str(machine.sync_count),
        }
        if link is not None:
            values |= {"frames_sent": str(link.sent), "frames_received": str(link.received)}
        level, message = Level.OK, "lockstep: SYNC advances the time" if lockstep else "real time"
        if lockstep and not self._follows_sync():
            level, message = Level.WARN, "lockstep: the bridge is gone, time follows the wall clock"
        if machine.simulation.phase.final:
            level, message = Level.ERROR, f"the plant has stopped: {machine.simulation.phase.value}"
        elif not lockstep and scheduler.measured is not None and not real_time:
            level = Level.WARN
            message = f"NOT real time: factor {measured}, dropped {scheduler.dropped:.3g} s"
        return Status(f"{self.NAME}: plant", message, level, self.NAME, values)


def main() -> int:
    """Run the node."""
    sys.setswitchinterval(SWITCH_INTERVAL)
    return run(EmulatorNode)


if __name__ == "__main__":
    sys.exit(main())
