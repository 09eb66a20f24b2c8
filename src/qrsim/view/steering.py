"""Changes to a world while it runs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from qrsim.errors import UsageError
from qrsim.scenarios.live_requests import OK, WIND_NUMBERS, Request, apply
from qrsim.simulation.injecting import wind_limit, with_wind
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import World

# Of the events that say so: their kinds, and the fields of the two of a change of the wind.
INJECTED, CLEARED, WIND_CHANGED = "injected", "cleared", "wind_changed"
WHEN = "wind changed at {:.2f} s"
# Who asks, in records.
PAGE = "page"
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
    try:
        limit = wind_limit(world)
    except UsageError:
        return None
    wind: Any = world.wind
    # As they were written, not as they are rounded to float32.
    speed, bearing = round(float(wind.speed_20ft), 3), round(math.degrees(float(wind.wind_from_rad)) % 360.0, 3)
    return Wind(speed, bearing, min(limit, max(20.0, math.ceil(speed))))


def steered(simulation: Simulation, request: Request) -> tuple[str, list[dict[str, object]]]:
    """Do what is asked on the page from the next tick on; return a line that says so, and the events of the run.

    Raises:
        UsageError: it cannot be done; nothing has changed.
    """
    line = apply(simulation, request, PAGE)
    where = {"time": simulation.time, "tick": simulation.tick, "vehicle": None}
    if not request.of_world:
        kind = CLEARED if request.kind == OK else INJECTED
        message = f"{line[0].lower()}{line[1:]}, at {simulation.time:.2f} s"
        vehicles = request.vehicles or (None,)
        return line, [
            {**where, "vehicle": name, "kind": kind, "field": request.target, "message": message} for name in vehicles
        ]
    speed, bearing = (request.numbers[name] for name in WIND_NUMBERS)
    said = ((SPEED, speed, f"{speed:g} m/s at 20 ft"), (BEARING, bearing, f"from {bearing:g} degrees"))
    return line, [
        {
            **where,
            "kind": WIND_CHANGED,
            "field": field,
            "value": value,
            "message": f"{WHEN.format(where['time'])}: {what}",
        }
        for field, value, what in said
    ]


def with_asked(world: World, asked: Mapping[Any, Any]) -> World:
    """Return a world with the wind set by the fields of recorded events."""
    return with_wind(world, asked[SPEED], asked[BEARING])
