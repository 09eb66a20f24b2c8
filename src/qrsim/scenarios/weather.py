"""Winds of weather models and of tables: read while a scenario is loaded, and from then on numbers of the scenario."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from qrsim.core.arrays import Floats, NumpyArray
from qrsim.errors import UsageError, warn_user
from qrsim.models.atmosphere.weather.soundings import Level, Site, Soundings, kind_of, read_weather
from qrsim.models.atmosphere.weather.table import read_table
from qrsim.models.atmosphere.weather.values import Request, needed_times
from qrsim.models.atmosphere.wind import FEET_PER_METRE, REFERENCE_FT
from qrsim.models.atmosphere.wind_profile import MOST_ROWS
from qrsim.scenarios.build import wind_of
from qrsim.scenarios.ground import bounds_of, top_of
from qrsim.scenarios.schema import ScenarioSpec
from qrsim.scenarios.wind_schema import PROFILE, WEATHER, profile_model

REFERENCE_M = REFERENCE_FT / FEET_PER_METRE
# Levels of an area without a ceiling reach up to here [m].
USUAL_TOP = 3000.0
# Depth of valleys [m].
DEEPEST = 500.0
# An area of more cells of a model has more than one wind.
MOST_OF_CELL = 2.0


def with_profile(scenario: ScenarioSpec, quiet: bool = False) -> tuple[ScenarioSpec, list[str]]:
    """Return a scenario with its wind file's numbers filled in, and the file's errors; ``quiet``: without warnings.

    Turbulence that leaves out its strength and bearing takes those of the profile 20 ft above the ground, in the middle
    of the run.
    """
    wind = scenario.world.wind
    if wind.type not in (PROFILE, WEATHER):
        return scenario, []
    try:
        if wind.type == WEATHER or wind.file is not None:
            wind = _numbers(scenario, quiet)
        elif not wind.heights:
            raise UsageError("heights: missing; give heights, speeds and wind_from_deg, or a file")
        elif len(wind.levels) not in (0, len(wind.heights)):
            raise UsageError(f"levels: {len(wind.levels)} names; heights has {len(wind.heights)}")
        scenario = scenario.model_copy(update={"world": scenario.world.model_copy(update={"wind": wind})})
        wind_of(scenario)
        return _with_turbulence(scenario), []
    except UsageError as error:
        return scenario, [f"world.wind: {error}"]


def _numbers(scenario: ScenarioSpec, quiet: bool) -> Any:
    """Read a wind file; return its profile at the site and time as a pydantic model; ``quiet``: without warnings."""
    wind, place = scenario.world.wind, scenario.site
    start = scenario.start_time.timestamp()
    request = Request(
        place.latitude_deg, place.longitude_deg, start, start + scenario.duration, vars(wind).get("member")
    )
    if wind.type == WEATHER:
        amsl = place.height - place.undulation
        found = read_weather(wind.file, request, Site(amsl, wind.above, wind.roughness))
    else:
        given = [name for name in ("heights", "speeds", "wind_from_rad", "times") if getattr(wind, name)]
        if given:
            raise UsageError(f"{given[0]}: is given along with a file; give one")
        if kind := kind_of(wind.file):
            raise UsageError(f"{wind.file}: is {kind}; a file of a weather model is of type weather, a profile is CSV")
        found = _of_run(wind.file, read_table(wind.file, wind.roughness), request)
    for note in () if quiet else (*found.notes, *_coarse(scenario, wind.file, found.cell)):
        warn_user(f"{scenario.name}: world.wind: {note}")
    top = top_of(scenario.world.area)
    # Above valleys vehicles are higher above the ground than above the origin.
    relief = 0.0 if scenario.world.ground.type == "flat" else DEEPEST
    return _spec(found, start, wind.roughness, USUAL_TOP if top is None else top + relief)


def _coarse(scenario: ScenarioSpec, file: str, cell: float) -> Iterator[str]:
    """Yield a note if the area spans several grid cells of the weather file, of which only the site's is used."""
    bounds = bounds_of(scenario.world.area)
    side = 0.0 if bounds is None else max(bounds[1] - bounds[0], bounds[3] - bounds[2])
    if side > MOST_OF_CELL * cell:
        yield (
            f"{file}: its cells are {cell / 1000.0:.2g} km, and the area is {side / 1000.0:.2g} km long; the wind of "
            "the site is used everywhere; world.wind of type grid differs from place to place"
        )


def _of_run(file: str, found: Soundings, request: Request) -> Soundings:
    """Return the soundings (wind over height) of a table, limited to the times that a run needs."""
    if not found.times:
        return found
    if len(found.times) == 1:
        raise UsageError(f"{file}: has one time; leave out the column time of a steady wind")
    kept = needed_times(file, list(found.times), request)
    first = found.times.index(kept[0])
    return Soundings(tuple(kept), found.levels[first : first + len(kept)], found.source)


def _spec(found: Soundings, start: float, roughness: float, top: float) -> Any:
    """Return soundings as a wind profile of the schema, up to the first level above ``top`` [m]."""
    rows: list[tuple[float, Level]] = []
    for i, levels in enumerate(found.levels):
        time = found.times[i] - start if found.times else 0.0
        above = [j for j, level in enumerate(levels) if level.height >= top]
        rows += [(time, level) for level in (levels[: above[0] + 1] if above else levels)]
    if len(rows) > MOST_ROWS:
        raise UsageError(f"{found.source}: {len(rows)} rows in the run and the area; allowed: {MOST_ROWS}")
    columns = {
        "heights": [level.height for _, level in rows],
        "speeds": [math.hypot(level.north, level.east) for _, level in rows],
        "wind_from_rad": [math.atan2(-level.east, -level.north) % math.tau for _, level in rows],
        "times": [time for time, _ in rows] if found.times else [],
        "levels": [level.name for _, level in rows],
    }
    model = profile_model()
    return model(type=PROFILE, roughness=roughness, source=found.source, model_gust=found.gust, **columns)


def _with_turbulence(scenario: ScenarioSpec) -> ScenarioSpec:
    """Return a scenario in which missing speed and bearing of the turbulence come from the wind profile."""
    turbulence = scenario.world.turbulence
    missing = [name for name in ("speed_20ft", "wind_from_rad") if vars(turbulence).get(name, 0.0) is None]
    if not missing:
        return scenario
    pair = velocity(scenario, np.array([REFERENCE_M]), [0.5 * scenario.duration])
    north, east = (float(axis[0, 0]) for axis in pair)
    values = {"speed_20ft": min(math.hypot(north, east), 50.0), "wind_from_rad": math.atan2(-east, -north) % math.tau}
    changed = turbulence.model_copy(update={name: values[name] for name in missing})
    return scenario.model_copy(update={"world": scenario.world.model_copy(update={"turbulence": changed})})


def velocity(scenario: ScenarioSpec, heights: NumpyArray, times: Sequence[float]) -> tuple[Floats, Floats]:
    """Return the wind profile's velocities to north and east, each (T, n) [m/s], at times (T,) and heights (n,).

    Args:
        scenario: with a wind of type profile.
        heights: (n,) above the ground [m].
        times: (T,) since the start of the run [s].

    Raises:
        UsageError: its rows are no profile.
    """
    wind = wind_of(scenario)
    known = wind.seconds + wind.fraction
    row = np.clip(np.searchsorted(known, times, side="right") - 1, 0, max(len(known) - 2, 0))
    after = np.minimum(row + 1, len(known) - 1)
    interval = known[after] - known[row]
    share = np.clip((times - known[row]) / np.where(interval > 0.0, interval, np.inf), 0.0, 1.0)[:, None]
    north, east = (axis[row] + share * (axis[after] - axis[row]) for axis in wind.at_times(heights))
    return north, east


def largest_speed(scenario: ScenarioSpec, heights: NumpyArray) -> Floats:
    """Return the largest wind speed [m/s] of a profile during the run, at heights (n,) [m]."""
    inside = [time for time in set(scenario.world.wind.times) if 0.0 < time < scenario.duration]
    return np.hypot(*velocity(scenario, heights, [0.0, *inside, scenario.duration])).max(axis=0)


def start_levels(wind: Any) -> tuple[list[float], list[str]]:
    """Return heights [m] and names of a wind profile's levels at its first time, sorted by height."""
    names = wind.levels or [f"{height:g} m" for height in wind.heights]
    first = min(wind.times, default=0.0)
    times = wind.times or [0.0] * len(wind.heights)
    rows = sorted((h, name) for h, name, time in zip(wind.heights, names, times, strict=True) if time == first)
    return [height for height, _ in rows], [name for _, name in rows]
