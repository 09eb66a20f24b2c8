"""Checks of a world's contents besides vehicles, and of random starts."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from qrsim.models.scene.contents import WIND_HEIGHT
from qrsim.models.scene.placement import RingPlaces
from qrsim.models.scene.plume import trail
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.schema import ScenarioSpec
from qrsim.scenarios.timing import is_multiple
from qrsim.scenarios.weather import largest_speed
from qrsim.scenarios.wind_schema import PROFILE

# Lowest and highest of the same.
PAIRS = (
    ("rate_min", "rate_max"),
    ("amount_min", "amount_max"),
    ("std_min", "std_max"),
    ("fewest", "most"),
    ("nearest", "farthest"),
    ("yaw_min_rad", "yaw_max_rad"),
)


def contents_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the errors in a scenario's plume, ground cover, persons and random starts."""
    world = scenario.world
    parts = {f"world.{name}": getattr(world, name) for name in ("plume", "terrain", "persons")}
    parts |= {f"fleets.{name}.placement": fleet.placement for name, fleet in scenario.fleets.items()}
    for path, part in parts.items():
        if part.type in ("none", "clear", "given"):
            continue
        if world.area.type != "box":
            yield f"{path}: '{part.type}' needs world.area of type box; it is a {world.area.type}"
        yield from _order_problems(path, part)
        period = vars(part).get("period")
        if period is not None and not is_multiple(period, scenario.time_step):
            yield f"{path}.period: {period:g} s is not a multiple of the time step {scenario.time_step:g} s"
    yield from _plume_problems(scenario)
    yield from _share_problems(scenario)
    yield from _ring_problems(scenario)


def _order_problems(path: str, part: object) -> Iterator[str]:
    """Yield an error for each pair (smallest, largest) in a part of the scenario that is in the wrong order."""
    for low, high in PAIRS:
        if low in vars(part) and getattr(part, low) > getattr(part, high):
            yield f"{path}.{low}: {getattr(part, low):g}; allowed: at most {high}, {getattr(part, high):g}"


def _plume_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield an error if a plume needs a wind and the scenario has none, or needs too many puffs."""
    plume, wind = scenario.world.plume, scenario.world.wind
    if not known.PLUMES[plume.type].needs_wind:
        return
    known_speed = wind.type == PROFILE or "speed_20ft" in vars(wind)
    if wind.type == PROFILE:
        speed = float(largest_speed(scenario, np.array([WIND_HEIGHT]))[0])
    else:
        speed = vars(wind).get("speed_20ft", 0.0)
    if not speed > 0.0:
        found = f"of {speed:g} m/s" if known_speed else f"'{wind.type}'"
        yield f"world.plume: '{plume.type}' needs a wind with a speed_20ft above 0; world.wind is {found}"
    elif plume.type == "puffs" and scenario.world.area.type == "box":
        needed = puffs_in_the_air(plume, scenario.world.area, speed)
        if needed > plume.puffs:
            yield (
                f"world.plume.puffs: {plume.puffs}; allowed: at least {needed}, because at {speed:g} m/s so many puffs "
                f"of a source, one in {plume.gap:g} s, can be in the area at once"
            )


def puffs_in_the_air(plume: Any, area: Any, speed: float) -> int:
    """Return how many puffs to store per plume source: the mean number in the area plus six standard deviations."""
    across = math.hypot(area.x_max - area.x_min, area.y_max - area.y_min)
    flown = across
    for _ in range(20):
        flown = across + float(trail(plume.spread_factor, plume.spread_exponent, flown))
    # Next to no time between two puffs would be more of them than numbers can say.
    mean = min(flown / max(speed * plume.gap, 1e-300), 1e15)
    return math.ceil(mean + 6.0 * math.sqrt(mean))


def _share_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield an error if the probabilities that a person is on clutter or occluded exceed 1 together."""
    persons = scenario.world.persons
    if persons.type == "lying" and persons.on_clutter + persons.on_occlusion > 1.0:
        total = persons.on_clutter + persons.on_occlusion
        yield f"world.persons: on_clutter and on_occlusion are {total:g} together; allowed: at most 1"


def _ring_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield an error for each fleet with more vehicles than fit into its ring of random starts."""
    for name, fleet in scenario.fleets.items():
        if fleet.placement.type != "ring":
            continue
        ring = fleet.placement
        room = RingPlaces(farthest=ring.farthest, apart=ring.apart).most_vehicles()
        if len(fleet.vehicles) > room:
            yield (
                f"fleets.{name}.placement: {len(fleet.vehicles)} vehicles at least {ring.apart:g} m apart do not fit "
                f"within {ring.farthest:g} m of a point; allowed: at most {room}"
            )
