"""Values above a place from NetCDF files of ERA5: pressure levels, old and new layout, and single levels."""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Any

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.errors import UsageError
from qrsim.models.atmosphere.weather.values import (
    LOWEST_HPA,
    Corners,
    Key,
    Request,
    Values,
    checked_speed,
    corners_of,
    needed_times,
    plausible_time,
)
from qrsim.models.atmosphere.wind_grid_file import LONGEST_AXIS, SPEED_UNITS, TIME_UNITS

GRAVITY = 9.80665
AXES = {
    "time": ("valid_time", "time"),
    "level": ("pressure_level", "level", "isobaricInhPa", "plev"),
    "latitude": ("latitude", "lat"),
    "longitude": ("longitude", "lon"),
    "member": ("number",),
    "version": ("expver",),
}
PRESSURE_UNITS = {"hpa": 1.0, "millibars": 1.0, "millibar": 1.0, "mbar": 1.0, "mb": 1.0, "pa": 0.01}
# Variable -> quantity, kind of level, level, and the factor to its unit; on levels of pressure, and without levels.
ON_LEVELS = {
    "u": ("u", 1.0),
    "v": ("v", 1.0),
    "z": ("height", 1.0 / GRAVITY),
    "gh": ("height", 1.0),
    "t": ("t", 1.0),
}
ALONE = {
    "u10": ("u", "m", 10.0, 1.0),
    "v10": ("v", "m", 10.0, 1.0),
    "u100": ("u", "m", 100.0, 1.0),
    "v100": ("v", "m", 100.0, 1.0),
    "z": ("height", "ground", 0.0, 1.0 / GRAVITY),
    "sp": ("pressure", "ground", 0.0, 1.0),
    "msl": ("pressure", "sea", 0.0, 1.0),
    "fg10": ("gust", "m", 10.0, 1.0),
    "i10fg": ("gust", "m", 10.0, 1.0),
}
UNITS = {
    "u": SPEED_UNITS,
    "v": SPEED_UNITS,
    "gust": SPEED_UNITS,
    "t": ("K", "kelvin"),
    "pressure": ("Pa", "pascal"),
}
_SINCE = re.compile(
    r"(\w+)\s+since\s+(\d{4})-(\d{1,2})-(\d{1,2})(?:[T ]+(\d{1,2}):(\d{2})(?::(\d{2}))?)?[.0Z]*\s*(?:UTC)?"
)


def netcdf_values(file: str, path: str, request: Request) -> Values:
    """Return the weather above a place from a NetCDF file; geopotentials become heights by 9.80665 m/s².

    Args:
        file: its name, for messages.
        path: of the file.
        request: place, run and member.

    Raises:
        UsageError: it is no such file, lacks the place or the run, or has other units; names the variable.
    """
    # Imported here, and without xarray, because a child process pays for it each time.
    import netCDF4

    try:
        content = netCDF4.Dataset(path)
    except OSError:
        raise UsageError(f"{file}: is neither NetCDF nor GRIB") from None
    with content:
        return _values(file, content, request)


def _values(file: str, content: Any, request: Request) -> Values:
    """Return the weather above a place from an opened NetCDF file; raise UsageError for missing coordinates."""
    names = {axis: next((name for name in known if name in content.variables), None) for axis, known in AXES.items()}
    for axis in ("time", "latitude", "longitude"):
        if names[axis] is None:
            raise UsageError(
                f"{file}: has no coordinate {' or '.join(AXES[axis])}; expected pressure or single levels of ERA5"
            )
    for name in filter(None, names.values()):
        if content.variables[name].size > LONGEST_AXIS:
            raise UsageError(f"{file}: '{name}' has {content.variables[name].size} values; allowed: {LONGEST_AXIS}")
    times = _times(file, content.variables[names["time"]])
    latitudes, longitudes = (_numbers(file, content, names[axis]) for axis in ("latitude", "longitude"))
    corners = corners_of(file, latitudes, longitudes, request.latitude_deg, request.longitude_deg)
    present = list(_present(content, names))
    _check_winds(file, content, [key[:3] for _, key, _ in present])
    needed = needed_times(file, sorted(set(times)), request)
    found = Values(sorted(set(times)), cell=corners.cell)
    reader = _Reader(file, content, names, corners, request.member, times, needed)
    for variable, (name, kind, level), factor in present:
        reader.read(variable, name, kind, level, factor, found)
    return found


def _present(content: Any, names: dict[str, str | None]) -> Iterator[tuple[str, tuple[str, str, float], float]]:
    """Yield (variable, (quantity, kind of level, level), unit factor) for each variable in the file that is used."""
    for variable in content.variables:
        dimensions = content.variables[variable].dimensions
        if names["latitude"] not in dimensions:
            continue
        if names["level"] in dimensions:
            if variable in ON_LEVELS:
                name, factor = ON_LEVELS[variable]
                yield variable, (name, "hPa", 0.0), factor
        elif variable in ALONE:
            name, kind, level, factor = ALONE[variable]
            yield variable, (name, kind, level), factor


def _check_winds(file: str, content: Any, found: list[tuple[str, str, float]]) -> None:
    """Raise UsageError for a file without wind, or with only one of the components u and v."""
    known = sorted(content.variables)
    pairs = (("u", "v", ("hPa", 0.0)), ("u10", "v10", ("m", 10.0)), ("u100", "v100", ("m", 100.0)))
    there = False
    for east, north, where in pairs:
        has = [(name, *where) in found for name in "uv"]
        if has[0] != has[1]:
            own, other = (east, north) if has[0] else (north, east)
            raise UsageError(f"{file}: has {own}, but no {other}")
        there = there or has[0]
    if not there:
        raise UsageError(
            f"{file}: has no wind: u and v over levels of pressure, u10 and v10, or u100 and v100; found "
            f"{', '.join(known)[:200]}"
        )


def _attribute(variable: Any, name: str) -> str:
    """Return a NetCDF variable's attribute as text, "" if it is missing."""
    return " ".join(str(variable.getncattr(name)).split()) if name in variable.ncattrs() else ""


def _numbers(file: str, content: Any, name: str | None) -> Floats:
    """Return a coordinate variable (k,) as float64; raise UsageError unless one-dimensional, numeric and finite."""
    values = np.ma.filled(np.ma.asarray(content.variables[name][...], np.float64), np.nan)
    if values.ndim > 1 or not np.isfinite(values).all():
        raise UsageError(f"{file}: '{name}' is no row of finite numbers")
    return np.atleast_1d(values)


def _times(file: str, variable: Any) -> list[float]:
    """Return a time variable as seconds since 1970; raise UsageError for unknown units or calendars."""
    units = _attribute(variable, "units")
    match = _SINCE.fullmatch(units)
    second = TIME_UNITS.get(match[1].lower()) if match else None
    if match is None or second is None:
        raise UsageError(f"{file}: '{variable.name}' has the units '{units:.60}'; expected 'hours since 1900-01-01'")
    calendar = _attribute(variable, "calendar") or "standard"
    if calendar not in ("standard", "gregorian", "proleptic_gregorian"):
        raise UsageError(f"{file}: '{variable.name}' has the calendar '{calendar:.40}'; expected 'standard'")
    try:
        year, month, day, hour, minute, second_ = (int(part or 0) for part in match.groups()[1:7])
        begin = datetime(year, month, day, hour, minute, second_, tzinfo=UTC).timestamp()
    except ValueError:
        raise UsageError(f"{file}: '{variable.name}' has the units '{units:.60}', which is no date") from None
    values = np.atleast_1d(np.ma.filled(np.ma.asarray(variable[...], np.float64), np.nan))
    return [plausible_time(file, round(begin + float(value) * second, 3)) for value in values]


class _Reader:
    """Reads variables at the corners around a place, at the times and levels that are needed."""

    def __init__(
        self,
        file: str,
        content: Any,
        names: dict[str, str | None],
        corners: Corners,
        member: int | None,
        times: list[float],
        needed: list[float],
    ):
        self.file, self.content, self.corners, self.times = file, content, corners, times
        self.axis_of = {name: axis for axis, name in names.items() if name is not None}
        rows = [i for i, time in enumerate(times) if time in needed]
        self.picked: dict[str, Any] = {
            "time": slice(min(rows), max(rows) + 1),
            "latitude": list(corners.rows),
            "longitude": list(corners.columns),
        }
        self.levels = self._levels(names["level"])
        self.picked["member"] = self._member(names["member"], member)

    def _levels(self, name: str | None) -> list[tuple[int, float]]:
        """Return (index, pressure [hPa]) of each pressure level that is read, [] for ``name`` None."""
        if name is None:
            return []
        units = _attribute(self.content.variables[name], "units")
        if units.lower() not in PRESSURE_UNITS:
            raise UsageError(f"{self.file}: '{name}' has the units '{units:.40}'; expected 'hPa'")
        pressures = _numbers(self.file, self.content, name) * PRESSURE_UNITS[units.lower()]
        return [(i, float(each)) for i, each in enumerate(pressures) if each >= LOWEST_HPA]

    def _member(self, name: str | None, member: int | None) -> int:
        """Return the index of ensemble member ``member``; raise UsageError if it is missing, or must be given."""
        if name is None or self.content.variables[name].ndim == 0:
            if member is not None:
                raise UsageError(f"{self.file}: has no ensemble, and member is {member}")
            return 0
        numbers = [int(each) for each in _numbers(self.file, self.content, name)]
        if member is None and len(numbers) > 1:
            raise UsageError(f"{self.file}: is an ensemble of {len(numbers)}; give member: {numbers[0]}")
        if member is not None and member not in numbers:
            raise UsageError(f"{self.file}: has no member {member}; it has {', '.join(map(str, numbers))[:100]}")
        return numbers.index(member) if member is not None else 0

    def read(self, variable: str, name: str, kind: str, level: float, factor: float, found: Values) -> None:
        """Add a variable's values at the place to ``found``; raise UsageError for wrong units or impossible speeds."""
        source = self.content.variables[variable]
        if source.dtype.kind not in "fiu":
            raise UsageError(f"{self.file}: '{variable}' is of type {source.dtype}; expected numbers")
        if name in UNITS:
            units = _attribute(source, "units")
            if units not in UNITS[name]:
                words = f"has the units '{units:.40}'" if units else "has no units"
                best = "m s-1" if UNITS[name] is SPEED_UNITS else UNITS[name][0]
                raise UsageError(f"{self.file}: '{variable}' {words}; expected '{best}'")
        if kind == "hPa" and not self.levels:
            raise UsageError(f"{self.file}: has no level of pressure of {LOWEST_HPA:g} hPa or more")
        values = self._at_place(variable, source, factor)
        levels = self.levels if kind == "hPa" else [(0, level)]
        # Levels are read from the first to the last that is needed.
        lowest = min(number for number, _ in levels)
        for i, time in enumerate(self.times[self.picked["time"]]):
            for number, own in levels:
                value = float(values[i, number - lowest])
                if name in ("u", "v"):
                    checked_speed(self.file, variable, value)
                if np.isfinite(value):
                    found.found[Key(name, time, kind, own)] = value

    def _at_place(self, variable: str, source: Any, factor: float) -> Floats:
        """Return a variable's values (times, levels) at the place; one level for a variable without levels."""
        axes: list[str] = []
        parts: list[object] = []
        for dimension in source.dimensions:
            axis = self.axis_of.get(dimension)
            if axis is None and source.shape[source.dimensions.index(dimension)] > 1:
                known = ", ".join(self.axis_of)
                raise UsageError(f"{self.file}: '{variable}' has the dimension '{dimension}'; expected {known}")
            if axis is None:
                parts.append(0)
                continue
            if axis == "level":
                numbers = [number for number, _ in self.levels]
                parts.append(slice(min(numbers), max(numbers) + 1))
            else:
                parts.append(self.picked.get(axis, slice(None)))
            if axis != "member":
                axes.append(axis)
        if axes.count("latitude") + axes.count("longitude") < 2 or "time" not in axes:
            raise UsageError(f"{self.file}: '{variable}' is over {', '.join(source.dimensions)}; it lacks an axis")
        values = _taken(source, parts)
        if "version" in axes:
            # Preliminary values follow the final ones, each missing where the other is.
            versions = np.moveaxis(values, axes.index("version"), 0)
            values = versions[0]
            for each in versions[1:]:
                values = np.where(np.isfinite(values), values, each)
            axes.remove("version")
        order = [axes.index(axis) for axis in ("time", "level", "latitude", "longitude") if axis in axes]
        values = self.corners.weighted(np.transpose(values, order)) * factor
        return values if "level" in axes else values[:, None]


def _taken(source: Any, parts: list[Any]) -> Floats:
    """Return ``source`` indexed by ``parts``, NaN for missing values; a pair of indices may be in any order."""
    lists = [(i, part) for i, part in enumerate(parts) if isinstance(part, list)]
    if not lists:
        return np.ma.filled(np.ma.asarray(source[tuple(parts)], np.float64), np.nan)
    place, pair = lists[0]
    singles = sum(isinstance(part, int) for part in parts[:place])
    slices = [_taken(source, [*parts[:place], slice(each, each + 1), *parts[place + 1 :]]) for each in pair]
    return np.concatenate(slices, axis=place - singles)
