"""GNSS: the navigation solution against nonlinear least squares, the sky's errors against theory, receivers."""

from __future__ import annotations

import itertools
import math
from functools import partial
from statistics import NormalDist
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy

from qrsim.core.noise import Draw, Key, Stream
from qrsim.core.tree import cast, quantity, record, replace
from qrsim.core.vectors import Vec3
from qrsim.models.gnss.orbits import NominalConstellation, dilution_of_precision, elevation_azimuth
from qrsim.models.gnss.receivers import (
    Fix,
    GnssReading,
    GnssReceiver,
    IdealGnss,
    OrnsteinUhlenbeckErrors,
    SharedSky,
    SkyState,
    solve_position,
)
from qrsim.models.site import Site

Array = np.ndarray[Any, Any]
F32 = np.float32
RECEIVER = cast(GnssReceiver(), F32)
NOISELESS = cast(GnssReceiver(range_noise_std=0.0), F32)  # type: ignore[arg-type]
# The code generator that compiles these programs in half the time.
jit = partial(jax.jit, compiler_options={"xla_cpu_use_fusion_emitters": False})


def z_limit(statistics: int) -> float:
    """Standard errors that none of so many statistics exceeds with 99.9 % confidence (Bonferroni)."""
    return NormalDist().inv_cdf(1.0 - 0.0005 / statistics)


def chi_squared_band(n: int, statistics: int = 1) -> tuple[float, float]:
    """Range of a variance of n standard normals of known mean, 99.9 % over so many statistics (Bonferroni)."""
    tails = [0.0005 / statistics, 1.0 - 0.0005 / statistics]
    low, high = scipy.stats.chi2.ppf(tails, n) / n
    return float(low), float(high)


def vec(array: Any, dtype: Any = F32) -> Vec3:
    """Vec3 of (...) from (..., 3)."""
    return Vec3(*np.moveaxis(np.asarray(array, dtype), -1, 0))  # type: ignore[arg-type]


def rows(v: Vec3) -> Array:
    """(..., 3) in double precision from a Vec3 of (...)."""
    return np.stack([np.asarray(v.x), np.asarray(v.y), np.asarray(v.z)], axis=-1).astype(np.float64)


def stream(seed: int, name: str, count: int) -> Stream:
    return Key.root(seed).stream(name, jnp.arange(count, dtype=jnp.uint32))


def at(source: Stream, tick: Any) -> Draw:
    return Draw(source, jnp.asarray(tick, jnp.uint32), jnp.zeros((), jnp.float32))


fix_of = jit(lambda receiver, source, tick, positions, sky: receiver.fix(at(source, tick), positions, sky))
fixes_of = jit(
    lambda receiver, source, positions, skies: jax.vmap(
        lambda sky: receiver.fix(at(source, 0), positions, sky)  # one draw for all skies
    )(skies)
)


@record
class DriftingSatellites:
    """Orbits for tests: satellites that move north at 1000 m/s."""

    start: Vec3 = quantity()

    def positions_ned(self, seconds: jax.Array, fraction: jax.Array) -> Vec3:
        """Return the positions at a time."""
        elapsed = seconds.astype(jnp.float32) + fraction
        return Vec3(self.start.x + 1000.0 * elapsed, self.start.y, self.start.z)


def satellites_at(gps_seconds: Any) -> Array:
    """The nominal constellation from the default site, (..., 24, 3) in NED."""
    return Site().ecef_to_ned(NominalConstellation().positions_ecef(gps_seconds))


# GPS seconds of 2010-08-27, and on from there in steps of two hours, so that the geometry differs.
START = 967_000_000.0
EPOCHS = START + 7200.0 * np.arange(12)
IDS = np.arange(24, dtype=np.uint32)
SKY = SharedSky(DriftingSatellites(vec(satellites_at(START))), cast(OrnsteinUhlenbeckErrors(), F32), IDS)  # type: ignore[arg-type]


def unit_vectors(rng: np.random.Generator, count: int, lowest: float) -> Array:
    """Directions spread over the sky above an elevation [rad], (count, 3) in NED."""
    up = rng.uniform(math.sin(lowest), 1.0, count)
    azimuth = rng.uniform(0.0, 2.0 * math.pi, count)
    level = np.sqrt(1.0 - up * up)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), -up], axis=-1)


def nonlinear_fix(satellites: Array, pseudorange: Array, guess: Array) -> Array:
    """Position (3,) by full nonlinear least squares on position and clock, in double precision."""

    def residual(x: Array) -> Array:
        return np.linalg.norm(satellites - x[:3], axis=-1) + x[3] - pseudorange

    def jacobian(x: Array) -> Array:
        ray = x[:3] - satellites
        return np.column_stack([ray / np.linalg.norm(ray, axis=-1, keepdims=True), np.ones(len(ray))])

    x = scipy.optimize.least_squares(residual, np.append(guess, 0.0), jacobian, method="lm").x
    for _ in range(2):  # the library stops at 1e-5 m
        x = x - np.linalg.lstsq(jacobian(x), residual(x))[0]
    # At the optimum the gradient is zero but for the rounding of the ranges, 4e-9 m each.
    assert np.max(np.abs(jacobian(x).T @ residual(x))) < 1e-7
    return x[:3]


# Receivers up to 1.5 km from the site's origin.
RECEIVERS = np.array([[0.0, 0.0, -10.0], [400.0, -300.0, -60.0], [-1000.0, 1000.0, -120.0]])


@pytest.fixture(scope="module")
def skies() -> SkyState:
    """Satellites at EPOCHS with range errors of 4 m, (12, 24) each."""
    errors = np.random.default_rng(1).normal(0.0, 4.0, (len(EPOCHS), 24)).astype(F32)
    return SkyState(vec(satellites_at(EPOCHS)), errors)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def fixes(skies: SkyState) -> Fix:
    """Fixes of RECEIVERS under all skies, (12, 3) each, without receiver noise."""
    return jax.tree.map(np.asarray, fixes_of(NOISELESS, stream(0, "gnss", 3), vec(RECEIVERS), skies))


def rays(skies: SkyState) -> Array:
    """Satellite minus receiver in double precision, (12, 3, 24, 3)."""
    return rows(skies.satellites_ned)[:, None] - RECEIVERS[None, :, None]


def seen(skies: SkyState, mask: float = math.radians(10.0)) -> Array:
    """Which satellites are above the mask, (12, 3, 24)."""
    elevation = elevation_azimuth(rays(skies))[0]
    # No satellite so near to the mask that single precision could decide otherwise.
    assert np.min(np.abs(elevation - mask)) > 1e-6
    return elevation > mask


class TestSolution:
    def test_against_nonlinear_least_squares(self, skies, fixes):
        """Under 1 mm at offsets up to 20 m; the reference also has a clock of 30 m to solve for."""
        found, used = rows(fixes.offset_ned), seen(skies)
        worst, offsets = 0.0, []
        for i, j in itertools.product(range(len(EPOCHS)), range(len(RECEIVERS))):
            satellites = (rays(skies)[i, j] + RECEIVERS[j])[used[i, j]]
            pseudorange = np.linalg.norm(satellites - RECEIVERS[j], axis=-1)
            pseudorange += skies.range_error[i, used[i, j]].astype(np.float64) + 30.0
            expected = nonlinear_fix(satellites, pseudorange, RECEIVERS[j]) - RECEIVERS[j]
            offsets.append(np.linalg.norm(expected))
            worst = max(worst, float(np.linalg.norm(found[i, j] - expected)))
        assert 15.0 < max(offsets) < 20.0
        # 1 mm is allowed; single precision leaves some 1e-5 m.
        assert worst < 1e-4

    def test_what_is_neglected_is_the_square_of_the_offset_over_twice_the_range(self):
        """In double precision, where rounding does not hide it: 1e-5 m per range at 20 m."""
        rng = np.random.default_rng(2)
        with jax.enable_x64(True):
            solve = jit(solve_position)
            for scale in (2.0, 20.0):
                directions = unit_vectors(rng, 9, 0.2)
                satellites, offset = 2.2e7 * directions, scale * unit_vectors(rng, 1, -1.0)[0]
                # Errors that are exactly an offset: the nonlinear solution is the offset itself.
                errors = np.linalg.norm(satellites - offset, axis=-1) - 2.2e7
                fix = solve(vec(directions[:, None], float), errors[:, None], np.ones((9, 1), bool))
                missed = np.abs(np.array([leaf[0] for leaf in jax.tree.leaves(fix.offset_ned)]) - offset)
                # The ranges' errors count as many times as the dilution of precision says.
                worst = scale**2 / (2.0 * 2.2e7) * math.sqrt(9) * dilution_of_precision(directions)[2]
                assert 0.0 < np.max(missed) < worst

    def test_dilution_of_precision(self, skies, fixes):
        used, lines = seen(skies), rays(skies)
        lines /= np.linalg.norm(lines, axis=-1, keepdims=True)
        for i, j in itertools.product(range(len(EPOCHS)), range(len(RECEIVERS))):
            hdop, vdop, _, _ = dilution_of_precision(lines[i, j, used[i, j]])
            assert float(fixes.hdop[i, j]) == pytest.approx(hdop, rel=1e-4)
            assert float(fixes.vdop[i, j]) == pytest.approx(vdop, rel=1e-4)

    def test_counts_the_satellites_above_the_mask(self, skies, fixes):
        np.testing.assert_array_equal(fixes.satellites, np.sum(seen(skies), axis=-1))
        assert 5 <= np.min(fixes.satellites) < np.max(fixes.satellites) <= 12

    @pytest.mark.long
    def test_a_clock_error_changes_nothing(self):
        rng = np.random.default_rng(3)
        lines = np.repeat(unit_vectors(rng, 8, 0.2)[:, None], 4, axis=1)
        errors = np.add.outer(rng.normal(0.0, 3.0, 8), [0.0, 1.0, -300.0, 300.0])
        fix = jit(solve_position)(vec(lines), errors.astype(F32), np.ones((8, 4), bool))
        for axis in jax.tree.leaves(fix.offset_ned):
            # A range of 300 m is rounded to 3e-5 m.
            np.testing.assert_allclose(axis, axis[0], atol=3e-4)
            assert abs(axis[0]) > 0.01

    @pytest.mark.parametrize("precision", ["float32", "float64"])
    def test_fewer_than_four_satellites_give_no_fix(self, precision: str):
        with jax.enable_x64(precision == "float64"):
            lines = unit_vectors(np.random.default_rng(4), 6, 0.3)
            used = np.tri(7, 6, -1, dtype=bool).T  # none, one, ... six
            errors = np.full((6, 7), 2.0, precision)
            fix = jit(solve_position)(vec(np.repeat(lines[:, None], 7, axis=1), precision), errors, used)
        np.testing.assert_array_equal(fix.satellites, np.arange(7.0))
        for value in (*jax.tree.leaves(fix.offset_ned), fix.hdop, fix.vdop):
            assert value.dtype == precision
            np.testing.assert_array_equal(np.isnan(value), [True] * 4 + [False] * 3)

    def test_a_satellite_without_a_position_is_left_out(self, skies):
        """An ephemeris may have gaps, where its positions are NaN: as good as below the horizon."""
        k = int(np.flatnonzero(seen(skies)[0, 0])[0])
        gone, low = (rows(skies.satellites_ned) for _ in range(2))
        gone[:, k], low[:, k] = math.nan, [2e7, 0.0, 1e7]
        without, expected = (
            fixes_of(NOISELESS, stream(0, "gnss", 3), vec(RECEIVERS), replace(skies, satellites_ned=vec(positions)))
            for positions in (gone, low)
        )
        for a, b in zip(jax.tree.leaves(without), jax.tree.leaves(expected), strict=True):
            assert np.all(np.isfinite(b))
            np.testing.assert_array_equal(a, b)

    def test_receivers_do_not_touch_each_other(self):
        """A receiver without a fix, or at no position at all, leaves the others theirs."""
        rng = np.random.default_rng(5)
        lines = np.repeat(unit_vectors(rng, 7, 0.2)[:, None], 3, axis=1)
        errors, used = np.repeat(rng.normal(size=(7, 1)), 3, axis=1).astype(F32), np.ones((7, 3), bool)
        solve = jit(solve_position)
        alone = solve(vec(lines), errors, used)
        used[2:, 0], lines[:, 2] = False, math.nan
        mixed = solve(vec(lines), errors, used)
        for a, b in zip(jax.tree.leaves(alone), jax.tree.leaves(mixed), strict=True):
            np.testing.assert_array_equal(a[1], b[1])
        assert np.isnan(mixed.offset_ned.x[0])
        assert np.isnan(mixed.offset_ned.x[2])


class TestMask:
    def test_each_receiver_has_its_own(self, skies):
        masks = np.radians([5.0, 25.0, 80.0])
        receiver = cast(GnssReceiver(elevation_mask_rad=masks), F32)  # type: ignore[arg-type]
        one_place = vec(np.repeat(RECEIVERS[:1], 3, axis=0))
        found = fixes_of(receiver, stream(0, "gnss", 3), one_place, skies)
        for k, mask in enumerate(masks):
            np.testing.assert_array_equal(found.satellites[:, k], np.sum(seen(skies, mask)[:, 0], axis=-1))
        # Hardly a satellite stands above 80 degrees: a count, but no fix.
        assert np.all(found.satellites[:, 2] < 4)
        assert np.all(np.isnan(found.offset_ned.x[:, 2]))
        assert np.all(np.isfinite(found.offset_ned.x[:, 0]))


@partial(jit, static_argnames="steps")
def error_path(errors: OrnsteinUhlenbeckErrors, begin: Stream, source: Stream, steps: int) -> jax.Array:
    """Range errors, (1 + steps, n), at the sky's period of 0.2 s."""
    first = errors.init(at(begin, 0))

    def tick(value: jax.Array, now: jax.Array) -> tuple[jax.Array, jax.Array]:
        value = errors.step(value, at(source, now), 0.2)
        return value, value

    return jnp.concatenate([first[None], jax.lax.scan(tick, first, jnp.arange(1, steps + 1, dtype=jnp.uint32))[1]])


def errors_of(errors: OrnsteinUhlenbeckErrors, seed: int, count: int, steps: int) -> Array:
    found = error_path(cast(errors, F32), stream(seed, "sky/start", count), stream(seed, "sky", count), steps)
    assert found.dtype == F32
    return np.asarray(found)


@pytest.fixture(scope="module")
def path() -> Array:
    """Range errors of 8192 satellites with the default parameters, (2001, 8192), in units of 12.35 m."""
    return errors_of(OrnsteinUhlenbeckErrors(), 1, 8192, 2000) / 12.35


class TestRangeErrors:
    """Of 8192 satellites over 400 s, a fifth of the time constant."""

    N, STEPS, STD, TAU = 8192, 2000, 12.35, 2000.0

    @pytest.mark.long
    def test_stationary_from_the_first_epoch(self, path):
        low, high = chi_squared_band(self.N, 3)
        for epoch in (0, 1, self.STEPS):
            assert low < np.mean(path[epoch] ** 2) < high
        assert abs(np.mean(path[0])) < z_limit(1) / math.sqrt(self.N)

    def test_change_per_epoch(self):
        """0.1746 m, as in the reference: std sqrt(2 (1 - a))."""
        expected = self.STD * math.sqrt(2.0 * -math.expm1(-0.2 / self.TAU))
        assert round(expected, 4) == 0.1747
        assert round(self.STD * math.sqrt(-math.expm1(-0.4 / self.TAU)), 4) == 0.1746
        path = errors_of(OrnsteinUhlenbeckErrors(), 1, self.N, 200) / self.STD
        changes = self.STD * np.diff(path.astype(np.float64), axis=0)
        # Squared changes of one satellite are uncorrelated to 1e-8, so that all of them count.
        low, high = chi_squared_band(changes.size)
        # Single precision keeps 1 - a = 1e-4 to 3e-8.
        assert low - 3e-4 < np.mean(changes**2) / expected**2 < high + 3e-4

    @pytest.mark.long
    def test_time_constant(self, path):
        """Recovered from the regression over 400 s, with 99.9 % confidence to 13 %."""
        first, last = path[0].astype(np.float64), path[-1].astype(np.float64)
        slope, lag = np.sum(first * last) / np.sum(first**2), 0.2 * self.STEPS
        r = math.exp(-lag / self.TAU)
        # The slope has variance (1 - r^2)/n, and tau = -lag/ln(slope).
        relative = math.sqrt((1.0 - r * r) / self.N) / r * self.TAU / lag
        assert z_limit(1) * relative == pytest.approx(0.128, abs=1e-3)
        assert abs(-lag / math.log(slope) / self.TAU - 1.0) < z_limit(1) * relative

    @pytest.mark.long
    def test_autocorrelation(self, path):
        for epochs in (500, self.STEPS):
            r = math.exp(-0.2 * epochs / self.TAU)
            # Of two standard normals of correlation r the product has mean r and variance 1 + r^2.
            error = math.sqrt((1.0 + r * r) / self.N)
            assert abs(np.mean(path[0] * path[epochs]) - r) < z_limit(2) * error

    @pytest.mark.long
    def test_satellites_are_independent(self, path):
        found = [np.mean(path[e, apart:] * path[e, :-apart]) for e in (0, self.STEPS) for apart in (1, 2, 24)]
        # Also what drives them later, where the first values have no part.
        driven = (path[-1] - math.exp(-0.2) * path[0]) / math.sqrt(-math.expm1(-0.4))
        found += [np.mean(driven[apart:] * driven[:-apart]) for apart in (1, 2, 24)]
        assert np.max(np.abs(found)) < z_limit(9) / math.sqrt(self.N - 24)

    def test_own_parameters(self):
        found = errors_of(OrnsteinUhlenbeckErrors(2.0, 0.4), 2, 8192, 10)  # type: ignore[arg-type]
        low, high = chi_squared_band(8192, 2)
        assert low < np.mean((found[0] / 2.0) ** 2) < high
        assert low < np.mean((found[10] / 2.0) ** 2) < high
        r = math.exp(-0.5)
        assert abs(np.mean(found[9] * found[10]) / 4.0 - r) < z_limit(1) * math.sqrt((1.0 + r * r) / 8192)


class TestSky:
    def test_steps_satellites_and_errors(self):
        @jit
        def two(begin: Stream, source: Stream) -> tuple[SkyState, SkyState]:
            first = SKY.init(at(begin, 0))
            return first, SKY.step(first, at(source, 30), jnp.int32(6), jnp.asarray(0.25, jnp.float32))

        first, second = two(stream(3, "sky/start", 24), stream(3, "sky", 24))
        start = rows(SKY.orbits.start)  # type: ignore[attr-defined]
        # A float of 2e7 m counts in steps of 2 m.
        np.testing.assert_allclose(rows(first.satellites_ned), start, atol=2.0)
        np.testing.assert_allclose(rows(second.satellites_ned), start + np.array([6250.0, 0.0, 0.0]), atol=2.0)
        assert first.range_error.shape == second.range_error.shape == (24,)
        # One period moves the errors by 0.17 m each, whatever the time.
        change = np.asarray(second.range_error) - np.asarray(first.range_error)
        assert np.all((change != 0.0) & (np.abs(change) < 1.0))
        np.testing.assert_array_equal(first.range_rate_error, 0.0)
        # A float of 10 m counts in steps of 1e-6 m.
        np.testing.assert_allclose(second.range_rate_error, change / 0.2, atol=2e-5)


PLACES = np.array([[0.0, 0.0, -10.0], [50.0, 0.0, -10.0]])


@pytest.fixture(scope="module")
def world_errors() -> Array:
    """Position errors [m] of two receivers 50 m apart in 1024 worlds of one seed, (1024, 2, 3)."""
    ids = jnp.arange(2, dtype=jnp.uint32)

    def world(index: jax.Array) -> Vec3:
        key = Key.root(5, index)
        sky = SKY.init(at(key.stream("sky/start", IDS), 0))  # type: ignore[arg-type]
        return RECEIVER.fix(at(key.stream("gnss", ids), 0), vec(PLACES), sky).offset_ned

    return rows(jit(jax.vmap(world))(jnp.arange(1024, dtype=jnp.uint32)))


def correlation(x: Array, y: Array) -> float:
    return float(np.corrcoef(x, y)[0, 1])


class TestSharing:
    def test_receivers_of_one_world_share_their_errors(self, world_errors):
        assert np.all(np.std(world_errors, axis=0) > 3.0)
        for axis in range(3):
            # Only 2 mm of range noise and 2e-6 rad of geometry are a receiver's own.
            assert correlation(world_errors[:, 0, axis], world_errors[:, 1, axis]) > 0.9999

    def test_but_not_all_of_them(self, world_errors):
        own = world_errors[:, 1] - world_errors[:, 0]
        # 2 mm of range noise each, times a dilution of precision of 1 to 3, and the geometry's 1e-4 m.
        assert np.all((np.std(own, axis=0) > 0.001) & (np.std(own, axis=0) < 0.02))

    def test_worlds_do_not(self, world_errors):
        # World 0 against world 1, 2 against 3, and so on; and two apart. 99.9 % over six correlations.
        limit = z_limit(6) / math.sqrt(512)
        for axis in range(3):
            x = world_errors[:, 0, axis]
            assert abs(correlation(x[0::2], x[1::2])) < limit
            assert abs(correlation(x[0::4], x[2::4])) < limit * math.sqrt(2.0)

    def test_spread_is_what_the_geometry_makes_of_the_range_errors(self, world_errors):
        """HDOP and VDOP times 12.35 m: 99.9 % over both."""
        lines = satellites_at(START) - PLACES[0]
        lines /= np.linalg.norm(lines, axis=-1, keepdims=True)
        hdop, vdop, _, _ = dilution_of_precision(lines[elevation_azimuth(lines)[0] > math.radians(10.0)])
        squares = np.mean(world_errors[:, 0].astype(np.float64) ** 2, axis=0)
        low, high = chi_squared_band(1024, 2)
        assert low < squares[2] / (12.35 * vdop) ** 2 < high
        # North and east together have at least the 1024 degrees of freedom of one of them.
        assert low < (squares[0] + squares[1]) / (12.35 * hdop) ** 2 < high


@pytest.fixture(scope="module")
def noise_fixes() -> list[Fix]:
    """Two fixes of 4096 receivers at one place under a sky without errors, with range noise of 1 m."""
    receiver = cast(GnssReceiver(range_noise_std=1.0), F32)  # type: ignore[arg-type]
    sky = SkyState(vec(satellites_at(START)), np.zeros(24, F32))  # type: ignore[arg-type]
    source, place = stream(6, "gnss", 4096), vec(np.zeros((4096, 3)))
    return [fix_of(receiver, source, np.uint32(tick), place, sky) for tick in (10, 20)]


class TestRangeNoise:
    N = 4096

    def test_spread_is_the_dilution_of_precision(self, noise_fixes):
        low, high = chi_squared_band(self.N, 4)
        for fix in noise_fixes:
            squares = np.mean(rows(fix.offset_ned) ** 2, axis=0)
            assert low < squares[2] / float(fix.vdop[0]) ** 2 < high
            # North and east together have at least the degrees of freedom of one of them.
            assert low < (squares[0] + squares[1]) / float(fix.hdop[0]) ** 2 < high

    def test_independent_between_vehicles_and_epochs(self, noise_fixes):
        first, second = (rows(fix.offset_ned) / np.std(rows(fix.offset_ned), axis=0) for fix in noise_fixes)
        found = [np.mean(first[apart:] * first[:-apart], axis=0) for apart in (1, 2, 64)]
        found.append(np.mean(first * second, axis=0))
        assert np.max(np.abs(found)) < z_limit(12) / math.sqrt(self.N - 64)


@pytest.fixture(scope="module")
def flights() -> tuple[Array, dict[int, GnssReading]]:
    """Readings of receivers with delays of 0, 1 and 3 periods, (11, 2) each, that saw the same 11 epochs.

    Also the true positions (11, 2, 3): one vehicle flies at 3, -2, 1 m/s, the other stays. Row 0 is the first reading.
    """
    receivers = {delay: replace(RECEIVER, delay=delay) for delay in (0, 1, 3)}
    velocity = vec([[3.0, -2.0, 1.0], [0.0, 0.0, 0.0]])
    origin = vec([[0.0, 0.0, -50.0], [50.0, 10.0, -20.0]])

    @jit
    def run(sky_start: Stream, sky_later: Stream, own: Stream) -> tuple[Vec3, dict[int, GnssReading]]:
        sky = SKY.init(at(sky_start, 0))
        begun = {delay: r.init(at(own, 0), origin, velocity, sky) for delay, r in receivers.items()}

        def epoch(carry: Any, tick: jax.Array) -> Any:
            sky, states = carry
            time = tick.astype(jnp.float32) * 0.2
            sky = SKY.step(sky, at(sky_later, tick), jnp.int32(0), time)
            here = origin + velocity * time
            stepped = {d: r.step(states[d], at(own, tick), here, velocity, sky) for d, r in receivers.items()}
            states, readings = ({d: pair[i] for d, pair in stepped.items()} for i in (0, 1))
            return (sky, states), (here, readings)

        states, first = ({d: pair[i] for d, pair in begun.items()} for i in (0, 1))
        later = jax.lax.scan(epoch, (sky, states), jnp.arange(1, 11, dtype=jnp.uint32))[1]
        return jax.tree.map(lambda a, b: jnp.concatenate([jnp.asarray(a)[None], b]), (origin, first), later)

    places, readings = run(stream(7, "sky/start", 24), stream(7, "sky", 24), stream(7, "gnss", 2))
    return rows(places), jax.tree.map(np.asarray, readings)


class TestReceiver:
    @pytest.mark.parametrize("delay", [1, 3])
    def test_a_fix_is_reported_exactly_so_many_periods_late(self, flights, delay: int):
        prompt, late = flights[1][0], flights[1][delay]
        for a, b in zip(jax.tree.leaves(prompt), jax.tree.leaves(late), strict=True):
            np.testing.assert_array_equal(b[delay:], a[:-delay])
            # Before that it is the first fix, as if it had been reported for a while.
            np.testing.assert_array_equal(b[:delay], np.repeat(a[:1], delay, axis=0))

    def test_default_delay_is_one_period(self):
        assert GnssReceiver().delay == 1

    def test_position_follows_the_vehicle(self, flights):
        truth, readings = flights
        errors = rows(readings[0].position_ned) - truth
        # The error is metres, but over two seconds it hardly changes: by 0.17 m per epoch and range.
        assert np.max(np.abs(errors)) > 1.0
        assert np.max(np.ptp(errors, axis=0)) < 5.0
        # An undelayed fix less the truth is nearly the same for both vehicles.
        assert np.max(np.abs(errors[:, 0] - errors[:, 1])) < 0.05

    def test_velocity_is_the_difference_of_successive_fixes(self, flights):
        reading = flights[1][0]
        difference = np.diff(rows(reading.position_ned), axis=0) / 0.2
        # Positions of 50 m are rounded to 4e-6 m, which the period of 0.2 s makes 4e-5 m/s.
        np.testing.assert_allclose(rows(reading.velocity_ned)[1:], difference, atol=1e-4)
        # It has the errors' changes in it: not the true velocity, but near it.
        assert np.max(np.abs(rows(reading.velocity_ned)[1:, 1])) > 0.1

    def test_first_velocity_is_the_true_one(self, flights):
        np.testing.assert_array_equal(rows(flights[1][0].velocity_ned)[0], [[3.0, -2.0, 1.0], [0.0, 0.0, 0.0]])

    def test_velocity_uses_the_receivers_own_period(self, skies):
        """Two receivers that differ in their period only, moved by 1 m between two fixes."""

        @jit
        def speeds(sky: SkyState, own: Stream) -> list[jax.Array]:
            found = []
            for period in (0.2, 1.0):
                receiver = replace(NOISELESS, period=period, delay=0)
                still = vec(np.zeros((1, 3)))
                state, _ = receiver.init(at(own, 0), still, still, sky)
                moved = vec([[1.0, 0.0, 0.0]])
                found.append(receiver.step(state, at(own, 1), moved, still, sky)[1].velocity_ned.x)
            return found

        fast, slow = speeds(jax.tree.map(lambda leaf: leaf[0], skies), stream(0, "gnss", 1))
        assert float(fast[0]) == pytest.approx(5.0, abs=1e-3)
        assert float(slow[0]) == pytest.approx(1.0, abs=1e-3)


DOPPLER_SPEED = np.array([4.0, -3.0, 0.5])
DIRECTIONS = satellites_at(START) / np.linalg.norm(satellites_at(START), axis=-1, keepdims=True)


@jit
def doppler_reading(receiver: GnssReceiver, sky: SkyState, own: Stream) -> GnssReading:
    place = vec(np.zeros((4096, 3)))
    velocity = vec(np.tile(DOPPLER_SPEED, (4096, 1)))
    state, _ = receiver.init(at(own, 0), place, velocity, sky)
    return receiver.step(state, at(own, 10), place, velocity, sky)[1]


class TestDoppler:
    """4096 receivers at one place; the range rates' errors are given, or white noise of 1 m/s."""

    N = 4096

    @pytest.fixture
    def reading(self, request: pytest.FixtureRequest) -> GnssReading:
        std, rates = request.param
        receiver = GnssReceiver(velocity="doppler", delay=0, range_noise_std=0.0, doppler_noise_std=std)  # type: ignore[arg-type]
        sky = SkyState(vec(satellites_at(START)), np.zeros(24, F32), np.asarray(rates, F32))  # type: ignore[arg-type]
        found = doppler_reading(cast(receiver, F32), sky, stream(8, "gnss", self.N))
        return jax.tree.map(np.asarray, found)

    @pytest.mark.parametrize("reading", [(1.0, np.zeros(24))], indirect=True)
    def test_spread_is_the_dilution_of_precision(self, reading):
        error = rows(reading.velocity_ned) - DOPPLER_SPEED
        squares = np.mean(error**2, axis=0)
        low, high = chi_squared_band(self.N, 2)
        assert low < squares[2] / float(reading.vdop[0]) ** 2 < high
        assert low < (squares[0] + squares[1]) / float(reading.hdop[0]) ** 2 < high
        scaled = error / np.std(error, axis=0)
        found = [np.mean(scaled[apart:] * scaled[:-apart], axis=0) for apart in (1, 2, 64)]
        assert np.max(np.abs(found)) < z_limit(9) / math.sqrt(self.N - 64)

    @pytest.mark.parametrize("reading", [(0.0, -DIRECTIONS @ [0.3, -0.2, 0.1])], indirect=True)
    def test_drifting_range_errors_are_a_velocity(self, reading):
        """Range rates of -u . d are a velocity error of d."""
        found = rows(reading.velocity_ned) - DOPPLER_SPEED
        np.testing.assert_allclose(found, np.tile([0.3, -0.2, 0.1], (self.N, 1)), atol=2e-6)

    @pytest.mark.parametrize("reading", [(0.0, np.full(24, 5.0))], indirect=True)
    def test_a_drifting_clock_is_none(self, reading):
        np.testing.assert_allclose(rows(reading.velocity_ned), np.tile(DOPPLER_SPEED, (self.N, 1)), atol=1e-4)


@pytest.fixture(scope="module")
def listed() -> tuple[Array, Array, GnssReading]:
    """Which of PRN 1 to 32 4096 receivers with the hand list keep, (2, 32, 4096): first and later; and their counts.

    The sky has errors of 3 m; every satellite has a position, but only half of them are above the horizon.
    """
    receiver = cast(GnssReceiver(satellites="hand_list", delay=0), F32)
    positions = 2.2e7 * unit_vectors(np.random.default_rng(9), 32, -1.5)
    errors, numbers = np.random.default_rng(10).normal(0.0, 3.0, 32), np.arange(1, 33, dtype=np.uint32)
    # Letters of other systems, in the upper byte, do not matter.
    sky = SkyState(vec(positions), errors.astype(F32), ids=numbers + np.uint32(7 * 256))  # type: ignore[arg-type]

    @jit
    def run(own: Stream) -> Any:
        still = vec(np.zeros((4096, 3)))
        state, first = receiver.init(at(own, 0), still, still, sky)
        later, second = receiver.step(state, at(own, 10), still, still, sky)
        return jnp.stack([state.listed, later.listed]), jnp.stack([first.satellites, second.satellites]), second

    kept, counts, reading = run(stream(9, "gnss", 4096))
    return np.asarray(kept), np.asarray(counts), jax.tree.map(np.asarray, reading)


class TestHandList:
    def test_keeps_10_to_13_of_the_list_for_the_whole_run(self, listed):
        kept, counts, _ = listed
        np.testing.assert_array_equal(kept[0], kept[1])
        prn = np.arange(1, 33)
        assert set(prn[np.any(kept[0], axis=1)]) == {3, 5, 6, 7, 13, 16, 18, 19, 20, 22, 24, 29, 31}
        np.testing.assert_array_equal(counts, np.sum(kept, axis=1))
        assert set(np.unique(counts)) == {10.0, 11.0, 12.0, 13.0}

    def test_each_number_and_each_satellite_is_equally_likely(self, listed):
        kept, counts, _ = listed
        # Pearson's chi-squared, 99.9 %.
        assert scipy.stats.chisquare(np.unique(counts[0], return_counts=True)[1]).pvalue > 0.001
        # Each satellite is kept in 11.5/13 of the cases: 99.9 % over the 13.
        share = np.mean(kept[0][np.any(kept[0], axis=1)], axis=1)
        p = 11.5 / 13.0
        assert np.max(np.abs(share - p)) < z_limit(13) * math.sqrt(p * (1.0 - p) / 4096)

    def test_receivers_choose_for_themselves(self, listed):
        chosen = {tuple(column) for column in listed[0][0].T}
        # 1 way to leave out none of 13, 13 for one, 78 for two, 286 for three: 378. Of the last, 1024 receivers miss
        # 286 exp(-1024/286) = 8 or so.
        assert 360 < len(chosen) <= 378

    def test_uses_satellites_below_the_horizon_too(self, listed):
        assert np.all(np.isfinite(rows(listed[2].position_ned)))
        # The spread between receivers comes from their choice alone: metres.
        assert np.all(np.std(rows(listed[2].position_ned), axis=0) > 0.1)


class TestIdeal:
    def test_is_the_truth_at_once(self, skies):
        sky = jax.tree.map(lambda leaf: leaf[0], skies)
        ideal = IdealGnss()
        assert ideal.period == GnssReceiver().period

        @jit
        def readings(position: Vec3, velocity: Vec3, own: Stream) -> tuple[GnssReading, GnssReading]:
            state, first = ideal.init(at(own, 0), position, velocity, sky)
            return first, ideal.step(state, at(own, 1), position + velocity, -velocity, sky)[1]

        position, velocity = vec([[1.0, 2.0, -3.0], [4.0, 5.0, -6.0]]), vec([[0.5, 0.25, 1.0], [0.0, -2.0, 0.0]])
        first, second = readings(position, velocity, stream(0, "gnss", 2))
        for reading, place, speed in ((first, position, velocity), (second, position + velocity, -velocity)):
            np.testing.assert_array_equal(rows(reading.position_ned), rows(place))
            np.testing.assert_array_equal(rows(reading.velocity_ned), rows(speed))
