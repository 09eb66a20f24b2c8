"""Numbers of the full Dryden model: figure 7 of MIL-F-8785C as it is printed, and the series of the last noise."""

from __future__ import annotations

import decimal
from decimal import Decimal
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.noise import Drawn
from qrsim.models.atmosphere.dryden import (
    Dryden,
    DrydenState,
    FilterState,
    exponential_decay,
    second_order,
    severity_sigma,
    third_row,
)

FOOT = 0.3048
# MIL-F-8785C, figure 7, as JSBSim tabulates its curves (FGWinds.cpp): heights [ft], and sigma [ft/s] of the curves 1
# (light) to 7.
FEET = (500.0, 1750.0, 3750.0, 7500.0, 15000.0, 25000.0, 35000.0, 45000.0, 55000.0, 65000.0, 75000.0, 80000.0)
FIGURE_7 = {
    1: (3.2, 2.2, 1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    2: (4.2, 3.6, 3.3, 1.6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    3: (6.6, 6.9, 7.4, 6.7, 4.6, 2.7, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0),
    4: (8.6, 9.6, 10.6, 10.1, 8.0, 6.6, 5.0, 4.2, 2.7, 0.0, 0.0, 0.0),
    5: (11.8, 13.0, 16.0, 15.1, 11.6, 9.7, 8.1, 8.2, 7.9, 4.9, 3.2, 2.1),
    6: (15.6, 17.6, 23.0, 23.6, 22.1, 20.0, 16.0, 15.1, 12.1, 7.9, 6.2, 5.1),
    7: (18.7, 21.5, 28.4, 30.2, 30.7, 31.0, 25.2, 23.1, 17.5, 10.7, 8.4, 7.2),
}


@pytest.mark.parametrize("severity", range(1, 8))
def test_figure_7_is_as_printed_and_linear_between_its_heights(severity: int) -> None:
    feet = np.sort(np.array([*FEET, 0.0, 1000.0, 6000.0, 30000.0, 40000.0, 50000.0, 90000.0]))
    expected = np.interp(feet, FEET, FIGURE_7[severity]) * FOOT
    found = severity_sigma(jnp.asarray(feet * FOOT, jnp.float32), severity)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)


@jax.jit
def last_factor(x: Any, ratio: Any) -> Any:
    """Return l33 (n,) of steps and ratios (n,)."""
    of = exponential_decay(x)
    return third_row(x, ratio, of, exponential_decay(x * ratio), second_order(x, of)).l33


def moment(rate: Decimal, power: int, x: Decimal) -> Decimal:
    """Return the integral of s^power exp(-rate s) over s from 0 to x, for a power up to 2."""
    y = rate * x
    tail = (Decimal(1), 1 + y, 2 + 2 * y + y * y)[power]
    return (Decimal((1, 1, 2)[power]) - (-y).exp() * tail) / rate ** (power + 1)


def last_noise(x: float, ratio: float) -> float:
    """Return the part of z3's noise over a step x that those of z1 and z2 do not explain, from a Gram determinant.

    Its impulse response has sqrt(2 r) ((1 + r)/(1 - r))^2 exp(-r s) beside exp(-s) and s exp(-s), which z1 and z2 have.
    """
    with decimal.localcontext(decimal.Context(prec=80)):
        r, one, step = Decimal(ratio), Decimal(1), Decimal(x)
        a, b, c = moment(2 * r, 0, step), moment(r + one, 0, step), moment(r + one, 1, step)
        d, e, f = (moment(2 * one, power, step) for power in (0, 1, 2))
        explained = (b * b * f - 2 * b * c * e + c * c * d) / (d * f - e * e)
        return float(((a - explained) * 2 * r * ((1 + r) / (1 - r)) ** 4).sqrt())


# Steps and ratios that binary numbers hold, with r x at most 1/4: both about 1/4, and either alone, so that each term
# of the series, up to the eighth order, is seen.
STEPS = (31 / 128, 31 / 128, 31 / 128, 31 / 128, 31 / 256, 31 / 512, 31 / 2048)
RATIOS = (33 / 32, 3 / 4, 1 / 2, 1 / 16, 2.0, 4.0, 16.0)


def test_last_noise_of_the_angular_gust_has_all_digits_of_double_precision() -> None:
    """A fifth of the smallest term of the eighth order would change it by 7e-14; the terms left out have 3e-14."""
    with jax.enable_x64(True):
        found = np.asarray(last_factor(np.array(STEPS), np.array(RATIOS)))
    exact = np.array([last_noise(*pair) for pair in zip(STEPS, RATIOS, strict=True)])
    np.testing.assert_allclose(found / exact - 1.0, 0.0, rtol=0.0, atol=3.5e-14)


def test_last_noise_does_not_vanish_at_the_smallest_steps() -> None:
    """A variance of x^5/360 16 = 4e-37 in units of the gust's is replaced by 1e-24, whose root has a slope."""
    found = last_factor(np.full(7, 1e-7, np.float32), np.ones(7, np.float32))
    np.testing.assert_allclose(found, 1e-12, rtol=1e-5)


def test_a_normal_for_each_number_of_the_state() -> None:
    """One of u, three each of v and r, and w and q, one of p."""
    assert Dryden.normals == 8
    state = Dryden(speed_20ft=8.0, wind_from_rad=0.0).init(Drawn(tuple(np.arange(8.0)[:, None])))  # type: ignore[arg-type]
    expected = DrydenState(0.0, FilterState(1.0, 2.0, 6.0), FilterState(3.0, 4.0, 7.0), 5.0)  # type: ignore[arg-type]
    np.testing.assert_array_equal(np.ravel(jax.tree.leaves(state)), jax.tree.leaves(expected))
