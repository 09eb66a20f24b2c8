"""Wakes behind buildings against the formulas of Röckle 1990, by hand."""

from __future__ import annotations

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.tree import cast, parameter, record
from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError
from qrsim.models.atmosphere.building_wakes import BuildingWakes, cavity_length
from qrsim.models.atmosphere.contracts import Footprint, Wind


@record
class Even(Wind):
    """The same at all heights, but ``roofs`` times as fast above 9 m."""

    north: Any = parameter(default=6.0, unit="m/s", doc="to the north")
    east: Any = parameter(default=0.0, unit="m/s", doc="to the east")
    roofs: Any = parameter(default=1.0, unit="1", doc="above 9 m")

    reads: ClassVar[tuple[str, ...]] = ()

    def velocity_ned(self, height_agl: Any, seconds: Any, fraction: Any, *args: Any, **reads: Any) -> Vec3:
        factor = jnp.where(height_agl > 9.0, self.roofs, 1.0)
        return Vec3(self.north * factor, self.east * factor, jnp.zeros_like(height_agl))


def block(south: float, north: float, west: float, east: float, tall: float = 10.0) -> Footprint:
    return Footprint(np.array([[south, west], [north, west], [north, east], [south, east]]), 0.0, -tall, 0.0)


# 20 m across a wind from the south, 10 m along it, 10 m high: L_R = 1.8 10 2/(1 (1 + 0.48)) = 24.324324 m.
HOUSE = block(-5.0, 5.0, -10.0, 10.0)
LENGTH = 24.324324


@jax.jit
def evaluate(wakes: Any, place: Vec3, wind: Any) -> Any:
    time = jnp.int32(0), jnp.zeros((), place.x.dtype)
    return wakes.velocity_ned(place, -place.z, wind.velocity_ned(-place.z, *time), *time, wind=wind).stack()


def taken(solids: list[Footprint], places: Any, wind: Any = None, precision: str = "float64") -> Any:
    """What the wakes add to the wind (n, 3) at places (n, 3)."""
    with jax.enable_x64(precision == "float64"):
        wakes = cast(BuildingWakes().built(None, solids), precision)
        place = Vec3.of(jnp.asarray(np.array(places, precision)))
        return np.asarray(evaluate(wakes, place, cast(wind or Even(), precision)), np.float64)


@pytest.mark.parametrize(
    ("width", "deep", "tall", "length"),
    [
        (20.0, 10.0, 10.0, LENGTH),
        (10.0, 10.0, 10.0, 14.516129),
        # L/H counts from 0.3 to 3, W/H up to 10.
        (10.0, 0.1, 10.0, 14.516129 / 0.3**0.3),
        (10.0, 90.0, 10.0, 14.516129 / 3.0**0.3),
        (990.0, 10.0, 10.0, 180.0 / 3.4),
    ],
)
def test_the_cavity_is_as_long_as_was_measured(width: float, deep: float, tall: float, length: float) -> None:
    found = cavity_length(*(jnp.asarray(value) for value in (width, deep, tall)))
    assert float(found) == pytest.approx(length, rel=1e-5)


@pytest.mark.parametrize(("precision", "tolerance"), [("float64", 1e-6), ("float32", 2e-5)])
def test_air_turns_back_in_the_cavity_and_is_slower_after_it(precision: str, tolerance: float) -> None:
    half = LENGTH * np.sqrt(0.75)
    found = taken(
        [HOUSE],
        [
            [5.0 + 0.5 * LENGTH, 0.0, 0.0],  # -U (1 - 1/2)^2
            [5.0 + 2.0 * LENGTH, 0.0, 0.0],  # U (1 - 2^-1.5)
            [5.0 + 0.5 * half, 0.0, -5.0],  # half of the height: d is the root of 3/4 of the length
            [5.0 + 2.0 * half, 5.0, 0.0],  # and half of the way to the side
            [5.0 + 0.5 * half, -5.0, 0.0],  # where the flow back is the root of 1/2 of it
            [5.0 + LENGTH, 0.0, 0.0],  # at the end of the cavity the air stands
            [5.1, 0.0, -10.5],  # above it, beside it and before it
            [15.0, 10.1, -2.0],
            [-5.1, 0.0, -2.0],
        ],
        precision=precision,
    )
    expected = [-6.0 - 1.5, -6.0 * 0.3535534, -6.0 - 1.5, -6.0 * 0.3535534, -6.0 - 1.5 * 0.7071068, -6.0, 0, 0, 0]
    np.testing.assert_allclose(found, np.column_stack([expected, np.zeros(9), np.zeros(9)]), atol=tolerance)


def test_the_flow_back_is_that_of_the_wind_over_the_roof() -> None:
    """In the cavity -2 x 6/4 in place of -6/4; after it a part of the wind there."""
    places = [[5.0 + 0.5 * LENGTH, 0.0, 0.0], [5.0 + 2.0 * LENGTH, 0.0, 0.0]]
    found = taken([HOUSE], places, Even(6.0, 0.0, 2.0))
    np.testing.assert_allclose(found[:, 0], [-6.0 - 3.0, -6.0 * 0.3535534], atol=1e-6)


def test_wakes_turn_with_the_wind() -> None:
    """The same house, a quarter of a turn on; and one of 14.142 m on a corner, which is 20 m wide and 10 m deep."""
    turned = block(-10.0, 10.0, -5.0, 5.0)
    found = taken([turned], [[0.0, -5.0 - 0.5 * LENGTH, 0.0]], Even(0.0, -6.0))
    np.testing.assert_allclose(found, [[0.0, 7.5, 0.0]], atol=1e-6)
    diamond = block(-(50.0**0.5), 50.0**0.5, -(50.0**0.5), 50.0**0.5)
    diagonal = np.array([np.sqrt(0.5), np.sqrt(0.5)])
    place = [*(diagonal * (5.0 + 2.0 * LENGTH)), 0.0]
    found = taken([diamond], [place], Even(*(6.0 * diagonal)))  # type: ignore[arg-type]
    np.testing.assert_allclose(found[0, :2], -6.0 * 0.3535534 * diagonal, atol=1e-6)


def test_a_footprint_that_is_no_rectangle_counts_as_one_about_its_centroid() -> None:
    """Half of a square of 20 m, its centroid 20/3 m from the right angle: 20 m across, 10 m along the wind."""
    half = Footprint(np.array([[30.0, 40.0], [50.0, 40.0], [30.0, 60.0]]), 0.0, -10.0, 0.0)
    lee = 30.0 + 20.0 / 3.0 + 5.0
    places = [[lee + 0.5 * LENGTH, 50.0, 0.0], [lee + 2.0 * LENGTH, 55.0, 0.0], [lee + 1.0, 39.9, 0.0]]
    # At half of the way to the side d is the root of 3/4 of the length: 1 - (0.4330127)^1.5 of the wind is left.
    np.testing.assert_allclose(taken([half], places)[:, 0], [-7.5, -6.0 * 0.2849384, 0.0], atol=1e-6)


def test_a_mast_has_a_wake_as_wide_as_it_is() -> None:
    """2 m across, pi/2 m deep, 10 m high: L_R = 1.8 2/(0.3^0.3 (1 + 0.048)) = 4.929471 m."""
    mast = Footprint(np.array([[0.0, 0.0]]), 1.0, -10.0, 0.0)
    length = 3.6 / (0.3**0.3 * 1.048)
    found = taken([mast], [[np.pi / 4.0 + 0.5 * length, 0.0, 0.0], [3.0, 1.01, 0.0]])
    np.testing.assert_allclose(found[:, 0], [-7.5, 0.0], atol=1e-6)


def test_of_several_wakes_that_counts_which_takes_most() -> None:
    far = block(-45.0, -35.0, -10.0, 10.0)
    place = [[5.0 + 0.5 * LENGTH, 0.0, 0.0]]
    np.testing.assert_array_equal(taken([far, HOUSE], place), taken([HOUSE], place))
    assert taken([far], place)[0, 0] > taken([HOUSE], place)[0, 0]


def test_still_air_has_no_wake() -> None:
    assert not taken([HOUSE], [[10.0, 0.0, -2.0]], Even(0.0, 0.0)).any()


def test_it_needs_buildings_and_not_too_many() -> None:
    with pytest.raises(UsageError, match=r"least_height: no obstacle is 2 m high, so none has a wake; give world.obst"):
        BuildingWakes().built(None, [block(0.0, 1.0, 0.0, 1.0, 1.9)])
    with pytest.raises(UsageError, match=r"least_height: 201 obstacles are 2 m high; allowed: at most 200; take a gre"):
        BuildingWakes().built(None, [HOUSE] * 201)


@pytest.mark.long
def test_gradients_are_finite() -> None:
    wakes = cast(BuildingWakes().built(None, [HOUSE, block(20.0, 30.0, 0.0, 10.0)]), np.float32)
    places = jnp.asarray([[5.0, 0.0, 0.0], [29.3, 0.0, 0.0], [10.0, 10.0, -10.0], [0.0, 0.0, -5.0], [90.0, 3.0, -2.0]])

    def total(wakes: Any, places: Any, wind: Any) -> Any:
        return jnp.sum(evaluate(wakes, Vec3.of(places), wind))

    slopes = jax.jit(jax.grad(total, (0, 1, 2)))(wakes, places, cast(Even(), np.float32))
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(slopes))
