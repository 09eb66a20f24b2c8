"""The windows that a picture has, computed piece by piece, against those of the whole array."""

from __future__ import annotations

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
from qrsim.models.scene.terrain import PatchyGround, TerrainState
from qrsim.models.sensors.camera import Camera, CameraReading
from qrsim.models.sensors.person_classifier import PersonClassifier

AREA = cast(BoxArea(-100.0, 100.0, -100.0, 100.0, -80.0, 0.0), np.float32)  # type: ignore[arg-type]
# At 8 m a person of 0.4 m is 2.5 of the 100 x 75 pixels wide, so that there are 50 x 38 windows, of which 40 x 30 fit.
SIZE, HEIGHTS = 0.4, (8.0, 3.0, np.nan, 1.0)


@jax.jit
def both(reading: CameraReading, persons: PersonsState, ground: Any) -> Any:
    """Return the ratios by themselves, and the whole picture."""
    # Of the heights, one is below ``near``.
    classifier = PersonClassifier(near=2.0)  # type: ignore[arg-type]
    camera = Camera(50.0, 50.0, 37.5, classifier, 100, 75, most_columns=40, most_rows=30)  # type: ignore[arg-type]
    camera = cast(camera, np.float32)
    contents = Contents(terrain=cast(PatchyGround(side=4), np.float32), persons=cast(Persons(), np.float32))
    state = ContentsState(None, TerrainState(ground), persons)
    around = Surroundings(contents, state, Calm(), AREA, jnp.int32(0), 0.02)
    count = reading.picture.shape[0]
    stream = Key.root(jnp.array([5, 0], jnp.uint32)).stream("camera", jnp.arange(count, dtype=jnp.uint32))
    size, zeros = jnp.float32(SIZE), jnp.zeros((count, 30, 40), jnp.float32)
    whole = camera.develop(reading, around, stream, size)
    return camera.ratios(reading, around, stream, size, zeros), camera.frame(reading, around, size), whole


@pytest.mark.long
def test_windows_computed_by_themselves_are_those_of_the_whole_picture() -> None:
    """Persons everywhere, many of them in one window, some found before the picture and some after it."""
    draw = np.random.default_rng(2)
    north, east = draw.uniform(-7.0, 7.0, (2, 60)).astype(np.float32)
    found = draw.choice([-1, 20, 200], 60).astype(np.int32)
    persons: Any = PersonsState(north, east, draw.uniform(size=60) < 0.8, found)  # type: ignore[arg-type]
    count = len(HEIGHTS)
    place = jnp.asarray([(1.0, -0.5, -height) for height in HEIGHTS], jnp.float32)
    angles = Euler(*(jnp.asarray(draw.uniform(-0.05, 0.05, count), jnp.float32) for _ in range(3)))
    reading = CameraReading(Vec3.of(place), angles, jnp.full(count, 2.0, jnp.float32))
    ground = jnp.asarray(draw.integers(0, 3, (4, 4)), jnp.int32)
    alone, (grid, corners), whole = jax.tree.map(np.asarray, both(reading, persons, ground))
    assert grid.tolist() == [[30, 40], [11, 15], [0, 0], [4, 5]]
    assert whole.seen.any(axis=(1, 2)).tolist() == [True, True, False, False]
    np.testing.assert_allclose(alone, np.nan_to_num(whole.ratio), rtol=2e-4, atol=2e-4)
    assert (alone[1, :11, :15] != 0.0).all()
    assert not alone[1, 11:].any()
    assert not alone[1, :, 15:].any()
    assert not alone[2].any()
    at = [(0, 0), (0, 15), (11, 15), (11, 0)]
    expected = [[whole.north[1, row, column], whole.east[1, row, column]] for row, column in at]
    np.testing.assert_allclose(corners[1], expected, atol=1e-5)
    assert np.isnan(corners[2]).all()
