"""Elementary functions against NumPy in float64, and their derivatives against closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core import fastmath

Array = np.ndarray[Any, Any]
EPS32 = 2.0**-24  # half a unit in the last place of 1

rng = np.random.default_rng(0)
# One length for all, so that operations compile once.
COUNT = 250_000


def sample(low: float, high: float, *chosen: Any, logarithmic: bool = False) -> Array:
    """Chosen points, and uniform ones up to COUNT."""
    points = np.concatenate([np.ravel(part) for part in chosen])
    missing = COUNT - points.size
    drawn = np.exp(rng.uniform(math.log(low), math.log(high), missing)) if logarithmic else None
    return np.concatenate([points, rng.uniform(low, high, missing) if drawn is None else drawn])


# Wide ranges, dense near the points where the reduction changes branch.
ANGLES = sample(
    -9999.0,
    9999.0,
    np.linspace(-10.0, 10.0, 20_001),
    np.arange(-6000, 6001)[:, None] * (math.pi / 4.0) + np.linspace(-1e-3, 1e-3, 5),
    [0.0, -0.0, 1e-30, -1e-30],
)
ANGLES32 = ANGLES.astype(np.float32)
POSITIVE32 = sample(
    1.2e-38, 3.4e38, np.linspace(0.5, 2.0, 50_001), 1.0 + np.linspace(-1e-3, 1e-3, 20_001), logarithmic=True
).astype(np.float32)
EXPONENTS32 = sample(-87.0, 88.0, np.linspace(-1.0, 1.0, 50_001), [-87.0, 88.0]).astype(np.float32)


def both_forms(function: Callable[..., Any], x: Array) -> list[Any]:
    """Results eager and jitted: the compiler may fuse roundings away, and neither may hurt."""
    return [function(jnp.asarray(x)), jax.jit(function)(jnp.asarray(x))]


class TestSinglePrecision:
    def test_sincos(self):
        exact = np.sin(ANGLES32.astype(np.float64)), np.cos(ANGLES32.astype(np.float64))
        for result in both_forms(fastmath.sincos, ANGLES32):
            for value, want in zip(result, exact, strict=True):
                assert value.dtype == np.float32
                # The docstring's promise.
                assert np.max(np.abs(np.asarray(value, np.float64) - want)) < 2e-7

    def test_sincos_near_zero_is_relative(self):
        x = np.float32(10.0) ** np.linspace(-30, -1, 1000, dtype=np.float32)
        sine, _ = jax.jit(fastmath.sincos)(x)
        np.testing.assert_allclose(sine, np.sin(x.astype(np.float64)), rtol=4 * EPS32)

    def test_sincos_of_turns(self):
        turns = np.concatenate([np.linspace(-0.5, 0.5, COUNT // 2), np.linspace(-7.0, 7.0, COUNT // 2)]).astype(
            np.float32
        )
        exact = 2.0 * np.pi * turns.astype(np.float64)
        for result in both_forms(fastmath.sincos_turns, turns):
            for value, want in zip(result, (np.sin(exact), np.cos(exact)), strict=True):
                assert np.max(np.abs(np.asarray(value, np.float64) - want)) < 9e-7

    def test_reciprocal_root(self):
        exact = 1.0 / np.sqrt(POSITIVE32.astype(np.float64))
        for value in both_forms(fastmath.reciprocal_root, POSITIVE32):
            assert value.dtype == np.float32
            np.testing.assert_allclose(value, exact, rtol=1e-6)

    def test_log(self):
        exact = np.log(POSITIVE32.astype(np.float64))
        for value in both_forms(fastmath.log, POSITIVE32):
            assert value.dtype == np.float32
            np.testing.assert_allclose(value, exact, rtol=3 * EPS32, atol=1e-38)
            assert not np.any(np.asarray(value)[POSITIVE32 == 1.0])

    def test_exp(self):
        exact = np.exp(EXPONENTS32.astype(np.float64))
        for value in both_forms(fastmath.exp, EXPONENTS32):
            assert value.dtype == np.float32
            np.testing.assert_allclose(value, exact, rtol=4 * EPS32)

    def test_exp_stays_finite_outside_its_range(self):
        low, high = jax.jit(fastmath.exp)(jnp.asarray([-1e9, 1e9], jnp.float32))
        assert float(low) == pytest.approx(math.exp(-87.0), rel=1e-6)
        assert float(high) == pytest.approx(math.exp(88.0), rel=1e-6)

    @pytest.mark.parametrize("exponent", [0.4, 1.2, 1.0 / 6.0, -1.0 / 3.0])
    def test_power(self, exponent: float):
        x = sample(1e-6, 1e6, [1.0], logarithmic=True).astype(np.float32)
        exact = x.astype(np.float64) ** exponent
        # The logarithm's rounding counts exponent * |log x| times: at most 1.2 * 13.8, here with room for three.
        allowed = EPS32 * (4.0 + 4.0 * np.abs(exponent * np.log(x.astype(np.float64))))
        value = jax.jit(fastmath.power, static_argnums=1)(x, exponent)
        assert np.all(np.abs(np.asarray(value, np.float64) / exact - 1.0) < allowed)

    def test_wrap_angle(self):
        x = sample(-100.0, 100.0, [0.0, 3.0, -3.0]).astype(np.float32)
        for value in both_forms(fastmath.wrap_angle, x):
            wrapped = np.asarray(value, np.float64)
            # Two roundings at the size of x.
            rounding = 2.0 * EPS32 * (np.abs(x) + math.pi)
            assert np.all(np.abs(wrapped) <= math.pi + rounding)
            turns = (x.astype(np.float64) - wrapped) / (2.0 * math.pi)
            assert np.all(np.abs(turns - np.round(turns)) * 2.0 * math.pi <= rounding)
            inside = np.abs(x) < 3.14
            np.testing.assert_array_equal(np.asarray(value)[inside], x[inside])

    @pytest.mark.parametrize("shape", [(), (5,), (2, 3)])
    def test_any_shape(self, shape: tuple[int, ...]):
        x = jax.ShapeDtypeStruct(shape, np.float32)
        for function in (fastmath.sincos, fastmath.log, fastmath.exp, fastmath.wrap_angle):
            for value in jax.tree.leaves(jax.eval_shape(function, x)):
                assert (value.shape, value.dtype) == (shape, np.float32)


DERIVATIVES: list[tuple[str, Callable[[jax.Array], jax.Array], Callable[[Array], Array], Callable[[Array], Array]]] = [
    ("sin", lambda x: fastmath.sincos(x)[0], np.cos, lambda x: -np.sin(x)),
    ("cos", lambda x: fastmath.sincos(x)[1], lambda x: -np.sin(x), lambda x: -np.cos(x)),
    ("log", lambda x: fastmath.log(x), lambda x: 1.0 / x, lambda x: -1.0 / x**2),
    ("exp", lambda x: fastmath.exp(x), np.exp, np.exp),
    ("power", lambda x: fastmath.power(x, 0.4), lambda x: 0.4 * x**-0.6, lambda x: -0.24 * x**-1.6),
    ("wrap_angle", lambda x: fastmath.wrap_angle(x), np.ones_like, np.zeros_like),
]


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize(("function", "first", "second"), [d[1:] for d in DERIVATIVES], ids=[d[0] for d in DERIVATIVES])
def test_derivatives(function: Any, first: Any, second: Any, precision: str):
    points = np.linspace(0.05, 3.1, 57)
    tolerance = 2e-6 if precision == "float32" else 1e-14
    with jax.enable_x64(precision == "float64"):

        @jax.jit
        def derivatives(x: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
            _, forward = jax.jvp(function, (x,), (jnp.ones_like(x),))
            return jax.vmap(jax.grad(function))(x), forward, jax.vmap(jax.grad(jax.grad(function)))(x)

        reverse, forward, twice = derivatives(jnp.asarray(points, precision))
    np.testing.assert_allclose(reverse, first(points), rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(forward, first(points), rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(twice, second(points), rtol=2 * tolerance, atol=tolerance)


def test_both_outputs_of_sincos_carry_a_derivative():
    x = jnp.asarray([0.3, 2.0], jnp.float32)
    gradient = jax.jit(jax.grad(lambda x: jnp.sum(2.0 * fastmath.sincos(x)[0] + 3.0 * fastmath.sincos(x)[1])))(x)
    np.testing.assert_allclose(gradient, 2.0 * np.cos(x) - 3.0 * np.sin(x), rtol=1e-6)


@pytest.mark.parametrize(
    ("function", "exact", "x"),
    [
        (lambda x: fastmath.sincos(x)[0], np.sin, ANGLES),
        (lambda x: fastmath.sincos(x)[1], np.cos, ANGLES),
        (fastmath.log, np.log, np.exp(np.linspace(-700.0, 700.0, 10_001))),
        (fastmath.exp, np.exp, np.linspace(-700.0, 700.0, 10_001)),
        (lambda x: fastmath.power(x, 1.2), lambda x: x**1.2, np.linspace(0.01, 1e4, 10_001)),
    ],
    ids=["sin", "cos", "log", "exp", "power"],
)
def test_double_precision(function: Any, exact: Any, x: Array):
    with jax.enable_x64(True):
        value = function(jnp.asarray(x))
        assert value.dtype == np.float64
        np.testing.assert_allclose(value, exact(x), rtol=5e-15, atol=1e-15)
