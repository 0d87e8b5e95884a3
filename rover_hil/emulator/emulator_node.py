"""The ``drive_emulator`` executable: drives, IMU and load cell on the link, played by the plant."""

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

from msg_schemas import topics
from msg_schemas.node import ContractNode, ExitCode
from msg_schemas.node_process import run
from msg_schemas.parameters import ParameterError, parameter
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import Level, Status, StatusSample, TextSample
from rover_hil.devices import CYCLE_OVER_ID, SYNC_PERIOD, SYNC_RATE
from rover_hil.emulator.killing import kill_process
from rover_hil.emulator.machine import EmulatedMachine, played_beside
from rover_hil.emulator.pace import SyncPace
from rover_hil.impairment import read_impairments
from rover_hil.link import SYNC_ID, Link, waited_ns
from rover_hil.transport import open_bus
from rover_hil.wiring import TOLD
from rover_sim import (
    StatePublisher,
    Tick,
    TruthRates,
    build_simulation,
    load_overridden,
    run_statistics,
)

# Threads of this process take turns this often [s]: what comes by the link is answered at once.
SWITCH_INTERVAL = 0.0005
_LISTENING = 0.1  # a link's end looks up so often [s]
_ANSWER = 5.0  # [s]
_STATUS_PERIOD = 0.1  # [s]
_NODES = 50  # that tell what they are, all at once to who comes late
BRIDGE_NAME = "hil_bridge"
BRIDGE_MARKS = (BRIDGE_NAME, "rover_hil.bridge_node")
"""What the command line of a bridge's process holds, however it was started."""


@dataclass(frozen=True)
class EmulatorParameters:
    """What is emulated, and on which link."""

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
    seed: int = parameter(1, "-", "seed of the sensors' errors", 0, 2**31 - 1, read_only=True)
    lockstep: bool = parameter(
        False,
        "-",
        "simulated time goes on by one tick with each SYNC",
        read_only=True,
    )
    lockstep_patience: float = parameter(
        10.0,
        "s",
        "wall time without SYNC after which simulated time goes on by the wall clock",
        0.01,
        600.0,
        read_only=True,
    )
    real_devices: str = parameter(
        "",
        "-",
        "names of devices that are on the link themselves and not played, with commas between",
        read_only=True,
    )
    command_delay: float = parameter(
        0.0, "s", "from a command's execution by a drive to its effect", 0.0, 0.5, read_only=True
    )
    rover_clock_offset: float = parameter(
        0.0, "s", "the clock of the rover's devices less that of the mother's", -1e6, 1e6,
        read_only=True,
    )  # fmt: skip
    rover_clock_drift: float = parameter(
        0.0, "-", "rate by which the rover's clock is fast", -1e-3, 1e-3, read_only=True
    )
    impairments: str = parameter(
        "",
        "-",
        "what is wrong, as a list in YAML such as [{what: loss, on: rover, strength: 0.3}], or the "
        "path of a .yaml file with one; what stood in it before goes on; empty: nothing is",
    )

    def __post_init__(self) -> None:
        """Refuse impairments and devices that are none."""
        played_beside(self.real)
        for impairment in read_impairments(self.impairments):
            there = [each.name for each in impairment.devices if each.name in self.real]
            if there:
                raise ParameterError(
                    f"impairments: {impairment} is on {there[0]}, which is one of the "
                    "real_devices: should be on what is played"
                )

    @property
    def real(self) -> tuple[str, ...]:
        """Names of the devices that are not played."""
        names = (name.strip() for name in self.real_devices.split(","))
        return tuple(name for name in names if name)


class EmulatorNode(ContractNode):
    """Plays drives, IMU and load cell on the link; tells clock and truth as sim_node does."""

    NAME = "drive_emulator"
    PARAMETERS = (EmulatorParameters, TruthRates)

    _machine: EmulatedMachine | None = None
    _link: Link | None = None
    _scenario: Mapping[str, Any] | None = None

    # --- life ------------------------------------------------------------------------------------

    def setup(self) -> None:
        """Load the scenario, compile and build the plant, open the link."""
        wanted = self.parameters_of(EmulatorParameters)
        scenario = load_overridden(wanted.scenario, wanted.overrides)
        rates = self.parameters_of(TruthRates)
        rates.check(SYNC_PERIOD)
        simulation = build_simulation(scenario, wanted.seed, SYNC_PERIOD, self)
        link = Link(open_bus(wanted.link))
        try:
            machine = EmulatedMachine(
                link,
                simulation,
                self._mother_clock,
                self._rover_clock,
                wanted.command_delay,
                wanted.real,
            )
        except ValueError:
            link.close()
            raise
        self._link, self._machine, self._scenario = link, machine, scenario.to_mapping()
        self._pace = SyncPace(SYNC_PERIOD)
        self._sync_at: float | None = None  # by the wall clock, in lockstep
        machine.on_sync = self._on_sync
        own = [name for name in simulation.interface.topics if name not in TOLD]
        self._publisher = StatePublisher(self, simulation, rates.of_topics(own, SYNC_RATE))
        self._status_publisher = self.publisher(topics.SIM_STATUS)
        self._bridge_process: tuple[int, str] | None = None
        self._hears_config = False
        self.serve(topics.SIM_RESET, lambda: (True, self._ask_reset(clock=True)))
        self.serve(topics.SIM_RESET_PLANT, lambda: (True, self._ask_reset(clock=False)))

    def start(self) -> None:
        """Switch the devices on, and let the world run."""
        machine = self._emulated
        self._publisher.publish_static()
        if not self._hears_config:
            # Not before it is active: what is latched comes once.
            self.subscribe(topics.CONFIG, self._on_config, _NODES)
            self._hears_config = True
        self._ending = threading.Event()
        self._reset: tuple[bool, Future[str]] | None = None
        machine.power_on()
        self._impair()
        self._thread = threading.Thread(target=self._guarded, name="machine")
        self._thread.start()
        self.every(_STATUS_PERIOD, self._publish_status, by_wall_clock=True)

    def stop(self) -> None:
        """Stop the world where it is."""
        self._ending.set()
        self._thread.join()

    def release(self) -> None:
        """Let go of plant and link."""
        if self._link is not None:
            self._link.close()
        self._link = self._machine = self._scenario = None

    def configuration(self) -> Mapping[str, Any]:
        """Scenario with all values, and the seed."""
        seed = self.parameters_of(EmulatorParameters).seed
        return {"scenario": self._scenario or {}, "seed": seed}

    def now_ns(self) -> int:
        """Simulated time [ns]: this node is the clock."""
        return 0 if self._machine is None else self._machine.simulation.stamp_ns

    def knows_time(self) -> bool:
        """Always: this node is the clock."""
        return True

    def parameters_changed(self) -> None:
        """Begin and end impairments."""
        if self.active:
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
        if self.parameters_of(EmulatorParameters).lockstep:
            return self.now_ns()
        return time.monotonic_ns()

    def _rover_clock(self) -> int:
        wanted, mother = self.parameters_of(EmulatorParameters), self._mother_clock()
        drifted = round(mother * wanted.rover_clock_drift)
        return mother + drifted + round(wanted.rover_clock_offset * 1e9)

    # --- the machine's thread --------------------------------------------------------------------

    def _guarded(self) -> None:
        try:
            self._run_machine()
        except Exception as error:  # noqa: BLE001 - a bug must reach the process, not end here
            self.get_logger().fatal("".join(traceback.format_exception(error)))
            self.exit_code = ExitCode.CRASH

    def _run_machine(self) -> None:
        """Answer the link and let the plant go on: one thread, so that neither waits halfway."""
        machine, link = self._emulated, self._link
        if link is None:
            raise AssertionError("no link")
        lockstep = self.parameters_of(EmulatorParameters).lockstep
        self._untold: tuple[Tick[Any], int] | None = None
        while not self._ending.is_set():
            wait = _LISTENING if self._follows_sync() else self._pace.wait(time.monotonic())
            frame = link.receive(min(wait, _LISTENING, machine.wait()))
            if frame is not None:
                if lockstep:
                    machine.hear([frame])
                else:
                    machine.hear(link.waiting(frame), waited_ns)
                if lockstep and frame.arbitration_id == SYNC_ID:
                    link.send(CYCLE_OVER_ID, bytes(frame.data[:1]))
                if frame.arbitration_id == SYNC_ID:
                    self._tell()
            machine.let_go_frames()
            self._serve_reset()
            if not self._follows_sync():
                for _ in range(self._pace.due(time.monotonic())):
                    self._tell()
                    self._tick()
        self._tell()

    def _follows_sync(self) -> bool:
        """Whether time goes on with SYNC: in lockstep, unless the bus master fell silent."""
        wanted = self.parameters_of(EmulatorParameters)
        if not wanted.lockstep or self._sync_at is None:
            return wanted.lockstep
        return time.monotonic() - self._sync_at <= wanted.lockstep_patience

    def _on_sync(self) -> None:
        """Before the devices answer a SYNC."""
        if self.parameters_of(EmulatorParameters).lockstep:
            self._sync_at = time.monotonic()
            self._pace = SyncPace(SYNC_PERIOD)  # begins anew, should SYNC cease
            self._tick()
        else:
            self._pace.synchronise(time.monotonic())

    def _tick(self) -> None:
        machine = self._emulated
        before_ns = machine.simulation.stamp_ns
        self._untold = machine.tick(), before_ns
        if self.parameters_of(EmulatorParameters).lockstep:
            self._tell()
        for change in machine.take_transitions():
            self.event(change.name, change.reason, change.level, change.values)
        for what in machine.take_kills():
            if what == "emulator_kill":
                self.wait_until_taken()
                os.kill(os.getpid(), signal.SIGKILL)
            self._kill_bridge()

    def _tell(self) -> None:
        """Tell of the last tick.

        In real time not before the SYNC that follows has been answered: drives answer at once, and
        telling takes as long as the tick.
        """
        untold, self._untold = self._untold, None
        if untold is not None:
            self._publisher.on_tick(*untold)

    def _kill_bridge(self) -> None:
        """Kill the bridge that tells its process, as long as it still is one on this machine."""
        told = self._bridge_process
        try:
            if told is None:
                raise ProcessLookupError("none has told its process")
            kill_process(*told, BRIDGE_MARKS)
        except OSError as error:
            self.event("bridge_kill_failed", f"it cannot be killed: {error}", Level.WARN)

    def _on_config(self, sample: TextSample) -> None:
        told = json.loads(sample.text)
        bridge = f"{self.get_namespace().rstrip('/')}/{BRIDGE_NAME}"
        if told.get("node") == bridge and {"process", "host"} <= told.keys():
            self._bridge_process = (int(told["process"]), str(told["host"]))

    # --- requests --------------------------------------------------------------------------------

    def _ask_reset(self, *, clock: bool) -> str:
        answer: Future[str] = Future()
        self._reset = (clock, answer)
        try:
            return answer.result(_ANSWER)
        except TimeoutError:
            raise Refusal(
                topics.SIM_RESET, RefusalCode.NOT_ACTIVE, "the plant gives no answer"
            ) from None

    def _serve_reset(self) -> None:
        asked, self._reset = self._reset, None
        if asked is None:
            return
        clock, answer = asked
        machine, simulation = self._emulated, self._emulated.simulation
        before = simulation.stamp_ns * 1e-9
        self._tell()
        with machine.lock:
            if clock:
                simulation.reset()
                self.accept_earlier_stamps()
            else:
                simulation.reset_plant()
            machine.restart()
        self._publisher.on_restart()
        what = "plant and clock" if clock else "the plant"
        message = f"{what} put back to the start at {before:g} s, the devices switched on anew"
        self.event("reset" if clock else "reset_plant", message)
        answer.set_result(message)

    # --- status ----------------------------------------------------------------------------------

    def _publish_status(self) -> None:
        self._status_publisher.send(StatusSample(self.now_ns(), (self._status(),)))

    def health(self) -> tuple[Status, ...]:
        """Whether the plant is well and keeps pace."""
        return (self._status(),) if self.active else ()

    def _status(self) -> Status:
        machine, link, pace = self._emulated, self._link, self._pace
        lockstep = self.parameters_of(EmulatorParameters).lockstep
        real_time = not lockstep and pace.is_real_time(time.monotonic())
        measured = "" if pace.measured is None else f"{pace.measured:.4g}"
        values = run_statistics(machine.simulation) | {
            "real_time": str(real_time).lower(),
            "real_time_factor": "lockstep" if lockstep else "1.0",
            "measured_real_time_factor": measured,
            "wall_time_dropped": f"{pace.given_up:.4g}",
            "synchronised": str(machine.synchronised),
        }
        if link is not None:
            values |= {"frames_sent": str(link.sent), "frames_received": str(link.received)}
        level, message = Level.OK, "lockstep: time goes with SYNC" if lockstep else "real time"
        if lockstep and not self._follows_sync():
            level, message = Level.WARN, "lockstep: SYNC has ceased, time goes by the wall clock"
        if machine.simulation.phase.final:
            level, message = Level.ERROR, f"the plant has stopped: {machine.simulation.phase.value}"
        elif not lockstep and pace.measured is not None and not real_time:
            level = Level.WARN
            message = f"NOT real time: it reaches {measured}, {pace.given_up:.3g} s were given up"
        return Status(f"{self.NAME}: plant", message, level, self.NAME, values)


def main() -> int:
    """Run the node."""
    sys.setswitchinterval(SWITCH_INTERVAL)
    return run(EmulatorNode)


if __name__ == "__main__":
    sys.exit(main())
