"""`mother_rover run`: start one ROS 2 node in this process."""

from __future__ import annotations

import argparse
import importlib
import sys

from rover_launch.nodes import NODES


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the name of the node and its own arguments."""
    parser.description = (
        "Start one node in this process, as `ros2 run mother_rover NODE` does where ROS 2 is "
        "installed. Ctrl-C stops it."
    )
    parser.epilog = (
        "Example: mother_rover run sim_node --ros-args -p scenario:=free_hang. "
        "`mother_rover run NODE --help` lists the parameters of a node."
    )
    parser.add_argument(
        "node", choices=sorted(NODES), metavar="NODE", help=f"one of {', '.join(sorted(NODES))}"
    )
    parser.add_argument(
        "arguments", nargs=argparse.REMAINDER, metavar="...", help="arguments of the node"
    )


def run(options: argparse.Namespace) -> int:
    """Run the node to its end; return its exit code."""
    module = importlib.import_module(NODES[options.node])
    sys.argv = [options.node, *options.arguments]  # nodes read their arguments from there
    code: int = module.main()
    return code
