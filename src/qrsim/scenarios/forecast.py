"""A wind as forecasts give it: a speed at a height, over land of a roughness, with gusts."""

from __future__ import annotations

import math
from collections.abc import Mapping

from qrsim.errors import ScenarioError, did_you_mean, nearest
from qrsim.files import Content
from qrsim.models.atmosphere.wind import FEET_PER_METRE, REFERENCE_FT, ROUGHNESS_M

FORECAST = ("speed", "at_height", "gust", "gust_factor")
# Height of the anemometers of the WMO [m].
USUAL_HEIGHT = 10.0
# Where a wind that is a number alone comes from.
USUAL_FROM_DEG = 0.0
# Standard deviations between the mean of ten minutes and its largest mean of 3 s, of gusts that are correlated over 4
# to 12 s, as at 10 m in 5 to 15 m/s.
GUST_SIGMAS = 2.5
# Largest gust [m/s], and largest ratio of a gust to the mean speed.
LARGEST_GUST, LARGEST_FACTOR = 75.0, 10.0
TURBULENT = ("dryden", "dryden_field", "dryden_first_order")


def insert_forecast(content: Mapping[str, object], source: str) -> None:
    """Replace, in place, the forecast parameters of a wind of type log_shear by ``speed_20ft`` and turbulence.

    A wind that is a number is a ``log_shear`` with that ``speed`` [m/s] from the north.

    Raises:
        ScenarioError: a number is missing, of the wrong kind or out of range.
    """
    world = content.get("world")
    wind = world.get("wind") if isinstance(world, dict) else None
    if isinstance(world, dict) and isinstance(wind, int | float) and not isinstance(wind, bool):
        wind = world["wind"] = {"type": "log_shear", "speed": wind, "wind_from_deg": USUAL_FROM_DEG}
    if not isinstance(world, dict) or not isinstance(wind, dict) or wind.get("type") != "log_shear":
        return
    given = {name: wind.pop(name) for name in FORECAST if name in wind}
    problem = _unknown(wind, bool(given)) or (_problem(given, wind) if given else "")
    if problem:
        raise ScenarioError(source, [f"world.wind.{problem}"])
    if not given:
        return
    height, roughness = float(given.get("at_height", USUAL_HEIGHT)), float(wind.get("roughness", ROUGHNESS_M))
    share = math.log(REFERENCE_FT / FEET_PER_METRE / roughness) / math.log(height / roughness)
    wind["speed_20ft"] = float(given["speed"]) * share
    if "gust" in given or "gust_factor" in given:
        turbulence = world.setdefault("turbulence", {"type": "dryden_field"})
        gust = given["gust"] if "gust" in given else given["gust_factor"] * given["speed"]
        sigma = (float(gust) - float(given["speed"])) / GUST_SIGMAS
        if isinstance(turbulence, dict) and turbulence.get("type") in TURBULENT:
            turbulence.setdefault("speed_20ft", turbulence_speed(sigma, height))


def turbulence_speed(sigma: float, height: float) -> float:
    """Return the wind speed at 20 ft [m/s] for which gusts at a height [m] have standard deviation ``sigma`` [m/s].

    MIL-F-8785C, low altitude: sigma_u = 0.1 W20/(0.177 + 0.000823 h)^0.4, h in feet.
    """
    feet = min(max(height * FEET_PER_METRE, 10.0), 1000.0)
    return 10.0 * sigma * (0.177 + 0.000823 * feet) ** 0.4


def _unknown(wind: Mapping[str, object], forecast: bool) -> str:
    """Return an error text for an unknown wind parameter, without a ``forecast`` only for a misspelt one; or "".

    Args:
        wind: without the names of forecasts.
        forecast: whether it had some; else only a name that is close to one is told here.
    """
    known = (*FORECAST, "roughness", "speed_20ft", "wind_from_rad", "wind_from_deg")
    for name in wind:
        if name not in ("type", *known) and (forecast or nearest(str(name), known) in FORECAST):
            return f"{name}: no such parameter of 'log_shear'{did_you_mean(str(name), known)}"
    return ""


def _problem(given: Content, wind: Content) -> str:
    """Return an error text for impossible numbers of a wind forecast; "" if they are valid."""
    for name, value in {**given, "roughness": wind.get("roughness", ROUGHNESS_M)}.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            return f"{name}: expected a number, found {'null' if value is None else f'{value!r:.60}'}"
    if "speed" not in given:
        return f"speed: missing; expected the mean speed [m/s] beside {' and '.join(given)}"
    if "speed_20ft" in wind:
        return "speed: gives both 'speed' and 'speed_20ft'; give one"
    speed, height = given["speed"], given.get("at_height", USUAL_HEIGHT)
    roughness = wind.get("roughness", ROUGHNESS_M)
    if not 0.0 <= speed <= 50.0:
        return f"speed: {speed:g} m/s; allowed: 0 to 50"
    if not 0.0 < roughness <= 2.0:
        return f"roughness: {roughness:g} m; allowed: above 0, at most 2"
    if not 2.0 * roughness < height <= 300.0:
        return f"at_height: {height:g} m; allowed: above {2.0 * roughness:.3g} (twice the roughness), at most 300"
    return _gust_problem(given, speed)


def _gust_problem(given: Content, speed: float) -> str:
    """Return an error text for the gust or gust factor of a forecast with mean ``speed`` [m/s]; "" if valid."""
    gust, factor = given.get("gust"), given.get("gust_factor")
    if gust is not None and factor is not None:
        return "gust: gives both 'gust' and 'gust_factor'; give one"
    if gust is not None and not speed <= gust <= LARGEST_GUST:
        other = "; gust_factor, a multiple of the speed, may take its place" if gust < speed else ""
        return f"gust: {gust:g} m/s; allowed: the mean speed, {speed:g}, to {LARGEST_GUST:g}{other}"
    if factor is not None and not 1.0 <= factor <= LARGEST_FACTOR:
        return f"gust_factor: {factor:g}; allowed: 1 to {LARGEST_FACTOR:g}"
    if factor is not None and factor * speed > LARGEST_GUST:
        return f"gust_factor: {factor:g} times {speed:g} m/s is {factor * speed:g} m/s; allowed: to {LARGEST_GUST:g}"
    return ""
