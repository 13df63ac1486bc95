"""Eight numbers at once in compiled code: arithmetic on `Lanes` has the notation of floats.

`Lanes` map to a processor's vector instructions, which a compiler finds in loops only if it can prove the
absence of overlaps. Compiled functions read lanes from flat float64 arrays (`load`, `spread`) and write them
back (`store`), with operators, comparisons (a `Mask`), `select`, `fused` and `clip` in between. No lane
depends on another, and the same instructions run for any number of used lanes: a car beside seven others
equals the single car bit by bit.

`fused` rounds once (IEEE 754 fusedMultiplyAdd) on any machine.
"""

from __future__ import annotations

import operator
from typing import Any

from llvmlite import ir
from numba.core import cgutils, config, types
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, lower_cast, models, register_model

from .layout import WIDTH

_intrinsic: Any = (
    intrinsic  # the type checker misjudges the arguments of the decorated functions
)
_DOUBLE, _WORD = ir.DoubleType(), ir.IntType(64)
_DOUBLES, _WORDS, _BITS = (
    ir.VectorType(t, WIDTH) for t in (_DOUBLE, _WORD, ir.IntType(1))
)


class _Lanes(types.Type):
    def __init__(self, name: str, vector: ir.Type) -> None:
        super().__init__(name=name)
        self.vector = vector


LANES = _Lanes("Lanes", _DOUBLES)
MASK = _Lanes("Mask", _BITS)


@register_model(_Lanes)
class _Model(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: _Lanes) -> None:
        super().__init__(dmm, fe_type, fe_type.vector)


def _splat(builder: Any, value: Any, vector: ir.VectorType) -> Any:
    one = builder.insert_element(
        ir.Constant(vector, ir.Undefined), value, ir.Constant(ir.IntType(32), 0)
    )
    return builder.shuffle_vector(
        one,
        ir.Constant(vector, ir.Undefined),
        ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH),
    )


@lower_cast(types.Float, LANES)
def _from_float(context, builder, fromty, toty, value):
    return _splat(
        builder, context.cast(builder, value, fromty, types.float64), _DOUBLES
    )


# ------------------------------------------------------------------------------------------ operators


def _operator(
    symbol: Any, emit: Any, result: _Lanes, operand: _Lanes = LANES, arity: int = 2
) -> None:
    """Define `symbol` for `arity` operands, at least one of which is lanes; the others are lanes or floats."""

    @infer_global(symbol)
    class _(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            fits = all(
                a == operand or (operand is LANES and isinstance(a, types.Float))
                for a in args
            )
            if len(args) == arity and operand in args and fits:
                return signature(result, *([operand] * arity))
            return None

    lower_builtin(symbol, *([operand] * arity))(
        lambda context, builder, sig, args: emit(builder, *args)
    )


for _symbol, _name in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _operator(_symbol, lambda b, x, y, n=_name: getattr(b, n)(x, y), LANES)
for _symbol, _name in (
    (operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">="), (operator.eq, "=="), (operator.ne, "!=")
):  # fmt: skip
    _compare = "fcmp_unordered" if _name == "!=" else "fcmp_ordered"
    _operator(
        _symbol, lambda b, x, y, n=_name, c=_compare: getattr(b, c)(n, x, y), MASK
    )
_operator(operator.and_, lambda b, x, y: b.and_(x, y), MASK, MASK)
_operator(operator.or_, lambda b, x, y: b.or_(x, y), MASK, MASK)
_operator(operator.invert, lambda b, x: b.not_(x), MASK, MASK, 1)
_operator(operator.neg, lambda b, x: b.fneg(x), LANES, LANES, 1)
_operator(abs, lambda b, x: _call(b, "llvm.fabs.v8f64", x), LANES, LANES, 1)


def _call(builder: Any, name: str, *args: Any) -> Any:
    function = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(_DOUBLES, [_DOUBLES] * len(args)), name
    )
    return builder.call(function, args)


# -------------------------------------------------------------------------------- memory and functions


def _address(
    context: Any, builder: Any, array_type: Any, array: Any, index: Any, vector: ir.Type
) -> Any:
    held = context.make_array(array_type)(context, builder, array)
    # NUMBA_BOUNDSCHECK=1, with a separate cache, checks all eight numbers
    if getattr(config, "BOUNDSCHECK", None):
        last = builder.add(index, ir.Constant(index.type, WIDTH))
        low = builder.icmp_signed("<", index, ir.Constant(index.type, 0))
        wrong = builder.or_(low, builder.icmp_signed(">", last, held.nitems))
        with builder.if_then(wrong, likely=False):
            context.call_conv.return_user_exc(
                builder, IndexError, ("eight lanes reach beyond their array",)
            )
    return builder.bitcast(builder.gep(held.data, [index]), vector.as_pointer())


def _flat(array: Any, dtype: Any) -> bool:
    return (
        isinstance(array, types.Array)
        and array.ndim == 1
        and array.layout == "C"
        and array.dtype == dtype
    )


@_intrinsic
def load(typing, array, index):
    """Return the eight numbers of a flat array from `index`."""
    if not _flat(array, types.float64):
        return None

    def emit(context, builder, sig, args):
        return builder.load(
            _address(context, builder, sig.args[0], args[0], args[1], _DOUBLES), align=8
        )

    return LANES(array, types.intp), emit


@_intrinsic
def store(typing, array, index, lanes):
    """Write lanes into a flat array from `index`."""
    if not _flat(array, types.float64) or lanes != LANES:
        return None

    def emit(context, builder, sig, args):
        builder.store(
            args[2],
            _address(context, builder, sig.args[0], args[0], args[1], _DOUBLES),
            align=8,
        )
        return context.get_dummy_value()

    return types.void(array, types.intp, lanes), emit


@_intrinsic
def spread(typing, value):
    """Return a number in every lane."""

    def emit(context, builder, sig, args):
        return _splat(builder, args[0], _DOUBLES)

    return LANES(types.float64), emit


@_intrinsic
def select(typing, mask, yes, no):
    """Return `yes` in lanes of the mask, and `no` in the other lanes."""
    if mask != MASK:
        return None

    def emit(context, builder, sig, args):
        return builder.select(*args)

    return LANES(MASK, LANES, LANES), emit


@_intrinsic
def fused(typing, a, b, c):
    """Return ``a b + c``, rounded once."""

    def emit(context, builder, sig, args):
        return _call(builder, "llvm.fma.v8f64", *args)

    return LANES(LANES, LANES, LANES), emit


@_intrinsic
def some(typing, mask):
    """Return whether the mask holds in any lane."""
    if mask != MASK:
        return None

    def emit(context, builder, sig, args):
        bits = builder.bitcast(args[0], ir.IntType(WIDTH))
        return builder.icmp_unsigned("!=", bits, ir.Constant(bits.type, 0))

    return types.boolean(MASK), emit


@_intrinsic
def bits(typing, mask):
    """Return the mask as an integer: bit l is lane l."""
    if mask != MASK:
        return None

    def emit(context, builder, sig, args):
        return builder.zext(builder.bitcast(args[0], ir.IntType(WIDTH)), _WORD)

    return types.int64(MASK), emit


# ----------------------------------------------------------------------------------------- road noise

_GOLDEN, _MIX_1, _MIX_2 = 0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB
_MEAN = 4 * 65535 / 2
_SIGMA = (4 * (65536.0**2 - 1) / 12) ** 0.5


@_intrinsic
def noise(typing, counters, index, stride):
    """Return eight numbers of zero mean and unit variance from the counters at `index` of a flat int64 array,
    and advance the counters by `stride`.

    Each number is the sum of the four 16-bit uniforms of one SplitMix64 word; the counters are multiples of
    SplitMix64's odd constant. The distribution is nearly normal (excess kurtosis -0.3); the road is a sum of
    thousands of numbers, and hence normal.
    """
    if not _flat(counters, types.int64):
        return None

    def emit(context, builder, sig, args):
        def word(value: int) -> Any:
            return ir.Constant(
                _WORDS,
                [ir.Constant(_WORD, value - (1 << 64) if value >> 63 else value)]
                * WIDTH,
            )

        def shifted(w: Any, by: int) -> Any:
            return builder.lshr(w, word(by))

        place = _address(context, builder, sig.args[0], args[0], args[1], _WORDS)
        golden = builder.mul(word(_GOLDEN), _splat(builder, args[2], _WORDS))
        w = builder.add(builder.load(place, align=8), golden)
        builder.store(w, place, align=8)
        w = builder.mul(builder.xor(w, shifted(w, 30)), word(_MIX_1))
        w = builder.mul(builder.xor(w, shifted(w, 27)), word(_MIX_2))
        w = builder.xor(w, shifted(w, 31))
        low = word(0xFFFF)
        total = builder.add(
            builder.add(builder.and_(w, low), builder.and_(shifted(w, 16), low)),
            builder.add(builder.and_(shifted(w, 32), low), shifted(w, 48)),
        )
        small = builder.trunc(total, ir.VectorType(ir.IntType(32), WIDTH))
        number = builder.sitofp(small, _DOUBLES)

        def constant(value: float) -> Any:
            return ir.Constant(_DOUBLES, [ir.Constant(_DOUBLE, value)] * WIDTH)

        return builder.fdiv(builder.fsub(number, constant(_MEAN)), constant(_SIGMA))

    return LANES(counters, types.intp, types.int64), emit
