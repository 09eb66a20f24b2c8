"""A digest of a traced program: equal for two traces of the same operations, in this process or in another."""

from __future__ import annotations

import enum
import hashlib
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

import jax
import numpy as np
from jax.extend import core as jex

from qrsim.core.arrays import NumpyArray
from qrsim.engine.llvm.rules import RULES


class UnknownError(Exception):
    """A program with a part that another process could not tell from another one."""


def digest(closed: object) -> str | None:
    """Return a hash of a closed jaxpr, equal for equal programs; None if a part of it cannot be hashed.

    Names, source lines and rules of differentiation are no part of it: they change nothing that is computed.
    """
    try:
        return _Walk().closed(closed)
    except UnknownError:
        return None


class _Walk:
    """Digests a program and the programs inside it, each of them once."""

    def __init__(self) -> None:
        # With the program itself, so that no other one gets its address.
        self._found: dict[int, tuple[object, str]] = {}

    def closed(self, closed: Any) -> str:
        """Return the hash of a closed jaxpr, or of a jaxpr without constants."""
        known = self._found.get(id(closed))
        if known is None:
            whole = isinstance(closed, jex.ClosedJaxpr)
            known = closed, self._jaxpr_digest(closed.jaxpr, closed.consts) if whole else self._jaxpr_digest(closed, ())
            self._found[id(closed)] = known
        return known[1]

    def _jaxpr_digest(self, jaxpr: Any, constants: Any) -> str:
        """Return the hash of a jaxpr and its constants."""
        result, numbers = hashlib.sha256(), dict[object, int]()

        def add(*parts: object) -> None:
            """Add values to the hash."""
            result.update(repr(parts).encode())

        def define(variables: Any) -> list[Any]:
            """Number the new variables of a jaxpr, and return their shapes and dtypes."""
            found = []
            for variable in variables:
                numbers[variable] = len(numbers)
                found.append((variable.aval.shape, variable.aval.dtype.name))
            return found

        def read(atom: object) -> object:
            """Return the number of a jaxpr's variable, or the hash of a literal."""
            if isinstance(atom, jex.Literal):
                return _array_digest(np.asarray(atom.val, atom.aval.dtype))  # type: ignore[attr-defined]
            return numbers[atom]

        add(define(jaxpr.constvars), [self._value(constant) for constant in constants], define(jaxpr.invars))
        for equation in jaxpr.eqns:
            rule = RULES.get(equation.primitive)
            # One of somebody else may have the name of a known one.
            if rule is None:
                raise UnknownError
            # Of a call only what is called: the rest is there for JAX's own compiler and for derivatives.
            params = [rule.op] if rule.method == "call" else sorted(equation.params)
            add(
                equation.primitive.name,
                [read(atom) for atom in equation.invars],
                [(name, self._value(equation.params[name])) for name in params],
                define(equation.outvars),
            )
        add([read(atom) for atom in jaxpr.outvars])
        return result.hexdigest()

    def _value(self, value: object) -> object:
        """Return an equation's parameter as an object with a unique repr; raise UnknownError for unknown kinds."""
        for kinds, text in self._TEXTS:
            if isinstance(value, kinds):
                return text(self, value)
        if isinstance(value, jex.ClosedJaxpr | jex.Jaxpr):
            return self.closed(value)
        raise UnknownError

    def _several(self, values: Sequence[object]) -> object:
        """Return a sequence's type name and the hashes of its elements."""
        return type(values).__name__, [self._value(value) for value in values]

    _TEXTS: tuple[tuple[Any, Callable[[Any, Any], Any]], ...] = (
        ((bool, int, str, bytes, type(None)), lambda walk, value: (type(value).__name__, repr(value))),
        (float, lambda walk, value: ("float", value.hex())),
        (enum.Enum, lambda walk, value: (type(value).__name__, value.name)),
        (np.dtype, lambda walk, value: ("dtype", value.name)),
        ((np.ndarray, np.generic, jax.Array), lambda walk, value: _array_digest(np.asarray(value))),
        ((tuple, list), _several),
        (
            type,
            lambda walk, value: ("dtype", np.dtype(value).name) if issubclass(value, np.generic) else _raise_unknown(),
        ),
    )


def _array_digest(array: NumpyArray) -> object:
    """Return an array's shape, dtype and hash."""
    return array.shape, array.dtype.name, hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()


def _raise_unknown() -> NoReturn:
    """Raise UnknownError, because the program contains a value that cannot be hashed."""
    raise UnknownError
