"""LLVM's text for one operation on values of one type."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import partialmethod

import numpy as np

from qrsim.core.arrays import DType
from qrsim.engine.llvm.graph import Node
from qrsim.engine.llvm.refusal import UnsupportedError
from qrsim.engine.llvm.text import literal, scalar_type, splat, suffix, vector

Emit = Callable[[str], str]  # emits an instruction and returns the name of its value

_LIBRARY = {"exp", "exp2", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh",
            "cosh", "tanh", "pow"}  # fmt: skip
_FLOAT_COMPARISONS = {"eq": "oeq", "ne": "une", "lt": "olt", "le": "ole", "gt": "ogt", "ge": "oge"}
# What hands on one of its arguments, or its bits but for the sign.
_CHOICES = ("select_n", "min", "max", "clamp")
_KEEPING = (*_CHOICES, "neg", "abs", "sign", "concatenate", "pick", "scatter", "update", "reduce", "running")
_BITS = {"and": "and", "or": "or", "xor": "xor"}
_SHIFTS = {"shift_left": "shl", "shift_right_logical": "lshr", "shift_right_arithmetic": "ashr"}


class Operations:
    """Emits the elementwise operations by ``emit``, and adds the functions that they call to ``declarations``."""

    def __init__(self, emit: Emit, declarations: set[str]):
        self.emit, self.declarations = emit, declarations
        self._flushed: set[int] = set()  # numbers of nodes that are normal or zero
        self._tiny_state = False

    def expect(self, results: Iterable[Node]) -> None:
        """Note whether these results of a tick may contain subnormal numbers."""
        self._tiny_state = any(self._may_be_tiny(node) for node in results if node.dtype.kind == "f")
        self._flushed.clear()

    def compute(self, node: Node, values: list[str], lanes: int) -> str:
        """Emit a graph node's operation on its arguments' values, of ``lanes`` lanes, and return the result's name."""
        argument = node.args[0].node.dtype if node.args else node.dtype
        if node.op != "bitcast_convert_type":
            values = [self._intrinsic("canonicalize", access.node.dtype, lanes, [value])
                      if access.node.dtype.kind == "f" and self._to_flush(node, access.node) else value
                      for access, value in zip(node.args, values, strict=True)]  # fmt: skip
        kind = argument.kind
        of = vector(scalar_type(argument), lanes)
        rule = getattr(self, f"_{node.op}", None)
        if node.op in ("add", "sub", "mul", "div", "rem"):
            # By a known number that is neither zero nor minus one no check is needed, and LLVM makes a product of it.
            if node.op in ("div", "rem") and kind in "iu" and _divides_well(node.args[1].node):
                return self.emit(f"{'s' if kind == 'i' else 'u'}{node.op} {of} {values[0]}, {values[1]}")
            return self._arithmetic(node.op, kind, of, argument, values, lanes)
        if node.op in _FLOAT_COMPARISONS:
            return self._comparison(node.op, kind, of, values)
        if node.op in _BITS:
            return self.emit(f"{_BITS[node.op]} {of} {values[0]}, {values[1]}")
        if node.op in _SHIFTS:
            return self._shift(node, of, values, lanes)
        if node.op in _LIBRARY:
            return self._library(node.op, argument, values, lanes)
        if rule is None:
            raise UnsupportedError(f"'{node.op}'")
        result: str = rule(node, of, values, lanes)
        return result

    def _to_flush(self, node: Node, argument: Node) -> bool:
        """Return whether an argument must be flushed to zero (if subnormal) before an operation.

        LLVM's min, max and select may flush or not, and LLVM folds constants without flushing.
        """
        return (argument.op == "constant" and _has_tiny(argument)) or (
            node.op in _CHOICES and self._may_be_tiny(argument)
        )

    def _may_be_tiny(self, node: Node) -> bool:
        """Return whether a node may be subnormal: reinterpreted integer bits, or a value carried by a loop."""
        seen: set[int] = set()
        stack = [node]
        while stack:
            found = stack.pop()
            if found.number in seen or found.number in self._flushed:
                continue
            seen.add(found.number)
            if found.op == "input" and self._tiny_state:
                return True
            if found.op in ("bitcast_convert_type", "carry") or (found.op == "constant" and _has_tiny(found)):
                return True
            if found.op == "output":
                owner = found.args[0].node
                if owner.op == "while":
                    return True
                stack += [region.results[found.attributes[0]].node for region in owner.regions]
            elif found.op in _KEEPING:
                stack += [access.node for access in found.args if access.node.dtype.kind == "f"]
        self._flushed |= seen
        return False

    def combine(self, how: str, dtype: DType, lanes: int, a: str, b: str) -> str:
        """Emit one step of the reduction ``how``, such as a sum, of two values, and return the result's name."""
        of = vector(scalar_type(dtype), lanes)
        if how in ("min", "max"):
            return self._extreme(how, dtype, of, a, b, lanes)
        if how in _BITS:
            return self.emit(f"{_BITS[how]} {of} {a}, {b}")
        return self._arithmetic(how, dtype.kind, of, dtype, [a, b], lanes)

    def _call(self, name: str, result: str, types: list[str], values: list[str]) -> str:
        """Emit a call of an LLVM or C function and its declaration, and return the result's name."""
        self.declarations.add(f"declare {result} @{name}({', '.join(types)})")
        arguments = ", ".join(f"{t} {v}" for t, v in zip(types, values, strict=True))
        return self.emit(f"call {result} @{name}({arguments})")

    def _intrinsic(self, name: str, dtype: DType, lanes: int, values: list[str]) -> str:
        """Emit a call of the LLVM intrinsic ``name`` on arguments of one type, and return the result's name."""
        element = scalar_type(dtype)
        of = vector(element, lanes)
        return self._call(f"llvm.{name}.{suffix(element, lanes)}", of, [of] * len(values), values)

    def _library(self, name: str, dtype: DType, values: list[str], lanes: int) -> str:
        """Emit calls of a C math function, lane by lane, and return the result's name."""
        element = scalar_type(dtype)
        if element not in ("float", "double"):
            raise UnsupportedError(f"'{name}' of {dtype}")
        symbol = name + ("f" if element == "float" else "")
        # The library would see a number too small to be a normal one, which everything else here takes for zero.
        values = [self._intrinsic("canonicalize", dtype, lanes, [value]) for value in values]
        # The C library has no functions of vectors that round as its scalars do.
        if lanes == 1:
            return self._call(symbol, element, [element] * len(values), values)
        of, result = vector(element, lanes), "poison"
        for lane in range(lanes):
            parts = [self.emit(f"extractelement {of} {value}, i32 {lane}") for value in values]
            one = self._call(symbol, element, [element] * len(values), parts)
            result = self.emit(f"insertelement {of} {result}, {element} {one}, i32 {lane}")
        return result

    def _arithmetic(self, op: str, kind: str, of: str, dtype: DType, values: list[str], lanes: int) -> str:
        """Emit +, -, *, / or remainder (``op``) of two values, and return its name (``of``: LLVM type)."""
        if kind == "f":
            return self.emit(f"f{op} {of} {values[0]}, {values[1]}")
        if kind == "b":
            raise UnsupportedError(f"'{op}' of bool")
        if op in ("div", "rem"):
            return self._whole_division(op, of, dtype, values, lanes)
        return self.emit(f"{op} {of} {values[0]}, {values[1]}")

    def _whole_division(self, op: str, of: str, dtype: DType, values: list[str], lanes: int) -> str:
        """Emit integer division as in JAX: x / 0 has all bits set, x % 0 is x (``of``: LLVM type)."""
        element, mask, signed = scalar_type(dtype), vector("i1", lanes), dtype.kind == "i"
        zero, one, ones = (splat(text, element, lanes) for text in ("0", "1", "-1"))
        is_zero = self.emit(f"icmp eq {of} {values[1]}, {zero}")
        # Dividing by zero, or the least number by minus one, would end the process, even in lanes that nobody reads.
        hard, is_minus_one = is_zero, ""
        if signed:
            is_minus_one = self.emit(f"icmp eq {of} {values[1]}, {ones}")
            hard = self.emit(f"or {mask} {is_zero}, {is_minus_one}")
        safe = self.emit(f"select {mask} {hard}, {of} {one}, {of} {values[1]}")
        result = self.emit(f"{'s' if signed else 'u'}{op} {of} {values[0]}, {safe}")
        if op == "rem":
            return self.emit(f"select {mask} {is_zero}, {of} {values[0]}, {of} {result}")
        if signed:
            negative = self.emit(f"sub {of} {zero}, {values[0]}")
            result = self.emit(f"select {mask} {is_minus_one}, {of} {negative}, {of} {result}")
        return self.emit(f"select {mask} {is_zero}, {of} {ones}, {of} {result}")

    def _shift(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        """Emit a bit shift as in JAX: by the width or more it gives 0, or the sign (``of``: LLVM type)."""
        how, bits = _SHIFTS[node.op], 8 * node.dtype.itemsize
        # All shifts of the noise are by constants, and must cost one instruction.
        known = _known_number(node.args[1].node)
        if known is not None and 0 <= known < bits:
            return self.emit(f"{how} {of} {values[0]}, {values[1]}")
        element = scalar_type(node.dtype)
        last, width = splat(str(bits - 1), element, lanes), splat(str(bits), element, lanes)
        name = f"llvm.umin.{suffix(element, lanes)}"
        near = self._call(name, of, [of, of], [values[1], last])
        result = self.emit(f"{how} {of} {values[0]}, {near}")
        if how == "ashr":
            return result
        inside = self.emit(f"icmp ult {of} {values[1]}, {width}")
        zero = splat("0", element, lanes)
        return self.emit(f"select {vector('i1', lanes)} {inside}, {of} {result}, {of} {zero}")

    def _comparison(self, op: str, kind: str, of: str, values: list[str]) -> str:
        """Emit a comparison of two values, and return the name of its flags (i1) (``of``: LLVM type)."""
        if kind == "f":
            return self.emit(f"fcmp {_FLOAT_COMPARISONS[op]} {of} {values[0]}, {values[1]}")
        signed = "" if op in ("eq", "ne") else "s" if kind == "i" else "u"
        return self.emit(f"icmp {signed}{op} {of} {values[0]}, {values[1]}")

    def _same(self, name: str, node: Node, of: str, values: list[str], lanes: int) -> str:
        """Emit a call of the LLVM intrinsic ``name``, and return the result's name (``of``: LLVM type)."""
        return self._intrinsic(name, node.dtype, lanes, values)

    _fma = partialmethod(_same, "fma")
    _sqrt = partialmethod(_same, "sqrt")
    _floor = partialmethod(_same, "floor")
    _ceil = partialmethod(_same, "ceil")

    def _fms(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        """Emit a * b - c with one rounding (the change of a sign is exact), and return its name (``of``: LLVM type)."""
        return self._intrinsic("fma", node.dtype, lanes, [*values[:2], self.emit(f"fneg {of} {values[2]}")])

    def _fnma(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        """Emit c - a * b with one rounding, and return its name (``of``: LLVM type)."""
        return self._intrinsic("fma", node.dtype, lanes, [self.emit(f"fneg {of} {values[0]}"), *values[1:]])

    def _neg(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        """Emit the negative of the argument, and return its name (``of``: LLVM type)."""
        if node.dtype.kind == "f":
            return self.emit(f"fneg {of} {values[0]}")
        return self.emit(f"sub {of} {splat('0', scalar_type(node.dtype), lanes)}, {values[0]}")

    def _abs(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        """Emit the absolute value of the argument, and return its name (``of``: LLVM type)."""
        if node.dtype.kind == "f":
            return self._intrinsic("fabs", node.dtype, lanes, values)
        if node.dtype.kind == "u":
            return values[0]
        negative = self._neg(node, of, values, lanes)
        return self._call(f"llvm.smax.{suffix(scalar_type(node.dtype), lanes)}", of, [of, of], [values[0], negative])

    def _sign(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        """Emit the sign of the argument, as in JAX: NaN and zeros are kept (``of``: LLVM type)."""
        dtype, element = node.dtype, scalar_type(node.dtype)
        zero, one, minus = (splat(literal(v, dtype), element, lanes) for v in (0, 1, -1))
        mask = vector("i1", lanes)
        above = self._comparison("gt", dtype.kind, of, [values[0], zero])
        below = self._comparison("lt", dtype.kind, of, [values[0], zero])
        rest = self.emit(f"select {mask} {below}, {of} {minus}, {of} {values[0]}")
        return self.emit(f"select {mask} {above}, {of} {one}, {of} {rest}")

    def _not(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        """Emit the logical or bitwise complement of the argument, and return its name (``of``: LLVM type)."""
        ones = "true" if node.dtype.kind == "b" else "-1"
        return self.emit(f"xor {of} {values[0]}, {splat(ones, scalar_type(node.dtype), lanes)}")

    def _ordered(self, how: str, node: Node, of: str, values: list[str], lanes: int) -> str:
        """Emit the minimum or maximum (``how``) of two arguments, and return its name (``of``: LLVM type)."""
        known = [_known_number(arg.node) for arg in node.args]
        if node.dtype.kind == "f":
            # A number that is known is no NaN, and where the other is equal they may only differ as zeros do.
            for which in (0, 1):
                number = known[which]
                if number is not None and not math.isnan(number):
                    return self._limited(how, of, values[1 - which], values[which], number, lanes)
        return self._extreme(how, node.dtype, of, values[0], values[1], lanes)

    _min = partialmethod(_ordered, "min")
    _max = partialmethod(_ordered, "max")

    def _limited(self, how: str, of: str, value: str, limit: str, number: float, lanes: int) -> str:
        """Emit min or max (``how``) of a value and a constant; +0 is above -0 (``of``: LLVM type)."""
        positive = math.copysign(1.0, number) > 0.0
        takes_equal = number == 0.0 and positive == (how == "max")
        compare = ("ole" if takes_equal else "olt") if how == "min" else ("oge" if takes_equal else "ogt")
        taken = self.emit(f"fcmp {compare} {of} {limit}, {value}")
        return self.emit(f"select {vector('i1', lanes)} {taken}, {of} {limit}, {of} {value}")

    def _extreme(self, how: str, dtype: DType, of: str, a: str, b: str, lanes: int) -> str:
        """Emit min or max (``how``), NaN if either value is; +0 is above -0 (``of``: LLVM type)."""
        if dtype.kind == "f":
            name = f"llvm.{'minimum' if how == 'min' else 'maximum'}.{suffix(scalar_type(dtype), lanes)}"
            return self._call(name, of, [of, of], [a, b])
        if dtype.kind == "b":
            return self.emit(f"{'and' if how == 'min' else 'or'} {of} {a}, {b}")
        sign = "s" if dtype.kind == "i" else "u"
        return self._call(f"llvm.{sign}{how}.{suffix(scalar_type(dtype), lanes)}", of, [of, of], [a, b])

    def _clamp(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        """Emit the second argument clipped to the first and the third, and return its name (``of``: LLVM type)."""
        low, value, high = values
        return self._extreme(
            "min", node.dtype, of, self._extreme("max", node.dtype, of, value, low, lanes), high, lanes
        )

    def _select_n(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        """Emit the third argument where the first is true, else the second, and return its name (``of``: LLVM type)."""
        if len(values) != 3 or node.args[0].node.dtype.kind != "b":
            raise UnsupportedError("a selection among several")
        result = vector(scalar_type(node.dtype), lanes)
        return self.emit(f"select {vector('i1', lanes)} {values[0]}, {result} {values[2]}, {result} {values[1]}")

    def _rsqrt(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        """Emit 1 / sqrt, not an estimate, which rounds differently on each processor (``of``: LLVM type)."""
        one = splat(literal(1.0, node.dtype), scalar_type(node.dtype), lanes)
        return self._arithmetic("div", "f", of, node.dtype, [one, self._sqrt(node, of, values, lanes)], lanes)

    def _round(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        """Emit the argument rounded to an integer, halves to even or away from 0, and return its name."""
        to_even = int(node.attributes[0]) == 1
        return self._intrinsic("roundeven" if to_even else "round", node.dtype, lanes, values)

    def _is_finite(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        """Emit whether the argument is finite, and return the name of the flags (``of``: LLVM type)."""
        dtype = node.args[0].node.dtype
        size = self._intrinsic("fabs", dtype, lanes, values)
        infinity = splat("0x7FF0000000000000", scalar_type(dtype), lanes)
        return self.emit(f"fcmp olt {of} {size}, {infinity}")

    def _square(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        """Emit the square of the argument, and return its name (``of``: LLVM type)."""
        return self.emit(f"{'f' if node.dtype.kind == 'f' else ''}mul {of} {values[0]}, {values[0]}")

    def _integer_pow(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        """Emit an integer power by repeated squares, in XLA's order, so that both round alike (``of``: LLVM type)."""
        power, kind = int(node.attributes[0]), node.dtype.kind
        if kind not in "fiu" or (kind != "f" and power < 0):
            raise UnsupportedError("this whole power")
        if power == 0:
            return splat(literal(1, node.dtype), scalar_type(node.dtype), lanes)
        multiply = "fmul" if kind == "f" else "mul"
        result, square, left = None, values[0], abs(power)
        while left:
            if left & 1:
                result = square if result is None else self.emit(f"{multiply} {of} {result}, {square}")
            left >>= 1
            if left:
                square = self.emit(f"{multiply} {of} {square}, {square}")
        assert result is not None
        if power > 0:
            return result
        one = splat(literal(1.0, node.dtype), scalar_type(node.dtype), lanes)
        return self._arithmetic("div", "f", of, node.dtype, [one, result], lanes)

    def _bitcast_convert_type(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        """Emit the argument's bits read as the node's dtype, and return the name (``of``: LLVM type)."""
        to = vector(scalar_type(node.dtype), lanes)
        return values[0] if to == of else self.emit(f"bitcast {of} {values[0]} to {to}")

    def whole_part(self, before: DType, after: DType, of: str, value: str, lanes: int) -> str:
        """Emit float to integer, truncated and clipped, NaN to 0, without LLVM's slow intrinsic (``of``: LLVM type)."""
        limits, element, mask = np.iinfo(after), scalar_type(before), vector("i1", lanes)
        to, signed = vector(scalar_type(after), lanes), after.kind == "i"
        low, beyond = (splat(literal(float(n), before), element, lanes) for n in (limits.min, limits.max + 1))
        above = self.emit(f"fcmp ogt {of} {value}, {low}")
        held = self.emit(f"select {mask} {above}, {of} {value}, {of} {low}")
        converted = self.emit(f"fpto{'s' if signed else 'u'}i {of} {held} to {to}")
        # Frozen, because what is too large could be anything, and is replaced.
        converted = self.emit(f"freeze {to} {converted}")
        large = self.emit(f"fcmp oge {of} {held}, {beyond}")
        last = splat(str(limits.max if signed else -1), scalar_type(after), lanes)
        found = self.emit(f"select {mask} {large}, {to} {last}, {to} {converted}")
        if not signed:
            return found
        missing = self.emit(f"fcmp uno {of} {value}, {value}")
        return self.emit(f"select {mask} {missing}, {to} {splat('0', scalar_type(after), lanes)}, {to} {found}")

    def _convert_element_type(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        """Emit the conversion of the argument to the node's dtype, and return its name (``of``: LLVM type)."""
        before, after = node.args[0].node.dtype, node.dtype
        to = vector(scalar_type(after), lanes)
        if before.kind == "b":
            how = "uitofp" if after.kind == "f" else "zext"
        elif after.kind == "b":
            zero = splat(literal(0, before), scalar_type(before), lanes)
            compare = "fcmp une" if before.kind == "f" else "icmp ne"
            return self.emit(f"{compare} {of} {values[0]}, {zero}")
        elif before.kind == "f" and after.kind == "f":
            if before.itemsize == after.itemsize:
                return values[0]
            how = "fptrunc" if before.itemsize > after.itemsize else "fpext"
        elif before.kind == "f":
            return self.whole_part(before, after, of, values[0], lanes)
        elif after.kind == "f":
            how = "sitofp" if before.kind == "i" else "uitofp"
        elif before.itemsize == after.itemsize:
            return values[0]
        elif before.itemsize > after.itemsize:
            how = "trunc"
        else:
            how = "sext" if before.kind == "i" else "zext"
        return self.emit(f"{how} {of} {values[0]} to {to}")


def _has_tiny(constant: Node) -> bool:
    """Return whether a constant contains a subnormal number."""
    sizes = np.abs(np.frombuffer(constant.attributes[0], constant.dtype))
    return bool(((sizes > 0.0) & (sizes < np.finfo(constant.dtype).tiny)).any())


def _known_number(node: Node) -> float | None:
    """Return the value that all elements of a constant node have; None if they differ or are not constant."""
    if node.op != "constant":
        return None
    numbers = np.frombuffer(node.attributes[0], node.dtype)
    if (
        not numbers.size
        or (numbers.view(f"u{node.dtype.itemsize}") != numbers.view(f"u{node.dtype.itemsize}")[0]).any()
    ):
        return None
    return numbers[0].item()


def _divides_well(divisor: Node) -> bool:
    """Return whether a divisor is a constant other than 0 and -1, so that integer division needs no checks."""
    return _known_number(divisor) not in (None, 0, -1)
