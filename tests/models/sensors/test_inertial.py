"""Gyroscope and accelerometer: white noise of stated spread on each axis, and the ideal forms."""

from __future__ import annotations

import itertools
import math
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
from qrsim.models.sensors.inertial import Accelerometer, Gyroscope, IdealAccelerometer, IdealGyroscope

Array = np.ndarray[Any, Any]
VEHICLES, READINGS = 4096, 9
# Sensor, what it reads, its quantity's name in the reading, and its documented spread.
NOISY = [(Gyroscope(), "rates_body", 0.0002), (Accelerometer(), "specific_force", 0.0025)]
# Powers of two, small enough that single precision keeps the noise to 1e-4 of it.
TRUTH = (0.125, -0.0625, 0.25)


def z_limit(statistics: int) -> float:
    """Standard errors that none of so many statistics exceeds with 99.9 % confidence (Bonferroni)."""
    return NormalDist().inv_cdf(1.0 - 0.0005 / statistics)


@jax.jit
def measure(sensor: Any, begin: Stream, source: Stream, truth: Vec3) -> Any:
    """Readings, (READINGS, n) each: one of ``init`` and the others of ``step``."""
    like = jnp.zeros((), truth.x.dtype)
    inputs = dict.fromkeys(sensor.reads, truth)
    state, first = sensor.init(Draw(begin, jnp.uint32(0), like), **inputs)

    def tick(state: Any, now: jax.Array) -> tuple[Any, Any]:
        return sensor.step(state, Draw(source, now, like), **inputs)

    later = jax.lax.scan(tick, state, jnp.arange(1, READINGS, dtype=jnp.uint32))[1]
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, later)


def readings(sensor: Any, name: str, n: int) -> Array:
    """(READINGS, 3, n) in double precision."""
    ids, key = jnp.arange(n, dtype=jnp.uint32), Key.root(1)
    truth = Vec3(*(np.full(n, value, np.float32) for value in TRUTH))  # type: ignore[arg-type]
    # Compiled anew: to JAX two sensors are one where they differ in nothing but their type.
    fresh = jax.jit(lambda *inputs: measure.__wrapped__(*inputs))
    reading = fresh(cast(sensor, np.float32), key.stream(f"{name}/start", ids), key.stream(name, ids), truth)
    assert list(reading.__dataclass_fields__) == [name]
    axes = [np.asarray(axis) for axis in jax.tree.leaves(reading)]
    assert all(axis.dtype == np.float32 for axis in axes)
    return np.stack(axes, axis=1).astype(np.float64)


@pytest.fixture(scope="module", params=NOISY, ids=["gyroscope", "accelerometer"])
def errors(request: pytest.FixtureRequest) -> Array:
    """Errors in units of their stated standard deviation, (READINGS, 3, VEHICLES)."""
    sensor, name, std = request.param
    return (readings(sensor, name, VEHICLES) - np.array(TRUTH)[:, None]) / std


class TestWhiteNoise:
    def test_spread(self, errors):
        """Each axis over all readings, and the first reading alone."""
        for samples in (errors, errors[:1]):
            n = samples[:, 0].size
            low, high = scipy.stats.chi2.ppf([0.0005 / 6, 1.0 - 0.0005 / 6], n) / n
            variances = np.mean(samples**2, axis=(0, 2))
            assert np.all((low < variances) & (variances < high)), variances

    def test_mean_is_zero(self, errors):
        assert np.max(np.abs(np.mean(errors, axis=(0, 2)))) < z_limit(3) / math.sqrt(errors[:, 0].size)

    def test_is_normal(self, errors):
        # Kolmogorov and Smirnov, 99.9 %.
        assert scipy.stats.kstest(errors.ravel(), "norm").pvalue > 0.001

    def test_axes_readings_and_vehicles_are_independent(self, errors):
        found = [np.mean(errors[:, a] * errors[:, b]) for a, b in itertools.combinations(range(3), 2)]
        found += [np.mean(errors[lag:, a] * errors[:-lag, a]) for lag in (1, 2) for a in range(3)]
        found += [np.mean(errors[1:, a] * errors[:-1, b]) for a, b in itertools.permutations(range(3), 2)]
        found += [np.mean(errors[..., apart:] * errors[..., :-apart]) for apart in (1, 2, 64)]
        # The fewest products of these means are those two readings apart.
        n = (READINGS - 2) * VEHICLES
        assert np.max(np.abs(found)) < z_limit(len(found)) / math.sqrt(n)


@pytest.mark.parametrize("sensor", [Gyroscope(), Accelerometer()])
def test_uses_as_many_normals_as_it_declares_each_on_its_axis(sensor: Any):
    normals = [np.full(1, value, np.float32) for value in (1.0, 2.0, 3.0)]
    assert sensor.normals == len(normals)
    zero = Vec3(*(np.zeros(1, np.float32) for _ in range(3)))  # type: ignore[arg-type]
    inputs = dict.fromkeys(sensor.reads, zero)
    _, reading = jax.jit(lambda s, d: s.step(None, d, **inputs))(cast(sensor, np.float32), Drawn(tuple(normals)))  # type: ignore[arg-type]
    for found, value in zip(jax.tree.leaves(reading), (1.0, 2.0, 3.0), strict=True):
        assert float(found[0]) == pytest.approx(value * sensor.white_std, rel=1e-6)


@pytest.mark.parametrize(
    ("ideal", "noisy", "name"),
    [(IdealGyroscope(), Gyroscope(), "rates_body"), (IdealAccelerometer(), Accelerometer(), "specific_force")],
)
def test_ideal_is_the_truth(ideal: Any, noisy: Any, name: str):
    found = readings(ideal, name, 2)
    np.testing.assert_array_equal(found, np.broadcast_to(np.array(TRUTH)[:, None], (READINGS, 3, 2)))
    assert ideal.normals == 0
    assert ideal.period == noisy.period == 0.02
    assert ideal.reads == noisy.reads
