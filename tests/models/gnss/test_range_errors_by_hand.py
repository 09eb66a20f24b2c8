"""Budgets, presets, nodes and steps of second-order range errors, against what has been published about them."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.noise import Drawn
from qrsim.models.gnss.errors import _NODES, _WEIGHTS, BUDGETS, PRESETS, GaussMarkov2


def test_budgets_are_the_tables_of_their_document() -> None:
    """Galileo OS Service Definition Document 1.3, annex C.4.5.1, tables 33 and 34: [m] at 5 and 90 degrees."""
    assert BUDGETS["consumer"] == {
        "signal in space": (0.67, 0.67),
        "residual ionosphere": (6.0, 3.0),
        "residual troposphere": (1.35, 0.14),
        "thermal noise, interference, multipath": (0.69, 0.63),
        "broadcast group delay": (0.30, 0.30),
        "code-carrier divergence": (0.30, 0.30),
    }
    assert BUDGETS["survey"] == {
        "signal in space": (0.67, 0.67),
        "residual ionosphere": (0.08, 0.03),
        "residual troposphere": (1.35, 0.14),
        "thermal noise, interference, multipath": (0.50, 0.23),
    }


@pytest.mark.parametrize(("name", "std"), [("consumer", 4.95), ("survey", 1.23)])
def test_presets_are_those_of_the_page(name: str, std: float) -> None:
    """docs/explanation/models/gnss.md: root mean squares of the budgets, to a centimetre; 1100 s and 100 s."""
    expected = {"type": "gauss_markov_2", "std": std, "time_constant": 1100.0, "drive_time_constant": 100.0}
    assert PRESETS[name] == expected


def test_nodes_and_weights_are_those_of_gauss_and_legendre() -> None:
    """Abramowitz and Stegun, table 25.4, n = 12, brought from [-1, 1] to [0, 1]."""
    x = np.array(
        [
            0.125233408511469,
            0.367831498998180,
            0.587317954286617,
            0.769902674194305,
            0.904117256370475,
            0.981560634246719,
        ]
    )
    w = np.array(
        [
            0.249147045813403,
            0.233492536538355,
            0.203167426723066,
            0.160078328543346,
            0.106939325995318,
            0.047175336386512,
        ]
    )
    np.testing.assert_allclose(_NODES, np.concatenate([0.5 - 0.5 * x[::-1], 0.5 + 0.5 * x]), atol=1e-14)
    np.testing.assert_allclose(_WEIGHTS, 0.5 * np.concatenate([w[::-1], w]), atol=1e-14)


def test_it_draws_as_many_normals_as_it_declares() -> None:
    """Two a step; a draw that allows one less is not enough."""
    errors = GaussMarkov2()
    normals = tuple(np.zeros(1, np.float32) for _ in range(errors.normals))
    assert errors.init(Drawn(normals)).error.shape == (1,)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="declares 1 normals"):
        errors.init(Drawn(normals[1:]))  # type: ignore[arg-type]


@jax.jit
def _step(tau: Any, tau_drive: Any) -> Any:
    return GaussMarkov2(tau, tau, tau_drive).discretise(jnp.asarray(1.0, tau.dtype))


@pytest.mark.parametrize(
    ("apart", "tolerance"),
    # A series up to 1e-3, of which z^4/120 = 5.5e-15 is left out; closed from there, good to rounding.
    [(9e-4, 1e-13), (1.15e-3, 3e-15)],
)
def test_rates_that_are_nearly_alike(apart: float, tolerance: float) -> None:
    """sqrt(a (a + b)) (exp(-a t) - exp(-b t))/(b - a), as exp(-a t) (1 - exp(-z))/z with z = (b - a) t; a = t = 1."""
    tau_drive = 1.0 / (1.0 + apart)
    b = 1.0 / tau_drive
    with jax.enable_x64(True):
        found = float(_step(np.float64(1.0), np.float64(tau_drive)).coupling)
    expected = math.sqrt(1.0 + b) * math.exp(-1.0) * -math.expm1(1.0 - b) / (b - 1.0)
    assert found == pytest.approx(expected, rel=tolerance, abs=0.0)


def test_short_steps_cancel_nothing() -> None:
    """Of 1e-8 and 1e-6 of the time constants: a random walk of y by 2 b t, integrated: a (a + b) 2 b t^3/3."""
    with jax.enable_x64(True):
        by = _step(np.float64(1e8), np.float64(1e6))
        found = float(by.own * by.own + by.shared * by.shared)
    assert found == pytest.approx(1e-8 * 1.01e-6 * 2e-6 / 3.0, rel=1e-5, abs=0.0)


def test_time_constants_that_are_not_alike_are_taken_as_they_are() -> None:
    """1.1e-5 of themselves apart; those closer than 1e-5 are moved to 1e-5 apart, about their mean."""
    for apart, slow, quick in ((1.1e-5, 1.0, 1.0 - 1.1e-5), (0.9e-5, 1.0 + 0.5e-6, 1.0 - 9.5e-6)):
        (_, first), (_, second) = GaussMarkov2(1.0, 1.0, 1.0 - apart)._terms()  # type: ignore[arg-type]
        assert (first, second) == pytest.approx((slow, quick), rel=1e-10)
