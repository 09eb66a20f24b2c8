"""The camera's windows against geometry done by hand, for a small level camera at 8 m.

Its focal length is 50 pixels and its middle (50, 37.5), so the ground (north, east) is at the pixel
(50 + 50 / 8 east, 37.5 - 50 / 8 north). A person of 4.16 m is 26 pixels wide, of which 4 x 3 fit best in 100 x 75
pixels: windows of 25 pixels which begin at 0.
"""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.noise import Key
from qrsim.core.tree import cast
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.atmosphere.wind import Calm
from qrsim.models.scene.area import BoxArea
from qrsim.models.scene.contents import Contents, ContentsState, Surroundings
from qrsim.models.scene.persons import Persons, PersonsState
from qrsim.models.scene.terrain import CLEAR, PatchyGround, TerrainState
from qrsim.models.sensors.camera import Camera, CameraReading, IdealCamera, PersonClassifier, Picture

Pixel = tuple[float, float]
AREA = cast(BoxArea(-100.0, 100.0, -100.0, 100.0, -80.0, 0.0), np.float32)  # type: ignore[arg-type]


@jax.jit
def _develop(reading: CameraReading, persons: PersonsState) -> Picture:
    camera = IdealCamera(
        50.0,  # type: ignore[arg-type]
        50.0,  # type: ignore[arg-type]
        37.5,  # type: ignore[arg-type]
        width=100,
        height=75,
        most_columns=4,
        most_rows=3,
        period=0.005,
    )
    contents = Contents(terrain=cast(PatchyGround(side=1), np.float32), persons=cast(Persons(), np.float32))
    state = ContentsState(None, TerrainState(jnp.full((1, 1), CLEAR, jnp.int32)), persons)
    around = Surroundings(contents, state, Calm(), AREA, jnp.int32(0), 0.02)
    stream = Key.root(jnp.array([0, 0], jnp.uint32)).stream("camera", jnp.arange(1, dtype=jnp.uint32))
    return cast(camera, np.float32).develop(reading, around, stream, jnp.float32(4.16))


def develop(persons: list[Pixel], found: tuple[int, int] = (-1, -1), number: float = 0.0) -> Any:
    """Return the picture of persons (two of them) at pixels (x, y), found at ticks (-1: never)."""
    x, y = np.array(persons, np.float32).T
    lying = PersonsState(
        (37.5 - y) * np.float32(0.16),
        (x - 50.0) * np.float32(0.16),
        np.ones(2, bool),  # type: ignore[arg-type]
        np.array(found, np.int32),  # type: ignore[arg-type]
    )
    zero: Any = np.zeros(1, np.float32)
    position, level = Vec3(zero, zero, zero - np.float32(8.0)), Euler(zero, zero, zero)
    reading = CameraReading(position, level, zero + np.float32(number))
    return jax.tree.map(np.asarray, _develop(reading, lying))


def seen_at(picture: Any) -> set[tuple[int, int]]:
    return {(int(row), int(column)) for row, column in np.argwhere(picture.seen[0])}


OUTSIDE = (500.0, 500.0)


def expected(distance: float, present: bool) -> float:
    """ln N(score; person) - ln N(score; none) of the mean score, from the published formulas on clear ground."""
    beyond = 0.66 - 0.005 * (distance - 11.0)
    person = 0.55 - 0.11 * math.cos(math.pi * distance / 11.0) if distance <= 11.0 else beyond
    none = 0.34 + 0.076 * min(distance / 11.0, 1.0)
    person_std = 0.16 - 0.0061 * distance + 7.4e-5 * distance**2
    none_std = 0.09 - 0.0016 * distance + 2.4e-5 * distance**2
    half_square = 0.5 * (person - none) ** 2
    if present:
        return half_square / none_std**2 + math.log(none_std / person_std)
    return -half_square / person_std**2 + math.log(none_std / person_std)


def test_the_distance_of_a_window_is_that_of_its_middle() -> None:
    """The middle of window (row, column) is 12.5 + 25 column - 50 pixels right and 25 - 25 row ahead, of 50 down."""
    picture = develop([(30.0, 37.5), OUTSIDE])
    assert (picture.rows[0], picture.columns[0]) == (3, 4)
    for row in range(3):
        for column in range(4):
            right, ahead = (25.0 * column - 37.5) / 50.0, (25.0 - 25.0 * row) / 50.0
            distance = 8.0 * math.sqrt(1.0 + right**2 + ahead**2)
            ratio = expected(distance, (row, column) in seen_at(picture))
            assert picture.ratio[0, row, column] == pytest.approx(ratio, rel=1e-3), (row, column)


def test_a_person_is_in_the_windows_of_its_middle_its_corners_and_the_middles_of_its_quarters() -> None:
    """Corners are 13 pixels from the middle each way; the triangles to the middle have theirs 26 / 3 along an axis.

    At (30, 37.5): corners at x = 17 and 43, y = 24.5 and 50.5, and only the triangle at (21.3, 37.5) is in (1, 0).
    At (62.5, 30): corners at x = 49.5 and 75.5, y = 17 and 43, and only the triangle at (62.5, 21.3) is in (0, 2).
    """
    assert seen_at(develop([(30.0, 37.5), OUTSIDE])) == {(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1)}
    assert seen_at(develop([(62.5, 30.0), OUTSIDE])) == {(0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3)}


@pytest.mark.parametrize("far", [-2.0, 2.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_of_two_persons_in_a_window_the_one_nearer_to_its_middle_counts(axis: int, far: float) -> None:
    """One is 2 pixels from the middle (37.5, 37.5) of window (1, 1), the other 1.25 to the other side."""
    places = [[37.5, 37.5], [37.5, 37.5]]
    places[0][axis] += far
    places[1][axis] -= 0.625 * far
    persons = [(x, y) for x, y in places]
    assert (1, 1) in seen_at(develop(persons, found=(0, -1)))
    assert (1, 1) not in seen_at(develop(persons, found=(-1, 0)))


def test_pictures_are_a_tick_apart_at_least() -> None:
    """A period of a quarter of a tick is one tick: of a person found at tick 4, picture 3 is before and 4 is not."""
    here = [(37.5, 37.5), OUTSIDE]
    assert (1, 1) in seen_at(develop(here, found=(4, -1), number=3.0))
    assert not seen_at(develop(here, found=(4, -1), number=4.0))


def test_pictures_are_numbered_one_by_one() -> None:
    """The first picture is number 0; each step takes the next, where the vehicle is then."""
    zero: Any = np.zeros(2, np.float32)
    position, level = Vec3(zero + 1.0, zero + 2.0, zero - 3.0), Euler(zero, zero, zero)
    state, reading = Camera().init(None, position, level)  # type: ignore[arg-type]
    np.testing.assert_array_equal(reading.picture, [0.0, 0.0])
    for number in (1.0, 2.0):
        state, reading = Camera().step(state, None, position, level)  # type: ignore[arg-type]
        np.testing.assert_array_equal(state, [number, number])
        np.testing.assert_array_equal(reading.picture, [number, number])
        assert reading.taken_at_ned is position


@jax.jit
def _grid(height: Any) -> Any:
    zero = 0.0 * height
    reading = CameraReading(Vec3(zero, zero, -height), Euler(zero, zero, zero), zero)
    around = Surroundings(Contents(), ContentsState(), Calm(), AREA, jnp.int32(0), 0.02)
    view = cast(Camera(), np.float32).view(reading, around, jnp.float32(0.5))
    return jnp.stack([view.rows, view.columns, view.width, view.height, view.left, view.top])


@pytest.mark.parametrize(
    ("height", "grid"),
    [
        # A person is 0.5 * 2280 / 44 = 25.91 pixels: 960 are 37.05 and 1280 are 49.4 of them.
        (44.0, (37, 49, 26, 25, 3, 5)),
        # A person is 3800 pixels, more than twice the picture: there is one window all the same.
        (0.3, (1, 1, 1280, 960, 0, 0)),
    ],
)
def test_the_grid_has_as_many_windows_as_persons_fit(height: float, grid: tuple[int, ...]) -> None:
    """(rows, columns, width, height, left, top); what windows leave of 1280 x 960 pixels is halved on both sides."""
    np.testing.assert_array_equal(_grid(np.float32(height)), grid)


def test_the_ratio_is_the_difference_of_two_normal_log_densities() -> None:
    """At r = 0 a person scores N(0.44, 0.16) and none N(0.34, 0.09); 0.6 is 1 and 26 / 9 deviations off."""
    ratio = jax.jit(PersonClassifier().ratio)(np.float32(0.6), np.float32(0.0), np.int32(CLEAR))
    person = -0.5 * 1.0 - math.log(0.16)
    none = -0.5 * (26.0 / 9.0) ** 2 - math.log(0.09)
    assert float(ratio) == pytest.approx(person - none, rel=1e-5)
