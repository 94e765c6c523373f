"""Forward-mode differentiation: machine code of the arithmetic of a number with its tangents.

A `TANGENTS` group of `lanes` has a number in lane 0 and its derivatives with respect to seven parameters, the
tangents, in the other lanes (Griewank and Walther, Evaluating Derivatives, chapter 3). The functions of this file add
instructions for the arithmetic of such groups to a function under construction. Lane 0 has the operations of a plain
number, in the same order, so that values have the same bits as without derivatives.

Comparisons test the number only. Where a function has a kink, the tangent is the derivative of the branch taken.
"""

import math
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils

INDEX, DOUBLE = ir.IntType(32), ir.DoubleType()
VALUE = ir.Constant(INDEX, 0)  # lane of the number


def from_number(builder: Any, vector: Any, number: Any) -> Any:
    """Return the group of a number whose derivatives are zero."""
    return builder.insert_element(ir.Constant(vector, [0.0] * vector.count), number, VALUE)


def value_of(builder: Any, group: Any) -> Any:
    """Return the number of a group."""
    return builder.extract_element(group, VALUE)


def multiply(builder: Any, vector: Any, a: Any, b: Any) -> Any:
    """Return a b of groups, or of a number and a group of type `vector`; the tangents are a b' + a' b."""
    if _is_number(b):
        a, b = b, a
    if _is_number(a):
        return builder.fmul(_repeat_number(builder, vector, a), b)
    return _add_tangents(builder, a, b, builder.fmul(_repeat(builder, a), b))


def multiply_add(builder: Any, vector: Any, a: Any, b: Any, c: Any) -> Any:
    """Return a b + c, with one rounding of the number; the tangents are a b' + a' b + c'.

    Each argument is a group of type `vector` or a number.
    """
    if _is_number(b):
        a, b = b, a
    b, c = (from_number(builder, vector, each) if _is_number(each) else each for each in (b, c))
    if _is_number(a):
        return _fma(builder, _repeat_number(builder, vector, a), b, c)
    return _add_tangents(builder, a, b, _fma(builder, _repeat(builder, a), b, c))


def divide(builder: Any, vector: Any, a: Any, b: Any) -> Any:
    """Return q = a / b of groups, or of a number and a group of type `vector`; the tangents are (a' - q b') / b.

    The tangents are multiplied by 1 / b: two divisions of numbers cost less than a division of a group.
    """
    number = _is_number(b)
    divisor = b if number else value_of(builder, b)
    quotient = builder.fdiv(a if _is_number(a) else value_of(builder, a), divisor)
    inverse = builder.fdiv(ir.Constant(DOUBLE, 1.0), divisor)
    if number:
        return chain(builder, quotient, inverse, a)
    change = builder.fmul(_repeat_number(builder, vector, quotient), b)
    difference = builder.fneg(change) if _is_number(a) else builder.fsub(a, change)
    return chain(builder, quotient, inverse, difference)


def square_root(builder: Any, vector: Any, a: Any) -> Any:
    """Return the square root r of a; the tangents are a' / (2 r)."""
    function = ir.FunctionType(DOUBLE, [DOUBLE])
    root = builder.call(
        cgutils.get_or_insert_function(builder.module, function, "llvm.sqrt.f64"), [value_of(builder, a)]
    )
    return chain(builder, root, builder.fdiv(ir.Constant(DOUBLE, 0.5), root), a)


def apply_function(builder: Any, symbol: Callable, call: Callable[[Callable, Any], Any], a: Any) -> Any:
    """Return f(a) for sine, cosine or hyperbolic tangent; the tangents are f'(a) a'.

    Args:
        builder: builder of the function under construction.
        symbol: math.sin, math.cos or math.tanh.
        call: function that adds the call of a mathematical function of a number.
        a: group.
    """
    x = value_of(builder, a)
    y = call(symbol, x)
    if symbol is math.sin:
        slope = call(math.cos, x)
    elif symbol is math.cos:
        slope = builder.fneg(call(math.sin, x))
    else:
        slope = builder.fsub(ir.Constant(DOUBLE, 1.0), builder.fmul(y, y))
    return chain(builder, y, slope, a)


def _is_number(value: Any) -> bool:
    return value.type == DOUBLE


def chain(builder: Any, value: Any, slope: Any, a: Any) -> Any:
    """Return a group with the given number and the tangents of a times the slope."""
    return builder.insert_element(builder.fmul(_repeat_number(builder, a.type, slope), a), value, VALUE)


def _add_tangents(builder: Any, a: Any, b: Any, total: Any) -> Any:
    """Return a group with a' b added to its tangents.

    A repetition of b with zero in lane 0 is one instruction, and leaves the number of the total as it is.
    """
    count = total.type.count
    lanes = [count] + [0] * (count - 1)
    zeros = ir.Constant(total.type, [0.0] * count)
    repeated = builder.shuffle_vector(b, zeros, ir.Constant(ir.VectorType(INDEX, count), lanes))
    return _fma(builder, a, repeated, total)


def _repeat(builder: Any, group: Any) -> Any:
    """Return the number of a group in all lanes."""
    return builder.shuffle_vector(
        group, group, ir.Constant(ir.VectorType(INDEX, group.type.count), [0] * group.type.count)
    )


def _repeat_number(builder: Any, vector: Any, number: Any) -> Any:
    return _repeat(builder, from_number(builder, vector, number))


def _fma(builder: Any, a: Any, b: Any, c: Any) -> Any:
    function = ir.FunctionType(a.type, [a.type] * 3)
    name = f"llvm.fma.v{a.type.count}f64"
    return builder.call(cgutils.get_or_insert_function(builder.module, function, name), [a, b, c])
