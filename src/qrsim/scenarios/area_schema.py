"""What a scenario says of where vehicles may be: the schemas of areas."""

from __future__ import annotations

from functools import cache, partial
from typing import TYPE_CHECKING, Any

from pydantic import Field

from qrsim.models.scene.fence import PolygonArea
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.component_schema import Strict, component_model
from qrsim.scenarios.legs import Corner
from qrsim.scenarios.slots import Maker, slot
from qrsim.scenarios.zone_schema import zones_model

MOST_CORNERS = 1000


class _Polygon(Strict):
    """Shows the corners as a PolygonArea has them."""

    if TYPE_CHECKING:
        corners_ned: list[tuple[float, float]]

    @property
    def north(self) -> list[float]:
        """North coordinates of the polygon's corners [m]."""
        return [north for north, _ in self.corners_ned]

    @property
    def east(self) -> list[float]:
        """East coordinates of the polygon's corners [m]."""
        return [east for _, east in self.corners_ned]


@cache
def polygon_model() -> Any:
    """Return the pydantic model of an area that is a polygon with its corners."""
    text = "[north, east] [m] of each corner, in order; the last is joined to the first"
    corners = (list[Corner], Field(description=text, min_length=3, max_length=MOST_CORNERS))
    return component_model("polygon", PolygonArea, arrays={"corners_ned": corners}, base=_Polygon)


@cache
def _fence_model() -> type[Strict]:
    """Return the pydantic model of an area that is a fence: a polygon with its corners in a file."""
    places = {
        "file": (
            str,
            Field(
                description="a .kml, .kmz or .geojson file with a polygon, or a QGroundControl .plan with a geofence",
                min_length=1,
            ),
        ),
        "name": (str | None, Field(None, description="of the polygon; may be left out where the KML has one only")),
    }
    return component_model("fence", PolygonArea, arrays=places)


@cache
def _area_model(name: str, area: type) -> type[Strict]:
    """Return the pydantic model of an area class; ``name`` is its type in scenarios."""
    return component_model(name, area)


def _areas() -> dict[str, Maker]:
    """Return type name -> function that makes its pydantic model, for all areas of the catalogue and "fence"."""
    own = {"polygon": polygon_model, "zones": zones_model}
    others = {name: partial(_area_model, name, area) for name, area in known.AREAS.items() if name not in own}
    return {**others, **own, "fence": _fence_model}


AreaSlot: Any = slot(_areas)
