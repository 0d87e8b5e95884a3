"""What the launch files start, started: every process comes up, and ends well.

ROS 2's own ``launch`` is no part of PyPI. Here its plan is carried out by the same arguments: the
executables, their parameter files and parameters, the namespace and its clock.
"""

from __future__ import annotations

import runpy
import signal
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from unittest.mock import patch

from msg_schemas import topics
from msg_schemas.machine import WINCH_TO_LENGTH
from msg_schemas.table import WINCH_DRUM
from rover_launch import plan as launching
from rover_launch.nodes import NODES
from rover_launch.plan import Plan, ProcessSpec, arguments_of, plan
from rover_verify.checks import Batch, Measured, NotPossible
from rover_verify.harness import NodeHarness, Observer, Process, open_harness

_ROOT = Path(__file__).parents[2]
_OWN_CLOCK = {"/clock": "clock"}
_PAID_OUT = 0.2  # by one of two rovers side by side [m]
_STAYS = 0.01  # within which the other one's length stays [m]
# Each file as it is, and the mission with each of the other plants.
_STARTED: tuple[tuple[str, Mapping[str, str]], ...] = (
    ("sim", {}),
    ("jump", {}),
    ("descent", {}),
    ("rehearsal", {}),
    ("mission", {}),
    ("mission", {"plant": launching.MOCK}),
    ("mission", {"plant": launching.HIL}),
)


def launches(batch: Batch) -> Measured:
    """How many launches fail: a process does not come up or ends badly, two rovers mix."""
    troubles: dict[str, str] = {}
    for number, (file, values) in enumerate(_STARTED):
        name = " ".join([f"{file}.launch.py", *(f"{k}:={v}" for k, v in values.items())])
        folder = batch.folder / str(number)
        folder.mkdir()
        try:
            _launch(folder, file, values)
        except AssertionError as trouble:
            troubles[name] = str(trouble)[:500]
        batch.progress(number + 1, len(_STARTED) + 1)
    try:
        _side_by_side(batch.folder)
    except AssertionError as trouble:
        troubles["two rovers side by side"] = str(trouble)[:500]
    batch.progress(len(_STARTED) + 1, len(_STARTED) + 1)
    return Measured(len(troubles), f"{len(_STARTED)} launches, and two rovers at once", troubles)


def described(path: Path) -> tuple[tuple[str, ...], dict[str, str]]:
    """Controllers and other defaults of a launch file, which is run without ROS 2's `launch`."""
    launch, description = ModuleType("launch"), ModuleType("rover_launch.description")
    vars(launch)["LaunchDescription"] = object
    vars(description)["describe"] = lambda *controllers, **defaults: (controllers, defaults)
    with patch.dict(sys.modules, {each.__name__: each for each in (launch, description)}):
        controllers, defaults = runpy.run_path(str(path))["generate_launch_description"]()
    return controllers, defaults


def _planned(harness: NodeHarness, file: str, values: Mapping[str, str]) -> Plan:
    path = _ROOT / "launch" / f"{file}.launch.py"
    if not path.is_file():
        raise NotPossible(f"launch/{path.name} comes with the source tree only")
    controllers, defaults = described(path)
    arguments = arguments_of(controllers, str(_ROOT / "config"), defaults)
    given = {each.name: each.default for each in arguments} | dict(values)
    if given["plant"] == launching.HIL:
        given["link"] = harness.link
    return plan(controllers, given)


def _start(harness: NodeHarness, planned: Plan) -> list[Process]:
    modules = [NODES[each.executable] for each in planned.started]
    return [
        _started(harness, module, each, planned.namespace)
        for module, each in zip(modules, planned.started, strict=True)
    ]


def _started(harness: NodeHarness, module: str, started: ProcessSpec, namespace: str) -> Process:
    files: Sequence[str] = [
        part for file in started.files for part in ("--ros-args", "--params-file", file, "--")
    ]
    return harness.processes.start(
        module,
        started.parameters,
        *started.arguments,
        *files,
        namespace=namespace,
        remap=_OWN_CLOCK if namespace else None,
    )


def _launch(folder: Path, file: str, values: Mapping[str, str]) -> None:
    with open_harness(folder) as harness:
        planned = _planned(harness, file, values)
        processes = _start(harness, planned)
        observer = harness.observer()
        for each in planned.started:
            observer.wait_until_ready(each.executable)
        _end(processes)


def _end(processes: Sequence[Process]) -> None:
    """As Ctrl-C does: all at once."""
    for process in processes:
        process.send(signal.SIGINT)
    for process in processes:
        code = process.wait()
        assert code == 0, f"{process.module} ended with {code}:\n{process.output}"


def _side_by_side(folder: Path) -> None:
    """Of two rovers one moves."""
    names = ("rover1", "rover2")
    with open_harness(folder) as harness:
        processes: list[Process] = []
        observers: list[Observer] = []
        for name in names:
            planned = _planned(harness, "descent", {"plant": launching.MOCK, "namespace": name})
            processes += _start(harness, planned)
            observers.append(harness.observer(name, _OWN_CLOCK))
        for observer in observers:
            for executable in ("winch_node", "descent_node"):
                observer.wait_until_ready(executable)
        drums = [observer.listen(topics.WINCH_STATE) for observer in observers]
        before = [drum.wait().joints[WINCH_DRUM].position for drum in drums]
        moving, _ = observers
        moving.call(topics.WINCH_REARM)
        moving.wait_for_text(topics.WINCH_MODE, "hold")
        moving.send_joint(topics.WINCH_REQUEST, WINCH_TO_LENGTH, before[0] + _PAID_OUT, 0.1, 0.0)
        drums[0].wait(
            lambda sample: abs(sample.joints[WINCH_DRUM].position - before[0] - _PAID_OUT) < _STAYS
        )
        seen = len(drums[1])
        stayed = drums[1].wait(since=seen).joints[WINCH_DRUM].position
        assert abs(stayed - before[1]) < _STAYS, f"rover2 went from {before[1]} to {stayed} m"
        _end(processes)
