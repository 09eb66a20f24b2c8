"""Earth's magnetic field by the World Magnetic Model, and the heading of a compass.

See docs/howto/sensors_heading_and_height.md.

The model's coefficients are those of pygeomag, which is imported when it is asked: once, while a world is built.
"""

from __future__ import annotations

from datetime import UTC, datetime

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array

from qrsim.core.fastmath import arctan2, sincos, wrap_angle
from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError
from qrsim.models.site import Site

# First year of the models at hand, and the first after them; each is for five years.
FIRST_YEAR, END_YEAR, SPAN = 2010, 2030, 5
# Two models were published for 2015; the second replaced the first.
_FILES = {2010: "WMM_2010", 2015: "WMM_2015v2", 2020: "WMM_2020", 2025: "WMM_2025"}


def years() -> str:
    """Return the range of dates that the magnetic models cover, as text."""
    return f"{FIRST_YEAR}-01-01 to {END_YEAR - 1}-12-31"


def covers(when: datetime) -> bool:
    """Return whether a magnetic model covers a time (with time zone), by its year in UTC."""
    return FIRST_YEAR <= when.astimezone(UTC).year < END_YEAR


def earth_field_ned(site: Site, when: datetime) -> npt.NDArray[np.float64]:
    """Return Earth's magnetic field (3,) NED [uT] at a site on a date, by the World Magnetic Model of that time.

    The model has the field of the core, and errs by some 0.15 uT, most of it that of the crust (its own error model).
    The height is above the ellipsoid.

    Raises:
        UsageError: the time is outside the models' years, or naive.
    """
    from pygeomag import GeoMag

    if when.utcoffset() is None:
        raise UsageError(f"{when.isoformat()} has no time zone; give one, for UTC '{when.isoformat()}+00:00'")
    if not covers(when):
        raise UsageError(f"{when.isoformat()} is outside the World Magnetic Model; allowed: {years()}")
    utc = when.astimezone(UTC)
    begin, end = (datetime(year, 1, 1, tzinfo=UTC) for year in (utc.year, utc.year + 1))
    model = GeoMag(coefficients_file=f"wmm/{_FILES[utc.year - utc.year % SPAN]}.COF")
    found = model.calculate(
        glat=float(np.degrees(site.latitude_rad)),
        glon=_within_half_turn(float(np.degrees(site.longitude_rad))),
        alt=site.height / 1000.0,
        time=utc.year + (utc - begin) / (end - begin),
    )
    return np.array([found.x, found.y, found.z]) / 1000.0


def _within_half_turn(degrees: float) -> float:
    """Return an angle [deg] wrapped to the interval [-180, 180)."""
    return (degrees + 180.0) % 360.0 - 180.0


def declination(field_ned: npt.ArrayLike) -> float:
    """Return the magnetic declination [rad] of a field (3,) NED, positive east: true minus magnetic heading."""
    north, east, _ = np.asarray(field_ned, np.float64)
    return float(np.arctan2(east, north))


def inclination(field_ned: npt.ArrayLike) -> float:
    """Return the magnetic inclination [rad] of a field (3,) NED, positive below the horizon."""
    north, east, down = np.asarray(field_ned, np.float64)
    return float(np.arctan2(down, np.hypot(north, east)))


def compass_heading(field_body: Vec3, roll: object, pitch: object, declination: Array | float = 0.0) -> Array:
    """Return the heading (n,) [rad], -pi to pi, from a magnetometer and known roll and pitch: a levelled compass.

    With a declination it is against true north, else against magnetic north. An error of the tilt turns it by about the
    error times the tangent of the inclination.

    Args:
        field_body: measured field (n,) in body axes, in any unit.
        roll: roll of the body (n,) [rad].
        pitch: pitch of the body (n,) [rad].
        declination: of the field there [rad].
    """
    x, y, z = (jnp.asarray(axis) for axis in field_body.axes)
    sin_roll, cos_roll = sincos(jnp.asarray(roll, x.dtype))
    sin_pitch, cos_pitch = sincos(jnp.asarray(pitch, x.dtype))
    down = sin_roll * y + cos_roll * z
    ahead, right = cos_pitch * x + sin_pitch * down, cos_roll * y - sin_roll * z
    return wrap_angle(arctan2(-right, ahead) + declination)
