"""A machine whose parts only publish, so that each can fail in every way that its receivers see."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ros_messages import message_of

from msg_schemas import machine, qos, topics
from msg_schemas.health import Health
from msg_schemas.message_types import message_class
from msg_schemas.phases import HealthState, JumpPhase, LoadState, PlantPhase, WinchMode
from msg_schemas.samples import (
    ClockSample,
    JointSample,
    JointValue,
    Level,
    Sample,
    Status,
    StatusSample,
    TextSample,
)
from msg_schemas.table import SERVICES, TOPICS
from operator_console.commands import COMMANDS

if TYPE_CHECKING:
    from rover_verify.harness import Observer

PERIOD = 0.05  # of all topics [s]
_HEALTH_PERIODS = 10  # between two health reports
NODES = (
    "mock_plant", "winch_node", "descent_node", "drive_node", "jump_node", "mission_node",
    "bag_record",
)  # fmt: skip
_STREAMS = {
    topics.WINCH_ESTIMATE: "winch_node",
    topics.WINCH_STATE: "mock_plant",
    topics.DESCENT_STATE: "descent_node",
    topics.DRIVE_STATE: "drive_node",
}
PLANT = "mock_plant"
BRIDGE = "hil_bridge"
ANSWER = "all devices answer"


class ScriptedMachine:
    """Publishes what a machine at rest at 5 m publishes, changed by the attributes.

    Attributes:
        nodes: that run.
        inactive: those of them that report to be inactive.
        missing: topics that nobody publishes.
        invalid: topics whose first number is not a number.
        reports: further statuses of the nodes' health.
        waits: what nodes wait for.
        simulation: status of the plant.
        link: statuses of the link; empty = there is none.
        texts: of the phases and modes.
        alarms: raised alarms of the winch.
        speed: of simulated time.
        other_clock: offset of a second plant's clock [s].
        orders: services that were called.
    """

    def __init__(self, observer: Observer) -> None:
        self._node = observer.node
        self.orders: list[str] = []
        self._publishers: dict[str, Any] = {}
        self._time, self._count = 100.0, 0
        self.link: tuple[Status, ...] = ()
        self._stop = threading.Event()
        self.mend()
        for name in (call.service for call in COMMANDS["hold"].calls):
            kind = message_class(SERVICES[name].service)
            self._node.create_service(kind, name, self._answer(name))
        self._thread = threading.Thread(target=self._run, name="machine")
        self._thread.start()

    def mend(self) -> None:
        """Let everything work."""
        self.nodes = set(NODES)
        self.inactive: set[str] = set()
        self.missing: set[str] = set()
        self.invalid: set[str] = set()
        self.reports: dict[str, tuple[Status, ...]] = {}
        self.waits: dict[str, str] = {}
        self.simulation = Status(f"{PLANT}: plant", "running", Level.OK, PLANT, _pause(False))
        # A link that was there stays.
        self.link = tuple(replace(each, message=ANSWER, level=Level.OK) for each in self.link)
        self.nodes |= {each.hardware_id for each in self.link}
        self.texts: dict[str, str] = {
            topics.WINCH_MODE: WinchMode.HOLD.value,
            topics.TRUTH_PHASE: PlantPhase.HANGING.value,
            topics.TENSION_WATCH: LoadState.NORMAL.value,
            topics.JUMP_PHASE: JumpPhase.STANDBY.value,
        }
        self.alarms: set[str] = set()
        self.speed = 1.0
        self.other_clock = 0.0

    def pause(self) -> None:
        """Pause simulated time."""
        self.speed = 0.0
        self.simulation = Status(f"{PLANT}: plant", "paused", Level.OK, PLANT, _pause(True))

    def fail(self, node: str, what: str, level: Level = Level.ERROR) -> None:
        """Let a node report a problem."""
        self.reports[node] = (Status(f"{node}: part", what, level, node),)

    def connect(self, *statuses: tuple[str, str, Level]) -> None:
        """Put a link between the nodes and the drives."""
        self.nodes |= {BRIDGE}
        given = [Status(f"{BRIDGE}: {name}", text, level, BRIDGE) for name, text, level in statuses]
        self.link = tuple({each.name: each for each in (*self.link, *given)}.values())

    def close(self) -> None:
        """Publish no more."""
        self._stop.set()
        self._thread.join()

    def _answer(self, name: str) -> Any:
        def on_call(_request: Any, response: Any) -> Any:
            self.orders.append(name)
            response.success = True
            return response

        return on_call

    def _run(self) -> None:
        last = time.monotonic()
        while not self._stop.wait(PERIOD):
            # As fast as the wall clock, also where a busy computer makes these steps longer.
            now = time.monotonic()
            self._time += (now - last) * self.speed
            self._count += 1
            last = now
            for name, sample in self._samples():
                if name in self.missing:
                    continue
                message = message_of(name, sample)
                if name in self.invalid:
                    message.position[0] = float("nan")
                self._publisher(name).publish(message)

    def _publisher(self, name: str) -> Any:
        if name not in self._publishers:
            row = TOPICS[name]
            self._publishers[name] = self._node.create_publisher(
                message_class(row.message), name, qos.profile(row.intent)
            )
        return self._publishers[name]

    def _samples(self) -> Iterator[tuple[str, Sample]]:
        now = round(self._time * 1e9)
        if PLANT in self.nodes:
            yield topics.CLOCK, ClockSample(now)
            yield topics.SIM_STATUS, StatusSample(now, (self.simulation,))
        if self.other_clock:
            yield topics.CLOCK, ClockSample(now + round(self.other_clock * 1e9))
        if self.link and BRIDGE in self.nodes:
            yield topics.LINK_STATUS, StatusSample(now, self.link)
        if self.speed:
            for name, node in _STREAMS.items():
                if node in self.nodes:
                    yield name, JointSample(now, _joints(name))
        yield topics.WINCH_ALARMS, JointSample(now, {
            name: JointValue(float(name in self.alarms)) for name in machine.ALARM_NAMES
        })  # fmt: skip
        for name, text in self.texts.items():
            yield name, TextSample(text)
        if self._count % _HEALTH_PERIODS == 0:
            for node in sorted(self.nodes):
                yield topics.DIAGNOSTICS, StatusSample(now, self._health(node))

    def _health(self, node: str) -> tuple[Status, ...]:
        waits = self.waits.get(node, "")
        state = HealthState.WAITING if waits else HealthState.READY
        if node in self.inactive:
            return (Health(node, HealthState.INACTIVE).status({}),)
        missing = (waits,) if waits else ()
        return (Health(node, state, missing).status({}), *self.reports.get(node, ()))


def _pause(is_paused: bool) -> dict[str, str]:
    return {"paused": str(is_paused).lower(), "measured_real_time_factor": "1.0"}


def _joints(name: str) -> dict[str, JointValue]:
    known = {
        machine.PAYOUT: JointValue(5.0),
        machine.TENSION: JointValue(1.0, 0.0, 16.0),
        machine.WINCH_DRUM: JointValue(5.0),
    }
    return {joint: known.get(joint, JointValue()) for joint in TOPICS[name].joints}
