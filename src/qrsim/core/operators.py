"""Operators of traced arrays without the compiled function that JAX wraps around each.

``a * b`` of two tracers calls a jitted function of ``jax.numpy``. JAX looks up its signature and inlines it, which
takes two to four times as long as binding the one operation that it becomes. A tick has thousands of them. Here
operators of arrays of one type, and of an array and a number, bind that operation at once. The traced program is the
same.
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
_by_jax: Callable[..., Any] = jnp.ufunc.__call__
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
        jnp.ufunc.__call__ = _call  # type: ignore[method-assign]
    try:
        yield
    finally:
        with _lock:
            _inside[0] -= 1
            if not _inside[0]:
                jnp.ufunc.__call__ = _by_jax  # type: ignore[method-assign]


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
