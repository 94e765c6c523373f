"""Forward-mode differentiation: machine code of the arithmetic of a number with its tangents.

A `TANGENTS` group of `lanes` has a number in lane 0 and its derivatives with respect to seven parameters, the
tangents, in the other lanes (Griewank and Walther, Evaluating Derivatives, chapter 3). `Tangents` adds
instructions for the arithmetic of such groups to a function under construction. Lane 0 has the operations of a plain
number, in the same order, so that values have the same bits as without derivatives.

Comparisons test the number only. Where a function has a kink, the tangent is the derivative of the branch taken.
"""

import math
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils

from flexman_gym.kernels.layout import ARMS_PER_GROUP

INDEX, DOUBLE = ir.IntType(32), ir.DoubleType()
VECTOR = ir.VectorType(DOUBLE, ARMS_PER_GROUP)  # type of a group
VALUE = ir.Constant(INDEX, 0)  # lane of the number


class Tangents:
    """Arithmetic of groups with tangents; `builder` is that of the function under construction."""

    def __init__(self, builder: Any) -> None:
        self._builder = builder

    def from_number(self, number: Any) -> Any:
        """Return the group of a number whose derivatives are zero."""
        return self._builder.insert_element(ir.Constant(VECTOR, [0.0] * ARMS_PER_GROUP), number, VALUE)

    def value_of(self, group: Any) -> Any:
        """Return the number of a group."""
        return self._builder.extract_element(group, VALUE)

    def multiply(self, a: Any, b: Any) -> Any:
        """Return a b of groups, or of a number and a group; the tangents are a b' + a' b."""
        if _is_number(b):
            a, b = b, a
        if _is_number(a):
            return self._builder.fmul(self._repeat_number(a), b)
        return self._add_tangents(a, b, self._builder.fmul(self._repeat(a), b))

    def multiply_add(self, a: Any, b: Any, c: Any) -> Any:
        """Return a b + c of groups or numbers, with one rounding of the number; the tangents are a b' + a' b + c'."""
        if _is_number(b):
            a, b = b, a
        b, c = (self.from_number(each) if _is_number(each) else each for each in (b, c))
        if _is_number(a):
            return self._fma(self._repeat_number(a), b, c)
        return self._add_tangents(a, b, self._fma(self._repeat(a), b, c))

    def divide(self, a: Any, b: Any) -> Any:
        """Return q = a / b of groups, or of a number and a group; the tangents are (a' - q b') / b.

        The tangents are multiplied by 1 / b: two divisions of numbers cost less than a division of a group.
        """
        builder, number = self._builder, _is_number(b)
        divisor = b if number else self.value_of(b)
        quotient = builder.fdiv(a if _is_number(a) else self.value_of(a), divisor)
        inverse = builder.fdiv(ir.Constant(DOUBLE, 1.0), divisor)
        if number:
            return self.chain(quotient, inverse, a)
        change = builder.fmul(self._repeat_number(quotient), b)
        difference = builder.fneg(change) if _is_number(a) else builder.fsub(a, change)
        return self.chain(quotient, inverse, difference)

    def square_root(self, a: Any) -> Any:
        """Return the square root r of a; the tangents are a' / (2 r)."""
        builder, function = self._builder, ir.FunctionType(DOUBLE, [DOUBLE])
        root = builder.call(
            cgutils.get_or_insert_function(builder.module, function, "llvm.sqrt.f64"), [self.value_of(a)]
        )
        return self.chain(root, builder.fdiv(ir.Constant(DOUBLE, 0.5), root), a)

    def apply_function(self, symbol: Callable, call: Callable[[Callable, Any], Any], a: Any) -> Any:
        """Return f(a) for sine, cosine or hyperbolic tangent; the tangents are f'(a) a'.

        Args:
            symbol: math.sin, math.cos or math.tanh.
            call: function that adds the call of a mathematical function of a number.
            a: group.
        """
        builder, x = self._builder, self.value_of(a)
        y = call(symbol, x)
        if symbol is math.sin:
            slope = call(math.cos, x)
        elif symbol is math.cos:
            slope = builder.fneg(call(math.sin, x))
        else:
            slope = builder.fsub(ir.Constant(DOUBLE, 1.0), builder.fmul(y, y))
        return self.chain(y, slope, a)

    def chain(self, value: Any, slope: Any, a: Any) -> Any:
        """Return a group with the given number and the tangents of a times the slope."""
        return self._builder.insert_element(self._builder.fmul(self._repeat_number(slope), a), value, VALUE)

    def _add_tangents(self, a: Any, b: Any, total: Any) -> Any:
        """Return a group with a' b added to its tangents.

        A repetition of b with zero in lane 0 is one instruction, and leaves the number of the total as it is.
        """
        lanes = ir.Constant(ir.VectorType(INDEX, ARMS_PER_GROUP), [ARMS_PER_GROUP] + [0] * (ARMS_PER_GROUP - 1))
        zeros = ir.Constant(VECTOR, [0.0] * ARMS_PER_GROUP)
        return self._fma(a, self._builder.shuffle_vector(b, zeros, lanes), total)

    def _repeat(self, group: Any) -> Any:
        """Return the number of a group in all lanes."""
        lanes = ir.Constant(ir.VectorType(INDEX, ARMS_PER_GROUP), [0] * ARMS_PER_GROUP)
        return self._builder.shuffle_vector(group, group, lanes)

    def _repeat_number(self, number: Any) -> Any:
        return self._repeat(self.from_number(number))

    def _fma(self, a: Any, b: Any, c: Any) -> Any:
        function = ir.FunctionType(VECTOR, [VECTOR] * 3)
        name = f"llvm.fma.v{ARMS_PER_GROUP}f64"
        return self._builder.call(cgutils.get_or_insert_function(self._builder.module, function, name), [a, b, c])


def _is_number(value: Any) -> bool:
    return value.type == DOUBLE
