"""Prisms by the cells of a grid, rays at their limits, and thin triangles, by hand."""

from __future__ import annotations

import math
from typing import Any

import jax
import numpy as np
import pytest

from qrsim.core.tree import cast
from qrsim.core.vectors import Vec3
from qrsim.models.scene.fence import polygon_problems
from qrsim.models.scene.obstacles import BoxObstacle, CylinderObstacle, Obstacles
from qrsim.models.scene.prisms import Pieces, PrismObstacle, Prisms, prisms_of
from qrsim.models.scene.rays import line_of_sight, ray_distance, walls_between

# An L: 20 m to the north, 10 m wide in the south and 4 m in the north, from 100 m north on.
L = [[100.0, 0.0], [120.0, 0.0], [120.0, 4.0], [110.0, 4.0], [110.0, 10.0], [100.0, 10.0]]


def vec(*points: tuple[float, float, float]) -> Any:
    return Vec3(*np.array(points, np.float32).T)


def slab(south: float, north: float, west: float, east: float) -> PrismObstacle:
    return PrismObstacle.of([[south, west], [north, west], [north, east], [south, east]], z_min=-10.0)


def row(count: int) -> list[PrismObstacle]:
    """Return slabs of 1 m by 14 m, each 20 m north of the one before."""
    return [slab(20.0 * i, 20.0 * i + 1.0, 0.0, 14.0) for i in range(count)]


def gridded(solids: list[PrismObstacle], radius: float = 1.0) -> Prisms:
    found = prisms_of(solids, range(len(solids)), radius)
    assert found is not None
    assert found.near is not None
    return found


def test_seventeen_pieces_have_a_grid_and_sixteen_have_none() -> None:
    few = prisms_of(row(16), range(16), 1.0)
    assert few is not None
    assert few.near is None
    assert gridded(row(17)).count == 17


def test_a_cell_names_what_its_places_are_near() -> None:
    """Cells of 4 m from 5 m beyond the slabs on; what is within 5 m and half a diagonal of the middle of a cell."""
    found = gridded(row(17))
    assert (found.rows, found.columns, found.most, found.reach, found.cell) == (83, 6, 1, 5.0, 4.0)
    np.testing.assert_allclose(found.corner, [-3.0, -3.0])
    north, east = np.meshgrid(-3.0 + 4.0 * np.arange(83), -3.0 + 4.0 * np.arange(6), indexing="ij")
    named = np.full((83, 6), 17)
    for i in range(17):
        to_north = np.maximum(np.maximum(20.0 * i - north, north - 20.0 * i - 1.0), 0.0)
        to_east = np.maximum(np.maximum(-east, east - 14.0), 0.0)
        named[np.hypot(to_north, to_east) <= 5.0 + 2.0 * math.sqrt(2.0)] = i
    np.testing.assert_array_equal(found.near.reshape(83, 6), named)
    # Named by cells without any is a cube of 1 m below the ground, 10 000 km to the north and to the east.
    last = [float(leaf[-1]) for leaf in jax.tree.leaves(found.pieces)]
    assert last == [1e7, 1e7 + 1.0, 1e7, 1e7, 1e7 + 1.0, 1e7 + 1.0, 0.0, 1.0, -1.0]


def test_large_vehicles_are_noticed_at_twice_their_radius() -> None:
    assert gridded(row(17), 4.0).reach == 8.0


def test_the_middle_of_a_slanted_prism_is_inside() -> None:
    """A parallelogram, all 14 m and more from 421 m north and 41 m east."""
    slanted = PrismObstacle.of([[400.0, 0.0], [440.0, 40.0], [440.0, 80.0], [400.0, 40.0]], z_min=-10.0)
    found = gridded([*row(16), slanted])
    assert 16 in found.near.reshape(found.rows, found.columns, found.most)[106, 11]


def test_of_a_large_world_the_cells_are_larger() -> None:
    """11 m by 11 000 km in 250 000 cells of 22 m by 22 m, if half a row counts as one."""
    solids = [slab(0.0, 1.0, 1000.0 * i, 1000.0 * i + 1.0) for i in range(16)]
    found = gridded([*solids, slab(0.0, 1.0, 10_999_000.0, 10_999_990.0)])
    assert (found.rows, found.columns) == (1, 500_000)
    assert found.cell == pytest.approx(22.0)
    np.testing.assert_allclose(found.corner, [6.0, 6.0])


def test_a_place_is_in_the_cell_whose_middle_is_nearest() -> None:
    """Three by three cells of 4 m, the first around the origin; each names a piece of its own, all at one place."""
    part: Any = np.zeros(9, np.float32)
    number: Any = np.arange(9, dtype=np.float32)
    pieces = Pieces(part, part + 1.0, (part, part), (part + 1.0, part + 1.0), part - 1.0, part, number)
    prisms = Prisms(pieces, np.arange(9, dtype=np.int32), (0.0, 0.0), 4.0, rows=3, columns=3, most=1, reach=5.0)
    places = vec((1.8, 0, 0), (2.1, 0, 0), (0, 1.8, 0), (0, 2.1, 0), (99, 0, 0), (0, 99, 0), (-99, -99, 0))
    _, found = jax.jit(lambda at: prisms.nearest(at))(places)
    assert np.asarray(found).tolist() == [0.0, 3.0, 0.0, 1.0, 6.0, 2.0, 0.0]


def solids() -> Any:
    """Return a box 10 m to the north, and the L."""
    box = BoxObstacle(*(np.array([v]) for v in (10.0, 20.0, 0.0, 4.0, -5.0, 0.0)))  # type: ignore[arg-type]
    none = CylinderObstacle(*(np.zeros(0),) * 5)  # type: ignore[arg-type]
    return cast(Obstacles(box, none, np.zeros(1), prisms_of([PrismObstacle.of(L, -5.0)], [1], 1.0)), np.float32)  # type: ignore[arg-type]


def test_rays_along_planes() -> None:
    """Along a face it meets a box; slower than 1e-12 of its length per unit it comes to no plane, else in the end."""
    far, slow, fast = 1.0 / 1.1e-12, 0.9e-12, 1.1e-12
    rays = (
        ((0.0, 0.0, -1.0), (1.0, 0.0, 0.0), 10.0),
        ((9.0, 2.0, -1.0), (fast, 0.0, 0.0), far),
        ((9.0, 2.0, -1.0), (slow, 0.0, 0.0), math.inf),
        ((105.0, -1.0, -1.0), (0.0, fast, 0.0), far),
        ((105.0, -1.0, -1.0), (0.0, slow, 0.0), math.inf),
        ((105.0, 11.0, -1.0), (0.0, -fast, 0.0), far),
        ((105.0, 11.0, -1.0), (0.0, -slow, 0.0), math.inf),
    )
    met = jax.jit(ray_distance)(solids(), vec(*(ray[0] for ray in rays)), vec(*(ray[1] for ray in rays)))
    np.testing.assert_allclose(met, [ray[2] for ray in rays], rtol=1e-5)


def test_what_is_a_tenth_farther_than_the_end_hides_nothing() -> None:
    """The box is 10 m away; the two pieces of the L count as one wall."""
    first = vec((0.0, 2.0, -1.0), (0.0, 2.0, -1.0), (95.0, 2.0, -1.0))
    last = vec((10.0 / 1.1, 2.0, -1.0), (11.0, 2.0, -1.0), (125.0, 2.0, -1.0))
    ask = jax.jit(lambda *ends: (line_of_sight(*ends), walls_between(*ends)))
    seen, walls = ask(solids(), first, last)
    assert np.asarray(seen).tolist() == [True, False, False]
    assert np.asarray(walls).tolist() == [0, 1, 1]


def test_how_thin_a_triangle_may_be() -> None:
    """A base of 1 and a height above or below a billionth of it."""
    assert polygon_problems([[0.0, 0.0], [1.0, 0.0], [0.5, 1.1e-9]]) == []
    assert "one line" in polygon_problems([[0.0, 0.0], [1.0, 0.0], [0.5, 0.9e-9]])[0]
