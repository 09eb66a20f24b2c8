"""Order of convergence of the integrators, on problems with known solutions."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.integrate import INTEGRATORS, heun, rk4

ORDERS = {"heun": 2, "rk4": 4}


def pendulum_error(rule: Any, steps: int) -> float:
    """Error at t = 2 of x' = cos(t) x^2 with x(0) = 0.5 and t as a state: x = 1/(2 - sin t)."""

    def slope(state: Any) -> Any:
        return {"t": jnp.ones_like(state["t"]), "x": jnp.cos(state["t"]) * state["x"] ** 2}, state["x"]

    with jax.enable_x64(True):
        state = {"t": jnp.zeros(()), "x": jnp.asarray(0.5)}
        state, _ = jax.lax.scan(lambda s, _: rule(slope, s, 2.0 / steps), state, None, steps)
        return abs(float(state["x"]) - 1.0 / (2.0 - math.sin(2.0)))


@pytest.mark.parametrize("name", ORDERS)
def test_order_of_convergence(name: str):
    rule = INTEGRATORS[name]
    errors = [pendulum_error(rule, steps) for steps in (40, 80, 160)]
    for coarse, fine in pairwise(errors):
        assert math.log2(coarse / fine) == pytest.approx(ORDERS[name], abs=0.15)


@pytest.mark.parametrize("name", ORDERS)
def test_linear_problem_gives_the_taylor_polynomial(name: str):
    """One step of x' = k x multiplies x by the exponential's series up to the rule's order."""
    with jax.enable_x64(True):
        z = -0.3
        after, output = INTEGRATORS[name](lambda x: (-3.0 * x, x), jnp.asarray(2.0), 0.1)
        series = sum(z**k / math.factorial(k) for k in range(ORDERS[name] + 1))
        assert float(after) == pytest.approx(2.0 * series, rel=1e-14)
        # The output is averaged with the slope's weights, so that here it is the mean of x over the step.
        assert float(output) == pytest.approx((float(after) - 2.0) / -0.3, rel=1e-14)


def test_heun_by_hand():
    # x' = x^2 from 1 with a step of 0.5: slopes 1 and 1.5^2.
    after, output = heun(lambda x: (x * x, 10.0 * x), jnp.asarray(1.0, jnp.float32), 0.5)
    assert float(after) == pytest.approx(1.0 + 0.25 * (1.0 + 2.25))
    assert float(output) == pytest.approx(12.5)


def test_rk4_is_simpson_on_a_quadrature():
    def slope(state: Any) -> Any:
        t, _ = state
        return (jnp.ones_like(t), t**3), t**3

    with jax.enable_x64(True):
        (_, area), mean = rk4(slope, (jnp.asarray(1.0), jnp.asarray(0.0)), 2.0)
    assert float(area) == pytest.approx(20.0, rel=1e-14)
    assert float(mean) == pytest.approx(10.0, rel=1e-14)


@pytest.mark.parametrize("name", ORDERS)
def test_trees_keep_their_structure_shape_and_precision(name: str):
    state = {"a": jnp.ones((3,), jnp.float32), "b": (jnp.zeros((2, 3), jnp.float32),)}
    after, output = INTEGRATORS[name](lambda s: (s, {"out": s["a"]}), state, 0.02)
    assert jax.tree.structure(after) == jax.tree.structure(state)
    for old, new in zip(jax.tree.leaves(state), jax.tree.leaves(after), strict=True):
        assert (new.shape, new.dtype) == (old.shape, old.dtype)
    assert output["out"].dtype == np.float32
