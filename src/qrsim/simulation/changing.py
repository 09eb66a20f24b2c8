"""Changes of the weather in flight: numbers of a World, checked."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from qrsim.core.arrays import is_number
from qrsim.core.tree import field_info, replace
from qrsim.errors import UsageError, did_you_mean
from qrsim.models.atmosphere.wind import LogShear
from qrsim.models.atmosphere.wind_series import VeeringShear
from qrsim.world.state import World

Weather = tuple[Any, ...]
WIND = "wind"
# Numbers that each kind takes: those that it needs, and those that it may have.
TAKES: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {WIND: (("speed_20ft", "wind_from_deg"), ())}


def changed(world: World, kind: str, numbers: Mapping[str, Any]) -> World:
    """Return a world with another weather from the next tick on.

    Args:
        world: its parameters, on the host.
        kind: what changes, one of ``TAKES``.
        numbers: its numbers, by name.

    Raises:
        UsageError: it cannot be changed, or not so.
    """
    if kind not in TAKES:
        raise UsageError(f"kind: '{kind}' does not suit the world; allowed: {', '.join(TAKES)}")
    needed, optional = TAKES[kind]
    for name in numbers:
        if name not in needed + optional:
            raise UsageError(f"{name}: there is no such number{did_you_mean(name, needed + optional)}")
    for name in needed:
        if numbers.get(name) is None:
            raise UsageError(f"{name}: missing; kind '{kind}' needs it")
    return _with_wind(world, numbers["speed_20ft"], numbers["wind_from_deg"])


def _with_wind(world: World, speed: Any, from_deg: Any) -> World:
    most = wind_limit(world)
    in_range(speed, "speed_20ft", 0.0, most, "m/s")
    if not is_number(from_deg) or not math.isfinite(from_deg):
        raise UsageError(f"wind_from_deg: {from_deg!r}; allowed: a finite number")
    return with_wind(world, speed, from_deg)


def weather_of(world: World) -> Weather:
    """Return the parts of a world that changes of its weather concern."""
    return (world.wind,)


def with_weather(world: World, weather: Weather) -> World:
    """Return a world with such parts of another time."""
    return replace(world, wind=weather[0])


def in_range(value: Any, name: str, low: float, high: float, unit: str) -> None:
    """Refuse what is no number from low to high."""
    if not is_number(value) or not low <= value <= high:
        raise UsageError(f"{name}: {value!r}; allowed: {low:g} to {high:g} {unit}".rstrip())


def wind_limit(world: World) -> float:
    """Return the largest speed [m/s], 20 ft above the ground, that the mean wind of a world can be changed to.

    Raises:
        UsageError: it cannot be changed.
    """
    # What every episode draws anew would win over any change.
    if any(path[:1] == ("wind",) for item in world.ranges for path in item.paths):
        raise UsageError("wind: every episode draws it (ranges), so it cannot be changed in flight")
    wind = world.wind
    if not isinstance(wind, LogShear | VeeringShear):
        raise UsageError("wind: only that of type log_shear, or a series over time, can be changed in flight")
    limit = next(field_info(field).maximum for field in dataclasses.fields(wind) if field.name == "speed_20ft")
    return math.inf if limit is None else limit


def with_wind(world: World, speed: float, from_deg: float) -> World:
    """Return a world with another mean wind: speed [m/s] at 20 ft, and bearing [degrees] it comes from."""
    wind: Any = world.wind
    dtype = np.asarray(wind.speed_20ft).dtype
    bearing = np.asarray(math.radians(from_deg), dtype)
    return replace(world, wind=replace(wind, speed_20ft=np.asarray(speed, dtype), wind_from_rad=bearing))
