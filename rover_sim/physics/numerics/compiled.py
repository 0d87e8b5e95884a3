"""Decorators that compile the numerics with numba, and the check of their cache on disk."""

import functools
import hashlib
import inspect
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Final

from numba import njit, types
from numba.core.caching import FunctionCache
from numba.core.registry import CPUDispatcher
from numba.core.runtime.nrt import rtsys

from rover_sim.physics.numerics.compilers import KernelCompiler, LinkedCompiler

# Without nnan and ninf: a diverging iteration must pass its NaN to the finiteness tests.
FAST_MATH = frozenset({"contract", "reassoc", "nsz", "arcp", "afn"})

_PHYSICS = __package__.rpartition(".")[0]
_FOLDER = Path(__file__).parents[1]
_IMPORT = re.compile(
    rf"^\s*(?:from {re.escape(_PHYSICS)}((?:\.\w+)*) import (\([^)]*\)|.*)"
    rf"|import {re.escape(_PHYSICS)}((?:\.\w+)+).*)$",
    re.MULTILINE,
)


@functools.cache
def _imported_by(path: Path) -> frozenset[Path]:
    """The modules of the physics that a file imports itself, by any form of absolute import."""
    found: set[Path] = set()
    for package, names, module in _IMPORT.findall(path.read_text(encoding="utf-8")):
        place = _FOLDER.joinpath(*(package or module).split("."))
        for imported in (place, *(place / name for name in re.findall(r"\w+", names))):
            found.update((imported.with_suffix(".py"), imported / "__init__.py"))
    return frozenset(file for file in found if file.exists())


def sources_of(path: Path) -> frozenset[Path]:
    """The file and all modules of the physics, in any room, that it imports, directly or not."""
    found: set[Path] = set()
    waiting = [path]
    while waiting:
        current = waiting.pop()
        if current not in found:
            found.add(current)
            waiting.extend(_imported_by(current))
    return frozenset(found)


@functools.cache
def source_stamp(path: Path) -> str:
    """Digest of the contents of `sources_of` a file."""
    digest = hashlib.sha256()
    for source in sorted(sources_of(path)):
        inside = source.is_relative_to(_FOLDER)
        name = source.relative_to(_FOLDER).as_posix() if inside else source.name
        digest.update(name.encode())
        digest.update(source.read_bytes())
    return digest.hexdigest()


class _Compiled(CPUDispatcher):
    """Dispatcher that does not compile another version for each literal argument."""

    def get_call_template(self, args: Any, kws: Any) -> Any:
        unliteral: Any = types.unliteral
        return super().get_call_template(tuple(unliteral(arg) for arg in args), kws)


class _Inner(_Compiled):
    """Dispatcher without a Python wrapper; a call from Python (tests, a prompt) compiles one."""

    _entry: Callable[..., Any] | None = None

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        if self._entry is None:
            inner = self
            self._entry = njit(**_ALWAYS)(lambda *given: inner(*given))  # noqa: PLW0108 - numba compiles the lambda
        return self._entry(*inspect.signature(self.py_func).bind(*args, **kwargs).args)


class _Cache(FunctionCache):
    """Cache on disk that loads machine code without numba's registries of types and functions.

    Only a compilation needs the registries, and fills them. Their import, with scipy's linear
    algebra, takes longer than to load all functions.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load the code for a signature; None: it is not in the cache."""
        runtime: Any = rtsys
        runtime.initialize(target_context)  # the code refers to its symbols
        numba_cache: Any = super()
        with numba_cache._guard_against_spurious_io_errors():
            return numba_cache._load_overload(sig, target_context)


_functions: list[Any] = []

_ALWAYS: Final[dict[str, Any]] = {
    "nogil": True,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
    "pipeline_class": KernelCompiler,
}
_FOR_CALLERS: Final[dict[str, Any]] = {
    "no_cpython_wrapper": True,
    "pipeline_class": LinkedCompiler,
}


def _decorator(kind: type[_Compiled], **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`njit` with a cache on disk that is invalidated by a change of any source.

    numba regards a cached function as current as long as its own file is unchanged, though the
    compiled code includes functions of other files: after a change of these it would run the old
    code. So the source stamp is replaced by the digest of all sources.
    """
    compile_later: Any = njit(**{"cache": True, **_ALWAYS, **options})

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = compile_later(function)
        dispatcher.__class__ = kind
        dispatcher._cache.__class__ = _Cache
        _functions.append(dispatcher)
        stamp = source_stamp(Path(function.__code__.co_filename))
        index = dispatcher._cache._cache_file
        index._source_stamp = stamp
        # numba compares the version before it unpickles the index. An index of other sources may
        # name types that no longer exist.
        index._version = f"{index._version} {stamp}"
        return dispatcher

    return decorate


def compile_anew() -> None:
    """Neither load functions from the cache on disk nor write them, in this process."""
    for function in _functions:
        function._cache.disable()


def called_from_python() -> list[Any]:
    """Return all functions but the `inner` ones."""
    return [function for function in _functions if type(function) is not _Inner]


def write_to_cache(functions: Iterable[Any]) -> None:
    """Write these functions to the cache on disk once they are compiled; never load them."""
    for function in functions:
        function._cache.enable()
        function._cache.load_overload = _do_nothing


def count_written(since_ns: int) -> int:
    """Return the number of functions written to the cache on disk since a time [ns since 1970]."""
    indices = {Path(each._cache._cache_file._index_path) for each in _functions}
    return sum(path.exists() and path.stat().st_mtime_ns >= since_ns for path in indices)


def load_when(is_written: Callable[[], object], function: Any) -> None:
    """Load a function from the cache on disk after a call of `is_written`; never write it."""
    cache = function._cache
    cache.enable()
    load = type(cache).load_overload

    def load_overload(*arguments: Any) -> Any:
        is_written()
        return load(cache, *arguments)

    cache.load_overload = load_overload
    cache.save_overload = _do_nothing


def _do_nothing(*_arguments: object) -> None:
    pass


def kernel_with(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`kernel` with further options of numba."""
    return _decorator(_Compiled, _nrt=False, fastmath=set(FAST_MATH), **options)


def inner_with(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`inner` with further options of numba."""
    return _decorator(_Inner, _nrt=False, fastmath=set(FAST_MATH), **_FOR_CALLERS, **options)


kernel = kernel_with()
"""Decorator for arithmetic: allows fused multiply-add and reordered sums (see FAST_MATH).

Such a function cannot allocate, and it does not count references to its arrays, which would cost
more than a small tether's step.
"""

inner = inner_with()
"""As `kernel`, for functions that only compiled functions call.

It has no Python wrapper, whose compilation would take as long as that of many a function.
"""

checked = _decorator(_Compiled, _nrt=False)
"""Decorator for control flow that tests convergence and finiteness: strict IEEE arithmetic."""

checked_inner = _decorator(_Inner, _nrt=False, **_FOR_CALLERS)
"""As `checked`, for functions that only compiled functions call."""
