"""LLVM's text for one operation on values of one type."""

from __future__ import annotations

from collections.abc import Callable

from qrsim.native.graph import Node, UnsupportedError
from qrsim.native.text import DType, literal, scalar_type, splat, suffix, vector

# Emits an instruction and returns the name of its value.
Emit = Callable[[str], str]

_LIBRARY = {
    "exp", "exp2", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh",
    "tanh", "pow",
}  # fmt: skip
_FLOAT_COMPARISONS = {"eq": "oeq", "ne": "une", "lt": "olt", "le": "ole", "gt": "ogt", "ge": "oge"}
_BITS = {"and": "and", "or": "or", "xor": "xor"}
_SHIFTS = {"shift_left": "shl", "shift_right_logical": "lshr", "shift_right_arithmetic": "ashr"}


class Operations:
    """Emits the elementwise operations.

    Args:
        emit: writes an instruction and returns the name of its value.
        declarations: takes the functions that are called.
    """

    def __init__(self, emit: Emit, declarations: set[str]):
        self.emit, self.declarations = emit, declarations

    def compute(self, node: Node, values: list[str], lanes: int) -> str:
        """Return the value of a node from those of its arguments, all of ``lanes`` lanes."""
        argument = node.args[0].node.dtype if node.args else node.dtype
        kind = argument.kind
        of = vector(scalar_type(argument), lanes)
        rule = getattr(self, f"_{node.op}", None)
        if node.op in ("add", "sub", "mul") or node.op in ("div", "rem"):
            return self._arithmetic(node.op, kind, of, argument, values, lanes)
        if node.op in _FLOAT_COMPARISONS:
            return self._comparison(node.op, kind, of, values)
        if node.op in _BITS:
            return self.emit(f"{_BITS[node.op]} {of} {values[0]}, {values[1]}")
        if node.op in _SHIFTS:
            return self.emit(f"{_SHIFTS[node.op]} {of} {values[0]}, {values[1]}")
        if node.op in _LIBRARY:
            return self._library(node.op, argument, values, lanes)
        if rule is None:
            raise UnsupportedError(f"'{node.op}'")
        result: str = rule(node, of, values, lanes)
        return result

    def combine(self, how: str, dtype: DType, lanes: int, a: str, b: str) -> str:
        """Return the value of one step of a reduction."""
        of = vector(scalar_type(dtype), lanes)
        if how in ("min", "max"):
            return self._extreme(how, dtype, of, a, b, lanes, b_is_number=False)
        if how in _BITS:
            return self.emit(f"{_BITS[how]} {of} {a}, {b}")
        return self._arithmetic(how, dtype.kind, of, dtype, [a, b], lanes)

    def _call(self, name: str, result: str, types: list[str], values: list[str]) -> str:
        self.declarations.add(f"declare {result} @{name}({', '.join(types)})")
        arguments = ", ".join(f"{t} {v}" for t, v in zip(types, values, strict=True))
        return self.emit(f"call {result} @{name}({arguments})")

    def _intrinsic(self, name: str, dtype: DType, lanes: int, values: list[str]) -> str:
        element = scalar_type(dtype)
        of = vector(element, lanes)
        return self._call(f"llvm.{name}.{suffix(element, lanes)}", of, [of] * len(values), values)

    def _library(self, name: str, dtype: DType, values: list[str], lanes: int) -> str:
        element = scalar_type(dtype)
        if element not in ("float", "double"):
            raise UnsupportedError(f"'{name}' of {dtype}")
        symbol = name + ("f" if element == "float" else "")
        if lanes == 1:
            return self._call(symbol, element, [element] * len(values), values)
        of, result = vector(element, lanes), "poison"
        for lane in range(lanes):
            parts = [self.emit(f"extractelement {of} {value}, i32 {lane}") for value in values]
            one = self._call(symbol, element, [element] * len(values), parts)
            result = self.emit(f"insertelement {of} {result}, {element} {one}, i32 {lane}")
        return result

    def _arithmetic(self, op: str, kind: str, of: str, dtype: DType, values: list[str], lanes: int) -> str:
        if kind == "f":
            return self.emit(f"f{op} {of} {values[0]}, {values[1]}")
        if kind == "b":
            raise UnsupportedError(f"'{op}' of bool")
        if op in ("div", "rem"):
            return self._whole_division(op, of, dtype, values, lanes)
        return self.emit(f"{op} {of} {values[0]}, {values[1]}")

    def _whole_division(self, op: str, of: str, dtype: DType, values: list[str], lanes: int) -> str:
        # Lanes that nobody reads may hold a zero, and dividing by it would end the process.
        element = scalar_type(dtype)
        zero, one = (splat(text, element, lanes) for text in ("0", "1"))
        is_zero = self.emit(f"icmp eq {of} {values[1]}, {zero}")
        safe = self.emit(f"select {vector('i1', lanes)} {is_zero}, {of} {one}, {of} {values[1]}")
        sign = "s" if dtype.kind == "i" else "u"
        return self.emit(f"{sign}{op} {of} {values[0]}, {safe}")

    def _comparison(self, op: str, kind: str, of: str, values: list[str]) -> str:
        if kind == "f":
            return self.emit(f"fcmp {_FLOAT_COMPARISONS[op]} {of} {values[0]}, {values[1]}")
        signed = "" if op in ("eq", "ne") else "s" if kind == "i" else "u"
        return self.emit(f"icmp {signed}{op} {of} {values[0]}, {values[1]}")

    def _fma(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        return self._intrinsic("fma", node.dtype, lanes, values)

    def _fms(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        return self._intrinsic("fma", node.dtype, lanes, [*values[:2], self.emit(f"fneg {of} {values[2]}")])

    def _fnma(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        return self._intrinsic("fma", node.dtype, lanes, [self.emit(f"fneg {of} {values[0]}"), *values[1:]])

    def _rounded(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        return values[0]

    def _neg(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        if node.dtype.kind == "f":
            return self.emit(f"fneg {of} {values[0]}")
        return self.emit(f"sub {of} {splat('0', scalar_type(node.dtype), lanes)}, {values[0]}")

    def _abs(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        if node.dtype.kind == "f":
            return self._intrinsic("fabs", node.dtype, lanes, values)
        if node.dtype.kind == "u":
            return values[0]
        negative = self._neg(node, of, values, lanes)
        return self._call(f"llvm.smax.{suffix(scalar_type(node.dtype), lanes)}", of, [of, of], [values[0], negative])

    def _sign(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        dtype, element = node.dtype, scalar_type(node.dtype)
        zero, one, minus = (splat(literal(v, dtype), element, lanes) for v in (0, 1, -1))
        mask = vector("i1", lanes)
        above = self._comparison("gt", dtype.kind, of, [values[0], zero])
        below = self._comparison("lt", dtype.kind, of, [values[0], zero])
        rest = self.emit(f"select {mask} {below}, {of} {minus}, {of} {values[0]}")
        return self.emit(f"select {mask} {above}, {of} {one}, {of} {rest}")

    def _not(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        ones = "true" if node.dtype.kind == "b" else "-1"
        return self.emit(f"xor {of} {values[0]}, {splat(ones, scalar_type(node.dtype), lanes)}")

    def _min(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        return self._ordered("min", node, of, values, lanes)

    def _max(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        return self._ordered("max", node, of, values, lanes)

    def _ordered(self, how: str, node: Node, of: str, values: list[str], lanes: int) -> str:
        constant = [arg.node.op == "constant" for arg in node.args]
        a, b = (values[1], values[0]) if constant[0] else values
        return self._extreme(how, node.dtype, of, a, b, lanes, b_is_number=any(constant))

    def _extreme(self, how: str, dtype: DType, of: str, a: str, b: str, lanes: int, b_is_number: bool) -> str:
        """Return min or max, NaN where a is, or b unless it is known to be a number."""
        mask = vector("i1", lanes)
        if dtype.kind != "f":
            if dtype.kind == "b":
                return self.emit(f"{'and' if how == 'min' else 'or'} {of} {a}, {b}")
            sign = "s" if dtype.kind == "i" else "u"
            return self._call(f"llvm.{sign}{how}.{suffix(scalar_type(dtype), lanes)}", of, [of, of], [a, b])
        chosen = self.emit(f"fcmp {'olt' if how == 'min' else 'ogt'} {of} {b}, {a}")
        result = self.emit(f"select {mask} {chosen}, {of} {b}, {of} {a}")
        if b_is_number:
            return result
        missing = self.emit(f"fcmp uno {of} {b}, {b}")
        return self.emit(f"select {mask} {missing}, {of} {b}, {of} {result}")

    def _clamp(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        low, value, high = values
        raised = self._extreme("max", node.dtype, of, value, low, lanes, b_is_number=False)
        return self._extreme("min", node.dtype, of, raised, high, lanes, b_is_number=False)

    def _select_n(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        if len(values) != 3 or node.args[0].node.dtype.kind != "b":
            raise UnsupportedError("a selection among several")
        result = vector(scalar_type(node.dtype), lanes)
        return self.emit(f"select {vector('i1', lanes)} {values[0]}, {result} {values[2]}, {result} {values[1]}")

    def _sqrt(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        return self._intrinsic("sqrt", node.dtype, lanes, values)

    def _rsqrt(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        one = splat(literal(1.0, node.dtype), scalar_type(node.dtype), lanes)
        return self._arithmetic("div", "f", of, node.dtype, [one, self._sqrt(node, of, values, lanes)], lanes)

    def _floor(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        return self._intrinsic("floor", node.dtype, lanes, values)

    def _ceil(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        return self._intrinsic("ceil", node.dtype, lanes, values)

    def _round(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        to_even = int(node.attributes[0]) == 1
        return self._intrinsic("roundeven" if to_even else "round", node.dtype, lanes, values)

    def _is_finite(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        dtype = node.args[0].node.dtype
        size = self._intrinsic("fabs", dtype, lanes, values)
        infinity = splat("0x7FF0000000000000", scalar_type(dtype), lanes)
        return self.emit(f"fcmp olt {of} {size}, {infinity}")

    def _square(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        return self.emit(f"{'f' if node.dtype.kind == 'f' else ''}mul {of} {values[0]}, {values[0]}")

    def _integer_pow(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        power = int(node.attributes[0])
        if node.dtype.kind != "f" or power == 0:
            raise UnsupportedError("this whole power")
        result, square, left = None, values[0], abs(power)
        while left:
            if left & 1:
                result = square if result is None else self.emit(f"fmul {of} {result}, {square}")
            left >>= 1
            if left:
                square = self.emit(f"fmul {of} {square}, {square}")
        assert result is not None
        if power > 0:
            return result
        one = splat(literal(1.0, node.dtype), scalar_type(node.dtype), lanes)
        return self._arithmetic("div", "f", of, node.dtype, [one, result], lanes)

    def _bitcast_convert_type(self, node: Node, of: str, values: list[str], lanes: int) -> str:
        to = vector(scalar_type(node.dtype), lanes)
        return values[0] if to == of else self.emit(f"bitcast {of} {values[0]} to {to}")

    def _convert_element_type(self, node: Node, of: str, values: list[str], lanes: int) -> str:
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
            # Frozen: what does not fit is some number, not the licence to do anything.
            converted = self.emit(f"fpto{'s' if after.kind == 'i' else 'u'}i {of} {values[0]} to {to}")
            return self.emit(f"freeze {to} {converted}")
        elif after.kind == "f":
            how = "sitofp" if before.kind == "i" else "uitofp"
        elif before.itemsize == after.itemsize:
            return values[0]
        elif before.itemsize > after.itemsize:
            how = "trunc"
        else:
            how = "sext" if before.kind == "i" else "zext"
        return self.emit(f"{how} {of} {values[0]} to {to}")
