"""Which of JAX's primitives the code generator takes, and which of their parameters it understands.

A primitive is known by itself and not by its name, which anybody may give to another. What is not in this table, or has
a parameter that is not, is XLA's to compile.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.extend.core.primitives as jex
from jax import lax

from qrsim.core import noise as _noise  # noqa: F401  its kernels are in the table
from qrsim.core.fastmath import rounded_p
from qrsim.core.nearest import nearest_squared_p
from qrsim.core.primitives import KERNELS
from qrsim.engine.llvm.refusal import UnsupportedError

Understood = Callable[[Any], bool]


class Rule(NamedTuple):
    """How a primitive becomes nodes.

    Attributes:
        method: of the Tracer.
        op: the operation of the graph, or what else the method has to know.
        parameters: those it may have, and whether a value is understood. Any may be None or (), which asks for nothing.
    """

    method: str
    op: str
    parameters: Mapping[str, Understood]


def _any(value: Any) -> bool:
    return True


def _none(value: Any) -> bool:
    return value is None


_UNARY = (
    "neg", "sign", "abs", "not", "sqrt", "rsqrt", "floor", "ceil", "is_finite", "square", "exp", "exp2", "expm1", "log",
    "log1p", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh",
)  # fmt: skip
_OTHERS = (
    "add", "sub", "mul", "div", "rem", "max", "min", "and", "or", "xor", "eq", "ne", "lt", "le", "gt", "ge", "select_n",
    "shift_left", "shift_right_logical", "shift_right_arithmetic", "clamp", "atan2", "pow",
)  # fmt: skip
_REDUCTIONS = {
    "reduce_sum": "add", "reduce_prod": "mul", "reduce_min": "min", "reduce_max": "max", "reduce_and": "and",
    "reduce_or": "or",
}  # fmt: skip
_RUNNING = {"cumsum": "add", "cumprod": "mul", "cummax": "max", "cummin": "min"}
_SCATTERS = {
    "scatter": "set", "scatter_add": "add", "scatter_mul": "mul", "scatter_min": "min", "scatter_max": "max",
}  # fmt: skip
_INDEXED = dict.fromkeys(("dimension_numbers", "unique_indices", "indices_are_sorted", "mode"), _any)
_STAGED = dict.fromkeys(
    (
        "jaxpr", "call_jaxpr", "in_shardings", "out_shardings", "in_layouts", "out_layouts", "donated_invars",
        "ctx_mesh", "name", "keep_unused", "inline", "compiler_options_kvs", "prevent_cse", "differentiated", "policy",
        "num_consts", "jvp_jaxpr_fun", "jvp_jaxpr_thunk", "symbolic_zeros", "fwd_jaxpr_thunk", "bwd", "out_trees",
    ),
    _any,
)  # fmt: skip


def _rows() -> dict[str, Rule]:
    """Return the table by names of primitives, which are looked up in JAX."""
    rows = {name: Rule("elementwise", name, {"accuracy": _none}) for name in _UNARY}
    rows |= {name: Rule("elementwise", name, {}) for name in _OTHERS}
    rows["add_jaxvals"] = Rule("elementwise", "add", {})
    rows["round"] = Rule("elementwise", "round", {"rounding_method": _any})
    rows["integer_pow"] = Rule("elementwise", "integer_pow", {"y": _any})
    rows["convert_element_type"] = Rule(
        "elementwise", "convert_element_type", {"new_dtype": _any, "weak_type": _any, "sharding": _none}
    )
    rows["bitcast_convert_type"] = Rule("elementwise", "bitcast_convert_type", {"new_dtype": _any})
    rows |= {name: Rule("reduction", op, {"axes": _any, "out_sharding": _none}) for name, op in _REDUCTIONS.items()}
    rows |= {name: Rule("running", op, {"axis": _any, "reverse": _any}) for name, op in _RUNNING.items()}
    rows |= {
        name: Rule("scatter", op, {**_INDEXED, "update_jaxpr": _any, "update_consts": _any})
        for name, op in _SCATTERS.items()
    }
    rows["gather"] = Rule("gather", "", {**_INDEXED, "slice_sizes": _any, "fill_value": _any})
    rows["dynamic_slice"] = Rule("dynamic_slice", "", {"slice_sizes": _any})
    rows["argmin"] = Rule("place_of", "min", {"axes": _any, "index_dtype": _any})
    rows["argmax"] = Rule("place_of", "max", {"axes": _any, "index_dtype": _any})
    rows["broadcast_in_dim"] = Rule(
        "broadcast_in_dim", "", {"shape": _any, "broadcast_dimensions": _any, "sharding": _none}
    )
    rows["reshape"] = Rule("reshape", "", {"new_sizes": _any, "dimensions": _none, "sharding": _none})
    rows["squeeze"] = Rule("squeeze", "", {"dimensions": _any})
    rows["transpose"] = Rule("transpose", "", {"permutation": _any})
    rows["slice"] = Rule("slice", "", {"start_indices": _any, "limit_indices": _any, "strides": _any})
    rows["split"] = Rule("split", "", {"sizes": _any, "axis": _any})
    rows["iota"] = Rule("iota", "", {"dtype": _any, "shape": _any, "dimension": _any, "sharding": _none})
    rows["unstack"] = Rule("unstack", "", {"axis": _any})
    rows["tile"] = Rule("tile", "", {"reps": _any})
    rows["stack"] = Rule("stack", "", {"axis": _any})
    rows["concatenate"] = Rule("concatenate", "", {"dimension": _any})
    rows["cond"] = Rule("cond", "", {"branches": _any})
    rows["while"] = Rule(
        "while_", "", dict.fromkeys(("cond_nconsts", "cond_jaxpr", "body_nconsts", "body_jaxpr"), _any)
    )
    rows["scan"] = Rule(
        "scan", "",
        dict.fromkeys(
            ("jaxpr", "length", "reverse", "num_consts", "num_carry", "linear", "unroll", "_split_transpose"), _any
        ),
    )  # fmt: skip
    # What is only there for differentiation, staging or for other compilers.
    rows |= {name: Rule("transparent", "", {}) for name in ("copy", "stop_gradient", "optimization_barrier")}
    rows |= {name: Rule("call", "jaxpr", _STAGED) for name in ("jit", "remat")}
    rows |= {name: Rule("call", "call_jaxpr", _STAGED) for name in ("custom_jvp_call", "custom_vjp_call")}
    return rows


def _known() -> dict[Any, Rule]:
    found: dict[Any, Rule] = {}
    for name, rule in _rows().items():
        # One that this version of JAX does not have occurs in no program.
        for place in (lax, jex):
            primitive = getattr(place, f"{name}_p", None)
            if primitive is not None:
                found[primitive] = rule
    found[rounded_p] = Rule("transparent", "", {})
    found[nearest_squared_p] = Rule("nearest", "", {})
    found |= {kernel.primitive: Rule("kernel", name, {}) for name, kernel in KERNELS.items()}
    return found


RULES: Mapping[Any, Rule] = _known()


def rule_of(equation: Any) -> Rule:
    """Return the rule for an equation of a jaxpr.

    Raises:
        UnsupportedError: there is none, or not for these parameters.
    """
    primitive = equation.primitive
    rule = RULES.get(primitive)
    if rule is None:
        raise UnsupportedError(f"'{primitive.name}'")
    for name, value in equation.params.items():
        if value is None or (isinstance(value, tuple) and not value):
            continue
        understood = rule.parameters.get(name)
        if understood is None or not understood(value):
            raise UnsupportedError(f"'{primitive.name}' with {name} = {value}")
    if equation.effects and rule.method not in ("call", "cond", "while_"):
        raise UnsupportedError(f"'{primitive.name}' with effects")
    for variable in equation.outvars:
        if variable.aval.dtype == jax.dtypes.float0:
            raise UnsupportedError("float0")
    return rule
