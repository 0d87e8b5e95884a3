"""The shell of every node, seen from outside: a real process, commanded over DDS."""

from __future__ import annotations

import json
import math
import os
import re
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from ros_messages import message_of
from shell_node import ShellEvent

from msg_schemas import machine, topics
from msg_schemas.cdr import pack
from msg_schemas.events import NodeEvent
from msg_schemas.health import Health, read_health
from msg_schemas.phases import HealthState, WinchMode
from msg_schemas.samples import ClockSample, JointSample, JointValue, Level, Status, TextSample

if TYPE_CHECKING:
    from rover_verify.harness import NodeHarness, Observer, Process, Processes

    Shell = tuple[Process, Observer]
    MakeMessage = Callable[[], Any]

pytestmark = [pytest.mark.ros, pytest.mark.process]

NODE = "shell_node"
COMMAND = topics.JUMP_MOTOR_COMMAND
SECOND = 1_000_000_000


def is_active(observer: Observer):
    observer.wait_for_event(NodeEvent.ACTIVE)


def command(
    position: float = 0.1,
    velocity: float = 0.05,
    effort: float = 200.0,
    stamp_ns: int | None = None,
) -> JointSample:
    stamp = time.time_ns() if stamp_ns is None else stamp_ns
    return JointSample(stamp, {machine.JUMP_SCREW: JointValue(position, velocity, effort)})


@pytest.fixture(scope="module")
def shell(shared_harness: NodeHarness):
    """A running node and an observer, shared by tests that leave no trace."""
    process = shared_harness.processes.start("shell_node")
    observer = shared_harness.observer()
    is_active(observer)
    observer.listen(topics.JUMP_MOTOR_STATE)
    observer.listen(topics.DIAGNOSTICS).wait()
    return process, observer


# ------------------------------------------------------------------- commands and their refusals


def command_and_observe(observer: Observer, position: float):
    """Whether a good command still goes through."""
    feed = observer.listen(topics.JUMP_MOTOR_STATE)
    feed.wait(since=len(feed))  # it publishes unprompted: its endpoint is matched
    observer.publisher(COMMAND)  # and it receives ours; only then take the stamp
    observer.send(COMMAND, command(position))
    return feed.wait(lambda s: s.joints[machine.JUMP_SCREW].position == position)


def test_a_good_command_is_handed_over(shell: Shell):
    _, observer = shell
    assert command_and_observe(observer, 0.123).joints[machine.JUMP_SCREW] == JointValue(
        0.123, 0.05, 200.0
    )


def bad_messages() -> list[Any]:
    def with_(change: Callable[[Any], object]) -> MakeMessage:
        def make() -> Any:
            message = message_of(COMMAND, command())
            change(message)
            return message

        return make

    def stamp(seconds: int) -> Callable[[Any], object]:
        def change(message: Any) -> None:
            message.header.stamp.sec += seconds

        return change

    def unstamp(message: Any) -> None:
        message.header.stamp.sec = message.header.stamp.nanosec = 0

    cases: dict[str, tuple[str, str, Callable[[Any], object]]] = {
        "nan": ("not_finite", "nan", lambda m: m.position.__setitem__(0, math.nan)),
        "infinite": ("not_finite", "inf", lambda m: m.velocity.__setitem__(0, -math.inf)),
        "too far": ("out_of_limits", "0.5", lambda m: m.position.__setitem__(0, 0.5)),
        "wrong joint": ("wrong_name", "winch", lambda m: m.name.__setitem__(0, "winch")),
        "joint twice": ("wrong_name", "each once", lambda m: m.name.append(machine.JUMP_SCREW)),
        "too short": ("wrong_length", "position", lambda m: m.position.pop()),
        "too long": ("wrong_length", "effort", lambda m: m.effort.append(1.0)),
        "stale": ("stale", "at most 0.5 s", stamp(-2)),
        "future": ("from_the_future", "at most 0.1 s", stamp(+2)),
        "unstamped": ("unstamped", "stamp is zero", unstamp),
        "the node's own reason": (
            "wrong_phase",
            "only up to 0.3 m",
            lambda m: m.position.__setitem__(0, 0.35),
        ),
    }
    return [
        pytest.param(with_(change), code, words, id=name)
        for name, (code, words, change) in cases.items()
    ]


@pytest.mark.parametrize(("message", "code", "words"), bad_messages())
def test_a_bad_command_is_refused_with_its_reason_and_the_node_lives_on(
    shell: Shell, message: MakeMessage, code: str, words: str
):
    process, observer = shell
    received = len(observer.listen(topics.DIAGNOSTICS))
    observer.publisher(COMMAND).publish(message())
    refusal = observer.wait_for_refusal(COMMAND, code, received)
    assert words in refusal.message
    assert refusal.level is Level.WARN
    assert command_and_observe(observer, 0.2)
    assert process.is_running


def test_an_earlier_stamp_is_refused_an_equal_one_is_not(shell: Shell):
    _, observer = shell
    feed = observer.listen(topics.JUMP_MOTOR_STATE)
    now = time.time_ns()
    observer.send(COMMAND, command(0.11, stamp_ns=now))
    observer.send(COMMAND, command(0.12, stamp_ns=now))
    observer.send(COMMAND, command(0.13, stamp_ns=now - 1000))
    refusal = observer.wait_for_refusal(COMMAND, "out_of_order")
    assert "stamps must not go back" in refusal.message
    feed.wait(lambda s: s.joints[machine.JUMP_SCREW].position == 0.12)
    assert not [s for s in feed.samples if s.joints[machine.JUMP_SCREW].position == 0.13]


def test_bytes_that_are_no_message_are_refused_and_do_no_harm(shell: Shell):
    process, observer = shell
    diagnostics = observer.listen(topics.DIAGNOSTICS)
    publisher, received = observer.publisher(COMMAND), len(diagnostics)
    for payload in (b"\x00\x01\x00\x00", bytes(range(256)), b"\xff" * 64):
        publisher.publish(payload)
    refusal = observer.wait_for_refusal(COMMAND, "malformed", received)
    assert "no sensor_msgs/msg/JointState: " in refusal.message
    assert command_and_observe(observer, 0.21)
    assert process.is_running


def test_a_flood_of_refusals_is_counted_and_not_repeated(shell: Shell):
    _, observer = shell
    feed, publisher = observer.listen(topics.DIAGNOSTICS), observer.publisher(COMMAND)
    received = len(feed)

    def statuses() -> list[Status]:
        return [s for sample in feed.samples[received:] for s in sample.statuses]

    def flooded() -> bool:
        for _ in range(10):
            publisher.publish(pack(COMMAND, command(stamp_ns=1)))
        return any(int(s.values.get("not_shown", "0")) > 0 for s in statuses())

    observer.wait_until(flooded, "no refusal was left out")
    # After the last one all are counted, and the reason is reported.
    publisher.publish(pack(COMMAND, command(stamp_ns=2)))
    assert command_and_observe(observer, 0.22)
    observer.wait_for_status(topics.DIAGNOSTICS, lambda s: s.name == f"{NODE}: node", len(feed))
    reported = [s for s in statuses() if s.values.get("code") == "stale"]
    for status in reported:
        assert "at most 0.5 s" in status.message
    first, last = (int(reported[index].values["refused"]) for index in (0, -1))
    not_shown = sum(int(s.values["not_shown"]) for s in reported)
    assert len(reported) + not_shown == last - first + 1


def test_services_answer_and_refuse_with_the_reason(shell: Shell):
    _, observer = shell
    answer = observer.call(topics.SIM_PAUSE, True)
    assert answer.success
    assert "pause is True" in answer.message
    answer = observer.call(topics.JUMP_ABORT)
    assert not answer.success
    assert "nothing to abort" in answer.message


# ------------------------------------------------------------------------------------ parameters


def test_parameters_are_described_with_unit_and_range(shell: Shell):
    _, observer = shell
    described = observer.describe_parameter(NODE, "rate")
    assert described.description == "how often it speaks [Hz]"
    limits = described.floating_point_range[0]
    assert (limits.from_value, limits.to_value) == (1.0, 100.0)
    assert observer.describe_parameter(NODE, "count").read_only


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("rate", math.nan, "rate"),
        ("use_sim_time", True, "give it then"),
        ("rate", 1e6, "rate"),
        ("rate", "fast", "rate"),
        ("count", 4, "read-only"),
        ("trouble", "much", "one of none, value"),
    ],
)
def test_a_bad_parameter_change_is_refused_with_its_reason(
    shell: Shell, name: str, value: object, reason: str
):
    _, observer = shell
    before = observer.get_parameter(NODE, name)
    result = observer.set_parameter(NODE, name, value)
    assert not result.successful
    assert reason in result.reason
    assert observer.get_parameter(NODE, name) == before


def test_a_good_parameter_change_reaches_the_node_and_its_latched_configuration(shell: Shell):
    _, observer = shell
    config = observer.listen(topics.CONFIG)
    assert observer.set_parameter(NODE, "rate", 20).successful
    config.wait(lambda s: json.loads(s.text)["parameters"]["rate"] == 20.0)
    observer.wait_for_event(ShellEvent.CHANGED)


def test_configuration_and_events_reach_those_who_join_late(
    shared_harness: NodeHarness, shell: Shell
):
    late = shared_harness.observer()
    content = json.loads(late.listen(topics.CONFIG).wait().text)
    assert content["node"] == f"/{NODE}"
    assert content["parameters"]["count"] == 3
    assert content["contract_version"]
    is_active(late)


def test_parameters_come_from_a_file(processes: Processes, observer: Observer, tmp_path: Path):
    path = tmp_path / "shell.yaml"
    path.write_text(f"{NODE}:\n  ros__parameters:\n    rate: 42\n    count: 7\n")
    processes.start("shell_node", params_file=path)
    content = json.loads(observer.listen(topics.CONFIG).wait().text)
    assert content["parameters"] == {
        "autostart": True, "realtime_priority": 0, "lockstep": "", "delay_seed": 1,
        "rate": 42.0, "count": 7, "trouble": "none",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("text", "unknown"),
    [
        ("/**:\n  ros__parameters:\n    rate: 42.0\n    others: 1\n    a: {b: 2}\n", ""),
        (
            "/**:\n  ros__parameters: {rats: 1}\n/**/shell_node:\n  ros__parameters: {rats: 2}",
            "rats",
        ),
        ("/**/shell_node:\n  ros__parameters: {rats: 2}", "rats"),
        ("/*:\n  ros__parameters: {rats: 2}", "rats"),
        ("/**:\n  ros__parameters: {a: 1}\nshell_node:\n  ros__parameters: {b: 2}", "b"),
    ],
    ids=["for all", "for both", "for the node", "for a level", "each"],
)
def test_names_for_all_nodes_may_be_meant_for_others(
    processes: Processes, observer: Observer, tmp_path: Path, text: str, unknown: str
):
    path = tmp_path / "shared.yaml"
    path.write_text(text)
    process = processes.start("shell_node", params_file=path)
    if unknown:
        assert process.wait() == 2
        assert f"unknown parameter {unknown}" in process.output
    else:
        content = json.loads(observer.listen(topics.CONFIG).wait().text)
        assert content["parameters"]["rate"] == 42.0


def test_a_name_on_the_command_line_is_always_the_nodes_own(processes: Processes, tmp_path: Path):
    path = tmp_path / "shared.yaml"
    path.write_text("/**:\n  ros__parameters: {rats: 1}\n")
    process = processes.start("shell_node", {"rats": 3.0}, params_file=path)
    assert process.wait() == 2
    assert "unknown parameter rats" in process.output


# ------------------------------------------------------------------------------------- lifecycle


def test_a_managed_node_acts_only_while_active(processes: Processes, observer: Observer):
    processes.start("shell_node", {"autostart": False})
    assert observer.state_of(NODE) == "unconfigured"
    states = observer.listen(topics.JUMP_MOTOR_STATE)

    assert observer.change_state(NODE, "configure")
    assert observer.state_of(NODE) == "inactive"
    observer.send(COMMAND, command())
    observer.wait_for_refusal(COMMAND, "not_active")
    assert "[not_active]" in observer.call(topics.SIM_PAUSE, True).message
    assert not states.samples
    observer.send(topics.WINCH_MODE, TextSample(WinchMode.HOLD))

    assert observer.change_state(NODE, "activate")
    observer.wait_for_event(ShellEvent.MODE, mode=WinchMode.HOLD)  # of a latched message, once
    assert command_and_observe(observer, 0.2)

    received = len(observer.listen(topics.EVENTS))
    assert observer.change_state(NODE, "deactivate")
    observer.wait_for_event(NodeEvent.INACTIVE, max(0, received - 1))
    silent_since = len(states)
    received = len(observer.listen(topics.DIAGNOSTICS))
    observer.send(COMMAND, command(0.19))
    observer.wait_for_refusal(COMMAND, "not_active", received)
    assert len(states) == silent_since

    assert observer.change_state(NODE, "cleanup")
    assert observer.state_of(NODE) == "unconfigured"
    assert observer.change_state(NODE, "configure")
    assert observer.change_state(NODE, "activate")
    assert command_and_observe(observer, 0.17)


def test_a_failed_configuration_can_be_mended_without_a_restart(
    processes: Processes, observer: Observer
):
    processes.start("shell_node", {"autostart": False, "trouble": "value"})
    assert not observer.change_state(NODE, "configure")
    assert observer.state_of(NODE) == "unconfigured"
    assert observer.node.count_subscribers(f"/{COMMAND}") == 0
    assert observer.set_parameter(NODE, "trouble", "none").successful
    assert observer.change_state(NODE, "configure")
    assert observer.change_state(NODE, "activate")
    assert command_and_observe(observer, 0.2)


# ---------------------------------------------------------------------------------- how it ends


def end_with_sigint(process: Process):
    process.send(signal.SIGINT)


def end_with_two_sigints(process: Process):
    process.send_to_group(signal.SIGINT)
    process.send(signal.SIGINT)


def end_with_sigterm(process: Process):
    process.send(signal.SIGTERM)


def end_with_both(process: Process):
    process.send(signal.SIGTERM)
    process.send(signal.SIGINT)


def end_with_sigints_until_it_is_gone(process: Process):
    while not process.exits_within(0.002):
        process.send(signal.SIGINT)


TERMINATIONS = [
    end_with_sigint,
    end_with_two_sigints,
    end_with_sigints_until_it_is_gone,
    end_with_sigterm,
    end_with_both,
]


@pytest.mark.parametrize("end", TERMINATIONS)
def test_a_signal_ends_it_cleanly(
    processes: Processes, observer: Observer, end: Callable[[Process], None]
):
    process = processes.start("shell_node")
    is_active(observer)
    end(process)
    assert process.wait() == 0
    assert "Traceback" not in process.output
    # Their threads would look at what the process's end destroys.
    assert "0 participants are left" in process.output
    assert process.has_group_exited()
    observer.wait_for_event(NodeEvent.INACTIVE)


def test_a_signal_ends_it_in_the_middle_of_a_long_setup(processes: Processes):
    process = processes.start("shell_node", {"trouble": "slow"})
    process.wait_for_output("setting up")
    assert process.stop(signal.SIGINT, timeout=20.0) == 0
    assert "Traceback" not in process.output


@pytest.mark.parametrize(
    ("parameters", "arguments", "complaint"),
    [
        ({"rate": 0.5}, (), "rate"),
        ({"rate": ".nan"}, (), "rate"),
        ({"rate": "fast"}, (), "rate"),
        ({"count": 3.5}, (), "count"),
        ({"trouble": "much"}, (), "one of none, value"),
        ({"rats": 3.0}, (), "did you mean 'rate'?"),
        ({"use_sim_time": 3}, (), "use_sim_time"),
        ({"trouble": "value"}, (), "the setup found a wrong value"),
        ({}, ("--rate", "3"), "unknown argument '--rate'"),
        ({}, ("--ros-args", "--nonsense"), "ROS arguments not understood"),
        ({}, ("--ros-args", "--params-file", "/nowhere.yaml"), "/nowhere.yaml"),
        ({}, ("--ros-args", "--params-file", "/dev/zero"), "/dev/zero: it is no regular file"),
    ],
)
def test_bad_configuration_ends_it_with_code_2_and_one_line(
    processes: Processes, parameters: dict[str, object], arguments: tuple[str, ...], complaint: str
):
    process = processes.start("shell_node", parameters, *arguments)
    assert process.wait() == 2
    assert "Traceback" not in process.output
    assert [line for line in process.output.splitlines() if complaint in line]


def test_a_parameter_file_that_would_take_minutes_or_never_end_is_refused(
    processes: Processes, tmp_path: Path
):
    os.mkfifo(tmp_path / "fifo.yaml")
    values = "".join(f"    p{number}: {number}\n" for number in range(50_000))
    (tmp_path / "huge.yaml").write_text(f"/**:\n  ros__parameters:\n{values}")
    for name, complaint in (("fifo", "no regular file"), ("huge", "more than 262144 bytes")):
        file = str(tmp_path / f"{name}.yaml")
        process = processes.start("shell_node", {}, "--ros-args", "--params-file", file)
        assert process.wait() == 2
        assert f"--params-file {file}: it " in process.output
        assert complaint in process.output


def test_a_release_that_blocks_ends_the_process_and_shows_where(
    processes: Processes, observer: Observer
):
    process = processes.start("shell_node", {"trouble": "stuck"})
    is_active(observer)
    assert process.stop(signal.SIGINT) == 1
    assert re.search(r'shell_node.py", line \d+ in release$', process.output, re.MULTILINE)
    assert process.has_group_exited()


@pytest.mark.parametrize("trouble", ["bug", "timer"])
def test_a_bug_ends_it_with_code_1(processes: Processes, trouble: str):
    process = processes.start("shell_node", {"trouble": trouble})
    assert process.wait() == 1
    assert "has a bug" in process.output
    assert process.has_group_exited()


def test_help_names_every_parameter_with_unit_and_range(processes: Processes):
    process = processes.start("shell_node", None, "--help")
    assert process.wait() == 0
    assert "rate (default 10.0 Hz): a number at least 1 and at most 100 Hz" in process.output
    assert "autostart" in process.output


# --------------------------------------------------------------------------------- simulated time


def test_it_follows_simulated_time_back_and_forth(processes: Processes, observer: Observer):
    processes.start("shell_node", {"use_sim_time": True})
    is_active(observer)
    states = observer.listen(topics.JUMP_MOTOR_STATE)

    def set_clock(stamp_ns: int) -> None:
        since = len(states)

        def is_published() -> bool:
            observer.send(topics.CLOCK, ClockSample(stamp_ns))  # again, as clocks do
            return any(sample.stamp_ns == stamp_ns for sample in states.samples[since:])

        observer.wait_until(is_published, "no state is published at the stamp of the clock")

    # It does not know the time yet: it takes no command and reports what it waits for.
    observer.wait_for_status(
        topics.DIAGNOSTICS,
        lambda s: read_health(s) == Health(NODE, HealthState.WAITING, (topics.CLOCK,)),
    )
    observer.send(topics.WINCH_MODE, TextSample(WinchMode.HOLD))
    observer.send(COMMAND, command(0.1, stamp_ns=100 * SECOND))
    assert topics.CLOCK in observer.wait_for_refusal(COMMAND, "not_active").message
    answer = observer.call(topics.SIM_PAUSE, True)
    assert not answer.success
    assert topics.CLOCK in answer.message

    reported = [s.name for each in observer.listen(topics.EVENTS).samples for s in each.statuses]
    assert "mode" not in reported

    # A running clock; its timer publishes at the stamps of the clock alone.
    set_clock(100 * SECOND)
    observer.wait_for_event(ShellEvent.MODE, mode=WinchMode.HOLD)  # of a latched message, once
    observer.send(COMMAND, command(0.11, stamp_ns=100 * SECOND))
    states.wait(lambda s: s.joints[machine.JUMP_SCREW].position == 0.11)
    received = len(observer.listen(topics.EVENTS))
    observer.send(topics.CLOCK, ClockSample(5 * SECOND))
    observer.wait_for_event(ShellEvent.CLOCK_JUMPED, received)
    # Stamps of the new past are accepted, those of the old time are not.
    observer.send(COMMAND, command(0.12, stamp_ns=5 * SECOND))
    states.wait(lambda s: s.joints[machine.JUMP_SCREW].position == 0.12)
    observer.send(COMMAND, command(0.13, stamp_ns=100 * SECOND))
    observer.wait_for_refusal(COMMAND, "from_the_future")


def test_a_timer_by_simulated_time_is_called_once_in_each_period(
    processes: Processes, observer: Observer
):
    """However close together the readings of the clock come."""
    processes.start("shell_node", {"use_sim_time": True, "rate": 10.0})
    is_active(observer)
    states = observer.listen(topics.JUMP_MOTOR_STATE)
    since = 0

    def send_clock(*stamps_ns: int) -> None:
        for stamp_ns in stamps_ns:
            observer.send(topics.CLOCK, ClockSample(stamp_ns))

    def is_called() -> bool:
        send_clock(now_ns)  # again: a single message may be lost
        return len(states) > since

    for tenth in range(1, 200):
        now_ns, since = tenth * SECOND // 10, len(states)
        send_clock(now_ns, now_ns + 1, now_ns + 2)
        now_ns += 2
        observer.wait_until(is_called, f"no state is published at {now_ns * 1e-9:g} s")
    periods = [sample.stamp_ns * 10 // SECOND for sample in states.samples]
    assert periods == list(range(1, 200))
