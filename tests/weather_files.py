"""Files of weather models, written by xarray, netCDF4 and ecCodes: a wind linear in place, height and time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

LATITUDES = np.linspace(52.5, 51.5, 5)
LONGITUDES = np.linspace(-1.0, 0.75, 8)
PRESSURES = np.array([1000.0, 975.0, 950.0, 900.0, 850.0, 800.0])
# Above the sea [m], the same everywhere.
HEIGHTS = np.array([110.0, 330.0, 550.0, 990.0, 1460.0, 1950.0])
BEGIN = datetime(2026, 5, 1, 9, tzinfo=UTC)
HOURS = (0, 1, 2)
GRAVITY = 9.80665


def u_of(hour: Any, level: Any, latitude: Any, longitude: Any) -> Any:
    """Return the velocity to the east [m/s] at an hour, a number of level, and a place [deg]."""
    return 3.0 + 0.5 * hour + 1.25 * level + 2.0 * (latitude - 52.0) - 1.5 * longitude


def v_of(hour: Any, level: Any, latitude: Any, longitude: Any) -> Any:
    """Return the velocity to the north [m/s]."""
    return -2.0 + 0.25 * hour - 0.5 * level - 1.0 * (latitude - 52.0) + 3.0 * longitude


def _cube(levels: Any, field: Any) -> Any:
    hours, numbers, latitudes, longitudes = np.meshgrid(HOURS, levels, LATITUDES, LONGITUDES, indexing="ij")
    return field(hours, numbers, latitudes, longitudes)


def era5(path: Path, layout: str = "new", drop: Iterable[str] = (), units: Mapping[str, str] | None = None) -> Path:
    """Write a file of pressure levels as the Climate Data Store does (new) or did (old: packed, top first)."""
    import xarray

    numbers = np.arange(len(PRESSURES))
    heights = np.broadcast_to(HEIGHTS[None, :, None, None] * GRAVITY, _cube(numbers, u_of).shape)
    winds = {name: (_cube(numbers, field), "m s**-1") for name, field in (("u", u_of), ("v", v_of))}
    cubes = {**winds, "z": (heights, "m**2 s**-2")}
    seconds = [int((BEGIN + timedelta(hours=hour)).timestamp()) for hour in HOURS]
    new = layout == "new"
    time, level = ("valid_time", "pressure_level") if new else ("time", "level")
    dimensions = (time, level, "latitude", "longitude")
    variables = {}
    for name, (values, unit) in cubes.items():
        if name not in drop:
            own = values if new else values[:, ::-1]
            variables[name] = (dimensions, own.astype(np.float32), {"units": (units or {}).get(name, unit)})
    since = 25_567 * 24  # hours from 1900 to 1970
    times = np.array(seconds) if new else np.array(seconds) // 3600 + since
    unit = "seconds since 1970-01-01" if new else "hours since 1900-01-01 00:00:00.0"
    coordinates = {
        time: (time, times.astype(np.int64 if new else np.int32), {"units": unit, "calendar": "proleptic_gregorian"}),
        level: (level, PRESSURES, {"units": "hPa"}),
        "latitude": ("latitude", LATITUDES, {"units": "degrees_north"}),
        "longitude": ("longitude", LONGITUDES, {"units": "degrees_east"}),
    }
    if not new:
        coordinates[level] = (level, PRESSURES[::-1].astype(np.int32), {"units": "millibars"})
    else:
        coordinates["number"] = ((), 0)
        coordinates["expver"] = (time, np.array(["0001"] * len(HOURS)))
    dataset = xarray.Dataset(variables, coordinates)
    encoding = {name: {"zlib": True, "complevel": 1} for name in variables}
    if not new:
        for name in variables:
            low, high = float(variables[name][1].min()), float(variables[name][1].max())
            scale = (high - low) / 65_000.0
            encoding[name] |= {"dtype": "int16", "scale_factor": scale, "add_offset": 0.5 * (low + high)}
            encoding[name]["_FillValue"] = -32_767
    dataset.to_netcdf(path, encoding=encoding, format="NETCDF4" if new else "NETCDF3_64BIT")
    return path


def single_levels(path: Path) -> Path:
    """Write winds 10 and 100 m above the ground, and gusts: level 0 and 1 of the field."""
    import xarray

    dimensions = ("valid_time", "latitude", "longitude")
    speed = {"units": "m s**-1"}
    variables = {
        f"{name}{height}": (dimensions, _cube([number], field)[:, 0], speed)
        for number, height in enumerate((10, 100))
        for name, field in (("u", u_of), ("v", v_of))
    }
    variables["fg10"] = (dimensions, np.full((len(HOURS), len(LATITUDES), len(LONGITUDES)), 11.5), speed)
    seconds = [int((BEGIN + timedelta(hours=hour)).timestamp()) for hour in HOURS]
    coordinates = {
        "valid_time": ("valid_time", seconds, {"units": "seconds since 1970-01-01"}),
        "latitude": ("latitude", LATITUDES),
        "longitude": ("longitude", LONGITUDES % 360.0),
    }
    xarray.Dataset(variables, coordinates).to_netcdf(path)
    return path


def grib(path: Path, hours: Iterable[int] = HOURS, **keys: Any) -> Path:
    """Write u, v and gh on levels of pressure, and u and v at 10 m, on a regular grid that begins in the south.

    Longitudes are from 0 to 360. ``keys`` of ecCodes are set last.
    """
    import eccodes

    with open(path, "wb") as file:
        for hour in hours:
            fields = [
                (name, "isobaricInhPa", int(pressure), field, float(i))
                for i, pressure in enumerate(PRESSURES)
                for name, field in (("u", u_of), ("v", v_of), ("gh", lambda h, k, a, o: HEIGHTS[int(k)] + 0.0 * a * o))
            ]
            fields += [("10u", "heightAboveGround", 10, u_of, -0.5), ("10v", "heightAboveGround", 10, v_of, -0.5)]
            for name, kind, level, field, number in fields:
                handle = eccodes.codes_grib_new_from_samples("regular_ll_pl_grib2")
                latitudes, longitudes = np.meshgrid(LATITUDES[::-1], LONGITUDES, indexing="ij")
                settings = {
                    "Ni": len(LONGITUDES),
                    "Nj": len(LATITUDES),
                    "latitudeOfFirstGridPointInDegrees": LATITUDES[-1],
                    "latitudeOfLastGridPointInDegrees": LATITUDES[0],
                    "longitudeOfFirstGridPointInDegrees": LONGITUDES[0] % 360.0,
                    "longitudeOfLastGridPointInDegrees": LONGITUDES[-1] % 360.0,
                    "iDirectionIncrementInDegrees": 0.25,
                    "jDirectionIncrementInDegrees": 0.25,
                    "jScansPositively": 1,
                    "dataDate": int(f"{BEGIN:%Y%m%d}"),
                    "dataTime": int(f"{BEGIN:%H%M}"),
                    "stepRange": hour,
                    "typeOfLevel": kind,
                    "level": level,
                    "shortName": name,
                    "bitsPerValue": 24,
                }
                for key, value in {**settings, **keys}.items():
                    eccodes.codes_set(handle, key, value)
                eccodes.codes_set_values(handle, (field(hour, number, latitudes, longitudes) + 0.0 * latitudes).ravel())
                eccodes.codes_write(handle, file)
                eccodes.codes_release(handle)
    return path
