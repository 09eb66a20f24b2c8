"""Reads footprints and heights of buildings from GeoJSON (RFC 7946), as OpenStreetMap's exports have them."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.errors import ScenarioError, UsageError, did_you_mean, readable
from qrsim.extras import load
from qrsim.files import Content
from qrsim.files.user_files import LARGEST_TABLE, read_text
from qrsim.models.scene.fence import polygon_problems
from qrsim.models.site import Site
from qrsim.scenarios.local import FARTHEST, local_ned
from qrsim.scenarios.obstacle_specs import MOST_CORNERS, MOST_HOLES, MOST_OBSTACLES

Ring = list[list[float]]
# Of all outlines together, and what a storey is high [m], as OpenStreetMap's users take it to be.
MOST_POINTS, STOREY = 50_000, 3.0
HIGHEST = 1000.0
# How a file may name longitude and latitude; RFC 7946 knows no other coordinates.
_DEGREES = re.compile(r"(CRS:?84|EPSG:+4326)$", re.IGNORECASE)
_DIGITS = r"([0-9]{1,9}(?:[.,][0-9]+)?)"
_METRES = re.compile(rf"\s*{_DIGITS}\s*(?:m|met(?:re|er)s?)?\s*", re.IGNORECASE)
_FEET = re.compile(
    rf"""\s*(?:{_DIGITS}\s*(?:'|\u2032|ft|feet))?\s*(?:{_DIGITS}\s*(?:"|\u2033|in))?\s*""", re.IGNORECASE
)
_FOOT = 0.3048
_HEIGHTS, _LEVELS = ("height", "building:height"), ("building:levels", "levels")
# Keys of OpenStreetMap: of a building and of a part of one, and others by which its exports are known.
_TAGS = ("building", "building:part")
_OTHER_TAGS = ("natural", "landuse", "leisure", "waterway", "highway", "barrier", "amenity", "@id")
# Width of the crown of a tree without the tag diameter_crown [m], and corners of its outline.
_CROWN, _CROWN_CORNERS = 5.0, 8


@dataclass
class Building:
    """A building, or trees.

    Attributes:
        name: for messages.
        rings: corners [north, east] [m] of its outline, then of each hole.
        height: of its roof over the ground [m]; None where the file says none.
        base: of its lowest floor over the ground [m].
        unread: what the file says of its height that is none, for messages.
    """

    name: str
    rings: list[Ring]
    height: float | None
    base: float = 0.0
    unread: str = ""


@dataclass
class BuildingsFile:
    """What a file has.

    Attributes:
        buildings: in the order of the file, with trees if they were asked for.
        skipped: number of features left out that are neither polygons nor multipolygons.
        others: number of polygons and multipolygons left out that are no buildings.
        trees: number of features left out that are trees; they are among the others and the skipped too.
    """

    buildings: list[Building] = field(default_factory=list)
    skipped: int = 0
    others: int = 0
    trees: int = 0


def read_buildings(file: str, frame: str, site: Site, trees: float | None = None) -> BuildingsFile:
    """Read the buildings of a GeoJSON file in coordinates ``frame``; ``trees``: height of trees [m], None: none.

    Args:
        file: a GeoJSON file with polygons or multipolygons.
        frame: "geodetic": longitude and latitude [deg]; "local": east and north of the site's origin [m].
        site: origin of the local frame.
        trees: height [m] of woods and trees without one; None: they are left out.

    Raises:
        UsageError: the file cannot be read, is no GeoJSON, or is too large.
        ScenarioError: polygons that are none; every fault with its feature.
    """
    content = _content(file)
    _check_frame(file, content, frame)
    everything = list(_features(file, content))
    features, found = _chosen(everything, trees is not None)
    points = sum(_points(geometry) for _, _, geometry in features)
    if points > MOST_POINTS:
        raise UsageError(
            f"{file}: has {points} corners; allowed: at most {MOST_POINTS} in all; cut it to the area, or simplify the "
            "outlines (ogr2ogr -simplify)"
        )
    # Once, and not of each feature, where it is not installed.
    load("buildings", "a file of buildings", "shapely")
    problems = []
    for name, properties, geometry in features:
        polygons = _polygons(geometry) or [None]
        for i, rings in enumerate(polygons):
            path = name if len(polygons) == 1 else f"{name}, polygon {i}"
            try:
                placed = [_crown(properties, geometry, frame, site)] if rings is None else _outline(rings, frame, site)
                height, base = _heights(properties)
            except UsageError as error:
                problems.append(f"{path}: {error}")
                continue
            if height is None and _is_tree(properties):
                height = trees
            found.buildings.append(Building(path, placed, height, base, "" if height else _unread(properties)))
    if problems:
        raise ScenarioError(file, problems)
    if not found.buildings:
        what = f"{found.others} polygons, none of them a building (building=*)" if found.others else "no polygon"
        among = f" among {len(everything)} features" if everything else ""
        raise UsageError(f"{file}: has {what}{among}{trees_left_out(found)}")
    if len(found.buildings) > MOST_OBSTACLES:
        raise UsageError(f"{file}: has {len(found.buildings)} buildings; allowed: at most {MOST_OBSTACLES}")
    return found


def _content(file: str) -> Content:
    """Read the GeoJSON object of a map file; raises UsageError if it is not GeoJSON with polygons."""
    with readable(file):
        text = read_text(file, LARGEST_TABLE)
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        where = f"line {error.lineno}: {error.msg}" if isinstance(error, json.JSONDecodeError) else str(error)
        raise UsageError(f"{file}: is no JSON: {where}; expected GeoJSON with polygons") from None
    kinds = ("FeatureCollection", "Feature", "Polygon", "MultiPolygon", "GeometryCollection")
    kind = content.get("type") if isinstance(content, dict) else None
    if kind not in kinds:
        hint = did_you_mean(str(kind), kinds) if kind else ""
        raise UsageError(f"{file}: its type is {kind!r:.40}; expected GeoJSON, a FeatureCollection of polygons{hint}")
    return content


def _check_frame(file: str, content: Mapping[str, object], frame: str) -> None:
    """Raise UsageError if the map file itself states other coordinates than ``frame``."""
    crs = content.get("crs")
    properties = crs.get("properties") if isinstance(crs, dict) else None
    name = properties.get("name") if isinstance(properties, dict) else None
    if frame == "geodetic" and isinstance(name, str) and not _DEGREES.search(name):
        raise UsageError(
            f"{file}: its coordinates are {name[:60]}; allowed: longitude and latitude (ogr2ogr -t_srs EPSG:4326 makes "
            "them), or with frame: local metres east and north of the site"
        )


def _features(file: str, content: Mapping[str, object]) -> Iterator[tuple[str, Content, Content]]:
    """Yield (name, properties, geometry) of each GeoJSON feature."""
    features: object = [content]
    if content["type"] == "FeatureCollection":
        features = content.get("features")
    if not isinstance(features, list):
        raise UsageError(f"{file}: its features are no list")
    for number, feature in enumerate(features):
        if not isinstance(feature, dict):
            raise UsageError(f"{file}: feature {number} is no object")
        bare = feature.get("type") != "Feature"
        geometry = feature if bare else feature.get("geometry")
        properties = None if bare else feature.get("properties")
        properties = properties if isinstance(properties, dict) else {}
        given = feature.get("id", properties.get("@id", properties.get("id")))
        name = f"feature {number}" + (f" ({given!s:.40})" if isinstance(given, str | int) else "")
        yield name, properties, geometry if isinstance(geometry, dict) else {}


def _chosen(
    everything: list[tuple[str, Content, Content]], trees: bool
) -> tuple[list[tuple[str, Content, Content]], BuildingsFile]:
    """Return the GeoJSON features that become obstacles (``trees``: also trees), and counts of those left out.

    In exports of OpenStreetMap the buildings are ``building=*``; in files without its keys all polygons are.
    """
    of_osm = any(tag in properties for _, properties, _ in everything for tag in (*_TAGS, *_OTHER_TAGS))
    chosen, found = [], BuildingsFile()
    for feature in everything:
        _, properties, geometry = feature
        outlined = bool(_polygons(geometry))
        building = outlined and (not of_osm or _has(properties, *_TAGS))
        tree = not building and _is_tree(properties) and (outlined or geometry.get("type") == "Point")
        if building or (tree and trees):
            chosen.append(feature)
        else:
            found.skipped += not outlined
            found.others += outlined
            found.trees += tree
    return chosen, found


def trees_left_out(found: BuildingsFile) -> str:
    """Return a remark, for a message, on trees of a map file that were left out; "" if none were."""
    return f"; {found.trees} are woods or trees (world.buildings.trees makes them obstacles)" if found.trees else ""


def _has(properties: Mapping[str, object], *tags: str) -> bool:
    """Return whether a feature has one of these OpenStreetMap tags, set to anything but "no"."""
    return any(properties.get(tag) not in (None, False, "", "no") for tag in tags)


def _is_tree(properties: Mapping[str, object]) -> bool:
    """Return whether a feature is a tree or a wood by its OpenStreetMap tags."""
    return properties.get("natural") in ("wood", "tree") or properties.get("landuse") == "forest"


def _polygons(geometry: Mapping[str, object]) -> list[object]:
    """Return the polygons of a GeoJSON geometry, each a list of rings; [] for other geometries."""
    found, parts = [], [geometry]
    while parts:
        part = parts.pop()
        kind, coordinates, inner = part.get("type"), part.get("coordinates"), part.get("geometries")
        if kind == "Polygon" and coordinates:
            found.append(coordinates)
        elif kind == "MultiPolygon" and isinstance(coordinates, list):
            found.extend(coordinates)
        elif kind == "GeometryCollection" and isinstance(inner, list):
            parts.extend(each for each in reversed(inner) if isinstance(each, dict))
    return found


def _points(geometry: Mapping[str, object]) -> int:
    """Return the number of coordinates in the rings of a GeoJSON geometry; 1 for a point."""
    return int(geometry.get("type") == "Point") + sum(
        len(ring) if isinstance(ring, list) else 0
        for rings in _polygons(geometry)
        for ring in (rings if isinstance(rings, list) else [])
    )


def _outline(rings: object, frame: str, site: Site) -> list[Ring]:
    """Return the rings of a GeoJSON polygon as [north, east] [m] corners; raises UsageError if they are invalid."""
    if not isinstance(rings, list) or not rings:
        raise UsageError("its coordinates are no rings of pairs of numbers")
    placed = [_placed(ring, frame, site) for ring in rings]
    _check(placed)
    return placed


def _crown(properties: Mapping[str, object], geometry: Mapping[str, object], frame: str, site: Site) -> Ring:
    """Return the crown of a tree given as a point: a circle of [north, east] [m] corners."""
    ((north, east),) = _in_metres(_pairs([geometry.get("coordinates")]), frame, site)
    radius = (_length(properties, "diameter_crown") or _CROWN) / 2.0
    angles = [2.0 * math.pi * i / _CROWN_CORNERS for i in range(_CROWN_CORNERS)]
    return [[north + radius * math.cos(angle), east + radius * math.sin(angle)] for angle in angles]


def _placed(ring: object, frame: str, site: Site) -> Ring:
    """Convert a GeoJSON ring to [north, east] [m] corners without repeats; raises UsageError for a wrong count."""
    corners = _pairs(ring)
    corners = corners[np.append((corners[1:] != corners[:-1]).any(axis=1), True)]
    if len(corners) > 1 and (corners[0] == corners[-1]).all():
        corners = corners[:-1]
    if not 3 <= len(corners) <= MOST_CORNERS:
        raise UsageError(f"a ring has {len(corners)} corners; allowed: 3 to {MOST_CORNERS}")
    return _in_metres(corners, frame, site)


def _pairs(points: Any) -> NumpyArray:
    """Return GeoJSON points as an array (k, 2); raises UsageError unless they are finite numbers."""
    try:
        pairs = np.array([point[:2] for point in points], np.float64)
    except (TypeError, ValueError, KeyError, OverflowError):
        pairs = np.zeros((0, 0))
    if pairs.ndim != 2 or pairs.shape[1:] != (2,) or not np.isfinite(pairs).all():
        raise UsageError("its coordinates are no rings of pairs of numbers")
    return pairs


def _in_metres(corners: NumpyArray, frame: str, site: Site) -> Ring:
    """Convert corners (k, 2) of a map file to [north, east] [m] pairs; raises UsageError out of range."""
    if frame == "local":
        far = float(np.hypot(*corners.T).max())
        if far > FARTHEST:
            raise UsageError(
                f"it is {far / 1000.0:.4g} km from the site; allowed: at most {FARTHEST / 1000.0:g} km; frame: local "
                "is for metres east and north of the site itself"
            )
        return corners[:, ::-1].tolist()
    wrong = np.flatnonzero((np.abs(corners[:, 0]) > 180.0) | (np.abs(corners[:, 1]) > 90.0))
    if wrong.size:
        east, north = corners[wrong[0]]
        raise UsageError(
            f"{east:.8g}, {north:.8g} is no longitude and latitude [deg]; metres east and north of the site are "
            "frame: local, and other coordinates have to be converted (ogr2ogr -t_srs EPSG:4326)"
        )
    return [point[:2] for point in local_ned(site, [(latitude, longitude, 0.0) for longitude, latitude in corners])]


def _check(placed: list[Ring]) -> None:
    """Raise UsageError for a building's outline that crosses itself, or a hole outside it."""
    if len(placed) - 1 > MOST_HOLES:
        raise UsageError(f"it has {len(placed) - 1} holes; allowed: at most {MOST_HOLES}")
    shapely = load("buildings", "a file of buildings", "shapely")
    polygon = shapely.Polygon(placed[0], placed[1:])
    if polygon.is_valid:
        return
    reason = str(shapely.is_valid_reason(polygon))
    words, _, place = reason.partition("[")
    try:
        north, east = (float(part) for part in place.rstrip("]").split())
        where = f" at north {north:.5g} m, east {east:.5g} m"
    except ValueError:
        where = ""
    for number, ring in enumerate(placed):
        problems = polygon_problems(ring)
        if problems:
            words = f"{'its outline' if number == 0 else f'hole {number - 1}'} {problems[0]}"
            break
    raise UsageError(
        f"{words.strip()}{where}; allowed: an outline that does not cross itself, with its holes inside it; 'Fix "
        "geometries' of QGIS and shapely.make_valid repair it"
    )


def _heights(properties: Mapping[str, object]) -> tuple[float | None, float]:
    """Return height and base [m] of a building above ground from its properties; None for a height that is missing.

    The rules are those of OpenStreetMap's Simple 3D Buildings: ``height`` includes the roof, ``building:levels`` does
    not. A height or a number of levels of 0 is none.
    """
    height = _length(properties, *_HEIGHTS) or None
    levels = _levels(properties, *_LEVELS)
    if height is None and levels is not None:
        roof = _length(properties, "roof:height")
        height = levels * STOREY + ((_levels(properties, "roof:levels") or 0.0) * STOREY if roof is None else roof)
        height = height or None
    base = _length(properties, "min_height", "building:min_height")
    if base is None:
        base = (_levels(properties, "building:min_level") or 0.0) * STOREY
    if height is not None and not 0.0 < height <= HIGHEST:
        raise UsageError(f"its height is {height:g} m; allowed: above 0, up to {HIGHEST:g}")
    if not 0.0 <= base < (math.inf if height is None else height):
        raise UsageError(f"it begins at {base:g} m, which is not below its height, {height:g} m")
    return height, base


def _unread(properties: Mapping[str, object]) -> str:
    """Return the first height property with a value that is not a height, as "name 'value'"; "" without one."""
    for names, read in ((_HEIGHTS, _length), (_LEVELS, _levels)):
        for name in names:
            value = properties.get(name)
            if value not in (None, "") and read(properties, name) is None:
                return f"{name} {value!r:.60}"
    return ""


def _length(properties: Mapping[str, object], *names: str) -> float | None:
    """Return the first of the named properties that is a length, in metres; None if none of them is."""
    for name in names:
        value = properties.get(name)
        number = _plain(value)
        if number is not None:
            return number
        if not isinstance(value, str) or not value.strip():
            continue
        if match := _METRES.fullmatch(value):
            return float(match[1].replace(",", "."))
        if match := _FEET.fullmatch(value):
            feet, inches = (float((part or "0").replace(",", ".")) for part in match.groups())
            return (feet + inches / 12.0) * _FOOT
    return None


def _levels(properties: Mapping[str, object], *names: str) -> float | None:
    """Return the first of the named properties that is a number of storeys (largest of a list "1,2"); else None.

    Levels below the ground do not count.
    """
    for name in names:
        value = properties.get(name)
        number = _plain(value)
        if number is not None:
            return max(number, 0.0)
        parts = re.split("[,;]", value) if isinstance(value, str) else []
        if parts and all(re.fullmatch(r"\s*[0-9]{1,9}(\.[0-9]+)?\s*", part) for part in parts):
            return max(float(part) for part in parts)
    return None


def _plain(value: object) -> float | None:
    """Return the value of a property as a finite number; None if it is not one."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None
