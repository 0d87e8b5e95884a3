"""Batches of flights: on all cores, once for all rows that look at them, each kept on disk.

A flight is one function of seed, number and arguments. Where a batch keeps its runs, one that was
stopped goes on where it was, and one with more runs flies those that are new.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from pathlib import Path
from typing import TypeVar

from rover_sim import available_cores, worker_processes
from rover_verify.checks import Batch

T = TypeVar("T")

_FLOWN: dict[tuple[object, ...], Sequence[object]] = {}


def fly_batch(batch: Batch, runs: int, task: Callable[..., T], *arguments: object) -> Sequence[T]:
    """Flights of a batch, in their order.

    Args:
        batch: its seed, and where flights are kept.
        runs: number of flights.
        task: flies one, from seed, number and arguments; a function of a module.
        arguments: the rest of what it takes, with words that tell them apart.
    """
    key = (batch.seed, runs, task.__name__, *arguments)
    if key not in _FLOWN:
        _FLOWN[key] = _spread(batch, runs, task, *arguments)
    return _FLOWN[key]  # type: ignore[return-value]


def _spread(batch: Batch, runs: int, task: Callable[..., T], *arguments: object) -> list[T]:
    flown: dict[int, T] = {}
    with worker_processes(min(available_cores(), runs)) as pool:
        jobs = {
            pool.submit(fly_kept, batch.kept, task, batch.seed, index, *arguments): index
            for index in range(runs)
        }
        for job in as_completed(jobs):
            flown[jobs[job]] = job.result()
            batch.progress(len(flown), runs)
    return [flown[index] for index in range(runs)]


def fly_kept(
    kept: Path | None, task: Callable[..., T], seed: int, index: int, *arguments: object
) -> T:
    """A flight, or what is kept of it."""
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
