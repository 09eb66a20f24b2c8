"""Distances from obstacles, by hand."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.tree import cast
from qrsim.core.vectors import Vec3
from qrsim.models.scene.obstacles import BoxObstacle, CylinderObstacle, Obstacles
from qrsim.models.scene.prisms import PrismObstacle, prisms_of
from qrsim.models.scene.sweeping import obstacle_hit

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


WALL = cast(BoxObstacle(x_min=5.0, x_max=5.1, y_min=-3.0, y_max=3.0, z_min=-5.0), np.float32)
POLE = cast(CylinderObstacle(x=5.0, y=8.0, radius=0.05, z_min=-5.0), np.float32)


def thin(wall: bool) -> Obstacles:
    """Return a wall of 0.1 m, a box or a prism, and a pole of 0.1 m."""
    boxes, poles = jax.tree.map(lambda leaf: np.atleast_1d(leaf), (WALL, POLE))
    if not wall:
        boxes = jax.tree.map(lambda leaf: leaf[:0], boxes)
    corners = [[5.0, -3.0], [5.1, -3.0], [5.1, 3.0], [5.0, 3.0]]
    prisms = None if wall else cast(prisms_of([PrismObstacle.of(corners, -5.0)], [7], 0.1), np.float32)
    return Obstacles(boxes, poles, np.array([7.0, 3.0] if wall else [3.0], np.float32), prisms)


@pytest.mark.parametrize("box", [True, False])
@pytest.mark.parametrize(
    ("start", "end", "radius", "number"),
    [
        # Through the wall and out of it: of vehicles without a size, and of 0.1 m.
        ((4.8, 0.0, -2.0), (5.3, 0.0, -2.0), 0.0, 7.0),
        ((4.5, 0.0, -2.0), (5.6, 0.4, -2.5), 0.1, 7.0),
        # Beside its end, over it, and away from it.
        ((4.8, 3.11, -2.0), (5.4, 3.11, -2.0), 0.1, None),
        ((4.8, 3.09, -2.0), (5.4, 3.09, -2.0), 0.1, 7.0),
        ((4.8, 0.0, -5.11), (5.4, 0.0, -5.11), 0.1, None),
        ((4.8, 0.0, -2.0), (4.3, 0.0, -2.0), 0.1, None),
        # Across the pole: its radius and that of the vehicle are 0.15 m.
        ((4.0, 8.14, -2.0), (6.0, 8.14, -2.0), 0.1, 3.0),
        ((4.0, 8.16, -2.0), (6.0, 8.16, -2.0), 0.1, None),
    ],
)
def test_a_way_through_what_is_thin_is_a_hit(
    box: bool, start: tuple[float, ...], end: tuple[float, ...], radius: float, number: float | None
) -> None:
    found, hit = obstacle_hit(thin(box), at(start), at(end), jnp.float32(radius))  # type: ignore[arg-type]
    assert bool(hit[0]) == (number is not None)
    if number is not None:
        assert found[0] == number


def test_both_ends_of_a_way_through_a_wall_are_free() -> None:
    for place in ((4.8, 0.0, -2.0), (5.3, 0.0, -2.0)):
        assert not obstacle_hit(thin(True), at(place), at(place), jnp.float32(0.1))[1][0]
