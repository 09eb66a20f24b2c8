"""Items that QGroundControl makes of patterns while it uploads them, and does not save.

StructureScan as StructureScanComplexItem of QGroundControl makes it (version 3 of the item, and version 2 of
QGroundControl 3.4), and fwLandingPattern as its LandingComplexItem. Both were compared with those sources, not with
recorded uploads.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from qrsim.files import Content
from qrsim.models.scene.fence import polygon_problems
from qrsim.models.site import Site
from qrsim.scenarios.plans import commands as known
from qrsim.scenarios.plans.parts import (
    LARGEST_LENGTH,
    PlanFaultError,
    number_of,
    of_kind,
    part_of,
    place_of,
)

SCAN, LANDING, VTOL_LANDING = "StructureScan", "fwLandingPattern", "vtolLandingPattern"
MOST_LAYERS = 500
# Of the item; that of version 1 had layers of another height.
SCAN_VERSIONS = (2, 3)
# Below this sine of the angle between two edges their corner would be far away.
_SHARPEST = 0.02
# An item, and the heading relative to the way to it [deg], None along it.
Generated = tuple[Content, float | None]
Point = tuple[float, float]


def scan_items(item: Mapping[str, object], path: str) -> list[Generated]:
    """Convert a structure scan of a .plan file to waypoints on which the vehicle faces the structure.

    The polygon is set out by the distance to the surface. Every layer is a round at half of its height, from the first
    corner and back to it. Version 3 enters and leaves the scan there at the altitude of entrance, above home.

    Raises:
        PlanFaultError: a part is missing or out of range.
    """
    version = part_of(item, "version", int, path)
    if version not in SCAN_VERSIONS:
        raise PlanFaultError(f"{path}.version: version {version} is not supported; supported: 2, 3")
    camera = part_of(item, "CameraCalc", dict, path)
    distance = _above_zero(camera, "DistanceToSurface", path)
    height = _above_zero(camera, "AdjustedFootprintFrontal", path)
    bottom = _length(item, "Altitude" if version == 2 else "ScanBottomAlt", path)
    layers = int(number_of(item.get("Layers"), f"{path}.Layers", MOST_LAYERS, ""))
    if layers < 1:
        raise PlanFaultError(f"{path}.Layers: {layers} is out of range; allowed: 1 to {MOST_LAYERS}")
    ring, turn = _set_out(_corners(item, path), distance, path)
    first, step = bottom + 0.5 * height, height
    if version == 3 and item.get("StartFromTop"):
        first, step = _length(item, "StructureHeight", path) - 0.5 * height, -height
    frame = known.ABOVE_HOME[0] if version == 3 or item.get("altitudeRelative", True) else known.ABOVE_SEA[0]
    found: list[Generated] = []
    for layer in range(layers):
        found += [(_waypoint(place, first + layer * step, frame), turn) for place in (*ring, ring[0])]
    if version == 2:
        return found
    gate = _waypoint(ring[0], _length(item, "EntranceAltitude", path), frame)
    return [(gate, None), *found, (gate, None)]


def landing_items(item: Mapping[str, object], path: str) -> list[Generated]:
    """Convert a fixed-wing landing pattern of a .plan file to simple items: the approach, and the landing.

    Raises:
        PlanFaultError: a part is missing or out of range.
    """
    approach = "landingApproachCoordinate" if "landingApproachCoordinate" in item else "loiterCoordinate"
    places = {}
    for key in (approach, "landCoordinate"):
        places[key] = place_of(part_of(item, key, list, path), f"{path}.{key}", 3)
    found = [_item(known.LAND_START, [0.0] * 7, known.MISSION_FRAME)]
    if item.get("useDoChangeSpeed"):
        speed = _above_zero(item, "finalApproachSpeed", path)
        found.append(_item(known.CHANGE_SPEED, [0.0, speed, -1.0, *[0.0] * 4], known.MISSION_FRAME))
    if item.get("useLoiterToAlt", True):
        radius = _above_zero(item, "loiterRadius", path)
        way = radius if item.get("loiterClockwise", True) else -radius
        params: list[float | None] = [1.0, way, 0.0, 1.0, *places[approach]]
        found.append(_item(known.LOITER_TO_ALTITUDE, params, _frame(item, "loiterAltitudeRelative")))
    else:
        params = [0.0, 0.0, 0.0, None, *places[approach]]
        found.append(_item(known.WAYPOINT, params, _frame(item, "loiterAltitudeRelative")))
    landing: list[float | None] = [0.0, 0.0, 0.0, None, *places["landCoordinate"]]
    found.append(_item(known.LAND, landing, _frame(item, "landingAltitudeRelative")))
    return [(each, None) for each in found]


def _frame(item: Mapping[str, object], old: str) -> int:
    """Return the MAVLink frame of an item's altitudes, above home or above sea; ``old`` is the key in version 1."""
    return known.ABOVE_HOME[0] if item.get("altitudesAreRelative", item.get(old, True)) else known.ABOVE_SEA[0]


def _item(command: int, params: Sequence[float | None], frame: int) -> Content:
    """Return a simple mission item as a .plan file has it, as JSON content."""
    return {"type": "SimpleItem", "command": command, "frame": frame, "params": list(params), "autoContinue": True}


def _waypoint(place: Point, altitude: float, frame: int) -> Content:
    """Return a waypoint item at a place (latitude, longitude) [deg] and altitude [m], as JSON content."""
    return _item(known.WAYPOINT, [0.0, 0.0, 0.0, None, *place, altitude], frame)


def _length(item: Mapping[str, object], key: str, path: str) -> float:
    """Return the length [m] under ``key`` of an item; raises PlanFaultError for other values."""
    return number_of(item.get(key), f"{path}.{key}", LARGEST_LENGTH, "m")


def _above_zero(item: Mapping[str, object], key: str, path: str) -> float:
    """Return the length [m] under ``key`` of an item; raises PlanFaultError unless it is above 0."""
    number = _length(item, key, path)
    if number <= 0.0:
        raise PlanFaultError(f"{path}: {key} is {number:g} m; allowed: above 0")
    return number


def _corners(item: Mapping[str, object], path: str) -> list[Point]:
    """Return the corners (latitude, longitude) [deg] of an item's polygon; raises PlanFaultError for invalid ones."""
    where, corners = f"{path}.polygon", []
    for i, corner in enumerate(part_of(item, "polygon", list, path)):
        latitude, longitude = place_of(of_kind(corner, list, f"{where}.{i}"), f"{where}.{i}", 2)
        corners.append((latitude, longitude))
    for problem in polygon_problems(corners):
        raise PlanFaultError(f"{where}: {problem}")
    return corners


def _set_out(corners: Sequence[Point], distance: float, path: str) -> tuple[list[Point], float]:
    """Offset a polygon outwards by a distance [m]; return its corners, and the heading inwards relative to a side
    [deg].

    Returns:
        The corners, latitude and longitude [deg], and the heading relative to the way that faces inwards [deg].
    """
    site = Site.from_degrees(*corners[0], 0.0)
    plane = [
        tuple(map(float, site.geodetic_to_ned(math.radians(latitude), math.radians(longitude), 0.0)[:2]))
        for latitude, longitude in corners
    ]
    count = len(plane)
    ways = [_way(plane[i], plane[(i + 1) % count]) for i in range(count)]
    area = sum(plane[i][0] * plane[(i + 1) % count][1] - plane[(i + 1) % count][0] * plane[i][1] for i in range(count))
    # From north to east is clockwise: the inside of a polygon of positive area is to the right.
    side = 1.0 if area > 0.0 else -1.0
    ring = []
    for i in range(count):
        (a, b), (c, d) = ways[i - 1], ways[i]
        sine, cosine = a * d - b * c, a * c + b * d
        if abs(sine) < _SHARPEST and cosine < 0.0:
            raise PlanFaultError(f"{path}.polygon: corner {i} is too sharp to be set out")
        # Along both edges: as far out as the bisector of their normals leads.
        more = math.tan(0.5 * math.atan2(sine, cosine))
        north = plane[i][0] + distance * side * (b + a * more)
        east = plane[i][1] + distance * side * (-a + b * more)
        place = site.ned_to_geodetic((north, east, 0.0))
        ring.append((math.degrees(float(place[0])), math.degrees(float(place[1]))))
    return ring, 90.0 * side


def _way(begin: Sequence[float], end: Sequence[float]) -> Point:
    """Return the unit vector (north, east) from one point to another."""
    north, east = end[0] - begin[0], end[1] - begin[1]
    length = math.hypot(north, east)
    return north / length, east / length
