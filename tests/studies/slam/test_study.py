"""The example's flights and the statistics of studies."""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import scipy
from tests.models.gnss import flown_receivers as receivers

from qrsim.core.noise import Draw, Key
from qrsim.core.vectors import Vec3
from qrsim.models.gnss.presets import PRESETS
from qrsim.studies.slam import intervals
from qrsim.studies.slam.example import MEMORY, CorrelatedGnss, base_world, world_of


def errors_of(time_constant: float, count: int = 4000) -> Any:
    """Errors north and east (T, n, 2) of many receivers of one kind over 3 s."""
    receiver = CorrelatedGnss(np.float32(0.5), np.float32(2.0), np.float32(time_constant))
    ids = jnp.arange(count, dtype=jnp.uint32)
    stream, like = Key.root(3).stream("gnss", ids), jnp.zeros((), jnp.float32)
    still = Vec3.zeros((count,), jnp.float32)
    state, reading = receiver.init(Draw(stream, jnp.int32(0), like), still, still, None)
    rows = [reading.position_ned.stack()]
    for tick in range(1, 16):
        state, reading = receiver.step(state, Draw(stream, jnp.int32(tick), like), still, still, None)
        rows.append(reading.position_ned.stack())
    return np.asarray(jnp.stack(rows))


@pytest.mark.parametrize("time_constant", [1e-3, 1.0, 100.0])
@pytest.mark.long
def test_errors_are_as_large_and_as_long_as_asked_for(time_constant: float) -> None:
    """Variances and correlations over 4000 receivers, within 5 standard errors; nothing in height."""
    errors = errors_of(time_constant)
    assert np.all(errors[..., 2] == 0.0)
    for axis, std in ((0, 0.5), (1, 2.0)):
        for tick in (0, 15):
            values = errors[tick, :, axis]
            assert values.std() == pytest.approx(std, abs=5.0 * std / math.sqrt(2 * len(values)))
        expected = math.exp(-3.0 / time_constant)
        found = np.corrcoef(errors[0, :, axis], errors[15, :, axis])[0, 1]
        assert found == pytest.approx(expected, abs=5.0 / math.sqrt(errors.shape[1]))
    assert abs(np.corrcoef(errors[0, :, 0], errors[0, :, 1])[0, 1]) < 5.0 / math.sqrt(errors.shape[1])


def test_a_seed_has_its_own_waypoints_over_the_field() -> None:
    base = base_world()
    one, again, other = (world_of(base, seed).fleets[0] for seed in (1, 1, 2))
    places = np.stack([one.route.position_ned.x, one.route.position_ned.y], axis=-1)
    assert np.all(np.abs(places) <= 20.0)
    assert np.all(np.asarray(one.route.position_ned.z) == -20.0)
    assert np.array_equal(one.route.position_ned.x, again.route.position_ned.x)
    assert not np.array_equal(one.route.position_ned.x, other.route.position_ned.x)
    assert float(one.start.position_ned.x[0]) == float(one.route.position_ned.x[0, 0])


def test_the_example_flies_receivers_of_type_gnss() -> None:
    """Under the sky that they are made for, without delay; a base station where one is needed, and phase fixed."""
    world = base_world(gnss="f9p_rtk")
    receiver: Any = world.fleets[0].sensors[world.fleets[0].sensor_names.index("gnss")]
    assert (receiver.preset, receiver.delay, receiver.first_fix) == ("f9p_rtk", 0, "fixed")
    sky: Any = world.sky
    assert (len(sky.ids), sky.base is not None) == (96, True)
    assert base_world(gnss="m8n").sky.base is None
    assert set(MEMORY) == set(PRESETS)


@pytest.mark.nightly
@pytest.mark.parametrize("preset", ["m8n", "f9p_single", "f9p_sbas"])
def test_how_long_errors_of_receivers_last(preset: str) -> None:
    """The correlation over ten minutes is that of the remedy's process, within a tenth, in 100 worlds."""
    flown = receivers.fly(receivers.receiver(preset), 1200.0, 100, seed=5)
    error, lag = np.asarray(flown.error)[:, :, 0, :2], 3000
    found = float(np.mean(error[lag:] * error[:-lag]) / np.mean(np.square(error)))
    assert found == pytest.approx(math.exp(-600.0 / MEMORY[preset]), abs=0.12)


def test_paired_counts_differences_of_pairs() -> None:
    generator = np.random.default_rng(0)
    one = generator.standard_normal(40)
    other = one + 0.3 + 0.5 * generator.standard_normal(40)
    other[3] = np.nan
    found = intervals.paired(one, other)
    left = np.delete(other - one, 3)
    assert found["pairs"] == 39
    assert found["p"] == pytest.approx(scipy.stats.wilcoxon(left).pvalue)
    low, high = scipy.stats.t.interval(0.95, 38, left.mean(), scipy.stats.sem(left))
    assert (found["low"], found["high"]) == pytest.approx((low, high))


def test_what_the_remedy_recovers() -> None:
    """Half of the loss, exactly known for every seed."""
    white = np.linspace(0.1, 0.3, 20)
    found = intervals.recovered(white, white + 0.4, white + 0.2)
    assert found == pytest.approx({"part": 0.5, "low": 0.5, "high": 0.5})


def test_the_allan_slopes_of_known_noises() -> None:
    """White noise falls with -1/2, a random walk rises with +1/2; intervals of 95 % from 50 records of 600."""
    white = list(np.random.default_rng(1).standard_normal((50, 600, 2)))
    found = intervals.allan_slope(white, 0.2)
    assert found["low"] < -0.5 < found["high"]
    assert found["slope"] == pytest.approx(-0.5, abs=0.05)
    walk = [np.cumsum(record, axis=0) for record in white]
    assert intervals.allan_slope(walk, 0.2)["slope"] == pytest.approx(0.5, abs=0.1)
    # One record says nothing of how far another would be from it.
    assert set(intervals.allan_slope(white[:1], 0.2)) == {"slope"}


def test_the_allan_deviation_is_that_of_an_independent_implementation() -> None:
    allantools = pytest.importorskip("allantools")
    record = np.cumsum(np.random.default_rng(2).standard_normal((300, 2)), axis=0)
    windows, deviation = intervals.allan([record], 0.2)
    theirs = [allantools.oadev(record[:, axis], rate=5.0, data_type="freq", taus=windows)[1] for axis in (0, 1)]
    np.testing.assert_allclose(deviation, np.sqrt(np.mean(np.square(theirs), axis=0)), rtol=1e-9)
