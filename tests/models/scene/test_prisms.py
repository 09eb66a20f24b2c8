"""Prisms: distances by hand and against all edges, pieces, and lines of sight against an independent geometry."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.by_numpy import uncompiled

from qrsim.core.tree import cast
from qrsim.core.vectors import Vec3
from qrsim.models.scene.obstacles import BoxObstacle, CylinderObstacle, Obstacles
from qrsim.models.scene.prisms import PrismObstacle, prisms_of, trapezoids
from qrsim.models.scene.rays import line_of_sight, ray_distance

# An L, 10 m high: 20 m to the north, 10 m wide in the south and 4 m in the north.
L = [[0.0, 0.0], [20.0, 0.0], [20.0, 4.0], [10.0, 4.0], [10.0, 10.0], [0.0, 10.0]]
COURT = [[2.0, 2.0], [8.0, 2.0], [8.0, 8.0], [2.0, 8.0]]


def at(*points: tuple[float, float, float]) -> Vec3:
    return Vec3.of(jnp.array(points, jnp.float32))


def world(solids: list[PrismObstacle], **more: Any) -> Obstacles:
    boxes = more.get("boxes", BoxObstacle(*(np.zeros(0),) * 6))
    cylinders = more.get("cylinders", CylinderObstacle(*(np.zeros(0),) * 5))
    count = len(boxes.z_min) + len(cylinders.z_min)
    numbers = np.arange(count, dtype=np.float64)
    prisms = prisms_of(solids, range(count, count + len(solids)), 1.0)
    return cast(Obstacles(boxes, cylinders, numbers, prisms), np.float32)


@pytest.mark.long
def test_distance() -> None:
    solid = PrismObstacle.of(L, z_min=-10.0)
    points = at((15, 2, -5), (15, 8, -5), (13, 7, -5), (-3, -4, -5), (5, 5, -13), (15, 7, -14))
    by_hand = [0.0, 4.0, 3.0, 5.0, 3.0, 5.0]
    np.testing.assert_allclose(uncompiled(solid.distance)(points), by_hand, atol=1e-5)
    found, number = uncompiled(world([solid]).nearest)(points)
    np.testing.assert_allclose(found, by_hand, atol=1e-5)
    assert (np.asarray(number) == 0.0).all()


def test_a_courtyard_is_not_inside() -> None:
    solid = PrismObstacle.of(L, -10.0, 0.0, [COURT])
    assert float(uncompiled(solid.distance)(at((5.0, 5.0, -1.0)))[0]) == pytest.approx(3.0)
    assert float(uncompiled(world([solid]).nearest)(at((5.0, 5.0, -1.0)))[0][0]) == pytest.approx(3.0)
    assert float(uncompiled(world([solid]).nearest)(at((1.0, 5.0, -1.0)))[0][0]) == 0.0


def test_the_pieces_have_the_polygons_area() -> None:
    turned = np.array(L) @ np.array([[0.8, -0.6], [0.6, 0.8]])
    for rings, area in (([L], 140.0), ([L, COURT], 104.0), ([turned], 140.0)):
        south, north, w0, w1, e0, e1 = trapezoids(rings).T
        assert np.sum(0.5 * (north - south) * (e0 - w0 + e1 - w1)) == pytest.approx(area)


def blocks(count: int) -> list[PrismObstacle]:
    """Return turned Ls with courtyards over 200 m."""
    rng, found = np.random.default_rng(1), []
    for _ in range(count):
        angle, place = rng.uniform(0.0, np.pi), rng.uniform(-100.0, 100.0, 2)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        found.append(
            PrismObstacle.of(np.array(L) @ turn + place, -rng.uniform(4.0, 40.0), 0.0, [np.array(COURT) @ turn + place])
        )
    return found


@pytest.mark.long
def test_by_cells_it_is_the_nearest_of_all_prisms_within_reach() -> None:
    solids = blocks(25)
    places = np.random.default_rng(2).uniform([-120.0, -120.0, -50.0], [120.0, 120.0, 0.0], (1000, 3))
    each = np.array([solid.distance(Vec3(*places.T)) for solid in solids])  # type: ignore[arg-type]
    found = world(solids)
    assert found.prisms is not None
    assert found.prisms.near is not None, "so many pieces have a grid"
    distance, number = uncompiled(found.nearest)(Vec3.of(jnp.asarray(places, jnp.float32)))
    near = each.min(axis=0) < 5.0
    assert 100 < np.sum(near) < 900
    np.testing.assert_allclose(np.asarray(distance)[near], each.min(axis=0)[near], atol=1e-4)
    inside = each.min(axis=0) == 0.0
    assert (np.asarray(distance)[inside] == 0.0).all()
    alone = near & (np.sort(each, axis=0)[1] > each.min(axis=0) + 1e-3)
    np.testing.assert_array_equal(np.asarray(number)[alone], each.argmin(axis=0)[alone])
    assert (np.asarray(distance)[~near] > 4.999).all()


@pytest.mark.long
def test_among_boxes_and_cylinders_the_nearest_counts_and_slopes_are_finite() -> None:
    box = BoxObstacle(*(np.array([v]) for v in (-20.0, -10.0, 0.0, 5.0, -5.0, 0.0)))  # type: ignore[arg-type]
    all_three = world([PrismObstacle.of(L, -10.0)], boxes=box)
    distance, number = uncompiled(all_three.nearest)(at((-8.0, 2.0, -1.0), (-3.0, 2.0, -1.0)))
    np.testing.assert_allclose(distance, [2.0, 3.0], atol=1e-6)
    np.testing.assert_array_equal(number, [0.0, 1.0])
    slope = uncompiled(jax.grad(lambda p: jnp.sum(all_three.nearest(Vec3.of(p))[0])))(
        jnp.array([[5.0, 5.0, -1.0], [-4.0, 2.0, -1]])
    )
    assert np.isfinite(slope).all()
    assert np.isnan(uncompiled(all_three.nearest)(at((np.nan, 0.0, -1.0)))[0]).all()


@pytest.mark.long
def test_rays_by_hand() -> None:
    cylinder = CylinderObstacle(*(np.array([v]) for v in (50.0, 0.0, 2.0, -8.0, 0.0)))  # type: ignore[arg-type]
    box = BoxObstacle(*(np.array([v]) for v in (-20.0, -10.0, -5.0, 5.0, -5.0, 0.0)))  # type: ignore[arg-type]
    found = world([PrismObstacle.of(L, -10.0, 0.0, [COURT])], boxes=box, cylinders=cylinder)
    origin = at((40.0, 2.0, -3.0), (40.0, 0.0, -3.0), (5.0, 5.0, -3.0), (-40.0, 0.0, -3.0), (0.0, -30.0, -12.0))
    ray = at((-1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 2.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    np.testing.assert_allclose(uncompiled(ray_distance)(found, origin, ray), [20.0, 8.0, 1.5, 20.0, np.inf], atol=1e-5)
    # Over the roof, through the notch, and from inside the wall.
    first = at((-5.0, 5.0, -9.0), (-5.0, 5.0, -11.0), (15.0, 5.0, -1.0), (1.0, 1.0, -1.0))
    last = at((30.0, 5.0, -9.0), (30.0, 5.0, -11.0), (25.0, 8.0, -1.0), (1.0, -9.0, -1.0))
    np.testing.assert_array_equal(uncompiled(line_of_sight)(found, first, last), [False, True, True, False])


@pytest.mark.long
def test_lines_of_sight_are_those_of_another_geometry() -> None:
    """Shapely cuts the plan of each line with each footprint; a line is blocked where it is below the roof there."""
    shapely = pytest.importorskip("shapely")
    solids = blocks(12)
    rng = np.random.default_rng(3)
    first, last = (rng.uniform([-120.0, -120.0, -45.0], [120.0, 120.0, 0.0], (200, 3)) for _ in range(2))
    plans = [shapely.Polygon(solid.rings()[0], solid.rings()[1:]) for solid in solids]
    clear = np.ones(200, bool)
    for i, (a, b) in enumerate(zip(first, last, strict=True)):
        line = shapely.LineString([a[:2], b[:2]])
        for solid, plan in zip(solids, plans, strict=True):
            cut = line.intersection(plan)
            parts = np.array([line.project(shapely.Point(p)) / line.length for p in shapely.get_coordinates(cut)])
            down = a[2] + parts * (b[2] - a[2])
            clear[i] &= not len(parts) or bool((down < float(solid.z_min)).all())
    found = line_of_sight(world(solids), *(Vec3.of(jnp.asarray(p, jnp.float32)) for p in (first, last)))
    assert 20 < clear.sum() < 180
    np.testing.assert_array_equal(found, clear)
