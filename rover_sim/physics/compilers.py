"""numba's compiler without what our numerics never need, so that a first start takes seconds less.

Two things are left out of every compilation: passes for what these functions do not contain
(closures, `with` blocks, inlining before types are known, expressions on whole arrays), and asking
again what an operator makes of operands that it was asked about before: numba tries dozens of
candidates for every `+`.

Functions that other compiled functions alone call are, moreover, neither optimised nor turned into
machine code by themselves: whoever calls them links their intermediate code, optimises it together
with its own, and emits it.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

from numba.core import types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager
from numba.core.targetconfig import ConfigStack

_NEVER_NEEDED: Final = frozenset(
    {
        "DumpParforDiagnostics",
        "FindLiterallyCalls",
        "InlineClosureLikes",
        "InlineInlinables",
        "InlineOverloads",
        "LiteralPropagationSubPipelinePass",
        "LiteralUnroll",
        "MakeFunctionToJitFunction",
        "NopythonRewrites",
        "RewriteDynamicRaises",
        "WithLifting",
    }
)

_answers: dict[Any, dict[Any, Any]] = {}
"""By flags of the compilation: the signature of a built-in function for types of operands."""


@contextmanager
def _remembering(flags: Any) -> Iterator[None]:
    """Let built-in functions give the same answer to the same question without thinking again.

    Types are asked for while they are inferred and once more for each use while code is made. Only
    what is compiled with these flags is answered so; what a function calls may have others.
    """
    known = _answers.setdefault(flags.copy(), {})
    depth = len(ConfigStack()) + 1
    builtin: Any = types.Function
    think = builtin.get_call_type

    def get_call_type(function: Any, context: Any, args: Any, kws: Any) -> Any:
        if kws or len(ConfigStack()) != depth:
            return think(function, context, args, kws)
        question = (function, *args)
        if question not in known:
            answer = think(function, context, args, kws)
            if answer is None:
                return None
            known[question] = answer
        return known[question]

    builtin.get_call_type = get_call_type
    try:
        yield
    finally:
        builtin.get_call_type = think


class KernelCompiler(CompilerBase):
    """numba's compiler, `pipeline_class`, for scalar code on arrays and tuples."""

    def _compile_core(self) -> Any:
        with _remembering(self.state.flags):
            return super()._compile_core()

    def define_pipelines(self) -> list[Any]:
        """The passes of numba's nopython pipeline that are needed."""
        passes = PassManager("kernel")
        for each, description in DefaultPassBuilder.define_nopython_pipeline(self.state).passes:
            if each.__name__ not in _NEVER_NEEDED:
                passes.add_pass(each, description)
        passes.finalize()
        return [passes]


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

    def _optimize_final_module(self) -> None:
        """Left to the callers."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True


class LinkedCompiler(KernelCompiler):
    """`KernelCompiler` for functions without an entry from Python or C."""

    def __init__(self, typingctx: Any, targetctx: Any, library: Any, *rest: Any) -> None:
        super().__init__(typingctx, targetctx, library, *rest)
        self.state.library = _Library(targetctx.codegen(), self.__class__.__name__)
