"""Digests of traced programs: equal for equal programs in any process, and for no others."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from qrsim.engine.llvm import digest

VECTOR = np.zeros(4, np.float32)


def of(function: Callable[..., Any], *arguments: Any) -> str | None:
    return digest(jax.make_jaxpr(function)(*(arguments or (VECTOR, VECTOR))))


def looped(turns: int) -> Callable[..., Any]:
    return lambda a, b: lax.fori_loop(0, turns, lambda _, x: x * b, a)


# Each differs in one respect from the first of its row, or from the others in it.
DIFFERENT: list[list[Callable[..., Any]]] = [
    [lambda a, b: a + b, lambda a, b: a - b, lambda a, b: b + a, lambda a, b: (a + b) + b],
    [lambda a, b: a * 2.0, lambda a, b: a * 2.5, lambda a, b: a * np.float32(2.0) + 0.0],
    [lambda a, b: a * np.arange(4, dtype=np.float32), lambda a, b: a * np.arange(1, 5, dtype=np.float32)],
    [lambda a, b: (a, b), lambda a, b: (b, a), lambda a, b: (a, a)],
    [lambda a, b: a[:2], lambda a, b: a[1:3], lambda a, b: a[:3]],
    [lambda a, b: lax.integer_pow(a, 2), lambda a, b: lax.integer_pow(a, 3)],
    [lambda a, b: a.astype(jnp.int32), lambda a, b: a.astype(jnp.uint32)],
    [lambda a, b: jnp.round(a), lambda a, b: lax.round(a)],
    [looped(5), looped(6)],
    [lambda a, b: jnp.where(a > b, a, b), lambda a, b: jnp.where(a >= b, a, b)],
    [lambda a, b: lax.cond(a[0] > 0, lambda: a, lambda: b), lambda a, b: lax.cond(a[0] > 0, lambda: b, lambda: a)],
    [lambda a, b: jax.jit(lambda x: x + 1.0)(a), lambda a, b: jax.jit(lambda x: x + 2.0)(a)],
    [lambda a, b: a.at[1].set(2.0), lambda a, b: a.at[2].set(2.0), lambda a, b: a.at[1].add(2.0)],
]


@pytest.mark.parametrize("row", DIFFERENT, ids=range(len(DIFFERENT)))
def test_whatever_changes_a_program_changes_its_digest(row):
    found = [of(function) for function in row]
    assert None not in found
    assert len(set(found)) == len(row)
    assert [of(function) for function in row] == found


def test_shapes_and_types_of_arguments_count():
    arguments = [VECTOR, np.zeros(5, np.float32), np.zeros((2, 2), np.float32), np.zeros(4, np.int32)]
    assert len({of(lambda a: a * a, argument) for argument in arguments}) == 4


def test_names_do_not_count():
    def first(speed: Any, time: Any) -> Any:
        return jax.jit(lambda speed: speed * 2.0)(speed) + time

    def second(a: Any, b: Any) -> Any:
        double = jax.jit(lambda x: x * 2.0)
        return double(a) + b

    assert of(first) == of(second) is not None


def test_an_operation_of_somebody_else_has_no_digest():
    """Whatever its name is: its code may be anything."""
    from jax.extend.core import Primitive

    other: Any = Primitive("add")
    other.def_abstract_eval(lambda a, b: a)
    assert of(other.bind) is None
    assert of(lambda a, b: jax.jit(other.bind)(a, b)) is None


@pytest.mark.long
def test_it_is_the_same_in_every_process():
    program = (
        "import jax, jax.numpy as jnp, numpy as np\n"
        "from qrsim.core.noise import Key\n"
        "from qrsim.engine.llvm import digest\n"
        "from qrsim.scenarios.scenario import load_scenario\n"
        "from qrsim.world import tick\n"
        "from qrsim.world.draws import keys_of\n"
        "world = load_scenario('mixed_team').world()\n"
        "print(digest(jax.make_jaxpr(tick.reset)(world, keys_of(world, Key.root(0, 0)))))"
    )
    found = [
        subprocess.run(
            [sys.executable, "-c", program], env=os.environ | {"PYTHONHASHSEED": seed}, stdout=-1, text=True, check=True
        ).stdout
        for seed in ("1", "2")
    ]
    assert found[0] == found[1]
    assert len(found[0].strip()) == 64
