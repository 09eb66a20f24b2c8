"""Traced functions evaluated with NumPy.

Loading, checking and recording compute a few numbers with functions that are written for JAX. XLA would take longer to
compile each of them than a short flight takes. Here a function is traced and its operations are computed one by one, as
JAX does without compiling; what NumPy has no operation for is left to JAX.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from typing import Any

import jax
import numpy as np
from jax.extend import core as jex

from qrsim.core.primitives import KERNELS
from qrsim.core.structure import kinds

_CALLS = ("jit", "pjit", "custom_jvp_call", "custom_vjp_call", "closed_call", "remat", "checkpoint")
# So many programs of a function are kept.
_MOST = 64


class _UnknownError(Exception):
    """An operation that is not computed here."""


def on_host(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of trees of arrays that computes with NumPy and returns a tree of NumPy arrays.

    Args:
        function: depends on its arguments alone. It is traced once for each structure, shape and type of them.
    """
    traced: dict[Any, Any] = {}

    @wraps(function)
    def call(*trees: Any) -> Any:
        leaves, structure = jax.tree.flatten(trees)
        arrays = [np.asarray(leaf, jax.dtypes.canonicalize_dtype(np.asarray(leaf).dtype)) for leaf in leaves]
        # As text and by types too: to JAX, structures whose records differ in nothing but their type are equal.
        key = repr(structure), tuple(kinds(structure)), tuple((array.shape, array.dtype) for array in arrays)
        if key not in traced:
            while len(traced) >= _MOST:
                del traced[next(iter(traced))]
            templates = jax.tree.unflatten(structure, arrays)
            closed, shape = jax.make_jaxpr(function, return_shape=True)(*templates)
            traced[key] = closed, jax.tree.structure(shape)
        closed, result = traced[key]
        try:
            with np.errstate(all="ignore"):
                found = _run(closed, arrays)
        except _UnknownError:
            return jax.tree.map(np.asarray, jax.jit(function)(*trees))
        return jax.tree.unflatten(result, found)

    return call


@cache
def _kernel(name: str) -> Any:
    """Return the body of a kernel, traced for single elements; NumPy spreads its operations over arrays."""
    kernel = KERNELS[name]
    return jax.make_jaxpr(kernel.body)(*(np.zeros((), dtype) for dtype in kernel.takes))


def _run(closed: Any, arguments: list[Any]) -> list[Any]:
    """Return the results of a program, each in its shape."""
    found = _results(closed, arguments)
    return [np.broadcast_to(array, aval.shape) for array, aval in zip(found, closed.out_avals, strict=True)]


def _results(closed: Any, arguments: list[Any]) -> list[Any]:
    jaxpr: Any = closed.jaxpr
    known: dict[Any, Any] = dict(zip(jaxpr.invars, arguments, strict=True))
    known.update(zip(jaxpr.constvars, map(np.asarray, closed.consts), strict=True))

    def read(atom: Any) -> Any:
        if not isinstance(atom, jex.Literal):
            return known[atom]
        of: Any = atom.aval
        return np.asarray(atom.val, of.dtype)

    for equation in jaxpr.eqns:
        found = _applied(equation, [read(atom) for atom in equation.invars])
        for variable, value in zip(equation.outvars, found, strict=True):
            aval: Any = variable.aval
            known[variable] = value if value.dtype == aval.dtype else value.astype(aval.dtype)
    return [read(atom) for atom in jaxpr.outvars]


def _applied(equation: Any, inputs: list[Any]) -> list[Any]:
    name, parameters = equation.primitive.name, equation.params
    if name in _CALLS:
        return _results(parameters["call_jaxpr" if "call_jaxpr" in parameters else "jaxpr"], inputs)
    if name.startswith("kernel_") and name.removeprefix("kernel_") in KERNELS:
        return _results(_kernel(name.removeprefix("kernel_")), inputs)
    if name in _PLAIN:
        return [_PLAIN[name](*inputs)]
    if name in _WITH_PARAMETERS:
        return [_WITH_PARAMETERS[name](parameters, *inputs)]
    raise _UnknownError(name)


def _rounded(parameters: Any, x: Any) -> Any:
    if int(parameters["rounding_method"]) == 1:
        return np.rint(x)
    return np.copysign(np.floor(np.abs(x) + 0.5), x)


def _power(x: Any, exponent: int) -> Any:
    # By squares, in the order of the compilers.
    result, square, left = None, x, abs(exponent)
    while left:
        if left & 1:
            result = square if result is None else result * square
        square, left = square * square, left >> 1
    result = np.ones_like(x) if result is None else result
    return result if exponent >= 0 else 1 / result


def _spread(parameters: Any, x: Any) -> Any:
    shape, axes = parameters["shape"], parameters["broadcast_dimensions"]
    aligned = [1] * len(shape)
    for axis, extent in zip(axes, x.shape, strict=True):
        aligned[axis] = extent
    return np.broadcast_to(x.reshape(aligned), shape)


def _part(parameters: Any, x: Any) -> Any:
    bounds = zip(parameters["start_indices"], parameters["limit_indices"], strict=True)
    steps = parameters["strides"] or (1,) * x.ndim
    return x[tuple(slice(begin, end, step) for (begin, end), step in zip(bounds, steps, strict=True))]


_PLAIN: dict[str, Callable[..., Any]] = {
    "add": np.add, "add_any": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide, "neg": np.negative,
    "max": np.maximum, "min": np.minimum, "abs": np.abs, "sign": np.sign, "sqrt": np.sqrt, "square": np.square,
    "floor": np.floor, "ceil": np.ceil, "exp": np.exp, "log": np.log, "sin": np.sin, "cos": np.cos, "tan": np.tan,
    "atan2": np.arctan2, "pow": np.power, "is_finite": np.isfinite, "rounded": lambda x: x, "copy": lambda x: x,
    "stop_gradient": lambda x: x, "optimization_barrier": lambda x: x,
    "eq": np.equal, "ne": np.not_equal, "lt": np.less, "le": np.less_equal, "gt": np.greater, "ge": np.greater_equal,
    "and": np.bitwise_and, "or": np.bitwise_or, "xor": np.bitwise_xor, "not": np.invert,
    "shift_left": np.left_shift, "shift_right_arithmetic": np.right_shift,
    "clamp": lambda low, x, high: np.minimum(np.maximum(x, low), high),
}  # fmt: skip
_WITH_PARAMETERS: dict[str, Callable[..., Any]] = {
    "select_n": lambda p, which, *cases: np.where(which, cases[1], cases[0]) if len(cases) == 2 else _unknown(),
    "integer_pow": lambda p, x: _power(x, p["y"]),
    "round": _rounded,
    "convert_element_type": lambda p, x: x.astype(p["new_dtype"]),
    "bitcast_convert_type": lambda p, x: np.ascontiguousarray(x).view(p["new_dtype"]),
    "broadcast_in_dim": _spread,
    "reshape": lambda p, x: x.reshape(p["new_sizes"]),
    "squeeze": lambda p, x: np.squeeze(x, p["dimensions"]),
    "transpose": lambda p, x: np.transpose(x, p["permutation"]),
    "slice": _part,
    "concatenate": lambda p, *parts: np.concatenate(parts, p["dimension"]),
    "reduce_max": lambda p, x: np.max(x, p["axes"]),
    "reduce_min": lambda p, x: np.min(x, p["axes"]),
    "reduce_or": lambda p, x: np.any(x, p["axes"]),
    "reduce_and": lambda p, x: np.all(x, p["axes"]),
}  # fmt: skip


def _unknown() -> Any:
    raise _UnknownError
