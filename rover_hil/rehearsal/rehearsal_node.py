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
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.utilities import get_rmw_implementation_identifier

from msg_schemas import qos, topics
from msg_schemas.cdr import unpack
from msg_schemas.health import Health, read_health
from msg_schemas.layouts import LAYOUTS
from msg_schemas.message_types import message_class
from msg_schemas.number_arguments import positive
from msg_schemas.package import package_version
from msg_schemas.parameters import parameter
from msg_schemas.phases import HealthState
from msg_schemas.refusal import Refusal
from msg_schemas.regular_files import file_problem
from msg_schemas.samples import StatusSample, TextSample
from msg_schemas.shipped import ShippedError
from msg_schemas.specifications import Intent
from msg_schemas.table import CONTRACT_VERSION, SERVICES, TOPICS, find_topic
from rover_hil.rehearsal.actions import PARTS
from rover_hil.rehearsal.environment import OutgoingMessage, PreconditionError, RehearsalResponse
from rover_hil.rehearsal.expectation_result import Result
from rover_hil.rehearsal.message_history import MessageHistory, ReceivedMessage
from rover_hil.rehearsal.operator_prompts import OperatorPrompts
from rover_hil.rehearsal.procedure import LoadedProcedure, load_procedure, shipped
from rover_hil.rehearsal.procedure_result import ProcedureResult
from rover_hil.rehearsal.procedure_runner import ProcedureRunner
from rover_hil.rehearsal.recording import Recording
from rover_hil.rehearsal.write_record import write_record
from rover_runtime.component import ExitCode
from rover_runtime.ros import process
from rover_runtime.ros.arguments import parse_node_arguments
from rover_runtime.ros.endpoint_matching import matched_subscribers
from rover_runtime.ros.node import RosComponent
from rover_runtime.ros.timers import steady_timer

FAILED, INCOMPLETE = 4, 5
"""Exit codes beyond those of every node: a step failed; not all steps could be run."""

_QUEUE_DEPTH = 1000  # messages
_TIMER_PERIOD = 0.02  # of the timer that measures stalls [s]
_REMEMBERED_DELAYS = 60_000  # of that timer
_STARTUP_TIMEOUT = 60.0  # of recorder and clock [s]
_SERVICE_TIMEOUT = 5.0  # of parameter services [s]
_RECORDER = "bag_record"
EXIT_CODES = (
    "With an emulated machine add --ros-args -p use_sim_time:=true. Exit codes: 0 all passed, "
    "1 crash, 2 refused (arguments, procedure, no clock), 4 a step failed, 5 no step failed, but "
    "some could not run."
)
_ALWAYS_SUBSCRIBED = (
    topics.CONFIG, topics.EVENTS, topics.DIAGNOSTICS, topics.LINK_STATUS, topics.SIM_STATUS,
)  # fmt: skip


@dataclass(frozen=True)
class RehearsalParameters:
    """Procedure, operator, machine, and folder of the record."""

    procedure: str = parameter(
        "", "-", "name of a procedure of the package, or path of a .yaml file", read_only=True
    )
    out: str = parameter("", "-", "folder to create for the record; empty = by date and time",
                         read_only=True)  # fmt: skip
    operator: str = parameter("", "-", "name of the operator, for the record", read_only=True)
    machine: str = parameter("", "-", "name of the machine, for the record", read_only=True)
    confirm_motion: bool = parameter(
        False, "-", "the area is clear: do not prompt before the first motion", read_only=True
    )
    operator_program: str = parameter(
        "", "-", "program in the operator's place; empty = prompts go to the terminal",
        read_only=True,
    )  # fmt: skip
    timeout_margin: float = parameter(
        3.0, "s", "wall time added to each timeout", 0.1, 600.0,
        read_only=True,
    )  # fmt: skip
    attempts: int = parameter(
        0, "-", "largest number of attempts at a step, where one is invalid; 0 = as the procedure "
        "defines", 0, 20, read_only=True,
    )  # fmt: skip
    record: bool = parameter(True, "-", "record a bag", read_only=True)


class TimedPublisher:
    """Publishes at a fixed rate until stopped.

    Args:
        send: publishes once; returns the time by the rehearsal's clock [ns].

    Attributes:
        longest_interval: longest time between two of them by the steady clock [s].
        last_stamp_ns: time of the last one by the rehearsal's clock.
    """

    def __init__(self, send: Callable[[], int]) -> None:
        self.longest_interval, self.last_stamp_ns = 0.0, 0
        self._send = send
        self._before: float | None = None
        self._timer: Any = None
        self._lock = threading.Lock()
        self._is_stopped = False

    def begin(self, make_timer: Callable[[Callable[[], None]], Any]) -> None:
        """Publish once, and then by the timer."""
        self._tick()
        self._timer = make_timer(self._tick)

    def _tick(self) -> None:
        with self._lock:
            if self._is_stopped:
                return
            now = time.monotonic()
            if self._before is not None:
                self.longest_interval = max(self.longest_interval, now - self._before)
            self._before = now
            self.last_stamp_ns = self._send()

    def stop(self) -> None:
        """Stop publishing."""
        with self._lock:
            self._is_stopped = True
        self._timer.cancel()


class RehearsalNode(RosComponent):
    """Runs a test procedure against an emulated or a real machine."""

    NAME = "hil_rehearsal"
    PARAMETERS = (RehearsalParameters,)
    END_TIMEOUT = 900.0  # it disarms the drives within `timeout_margin` and waits for its recorder
    result: ClassVar[Result | None] = None

    def setup(self) -> None:
        """Read the procedure, create the folder, subscribe.

        Raises:
            ShippedError: the procedure is invalid.
            ValueError: the folder exists.
        """
        settings = self.parameters_of(RehearsalParameters)
        self._loaded: LoadedProcedure = load_procedure(settings.procedure)
        stamp = datetime.now().astimezone().strftime("%Y_%m_%d-%H_%M_%S")
        self._folder = Path(settings.out or f"rehearsal_{stamp}").expanduser().absolute()
        if self._folder.exists():
            raise ValueError(
                f"out: {self._folder} exists and is never overwritten; name another folder"
            )
        self._folder.mkdir(parents=True)
        self.history = MessageHistory()
        self._stopping = threading.Event()
        self._command_publishers: dict[str, Any] = {}
        self._service_clients: dict[str, Any] = {}
        self._timer_delays: deque[tuple[int, float]] = deque(maxlen=_REMEMBERED_DELAYS)
        self._operator = OperatorPrompts(
            settings.operator_program, 10.0 * _STARTUP_TIMEOUT, self._stopping.is_set,
            sys.stdin if sys.stdin is not None and sys.stdin.isatty() else None,
        )  # fmt: skip
        self._step_topics: tuple[str, ...] = ()
        self._topic_subscriptions: dict[str, Any] = {}
        self._update_subscriptions()

    def start(self) -> None:
        """Start the rehearsal in a thread of its own."""
        self._last_timer_ns = time.monotonic_ns()
        self.every(_TIMER_PERIOD, self._on_timer, by_wall_clock=True)
        self._thread = threading.Thread(target=self._run_thread, name="rehearsal")
        self._thread.start()

    def stop(self) -> None:
        """Stop the rehearsal: disarm the drives and write the record."""
        self._stopping.set()
        while self._thread.is_alive():
            # Its last calls need responses.
            if self.ros.executor is not None:
                self.ros.executor.spin_once(timeout_sec=_TIMER_PERIOD)
            else:
                self._thread.join(_TIMER_PERIOD)

    # --- subscriptions ---------------------------------------------------------------------------

    def listen(self, topics: tuple[str, ...]) -> None:
        """Subscribe to these topics, and close the subscriptions of earlier steps.

        The executor's thread opens and closes them.
        """
        self._step_topics = topics

    def _update_subscriptions(self) -> None:
        required = {*_ALWAYS_SUBSCRIBED, *self._step_topics}
        for name in required - self._topic_subscriptions.keys():
            self._topic_subscriptions[name] = self._subscription(name)
        for name in self._topic_subscriptions.keys() - required:
            self.ros.destroy_subscription(self._topic_subscriptions.pop(name))
            self.history.discard(name)

    def _subscription(self, name: str) -> Any:
        row = find_topic(name)
        return self.ros.create_subscription(
            message_class(row.message),
            name,
            partial(self._on_message, name),
            qos.profile(row.intent, _QUEUE_DEPTH),
            raw=True,
        )

    def _on_message(self, name: str, data: bytes) -> None:
        if name not in self._topic_subscriptions:
            return  # it was in transit when the subscription was closed
        now_ns, steady_ns = self.now_ns(), time.monotonic_ns()
        try:
            sample = unpack(name, data)
        except Refusal as refusal:
            self.history.add(name, ReceivedMessage(now_ns, now_ns, steady_ns, None, str(refusal)))
            return
        stamp_ns = getattr(sample, "stamp_ns", 0) or now_ns
        self.history.add(name, ReceivedMessage(stamp_ns, now_ns, steady_ns, sample))

    def _on_timer(self) -> None:
        now_ns = time.monotonic_ns()
        self._timer_delays.append((now_ns, (now_ns - self._last_timer_ns) * 1e-9 - _TIMER_PERIOD))
        self._last_timer_ns = now_ns
        self._update_subscriptions()

    # --- what a procedure runs against -----------------------------------------------------------

    def steady_ns(self) -> int:
        """The computer's steady clock [ns]."""
        return time.monotonic_ns()

    def wall_ns(self) -> int:
        """The computer's time of day [ns], by which bags log."""
        return time.time_ns()

    def wait(self, timeout: float) -> None:
        """Wait for about this time [s] while messages are received."""
        self._stopping.wait(timeout)

    def longest_stall(self, since_ns: int) -> float:
        """The longest delay of the executor's timer since a steady time [s]."""
        late = [late for at_ns, late in list(self._timer_delays) if at_ns >= since_ns]
        waiting = (time.monotonic_ns() - self._last_timer_ns) * 1e-9 - _TIMER_PERIOD
        return max([0.0, waiting, *late])

    def is_available(self, name: str) -> bool:
        """Whether a topic has a publisher, a command a subscriber, or a service a server."""
        if name in SERVICES:
            return bool(self._client(name).service_is_ready())
        if TOPICS[name].intent is Intent.COMMAND:
            return self.has_subscriber(name)
        return bool(self.ros.count_publishers(name))

    def has_subscriber(self, topic: str) -> bool:
        """Whether a topic has a subscriber besides the recorder."""
        subscribers = {
            name for name, _ in matched_subscribers(self.ros, self._command_publisher(topic))
        }
        return bool(subscribers - {_RECORDER, self.NAME})

    def _command_publisher(self, topic: str) -> Any:
        if topic not in self._command_publishers:
            row = TOPICS[topic]
            self._command_publishers[topic] = self.ros.create_publisher(
                message_class(row.message), topic, qos.profile(row.intent)
            )
        return self._command_publishers[topic]

    def send(self, topic: str, message: OutgoingMessage) -> None:
        """Publish once, unchecked: the message may violate the contract."""
        columns = [
            () if part == message.omit else [getattr(v, part) for v in message.joints.values()]
            for part in PARTS
        ]
        values = (message.stamp_ns, self.full_name, tuple(message.joints), *columns)
        self._command_publisher(topic).publish(LAYOUTS[TOPICS[topic].message].serialize(values))

    def send_periodically(
        self, topic: str, make: Callable[[int], OutgoingMessage], period: float
    ) -> TimedPublisher:
        """Publish now and every `period` [s] of the steady clock; `make` gets the clock's time."""
        self._command_publisher(topic)

        def send() -> int:
            now_ns = self.now_ns()
            self.send(topic, make(now_ns))
            return now_ns

        publisher = TimedPublisher(send)
        publisher.begin(lambda tick: steady_timer(self.ros, period, tick))
        return publisher

    def call(self, service: str, data: bool | None, timeout: float) -> RehearsalResponse:
        """Call a service.

        Raises:
            PreconditionError: it has no server, or does not respond.
        """
        kind = message_class(SERVICES[service].service)
        request = kind.Request() if data is None else kind.Request(data=data)
        answer = self._call(self._client(service), service, request, timeout)
        return RehearsalResponse(bool(answer.success), str(answer.message))

    def _client(self, service: str) -> Any:
        if service not in self._service_clients:
            kind = message_class(SERVICES[service].service)
            self._service_clients[service] = self.ros.create_client(kind, service)
        return self._service_clients[service]

    def _call(self, client: Any, name: str, request: Any, timeout: float) -> Any:
        deadline = time.monotonic() + timeout
        while not client.service_is_ready():
            if time.monotonic() > deadline:
                raise PreconditionError(f"{name} has no server")
            threading.Event().wait(_TIMER_PERIOD)
        answered = threading.Event()
        future = client.call_async(request)
        future.add_done_callback(lambda _: answered.set())
        if not answered.wait(max(0.1, deadline - time.monotonic())):
            raise PreconditionError(f"{name} did not respond within {timeout:g} s")
        return future.result()

    def parameter(self, node: str, name: str) -> object:
        """Read a parameter.

        Raises:
            PreconditionError: there is no such node or parameter.
        """
        service = f"{node}/get_parameters"
        client = self.ros.create_client(GetParameters, service)
        try:
            answer = self._call(
                client, service, GetParameters.Request(names=[name]), _SERVICE_TIMEOUT
            )
        finally:
            self.ros.destroy_client(client)
        if not answer.values or answer.values[0].type == ParameterType.PARAMETER_NOT_SET:
            raise PreconditionError(f"node {node} has no parameter {name}")
        value: object = parameter_value_to_python(answer.values[0])
        return value

    def set_parameter(self, node: str, name: str, value: object) -> None:
        """Set a parameter.

        Raises:
            PreconditionError: there is no such node, or it refuses the value.
        """
        service = f"{node}/set_parameters"
        client = self.ros.create_client(SetParameters, service)
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()]
        )
        try:
            (answer,) = self._call(client, service, request, _SERVICE_TIMEOUT).results
        finally:
            self.ros.destroy_client(client)
        if not answer.successful:
            raise PreconditionError(f"{node} refuses {name}: {answer.reason}")

    def request_action(self, key: str, instruction: str) -> None:
        """Prompt the operator to do something, and wait until it is done.

        Raises:
            PreconditionError: it cannot be done, or there is no operator.
        """
        self._operator.prompt(key, instruction)

    def request_answer(self, key: str, question: str) -> bool:
        """Put a yes-or-no question to the operator.

        Raises:
            PreconditionError: the operator cannot answer it, or there is no operator.
        """
        return self._operator.inspect(key, question)

    def report_progress(self, line: str) -> None:
        """Print a line."""
        print(line, flush=True)

    # --- the rehearsal's thread ------------------------------------------------------------------

    def _run_thread(self) -> None:
        try:
            self._rehearse()
        except PreconditionError as error:
            print(f"{self.NAME}: {error}", file=sys.stderr, flush=True)
            self.exit_code = ExitCode.BAD_CONFIGURATION
        except Exception:  # noqa: BLE001 - a bug must reach the process, not end here
            traceback.print_exc()
            self.exit_code = ExitCode.CRASH

    def _rehearse(self) -> None:
        settings = self.parameters_of(RehearsalParameters)
        began = datetime.now().astimezone()
        recording = Recording(self._folder, self.ros.get_namespace()) if settings.record else None
        try:
            self._wait_for_clock()
            if recording is not None:
                self._wait_for_recorder(recording)
            runner = ProcedureRunner(
                self,
                timeout_margin=settings.timeout_margin,
                attempts=settings.attempts,
                confirmed=settings.confirm_motion,
                is_stopped=self._stopping.is_set,
            )
            steps, completed = runner.run(self._loaded.procedure)
        finally:
            note = "no bag requested" if recording is None else _close_recording(recording)
        procedure_result = ProcedureResult(
            self._loaded,
            steps,
            completed and (recording is None or not note.startswith("NOT ")),
            self._about(began),
            self._devices(),
            self._configurations(),
            "" if recording is None else recording.bag.name,
            note,
        )
        for path in write_record(procedure_result, self._folder):
            self.report_progress(f"wrote {path}")
        RehearsalNode.result = procedure_result.result
        self.report_progress(f"{self._loaded.name}: {procedure_result.result.value}")
        self.exit_code = ExitCode.OK

    def _wait_for_clock(self) -> None:
        simulated = self.ros.get_parameter("use_sim_time").value
        since = time.monotonic()
        while simulated and not self.now_ns():
            if self._stopping.is_set() or time.monotonic() - since > _STARTUP_TIMEOUT:
                raise PreconditionError(
                    "use_sim_time is true, but no clock is published: is the emulator running?"
                )
            self._stopping.wait(_TIMER_PERIOD)
        if not simulated and self.ros.count_publishers(topics.CLOCK):
            raise PreconditionError(
                "simulated time is published, as by an emulated machine: start with "
                "--ros-args -p use_sim_time:=true"
            )

    def _wait_for_recorder(self, recording: Recording) -> None:
        since = time.monotonic()
        while not any(
            read_health(status) == Health(_RECORDER, HealthState.READY)
            for message in self.history.of(topics.DIAGNOSTICS)
            if isinstance(message.sample, StatusSample)
            for status in message.sample.statuses
        ):
            if not recording.is_running or time.monotonic() - since > _STARTUP_TIMEOUT:
                raise PreconditionError(f"the recorder did not start, see {self._folder}")
            if self._stopping.wait(_TIMER_PERIOD):
                return

    # --- further content of the record -----------------------------------------------------------

    def _about(self, began: datetime) -> dict[str, str]:
        settings = self.parameters_of(RehearsalParameters)
        return {
            "operator": settings.operator,
            "machine": settings.machine,
            "began": began.isoformat(timespec="seconds"),
            "ended": datetime.now().astimezone().isoformat(timespec="seconds"),
            "procedure": str(self._loaded.path),
            "contract version": CONTRACT_VERSION,
            "package version": package_version(),
            "Python": platform.python_version(),
            "middleware": str(get_rmw_implementation_identifier()),
            "computer": f"{platform.node()}, {platform.system()} {platform.release()}",
            "ROS domain": os.environ.get("ROS_DOMAIN_ID", "0"),
            "namespace": self.ros.get_namespace(),
            "clock": "simulated" if self.ros.get_parameter("use_sim_time").value else "time of day",
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
        for message in self.history.of(topics.CONFIG):
            if isinstance(message.sample, TextSample):
                content = json.loads(message.sample.text)
                found[str(content.get("node", ""))] = content
        namespace = self.ros.get_namespace().rstrip("/")
        own = {self.full_name, f"{namespace}/{_RECORDER}"}
        return {node: content for node, content in sorted(found.items()) if node not in own}


def _close_recording(recording: Recording) -> str:
    try:
        return recording.close()
    except OSError as error:
        return f"NOT RECORDED: {file_problem(error)}"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = (
        "Run a test procedure against an emulated or a real machine behind hil_bridge, and write a "
        "record for sign-off: record.html, junit.xml, record.json and a bag. No step that may move "
        "the machine runs before the operator confirms motion."
    )
    parser.epilog = f"Procedures of the package: {', '.join(shipped())}. {EXIT_CODES}"
    parser.add_argument("procedure", help="name of a procedure, or path of a .yaml file")
    add_run_arguments(parser)


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments common to all procedures."""
    parser.add_argument("-o", "--out", metavar="DIR", help="folder to create for the record")
    parser.add_argument("--operator", metavar="NAME", help="operator, for the record")
    parser.add_argument("--machine", metavar="TEXT", help="machine, for the record")
    parser.add_argument(
        "--confirm-motion",
        action="store_true",
        help="the area is clear: do not prompt before motion",
    )
    parser.add_argument(
        "--operator-program", metavar="PROGRAM",
        help="program in the operator's place, called with a key and a text; exit code 0 for done "
        "or yes, 1 for no, any other for impossible",
    )  # fmt: skip
    parser.add_argument("--timeout-margin", type=float, metavar="S", help="wall time added to each "
                        "timeout (default 3)")  # fmt: skip
    parser.add_argument("--attempts", type=positive, metavar="N", help="attempts at a "
                        "step, instead of the procedure's")  # fmt: skip
    parser.add_argument("--no-bag", action="store_true", help="record no bag")
    parser.add_argument("--dry-run", action="store_true", help="validate the procedure and end")


def _as_ros_arguments(options: argparse.Namespace) -> list[str]:
    given: dict[str, Any] = {
        "procedure": options.procedure,
        "out": options.out,
        "operator": options.operator,
        "machine": options.machine,
        "confirm_motion": True if options.confirm_motion else None,
        "operator_program": options.operator_program,
        "timeout_margin": options.timeout_margin,
        "attempts": options.attempts,
        "record": False if options.no_bag else None,
    }
    assignments: list[str] = []
    for name, value in given.items():
        if value is not None:
            # Quoted, a text that looks like a number stays a text.
            assignments += ["-p", f"{name}:={json.dumps(value)}"]
    return assignments


def run(options: argparse.Namespace) -> int:
    """Run the procedure; return an exit code."""
    try:
        loaded = load_procedure(options.procedure)
    except ShippedError as error:
        print(f"mother_rover hil rehearse: {error}", file=sys.stderr)
        return ExitCode.BAD_CONFIGURATION
    if options.dry_run:
        print(f"{loaded.path}: {len(loaded.procedure.steps)} steps, valid")
        return ExitCode.OK
    ros = options.ros_arguments or ["--ros-args"]
    code = process.run(RehearsalNode, arguments=[*ros, *_as_ros_arguments(options)])
    result = RehearsalNode.result
    if code != ExitCode.OK or result is Result.PASS:
        return code
    return FAILED if result is Result.FAIL else INCOMPLETE


def main() -> int:
    """Run the node as `ros2 run` starts it."""
    return run(parse_node_arguments(RehearsalNode.NAME, add_arguments))


if __name__ == "__main__":
    sys.exit(main())
