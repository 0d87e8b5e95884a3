"""The process of long computations: results, failures, and its end."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import Future
from functools import partial
from typing import Final

import pytest

from rover_runtime.worker_process import InlineWorker, Worker, WorkerProcess, WorkFailed, _finish

TIMEOUT: Final = 60.0  # [s]
PARENT: Final = """
import os, signal
from rover_runtime.worker_process import WorkerProcess
worker = WorkerProcess()
print(worker.submit(os.getpid).result(), flush=True)
worker.submit(signal.pause)
signal.pause()
"""


@pytest.fixture
def process() -> Iterator[WorkerProcess]:
    worker = WorkerProcess()
    yield worker
    worker.close()


@pytest.fixture(params=[WorkerProcess, InlineWorker])
def worker(request: pytest.FixtureRequest) -> Iterator[Worker]:
    made: Worker = request.param()
    yield made
    made.close()


def test_functions_are_computed_in_order(worker: Worker):
    results = [worker.submit(partial(divmod, number, 3)) for number in range(5)]
    assert [each.result(TIMEOUT) for each in results] == [divmod(n, 3) for n in range(5)]


def test_an_exception_is_a_failure_with_its_text(worker: Worker):
    failed = worker.submit(partial(int, "seven"))
    text = "ValueError: invalid literal for int() with base 10: 'seven'"
    with pytest.raises(WorkFailed) as raised:
        failed.result(TIMEOUT)
    assert str(raised.value) == text
    assert worker.submit(partial(int, "7")).result(TIMEOUT) == 7


def test_arguments_are_not_shared(worker: Worker):
    given = [1, 2, 3]
    assert worker.submit(partial(list.clear, given)).result(TIMEOUT) is None
    assert given == [1, 2, 3]


def test_a_function_without_a_name_is_refused(worker: Worker):
    with pytest.raises((pickle.PicklingError, AttributeError), match="lambda"):
        worker.submit(lambda: 7)


def test_a_result_that_cannot_be_read_is_a_failure():
    future: Future[int] = Future()
    _finish(future, b"no pickle")
    with pytest.raises(WorkFailed, match="its result cannot be read: UnpicklingError"):
        future.result(TIMEOUT)


def test_it_computes_in_one_process_beside_this_one(process: WorkerProcess):
    first = process.submit(os.getpid).result(TIMEOUT)
    assert first == process.pid != os.getpid()
    assert process.submit(os.getpid).result(TIMEOUT) == first


def test_the_death_of_the_process_is_a_failure(process: WorkerProcess):
    pid = process.submit(os.getpid).result(TIMEOUT)
    computing = process.submit(partial(signal.raise_signal, signal.SIGKILL))
    next_one = process.submit(os.getpid)
    with pytest.raises(WorkFailed, match="died"):
        computing.result(TIMEOUT)
    assert next_one.result(TIMEOUT) not in (pid, os.getpid())


def test_a_process_that_died_while_it_rested_is_replaced(process: WorkerProcess):
    pid = process.submit(os.getpid).result(TIMEOUT)
    os.kill(pid, signal.SIGKILL)
    os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
    assert process.submit(os.getpid).result(TIMEOUT) not in (pid, os.getpid())


def test_a_process_without_a_sign_of_life_is_a_failure(process: WorkerProcess):
    pid = process.submit(os.getpid).result(TIMEOUT)
    computing = process.submit(signal.pause)
    os.kill(pid, signal.SIGSTOP)
    with pytest.raises(WorkFailed, match="no sign of life for 2 s"):
        computing.result(TIMEOUT)
    assert process.submit(os.getpid).result(TIMEOUT) != pid


def test_its_end_fails_what_is_not_finished(process: WorkerProcess):
    process.submit(os.getpid).result(TIMEOUT)
    waiting = [process.submit(signal.pause) for _ in range(2)]
    process.close()
    for each in (*waiting, process.submit(signal.pause)):
        with pytest.raises(WorkFailed, match="closed"):
            each.result(TIMEOUT)
    assert process.pid is None


def test_it_ends_with_its_parent():
    command = [sys.executable, "-c", PARENT]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment) as parent:
        assert parent.stdout is not None
        assert int(parent.stdout.readline()) > 0
        parent.kill()
        # The worker has the same standard output: it ends when both have ended.
        assert parent.communicate(timeout=TIMEOUT)[0] == b""
