"""numba compiler pipelines reduced to what the kernels need; a first start is seconds faster.

`KernelCompiler` omits the passes for features that the kernels do not use (closures, `with` blocks,
inlining before type inference, whole-array expressions), and caches the result type of an operator
for given operand types: numba tries dozens of candidates for every `+`.

Their machine code does not depend on what else a process has loaded; see `_Executable`.

`LinkedCompiler`, for functions that only compiled functions call, moreover neither optimises nor
emits machine code: the caller links their LLVM IR, optimises it together with its own and emits it.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

import llvmlite.binding as ll
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

_signatures: dict[Any, dict[Any, Any]] = {}
"""By flags of the compilation: the signature of a built-in function for operand types."""


@contextmanager
def _cached_signatures(flags: Any) -> Iterator[None]:
    """Cache the call types of built-in functions.

    numba resolves them during type inference and again for each use during lowering. Only the
    function compiled with these flags uses the cache; its callees may have other flags.
    """
    known = _signatures.setdefault(flags.copy(), {})
    depth = len(ConfigStack()) + 1
    builtin: Any = types.Function
    resolve = builtin.get_call_type

    def get_call_type(function: Any, context: Any, args: Any, kws: Any) -> Any:
        if kws or len(ConfigStack()) != depth:
            return resolve(function, context, args, kws)
        key = (function, *args)
        if key not in known:
            signature = resolve(function, context, args, kws)
            if signature is None:
                return None
            known[key] = signature
        return known[key]

    builtin.get_call_type = get_call_type
    try:
        yield
    finally:
        builtin.get_call_type = resolve


class _Executable(JITCodeLibrary):
    """Machine code that calls its own copies of linked functions.

    numba gives these weak symbols. Of two libraries with the same function, the one loaded last
    would call the other's copy, which was optimised for other callers: the last bits of results
    would depend on the order in which a process loads its functions.
    """

    def _finalize_final_module(self) -> None:
        self._finalized = True
        self._get_module_for_linking()  # keeps a copy with weak symbols, for callers to link
        for function in self._final_module.functions:
            if function.linkage is ll.Linkage.linkonce_odr:
                function.linkage = ll.Linkage.internal
        super()._finalize_final_module()


class KernelCompiler(CompilerBase):
    """numba's compiler, `pipeline_class`, for scalar code on arrays and tuples."""

    _library: type[JITCodeLibrary] = _Executable

    def __init__(self, typingctx: Any, targetctx: Any, library: Any, *rest: Any) -> None:
        super().__init__(typingctx, targetctx, library, *rest)
        self.state.library = self._library(targetctx.codegen(), self.__class__.__name__)
        self.state.library.enable_object_caching()

    def _compile_core(self) -> Any:
        with _cached_signatures(self.state.flags):
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
    """Stand-in for the execution engine of code that is linked and never run by itself."""

    def set_env(self, name: str, environment: object) -> None:
        """Does nothing: only functions that call Python need an environment."""


class _Library(JITCodeLibrary):
    """LLVM IR that callers link; it has no machine code of its own."""

    @property
    def codegen(self) -> Any:
        return _NoEngine()

    def get_pointer_to_function(self, name: str) -> int:  # noqa: ARG002 - numba's signature
        """Return 0: there is no machine code."""
        return 0

    def serialize_using_object_code(self) -> Any:
        """Serialise for the cache as bitcode instead of object code."""
        return self.serialize_using_bitcode()

    def _optimize_final_module(self) -> None:
        """Does nothing: the callers optimise."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True


class LinkedCompiler(KernelCompiler):
    """`KernelCompiler` for functions that are called neither from Python nor from C."""

    _library = _Library
