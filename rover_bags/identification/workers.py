"""Simulate many runs, in this process or in worker processes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from typing import Any

from tqdm import tqdm

from rover_bags.identification.noise import Floats
from rover_bags.identification.runs import IdentificationRun, Task, predict
from rover_sim import compile_ahead, worker_processes

_experiments: list[IdentificationRun] = []
"""Experiments of a worker process."""


class Simulations:
    """Predicts the readings of experiments; see `fit.Predictor`.

    Attributes:
        runs: number of simulations made.
    """

    def __init__(
        self,
        experiments: Sequence[IdentificationRun],
        executor: Executor | None,
        jobs: int,
        bar: Any,
    ) -> None:
        self._experiments = list(experiments)
        self._executor = executor
        self._jobs = jobs
        self._bar = bar
        self.runs = 0

    def __call__(self, tasks: Sequence[Task]) -> list[Floats]:
        """Return the readings of each task, in the order of the tasks."""
        self.runs += len(tasks)
        found = []
        for predicted in self._results(tasks):
            found.append(predicted)
            self._bar.update()
        return found

    def _results(self, tasks: Sequence[Task]) -> Iterator[Floats]:
        if self._executor is None:
            for number, values, start in tasks:
                yield predict(self._experiments[number], values, start)
            return
        batch = max(1, len(tasks) // (4 * self._jobs))
        yield from self._executor.map(_predict, tasks, chunksize=batch)


@contextmanager
def simulations(
    experiments: Sequence[IdentificationRun], *, jobs: int = 1, show_progress: bool = False
) -> Iterator[Simulations]:
    """Provide simulations in a number of processes; 1: in this process."""
    for one in experiments:
        compile_ahead(one.scenario)
    with ExitStack() as closing:
        executor = None
        if jobs > 1:
            executor = closing.enter_context(worker_processes(jobs, _remember, list(experiments)))
        bar = closing.enter_context(
            tqdm(unit=" simulations", desc="identifying", disable=not show_progress)
        )
        yield Simulations(experiments, executor, jobs, bar)


def _remember(experiments: list[IdentificationRun]) -> None:
    _experiments[:] = experiments


def _predict(task: Task) -> Floats:
    number, values, start = task
    return predict(_experiments[number], values, start)
