"""The attitude estimate: three Ornstein-Uhlenbeck errors of stated spread and time constant."""

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

from qrsim.core.noise import Draw, Drawn, Key, Stream
from qrsim.core.tree import cast, replace
from qrsim.core.vectors import Euler
from qrsim.models.sensors.attitude import AttitudeEstimator, AttitudeReading, IdealAttitude

Array = np.ndarray[Any, Any]
STD, TAU, PERIOD = 0.00354, 100.0, 0.02
VEHICLES, STEPS = 4096, 1000  # 20 s
# Large enough to matter, small enough that single precision keeps the errors: 0.25 is rounded to 1.5e-8.
TRUTH = (0.1, -0.2, 0.25)


def z_limit(statistics: int) -> float:
    """Standard errors that none of so many statistics exceeds with 99.9 % confidence (Bonferroni)."""
    return NormalDist().inv_cdf(1.0 - 0.0005 / statistics)


def chi_squared_band(n: int, statistics: int = 1) -> tuple[float, float]:
    """Range of a variance of n standard normals of known mean, 99.9 % over so many statistics (Bonferroni)."""
    low, high = scipy.stats.chi2.ppf([0.0005 / statistics, 1.0 - 0.0005 / statistics], n) / n
    return float(low), float(high)


def truth(n: int) -> Euler:
    return Euler(*(np.full(n, angle, np.float32) for angle in TRUTH))  # type: ignore[arg-type]


@partial(jax.jit, static_argnames="steps")
def estimate(sensor: Any, begin: Stream, source: Stream, attitude: Euler, steps: int) -> AttitudeReading:
    """Estimates, (1 + steps, n) each, of vehicles that hold an attitude."""
    like = jnp.zeros((), attitude.roll.dtype)
    state, first = sensor.init(Draw(begin, jnp.uint32(0), like), attitude)

    def tick(state: Any, now: jax.Array) -> tuple[Any, AttitudeReading]:
        return sensor.step(state, Draw(source, now, like), attitude)

    later = jax.lax.scan(tick, state, jnp.arange(1, steps + 1, dtype=jnp.uint32))[1]
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, later)


@pytest.fixture(scope="module")
def errors(optimising: Any) -> Array:
    """Errors in units of 0.00354 rad, (1 + STEPS, 3, VEHICLES)."""
    ids, key = jnp.arange(VEHICLES, dtype=jnp.uint32), Key.root(1)
    sensor = cast(AttitudeEstimator(), np.float32)
    with optimising():
        reading = estimate(sensor, key.stream("ins/start", ids), key.stream("ins", ids), truth(VEHICLES), STEPS)
    angles = [np.asarray(angle) for angle in jax.tree.leaves(reading)]
    assert all(angle.dtype == np.float32 for angle in angles)
    return np.stack(angles, axis=1) / STD - np.array(TRUTH, np.float32).astype(float)[None, :, None] / STD


@pytest.mark.long
def test_stationary_from_the_first_reading(errors):
    low, high = chi_squared_band(VEHICLES, 12)
    for step in (0, 1, 50, STEPS):
        variances = np.mean(errors[step] ** 2, axis=-1)
        assert np.all((low < variances) & (variances < high)), variances
    assert np.max(np.abs(np.mean(errors[0], axis=-1))) < z_limit(3) / math.sqrt(VEHICLES)


def test_time_constant(errors):
    """Recovered from the regression over 20 s of all three angles, with 99.9 % confidence to 10 %."""
    slope = np.sum(errors[0] * errors[-1]) / np.sum(errors[0] ** 2)
    lag = PERIOD * STEPS
    r = math.exp(-lag / TAU)
    # The slope has variance (1 - r^2)/n, and tau = -lag/ln(slope).
    relative = math.sqrt((1.0 - r * r) / errors[0].size) / r * TAU / lag
    assert z_limit(1) * relative == pytest.approx(0.104, abs=0.001)
    assert abs(-lag / math.log(slope) / TAU - 1.0) < z_limit(1) * relative


def test_change_per_reading(errors):
    """0.0005 rad per sqrt(s), the reference's driving noise: sigma sqrt(2/tau)."""
    assert STD * math.sqrt(2.0 / TAU) == pytest.approx(0.0005, rel=2e-3)
    changes = np.diff(errors[:201], axis=0)
    expected = 2.0 * -math.expm1(-PERIOD / TAU)
    low, high = chi_squared_band(changes.size)
    # 1 - a = 2e-4 is rounded by up to 3e-8; the angles, 1.5e-8 rad each, make a variance of a sixth of that squared.
    rounding = 3e-8 / -math.expm1(-PERIOD / TAU) + (1.5e-8 / STD) ** 2 / 6.0 / expected
    assert rounding < 1e-3
    assert low - rounding < np.mean(changes**2) / expected < high + rounding


def test_angles_are_independent(errors):
    pairs = list(itertools.permutations(range(3), 2))
    found = [np.mean(errors[0, a] * errors[lag, b]) for a, b in pairs for lag in (0, STEPS)]
    # What drives them, where the first values have no part.
    driven = errors[STEPS] - math.exp(-0.2) * errors[0]
    driven /= math.sqrt(-math.expm1(-0.4))
    found += [np.mean(driven[a] * driven[b]) for a, b in itertools.combinations(range(3), 2)]
    assert np.max(np.abs(found)) < z_limit(len(found)) / math.sqrt(VEHICLES)


def test_vehicles_are_independent(errors):
    driven = (errors[STEPS] - math.exp(-0.2) * errors[0]) / math.sqrt(-math.expm1(-0.4))
    found = [np.mean(x[:, apart:] * x[:, :-apart], axis=-1) for x in (errors[0], driven) for apart in (1, 2, 64)]
    assert np.max(np.abs(found)) < z_limit(np.size(found)) / math.sqrt(VEHICLES - 64)


def test_follows_the_true_attitude():
    """Angle for angle; a yaw beyond pi wraps."""
    angles = Euler(*(np.asarray(x, np.float32) for x in ([0.5, -0.5], [1.5, 0.0], [3.0, -1.2])))  # type: ignore[arg-type]
    zero = Drawn((np.zeros(2, np.float32),) * AttitudeEstimator.normals)  # type: ignore[arg-type]
    step = jax.jit(lambda s, d, a: s.step(s.init(d, a)[0], d, a)[1])
    found = step(cast(AttitudeEstimator(), np.float32), zero, angles).attitude
    for name in ("roll", "pitch", "yaw"):
        np.testing.assert_array_equal(getattr(found, name), getattr(angles, name))
    turned = step(cast(AttitudeEstimator(), np.float32), zero, replace(angles, yaw=np.float32([3.5, -9.0]))).attitude
    np.testing.assert_allclose(turned.yaw, [3.5 - 2.0 * math.pi, -9.0 + 2.0 * math.pi], atol=1e-6)


def test_uses_as_many_normals_as_it_declares_each_for_its_angle():
    normals = tuple(np.full(1, value, np.float32) for value in (1.0, 2.0, 3.0))
    assert AttitudeEstimator.normals == len(normals)
    zero = Euler(*(np.zeros(1, np.float32) for _ in range(3)))  # type: ignore[arg-type]
    first = jax.jit(lambda s, d, a: s.init(d, a)[1])(cast(AttitudeEstimator(), np.float32), Drawn(normals), zero)  # type: ignore[arg-type]
    found = [float(getattr(first.attitude, name)[0]) for name in ("roll", "pitch", "yaw")]
    assert found == pytest.approx([STD, 2.0 * STD, 3.0 * STD], rel=1e-6)


def test_ideal_is_the_truth():
    none = jnp.arange(2, dtype=jnp.uint32)
    stream = Key.root(1).stream("ins", none)
    reading = estimate(IdealAttitude(), stream, stream, truth(2), 2)
    for found, angle in zip(jax.tree.leaves(reading), TRUTH, strict=True):
        np.testing.assert_array_equal(found, np.full((3, 2), angle, np.float32))
    assert IdealAttitude.normals == 0
    assert IdealAttitude().period == AttitudeEstimator().period == PERIOD
