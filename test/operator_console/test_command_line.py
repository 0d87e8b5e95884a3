"""The command `rover`: arguments, exit codes and messages."""

import io
import json
import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from contract_bag import MadeUp

from msg_schemas import machine, topics
from msg_schemas.cdr import pack
from msg_schemas.phases import WinchMode
from msg_schemas.samples import Level, Status, StatusSample, TextSample
from msg_schemas.table import TOPICS
from operator_console.command_line import Exit, TerminalSession, main, make_parser
from operator_console.commands import COMMANDS, Order
from operator_console.exchange import Exchange, OrderResult, OrderStatus, SentOrder
from operator_console.telemetry import Telemetry
from rover_bags.files.store import BagWriter, standard_type
from rover_verify.harness import NodeHarness, Process

PATIENCE = "60"


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        (["descend", "nan"], "depth = nan: should be a number at least 0 and at most 1000 m"),
        (["ascend", "-1"], "depth = -1.0: should be a number at least 0"),
        (["payout", "3", "--rate", "0.6"], "rate = 0.6: should be .* at most 0.5 m/s"),
        (["jump", "0.3m"], "stroke = '0.3m': should be a number at least 0.005"),
        (["descend", "1_2"], "depth = '1_2': should be a number at least 0"),
        (["turn", "-1e3"], "angle = -1000.0: should be a number at least -180"),
    ],
)
def test_bad_arguments_are_refused_before_anything_is_sent(
    given: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
):
    assert main(given) == Exit.BAD_ARGUMENTS
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(f"rover {given[0]}: ")
    assert re.search(complaint, printed.err)


def test_the_state_in_a_bag_is_shown_without_a_node(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    made = MadeUp()
    made.add(1.0, topics.WINCH_MODE, TextSample(WinchMode.HOLD))
    made.write(tmp_path / "bag")
    assert main(["status", "--bag", str(tmp_path / "bag"), "--json"]) == Exit.DONE
    shown = json.loads(capsys.readouterr().out)
    assert {each["key"]: each["value"] for each in shown["phases"]}["winch"] == WinchMode.HOLD
    assert main(["status", "--bag", str(tmp_path / "no_bag")]) == Exit.BAD_ARGUMENTS
    assert "no_bag" in capsys.readouterr().err
    assert main(["status", "--bag", "x" * 300]) == Exit.BAD_ARGUMENTS
    assert re.fullmatch("rover: x+: File name too long\n", capsys.readouterr().err)


@pytest.mark.parametrize("at", ["0", "1.79e9"])
def test_any_time_of_a_bag_may_be_requested(tmp_path: Path, at: str):
    made = MadeUp()
    made.add(0.0, topics.WINCH_MODE, TextSample(WinchMode.HOLD))
    made.write(tmp_path / "bag")
    assert main(["status", "--bag", str(tmp_path / "bag"), "--at", at]) == Exit.DONE


@pytest.mark.parametrize(
    ("output", "printed"),
    [("ended", ""), ("full", "rover: the output cannot be written: No space left on device\n")],
)
def test_output_that_cannot_be_written_is_reported_by_the_exit_code(
    tmp_path: Path, output: str, printed: str
):
    made = MadeUp()
    made.add(1.0, topics.WINCH_MODE, TextSample(WinchMode.HOLD))
    made.write(tmp_path / "bag")
    command = [sys.executable, "-m", "operator_console.command_line", "status", "--bag"]
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "wb") as ended, Path("/dev/full").open("wb") as full:
        stdout = full if output == "full" else ended
        done = subprocess.run(
            [*command, str(tmp_path / "bag")], stdout=stdout, stderr=subprocess.PIPE, check=False
        )
    assert (done.returncode, done.stderr.decode()) == (Exit.CRASHED, printed)


class FakeLink:
    """Answers each order with one status, and records what is undone."""

    def __init__(self, status: OrderStatus) -> None:
        self.status = status
        self.undone: list[str] = []

    def __getattr__(self, name: str) -> Any:
        return {
            "with_defaults": lambda _command, given, *_: given,
            "follow": lambda *_: None,
            "unreported": lambda: ["mission_node"],
            "snapshot": lambda: Telemetry().snapshot(0.0),
        }.get(name, lambda *_: True)

    def send(self, order: Order, *_: object) -> SentOrder:
        result = OrderResult(self.status, order.command.name, "as it is")
        return SentOrder(order, result, Exchange(order) if order.command.request else None)

    def undo(self, order: Order, *_: object) -> SentOrder:
        self.undone.append(order.command.undo)
        return self.send(COMMANDS[order.command.undo].order({}))


def test_a_motion_stops_where_its_progress_cannot_be_written(monkeypatch: pytest.MonkeyPatch):
    session = TerminalSession(
        make_parser().parse_args(["descend", "3", "--wait"]), threading.Event()
    )
    link: Any = FakeLink(OrderStatus.ACCEPTED)
    with Path("/dev/full").open("w") as full:
        monkeypatch.setattr(sys, "stdout", full)
        assert session.order(link, COMMANDS["descend"], {"depth": 3.0}) == Exit.INTERRUPTED
    assert link.undone == ["hold"]


@pytest.mark.parametrize(
    ("status", "undone"), [(OrderStatus.NO_ANSWER, ["hold"]), (OrderStatus.CANCELLED, [])]
)
def test_ctrl_c_before_the_answer_to_a_call_stops_what_was_sent(
    status: OrderStatus, undone: list[str]
):
    stop = threading.Event()
    stop.set()
    session = TerminalSession(make_parser().parse_args(["relax"]), stop)
    link: Any = FakeLink(status)
    assert session.order(link, COMMANDS["relax"], {}) == Exit.INTERRUPTED
    assert link.undone == undone


def test_a_state_without_the_report_of_a_node_is_incomplete(capsys: pytest.CaptureFixture[str]):
    session = TerminalSession(make_parser().parse_args(["status"]), threading.Event())
    link: Any = FakeLink(OrderStatus.ACCEPTED)
    assert session.status(link) == Exit.DONE
    assert "no health report has arrived of mission_node" in capsys.readouterr().err


def test_characters_that_the_terminal_lacks_are_escaped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    event = Status("moved", "by J\u00fcrgen", Level.OK, "winch_node", {})
    made = MadeUp()
    made.add(1.0, topics.EVENTS, StatusSample(0, (event,)))
    made.write(tmp_path / "bag")
    output = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(output, encoding="ascii"))
    assert main(["status", "--bag", str(tmp_path / "bag")]) == Exit.DONE
    assert rb"by J\xfcrgen" in output.getvalue()


def test_a_signal_that_comes_twice_at_once_is_one_and_a_later_one_ends_the_command():
    program = """
import os, signal, threading
from operator_console.command_line import _handle_signals
stop = threading.Event()
_handle_signals(stop)
for _ in range(2):
    os.kill(os.getpid(), signal.{name})
assert stop.is_set()
print("stops", flush=True)
while True:  # until one counts as a later one
    os.kill(os.getpid(), signal.{name})
"""
    for name in ("SIGINT", "SIGTERM"):
        done = subprocess.run(
            [sys.executable, "-c", program.format(name=name)],
            capture_output=True, text=True, check=False, timeout=60.0,
        )  # fmt: skip
        assert (done.returncode, done.stdout) == (-signal.SIGINT, "stops\n")
        assert "a motion may continue" in done.stderr


def test_ctrl_c_while_a_default_is_awaited_interrupts():
    stop = threading.Event()
    stop.set()
    session = TerminalSession(make_parser().parse_args(["ascend"]), stop)
    link: Any = SimpleNamespace(with_defaults=lambda _command, given, *_: given)
    assert session.order(link, COMMANDS["ascend"], {}) == Exit.INTERRUPTED


@pytest.mark.parametrize(("rover", "shown"), [("/rover1", "hold"), ("rover2", "stop")])
def test_of_several_rovers_in_a_bag_that_of_the_namespace_is_shown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], rover: str, shown: str
):
    kind = standard_type(TOPICS[topics.WINCH_MODE].message)
    with BagWriter(tmp_path / "bag", sync=False) as writer:
        for name, mode in (("/rover1", WinchMode.HOLD), ("/rover2", WinchMode.STOP)):
            data = pack(topics.WINCH_MODE, TextSample(mode))
            writer.write(writer.add_topic(f"{name}/{topics.WINCH_MODE}", kind), 1, 1, data)
    given = ["status", "--bag", str(tmp_path / "bag"), "--namespace", rover, "--json"]
    assert main(given) == Exit.DONE
    phases = json.loads(capsys.readouterr().out)["phases"]
    assert {each["key"]: each["value"] for each in phases}["winch"] == shown


@pytest.mark.parametrize(
    "given",
    [
        ["fly"],
        [],
        ["descend"],
        ["status", "--at", "3"],
        ["hold", "3"],
        ["arm", "--timeout", "0"],
        ["mission"],
    ],
)
def test_an_unknown_command_is_refused(given: list[str], capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as ended:
        main(given)
    assert ended.value.code == Exit.BAD_ARGUMENTS
    assert "usage: rover" in capsys.readouterr().err


def test_help_lists_every_command_and_exit_code():
    text = make_parser().format_help()
    assert all(f"    {name.partition('-')[0]} " in text for name in COMMANDS)
    assert all(f"  {int(code)}  " in text for code in Exit)


@pytest.mark.process
@pytest.mark.slow
@pytest.mark.ros
def test_an_operator_gets_the_result_of_each_order(harness: NodeHarness):
    # Slow simulated time and long timeouts: a busy computer must not brake the winch.
    patient = {
        "use_sim_time": True, "max_step_delay": 5.0, "command_timeout": 30.0,
        "encoder_timeout": 1.0, "load_cell_timeout": 10.0,
    }  # fmt: skip
    slow = {"scenario": "free_hang", "real_time_factor": 0.5}

    def rover(*given: str) -> Process:
        return harness.processes.start("operator_console.command_line", None, *given)

    def result_of(*given: str) -> tuple[int, dict[str, Any]]:
        process = rover(*given, "--json", "--timeout", PATIENCE)
        code = process.wait()
        return code, json.loads(process.output.splitlines()[-1])

    unavailable = rover("payout", "20", "--timeout", "0.5")
    assert unavailable.wait() == Exit.UNAVAILABLE
    assert "winch_node does not run in the namespace /" in unavailable.output

    harness.processes.start("rover_sim.node.mock_plant_node", slow)
    harness.processes.start("tether_winch.winch_node", patient)
    observer = harness.observer()
    observer.wait_until_ready("winch_node")
    start = observer.listen(topics.WINCH_STATE).wait().joints[machine.WINCH_DRUM].position

    code, refused = result_of("payout", str(start + 0.2))
    assert (code, refused["status"], refused["code"]) == (Exit.REFUSED, "refused", "not_armed")
    assert "winch/rearm arms it" in refused["reason"]
    code, armed = result_of("arm")
    assert (code, armed["status"]) == (Exit.DONE, "accepted")

    code, done = result_of("payout", str(start + 0.2), "--wait")
    assert (code, done["completion"]["is_done"]) == (Exit.DONE, True)
    there = observer.listen(topics.WINCH_STATE).last.joints[machine.WINCH_DRUM].position
    assert there == pytest.approx(start + 0.2, abs=0.05)

    # A signal during a motion, also of a terminal that closes: the command stops the motion first.
    for number in (signal.SIGINT, signal.SIGHUP):
        jog = rover("jog", "0.02", "--timeout", PATIENCE)
        jog.wait_for_output("renewed until Ctrl-C")
        observer.wait_for_text(topics.WINCH_MODE, WinchMode.RATE)
        assert jog.stop(number) == Exit.DONE
        assert "hold: accepted by winch/hold" in jog.output
        assert re.search("at rest; .*winch hold", jog.output)

    # A mission lasts beyond its acceptance, until another command holds it.
    harness.processes.start(
        "rover_control.mission.mission_node", {"use_sim_time": True, "checkpoint": "none"}
    )
    observer.wait_until_ready("mission_node")
    mission = rover("mission", "go", "--wait", "--timeout", PATIENCE)
    mission.wait_for_output("mission_leg_started")
    assert result_of("mission", "hold")[0] == Exit.DONE
    assert mission.wait() == Exit.NOT_DONE
    assert re.search("NOT done: superseded: .*hold", mission.output)


COMPLETE = """
eval "$(register-python-argcomplete rover)"
COMP_WORDS=({words}); COMP_CWORD={at}; COMP_LINE="{words}"; COMP_POINT=${{#COMP_LINE}}; COMP_TYPE=9
_python_argcomplete rover
echo "${{COMPREPLY[@]}}"
"""


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("rover de", {"descend"}),
        ("rover d", {"descend", "disarm", "drive"}),
        ("rover jump --w", {"--wait"}),
    ],
)
def test_the_shell_completes_commands_and_options(words: str, offered: set[str]):
    own = Path(sys.executable).parent
    if not all((own / name).exists() for name in ("rover", "register-python-argcomplete")):
        pytest.skip("neither is installed beside this Python")
    given = {**os.environ, "PATH": f"{own}:{os.environ['PATH']}"}
    script = COMPLETE.format(words=words, at=len(words.split()) - 1)
    done = subprocess.run(
        ["bash", "-c", script], env=given, capture_output=True, text=True, check=True
    )
    assert set(done.stdout.split()) == offered
