"""The loop host: what components send is received later, in one order, the same in each run."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from dataclasses import dataclass
from functools import partial
from unittest.mock import Mock

import pytest

from msg_schemas import machine, qos, topics
from msg_schemas.events import EventName, EventReport
from msg_schemas.parameters import ParameterError, parameter
from msg_schemas.refusal import Refusal, RefusalCode, read_refusal
from msg_schemas.samples import JointSample, JointValue, Level, Sample, StatusSample, TextSample
from rover_runtime.component import Component
from rover_runtime.delays import Delays
from rover_runtime.loop_host import LoopHost, ServiceResponse
from rover_runtime.worker_process import WorkFailed

TICK = 0.01
ONE_TICK = Delays(ticks=(1,))


@dataclass(frozen=True)
class SourceParameters:
    """Rate of the source."""

    rate: float = parameter(100.0, "Hz", "of the commands", 1.0, 100.0)


class SourceEvent(EventName):
    """Events of the source."""

    ANSWERED = "answered", Level.OK, "the service has answered", "text", "at"


class Source(Component):
    """Commands the nut, and aborts when told to."""

    NAME = "source"
    PARAMETERS = (SourceParameters,)

    def setup(self) -> None:
        self.sent: list[int] = []
        self.stopped = False
        self._command = self.publisher(topics.JUMP_MOTOR_COMMAND)
        self._mode = self.publisher(topics.WINCH_MODE)

    def start(self) -> None:
        self.set_mode("hold")
        self.every(1.0 / self.parameters_of(SourceParameters).rate, self._step)

    def stop(self) -> None:
        self.stopped = True

    def _step(self) -> None:
        self.sent.append(self.now_ns())
        self.command(0.1)

    def command(self, position: float) -> None:
        self._command.send(
            JointSample(self.now_ns(), {machine.JUMP_SCREW: JointValue(position, 0.1, 1.0)})
        )

    def set_mode(self, mode: str) -> None:
        self._mode.send(TextSample(mode))

    def abort(self) -> bool:
        return self.call_service(topics.JUMP_ABORT, self._on_answer)

    def _on_answer(self, success: bool, text: str) -> None:
        values = {"text": f"{success} {text}", "at": self.now_ns()}
        self.event(EventReport(SourceEvent.ANSWERED, "answered", values))


class Sink(Component):
    """Receives the commands."""

    NAME = "sink"

    def setup(self) -> None:
        self.received: list[tuple[int, int]] = []  # stamp and time of reception [ns]
        self.modes: list[str] = []
        self.subscribe(topics.JUMP_MOTOR_COMMAND, self._on_command)
        self.subscribe(topics.WINCH_MODE, lambda sample: self.modes.append(sample.text))
        self.serve(topics.JUMP_ABORT, self._on_abort)
        self.serve(topics.SIM_PAUSE, lambda pause: (True, f"pause is {pause}"))

    def _on_command(self, sample: JointSample) -> None:
        self.received.append((sample.stamp_ns, self.now_ns()))

    def _on_abort(self) -> tuple[bool, str]:
        return True, f"aborted at {self.now_ns()}"


def pair(delays: Delays = ONE_TICK, **parameters: object) -> tuple[LoopHost, Source, Sink]:
    host = LoopHost(delays, TICK)
    return host, host.start(Source, parameters), host.start(Sink)


def hops(sink: Sink) -> list[int]:
    return [round((received - sent) * 1e-9 / TICK) for sent, received in sink.received]


def test_it_needs_no_ros():
    code = (
        "import sys, rover_runtime.loop_host, rover_launch.loop, rover_sim.node.sim_node, "
        "rover_control.mission.mission_node, rover_control.hanging.descent_node, "
        "rover_control.drive.drive_node, "
        "rover_control.jump.jump_node, tether_winch.winch_node, rover_view.view_node; "
        "sys.exit('rclpy' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_message_is_received_one_tick_later():
    host, source, sink = pair()
    host.run(1.0)
    assert len(source.sent) == 99
    assert [stamp for stamp, _ in sink.received] == source.sent[:-1]
    assert set(hops(sink)) == {1}


def test_one_hop_in_ten_takes_two_ticks_and_none_overtakes():
    host, _, sink = pair(Delays(seed=3))
    host.run(20.0)
    late = sum(hop == 2 for hop in hops(sink)) / len(sink.received)
    assert late == pytest.approx(0.1, abs=0.03)
    assert set(hops(sink)) == {1, 2}
    assert [stamp for stamp, _ in sink.received] == sorted(stamp for stamp, _ in sink.received)


def test_the_seed_decides_the_delays():
    flown = []
    for seed in (1, 1, 2):
        host, _, sink = pair(Delays(seed=seed))
        host.run(2.0)
        flown.append(sink.received)
    assert flown[0] == flown[1] != flown[2]


def test_long_delays_keep_the_order():
    host, _, sink = pair(Delays(ticks=(3, 4, 5, 6, 7)))
    host.run(5.0)
    assert min(hops(sink)) == 3
    assert max(hops(sink)) == 7
    stamps = [stamp for stamp, _ in sink.received]
    assert stamps == sorted(stamps)
    assert len(stamps) > 480


def test_an_impaired_topic_is_received_as_it_is_changed():
    host, source, sink = pair()
    host.run(0.1)
    received, sent = len(sink.received), len(source.sent)
    host.exchange.impair(topics.JUMP_MOTOR_COMMAND, lambda _: None)
    host.run(0.1)
    assert len(source.sent) == sent + 10
    assert len(sink.received) == received + 1  # it was under way
    refused: list[str] = []

    def on_diagnostics(_topic: str, sample: Sample, _sender: str, _now_ns: int) -> None:
        assert isinstance(sample, StatusSample)
        refused.extend(s.message for s in sample.statuses if read_refusal(s) is not None)

    host.exchange.listen(on_diagnostics, topics.DIAGNOSTICS)
    wrong = JointValue(math.nan, 0.1, 1.0)
    host.exchange.impair(
        topics.JUMP_MOTOR_COMMAND,
        lambda sample: JointSample(sample.stamp_ns, {machine.JUMP_SCREW: wrong}),
    )
    host.run(0.1)
    assert len(sink.received) == received + 1
    assert "nan" in refused[0]
    host.exchange.impair(topics.JUMP_MOTOR_COMMAND, None)
    host.run(0.1)
    assert len(sink.received) == received + 10


def test_no_delay_below_a_tick():
    with pytest.raises(ValueError, match="at least 1"):
        Delays(ticks=(0, 1))


def test_a_late_joiner_gets_the_latched_text():
    host = LoopHost(ONE_TICK, TICK)
    host.start(Source)
    host.run(0.5)
    sink = host.start(Sink)
    host.run(0.05)
    assert sink.modes == ["hold"]


class Reader(Component):
    """Receives the configuration of every node."""

    NAME = "mission_node"  # which may

    def setup(self) -> None:
        self.names: list[str] = []
        self.subscribe(topics.CONFIG, self._on_configuration, depth=qos.LATCHED_NODES)

    def _on_configuration(self, sample: TextSample) -> None:
        self.names.append(json.loads(sample.text)["node"])


def test_an_inactive_component_keeps_the_latched_texts_of_all_publishers():
    host, _, _ = pair()
    host.run(0.1)
    reader = host.start(Reader)
    reader.deactivate()
    host.run(0.1)
    assert reader.names == []
    reader.activate()
    assert sorted(reader.names) == ["/mission_node", "/sink", "/source"]


def test_an_inactive_component_keeps_only_the_last_text_of_one_publisher():
    host, source, sink = pair()
    host.run(0.1)
    sink.deactivate()
    for mode in ("tension", "length"):
        source.set_mode(mode)
        host.run(0.05)
    assert sink.modes == ["hold"]
    sink.activate()
    assert sink.modes == ["hold", "length"]


def test_a_service_answers_two_hops_later():
    host, source, _ = pair()
    host.run(0.1)
    events: list[Sample] = []
    host.exchange.listen(lambda _name, sample, _sender, _now: events.append(sample), topics.EVENTS)
    called_ns = host.now_ns()
    assert source.abort()
    host.run(0.1)
    (answered,) = events
    assert isinstance(answered, StatusSample)
    values = answered.statuses[0].values
    assert values["text"] == f"True aborted at {called_ns + 10_000_000}"
    assert int(values["at"]) == called_ns + 20_000_000


def test_a_request_from_outside_and_one_without_a_server():
    host, _, _ = pair()
    host.run(0.1)
    response = host.call(topics.SIM_PAUSE, True)
    assert response.success is None
    host.run(0.1)
    assert response == ServiceResponse(True, "pause is True")
    with pytest.raises(Refusal) as found:
        host.call(topics.DRIVE_STOP)
    assert found.value.code is RefusalCode.NOT_ACTIVE


def test_admission_applies_as_over_dds():
    host, source, sink = pair()
    refused: list[str] = []

    def listen(_name: str, sample: Sample, _sender: str, _now: int) -> None:
        assert isinstance(sample, StatusSample)
        refused.extend(s.values["code"] for s in sample.statuses if "code" in s.values)

    host.exchange.listen(listen, topics.DIAGNOSTICS)
    host.run(0.1)
    stroke = JointSample(host.now_ns(), {machine.JUMP_SCREW: JointValue(0.2, 0.1, 1.0)})
    host.request(topics.JUMP_MOTOR_COMMAND, stroke, "somebody")
    host.run(0.1)
    assert refused == [RefusalCode.OWNED.value]
    assert len(sink.received) == len(source.sent) - 1


def test_a_sample_that_breaks_the_contract_is_not_sent():
    host, source, sink = pair()
    host.run(0.1)
    before = len(sink.received)
    source.command(float("nan"))
    host.tick()
    host.tick()
    assert len(sink.received) == before + 2
    wrong = JointSample(host.now_ns(), {machine.JUMP_STROKE: JointValue(0.1)})
    with pytest.raises(Refusal):
        host.request(topics.JUMP_MOTOR_COMMAND, wrong)


def test_kill_and_restart():
    host, source, sink = pair()
    host.run(0.5)
    host.kill("source")
    assert not source.stopped
    received = len(sink.received)
    host.run(1.0)
    assert len(sink.received) == received + 1  # one was under way
    again = host.start(Source)
    host.run(0.1)
    assert again is not source
    assert len(sink.received) > received + 5


def test_stop_leaves_the_actuators_safe():
    host, source, _ = pair()
    host.run(0.1)
    host.stop("source")
    assert source.stopped
    assert host.names == ("sink",)


def test_a_frozen_component_gets_what_its_queue_kept():
    host, source, sink = pair()
    host.run(0.5)
    host.freeze("sink")
    before = len(sink.received)
    host.run(0.5)
    assert len(sink.received) == before
    host.thaw("sink")
    # A queue of commands keeps ten; they are stale by then, but the last ones.
    stamps = [stamp for stamp, _ in sink.received[before:]]
    assert stamps == [t for t in source.sent[:-1] if t in stamps]
    assert 0 < len(stamps) <= 10


def test_a_frozen_source_of_messages_is_silent():
    host, source, sink = pair()
    host.run(0.5)
    host.freeze("source")
    before = len(source.sent)
    host.run(0.5)
    assert len(source.sent) == before
    assert len(sink.received) == before


def test_work_ends_after_its_simulated_duration():
    host, source, _ = pair()
    host.run(0.1)
    work = source.work(0.25, partial(divmod, 127, 3))
    assert not work.done()
    assert host.run(1.0, work.done)
    assert host.time == pytest.approx(0.35)
    assert work.result() == (42, 1)
    failed = source.work(0.0, partial(divmod, 1, 0))
    assert failed.done()
    with pytest.raises(WorkFailed, match="ZeroDivisionError: integer"):
        failed.result()


def test_the_source_of_time_runs_in_bursts():
    pacer = LoopHost().time_stepper(Mock(), Mock(), 1.0).pacer
    pacer.wait(0.0, 0)
    waits = [pacer.wait(0.0, ticks * 10_000_000) for ticks in (1, 4, 5)]
    assert waits == pytest.approx([0.0, 0.0, 0.05])


def test_parameters_are_checked():
    host = LoopHost()
    with pytest.raises(ParameterError, match="rate"):
        host.start(Source, {"rate": -1.0})
    with pytest.raises(ParameterError, match="no parameter ratio"):
        host.start(Source, {"ratio": 1.0})
    assert host.names == ()


def test_one_name_runs_once():
    host, _, _ = pair()
    with pytest.raises(ValueError, match="runs already"):
        host.start(Source)


@pytest.mark.parametrize("ends", ["kill", "freeze"])
def test_a_component_that_has_ended_or_is_frozen_processes_no_answer(ends: str):
    host, source, _ = pair()
    host.run(0.1)
    events: list[Sample] = []
    host.exchange.listen(lambda _name, sample, _sender, _now: events.append(sample), topics.EVENTS)
    source.abort()
    host.tick()
    host.tick()  # the answer is on its way
    getattr(host, ends)("source")
    host.run(0.1)
    assert not events
    if ends == "freeze":
        host.thaw("source")
        host.run(0.1)
        assert len(events) == 1


class Reacting(Source):
    """Records what it reacts to."""

    def setup(self) -> None:
        super().setup()
        self.reactions: list[str] = []

    def parameters_changed(self) -> None:
        self.reactions.append(f"rate {self.parameters_of(SourceParameters).rate:g}")

    def clock_jumped(self) -> None:
        self.reactions.append("clock")


def test_a_component_reacts_to_a_change_once_it_is_active():
    host = LoopHost(ONE_TICK, TICK)
    source = host.start(Reacting)
    source.change_parameters({"rate": 20.0})
    assert source.reactions == ["rate 20"]
    source.deactivate()
    source.change_parameters({"rate": 30.0})
    source.change_parameters({"rate": 40.0})
    source.clock_went_back()
    assert source.reactions == ["rate 20"]
    source.activate()
    assert source.reactions == ["rate 20", "rate 40", "clock"]
    source.deactivate()
    source.activate()
    assert len(source.reactions) == 3


class Failing(Source):
    """Fails to start, or to stop, after its timers run."""

    def start(self) -> None:
        super().start()
        raise OSError("no start")

    def stop(self) -> None:
        raise OSError("no stop")


def test_a_failed_activation_leaves_a_component_inactive():
    host = LoopHost(ONE_TICK, TICK)
    source = host.add(Failing, {SourceParameters: SourceParameters()})
    source.configure()
    with pytest.raises(OSError, match="no start"):
        source.activate()
    host.run(0.5)
    assert not source.active
    assert source.sent == []


def test_a_failed_stop_leaves_a_component_inactive():
    host = LoopHost(ONE_TICK, TICK)
    source = host.add(Failing, {SourceParameters: SourceParameters()})
    source.configure()
    source.active = True
    with pytest.raises(OSError, match="no stop"):
        source.deactivate()
    assert not source.active
