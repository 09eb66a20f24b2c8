"""Changes to a world while it runs."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from qrsim.core.tree import field_info, replace
from qrsim.simulation import Simulation
from qrsim.world_tree import World


@dataclass(frozen=True)
class Wind:
    """A mean wind.

    Attributes:
        speed: 20 ft above the ground [m/s].
        from_deg: bearing it comes from [degrees].
        fastest: that can be asked for [m/s].
    """

    speed: float
    from_deg: float
    fastest: float = 20.0


def wind_of(world: World) -> Wind | None:
    """Return the mean wind of a world; None where it is of a kind that has no one speed and direction."""
    wind = world.wind
    # What every episode draws anew would win over any change.
    drawn = any(path[:1] == ("wind",) for item in getattr(world, "ranges", ()) for path in item.paths)
    if drawn or not (hasattr(wind, "speed_20ft") and hasattr(wind, "wind_from_rad")):
        return None
    speed, bearing = float(wind.speed_20ft), math.degrees(float(wind.wind_from_rad)) % 360.0
    limit = next(field_info(f).maximum for f in dataclasses.fields(wind) if f.name == "speed_20ft")
    return Wind(speed, bearing, min(limit or math.inf, max(20.0, math.ceil(speed))))


def change_wind(simulation: Simulation, wind: Wind) -> list[dict[str, Any]]:
    """Let another wind blow from the next tick on; return that as events of a run."""
    world = simulation.world
    changed = replace(
        world.wind,
        speed_20ft=np.asarray(wind.speed, simulation.dtype),
        wind_from_rad=np.asarray(math.radians(wind.from_deg), simulation.dtype),
    )
    simulation.change_world(replace(world, wind=changed))
    where = {"time": simulation.time, "tick": simulation.tick, "vehicle": None, "kind": "wind_changed"}
    speed = f"wind changed at {simulation.time:.2f} s: {wind.speed:g} m/s at 20 ft"
    bearing = f"wind changed at {simulation.time:.2f} s: from {wind.from_deg:g} degrees"
    return [
        {**where, "field": "world.wind.speed_20ft", "value": wind.speed, "message": speed},
        {**where, "field": "world.wind.wind_from_deg", "value": wind.from_deg, "message": bearing},
    ]
