"""Reads routes of GPX 1.0 and 1.1 files; ``ele`` is above mean sea level."""

from __future__ import annotations

from xml.etree.ElementTree import Element

from qrsim.errors import UsageError, readable, shortened
from qrsim.files.user_files import LARGEST_TEXT, read_bytes
from qrsim.scenarios.plans.drawn import (
    Drawn,
    Options,
    Point,
    check_count,
    checked_altitude,
    checked_place,
    chosen,
    drawn_plan,
)
from qrsim.scenarios.plans.plan import Plan
from qrsim.scenarios.plans.xml import children, tag, text_of, xml_root


def read_gpx(source: str, options: Options) -> Plan:
    """Read a plan from a GPX file: the route that the options name, or its only one.

    Raises:
        UsageError: the file cannot be read, has no such route, or a point of it is wrong.
    """
    with readable(source):
        data = read_bytes(source, LARGEST_TEXT)
    root = xml_root(source, data, "GPX")
    found = children(root, "rte")
    if not found:
        tracks = sum(tag(each) == "trkpt" for each in root.iter())
        marks = len(children(root, "wpt"))
        other = f"it has {marks} waypoints without an order" if marks else "it is empty"
        if tracks:
            other = f"it has a track of {tracks} points: a recorded path is recorded_path"
        raise UsageError(f"{source}: has no route; {other}")
    routes = [_route(source, element) for element in found]
    return drawn_plan(source, chosen(source, "route", routes, options.route, "plan.route"), options)


def _route(source: str, element: Element) -> Drawn:
    """Convert a GPX ``rte`` element to a drawn route."""
    name, points = text_of(element, "name"), []
    marks = children(element, "rtept")
    check_count(source, f"route '{name}'", len(marks))
    for number, each in enumerate(marks, 1):
        where = f"point {number} of route '{name}'" if name else f"route point {number}"
        place = (_number(source, where, key, each.get(key)) for key in ("lat", "lon"))
        latitude, longitude = checked_place(source, where, *place)
        height = text_of(each, "ele")
        altitude = checked_altitude(source, where, _number(source, where, "ele", height)) if height else None
        points.append(Point(latitude, longitude, altitude))
    return Drawn(name, tuple(points), "has points without ele")


def _number(source: str, where: str, name: str, text: str | None) -> float:
    """Parse a number of a GPX file; raises UsageError that names its place in the file."""
    try:
        return float(text or "")
    except ValueError:
        raise UsageError(f"{source}: {where}: {name} is '{shortened(text or '', 40)}'; expected a number") from None
