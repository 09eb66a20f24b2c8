"""Reads routes and polygons of GeoJSON files (RFC 7946); the third coordinate is above the WGS-84 ellipsoid."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

from qrsim.errors import UsageError, did_you_mean
from qrsim.files import Content
from qrsim.files.user_files import LARGEST_TABLE
from qrsim.models.geoid import undulation
from qrsim.scenarios.plans.drawn import (
    Drawn,
    DrawnPolygon,
    Options,
    Point,
    check_count,
    checked_altitude,
    checked_place,
    chosen,
    closed_ring,
    drawn_plan,
)
from qrsim.scenarios.plans.parts import plan_content, shown
from qrsim.scenarios.plans.plan import Corners, FencePolygon, Plan

_POLYGONS = ("Polygon", "MultiPolygon")
_COLLECTIONS = ("FeatureCollection", "Feature", "GeometryCollection")
_ROUTES = ("LineString", "MultiLineString", "Point")
_LACKS = "has points without altitudes"


def read_geojson(source: str, options: Options) -> Plan:
    """Read a plan from a GeoJSON file: a LineString, or else all Points in order, as route, and polygons as fence.

    ``properties.height`` of a feature is a height of all its points above the ground.

    Raises:
        UsageError: the file cannot be read, is no GeoJSON, has no such route, or a point of it is wrong.
    """
    content = _content(source, "a LineString", _ROUTES)
    routes, points = [], []
    for where, properties, geometry in _geometries(source, content):
        height = _height(source, where, properties)
        name = _name(properties)
        coordinates = geometry.get("coordinates")
        if geometry.get("type") == "Point":
            points.append(_point(source, where, coordinates, height))
        elif geometry.get("type") == "LineString":
            routes.append(_line(source, where, name, coordinates, height))
        elif geometry.get("type") == "MultiLineString":
            routes += [_line(source, where, name, each, height) for each in _listed(source, where, coordinates)]
    if not routes and points:
        routes = [Drawn("", tuple(points), _LACKS)]
    if not routes:
        raise UsageError(f"{source}: has no route; expected a LineString or Points")
    polygons = [each.read() for each in _polygons(source, content)]
    return drawn_plan(source, chosen(source, "route", routes, options.route, "plan.route"), options, polygons)


def geojson_polygons(source: str) -> list[DrawnPolygon]:
    """Return the polygons of a GeoJSON file; other geometries are ignored.

    Raises:
        UsageError: the file cannot be read, is no GeoJSON, or has no polygon.
    """
    found = list(_polygons(source, _content(source, "a Polygon", (*_ROUTES, *_POLYGONS))))
    if not found:
        raise UsageError(f"{source}: has no Polygon and no MultiPolygon")
    return found


def _content(source: str, wanted: str, kinds: tuple[str, ...]) -> Content:
    """Return a file's GeoJSON object; raises UsageError unless it is a collection or one of the types ``kinds``."""
    content = plan_content(source, f"GeoJSON with {wanted}", LARGEST_TABLE)
    kind = content.get("type") if isinstance(content, dict) else None
    if kind not in (*_COLLECTIONS, *kinds):
        hint = did_you_mean(str(kind), (*_COLLECTIONS, *kinds)) if kind else ""
        raise UsageError(f"{source}: its type is {shown(kind)}; expected GeoJSON with {wanted}{hint}")
    found: Content = content
    return found


def _polygons(source: str, content: Content) -> Iterator[DrawnPolygon]:
    """Yield each polygon of a GeoJSON object; its corners are parsed only when it is chosen."""
    for where, properties, geometry in _geometries(source, content):
        if geometry.get("type") in _POLYGONS:
            coordinates = _listed(source, where, geometry.get("coordinates"))
            for rings in [coordinates] if geometry["type"] == "Polygon" else coordinates:
                name = _name(properties)
                yield DrawnPolygon(name, partial(_polygon, source, where, name, rings))


def _polygon(source: str, where: str, name: str, rings: object) -> FencePolygon:
    """Convert GeoJSON rings to a polygon with holes; raises UsageError for invalid rings."""
    where = f"{where}, polygon '{name}'" if name else where
    found = [_ring(source, where, ring) for ring in _listed(source, where, rings)]
    if not found:
        raise UsageError(f"{source}: {where}: expected a list of rings, found none")
    return FencePolygon(True, found[0], tuple(found[1:]), name)


def _name(properties: Content) -> str:
    """Return the name of a GeoJSON feature, at most 100 characters; "" without one."""
    name = properties.get("name")
    return name[:100] if isinstance(name, str) else ""


def _geometries(source: str, content: Content) -> Iterator[tuple[str, Content, Content]]:
    """Yield (place in the file, properties, geometry) of each feature of a GeoJSON object."""
    features = [content]
    if content["type"] == "FeatureCollection":
        features = _listed(source, "features", content.get("features"), counts=False)
    for number, feature in enumerate(features):
        where = f"feature {number}"
        if not isinstance(feature, dict):
            raise UsageError(f"{source}: {where}: expected an object, found {shown(feature)}")
        bare = feature.get("type") != "Feature"
        properties = {} if bare else feature.get("properties")
        geometry = feature if bare else feature.get("geometry")
        properties = properties if isinstance(properties, dict) else {}
        if isinstance(geometry, dict) and geometry.get("type") == "GeometryCollection":
            inside = _listed(source, where, geometry.get("geometries"))
            yield from ((where, properties, each) for each in inside if isinstance(each, dict))
        elif isinstance(geometry, dict):
            yield where, properties, geometry


def _height(source: str, where: str, properties: Content) -> float | None:
    """Return a feature's ``height`` property [m], None without one; raises UsageError for values that are no height."""
    height = properties.get("height")
    if height is None:
        return None
    if isinstance(height, bool) or not isinstance(height, int | float):
        raise UsageError(f"{source}: {where}: its height is {shown(height)}; expected a number [m]")
    return checked_altitude(source, where, height)


def _line(source: str, where: str, name: str, coordinates: object, height: float | None) -> Drawn:
    """Convert the coordinates of a GeoJSON LineString to a drawn route; ``height`` [m] is above the ground."""
    points = [
        _point(source, f"{where}, point {i}", each, height)
        for i, each in enumerate(_listed(source, where, coordinates), 1)
    ]
    return Drawn(name, tuple(points), _LACKS)


def _point(source: str, where: str, position: object, height: float | None) -> Point:
    """Convert a GeoJSON position to a point, with ``height`` above ground or its own altitude above the sea [m]."""
    numbers = _position(source, where, position)
    latitude, longitude = checked_place(source, where, numbers[1], numbers[0])
    if height is not None:
        return Point(latitude, longitude, height, "ground")
    if len(numbers) < 3:
        return Point(latitude, longitude)
    return Point(latitude, longitude, checked_altitude(source, where, numbers[2]) - undulation(latitude, longitude))


def _ring(source: str, where: str, positions: object) -> Corners:
    """Return the corners (latitude, longitude) [deg] of a GeoJSON ring, without the repeated first corner."""
    corners = []
    for i, position in enumerate(_listed(source, where, positions)):
        numbers = _position(source, f"{where}, corner {i}", position)
        corners.append(checked_place(source, f"{where}, corner {i}", numbers[1], numbers[0]))
    return closed_ring(source, where, corners)


def _position(source: str, where: str, position: object) -> list[float]:
    """Return a GeoJSON position as a list of numbers; raises UsageError unless it has at least two."""
    numbers = position if isinstance(position, list) else []
    whole = all(isinstance(each, int | float) and not isinstance(each, bool) for each in numbers)
    if len(numbers) < 2 or not whole:
        raise UsageError(f"{source}: {where}: {shown(position)}; expected [longitude, latitude] or with an altitude")
    try:
        return [float(each) for each in numbers]
    except OverflowError:
        raise UsageError(f"{source}: {where}: {shown(position)}: a number is too large") from None


def _listed(source: str, where: str, value: object, counts: bool = True) -> list[Any]:
    """Return a value unchanged; raises UsageError unless it is a list, and, with ``counts``, not too long."""
    if not isinstance(value, list):
        raise UsageError(f"{source}: {where}: expected a list, found {shown(value)}")
    if counts:
        check_count(source, where, len(value))
    return value
