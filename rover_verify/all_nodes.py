"""Plant and controllers in one process; the arguments are the names of the nodes."""

from __future__ import annotations

import argparse
import sys

from rover_launch.loop import component_class
from rover_runtime.ros.arguments import parse_node_arguments
from rover_runtime.ros.process import run

NAME = "all_nodes"


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("nodes", nargs="+")


def main() -> int:
    """Run the nodes."""
    given = parse_node_arguments(NAME, _add_arguments)
    classes = [component_class(name) for name in given.nodes]
    return run(*classes, arguments=given.ros_arguments)


if __name__ == "__main__":
    sys.exit(main())
