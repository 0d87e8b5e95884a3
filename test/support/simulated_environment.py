"""A procedure environment in simulated time without ROS: a simple winch behind a bridge."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from msg_schemas import topics
from msg_schemas.events import BridgeEvent
from msg_schemas.machine import WINCH_BRAKE, WINCH_DRUM, WINCH_LIMIT
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample, JointValue, Level, Status, StatusSample, TextSample
from msg_schemas.table import TOPICS
from rover_hil.rehearsal.environment import OutgoingMessage, PreconditionError, RehearsalResponse
from rover_hil.rehearsal.message_history import MessageHistory, ReceivedMessage
from rover_runtime.refusal_log import RefusalLog

STEP = 0.005  # [s]
_SECOND = 1_000_000_000


@dataclass
class Machine:
    """Properties of the machine and the computer."""

    rate: float = 200.0  # of the winch's state [Hz]
    timeout: float = 0.5  # of the bridge's watchdog [s]; inf: none
    refuses: bool = True  # commands while disarmed or beyond the limits
    owner: str = ""  # present command source
    real_time: bool = True
    is_emulated: bool = True
    age: float = 0.001  # of messages at reception [s]
    stall_at: float = -1.0  # time of a stall of the rehearsal [s]
    stall: float = 0.0  # its duration [s]
    stall_count: int = 1
    recovery: float = 0.0  # time without answers after a parameter was set [s]
    offered: set[str] = field(default_factory=lambda: {topics.WINCH_STATE, topics.WINCH_COMMAND})
    parameters: dict[tuple[str, str], object] = field(default_factory=dict)
    answers: dict[str, bool] = field(default_factory=dict)  # of the operator, by key


class SimulatedPublisher:
    """Publishes by simulated time."""

    def __init__(
        self,
        environment: SimulatedEnvironment,
        topic: str,
        make: Callable[[int], OutgoingMessage],
        period: float,
    ) -> None:
        self.count, self.longest_interval, self.last_stamp_ns = 0, 0.0, 0
        self._environment, self._topic, self._make, self._period = environment, topic, make, period
        self.tick()

    def tick(self) -> None:
        now_ns = self._environment.now_ns()
        if self.count and now_ns - self.last_stamp_ns < self._period * 1e9 - 1:
            return
        if self.count:
            self.longest_interval = max(self.longest_interval, (now_ns - self.last_stamp_ns) * 1e-9)
        self._environment.send(self._topic, self._make(now_ns))
        self.last_stamp_ns = now_ns
        self.count += 1

    def stop(self) -> None:
        self._environment.publishers.remove(self)


class SimulatedEnvironment:
    """An environment by simulated time, in place of the node's."""

    def __init__(self, machine: Machine | None = None) -> None:
        self.machine = Machine() if machine is None else machine
        self.history = MessageHistory()
        self.time_ns = 10 * _SECOND
        self.publishers: list[SimulatedPublisher] = []
        self.progress: list[str] = []
        self.sent: list[tuple[str, OutgoingMessage]] = []
        self.calls: list[tuple[str, bool | None]] = []
        self.set: list[tuple[str, str, object]] = []
        self.armed = False
        self.brake = 0.0
        self.stalls: list[tuple[int, float]] = []
        self._command_ns = -_SECOND
        self._state_ns = 0
        self._reported_ns = 0
        self._stalls_done = 0
        self._refusals = RefusalLog("hil_bridge")
        self._set_ns = -_SECOND * 1000

    # --- clocks ----------------------------------------------------------------------------------

    def now_ns(self) -> int:
        return self.time_ns

    steady_ns = wall_ns = now_ns

    def wait(self, timeout: float) -> None:
        end_ns = self.time_ns + max(round(timeout * 1e9), 1)
        while self.time_ns < end_ns:
            self._step()

    def longest_stall(self, since_ns: int) -> float:
        return max([0.0, *(late for at_ns, late in self.stalls if at_ns >= since_ns)])

    def _step(self) -> None:
        machine = self.machine
        self.time_ns += round(STEP * 1e9)
        since = (self.time_ns - 10 * _SECOND) * 1e-9
        if 0.0 <= machine.stall_at <= since and self._stalls_done < machine.stall_count:
            self._stalls_done += 1
            machine.stall_at = since + 1.5
            for _ in range(round(machine.stall / STEP)):
                self.time_ns += round(STEP * 1e9)
                self._step_machine()
            self.stalls.append((self.time_ns, machine.stall))
        for publisher in list(self.publishers):
            publisher.tick()
        self._step_machine()

    # --- the machine -----------------------------------------------------------------------------

    def _step_machine(self) -> None:
        machine = self.machine
        since_command = (self.time_ns - self._command_ns) * 1e-9
        if self.brake and since_command > machine.timeout:
            self.brake = 0.0
            self.event(BridgeEvent.COMMANDS_CEASED, "no command")
        if self.time_ns - self._state_ns >= 1e9 / machine.rate - 1:
            self._state_ns = self.time_ns
            joints = {WINCH_DRUM: JointValue(20.0), WINCH_BRAKE: JointValue(self.brake)}
            self.receive(topics.WINCH_STATE, JointSample(self.time_ns, joints))
        if self.time_ns % _SECOND == 0:
            for status in self._refusals.end_period():
                self.receive(topics.DIAGNOSTICS, StatusSample(self.time_ns, (status,)))
        if self.time_ns - self._reported_ns >= _SECOND // 2:
            self._reported_ns = self.time_ns
            self._report()

    def _report(self) -> None:
        cycles = str(self.time_ns // 5_000_000)
        link = {"cycles": cycles, "sync_rate": "200.0", "command_time_p99": "0.004"}
        drive = {"armed": str(self.armed).lower()}
        level, message, link["devices_missing"] = Level.OK, "all devices answer", "0"
        if self._is_recovering:
            level, message, link["devices_missing"] = Level.ERROR, "no answer: winch", "1"
        statuses = (
            Status("hil_bridge: link", message, level, "hil_bridge", link),
            Status("hil_bridge: winch", "operation enabled", Level.OK, "hil_bridge", drive),
        )
        self.receive(topics.LINK_STATUS, StatusSample(self.time_ns, statuses))
        if self.machine.is_emulated:
            plant = {
                "real_time": str(self.machine.real_time).lower(),
                "real_time_factor": "1.0",
                "wall_time_dropped": "0",
            }
            progress = (Status("drive_emulator: plant", "", Level.OK, "drive_emulator", plant),)
            self.receive(topics.SIM_STATUS, StatusSample(self.time_ns, progress))

    def receive(self, topic: str, sample: JointSample | StatusSample | TextSample) -> None:
        received_ns = self.time_ns + round(self.machine.age * 1e9)
        stamp_ns = getattr(sample, "stamp_ns", self.time_ns)
        self.history.add(topic, ReceivedMessage(stamp_ns, received_ns, self.time_ns, sample))

    def add_invalid(self, topic: str, refusal: str) -> None:
        self.history.add(
            topic, ReceivedMessage(self.time_ns, self.time_ns, self.time_ns, None, refusal)
        )

    def event(self, name: str, message: str, values: dict[str, str] | None = None) -> None:
        status = Status(name, message, Level.OK, "hil_bridge", values or {})
        self.receive(topics.EVENTS, StatusSample(self.time_ns, (status,)))

    def refuse(self, subject: str, code: str, reason: str) -> None:
        status = self._refusals.take(Refusal(subject, RefusalCode(code), reason))
        if status is not None:
            self.receive(topics.DIAGNOSTICS, StatusSample(self.time_ns, (status,)))

    # --- what a procedure runs against -----------------------------------------------------------

    def listen(self, topics: tuple[str, ...]) -> None:
        pass

    def is_available(self, name: str) -> bool:
        return name in self.machine.offered

    has_subscriber = is_available

    def send(self, topic: str, message: OutgoingMessage) -> None:
        self.sent.append((topic, message))
        if self.machine.owner:
            self.refuse(topic, "owned", f"{self.machine.owner} owns it")
            return
        fields = TOPICS[topic].by_path
        for name, value in message.joints.items():
            for part, number in zip(value._fields, value, strict=True):
                row = fields.get(f"{name}.{part}")
                if row is not None and not row.minimum <= number <= row.maximum:
                    if self.machine.refuses:
                        self.refuse(topic, "out_of_limits", f"{row.path} is {number!r} {row.unit}")
                    return
        if not self.armed:
            if self.machine.refuses:
                self.refuse(topic, "not_armed", "the winch drive is not armed")
            return
        self._command_ns = self.time_ns
        if WINCH_BRAKE in message.joints and WINCH_LIMIT in message.joints:
            self.brake = message.joints[WINCH_BRAKE].position

    def send_periodically(
        self, topic: str, make: Callable[[int], OutgoingMessage], period: float
    ) -> SimulatedPublisher:
        publisher = SimulatedPublisher(self, topic, make, period)
        self.publishers.append(publisher)
        return publisher

    def call(self, service: str, data: bool | None, timeout: float) -> RehearsalResponse:
        self.calls.append((service, data))
        if service != topics.DRIVES_ARM:
            raise PreconditionError(f"{service} has no server")
        if data and self._is_recovering:
            return RehearsalResponse(False, "no answer on the link: winch")
        self.armed = data is True
        if not self.armed:
            self.brake = 0.0
        return RehearsalResponse(True, "armed" if self.armed else "disarmed")

    def parameter(self, node: str, name: str) -> object:
        if (node, name) not in self.machine.parameters:
            raise PreconditionError(f"{node}/get_parameters has no server")
        return self.machine.parameters[node, name]

    def set_parameter(self, node: str, name: str, value: object) -> None:
        self.machine.parameters[node, name] = value
        self.set.append((node, name, value))
        self._set_ns = self.time_ns

    @property
    def _is_recovering(self) -> bool:
        return self.time_ns - self._set_ns < self.machine.recovery * _SECOND

    def request_action(self, key: str, instruction: str) -> None:
        if not self.machine.answers.get(key, False):
            raise PreconditionError(f"{instruction} There is no operator at a terminal")

    def request_answer(self, key: str, question: str) -> bool:
        if key not in self.machine.answers:
            raise PreconditionError(f"{question} There is no operator at a terminal")
        return self.machine.answers[key]

    def report_progress(self, line: str) -> None:
        self.progress.append(line)
