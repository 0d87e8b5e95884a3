"""The scheduling of a node's process, as the kernel tells it."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from msg_schemas.events import NodeEvent
from msg_schemas.samples import Level
from rover_runtime.worker_process import WorkerProcess

if TYPE_CHECKING:
    from rover_verify.harness import Observer, Processes

pytestmark = [
    pytest.mark.ros,
    pytest.mark.process,
    pytest.mark.skipif(sys.platform != "linux", reason="only Linux has this scheduling"),
]

PRIORITY = 7


def in_a_thread(act: Callable[[], int]) -> int:
    """What something gives that is done in a thread of its own, with its own scheduling."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(act).result()


def is_permitted() -> bool:
    """Whether this test's processes may have a real-time priority."""
    try:
        return in_a_thread(take) == os.SCHED_RR
    except PermissionError:
        return False


def take() -> int:
    """A real-time priority for this thread alone; its policy then."""
    os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(PRIORITY))
    return os.sched_getscheduler(0)


permitted = pytest.mark.skipif(
    not is_permitted(), reason="a real-time priority is not permitted here"
)


def scheduling(pid: int) -> set[tuple[int, int]]:
    """Policies and priorities of the threads of a process."""
    threads = [int(thread.name) for thread in Path(f"/proc/{pid}/task").iterdir()]
    return {
        (os.sched_getscheduler(thread), os.sched_getparam(thread).sched_priority)
        for thread in threads
    }


def own() -> tuple[int, int]:
    """Policy and priority of the test itself, which what it starts inherits."""
    return os.sched_getscheduler(0), os.sched_getparam(0).sched_priority


def test_a_process_is_scheduled_as_any_other(processes: Processes, observer: Observer):
    process = processes.start("shell_node")
    observer.wait_for_event(NodeEvent.ACTIVE)
    assert scheduling(process.pid) == {own()}


@permitted
def test_all_threads_have_the_priority_of_an_active_node(processes: Processes, observer: Observer):
    process = processes.start("shell_node", {"realtime_priority": PRIORITY})
    observer.wait_for_event(NodeEvent.ACTIVE)
    assert scheduling(process.pid) == {(os.SCHED_RR, PRIORITY)}


@permitted
def test_long_computations_stay_behind():
    def computes() -> int:
        take()
        worker = WorkerProcess()  # its process inherits the priority of the thread that starts it
        policy = worker.submit(partial(os.sched_getscheduler, 0)).result()
        worker.close()
        return policy

    assert in_a_thread(computes) == os.SCHED_OTHER


def test_a_node_without_permission_reports_it_and_works(processes: Processes, observer: Observer):
    process = processes.start("shell_node", {"realtime_priority": PRIORITY, "trouble": "no_rights"})
    event = observer.wait_for_event(NodeEvent.REALTIME_DENIED)
    assert event.level is Level.WARN
    assert f"permit its user rtprio {PRIORITY}" in event.message
    observer.wait_for_event(NodeEvent.ACTIVE)
    assert scheduling(process.pid) == {own()}
