"""An operation: its schema, the file of it, and one made of plans alone."""

from __future__ import annotations

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
from qrsim.studies.brief.words import LARGEST_WIND, share_of, time_of

Fault = Literal["motor", "gnss", "link", "low_battery"]
FAULTS: list[Fault] = ["motor", "gnss", "link", "low_battery"]
Share = Annotated[Finite, BeforeValidator(share_of)]


def _no_percents(value: object, largest: float) -> object:
    """Refuse a share that is meant in percent."""
    if isinstance(value, int | float) and not isinstance(value, bool) and 1.0 <= value <= 100.0:
        raise ValueError(f"{value:g} is out of range; allowed: 0 to {largest:g} ({value:g} % is {value / 100.0:g})")
    return value


class Part(BaseModel):
    """Base of every part of an operation: unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class MissionSpec(Part):
    """A plan and its vehicle."""

    plan: str = Field(description="a QGroundControl .plan file")
    vehicle: str = Field(description="a built-in multirotor, or a .yaml file with a vehicle")
    name: str | None = Field(None, description="of the vehicle; default: of the plan's file", pattern=NAME)
    battery: dict[str, Any] = Field({}, description="numbers of the pack, as of a scenario's battery 'lithium_cells'")
    delay: Finite = Field(0.0, description="time before its take-off [s]", ge=0.0, le=3600.0)


class WindSpec(Part):
    """The forecast of the wind, with its error."""

    speed: Finite = Field(description="mean speed [m/s]", ge=0.0, le=LARGEST_WIND)
    from_deg: Finite = Field(description="bearing that it comes from [deg], also written 'from'", ge=0.0, le=360.0)
    height: Finite = Field(10.0, description="height above the ground that the speed is of [m]", ge=1.0, le=200.0)
    std: Finite = Field(1.5, description="standard deviation of the forecast's speed [m/s]", ge=0.0, le=10.0)
    from_std: Finite = Field(15.0, description="standard deviation of its bearing [deg]", ge=0.0, le=60.0)

    @model_validator(mode="before")
    @classmethod
    def _from(cls, data: object) -> object:
        if isinstance(data, dict) and "from" in data and "from_deg" not in data:
            return {("from_deg" if key == "from" else key): value for key, value in data.items()}
        return data


class UncertainSpec(Part):
    """Numbers of the vehicles that differ from run to run, uniformly."""

    battery_capacity: Share = Field(0.05, description="largest relative difference", ge=0.0, le=0.5)
    initial_charge: tuple[Share, Share] = Field((0.95, 1.0), description="smallest and largest charge at the start")
    mass: Share = Field(0.02, description="largest relative difference", ge=0.0, le=0.5)
    drag: Share = Field(0.10, description="largest relative difference", ge=0.0, le=0.9)

    @model_validator(mode="after")
    def _ordered(self) -> UncertainSpec:
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

    do: Literal["warn", "land", "return"] = Field("land", description="reaction; after 5 s without a fix: descend")


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


class OperationSpec(Part):
    """A field day: plans, vehicles, weather, reactions and criteria."""

    operation: str = Field(description="short name", pattern=NAME, max_length=100)
    at: Annotated[str, BeforeValidator(lambda value: value if isinstance(value, str) else value.isoformat())] = Field(
        description="start, with its zone"
    )
    missions: list[MissionSpec] = Field(description="plans with their vehicles", min_length=1, max_length=60)
    wind: WindSpec = Field(description="forecast of the wind")
    site: dict[str, Any] = Field({}, description="'ceiling' [m above home], and keys of a scenario's site")
    world: dict[str, Any] = Field({}, description="keys of a scenario's world but its wind: buildings, ground, area")
    uncertain: UncertainSpec = UncertainSpec.model_validate({})
    contingency: ContingencySpec = ContingencySpec.model_validate({})
    faults: list[Fault] = Field(FAULTS, description="faults to fly, each at 25, 50 and 75 % of the mission")
    criteria: CriteriaSpec = CriteriaSpec.model_validate({})
    extends: str | None = Field(None, description="a scenario below all this: its site and world, not its fleets")

    @field_validator("world")
    @classmethod
    def _without_wind(cls, world: dict[str, Any]) -> dict[str, Any]:
        if "wind" in world:
            raise ValueError(
                "the wind of an operation is its own key, such as wind: {speed: 7, from: 250}; leave world.wind out"
            )
        return world

    def to_yaml(self) -> str:
        """Return the file of the operation, every default written out."""
        return dump_yaml(self.model_dump(mode="json", exclude_none=True))


def read_operation(path: Path, changes: Content) -> OperationSpec:
    """Read an operation's file; paths in it are relative to its folder.

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
    missions = content.get("missions")
    for mission in missions if isinstance(missions, list) else ():
        for key in ("plan", "vehicle"):
            value = mission.get(key) if isinstance(mission, dict) else None
            if isinstance(value, str) and Path(value).suffix:
                mission[key] = str(path.parent / value)
    anchor_files(content, path.parent)
    below = content.get("extends")
    if isinstance(below, str) and Path(below).suffix:
        content["extends"] = str(path.parent / below)
    return checked(content, str(path))


def checked(content: Content, source: str) -> OperationSpec:
    """Check the content of an operation.

    Raises:
        ScenarioError: it is wrong; the message lists the faults.
    """
    try:
        found = OperationSpec.model_validate(content)
    except ValidationError as error:
        raise ScenarioError(source, describe(error, OperationSpec, content)) from None
    return found.model_copy(update={"at": time_of(found.at)})
