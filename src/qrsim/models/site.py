"""The geodetic site: where the local NED frame touches the Earth, and the GPS time scale.

Geodesy is pymap3d's, in float64, at load and in logs only; inside a tick everything is local NED. The
functions import pymap3d when they are called: its import takes 10 ms or more, and brings in astropy where that is
installed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from qrsim.errors import UsageError

Float64 = npt.NDArray[np.float64]

# Semi-axes of WGS-84 and its linear eccentricity [m], and the distance from axis and centre below which pymap3d's
# special cases may hold [m].
_MAJOR, _MINOR, _NEAR_AXIS = 6378137.0, 6356752.31424518, 1.0
_FOCUS = math.sqrt(_MAJOR**2 - _MINOR**2)
GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)
# First day on which GPS - UTC, 0 at the GPS epoch, was one second more (IERS Bulletin C).
LEAP_SECOND_DAYS = (
    "1981-07-01", "1982-07-01", "1983-07-01", "1985-07-01", "1988-01-01", "1990-01-01", "1991-01-01", "1992-07-01",
    "1993-07-01", "1994-07-01", "1996-01-01", "1997-07-01", "1999-01-01", "2006-01-01", "2009-01-01", "2012-07-01",
    "2015-07-01", "2017-01-01",
)  # fmt: skip
_LEAPS_UTC = tuple(datetime.fromisoformat(day).replace(tzinfo=UTC) for day in LEAP_SECOND_DAYS)
_MICROSECOND = timedelta(microseconds=1)


@dataclass(frozen=True)
class Site:
    """Origin of the NED frame on the WGS-84 ellipsoid.

    Attributes:
        latitude_rad: geodetic latitude [rad], north positive.
        longitude_rad: longitude [rad], east positive.
        height: above the ellipsoid [m].
        geoid: height of the geoid above the ellipsoid at the origin [m], and its change per metre to the north and to
            the east; None: that of EGM96.

    The default is the flying field of Symington et al., IROS 2014.
    """

    latitude_rad: float = math.radians(51.71190)
    longitude_rad: float = math.radians(-0.21052)
    height: float = 0.0
    geoid: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            UsageError: an angle that is out of range (degrees, perhaps) or a value that is not finite.
        """
        for name, limit, words in (
            ("latitude_rad", 0.5 * math.pi, "[-pi/2, pi/2]"),
            ("longitude_rad", 2.0 * math.pi, "[-2 pi, 2 pi]"),
        ):
            value = getattr(self, name)
            # NaN fails this comparison too.
            if not abs(value) <= limit:
                raise UsageError(f"site.{name}: {value} is outside {words} rad; for degrees use Site.from_degrees")
        if not math.isfinite(self.height):
            raise UsageError(f"site.height: {self.height} is not a finite number of metres")

    @staticmethod
    def from_degrees(
        latitude_deg: float,
        longitude_deg: float,
        height: float = 0.0,
        geoid: tuple[float, float, float] | None = None,
    ) -> Site:
        """Return the site at a latitude and longitude [deg] and height [m]; raises as the constructor does."""
        return Site(math.radians(latitude_deg), math.radians(longitude_deg), height, geoid)

    def ned_to_geodetic(self, position_ned: npt.ArrayLike) -> tuple[Float64, Float64, Float64]:
        """Return (latitude [rad], longitude [rad], height [m]), each (...), of positions (..., 3) in NED [m]."""
        return _apply(_ned_to_geodetic, "position_ned", position_ned, *self._origin)

    def geodetic_to_ned(
        self, latitude_rad: npt.ArrayLike, longitude_rad: npt.ArrayLike, height: npt.ArrayLike
    ) -> Float64:
        """Return positions (..., 3) NED [m] of latitudes [rad], longitudes [rad] and heights [m], which broadcast."""
        from pymap3d import geodetic2ned

        geodetic = np.stack(np.broadcast_arrays(latitude_rad, longitude_rad, height), axis=-1)
        return np.stack(_apply(geodetic2ned, "geodetic", geodetic, *self._origin), axis=-1)

    def ecef_to_ned(self, points_ecef: npt.ArrayLike) -> Float64:
        """Return Earth-fixed points (..., 3) [m] in this site's NED frame [m]."""
        from pymap3d import ecef2ned

        return np.stack(_apply(ecef2ned, "points_ecef", points_ecef, *self._origin), axis=-1)

    def ned_from_ecef_rotation(self) -> Float64:
        """Return the matrix (3, 3) that rotates an Earth-fixed vector to NED; its rows are north, east and down."""
        from pymap3d import ecef2nedv

        axes = _apply(ecef2nedv, "axes", np.eye(3), self.latitude_rad, self.longitude_rad)
        return np.stack(axes, axis=0)

    def origin_ecef(self) -> Float64:
        """Return the origin (3,) of the local frame in Earth-fixed coordinates [m]."""
        from pymap3d import geodetic2ecef

        return np.asarray(geodetic2ecef(*self._origin, deg=False), np.float64)

    @property
    def _origin(self) -> tuple[float, float, float]:
        """Latitude and longitude [rad] and height [m] of the local frame's origin."""
        return self.latitude_rad, self.longitude_rad, self.height


def _apply(
    function: Callable[..., Sequence[npt.ArrayLike]], name: str, points: npt.ArrayLike, *origin: float
) -> tuple[Float64, Float64, Float64]:
    """Return the three results (...) of a pymap3d function for points (..., 3); raise UsageError for other shapes."""
    array = np.asarray(points, np.float64)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise UsageError(f"{name}: expected an array of shape (..., 3), got {array.shape}")
    results = function(*(array[..., i] for i in range(3)), *origin, deg=False)
    # pymap3d drops axes of length one from some results.
    first, second, third = (np.reshape(np.asarray(result, np.float64), array.shape[:-1]) for result in results)
    return first, second, third


@lru_cache(maxsize=16)
def _frame(latitude: float, longitude: float, height: float) -> tuple[float, ...]:
    """Return cosine and sine of latitude and of longitude [rad], and Earth-fixed coordinates [m], of a place."""
    from pymap3d import geodetic2ecef

    origin = map(float, geodetic2ecef(latitude, longitude, height, deg=False))
    return (*(float(f(angle)) for angle in (latitude, longitude) for f in (np.cos, np.sin)), *origin)


def _ned_to_geodetic(
    north: Float64, east: Float64, down: Float64, latitude: float, longitude: float, height: float, deg: bool
) -> Sequence[npt.ArrayLike]:
    """Return the bits of pymap3d.ned2geodetic, for a few points in less than half of its time.

    Method of You (2000), doi: 10.1061/(ASCE)0733-9453(2000)126:1(1). Points near the Earth's axis or centre are left to
    pymap3d.
    """
    cos_lat, sin_lat, cos_lon, sin_lon, x0, y0, z0 = _frame(latitude, longitude, height)
    up = -down
    t = cos_lat * up - sin_lat * north
    x, y = x0 + (cos_lon * t - sin_lon * east), y0 + (sin_lon * t + cos_lon * east)
    z = z0 + (sin_lat * up + cos_lat * north)
    r2 = np.sqrt(x * x + y * y + z * z) ** 2 - _FOCUS**2
    u, level = np.sqrt(0.5 * r2 + 0.5 * np.hypot(r2, 2 * _FOCUS * z)), np.hypot(x, y)
    if np.fmin.reduce(np.fmin(u, level), axis=None, initial=math.inf) < _NEAR_AXIS:
        from pymap3d import ned2geodetic

        return ned2geodetic(north, east, down, latitude, longitude, height, deg=deg)
    focal = np.hypot(u, _FOCUS)
    beta = np.arctan(focal / u * z / level)
    beta += ((_MINOR * u - _MAJOR * focal + _FOCUS**2) * np.sin(beta)) / (
        _MAJOR * focal * 1 / np.cos(beta) - _FOCUS**2 * np.cos(beta)
    )
    above = np.hypot(z - _MINOR * np.sin(beta), level - _MAJOR * np.cos(beta))
    inside = x**2 / _MAJOR**2 + y**2 / _MAJOR**2 + z**2 / _MINOR**2 < 1
    return np.arctan(_MAJOR / _MINOR * np.tan(beta)), np.arctan2(y, x), np.where(inside, -above, above)


def gps_minus_utc(when: datetime) -> int:
    """Return GPS minus UTC time [s] at a time; beyond the table its last value (18 s since 2017).

    Raises:
        UsageError: the time is naive.
    """
    return sum(leap <= _aware(when) for leap in _LEAPS_UTC)


def gps_seconds_from_utc(when: datetime) -> float:
    """Return a time with time zone as GPS seconds since 1980-01-06 00:00, to a microsecond.

    Raises:
        UsageError: the time is naive, or before GPS time began.
    """
    if _aware(when) < GPS_EPOCH:
        raise UsageError(f"{when.isoformat()} is before GPS time began, {GPS_EPOCH.isoformat()}")
    return (when - GPS_EPOCH) // _MICROSECOND / 1e6 + gps_minus_utc(when)


def utc_from_gps_seconds(gps_seconds: float) -> datetime:
    """Return GPS seconds since 1980-01-06 00:00 as a UTC time, to a microsecond.

    A datetime cannot say 23:59:60, so a time within a leap second reads 23:59:59 a second time.

    Raises:
        UsageError: the time is negative, not finite, or after the year 9999.
    """
    if not 0.0 <= gps_seconds < math.inf:
        raise UsageError(f"GPS seconds {gps_seconds}: expected a finite number that is not negative")
    try:
        gps = GPS_EPOCH + timedelta(microseconds=round(gps_seconds * 1e6))
    except OverflowError:
        raise UsageError(f"GPS seconds {gps_seconds}: after the year 9999") from None
    # On the GPS scale a leap begins after the seconds that went before it.
    offset = sum(leap + timedelta(seconds=before) <= gps for before, leap in enumerate(_LEAPS_UTC))
    return gps - timedelta(seconds=offset)


def _aware(when: datetime) -> datetime:
    """Return ``when`` unchanged; raise UsageError if it has no time zone."""
    if when.utcoffset() is None:
        raise UsageError(f"{when.isoformat()} has no time zone; give one, for UTC '{when.isoformat()}+00:00'")
    return when
