"""Traced operators are those of JAX, operation for operation."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend import source_info_util

from qrsim.core.operators import make_jaxpr

BOTH: list[Callable[..., Any]] = [
    operator.add, operator.sub, operator.mul, operator.truediv, operator.lt, operator.le, operator.gt, operator.ge,
    operator.eq, operator.ne, jnp.maximum, jnp.minimum,
]  # fmt: skip
BITS: list[Callable[..., Any]] = [operator.and_, operator.or_, operator.xor]
F32, F64, I32, U32 = np.float32, np.float64, np.int32, np.uint32
KINDS = [(F32, F32), (I32, I32), (U32, U32), (np.bool_, np.bool_)]
NUMBERS = [2.0, 3, 0.1, -0.0, float("nan"), float("inf")]


def same(function: Callable[..., Any], *templates: Any) -> None:
    """Trace a function by JAX and by this package, and compare the programs as text and their constants."""
    # A function of its own each, as JAX keeps the program of a function.
    expected = jax.make_jaxpr(lambda *given: function(*given))(*templates)
    found = make_jaxpr(lambda *given: function(*given))(*templates)
    assert str(found) == str(expected)
    literals = [
        [np.asarray(atom.val).tobytes() for each in closed.jaxpr.eqns for atom in each.invars if hasattr(atom, "val")]
        for closed in (found, expected)
    ]
    assert literals[0] == literals[1]


def array(dtype: Any, *shape: int) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(shape, dtype)


@pytest.mark.parametrize("x64", [False, True])
def test_arrays_of_one_shape_and_type(x64: bool) -> None:
    def all_of(a: Any, b: Any) -> list[Any]:
        bits = [] if a.dtype.kind == "f" else BITS
        return [each(a, b) for each in [*BOTH, *bits] if a.dtype != bool or each is not operator.sub]

    with jax.enable_x64(x64):
        for left, right in [*KINDS, *([(F64, F64)] if x64 else [])]:
            same(all_of, array(left, 5), array(right, 5))
            same(all_of, array(left), array(right))
            same(all_of, array(left, 5), array(right))
            same(all_of, array(left), array(right, 5))
            # Axes that are repeated are left to JAX.
            same(all_of, array(left, 1), array(right, 5))


@pytest.mark.parametrize(("dtype", "x64"), [(F32, False), (F32, True), (F64, True), (I32, False), (U32, False)])
def test_arrays_and_numbers(dtype: Any, x64: bool) -> None:
    whole = dtype in (I32, U32)
    numbers = [0, 2, 2**31 - 1] if whole else [*NUMBERS, dtype(2.0)]

    def all_of(a: Any) -> list[Any]:
        return [pair for each in [*BOTH, *BITS * whole] for x in numbers for pair in (each(a, x), each(x, a))]

    with jax.enable_x64(x64):
        same(all_of, array(dtype))
        same(all_of, array(dtype, 5))


@pytest.mark.parametrize(("dtype", "x64"), [(F32, False), (F64, True), (I32, False), (U32, False), (np.bool_, False)])
def test_functions_of_one_array(dtype: Any, x64: bool) -> None:
    def all_of(a: Any) -> list[Any]:
        return [jnp.sqrt(a), jnp.isfinite(a), *([] if dtype == np.bool_ else [-a])]

    with jax.enable_x64(x64):
        same(all_of, array(dtype))
        same(all_of, array(dtype, 5))
    same(lambda a: [-jax.lax.full_like(2.0, a), jnp.sqrt(3.0), jnp.isfinite(2)], array(F32))


# Of a selection: the types and shapes of its cases beside a condition (5,), numbers being their own.
CASES = [
    ((F32, 5), (F32, 5)), ((F32, 5), 2.0), (0, (F32, 5)), ((F32,), (F32, 5)), ((F32,), 1.5), ((I32, 5), 7),
    ((np.bool_, 5), (np.bool_, 5)),
]  # fmt: skip


@pytest.mark.parametrize("cases", CASES)
@pytest.mark.parametrize("shape", [(5,), ()])
def test_a_selection_is_that_of_jax_without_a_program_of_its_own(cases: Any, shape: tuple[int, ...]) -> None:
    templates = [array(*case) for case in cases if isinstance(case, tuple)]

    def select(condition: Any, *arrays: Any) -> Any:
        left = iter(arrays)
        return jnp.where(condition, *(next(left) if isinstance(case, tuple) else case for case in cases))

    (called,) = jax.make_jaxpr(lambda *given: select(*given))(array(np.bool_, *shape), *templates).jaxpr.eqns
    found = make_jaxpr(select)(array(np.bool_, *shape), *templates)
    assert called.params["name"] == "_where"
    assert found.out_avals == [each.aval for each in called.outvars]
    names = [each.primitive.name for each in found.jaxpr.eqns]
    assert names[-1] == "select_n"
    assert set(names[:-1]) <= {"broadcast_in_dim"}
    for condition in (np.arange(5) % 2 == 0, np.arange(5) % 2 == 1) if shape else (np.True_, np.False_):
        given = [np.full(each.shape, 3 + i, each.dtype) for i, each in enumerate(templates)]
        expected = np.asarray(select(condition, *map(jnp.asarray, given)))
        np.testing.assert_array_equal(jax.core.eval_jaxpr(found.jaxpr, found.consts, condition, *given)[0], expected)


@pytest.mark.parametrize(
    ("condition", "left", "right"),
    [
        (array(np.bool_, 4, 5), array(F32, 5), array(F32, 5)),
        (array(np.bool_, 5), array(F32, 1), array(F32, 5)),
        (array(np.bool_, 5), array(F32, 5), float("nan")),
        (array(np.bool_, 5), array(I32, 5), 2.5),
        (array(np.bool_, 5), 1.0, 2.0),
        (array(I32, 5), array(F32, 5), array(F32, 5)),
        (array(np.bool_, 5), array(F32, 5), array(I32, 5)),
    ],
)
def test_selections_that_convert_something_are_left_to_jax(condition: Any, left: Any, right: Any) -> None:
    templates = [each for each in (condition, left, right) if isinstance(each, jax.ShapeDtypeStruct)]

    def select(*arrays: Any) -> Any:
        given = iter(arrays)
        cases = [next(given) if isinstance(each, jax.ShapeDtypeStruct) else each for each in (condition, left, right)]
        return jnp.where(*cases)

    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        same(select, *templates)


def test_slopes_and_batches_and_weak_types() -> None:
    def curve(a: Any, b: Any) -> Any:
        return jnp.sum(jnp.maximum(a * b - 2.0 / a, 0.5 * b) + a)

    same(lambda a, b: jax.jvp(curve, (a, b), (b, a)), array(F32, 5), array(F32, 5))
    same(jax.vmap(curve), array(F32, 3, 5), array(F32, 3, 5))
    same(lambda a: (a * jnp.asarray(2.0) + a) * jax.lax.full_like(2.0, 3.0), array(F32, 5))


def test_errors_are_those_of_jax_and_the_method_is_put_back() -> None:
    tracer: Any = jax.core.Tracer
    before, others = jnp.ufunc.__call__, [jnp.where, jnp.sqrt, tracer.__mul__, tracer.__neg__]
    for traced in (jax.make_jaxpr, make_jaxpr):
        with pytest.raises(TypeError, match="incompatible shapes for broadcasting"):
            traced(lambda a, b: a + b)(array(F32, 5), array(F32, 4))
    assert jnp.ufunc.__call__ is before

    def nested(a: Any) -> Any:
        make_jaxpr(lambda b: b + b)(array(F32, 2))
        seen.append(jnp.ufunc.__call__ is before)
        return a + a

    seen: list[bool] = []
    make_jaxpr(nested)(array(F32, 5))
    assert seen == [False]
    assert jnp.ufunc.__call__ is before
    assert [jnp.where, jnp.sqrt, tracer.__mul__, tracer.__neg__] == others


def test_messages_name_the_line_of_the_caller() -> None:
    (equation,) = make_jaxpr(lambda a: a * 2.0)(array(F32, 5)).jaxpr.eqns
    assert "test_operators.py" in source_info_util.summarize(equation.source_info)


def test_a_function_of_a_user_is_called() -> None:
    """Also where it has the name of one of JAX."""
    own: Any = jnp.frompyfunc(lambda x, y: x - y, 2, 1)
    own.__name__ = "add"
    same(lambda a, b: own(a, b), array(F32, 5), array(F32, 5))
