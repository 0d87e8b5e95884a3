"""What one core can do at most, measured, and what our kernels make of it."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numba import njit

# Multiplications and additions of the planar tether kernel per element and Newton iteration,
# counted from its equations: midpoint slopes and their increments at the five quadrature points
# (120), strains and forces there (60), their sums over the points (90), the tangent's tensors and
# their sums (250), spreading to the element's 8 x 8 tangent and residual with mass and bending
# (330), elimination of a node's 4 x 4 block with five columns (370), substitution (35).
FLOPS_PER_ELEMENT_ITERATION = 1255

# The same of the spatial tether: slopes with three components (180), strains and forces (75), sums
# over the points (150), the tangent's symmetric 3 x 3 tensors (500), spreading to the 12 x 12
# tangent (740), elimination of a node's 6 x 6 block with seven columns (1150), substitution (80).
# Contact with the ground, the predictor and the energy balance come on top and are not counted.
FLOPS_PER_SPATIAL_ELEMENT_ITERATION = 2875

_DEGREE = 32
_jit: Any = njit(cache=True, fastmath=True, nogil=True, error_model="numpy")


@_jit  # type: ignore[untyped-decorator]
def _horner(x: Any, out: Any, repeat: int) -> None:
    for _ in range(repeat):
        for i in range(x.size):
            t = x[i]
            a, b = 0.5, 0.25
            for _k in range(_DEGREE):
                a = a * t + 0.75
                b = b * t + 0.5
            out[i] = a + b


def peak_gflops() -> float:
    """Fused multiply-adds of one core in the fastest loop we know, as 10^9 operations per second.

    Two polynomials by Horner's rule at each of 4096 points: long chains without memory traffic,
    which the compiler spreads over the vector units. The best of several runs.
    """
    x, out = np.linspace(0.0, 0.5, 4096), np.empty(4096)
    _horner(x, out, 1)
    repeat, best = 40, np.inf
    for _ in range(15):
        began = time.process_time()
        _horner(x, out, repeat)
        best = min(best, time.process_time() - began)
    return float(repeat * x.size * 4 * _DEGREE / best * 1e-9)
