"""Phases and lifetimes of the waves of the turbulence field."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.models.atmosphere import field_reference as field

from qrsim.core.tree import replace
from qrsim.models.atmosphere.field_waves import mixed, stagger, waves_at
from qrsim.studies.validate import wind_field


@pytest.mark.parametrize("evolution", ["lifetime", "frozen"])
def test_phases_at_a_time_are_those_of_whole_numbers(evolution: str) -> None:
    drawn = field.draw(field.component(convection_ned=[50.0, 30.0], evolution=evolution))
    for seconds in (0, 1, 59, 10**6, 2_000_000_000):
        turns, amplitudes = waves_at(drawn, jnp.int32(seconds), jnp.float32(0.0))
        phases, sizes = field.chains_at(16, drawn, seconds, 0.0)
        exact = [
            ((p - int(f) * seconds) % 2**32) / 2.0**32 for p, f in zip(phases, np.asarray(drawn.advance), strict=True)
        ]
        away = np.asarray(turns, np.float64) - exact
        assert np.abs(away - np.round(away)).max() < 1e-7
        if evolution == "frozen":
            assert amplitudes is None
        else:
            np.testing.assert_allclose(amplitudes, sizes, rtol=0.0, atol=3e-6)


def test_the_hash_of_phases_is_that_of_murmur_hash() -> None:
    """MurmurHash3_x86_32 of nothing is fmix32 of its seed: published for the seeds 0, 1 and 2^32 - 1."""
    found = np.asarray(mixed(jnp.array([0, 1, 2**32 - 1], jnp.uint32))).tolist()
    assert found == [0, 0x514E28B7, 0x81F16F39]


@pytest.mark.parametrize("chains", [8, 12, 16, 64])
def test_four_neighbours_are_a_quarter_of_a_lifetime_apart(chains: int) -> None:
    """So that the sum of their sin^4 is 3/2 at any time; all ages of both segments differ."""
    ages = stagger(chains) / 2.0**20
    assert len(set(ages)) == 2 * chains
    for four in ages.reshape(-1, 4):
        np.testing.assert_allclose(np.sort((four - four[0]) % 1.0), [0.0, 0.25, 0.5, 0.75], rtol=0.0, atol=2e-6)


def test_waves_are_forgotten_in_a_lifetime() -> None:
    """The closed form is the autocorrelation of sin^2(pi s) from 0 to 1: by numerical integration."""
    s = np.linspace(0.0, 1.0, 20_001)
    for x in (0.0, 0.1, 0.35, 0.5, 0.8, 1.0, 1.7):
        product = np.sin(np.pi * s) ** 2 * np.where(s + x < 1.0, np.sin(np.pi * (s + x)) ** 2, 0.0)
        assert float(wind_field.kept(x)) == pytest.approx(8.0 / 3.0 * np.trapezoid(product, s), abs=1e-7)


@pytest.mark.parametrize(("lifetime", "rate"), [(100.0, 10486), (10.0, 104858), (10000.0, 105)])
def test_each_phase_is_drawn_again_once_in_a_lifetime(lifetime: float, rate: int) -> None:
    """Over 1.2 lifetimes, and where the ages wrap; the amplitude is zero at the change, and nothing jumps there."""
    drawn = field.draw(field.component(convection_ned=[0.0, 0.0], lifetime=lifetime))
    assert drawn.ages is not None
    assert int(drawn.ages.rate) == rate
    for start in (123_456_789, 2**32 - 1000):
        ages = replace(drawn.ages, start=jnp.uint32(start))
        times = np.arange(0.0, 1.2 * lifetime, lifetime / 400.0)
        turns, amplitudes = jax.vmap(lambda s, f, ages=ages: waves_at(replace(drawn, ages=ages), s, f))(
            jnp.asarray(times, jnp.int32), jnp.asarray(times % 1.0, jnp.float32)
        )
        changes = np.diff(np.asarray(turns), axis=0) != 0.0
        assert set(changes.sum(axis=0)) == {1, 2}
        sizes = np.asarray(amplitudes)
        assert np.maximum(sizes[1:], sizes[:-1])[changes].max() < 1e-3
        assert np.abs(np.diff(sizes, axis=0)).max() < 2.0 * np.pi / 400.0
        # The mean square of all chains is 1 at any time.
        np.testing.assert_allclose(np.mean(sizes**2, axis=1), 1.0, rtol=0.0, atol=1e-5)


@pytest.mark.long
def test_in_the_moving_frame_gusts_are_forgotten_by_the_closed_form() -> None:
    """Correlations over 400 worlds of 30 places each, which are independent: four standard errors, at most 0.06."""
    turbulence = field.component(convection_ned=[-5.0, 4.0])
    flat = np.random.default_rng(3).uniform(-3000.0, 3000.0, (30, 2))
    at = np.column_stack([flat, np.full(30, -15.0)])
    start, _ = field.sampled(turbulence, 400, at)
    for seconds, expected in ((5.0, 0.9837), (30.0, 0.5459), (50.0, 0.1667), (100.0, 0.0), (230.0, 0.0)):
        moved, _ = field.sampled(turbulence, 400, at + np.array([-5.0, 4.0, 0.0]) * seconds, seconds)
        assert float(wind_field.kept(seconds / 100.0)) == pytest.approx(expected, abs=1e-4)
        products = np.mean(start * moved, axis=1) / np.mean(start**2, axis=(0, 1))
        error = products.std(axis=0, ddof=1) / math.sqrt(400.0)
        assert np.all(error < 0.015)
        assert np.all(np.abs(products.mean(axis=0) - expected) < 4.0 * error + 0.006 * expected)
