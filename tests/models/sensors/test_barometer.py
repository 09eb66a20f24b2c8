"""Barometric altitude: the drift's standard deviation and time constant, and the height rate made of it."""

from __future__ import annotations

import math
from functools import partial
from statistics import NormalDist
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy

from qrsim.core.noise import Draw, Drawn, Key, Stream
from qrsim.core.tree import cast
from qrsim.core.vectors import Vec3
from qrsim.models.sensors.barometer import Barometer, BarometerReading, IdealBarometer

Array = np.ndarray[Any, Any]
STD, TAU, PERIOD = 0.26, 300.0, 0.02
VEHICLES, STEPS = 8192, 2000  # 40 s
HEIGHT = 50.0


def z_limit(statistics: int) -> float:
    """Standard errors that none of so many statistics exceeds with 99.9 % confidence (Bonferroni)."""
    return NormalDist().inv_cdf(1.0 - 0.0005 / statistics)


def chi_squared_band(n: int, statistics: int = 1) -> tuple[float, float]:
    """Range of a variance of n standard normals of known mean, 99.9 % over so many statistics (Bonferroni)."""
    low, high = scipy.stats.chi2.ppf([0.0005 / statistics, 1.0 - 0.0005 / statistics], n) / n
    return float(low), float(high)


def vertical(z: jax.Array) -> Vec3:
    """A vector that is z down."""
    return Vec3(jnp.zeros_like(z), jnp.zeros_like(z), z)


@partial(jax.jit, static_argnames="steps")
def listen(sensor: Any, begin: Stream, source: Stream, z: jax.Array, climb: jax.Array, steps: int) -> BarometerReading:
    """Readings, (1 + steps, n) each, of vehicles that climb from z (n,) [m] at ``climb`` (n,) [m/s]."""
    like = jnp.zeros((), z.dtype)
    state, first = sensor.init(Draw(begin, jnp.uint32(0), like), vertical(z), vertical(-climb))

    def tick(state: Any, now: jax.Array) -> tuple[Any, BarometerReading]:
        position = vertical(z - climb * (now.astype(z.dtype) * sensor.period))
        return sensor.step(state, Draw(source, now, like), position, vertical(-climb))

    later = jax.lax.scan(tick, state, jnp.arange(1, steps + 1, dtype=jnp.uint32))[1]
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, later)


def readings(sensor: Any, n: int, steps: int, climb: float = 0.0, seed: int = 1) -> tuple[Array, Array]:
    """Heights and height rates, (1 + steps, n) each, in single precision."""
    ids, key = jnp.arange(n, dtype=jnp.uint32), Key.root(seed)
    z, speed = np.full(n, -HEIGHT, np.float32), np.full(n, climb, np.float32)
    reading = listen(
        cast(sensor, np.float32), key.stream("barometer/start", ids), key.stream("barometer", ids), z, speed, steps
    )
    assert reading.height.dtype == reading.height_rate.dtype == np.float32
    return np.asarray(reading.height), np.asarray(reading.height_rate)


@pytest.fixture(scope="module")
def still(optimising: Any) -> tuple[Array, Array]:
    """Readings of vehicles at 50 m with the default parameters, as errors in m and m/s."""
    with optimising():
        height, rate = readings(Barometer(), VEHICLES, STEPS)
    return height - HEIGHT, rate


class TestDrift:
    @pytest.mark.long
    def test_stationary_from_the_first_reading(self, still):
        low, high = chi_squared_band(VEHICLES, 4)
        for step in (0, 1, 50, STEPS):
            assert low < np.mean(still[0][step] ** 2) / STD**2 < high
        assert abs(np.mean(still[0][0])) < z_limit(1) * STD / math.sqrt(VEHICLES)

    def test_time_constant(self, still):
        """Recovered from the regression over 40 s, with 99.9 % confidence to 15 %; a rate of 300 would give 0."""
        first, last = still[0][0].astype(np.float64), still[0][-1].astype(np.float64)
        slope = np.sum(first * last) / np.sum(first**2)
        lag = PERIOD * STEPS
        r = math.exp(-lag / TAU)
        # The slope has variance (1 - r^2)/n, and tau = -lag/ln(slope).
        relative = math.sqrt((1.0 - r * r) / VEHICLES) / r * TAU / lag
        assert z_limit(1) * relative == pytest.approx(0.151, abs=0.001)
        assert abs(-lag / math.log(slope) / TAU - 1.0) < z_limit(1) * relative

    def test_time_constant_over_short_times(self, still):
        """What 1 s changes: variance 2 sigma^2 (1 - a), from 40 nearly independent seconds of each vehicle."""
        changes = np.diff(still[0][::50], axis=0)
        variance = 2.0 * STD**2 * -math.expm1(-1.0 / TAU)
        # Changes of successive seconds are correlated by -1/600, which widens the band by nothing that shows.
        low, high = chi_squared_band(changes.size)
        assert low < np.mean(changes**2) / variance < high

    def test_vehicles_are_independent(self, still):
        x = still[0][[0, -1]] / STD
        found = [np.mean(x[step, apart:] * x[step, :-apart]) for step in (0, 1) for apart in (1, 2, 64)]
        # Also what drives them, where the first values have no part.
        moved = (x[1] - math.exp(-40.0 / TAU) * x[0]) / math.sqrt(-math.expm1(-80.0 / TAU))
        found += [np.mean(moved[apart:] * moved[:-apart]) for apart in (1, 2, 64)]
        assert np.max(np.abs(found)) < z_limit(9) / math.sqrt(VEHICLES - 64)


class TestHeightRate:
    def test_spread(self, still):
        """sigma sqrt(2 (1 - a))/T = 0.15 m/s."""
        expected = STD * math.sqrt(2.0 * -math.expm1(-PERIOD / TAU)) / PERIOD
        assert round(expected, 4) == 0.1501
        rates = still[1][1:201].astype(np.float64)
        low, high = chi_squared_band(rates.size)
        # Heights of 50 m are rounded to 3.8e-6 m, uniformly: a variance of (3.8e-6/0.02)^2/6 in their difference
        # over T. And the drift's factor 1 - a = 6.7e-5 is rounded by up to 3e-8.
        rounding = (3.8e-6 / PERIOD) ** 2 / 6.0 / expected**2 + 3e-8 / -math.expm1(-PERIOD / TAU)
        assert rounding < 1e-3
        assert low - rounding < np.mean(rates**2) / expected**2 < high + rounding

    def test_is_the_difference_of_the_heights(self, still):
        # The rates were made of single-precision heights, and so is this difference.
        np.testing.assert_allclose(still[1][1:201], np.diff(still[0][:201], axis=0) / PERIOD, atol=1e-5)

    def test_first_is_the_true_one(self, still):
        np.testing.assert_array_equal(still[1][0], 0.0)

    def test_follows_a_climb(self):
        height, rate = readings(Barometer(drift_std=0.0), 2, 100, climb=2.0)  # type: ignore[arg-type]
        # Up is positive. Heights of 50 m are rounded to 3.8e-6 m, which over T is 2e-4 m/s.
        np.testing.assert_allclose(height[:, 0], HEIGHT + 0.04 * np.arange(101), atol=1e-5)
        np.testing.assert_allclose(rate, 2.0, atol=5e-4)


class TestWhiteNoise:
    def test_is_off_by_default(self):
        assert Barometer().white_std == 0.0

    def test_alone(self):
        """A white error is new in each reading, and its difference over T has sqrt(2)/T of its spread."""
        sensor = Barometer(drift_std=0.0, white_std=0.5)  # type: ignore[arg-type]
        height, rate = readings(sensor, VEHICLES, 10, seed=2)
        error = height - HEIGHT
        low, high = chi_squared_band(error.size, 2)
        assert low < np.mean(error**2) / 0.25 < high
        # A difference shares each reading with its neighbour, so every second one counts.
        low, high = chi_squared_band(rate[1::2].size, 2)
        assert low < np.mean(rate[1::2] ** 2) / (2.0 * 0.25 / PERIOD**2) < high
        limit = z_limit(2) / math.sqrt(10 * VEHICLES)
        assert abs(np.mean(error[1:] * error[:-1])) / 0.25 < limit
        assert abs(np.mean(error[:, 1:] * error[:, :-1])) / 0.25 < limit

    def test_is_independent_of_the_drift(self):
        """The sum has the sum of the variances, also where new drift is most of the drift."""
        sensor = Barometer(drift_std=0.5, drift_time_constant=0.01, white_std=0.5)  # type: ignore[arg-type]
        height, _ = readings(sensor, VEHICLES, 10, seed=3)
        low, high = chi_squared_band(VEHICLES, 3)
        for step in (0, 1, 10):
            assert low < np.mean((height[step] - HEIGHT) ** 2) / 0.5 < high


def test_ideal_is_the_truth():
    height, rate = readings(IdealBarometer(), 3, 10, climb=-1.5)
    np.testing.assert_allclose(height, np.tile(HEIGHT - 0.03 * np.arange(11)[:, None], 3), atol=1e-5)
    np.testing.assert_array_equal(rate, -1.5)
    assert IdealBarometer.normals == 0
    assert IdealBarometer().period == Barometer().period == PERIOD


def test_draws_as_many_normals_as_it_declares():
    """World steps hand out exactly that many."""
    one = np.ones(1, np.float32)
    sensor = Barometer(drift_std=1.0, white_std=1.0)  # type: ignore[arg-type]
    drawn = Drawn((one,) * Barometer.normals)  # type: ignore[arg-type]
    step = jax.jit(lambda s, d, p: s.step(s.init(d, p, p)[0], d, p, p)[1])
    reading = step(cast(sensor, np.float32), drawn, Vec3(one, one, one))
    a = math.exp(-PERIOD / TAU)
    assert float(reading.height[0]) == pytest.approx(a + math.sqrt(1.0 - a * a) - 1.0 + 1.0, rel=1e-5)


def test_the_first_rate_of_a_vehicle_placed_anew_is_that_of_a_whole_period() -> None:
    """Placed at 30 m, climbing at 2 m/s, 5 ms after a reading: at the next one, at 30.03 m, the rate is 2 m/s."""
    sensor = cast(Barometer(drift_std=0.0), np.float32)  # type: ignore[arg-type]
    zero = jnp.zeros(1, jnp.float32)
    climb, still = vertical(zero - 2.0), Drawn((zero, zero))
    state, _ = sensor.init(still, vertical(zero), vertical(zero))
    state, _ = sensor.restart(state, still, jnp.full(1, 0.005, jnp.float32), vertical(zero - 30.0), climb)
    _, reading = sensor.step(state, still, vertical(zero - 30.03), climb)
    assert float(reading.height[0]) == pytest.approx(30.03, abs=1e-5)
    assert float(reading.height_rate[0]) == pytest.approx(2.0, abs=5e-4)
