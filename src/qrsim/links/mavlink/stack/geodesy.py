"""Places of messages in the frame of the site, one at a time: WGS-84 in closed form, without a library's overhead."""

from __future__ import annotations

import math

from qrsim.links.mavlink.stack.contracts import Datum, Triple
from qrsim.models.geoid import GeoidPlane
from qrsim.models.site import Site

# WGS-84: equatorial radius [m] and first eccentricity squared.
RADIUS, ECCENTRICITY2 = 6378137.0, 6.69437999014e-3


def geoid_of(site: Site, datum: Datum) -> GeoidPlane:
    """Return the surface from which altitudes in messages are measured: the geoid for the datum "sea", else the
    ellipsoid."""
    return GeoidPlane.at(site) if datum == "sea" else GeoidPlane()


class Geodesy:
    """From latitude, longitude and altitude to a site's NED frame, and back.

    Args:
        site: origin of the frame, with its height above the ellipsoid.
        datum: what altitudes are measured from.

    Attributes:
        height: altitude of the site [m].
    """

    def __init__(self, site: Site, datum: Datum = "sea"):
        self._latitude, self._longitude = site.latitude_rad, site.longitude_rad
        self._geoid = geoid_of(site, datum)
        self.height = site.height - self._geoid.height
        self._height = site.height
        self._sin, self._cos = math.sin(site.latitude_rad), math.cos(site.latitude_rad)
        self._origin = _ecef(site.latitude_rad, site.longitude_rad, site.height)

    def to_ned(self, latitude: float, longitude: float, altitude: float) -> Triple:
        """Convert latitude, longitude [deg] and altitude [m] in a message to a position NED [m] in the site's frame."""
        geoid = self._geoid
        north, east, _ = self._to_ned(latitude, longitude, altitude + geoid.height)
        return self._to_ned(latitude, longitude, altitude + geoid.undulation(north, east))

    def _to_ned(self, latitude: float, longitude: float, height: float) -> Triple:
        """Convert latitude, longitude [deg] and height above the ellipsoid [m] to a position NED [m] in the site's
        frame."""
        x, y, z = _ecef(math.radians(latitude), math.radians(longitude), height)
        dx, dy, dz = x - self._origin[0], y - self._origin[1], z - self._origin[2]
        sine, cosine = math.sin(self._longitude), math.cos(self._longitude)
        outward = cosine * dx + sine * dy
        return (
            self._cos * dz - self._sin * outward,
            cosine * dy - sine * dx,
            -self._cos * outward - self._sin * dz,
        )

    def to_geodetic(self, position_ned: Triple) -> Triple:
        """Convert a position NED [m] in the site's frame to latitude, longitude [deg] and altitude [m]: the inverse of
        ``to_ned``."""
        north, east, down = position_ned
        undulation = self._geoid.undulation(north, east)
        place = [math.degrees(self._latitude), math.degrees(self._longitude), self._height - down]
        for _ in range(4):
            n, e, d = self._to_ned(place[0], place[1], place[2])
            place[0] += math.degrees((north - n) / RADIUS)
            place[1] += math.degrees((east - e) / (RADIUS * max(self._cos, 1e-6)))
            place[2] -= down - d
        return place[0], place[1], place[2] - undulation


def _ecef(latitude: float, longitude: float, height: float) -> Triple:
    """Convert latitude, longitude [rad] and height above WGS-84 [m] to an Earth-centred, Earth-fixed position [m]."""
    sine, cosine = math.sin(latitude), math.cos(latitude)
    normal = RADIUS / math.sqrt(1.0 - ECCENTRICITY2 * sine * sine)
    flat = (normal + height) * cosine
    return flat * math.cos(longitude), flat * math.sin(longitude), (normal * (1.0 - ECCENTRICITY2) + height) * sine
