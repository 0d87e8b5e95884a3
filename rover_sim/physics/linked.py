"""Compiles functions that other compiled functions take into their own code, and nobody else calls.

numba turns every function into machine code as soon as it is compiled, though a caller links and
optimises the intermediate code of what it calls and emits it once more. For a tree of small
functions that is an eighth of all the time it takes to compile. Here such a function stays
intermediate code, in memory and in the cache.
"""

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler


class _NoEngine:
    """What a compiler tells of a function to the engine that would run it."""

    def set_env(self, name: str, environment: object) -> None:
        """Needed by what calls Python alone."""


class _Library(JITCodeLibrary):
    """Intermediate code that is linked into others and has no machine code of its own."""

    @property
    def codegen(self) -> Any:
        return _NoEngine()

    def get_pointer_to_function(self, name: str) -> int:  # noqa: ARG002 - numba's signature
        """There is none."""
        return 0

    def serialize_using_object_code(self) -> Any:
        """For the cache: as intermediate code."""
        return self.serialize_using_bitcode()

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True


class LinkedCompiler(Compiler):
    """numba's compiler, `pipeline_class`, for functions without an entry from Python or C."""

    def __init__(self, typingctx: Any, targetctx: Any, library: Any, *rest: Any) -> None:
        super().__init__(typingctx, targetctx, library, *rest)
        self.state.library = _Library(targetctx.codegen(), self.__class__.__name__)
