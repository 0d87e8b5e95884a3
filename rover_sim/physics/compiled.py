"""How the numerics are compiled."""

from typing import Any

from numba import njit

# Without nnan and ninf: a diverging iteration must show its NaN to the tests that look for it.
FAST_MATH = frozenset({"contract", "reassoc", "nsz", "arcp", "afn"})

kernel: Any = njit(cache=True, nogil=True, error_model="numpy", fastmath=set(FAST_MATH))
"""For arithmetic: products feed additions, sums may be reordered."""

checked: Any = njit(cache=True, nogil=True, error_model="numpy")
"""For control flow that tests for convergence and finiteness: arithmetic as written."""
