"""Concentration fields: mass and flux against what was released, and the reflection at the ground."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.noise import Draw, Key
from qrsim.core.tree import cast
from qrsim.core.vectors import Vec3
from qrsim.models.scene.area import BoxArea
from qrsim.models.scene.plume import (
    DispersionPlume,
    GaussianPlume,
    GaussianState,
    NoPlume,
    PuffPlume,
    PuffState,
    Sources,
    Wind,
)

Array = np.ndarray[Any, Any]
SPEED, RATE, HEIGHT = 3.0, 1.7, 20.0


def box(half: float = 140.0, top: float = 80.0) -> BoxArea:
    return cast(BoxArea(-half, half, -half, half, -top, 0.0), np.float64)  # type: ignore[arg-type]


def blowing(towards_rad: float = 0.6, speed: float = SPEED) -> Wind:
    return cast(Wind(speed, math.cos(towards_rad), math.sin(towards_rad)), np.float64)  # type: ignore[arg-type]


def one_source(strength: float, height: float = HEIGHT) -> Sources:
    zero = np.zeros(1)
    return Sources(Vec3(zero, zero, zero - height), np.array([strength]))  # type: ignore[arg-type]


def at(along: Array, across: Array, height: Array, towards_rad: float = 0.6) -> Vec3:
    """Positions by distances downwind and across of a source at the origin."""
    along, across, height = np.broadcast_arrays(along, across, height)
    cosine, sine = math.cos(towards_rad), math.sin(towards_rad)
    north, east = cosine * along - sine * across, sine * along + cosine * across
    return Vec3(north.ravel(), east.ravel(), -height.ravel())  # type: ignore[arg-type]


pytestmark = pytest.mark.usefixtures("double_precision")


NOW = np.float64(0.0)


@pytest.mark.parametrize("distance", [5.0, 40.0, 200.0])
def test_what_flows_through_any_plane_downwind_is_the_rate(distance: float) -> None:
    across, height = np.linspace(-150.0, 150.0, 601)[:, None], np.linspace(0.0, 200.0, 801)[None]
    plume = DispersionPlume()
    found = plume.concentration(one_source(RATE), at(np.full((1, 1), distance), across, height), blowing(), None, NOW)
    flux = SPEED * np.trapezoid(np.trapezoid(np.asarray(found).reshape(601, 801), height[0]), across[:, 0])
    assert flux == pytest.approx(RATE, rel=1e-6)
    behind = plume.concentration(one_source(RATE), at(np.full((1, 1), -1.0), across, height), blowing(), None, NOW)
    assert np.all(np.asarray(behind) == 0.0)


def released(plume: PuffPlume, ages: list[float], amounts: list[float]) -> PuffState:
    zero = np.zeros(1)
    age, amount = np.zeros((1, plume.puffs)), np.zeros((1, plume.puffs))
    age[0, : len(ages)], amount[0, : len(ages)] = ages, amounts
    return PuffState(one_source(1.0), zero, np.array([len(ages)], np.int32), age, amount)  # type: ignore[arg-type]


@pytest.mark.long
def test_a_puff_holds_what_was_released() -> None:
    """Its spread is that of the receptor's distance, so its mass is exact only where it is small beside that."""
    plume = PuffPlume(puffs=4, spread_factor=1e-3)  # type: ignore[arg-type]
    state = released(plume, [100.0 / SPEED], [1.3])
    axes = (np.linspace(95.0, 105.0, 81), np.linspace(-4.0, 4.0, 81), np.linspace(HEIGHT - 4.0, HEIGHT + 4.0, 81))
    places = at(*np.meshgrid(*axes, indexing="ij"))
    total = np.asarray(plume.concentration(state, places, blowing(), box(), NOW)).reshape(81, 81, 81)
    for axis in reversed(axes):
        total = np.trapezoid(total, axis)
    assert total == pytest.approx(1.3, rel=1e-3)


def test_puffs_come_in_time_to_the_plume_of_a_steady_release() -> None:
    """The integral of one puff over time is the plume of its amount in one second."""
    plume, step = PuffPlume(puffs=2000), 0.05
    ages = list(step * np.arange(2000))
    state = released(plume, ages, [RATE * step] * 2000)
    places = at(np.array([10.0, 60.0, 100.0]), np.array([1.0, -6.0, 4.0]), np.array([19.0, 25.0, 2.0]))
    found = plume.concentration(state, places, blowing(), box(), NOW)
    expected = DispersionPlume().concentration(one_source(RATE), places, blowing(), None, NOW)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    mean = plume.mean(released(plume, [], []), places, blowing())
    np.testing.assert_allclose(mean, np.asarray(expected) / RATE * (2.5 / 5.0), rtol=1e-12)


@pytest.mark.long
def test_a_puff_is_dropped_when_its_tail_has_left_the_box() -> None:
    """140 m from the source to the wall along the wind: the tail is sqrt(-2 ln(0.01) a (u t)^b) behind the middle."""
    plume = PuffPlume(puffs=2)
    wind = blowing(0.0)
    tail = math.sqrt(-2.0 * math.log(0.01) * 0.33 * 160.0**0.86)
    inside = at(np.array([139.0]), np.zeros(1), np.array([HEIGHT]), 0.0)
    for flown, there in ((140.0 + tail - 2.0, True), (140.0 + tail + 4.0, False)):
        found = plume.concentration(released(plume, [flown / SPEED], [1.0]), inside, wind, box(), NOW)
        assert (np.asarray(found)[0] > 0.0) == there


def draw(ids: int, tick: int, seed: int = 0) -> Draw:
    stream = Key.root(seed).stream("test", jnp.arange(ids, dtype=jnp.uint32))
    return Draw(stream, jnp.int32(tick), jnp.zeros((), jnp.float64))


@pytest.mark.long
@pytest.mark.usefixtures("optimised")
def test_puffs_are_released_at_exponential_gaps_with_uniform_amounts() -> None:
    """Counts and amounts of 100 sources in 2000 s against their mean, within four standard errors."""
    plume = cast(PuffPlume(fewest=100, most=100, puffs=1024), np.float64)

    @jax.jit
    def fly(key: Any) -> PuffState:
        state = plume.init(Draw(key, jnp.int32(0), jnp.zeros((), jnp.float64)), box())
        return jax.lax.fori_loop(
            1, 4001, lambda i, now: plume.step(now, Draw(key, jnp.int32(i), jnp.zeros((), jnp.float64))), state
        )

    state = fly(draw(100, 0).stream)
    count = np.asarray(state.released)
    assert abs(count.mean() - 400.0) < 4.0 * 20.0 / 10.0
    assert abs(count.var() / 400.0 - 1.0) < 4.0 * math.sqrt(2.0 / 99.0)
    amounts = np.asarray(state.amount)[np.asarray(state.amount) > 0.0]
    assert amounts.size == count.sum()
    assert 0.1 <= amounts.min() < amounts.max() <= 2.5
    assert abs(amounts.mean() - 1.3) < 4.0 * 2.4 / math.sqrt(12.0 * amounts.size)
    first = np.sort(np.asarray(state.age)[0, : count[0]])[::-1]
    gaps = -np.diff(first)
    assert gaps.min() < 0.5, "two releases within a period are two puffs"
    assert abs(gaps.mean() - 5.0) < 4.0 * 5.0 / math.sqrt(gaps.size)


@pytest.mark.long
def test_sources_are_in_the_inner_part_of_the_box_and_as_many_as_asked_for() -> None:
    plume = cast(DispersionPlume(fewest=1, most=5), np.float64)
    begin = jax.jit(
        lambda seed: plume.init(
            Draw(Key.root(seed).stream("x", jnp.arange(5, dtype=jnp.uint32)), jnp.int32(0), jnp.zeros((), jnp.float64)),
            box(),
        )
    )
    found = [begin(np.array([seed, 0], np.uint32)) for seed in range(300)]
    counts = np.array([int((np.asarray(sources.strength) > 0.0).sum()) for sources in found])
    assert set(counts) == {1, 2, 3, 4, 5}
    positions = np.stack([np.asarray(sources.position_ned.stack()) for sources in found]).reshape(-1, 3)
    low, high = np.array([-112.0, -112.0, -72.0]), np.array([112.0, 112.0, -8.0])
    assert (positions > low).all()
    assert (positions < high).all()
    np.testing.assert_allclose(positions.std(axis=0), (high - low) / math.sqrt(12.0), rtol=0.08)


def test_a_gaussian_has_its_peak_and_its_spread_along_its_own_axes() -> None:
    zero = np.zeros(1)
    std = Vec3(zero + 4.0, zero + 10.0, zero + 3.0)
    state = GaussianState(one_source(1.0), std, np.array([0.5]))  # type: ignore[arg-type]
    plume = GaussianPlume()
    ahead, right = (math.cos(0.5), math.sin(0.5)), (-math.sin(0.5), math.cos(0.5))
    places = np.array(
        [[0, 0, -20], [4 * ahead[0], 4 * ahead[1], -20], [10 * right[0], 10 * right[1], -20], [0, 0, -23]]
    )
    found = plume.concentration(state, Vec3.of(jnp.asarray(places, jnp.float64)), blowing(), None, NOW)
    np.testing.assert_allclose(found, [1.0, *[math.exp(-0.5)] * 3], rtol=1e-12)


def test_clean_air_has_no_concentration() -> None:
    assert np.all(
        np.asarray(NoPlume().concentration(None, at(np.ones(3), np.ones(3), np.ones(3)), blowing(), None, NOW)) == 0
    )  # type: ignore[arg-type]
