"""Heights of mean sea level: the geoid EGM96 above the WGS-84 ellipsoid.

EGM96: Lemoine et al., NASA/TP-1998-206861, of NIMA (now NGA), NASA and the Ohio State University; a work of the U.S.
Government in the public domain. ``egm96.zlib`` has it every 15 minutes of arc, to 1 cm; ``tools/geoid_grid.py`` wrote
the file from the grid of 5 minutes of GeographicLib, as in the package egm96 0.3.0.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import TypeVar, overload

import numpy as np
import numpy.typing as npt

from qrsim.core.arrays import NumpyArray
from qrsim.errors import UsageError, shortened
from qrsim.models.site import Site

Float64 = npt.NDArray[np.float64]
Lengths = TypeVar("Lengths", float, NumpyArray)
Arrays = NumpyArray | Sequence[float]

# From pole to pole, and around the Earth.
ROWS, COLUMNS, PER_DEGREE = 721, 1440, 4
# Points of the grid in each direction that a value is interpolated from, and those before the first of its cell.
POINTS, BEFORE = 8, 3
# The slope at a site is that between places this far from it to either side [m].
SLOPE_OVER = 2500.0


@overload
def undulation(latitude_deg: float, longitude_deg: float) -> float:
    """Return the geoid undulation [m] at one place, as a float."""


@overload
def undulation(latitude_deg: Arrays, longitude_deg: npt.ArrayLike) -> Float64:
    """Return the geoid undulations [m] at arrays of places [deg]; either argument may be a scalar."""


@overload
def undulation(latitude_deg: npt.ArrayLike, longitude_deg: Arrays) -> Float64:
    """Return the geoid undulations [m] at arrays of places [deg]; either argument may be a scalar."""


def undulation(latitude_deg: npt.ArrayLike, longitude_deg: npt.ArrayLike) -> float | Float64:
    """Return the geoid undulation [m], EGM96's height above the WGS-84 ellipsoid, at places (...) [deg].

    A height h above the ellipsoid is the height h - undulation above mean sea level. The value is interpolated from
    eight by eight points of a grid of 15 minutes of arc, by polynomials of degree 7. It is within 0.02 m of the grid
    of 5 minutes, at every point of that. EGM96 itself differs from mean sea level by about 0.5 to 1 m. The first call
    reads the grid, in about 40 ms.

    Args:
        latitude_deg: (...) geodetic latitude [deg], -90 to 90.
        longitude_deg: (...) longitude [deg], east positive, -360 to 360; the two broadcast.

    Returns:
        A number for two numbers, otherwise an array of the broadcast shape.

    Raises:
        UsageError: a value is not a finite number or out of range, or the shapes do not broadcast.

    Examples:
        >>> import qrsim
        >>> round(qrsim.geoid.undulation(51.7119, -0.21052), 1)
        46.3
    """
    latitude = _checked("latitude_deg", latitude_deg, 90.0)
    longitude = _checked("longitude_deg", longitude_deg, 360.0)
    try:
        latitude, longitude = np.broadcast_arrays(latitude, longitude)
    except ValueError:
        raise UsageError(
            f"latitude_deg and longitude_deg: shapes {latitude.shape} and {longitude.shape} do not broadcast"
        ) from None
    row, column = (90.0 - latitude) * PER_DEGREE, np.mod(longitude, 360.0) * PER_DEGREE
    # Of a tiny negative longitude the remainder is 360 itself.
    i, j = row.astype(np.intp), np.minimum(column.astype(np.intp), COLUMNS - 1)
    grid, rows, columns = _grid(), _weights(row - i), _weights(column - j)
    found = np.zeros(latitude.shape)
    for a in range(POINTS):
        for b in range(POINTS):
            found += rows[a] * columns[b] * grid[i + a, j + b]
    return found if found.ndim else float(found)


@dataclass(frozen=True)
class GeoidPlane:
    """The geoid near a site as a plane: what altitudes of a run are measured from.

    Within 5 km of a site the plane is within 0.02 m of ``undulation`` almost everywhere, and within 0.1 m on steep
    islands. Without arguments it is the ellipsoid, and altitudes are heights above that.

    Attributes:
        height: of the geoid above the WGS-84 ellipsoid at the site [m].
        slope_north, slope_east: its change [m] per metre to the north and to the east.
    """

    height: float = 0.0
    slope_north: float = 0.0
    slope_east: float = 0.0

    @staticmethod
    @lru_cache(maxsize=8)
    def at(site: Site) -> GeoidPlane:
        """Return the plane that fits the geoid near a site, of EGM96 unless the site has its own geoid."""
        return GeoidPlane(*site.geoid) if site.geoid is not None else plane_of(site, undulation)

    def undulation(self, north: Lengths, east: Lengths) -> Lengths:
        """Return the geoid's height [m] above the WGS-84 ellipsoid at places north and east [m] in the site's frame."""
        return self.height + self.slope_north * north + self.slope_east * east


def plane_of(site: Site, undulations: Callable[[Float64, Float64], Float64]) -> GeoidPlane:
    """Return the plane that fits a geoid near a site, from a function of undulations [m] at places [deg].

    Args:
        site: the place.
        undulations: heights (n,) above the ellipsoid [m] at latitudes and longitudes (n,) [deg].
    """
    by = SLOPE_OVER
    places = [[0.0, 0.0, 0.0], [by, 0.0, 0.0], [-by, 0.0, 0.0], [0.0, by, 0.0], [0.0, -by, 0.0]]
    latitude, longitude, _ = site.ned_to_geodetic(places)
    here, north, south, east, west = undulations(np.degrees(latitude), np.degrees(longitude)).tolist()
    return GeoidPlane(here, (north - south) / (2.0 * by), (east - west) / (2.0 * by))


def above_sea(geodetic: Float64, site: Site) -> Float64:
    """Return places (..., 3) [deg, deg, m] near a site with ellipsoidal heights replaced by heights above the sea."""
    latitude, longitude, height = (geodetic[..., i] for i in range(3))
    if site.geoid is None:
        return np.stack((latitude, longitude, height - undulation(latitude, longitude)), axis=-1)
    ned = site.geodetic_to_ned(np.radians(latitude), np.radians(longitude), height)
    amsl = height - GeoidPlane.at(site).undulation(ned[..., 0], ned[..., 1])
    return np.stack((latitude, longitude, amsl), axis=-1)


def _checked(name: str, values: npt.ArrayLike, limit: float) -> Float64:
    """Return angles [deg] as float64; raise UsageError, naming ``name``, for one beyond +/- ``limit`` or NaN."""
    try:
        array = np.asarray(values)
    except ValueError:
        raise UsageError(f"{name}: expected a number or an array of numbers, found rows of different lengths") from None
    if array.dtype.kind not in "iuf":
        raise UsageError(f"{name}: expected a number or an array of numbers, found {shortened(repr(values), 60)}")
    array = array.astype(np.float64)
    # NaN fails this comparison too.
    wrong = ~(np.abs(array) <= limit)
    if wrong.any():
        raise UsageError(f"{name}: {array[wrong][0]:g} is out of range; allowed: {-limit:g} to {limit:g} deg")
    return array


def _weights(part: Float64) -> list[Float64]:
    """Return Lagrange interpolation weights, a list of (...) for each point, at positions (...) in a cell, 0 to 1."""
    return [*lagrange(part, POINTS, BEFORE)]


def lagrange(place: float | Float64, points: int, before: int = 0) -> Float64:
    """Return Lagrange interpolation weights (points, ...) at places (...) for nodes at -before, 1 - before, ..."""
    weights = []
    for a in range(points):
        weight = np.ones_like(place, np.float64)
        for b in range(points):
            if b != a:
                weight = weight * (place + (before - b)) / (a - b)
        weights.append(weight)
    return np.array(weights)


@lru_cache(maxsize=1)
def _grid() -> Float64:
    """Return EGM96's grid of undulations [m], from the north pole southwards and Greenwich eastwards, with margins.

    Beyond a pole the meridian continues on the opposite one, 180 degrees away.
    """
    packed = resources.files("qrsim.models").joinpath("egm96.zlib").read_bytes()
    differences = np.frombuffer(zlib.decompress(packed), "<i2").reshape(ROWS, COLUMNS)
    metres = 0.01 * np.cumsum(np.cumsum(differences, axis=0, dtype=np.int32), axis=1)
    after = POINTS - BEFORE - 1
    opposite = np.roll(metres, COLUMNS // 2, axis=1)
    tall = np.concatenate((opposite[BEFORE:0:-1], metres, opposite[-2 : -2 - after : -1]))
    return np.pad(tall, ((0, 0), (BEFORE, after)), mode="wrap")
