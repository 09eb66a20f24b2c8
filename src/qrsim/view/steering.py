"""Changes to a world while it runs."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from qrsim.core.tree import field_info, replace
from qrsim.models.atmosphere.wind import LogShear
from qrsim.models.atmosphere.wind_series import VeeringShear
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import World

# Of the events that say so: their kind, and the fields of the two of a change.
WIND_CHANGED = "wind_changed"
SPEED, BEARING = "world.wind.speed_20ft", "world.wind.wind_from_deg"


@dataclass(frozen=True)
class Wind:
    """Speed and direction of a mean wind.

    Attributes:
        speed: 20 ft above the ground [m/s].
        from_deg: bearing it comes from [degrees].
        fastest: that can be asked for [m/s].
    """

    speed: float
    from_deg: float
    fastest: float = 20.0


def wind_of(world: World) -> Wind | None:
    """Return the mean wind of a world; None for a wind model without one speed and direction."""
    wind = world.wind
    # What every episode draws anew would win over any change.
    drawn = any(path[:1] == ("wind",) for item in world.ranges for path in item.paths)
    if drawn or not isinstance(wind, LogShear | VeeringShear):
        return None
    # As they were written, not as they are rounded to float32.
    speed, bearing = round(float(wind.speed_20ft), 3), round(math.degrees(float(wind.wind_from_rad)) % 360.0, 3)
    limit = next(field_info(f).maximum for f in dataclasses.fields(wind) if f.name == "speed_20ft")
    return Wind(speed, bearing, min(limit or math.inf, max(20.0, math.ceil(speed))))


def change_wind(simulation: Simulation, wind: Wind) -> list[dict[str, object]]:
    """Change the wind from the next tick on; return the change as events of a run."""
    asked = {SPEED: wind.speed, BEARING: wind.from_deg}
    simulation.change_world(with_wind(simulation.world, asked))
    where = {"time": simulation.time, "tick": simulation.tick, "vehicle": None, "kind": WIND_CHANGED}
    said = (f"{wind.speed:g} m/s at 20 ft", f"from {wind.from_deg:g} degrees")
    return [
        {**where, "field": field, "value": value, "message": f"wind changed at {simulation.time:.2f} s: {what}"}
        for (field, value), what in zip(asked.items(), said, strict=True)
    ]


def with_wind(world: World, asked: Mapping[Any, Any]) -> World:
    """Return a world with the wind set by the fields of recorded events."""
    wind: Any = world.wind
    dtype = np.asarray(wind.speed_20ft).dtype
    speed, bearing = np.asarray(asked[SPEED], dtype), np.asarray(math.radians(asked[BEARING]), dtype)
    return replace(world, wind=replace(wind, speed_20ft=speed, wind_from_rad=bearing))
