"""What placements and covers make of draws that are given: places, counts, drops and jumps, all by hand."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.models.by_hand import Given, words

from qrsim.core.vectors import Euler, Vec3
from qrsim.models.scene.area import BoxArea
from qrsim.models.scene.placement import RingPlaces, UniformPlaces
from qrsim.models.scene.terrain import CLEAR, CLUTTER, OCCLUSION, PatchyGround
from qrsim.models.scene.uniform import uniform, whole

AREA = BoxArea(0.0, 100.0, 200.0, 300.0, -50.0, 0.0)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Start:
    """Where a fleet starts."""

    position_ned: Any
    attitude: Any


def placed(model: Any) -> Any:
    """Return a function of the words to north, east and heading, and whether there was a place."""

    def place(table: Any) -> Any:
        found, whether = model.place(Given(table), start(), AREA)
        return found.position_ned.x, found.position_ned.y, found.attitude.yaw, whether

    return jax.jit(place)


def start() -> Start:
    zero = jnp.zeros(2, jnp.float32)
    return Start(Vec3(zero, zero, zero - 7.0), Euler(zero, zero, zero))


# North and east of two vehicles, as parts: too near each other, and three places that are not.
NEAR = ((0.5, 0.5), (0.25, 0.25))
GOOD = (((0.1, 0.9), (0.3, 0.6)), ((0.2, 0.7), (0.8, 0.4)), ((0.15, 0.55), (0.35, 0.75)))
YAW = ((0.5, 0.25),)
LATE = ((0.05, 0.95), (0.45, 0.65))
# Three tries, the number of the draw that turns them, and more that nobody should come to.
CASES = (
    (0, GOOD[0] + GOOD[1] + GOOD[2] + YAW + LATE + LATE),
    (1, NEAR + GOOD[1] + GOOD[2] + YAW + LATE + LATE),
    (2, NEAR + NEAR + GOOD[2] + YAW + LATE + LATE),
    (None, NEAR + NEAR + NEAR + ((0.05, 0.95),) + ((0.45, 0.65), (0.05, 0.95)) * 2),
)


def test_uniform_places_are_those_of_the_first_try_that_is_apart() -> None:
    model: Any = UniformPlaces(inner=1.0, yaw_min_rad=0.0, yaw_max_rad=2.0, apart=5.0, tries=3)  # type: ignore[arg-type]
    place = placed(model)
    for number, rows in CASES:
        north, east, yaw, whether = place(words(rows))
        assert bool(whether) is (number is not None)
        if number is None:
            assert np.isnan(north).all()
            continue
        np.testing.assert_allclose(north, 100.0 * np.array(GOOD[number][0]), atol=1e-3)
        np.testing.assert_allclose(east, 200.0 + 100.0 * np.array(GOOD[number][1]), atol=1e-3)
        np.testing.assert_allclose(yaw, [1.0, 0.5], atol=1e-5)


def test_ring_places_are_by_angle_and_distance() -> None:
    """The angle from -pi to pi, the distance from 10 to 20 m around 3, 4."""
    model: Any = RingPlaces(north=3.0, east=4.0, nearest=10.0, farthest=20.0, apart=2.0, tries=3)  # type: ignore[arg-type]
    place = placed(model)
    for number, rows in CASES[:3]:
        assert number is not None
        north, east, _, whether = place(words(rows))
        assert bool(whether)
        angle, distance = 2.0 * math.pi * (np.array(GOOD[number][0]) - 0.5), 10.0 + 10.0 * np.array(GOOD[number][1])
        np.testing.assert_allclose(north, 3.0 + distance * np.cos(angle), atol=1e-3)
        np.testing.assert_allclose(east, 4.0 + distance * np.sin(angle), atol=1e-3)


def test_how_many_fit_on_a_ring() -> None:
    """Chords of the outer circle: as long as its radius, six; a billionth of it is nothing to divide by."""
    nearly = math.sin(math.pi / (6.0 - 1.1e-9))
    for apart, farthest, most in ((20.0, 20.0, 6), (41.0, 20.0, 1), (0.5e-9, 1.0, 10**9), (nearly, 0.5, 5)):
        assert RingPlaces(apart=apart, farthest=farthest).most_vehicles() == most  # type: ignore[arg-type]
    few: Any = RingPlaces(apart=1.1e-9, farthest=1.0)  # type: ignore[arg-type]
    assert few.most_vehicles() == pytest.approx(2.0 * math.pi / 1.1e-9, rel=1e-6)


def test_uniform_numbers_are_the_middles_of_their_steps() -> None:
    """23 bits and a half: the least word is half a step of 2^-23, and bounds are 0 and 1 unless told otherwise."""
    table: Any = np.array([[0, 2**31]], np.uint32)
    found = np.asarray(uniform(Given(table), 0))  # type: ignore[arg-type]
    np.testing.assert_allclose(found, [2.0**-24, 0.5 + 2.0**-24], rtol=1e-7)
    # Of two numbers the lower half of all words gives the first.
    given: Any = Given(words([[0.02, 0.48, 0.52, 0.98]]))
    assert np.asarray(whole(given, 0, 3, 4)).tolist() == [3, 3, 4, 4]


def test_three_uniform_numbers_of_two_words() -> None:
    """The lower 16 bits of the first, the upper 23 of the second, and the upper 16 of the first."""
    first: Any = np.array([[0], [0x9ABC1234]], np.uint32)
    second: Any = np.array([[0], [0x60000000]], np.uint32)
    draw: Any = Given(first, second)
    least = [float(part) for part in PatchyGround._uniforms(draw, jnp.int32(0))]
    np.testing.assert_allclose(least, [2.0**-17, 2.0**-24, 2.0**-17], rtol=1e-6)
    other = [float(part) for part in PatchyGround._uniforms(draw, jnp.int32(1))]
    np.testing.assert_allclose(other, [4660.5 / 65536, 0.375, 39612.5 / 65536], rtol=2e-6)


def test_a_jump_is_exponential_in_any_direction() -> None:
    """-ln of a third of the mean, 10 cells: 10.99; a quarter of a turn is east, where it goes on from the west."""
    ground: Any = PatchyGround(jump=10.0, side=50)  # type: ignore[arg-type]
    jumped = jax.jit(lambda centre, chance: ground._jumped(centre, chance))
    for turn, cell in ((0.25, [5, 1]), (0.75, [5, 29]), (0.0, [16, 40])):
        chance: Any = tuple(np.float32(part) for part in (1.0 / 3.0, turn, 0.5))
        assert np.asarray(jumped(np.array([5, 40], np.int32), chance)).tolist() == cell


def test_a_drop_walks_to_a_neighbour() -> None:
    """Two cells of clutter of 16: where the first drop falls, 1 north and 2 east, and where the second one walks.

    Draws: the corner; a jump of no cell; a drop that turns its cell; a walk; a turn. Others would walk elsewhere.
    """
    ground: Any = PatchyGround(
        clutter_share=0.125,
        occlusion_share=0.0,
        jump=0.0,
        drops_least=5.0,
        drops_spread=0.0,
        side=4,  # type: ignore[arg-type]
    )
    grow = jax.jit(lambda first, second: ground.init(Given(first, second)).classes)
    second = words([[0.6]] * 8)
    for part, cell in ((0.22, (2, 2)), (0.45, (0, 2)), (0.7, (1, 3)), (0.95, (1, 1))):
        low = np.array([0.3, 0.3, 0.3, part, *[(part + 0.5) % 1.0] * 4])
        first = (low * 65536).astype(np.uint32)[:, None]
        classes = np.asarray(grow(first, second))
        assert {tuple(place) for place in np.argwhere(classes == 1).tolist()} == {(1, 2), cell}
        assert (classes[classes != 1] == 0).all()


def test_the_numbers_of_the_classes() -> None:
    assert (CLEAR, CLUTTER, OCCLUSION) == (0, 1, 2)
