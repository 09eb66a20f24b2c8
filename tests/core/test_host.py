"""Functions of JAX computed with NumPy: equal to what JAX computes, one operation after the other."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from qrsim.core import fastmath
from qrsim.core.host import on_host
from qrsim.core.noise import Key
from qrsim.core.quaternions import Quaternion
from qrsim.core.vectors import Euler, Vec3

# By XLA: other tests of this folder compute single operations by what is tested here.
pytestmark = pytest.mark.usefixtures("optimised")
rng = np.random.default_rng(5)
X, Y = rng.normal(size=(2, 3, 40)).astype(np.float32)
WHOLE = rng.integers(-50, 50, 40).astype(np.int32)

FUNCTIONS: dict[str, Callable[..., Any]] = {
    "arithmetic": lambda x, y, i: (x * y - x / y, -x, abs(y), i + 2, i * i, x**2, y**-3, lax.sqrt(abs(x))),
    "choices": lambda x, y, i: (jnp.where(x > y, x, 0.0), jnp.clip(x, -0.5, 0.25), jnp.minimum(x, y), jnp.sign(i)),
    "steps": lambda x, y, i: (jnp.round(3.0 * x), jnp.floor(x), jnp.ceil(y), lax.round(2.0 * x), x.astype(int)),
    "shapes": lambda x, y, i: (x[1:, ::2], x.T, jnp.concatenate([x, y]), jnp.stack([i, i]), x[:, 3], x.reshape(4, 30)),
    "moved": lambda x, y, i: (x[i[0] // 50 + 1], lax.dynamic_slice(y, (i[1], i[2]), (2, 39))),
    "spread": lambda x, y, i: (jnp.broadcast_to(x[0], (5, 40)), jnp.zeros_like(x), jnp.full_like(y, 2.0)),
    "over": lambda x, y, i: (jnp.max(x, axis=0), jnp.min(y), jnp.any(x > 2.0), jnp.all(i > -60)),
    "bits": lambda x, y, i: (lax.bitcast_convert_type(x, jnp.int32) >> 3, i & 7, i | 1, i ^ 5, ~(x > 0.0)),
    # Left to JAX as a whole.
    "unknown": lambda x, y, i: (jnp.cumsum(x, axis=1), jnp.sort(y)),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_it_is_what_jax_computes(name: str) -> None:
    function = FUNCTIONS[name]
    for mine, expected in zip(on_host(function)(X, Y, WHOLE), function(*map(jnp.asarray, (X, Y, WHOLE))), strict=True):
        assert isinstance(mine, np.ndarray)
        assert (mine.dtype, mine.shape) == (expected.dtype, expected.shape)
        np.testing.assert_array_equal(mine, expected)


def test_kernels() -> None:
    """Of arrays in single precision, within what the compiler may round otherwise; normals to the bit."""

    def function(x: Any, y: Any) -> Any:
        positive = abs(x) + 0.1
        functions = fastmath.exp(x), fastmath.log(positive), fastmath.arctan2(y, x), fastmath.reciprocal_root(positive)
        normals = Key.root(7).stream("wind", jnp.arange(40, dtype=jnp.uint32)).normals(jnp.int32(9), 3, x.dtype)
        return (*functions, *fastmath.sincos(x), *fastmath.sincos_turns(y)), normals

    (found, normals), (expected, drawn) = on_host(function)(X, Y), jax.jit(function)(X, Y)
    for mine, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=3e-7, atol=3e-7)
    for mine, theirs in zip(normals, drawn, strict=True):
        np.testing.assert_array_equal(mine, theirs)


def test_records_are_traced_once_for_each_structure() -> None:
    traced = []

    def euler(attitude: Any) -> Any:
        traced.append(1)
        return attitude.euler() if isinstance(attitude, Quaternion) else Vec3(attitude.z, attitude.y, attitude.x)

    call = on_host(euler)
    angles = Euler(*(0.4 * X))
    found = [call(on_host(Quaternion.of)(angles)) for _ in range(3)][-1]
    assert isinstance(found, Euler)
    np.testing.assert_allclose(found.roll, angles.roll, atol=1e-6)
    assert len(traced) == 1
    call(Vec3(*X))
    call(Vec3(*X[:, :7]))
    assert len(traced) == 3


def test_a_result_of_nothing_and_of_what_was_given() -> None:
    assert on_host(lambda x: None)(X) is None
    same, two = on_host(lambda x: (x, 2.0))(X)
    np.testing.assert_array_equal(same, X)
    assert float(two) == 2.0
