"""Checks: each measures what one requirement limits.

A check takes a `CheckBatch` (how many runs, which seed, a scratch folder) and returns a `Measured`
value; it judges nothing. What it cannot do here (a missing tool) it reports by `NotPossible`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np


class NotPossible(RuntimeError):
    """The check cannot be run on this machine; the message names what is missing."""


class SetsNotGiven(NotPossible):
    """The check needs measured sets, and no folder of such is given."""


@dataclass(frozen=True)
class Measured:
    """What a check found.

    Attributes:
        value: the number that is held to the limit, in the limit's unit.
        note: one sentence about how it came about.
        details: further values, by name.
    """

    value: float
    note: str = ""
    details: Mapping[str, float | str] = field(default_factory=dict)

    @classmethod
    def largest(cls, values: Mapping[str, float], note: str = "") -> Measured:
        """The largest magnitude of named values; NaN if one of them is."""
        return cls(float(np.max(np.abs(list(values.values())))), note, values)

    @classmethod
    def number_of(cls, faults: Mapping[str, str], note: str = "") -> Measured:
        """The number of named faults, each with its description."""
        return cls(len(faults), note, faults)


@dataclass(frozen=True)
class CheckBatch:
    """How a check is to be run.

    Attributes:
        runs: number of random runs, where a check makes some.
        seed: seed of everything random.
        folder: scratch folder of this check, empty.
        progress: called with the number of finished runs and of all.
        kept: folder of what a check wants to find again when it is started again after a kill,
            valid for one state of the source; None: nothing is kept.
        sets: folder of measured sets, as `mother_rover validate summary` reads it; None: not given.
        hours: simulated time of the missions flown for endurance [h].
    """

    runs: int
    seed: int
    folder: Path
    progress: Callable[[int, int], None] = lambda _done, _total: None
    kept: Path | None = None
    sets: Path | None = None
    hours: float = 1.0

    def generators(self, runs: int | None = None) -> Iterator[np.random.Generator]:
        """One independent random generator a run, the same whatever the number of runs."""
        count = self.runs if runs is None else runs
        for index in range(count):
            yield np.random.default_rng([self.seed, index])
            self.progress(index + 1, count)


def described(result: Any) -> str:
    """Fields of a named tuple as text, numbers with four digits."""
    return ", ".join(f"{name} {_shown(value)}" for name, value in result._asdict().items())


def _shown(value: Any) -> str:
    if hasattr(value, "_asdict"):
        return f"({described(value)})"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def per_run(results: Iterable[Any]) -> dict[str, str]:
    """Details of a batch: the fields of each result, by the number of its run."""
    return {f"run {index}": described(each) for index, each in enumerate(results)}


Check = Callable[[CheckBatch], Measured]

Run = Callable[[int, np.random.Generator], Iterable[tuple[str, float]]]
"""One random run of a check: from its number and its generator to named values."""


def worst_of(note: str, most: int | None = None) -> Callable[[Run], Check]:
    """Make a check from one of its random runs; it measures the largest magnitude of all values.

    Args:
        note: about the runs; ``{runs}`` stands for their number.
        most: largest number of runs; None: as many as the batch has.
    """

    def check_of(run: Run) -> Check:
        def check(batch: CheckBatch) -> Measured:
            runs = batch.runs if most is None else min(batch.runs, most)
            details = {
                f"run {index}: {name}": value
                for index, generator in enumerate(batch.generators(runs))
                for name, value in run(index, generator)
            }
            return Measured.largest(details, note.format(runs=runs))

        check.__doc__ = run.__doc__
        return check

    return check_of
