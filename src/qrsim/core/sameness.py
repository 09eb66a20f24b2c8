"""Detects changes of users' objects since a program was compiled from them."""

from __future__ import annotations

import functools
import hashlib
import types
import weakref
from collections.abc import Callable, Hashable

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.arrays import NumpyArray

# Maximum depth of the comparison; deeper objects compare by identity.
DEPTH = 4
_PLAIN = (bool, int, float, complex, str, bytes, type(None))
_CODE = (
    type,
    types.FunctionType,
    types.BuiltinFunctionType,
    types.MethodType,
    types.ModuleType,
    functools.partial,
    jax.stages.Wrapped,
)


class Itself:
    """An object as a key: equal to itself only, and to nothing once the object is gone.

    Args:
        given: the object. It is kept alive only if it cannot be referred to weakly.
    """

    def __init__(self, given: object):
        self._id = id(given)
        try:
            self._given: Callable[[], object] = weakref.ref(given)
        except TypeError:
            self._given = lambda: given

    @property
    def gone(self) -> bool:
        """True if the object that this key refers to no longer exists."""
        return self._given() is None

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        # Another object may have the same id by now.
        mine = self._given()
        return mine is not None and isinstance(other, Itself) and mine is other._given()

    def __hash__(self) -> int:
        return self._id


def sameness(given: object, depth: int = DEPTH) -> Hashable:
    """Return a hashable key that changes if the object is replaced or one of its attributes changes.

    A program has the attributes of a policy as constants. Functions and classes compare by identity: as with
    ``jax.jit``, a change of a variable that they close over is not noticed.

    Args:
        given: the object.
        depth: largest depth of attributes, lists and dicts that are compared.
    """
    if isinstance(given, _PLAIN):
        # As text, because 1, 1.0 and True are equal, NaN is not equal to itself, and -0.0 is no 0.0.
        return type(given), repr(given)
    if isinstance(given, jax.core.Tracer):
        # Left behind by a program that was made; no two programs leave the same.
        return jax.core.Tracer
    if isinstance(given, np.ndarray | np.generic | jax.Array) and _has_numbers(given):
        numbers = np.asarray(given)
        return type(given), str(numbers.dtype), numbers.shape, hashlib.sha256(numbers.tobytes()).digest()
    if depth and not isinstance(given, _CODE):
        if isinstance(given, list | tuple):
            return type(given), tuple(sameness(part, depth - 1) for part in given)
        if isinstance(given, set | frozenset):
            return type(given), frozenset(sameness(part, depth - 1) for part in given)
        named = given if isinstance(given, dict) else getattr(given, "__dict__", {})
        parts = tuple((sameness(name, 1), sameness(part, depth - 1)) for name, part in list(named.items()))
        return type(given) if isinstance(given, dict) else Itself(given), parts
    return Itself(given)


def is_gone(key: Hashable) -> bool:
    """Return whether a key of ``sameness`` refers to an object that no longer exists."""
    if isinstance(key, Itself):
        return key.gone
    return isinstance(key, tuple | frozenset) and any(map(is_gone, key))


def _has_numbers(array: NumpyArray | np.generic | jax.Array) -> bool:
    """Return whether an array's elements are numbers, not objects or random keys."""
    return not jnp.issubdtype(array.dtype, jax.dtypes.extended) and array.dtype != object
