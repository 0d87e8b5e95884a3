"""``mother_rover state save``: save the state of a running simulated plant, to start from it."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from enum import IntEnum
from pathlib import Path
from typing import Any

from msg_schemas import qos, topics
from msg_schemas.cdr import unpack
from msg_schemas.message_types import message_class
from msg_schemas.name_arguments import namespace
from msg_schemas.number_arguments import finite_number
from msg_schemas.refusal import Refusal
from msg_schemas.table import TOPICS
from rover_bags.files.state_file import save_state
from rover_sim import is_state

_NODE = "state_save"
_POLL_PERIOD = 0.1  # [s]


class SaveExitCode(IntEnum):
    """Exit codes of ``mother_rover state save``."""

    SAVED = 0
    BAD_ARGUMENTS = 2
    NOT_WRITTEN = 3
    NO_PLANT = 4
    INTERRUPTED = 130


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = (
        "Save the next state that a simulated plant publishes, at its state_rate, or the state in "
        "which its time is paused. A plant of the same scenario starts from the file by its "
        "parameter start_state."
    )
    parser.epilog = (
        "Exit codes: 0 saved, 2 bad arguments, 3 the file exists or cannot be written, 4 no plant "
        "publishes its state, 130 interrupted."
    )
    parser.add_argument("file", type=Path, help="new file, such as hang.json")
    parser.add_argument(
        "--namespace", type=namespace, default="", metavar="NS", help="namespace of the plant"
    )
    parser.add_argument(
        "--timeout", type=finite_number(0.1, 1e6), default=20.0, metavar="S",
        help="longest wait for a state [s] (default: %(default)g)",
    )  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Run the command; return a `SaveExitCode`."""
    if options.file.exists():
        print(f"mother_rover state save: {options.file} exists: name a new file", file=sys.stderr)
        return SaveExitCode.NOT_WRITTEN
    try:
        found = _receive(options.namespace, options.timeout, options.ros_arguments)
    except KeyboardInterrupt:
        return SaveExitCode.INTERRUPTED
    except (RuntimeError, ValueError) as error:  # the base classes of rclpy's errors
        reason = str(error).partition("\n")[0]
        print(f"mother_rover state save: bad ROS arguments: {reason}", file=sys.stderr)
        return SaveExitCode.BAD_ARGUMENTS
    if not {"scenario", topics.TRUTH_STATE} <= found.keys():
        where = options.namespace or "/"
        print(
            f"mother_rover state save: no simulated plant in the namespace {where} has published "
            f"{topics.TRUTH_STATE} within {options.timeout:g} s",
            file=sys.stderr,
        )
        return SaveExitCode.NO_PLANT
    is_saved = save_state(
        "mother_rover state save", options.file, found["scenario"], found[topics.TRUTH_STATE]
    )
    return SaveExitCode.SAVED if is_saved else SaveExitCode.NOT_WRITTEN


def _receive(namespace: str, timeout: float, arguments: Sequence[str]) -> dict[str, Any]:
    """Return scenario and state of the plant, as far as they arrive within the timeout [s]."""
    # None of these is needed for --help.
    import rclpy  # noqa: PLC0415
    from rclpy.context import Context  # noqa: PLC0415
    from rclpy.executors import SingleThreadedExecutor  # noqa: PLC0415

    from rover_runtime.ros import middleware  # noqa: PLC0415

    found: dict[str, Any] = {}

    def on_message(name: str, data: bytes) -> None:
        try:
            content = json.loads(unpack(name, data).text)
        except Refusal:
            return  # not by the contract
        if name == topics.TRUTH_STATE:
            if is_state(content):
                found[name] = content
        elif isinstance(content.get("scenario"), Mapping):
            found["scenario"] = content["scenario"]

    middleware.select_transport()
    context = Context()
    context.init(args=list(arguments))
    try:
        node = rclpy.create_node(
            _NODE, namespace=namespace, context=context, start_parameter_services=False
        )
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        for name in (topics.CONFIG, topics.TRUTH_STATE):
            row = TOPICS[name]
            node.create_subscription(
                message_class(row.message),
                name,
                lambda data, name=name: on_message(name, data),  # type: ignore[misc]
                qos.profile(row.intent, qos.LATCHED_NODES),
                raw=True,
            )
        deadline = time.monotonic() + timeout
        while len(found) < 2 and time.monotonic() < deadline:
            executor.spin_once(timeout_sec=_POLL_PERIOD)
        executor.shutdown()
        node.destroy_node()
    finally:
        context.try_shutdown()
    return found
