"""Wind over height above a place at some times, from a weather model's values or a table."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from qrsim import extras
from qrsim.errors import UsageError, readable
from qrsim.files.in_child import ChildError, in_child
from qrsim.files.user_files import LARGEST_DATA, open_file
from qrsim.models.atmosphere.weather.grib import grib_values
from qrsim.models.atmosphere.weather.netcdf import netcdf_values
from qrsim.models.atmosphere.weather.values import FASTEST, Key, Request, Values, span

# Of a standard atmosphere, and of dry air [m/s², J/kg/K].
GRAVITY, DRY_AIR = 9.80665, 287.05287
SEA_PA, SEA_K, LAPSE = 101_325.0, 288.15, 0.0065
# Difference [m] of a model's ground and the site that is told.
MOST_ABOVE = 50.0
# Of all hours of a day of a global model, joined [bytes].
LARGEST_FILE = 8 * LARGEST_DATA
# Levels above this one [m] are left out.
HIGHEST = 30_000.0
# Levels closer than this [m] are one.
CLOSEST = 1.0


class Level(NamedTuple):
    """The air at a height.

    Attributes:
        height: above the ground [m].
        north, east: of the air's velocity [m/s].
        name: of the level in its source.
    """

    height: float
    north: float
    east: float
    name: str


@dataclass(frozen=True)
class Soundings:
    """Wind over height.

    Attributes:
        times: seconds since 1970 UTC of each row of levels; empty where one holds for all times.
        levels: by height, for each time.
        source: what it was read from, in words.
        gust: largest gust of the model in these times [m/s]; None: it states none.
        notes: what a user should know, a sentence each.
        cell: shorter side of a cell of the model's grid [m]; infinite: there is no grid.
    """

    times: tuple[float, ...]
    levels: tuple[tuple[Level, ...], ...]
    source: str
    gust: float | None = None
    notes: tuple[str, ...] = ()
    cell: float = math.inf


class Site(NamedTuple):
    """How heights of a model become heights above the ground.

    Attributes:
        height_amsl: of the site, above mean sea level [m].
        above: "sea": heights above the sea less that of the site; "model": above the model's own ground.
        roughness: of the ground [m].
    """

    height_amsl: float
    above: str
    roughness: float


def kind_of(file: str) -> str:
    """Return a weather file's format by its first bytes: "NetCDF", "GRIB" or ""; raise UsageError if unreadable."""
    with readable(file), open_file(file, LARGEST_FILE) as opened:
        head = opened.read(1024)
    return "NetCDF" if head.startswith((b"CDF", b"\x89HDF")) else "GRIB" if b"GRIB" in head else ""


def read_weather(file: str, request: Request, site: Site) -> Soundings:
    """Return the wind over height and time above a site from a GRIB or NetCDF file, read in a child process.

    Raises:
        UsageError: no such file, or it does not hold the place, the run, or the wind.
    """
    kind = kind_of(file)
    if not kind:
        raise UsageError(f"{file}: is neither NetCDF nor GRIB; a table of heights and speeds is of type profile")
    reader, package = (netcdf_values, "netCDF4") if kind == "NetCDF" else (grib_values, "eccodes")
    extras.require("weather", f"{file}: a wind of a weather model", package)
    try:
        values = in_child(reader, file, os.path.abspath(os.path.expanduser(file)), request)
    except ChildError as error:
        raise UsageError(f"{file}: cannot be read: {error}") from None
    return soundings_of(file, values, request, site)


def soundings_of(file: str, values: Values, request: Request, site: Site) -> Soundings:
    """Return the wind over height and time above a site, from a weather model's values there.

    Raises:
        UsageError: no level lies above the ground, or the heights of levels of pressure cannot be known.
    """
    notes: dict[str, None] = {}
    times = sorted({key.time for key in values.found if key.name == "u"})
    levels = []
    for time in times:
        own = tuple(_levels(file, values, time, site, notes))
        if not own:
            raise UsageError(
                f"{file}: has no level above the ground at the site, {site.height_amsl:.0f} m above the sea"
            )
        levels.append(own)
    if not times:
        raise UsageError(f"{file}: has no level with both u and v at the site")
    gusts = [value for key, value in values.found.items() if key.name == "gust" and request.start <= key.time]
    source = f"{file}, {span(values.times[0], values.times[-1])}"
    return Soundings(tuple(times), tuple(levels), source, max(gusts, default=None), tuple(notes), values.cell)


def _levels(file: str, values: Values, time: float, site: Site, notes: dict[str, None]) -> Iterator[Level]:
    """Yield the wind at each level above ground at a time, lowest first; messages to the user go into ``notes``."""
    found = {key._replace(time=0.0): value for key, value in values.found.items() if key.time == time}
    pairs = [
        (key.kind, key.level, found[key], found[other])
        for key in found
        if key.name == "u" and (other := key._replace(name="v")) in found
    ]
    least = max(0.5, 2.0 * site.roughness)
    known = [Level(level, v, u, f"{level:g} m") for kind, level, u, v in pairs if kind == "m" and level >= least]
    lowest = min((level.height for level in known), default=least)
    pressures = sorted((level for kind, level, *_ in pairs if kind == "hPa"), reverse=True)
    heights = _heights(file, found, pressures, site, notes) if pressures else {}
    for kind, level, u, v in pairs:
        height = heights.get(level, -math.inf) if kind == "hPa" else -math.inf
        if lowest <= height <= HIGHEST and all(abs(height - other.height) >= CLOSEST for other in known):
            known.append(Level(height, v, u, f"{level:g} hPa"))
    for own in sorted(known):
        speed = math.hypot(own.north, own.east)
        if speed > FASTEST:
            raise UsageError(f"{file}: {speed:.4g} m/s at the level {own.name}; allowed: {FASTEST:g}")
        yield own


def _heights(
    file: str, found: dict[Key, float], pressures: Sequence[float], site: Site, notes: dict[str, None]
) -> dict[float, float]:
    """Return {pressure [hPa]: height above ground [m]} of the levels; messages to the user go into ``notes``."""
    own = {level: found.get(Key("height", 0.0, "hPa", level)) for level in pressures}
    heights = {level: height for level, height in own.items() if height is not None}
    if len(heights) < len(own):
        heights = _by_hypsometry(file, found, pressures, notes)
    ground = _ground(found, heights)
    if site.above == "model":
        if ground is None:
            raise UsageError(
                f"{file}: has neither the height of the model's ground (z of the surface) nor the pressure there (sp); "
                "above: model needs one, above: sea does not"
            )
        return {level: height - ground for level, height in heights.items()}
    if ground is not None and abs(ground - site.height_amsl) > MOST_ABOVE:
        notes[
            f"{file}: the model's ground is {ground:.0f} m above the sea at the site, the site {site.height_amsl:.0f} "
            "m; above: model takes heights above the model's ground"
        ] = None
    return {level: height - site.height_amsl for level, height in heights.items()}


def _ground(found: dict[Key, float], heights: dict[float, float]) -> float | None:
    """Return the height [m] of the weather model's ground above the sea, as given or by its pressure, or None."""
    ground = found.get(Key("height", 0.0, "ground", 0.0))
    pressure = found.get(Key("pressure", 0.0, "ground", 0.0))
    if ground is not None or pressure is None or len(heights) < 2 or not pressure > 0.0:
        return ground
    # Heights are close to linear in the logarithm of pressure; below the lowest level its slope goes on.
    levels = sorted(heights, reverse=True)
    above = [level for level in levels if level * 100.0 <= pressure]
    top = levels.index(above[0]) if above else len(levels) - 1
    low, high = (levels[max(top - 1, 0)], levels[max(top, 1)])
    share = math.log(low * 100.0 / pressure) / math.log(low / high)
    return heights[low] + share * (heights[high] - heights[low])


def _by_hypsometry(
    file: str, found: dict[Key, float], pressures: Sequence[float], notes: dict[str, None]
) -> dict[float, float]:
    """Return {pressure [hPa]: height above the sea [m]} from temperatures, or else from the standard atmosphere.

    The thickness of a layer is R T/g ln(p1/p2), T the mean of both ends.
    """
    sea = found.get(Key("pressure", 0.0, "sea", 0.0), math.nan)
    sea = sea if 80_000.0 < sea < 110_000.0 else SEA_PA
    own = [found.get(Key("t", 0.0, "hPa", level)) for level in pressures]
    if any(each is None or not 150.0 < each < 350.0 for each in own):
        notes[
            f"{file}: has neither heights (z, gh) nor temperatures of its levels of pressure; their heights are those "
            "of the standard atmosphere, to about 30 m"
        ] = None
        power = DRY_AIR * LAPSE / GRAVITY
        return {level: SEA_K / LAPSE * (1.0 - (level * 100.0 / sea) ** power) for level in pressures}
    temperatures = [each for each in own if each is not None]
    heights, height, below, warm = {}, 0.0, sea / 100.0, temperatures[0]
    for level, temperature in zip(pressures, temperatures, strict=True):
        height += DRY_AIR / GRAVITY * 0.5 * (warm + temperature) * math.log(below / level)
        heights[level], below, warm = height, level, temperature
    return heights
