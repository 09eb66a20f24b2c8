"""The schema of a scenario's site, and of plans by their file."""

from __future__ import annotations

from pydantic import Field, SerializerFunctionWrapHandler, field_validator, model_serializer, model_validator

from qrsim.errors import shortened
from qrsim.files import Content
from qrsim.models.geoid import undulation
from qrsim.models.site import Site
from qrsim.scenarios.component_schema import Finite, Strict

# Of the origin over the ellipsoid [m].
LOWEST_SITE, HIGHEST_SITE = -500.0, 9000.0
# Two heights of a site that differ by no more than this, but for the geoid, are the same one [m].
SAME_HEIGHT = 1e-3
# Above mean sea level [m]: the shores of the Dead Sea, and Mount Everest.
LOWEST_AMSL, HIGHEST_AMSL = -450.0, 9000.0
# Of the day over the standard atmosphere [K]: from the coldest days of Antarctica to the hottest of deserts.
COLDEST_DAY, HOTTEST_DAY = -80.0, 50.0

# Ends of names of plans without a home.
_HOMELESS = (".kml", ".kmz", ".gpx", ".geojson", ".json")


class PlanSpec(Strict):
    """A plan with its home as the site."""

    file: str = Field(description="a QGroundControl .plan file", min_length=1)

    @field_validator("file")
    @classmethod
    def _has_home(cls, file: str) -> str:
        """Refuse a plan file in a format that has no home position."""
        if file.lower().endswith(_HOMELESS):
            raise ValueError(f"'{shortened(file, 200)}' has no home; expected a .plan")
        return file


class RoutePlanSpec(Strict):
    """A plan: the route of a vehicle."""

    file: str = Field(
        description="a file: .plan, .waypoints or .txt (QGC WPL), .kml, .kmz, .gpx, .geojson", min_length=1
    )
    route: str | None = Field(None, description="name of a route of the file; default: its only one")
    height: Finite | None = Field(
        None, description="height above the ground [m] of points without an altitude", gt=0, le=10_000
    )
    home: list[Finite] | None = Field(
        None,
        description="home of a file without one: latitude, longitude [deg] and perhaps altitude above mean sea level "
        "[m]; default: its first point",
        min_length=2,
        max_length=3,
    )
    terrain_tolerance: Finite = Field(
        1.0,
        description="largest difference of the height above the ground [m] between two items with heights above it",
        ge=0.5,
        le=100,
    )
    params: str | None = Field(
        None,
        description="file of parameters for qrsim mavlink (.params, .param or .parm); default: the .params with the "
        "name of the plan, where there is one",
        min_length=1,
    )

    @field_validator("home")
    @classmethod
    def _on_earth(cls, home: list[float] | None) -> list[float] | None:
        """Refuse a home outside the ranges of latitude and longitude [deg]."""
        if home and (abs(home[0]) > 90.0 or abs(home[1]) > 180.0):
            hint = "; is it longitude, latitude?" if abs(home[0]) > 90.0 and abs(home[1]) <= 90.0 else ""
            raise ValueError(f"{home[:2]} is no latitude, longitude{hint}")
        return home


class GeoidSpec(Strict):
    """A geoid near the site: a file, or the plane that was made of one."""

    file: str | None = Field(
        None,
        description="heights of a geoid above the WGS-84 ellipsoid [m]: .tif, .img, or .pgm of GeographicLib",
        min_length=1,
        exclude=True,
    )
    height: Finite | None = Field(None, description="height at the site [m], instead of file", ge=-200, le=200)
    slope_north: Finite = Field(0.0, description="change of the height per metre to the north", ge=-0.01, le=0.01)
    slope_east: Finite = Field(0.0, description="change of the height per metre to the east", ge=-0.01, le=0.01)
    source: str = Field("", description="file that the numbers are from")

    @model_validator(mode="after")
    def _one(self) -> GeoidSpec:
        """Refuse a geoid that is given neither by numbers nor by a file, or by both."""
        if (self.file is None) == (self.height is None):
            raise ValueError("expected one of file and height")
        return self

    @property
    def plane(self) -> tuple[float, float, float] | None:
        """Height [m] and slopes to north and east of the geoid; None for a file that is not read yet."""
        return None if self.height is None else (self.height, self.slope_north, self.slope_east)


def or_its_file(schema: Content) -> None:
    """Extend the JSON schema of a plan, in place, so that a file name alone is allowed."""
    schema["anyOf"].append({"type": "string"})


class SiteSpec(Strict):
    """Origin of the local frame on the Earth."""

    latitude_deg: Finite = Field(51.71190, description="geodetic latitude [deg]", ge=-90, le=90)
    longitude_deg: Finite = Field(-0.21052, description="longitude [deg], east positive", ge=-180, le=180)
    height: Finite = Field(0.0, description="height above the WGS-84 ellipsoid [m]", ge=LOWEST_SITE, le=HIGHEST_SITE)
    height_amsl: Finite | None = Field(
        None,
        description="height above mean sea level (the geoid) [m], instead of height",
        ge=LOWEST_AMSL,
        le=HIGHEST_AMSL,
    )
    geoid: GeoidSpec | None = Field(
        None,
        description="reference of heights above the sea, FILE or {file: FILE}; default: the geoid EGM96",
        json_schema_extra=or_its_file,
    )
    temperature_offset: Finite = Field(
        0.0,
        description="temperature of the day over that of the standard atmosphere [K]",
        ge=COLDEST_DAY,
        le=HOTTEST_DAY,
    )
    plan: PlanSpec | None = Field(
        None,
        description="a .plan file, FILE or {file: FILE}, with its home as the site, instead of the three numbers",
        exclude=True,
        json_schema_extra=or_its_file,
    )

    @model_serializer(mode="wrap")
    def _without_none(self, handler: SerializerFunctionWrapHandler) -> Content:
        """Leave out ``height_amsl`` and ``geoid`` if they are None when a site's specification is written."""
        found: Content = handler(self)
        for name in ("height_amsl", "geoid"):
            if getattr(self, name) is None:
                found.pop(name, None)
        return found

    @property
    def undulation(self) -> float:
        """Height of the geoid above the ellipsoid at the site [m]."""
        plane = self.geoid.plane if self.geoid else None
        return undulation(self.latitude_deg, self.longitude_deg) if plane is None else plane[0]

    def at(self) -> Site:
        """Return the site: the geodetic origin of the local frame."""
        plane = self.geoid.plane if self.geoid else None
        return Site.from_degrees(self.latitude_deg, self.longitude_deg, self.height, plane)

    @model_validator(mode="after")
    def _one_height(self) -> SiteSpec:
        """Refuse a site with heights above ellipsoid and sea, unless they agree by the geoid."""
        if self.height_amsl is None or "height" not in self.model_fields_set:
            return self
        # Saved scenarios have both.
        if abs(self.height - self.height_amsl - self.undulation) > SAME_HEIGHT:
            raise ValueError("height and height_amsl are both given; allowed: one")
        return self
