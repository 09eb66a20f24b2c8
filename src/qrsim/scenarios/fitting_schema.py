"""The schema of how a sensor is fitted: what a scenario says of every sensor beside the parameters of its model."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field

from qrsim.models.sensors.fitting import LONGEST_DELAY
from qrsim.scenarios.component_schema import Finite

FARTHEST = 100.0
_Angle = Annotated[float, Field(allow_inf_nan=False, strict=True, ge=-2.0 * math.pi, le=2.0 * math.pi)]
_Place = Annotated[float, Field(allow_inf_nan=False, strict=True, ge=-FARTHEST, le=FARTHEST)]
_THREE = Field(min_length=3, max_length=3)
# A sensor with a parameter of one of these names keeps it, as a GNSS receiver its own delay in whole periods.
FITTING: dict[str, tuple[object, object]] = {
    "delay": (
        Finite,
        Field(
            0.0,
            ge=0,
            le=LONGEST_DELAY,
            json_schema_extra={"unit": "periods"},
            description="mean time from reading to delivery, a whole number of time steps",
        ),
    ),
    "jitter": (
        Finite,
        Field(0.0, ge=0, json_schema_extra={"unit": "s"}, description="std of the time of delivery; 0: always alike"),
    ),
    "mount_position_body": (
        Annotated[list[_Place], _THREE] | None,
        Field(
            None,
            json_schema_extra={"unit": "m"},
            description="forward, right and down of the centre of mass; default: there",
        ),
    ),
    "mount_attitude_rad": (
        Annotated[list[_Angle], _THREE] | None,
        Field(
            None,
            json_schema_extra={"unit": "rad"},
            description="roll, pitch and yaw of the sensor's axes against the body's; default: none",
        ),
    ),
}
