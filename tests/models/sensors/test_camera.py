"""The camera: its grid of windows, where they are on the ground, and the scores against the published formulas."""

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
from qrsim.models.scene.terrain import CLEAR, CLUTTER, OCCLUSION, PatchyGround, TerrainState
from qrsim.models.sensors.camera import Camera, CameraReading, IdealCamera, PersonClassifier, Picture

Array = np.ndarray[Any, Any]
AREA = cast(BoxArea(-100.0, 100.0, -100.0, 100.0, -80.0, 0.0), np.float32)  # type: ignore[arg-type]


def lying(places: list[tuple[float, float]], found_tick: int = -1) -> PersonsState:
    north, east = np.array(places, np.float32).reshape(-1, 2).T
    count = len(places)
    return PersonsState(
        north,
        east,
        np.ones(count, bool),
        np.full(count, found_tick, np.int32),  # type: ignore[arg-type]
    )


def taken(positions: Any, attitudes: Any = (0.0, 0.0, 0.0), number: float = 0.0) -> CameraReading:
    position = np.atleast_2d(np.asarray(positions, np.float32))
    attitude = np.broadcast_to(np.asarray(attitudes, np.float32), position.shape)
    angles = Euler(*(jnp.asarray(attitude[:, i]) for i in range(3)))
    return CameraReading(Vec3.of(jnp.asarray(position)), angles, jnp.full(len(position), number, jnp.float32))


@jax.jit
def _develop(camera: Camera, reading: CameraReading, persons: Any, ground: Any, seed: Any) -> Picture:
    terrain = cast(PatchyGround(side=1), np.float32)
    contents = Contents(terrain=terrain, persons=cast(Persons(), np.float32))
    state = ContentsState(None, TerrainState(ground), persons)
    around = Surroundings(contents, state, Calm(), AREA, jnp.int32(0), 0.02)
    stream = Key.root(seed).stream("camera", jnp.arange(reading.picture.shape[0], dtype=jnp.uint32))
    return camera.develop(reading, around, stream, jnp.float32(0.5))


def develop(camera: Camera, reading: CameraReading, persons: Any, ground: int = CLEAR, seed: int = 0) -> Any:
    camera = cast(camera, np.float32)
    cells = jnp.full((1, 1), ground, jnp.int32)
    return jax.tree.map(np.asarray, _develop(camera, reading, persons, cells, jnp.array([seed, 0], jnp.uint32)))


NOBODY = lying([(90.0, 90.0)])


@pytest.mark.parametrize(("height", "grid"), [(25.0, (21, 28)), (45.0, (38, 51)), (79.9, (67, 90)), (1.0, (1, 1))])
def test_a_window_is_as_large_as_a_person_looks(height: float, grid: tuple[int, int]) -> None:
    picture = develop(IdealCamera(), taken((0.0, 0.0, -height)), NOBODY)
    assert (picture.rows[0], picture.columns[0]) == grid
    shown = np.isfinite(picture.ratio[0])
    assert shown[: grid[0], : grid[1]].all()
    assert shown.sum() == grid[0] * grid[1]
    corners = np.isfinite(picture.north[0])
    assert corners.sum() == (grid[0] + 1) * (grid[1] + 1)


def test_the_windows_lie_on_the_ground_as_published() -> None:
    """At 25 m: 45 pixels, beginning 10 from the left and 7 from the top, 25 m / 2280 pixels on the ground."""
    picture = develop(IdealCamera(), taken((3.0, -4.0, -25.0)), NOBODY)
    east = -4.0 + (10 + 45 * np.arange(29) - 640.0) * 25.0 / 2280.0
    north = 3.0 - (7 + 45 * np.arange(22) - 480.0) * 25.0 / 2280.0
    np.testing.assert_allclose(picture.east[0, :22, :29], np.broadcast_to(east, (22, 29)), atol=1e-4)
    np.testing.assert_allclose(picture.north[0, :22, :29], np.broadcast_to(north[:, None], (22, 29)), atol=1e-4)


def test_the_camera_turns_and_tilts_with_the_body() -> None:
    """Heading east, up in the picture is east; nose up by 0.1 rad, the axis meets the ground ahead."""
    picture = develop(IdealCamera(), taken((0.0, 0.0, -25.0), (0.0, 0.1, math.pi / 2.0)), NOBODY)
    rows, columns = picture.rows[0], picture.columns[0]
    middle = picture.east[0, : rows + 1, : columns + 1].mean(), picture.north[0, : rows + 1, : columns + 1].mean()
    assert middle[0] == pytest.approx(25.0 * math.tan(0.1), abs=0.3)
    assert middle[1] == pytest.approx(0.0, abs=0.1)
    assert (np.diff(picture.east[0, : rows + 1, 5]) < 0.0).all()
    assert (np.diff(picture.north[0, 5, : columns + 1]) < 0.0).all()


def seen_at(picture: Any) -> set[tuple[int, int]]:
    return {(int(row), int(column)) for row, column in np.argwhere(picture.seen[0])}


def test_a_person_occupies_the_windows_of_its_middle_and_edges() -> None:
    """At 25 m a person is 45.6 pixels wide and a window 45: at a corner of four windows it is in all of them."""
    corner = develop(IdealCamera(), taken((0.0, 0.0, -25.0)), NOBODY)
    north, east = float(corner.north[0, 10, 14]), float(corner.east[0, 10, 14])
    picture = develop(IdealCamera(), taken((0.0, 0.0, -25.0)), lying([(north, east)]))
    assert seen_at(picture) == {(9, 13), (9, 14), (10, 13), (10, 14)}
    assert (picture.ratio[0][picture.seen[0]] > 0.0).all()
    half = 25.0 / 2280.0 * 22.5
    inside = develop(IdealCamera(), taken((0.0, 0.0, -25.0)), lying([(north - half, east + half)]))
    assert (10, 14) in seen_at(inside)
    assert len(seen_at(inside)) <= 9


def test_a_person_counts_if_its_middle_is_in_the_frame() -> None:
    edge = 25.0 * 480.0 / 2280.0
    assert seen_at(develop(IdealCamera(), taken((0.0, 0.0, -25.0)), lying([(edge - 0.2, 0.0)])))
    assert not seen_at(develop(IdealCamera(), taken((0.0, 0.0, -25.0)), lying([(edge + 0.1, 0.0)])))


@pytest.mark.long
def test_found_persons_give_no_score_from_then_on_and_hide_none_that_is_nearer() -> None:
    before = develop(IdealCamera(), taken((0.0, 0.0, -25.0), number=1.0), lying([(0.1, 0.1)], found_tick=60))
    after = develop(IdealCamera(), taken((0.0, 0.0, -25.0), number=2.0), lying([(0.1, 0.1)], found_tick=60))
    assert seen_at(before)
    assert not seen_at(after)
    both = lying([(0.1, 0.1), (0.1, 0.2)])
    found = PersonsState(both.north, both.east, both.there, jnp.array([0, -1], jnp.int32))
    assert seen_at(develop(IdealCamera(), taken((0.0, 0.0, -25.0)), found))


def published(r: float, ground: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """The formulas of the reference, for (person, none)."""
    near = 0.55 + 0.11 * math.cos(math.pi * (1.0 + r / 11.0)) if r <= 11.0 else 0.66 - 0.005 * (r - 11.0)
    person = near - (0.1 if ground == OCCLUSION else 0.0), 7.4e-5 * r * r - 0.0061 * r + 0.16
    none = 0.34 + 0.076 * min(r / 11.0, 1.0), 2.4e-5 * r * r - 0.0016 * r + 0.09 + (0.04 if ground == CLUTTER else 0.0)
    return person, none


@pytest.mark.parametrize("ground", [CLEAR, CLUTTER, OCCLUSION])
@pytest.mark.parametrize("r", [0.0, 4.0, 11.0, 25.0, 50.0, 80.0])
def test_mean_and_spread_of_a_score_are_as_published(r: float, ground: int) -> None:
    classifier = PersonClassifier()
    person, none = published(min(r, 50.0), ground)
    at = jnp.float32(r), jnp.int32(ground)
    np.testing.assert_allclose([float(part) for part in classifier.person(*at)], person, rtol=1e-5)
    np.testing.assert_allclose([float(part) for part in classifier.none(*at)], none, rtol=1e-5)


@pytest.mark.parametrize("ground", [CLEAR, CLUTTER])
@pytest.mark.long
def test_the_scores_of_empty_windows_are_distributed_as_published(ground: int) -> None:
    """Mean and variance of the ratios of 20 pictures from 25 m against the formulas, within four standard errors.

    A ratio is a quadratic of a normal score, whose moments are closed forms.
    """
    pictures = [develop(Camera(), taken((0.0, 0.0, -25.0), number=i), NOBODY, ground).ratio[0] for i in range(20)]
    found = np.stack(pictures)[:, :21, :28]
    middle = develop(Camera(), taken((0.0, 0.0, -25.0)), NOBODY, ground)
    north = middle.north[0, :22, :29]
    east = middle.east[0, :22, :29]
    r = np.sqrt(0.25 * (north[:-1, 1:] + north[1:, 1:]) ** 2 + 0.25 * (east[1:, :-1] + east[1:, 1:]) ** 2 + 625.0)
    (m1, s1), (m0, s0) = _moments(r, ground)
    # ln N(x; m1, s1) - ln N(x; m0, s0) with x = m0 + s0 z is a + b z + c z^2.
    a, b = -0.5 * ((m0 - m1) / s1) ** 2 - np.log(s1 / s0), -(m0 - m1) * s0 / s1**2
    c = 0.5 - 0.5 * (s0 / s1) ** 2
    mean, variance = a + c, b**2 + 2.0 * c**2
    z = (found - mean) / np.sqrt(variance)
    assert abs(z.mean()) < 4.0 / math.sqrt(z.size)
    fourth = np.mean(z**4)
    assert abs(z.var() - 1.0) < 4.0 * math.sqrt((fourth - 1.0) / z.size)
    assert len(np.unique(found)) > 0.99 * found.size, "every window of every picture has its own noise"


def _moments(r: Array, ground: int) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    both = [published(float(v), ground) for v in r.ravel()]
    shaped = [[np.array([pair[i][j] for pair in both]).reshape(r.shape) for j in (0, 1)] for i in (0, 1)]
    return (shaped[0][0], shaped[0][1]), (shaped[1][0], shaped[1][1])


@pytest.mark.long
def test_a_picture_is_the_same_however_often_and_with_whomever_it_is_looked_at() -> None:
    one = develop(Camera(), taken((0.0, 0.0, -25.0), number=3.0), NOBODY)
    two = develop(Camera(), taken([(0.0, 0.0, -25.0), (5.0, 0.0, -30.0)], number=3.0), NOBODY)
    np.testing.assert_allclose(one.ratio[0], two.ratio[0], rtol=1e-5, atol=1e-5)
    assert not np.allclose(two.ratio[0][:10, :10], two.ratio[1][:10, :10])


@pytest.mark.long
def test_a_vehicle_that_has_stopped_has_no_picture() -> None:
    picture = develop(Camera(), taken((math.nan, 0.0, -25.0), number=math.nan), NOBODY)
    assert np.isnan(picture.ratio).all()
    assert not picture.seen.any()
