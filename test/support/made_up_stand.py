"""A stand without ROS and without waiting: a small winch behind a bridge, played by arithmetic."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from msg_schemas import topics
from msg_schemas.machine import WINCH_BRAKE, WINCH_DRUM, WINCH_LIMIT
from msg_schemas.samples import JointSample, JointValue, Level, Status, StatusSample, TextSample
from msg_schemas.table import TOPICS
from rover_hil.rehearsal.history import Heard, History
from rover_hil.rehearsal.stand import Answer, CannotDoError, Outgoing

STEP = 0.005  # [s]
_SECOND = 1_000_000_000


@dataclass
class Machine:
    """How good the machine is, and how well the computer does."""

    rate: float = 200.0  # of the winch's state [Hz]
    timeout: float = 0.5  # after which the bridge's watchdog acts [s]; inf: it has none
    refuses: bool = True  # commands while disarmed, and those beyond the limits
    owner: str = ""  # who commands already
    real_time: bool = True
    is_emulated: bool = True
    age: float = 0.001  # of messages on arrival [s]
    hiccup_at: float = -1.0  # when the rehearsal itself is held up [s]
    hiccup: float = 0.0  # for how long [s]
    hiccups: int = 1
    recovery: float = 0.0  # after a parameter was set; till then the link's devices are silent [s]
    offered: set[str] = field(default_factory=lambda: {topics.WINCH_STATE, topics.WINCH_COMMAND})
    parameters: dict[tuple[str, str], object] = field(default_factory=dict)
    answers: dict[str, bool] = field(default_factory=dict)  # of the operator, by key


class MadeUpSending:
    """Messages that go out at a rate."""

    def __init__(self, stand: MadeUpStand, topic: str, make: Callable[[int], Outgoing],
                 period: float) -> None:  # fmt: skip
        self.count, self.longest, self.last_ns = 0, 0.0, 0
        self._stand, self._topic, self._make, self._period = stand, topic, make, period
        self.tick()

    def tick(self) -> None:
        now_ns = self._stand.now_ns()
        if self.count and now_ns - self.last_ns < self._period * 1e9 - 1:
            return
        if self.count:
            self.longest = max(self.longest, (now_ns - self.last_ns) * 1e-9)
        self._stand.send(self._topic, self._make(now_ns))
        self.last_ns = now_ns
        self.count += 1

    def stop(self) -> None:
        self._stand.sendings.remove(self)


class MadeUpStand:
    """See `rover_hil.rehearsal.stand.Stand`."""

    def __init__(self, machine: Machine | None = None) -> None:
        self.machine = Machine() if machine is None else machine
        self.history = History()
        self.time_ns = 10 * _SECOND
        self.sendings: list[MadeUpSending] = []
        self.told: list[str] = []
        self.sent: list[tuple[str, Outgoing]] = []
        self.calls: list[tuple[str, bool | None]] = []
        self.set: list[tuple[str, str, object]] = []
        self.armed = False
        self.brake = 0.0
        self.held_ups: list[tuple[int, float]] = []
        self._commanded_ns = -_SECOND
        self._told_ns = 0
        self._reported_ns = 0
        self._hiccups = 0
        self._set_ns = -_SECOND * 1000

    # --- clocks ----------------------------------------------------------------------------------

    def now_ns(self) -> int:
        return self.time_ns

    steady_ns = wall_ns = now_ns

    def wait(self, timeout: float) -> None:
        end_ns = self.time_ns + max(round(timeout * 1e9), 1)
        while self.time_ns < end_ns:
            self._step()

    def held_up(self, since_ns: int) -> float:
        return max([0.0, *(late for at_ns, late in self.held_ups if at_ns >= since_ns)])

    def _step(self) -> None:
        machine = self.machine
        self.time_ns += round(STEP * 1e9)
        since = (self.time_ns - 10 * _SECOND) * 1e-9
        if 0.0 <= machine.hiccup_at <= since and self._hiccups < machine.hiccups:
            self._hiccups += 1
            machine.hiccup_at = since + 1.5
            for _ in range(round(machine.hiccup / STEP)):
                self.time_ns += round(STEP * 1e9)
                self._play()
            self.held_ups.append((self.time_ns, machine.hiccup))
        for sending in list(self.sendings):
            sending.tick()
        self._play()

    # --- the machine -----------------------------------------------------------------------------

    def _play(self) -> None:
        machine = self.machine
        silent = (self.time_ns - self._commanded_ns) * 1e-9
        if self.brake and silent > machine.timeout:
            self.brake = 0.0
            self.event("winch_commands_ceased", "no command")
        if self.time_ns - self._told_ns >= 1e9 / machine.rate - 1:
            self._told_ns = self.time_ns
            joints = {WINCH_DRUM: JointValue(20.0), WINCH_BRAKE: JointValue(self.brake)}
            self.hear(topics.WINCH_STATE, JointSample(self.time_ns, joints))
        if self.time_ns - self._reported_ns >= _SECOND // 2:
            self._reported_ns = self.time_ns
            self._report()

    def _report(self) -> None:
        cycles = str(self.time_ns // 5_000_000)
        link = {"cycles": cycles, "sync_rate": "200.0", "command_time_p99": "0.004"}
        drive = {"armed": str(self.armed).lower()}
        level, message = Level.OK, "all devices answer"
        if self._suffers:
            level, message = Level.ERROR, "not heard: winch"
        statuses = (
            Status("hil_bridge: link", message, level, "hil_bridge", link),
            Status("hil_bridge: winch", "operation enabled", Level.OK, "hil_bridge", drive),
        )
        self.hear(topics.LINK_STATUS, StatusSample(self.time_ns, statuses))
        if self.machine.is_emulated:
            plant = {
                "real_time": str(self.machine.real_time).lower(),
                "real_time_factor": "1.0",
                "wall_time_dropped": "0",
            }
            told = (Status("drive_emulator: plant", "", Level.OK, "drive_emulator", plant),)
            self.hear(topics.SIM_STATUS, StatusSample(self.time_ns, told))

    def hear(self, topic: str, sample: JointSample | StatusSample | TextSample) -> None:
        heard_ns = self.time_ns + round(self.machine.age * 1e9)
        stamp_ns = getattr(sample, "stamp_ns", self.time_ns)
        self.history.add(topic, Heard(stamp_ns, heard_ns, self.time_ns, sample))

    def on_bad(self, topic: str, refusal: str) -> None:
        self.history.add(topic, Heard(self.time_ns, self.time_ns, self.time_ns, None, refusal))

    def event(self, name: str, message: str, values: dict[str, str] | None = None) -> None:
        status = Status(name, message, Level.OK, "hil_bridge", values or {})
        self.hear(topics.EVENTS, StatusSample(self.time_ns, (status,)))

    def refuse(self, subject: str, code: str, reason: str) -> None:
        name = f"hil_bridge: refused {subject}"
        status = Status(name, reason, Level.WARN, "hil_bridge", {"code": code})
        self.hear(topics.DIAGNOSTICS, StatusSample(self.time_ns, (status,)))

    # --- what the rehearsal asks for -------------------------------------------------------------

    def listen(self, topics: tuple[str, ...]) -> None:
        pass

    def is_offered(self, name: str) -> bool:
        return name in self.machine.offered

    is_heard = is_offered

    def send(self, topic: str, message: Outgoing) -> None:
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
        self._commanded_ns = self.time_ns
        if WINCH_BRAKE in message.joints and WINCH_LIMIT in message.joints:
            self.brake = message.joints[WINCH_BRAKE].position

    def send_steadily(
        self, topic: str, make: Callable[[int], Outgoing], period: float
    ) -> MadeUpSending:
        sending = MadeUpSending(self, topic, make, period)
        self.sendings.append(sending)
        return sending

    def call(self, service: str, data: bool | None, timeout: float) -> Answer:
        self.calls.append((service, data))
        if service != topics.DRIVES_ARM:
            raise CannotDoError(f"nobody serves {service}")
        if data and self._suffers:
            return Answer(False, "not heard on the link: winch")
        self.armed = data is True
        if not self.armed:
            self.brake = 0.0
        return Answer(True, "armed" if self.armed else "disarmed")

    def parameter(self, node: str, name: str) -> object:
        if (node, name) not in self.machine.parameters:
            raise CannotDoError(f"nobody serves {node}/get_parameters")
        return self.machine.parameters[node, name]

    def set_parameter(self, node: str, name: str, value: object) -> None:
        self.machine.parameters[node, name] = value
        self.set.append((node, name, value))
        self._set_ns = self.time_ns

    @property
    def _suffers(self) -> bool:
        return self.time_ns - self._set_ns < self.machine.recovery * _SECOND

    def ask(self, key: str, what: str) -> None:
        if not self.machine.answers.get(key, False):
            raise CannotDoError(f"{what} There is no operator at a terminal")

    def question(self, key: str, what: str) -> bool:
        if key not in self.machine.answers:
            raise CannotDoError(f"{what} There is no operator at a terminal")
        return self.machine.answers[key]

    def tell(self, line: str) -> None:
        self.told.append(line)
