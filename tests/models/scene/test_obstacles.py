"""Distances from obstacles, by hand."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.tree import cast
from qrsim.core.vectors import Vec3
from qrsim.models.scene.obstacles import BoxObstacle, CylinderObstacle, Obstacles

BOX = cast(BoxObstacle(x_min=0.0, x_max=2.0, y_min=-1.0, y_max=1.0, z_min=-5.0), np.float32)
MAST = cast(CylinderObstacle(x=10.0, y=0.0, radius=2.0, z_min=-8.0), np.float32)


def at(*points: tuple[float, float, float]) -> Vec3:
    return Vec3.of(jnp.array(points, jnp.float32))


def both(numbers: tuple[float, ...] = (0.0, 1.0)) -> Obstacles:
    one = jax.tree.map(lambda leaf: np.atleast_1d(leaf), (BOX, MAST))
    return Obstacles(*one, np.array(numbers, np.float32))


@pytest.mark.parametrize(
    ("point", "distance"),
    [
        ((1.0, 0.0, -1.0), 0.0),
        ((-3.0, 0.0, -1.0), 3.0),
        ((1.0, 5.0, -1.0), 4.0),
        ((1.0, 0.0, -7.5), 2.5),
        ((5.0, 5.0, -5.0), 5.0),
        ((-2.0, 3.0, -6.0), 3.0),
    ],
)
def test_box(point: tuple[float, float, float], distance: float) -> None:
    assert float(BOX.distance(at(point))[0]) == pytest.approx(distance, abs=1e-6)


@pytest.mark.parametrize(
    ("point", "distance"),
    [
        ((10.0, 1.5, -1.0), 0.0),
        ((13.0, 4.0, -1.0), 3.0),
        ((10.0, 0.0, -9.0), 1.0),
        ((10.0, 5.0, -12.0), 5.0),
    ],
)
def test_cylinder(point: tuple[float, float, float], distance: float) -> None:
    assert float(MAST.distance(at(point))[0]) == pytest.approx(distance, abs=1e-6)


def test_nearest_gives_distance_and_number_in_the_scenario() -> None:
    distance, number = both(numbers=(1.0, 0.0)).nearest(at((3.0, 0.0, -1.0), (7.5, 0.0, -1.0)))
    np.testing.assert_allclose(distance, [1.0, 0.5], atol=1e-6)
    np.testing.assert_array_equal(number, [1.0, 0.0])


def test_without_obstacles_the_nearest_is_infinitely_far() -> None:
    empty = jax.tree.map(lambda leaf: np.zeros(0, np.float32), both())
    distance, number = empty.nearest(at((0.0, 0.0, 0.0)))
    assert np.isinf(distance[0])
    assert number[0] == -1.0


@pytest.mark.long
def test_gradients_are_finite_outside() -> None:
    gradient = jax.grad(lambda p: jnp.sum(both().nearest(Vec3.of(p))[0]))(jnp.array([[-3.0, 0.5, -1.0]]))
    assert np.all(np.isfinite(gradient))


@pytest.mark.parametrize("point", [(1.0, 0.0, -1.0), (0.0, 0.0, -1.0), (10.0, 0.0, -1.0), (12.0, 0.0, -8.0)])
def test_inside_and_at_a_face_the_distance_is_exactly_zero_and_has_a_slope(point: tuple[float, float, float]) -> None:
    distance, _ = both().nearest(at(point))
    assert distance[0] == 0.0
    slope = jax.grad(lambda p: jnp.sum(both().nearest(Vec3.of(p))[0]))(jnp.array([point]))
    assert np.all(np.isfinite(slope))


def test_a_position_that_is_not_a_number_is_not_inside() -> None:
    assert np.isnan(both().nearest(at((np.nan, 0.0, -1.0)))[0]).all()


def test_in_numpy_it_is_the_same() -> None:
    """Scenarios are checked without compiling anything."""
    points = np.random.default_rng(2).uniform(-12.0, 12.0, (50, 3)).astype(np.float32)
    for solid in (BOX, MAST):
        plain = solid.distance(Vec3(*points.T))  # type: ignore[arg-type]
        assert isinstance(plain, np.ndarray)
        np.testing.assert_allclose(plain, solid.distance(Vec3.of(jnp.asarray(points))), atol=1e-5)
