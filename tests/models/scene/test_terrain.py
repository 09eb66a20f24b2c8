"""The ground's cover: shares of its classes, and how cells lie over the area."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.noise import Draw, Key
from qrsim.core.tree import cast
from qrsim.core.vectors import Vec3
from qrsim.models.scene.area import BoxArea
from qrsim.models.scene.terrain import CLEAR, CLUTTER, OCCLUSION, ClearGround, PatchyGround, TerrainState


@pytest.fixture(scope="module")
def grounds() -> np.ndarray[Any, Any]:
    """The cells (24, 50, 50) of many episodes."""
    ground = cast(PatchyGround(), np.float32)

    def grow(seed: Any) -> Any:
        stream = Key.root(jnp.stack([seed, jnp.uint32(0)])).stream("ground", jnp.zeros(1, jnp.uint32))
        return ground.init(Draw(stream, jnp.int32(0), jnp.zeros((), jnp.float32))).classes

    # Without optimisation it computes for longer than it takes to compile with it.
    quick = jax.config.values["jax_disable_most_optimizations"]
    jax.config.update("jax_disable_most_optimizations", False)
    found = np.asarray(jax.jit(jax.vmap(grow))(jnp.arange(24, dtype=jnp.uint32)))
    jax.config.update("jax_disable_most_optimizations", quick)
    return found


@pytest.mark.long
def test_the_classes_have_their_shares(grounds: np.ndarray[Any, Any]) -> None:
    """The last one grown exactly; of the one before, occlusion may have turned some cells, never more than its own."""
    assert set(np.unique(grounds)) == {CLEAR, CLUTTER, OCCLUSION}
    occluded, cluttered = ((grounds == number).mean(axis=(1, 2)) for number in (OCCLUSION, CLUTTER))
    np.testing.assert_allclose(occluded, 0.05, atol=1e-12)
    assert (cluttered <= 0.2).all()
    assert (cluttered >= 0.15).all()
    assert cluttered.mean() > 0.18


@pytest.mark.long
def test_a_class_lies_in_patches(grounds: np.ndarray[Any, Any]) -> None:
    """A neighbour of a cluttered cell is cluttered far more often than one cell in five."""
    cluttered = grounds == CLUTTER
    pairs = cluttered[:, 1:] & cluttered[:, :-1]
    assert pairs.sum() / cluttered[:, 1:].sum() > 0.7


@pytest.mark.long
def test_episodes_have_grounds_of_their_own(grounds: np.ndarray[Any, Any]) -> None:
    assert len({ground.tobytes() for ground in grounds}) == len(grounds)
    everywhere = (grounds != CLEAR).mean(axis=0)
    assert everywhere.max() < 0.75
    assert (everywhere > 0.0).mean() > 0.9


def test_cells_are_stretched_over_the_area() -> None:
    classes = jnp.zeros((50, 50), jnp.int32).at[0, 49].set(CLUTTER).at[25, 0].set(OCCLUSION)
    area = BoxArea(-122.474, 122.474, -122.474, 122.474, -80.0, 0.0)  # type: ignore[arg-type]
    places = np.array([[-122.0, 122.0], [-118.9, 122.0], [-117.0, 122.0], [1.0, -122.0], [-3.0, -122.0], [500.0, 0.0]])
    at = Vec3(jnp.asarray(places[:, 0]), jnp.asarray(places[:, 1]), jnp.zeros(6))
    found = PatchyGround().class_at(TerrainState(classes), at, area)
    assert list(np.asarray(found)) == [CLUTTER, CLUTTER, CLEAR, OCCLUSION, CLEAR, CLEAR]
    assert np.all(np.asarray(ClearGround().class_at(None, at, area)) == CLEAR)
