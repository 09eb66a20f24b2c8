"""A JAX function evaluated by NumPy, operation by operation: what it computes, without a compilation.

The function is traced as ``jax.jit`` traces it, so laws about structure, slopes and batches hold or fail as they would
in a compiled program. What has no rule here is left to JAX.
"""

from __future__ import annotations

import functools
import itertools
import operator
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax.extend import core as jex

from qrsim.core.primitives import KERNELS

Array = np.ndarray[Any, Any]
Rule = Callable[..., Any]
# Longer loops are left to JAX.
MOST_TURNS = 100


def by_numpy(function: Callable[..., Any], each: Sequence[Sequence[Any]]) -> list[Any]:
    """Return what a function makes of each of several lists of arguments of the same shapes; it is traced once."""
    closed, shape = jax.make_jaxpr(function, return_shape=True)(*each[0])
    results = [evaluate(closed, jax.tree.leaves(arguments)) for arguments in each]
    return [jax.tree.unflatten(jax.tree.structure(shape), leaves) for leaves in results]


def uncompiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that computes the same by NumPy; its arguments may be of any kind."""
    return lambda *arguments, **named: by_numpy(lambda: function(*arguments, **named), [()])[0]


def evaluate(closed: Any, arguments: Sequence[Any]) -> list[Array]:
    """Return the results of a closed jaxpr."""
    with np.errstate(all="ignore"):
        return _run(closed.jaxpr, closed.consts, arguments)


def _run(jaxpr: Any, constants: Sequence[Any], arguments: Sequence[Any]) -> list[Any]:
    known: dict[Any, Any] = {}
    for variable, value in zip((*jaxpr.constvars, *jaxpr.invars), (*constants, *arguments), strict=True):
        known[variable] = np.asarray(value)

    def read(atom: Any) -> Any:
        return np.asarray(atom.val, atom.aval.dtype) if isinstance(atom, jex.Literal) else known[atom]

    for equation in jaxpr.eqns:
        inputs = [read(atom) for atom in equation.invars]
        outputs = _applied(equation, inputs)
        for variable, value in zip(equation.outvars, outputs, strict=True):
            known[variable] = np.asarray(value, variable.aval.dtype)
    return [read(atom) for atom in jaxpr.outvars]


def _applied(equation: Any, inputs: list[Any]) -> Sequence[Any]:
    name, parameters = equation.primitive.name, equation.params
    rule = _RULES.get(name)
    if rule is not None:
        return (rule(parameters, *inputs),)
    if name in _WHOLE and parameters.get("length", 0) <= MOST_TURNS:
        return _WHOLE[name](parameters, *inputs)
    if name.startswith("kernel_"):
        body = _kernel(name.removeprefix("kernel_"), *((each.shape, each.dtype) for each in inputs))
        return _run(body.jaxpr, body.consts, inputs)
    found = equation.primitive.bind(*map(jax.numpy.asarray, inputs), **parameters)
    return found if equation.primitive.multiple_results else (found,)


@functools.cache
def _kernel(name: str, *like: tuple[tuple[int, ...], Any]) -> Any:
    return jax.make_jaxpr(KERNELS[name].body)(*(jax.ShapeDtypeStruct(*each) for each in like))


# Programs inside programs


def _called(parameters: Any, *inputs: Any) -> list[Any]:
    closed = parameters.get("jaxpr", parameters.get("call_jaxpr"))
    return _run(getattr(closed, "jaxpr", closed), getattr(closed, "consts", ()), inputs)


def _cond(parameters: Any, index: Any, *inputs: Any) -> list[Any]:
    branches = parameters["branches"]
    chosen = branches[min(max(int(index), 0), len(branches) - 1)]
    return _run(chosen.jaxpr, chosen.consts, inputs)


def _scan(parameters: Any, *inputs: Any) -> list[Any]:
    body, constants, carried = parameters["jaxpr"], parameters["num_consts"], parameters["num_carry"]
    same, state, rows = inputs[:constants], inputs[constants : constants + carried], inputs[constants + carried :]
    turns = range(parameters["length"])
    found: list[list[Any]] = []
    for i in reversed(turns) if parameters["reverse"] else turns:
        results = _run(body.jaxpr, body.consts, (*same, *state, *(row[i] for row in rows)))
        state = tuple(results[:carried])
        found.append(results[carried:])
    if parameters["reverse"]:
        found.reverse()
    return [*state, *(np.stack(each) for each in zip(*found, strict=True))]


_WHOLE: dict[str, Rule] = {
    **dict.fromkeys(("jit", "pjit", "closed_call", "custom_jvp_call", "custom_vjp_call", "checkpoint"), _called),
    "cond": _cond, "scan": _scan,
    "unstack": lambda p, x: [np.take(x, i, p["axis"]) for i in range(x.shape[p["axis"]])],
    "split": lambda p, x: np.split(x, np.cumsum(p["sizes"])[:-1], p["axis"]),
}  # fmt: skip


# Operations


def _broadcast(parameters: Any, x: Any) -> Any:
    shape, to = parameters["shape"], parameters["broadcast_dimensions"]
    wider = [x.shape[to.index(axis)] if axis in to else 1 for axis in range(len(shape))]
    return np.broadcast_to(x.reshape(wider), shape)


def _slice(parameters: Any, x: Any) -> Any:
    strides = parameters["strides"] or itertools.repeat(1)
    return x[tuple(map(slice, parameters["start_indices"], parameters["limit_indices"], strides))]


def _select(parameters: Any, which: Any, *cases: Any) -> Any:
    return np.where(which, cases[1], cases[0]) if which.dtype == bool else np.choose(which, cases)


def _converted(parameters: Any, x: Any) -> Any:
    to = parameters["new_dtype"]
    if x.dtype.kind == "f" and np.dtype(to).kind in "iu":
        # Beyond what fits, NumPy's result depends on the processor.
        limits = np.iinfo(to)
        return np.clip(np.nan_to_num(np.trunc(x.astype(np.float64))), limits.min, limits.max).astype(to)
    return x.astype(to)


def _rounded(parameters: Any, x: Any) -> Any:
    if int(parameters["rounding_method"]) == 1:
        return np.rint(x)
    return np.copysign(np.floor(np.abs(x) + x.dtype.type(0.5)), x)


def _power(parameters: Any, x: Any) -> Any:
    exponent = parameters["y"]
    found = functools.reduce(operator.mul, [x] * abs(exponent), np.ones_like(x))
    return found if exponent >= 0 else np.reciprocal(found)


def _quotient(parameters: Any, a: Any, b: Any) -> Any:
    return a / b if a.dtype.kind == "f" else np.trunc(a.astype(np.float64) / b)


def _padded(parameters: Any, x: Any, value: Any) -> Any:
    sizes = [low + high + n + max(n - 1, 0) * gap for n, (low, high, gap) in zip(x.shape, parameters["padding_config"],
                                                                                 strict=True)]  # fmt: skip
    if any(min(low, high) < 0 for low, high, _ in parameters["padding_config"]):
        return jax.lax.pad(jax.numpy.asarray(x), jax.numpy.asarray(value), parameters["padding_config"])
    found = np.full(sizes, value, x.dtype)
    found[tuple(slice(low, size - high, gap + 1) for size, (low, high, gap) in zip(sizes, parameters["padding_config"],
                                                                                  strict=True))] = x  # fmt: skip
    return found


def _iota(parameters: Any) -> Any:
    shape, axis = parameters["shape"], parameters["dimension"]
    counted = np.arange(shape[axis]).reshape([-1 if i == axis else 1 for i in range(len(shape))])
    return np.broadcast_to(counted, shape)


def _shifted(function: Rule) -> Rule:
    def rule(parameters: Any, a: Any, b: Any) -> Any:
        bits = 8 * a.dtype.itemsize
        unsigned = a.view(f"u{a.dtype.itemsize}") if function is np.right_shift else a
        return np.where(b < a.dtype.type(bits), function(unsigned, b.astype(unsigned.dtype)), 0).astype(a.dtype)

    return rule


def _of(function: Rule) -> Rule:
    return lambda parameters, *inputs: function(*inputs)


def _sum(parameters: Any, x: Any) -> Any:
    axes = parameters["axes"]
    rest = [size for axis, size in enumerate(x.shape) if axis not in axes]
    parts = np.moveaxis(x, axes, range(len(axes))).reshape(-1, *rest)
    # One after the other in every layout, unlike np.sum.
    return np.add.accumulate(parts, axis=0, dtype=x.dtype)[-1] if len(parts) else np.zeros(rest, x.dtype)


def _along(function: Any) -> Rule:
    return lambda parameters, x: function.reduce(x, axis=tuple(parameters["axes"]), dtype=x.dtype)


_RULES: dict[str, Rule] = {
    **{name: _of(function) for name, function in {
        "add": np.add, "add_any": np.add, "sub": np.subtract, "mul": np.multiply, "max": np.maximum, "min": np.minimum,
        "neg": np.negative, "abs": np.abs, "sqrt": np.sqrt, "sign": np.sign, "floor": np.floor, "ceil": np.ceil,
        "rem": np.fmod, "square": np.square, "atan2": np.arctan2, "rsqrt": lambda x: 1 / np.sqrt(x),
        "lt": np.less, "le": np.less_equal, "gt": np.greater, "ge": np.greater_equal, "eq": np.equal,
        "ne": np.not_equal, "and": np.bitwise_and, "or": np.bitwise_or, "xor": np.bitwise_xor, "not": np.invert,
        "is_finite": np.isfinite, "expm1": np.expm1, "log1p": np.log1p, "exp": np.exp, "log": np.log,
        "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "sin": np.sin, "cos": np.cos, "tan": np.tan,
        "tanh": np.tanh, "sinh": np.sinh, "cosh": np.cosh, "exp2": np.exp2, "stop_gradient": lambda x: x,
        "rounded": lambda x: x, "copy": lambda x: x, "clamp": lambda low, x, high: np.minimum(np.maximum(low, x), high),
    }.items()},
    **{f"reduce_{name}": _along(function) for name, function in {
        "max": np.maximum, "min": np.minimum, "or": np.bitwise_or, "and": np.bitwise_and,
        "prod": np.multiply}.items()},
    "reduce_sum": _sum, "broadcast_in_dim": _broadcast,
    "slice": _slice, "select_n": _select, "convert_element_type": _converted,
    "round": _rounded, "integer_pow": _power, "div": _quotient, "pad": _padded, "iota": _iota,
    "reshape": lambda p, x: x.reshape(p["new_sizes"]),
    "squeeze": lambda p, x: np.squeeze(x, tuple(p["dimensions"])),
    "transpose": lambda p, x: x.transpose(p["permutation"]),
    "concatenate": lambda p, *parts: np.concatenate(parts, p["dimension"]),
    "stack": lambda p, *parts: np.stack(parts, p["axis"]),
    "bitcast_convert_type": lambda p, x: np.ascontiguousarray(x).view(p["new_dtype"]).reshape(x.shape),
    "empty2": lambda p: np.zeros((), p["dtype"]),
    "shift_left": _shifted(np.left_shift), "shift_right_logical": _shifted(np.right_shift),
    "shift_right_arithmetic": lambda p, a, b: np.right_shift(a, np.minimum(b, a.dtype.type(8 * a.dtype.itemsize - 1))),
}  # fmt: skip
