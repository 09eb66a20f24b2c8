"""First-order Dryden gusts against the scales of MIL-F-8785C worked by hand and the theory of the process."""

from __future__ import annotations

import dataclasses
import itertools
import math
from functools import partial
from statistics import NormalDist
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy

from qrsim.core.noise import Draw, Drawn, Key
from qrsim.core.tree import cast, field_info, replace
from qrsim.core.vectors import Vec3
from qrsim.models.atmosphere.turbulence import DrydenFirstOrder, GustState, Still, low_altitude_scales

Array = np.ndarray[Any, Any]
FOOT, DT = 0.3048, 0.02
DRYDEN = DrydenFirstOrder(speed_20ft=8.0, wind_from_rad=0.0)  # type: ignore[arg-type]
# Height [ft], 0.177 + 0.000823 h, Lu = Lv = h/(..)^1.2 [ft], sigma_u/sigma_w = (..)^-0.4.
BY_HAND = (
    (10.0, 0.18523, 75.6391, 1.962978),
    (20.0, 0.19346, 143.5888, 1.929139),
    (100.0, 0.25930, 505.1693, 1.715849),
    (500.0, 0.58850, 944.6572, 1.236236),
    (1000.0, 1.00000, 1000.000, 1.000000),
)


def z_limit(statistics: int) -> float:
    """Standard errors that none of so many statistics exceeds with 99.9 % confidence (Bonferroni)."""
    return NormalDist().inv_cdf(1.0 - 0.0005 / statistics)


def assert_variances(samples: Array, expected: Any) -> None:
    """Check variances of (n, ...) samples of known mean zero by chi-squared, 99.9 % over all of them."""
    n, count = samples.shape[0], samples[0].size
    ratio = np.sum(np.square(samples, dtype=np.float64), axis=0) / expected
    low, high = scipy.stats.chi2.ppf([0.0005 / count, 1.0 - 0.0005 / count], n)
    assert np.all((ratio > low) & (ratio < high)), f"{ratio / n} outside [{low / n}, {high / n}]"


def vec(array: Any) -> Vec3:
    """Vec3 of (n,) float32 from (n, 3) or (3,)."""
    return Vec3(*np.moveaxis(np.asarray(array, np.float32), -1, 0))  # type: ignore[arg-type]


class Flight(NamedTuple):
    """Height [m], ground speed north and wind speed north [m/s] of vehicles, (n,)."""

    height: Array
    ground: Array
    wind: Array


@partial(jax.jit, static_argnames="steps")
def fly(model: DrydenFirstOrder, flight: Flight, key: Key, steps: int) -> jax.Array:
    """Gusts in units of their standard deviation, (1 + steps, 3, n), of vehicles in steady flight."""
    height, ground, wind = flight
    zero = jnp.zeros_like(height)
    ids, like = jnp.arange(height.shape[0], dtype=jnp.uint32), jnp.zeros((), height.dtype)
    stream = key.stream("turbulence", ids)
    first = model.init(Draw(key.stream("turbulence/start", ids), jnp.uint32(0), like))

    def tick(state: GustState, now: jax.Array) -> tuple[GustState, jax.Array]:
        draw = Draw(stream, now, like)
        state = model.step(state, draw, height, Vec3(ground, zero, zero), Vec3(wind, zero, zero), DT)
        return state, jnp.stack(jax.tree.leaves(state))

    rest = jax.lax.scan(tick, first, jnp.arange(1, steps + 1, dtype=jnp.uint32))[1]
    return jnp.concatenate([jnp.stack(jax.tree.leaves(first))[None], rest])


def coefficients(model: DrydenFirstOrder, height: Any, velocity: Any, wind: Any) -> tuple[Array, Array]:
    """Factors of the old gust and of the normals in one step, (n, 3) each, exact but for rounding."""
    heights = np.asarray(height, np.float32)
    one, zero = np.ones_like(heights), np.zeros_like(heights)

    def step(gust: Array, normal: Array) -> Array:
        state = GustState(Vec3(gust, gust, gust))  # type: ignore[arg-type]
        drawn = Drawn((normal, normal, normal))  # type: ignore[arg-type]
        return np.asarray(one_step(model, state, drawn, heights, vec(velocity), vec(wind)).gust.stack())

    return step(one, zero), step(zero, one)


@jax.jit
def one_step(model: Any, state: Any, drawn: Drawn, height: Any, velocity: Vec3, wind: Vec3) -> Any:
    return model.step(state, drawn, height, velocity, wind, DT)


def lengths_m(height: Any) -> Array:
    """Length scales [m], (n, 3), in double precision."""
    feet = np.clip(np.asarray(height, np.float64) / FOOT, 10.0, 1000.0)
    horizontal = feet / (0.177 + 0.000823 * feet) ** 1.2
    return np.stack([horizontal, horizontal, feet], axis=-1) * FOOT


class TestScales:
    def test_by_hand(self):
        feet, shape, horizontal, ratio = np.array(BY_HAND).T
        np.testing.assert_allclose(0.177 + 0.000823 * feet, shape, rtol=1e-12)
        lengths, ratios = jax.jit(low_altitude_scales)(np.asarray(feet * FOOT, np.float32))
        for found in (lengths.x, lengths.y):
            np.testing.assert_allclose(found, horizontal * FOOT, rtol=2e-6)
        np.testing.assert_allclose(lengths.z, feet * FOOT, rtol=1e-6)
        for found in (ratios.x, ratios.y):
            np.testing.assert_allclose(found, ratio, rtol=2e-6)
        np.testing.assert_array_equal(ratios.z, 1.0)

    def test_clamped_below_10_and_above_1000_ft(self):
        heights = np.asarray([-20.0, 0.0, 2.0, 10.0 * FOOT, 1000.0 * FOOT, 400.0, 1e4], np.float32)
        lengths, ratios = jax.jit(low_altitude_scales)(heights)
        for leaf in jax.tree.leaves((lengths, ratios)):
            np.testing.assert_allclose(leaf[:4], leaf[3], rtol=1e-6)
            np.testing.assert_allclose(leaf[4:], leaf[4], rtol=1e-6)

    def test_intensity_is_a_tenth_of_the_wind_at_20_ft(self):
        one = np.ones(5, np.float32)
        feet, _, _, ratio = np.array(BY_HAND, np.float32).T
        # Wind from the north: along the moving air is south, across is west.
        gust = jax.jit(DrydenFirstOrder.gust_ned)(cast(DRYDEN, np.float32), GustState(Vec3(one, one, one)), feet * FOOT)
        np.testing.assert_allclose(gust.x, -0.8 * ratio, rtol=3e-6)
        np.testing.assert_allclose(gust.y, -0.8 * ratio, rtol=3e-6)
        np.testing.assert_allclose(gust.z, 0.8, rtol=1e-6)


# Four groups of EACH vehicles.
EACH, STEPS = 2048, 200
HEIGHTS = np.array([10.0, 20.0, 100.0, 1000.0]) * FOOT
GROUND = np.array([0.0, 3.0, -10.0, 15.0])
WIND = np.array([4.0, 6.0, 2.0, 0.0])
AIRSPEED = np.array([4.0, 3.0, 12.0, 15.0])


@pytest.fixture(scope="module")
def gusts() -> Array:
    """Gusts of the exact form in units of their standard deviation, (1 + STEPS, 3, 4, EACH)."""
    flight = Flight(*(np.repeat(x, EACH).astype(np.float32) for x in (HEIGHTS, GROUND, WIND)))
    found = np.asarray(fly(cast(DRYDEN, np.float32), flight, Key.root(1), STEPS))
    assert found.dtype == np.float32
    return found.reshape(STEPS + 1, 3, 4, EACH)


class TestExactForm:
    def test_stationary_from_the_first_sample(self, gusts):
        # Were there a spin-up, the first samples would be small or the later ones large.
        assert_variances(np.moveaxis(gusts[[0, 1, 2, 10, 50, STEPS]], -1, 0), 1.0)

    def test_mean_is_zero(self, gusts):
        means = np.mean(gusts[[0, STEPS]], axis=-1)
        assert np.max(np.abs(means)) < z_limit(means.size) / math.sqrt(EACH)

    def test_autocorrelation_is_exponential(self, gusts):
        lags = np.array([1, 10, 50, 100, STEPS])
        products = np.mean(gusts[0] * gusts[lags], axis=-1)
        expected = np.exp(-lags[:, None, None] * DT * AIRSPEED / lengths_m(HEIGHTS).T)
        # The product of two standard normals of correlation r has variance 1 + r^2.
        z = (products - expected) / np.sqrt((1.0 + expected**2) / EACH)
        assert z.size == 60
        assert np.max(np.abs(z)) < z_limit(z.size)
        # The test can tell a process that is twice as fast.
        wrong = (products - expected**2) / np.sqrt((1.0 + expected**4) / EACH)
        assert np.max(np.abs(wrong)) > 2.0 * z_limit(z.size)

    def test_axes_are_independent(self, gusts):
        x = gusts.reshape(STEPS + 1, 3, -1)
        pairs = list(itertools.permutations(range(3), 2))
        found = [np.mean(x[0, a] * x[lag, b]) for a, b in pairs for lag in (0, 10, STEPS)]
        # At the same time later, when what drove them counts.
        found += [np.mean(x[STEPS, a] * x[STEPS, b]) for a, b in itertools.combinations(range(3), 2)]
        assert np.max(np.abs(found)) < z_limit(len(found)) / math.sqrt(x.shape[-1])

    def test_vehicles_are_independent(self, gusts):
        n = gusts.shape[-1]
        found = [
            np.mean(gusts[step][..., apart:] * gusts[step][..., :-apart], axis=-1)
            for step in (0, STEPS)
            for apart in (1, 2, 64)
        ]
        assert np.max(np.abs(found)) < z_limit(np.size(found)) / math.sqrt(n - 64)

    def test_coefficients(self):
        decay, spread = coefficients(
            cast(DRYDEN, np.float32), HEIGHTS, AIRSPEED[:, None] * [[0.6, 0.0, 0.8]], np.zeros((4, 3))
        )
        a = np.exp(-DT * AIRSPEED[:, None] / lengths_m(HEIGHTS))
        np.testing.assert_allclose(decay, a, rtol=1e-6)
        np.testing.assert_allclose(spread, np.sqrt(1.0 - a * a), rtol=1e-5)

    def test_stable_for_any_airspeed(self):
        # V T/L = 6.6 for the vertical axis: the recursion would multiply by -5.6.
        decay, spread = coefficients(cast(DRYDEN, np.float32), [3.0], [[1000.0, 0.0, 0.0]], [[0.0, 0.0, 0.0]])
        assert 0.0 < decay[0, 2] < 0.002
        np.testing.assert_allclose(decay**2 + spread**2, 1.0, rtol=1e-6)


class TestEulerForm:
    """The published recursion x' = (1 - x) g + sqrt(2 x) n, x = V T/L, has variance 1/(1 - x/2)."""

    EULER = replace(DRYDEN, discretisation="euler")

    @pytest.mark.parametrize("excess", [0.008, 0.05, 0.22])
    def test_coefficients_have_the_excess_that_theory_says(self, excess: float):
        # The two ends and one more of the published form's excess, for the vertical axis at 10 ft.
        x = 2.0 * (1.0 - 1.0 / (1.0 + excess))
        speed = x * 10.0 * FOOT / DT
        decay, spread = coefficients(cast(self.EULER, np.float32), [3.048], [[speed, 0.0, 0.0]], [[0.0, 0.0, 0.0]])
        each = DT * speed / lengths_m([3.048])
        np.testing.assert_allclose(decay, 1.0 - each, rtol=1e-6)
        np.testing.assert_allclose(spread, np.sqrt(2.0 * each), rtol=1e-5)
        assert each[0, 2] == pytest.approx(x, rel=1e-12)
        variance = float(spread[0, 2]) ** 2 / (1.0 - float(decay[0, 2]) ** 2)
        assert variance == pytest.approx(1.0 + excess, abs=1e-4)

    def test_variance_of_its_gusts(self):
        n, x = 16384, 0.3607
        speed = x * 10.0 * FOOT / DT
        fill = np.full(n, 10.0 * FOOT, np.float32)
        flight = Flight(fill, np.full_like(fill, speed), np.zeros_like(fill))
        # The slowest axis forgets its first value as (1 - 0.0477)^(2 k): to 2e-5 in 110 steps.
        end = np.asarray(fly(cast(self.EULER, np.float32), flight, Key.root(2), 110))[-1]
        each = DT * speed / lengths_m([3.048])[0]
        assert 1.0 / (1.0 - each[2] / 2.0) == pytest.approx(1.22, abs=1e-3)
        assert_variances(end.T, 1.0 / (1.0 - each / 2.0))
        # The vertical axis can be told from the exact form.
        with pytest.raises(AssertionError):
            assert_variances(end[2:].T, 1.0)


class TestAirspeed:
    """The speed shows in the decay: V = -L ln(a)/T."""

    CASES = (
        # velocity over ground, mean wind, relative airspeed, the reference's
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.5, 0.5),
        ((0.0, 0.0, 0.0), (-6.0, 8.0, 0.0), 10.0, 0.5),  # hovering in wind U sees U
        ((-6.0, 8.0, 0.0), (-6.0, 8.0, 0.0), 0.5, 10.5),  # drifting with the air
        ((3.0, 4.0, 0.0), (0.0, 0.0, 0.0), 5.0, 5.5),
        ((5.0, 0.0, -2.0), (3.0, -1.0, 0.0), 3.0, 0.5 + math.sqrt(29.0)),
        ((0.3, 0.0, 0.0), (0.0, 0.0, 0.0), 0.5, 0.8),  # slower than the least
    )

    @pytest.mark.parametrize(("airspeed", "column"), [("relative", 2), ("ground", 3)])
    def test_speed_that_carries_the_gusts_past(self, airspeed: Any, column: int):
        velocity, wind = (np.array([case[i] for case in self.CASES]) for i in (0, 1))
        height = np.full(len(self.CASES), 6.096)
        decay, _ = coefficients(cast(replace(DRYDEN, airspeed=airspeed), np.float32), height, velocity, wind)
        found = -lengths_m(height) * np.log(decay.astype(np.float64)) / DT
        # 1 - a is 2e-4 for the longest scale at 0.5 m/s, of which single precision keeps three digits.
        expected = np.array([case[column] for case in self.CASES])
        np.testing.assert_allclose(found[:, 2], expected, rtol=1e-4)
        np.testing.assert_allclose(found, np.tile(expected[:, None], 3), rtol=1e-3)


class TestRotation:
    @pytest.mark.parametrize("from_deg", [0.0, 90.0, 225.0, 300.0])
    def test_gusts_turn_with_the_bearing(self, from_deg: float):
        d, height = math.radians(from_deg), np.asarray([6.096, 304.8], np.float32)
        model = cast(replace(DRYDEN, wind_from_rad=d), np.float32)
        state = cast(GustState(Vec3(*(np.full(2, x) for x in (1.0, -2.0, 0.5)))), np.float32)  # type: ignore[arg-type]
        found = np.asarray(jax.jit(lambda m, s, h: m.gust_ned(s, h).stack())(model, state, height))
        along, across = np.array([-math.cos(d), -math.sin(d), 0.0]), np.array([math.sin(d), -math.cos(d), 0.0])
        for row, ratio in zip(found, (1.929139, 1.0), strict=True):
            expected = 0.8 * (ratio * (along - 2.0 * across) + 0.5 * np.array([0.0, 0.0, 1.0]))
            np.testing.assert_allclose(row, expected, atol=5e-6)

    def test_bearing_is_its_own_and_by_default_the_mean_winds(self):
        """The turbulence has its own bearing, a parameter; a scenario that leaves it out takes the wind's."""
        inherits = {field.name: field_info(field).inherits for field in dataclasses.fields(DrydenFirstOrder)}
        assert inherits["wind_from_rad"] == "world.wind.wind_from_rad"
        assert inherits["speed_20ft"] == "world.wind.speed_20ft"
        # The mean wind at the vehicle has no part in the gust's direction.
        state = cast(GustState(Vec3(*(np.ones(1) for _ in range(3)))), np.float32)  # type: ignore[arg-type]
        normals = Drawn((np.zeros(1, np.float32),) * 3)  # type: ignore[arg-type]
        model, height, still = cast(DRYDEN, np.float32), np.full(1, 20.0, np.float32), vec(np.zeros((1, 3)))
        north, east = (one_step(model, state, normals, height, still, vec([wind])) for wind in np.eye(3)[:2] * 5.0)
        for a, b in zip(jax.tree.leaves(north), jax.tree.leaves(east), strict=True):
            np.testing.assert_array_equal(a, b)

    def test_spread_in_ned(self):
        """Covariance in NED of 45 degrees: along and across share sigma, so it stays diagonal."""
        n = 8192
        ids = jnp.arange(n, dtype=jnp.uint32)
        model = cast(replace(DRYDEN, wind_from_rad=math.radians(225.0)), np.float32)

        @jax.jit
        def gusts(model: DrydenFirstOrder) -> jax.Array:
            draw = Draw(Key.root(3).stream("turbulence", ids), jnp.uint32(0), jnp.zeros((), jnp.float32))
            return model.gust_ned(model.init(draw), jnp.full(n, 6.096, jnp.float32)).stack()

        found = np.asarray(gusts(model))
        sigma = 0.8 * np.array([1.929139, 1.929139, 1.0])
        assert_variances(found, sigma**2)
        scaled = found / sigma
        mixed = [np.mean(scaled[:, a] * scaled[:, b]) for a, b in itertools.combinations(range(3), 2)]
        # 99.9 % over three products of independent standard normals.
        assert np.max(np.abs(mixed)) < z_limit(3) / math.sqrt(n)


def test_a_change_of_height_rescales_the_gust():
    state = cast(GustState(Vec3(*(np.full(2, 0.7) for _ in range(3)))), np.float32)  # type: ignore[arg-type]
    low_high = np.asarray([10.0 * FOOT, 1000.0 * FOOT], np.float32)
    gust = jax.jit(DrydenFirstOrder.gust_ned)(cast(DRYDEN, np.float32), state, low_high)
    assert float(gust.x[0] / gust.x[1]) == pytest.approx(1.962978, rel=1e-5)
    assert float(gust.z[0]) == float(gust.z[1])


def test_still_air_has_no_gust():
    state = Still().init(Drawn(()))
    height = np.asarray([0.0, 10.0], np.float32)
    velocity = vec(np.ones((2, 3)))
    assert Still.normals == 0
    gust = Still().gust_ned(one_step(Still(), state, Drawn(()), height, velocity, velocity), jnp.asarray(height))
    for axis in (gust.x, gust.y, gust.z):
        assert axis.dtype == np.float32
        np.testing.assert_array_equal(axis, np.zeros(2))


def test_slope_by_velocity_is_finite():
    """Also for a vehicle that moves with the air, where the airspeed has its least value."""

    def gust(velocity: jax.Array) -> jax.Array:
        one, height = jnp.ones(3, jnp.float32), jnp.full(3, 6.096, jnp.float32)
        wind = Vec3.of(jnp.asarray([[3.0, 0.0, 0.0]] * 3, jnp.float32))
        state = GustState(Vec3(one, one, one))
        after = DRYDEN.step(state, Drawn((one, one, one)), height, Vec3.of(velocity), wind, DT)
        return jnp.sum(DRYDEN.gust_ned(after, height).stack())

    slopes = jax.jit(jax.grad(gust))(np.asarray([[-5.0, 1.0, 0.0], [3.2, 0.0, 0.0], [3.0, 0.0, 0.0]], np.float32))
    assert np.all(slopes[0, :2] != 0.0)
    assert np.all(np.isfinite(slopes))
