# mypy: disable-error-code="no-untyped-call"
"""SIMD packets for compiled functions: small vectors of float64 in one vector register.

A packet has 4 lanes for a problem in the plane and 8 in space: room for a node's column of 4 or 6
numbers, or for as many elements at once. The width is given by a *tag*, any tuple of 2 or 3 numbers
whose length is the number of directions, so that the same source compiles for both. In compiled
functions packets are values: +, -, * and / act lane by lane, also with a float on one side, and
multiply-add may be fused.

The module extends numba (its "low-level extension API", which is not typed); none of its functions
run in the interpreter.
"""

import operator
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

_intrinsic: Any = intrinsic  # called without the first argument, which numba supplies

_LANES = {2: 4, 3: 8}
_FLAGS = ("contract", "reassoc", "nsz", "arcp", "afn")


class PacketType(types.Type):
    """numba's type of a packet."""

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        super().__init__(name=f"Packet({lanes})")


class StackType(types.Type):
    """numba's type of a fixed number of packets on the stack."""

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        super().__init__(name=f"Stack({lanes})")


def _vector(lanes: int) -> ir.VectorType:
    return ir.VectorType(ir.DoubleType(), lanes)


@register_model(PacketType)
class _PacketModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: PacketType) -> None:
        super().__init__(dmm, fe_type, _vector(fe_type.lanes))


@register_model(StackType)
class _StackModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: StackType) -> None:
        super().__init__(dmm, fe_type, _vector(fe_type.lanes).as_pointer())


def _splat(builder: Any, value: Any, lanes: int) -> Any:
    """A vector with the value in every lane."""
    integer = ir.IntType(32)
    first = builder.insert_element(
        ir.Constant(_vector(lanes), ir.Undefined), value, ir.Constant(integer, 0)
    )
    zeros = ir.Constant(ir.VectorType(integer, lanes), [0] * lanes)
    return builder.shuffle_vector(first, first, zeros)


def _define_operator(function: Any, instruction: str) -> None:
    """Define an operator for packets, also with a float on one side."""

    class Template(AbstractTemplate):
        key = function

        def generic(self, args: Any, kws: Any) -> Any:  # noqa: ARG002
            packets = [a for a in args if isinstance(a, PacketType)]
            others = [a for a in args if not isinstance(a, PacketType)]
            if len(args) != 2 or not packets or len({p.lanes for p in packets}) > 1:
                return None
            if not all(isinstance(a, types.Float) for a in others):
                return None
            return signature(packets[0], *args)

    infer_global(function)(Template)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:  # noqa: ARG001
        lanes = sig.return_type.lanes
        left, right = (
            value if isinstance(kind, PacketType) else _splat(builder, value, lanes)
            for kind, value in zip(sig.args, args, strict=True)
        )
        return getattr(builder, instruction)(left, right, flags=_FLAGS)

    for kinds in (
        (PacketType, PacketType),
        (PacketType, types.Float),
        (types.Float, PacketType),
    ):
        lower_builtin(function, *kinds)(lower)


for _functions, _instruction in (
    ((operator.add, operator.iadd), "fadd"),
    ((operator.sub, operator.isub), "fsub"),
    ((operator.mul, operator.imul), "fmul"),
    ((operator.truediv, operator.itruediv), "fdiv"),
):
    for _function in _functions:
        _define_operator(_function, _instruction)


def _lanes_of(tag: Any) -> int:
    return _LANES[len(tag)]


@_intrinsic
def lane_count(typingctx: Any, tag: Any) -> Any:  # noqa: ARG001
    """Number of lanes of the tag's packets, a compile-time constant."""
    lanes = _lanes_of(tag)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:  # noqa: ARG001
        return context.get_constant(types.intp, lanes)

    return types.intp(tag), generate


@_intrinsic
def fill(typingctx: Any, tag: Any, value: Any) -> Any:  # noqa: ARG001
    """A packet with the float in every lane."""
    lanes = _lanes_of(tag)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:  # noqa: ARG001
        return _splat(builder, args[1], lanes)

    return PacketType(lanes)(tag, types.float64), generate


@_intrinsic
def lane(typingctx: Any, packet: Any, index: Any) -> Any:  # noqa: ARG001
    """The float in lane k."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:  # noqa: ARG001
        return builder.extract_element(args[0], builder.trunc(args[1], ir.IntType(32)))

    return types.float64(packet, types.intp), generate


@_intrinsic
def with_lane(typingctx: Any, packet: Any, index: Any, value: Any) -> Any:  # noqa: ARG001
    """The packet with one lane replaced."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:  # noqa: ARG001
        return builder.insert_element(args[0], args[2], builder.trunc(args[1], ir.IntType(32)))

    return packet(packet, types.intp, types.float64), generate


@_intrinsic
def root(typingctx: Any, packet: Any) -> Any:  # noqa: ARG001
    """Square roots."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:  # noqa: ARG001
        kind = args[0].type
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(kind, [kind]), f"llvm.sqrt.v{packet.lanes}f64"
        )
        return builder.call(function, args)

    return packet(packet), generate


@_intrinsic
def magnitude(typingctx: Any, packet: Any) -> Any:  # noqa: ARG001
    """Absolute values."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:  # noqa: ARG001
        kind = args[0].type
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(kind, [kind]), f"llvm.fabs.v{packet.lanes}f64"
        )
        return builder.call(function, args)

    return packet(packet), generate


@_intrinsic
def larger(typingctx: Any, packet: Any, other: Any) -> Any:  # noqa: ARG001
    """Lane-wise maximum of two packets; where either is NaN, the second's value."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:  # noqa: ARG001
        return builder.select(builder.fcmp_ordered(">", *args), *args)

    return packet(packet, other), generate


def _address(context: Any, builder: Any, kind: Any, array: Any, indices: Any, lanes: int) -> Any:
    """Pointer to a vector at an element of a C-contiguous array."""
    struct = context.make_array(kind)(context, builder, array)
    pointer = cgutils.get_item_pointer(
        context, builder, kind, struct, cgutils.unpack_tuple(builder, indices), wraparound=False
    )
    return builder.bitcast(pointer, _vector(lanes).as_pointer())


@_intrinsic
def load(typingctx: Any, tag: Any, array: Any, indices: Any) -> Any:  # noqa: ARG001
    """Packet of consecutive numbers from array[i, ..., j] on; `indices` is (i, ..., j).

    The array is C-contiguous. Bounds are not checked.
    """
    lanes = _lanes_of(tag)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer = _address(context, builder, sig.args[1], args[1], args[2], lanes)
        return builder.load(pointer, align=8)

    return PacketType(lanes)(tag, array, indices), generate


@_intrinsic
def store(typingctx: Any, array: Any, indices: Any, packet: Any) -> Any:  # noqa: ARG001
    """Write the lanes to consecutive entries from array[i, ..., j] on; see `load`."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer = _address(context, builder, sig.args[0], args[0], args[1], packet.lanes)
        builder.store(args[2], pointer, align=8)
        return context.get_dummy_value()

    return types.void(array, indices, packet), generate


@_intrinsic(prefer_literal=True)
def stack(typingctx: Any, tag: Any, count: Any) -> Any:  # noqa: ARG001
    """Array s of `count` uninitialised packets, read and written as s[i].

    It exists until the function returns; `count` is a literal. In unrolled loops the packets are
    registers.
    """
    lanes = _lanes_of(tag)
    size = count.literal_value

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:  # noqa: ARG001
        with builder.goto_entry_block():
            return builder.alloca(_vector(lanes), size=size)

    return StackType(lanes)(tag, count), generate


@infer_global(operator.getitem)
class _StackGet(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:  # noqa: ARG002
        if isinstance(args[0], StackType) and isinstance(args[1], types.Integer):
            return signature(PacketType(args[0].lanes), args[0], types.intp)
        return None


@infer_global(operator.setitem)
class _StackSet(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:  # noqa: ARG002
        if isinstance(args[0], StackType) and isinstance(args[1], types.Integer):
            return signature(types.void, args[0], types.intp, PacketType(args[0].lanes))
        return None


@lower_builtin(operator.getitem, StackType, types.intp)
def _stack_get(context: Any, builder: Any, sig: Any, args: Any) -> Any:  # noqa: ARG001
    return builder.load(builder.gep(args[0], [args[1]], inbounds=True))


@lower_builtin(operator.setitem, StackType, types.intp, PacketType)
def _stack_set(context: Any, builder: Any, sig: Any, args: Any) -> Any:  # noqa: ARG001
    builder.store(args[2], builder.gep(args[0], [args[1]], inbounds=True))
    return context.get_dummy_value()


@_intrinsic
def transpose(typingctx: Any, packets: Any, start: Any) -> Any:  # noqa: ARG001
    """Transpose a square of packets, as many as lanes, from `start` on, in place."""
    lanes = packets.lanes

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:  # noqa: ARG001
        pointers = [
            builder.gep(
                args[0], [builder.add(args[1], ir.Constant(args[1].type, i))], inbounds=True
            )
            for i in range(lanes)
        ]
        rows = [builder.load(pointer) for pointer in pointers]
        mask_type = ir.VectorType(ir.IntType(32), lanes)
        width = 1
        while width < lanes:
            # exchange the off-diagonal squares of this width between rows i and i + width
            low = [k if not k & width else lanes + k - width for k in range(lanes)]
            high = [k + width if not k & width else lanes + k for k in range(lanes)]
            for i in range(lanes):
                if not i & width:
                    first, second = rows[i], rows[i + width]
                    for target, mask in ((i, low), (i + width, high)):
                        rows[target] = builder.shuffle_vector(
                            first, second, ir.Constant(mask_type, mask)
                        )
            width *= 2
        for row, pointer in zip(rows, pointers, strict=True):
            builder.store(row, pointer)
        return context.get_dummy_value()

    return types.void(packets, types.intp), generate
