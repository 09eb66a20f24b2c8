"""The schema of zones to stay in and to stay out of, and zones of the host from it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cache
from typing import Annotated, Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from qrsim.files import Content
from qrsim.models.scene.zone import Zone
from qrsim.models.scene.zones import ZonesArea
from qrsim.scenarios.component_schema import Finite, Strict, component_model
from qrsim.scenarios.legs import Corner

MOST_ZONES, MOST_ZONE_CORNERS = 200, 5000
_SHAPES = ("file", "polygon_ned", "polygon_geodetic", "circle_ned", "circle_geodetic")
Ring = Annotated[list[Corner], Field(min_length=3, max_length=MOST_ZONE_CORNERS)]


class ZoneSpec(Strict):
    """A zone: a file, a polygon or a circle, with floor and ceiling."""

    name: str | None = Field(None, description="for messages; of a file: the polygons to take", max_length=100)
    file: str | None = Field(
        None,
        description="a .kml, .kmz or .geojson file with polygons, or a QGroundControl .plan file with a geofence",
        min_length=1,
        exclude=True,
    )
    polygon_ned: Ring | None = Field(
        None, description="[north, east] [m] of each corner, in order; the last is joined to the first"
    )
    holes_ned: list[Ring] = Field([], description="the same of each hole in it", max_length=MOST_ZONES)
    polygon_geodetic: Ring | None = Field(
        None, description="[latitude, longitude] [deg] of each corner, instead of polygon_ned", exclude=True
    )
    holes_geodetic: list[Ring] = Field(
        [], description="the same of each hole in it", max_length=MOST_ZONES, exclude=True
    )
    circle_ned: Corner | None = Field(None, description="[north, east] [m] of the centre of a circle")
    circle_geodetic: Corner | None = Field(
        None, description="[latitude, longitude] [deg] of the centre, instead of circle_ned", exclude=True
    )
    radius: Finite | None = Field(None, description="of a circle [m]", gt=0, le=100e3)
    floor: Finite = Field(
        0.0, description="height of the bottom [m]; 0: from the ground, wherever that is", ge=0, le=100e3
    )
    ceiling: Finite | None = Field(None, description="height of the top [m]; null: none", gt=0, le=100e3)
    above: Literal["site", "terrain"] = Field(
        "site", description="level from which the heights count: the site (z = 0), or the ground below the vehicle"
    )

    @model_serializer(mode="wrap")
    def _without_nothing(self, handler: SerializerFunctionWrapHandler) -> Content:
        """Leave out None and empty lists when a zone's specification is written."""
        return {key: value for key, value in handler(self).items() if value not in (None, [])}

    @model_validator(mode="after")
    def _one_shape(self) -> ZoneSpec:
        """Refuse a zone that does not have exactly one shape, or lacks numbers that the shape needs."""
        given = [name for name in _SHAPES if getattr(self, name) is not None]
        if len(given) != 1:
            found = " and ".join(f"'{name}'" for name in given) or "no shape"
            raise ValueError(f"gives {found}; give one of {', '.join(_SHAPES)}")
        shape = given[0]
        if shape.startswith("circle") != (self.radius is not None):
            raise ValueError(
                "gives 'radius' without a circle; give circle_ned or circle_geodetic"
                if self.radius is not None
                else f"gives '{shape}' without 'radius'"
            )
        for holes, polygon in (("holes_ned", "polygon_ned"), ("holes_geodetic", "polygon_geodetic")):
            if getattr(self, holes) and shape != polygon:
                raise ValueError(f"gives '{holes}' without '{polygon}'")
        if self.ceiling is not None and self.ceiling <= self.floor:
            raise ValueError(f"ceiling {self.ceiling:g} m is not above floor, {self.floor:g} m")
        return self


@cache
def zones_model() -> Any:
    """Return the pydantic model of an area of zones."""
    zones = list[ZoneSpec]
    parts = {
        "stay_in": (zones, Field([], description="zones to stay in: in one of them at least", max_length=MOST_ZONES)),
        "stay_out": (zones, Field([], description="zones to stay out of, all of them", max_length=MOST_ZONES)),
        "allow_crossing": (
            bool,
            Field(False, strict=True, description="whether legs may lead through zones to stay out of, with a warning"),
        ),
    }
    return component_model("zones", ZonesArea, arrays=parts)


def zones_of(area: Any) -> list[Zone]:
    """Return the zones of an area, all in NED; a zone without a name gets its scenario path as name."""
    return [
        zone_of(spec, key == "stay_in", f"{key}.{i}")
        for key in ("stay_in", "stay_out")
        for i, spec in enumerate(getattr(area, key))
    ]


def zone_of(spec: ZoneSpec, keep: bool, path: str) -> Zone:
    """Convert a zone's specification in NED to a ``Zone``; ``keep``: vehicles must stay inside, not outside."""
    ceiling = math.inf if spec.ceiling is None else spec.ceiling
    rest = (spec.floor, ceiling, spec.above == "terrain", spec.name or path)
    if spec.polygon_ned is None:
        north, east = spec.circle_ned or (0.0, 0.0)
        return Zone(keep, (), (north, east), spec.radius or 0.0, *rest)
    rings = tuple(tuple((north, east) for north, east in ring) for ring in (spec.polygon_ned, *spec.holes_ned))
    return Zone(keep, rings, (0.0, 0.0), 0.0, *rest)


def content_of(zones: Iterable[Zone]) -> Content:
    """Convert zones to scenario content."""
    found: Content = {"stay_in": [], "stay_out": []}
    for zone in zones:
        part: Content = {"name": zone.name, "floor": max(zone.floor, 0.0)}
        part |= {"above": "terrain"} if zone.terrain else {}
        part |= {"ceiling": zone.ceiling} if math.isfinite(zone.ceiling) else {}
        if zone.rings:
            outline, *holes = ([list(corner) for corner in ring] for ring in zone.rings)
            part |= {"polygon_ned": outline, "holes_ned": holes}
        else:
            part |= {"circle_ned": list(zone.centre), "radius": zone.radius}
        found["stay_in" if zone.keep else "stay_out"].append(part)
    return found
