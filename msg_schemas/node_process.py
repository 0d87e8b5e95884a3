"""Runs a node as a process: the ``main`` of every node.

Clean Ctrl-C, exit codes that mean something, ``--help``.
"""

from __future__ import annotations

import faulthandler
import gc
import signal
import sys
import traceback
from typing import TypeVar

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args, try_shutdown

from msg_schemas import middleware
from msg_schemas.node import ContractNode, ExitCode, parameter_classes
from msg_schemas.parameters import ParameterError
from msg_schemas.ros_parameters import parameter_help

_SPIN_SLICE = 0.1  # [s]
_LEAVING = 20.0  # the graph, before that is given up [s]

N = TypeVar("N", bound=ContractNode)


def help_text(node_class: type[ContractNode]) -> str:
    """Return what ``--help`` prints: purpose and parameters with unit, default and range."""
    lines = [
        f"{node_class.NAME}: {(node_class.__doc__ or '').strip()}",
        "",
        f"usage: {node_class.NAME} [--ros-args -p NAME:=VALUE -r FROM:=TO -r __ns:=/NAMESPACE ...]",
        "",
        "parameters:",
    ]
    lines += parameter_help(parameter_classes(node_class))
    return "\n".join(lines)


class _ShutdownSignal:
    """SIGINT and SIGTERM, however often they come.

    They raise nothing: an exception out of nowhere leaves what is begun half done, a process that
    is just being started among it. What takes long asks whether it should go on.
    """

    def __init__(self) -> None:
        self._made = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    def _on_signal(self, *_: object) -> None:
        self._made = True

    def is_received(self) -> bool:
        """Whether a signal has come."""
        return self._made

    @staticmethod
    def ignore_further() -> None:
        """Bear any that still come: a process that ends gives its handlers up before its end."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)


def run(node_class: type[N], arguments: list[str] | None = None) -> int:
    """Run one node until it is told to stop; the ``main`` of every node.

    SIGINT and SIGTERM (also twice) stop it cleanly: it deactivates, so that it
    leaves its actuators safe, and only then leaves the graph.

    Returns:
        An ``ExitCode``.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    if {"-h", "--help"} & set(arguments):
        print(help_text(node_class))
        return ExitCode.OK
    stop = _ShutdownSignal()
    try:
        _init_ros(arguments)
        return _run_until(node_class, stop)
    except ParameterError as error:
        print(f"{node_class.NAME}: {error}", file=sys.stderr)
        return ExitCode.BAD_CONFIGURATION
    except Exception:  # noqa: BLE001 - the last resort: say what happened and fail
        traceback.print_exc()
        return ExitCode.CRASH
    finally:
        try_shutdown()
        # The node is part of a ring, and the collector passes over what it has frozen. Were the
        # node left to the process's end, the middleware's threads would outlive what they look at.
        gc.unfreeze()
        gc.collect()
        stop.ignore_further()
        faulthandler.cancel_dump_traceback_later()


def _init_ros(arguments: list[str]) -> None:
    middleware.select_transport()
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        rest = remove_ros_args(arguments)
    except RuntimeError as error:  # what rclpy's own errors have in common
        msg = f"ROS arguments not understood: {str(error).splitlines()[0]}"
        raise ParameterError(msg) from error
    if rest:
        msg = (
            f"unknown argument {rest[0]!r}; parameters are given as "
            "--ros-args -p NAME:=VALUE, --help lists them"
        )
        raise ParameterError(msg)


def _run_until(node_class: type[N], stop: _ShutdownSignal) -> int:
    node = node_class()
    node.shutdown_requested = stop.is_received
    executor = node_class.EXECUTOR()
    executor.add_node(node)
    try:
        failed = node.configure_and_activate()
        if failed is not None:
            return failed
        while not stop.is_received() and node.exit_code is None:
            try:
                executor.spin_once(timeout_sec=_SPIN_SLICE)
            except ExternalShutdownException:
                break
        return ExitCode.OK if node.exit_code is None else node.exit_code
    finally:
        node.deactivate_and_report()
        # All is said and safe. Should rclpy or the middleware not let go, its stacks tell where.
        faulthandler.dump_traceback_later(_LEAVING, exit=True, file=2)
        # First of all: the executor of events hears from the middleware's threads, and what is
        # destroyed under it may be looked at once more (rclpy issue 1644).
        executor.shutdown()
        faulthandler.cancel_dump_traceback_later()  # to close a bag takes the time it takes
        node.release_resources()
        faulthandler.dump_traceback_later(_LEAVING, exit=True, file=2)
        node.destroy_node()
