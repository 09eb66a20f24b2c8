"""The ground as the page draws it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from qrsim.models.scene.ground import FlatGround, GridGround
from qrsim.scenarios.making import make_world
from qrsim.view.contents import plate
from qrsim.view.frame import Cast
from qrsim.view.ground import MOST_ALONG, surface
from qrsim.view.layers import down_at
from qrsim.view.scene import Scene
from qrsim.view.server import start_server


@pytest.mark.long
def test_a_surface_is_the_ground_over_the_outline_of_the_area() -> None:
    # It rises by 1 m in 10 m to the north.
    grid = np.array([[10.0, 10.0], [-10.0, -10.0]])
    ground = GridGround(grid, (-100.0, -100.0), (200.0, 200.0), np.zeros((8, 180)), (0.0, -200.0))  # type: ignore[arg-type]
    outline = np.array([[-50.0, -20.0], [-50.0, 30.0], [80.0, 30.0], [80.0, -20.0]])
    points, faces = surface(ground, (outline, -120.0, 0.0), 500.0)
    assert points.shape == (MOST_ALONG**2, 3)
    np.testing.assert_allclose(points[[0, -1]], [[-50.0, -20.0, 5.0], [80.0, 30.0, -8.0]], atol=1e-4)
    assert faces.shape == (2 * (MOST_ALONG - 1) ** 2, 3)
    # All faces together cover the outline once.
    a, b, c = (points[faces[:, i], :2].astype(float) for i in range(3))
    areas = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    np.testing.assert_allclose(areas.sum(), 130.0 * 50.0, rtol=1e-4)


def test_cover_has_no_seams() -> None:
    """Cells of 10 m by 20 m in an L share their corners; together they have the area of three cells."""
    there = np.zeros((4, 3), bool)
    there[1, 1] = there[2, 1] = there[2, 2] = True
    corners, faces = plate(there, np.array([0.0, -30.0]), np.array([40.0, 30.0]))
    assert len(corners) == 8
    assert len(np.unique(corners, axis=0)) == 8
    assert faces.shape == (6, 3)
    a, b, c = (corners[faces[:, i], :2] for i in range(3))
    areas = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    np.testing.assert_allclose(areas, 100.0)
    np.testing.assert_array_equal([corners.min(axis=0), corners.max(axis=0)], [[10.0, -10.0, 0.0], [30.0, 30.0, 0.0]])


def test_heights_of_a_flat_ground() -> None:
    np.testing.assert_array_equal(down_at(FlatGround(height=3.0), np.zeros(2), np.zeros(2)), [-3.0, -3.0])


@pytest.mark.long
def test_the_page_shows_the_surface_in_place_of_the_plane(tmp_path: Path) -> None:
    places = 50.0 * np.arange(-3, 4)
    np.savez(tmp_path / "hill.npz", north=places, east=places, height=100.0 - np.hypot(places[:, None], places) / 10.0)
    area = {"type": "box", "x_min": -100, "x_max": 100, "y_min": -120, "y_max": 120}
    start = np.array([[0.0, 0.0, -20.0]])
    shown = {}
    for ground in ({"type": "flat"}, {"type": "dem", "file": str(tmp_path / "hill.npz")}):
        world = make_world(start.tolist(), ground=ground, area=area)
        server = start_server(0)
        try:
            Scene(server, Cast(("a",), np.zeros(1, int), start), world)
            shown[ground["type"]] = set(server.scene._handle_from_node_name)
        finally:
            server.stop()
    assert {name.rpartition("/")[2] for name in shown["flat"] ^ shown["dem"]} == {"grid", "surface", "sun"}
