"""The position of a place in the grid of a GRIB message: regular in latitude and longitude, or Lambert's conic."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.errors import UsageError
from qrsim.models.atmosphere.weather.values import Corners, Request, corners_of

Get = Callable[[str], Any]
# Names of grids, for those that are not read.
OTHERS = {
    "unstructured_grid": "an unstructured grid (ICON native); take the regular-lat-lon files",
    "rotated_ll": "a rotated grid; take the regular-lat-lon files",
    "reduced_gg": "a reduced Gaussian grid; ask for a regular grid, such as 0.25/0.25",
    "regular_gg": "a Gaussian grid; ask for a regular grid, such as 0.25/0.25",
    "sh": "spherical harmonics; ask for a regular grid, such as 0.25/0.25",
}
READ = "regular_ll or lambert"
MOST_ALONG = 100_000


class Place(NamedTuple):
    """A place in a grid.

    Attributes:
        points: numbers of the four points around it.
        weights: (4,) of them, which add up to 1.
        cell: shorter side of the cell between them [m].
        turn: angle from true north to the grid's, clockwise [rad]; 0 where velocities are to the east and north.
    """

    points: tuple[int, ...]
    weights: Floats
    cell: float
    turn: float


def place_in(get: Get, file: str, request: Request) -> Place:
    """Return the grid points around a place in a GRIB message, with weights, cell size and the axes' turn from north.

    Args:
        get: returns the value of a key of ecCodes.
        file: name, for messages.
        request: the place.

    Raises:
        UsageError: the grid is of another kind, or does not hold the place.
    """
    kind = str(get("gridType"))
    if kind not in ("regular_ll", "lambert"):
        raise UsageError(f"{file}: has {OTHERS.get(kind, f'the grid {kind!r:.40}')}; grids that are read: {READ}")
    if int(get("alternativeRowScanning")):
        raise UsageError(f"{file}: every second row of its grid runs backwards; expected all rows in one direction")
    along, down = (int(get("Ni")), int(get("Nj"))) if kind == "regular_ll" else (int(get("Nx")), int(get("Ny")))
    if not (2 <= along <= MOST_ALONG and 2 <= down <= MOST_ALONG):
        raise UsageError(f"{file}: its grid has {along} x {down} points; allowed: 2 to {MOST_ALONG} along each axis")
    corners, turn = (_regular if kind == "regular_ll" else _lambert)(get, file, request, along, down)
    by_column = bool(int(get("jPointsAreConsecutive")))
    pairs = [(row, column) for row in corners.rows for column in corners.columns]
    points = tuple(column * down + row if by_column else row * along + column for row, column in pairs)
    rows, columns = (1.0 - corners.down, corners.down), (1.0 - corners.along, corners.along)
    return Place(points, np.array([row * column for row in rows for column in columns]), corners.cell, turn)


def _regular(get: Get, file: str, request: Request, along: int, down: int) -> tuple[Corners, float]:
    """Return the grid points around a place on a latitude-longitude grid, and 0, its axes' turn from north [rad]."""
    first, last = (
        (float(get(f"latitudeOf{end}GridPointInDegrees")), float(get(f"longitudeOf{end}GridPointInDegrees")))
        for end in ("First", "Last")
    )
    # From the first and the last point, because steps are rounded.
    way = (last[1] - first[1]) % 360.0
    if int(get("iScansNegatively")):
        way -= 360.0
    longitudes = first[1] + np.linspace(0.0, way, along)
    latitudes = np.linspace(first[0], last[0], down)
    return corners_of(file, latitudes, longitudes, request.latitude_deg, request.longitude_deg), 0.0


def _lambert(get: Get, file: str, request: Request, along: int, down: int) -> tuple[Corners, float]:
    """Return the grid points around a place on a Lambert conformal grid, and its axes' turn from north [rad]."""
    if int(get("earthIsOblate")):
        raise UsageError(f"{file}: its grid is Lambert's on an ellipsoid; a sphere is read, as that of HRRR")
    one, two, middle = (float(get(name)) for name in ("Latin1InDegrees", "Latin2InDegrees", "LoVInDegrees"))
    if not 0.0 < abs(one) < 90.0 or not 0.0 < abs(two) < 90.0 or one * two < 0.0:
        raise UsageError(f"{file}: its grid has the standard parallels {one:g} and {two:g}; allowed: between 0 and 90")

    def grown(latitude: float) -> float:
        """Return tan(pi/4 + latitude/2) for a latitude [deg], a term of the Lambert projection."""
        return math.tan(0.25 * math.pi + 0.5 * math.radians(latitude))

    cone = math.sin(math.radians(one))
    if abs(one - two) > 1e-9:
        ratio = math.cos(math.radians(one)) / math.cos(math.radians(two))
        cone = math.log(ratio) / math.log(grown(two) / grown(one))
    scale = float(get("radius")) * math.cos(math.radians(one)) * grown(one) ** cone / cone

    def plane(latitude: float, longitude: float) -> tuple[float, float]:
        """Return map coordinates x and y [m] of a latitude and longitude [deg] in the Lambert projection."""
        angle = cone * math.radians((longitude - middle + 180.0) % 360.0 - 180.0)
        radius = scale / grown(min(max(latitude, -89.9999), 89.9999)) ** cone
        return radius * math.sin(angle), -radius * math.cos(angle)

    steps = [
        -float(get(name)) if backwards else float(get(name))
        for name, backwards in (
            ("DxInMetres", int(get("iScansNegatively"))),
            ("DyInMetres", not int(get("jScansPositively"))),
        )
    ]
    if 0.0 in steps:
        raise UsageError(f"{file}: its grid has a spacing of 0 m")
    begin = plane(float(get("latitudeOfFirstGridPointInDegrees")), float(get("longitudeOfFirstGridPointInDegrees")))
    here = plane(request.latitude_deg, request.longitude_deg)
    column, row = ((at - start) / step for at, start, step in zip(here, begin, steps, strict=True))
    if not (-1e-6 <= column <= along - 1 + 1e-6 and -1e-6 <= row <= down - 1 + 1e-6):
        raise UsageError(
            f"{file}: the site, latitude {request.latitude_deg:.6g}, longitude {request.longitude_deg:.6g}, is outside "
            f"its grid: at column {column:.0f} of {along} and row {row:.0f} of {down}"
        )
    left, low = (int(min(max(math.floor(value), 0), count - 2)) for value, count in ((column, along), (row, down)))
    parts = [min(max(value - number, 0.0), 1.0) for value, number in ((row, low), (column, left))]
    # Velocities along the rows are turned by the convergence of meridians.
    turn = cone * math.radians((request.longitude_deg - middle + 180.0) % 360.0 - 180.0)
    cell = min(map(abs, steps))
    return Corners((low, low + 1), (left, left + 1), parts[0], parts[1], cell), turn if int(
        get("uvRelativeToGrid")
    ) else 0.0
