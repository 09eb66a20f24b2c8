"""Random programs over every primitive that the code generator takes, held against a reference with bounds."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from evidence import compiler
from hypothesis import HealthCheck, settings
from hypothesis import given as drawn
from hypothesis import strategies as st
from jax import lax
from jax.extend.core import jaxprs_in_params
from tests.engine.reference import trying
from tests.engine.reference.bounds import given
from tests.engine.reference.evaluation import evaluate
from tests.engine.reference.programs import FEATURED, HALVES

from qrsim.engine.llvm.rules import RULES


def primitives(jaxpr: Any) -> set[Any]:
    """Return the primitives of a program, those of inner ones included."""
    found = set()
    for equation in jaxpr.eqns:
        found.add(equation.primitive)
        for inner in jaxprs_in_params(equation.params):
            found |= primitives(inner)
    return found


@pytest.mark.long
@pytest.mark.parametrize("number", [2699, 10315, 15936, 16300, 18639])
def test_programs_that_found_a_fault_once(number: int) -> None:
    """Numbers below the normal ones, kept by a loop, a tick or a constant, and the sign of zero."""
    assert trying.tried(number)[0] in ("equal", "within")


@pytest.mark.parametrize("programs", [1, pytest.param(15, marks=pytest.mark.long)])
def test_programs_on_halves_of_symmetric_matrices(programs: int) -> None:
    """Their products, changes and transformations, one after the other, in each way of using vectors."""
    found = [trying.tried(3 * 10**9 + number, HALVES, longest=2) for number in range(programs)]
    assert {what for what, _ in found} <= {"equal", "within", "ambiguous"}
    seen = set[Any]().union(*(primitives(program.closed.jaxpr) for _, program in found))
    assert {primitive.name for primitive in seen} >= {"half_times"}


@pytest.mark.parametrize("programs", [20, pytest.param(300, marks=pytest.mark.nightly)])
def test_random_programs_and_every_primitive(programs):
    """Equal to the bit or within the roundings of their operations; none crashes; of many, no rule is left out."""
    seen: set[Any] = set()

    def check(number: int, featured: Any = None) -> None:
        what, program = trying.tried(number, featured, longest=3)
        assert what in trying.OUTCOMES, f"program {number}: {what}"
        if what in ("equal", "within"):
            seen.update(primitives(program.closed.jaxpr))

    @settings(
        max_examples=programs, derandomize=True, deadline=None, database=None, suppress_health_check=list(HealthCheck)
    )
    @drawn(st.integers(0, 10**9))
    def try_it(number: int) -> None:
        check(number)

    try_it()
    if programs < 150:
        assert len(seen) > len(RULES) / 2
        return
    # What chance left out so far.
    for number in range(60):
        if set(RULES) <= seen:
            break
        for i, maker in enumerate((*FEATURED, HALVES)):
            check(2 * 10**9 + 1000 * number + i, maker)
    assert not {primitive.name for primitive in set(RULES) - seen}


SPECIAL = np.array(
    [0.0, -0.0, 1.0, -1.0, 0.5, 2.5, -2.5, 3e9, -3e9, 1e38, -1e38, 1e-37, np.inf, -np.inf, np.nan, 0.49999997],
    np.float32,
)
WHOLE = np.array([0, 1, -1, 2, -7, 31, 32, 33, 100, -(2**31), 2**31 - 1], np.int32)
FLOATS: dict[str, Any] = {
    "add": lax.add, "mul": lax.mul, "div": lax.div, "rem": lax.rem, "max": lax.max, "min": lax.min, "atan2": lax.atan2,
    "lt": lax.lt, "ge": lax.ge, "eq": lax.eq, "ne": lax.ne, "clamp": lambda a, b: lax.clamp(a, b, lax.max(a, b)),
    "sign": lambda a, b: lax.sign(a), "floor": lambda a, b: lax.floor(a), "even": lambda a, b: jnp.round(a),
    "away": lambda a, b: lax.round(a), "int32": lambda a, b: a.astype(jnp.int32),
    "uint32": lambda a, b: a.astype(jnp.uint32),
    "bool": lambda a, b: a.astype(bool), "finite": lambda a, b: lax.is_finite(a),
    "cube": lambda a, b: lax.integer_pow(a, 3),
    "over": lambda a, b: lax.integer_pow(a, -2), "max of all": lambda a, b: jnp.max(jnp.stack([a, b]), 0),
    "place": lambda a, b: jnp.argmax(jnp.stack([a, b]), 0),
    "least place": lambda a, b: jnp.argmin(jnp.stack([a, b]), 0),
    "running": lambda a, b: lax.cummax(jnp.stack([a, b])), "sum": lambda a, b: jnp.sum(jnp.stack([a, b]), 0),
}  # fmt: skip
INTEGERS: dict[str, Any] = {
    "add": lax.add, "mul": lax.mul, "div": lax.div, "rem": lax.rem, "left": lax.shift_left, "max": lax.max,
    "right": lax.shift_right_arithmetic, "logical": lax.shift_right_logical, "abs": lambda a, b: lax.abs(a),
    "sign": lambda a, b: lax.sign(a), "float": lambda a, b: a.astype(jnp.float32), "less": lax.lt,
    "power": lambda a, b: lax.integer_pow(a, 3), "place": lambda a, b: jnp.argmin(jnp.stack([a, b]), 0),
}  # fmt: skip


def _pairs(numbers: Any) -> tuple[Any, Any]:
    first, second = np.meshgrid(numbers, numbers)
    return first.ravel(), second.ravel()


def _compare_all(rules: dict[str, Any], a: Any, b: Any) -> None:
    """Compare machine code with JAX, to the bit, and the reference with both."""
    from tests.engine.llvm.test_operations import run

    def every(one: Any, two: Any) -> dict[str, Any]:
        return {name: rule(one, two) for name, rule in rules.items()}

    theirs = jax.tree.map(np.asarray, jax.jit(every)(a, b))
    reference = evaluate(jax.make_jaxpr(every)(a, b), [given(a), given(b)])
    empty = jax.tree.map(np.zeros_like, theirs)
    state = jax.tree.map(lambda leaf: leaf[None], {"a": a, "b": b, "found": empty})

    def function(_: Any, now: Any, tick: Any) -> Any:
        return dict(now, found=every(now["a"], now["b"]))

    for mode in trying.MODES[1:]:
        (mine,) = run(function, state, mode)
        for (name, wanted), value in zip(theirs.items(), reference, strict=True):
            np.testing.assert_array_equal(mine["found"][name], wanted, err_msg=f"{name} {mode}")
            np.testing.assert_array_equal(value.rounded, wanted, err_msg=f"{name}, the reference")
            if wanted.dtype.kind == "f" and name in ("max", "min"):
                zero = wanted == 0.0
                np.testing.assert_array_equal(np.signbit(mine["found"][name])[zero], np.signbit(wanted)[zero])


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
def test_special_numbers_go_the_way_they_go_in_jax():
    """Zeros, NaN, infinity, what does not fit, division by zero, shifts by more than there are bits."""
    with np.errstate(all="ignore"):
        _compare_all({k: v for k, v in FLOATS.items() if k != "atan2"}, *_pairs(SPECIAL))
        _compare_all(INTEGERS, *_pairs(WHOLE))
        _compare_all(
            {k: v for k, v in INTEGERS.items() if k not in ("abs", "sign")},
            *(part.view(np.uint32) for part in _pairs(WHOLE)),
        )


def test_a_value_that_is_too_far_off_is_found():
    """The reference's bounds are narrow: a sum of products with a wrong sign or 1e-5 beside it fails."""
    program = trying.tried(3, FEATURED[1], longest=2)[1]
    with np.errstate(all="ignore"):
        reference = trying.expected(program, 1)
    mine = [
        jax.tree.unflatten(jax.tree.structure(program.worlds[0]), [value.rounded for value in leaves])
        for leaves in reference
    ]
    assert trying.judged(mine, reference) == "equal"
    for name in ("i", "k", "u"):
        wrong = [dict(world) for world in mine]
        wrong[1][name] = wrong[1][name] + 1
        assert name in trying.judged(wrong, reference)
    wrong = [dict(world) for world in mine]
    wrong[0]["x"] = np.where(np.isfinite(wrong[0]["x"]), wrong[0]["x"] * 1.001 + 0.001, 1.0)
    assert "'x'" in trying.judged(wrong, reference)


@pytest.mark.long
def test_the_study_counts_what_became_of_programs():
    found = compiler.run(full=False)
    assert found["different"] == 0
    assert found["compiled"] + found["handed_over"] == found["programs"]
    assert found["equal_to_the_bit"] > found["within"] > 0


@pytest.mark.parametrize("values", [(-0.0, 0.0), (0.0, -0.0), (-0.0, -0.0), (0.0, -3.0, -0.0), (-0.0, 3.0, 0.0)])
@pytest.mark.parametrize(("name", "function"), [("reduce_max", jnp.max), ("reduce_min", jnp.min)])
def test_the_reference_takes_the_zero_that_jax_takes(name, function, values):
    closed = jax.make_jaxpr(function)(np.float32(values))
    (found,) = evaluate(closed, [given(np.float32(values))])
    own = np.asarray(jax.jit(function)(np.float32(values)))
    assert str(closed.jaxpr.eqns[0].primitive) == name
    assert float(found.rounded) == float(own)
    assert np.signbit(found.rounded) == np.signbit(own)


@pytest.mark.parametrize(("name", "function"), [("max", jnp.maximum), ("min", jnp.minimum)])
def test_the_reference_takes_the_zero_that_jax_takes_of_two(name, function):
    a, b = np.float32([0.0, -0.0, -0.0, 0.0, 1.0, np.nan]), np.float32([-0.0, 0.0, -0.0, 0.0, -0.0, 0.0])
    closed = jax.make_jaxpr(function)(a, b)
    (found,) = evaluate(closed, [given(a), given(b)])
    own = np.asarray(jax.jit(function)(a, b))
    assert str(closed.jaxpr.eqns[0].primitive) == name
    np.testing.assert_array_equal(found.rounded, own)
    np.testing.assert_array_equal(np.signbit(found.rounded)[:5], np.signbit(own)[:5])


def test_a_program_whose_zeros_have_both_signs():
    assert trying.tried(16612)[0] == "equal"
