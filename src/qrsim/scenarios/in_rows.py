"""Vehicles in rows: so many, so far apart, in place of a list (docs/scenarios.md)."""

from __future__ import annotations

import math
from typing import Any

from pydantic import Field, ValidationError

from qrsim.scenarios.component_schema import Finite, Strict
from qrsim.scenarios.legs import Position
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
    yaw_rad: Finite = Field(0.0, description="heading of all at the start and along the route [rad]", ge=-6.3, le=6.3)
    velocity_body: Position = Field([0.0, 0.0, 0.0], description="initial velocity of all in body axes [m/s]")
    on_ground: bool = Field(False, description="whether all start on the ground", strict=True)

    def vehicles(self) -> list[dict[str, Any]]:
        """Return the vehicles one by one, as a list of them in a scenario has them."""
        columns = min(self.columns or math.ceil(math.sqrt(self.count)), self.count)
        rows = -(-self.count // columns)
        found = []
        for i in range(self.count):
            row, column = divmod(i, columns)
            beside = (self.spacing * (row - 0.5 * (rows - 1)), self.spacing * (column - 0.5 * (columns - 1)), 0.0)

            def shifted(point: list[float], beside: tuple[float, ...] = beside) -> list[float]:
                return [axis + off for axis, off in zip(point, beside, strict=True)]

            found.append(
                {
                    "position_ned": shifted(self.position_ned), "yaw_rad": self.yaw_rad,
                    "waypoints_ned": [shifted(point) for point in self.waypoints_ned],
                    "velocity_body": list(self.velocity_body), "on_ground": self.on_ground,
                }
            )  # fmt: skip
        return found


def one_by_one(value: Any) -> Any:
    """Return vehicles that are given in rows one by one, and anything else as it is.

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
        raise ValueError("; ".join(describe(error, RowsSpec, value))) from None
    return rows.vehicles()


def or_in_rows(schema: dict[str, Any]) -> None:
    """Add rows to the JSON schema of a list of vehicles."""
    listed = {name: schema.pop(name) for name in ("type", "items", "minItems") if name in schema}
    schema["anyOf"] = [listed, RowsSpec.model_json_schema()]


def count_of(value: Any) -> int:
    """Return how many vehicles the content of a scenario asks for, 0 where that cannot be read."""
    if isinstance(value, dict):
        value = value.get("count", 0)
        return value if isinstance(value, int) and not isinstance(value, bool) else 0
    return len(value) if isinstance(value, list) else 0
