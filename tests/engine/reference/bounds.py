"""What a JAX program gives, operation by operation in NumPy: rounded as on a processor, exactly, and how far apart."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

Array = np.ndarray[Any, Any]
# So many units of rounding, of the result's size, may each operation that is no exact one be wrong.
ULPS_ARITHMETIC, ULPS_LIBRARY = 1.0, 4.0


class AmbiguousError(Exception):
    """Roundings decide which way the program goes."""


class Value(NamedTuple):
    """An array as it is computed and as it should be.

    Attributes:
        rounded: each operation rounded to the type of the program.
        exact: the same in wider floating-point numbers; of whole numbers and bools, what ``rounded`` is.
        error: how far any honest result may be from ``exact``; 0: it is just that; infinite: nothing is known.
    """

    rounded: Array
    exact: Array
    error: Array

    @property
    def known(self) -> bool:
        """Whether no element is at the mercy of roundings."""
        return bool(np.isfinite(self.error).all())

    def each(self, function: Callable[[Array], Array]) -> Value:
        """Return the same movement of elements of all three."""
        return Value(*(np.asarray(function(part)) for part in self))


def wide(dtype: Any) -> Any:
    """Return the type in which results are taken for exact."""
    return np.longdouble if np.dtype(dtype) == np.float64 else np.float64


def given(array: Any) -> Value:
    """Return numbers that are known."""
    rounded = np.asarray(array)
    if rounded.dtype.kind != "f":
        return Value(rounded, rounded, np.zeros(rounded.shape))
    rounded = flushed(rounded)
    return Value(rounded, rounded.astype(wide(rounded.dtype)), np.zeros(rounded.shape))


def flushed(array: Array) -> Array:
    """Return floating-point numbers as processors are told to take them: below the least normal one is zero."""
    small = np.abs(array) < np.finfo(array.dtype).tiny
    return np.where(small, np.copysign(array.dtype.type(0.0), array), array).astype(array.dtype)


def settled(rounded: Array, exact: Array, error: Array, ulps: float = ULPS_ARITHMETIC) -> Value:
    """Return a result with the rounding of its last operation added to its error."""
    rounded = flushed(np.asarray(rounded))
    info = np.finfo(rounded.dtype)
    exact = np.asarray(exact, wide(rounded.dtype))
    size = np.abs(exact)
    fits = (error == 0.0) & (exact.astype(rounded.dtype).astype(exact.dtype) == exact)
    fits &= (size >= info.tiny) | (exact == 0.0)
    if ulps != ULPS_ARITHMETIC:
        fits = np.zeros_like(fits)
    finite = np.isfinite(exact)
    more = np.where(finite, ulps * info.eps * np.where(finite, size, 0.0) + info.tiny, 0.0)
    error = np.where(fits, 0.0, np.where(finite, error + more.astype(float), np.where(np.isfinite(error), 0.0, np.inf)))
    # Whether this is infinite depends on roundings, and on what is computed with more bits in between.
    error = np.where(finite & (size + error > 0.99 * info.max), np.inf, error)
    return Value(rounded, exact, error)


def monotonous(function: Callable[[Array], Array], x: Value, ulps: float = ULPS_LIBRARY) -> Value:
    """Return an elementwise function without a turning point."""
    exact = function(x.exact)
    ends = [np.abs(function(x.exact + side * np.where(np.isfinite(x.error), x.error, 0.0)) - exact) for side in (-1, 1)]
    spread = np.maximum(*ends)
    error = np.where(x.error == 0.0, 0.0, np.where(np.isnan(spread) & ~np.isnan(exact), np.inf, spread))
    error = np.where(np.isfinite(x.error), np.where(np.isnan(exact) & (x.error > 0.0), np.inf, error), np.inf)
    return settled(function(x.rounded), exact, error.astype(float), ulps)


def smooth(function: Callable[[Array], Array], slope: Callable[[Array, Array], Array], x: Value) -> Value:
    """Return an elementwise function of at most a slope over all that an argument may be."""
    with_error = np.where(x.error > 0.0, x.error * slope(x.exact, x.error), 0.0)
    error = np.where(np.isnan(with_error), np.inf, with_error)
    return settled(function(x.rounded), function(x.exact), error.astype(float), ULPS_LIBRARY)


def stepped(function: Callable[[Array], Array], x: Value) -> Value:
    """Return an elementwise function of steps: known where all that the argument may be is on one."""
    safe = np.where(np.isfinite(x.error), x.error, 0.0)
    below, above = function(x.exact - safe), function(x.exact + safe)
    same = ((below == above) | (np.isnan(below) & np.isnan(above))) & np.isfinite(x.error)
    exact = function(x.exact)
    return Value(flushed(function(x.rounded)), exact, np.where((x.error == 0.0) | same, 0.0, np.inf))


def compared(function: Callable[[Any, Any], Array], a: Value, b: Value) -> Value:
    """Return a comparison: known where the errors do not decide it."""
    with np.errstate(invalid="ignore"):
        apart = np.abs(a.exact - b.exact) > a.error + b.error if a.exact.dtype.kind == "f" else np.False_
    sure = ((a.error == 0.0) & (b.error == 0.0)) | apart
    unlike = (a.exact != b.exact) & ~(np.isfinite(a.exact) & np.isfinite(b.exact))
    sure = sure | (unlike & np.isfinite(a.error + b.error))
    return Value(function(a.rounded, b.rounded), function(a.exact, b.exact), np.where(sure, 0.0, np.inf))


def chosen(which: Value, first: Value, second: Value) -> Value:
    """Return ``second`` where ``which`` holds, else ``first``."""
    parts = [
        np.where(w, b, a) for w, a, b in zip((which.rounded, which.exact, which.exact), first, second, strict=True)
    ]
    return Value(parts[0], parts[1], np.where(np.isfinite(which.error), parts[2], np.inf))


def whole(result: Array, *arguments: Value) -> Value:
    """Return whole numbers or bools that are known where their arguments are."""
    error = np.zeros(np.shape(result))
    for argument in arguments:
        error = error + np.where(np.isfinite(argument.error), 0.0, np.inf)
    return Value(np.asarray(result), np.asarray(result), error)


def exact_together(x: Value, axes: Sequence[int]) -> Array:
    """Return where a sum over axes is exact in any order: small multiples of 1/1024."""
    finite = np.where(np.isfinite(x.exact), x.exact, 0.5e-9)
    parts = (finite * 1024.0 == np.floor(finite * 1024.0)) & (x.error == 0.0)
    return np.asarray(parts.all(axis=tuple(axes)) & (np.abs(finite * 1024.0).sum(axis=tuple(axes)) < 2.0**23))
