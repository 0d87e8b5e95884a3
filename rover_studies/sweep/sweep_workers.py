"""Workers of a sweep: local processes, or a dask.distributed cluster.

Both have an executor of `concurrent.futures`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

from msg_schemas.package import package_version
from rover_sim import AnyScenario, compile_ahead, worker_processes

_CONNECT_TIMEOUT = 20.0


class WorkersError(RuntimeError):
    """No workers are available; the message has the reason."""


@dataclass(frozen=True)
class Workers:
    """An executor and its number of parallel batches."""

    executor: Executor
    count: int
    about: str
    of_cluster: bool = False


def compile_all(scenarios: Iterable[AnyScenario]) -> None:
    """Compile the plants of some scenarios into this machine's cache."""
    for scenario in scenarios:
        compile_ahead(scenario)


@contextlib.contextmanager
def local_processes(count: int, scenarios: Iterable[AnyScenario] = ()) -> Iterator[Workers]:
    """Start local processes with `worker_processes`.

    Args:
        count: number of processes.
        scenarios: whose plants are compiled first.
    """
    compile_all(scenarios)
    with worker_processes(count) as pool:
        yield Workers(pool, count, f"{count} process{'es' if count > 1 else ''}")


@contextlib.contextmanager
def dask_cluster(address: str, scenarios: Iterable[AnyScenario] = ()) -> Iterator[Workers]:
    """Connect to the workers of a dask.distributed scheduler.

    Args:
        address: of the scheduler, such as ``tcp://host:8786``.
        scenarios: whose plants are compiled first, on every worker's machine.

    Raises:
        WorkersError: dask is not installed, no scheduler answers, it has no workers, or the workers
            have another version of the package.
    """
    try:
        from distributed import Client  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise WorkersError(
            "dask.distributed is not installed: pip install 'mother_rover[cluster]'"
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
        executor = client.get_executor(pure=False)
        yield Workers(executor, threads, f"{threads} workers at {address}", of_cluster=True)
    finally:
        client.close()


def _check_versions(call: Callable[..., Mapping[str, Any]], address: str) -> None:
    mine = package_version()
    try:
        found = {str(value) for value in call(package_version).values()}
    except Exception as error:
        raise WorkersError(
            f"the workers at {address} cannot load mother_rover: {error}; install the same "
            "version of the package there"
        ) from error
    if found != {mine}:
        raise WorkersError(
            f"the workers at {address} have version {', '.join(sorted(found))} of the package, "
            f"this is {mine}; install the same version"
        )
