"""The wind of a profile in words, for ``qrsim show``."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from datetime import UTC, timedelta
from typing import Any

import numpy as np

from qrsim.scenarios.schema import ScenarioSpec
from qrsim.scenarios.weather import start_levels, velocity
from qrsim.scenarios.wind_limits import gust_sigma
from qrsim.scenarios.wind_schema import PROFILE

# Heights above the ground that are printed [m].
SHOWN = (2.0, 10.0, 50.0, 100.0)
# Standard deviations between the mean wind and the largest of some hundred gusts.
GUST_SIGMAS = 3.0


def profile_lines(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield lines of text about a wind profile at the start of the run, with the source of each height."""
    wind = scenario.world.wind
    if wind.type != PROFILE:
        return
    heights, names = start_levels(wind)
    source = f"{wind.source}; " if wind.source else ""
    times = f" to {max(wind.times):g} s of the run" if len(set(wind.times)) > 1 else ""
    yield f"wind: {source}{_held(wind, scenario, times)}"
    for height, north, east in zip(SHOWN, *_at_start(scenario, SHOWN), strict=True):
        speed, bearing = math.hypot(north, east), math.degrees(math.atan2(-east, -north)) % 360.0
        yield f"  {height:3g} m: {speed:.2f} m/s from {bearing:.0f} deg, {_origin(height, heights, names)}"
    if wind.model_gust is not None:
        gusts = _turbulent_gust(scenario)
        yield f"  gusts of the model: up to {wind.model_gust:.1f} m/s, not added{gusts}"


def _held(wind: Any, scenario: ScenarioSpec, times: str) -> str:
    """Return as text how long the printed wind is valid: steady, or interpolated between two times in UTC."""
    if not times:
        return "steady:"
    begin, end = (
        scenario.start_time.astimezone(UTC) + timedelta(seconds=each) for each in (min(wind.times), max(wind.times))
    )
    return f"interpolated from {begin:%Y-%m-%d %H:%M:%S} to {end:%Y-%m-%d %H:%M:%S} UTC; at the start of the run:"


def _origin(height: float, heights: list[float], names: list[str]) -> str:
    """Return as text the levels of the profile between which the wind at a height [m] is interpolated."""
    labels = [
        name if name.endswith(" m") else f"{name} ({own:.0f} m)" for own, name in zip(heights, names, strict=True)
    ]
    above = next((i for i, own in enumerate(heights) if own >= height - 1e-9), len(heights))
    if above == len(heights):
        return f"that of the highest level, {labels[-1]}"
    if abs(heights[above] - height) < 1e-6:
        return f"level {labels[above]}"
    if above == 0:
        return f"by the logarithm of height below level {labels[0]}"
    return f"between levels {labels[above - 1]} and {labels[above]}"


def _turbulent_gust(scenario: ScenarioSpec) -> str:
    """Return as text the strength of the turbulence's gusts 10 m above the ground."""
    sigma = float(gust_sigma(scenario, np.array([10.0]))[0])
    if scenario.world.turbulence.type == "still" or not sigma:
        return ""
    ((north,), (east,)) = _at_start(scenario, (10.0,))
    most = math.hypot(north, east) + GUST_SIGMAS * sigma
    return f"; the turbulence reaches {most:.1f} m/s at 10 m (mean and {GUST_SIGMAS:g} standard deviations)"


def _at_start(scenario: ScenarioSpec, heights: Sequence[float]) -> tuple[list[float], list[float]]:
    """Return wind velocities to north and east [m/s] at heights [m] at the start of the run."""
    north, east = velocity(scenario, np.array(heights), [0.0])
    return north[0].tolist(), east[0].tolist()
