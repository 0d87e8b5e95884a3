"""Who does the work: processes of this machine, or a dask.distributed cluster.

Both take batches and give `concurrent.futures.Future`s. The statics of a scenario hold Python's
lock, so threads would not help.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from rover_sim import AnyScenario, compile_ahead

_SINGLE_THREADED = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)
_CONNECT_TIMEOUT = 20.0


class WorkersError(RuntimeError):
    """No workers are to be had; says why."""


@dataclass(frozen=True)
class Workers:
    """An executor and how many batches it works on at a time."""

    executor: Executor
    count: int
    about: str


def package_version() -> str:
    """Version of the package that runs here."""
    try:
        return version("mother_rover")
    except PackageNotFoundError:
        return "uninstalled"


def compile_all(scenarios: Iterable[AnyScenario]) -> None:
    """Have the code of some scenarios in this machine's cache."""
    for scenario in scenarios:
        compile_ahead(scenario)


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0))


@contextlib.contextmanager
def local_processes(count: int, scenarios: Iterable[AnyScenario] = ()) -> Iterator[Workers]:
    """Processes of this machine, one thread each; they end with this process, however it ends.

    Args:
        count: how many.
        scenarios: compiled beforehand.
    """
    compile_all(scenarios)
    # The child reads its environment when it starts, before numpy is imported.
    kept = {name: os.environ.get(name) for name in _SINGLE_THREADED}
    os.environ.update(_SINGLE_THREADED)
    pool = ProcessPoolExecutor(
        count, mp_context=multiprocessing.get_context("spawn"), initializer=_start_worker
    )
    try:
        with _ctrl_c_ignored():
            for _ in range(count):
                pool.submit(_nothing)  # starts one, as none has come to rest yet
        yield Workers(pool, count, f"{count} process{'es' if count > 1 else ''}")
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
def _ctrl_c_ignored() -> Iterator[None]:
    """What starts meanwhile never hears Ctrl-C: it is the parent's to end it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    kept = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, kept)


def _nothing() -> None:
    """A task that starts a worker."""


def _start_worker() -> None:
    """Leave Ctrl-C to the parent, and do not outlive it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, name="parent watch", daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextlib.contextmanager
def dask_cluster(address: str, scenarios: Iterable[AnyScenario] = ()) -> Iterator[Workers]:
    """The workers of a dask.distributed scheduler.

    Args:
        address: of the scheduler, such as ``tcp://host:8786``.
        scenarios: compiled beforehand on every worker's machine.

    Raises:
        WorkersError: dask is not installed, nobody answers there, no worker has joined, or the
            workers run another version of the package.
    """
    try:
        from distributed import Client  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise WorkersError(
            "dask.distributed is not installed here: pip install 'mother_rover[cluster]'"
        ) from error
    try:
        client = Client(address, timeout=_CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise WorkersError(f"no dask scheduler answers at {address}: {error}") from error
    try:
        threads = sum(client.nthreads().values())
        if not threads:
            raise WorkersError(f"the dask scheduler at {address} has no workers")
        _check_versions(client.run, address)
        client.run(compile_all, list(scenarios))
        yield Workers(client.get_executor(pure=False), threads, f"{threads} workers at {address}")
    finally:
        client.close()


def _check_versions(ask: Callable[..., Mapping[str, Any]], address: str) -> None:
    mine = package_version()
    try:
        found = {str(value) for value in ask(package_version).values()}
    except Exception as error:
        raise WorkersError(
            f"the workers at {address} cannot load mother_rover: {error}; install the same "
            "version of the package there"
        ) from error
    if found != {mine}:
        raise WorkersError(
            f"the workers at {address} run version {', '.join(sorted(found))} of the package, "
            f"this is {mine}; they should be the same"
        )
