"""Small programs that tests evaluate by NumPy: which they are, and that XLA computes the same to the bit."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests import one_by_one

from qrsim.engine.settings import quick_to_compile

X, Y = np.random.default_rng(3).normal(size=(2, 3, 4)).astype(np.float32)
SMALL: dict[str, Callable[..., Any]] = {
    "sum": lambda x, y: x + y,
    "quotient": lambda x, y: x / y,
    "root of a square": lambda x, y: jnp.sqrt(jnp.abs(x)),
    "square": lambda x, y: x**2,
    "row": lambda x, y: x[1],
    "last row": lambda x, y: jax.lax.dynamic_slice(x, (jnp.int32(7), jnp.int32(-1)), (1, 3)),
    "choice": lambda x, y: jnp.where(x > y, x, 0.0),
    "limits": lambda x, y: jnp.clip(x, -0.5, y),
    "stack": lambda x, y: jnp.stack([x, y], axis=1),
    "integers": lambda x, y: (3.0 * x).astype(jnp.int32),
    "largest": lambda x, y: jnp.max(x, axis=0),
}
LEFT_TO_XLA: dict[str, Callable[..., Any]] = {
    "two that round": lambda x, y: x * y + x,
    "order of a sum": lambda x, y: jnp.sum(x),
    "elementary": lambda x, y: jnp.sin(x),
}


@pytest.fixture
def compiled(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Any]]:
    """Return the programs that are left to XLA meanwhile."""
    found: list[Any] = []
    by_xla = one_by_one.by_xla

    def counted(*arguments: Any, jaxpr: Any, **options: Any) -> Any:
        found.append(jaxpr)
        return by_xla(*arguments, jaxpr=jaxpr, **options)

    monkeypatch.setattr(one_by_one, "by_xla", counted)
    # Asks XLA, by a program, for the options that it knows.
    quick_to_compile()
    before = jax.config.values["jax_disable_most_optimizations"]
    jax.config.update("jax_disable_most_optimizations", True)
    yield found
    jax.config.update("jax_disable_most_optimizations", before)


@pytest.mark.parametrize("name", SMALL)
def test_it_is_what_xla_computes(compiled: list[Any], name: str) -> None:
    mine = jax.jit(lambda x, y: SMALL[name](x, y))(X, Y)
    assert not compiled
    jax.config.update("jax_disable_most_optimizations", False)
    expected = jax.jit(lambda x, y: SMALL[name](x, y))(X, Y)
    assert len(compiled) == 1
    assert isinstance(mine, jax.Array)
    assert (mine.dtype, mine.shape, mine.weak_type) == (expected.dtype, expected.shape, expected.weak_type)
    np.testing.assert_array_equal(mine, expected)


@pytest.mark.parametrize("name", LEFT_TO_XLA)
def test_others_are_compiled(compiled: list[Any], name: str) -> None:
    jax.jit(LEFT_TO_XLA[name])(X, Y)
    assert len(compiled) == 1


def test_a_weak_type_stays_weak(compiled: list[Any]) -> None:
    found = jnp.add(1.0, 2.0)
    assert not compiled
    assert found.weak_type
    assert (found * jnp.ones(2, jnp.float16)).dtype == jnp.float16


def test_a_program_that_is_called_often_and_an_array_of_a_chosen_device_are_compiled(compiled: list[Any]) -> None:
    function = jax.jit(lambda x: x - 1.0)
    for _ in range(60):
        function(X)
    assert not compiled
    # From then on JAX calls the compiled program by itself.
    for _ in range(10):
        function(X)
    assert len(compiled) == 1
    jax.jit(lambda x: x - 2.0)(jax.device_put(X, jax.devices()[0]))
    assert len(compiled) == 2
