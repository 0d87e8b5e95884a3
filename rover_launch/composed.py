"""Runs several controllers in one process."""

from __future__ import annotations

import argparse
import sys

from msg_schemas.access import COMPOSED
from rover_launch.loop import component_class
from rover_runtime.component import ExitCode
from rover_runtime.ros.arguments import parse_node_arguments


def run_composed(executable: str) -> int:
    """Run the controllers of an executable that the command line names, by default all.

    Returns:
        An ``ExitCode``.
    """
    from rover_runtime.ros.process import run  # noqa: PLC0415 - `--help` of others needs no ROS

    nodes = COMPOSED[executable]

    def add_arguments(parser: argparse.ArgumentParser) -> None:
        about = f"nodes to run, of {', '.join(nodes)}; default: all"
        parser.add_argument("nodes", nargs="*", metavar="NODE", help=about)
        parser.epilog = "Each node lists its parameters: " + ", ".join(
            f"`{name} --help`" for name in nodes
        )

    given = parse_node_arguments(executable, add_arguments)
    wrong = [name for name in given.nodes if name not in nodes or given.nodes.count(name) > 1]
    if wrong:
        known = ", ".join(nodes)
        print(f"{executable}: {wrong[0]!r} should be of {known}, once", file=sys.stderr)
        return ExitCode.BAD_CONFIGURATION
    classes = [component_class(name) for name in given.nodes or nodes]
    return run(*classes, arguments=given.ros_arguments)
