"""Zones: the compiled decision and the host's against shapely and by hand, distances, ways between ticks."""

from __future__ import annotations

import math
from typing import Any

import jax
import numpy as np
import pytest
import shapely

from qrsim.core.host import on_host
from qrsim.core.tree import cast
from qrsim.core.vectors import Vec3
from qrsim.models.scene.area import REASONS
from qrsim.models.scene.ground import FlatGround
from qrsim.models.scene.zone import Zone, Zones
from qrsim.models.scene.zones import ZonesArea

SQUARE = ((-50.0, -50.0), (-50.0, 50.0), (50.0, 50.0), (50.0, -50.0))
HOLE = ((-20.0, -20.0), (-20.0, 30.0), (25.0, 0.0))
FENCE = REASONS.index(("out_of_area", "fence"))

compiled_inside = jax.jit(ZonesArea.inside)
checked = on_host(lambda area, place: area.check(place))
swept = on_host(lambda area, before, place: area.swept(before, place))


def star(rng: Any, corners: int, middle: Any, radius: float) -> tuple[tuple[float, float], ...]:
    angles = np.sort(rng.uniform(0.0, 2.0 * math.pi, corners))
    lengths = radius * rng.uniform(0.4, 1.0, corners)
    points = np.stack([middle[0] + lengths * np.cos(angles), middle[1] + lengths * np.sin(angles)], axis=1)
    return tuple(map(tuple, points.tolist()))


def twenty_zones() -> list[Zone]:
    """20 zones, most of 40 corners: one with a hole and a circle to stay in, others with ceilings to stay out of."""
    rng = np.random.default_rng(1)
    zones = [Zone(True, (star(rng, 40, (0.0, 0.0), 900.0), HOLE))]
    for _ in range(17):
        middle = rng.uniform(-600.0, 600.0, 2)
        zones.append(Zone(False, (star(rng, 40, middle, 80.0),), ceiling=float(rng.uniform(20.0, 90.0))))
    zones.append(Zone(False, (), (100.0, -200.0), 60.0, 20.0, 60.0))
    zones.append(Zone(True, (), (700.0, 700.0), 260.0))
    return zones


def area_of(zones: list[Zone], ground: Any = None, breach: str = "end") -> ZonesArea:
    return cast(ZonesArea(z_min=-120.0, z_max=0.0, breach=breach).of(zones, ground), np.dtype("float32"))  # type: ignore[arg-type]


def places(*rows: Any) -> Vec3:
    return Vec3(*np.array(rows, np.float32).T)  # type: ignore[arg-type]


def by_shapely(zones: list[Zone], place: Vec3) -> tuple[Any, Any]:
    """Return which places are allowed, and how far each is from the nearest edge, floor or ceiling."""
    x, y, height = (np.asarray(axis, float) for axis in (place.x, place.y, -place.z))  # type: ignore[operator]
    points, near = shapely.points(x, y), np.full(x.shape, np.inf)
    kept, barred = np.zeros(x.shape, bool), np.zeros(x.shape, bool)
    for zone in zones:
        if zone.rings:
            shape = shapely.Polygon(zone.rings[0], zone.rings[1:])
            over, aside = shapely.contains(shape, points), shapely.distance(shape.boundary, points)
        else:
            away = shapely.distance(shapely.Point(zone.centre), points)
            over, aside = away <= zone.radius, np.abs(away - zone.radius)
        level = (height <= zone.ceiling) & ((height >= zone.floor) | (zone.floor == 0.0))
        gaps = [aside, np.abs(height - zone.ceiling)] + ([np.abs(height - zone.floor)] if zone.floor else [])
        near = np.minimum(near, np.min(gaps, axis=0))
        kept, barred = kept | (zone.keep & over & level), barred | (~zone.keep & over & level)  # type: ignore[operator]
    return kept & ~barred, near


def inside(area: ZonesArea, place: Vec3) -> Any:
    """By NumPy, which compiles nothing."""
    return area.inside(place)


def distance(area: ZonesArea, place: Vec3) -> Any:
    return area.distance_to_zones(place)


@pytest.mark.parametrize(
    ("count", "decide"), [(2000, inside), pytest.param(10_000, compiled_inside, marks=pytest.mark.long)]
)
def test_decisions_are_those_of_shapely(count: int, decide: Any) -> None:
    zones, rng = twenty_zones(), np.random.default_rng(2)
    area = area_of(zones)
    assert sum(len(ring) for zone in area.zones for ring in zone.rings) == 18 * 40 + 3
    rows = np.column_stack([*rng.uniform(-950.0, 950.0, (2, count)), rng.uniform(-100.0, 0.0, count)])
    place = places(*rows)
    allowed, near = by_shapely(zones, place)
    assert 0.3 < allowed.mean() < 0.7
    clear = near > 1e-3
    assert clear.mean() > 0.99
    np.testing.assert_array_equal(np.asarray(decide(area, place))[clear], allowed[clear])
    host, some = Zones(zones), clear[:500]
    found = np.array([host.inside(*row) for row in rows[:500].astype(np.float32).tolist()])
    np.testing.assert_array_equal(found[some], allowed[:500][some])
    fewer = places(*rows[:200])
    assert ((distance(area, fewer) >= 0.0) == inside(area, fewer)).all()


def test_distances_by_hand() -> None:
    """A square with a hole, ceiling 60, and a keep-out between 20 and 40 m; heights are positive up."""
    zones = [
        Zone(True, (SQUARE, ((30.0, 30.0), (30.0, 40.0), (40.0, 40.0), (40.0, 30.0))), ceiling=60.0),
        Zone(False, (), (-20.0, 0.0), 10.0, 20.0, 40.0),
    ]
    place = places(
        [0, -45, -10],  # 5 m from the side
        [0, -53, -10],  # 3 m outside
        [35, 32, -10],  # 2 m deep in the hole
        [40, -20, -58],  # 2 m below the ceiling
        [40, -20, -63],  # 3 m above it
        [-20, 4, -30],  # 6 m deep in the keep-out
        [-20, 4, -15],  # 5 m below it
        [-20, 0, -44],  # 4 m above it
    )
    expected = [5.0, -3.0, -2.0, 2.0, -3.0, -6.0, 5.0, 4.0]
    np.testing.assert_allclose(distance(area_of(zones), place), expected, atol=1e-4)
    host = Zones(zones)
    rows = np.column_stack([place.x, place.y, place.z]).tolist()
    np.testing.assert_allclose([host.limit(*row)[0] for row in rows], expected, atol=1e-4)
    (code, value, broken), (_, z, _) = checked(area_of(zones), place)
    assert code == FENCE
    assert broken.tolist() == [False, True, True, False, True, True, False, False]
    np.testing.assert_allclose(value, np.minimum(expected, 0.0), atol=1e-4)
    assert z[0] == -10.0


def test_zones_that_meet_have_neither_a_gap_nor_an_edge_there() -> None:
    """A square, a neighbour with a common edge, one that overlaps, and one inside with a part of the outer edge."""
    slanted = ((-50.0, 50.0), (50.0, 50.0), (57.3, 90.0), (-41.7, 88.8))
    overlaps = ((-20.0, -90.0), (-20.0, -30.0), (20.0, -30.0), (20.0, -90.0))
    inner = ((10.0, -10.0), (50.0, -10.0), (50.0, 10.0), (10.0, 10.0))
    area = area_of([Zone(True, (ring,)) for ring in (SQUARE, slanted, overlaps, inner)])
    along = np.linspace(-49.0, 49.0, 501)
    assert inside(area, places(*((north, 50.0, -10.0) for north in along))).all()
    rows = [[0, 50], [0, -50], [0, -30], [10, 0], [45, 0], [-45, 70], [3, -80]]
    edge = shapely.unary_union([shapely.Polygon(ring) for ring in (SQUARE, slanted, overlaps, inner)]).boundary
    expected = shapely.distance(edge, shapely.points(rows))
    assert expected[1:5].tolist() == pytest.approx([20.0, 28.284, 40.0, 5.0], abs=1e-3)
    np.testing.assert_allclose(distance(area, places(*([*row, -10] for row in rows))), expected, atol=1e-3)


def test_a_polygon_inside_a_circle_has_no_edge_of_its_own() -> None:
    area = area_of([Zone(True, (), (0.0, 0.0), 100.0), Zone(True, (SQUARE,))])
    np.testing.assert_allclose(distance(area, places([0, 40, -10], [0, 103, -10])), [60.0, -3.0], atol=1e-3)


def test_heights_above_terrain_count_from_the_ground_below() -> None:
    """The ground is at 12 m; the keep-out ends 30 m above it."""
    zones = [Zone(False, (SQUARE,), ceiling=30.0, terrain=True)]
    area = area_of(zones, FlatGround(height=np.float32(12.0)))  # type: ignore[arg-type]
    np.testing.assert_array_equal(inside(area, places([0, 0, -41], [0, 0, -43])), [False, True])
    host = Zones(zones, lambda north, east: -12.0)
    assert [host.inside(0.0, 0.0, down) for down in (-41.0, -43.0)] == [False, True]
    assert area_of([Zone(True, (SQUARE,))], FlatGround()).ground is None


def test_a_long_step_is_checked_between_its_ends() -> None:
    thin = ((-1.0, -50.0), (-1.0, 50.0), (1.0, 50.0), (1.0, -50.0))
    area = area_of([Zone(False, (thin,))])
    before, after = places([-4, 0, -5], [-4, 0, -5]), places([4, 0, -5], [-2, 0, -5])
    (_, value, broken), _ = swept(area, before, after)
    assert broken.tolist() == [True, False]
    assert value.tolist() == [0.0, 0.0]


def test_a_reported_breach_ends_no_flight_but_the_ceiling_of_the_area_does() -> None:
    area = area_of([Zone(True, (SQUARE,))], breach="report")
    ((code, _, broken),) = checked(area, places([90, 0, -10], [0, 0, -130]))
    assert REASONS[code] == ("out_of_area", "position_ned.z")
    assert broken.tolist() == [False, True]


def test_the_farthest_corner() -> None:
    area = area_of([Zone(True, (SQUARE,)), Zone(True, (), (100.0, 0.0), 30.0), Zone(False, (), (900.0, 0.0), 5.0)])
    found = on_host(lambda area, place: area.farthest_squared(place))(area, places([0, 0, -20]))
    assert found[0] == pytest.approx(130.0**2 + 100.0**2)


@pytest.mark.parametrize(
    ("begin", "end", "length", "first"),
    [
        ((0.0, -100.0, -10.0), (0.0, 100.0, -10.0), 100.0, (0.0, -50.0, -10.0)),
        ((0.0, -100.0, -70.0), (0.0, 100.0, -70.0), 0.0, None),  # above its ceiling
        ((0.0, 0.0, -10.0), (0.0, 0.0, -100.0), 50.0, (0.0, 0.0, -10.0)),  # up through its ceiling
        ((60.0, -60.0, -10.0), (60.0, 60.0, -10.0), 0.0, None),
    ],
)
def test_the_part_of_a_way_inside_a_zone(begin: Any, end: Any, length: float, first: Any) -> None:
    zone = Zone(False, (SQUARE,), ceiling=60.0)
    found, where = zone.along(begin, end)
    assert found == pytest.approx(length)
    assert where == (None if first is None else pytest.approx(first))


def test_the_part_of_a_way_inside_a_circle_and_outside_what_to_stay_in() -> None:
    circle = Zone(False, (), (0.0, 0.0), 5.0)
    assert circle.along((3.0, -10.0, -5.0), (3.0, 10.0, -5.0)) == (pytest.approx(8.0), pytest.approx((3.0, -4.0, -5.0)))
    zones = Zones([Zone(True, (SQUARE, HOLE))])
    length, first = zones.outside((-10.0, -40.0, -5.0), (-10.0, 60.0, -5.0))
    # The hole at north -10: from east -20 + 10 x 20 / 45 to 30 - 10 x 30 / 45; and 10 m beyond the square.
    assert length == pytest.approx(30.0 - 10.0 * 30.0 / 45.0 + 20.0 - 10.0 * 20.0 / 45.0 + 10.0)
    assert first == pytest.approx((-10.0, -20.0 + 10.0 * 20.0 / 45.0, -5.0))
