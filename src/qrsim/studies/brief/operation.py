"""An operation: its schema, the file of it, and one made of plans alone."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, field_validator, model_validator

from qrsim.errors import ScenarioError, UsageError, did_you_mean_file
from qrsim.files import Content
from qrsim.files.user_files import read_text
from qrsim.files.yaml_text import dump_yaml, parse_yaml
from qrsim.scenarios.component_schema import Finite
from qrsim.scenarios.problems import describe
from qrsim.scenarios.reading import anchor_files
from qrsim.scenarios.schema import NAME
from qrsim.studies.brief.words import LARGEST_WIND, minutes_of, share_of, time_of

Fault = Literal["motor", "gnss", "link", "low_battery"]
FAULTS: list[Fault] = ["motor", "gnss", "link", "low_battery"]
Share = Annotated[Finite, BeforeValidator(share_of)]


def _no_percents(value: object, largest: float) -> object:
    """Return a share unchanged; raises ValueError if it looks like a percentage, such as 5 for 0.05."""
    if isinstance(value, int | float) and not isinstance(value, bool) and 1.0 <= value <= 100.0:
        raise ValueError(f"{value:g} is out of range; allowed: 0 to {largest:g} ({value:g} % is {value / 100.0:g})")
    return value


class Part(BaseModel):
    """Base of every part of an operation: unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class MissionSpec(Part):
    """A plan and its vehicle."""

    plan: str = Field(description="a .plan of QGroundControl, .waypoints, .kml, .kmz, .gpx or .geojson")
    route: str | None = Field(None, description="name of a route of a file with several")
    height: Finite | None = Field(
        None, description="height above the ground of points without an altitude [m]", gt=0.0, le=10_000.0
    )
    vehicle: str = Field(description="a built-in multirotor, or a .yaml file with a vehicle")
    name: str | None = Field(None, description="of the vehicle; default: of the plan's file", pattern=NAME)
    battery: Content = Field({}, description="numbers of the pack, as of a scenario's battery 'lithium_cells'")
    delay: Finite = Field(0.0, description="time before its take-off [s]", ge=0.0, le=3600.0)


class WindSpec(Part):
    """The forecast of the wind, with its error: a speed and a bearing, or a file."""

    speed: Finite | None = Field(None, description="mean speed [m/s]", ge=0.0, le=LARGEST_WIND)
    from_deg: Finite | None = Field(
        None, description="bearing that it comes from [deg], also written 'from'", ge=0.0, le=360.0
    )
    file: str | None = Field(
        None, description="instead: a file of a weather model (GRIB, NetCDF), or a .csv with a profile", min_length=1
    )
    height: Finite = Field(10.0, description="height above the ground that the speed is of [m]", ge=1.0, le=200.0)
    std: Finite = Field(1.5, description="standard deviation of the forecast's speed [m/s]", ge=0.0, le=10.0)
    from_std: Finite = Field(15.0, description="standard deviation of its bearing [deg]", ge=0.0, le=60.0)

    @model_validator(mode="before")
    @classmethod
    def _from(cls, data: object) -> object:
        """Rename the key ``from`` of a wind's data to ``from_deg``."""
        if isinstance(data, dict) and "from" in data and "from_deg" not in data:
            return {("from_deg" if key == "from" else key): value for key, value in data.items()}
        return data

    @model_validator(mode="after")
    def _one_way(self) -> WindSpec:
        """Raise ValueError unless the wind is given either by speed and direction or by a file."""
        for name in ("speed", "from_deg"):
            if (getattr(self, name) is None) == (self.file is None):
                given = f"'{name}' and 'file'" if self.file is not None else f"neither '{name}' nor 'file'"
                raise ValueError(f"gives {given}; give speed and from, or file")
        return self


class UncertainSpec(Part):
    """Numbers of the vehicles that differ from run to run, uniformly."""

    battery_capacity: Share = Field(0.05, description="largest relative difference", ge=0.0, le=0.5)
    initial_charge: tuple[Share, Share] = Field((0.95, 1.0), description="smallest and largest charge at the start")
    mass: Share = Field(0.02, description="largest relative difference", ge=0.0, le=0.5)
    drag: Share = Field(0.10, description="largest relative difference", ge=0.0, le=0.9)

    @model_validator(mode="after")
    def _ordered(self) -> UncertainSpec:
        """Raise ValueError unless the bounds of the initial charge ascend from above 0 to at most 1."""
        low, high = self.initial_charge
        if not 0.0 < low <= high <= 1.0:
            raise ValueError(f"initial_charge: {low:g} to {high:g}; allowed: ascending, above 0, at most 1")
        return self


class LowBatterySpec(Part):
    """Reaction to a low battery."""

    at: Share = Field(0.15, description="charge", gt=0.0, lt=1.0)
    do: Literal["warn", "land", "return"] = Field("return", description="reaction")


class GnssLostSpec(Part):
    """Reaction to a lost fix."""

    do: Literal["warn", "land", "return"] = Field("land", description="reaction to the lost fix")
    after: Finite = Field(5.0, description="time without a fix until the position is lost [s]", ge=0.5, le=10.0)


class LinkLostSpec(Part):
    """Reaction to a lost link; the link itself is in the stage of faults only."""

    after: Finite = Field(10.0, description="silence [s]", gt=0.0, le=300.0)
    do: Literal["none", "hold", "land", "return"] = Field("return", description="reaction")


class ContingencySpec(Part):
    """Reactions of the vehicles to failures."""

    low_battery: LowBatterySpec = LowBatterySpec.model_validate({})
    gnss_lost: GnssLostSpec = GnssLostSpec.model_validate({})
    link_lost: LinkLostSpec = LinkLostSpec.model_validate({})
    return_height: Finite = Field(60.0, description="height of a return above home [m]", gt=0.0, le=500.0)


class CriteriaSpec(Part):
    """What a go needs."""

    reserve: Annotated[Share, BeforeValidator(partial(_no_percents, largest=0.9))] = Field(
        0.20, description="charge left at the end, in 95 % of the runs", ge=0.0, le=0.9
    )
    p_loss: Annotated[Share, BeforeValidator(partial(_no_percents, largest=0.5))] = Field(
        0.01, description="probability of a run in which a vehicle is lost", ge=0.0005, le=0.5
    )
    fence: Finite = Field(5.0, description="distance to the sides and the ceiling of the area [m]", ge=0.0)
    separation: Finite = Field(10.0, description="distance between two vehicles in the air [m]", ge=0.0)
    ground: Finite = Field(10.0, description="height between take-off and landing [m]", ge=0.0)
    obstacle: Finite = Field(5.0, description="distance to obstacles [m]", ge=0.0)
    wind_limit: Finite | None = Field(None, description="the maker's limit of the wind, gusts included [m/s]", gt=0.0)


class SiteSpec(Part):
    """The place of the flights; without it the home of the first plan, on flat ground."""

    ceiling: Finite | None = Field(None, description="height above home [m]", gt=0.0, le=10_000.0)
    terrain: list[str] = Field([], description="files of heights: GeoTIFF, SRTM (.hgt) and others")
    buildings: str | None = Field(None, description="a .geojson file with buildings", min_length=1)
    keep_out: list[str] = Field([], description="files with zones to stay out of: .kml, .kmz, .geojson or .plan")
    latitude_deg: Finite | None = Field(None, description="of the origin, instead of the home [deg]", ge=-90, le=90)
    longitude_deg: Finite | None = Field(None, description="of the origin, instead of the home [deg]", ge=-180, le=180)
    height_amsl: Finite | None = Field(None, description="of the origin above the sea [m]", ge=-500, le=9000)
    temperature_offset: Finite = Field(0.0, description="of the day over the standard atmosphere [K]", ge=-80, le=50)

    @model_validator(mode="after")
    def _place(self) -> SiteSpec:
        """Raise ValueError for a site with a latitude but no longitude, or a height but neither."""
        if (self.latitude_deg is None) != (self.longitude_deg is None):
            raise ValueError("gives one of latitude_deg and longitude_deg; give both, or neither")
        if self.latitude_deg is None and self.height_amsl is not None:
            raise ValueError("gives height_amsl without latitude_deg and longitude_deg")
        return self


class OperationSpec(Part):
    """A field day: plans, vehicles, weather, reactions and criteria."""

    operation: str = Field(description="short name", pattern=NAME, max_length=100)
    at: Annotated[str, BeforeValidator(lambda value: value if isinstance(value, str) else value.isoformat())] = Field(
        description="start, with its zone"
    )
    missions: list[MissionSpec] = Field(description="plans with their vehicles", min_length=1, max_length=60)
    wind: WindSpec = Field(description="forecast of the wind")
    window: Annotated[Finite, BeforeValidator(minutes_of)] = Field(
        0.0,
        description="time over which the starts of the runs are spread [min], also written '30 min'",
        ge=0.0,
        le=720.0,
    )
    site: SiteSpec = SiteSpec.model_validate({})
    energy: bool = Field(True, description="whether the charge is judged", strict=True)
    world: Content = Field({}, description="keys of a scenario's world but its wind: buildings, ground, area")
    uncertain: UncertainSpec = UncertainSpec.model_validate({})
    contingency: ContingencySpec = ContingencySpec.model_validate({})
    faults: list[Fault] = Field(FAULTS, description="faults to fly, each at 25, 50 and 75 % of the mission")
    criteria: CriteriaSpec = CriteriaSpec.model_validate({})
    extends: str | None = Field(None, description="a scenario below all this: its site and world, not its fleets")

    @field_validator("world")
    @classmethod
    def _without_wind(cls, world: dict[str, object]) -> dict[str, object]:
        """Return an operation's ``world`` unchanged; raises ValueError if it has a wind."""
        if "wind" in world:
            raise ValueError(
                "the wind of an operation is its own key, such as wind: {speed: 7, from: 250}; leave world.wind out"
            )
        return world

    def to_yaml(self) -> str:
        """Return the operation as YAML, every default written out."""
        return dump_yaml(self.model_dump(mode="json", exclude_none=True))


def read_operation(path: Path, changes: Content) -> OperationSpec:
    """Read an operation's YAML file and apply changes; file paths in it start in its folder.

    Args:
        path: of the file.
        changes: keys that the command line gives in place of the file's.

    Raises:
        UsageError: there is no such file.
        ScenarioError: it is wrong; the message lists the faults.
    """
    try:
        content = parse_yaml(read_text(path), str(path))
    except FileNotFoundError:
        raise UsageError(f"operation {path}: no such file{did_you_mean_file(path)}") from None
    except OSError as error:
        raise UsageError(f"operation {path}: cannot be read: {error.strerror}") from None
    if not isinstance(content, dict):
        raise ScenarioError(str(path), ["expected keys and values such as operation: my_field"])
    if "fleets" in content and "missions" not in content:
        raise UsageError(f"{path}: is a scenario and no operation, which names plans; 'qrsim check {path}' flies it")
    content = {"operation": path.stem, **content, **changes}
    content = with_paths(content, lambda name: str(path.parent / name))
    if isinstance(content.get("world"), dict):
        anchor_files({"world": content["world"]}, path.parent)
    below = content.get("extends")
    if isinstance(below, str) and Path(below).suffix:
        content["extends"] = str(path.parent / below)
    return checked(content, str(path))


def with_paths(content: Content, changed: Callable[[str], str]) -> Content:
    """Return a copy of an operation's content with every file path replaced by ``changed(path)``."""
    found = copy.deepcopy(content)

    def change(part: Any, key: Any) -> None:
        """Replace the entry ``part[key]`` in place if it is a file path."""
        if isinstance(part[key], str) and (key != "vehicle" or Path(part[key]).suffix):
            part[key] = changed(part[key])

    missions: Any = found.get("missions")
    site: Any = found.get("site")
    for mission in missions if isinstance(missions, list) else ():
        for key in {"plan", "vehicle"}.intersection(mission if isinstance(mission, dict) else ()):
            change(mission, key)
    for key in {"terrain", "keep_out", "buildings"}.intersection(site if isinstance(site, dict) else ()):
        files = site[key]
        for i in range(len(files)) if isinstance(files, list) else ():
            change(files, i)
        change(site, key)
    if isinstance(found.get("wind"), dict) and "file" in found["wind"]:
        change(found["wind"], "file")
    return found


def checked(content: Content, source: str) -> OperationSpec:
    """Validate an operation's content and return it as a specification; raises ScenarioError for errors.

    Raises:
        ScenarioError: it is wrong; the message lists the faults.
    """
    try:
        found = OperationSpec.model_validate(content)
    except ValidationError as error:
        raise ScenarioError(source, describe(error, OperationSpec, content)) from None
    return found.model_copy(update={"at": time_of(found.at)})
