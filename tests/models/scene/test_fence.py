"""Polygon areas: inside or out against winding numbers, distances against points along the edges, bad polygons."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.tree import cast
from qrsim.core.vectors import Vec3
from qrsim.models.scene.area import REASONS, BoxArea, Violation
from qrsim.models.scene.fence import PolygonArea, polygon_problems

Array = np.ndarray[Any, Any]

SQUARE = [[-100.0, -200.0], [-100.0, 200.0], [100.0, 200.0], [100.0, -200.0]]
# An L: what is north of 0 and east of 0 is missing.
ELL = [[-100.0, -100.0], [-100.0, 200.0], [0.0, 200.0], [0.0, 0.0], [300.0, 0.0], [300.0, -100.0]]
# A comb with three teeth, northwards.
COMB = [
    [0.0, 0.0], [500.0, 0.0], [500.0, 100.0], [50.0, 100.0], [50.0, 200.0], [500.0, 200.0], [500.0, 300.0],
    [50.0, 300.0], [50.0, 400.0], [500.0, 400.0], [500.0, 500.0], [0.0, 500.0],
]  # fmt: skip
STAR = [
    [radius * math.cos(i * math.pi / 7 + 0.1), radius * math.sin(i * math.pi / 7 + 0.1)]
    for i, radius in enumerate([900.0, 250.0] * 7)
]


def spiral() -> list[list[float]]:
    """Two turns of a band 60 m wide."""
    angles = np.linspace(0.0, 4.0 * math.pi, 40)
    radii = np.concatenate([100.0 + 60.0 * angles, 160.0 + 60.0 * angles[::-1]])
    angles = np.concatenate([angles, angles[::-1]])
    return np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1).tolist()


distance_to_fence, check = jax.jit(PolygonArea.distance_to_fence), jax.jit(PolygonArea.check)
SHAPES = {"square": SQUARE, "ell": ELL, "comb": COMB, "star": STAR, "spiral": spiral()}


def area(corners: Any, dtype: Any = np.float32) -> PolygonArea:
    north, east = np.asarray(corners, np.float64).T
    return cast(PolygonArea(north, east), dtype)  # type: ignore[arg-type]


def places(points: Any, z: float = -10.0, dtype: Any = np.float32) -> Vec3:
    x, y = np.asarray(points, dtype).T
    return Vec3(x, y, np.full_like(x, z))  # type: ignore[arg-type]


def distances(corners: Any, points: Any) -> Array:
    return np.asarray(distance_to_fence(area(corners), places(points)))


def winding_numbers(corners: Any, points: Array) -> Array:
    """Turns (n,) of the polygon about points (n, 2), from the angles its edges are seen at."""
    sight = np.asarray(corners)[None] - points[:, None]
    following = np.roll(sight, -1, axis=1)
    cross = sight[..., 0] * following[..., 1] - sight[..., 1] * following[..., 0]
    turns = np.sum(np.arctan2(cross, np.sum(sight * following, axis=-1)), axis=1) / (2.0 * math.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
    return np.round(turns)


def nearest_edge(corners: Any, points: Array) -> Array:
    """Distances (n,) of points (n, 2) from the edges, each edge as the line it is on and the ends it has."""
    start = np.asarray(corners)
    found = np.full(len(points), np.inf)
    for a, b in zip(start, np.roll(start, -1, axis=0), strict=True):
        along = (b - a) / np.linalg.norm(b - a)
        to_ends = np.minimum(np.linalg.norm(points - a, axis=1), np.linalg.norm(points - b, axis=1))
        progress = (points - a) @ along
        beside = np.abs((points - a) @ [-along[1], along[0]])
        found = np.minimum(found, np.where((progress > 0.0) & (progress < np.linalg.norm(b - a)), beside, to_ends))
    return found


def scattered(corners: Any, count: int = 4000) -> Array:
    corners = np.asarray(corners)
    low, high = corners.min(axis=0) - 50.0, corners.max(axis=0) + 50.0
    return np.random.default_rng(7).uniform(low, high, (count, 2))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("turn", [1, -1], ids=["forwards", "backwards"])
def test_side_and_distance_of_scattered_points(shape: str, turn: int) -> None:
    corners = SHAPES[shape][::turn]
    points = scattered(corners)
    expected = np.where(winding_numbers(corners, points) != 0.0, 1.0, -1.0) * nearest_edge(corners, points)
    assert 0.1 < np.mean(expected > 0.0) < 0.9
    with jax.enable_x64(True):
        double = np.asarray(distance_to_fence(area(corners, np.float64), places(points, dtype=np.float64)))
    assert double.dtype == np.float64
    np.testing.assert_allclose(double, expected, atol=1e-9)
    single = distance_to_fence(area(corners), places(points))
    assert single.dtype == np.float32
    # Coordinates of 1000 m have a spacing of 6e-5 m.
    np.testing.assert_allclose(single, expected, atol=5e-4)


@pytest.mark.parametrize("shape", ["ell", "comb"])
def test_a_ray_through_corners_or_along_an_edge_counts_rightly(shape: str) -> None:
    """Points on a grid that the corners are on too."""
    corners = np.asarray(SHAPES[shape])
    grid = np.stack(np.meshgrid(np.arange(-150.0, 600.0, 50.0), np.arange(-150.0, 600.0, 50.0)), axis=-1).reshape(-1, 2)
    apart = nearest_edge(corners, grid)
    found = distances(corners, grid)
    np.testing.assert_array_equal(np.abs(found), apart.astype(np.float32))
    off = apart > 0.0
    np.testing.assert_array_equal(found[off] > 0.0, winding_numbers(corners, grid[off]) != 0.0)
    assert np.count_nonzero(~off) > 10


@pytest.mark.parametrize("shape", SHAPES)
def test_corners_and_edges_belong_to_the_area(shape: str) -> None:
    corners = np.asarray(SHAPES[shape], np.float32)
    (_, at_corners, broken), _ = check(area(corners), places(corners))
    np.testing.assert_array_equal(at_corners, 0.0)
    assert not np.any(broken)
    middles = 0.5 * (corners + np.roll(corners, -1, axis=0))
    np.testing.assert_allclose(distances(corners, middles), 0.0, atol=1e-4)


def test_gradients_are_finite_everywhere_and_point_inwards() -> None:
    points = np.concatenate([ELL, [[-50.0, 0.0], [-90.0, 50.0], [150.0, 20.0], [400.0, -50.0], [-100.0, 20.0]]])

    def total(xy: jax.Array) -> jax.Array:
        return jnp.sum(area(ELL).distance_to_fence(Vec3(xy[:, 0], xy[:, 1], jnp.zeros(len(points)))))

    gradient = np.asarray(jax.jit(jax.grad(total))(jnp.asarray(points, jnp.float32)))
    assert np.all(np.isfinite(gradient))
    # Near the southern edge, outside the edge along the north, and beyond the northern edge.
    np.testing.assert_allclose(gradient[7:10], [[1.0, 0.0], [0.0, -1.0], [-1.0, 0.0]], atol=1e-6)


def test_reasons_and_values() -> None:
    inside, outside = [50.0, -50.0], [50.0, 30.0]
    points = places([inside, outside, inside, outside, inside])
    points = Vec3(points.x, points.y, np.array([-10.0, -10.0, -121.0, 0.5, 0.5], np.float32))  # type: ignore[arg-type]
    found = Violation.first(check(area(ELL), points), points.x)
    fence, height = ("out_of_area", "fence"), ("out_of_area", "position_ned.z")
    assert [REASONS[code] for code in np.asarray(found.code)] == [("valid", ""), fence, height, fence, height]
    np.testing.assert_array_equal(found.value, [0.0, -30.0, -121.0, -30.0, 0.5])
    np.testing.assert_array_equal(area(ELL).height_agl(points), [10.0, 10.0, 121.0, -0.5, -0.5])


def test_limits_of_height_are_allowed_and_can_be_set() -> None:
    low = cast(PolygonArea(*np.asarray(ELL).T, z_min=-30.0, z_max=-5.0), np.float32)  # type: ignore[arg-type]
    points = Vec3(*np.array([[0.0] * 4, [-50.0] * 4, [-30.0, -5.0, -30.1, -4.9]], np.float32))  # type: ignore[arg-type]
    np.testing.assert_array_equal(check(low, points)[1][2], [False, False, True, True])


def test_one_position_without_an_axis() -> None:
    place = Vec3(*(np.float32(value) for value in (-50.0, 0.0, -10.0)))  # type: ignore[arg-type]
    distance = distance_to_fence(area(ELL), place)
    assert distance.shape == ()
    assert distance == 50.0


def test_a_position_that_is_not_a_number_breaks_no_limit() -> None:
    # The world checks for that itself, first of all.
    (_, distance, broken), _ = check(area(ELL), places([[math.nan, 0.0], [0.0, math.nan]]))
    assert np.all(np.isnan(distance))
    assert not np.any(broken)


def test_a_position_infinitely_far_away_is_outside() -> None:
    far = [[math.inf, 0.0], [-math.inf, 0.0], [0.0, math.inf], [-50.0, -math.inf], [math.inf, -math.inf]]
    np.testing.assert_array_equal(distances(ELL, far), -math.inf)


def test_a_corner_given_twice_changes_nothing() -> None:
    points = scattered(ELL, 200)
    np.testing.assert_array_equal(distances([*ELL, ELL[-1]], points), distances(ELL, points))


# Polygons that are none


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("turn", [1, -1])
@pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (1e-5, 51.7)], ids=["metres", "degrees"])
def test_simple_polygons_have_no_problems(shape: str, turn: int, scale: float, offset: float) -> None:
    assert polygon_problems(offset + scale * np.asarray(SHAPES[shape][::turn])) == []


BAD: dict[str, tuple[list[list[float]], list[str]]] = {
    "empty": ([], ["has 0 corners; a polygon needs at least 3"]),
    "one": ([[1.0, 2.0]], ["has 1 corner; a polygon needs at least 3"]),
    "two": ([[0.0, 0.0], [1.0, 0.0]], ["has 2 corners; a polygon needs at least 3"]),
    "not numbers": (
        [[0.0, 0.0], [math.nan, 1.0], [1.0, 1.0], [0.0, math.inf]],
        ["corner 1 is not a pair of finite numbers", "corner 3 is not a pair of finite numbers"],
    ),
    "repeated": ([*SQUARE[:2], *SQUARE[1:]], ["corners 1 and 2 are the same point"]),
    "closed": ([*SQUARE, SQUARE[0]], ["corners 4 and 0 are the same point"]),
    "on a line": (
        [[0.0, 0.0], [1.0, 2.0], [3.0, 6.0], [2.0, 4.0]],
        ["encloses no area, because its corners lie on one line"],
    ),
    "bow tie": (
        [SQUARE[i] for i in (0, 1, 3, 2)],
        ["crosses itself: the edge from corner 1 to 2 meets the edge from corner 3 to 0"],
    ),
    "a corner on an edge": (
        [[0.0, 0.0], [0.0, 10.0], [10.0, 10.0], [0.0, 5.0], [10.0, 0.0]],
        ["crosses itself: the edge from corner 0 to 1 meets the edge from corner 2 to 3 (2 pairs of edges do)"],
    ),
    "there and back": (
        [[0.0, 0.0], [0.0, 10.0], [0.0, 5.0], [10.0, 0.0]],
        ["crosses itself: the edge from corner 0 to 1 meets the edge from corner 1 to 2 (2 pairs of edges do)"],
    ),
    "star of five lines": (
        [[math.cos(0.8 * math.pi * i), math.sin(0.8 * math.pi * i)] for i in range(5)],
        ["crosses itself: the edge from corner 0 to 1 meets the edge from corner 2 to 3 (5 pairs of edges do)"],
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_no_simple_polygon(case: str) -> None:
    corners, expected = BAD[case]
    assert polygon_problems(corners) == expected


def test_the_margin_is_the_distance_to_the_nearest_side_floor_or_ceiling() -> None:
    square = cast(
        PolygonArea(np.array([-10.0, 10.0, 10.0, -10.0]), np.array([-20.0, -20.0, 20.0, 20.0]), -30.0, 0.0), np.float32
    )  # type: ignore[arg-type]
    box = cast(BoxArea(-10.0, 10.0, -20.0, 20.0, -30.0, 0.0), np.float32)  # type: ignore[arg-type]
    points = np.array(
        [
            [0.0, 0.0, -15.0],
            [8.0, 0.0, -15.0],
            [0.0, -19.0, -15.0],
            [0.0, 0.0, -29.5],
            [0.0, 0.0, -0.25],
            [12.0, 0.0, -15.0],
            [0.0, 0.0, 1.0],
        ],
        np.float32,
    )
    position = Vec3(*(points[:, i] for i in range(3)))  # type: ignore[arg-type]
    expected = [10.0, 2.0, 1.0, 0.5, 0.25, -2.0, -1.0]
    for area in (square, box):
        np.testing.assert_allclose(area.margin(position), expected, atol=1e-5)


# A square with a slit from the north, 0.1 m wide at its mouth, whose tip is at 5 m south.
SLIT = [[-10.0, -10.0], [-10.0, 10.0], [10.0, 10.0], [10.0, 0.05], [-5.0, 0.0], [10.0, -0.05], [10.0, -10.0]]


def test_a_way_across_a_slit_leaves_the_area():
    """At 100 m/s a step of 0.02 s is 2 m: both ends are inside, and the way is not; south of the tip it is."""
    ways = np.array(
        [
            [[0.0, -1.0], [0.0, 1.0]],
            [[0.0, 1.0], [0.0, -1.0]],
            [[9.0, -1.0], [-9.0, 1.0]],
            [[-6.0, -1.0], [-6.0, 1.0]],
            [[0.0, -1.0], [0.0, -0.5]],
            [[0.0, 1.0], [0.0, 1.0]],
            [[-9.0, -9.0], [-9.0, 9.0]],
        ]
    )
    start, end = places(ways[:, 0]), places(ways[:, 1])
    assert not np.asarray(check(area(SLIT), end)[0][2]).any(), "the ends alone show nothing"
    (_, distance, broken), _ = jax.jit(PolygonArea.swept)(area(SLIT), start, end)
    assert np.asarray(broken).tolist() == [True, True, True, False, False, False, False]
    # The fence itself, where the way crosses it; else the distance of the end: of the tip at (-5, 0) from (-6, 1).
    assert np.asarray(distance)[[0, 3]] == pytest.approx([0.0, math.sqrt(2.0)])


def test_no_way_inside_a_convex_polygon_leaves_it():
    """Ways of up to 450 m between points of the square, some of which start on its edge."""
    random = np.random.default_rng(5)
    start, end = random.uniform(-1.0, 1.0, (2, 500, 2)) * [99.0, 199.0]
    start[:20, 0] = -100.0
    (_, _, broken), _ = jax.jit(PolygonArea.swept)(area(SQUARE), places(start), places(end))
    assert not np.asarray(broken).any()
