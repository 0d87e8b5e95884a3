"""Records: nested named tuples of constants, states and arrays, passed to kernels by pointer.

numba passes a named tuple by value. A step's constants and work arrays are a thousand words, which
every call would copy, and the call from Python would convert each of them. A `Record` holds the
compiled form of a named tuple in memory of its own. In a kernel its fields are attributes, as those
of the tuple: a field that is a named tuple is a record again, any other field is loaded.

The fields of a record never change: loads of them are invariant, so that loops keep array pointers
in registers. What changes are the elements of the arrays.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import typeof
from numba.core import types
from numba.core.datamodel import models
from numba.core.datamodel.registry import register_default
from numba.core.imputils import lower_getattr_generic
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import NativeValue, intrinsic, unbox

# numba is not typed.
_typeof: Any = typeof
_lower: Any = lower_getattr_generic
_unbox: Any = unbox
_intrinsic: Any = intrinsic
_native: Any = NativeValue


class RecordType(types.Type):
    """Pointer to the compiled form of a named tuple."""

    def __init__(self, target: Any) -> None:
        self.target = target
        initialise: Any = super().__init__
        initialise(name=f"Record({target})")


@register_default(RecordType)
class _RecordModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: RecordType) -> None:
        initialise: Any = super().__init__
        initialise(manager, kind, manager.lookup(kind.target).get_data_type().as_pointer())


def _field_type(kind: RecordType, name: str) -> Any:
    if name not in kind.target.fields:
        return None
    field = kind.target[kind.target.fields.index(name)]
    return RecordType(field) if isinstance(field, types.BaseNamedTuple) else field


@infer_getattr
class _Fields(AttributeTemplate):
    key = RecordType

    def generic_resolve(self, typ: Any, attr: str) -> Any:  # type: ignore[override]
        return _field_type(typ, attr)


@_lower(RecordType)
def _field(context: Any, builder: Any, kind: RecordType, pointer: Any, name: str) -> Any:
    index = kind.target.fields.index(name)
    zero = ir.Constant(ir.IntType(32), 0)
    place = builder.gep(pointer, [zero, ir.Constant(ir.IntType(32), index)], inbounds=True)
    field = kind.target[index]
    if isinstance(field, types.BaseNamedTuple):
        return place
    loaded = builder.load(place)
    loaded.set_metadata("invariant.load", builder.module.add_metadata([]))
    return context.data_model_manager[field].from_data(builder, loaded)


@_unbox(RecordType)
def _unbox_record(kind: RecordType, obj: Any, c: Any) -> Any:
    address = c.pyapi.object_getattr_string(obj, "address")
    number = c.pyapi.long_as_voidptr(address)
    c.pyapi.decref(address)
    pointer = c.builder.bitcast(number, c.context.get_value_type(kind))
    return _native(pointer)


@_intrinsic
def store(typingctx: Any, value: Any, buffer: Any) -> Any:  # noqa: ARG001
    """Write the compiled form of a named tuple to the memory of an array."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = signature.args[0]
        model = context.data_model_manager[kind]
        array = context.make_array(signature.args[1])(context, builder, args[1])
        place = builder.bitcast(array.data, model.get_data_type().as_pointer())
        builder.store(model.as_data(builder, args[0]), place)
        return context.get_dummy_value()

    return types.void(value, buffer), generate


class Record:
    """The compiled form of a named tuple, and the tuple.

    Args:
        value: a named tuple of numbers, arrays, tuples and named tuples; kept, with its arrays.
        fill: compiled function that calls `store` with its arguments. It belongs beside the tuple's
            type: its cache on disk refers to that type.
    """

    def __init__(self, value: Any, fill: Any) -> None:
        target: Any = _typeof(value)
        self.value = value
        self._numba_type_ = RecordType(target)
        self._memory = np.zeros(_size_of(value), np.uint64)
        self.address = int(self._memory.ctypes.data)
        fill(value, self._memory)

    def field(self, path: str) -> Any:
        """Argument of the type of a field, to compile for; `path` is dotted."""
        kind: Any = self._numba_type_
        value = self.value
        for name in path.split("."):
            kind, value = _field_type(kind, name), getattr(value, name)
        return _Typed(kind) if isinstance(kind, RecordType) else value


class _Typed:
    """Stand-in for a value of a type."""

    def __init__(self, kind: RecordType) -> None:
        self._numba_type_ = kind


def _size_of(value: object) -> int:
    """Words that the compiled form of a value takes at most."""
    if isinstance(value, np.ndarray):
        return 5 + 2 * int(value.ndim)
    return sum(_size_of(each) for each in value) if isinstance(value, tuple) else 1
