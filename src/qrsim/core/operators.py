"""Operators of traced arrays without the compiled function that JAX wraps around each.

``a * b`` of two tracers calls a jitted function of ``jax.numpy``. JAX looks up its signature and inlines it, which
takes two to four times as long as binding the one operation that it becomes. A tick has thousands of them. Here
operators of arrays of one type, and of an array and a number, bind that operation at once. The traced program is the
same, except for ``jnp.where``: JAX calls a separate program for each one, here its operations stand in the main one.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend import source_info_util

# Lines of code that messages name are those of the caller.
source_info_util.register_exclusion(__file__)

_OF_NUMBERS: dict[Any, Callable[[Any, Any], Any]] = {
    jnp.add: lax.add,
    jnp.subtract: lax.sub,
    jnp.multiply: lax.mul,
    jnp.maximum: lax.max,
    jnp.minimum: lax.min,
    jnp.less: lax.lt,
    jnp.less_equal: lax.le,
    jnp.greater: lax.gt,
    jnp.greater_equal: lax.ge,
    jnp.equal: lax.eq,
    jnp.not_equal: lax.ne,
}
_OF_FLOATS = {**_OF_NUMBERS, jnp.divide: lax.div, jnp.true_divide: lax.div}
_OF_BITS = {jnp.bitwise_and: lax.bitwise_and, jnp.bitwise_or: lax.bitwise_or, jnp.bitwise_xor: lax.bitwise_xor}
# Functions by identity, as users may make some of the same names.
_DIRECT = {
    np.dtype(kind): {id(function): direct for function, direct in functions.items()}
    for kind, functions in (
        (np.float32, _OF_FLOATS),
        (np.float64, _OF_FLOATS),
        (np.int32, {**_OF_NUMBERS, **_OF_BITS}),
        (np.uint32, {**_OF_NUMBERS, **_OF_BITS}),
        (np.bool_, _OF_BITS),
    )
}
# Python's numbers of other types and beyond these bounds are left to JAX.
_NUMBERS = {
    "f": ((float, int), -3e38, 3e38),
    "i": ((int,), -(2**31), 2**31 - 1),
    "u": ((int,), 0, 2**32 - 1),
    "b": ((), 0, 0),
}
_SIGNED = (np.dtype(np.float32), np.dtype(np.float64), np.dtype(np.int32))
_by_jax: Callable[..., Any] = jnp.ufunc.__call__
_where_of_jax: Callable[..., Any] = jnp.where
_lock = threading.Lock()
_inside = [0]


def make_jaxpr(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
    """Return ``jax.make_jaxpr`` of a function in a faster form: operators of traced arrays skip jax.numpy's checks."""
    traced: Callable[..., Any] = jax.make_jaxpr(function, **options)

    def trace(*arguments: Any) -> Any:
        """Return the jaxpr of the function for these arguments, or for their shapes."""
        with _direct_operators():
            return traced(*arguments)

    return trace


@contextlib.contextmanager
def _direct_operators() -> Iterator[None]:
    """Patch jax.numpy, inside a ``with`` block and in all threads, so that operators of traced arrays bind directly."""
    with _lock:
        _inside[0] += 1
        for (owner, name), (own, _) in _REPLACED.items():
            setattr(owner, name, own)
    try:
        yield
    finally:
        with _lock:
            _inside[0] -= 1
            if not _inside[0]:
                for (owner, name), (_, plain) in _REPLACED.items():
                    setattr(owner, name, plain)


def _call(self: Any, *arguments: Any, **options: Any) -> Any:
    """Return the result of a jax.numpy ufunc called with these arguments, bound directly where possible."""
    if len(arguments) == 2 and not options:
        found = _direct(id(self), *arguments)
        if found is not None:
            return found
    return _by_jax(self, *arguments, **options)


def _direct(function: int, left: Any, right: Any) -> Any:
    """Return a traced array's operation with an array or number of its dtype, bound directly; None if not possible."""
    array, other = (left, right) if isinstance(left, jax.core.Tracer) else (right, left)
    if not isinstance(array, jax.core.Tracer):
        return None
    kind: Any = array.aval
    if not isinstance(kind, jax.core.ShapedArray):
        return None
    operation = _DIRECT.get(kind.dtype, {}).get(function)
    if operation is None or kind.weak_type:
        return None
    if isinstance(other, jax.core.Tracer):
        its: Any = other.aval
        # One of them may be a scalar, as in the operation itself.
        fits = its.shape == kind.shape or not its.shape or not kind.shape
        return operation(left, right) if fits and its.dtype == kind.dtype and not its.weak_type else None
    types, least, most = _NUMBERS[kind.dtype.kind]
    if type(other) not in types or not least <= other <= most:
        return None
    number = kind.dtype.type(other)
    return operation(array, number) if array is left else operation(number, array)


def _typed(value: Any) -> Any:
    """Return the shape and type of a tracer of an array whose type is not weak; None of others."""
    kind: Any = value.aval if isinstance(value, jax.core.Tracer) else None
    return kind if isinstance(kind, jax.core.ShapedArray) and not kind.weak_type else None


def _of_two(function: Any, plain: Callable[..., Any], swapped: bool) -> Callable[..., Any]:
    """Return the method of a tracer for an operator of two arrays."""
    number = id(function)

    def operator(self: Any, other: Any) -> Any:
        """Return the result of one operation, or of JAX's method."""
        found = _direct(number, other, self) if swapped else _direct(number, self, other)
        return plain(self, other) if found is None else found

    return operator


def _of_one(direct: Callable[..., Any], plain: Callable[..., Any], types: tuple[Any, ...]) -> Callable[..., Any]:
    """Return a function of one array of some types that binds its operation, and calls JAX's for others."""

    def function(*arguments: Any, **options: Any) -> Any:
        """Return the result of one operation, or of JAX's function."""
        if len(arguments) == 1 and not options:
            kind = _typed(arguments[0])
            if kind is not None and kind.dtype in types:
                return direct(arguments[0])
        return plain(*arguments, **options)

    return function


def _where(*arguments: Any, **options: Any) -> Any:
    """Return the result of a selection and what makes its cases of one shape, or of JAX's function."""
    if len(arguments) == 3 and not options:
        condition, *cases = arguments
        kind = _typed(condition)
        if kind is not None and kind.dtype == np.bool_:
            found = _selected(condition, kind.shape, cases)
            if found is not None:
                return found
    return _where_of_jax(*arguments, **options)


def _selected(condition: Any, shape: tuple[int, ...], cases: list[Any]) -> Any:
    """Return the cases where a condition of a shape is true and false; None if JAX has to convert something."""
    kinds = [_typed(case) for case in cases]
    known = [kind for kind in kinds if kind is not None]
    if not known or any(kind.dtype != known[0].dtype for kind in known):
        return None
    dtype, whole = known[0].dtype, {kind.shape for kind in known if kind.shape} | ({shape} if shape else set())
    if len(whole) > 1 or dtype not in _DIRECT:
        return None
    types, least, most = _NUMBERS[dtype.kind]
    for case, kind in zip(cases, kinds, strict=True):
        if kind is None and (type(case) not in types or not least <= case <= most):
            return None
    to = next(iter(whole), ())
    alike = [
        (lax.full(to, case, dtype) if kind is None else case if kind.shape == to else lax.broadcast(case, to))
        for case, kind in zip(cases, kinds, strict=True)
    ]
    return lax.select(condition, *alike)


_OF_TWO = {
    **{f"__{name}__": (function, False) for name, function in (
        ("add", jnp.add), ("sub", jnp.subtract), ("mul", jnp.multiply), ("truediv", jnp.true_divide),
        ("lt", jnp.less), ("le", jnp.less_equal), ("gt", jnp.greater), ("ge", jnp.greater_equal),
    )},
    "__radd__": (jnp.add, True), "__rsub__": (jnp.subtract, True), "__rmul__": (jnp.multiply, True),
    "__rtruediv__": (jnp.true_divide, True),
}  # fmt: skip
_Tracer: Any = jax.core.Tracer
# While tracing, these attributes have other values: those here, and those of JAX.
_REPLACED: dict[tuple[Any, str], tuple[Callable[..., Any], Callable[..., Any]]] = {
    (jnp.ufunc, "__call__"): (_call, _by_jax),
    (jnp, "where"): (_where, _where_of_jax),
    (jnp, "sqrt"): (_of_one(lax.sqrt, jnp.sqrt, _SIGNED[:2]), jnp.sqrt),
    (jnp, "isfinite"): (_of_one(lax.is_finite, jnp.isfinite, _SIGNED[:2]), jnp.isfinite),
    (_Tracer, "__neg__"): (_of_one(lax.neg, _Tracer.__neg__, _SIGNED), _Tracer.__neg__),
    **{
        (_Tracer, name): (_of_two(function, getattr(_Tracer, name), swapped), getattr(_Tracer, name))
        for name, (function, swapped) in _OF_TWO.items()
    },
}
