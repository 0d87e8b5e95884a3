"""Start the processes of a launch plan, as ROS 2's ``launch`` does, which is not on PyPI."""

from __future__ import annotations

import signal
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from msg_schemas import topics
from msg_schemas.access import ACCESS
from msg_schemas.phases import WinchMode
from msg_schemas.table import TOPICS
from rover_bags.files.scan import BagScan
from rover_bags.files.store import BagError
from rover_launch.loop import Parameters, make_plan
from rover_launch.nodes import NODES
from rover_launch.plan import HANGING_DEFAULTS, HIL, LaunchPlan, ProcessSpec
from rover_verify.harness import NodeHarness, Observer
from rover_verify.harness.processes import Process

RECORDER = "bag_record"
CLOCK_REMAP = {"/clock": "clock"}
"""Of every process in a namespace: each namespace has its own clock."""
STREAMS = frozenset(
    row.name.strip("/")
    for row in TOPICS.values()
    if row.name in ACCESS["sim_node"].publishes and row.rate and not row.spatial_only
)
"""Topics of the simulator with a rate."""


def start_processes(
    harness: NodeHarness, planned: LaunchPlan, changed: Parameters | None = None
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


class Launched:
    """The processes of a launch plan, their observer, and the bag that they are recorded to.

    Args:
        harness: that starts them.
        controllers: executables.
        given: arguments of the launch file.
        changed: parameters by node and name that override those of the plan.
        bag: folder to record to; None = nothing is recorded.
        defaults: arguments of the launch file.
        arrange: changes the plan.

    Attributes:
        harness: that starts them.
        planned: plan of the launch.
        observer: started before the processes.
        processes: by executable.
    """

    def __init__(
        self,
        harness: NodeHarness,
        controllers: Sequence[str],
        given: Mapping[str, str],
        changed: Parameters | None = None,
        *,
        bag: Path | None = None,
        defaults: Mapping[str, str] = HANGING_DEFAULTS,
        arrange: Callable[[LaunchPlan], LaunchPlan] = lambda planned: planned,
    ) -> None:
        self.harness, self._changed, self._bag = harness, changed or {}, bag
        arguments = dict(given) | ({} if bag is None else {"record": str(bag)})
        if arguments.get("plant") == HIL:
            arguments["link"] = harness.link
        self.planned = arrange(make_plan(controllers, defaults, arguments))
        self.observer = harness.observer()
        self.processes: dict[str, Process] = {}
        for each in self.planned.started:
            self.start(each.executable)

    def start(self, executable: str) -> None:
        """Start a process of the plan, also once more after its end."""
        (planned,) = [each for each in self.planned.started if each.executable == executable]
        namespace = self.planned.namespace
        self.processes[executable] = _started(self.harness, planned, namespace, self._changed)

    def wait_until_ready(self, *recorded: str) -> None:
        """Wait until all nodes are ready and these topics are recorded."""
        for each in self.planned.started:
            wait_until_ready(self.observer, each)
        bag = self._bag
        if bag is not None:
            self.observer.wait_until(
                lambda: set(recorded) <= recorded_topics(bag), f"{recorded} are not recorded"
            )

    def end_recording(self) -> Path:
        """Stop the recorder; returns the bag.

        Raises:
            RuntimeError: it failed.
        """
        recorder = self.processes[RECORDER]
        if recorder.stop() != 0 or self._bag is None:
            raise RuntimeError(f"the recorder failed:\n{recorder.output}")
        return self._bag


def recorded_topics(bag: Path) -> set[str]:
    """Topics with messages on disk in a bag, finished or not."""
    try:
        return {message.topic.name.strip("/") for message in BagScan(bag)}
    except BagError:
        return set()


def missing_streams(bag: Path) -> list[str]:
    """Streams of the simulator without messages in the bag."""
    return sorted(STREAMS - recorded_topics(bag))


def arm_winch(observer: Observer) -> None:
    """Arm the winch, and wait until it holds.

    Raises:
        RuntimeError: it cannot be armed.
    """
    answer = observer.call(topics.WINCH_REARM)
    if not answer.success:
        raise RuntimeError(f"the winch cannot be armed: {answer.message}")
    observer.wait_for_text(topics.WINCH_MODE, WinchMode.HOLD)


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
