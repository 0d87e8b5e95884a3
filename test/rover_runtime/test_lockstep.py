"""Lockstep: components in several processes exchange the same messages as those in one."""

from __future__ import annotations

import random
from collections.abc import Callable
from functools import partial

import pytest

from msg_schemas import machine, topics
from msg_schemas.access import Act
from msg_schemas.cdr import pack
from msg_schemas.samples import JointSample, JointValue, Sample, TextSample
from rover_runtime.component import Component
from rover_runtime.delays import Delays
from rover_runtime.lockstep import LockstepProcess, Release, Report
from rover_runtime.loop_host import LoopHost
from rover_runtime.loop_port import LoopPort
from rover_runtime.remote import Sent

TICK_NS = 10_000_000
ORDER = ("clock", "ping", "pong")
Record = list[tuple[str, str, int]]  # topic, content and time of sending [ns]


class Clock(Component):
    """The source of time; publishes a state in each tick."""

    NAME = "clock"

    def setup(self) -> None:
        self.stamp_ns = 0
        self.paused = False
        self._state = self.publisher(topics.JUMP_MOTOR_STATE)
        self._stepper = self.port.time_stepper(self, 0.0)
        self.subscribe(topics.JUMP_MOTOR_COMMAND, self._on_command)
        self._position = 0.0

    def start(self) -> None:
        self._stepper.start()

    @property
    def next_ns(self) -> int:
        return self.stamp_ns + TICK_NS

    def begin(self) -> None:
        pass

    def reset(self) -> None:
        self.stamp_ns = 0

    def advance(self) -> None:
        self.stamp_ns += TICK_NS
        value = JointValue(self._position, 0.0, 0.0)
        self._state.send(JointSample(self.stamp_ns, {machine.JUMP_SCREW: value}))

    def on_crash(self, error: Exception) -> None:
        raise error

    def now_ns(self) -> int:
        return self.stamp_ns

    def _on_command(self, sample: JointSample) -> None:
        self._position = 0.9 * self._position + 0.1 * sample.joints[machine.JUMP_SCREW].position


class Ping(Component):
    """Commands what it has received, and calls a service now and then."""

    NAME = "ping"

    def setup(self) -> None:
        self.answers: list[tuple[bool, str, int]] = []
        self.jumps: list[int] = []
        self._command = self.publisher(topics.JUMP_MOTOR_COMMAND)
        self._phase = self.publisher(topics.WINCH_MODE)
        self.subscribe(topics.JUMP_MOTOR_STATE, self._on_state)
        self._count = 0

    def start(self) -> None:
        self._phase.send(TextSample("hold"))
        self.every(0.1, self._call)

    def clock_jumped(self) -> None:
        self.jumps.append(self.now_ns())
        self._phase.send(TextSample("fault"))

    def _on_state(self, sample: JointSample) -> None:
        self._count += 1
        position = (
            0.1 + 0.05 * ((7 * self._count) % 3) + 0.1 * sample.joints[machine.JUMP_SCREW].position
        )
        self._command.send(
            JointSample(self.now_ns(), {machine.JUMP_SCREW: JointValue(position, 0.1, 1.0)})
        )

    def _call(self) -> None:
        self.call_service(
            topics.JUMP_ABORT,
            lambda success, text: self.answers.append((success, text, self.now_ns())),
        )


class Pong(Component):
    """Serves, and reports what it has received."""

    NAME = "pong"

    def setup(self) -> None:
        self.requests: list[tuple[float, int]] = []
        self.modes: list[str] = []
        self._estimate = self.publisher(topics.JUMP_PHASE)
        self.subscribe(topics.JUMP_MOTOR_STATE, self._on_state)
        self.subscribe(topics.WINCH_MODE, lambda sample: self.modes.append(sample.text))
        self.subscribe(topics.JUMP_REQUEST, self._on_request)
        self.serve(topics.JUMP_ABORT, lambda: (True, f"at {self.now_ns()}"))

    def _on_state(self, sample: JointSample) -> None:
        if round(sample.stamp_ns / TICK_NS) % 9 == 0:
            self._estimate.send(TextSample("standby" if sample.stamp_ns % 2 else "loading"))

    def _on_request(self, sample: JointSample) -> None:
        self.requests.append((sample.joints[machine.JUMP_STROKE].position, self.now_ns()))


class Net:
    """A network of processes: delivers at any time, but in each link's order.

    Args:
        seed: of the order.
        loss: probability that a report or release is lost.
    """

    def __init__(self, seed: int, loss: float = 0.0) -> None:
        self.loss = loss
        self.lost = 0
        self.random = random.Random(seed)
        self.processes: dict[str, LockstepProcess] = {}
        self.links: dict[tuple[str, str], list[Callable[[], None]]] = {}
        self.cut: set[str] = set()

    def join(self, name: str, host: LoopHost) -> LockstepProcess:
        process = self.processes[name] = LockstepProcess(name, host, _Link(self, name))
        return process

    def send(
        self,
        sender: str,
        act: Callable[[LockstepProcess], None],
        *,
        back: bool = False,
        only: str = "",
    ) -> None:
        for name, process in self.processes.items():
            if (name != sender or back) and only in ("", name):
                queue = self.links.setdefault((sender, name), [])
                queue.append(partial(act, process))

    def loses(self) -> bool:
        is_lost = self.random.random() < self.loss
        self.lost += is_lost
        return is_lost

    def turn(self) -> None:
        """Deliver something, or let a process run; at rest, repeat what was lost."""
        full = [link for link, queue in self.links.items() if queue and link[0] not in self.cut]
        if full and self.random.random() < 0.8:
            self.links[self.random.choice(full)].pop(0)()
        else:
            name = self.random.choice(sorted(self.processes.keys() - self.cut))
            is_run = self.processes[name].run_tick()
            if self.loss and name == "clock" and not is_run and self.random.random() < 0.3:
                self.processes[name].repeat_release()

    def run(self, ticks: int, *, turns: int = 200_000) -> None:
        for _ in range(turns):
            if all(
                p.host.exchange.ticks >= ticks
                for n, p in self.processes.items()
                if n not in self.cut
            ):
                return
            self.turn()
        raise AssertionError(
            {n: (p.host.exchange.ticks, p.missing()) for n, p in self.processes.items()}
        )


class _Link:
    def __init__(self, net: Net, name: str) -> None:
        self._net, self._name = net, name

    def open(self, act: Act, port: LoopPort, name: str) -> None:
        pass

    def publish(self, component: str, topic: str, data: bytes) -> None:
        self._net.send(self._name, lambda p: _arrive(p, topic, data), back=True)

    def report(self, data: bytes) -> None:
        if not self._net.loses():
            self._net.send(self._name, lambda p: p.on_report(data), only="clock")

    def release(self, data: bytes) -> None:
        for name in self._net.processes:
            if not self._net.loses():
                self._net.send(self._name, lambda p: p.on_release(data), only=name)

    def is_received(self, topic: str) -> bool:
        return True

    def is_needed(self, topic: str) -> bool:
        return True

    def is_watched(self, topic: str) -> bool:
        return self._net.processes[self._name].host.exchange.is_subscribed(topic)

    def is_served(self, service: str) -> bool:
        return service == topics.JUMP_ABORT


def _arrive(process: LockstepProcess, topic: str, data: bytes) -> None:
    if process.host.exchange.is_subscribed(topic):
        process.on_message(topic, data + bytes(3))  # as the middleware may


def record(host: LoopHost, into: Record) -> None:
    def listen(name: str, sample: Sample, _sender: str, now_ns: int) -> None:
        into.append((name, repr(sample), now_ns))

    host.exchange.listen(listen)


def by_topic(records: Record) -> dict[str, list[tuple[str, int]]]:
    found: dict[str, list[tuple[str, int]]] = {}
    for name, content, now_ns in records:
        # Nodes report their health side by side.
        if name not in (topics.DIAGNOSTICS, topics.EVENTS, topics.CONFIG):
            found.setdefault(name, []).append((content, now_ns))
    return found


def alone(ticks: int, seed: int = 1) -> tuple[Record, Ping, Pong]:
    host, records = LoopHost(Delays(seed), order=ORDER), Record()
    record(host, records)
    host.start(Clock)
    ping, pong = host.start(Ping), host.start(Pong)
    for _ in range(ticks):
        host.tick()
    return records, ping, pong


def apart(net: Net, seed: int = 1) -> tuple[Record, Ping, Pong]:
    records = Record()
    started: dict[str, Component] = {}
    for kind in (Clock, Ping, Pong):
        host = LoopHost(Delays(seed), order=ORDER)
        record(host, records)
        net.join(kind.NAME, host)
        started[kind.NAME] = host.start(kind)
    net.processes["clock"].begin(ORDER)
    ping, pong = started["ping"], started["pong"]
    assert isinstance(ping, Ping)
    assert isinstance(pong, Pong)
    return records, ping, pong


@pytest.mark.parametrize("loss", [0.0, 0.3])
@pytest.mark.parametrize("seed", range(5))
def test_three_processes_exchange_what_one_does(seed: int, loss: float):
    ticks = 150
    expected, ping_alone, pong_alone = alone(ticks)
    net = Net(seed, loss)
    records, ping, pong = apart(net)
    net.run(ticks)
    assert (net.lost > ticks / 2) == (loss > 0.0)
    last = min(p.host.exchange.ticks for p in net.processes.values())
    assert last >= ticks
    end_ns = (ticks - 3) * TICK_NS
    one, several = by_topic(expected), by_topic(records)
    assert one.keys() == several.keys()
    for name in one:
        until = [each for each in one[name] if each[1] < end_ns]
        assert until == [each for each in several[name] if each[1] < end_ns], name
        assert len(until) >= 1
    answers = [each for each in ping_alone.answers if each[2] < end_ns]
    assert answers
    assert answers == [each for each in ping.answers if each[2] < end_ns]
    assert pong.modes == pong_alone.modes == ["hold"]


def test_nothing_runs_before_all_have_met_and_time_waits_for_the_last():
    net = Net(1)
    _, _, pong = apart(net)
    net.cut.add("ping")
    with pytest.raises(AssertionError):
        net.run(5, turns=3000)
    assert {net.processes[n].host.exchange.ticks for n in ("clock", "pong")} <= {0, 1, 2}
    assert net.processes["clock"].missing() == ("ping",)
    assert net.processes["pong"].missing() == ("the source of time",)
    net.cut.clear()
    net.run(50)
    assert pong.modes == ["hold"]


@pytest.mark.parametrize("excluded", [("ping",), ("ping", "pong")])
def test_those_that_are_excluded_are_not_waited_for_and_may_come_back(excluded: tuple[str, ...]):
    net = Net(2)
    _, ping, _ = apart(net)
    net.run(50)
    clock, back = net.processes["clock"], [net.processes[name] for name in excluded]
    net.cut.update(excluded)
    for name in excluded:
        clock.exclude(name)
    net.run(120)
    assert all(each.host.exchange.ticks < 60 for each in back)
    # Back again, they learn from the releases that they are no members.
    net.cut.clear()
    clock.run_tick()
    while any(net.links.values()):
        for queue in net.links.values():
            while queue:
                queue.pop(0)()
    assert not any(each.is_member for each in back)
    answers = len(ping.answers)
    for name in excluded:
        clock.invite(name)
    net.run(200)
    assert all(each.is_member for each in back)
    assert all(each.host.exchange.ticks >= 200 for each in back)
    assert len(ping.answers) > answers + 3


def test_a_message_from_outside_is_received_once_within_three_ticks():
    net = Net(3)
    _, _, pong = apart(net)
    net.run(20)
    process = net.processes["pong"]
    now_ns = process.host.now_ns()
    sample = JointSample(now_ns, {machine.JUMP_STROKE: JointValue(0.1)})
    process.on_message(topics.JUMP_REQUEST, pack(topics.JUMP_REQUEST, sample, "operator"))
    net.run(60)
    ((stroke, at_ns),) = pong.requests
    assert stroke == 0.1
    assert 0 <= at_ns - now_ns <= 3 * TICK_NS


def test_time_waits_for_a_long_computation(monkeypatch: pytest.MonkeyPatch):
    net = Net(4)
    apart(net)
    net.run(20)
    process = net.processes["pong"]
    late = True
    monkeypatch.setattr(process.host, "computing", lambda _now_ns: ("node",) * late)
    with pytest.raises(AssertionError):
        net.run(40, turns=3000)
    assert process.computing() == ("node",)
    late = False
    net.run(40)


def test_reports_and_releases_are_read_as_they_were_written():
    sent = Sent(topics.WINCH_MODE, "ping", 3000, 4)
    report = Report("ping", 3, [(sent, b"one"), (sent._replace(sequence=3001), b"")])
    assert Report.from_bytes(report.to_bytes()) == report
    both = Report("ping", 3, [*report.sent, (sent._replace(topic=topics.JUMP_PHASE), b"two")])
    assert Report.from_bytes(both.to_bytes(), lambda topic: topic == topics.WINCH_MODE) == report
    release = Release(
        4, 40_000_000, {"clock": 0, "ping": 4}, {"ping": report.to_bytes(), "clock": b""}
    )
    assert Release.from_bytes(release.to_bytes()) == release


def test_bytes_that_are_no_report_are_refused():
    whole = Report("ping", 3, [(Sent(topics.WINCH_MODE, "ping", 3000, 4), b"one")]).to_bytes()
    texts = (b"[]", b"{}", b"[1,2]", b'["a",1,[[1]],[],[]]', b"nonsense")
    for data in (b"", *(bytes((len(t), 0, 0, 0)) + t for t in texts), whole[:-1], whole[:9]):
        for kind in (Report, Release):
            with pytest.raises(ValueError):  # noqa: PT011 - JSON's own or ours
                kind.from_bytes(data)


def test_all_processes_notice_that_the_clock_went_back():
    net = Net(5)
    _, ping, pong = apart(net)
    net.run(50)
    clock = net.processes["clock"].host["clock"]
    assert isinstance(clock, Clock)
    clock.reset()
    net.run(100)
    assert len(ping.jumps) == 1
    assert pong.modes == ["hold", "fault"]
    assert len(ping.answers) >= 8


@pytest.mark.parametrize("paused", [False, True])
def test_what_is_sent_at_time_zero_is_received(paused: bool):
    host = LoopHost(Delays(1), order=ORDER)
    clock, ping, pong = host.start(Clock), host.start(Ping), host.start(Pong)
    host.run(0.5)
    clock.reset()
    clock.paused = paused
    for _ in range(5):
        host.tick()
    assert len(ping.jumps) == 1
    assert pong.modes == ["hold", "fault"]


def test_the_wall_clock_runs_while_time_is_paused():
    host, records = LoopHost(Delays(1), order=ORDER), Record()
    record(host, records)
    clock = host.start(Clock)
    for paused in (False, True):
        clock.paused = paused
        records.clear()
        for _ in range(400):
            host.tick()
        assert len([name for name, *_ in records if name == topics.DIAGNOSTICS]) == 4


def test_a_component_that_is_configured_again_gets_what_others_have_sent():
    net = Net(6)
    _, _, pong = apart(net)
    net.run(50)
    pong.clean_up()
    pong.configure()
    assert pong.modes == []
    pong.activate()
    net.run(60)
    assert pong.modes == ["hold"]


def test_a_process_that_comes_back_delivers_what_its_components_had_sent():
    host = LoopHost(Delays(1), order=ORDER)
    ping, pong = host.start(Ping), host.start(Pong)
    host.run(0.1)
    ping.clock_jumped()
    host.exchange.restart_at(host.exchange.ticks + 500)
    host.run(0.1)
    assert pong.modes == ["hold", "fault"]
