"""Start the processes of a launch plan, as ROS 2's ``launch`` does, which is not on PyPI."""

from __future__ import annotations

import signal
from collections.abc import Sequence

from rover_launch.loop import Parameters
from rover_launch.nodes import NODES
from rover_launch.plan import Plan, ProcessSpec
from rover_verify.harness import NodeHarness, Observer
from rover_verify.harness.processes import Process

CLOCK_REMAP = {"/clock": "clock"}
"""Of every process in a namespace: each namespace has its own clock."""


def start_processes(
    harness: NodeHarness, planned: Plan, changed: Parameters | None = None
) -> list[Process]:
    """Start the processes of a plan, in its order.

    Args:
        harness: that starts them.
        planned: plan of the launch.
        changed: parameters by node and name that override those of the plan.
    """
    return [_started(harness, each, planned.namespace, changed or {}) for each in planned.started]


def _started(
    harness: NodeHarness, started: ProcessSpec, namespace: str, changed: Parameters
) -> Process:
    own = {
        f"{node}:{name}": value
        for node in started.node_names
        for name, value in changed.get(node, {}).items()
    }
    files: Sequence[str] = [
        part for file in started.files for part in ("--ros-args", "--params-file", file, "--")
    ]
    return harness.processes.start(
        NODES.get(started.executable, started.executable),
        {**started.parameters, **own},
        *started.arguments,
        *files,
        namespace=namespace,
        remap=CLOCK_REMAP if namespace else None,
    )


def wait_until_ready(observer: Observer, started: ProcessSpec) -> None:
    """Wait until the nodes of a process are ready."""
    for node in started.node_names:
        observer.wait_until_ready(node)


def end_processes(processes: Sequence[Process]) -> None:
    """Interrupt all processes at once, as Ctrl-C does; AssertionError if one fails."""
    for process in processes:
        process.send(signal.SIGINT)
    for process in processes:
        code = process.wait()
        assert code == 0, f"{process.module} exited with {code}:\n{process.output}"
