"""Vehicles in rows: so many, so far apart, in place of a list (docs/howto/write_a_scenario.md)."""

from __future__ import annotations

import math

from pydantic import Field, ValidationError, model_validator

from qrsim.files import Content
from qrsim.scenarios.component_schema import Finite, Strict
from qrsim.scenarios.legs import LegSpec, Position
from qrsim.scenarios.problems import describe

MOST_IN_ROWS = 10_000


class RowsSpec(Strict):
    """So many vehicles in rows to the east, one row behind the other to the north, the first one in the south-west."""

    count: int = Field(description="number of vehicles", ge=1, le=MOST_IN_ROWS, strict=True)
    spacing: Finite = Field(5.0, description="from one vehicle to the next, both ways [m]", ge=0, le=1e5)
    columns: int | None = Field(
        None, description="vehicles in a row; default: as many as make the whole nearly square", ge=1, strict=True
    )
    position_ned: Position = Field(description="the middle of the whole rectangle [m]: north, east, down")
    waypoints_ned: list[Position] = Field(
        [], description="route of the middle [m], which each flies beside it as it starts", max_length=2000
    )
    legs: list[LegSpec] = Field(
        [],
        description="mission of the middle, instead of waypoints; each flies it shifted as its start is",
        max_length=2000,
    )
    yaw_rad: Finite = Field(0.0, description="heading of all at the start and along the route [rad]", ge=-6.3, le=6.3)
    velocity_body: Position = Field([0.0, 0.0, 0.0], description="initial velocity of all in body axes [m/s]")
    on_ground: bool = Field(False, description="whether all start on the ground", strict=True)

    @model_validator(mode="after")
    def _one_route(self) -> RowsSpec:
        """Refuse rows of vehicles with both waypoints and legs, or with legs to geodetic positions."""
        if self.waypoints_ned and self.legs:
            raise ValueError("gives both 'waypoints_ned' and 'legs'; give one")
        for number, leg in enumerate(self.legs):
            if vars(leg).get("to_geodetic") is not None:
                raise ValueError(f"legs.{number}.to_geodetic: rows are shifted in metres; give to_ned")
        return self

    def vehicles(self) -> list[Content]:
        """Expand the rows to a list of single vehicles, as scenario content."""
        columns = min(self.columns or math.ceil(math.sqrt(self.count)), self.count)
        rows = -(-self.count // columns)
        legs = [leg.model_dump(exclude_unset=True) | {"type": leg.type} for leg in self.legs]
        found = []
        for i in range(self.count):
            row, column = divmod(i, columns)
            off = (self.spacing * (row - 0.5 * (rows - 1)), self.spacing * (column - 0.5 * (columns - 1)), 0.0)
            found.append(
                {
                    "position_ned": _shifted(self.position_ned, off),
                    "yaw_rad": self.yaw_rad,
                    "waypoints_ned": [_shifted(point, off) for point in self.waypoints_ned],
                    "legs": [
                        leg | {name: _shifted(leg[name], off) for name in ("to_ned", "at_ned") if leg.get(name)}
                        for leg in legs
                    ],
                    "velocity_body": list(self.velocity_body),
                    "on_ground": self.on_ground,
                }
            )
        return found


def _shifted(point: list[float], off: tuple[float, ...]) -> list[float]:
    """Return a point [m] of two or three coordinates, shifted by ``off`` [m]."""
    return [axis + shift for axis, shift in zip(point, off, strict=False)]


def one_by_one(value: object) -> object:
    """Expand vehicles given in rows to a list of vehicles; return any other value unchanged.

    Raises:
        ValueError: the rows are wrong; says what of them.
    """
    if not isinstance(value, dict):
        return value
    if not value or ("position_ned" in value and not {"count", "spacing", "columns"} & set(value)):
        raise ValueError("expected a list, or rows with a count; found keys and values without one")
    try:
        rows = RowsSpec.model_validate(value)
    except ValidationError as error:
        # What concerns the rows as a whole has the path of the scenario itself.
        lines = (line.removeprefix("scenario: ") for line in describe(error, RowsSpec, value))
        raise ValueError("; ".join(lines)) from None
    return rows.vehicles()


def count_of(value: object) -> int:
    """Return the number of vehicles in scenario content, a list or rows; 0 if it is neither."""
    if isinstance(value, dict):
        value = value.get("count", 0)
        return value if isinstance(value, int) and not isinstance(value, bool) else 0
    return len(value) if isinstance(value, list) else 0
