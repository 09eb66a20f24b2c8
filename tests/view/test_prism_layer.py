"""Prisms as a mesh of the page, and as lines of a Foxglove scene."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from qrsim.models.scene.prisms import PrismObstacle, prisms_of
from qrsim.runs.export.mcap_scene import _prism
from qrsim.view.ground import numbers_of, solids

# An L of 140 m^2 with a courtyard of 36 m^2, 10 m high.
L = [[0.0, 0.0], [20.0, 0.0], [20.0, 4.0], [10.0, 4.0], [10.0, 10.0], [0.0, 10.0]]
COURT = [[2.0, 2.0], [8.0, 2.0], [8.0, 8.0], [2.0, 8.0]]


def test_the_mesh_is_closed_and_as_large_as_the_prism() -> None:
    prisms = prisms_of([PrismObstacle.of(L, -10.0, 0.0, [COURT])], [0], 1.0)
    assert prisms is not None
    corners, faces = solids(prisms)
    a, b, c = (corners[faces[:, i]].astype(float) for i in range(3))
    # By Gauss: the signed volumes of the tetrahedra of all faces with the origin.
    assert abs(np.sum(a * np.cross(b, c)) / 6.0) == 1040.0


def test_the_lines_are_both_rings_below_and_above_and_the_upright_edges() -> None:
    lines = _prism({"corners_ned": L, "holes_ned": [COURT], "z_min": -10.0, "z_max": 0.0})
    assert len(lines) == 2 * 2 + 6 + 4
    assert {point["z"] for line in lines for point in line["points"]} == {0.0, 10.0}


def test_solids_have_the_numbers_of_their_obstacles() -> None:
    prisms = prisms_of([PrismObstacle.of(L, -10.0), PrismObstacle.of(COURT, -10.0)], [4, 1], 1.0)
    # Two boxes and a cylinder; the L has two pieces, and the square one.
    own: Any = SimpleNamespace(
        boxes=SimpleNamespace(x_min=[0.0, 9.0]), numbers=np.array([3.0, 0.0, 2.0]), prisms=prisms
    )
    assert numbers_of(own) == {"boxes": [3, 0], "cylinders": [2], "prisms": [4, 4, 1]}
    own.prisms = None
    assert numbers_of(own)["prisms"] == []
