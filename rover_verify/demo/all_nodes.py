"""Plant and controllers in one process; the arguments are the names of the nodes.

In lockstep no other process is waited for.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

from msg_schemas.package import PACKAGE
from rover_launch.loop import component_class
from rover_launch.plan import LOCKSTEP, LaunchPlan, ProcessSpec, Value
from rover_runtime.ros.arguments import parse_node_arguments
from rover_runtime.ros.process import run

NAME = "all_nodes"


def merged(planned: LaunchPlan) -> LaunchPlan:
    """Return a plan in lockstep with all nodes that time waits for in one process."""
    joined = [each for each in planned.started if LOCKSTEP in each.parameters]
    nodes = tuple(name for each in joined for name in each.node_names)
    parameters: dict[str, Value] = {
        f"{node}:{name}": value
        for each in joined
        for node in each.node_names
        for name, value in each.parameters.items()
        if name != LOCKSTEP
    }
    parameters[LOCKSTEP] = f"{NAME}={'+'.join(nodes)}"
    files = tuple(file for each in joined for file in each.files)
    one = ProcessSpec(__name__, PACKAGE, files, parameters, arguments=nodes, nodes=nodes)
    rest = tuple(each for each in planned.started if each not in joined)
    return replace(planned, started=(one, *rest))


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("nodes", nargs="+")


def main() -> int:
    """Run the nodes."""
    given = parse_node_arguments(NAME, _add_arguments)
    classes = [component_class(name) for name in given.nodes]
    return run(*classes, arguments=given.ros_arguments)


if __name__ == "__main__":
    sys.exit(main())
