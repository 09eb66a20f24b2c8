"""The schema of a mission's legs, as a vehicle of a scenario has them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Literal, TypeVar

from pydantic import BeforeValidator, Field, model_validator

from qrsim.scenarios.component_schema import Finite, Strict

S = TypeVar("S")
Position = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Corner = Annotated[list[Finite], Field(min_length=2, max_length=2)]
# A week.
LONGEST_HOLD = 604_800.0


class GeodeticSpec(Strict):
    """A position by latitude and longitude; its height is over the site's origin, like -z."""

    latitude_deg: Finite = Field(description="geodetic latitude [deg]", ge=-90, le=90)
    longitude_deg: Finite = Field(description="longitude [deg], east positive", ge=-180, le=180)
    height: Finite = Field(description="height above the site's origin [m], positive up")


class _LegSpec(Strict):
    """What all legs have."""

    speed: Finite | None = Field(None, description="largest speed [m/s]; default: the guidance's", gt=0, le=50)
    climb_speed: Finite | None = Field(
        None, description="largest upward speed [m/s]; default: the guidance's", gt=0, le=50
    )
    sink_speed: Finite | None = Field(
        None, description="largest downward speed [m/s], not of a landing; default: the guidance's", gt=0, le=50
    )
    yaw_rad: Finite | None = Field(None, description="heading [rad]; default: along the way", ge=-6.3, le=6.3)
    facing_ned: Corner | None = Field(None, description="place to face instead [m]: north, east")
    item: int | None = Field(None, description="number for messages; default: the leg's place in the list", ge=1)

    @model_validator(mode="after")
    def _one_heading(self) -> _LegSpec:
        """Refuse a mission leg with both a yaw and a place to face."""
        if self.yaw_rad is not None and self.facing_ned is not None:
            raise ValueError("gives both 'yaw_rad' and 'facing_ned'; give one")
        return self


def _called(name: str) -> Callable[[type[S]], type[S]]:
    """Return a class decorator that names a pydantic model as its leg type in scenarios, for error messages."""

    def rename(cls: type[S]) -> type[S]:
        """Return the class with its name set."""
        cls.__name__ = name
        return cls

    return rename


@_called("fly")
class FlyLeg(_LegSpec):
    """Fly to a place."""

    type: Literal["fly"] = Field("fly", description="what it is")
    to_ned: Position = Field(default_factory=list, description="where to [m]: north, east, down")
    to_geodetic: GeodeticSpec | None = Field(None, description="where to, instead of NED", exclude=True)
    accept_radius: Finite | None = Field(
        None, description="distance [m] at which it counts as reached; default: the guidance's", gt=0, le=1000
    )
    hold: Finite = Field(0.0, description="time to stay there [s]", ge=0, le=LONGEST_HOLD)
    stop: bool = Field(False, description="come to rest there, also without a hold")

    @model_validator(mode="after")
    def _one_place(self) -> FlyLeg:
        """Refuse a leg of type fly that does not give exactly one place to fly to."""
        _check_one(self, "to_ned", "to_geodetic")
        return self


@_called("take_off")
class TakeOffLeg(_LegSpec):
    """Climb straight up."""

    type: Literal["take_off"] = Field(description="what it is")
    height: Finite = Field(description="height above the site's origin to climb to [m], positive up")


@_called("land")
class LandLeg(_LegSpec):
    """Land, and let the motors idle."""

    type: Literal["land"] = Field(description="what it is")
    at_ned: Corner | None = Field(None, description="where [m]: north, east; default: below")
    hold: Finite = Field(0.0, description="time to stay on the ground [s]", ge=0, le=LONGEST_HOLD)


@_called("loiter")
class LoiterLeg(_LegSpec):
    """Stay at a place, or circle it: for a time, for some turns, or without end."""

    type: Literal["loiter"] = Field(description="what it is")
    to_ned: Position | None = Field(None, description="where [m]: north, east, down; default: where the vehicle is")
    to_geodetic: GeodeticSpec | None = Field(None, description="where, instead of NED", exclude=True)
    time: Finite | None = Field(None, description="for how long [s]", gt=0, le=LONGEST_HOLD)
    turns: Finite | None = Field(None, description="how many turns on the circle", gt=0, le=10_000)
    radius: Finite = Field(
        0.0,
        description="of the circle [m], clockwise, negative: the other way; 0: stay in the middle",
        ge=-10e3,
        le=10e3,
    )

    @model_validator(mode="after")
    def _consistent(self) -> LoiterLeg:
        """Refuse a loiter leg with both time and turns, turns without radius, or two places."""
        if self.time is not None and self.turns is not None:
            raise ValueError("gives both 'time' and 'turns'; give one, or none for a loiter that does not end")
        if self.turns is not None and self.radius == 0.0:
            raise ValueError("gives 'turns' without a circle; give 'radius' too")
        if self.to_ned is not None and self.to_geodetic is not None:
            raise ValueError("gives both 'to_ned' and 'to_geodetic'; give one")
        return self


@_called("return")
class ReturnLeg(_LegSpec):
    """Fly back to the start, and land there."""

    type: Literal["return"] = Field(description="what it is")
    height: Finite | None = Field(
        None, description="height above the site's origin to climb to before [m], where the vehicle is lower"
    )
    land: bool = Field(True, description="land there, else stay above it")


def _fly_by_default(value: object) -> object:
    """Return a leg's data with the type "fly" if it gives none."""
    return {"type": "fly", **value} if isinstance(value, dict) and "type" not in value else value


LegSpec = Annotated[
    Annotated[FlyLeg | TakeOffLeg | LandLeg | LoiterLeg | ReturnLeg, Field(discriminator="type")],
    BeforeValidator(_fly_by_default),
]


def _check_one(spec: FlyLeg, *names: str) -> None:
    """Raise ValueError unless exactly one of the named fields of a leg is given."""
    given = [name for name in names if name in spec.model_fields_set and getattr(spec, name) is not None]
    if len(given) > 1:
        raise ValueError(f"gives both '{given[0]}' and '{given[1]}'; give one")
    if not given:
        raise ValueError(f"the place is missing; give {' or '.join(names)}")
