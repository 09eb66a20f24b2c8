"""Elementwise operations of the reference, with bounds."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
from tests.engine.reference import bounds
from tests.engine.reference.bounds import Array, Value, compared, given, settled, whole

_COMPARISONS: dict[str, Callable[..., Any]] = {
    "eq": np.equal,
    "ne": np.not_equal,
    "lt": np.less,
    "le": np.less_equal,
    "gt": np.greater,
    "ge": np.greater_equal,
}
_MONOTONOUS: dict[str, Callable[..., Any]] = {
    "exp": np.exp, "exp2": np.exp2, "expm1": np.expm1, "log": np.log, "log1p": np.log1p, "asin": np.arcsin,
    "acos": np.arccos, "atan": np.arctan, "sinh": np.sinh, "tanh": np.tanh, "rsqrt": lambda x: 1.0 / np.sqrt(x),
}  # fmt: skip
_SMOOTH: dict[str, tuple[Callable[..., Any], Callable[..., Any]]] = {
    "sin": (np.sin, lambda x, e: 1.0),
    "cos": (np.cos, lambda x, e: 1.0),
    "cosh": (np.cosh, lambda x, e: np.sinh(np.abs(x) + e)),
    "tan": (np.tan, lambda x, e: np.where(np.abs(np.cos(x)) > 2.0 * e, 4.0 / np.cos(x) ** 2, np.inf)),
}


def _sign(x: Any) -> Any:
    """Return the sign; of a zero itself, as JAX has it."""
    return np.where(x == 0.0, x, np.sign(x))


_STEPS: dict[str, Callable[..., Any]] = {"floor": np.floor, "ceil": np.ceil, "sign": _sign}
# What was asked for the bits of a NaN, which no program decides.
BITS_OF_NAN: list[str] = []
_BITS: dict[str, Callable[..., Any]] = {"and": np.bitwise_and, "or": np.bitwise_or, "xor": np.bitwise_xor}
_EXTREMES: dict[str, Callable[..., Any]] = {
    "max": lambda a, b: _of_zeros(np.maximum(a, b), a, b, 1.0),
    "min": lambda a, b: _of_zeros(np.minimum(a, b), a, b, -1.0),
}


def elementwise(name: str, inputs: list[Value], parameters: Any, dtype: Any) -> Value:
    """Return the result of an elementwise operation; KeyError: it is not known here."""
    a = inputs[0]
    if name in _COMPARISONS:
        return compared(_COMPARISONS[name], *inputs)
    if a.rounded.dtype.kind != "f" and name != "convert_element_type":
        return _whole(name, inputs, parameters)
    if name in _MONOTONOUS:
        return bounds.monotonous(_MONOTONOUS[name], a)
    if name in _SMOOTH:
        return bounds.smooth(*_SMOOTH[name], a)
    if name in _STEPS:
        return bounds.stepped(_STEPS[name], a)
    return _FLOATS[name](inputs, parameters, dtype)


def _sum(inputs: list[Value], parameters: Any, dtype: Any) -> Value:
    a, b = inputs
    return settled(a.rounded + b.rounded, a.exact + b.exact, a.error + b.error)


def _difference(inputs: list[Value], parameters: Any, dtype: Any) -> Value:
    a, b = inputs
    return settled(a.rounded - b.rounded, a.exact - b.exact, a.error + b.error)


def _times_error(size: Array, error: Array) -> Array:
    """Return a product in which nothing times nothing known is nothing, of infinite sizes too."""
    return np.where(error == 0.0, 0.0, np.where(np.isfinite(size), size, 0.0) * error)


def product(inputs: list[Value], parameters: Any, dtype: Any) -> Value:
    """Return a product of two arrays."""
    a, b = inputs
    error = _times_error(np.abs(a.exact), b.error) + _times_error(np.abs(b.exact), a.error)
    error = error + np.where((a.error == 0.0) | (b.error == 0.0), 0.0, a.error * b.error)
    # A zero of which the sign of the other is not known may be NaN with infinity.
    hard = (~np.isfinite(a.exact) & (b.error > 0.0) & (np.abs(b.exact) <= b.error)) | (
        ~np.isfinite(b.exact) & (a.error > 0.0) & (np.abs(a.exact) <= a.error)
    )
    return settled(a.rounded * b.rounded, a.exact * b.exact, np.where(hard, np.inf, error).astype(float))


def _quotient(inputs: list[Value], parameters: Any, dtype: Any) -> Value:
    a, b = inputs
    exact, size = a.exact / b.exact, np.abs(b.exact)
    room = size - b.error
    error = (a.error + np.where(b.error == 0.0, 0.0, np.abs(exact) * b.error)) / np.where(room > 0.0, room, 1.0)
    error = np.where((a.error == 0.0) & (b.error == 0.0), 0.0, np.where(room > 0.0, error, np.inf))
    error = np.where(np.isnan(error), np.inf, error)
    return settled(a.rounded / b.rounded, exact, error.astype(float))


def _remainder(inputs: list[Value], parameters: Any, dtype: Any) -> Value:
    a, b = inputs
    sure = (a.error == 0.0) & (b.error == 0.0)
    return Value(bounds.flushed(np.fmod(a.rounded, b.rounded)), np.fmod(a.exact, b.exact), np.where(sure, 0.0, np.inf))


def _of_zeros(found: Array, a: Array, b: Array, sign: float) -> Array:
    """Return extremes with the zero that JAX takes: -0 is less than +0, in whichever order they come."""
    zeros = (found == 0) & (a == b)
    # The sum of zeros is -0 where both are; the other way round for the least.
    return (
        np.where(zeros, sign * (sign * a + sign * b), found).astype(found.dtype) if found.dtype.kind == "f" else found
    )


def _extreme(name: str) -> Callable[..., Value]:
    def of(inputs: list[Value], parameters: Any, dtype: Any) -> Value:
        a, b = inputs
        error = np.maximum(a.error, b.error)
        exact = _EXTREMES[name](a.exact, b.exact)
        return Value(
            _EXTREMES[name](a.rounded, b.rounded), exact, np.where(np.isnan(exact) & np.isfinite(error), 0.0, error)
        )

    return of


def _clamped(inputs: list[Value], parameters: Any, dtype: Any) -> Value:
    low, x, high = inputs
    if x.rounded.dtype.kind != "f":
        return whole(np.minimum(np.maximum(low.rounded, x.rounded), high.rounded), *inputs)
    return _extreme("min")([_extreme("max")([low, x], None, dtype), high], None, dtype)


def _power(inputs: list[Value], parameters: Any, dtype: Any) -> Value:
    a, b = inputs
    exact = np.power(a.exact, b.exact)
    spread: Any = 0.0
    for one, two in itertools.product((-1, 1), repeat=2):
        corner = np.power(a.exact + one * np.minimum(a.error, 1e30), b.exact + two * np.minimum(b.error, 1e30))
        spread = np.maximum(spread, np.abs(corner - exact))
    sure = (a.error == 0.0) & (b.error == 0.0)
    # XLA takes x**y for exp2(y * log2(x)), the larger the exponent the less it is sure of.
    own = np.abs(np.nan_to_num(exact * b.exact * np.log2(np.abs(a.exact)), nan=0.0, posinf=0.0, neginf=0.0))
    own = np.where(np.isfinite(exact), own * np.finfo(dtype).eps, 0.0)
    error = np.where(sure, own, np.where((a.exact > a.error) & np.isfinite(spread), spread + own, np.inf))
    return settled(np.power(a.rounded, b.rounded), exact, error.astype(float), bounds.ULPS_LIBRARY)


def _angle(inputs: list[Value], parameters: Any, dtype: Any) -> Value:
    y, x = inputs
    error, radius = np.hypot(x.error, y.error), np.hypot(x.exact, y.exact)
    away = np.where(error < 0.5 * radius, 2.0 * error / np.where(radius > 0.0, radius, 1.0), np.inf)
    cut = (x.exact - x.error <= 0.0) & (np.abs(y.exact) <= y.error)
    known = np.where(error == 0.0, 0.0, np.where(cut, np.inf, away))
    return settled(
        np.arctan2(y.rounded, x.rounded), np.arctan2(y.exact, x.exact), known.astype(float), bounds.ULPS_LIBRARY
    )


def _root(inputs: list[Value], parameters: Any, dtype: Any) -> Value:
    (x,) = inputs
    return bounds.monotonous(np.sqrt, x, bounds.ULPS_ARITHMETIC)


def _integer_power(inputs: list[Value], parameters: Any, dtype: Any) -> Value:
    (x,), y = inputs, parameters["y"]
    result: Value | None = None
    square, left = x, abs(y)
    if not y:
        return given(np.ones_like(x.rounded))
    while left:
        if left & 1:
            result = square if result is None else product([result, square], None, dtype)
        left >>= 1
        if left:
            square = product([square, square], None, dtype)
    assert result is not None
    return result if y > 0 else _quotient([given(np.ones_like(x.rounded)), result], None, dtype)


def _rounding(inputs: list[Value], parameters: Any, dtype: Any) -> Value:
    if int(parameters["rounding_method"]) == 1:
        return bounds.stepped(np.rint, inputs[0])
    return bounds.stepped(lambda x: np.copysign(np.floor(np.abs(x.astype(float)) + 0.5), x).astype(x.dtype), inputs[0])


def _finite(inputs: list[Value], parameters: Any, dtype: Any) -> Value:
    (x,) = inputs
    return Value(np.isfinite(x.rounded), np.isfinite(x.exact), np.where(np.isfinite(x.error), 0.0, np.inf))


def _converted(inputs: list[Value], parameters: Any, dtype: Any) -> Value:
    (x,), before = inputs, inputs[0].rounded.dtype
    if before.kind != "f":
        if np.dtype(dtype).kind != "f":
            return whole(x.rounded.astype(dtype), x)
        exact = x.rounded.astype(bounds.wide(dtype))
        return settled(x.rounded.astype(dtype), exact, x.error)
    if np.dtype(dtype).kind == "f":
        return settled(x.rounded.astype(dtype), x.exact, x.error)
    if np.dtype(dtype).kind == "b":
        return compared(np.not_equal, x, given(np.zeros_like(x.rounded)))
    limits = np.iinfo(dtype)

    def saturated(values: Array) -> Array:
        held = np.clip(np.trunc(np.where(np.isnan(values), 0.0, values)).astype(np.longdouble), limits.min, limits.max)
        return np.asarray(held.astype(dtype))

    safe = np.where(np.isfinite(x.error), x.error, 0.0)
    found = [saturated(x.exact + side * safe) for side in (-1, 0, 1)]
    same = (found[0] == found[2]) & np.isfinite(x.error)
    return Value(saturated(x.rounded), found[1], np.where(same, 0.0, np.inf))


def _bits_of(inputs: list[Value], parameters: Any, dtype: Any) -> Value:
    (x,) = inputs
    if x.rounded.dtype.kind == "f" and np.isnan(x.rounded).any() and np.dtype(dtype).kind != "f":
        BITS_OF_NAN.append(str(dtype))
    bits = np.ascontiguousarray(x.rounded).view(dtype).reshape(x.rounded.shape)
    sure = np.where(x.error == 0.0, 0.0, np.inf)
    if np.dtype(dtype).kind != "f":
        if x.rounded.dtype.kind == "f":
            # Whether a zero is the positive one is not followed.
            sure = np.where((x.exact == 0.0) | np.isnan(x.exact), np.inf, sure)
        return Value(bits, bits, sure)
    plain = given(bits)
    return Value(plain.rounded, plain.exact, np.where(np.isfinite(bits) & (plain.rounded == bits), sure, np.inf))


_FLOATS: dict[str, Callable[..., Value]] = {
    "add": _sum, "add_any": _sum, "sub": _difference, "mul": product, "div": _quotient, "rem": _remainder,
    "max": _extreme("max"), "min": _extreme("min"), "clamp": _clamped, "pow": _power, "atan2": _angle, "sqrt": _root,
    "integer_pow": _integer_power, "round": _rounding, "is_finite": _finite, "convert_element_type": _converted,
    "bitcast_convert_type": _bits_of,
    "neg": lambda inputs, *_: inputs[0]._replace(rounded=-inputs[0].rounded, exact=-inputs[0].exact),
    "abs": lambda inputs, *_: inputs[0]._replace(rounded=np.abs(inputs[0].rounded), exact=np.abs(inputs[0].exact)),
    "square": lambda inputs, *_: product([inputs[0], inputs[0]], None, None),
    "rounded": lambda inputs, *_: inputs[0],
}  # fmt: skip


def _whole(name: str, inputs: list[Value], parameters: Any) -> Value:
    """Return an operation on whole numbers or bools, which wraps around."""
    dtype, numbers = inputs[0].rounded.dtype, [value.rounded for value in inputs]
    if name in _BITS:
        return whole(_BITS[name](*numbers), *inputs)
    if name == "not":
        return whole(np.logical_not(numbers[0]) if dtype.kind == "b" else np.invert(numbers[0]), *inputs)
    if name in _EXTREMES:
        return whole(_EXTREMES[name](*numbers), *inputs)
    if name == "clamp":
        return _clamped(inputs, parameters, dtype)
    if name == "bitcast_convert_type":
        return _bits_of(inputs, parameters, parameters["new_dtype"])
    # In Python's whole numbers, and then cut to the width.
    long = [number.astype(object) for number in numbers]
    found = np.vectorize(lambda *one: _WHOLE[name](dtype, parameters, *one), otypes=[object])(*long)
    bits = 8 * dtype.itemsize
    cut = np.vectorize(lambda n: (int(n) + (1 << (bits - 1))) % (1 << bits) - (1 << (bits - 1)), otypes=[object])
    if dtype.kind == "u":
        cut = np.vectorize(lambda n: int(n) % (1 << bits), otypes=[object])
    return whole(cut(found).astype(dtype) if found.size else np.zeros(found.shape, dtype), *inputs)


def _towards_zero(dtype: Any, parameters: Any, a: int, b: int) -> int:
    if b == 0:
        return -1
    return abs(a) // abs(b) * (1 if (a < 0) == (b < 0) else -1)


def _left(dtype: Any, parameters: Any, a: int, b: int) -> int:
    if b == 0:
        return a
    return abs(a) % abs(b) * (-1 if a < 0 else 1)


def _shifted(how: str) -> Callable[..., int]:
    def of(dtype: Any, parameters: Any, a: int, b: int) -> int:
        bits = 8 * dtype.itemsize
        inside = 0 <= b < bits
        if how == "left":
            return a << b if inside else 0
        if how == "logical":
            return (a % (1 << bits)) >> b if inside else 0
        # A number without sign is shifted as if its first bit were one.
        signed = a - (1 << bits) if a >= 1 << (bits - 1) else a
        return signed >> (b if inside else bits - 1)

    return of


_WHOLE: dict[str, Callable[..., int]] = {
    "add": lambda d, p, a, b: a + b, "add_any": lambda d, p, a, b: a + b, "sub": lambda d, p, a, b: a - b,
    "mul": lambda d, p, a, b: a * b, "div": _towards_zero, "rem": _left, "neg": lambda d, p, a: -a,
    "abs": lambda d, p, a: abs(a), "sign": lambda d, p, a: (a > 0) - (a < 0), "square": lambda d, p, a: a * a,
    "integer_pow": lambda d, p, a: a ** p["y"], "shift_left": _shifted("left"),
    "shift_right_logical": _shifted("logical"), "shift_right_arithmetic": _shifted("arithmetic"),
}  # fmt: skip
