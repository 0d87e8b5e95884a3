"""Batches of simulated flights on all cores, shared between rows and stored on disk.

A flight is a function of seed, number and arguments. A batch that stores its flights resumes where
it was stopped, and a larger batch adds the new flights only.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from pathlib import Path
from typing import TypeVar

from rover_sim import available_cores, worker_processes
from rover_verify.checks import CheckBatch

T = TypeVar("T")

_FLOWN: dict[tuple[object, ...], Sequence[object]] = {}


def fly_batch(
    batch: CheckBatch, runs: int, task: Callable[..., T], *arguments: object
) -> Sequence[T]:
    """Return the flights of a batch in their order.

    Args:
        batch: provides the seed and the folder of stored flights.
        runs: number of flights.
        task: module-level function of seed, number and arguments that makes a flight.
        arguments: further arguments; their texts must identify them.
    """
    key = (batch.seed, runs, task.__name__, *arguments)
    if key not in _FLOWN:
        flown: dict[int, T] = {}
        with worker_processes(min(available_cores(), runs)) as pool:
            jobs = {
                pool.submit(fly_kept, batch.kept, task, batch.seed, index, *arguments): index
                for index in range(runs)
            }
            for job in as_completed(jobs):
                flown[jobs[job]] = job.result()
                batch.progress(len(flown), runs)
        _FLOWN[key] = [flown[index] for index in range(runs)]
    return _FLOWN[key]  # type: ignore[return-value]


def fly_kept(
    kept: Path | None, task: Callable[..., T], seed: int, index: int, *arguments: object
) -> T:
    """Return a flight, stored or new."""
    if kept is None:
        return task(seed, index, *arguments)
    words = [task.__name__, *arguments, seed, index]
    path = kept / ("_".join(str(word).replace(" ", "-") for word in words) + ".pickle")
    if path.exists():
        found: T = pickle.loads(path.read_bytes())
        return found
    made = task(seed, index, *arguments)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    partial.write_bytes(pickle.dumps(made))
    partial.replace(path)
    return made
