"""Elevations of the ground from a file: ESRI ASCII grids (.asc) and NumPy archives (.npz), local or by latitude."""

from __future__ import annotations

import codecs
import math
import os
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from qrsim.errors import UsageError, did_you_mean, readable
from qrsim.files.numpy_file import read_arrays
from qrsim.files.user_files import LARGEST_TABLE, read_bytes
from qrsim.models.site import Site

Float64 = npt.NDArray[np.float64]
Frame = Literal["local", "geodetic", "cells"]
# South, north, west, east [m].
Bounds = tuple[float, float, float, float]

KEYS: dict[Frame, tuple[str, str]] = {"local": ("north", "east"), "geodetic": ("latitude_deg", "longitude_deg")}
# Files with coordinates of a map, which terrain_files/ reads; those of an .asc may be others.
SUFFIXES = (".tif", ".tiff", ".img", ".hgt", ".asc", ".vrt")
# No grid in metres has cells so small, and none in degrees so large.
LARGEST_DEGREES = 0.1
EARTH_RADIUS = 6_371_000.0
# How far from a missing height the nearest one may be, in cells.
FARTHEST_FILL = 5
# 2 800 rows of as many: finer, an area is described by an excerpt or by larger cells.
MOST_HEIGHTS = 8_000_000
LONGEST_HEADER = 4096


@dataclass(frozen=True)
class Elevations:
    """Heights at the points of a regular grid.

    Attributes:
        frame: whether rows and columns are [m] north and east, or [deg] latitude and longitude, or numbers of cells
            (``terrain_files``).
        rows: (R,) coordinate of each row, increasing.
        columns: (C,) coordinate of each column, increasing.
        height: (R, C) [m], positive up; NaN where the file has none.
    """

    frame: Frame
    rows: Float64
    columns: Float64
    height: Float64

    @property
    def spacing(self) -> tuple[float, float]:
        """Distance between rows and between columns, in the unit of the grid's frame (degrees or metres)."""
        return (
            float(self.rows[-1] - self.rows[0]) / (len(self.rows) - 1),
            float(self.columns[-1] - self.columns[0]) / (len(self.columns) - 1),
        )

    def at(self, row: Float64, column: Float64) -> Float64:
        """Return the height [m], bilinear in the grid, at coordinates of any shape; NaN outside and near gaps."""
        (dr, dc), heights = self.spacing, self.height
        r, c = (row - self.rows[0]) / dr, (column - self.columns[0]) / dc
        # A coordinate on the edge may be a rounding error beyond it.
        tolerance = 1e-6
        inside = (r >= -tolerance) & (r <= len(self.rows) - 1 + tolerance)
        inside &= (c >= -tolerance) & (c <= len(self.columns) - 1 + tolerance)
        r, c = np.where(inside, r, 0.0), np.where(inside, c, 0.0)
        i = np.clip(np.floor(r).astype(int), 0, len(self.rows) - 2)
        j = np.clip(np.floor(c).astype(int), 0, len(self.columns) - 2)
        a, b = np.clip(r - i, 0.0, 1.0), np.clip(c - j, 0.0, 1.0)
        found = np.zeros(np.broadcast(r, c).shape)
        for di, wa in ((0, 1.0 - a), (1, a)):
            for dj, wb in ((0, 1.0 - b), (1, b)):
                # A point that has no weight may have no height.
                weight = wa * wb
                found = found + np.where(weight > 0.0, weight * heights[i + di, j + dj], 0.0)
        return np.where(inside, found, np.nan)


@dataclass(frozen=True)
class Landscape:
    """Elevations in the frame of a site.

    Attributes:
        elevations: of the file.
        site: origin of the frame.
        origin: the file's coordinates north and east of the site's origin [m], for a local one.
        zero: height in the file that is z = 0 [m].
        filled: number of missing heights that are those of the nearest points.
    """

    elevations: Elevations
    site: Site
    origin: tuple[float, float]
    zero: float
    filled: int = 0

    def down(self, north: Float64, east: Float64) -> Float64:
        """Return the down coordinate [m] of the ground at places north and east [m]; NaN without data."""
        return self.zero - self.elevations.at(*_in_file(self.elevations, self.site, self.origin, north, east))


def _in_file(
    elevations: Elevations, site: Site, origin: tuple[float, float], north: Float64, east: Float64
) -> tuple[Float64, Float64]:
    """Return the file's coordinates (row, column), in its own unit, of places north and east [m]."""
    north, east = np.broadcast_arrays(np.asarray(north, np.float64), np.asarray(east, np.float64))
    if elevations.frame == "local":
        return north + origin[0], east + origin[1]
    latitude, longitude, _ = site.ned_to_geodetic(np.stack([north, east, np.zeros_like(north)], axis=-1))
    degrees = np.degrees(longitude)
    # A file may count to 360 degrees and a site to -180.
    middle = 0.5 * float(elevations.columns[0] + elevations.columns[-1])
    return np.degrees(latitude), degrees + 360.0 * np.round((middle - degrees) / 360.0)


def landscape(
    file: str,
    frame: str,
    site: Site,
    origin: tuple[float, float],
    height_of_zero: float | None,
    box: Bounds | None,
    every: int = 1,
    fill: bool = False,
) -> Landscape:
    """Return the terrain heights of a file, placed in a site's local frame.

    Args:
        file: .asc or .npz.
        frame: "auto", "local" or "geodetic".
        site: origin of the local frame.
        origin: the file's coordinates north and east of the origin [m], for a local one.
        height_of_zero: height in the file that is z = 0 [m]; None: that of the ground at the origin.
        box: south, north, west, east [m] of what it must cover, if that is known.
        every: n-th row and column that counts.
        fill: whether missing heights are those of the nearest points.

    Raises:
        UsageError: no such file, no such grid, it does not cover the box, or it has no height there.
    """
    found = read_elevations(file, frame)
    if every > 1:
        if min(found.height.shape) <= every:
            raise UsageError(
                f"{file}: has {' x '.join(map(str, found.height.shape))} heights; every: {every} leaves one"
            )
        found = Elevations(found.frame, found.rows[::every], found.columns[::every], found.height[::every, ::every])
    count = 0
    if fill:
        heights, count = filled(found.height)
        found = Elevations(found.frame, found.rows, found.columns, heights)
    if box is not None:
        _check_cover(file, found, site, origin, box)
    zero = height_of_zero
    if zero is None:
        zero = float(found.at(*_in_file(found, site, origin, np.zeros(()), np.zeros(()))))
    if not math.isfinite(zero):
        raise UsageError(
            f"{file}: has no height at the site's origin, which would be z = 0; give height_of_zero, the height in the "
            "file that is z = 0"
            if height_of_zero is None
            else f"height_of_zero: {height_of_zero} is not a finite number of metres"
        )
    return Landscape(found, site, origin, zero, count)


def filled_note(name: str, count: int) -> str:
    """Return the message to the user that ``count`` missing heights of file ``name`` were filled."""
    return f"{name}: {count} missing heights are those of the nearest cells, at most {FARTHEST_FILL} away"


def filled(height: Float64) -> tuple[Float64, int]:
    """Return heights (R, C) with NaN filled from the nearest height within FARTHEST_FILL cells, and their number.

    Those farther off stay NaN.
    """
    missing = np.isnan(height)
    if not missing.any() or missing.all():
        return height, 0
    # Most scenarios need no scipy here.
    from scipy.ndimage import distance_transform_edt

    distance, (rows, columns) = distance_transform_edt(missing, return_indices=True)
    near = missing & (distance <= FARTHEST_FILL)
    return np.where(near, height[rows, columns], height), int(near.sum())


def _check_cover(file: str, found: Elevations, site: Site, origin: tuple[float, float], box: Bounds) -> None:
    """Raise UsageError for a terrain file that does not cover a box [m]."""
    south, north, west, east = box
    # A box in metres is not a box by latitude and longitude, so points along its sides are checked.
    along = np.linspace(0.0, 1.0, 9)
    norths = south + (north - south) * np.concatenate([along, along, along * 0.0, along * 0.0 + 1.0])
    easts = west + (east - west) * np.concatenate([along * 0.0, along * 0.0 + 1.0, along, along])
    rows, columns = _in_file(found, site, origin, norths, easts)
    slack = [1e-6 * step for step in found.spacing]
    if (
        rows.min() >= found.rows[0] - slack[0]
        and rows.max() <= found.rows[-1] + slack[0]
        and columns.min() >= found.columns[0] - slack[1]
        and columns.max() <= found.columns[-1] + slack[1]
    ):
        return
    if found.frame == "local":
        covered = _extent(found.rows - origin[0], found.columns - origin[1], "north", "east", "m", ".6g")
        asked = _extent(np.array([south, north]), np.array([west, east]), "north", "east", "m", ".6g")
    else:
        covered = _extent(found.rows, found.columns, "latitude", "longitude", "deg", ".8g")
        asked = _extent(rows, columns, "latitude", "longitude", "deg", ".8g")
    raise UsageError(f"{file}: covers {covered}; world.area needs {asked}; {_help_to_cover(file, found, origin, box)}")


def _help_to_cover(file: str, found: Elevations, origin: tuple[float, float], box: Bounds) -> str:
    """Return a hint for the error message of a terrain file that does not cover a box."""
    rows, columns = found.rows - origin[0], found.columns - origin[1]
    overlaps = rows[0] <= box[1] and rows[-1] >= box[0] and columns[0] <= box[3] and columns[-1] >= box[2]
    if found.frame != "local" or overlaps:
        return "give a smaller world.area or a larger file"
    if origin != (0.0, 0.0):
        return "look at origin_north and origin_east"
    map_of = "crs (EPSG:n) of its map, or " if file.lower().endswith(".asc") else ""
    return f"give {map_of}origin_north and origin_east, the coordinates of the site in it"


def _extent(rows: Float64, columns: Float64, first: str, second: str, unit: str, form: str) -> str:
    """Return the range of rows and columns as text for messages, with their names, unit and number format."""
    parts = [
        f"{name} {format(values.min(), form)} to {format(values.max(), form)}"
        for name, values in ((first, rows), (second, columns))
    ]
    return f"{parts[0]} and {parts[1]} {unit}"


def read_elevations(file: str, frame: str) -> Elevations:
    """Return the grid of heights in a terrain file, from a cache if the file has not changed.

    Args:
        file: ``.asc``, an ESRI ASCII grid; or ``.npz`` with ``height`` (R, C) [m] and ``north`` (R,), ``east`` (C,) [m]
            or ``latitude_deg`` (R,), ``longitude_deg`` (C,).
        frame: of an ASCII grid "local" or "geodetic"; "auto" takes cells below 0.1 for degrees.

    Raises:
        UsageError: no such file, or no such grid.
    """
    path = Path(file)
    if path.suffix.lower() not in (".asc", ".npz"):
        raise UsageError(f"{file}: expected one of {', '.join(SUFFIXES)}, .npz, or a folder of tiles")
    with readable(file):
        status = os.stat(os.path.expanduser(file))
        return _read(file, frame, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=2)
def _read(file: str, frame: str, changed: int, size: int) -> Elevations:
    """Return the checked grid of heights in a file; ``changed`` and ``size`` identify its version for the cache."""
    data = read_bytes(file, LARGEST_TABLE)
    found = _from_archive(file, data) if file.lower().endswith(".npz") else _from_text(file, data, frame)
    if frame not in ("auto", found.frame):
        raise UsageError(
            f"{file}: has {' and '.join(KEYS[found.frame])}, so its frame is '{found.frame}', not '{frame}'"
        )
    found = _upwards(found)
    for name, values in zip(KEYS[found.frame], (found.rows, found.columns), strict=True):
        steps = np.diff(values)
        if len(values) < 2 or not np.isfinite(values).all() or not (steps > 0.0).all():
            raise UsageError(f"{file}: its {name} are no two or more numbers in order")
        if np.ptp(steps) > 1e-3 * steps.mean():
            raise UsageError(
                f"{file}: its {name} are not evenly spaced: from {steps.min():.6g} to {steps.max():.6g}; resample it"
            )
    if found.frame == "geodetic" and (np.abs(found.rows).max() > 90.0 or np.abs(found.columns).max() > 360.0):
        raise UsageError(
            f"{file}: its rows go from {found.rows[0]:.6g} to {found.rows[-1]:.6g} and its columns from "
            f"{found.columns[0]:.6g} to {found.columns[-1]:.6g}, which are no degrees; give frame: local, with "
            "origin_north and origin_east"
        )
    return found


def _upwards(found: Elevations) -> Elevations:
    """Return the grid flipped so that its row and column coordinates rise."""
    rows, columns, height = found.rows, found.columns, found.height
    if height.shape == (len(rows), len(columns)):
        if len(rows) > 1 and rows[0] > rows[-1]:
            rows, height = rows[::-1], height[::-1]
        if len(columns) > 1 and columns[0] > columns[-1]:
            columns, height = columns[::-1], height[:, ::-1]
    return Elevations(found.frame, rows, columns, np.ascontiguousarray(height))


def _from_archive(file: str, data: bytes) -> Elevations:
    """Return the grid of heights in a .npz archive; raise UsageError for missing or wrong arrays."""
    content = read_arrays(file, data, MOST_HEIGHTS)
    frame: Frame = "geodetic" if "latitude_deg" in content else "local"
    wanted = (*KEYS[frame], "height")
    for name in wanted:
        if name not in content:
            raise UsageError(
                f"{file}: has no '{name}'{did_you_mean(name, list(content))}; expected height with north and east [m], "
                "or with latitude_deg and longitude_deg"
            )
        if content[name].dtype.kind not in "fiu":
            raise UsageError(f"{file}: '{name}' is of type {content[name].dtype}; expected numbers")
    rows, columns, height = (content[name].astype(np.float64) for name in wanted)
    if rows.ndim != 1 or columns.ndim != 1 or height.shape != (len(rows), len(columns)):
        raise UsageError(
            f"{file}: '{wanted[0]}' has shape {rows.shape}, '{wanted[1]}' {columns.shape} and 'height' {height.shape}; "
            "expected (R,), (C,) and (R, C)"
        )
    return Elevations(frame, rows, columns, np.where(np.isfinite(height), height, np.nan))


def _from_text(file: str, data: bytes, frame: str) -> Elevations:
    """Return the grid of heights in an ESRI ASCII grid's text; raise UsageError for a damaged one."""
    data = data.removeprefix(codecs.BOM_UTF8)
    # No header is longer; of the rest no more is taken apart than it says.
    words = data[:LONGEST_HEADER].decode("latin-1").split()
    header: dict[str, float] = {}
    while 2 * len(header) + 1 < len(words) and _is_name(words[2 * len(header)]):
        name, text = words[2 * len(header)].lower(), words[2 * len(header) + 1]
        if name in header:
            raise UsageError(f"{file}: its header has '{name[:40]}' twice")
        header[name] = _number(file, name, text)
    cells = header.get("cellsize")
    needed: dict[str, Any] = {
        "ncols": header.get("ncols"),
        "nrows": header.get("nrows"),
        "cellsize": cells if cells is not None else header.get("dx"),
        "xllcorner": header.get("xllcorner", header.get("xllcenter")),
        "yllcorner": header.get("yllcorner", header.get("yllcenter")),
    }
    for name, value in needed.items():
        if value is None:
            raise UsageError(f"{file}: its header has no '{name}'{did_you_mean(name, list(header))}")
    width, height = int(needed["ncols"]), int(needed["nrows"])
    dx, dy = (float(header.get(name, needed["cellsize"])) for name in ("dx", "dy"))
    asked = width * height
    if asked > MOST_HEIGHTS:
        raise UsageError(
            f"{file}: its header says {height} rows of {width}, {asked:.3g} heights; allowed: {MOST_HEIGHTS:.3g}"
        )
    # Whatever is left over is one more.
    values = data.decode("latin-1").split(None, 2 * len(header) + asked)[2 * len(header) :]
    if len(values) != asked:
        many = "more" if len(values) > asked else str(len(values))
        raise UsageError(f"{file}: {many} heights; its header says {height} rows of {width}, which are {asked}")
    try:
        heights = np.array(values, np.float64).reshape(height, width)
    except ValueError:
        line, word = _first_text(data.decode("latin-1"), 2 * len(header))
        raise UsageError(f"{file}: line {line}: the height {word[:40]!r} is not a number") from None
    heights = np.where((heights == header.get("nodata_value", -9999.0)) | ~np.isfinite(heights), np.nan, heights)
    # The header gives the corner of a cell; its height is that of its centre.
    west = needed["xllcorner"] + (0.5 * dx if "xllcorner" in header else 0.0)
    south = needed["yllcorner"] + (0.5 * dy if "yllcorner" in header else 0.0)
    own: Frame = "geodetic" if max(dx, dy) < LARGEST_DEGREES else "local"
    kind: Frame = own if frame == "auto" else ("local" if frame == "local" else "geodetic")
    return Elevations(kind, south + dy * np.arange(height), west + dx * np.arange(width), heights[::-1])


def _first_text(text: str, skipped: int) -> tuple[int, str]:
    """Return line number and text of the first word that is not a number, after ``skipped`` words."""
    count = 0
    for number, line in enumerate(text.split("\n"), 1):
        for word in line.split():
            count += 1
            try:
                float(word if count > skipped else "0")
            except ValueError:
                return number, word
    return 1, text[:40]


def _is_name(word: str) -> bool:
    """Return whether a word is a header field's name: neither a number nor NaN."""
    return word[:1].isalpha() and word.lower() != "nan"


def _number(file: str, name: str, text: str) -> float:
    """Return a number of an ASCII grid's header field ``name``; raise UsageError for impossible values."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    # GDAL writes nan, Windows 1.#QNAN; no height is any of these, so the word does not matter.
    if not math.isfinite(number) and (name != "nodata_value" or "nan" not in text.lower()):
        raise UsageError(f"{file}: '{name}' of its header is {text[:40]!r}; expected a number")
    if name in ("ncols", "nrows") and not (number == int(number) and number >= 2):
        raise UsageError(f"{file}: '{name}' of its header is {text[:40]}; expected a whole number, at least 2")
    if name in ("cellsize", "dx", "dy") and not number > 0.0:
        raise UsageError(f"{file}: '{name}' of its header is {text[:40]}; expected a number above 0")
    return number
