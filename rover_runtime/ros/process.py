"""Runs a component as a process: the ``main`` of every node.

It handles SIGINT, SIGTERM and SIGHUP, returns an ``ExitCode`` and prints ``--help``.
"""

from __future__ import annotations

import faulthandler
import gc
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path

import rclpy
from rclpy.executors import Executor, ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import remove_ros_args, try_shutdown

from msg_schemas.parameters import ParameterError
from msg_schemas.regular_files import file_problem, read_text
from rover_runtime.component import Component, ExitCode
from rover_runtime.ros import middleware
from rover_runtime.ros.lockstep import LockstepCarrier
from rover_runtime.ros.node import ComponentNode, Shared, parameter_classes
from rover_runtime.ros.parameters import parameter_help
from rover_runtime.stop_signals import stop_signals
from rover_runtime.text_output import escape_unencodable

_LARGEST_PARAMETERS = 1 << 18  # file; rcl's time grows with the square of the size [byte]
_SPIN_SLICE = 0.1  # [s]
_LAST_ANSWERS = 0.2  # for the answers of deactivated nodes [s]
_SHUTDOWN_TIMEOUT = 20.0  # of each step of the end that is not a component's [s]


def help_text(component_class: type[Component]) -> str:
    """Return what ``--help`` prints: purpose and parameters with unit, default and range."""
    name = component_class.NAME
    lines = [
        f"{name}: {(component_class.__doc__ or '').strip()}",
        "",
        f"usage: {name} [--ros-args -p NAME:=VALUE -r FROM:=TO -r __ns:=/NAMESPACE ...]",
        "",
        "parameters:",
    ]
    lines += parameter_help(parameter_classes(component_class))
    return "\n".join(lines)


class _ShutdownSignal:
    """Records signals that ask to stop, also repeated ones.

    The handler raises nothing: an exception at an arbitrary line would leave work half done, such
    as the start of a child process. Long work polls ``is_received``.
    """

    def __init__(self) -> None:
        self._received = False
        self._numbers = stop_signals()
        for number in self._numbers:
            signal.signal(number, self._on_signal)

    def _on_signal(self, *_: object) -> None:
        self._received = True

    def is_received(self) -> bool:
        """Whether a signal was received."""
        return self._received

    def ignore_further(self) -> None:
        """Ignore later signals: the interpreter drops its handlers before the process ends."""
        for number in self._numbers:
            signal.signal(number, signal.SIG_IGN)


def run(*component_classes: type[Component], arguments: list[str] | None = None) -> int:
    """Run one node or several until a signal or an exit code of theirs; the ``main`` of every node.

    On SIGINT, SIGTERM or SIGHUP, also repeated, the nodes deactivate, which leaves their
    actuators safe, and then leave the graph. A step of the end that blocks ends the process with
    exit code 1 and the stacks on stderr, also after this function: the caller must end the process.

    Returns:
        An ``ExitCode``.
    """
    escape_unencodable()
    arguments = sys.argv[1:] if arguments is None else arguments
    if {"-h", "--help"} & set(arguments):
        print("\n\n".join(help_text(each) for each in component_classes))
        return ExitCode.OK
    stop = _ShutdownSignal()
    # The imported modules stay. Each full collection of the start would look through all of them.
    gc.freeze()
    try:
        _init_ros(arguments)
        return _run_until(component_classes, stop)
    except ParameterError as error:
        names = ", ".join(each.NAME for each in component_classes)
        print(f"{names}: {error}", file=sys.stderr)
        return ExitCode.BAD_CONFIGURATION
    except Exception:  # noqa: BLE001 - last resort: print the error and fail
        traceback.print_exc()
        return ExitCode.CRASH
    finally:
        _limit_next_step(_SHUTDOWN_TIMEOUT)
        # SIGALRM also ends what outlives the interpreter: the end of the middleware's own objects.
        signal.setitimer(signal.ITIMER_REAL, 2.0 * _SHUTDOWN_TIMEOUT)
        try_shutdown()
        # The node is part of a reference cycle, and frozen objects are not collected. Without this
        # the middleware's threads would outlive the objects that they use.
        gc.unfreeze()
        gc.collect()
        stop.ignore_further()


def _limit_next_step(timeout: float) -> None:
    """End the process after this time [s] with its stacks on stderr, unless called again before.

    The middleware may deadlock when it destroys an endpoint (Fast DDS issue 6502). Python's threads
    then wait for the interpreter's lock; the one of `faulthandler` does not need it.
    """
    faulthandler.dump_traceback_later(timeout, exit=True, file=2)


def _init_ros(arguments: list[str]) -> None:
    middleware.select_transport()
    for option, file in pairwise(arguments):
        if option == "--params-file":
            _check_parameter_file(file)
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        rest = remove_ros_args(arguments)
    except RuntimeError as error:  # the base class of rclpy's errors
        msg = f"ROS arguments not understood: {str(error).splitlines()[0]}"
        raise ParameterError(msg) from error
    if rest:
        msg = (
            f"unknown argument {rest[0]!r}; parameters are given as "
            "--ros-args -p NAME:=VALUE, --help lists them"
        )
        raise ParameterError(msg)


def _check_parameter_file(file: str) -> None:
    """Refuse a file of parameters that rcl would wait for, or read for minutes."""
    try:
        read_text(Path(file), _LARGEST_PARAMETERS)
    except OSError as error:
        msg = f"--params-file {file_problem(error)}"
        raise ParameterError(msg) from None
    except UnicodeDecodeError:
        msg = f"--params-file {file}: it is not UTF-8 text"
        raise ParameterError(msg) from None


def _run_until(component_classes: Sequence[type[Component]], stop: _ShutdownSignal) -> int:
    shared = Shared()
    # Less than half the time per message of rclpy's other executors, which use wait sets.
    executor = EventsExecutor()
    nodes: list[ComponentNode] = []
    try:
        for each in component_classes:
            node = ComponentNode(each, shared)
            nodes.append(node)
            node.component.shutdown_requested = stop.is_received
            executor.add_node(node)
        for node in nodes:
            failure = node.configure_and_activate()
            if failure is not None:
                return failure
        return _spin(nodes, shared.carrier, executor, stop)
    finally:
        _end(nodes, shared.carrier, executor)


def _end(
    nodes: Sequence[ComponentNode], carrier: LockstepCarrier | None, executor: Executor
) -> None:
    """End all nodes, the others also if one of them fails; raises the first failure."""
    failures: list[Exception] = []

    def attempt(act: Callable[[], object]) -> None:
        try:
            act()
        except Exception as error:  # noqa: BLE001 - the other nodes' actuators must be safe too
            failures.append(error)

    for node in nodes:
        _limit_next_step(node.component.END_TIMEOUT)
        attempt(node.deactivate_and_report)
    _limit_next_step(_SHUTDOWN_TIMEOUT)
    if carrier is not None:
        attempt(partial(carrier.leave, executor))
    if executor.context.ok():
        # What waits for the end of the nodes' work, such as the client of an action, is answered.
        attempt(partial(executor.spin_until_future_complete, Future(), timeout_sec=_LAST_ANSWERS))
    # Shut the executor down before any entity is destroyed: threads of the middleware call the
    # events executor, which may access a destroyed entity (rclpy issue 1644).
    executor.shutdown()
    for node in nodes:
        _limit_next_step(node.component.END_TIMEOUT)
        attempt(node.release_resources)
    _limit_next_step(_SHUTDOWN_TIMEOUT)
    for node in nodes:
        node.destroy_node()
    if failures:
        raise failures[0]


def _spin(
    nodes: Sequence[ComponentNode],
    carrier: LockstepCarrier | None,
    executor: Executor,
    stop: _ShutdownSignal,
) -> int:
    def is_over() -> bool:
        return stop.is_received() or any(each.component.exit_code is not None for each in nodes)

    try:
        if carrier is not None:
            carrier.spin(executor, is_over)
        while not is_over():
            # Many callbacks at once: one at a time costs as much again as a message.
            executor.spin_until_future_complete(Future(), timeout_sec=_SPIN_SLICE)
    except ExternalShutdownException:
        return ExitCode.OK
    codes = [each.component.exit_code for each in nodes if each.component.exit_code is not None]
    return codes[0] if codes else ExitCode.OK
