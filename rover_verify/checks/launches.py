"""Launch files: every process starts, becomes ready, and exits with code 0.

ROS 2's ``launch`` is not on PyPI. These checks start the plan of each launch file with the same
arguments: executables, parameter files and parameters, namespace and clock.
"""

from __future__ import annotations

import runpy
import sys
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from unittest.mock import patch

from msg_schemas import machine, topics
from rover_launch import plan as launching
from rover_launch.plan import LaunchPlan, arguments_of, plan
from rover_verify.checks import CheckBatch, Measured, NotPossible
from rover_verify.harness import NodeHarness, Observer, Process, open_harness
from rover_verify.harness.launching import (
    CLOCK_REMAP,
    arm_winch,
    end_processes,
    start_processes,
    wait_until_ready,
)

_ROOT = Path(__file__).parents[2]
_PAYOUT = 0.2  # of one of two rovers in parallel [m]
_TOLERANCE = 0.01  # of the other rover's length [m]
# Each file with its defaults, and the mission with each other plant.
_LAUNCHES: tuple[tuple[str, Mapping[str, str]], ...] = (
    ("sim", {}),
    ("jump", {}),
    ("descent", {}),
    ("rehearsal", {}),
    ("mission", {}),
    ("mission", {"plant": launching.MOCK}),
    ("mission", {"plant": launching.MOCK, "composed": "false"}),
    ("mission", {"plant": launching.MOCK, "lockstep": "false"}),
    ("mission", {"plant": launching.HIL}),
    ("mission", {"plant": launching.HIL, "lockstep": "true"}),
)


def launches(batch: CheckBatch) -> Measured:
    """Number of failed launches: a process fails to start or exit, or two rovers interact."""
    failures: dict[str, str] = {}
    for number, (file, values) in enumerate(_LAUNCHES):
        name = " ".join([f"{file}.launch.py", *(f"{k}:={v}" for k, v in values.items())])
        folder = batch.folder / str(number)
        folder.mkdir()
        try:
            _launch(folder, file, values)
        except AssertionError as failure:
            failures[name] = str(failure)[:500]
        batch.progress(number + 1, len(_LAUNCHES) + 1)
    try:
        _side_by_side(batch.folder)
    except AssertionError as failure:
        failures["two rovers in parallel"] = str(failure)[:500]
    batch.progress(len(_LAUNCHES) + 1, len(_LAUNCHES) + 1)
    return Measured(len(failures), f"{len(_LAUNCHES)} launches, two rovers in parallel", failures)


def described(path: Path) -> tuple[tuple[str, ...], dict[str, str]]:
    """Controllers and defaults of a launch file, evaluated without ROS 2's `launch`."""
    launch, description = ModuleType("launch"), ModuleType("rover_launch.description")
    vars(launch)["LaunchDescription"] = object
    vars(description)["describe"] = lambda *controllers, **defaults: (controllers, defaults)
    with patch.dict(sys.modules, {each.__name__: each for each in (launch, description)}):
        controllers, defaults = runpy.run_path(str(path))["generate_launch_description"]()
    return controllers, defaults


def _planned(harness: NodeHarness, file: str, values: Mapping[str, str]) -> LaunchPlan:
    path = _ROOT / "launch" / f"{file}.launch.py"
    if not path.is_file():
        raise NotPossible(f"launch/{path.name} is only in a checkout")
    controllers, defaults = described(path)
    arguments = arguments_of(controllers, str(_ROOT / "config"), defaults)
    arguments_by_name = {each.name: each.default for each in arguments} | dict(values)
    if arguments_by_name["plant"] == launching.HIL:
        arguments_by_name["link"] = harness.link
    return plan(controllers, arguments_by_name)


def _launch(folder: Path, file: str, values: Mapping[str, str]) -> None:
    with open_harness(folder) as harness:
        planned = _planned(harness, file, values)
        processes = start_processes(harness, planned)
        observer = harness.observer()
        for each in planned.started:
            wait_until_ready(observer, each)
        end_processes(processes)


def _side_by_side(folder: Path) -> None:
    """Command one of two rovers; the other one must not move."""
    names = ("rover1", "rover2")
    with open_harness(folder) as harness:
        processes: list[Process] = []
        observers: list[Observer] = []
        for name in names:
            planned = _planned(harness, "descent", {"plant": launching.MOCK, "namespace": name})
            processes += start_processes(harness, planned)
            observers.append(harness.observer(name, CLOCK_REMAP))
        for observer in observers:
            for executable in ("winch_node", "descent_node"):
                observer.wait_until_ready(executable)
        drums = [observer.listen(topics.WINCH_STATE) for observer in observers]
        before = [drum.wait().joints[machine.WINCH_DRUM].position for drum in drums]
        moving, _ = observers
        arm_winch(moving)
        moving.send_joint(
            topics.WINCH_REQUEST, machine.WINCH_TO_LENGTH, before[0] + _PAYOUT, 0.1, 0.0
        )
        drums[0].wait(
            lambda sample: (
                abs(sample.joints[machine.WINCH_DRUM].position - before[0] - _PAYOUT) < _TOLERANCE
            )
        )
        seen = len(drums[1])
        length = drums[1].wait(since=seen).joints[machine.WINCH_DRUM].position
        assert abs(length - before[1]) < _TOLERANCE, (
            f"the length of rover2 changed from {before[1]} to {length} m"
        )
        end_processes(processes)
