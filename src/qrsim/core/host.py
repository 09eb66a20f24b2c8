"""Traced functions evaluated with NumPy, operation by operation.

Loading, checking and recording compute a few numbers with functions that are written for JAX. XLA would take longer to
compile each of them than a short flight takes. Here a function is traced and its operations are computed one by one, as
JAX does without compiling; what NumPy has no operation for is left to JAX.
"""

from __future__ import annotations

import functools
import itertools
import operator
from collections.abc import Callable, Mapping, Sequence
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core as jex

from qrsim.core.arrays import NumpyArray
from qrsim.core.operators import make_jaxpr
from qrsim.core.primitives import KERNELS
from qrsim.core.structure import kinds

Rule = Callable[..., Any]
# Parameters of an equation, by name.
Parameters = Mapping[str, Any]
# Largest number of programs that are kept for a function.
_MOST = 64
# Longer loops are left to JAX.
_MOST_TURNS = 100


def library_of(*values: object) -> ModuleType:
    """Return the module numpy if all values are NumPy arrays, else jax.numpy, which traced values need."""
    return np if all(isinstance(value, np.ndarray) for value in values) else jnp


def on_host(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a JAX function in a form that NumPy computes: it takes and returns trees of arrays, NumPy's on return.

    Args:
        function: depends on its arguments alone. It is traced once for each structure, shape and type of them.
    """
    traced: dict[Any, Any] = {}

    @functools.wraps(function)
    def call(*trees: object) -> Any:
        """Return the function's result, computed by NumPy; it is traced at the first call for these shapes."""
        leaves, structure = jax.tree.flatten(trees)
        arrays = [np.asarray(leaf, jax.dtypes.canonicalize_dtype(np.asarray(leaf).dtype)) for leaf in leaves]
        # Text and types are part of the key: JAX treats structures as equal if only the types of their records differ.
        key = repr(structure), tuple(kinds(structure)), tuple((array.shape, array.dtype) for array in arrays)
        if key not in traced:
            while len(traced) >= _MOST:
                del traced[next(iter(traced))]
            templates = jax.tree.unflatten(structure, arrays)
            closed, shape = make_jaxpr(function, return_shape=True)(*templates)
            traced[key] = closed, jax.tree.structure(shape)
        closed, result = traced[key]
        return jax.tree.unflatten(result, evaluate(closed, arrays))

    return call


def evaluate(closed: jex.ClosedJaxpr, arguments: Sequence[object]) -> list[NumpyArray]:
    """Return the results of a closed jaxpr for NumPy arrays, by NumPy, each broadcast to its declared shape."""
    with np.errstate(all="ignore"):
        found = _run(closed.jaxpr, closed.consts, arguments)
    return [np.broadcast_to(array, aval.shape) for array, aval in zip(found, closed.out_avals, strict=True)]


def _run(jaxpr: Any, constants: Sequence[object], arguments: Sequence[object]) -> list[NumpyArray]:
    """Return the results of a jaxpr for its constants and arguments, computed equation by equation with NumPy."""
    known: dict[object, NumpyArray] = {}
    for variable, value in zip((*jaxpr.constvars, *jaxpr.invars), (*constants, *arguments), strict=True):
        known[variable] = np.asarray(value)

    def read(atom: object) -> NumpyArray:
        """Return the present value of a jaxpr's variable, or of a literal."""
        if not isinstance(atom, jex.Literal):
            return known[atom]
        of: Any = atom.aval
        return np.asarray(atom.val, of.dtype)

    for equation in jaxpr.eqns:
        outputs = _applied(equation, [read(atom) for atom in equation.invars])
        for variable, value in zip(equation.outvars, outputs, strict=True):
            known[variable] = np.asarray(value, variable.aval.dtype)
    return [read(atom) for atom in jaxpr.outvars]


def _applied(equation: jex.JaxprEqn, inputs: Sequence[object]) -> Sequence[object]:
    """Return the results of one equation of a jaxpr, by a NumPy rule of this file, else by JAX itself."""
    name, parameters = equation.primitive.name, equation.params
    rule = _RULES.get(name)
    if rule is not None:
        return (rule(parameters, *inputs),)
    if name in _WHOLE and parameters.get("length", 0) <= _MOST_TURNS:
        found: Sequence[object] = _WHOLE[name](parameters, *inputs)
        return found
    if name.startswith("kernel_"):
        body = _kernel(name.removeprefix("kernel_"))
        return _run(body.jaxpr, body.consts, inputs)
    found = equation.primitive.bind(*map(jax.numpy.asarray, inputs), **parameters)
    return found if equation.primitive.multiple_results else (found,)


@functools.cache
def _kernel(name: str) -> jex.ClosedJaxpr:
    """Return the jaxpr of the kernel (fused operation) ``name`` for scalars; NumPy broadcasts it over arrays."""
    kernel = KERNELS[name]
    return make_jaxpr(kernel.body)(*(np.zeros((), dtype) for dtype in kernel.takes))


# Programs inside programs


def _called(parameters: Parameters, *inputs: object) -> Sequence[object]:
    """Return the results of an equation that calls another jaxpr (such as a jitted function), by NumPy."""
    closed = parameters.get("jaxpr", parameters.get("call_jaxpr"))
    whole = isinstance(closed, jex.ClosedJaxpr)
    return _run(closed.jaxpr, closed.consts, inputs) if whole else _run(closed, (), inputs)


def _cond(parameters: Parameters, index: NumpyArray, *inputs: object) -> Sequence[object]:
    """Return the results of JAX's cond: those of the branch with number ``index``, by NumPy."""
    branches = parameters["branches"]
    chosen = branches[min(max(int(index), 0), len(branches) - 1)]
    return _run(chosen.jaxpr, chosen.consts, inputs)


def _scan(parameters: Parameters, *inputs: NumpyArray) -> Sequence[object]:
    """Return the results of JAX's scan, the final carry and then the stacked outputs, by NumPy."""
    body, constants, carried = parameters["jaxpr"], parameters["num_consts"], parameters["num_carry"]
    same, state, rows = inputs[:constants], inputs[constants : constants + carried], inputs[constants + carried :]
    turns = range(parameters["length"])
    found: list[Sequence[object]] = []
    for i in reversed(turns) if parameters["reverse"] else turns:
        results = _run(body.jaxpr, body.consts, (*same, *state, *(row[i] for row in rows)))
        state = tuple(results[:carried])
        found.append(results[carried:])
    if parameters["reverse"]:
        found.reverse()
    return [*state, *(np.stack(each) for each in zip(*found, strict=True))]


_WHOLE: dict[str, Rule] = {
    **dict.fromkeys(("jit", "pjit", "closed_call", "custom_jvp_call", "custom_vjp_call", "checkpoint"), _called),
    "cond": _cond,
    "scan": _scan,
    "unstack": lambda p, x: [np.take(x, i, p["axis"]) for i in range(x.shape[p["axis"]])],
    "split": lambda p, x: np.split(x, np.cumsum(p["sizes"])[:-1], p["axis"]),
}


# Operations


def _broadcast(parameters: Parameters, x: NumpyArray) -> NumpyArray:
    """Return the result of JAX's broadcast_in_dim, by NumPy."""
    shape, to = parameters["shape"], parameters["broadcast_dimensions"]
    wider = [x.shape[to.index(axis)] if axis in to else 1 for axis in range(len(shape))]
    return np.broadcast_to(x.reshape(wider), shape)


def _slice(parameters: Parameters, x: NumpyArray) -> object:
    """Return the result of JAX's slice, by NumPy."""
    strides = parameters["strides"] or itertools.repeat(1)
    return x[tuple(map(slice, parameters["start_indices"], parameters["limit_indices"], strides))]


def _slice_at(parameters: Parameters, x: NumpyArray, *starts: NumpyArray) -> object:
    """Return the result of JAX's dynamic_slice, by NumPy: a slice from ``starts``, clipped so that it fits."""
    sizes = parameters["slice_sizes"]
    first = [min(max(int(start), 0), n - size) for start, n, size in zip(starts, x.shape, sizes, strict=True)]
    return x[tuple(slice(start, start + size) for start, size in zip(first, sizes, strict=True))]


def _select(parameters: object, which: NumpyArray, *cases: NumpyArray) -> object:
    """Return the result of JAX's select_n, by NumPy: elements of ``cases`` chosen by ``which``."""
    return np.where(which, cases[1], cases[0]) if which.dtype == bool else np.choose(which, cases)


def _converted(parameters: Parameters, x: NumpyArray) -> Any:
    """Return the result of JAX's convert_element_type, by NumPy; for integers truncated and clipped."""
    to = parameters["new_dtype"]
    if x.dtype.kind == "f" and np.dtype(to).kind in "iu":
        # Beyond what fits, NumPy's result depends on the processor.
        limits = np.iinfo(to)
        return np.clip(np.nan_to_num(np.trunc(x.astype(np.float64))), limits.min, limits.max).astype(to)
    return x.astype(to)


def _rounded(parameters: Parameters, x: NumpyArray) -> object:
    """Return the result of JAX's round, by NumPy: half to even or, by its parameter, half away from zero."""
    if int(parameters["rounding_method"]) == 1:
        return np.rint(x)
    return np.copysign(np.floor(np.abs(x) + x.dtype.type(0.5)), x)


def _power(parameters: Parameters, x: object) -> object:
    """Return the result of JAX's integer_pow, by NumPy."""
    exponent = parameters["y"]
    found = functools.reduce(operator.mul, [x] * abs(exponent), np.ones_like(x))
    return found if exponent >= 0 else np.reciprocal(found)


def _quotient(parameters: object, a: NumpyArray, b: NumpyArray) -> object:
    """Return the result of JAX's div, by NumPy; integers are rounded towards zero."""
    return a / b if a.dtype.kind == "f" else np.trunc(a.astype(np.float64) / b)


def _padded(parameters: Parameters, x: NumpyArray, value: NumpyArray) -> object:
    """Return the result of JAX's pad, by NumPy: padded at the ends and between elements; negative padding cuts."""
    sizes = [
        low + high + n + max(n - 1, 0) * gap
        for n, (low, high, gap) in zip(x.shape, parameters["padding_config"], strict=True)
    ]
    if any(min(low, high) < 0 for low, high, _ in parameters["padding_config"]):
        return jax.lax.pad(jax.numpy.asarray(x), jax.numpy.asarray(value), parameters["padding_config"])
    found = np.full(sizes, value, x.dtype)
    found[
        tuple(
            slice(low, size - high, gap + 1)
            for size, (low, high, gap) in zip(sizes, parameters["padding_config"], strict=True)
        )
    ] = x
    return found


def _iota(parameters: Parameters) -> NumpyArray:
    """Return the result of JAX's iota, by NumPy: an array of indices along one axis."""
    shape, axis = parameters["shape"], parameters["dimension"]
    counted = np.arange(shape[axis]).reshape([-1 if i == axis else 1 for i in range(len(shape))])
    return np.broadcast_to(counted, shape)


def _shifted(function: Rule) -> Rule:
    """Return the NumPy rule of a bit shift by ``function``; shifts by the word's width or more give 0."""

    def rule(parameters: object, a: NumpyArray, b: NumpyArray) -> NumpyArray:
        """Return the bits of a shifted by b places, with zero bits coming in."""
        bits = 8 * a.dtype.itemsize
        unsigned = a.view(f"u{a.dtype.itemsize}") if function is np.right_shift else a
        return np.where(b < a.dtype.type(bits), function(unsigned, b.astype(unsigned.dtype)), 0).astype(a.dtype)

    return rule


def _ignoring_parameters(function: Rule) -> Rule:
    """Return a NumPy rule that calls ``function`` with an equation's inputs, without its parameters."""
    return lambda parameters, *inputs: function(*inputs)


def _sum(parameters: Parameters, x: NumpyArray) -> object:
    """Return the result of JAX's reduce_sum, by NumPy, always added in the same order."""
    axes = parameters["axes"]
    rest = [size for axis, size in enumerate(x.shape) if axis not in axes]
    parts = np.moveaxis(x, axes, range(len(axes))).reshape(-1, *rest)
    # One after the other in every layout, unlike np.sum.
    return np.add.accumulate(parts, axis=0, dtype=x.dtype)[-1] if len(parts) else np.zeros(rest, x.dtype)


def _along(function: Any) -> Rule:
    """Return a NumPy rule that reduces an array along the axes in the parameters, by a NumPy ufunc."""
    return lambda parameters, x: function.reduce(x, axis=tuple(parameters["axes"]), dtype=x.dtype)


_ELEMENTWISE: dict[str, Rule] = {
    "add": np.add, "add_any": np.add, "sub": np.subtract, "mul": np.multiply, "max": np.maximum, "min": np.minimum,
    "neg": np.negative, "abs": np.abs, "sqrt": np.sqrt, "sign": np.sign, "floor": np.floor, "ceil": np.ceil,
    "rem": np.fmod, "square": np.square, "atan2": np.arctan2, "rsqrt": lambda x: 1 / np.sqrt(x),
    "lt": np.less, "le": np.less_equal, "gt": np.greater, "ge": np.greater_equal, "eq": np.equal,
    "ne": np.not_equal, "and": np.bitwise_and, "or": np.bitwise_or, "xor": np.bitwise_xor, "not": np.invert,
    "is_finite": np.isfinite, "expm1": np.expm1, "log1p": np.log1p, "exp": np.exp, "log": np.log,
    "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "sin": np.sin, "cos": np.cos, "tan": np.tan,
    "tanh": np.tanh, "sinh": np.sinh, "cosh": np.cosh, "exp2": np.exp2, "stop_gradient": lambda x: x,
    "rounded": lambda x: x, "copy": lambda x: x, "optimization_barrier": lambda x: x,
    "clamp": lambda low, x, high: np.minimum(np.maximum(low, x), high),
}  # fmt: skip
_REDUCTIONS: dict[str, Rule] = {
    "max": np.maximum,
    "min": np.minimum,
    "or": np.bitwise_or,
    "and": np.bitwise_and,
    "prod": np.multiply,
}
_RULES: dict[str, Rule] = {
    **{name: _ignoring_parameters(function) for name, function in _ELEMENTWISE.items()},
    **{f"reduce_{name}": _along(function) for name, function in _REDUCTIONS.items()},
    "reduce_sum": _sum,
    "broadcast_in_dim": _broadcast,
    "slice": _slice,
    "dynamic_slice": _slice_at,
    "select_n": _select,
    "convert_element_type": _converted,
    "round": _rounded,
    "integer_pow": _power,
    "div": _quotient,
    "pad": _padded,
    "iota": _iota,
    "reshape": lambda p, x: x.reshape(p["new_sizes"]),
    "squeeze": lambda p, x: np.squeeze(x, tuple(p["dimensions"])),
    "transpose": lambda p, x: x.transpose(p["permutation"]),
    "concatenate": lambda p, *parts: np.concatenate(parts, p["dimension"]),
    "stack": lambda p, *parts: np.stack(parts, p["axis"]),
    "bitcast_convert_type": lambda p, x: np.ascontiguousarray(x).view(p["new_dtype"]).reshape(x.shape),
    "empty2": lambda p: np.zeros((), p["dtype"]),
    "shift_left": _shifted(np.left_shift),
    "shift_right_logical": _shifted(np.right_shift),
    "shift_right_arithmetic": lambda p, a, b: np.right_shift(a, np.minimum(b, a.dtype.type(8 * a.dtype.itemsize - 1))),
}
