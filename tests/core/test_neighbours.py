"""Who is near: the K nearest within reach, by cells and by all pairs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.engine.llvm.test_operations import by_jax, run

from qrsim.core.neighbours import by_all_pairs, neighbours
from qrsim.engine.llvm import Mode

COUNT, ROOM = 6, 40


def by_hand(points, reach, count):
    """Return numbers and squared distances (count, n), by sorting all others of each."""
    squared = ((points[:, :, None] - points[:, None, :]) ** 2).sum(axis=0)
    squared[np.eye(squared.shape[0], dtype=bool) | (squared > float(reach) ** 2)] = np.inf
    # Stable: of two as far, the one of the lower number.
    index = np.argsort(squared, axis=0, kind="stable")[:count]
    squared = np.take_along_axis(squared, index, axis=0)
    return np.where(np.isfinite(squared), index, -1), squared


@jax.jit
def found(x, y, z, reach):
    return neighbours(x, y, z, reach, COUNT, ROOM)


@pytest.mark.long
def test_cells_find_who_is_found_by_all_pairs():
    """In 100 worlds of 200 points, in one of ten beyond 40 km from the origin; no column has too many."""
    random = np.random.default_rng(4)
    for world in range(100):
        # Whole numbers of eighths, so that squares are exact and ties occur.
        size = random.integers(200, 400)
        points = (random.integers(-8 * size, 8 * size, (3, 200)) / 8.0).astype(np.float32)
        points[0] += 40_000.0 if world % 10 == 0 else 0.0
        reach = np.float32(random.integers(10, 40))
        near = found(*points, reach)
        index, squared = by_hand(points.astype(np.float64), reach, COUNT)
        assert not near.overfull.any()
        np.testing.assert_array_equal(near.index, index)
        np.testing.assert_array_equal(near.squared, squared)


@pytest.mark.long
def test_an_overfull_stretch_is_said_and_what_is_found_is_near():
    """All of 200 points in one place: each has 199 near it, and there is room for 40 of each three columns."""
    points = np.random.default_rng(5).uniform(0.0, 5.0, (3, 200)).astype(np.float32)
    near = found(*points, np.float32(10.0))
    assert near.overfull.all()
    assert (np.asarray(near.index) >= 0).all()
    squared = ((points[:, near.index] - points[:, None, :]) ** 2).sum(axis=0)
    np.testing.assert_allclose(near.squared, squared, rtol=1e-5)


@pytest.mark.long
def test_who_is_nowhere_has_no_neighbours_and_is_nobodys():
    points = np.random.default_rng(6).uniform(0.0, 50.0, (3, 200)).astype(np.float32)
    points[1, 7], points[2, 9] = np.nan, np.inf
    for near in (found(*points, np.float32(20.0)), by_all_pairs(*map(jnp.asarray, points), 20.0, COUNT)):
        assert not np.isin([7, 9], near.index).any()
        assert (np.asarray(near.index)[:, [7, 9]] == -1).all()


@pytest.mark.long
def test_a_lonely_point_and_two_at_one_place():
    near = neighbours(*(jnp.asarray(axis) for axis in np.float32([[0, 0, 9], [1, 1, 1], [0, 0, 0]])), 5.0, 2)
    assert near.index.tolist() == [[1, 0, -1], [-1, -1, -1]]
    assert near.squared.tolist() == [[0.0, 0.0, np.inf], [np.inf] * 3]


def test_the_order_of_points_changes_nothing():
    """Points in another order have the same neighbours; no two are as far from a third."""
    points = np.random.default_rng(7).uniform(0.0, 300.0, (3, 200)).astype(np.float32)
    mixed = np.random.default_rng(0).permutation(200)
    near, other = found(*points, np.float32(60.0)), found(*points[:, mixed], np.float32(60.0))
    named = np.where(np.asarray(other.index) < 0, -1, mixed[np.asarray(other.index)])
    np.testing.assert_array_equal(np.asarray(near.index)[:, mixed], named)


@pytest.mark.long
@pytest.mark.parametrize("lanes", [pytest.param(8, marks=pytest.mark.long), 16])
def test_machine_code_of_our_own_finds_the_same(lanes):
    """In one world of cells; the code generator takes the search, with nothing left to XLA."""
    points = [axis[None] for axis in np.random.default_rng(8).uniform(0.0, 400.0, (3, 200)).astype(np.float32)]
    empty = {"index": np.zeros((1, COUNT, 200), np.int32), "squared": np.zeros((1, COUNT, 200), np.float32)}

    def search(shared, state, tick):
        near = neighbours(*state["points"], shared, COUNT, ROOM)
        return {"points": state["points"], "index": near.index, "squared": near.squared}

    state = {"points": points, **empty}
    mine, theirs = (
        each(search, state, *mode, shared=np.float32(60.0))[0]
        for each, mode in ((run, (Mode(lanes, False),)), (by_jax, ()))
    )
    assert (mine["index"] >= 0).any()
    np.testing.assert_array_equal(mine["index"], theirs["index"])
    np.testing.assert_allclose(mine["squared"], theirs["squared"], rtol=1e-6)
