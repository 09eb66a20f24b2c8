"""Changes to a world while it runs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from qrsim.errors import UsageError
from qrsim.scenarios.live_requests import Request, apply
from qrsim.simulation.changing import wind_limit, with_wind
from qrsim.world.state import World

if TYPE_CHECKING:
    from qrsim.simulation.simulation import Simulation

# Kind of the events that tell of another wind, and the fields of the two of a change of the wind.
WIND_CHANGED = "wind_changed"
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
    """Return the mean wind that users may change on the page; None for a wind model without one speed and direction."""
    try:
        limit = wind_limit(world)
    except UsageError:
        return None
    wind: Any = world.wind
    # As they were written, not as they are rounded to float32.
    speed, bearing = round(float(wind.speed_20ft), 3), round(math.degrees(float(wind.wind_from_rad)) % 360.0, 3)
    return Wind(speed, bearing, min(limit, max(20.0, math.ceil(speed))))


def steered(simulation: Simulation, request: Request) -> str:
    """Apply a request of the page, such as a fault or other wind, from the next tick on; return a line about it.

    Raises:
        UsageError: it cannot be done; nothing has changed.
    """
    return apply(simulation, request, PAGE)


def with_asked(world: World, asked: Mapping[Any, Any]) -> World:
    """Return a world with its wind changed as recorded in events; ``asked``: field (speed, direction) -> value."""
    return with_wind(world, asked.get(SPEED), asked.get(BEARING))
