"""Places of messages in the frame of the site, one at a time: WGS-84 in closed form, without a library's overhead."""

from __future__ import annotations

import math

from qrsim.links.mavlink.stack.contracts import Triple
from qrsim.models.site import Site

# WGS-84: equatorial radius [m] and first eccentricity squared.
RADIUS, ECCENTRICITY2 = 6378137.0, 6.69437999014e-3


class Geodesy:
    """From latitude, longitude and altitude to a site's NED frame, and back.

    Altitudes above mean sea level are heights above the ellipsoid: there is no geoid.
    """

    def __init__(self, site: Site):
        self._latitude, self._longitude = site.latitude_rad, site.longitude_rad
        self.height = site.height
        self._sin, self._cos = math.sin(site.latitude_rad), math.cos(site.latitude_rad)
        self._origin = _ecef(site.latitude_rad, site.longitude_rad, site.height)

    def to_ned(self, latitude: float, longitude: float, altitude: float) -> Triple:
        """Return the position NED [m] of a latitude and longitude [deg] and an altitude [m]."""
        x, y, z = _ecef(math.radians(latitude), math.radians(longitude), altitude)
        dx, dy, dz = x - self._origin[0], y - self._origin[1], z - self._origin[2]
        sine, cosine = math.sin(self._longitude), math.cos(self._longitude)
        outward = cosine * dx + sine * dy
        return (
            self._cos * dz - self._sin * outward,
            cosine * dy - sine * dx,
            -self._cos * outward - self._sin * dz,
        )

    def to_geodetic(self, position_ned: Triple) -> Triple:
        """Return latitude and longitude [deg] and altitude [m] of a position NED [m]: the inverse of ``to_ned``."""
        north, east, down = position_ned
        place = [math.degrees(self._latitude), math.degrees(self._longitude), self.height - down]
        for _ in range(4):
            n, e, d = self.to_ned(place[0], place[1], place[2])
            place[0] += math.degrees((north - n) / RADIUS)
            place[1] += math.degrees((east - e) / (RADIUS * max(self._cos, 1e-6)))
            place[2] -= down - d
        return place[0], place[1], place[2]


def _ecef(latitude: float, longitude: float, height: float) -> Triple:
    sine, cosine = math.sin(latitude), math.cos(latitude)
    normal = RADIUS / math.sqrt(1.0 - ECCENTRICITY2 * sine * sine)
    flat = (normal + height) * cosine
    return flat * math.cos(longitude), flat * math.sin(longitude), (normal * (1.0 - ECCENTRICITY2) + height) * sine
