"""Velocities of the air on a grid, read from a NetCDF file after checks of units and frame."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from qrsim import extras
from qrsim.core.arrays import Floats
from qrsim.errors import UsageError, did_you_mean, readable
from qrsim.files.user_files import LARGEST_DATA, open_file

if TYPE_CHECKING:
    import xarray

SPEED_UNITS = ("m s-1", "m/s", "m s^-1", "m s**-1", "m.s-1", "meter second-1", "metre second-1", "meters/second")
LENGTH_UNITS = ("m", "meter", "meters", "metre", "metres")
# Seconds of each unit of time that UDUNITS knows and whose length is always the same.
TIME_UNITS = {
    name: seconds
    for seconds, names in (
        (1e-3, ("ms", "msec", "millisecond", "milliseconds")),
        (1.0, ("s", "sec", "secs", "second", "seconds")),
        (60.0, ("min", "mins", "minute", "minutes")),
        (3600.0, ("h", "hr", "hrs", "hour", "hours")),
        (86_400.0, ("d", "day", "days")),
    )
    for name in names
}
# What the CF conventions call each of them; x and y of a grid that is not turned are east and north.
STANDARD_NAMES = (
    ("eastward_wind", "x_wind", "grid_eastward_wind"),
    ("northward_wind", "y_wind", "grid_northward_wind"),
    ("upward_air_velocity",),
)
DIRECTIONS = ("east", "north", "up")
AXES = {
    "x": ("x", "east", "easting", "projection_x_coordinate"),
    "y": ("y", "north", "northing", "projection_y_coordinate"),
    "z": ("z", "height", "altitude", "level", "up"),
    "t": ("t", "time"),
}
# What is read before it is cut: 720 MB in double precision.
MOST_READ = 30_000_000
LONGEST_AXIS = 100_000
# No wind that is none of a tornado; fill values that are not declared are far beyond it.
FASTEST = 150.0


class Layout(NamedTuple):
    """Layout of a file.

    Attributes:
        names: of the velocities to the east, to the north and upwards.
        calm: whether missing values are calm air.
    """

    names: tuple[str, str, str]
    calm: bool


@dataclass(frozen=True)
class GridFile:
    """A file's grid.

    Attributes:
        x, y, z: increasing coordinates to the east, to the north and upwards [m].
        times: (T,) [s] since the first.
        air: (T, Z, Y, X) velocities to the east, to the north and upwards [m/s].
    """

    x: Floats
    y: Floats
    z: Floats
    times: Floats
    air: tuple[Floats, Floats, Floats]


def read_grid(file: str, layout: Layout) -> GridFile:
    """Return the wind grid in a NetCDF file, from a cache if the file has not changed.

    Raises:
        UsageError: no such file, or no such grid: it names the variable, what it has and what it should have.
    """
    with readable(file), open_file(file, LARGEST_DATA):
        status = os.stat(os.path.expanduser(file))
    return _read(file, layout, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=2)
def _read(file: str, layout: Layout, changed: int, size: int) -> GridFile:
    """Return the wind grid in a NetCDF file; ``changed`` and ``size`` identify its version for the cache."""
    xarray = extras.load("wind", "a wind from a NetCDF file", "xarray")
    path = os.path.expanduser(file)
    try:
        _check_axes(file, path)
        content = xarray.open_dataset(path, engine="netcdf4", decode_times=False)
    except UsageError:
        raise
    except (OSError, ValueError, RuntimeError):
        raise UsageError(f"{file}: is no NetCDF file; xarray's Dataset.to_netcdf writes one") from None
    with content:
        variables = [_variable(file, content, name, i) for i, name in enumerate(layout.names)]
        shapes = {str(each.dims): each.name for each in variables}
        if len(shapes) > 1:
            raise UsageError(
                f"{file}: its velocities are on different grids: "
                + "; ".join(f"'{each.name}' over {', '.join(map(str, each.dims)) or 'nothing'}" for each in variables)
            )
        axes = _axes(file, variables[0], content)
        points = {name: _coordinate(file, content, axes[name], name) for name in "xyz"}
        times = _times(file, content, axes["t"]) if "t" in axes else np.zeros(1)
        if variables[0].size > MOST_READ:
            raise UsageError(f"{file}: {variables[0].size} points; allowed: {MOST_READ}, so cut it to the area")
        order = [axes[name] for name in "tzyx" if name in axes]
        try:
            arrays = [np.asarray(each.transpose(*order).values, np.float64) for each in variables]
        except (OSError, ValueError, RuntimeError) as error:
            raise UsageError(f"{file}: cannot be read: {str(error).splitlines()[0]:.200}") from None
    arrays = [each if "t" in axes else each[None] for each in arrays]
    for number, name in enumerate("zyx", 1):
        if points[name][0] > points[name][-1]:
            points[name] = points[name][::-1]
            arrays = [np.flip(each, number) for each in arrays]
        _check_increasing(file, axes[name], points[name], even=name != "z")
    found = _filled(file, layout, arrays)
    return GridFile(points["x"], points["y"], points["z"], times, (found[0], found[1], found[2]))


def _check_axes(file: str, path: str) -> None:
    """Raise UsageError for a file with too many points on an axis, before xarray loads them."""
    with extras.load("wind", "a wind from a NetCDF file", "netCDF4").Dataset(path) as opened:
        for name, dimension in opened.dimensions.items():
            if name in opened.variables and len(dimension) > LONGEST_AXIS:
                raise UsageError(f"{file}: '{name}' has {len(dimension)} values; allowed: {LONGEST_AXIS}")


def _variable(file: str, content: xarray.Dataset, name: str, which: int) -> xarray.DataArray:
    """Return a velocity variable of the file; raise UsageError if it is missing or has wrong units or direction."""
    variables = [str(each) for each in content.data_vars]
    if name not in content.data_vars:
        raise UsageError(
            f"{file}: has no '{name}', the velocity {_towards(which)}{did_you_mean(name, variables)}; "
            f"say which it is by world.wind.{'uvw'[which]}"
        )
    variable = content[name]
    if variable.dtype.kind not in "fiu":
        raise UsageError(f"{file}: '{name}' is of type {variable.dtype}; expected numbers")
    _check_units(file, name, variable.attrs, SPEED_UNITS, "m s-1")
    standard = str(variable.attrs.get("standard_name", "")).strip()
    if standard and standard not in STANDARD_NAMES[which]:
        raise UsageError(
            f"{file}: '{name}' has the standard name '{standard}', but is read as the velocity {_towards(which)}; "
            f"expected {' or '.join(STANDARD_NAMES[which])}"
        )
    return variable


def _towards(which: int) -> str:
    """Return the direction of wind component 0, 1 or 2 in words, such as "upwards" for 2."""
    return "upwards" if which == 2 else f"to the {DIRECTIONS[which]}"


def _check_units(file: str, name: str, attributes: Mapping[str, object], allowed: tuple[str, ...], best: str) -> None:
    """Raise UsageError unless the attribute ``units`` is one of ``allowed``; ``best`` is the unit to suggest."""
    units = attributes.get("units")
    if units is None:
        raise UsageError(f"{file}: '{name}' has no units; expected the attribute units: '{best}'")
    if " ".join(str(units).split()) not in allowed:
        raise UsageError(f"{file}: '{name}' has the units '{units!s:.40}'; expected '{best}'")


def _axes(file: str, variable: xarray.DataArray, content: xarray.Dataset) -> dict[str, str]:
    """Return the variable's dimension by axis, "x", "y", "z", perhaps "t"; raise UsageError for others or too few."""
    found: dict[str, str] = {}
    for dimension in map(str, variable.dims):
        attributes = content[dimension].attrs if dimension in content.coords else {}
        said = str(attributes.get("axis", "")).lower()
        known = (dimension.lower(), str(attributes.get("standard_name", "")))
        axis = said if said in AXES else next((a for a, names in AXES.items() if set(known) & set(names)), None)
        if axis is None or axis in found:
            names = "; ".join(f"{a}: {', '.join(names)}" for a, names in AXES.items())
            raise UsageError(
                f"{file}: '{variable.name}' has the dimension '{dimension}', which is "
                + (f"another {axis}" if axis else f"not known; expected names of {names}, or an attribute axis")
            )
        found[axis] = dimension
    missing = [axis for axis in "xyz" if axis not in found]
    if missing:
        dims = ", ".join(map(str, variable.dims)) or "nothing"
        raise UsageError(f"{file}: '{variable.name}' is over {dims}; it lacks {', '.join(missing)}")
    return found


def _coordinate(file: str, content: xarray.Dataset, name: str, axis: str) -> Floats:
    """Return an axis' coordinates [m], z positive upwards; raise UsageError for other units."""
    values = _numbers(file, content, name)
    attributes = content[name].attrs
    units = str(attributes.get("units", ""))
    if units.lower().startswith("degree"):
        raise UsageError(f"{file}: '{name}' is in {units}; expected metres: project the grid onto a plane")
    _check_units(file, name, attributes, LENGTH_UNITS, "m")
    return -values if axis == "z" and str(attributes.get("positive", "up")).lower() == "down" else values


def _times(file: str, content: xarray.Dataset, name: str) -> Floats:
    """Return the file's times [s] since the first; raise UsageError for unknown units or times that do not increase."""
    values = _numbers(file, content, name, least=1)
    units = content[name].attrs.get("units")
    expected = "'s' or 'seconds since ...', or the same with minutes, hours or days"
    if units is None:
        raise UsageError(f"{file}: '{name}' has no units; expected the attribute units: {expected}")
    second = TIME_UNITS.get(str(units).lower().partition(" since ")[0].strip())
    if second is None:
        raise UsageError(f"{file}: '{name}' has the units '{units!s:.40}'; expected {expected}")
    if not (np.diff(values) > 0.0).all():
        raise UsageError(f"{file}: '{name}' does not increase")
    # To the millisecond, so that a third of an hour is 1200 s and covers a run as long.
    return np.round((values - values[0]) * second, 3) if second > 1.0 else (values - values[0]) * second


def _numbers(file: str, content: xarray.Dataset, name: str, least: int = 2) -> Floats:
    """Return a coordinate variable (k,) as float64; raise UsageError for fewer than ``least`` finite numbers."""
    if name not in content.coords:
        raise UsageError(f"{file}: '{name}' is a dimension without coordinates; expected a variable '{name}'({name})")
    variable = content[name]
    if variable.dtype.kind not in "fiu" or len(variable) < least or not np.isfinite(variable.values).all():
        raise UsageError(f"{file}: '{name}' has {len(variable)} values; expected {least} or more finite numbers")
    return np.asarray(variable.values, np.float64)


def _check_increasing(file: str, name: str, values: Floats, even: bool) -> None:
    """Raise UsageError unless coordinates increase, and in equal steps if ``even``."""
    steps = np.diff(values)
    if not (steps > 0.0).all():
        raise UsageError(f"{file}: '{name}' is no row of numbers in order")
    if even and np.ptp(steps) > 1e-3 * steps.mean():
        raise UsageError(
            f"{file}: '{name}' is not evenly spaced: from {steps.min():.6g} to {steps.max():.6g} m; resample it"
        )


def _filled(file: str, layout: Layout, arrays: list[Floats]) -> list[Floats]:
    """Return the velocities with missing points set to 0 if the layout allows it; else raise UsageError."""
    missing = ~np.isfinite(arrays[0]) | ~np.isfinite(arrays[1]) | ~np.isfinite(arrays[2])
    count = int(missing.sum())
    if count and not layout.calm:
        raise UsageError(
            f"{file}: {count} of {missing.size} points have no velocity; missing: calm takes the air there for still, "
            "as inside of buildings"
        )
    found = [np.where(missing, 0.0, each) for each in arrays]
    for name, values in zip(layout.names, found, strict=True):
        largest = float(np.abs(values).max())
        if largest > FASTEST:
            raise UsageError(
                f"{file}: '{name}' reaches {largest:.4g} m/s; allowed: {FASTEST:g}; is it a fill value without the "
                "attribute _FillValue?"
            )
    return found
