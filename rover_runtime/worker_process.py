"""Computations longer than a tick, in a process beside the components.

A function goes to the process pickled, by its name and with its arguments, and its result comes
back; nothing is shared. So the interpreter's lock and the memory of the components are not touched,
and a computation that crashes or hangs takes nothing along.

While it computes, the process gives signs of life. Without them, or when it dies, the computation
has failed, and the next one starts another process. It ends with its parent, however that ends: its
connection is closed then.
"""

from __future__ import annotations

import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from multiprocessing.connection import Connection, Pipe
from typing import Any, NamedTuple, Protocol, TypeVar

from rover_runtime.stop_signals import stop_signals

T = TypeVar("T")

_ALIVE_PERIOD = 0.2  # of the signs of life [s]
_END_TIMEOUT = 5.0  # [s]
_ALIVE_TIMEOUT = 2.0  # without a sign of life the process counts as hung [s]
_ALIVE = b""
_CLOSED = "the worker process was closed"
_THIS_THREAD = 0


class WorkFailed(Exception):
    """A computation raised an exception, or its process died, hung or was closed."""


class Worker(Protocol):
    """Computes functions, one after the other."""

    def submit(self, function: Callable[[], T]) -> Future[T]:
        """Compute a function that can be pickled; the future raises ``WorkFailed``."""

    def close(self) -> None:
        """Discard what is not finished."""


class InlineWorker:
    """Computes at once in this thread, with the results of a ``WorkerProcess``."""

    def submit(self, function: Callable[[], T]) -> Future[T]:
        """Compute a function."""
        future: Future[T] = Future()
        _finish(future, _compute(pickle.dumps(function)))
        return future

    def close(self) -> None:
        """Discard nothing."""


class _Task(NamedTuple):
    function: bytes
    future: Future[Any]


class WorkerProcess:
    """Computes in a process of its own, which the first computation starts."""

    def __init__(self) -> None:
        self._tasks: queue.Queue[_Task | None] = queue.Queue()
        self._connection: Connection | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._is_closed = False
        self._lock = threading.Lock()  # of the process and whether it may be started
        self._thread = threading.Thread(target=self._run, name="worker", daemon=True)

    @property
    def pid(self) -> int | None:
        """Number of the process; None = it is not running."""
        process = self._process
        return None if process is None or process.poll() is not None else process.pid

    def submit(self, function: Callable[[], T]) -> Future[T]:
        """Compute a function that can be pickled, after those before it."""
        task = _Task(pickle.dumps(function), Future())
        if self._is_closed:
            task.future.set_exception(WorkFailed(_CLOSED))
            return task.future
        self._tasks.put(task)
        if not self._thread.is_alive():
            self._thread.start()
        return task.future

    def close(self) -> None:
        """End the process, and wait until it has ended; what is not finished fails."""
        with self._lock:
            self._is_closed = True
            if self._process is not None:
                self._process.kill()
        self._tasks.put(None)
        if self._thread.is_alive():
            self._thread.join(_END_TIMEOUT)

    # --- in the thread ---------------------------------------------------------------------------

    def _run(self) -> None:
        while (task := self._tasks.get()) is not None:
            try:
                answer = self._exchange(task.function)
            except WorkFailed as failure:
                self._end_process()
                task.future.set_exception(failure)
            else:
                _finish(task.future, answer)
        self._end_process()

    def _exchange(self, function: bytes) -> bytes:
        """Let the process compute; raises WorkFailed."""
        try:
            connection = self._connect()
            connection.send_bytes(function)
            silent = 0.0
            while silent < _ALIVE_TIMEOUT:
                # Polls, and no clock: the time in which this process itself was stopped counts not.
                if not connection.poll(_ALIVE_PERIOD):
                    silent += _ALIVE_PERIOD
                elif (answer := connection.recv_bytes()) != _ALIVE:
                    return answer
                else:
                    silent = 0.0
        except (EOFError, OSError):
            raise WorkFailed(_CLOSED if self._is_closed else "the worker process died") from None
        raise WorkFailed(f"the worker process gave no sign of life for {_ALIVE_TIMEOUT:g} s")

    def _connect(self) -> Connection:
        if self._connection is None or self.pid is None:
            self._end_process()
            self._connection, theirs = Pipe()
            with theirs, self._lock:
                if self._is_closed:
                    raise WorkFailed(_CLOSED)
                self._process = _start(theirs.fileno())
        return self._connection

    def _end_process(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        if self._connection is not None:
            self._connection.close()
        self._process = self._connection = None


def _start(connection: int) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-P", "-m", __name__, str(connection)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    return subprocess.Popen(
        command, env=environment, stdin=subprocess.DEVNULL, pass_fds=(connection,)
    )


def _finish(future: Future[T], answer: bytes) -> None:
    try:
        result, failure = pickle.loads(answer)
    except Exception as error:  # noqa: BLE001 - it is raised where the result is taken
        result, failure = None, f"its result cannot be read: {type(error).__name__}: {error}"
    if failure:
        future.set_exception(WorkFailed(failure))
    else:
        future.set_result(result)


def _compute(function: bytes) -> bytes:
    """Return the result, and the text of the exception that was raised."""
    try:
        result = pickle.loads(function)()
        return pickle.dumps((result, ""))
    except Exception as error:  # noqa: BLE001 - it is raised where the result is taken
        return pickle.dumps((None, f"{type(error).__name__}: {error}"))


def _serve(connection: Connection) -> None:
    """Compute until the parent has closed the connection."""
    pool = ThreadPoolExecutor(1)
    while True:
        computing = pool.submit(_compute, connection.recv_bytes())
        while not wait((computing,), _ALIVE_PERIOD).done:
            connection.send_bytes(_ALIVE)
        connection.send_bytes(computing.result())


def main() -> None:
    """Serve the connection whose number is the argument."""
    for number in stop_signals():  # of a terminal's whole group: the parent ends
        signal.signal(number, signal.SIG_IGN)
    if sys.platform == "linux":  # its parent may have a real-time priority
        os.sched_setscheduler(_THIS_THREAD, os.SCHED_OTHER, os.sched_param(0))
    try:
        _serve(Connection(int(sys.argv[1])))
    except (EOFError, OSError):
        pass
    finally:
        os._exit(0)  # a computation whose result nobody takes is not waited for


if __name__ == "__main__":
    main()
