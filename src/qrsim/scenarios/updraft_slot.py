"""The schema of updrafts, and the obstacles of a scenario as they see them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, partial

import numpy as np
from pydantic import Field

from qrsim.models.atmosphere.contracts import Footprint
from qrsim.models.atmosphere.thermals import MOST_THERMALS, Thermals
from qrsim.models.scene.obstacles import BoxObstacle, CylinderObstacle
from qrsim.models.scene.prisms import PrismObstacle
from qrsim.scenarios.component_schema import Strict, component_model
from qrsim.scenarios.legs import Corner
from qrsim.scenarios.slots import slot

MOST_UPDRAFTS = 20


@cache
def _model(name: str, kind: type) -> type[Strict]:
    """Return the pydantic model of an updraft class, cached; that of thermals has a list of places."""
    if not issubclass(kind, Thermals):
        return component_model(name, kind)
    text = "[north, east] [m] of each at the start; empty: drawn once an episode"
    places: dict[str, object] = {"places_ned": (list[Corner], Field([], description=text, max_length=MOST_THERMALS))}
    return component_model(name, kind, arrays=places)


def updraft_slot(choices: Mapping[str, type]) -> object:
    """Return the pydantic annotation of an updraft of any type in ``choices`` (type name -> class)."""
    return slot(lambda: {name: partial(_model, name, kind) for name, kind in choices.items()})


def footprint(solid: BoxObstacle | CylinderObstacle | PrismObstacle) -> Footprint:
    """Return an obstacle's outline from above and its heights [m], for updrafts along its sides."""
    heights = float(solid.z_min), float(solid.z_max)
    if isinstance(solid, CylinderObstacle):
        return Footprint(np.array([[float(solid.x), float(solid.y)]]), float(solid.radius), *heights)
    if isinstance(solid, BoxObstacle):
        south, north, west, east = (float(side) for side in (solid.x_min, solid.x_max, solid.y_min, solid.y_max))
        return Footprint(np.array([[south, west], [north, west], [north, east], [south, east]]), 0.0, *heights)
    return Footprint(np.asarray(solid.rings()[0], np.float64), 0.0, *heights)
