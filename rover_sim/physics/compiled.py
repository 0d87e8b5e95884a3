"""How the numerics are compiled, and when a compiled function kept on disk is out of date."""

import functools
import hashlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba import njit

# Without nnan and ninf: a diverging iteration must show its NaN to the tests that look for it.
FAST_MATH = frozenset({"contract", "reassoc", "nsz", "arcp", "afn"})

_IMPORT = re.compile(
    rf"^from {re.escape(__package__)}(?:\.(\w+))? import (\([^)]*\)|.*)$", re.MULTILINE
)


def sources_of(path: Path) -> frozenset[Path]:
    """The file and all modules of this folder that it imports, directly or not."""
    found: set[Path] = set()
    waiting = [path]
    while waiting:
        current = waiting.pop()
        if current in found or not current.exists():
            continue
        found.add(current)
        for module, names in _IMPORT.findall(current.read_text(encoding="utf-8")):
            modules = [module] if module else re.findall(r"\w+", names)
            waiting.extend(Path(__file__).parent / f"{name}.py" for name in modules)
    return frozenset(found)


@functools.cache
def source_stamp(path: Path) -> str:
    """Digest of the contents of `sources_of` a file."""
    digest = hashlib.sha256()
    for source in sorted(sources_of(path)):
        digest.update(source.name.encode())
        digest.update(source.read_bytes())
    return digest.hexdigest()


def _decorator(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`njit` with a cache on disk that knows what a function is compiled from.

    numba takes a cached function as fresh as long as its own file is unchanged, though it holds
    the functions that it calls in other files as well: after a change of these it would go on with
    the old ones. So the stamp that it compares is replaced by that of all sources.
    """
    compile_later: Any = njit(cache=True, nogil=True, error_model="numpy", **options)

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = compile_later(function)
        dispatcher._cache._cache_file._source_stamp = source_stamp(
            Path(function.__code__.co_filename)
        )
        return dispatcher

    return decorate


kernel = _decorator(_nrt=False, fastmath=set(FAST_MATH))
"""For arithmetic: products feed additions, sums may be reordered.

Neither these functions nor the `checked` ones can allocate, and they do not count references to
the arrays that they are given, which would cost more than a small tether's step.
"""

checked = _decorator(_nrt=False)
"""For control flow that tests for convergence and finiteness: arithmetic as written."""

allocating = _decorator()
"""For what makes arrays."""

inner = _decorator(
    _nrt=False, fastmath=set(FAST_MATH), no_cpython_wrapper=True, no_cfunc_wrapper=True
)
"""As `kernel`, for what compiled functions alone call.

Without its entry from Python, which takes seconds to compile for arguments of many numbers.
"""

checked_inner = _decorator(_nrt=False, no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""As `checked`, for what compiled functions alone call."""
