"""The schema of a scenario's site, and of plans by their file."""

from __future__ import annotations

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from qrsim.files import Content
from qrsim.models.geoid import undulation
from qrsim.scenarios.component_schema import Finite, Strict

# Of the origin over the ellipsoid [m].
LOWEST_SITE, HIGHEST_SITE = -500.0, 9000.0
# Two heights of a site that differ by no more than this, but for the geoid, are the same one [m].
SAME_HEIGHT = 1e-3
# Above mean sea level [m]: the shores of the Dead Sea, and Mount Everest.
LOWEST_AMSL, HIGHEST_AMSL = -450.0, 9000.0
# Of the day over the standard atmosphere [K]: from the coldest days of Antarctica to the hottest of deserts.
COLDEST_DAY, HOTTEST_DAY = -80.0, 50.0


class PlanSpec(Strict):
    """A QGroundControl plan: the route of a vehicle, or the home of which is the site."""

    file: str = Field(description="a QGroundControl .plan file", min_length=1)


def or_its_file(schema: Content) -> None:
    """Add the file alone to the JSON schema of a plan."""
    schema["anyOf"].append({"type": "string"})


class SiteSpec(Strict):
    """Origin of the local frame on the Earth."""

    latitude_deg: Finite = Field(51.71190, description="geodetic latitude [deg]", ge=-90, le=90)
    longitude_deg: Finite = Field(-0.21052, description="longitude [deg], east positive", ge=-180, le=180)
    height: Finite = Field(0.0, description="height above the WGS-84 ellipsoid [m]", ge=LOWEST_SITE, le=HIGHEST_SITE)
    height_amsl: Finite | None = Field(
        None,
        description="height above mean sea level (EGM96) [m], instead of height",
        ge=LOWEST_AMSL,
        le=HIGHEST_AMSL,
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
        """Leave out a height above mean sea level that there is not."""
        found: Content = handler(self)
        if self.height_amsl is None:
            found.pop("height_amsl", None)
        return found

    @model_validator(mode="after")
    def _one_height(self) -> SiteSpec:
        if self.height_amsl is None or "height" not in self.model_fields_set:
            return self
        # Saved scenarios have both.
        geoid = undulation(self.latitude_deg, self.longitude_deg)
        if abs(self.height - self.height_amsl - geoid) > SAME_HEIGHT:
            raise ValueError("height and height_amsl are both given; allowed: one")
        return self
