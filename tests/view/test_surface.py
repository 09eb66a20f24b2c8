"""The ground as the page draws it."""

from __future__ import annotations

import numpy as np

from qrsim.models.scene.ground import FlatGround, GridGround
from qrsim.view.ground import MOST_ALONG, down_at, surface


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


def test_heights_of_a_flat_ground() -> None:
    np.testing.assert_array_equal(down_at(FlatGround(height=3.0), np.zeros(2), np.zeros(2)), [-3.0, -3.0])
