"""What the bench measures of any code: one run at one setting, and how far it was off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Positions of the tether's tip are kept this often; every step size of the bench divides it [s].
SAMPLE = 0.1


@dataclass(frozen=True)
class BenchSetting:
    """How a code integrates.

    Attributes:
        h: step size [s].
        tolerance: of the Newton iteration, in the code's own meaning.
        method: the code's name of its method.
    """

    h: float
    tolerance: float
    method: str

    def __str__(self) -> str:
        """As the table shows it."""
        return f"{self.h * 1e3:.3g} ms, {self.tolerance:g}"


@dataclass(frozen=True)
class Trial:
    """One run: what it cost and where the tether's tip went.

    Attributes:
        cpu: CPU time of the run [s], without building and warming up.
        path: the tip's positions every `SAMPLE`, the first at the start [m], (k, 2).
        iterations: Newton iterations, 0 where the code does not report them.
    """

    cpu: float
    path: NDArray[np.float64]
    iterations: int = 0

    def error(self, reference: NDArray[np.float64], until: float) -> float:
        """Largest distance of the tip from a reference path at the samples up to a time [m]."""
        count = round(until / SAMPLE) + 1
        distance = np.linalg.norm(self.path[:count] - reference[:count], axis=1)
        return float(np.max(distance))
