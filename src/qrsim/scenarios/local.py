"""From latitude and longitude to the local NED frame of a scenario."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from qrsim.errors import UsageError
from qrsim.models.site import Site

# At this distance from the site [m] a length in its plane is half a metre shorter than the same over the ground.
FARTHEST = 50_000.0


def local_ned(site: Site, places: Sequence[tuple[float, float, float]]) -> list[list[float]]:
    """Convert (latitude [deg], longitude [deg], height above the site's origin [m]) of places to NED [m].

    North and east are those of the place at the site's own height, and down is minus the height: the ground is flat, as
    everywhere in a scenario.

    Raises:
        UsageError: a place is not near the site.
    """
    latitude, longitude, height = np.array(places, np.float64).T
    points = site.geodetic_to_ned(np.radians(latitude), np.radians(longitude), site.height)
    for place, point in zip(places, points, strict=True):
        distance = math.hypot(*point)
        if distance > FARTHEST:
            raise UsageError(
                f"latitude {place[0]:.6g} deg, longitude {place[1]:.6g} deg is {distance / 1000.0:.0f} km from the "
                f"site; allowed: at most {FARTHEST / 1000.0:g} km (see site.latitude_deg and site.longitude_deg)"
                + _if_swapped(site, place)
            )
    return [[float(north), float(east), -float(up)] for (north, east, _), up in zip(points, height, strict=True)]


def swapped_hint(latitude: object, longitude: object) -> str:
    """Return a hint if latitude and longitude [deg] must be swapped because one is out of range; else ""."""
    pair = [float(each) for each in (latitude, longitude) if isinstance(each, int | float)]
    swapped = len(pair) == 2 and 90.0 < abs(pair[0]) <= 180.0 and abs(pair[1]) <= 90.0
    return "; latitude and longitude seem to be swapped" if swapped else ""


def _if_swapped(site: Site, place: tuple[float, float, float]) -> str:
    """Return a hint if a place is near the site once latitude and longitude [deg] are swapped; else ""."""
    latitude, longitude, height = place
    if abs(longitude) > 90.0:
        return ""
    point = site.geodetic_to_ned(math.radians(longitude), math.radians(latitude), height)
    distance = math.hypot(*map(float, point))
    near = distance <= FARTHEST
    return f"; with latitude and longitude swapped it is {distance / 1000.0:.3g} km away" if near else ""
