"""Pool of local worker processes for parallel simulations.

The statics of a scenario hold the interpreter's lock, so threads would not help. Each worker is
single-threaded, leaves Ctrl-C to its parent, and ends with its parent in any case.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from multiprocessing.process import BaseProcess
from typing import Any

from rover_runtime.single_threaded import SINGLE_THREADED

_OF_A_TERMINAL = (signal.SIGINT, signal.SIGHUP)


def available_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


@contextlib.contextmanager
def worker_processes(
    count: int, prepare: Callable[..., None] | None = None, *arguments: Any
) -> Iterator[ProcessPoolExecutor]:
    """Start worker processes, and end them with the block.

    Pending tasks are cancelled at the end of the block; after an error, running tasks as well.

    Args:
        count: of processes.
        prepare: called in each process at its start; a function of a module.
        arguments: of `prepare`.
    """
    # A child reads its environment when it starts, before numpy is imported.
    kept = {name: os.environ.get(name) for name in SINGLE_THREADED}
    os.environ.update(SINGLE_THREADED)
    others = multiprocessing.active_children()
    context = multiprocessing.get_context("spawn")
    workers: list[BaseProcess] = []
    with _terminal_ignored():  # also by the tracker of resources, which the pool starts
        pool = ProcessPoolExecutor(count, context, _start, (prepare, arguments))
    try:
        with _terminal_ignored():
            for _ in range(count):
                pool.submit(_nothing)  # starts a worker, as none is idle yet
        workers = [each for each in multiprocessing.active_children() if each not in others]
        yield pool
    except BaseException:
        for worker in workers:
            worker.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        _restore(kept)


def _restore(kept: Mapping[str, str | None]) -> None:
    for name, value in kept.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


@contextlib.contextmanager
def _terminal_ignored() -> Iterator[None]:
    """Start processes that ignore what a terminal sends to all of them: the parent ends them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    kept = {number: signal.signal(number, signal.SIG_IGN) for number in _OF_A_TERMINAL}
    try:
        yield
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)


def _nothing() -> None:
    """A task that starts a worker."""


def _start(prepare: Callable[..., None] | None, arguments: tuple[Any, ...]) -> None:
    """Ignore what a terminal sends, and watch the parent."""
    for number in _OF_A_TERMINAL:
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, name="parent watch", daemon=True).start()
    if prepare is not None:
        prepare(*arguments)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
