"""How the numerics are compiled."""

from typing import Any

from numba import njit

# Without nnan and ninf: a diverging iteration must show its NaN to the tests that look for it.
FAST_MATH = frozenset({"contract", "reassoc", "nsz", "arcp", "afn"})

_njit: Any = njit  # its types leave out _nrt

kernel: Any = _njit(
    cache=True, nogil=True, error_model="numpy", _nrt=False, fastmath=set(FAST_MATH)
)
"""For arithmetic: products feed additions, sums may be reordered.

Neither these functions nor the `checked` ones can allocate, and they do not count references to
the arrays that they are given, which would cost more than a small tether's step.
"""

checked: Any = _njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
"""For control flow that tests for convergence and finiteness: arithmetic as written."""

allocating: Any = _njit(cache=True, nogil=True, error_model="numpy")
"""For what makes arrays."""
