"""Which of JAX's primitives the code generator takes, and which of their parameters it understands.

A primitive is known by itself and not by its name, which anybody may give to another. What is not in this table, or has
a parameter that is not, is XLA's to compile.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import jax
import jax.extend.core.primitives as jex
from jax import lax
from jax.extend.core import Primitive

from qrsim.core import noise as _noise  # noqa: F401  its kernels are in the table
from qrsim.core.fastmath import rounded_p
from qrsim.core.nearest import nearest_squared_p
from qrsim.core.primitives import KERNELS
from qrsim.core.symmetric import lowered_p, times_p, transformed_p
from qrsim.engine.llvm.refusal import UnsupportedError


class Rule(NamedTuple):
    """How a primitive becomes nodes.

    Attributes:
        method: of the Tracer.
        op: the operation of the graph, or what else the method has to know.
        parameters: those that are understood. Any other may be None or (), which asks for nothing.
    """

    method: str
    op: str
    parameters: Collection[str] = frozenset()


_UNARY = (
    "neg", "sign", "abs", "not", "sqrt", "rsqrt", "floor", "ceil", "is_finite", "square", "exp", "exp2", "expm1", "log",
    "log1p", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh",
)  # fmt: skip
_OTHERS = (
    "add", "sub", "mul", "div", "rem", "max", "min", "and", "or", "xor", "eq", "ne", "lt", "le", "gt", "ge", "select_n",
    "shift_left", "shift_right_logical", "shift_right_arithmetic", "clamp", "atan2", "pow",
)  # fmt: skip
_REDUCTIONS = {
    "reduce_sum": "add",
    "reduce_prod": "mul",
    "reduce_min": "min",
    "reduce_max": "max",
    "reduce_and": "and",
    "reduce_or": "or",
}
_RUNNING = {"cumsum": "add", "cumprod": "mul", "cummax": "max", "cummin": "min"}
_SCATTERS = {"scatter": "set", "scatter_add": "add", "scatter_mul": "mul", "scatter_min": "min", "scatter_max": "max"}
_INDEXED = {"dimension_numbers", "unique_indices", "indices_are_sorted", "mode"}
_STAGED = {
    "jaxpr", "call_jaxpr", "in_shardings", "out_shardings", "in_layouts", "out_layouts", "donated_invars",
    "ctx_mesh", "name", "keep_unused", "inline", "compiler_options_kvs", "prevent_cse", "differentiated", "policy",
    "num_consts", "jvp_jaxpr_fun", "jvp_jaxpr_thunk", "symbolic_zeros", "fwd_jaxpr_thunk", "bwd", "out_trees",
}  # fmt: skip


def _rows() -> dict[str, Rule]:
    """Return the translation rule of each JAX primitive, by the primitive's name."""
    rows = {name: Rule("elementwise", name) for name in _UNARY}
    rows |= {name: Rule("elementwise", name) for name in _OTHERS}
    rows["add_jaxvals"] = Rule("elementwise", "add")
    rows["round"] = Rule("elementwise", "round", {"rounding_method"})
    rows["integer_pow"] = Rule("elementwise", "integer_pow", {"y"})
    rows["convert_element_type"] = Rule("elementwise", "convert_element_type", {"new_dtype", "weak_type"})
    rows["bitcast_convert_type"] = Rule("elementwise", "bitcast_convert_type", {"new_dtype"})
    rows |= {name: Rule("reduction", op, {"axes"}) for name, op in _REDUCTIONS.items()}
    rows |= {name: Rule("running", op, {"axis", "reverse"}) for name, op in _RUNNING.items()}
    rows |= {name: Rule("scatter", op, {*_INDEXED, "update_jaxpr", "update_consts"}) for name, op in _SCATTERS.items()}
    rows["gather"] = Rule("gather", "", {*_INDEXED, "slice_sizes", "fill_value"})
    rows["dynamic_slice"] = Rule("dynamic_slice", "", {"slice_sizes"})
    rows["dynamic_update_slice"] = Rule("dynamic_update_slice", "")
    rows["argmin"] = Rule("place_of", "min", {"axes", "index_dtype"})
    rows["argmax"] = Rule("place_of", "max", {"axes", "index_dtype"})
    rows["broadcast_in_dim"] = Rule("broadcast_in_dim", "", {"shape", "broadcast_dimensions"})
    rows["reshape"] = Rule("reshape", "", {"new_sizes"})
    rows["squeeze"] = Rule("squeeze", "", {"dimensions"})
    rows["transpose"] = Rule("transpose", "", {"permutation"})
    rows["slice"] = Rule("slice", "", {"start_indices", "limit_indices", "strides"})
    rows["split"] = Rule("split", "", {"sizes", "axis"})
    rows["iota"] = Rule("iota", "", {"dtype", "shape", "dimension"})
    rows["unstack"] = Rule("unstack", "", {"axis"})
    rows["tile"] = Rule("tile", "", {"reps"})
    rows["stack"] = Rule("stack", "", {"axis"})
    rows["concatenate"] = Rule("concatenate", "", {"dimension"})
    rows["cond"] = Rule("cond", "", {"branches"})
    rows["while"] = Rule("while_", "", {"cond_nconsts", "cond_jaxpr", "body_nconsts", "body_jaxpr"})
    rows["scan"] = Rule(
        "scan", "", {"jaxpr", "length", "reverse", "num_consts", "num_carry", "linear", "unroll", "_split_transpose"}
    )
    # What is only there for differentiation, staging or for other compilers.
    rows |= {name: Rule("transparent", "") for name in ("copy", "stop_gradient", "optimization_barrier")}
    rows |= {name: Rule("call", "jaxpr", _STAGED) for name in ("jit", "remat")}
    rows |= {name: Rule("call", "call_jaxpr", _STAGED) for name in ("custom_jvp_call", "custom_vjp_call")}
    return rows


def _known() -> dict[Primitive, Rule]:
    """Return primitive -> translation rule, for each JAX primitive that can be compiled."""
    found: dict[Primitive, Rule] = {}
    for name, rule in _rows().items():
        # One that this version of JAX does not have occurs in no program.
        for place in (lax, jex):
            primitive = getattr(place, f"{name}_p", None)
            if primitive is not None:
                found[primitive] = rule
    found[rounded_p] = Rule("transparent", "")
    found[nearest_squared_p] = Rule("nearest", "")
    found[times_p] = Rule("half", "half_times", {"rows"})
    found[lowered_p] = Rule("half", "half_lowered")
    found[transformed_p] = Rule("half", "half_transformed", {"terms", "rows"})
    found |= {kernel.primitive: Rule("kernel", name) for name, kernel in KERNELS.items()}
    return found


RULES: Mapping[Primitive, Rule] = _known()


def rule_of(equation: Any) -> Rule:
    """Return the rule that translates an equation of a jaxpr; raise UnsupportedError if there is none.

    Raises:
        UnsupportedError: there is none, or not for these parameters.
    """
    primitive = equation.primitive
    rule = RULES.get(primitive)
    if rule is None:
        raise UnsupportedError(f"'{primitive.name}'")
    for name, value in equation.params.items():
        asks = value is not None and not (isinstance(value, tuple) and not value)
        if asks and name not in rule.parameters:
            raise UnsupportedError(f"'{primitive.name}' with {name} = {value}")
    if equation.effects and rule.method not in ("call", "cond", "while_"):
        raise UnsupportedError(f"'{primitive.name}' with effects")
    for variable in equation.outvars:
        if variable.aval.dtype == jax.dtypes.float0:
            raise UnsupportedError("float0")
    return rule
