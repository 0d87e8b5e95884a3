"""The node that runs a procedure against a machine and writes a record: `hil rehearse`."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.utilities import get_rmw_implementation_identifier

from msg_schemas import node_process, qos, topics
from msg_schemas.codecs import decode, message_class, to_time, topic_row
from msg_schemas.endpoint_matching import listeners
from msg_schemas.node import READY, ContractNode, ExitCode, package_version
from msg_schemas.parameters import parameter
from msg_schemas.refusal import Refusal
from msg_schemas.ros_arguments import parse_node_arguments
from msg_schemas.samples import StatusSample, TextSample
from msg_schemas.specifications import Intent
from msg_schemas.table import CONTRACT_VERSION, SERVICES, TOPICS
from rover_hil.rehearsal.actions import PARTS
from rover_hil.rehearsal.finding import Verdict
from rover_hil.rehearsal.history import Heard, History
from rover_hil.rehearsal.operator_desk import OperatorDesk
from rover_hil.rehearsal.outcome import Outcome
from rover_hil.rehearsal.procedure import ProcedureError, Written, load_procedure, shipped
from rover_hil.rehearsal.procedure_runner import ProcedureRunner
from rover_hil.rehearsal.recording import Recording
from rover_hil.rehearsal.stand import Answer, CannotDoError, Outgoing
from rover_hil.rehearsal.write_record import write_record

FAILED, INCOMPLETE = 4, 5
"""Exit codes of a rehearsal beyond those of every node: a rule failed; not all could be run."""

_DEEP = 1000  # messages that may wait
_BEAT = 0.02  # of the timer by which the rehearsal knows that it is held up [s]
_BEATS = 60_000  # that are remembered
_STARTING = 60.0  # longest for recorder and clock to come up [s]
_NODE_ANSWERS = 5.0  # longest for parameters [s]
_RECORDER = "bag_record"
EXIT_CODES = (
    "With an emulated machine add --ros-args -p use_sim_time:=true. Exit codes: 0 all passed, 1 "
    "crashed, 2 refused (arguments, procedure, no clock), 4 a rule failed, 5 nothing failed, but "
    "some steps could not run."
)
_ALWAYS_HEARD = (
    topics.CONFIG, topics.EVENTS, topics.DIAGNOSTICS, topics.LINK_STATUS, topics.SIM_STATUS,
)  # fmt: skip


@dataclass(frozen=True)
class RehearsalParameters:
    """What is rehearsed, by whom, and where the record goes."""

    procedure: str = parameter(
        "", "-", "name of a procedure of the package, or path of a .yaml file", read_only=True
    )
    out: str = parameter("", "-", "folder to create for the record; empty = by date and time",
                         read_only=True)  # fmt: skip
    operator: str = parameter("", "-", "who runs it, as it stands in the record", read_only=True)
    machine: str = parameter("", "-", "which machine, as it stands in the record", read_only=True)
    confirm_motion: bool = parameter(
        False, "-", "the area is clear: nobody is asked before the machine may move", read_only=True
    )
    hands: str = parameter(
        "", "-", "program that does what an operator would; empty = the operator is asked",
        read_only=True,
    )  # fmt: skip
    patience: float = parameter(
        3.0, "s", "wall time for which something is awaited beyond its own time", 0.1, 600.0,
        read_only=True,
    )  # fmt: skip
    attempts: int = parameter(
        0, "-", "how often a step is tried at most where the test itself was disturbed; 0 = as the "
        "procedure says", 0, 20, read_only=True,
    )  # fmt: skip
    record: bool = parameter(True, "-", "record a bag", read_only=True)


class _Sending:
    """Messages that go out by a timer."""

    def __init__(self, send: Callable[[], int]) -> None:
        self.count, self.longest, self.last_ns = 0, 0.0, 0
        self._send = send
        self._before: float | None = None
        self._timer: Any = None
        self._lock = threading.Lock()
        self._is_over = False

    def begin(self, make_timer: Callable[[Callable[[], None]], Any]) -> None:
        self._tick()
        self._timer = make_timer(self._tick)

    def _tick(self) -> None:
        with self._lock:
            if self._is_over:
                return
            now = time.monotonic()
            if self._before is not None:
                self.longest = max(self.longest, now - self._before)
            self._before = now
            self.last_ns = self._send()
            self.count += 1

    def stop(self) -> None:
        with self._lock:
            self._is_over = True
        self._timer.cancel()


class RehearsalNode(ContractNode):
    """Runs a written procedure against an emulated or a real machine."""

    NAME = "hil_rehearsal"
    PARAMETERS = (RehearsalParameters,)
    verdict: ClassVar[Verdict | None] = None

    def setup(self) -> None:
        """Read the procedure, make the folder, listen.

        Raises:
            ProcedureError: the procedure is not as it should be.
            ValueError: the folder is there already.
        """
        wanted = self.parameters_of(RehearsalParameters)
        self._written: Written = load_procedure(wanted.procedure)
        stamp = datetime.now().astimezone().strftime("%Y_%m_%d-%H_%M_%S")
        self._folder = Path(wanted.out or f"rehearsal_{stamp}").absolute()
        if self._folder.exists():
            raise ValueError(f"out: {self._folder} is there already, a record is never overwritten")
        self._folder.mkdir(parents=True)
        self.history = History()
        self._ending = threading.Event()
        self._senders: dict[str, Any] = {}
        self._callers: dict[str, Any] = {}
        self._beats: deque[tuple[int, float]] = deque(maxlen=_BEATS)
        self._steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._desk = OperatorDesk(
            wanted.hands, 10.0 * _STARTING, self._ending.is_set,
            sys.stdin if sys.stdin is not None and sys.stdin.isatty() else None,
        )  # fmt: skip
        self._wanted: tuple[str, ...] = ()
        self._heard: dict[str, Any] = {}
        self._on_setpoint()

    def start(self) -> None:
        """Begin the rehearsal, in a thread of its own."""
        self._beat_ns = time.monotonic_ns()
        self.every(_BEAT, self._beat, by_wall_clock=True)
        self._thread = threading.Thread(target=self._guarded, name="rehearsal")
        self._thread.start()

    def stop(self) -> None:
        """End the rehearsal: what was armed is disarmed, and the record is written."""
        self._ending.set()
        while self._thread.is_alive():
            # Its last calls need answers.
            if self.executor is not None:
                self.executor.spin_once(timeout_sec=_BEAT)
            else:
                self._thread.join(_BEAT)

    # --- hearing ---------------------------------------------------------------------------------

    def listen(self, topics: tuple[str, ...]) -> None:
        """Hear these topics from soon on: the executor's thread opens and closes them."""
        self._wanted = topics

    def _on_setpoint(self) -> None:
        wanted = {*_ALWAYS_HEARD, *self._wanted}
        for name in wanted - self._heard.keys():
            self._heard[name] = self._subscription(name)
        for name in self._heard.keys() - wanted:
            self.destroy_subscription(self._heard.pop(name))
            self.history.forget(name)

    def _subscription(self, name: str) -> Any:
        row = topic_row(name)
        return self.create_subscription(
            message_class(row.message),
            name,
            partial(self._hear, name),
            qos.profile(row.intent, _DEEP),
        )

    def _hear(self, name: str, message: Any) -> None:
        if name not in self._heard:
            return  # it was on its way when the topic was closed
        now_ns, steady_ns = self.now_ns(), time.monotonic_ns()
        try:
            sample = decode(name, message)
        except Refusal as refusal:
            self.history.add(name, Heard(now_ns, now_ns, steady_ns, None, str(refusal)))
            return
        stamp_ns = getattr(sample, "stamp_ns", 0) or now_ns
        self.history.add(name, Heard(stamp_ns, now_ns, steady_ns, sample))

    def _beat(self) -> None:
        now_ns = time.monotonic_ns()
        self._beats.append((now_ns, (now_ns - self._beat_ns) * 1e-9 - _BEAT))
        self._beat_ns = now_ns
        self._on_setpoint()

    # --- the stand: see rover_hil.rehearsal.stand ------------------------------------------------

    def steady_ns(self) -> int:
        """The computer's steady clock [ns]."""
        return time.monotonic_ns()

    def wall_ns(self) -> int:
        """The computer's time of day [ns]."""
        return time.time_ns()

    def wait(self, timeout: float) -> None:
        """Let things happen."""
        self._ending.wait(timeout)

    def held_up(self, since_ns: int) -> float:
        """The longest time between two turns of the executor, since then [s]."""
        late = [late for at_ns, late in list(self._beats) if at_ns >= since_ns]
        waiting = (time.monotonic_ns() - self._beat_ns) * 1e-9 - _BEAT
        return max([0.0, waiting, *late])

    def is_offered(self, name: str) -> bool:
        """Whether somebody publishes a topic, takes a command, or serves a service."""
        if name in SERVICES:
            return bool(self._client(name).service_is_ready())
        if TOPICS[name].intent is Intent.COMMAND:
            return self.is_heard(name)
        return bool(self.count_publishers(name))

    def is_heard(self, topic: str) -> bool:
        """Whether somebody listens, besides the recorder."""
        heard = {name for name, _ in listeners(self, self._sender(topic))}
        return bool(heard - {_RECORDER, self.NAME})

    def _sender(self, topic: str) -> Any:
        if topic not in self._senders:
            row = TOPICS[topic]
            self._senders[topic] = self.create_publisher(
                message_class(row.message), topic, qos.profile(row.intent)
            )
        return self._senders[topic]

    def send(self, topic: str, message: Outgoing) -> None:
        """Publish once, as it is: also what the contract forbids."""
        made = message_class(TOPICS[topic].message)()
        made.header.stamp = to_time(message.stamp_ns)
        made.header.frame_id = self.get_fully_qualified_name()  # who commands
        made.name = list(message.joints)
        for part in PARTS:
            values = [getattr(value, part) for value in message.joints.values()]
            setattr(made, part, [] if part == message.omit else values)
        self._sender(topic).publish(made)

    def send_steadily(self, topic: str, make: Callable[[int], Outgoing], period: float) -> _Sending:
        """Publish by a timer of the steady clock."""
        self._sender(topic)

        def send() -> int:
            now_ns = self.now_ns()
            self.send(topic, make(now_ns))
            return now_ns

        sending = _Sending(send)
        sending.begin(lambda tick: self.create_timer(period, tick, clock=self._steady_clock))
        return sending

    def call(self, service: str, data: bool | None, timeout: float) -> Answer:
        """Call a service."""
        kind = message_class(SERVICES[service].service)
        request = kind.Request() if data is None else kind.Request(data=data)
        answer = self._call(self._client(service), service, request, timeout)
        return Answer(bool(answer.success), str(answer.message))

    def _client(self, service: str) -> Any:
        if service not in self._callers:
            kind = message_class(SERVICES[service].service)
            self._callers[service] = self.create_client(kind, service)
        return self._callers[service]

    def _call(self, client: Any, name: str, request: Any, timeout: float) -> Any:
        deadline = time.monotonic() + timeout
        while not client.service_is_ready():
            if time.monotonic() > deadline:
                raise CannotDoError(f"nobody serves {name}")
            threading.Event().wait(_BEAT)
        answered = threading.Event()
        future = client.call_async(request)
        future.add_done_callback(lambda _: answered.set())
        if not answered.wait(max(0.1, deadline - time.monotonic())):
            raise CannotDoError(f"{name} gave no answer in {timeout:g} s")
        return future.result()

    def parameter(self, node: str, name: str) -> object:
        """A parameter's present value."""
        service = f"{node}/get_parameters"
        client = self.create_client(GetParameters, service)
        try:
            answer = self._call(client, service, GetParameters.Request(names=[name]), _NODE_ANSWERS)
        finally:
            self.destroy_client(client)
        if not answer.values or answer.values[0].type == ParameterType.PARAMETER_NOT_SET:
            raise CannotDoError(f"the node {node} has no parameter {name}")
        value: object = parameter_value_to_python(answer.values[0])
        return value

    def set_parameter(self, node: str, name: str, value: object) -> None:
        """Set a parameter."""
        service = f"{node}/set_parameters"
        client = self.create_client(SetParameters, service)
        asked = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        try:
            (answer,) = self._call(client, service, asked, _NODE_ANSWERS).results
        finally:
            self.destroy_client(client)
        if not answer.successful:
            raise CannotDoError(f"{node} refuses {name}: {answer.reason}")

    def ask(self, key: str, what: str) -> None:
        """Have the operator do something."""
        self._desk.do(key, what)

    def question(self, key: str, what: str) -> bool:
        """Ask the operator a question."""
        return self._desk.judge(key, what)

    def tell(self, line: str) -> None:
        """Show how it goes."""
        print(line, flush=True)

    # --- the rehearsal's thread ------------------------------------------------------------------

    def _guarded(self) -> None:
        try:
            self._rehearse()
        except CannotDoError as error:
            print(f"{self.NAME}: {error}", file=sys.stderr, flush=True)
            self.exit_code = ExitCode.BAD_CONFIGURATION
        except Exception:  # noqa: BLE001 - a bug must reach the process, not end here
            traceback.print_exc()
            self.exit_code = ExitCode.CRASH

    def _rehearse(self) -> None:
        wanted = self.parameters_of(RehearsalParameters)
        began = datetime.now().astimezone()
        recording = Recording(self._folder, self.get_namespace()) if wanted.record else None
        try:
            self._wait_for_clock()
            if recording is not None:
                self._wait_for_recorder(recording)
            runner = ProcedureRunner(
                self,
                patience=wanted.patience,
                attempts=wanted.attempts,
                confirmed=wanted.confirm_motion,
                is_over=self._ending.is_set,
            )
            steps, completed = runner.run(self._written.procedure)
        finally:
            note = "no bag was asked for" if recording is None else _closed(recording)
        outcome = Outcome(
            self._written,
            steps,
            completed and (recording is None or not note.startswith("NOT ")),
            self._about(began),
            self._devices(),
            self._configurations(),
            "" if recording is None else recording.bag.name,
            note,
        )
        for path in write_record(outcome, self._folder):
            self.tell(f"wrote {path}")
        RehearsalNode.verdict = outcome.verdict
        self.tell(f"{self._written.name}: {outcome.verdict.value}")
        self.exit_code = ExitCode.OK

    def _wait_for_clock(self) -> None:
        simulated = self.get_parameter("use_sim_time").value
        since = time.monotonic()
        while simulated and not self.now_ns():
            if self._ending.is_set() or time.monotonic() - since > _STARTING:
                raise CannotDoError(
                    "use_sim_time is true, but no clock is heard: is the emulator running?"
                )
            self._ending.wait(_BEAT)
        if not simulated and self.count_publishers(topics.CLOCK):
            raise CannotDoError(
                "somebody publishes simulated time, as an emulated machine does: should be started "
                "with --ros-args -p use_sim_time:=true"
            )

    def _wait_for_recorder(self, recording: Recording) -> None:
        wanted = f"{_RECORDER}: node"
        since = time.monotonic()
        while not any(
            status.name == wanted and status.message == READY
            for heard in self.history.of(topics.DIAGNOSTICS)
            if isinstance(heard.sample, StatusSample)
            for status in heard.sample.statuses
        ):
            if not recording.is_running or time.monotonic() - since > _STARTING:
                raise CannotDoError(f"the recorder did not come up, see {self._folder}")
            if self._ending.wait(_BEAT):
                return

    # --- what else the record holds --------------------------------------------------------------

    def _about(self, began: datetime) -> dict[str, str]:
        wanted = self.parameters_of(RehearsalParameters)
        return {
            "operator": wanted.operator,
            "machine": wanted.machine,
            "began": began.isoformat(timespec="seconds"),
            "ended": datetime.now().astimezone().isoformat(timespec="seconds"),
            "procedure": str(self._written.path),
            "contract version": CONTRACT_VERSION,
            "package version": package_version(),
            "Python": platform.python_version(),
            "middleware": str(get_rmw_implementation_identifier()),
            "computer": f"{platform.node()}, {platform.system()} {platform.release()}",
            "ROS domain": os.environ.get("ROS_DOMAIN_ID", "0"),
            "namespace": self.get_namespace(),
            "clock": "simulated" if self.get_parameter("use_sim_time").value else "time of day",
        }

    def _devices(self) -> tuple[dict[str, str], ...]:
        last = self.history.last(topics.LINK_STATUS)
        if last is None or not isinstance(last.sample, StatusSample):
            return ()
        return tuple(
            {"name": each.name.partition(": ")[2], "state": each.message, **each.values}
            for each in last.sample.statuses
        )

    def _configurations(self) -> Mapping[str, Mapping[str, Any]]:
        found: dict[str, Mapping[str, Any]] = {}
        for heard in self.history.of(topics.CONFIG):
            if isinstance(heard.sample, TextSample):
                content = json.loads(heard.sample.text)
                found[str(content.get("node", ""))] = content
        own = {self.get_fully_qualified_name(), f"{self.get_namespace().rstrip('/')}/{_RECORDER}"}
        return {node: content for node, content in sorted(found.items()) if node not in own}


def _closed(recording: Recording) -> str:
    try:
        return recording.close()
    except OSError as error:
        return f"NOT RECORDED: {error}"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = (
        "Run a test procedure against an emulated or a real machine behind hil_bridge, and write a "
        "record for signature: record.html, junit.xml, record.json and a bag. Nothing moves before "
        "motion is confirmed."
    )
    parser.epilog = f"Procedures of the package: {', '.join(shipped())}. {EXIT_CODES}"
    parser.add_argument("procedure", help="name of a procedure, or path of a .yaml file")
    add_run_arguments(parser)


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that are the same for every procedure."""
    parser.add_argument("-o", "--out", metavar="DIR", help="folder to create for the record")
    parser.add_argument("--operator", metavar="NAME", help="who runs it, for the record")
    parser.add_argument("--machine", metavar="TEXT", help="which machine, for the record")
    parser.add_argument(
        "--confirm-motion", action="store_true", help="the area is clear: do not ask before motion"
    )
    parser.add_argument(
        "--hands", metavar="PROGRAM",
        help="program called with a key and a text in place of the operator; its exit code means "
        "0 done or yes, 1 no, else not possible",
    )  # fmt: skip
    parser.add_argument("--patience", type=float, metavar="S", help="wall time to wait beyond what "
                        "is expected [s] (default 3)")  # fmt: skip
    parser.add_argument("--attempts", type=int, metavar="N", help="attempts at a disturbed step, "
                        "in place of the procedure's own number")  # fmt: skip
    parser.add_argument("--no-bag", action="store_true", help="record no bag")
    parser.add_argument("--dry-run", action="store_true", help="check the procedure and end")


def _as_ros_arguments(options: argparse.Namespace) -> list[str]:
    given: dict[str, Any] = {
        "procedure": options.procedure,
        "out": options.out,
        "operator": options.operator,
        "machine": options.machine,
        "confirm_motion": True if options.confirm_motion else None,
        "hands": options.hands,
        "patience": options.patience,
        "attempts": options.attempts,
        "record": False if options.no_bag else None,
    }
    assignments: list[str] = []
    for name, value in given.items():
        if value is not None:
            # A quoted text stays one, even where it reads like a number.
            assignments += ["-p", f"{name}:={json.dumps(value)}"]
    return assignments


def run(options: argparse.Namespace) -> int:
    """Run the procedure; return an exit code."""
    try:
        written = load_procedure(options.procedure)
    except ProcedureError as error:
        print(f"mother_rover hil rehearse: {error}", file=sys.stderr)
        return ExitCode.BAD_CONFIGURATION
    if options.dry_run:
        print(f"{written.path}: {len(written.procedure.steps)} steps, as they should be")
        return ExitCode.OK
    ros = options.ros_arguments or ["--ros-args"]
    code = node_process.run(RehearsalNode, [*ros, *_as_ros_arguments(options)])
    verdict = RehearsalNode.verdict
    if code != ExitCode.OK or verdict is Verdict.PASS:
        return code
    return FAILED if verdict is Verdict.FAIL else INCOMPLETE


def main() -> int:
    """Run the node as `ros2 run` starts it."""
    return run(parse_node_arguments(RehearsalNode.NAME, add_arguments))


if __name__ == "__main__":
    sys.exit(main())
