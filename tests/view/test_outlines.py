"""How far apart the walls of obstacles are, by the script of the page in an empty one."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

import numpy as np
import pytest

from qrsim.models.scene.prisms import PrismObstacle, prisms_of
from qrsim.view import shapes
from qrsim.view.browser import INSTALL, Browser, find_browser
from qrsim.view.ground import solids

# Calls of a scene with nodes of triangles, as viser keeps them.
HARNESS = """
const nodes = {};
for (const [part, props] of Object.entries(meshes)) {
  const name = "/o/" + part;
  for (const key in props) props[key] = key === "faces" ? Uint32Array.from(props[key]) : Float32Array.from(props[key]);
  nodes[name] = { message: { name, props } };
}
const data = { obstacles: "/o", obstacleNumbers };
const found = solidsIn({ data, nodes: () => nodes, floats: (array) => array, shown: () => true });
const hit = found.cast([30, 0, -20], [-1, 0, 0]).solid;
return [pairs.map(([a, b]) => found.apart(a, b)), [hit.number, hit.high[2] - hit.low[2]]];
"""


def mesh(pair: shapes.Mesh, **more: Any) -> dict[str, list[float]]:
    """Return a node's content for JSON."""
    named = {"vertices": pair[0], "faces": pair[1], **more}
    return {name: np.asarray(own).ravel().tolist() for name, own in named.items()}


@pytest.mark.long
@pytest.mark.skipif(find_browser() is None, reason=f"no browser; {INSTALL}")
def test_walls_of_boxes_cylinders_and_prisms():
    unit = shapes.box((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5))
    # Boxes 0 to 10 m north and east, 20 to 30 m north and 25 to 35 m east, and over the first.
    middle, size = [[5, 5, -22.5], [25, 30, -5], [5, 12, -50]], [[10, 10, 45], [10, 10, 10], [4, 6, 10]]
    # Cylinders of 2 m radius at 5 m north, and at 16 m north and 18 m east.
    round_at, round_size = [[5, -10, -5], [16, 18, -5]], [[2, 2, 10], [2, 2, 10]]
    # An L around the origin of 100 m north, of several pieces, and a triangle in its notch.
    corners = [[100, 0], [120, 0], [120, 4], [110, 4], [110, 10], [100, 10]]
    wedge = [[120, 10], [116, 10], [120, 14]]
    prisms = prisms_of([PrismObstacle.of(ring, -10.0, 0.0) for ring in (corners, wedge)], [7, 8], 1.0)
    assert prisms is not None
    meshes = {
        "boxes": mesh(unit, batched_positions=middle, batched_scales=size),
        "cylinders": mesh(shapes.prism(1.0, -0.5, 0.5), batched_positions=round_at, batched_scales=round_size),
        "prisms": mesh(solids(prisms)),
    }
    pieces = np.asarray(prisms.pieces.number, int)[: prisms.count].tolist()
    # Numbers are in no order.
    numbers = {"boxes": [3, 1, 2], "cylinders": [5, 6], "prisms": pieces}
    pairs = [(3, 1), (1, 3), (3, 2), (3, 5), (3, 6), (5, 6), (3, 7), (7, 8)]
    given = {"meshes": meshes, "obstacleNumbers": numbers, "pairs": pairs}
    script = files("qrsim.view").joinpath("solids.js").read_text("utf-8")
    head = "".join(f"const {name} = {json.dumps(own)};\n" for name, own in given.items())
    with Browser(200, 200) as browser:
        browser.open("about:blank")
        apart, hit = browser.evaluate("(() => {\n" + head + script + HARNESS + "})()")
    wanted = [
        # 10 m north and 15 m east.
        325.0**0.5,
        325.0**0.5,
        0.0,
        8.0,
        # Its axis is 6 m north and 8 m east of a corner.
        8.0,
        # Axes 11 m and 28 m apart.
        905.0**0.5 - 4.0,
        90.0,
        # From a corner of the triangle, 116 m north and 10 m east, to the wall at 110 m north and to that at 4 m east.
        6.0,
    ]
    np.testing.assert_allclose(apart, wanted, atol=1e-5)
    # Seen from 30 m north at 20 m, the first box of 45 m.
    assert hit == [3, 45.0]
