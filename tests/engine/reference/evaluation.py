"""A jaxpr evaluated operation by operation, with bounds: the reference for machine code (see ``bounds``)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax.extend import core as jex
from tests.engine.reference.arrays import RULES
from tests.engine.reference.bounds import AmbiguousError, Array, Value, given
from tests.engine.reference.elements import elementwise
from tests.engine.reference.halves import RULES as HALVES

from qrsim.core.primitives import KERNELS

# A loop of more turns than this is none that was meant.
MOST_TURNS = 10_000
_CALLS = {"jit": "jaxpr", "pjit": "jaxpr", "remat": "jaxpr", "checkpoint": "jaxpr", "remat2": "jaxpr",
          "custom_jvp_call": "call_jaxpr", "custom_vjp_call": "call_jaxpr", "closed_call": "call_jaxpr",
          "call": "call_jaxpr", "core_call": "call_jaxpr", "core_closed_call": "call_jaxpr"}  # fmt: skip


def evaluate(closed: Any, arguments: Sequence[Value]) -> list[Value]:
    """Return the results of a closed jaxpr.

    Raises:
        AmbiguousError: roundings decide a branch, the turns of a loop or a place.
        KeyError: an operation that is not known here.
    """
    return _run(closed.jaxpr, [given(constant) for constant in closed.consts], arguments)


def _run(jaxpr: Any, constants: Sequence[Value], arguments: Sequence[Value]) -> list[Value]:
    known: dict[Any, Value] = dict(zip(jaxpr.invars, arguments, strict=True))
    known.update(zip(jaxpr.constvars, constants, strict=True))

    def read(atom: Any) -> Value:
        return given(np.asarray(atom.val, atom.aval.dtype)) if isinstance(atom, jex.Literal) else known[atom]

    for equation in jaxpr.eqns:
        inputs = [read(atom) for atom in equation.invars]
        found = _applied(equation, inputs)
        for variable, value in zip(equation.outvars, found, strict=True):
            shape = tuple(variable.aval.shape)
            rounded = np.asarray(value.rounded, variable.aval.dtype)
            # Literals have no axes.
            known[variable] = Value(*(np.broadcast_to(part, shape) for part in (rounded, value.exact, value.error)))
    return [read(atom) for atom in jaxpr.outvars]


def _applied(equation: Any, inputs: list[Value]) -> list[Value]:
    name, parameters = equation.primitive.name, equation.params
    if name in _CALLS:
        closed = parameters[_CALLS[name]]
        return _run(getattr(closed, "jaxpr", closed), [given(c) for c in getattr(closed, "consts", ())], inputs)
    if name.startswith("kernel_"):
        closed = jax.make_jaxpr(KERNELS[name.removeprefix("kernel_")].body)(*(v.aval for v in equation.invars))
        return _run(closed.jaxpr, [given(constant) for constant in closed.consts], inputs)
    rule = RULES.get(name) or HALVES.get(name) or _CONTROL_FLOW.get(name)
    if rule is not None:
        found = rule(inputs, parameters, equation.outvars[0].aval)
        return found if isinstance(found, list) else [found]
    moved = _movement(name, parameters, equation)
    if moved is not None:
        return [inputs[0].each(moved)]
    return [elementwise(name, inputs, parameters, equation.outvars[0].aval.dtype)]


def _movement(name: str, parameters: Any, equation: Any) -> Callable[[Array], Array] | None:
    """Return what only moves elements of one array, None for anything else."""
    shape = tuple(equation.outvars[0].aval.shape)
    if name == "broadcast_in_dim":
        to, old = parameters["broadcast_dimensions"], tuple(equation.invars[0].aval.shape)
        wider = [old[to.index(axis)] if axis in to else 1 for axis in range(len(shape))]
        return lambda part: np.broadcast_to(part.reshape(wider), shape)
    if name in ("reshape", "squeeze"):
        return lambda part: part.reshape(shape)
    if name == "transpose":
        return lambda part: part.transpose(parameters["permutation"])
    if name == "slice":
        limits = zip(parameters["start_indices"], parameters["limit_indices"], strict=True)
        strides = parameters["strides"] or [1] * len(shape)
        cut = tuple(slice(a, b, s) for (a, b), s in zip(limits, strides, strict=True))
        return lambda part: part[cut]
    return None


def _branched(inputs: list[Value], parameters: Any, out: Any) -> list[Value]:
    if not inputs[0].known:
        raise AmbiguousError("which branch")
    branches = parameters["branches"]
    return evaluate(branches[int(np.clip(int(inputs[0].rounded), 0, len(branches) - 1))], inputs[1:])


def _repeated(inputs: list[Value], parameters: Any, out: Any) -> list[Value]:
    first, second = parameters["cond_nconsts"], parameters["body_nconsts"]
    carry = inputs[first + second :]
    for _ in range(MOST_TURNS):
        (goes_on,) = evaluate(parameters["cond_jaxpr"], [*inputs[:first], *carry])
        if not goes_on.known:
            raise AmbiguousError("how many turns")
        if not bool(goes_on.rounded):
            return carry
        carry = evaluate(parameters["body_jaxpr"], [*inputs[first : first + second], *carry])
    raise AmbiguousError("a loop without an end")


def _counted(inputs: list[Value], parameters: Any, out: Any) -> list[Value]:
    constants = parameters["num_consts"]
    carry = inputs[constants:]
    assert len(carry) == parameters["num_carry"]
    for _ in range(parameters["length"]):
        carry = evaluate(parameters["jaxpr"], [*inputs[:constants], *carry])
    return carry


_CONTROL_FLOW = {"cond": _branched, "while": _repeated, "scan": _counted}
