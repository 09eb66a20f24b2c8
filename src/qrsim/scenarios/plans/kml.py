"""Reads routes and polygons of KML 2.2 files and KMZ archives; ``absolute`` altitudes are above mean sea level."""

from __future__ import annotations

import io
import math
import struct
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator
from functools import partial
from xml.etree.ElementTree import Element

from qrsim.errors import UsageError, readable, shortened
from qrsim.files.user_files import LARGEST_TEXT, read_bytes
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
from qrsim.scenarios.plans.plan import Above, Corners, FencePolygon, Plan
from qrsim.scenarios.plans.xml import children, tag, text_of, xml_root

# Unpacked size of an archive over its packed size.
MOST_PACKED = 100
# altitudeMode, also that of Google's extension, and what altitudes are above; the others are on the ground or sea.
_ABOVE: dict[str, Above] = {"absolute": "sea", "relativeToGround": "ground", "relativeToSeaFloor": "ground"}
_TRACKS = ("Track", "MultiTrack")
GEOMETRIES = ("Point", "LineString", "LinearRing", "Polygon", "Model", *_TRACKS)
# Whatever zipfile raises for an archive that is damaged.
_DAMAGED = (
    zipfile.BadZipFile,
    NotImplementedError,
    RuntimeError,
    OSError,
    EOFError,
    ValueError,
    OverflowError,
    struct.error,
    zlib.error,
)


def read_kml(source: str, options: Options) -> Plan:
    """Read a plan from a KML file or KMZ archive: a LineString, else all Points in order, as route; polygons as fence.

    Raises:
        UsageError: the file cannot be read, has no such route, or a point of it is wrong.
    """
    marks = [each for each in _root(source).iter() if tag(each) == "Placemark"]
    routes = [
        _line(source, text_of(mark, "name"), line)
        for mark in marks
        for line in mark.iter()
        if tag(line) == "LineString"
    ]
    points = [point for mark in marks for point in mark.iter() if tag(point) == "Point"]
    if not routes and points:
        routes = [_of_points(source, points)]
    if not routes:
        tracks = any(tag(part) in _TRACKS for mark in marks for part in mark.iter())
        other = (
            ": its gx:Track is a recording, which is recorded_path" if tracks else "; expected a LineString or Points"
        )
        raise UsageError(f"{source}: has no route{other}")
    polygons = [each.read() for each in _polygons(source, marks)]
    return drawn_plan(source, chosen(source, "route", routes, options.route, "plan.route"), options, polygons)


def kml_polygons(source: str) -> list[DrawnPolygon]:
    """Return the polygons of a KML file or KMZ archive; other features are ignored.

    Raises:
        UsageError: the file cannot be read, or has no polygon.
    """
    marks = [each for each in _root(source).iter() if tag(each) == "Placemark"]
    found = _polygons(source, marks)
    if not found:
        others = Counter(tag(part) for mark in marks for part in mark.iter() if tag(part) in GEOMETRIES)
        words = ", ".join(f"{count} {kind}" for kind, count in others.items()) or "no geometry"
        raise UsageError(f"{source}: has no Polygon in a Placemark; found {words}")
    return found


def _root(source: str) -> Element:
    """Return the root element of a KML file or KMZ archive."""
    with readable(source):
        data = read_bytes(source, LARGEST_TEXT)
    return xml_root(source, _unpacked(source, data) if data.startswith(b"PK") else data, "KML")


def _unpacked(source: str, data: bytes) -> bytes:
    """Extract the KML document from the bytes of a KMZ archive."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            names = [each for each in archive.infolist() if each.filename.lower().endswith(".kml")]
            main = [each for each in names if each.filename == "doc.kml"] or names
            found = _read_member(archive, main[0]) if len(main) == 1 else len(main)
    except _DAMAGED as error:
        raise UsageError(f"{source}: is no KMZ archive: {error}") from None
    if isinstance(found, bytes):
        return found
    if isinstance(found, str):
        raise UsageError(f"{source}: {found}")
    raise UsageError(f"{source}: has {found} .kml files in it; expected doc.kml or one")


def _read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes | str:
    """Read a file of a ZIP archive; return its bytes, or a text that says why not if it is too large."""
    size, packed = member.file_size, max(member.compress_size, 1)
    if size > LARGEST_TEXT or size > MOST_PACKED * packed:
        return (
            f"{member.filename} unpacks to {_size(size)}; allowed: {LARGEST_TEXT // 2**20} MB, and {MOST_PACKED} times "
            "its packed size"
        )
    with archive.open(member) as file:
        # Never more than it says it has.
        return file.read(size)


def _size(count: int) -> str:
    """Format a number of bytes as text, such as "1.5 MB"."""
    return next(
        f"{count / unit:.3g} {name}" for unit, name in ((1e9, "GB"), (1e6, "MB"), (1, "bytes")) if count >= unit
    )


def _line(source: str, name: str, element: Element) -> Drawn:
    """Convert a KML LineString to a drawn route."""
    mode = text_of(element, "altitudeMode") or "clampToGround"
    where = f"'{name}'" if name else "its LineString"
    points = tuple(_points(source, where, text_of(element, "coordinates"), mode))
    return Drawn(name, points, _lacking(mode))


def _of_points(source: str, elements: list[Element]) -> Drawn:
    """Convert KML Points, in their order, to a drawn route."""
    points, mode = [], "clampToGround"
    for i, element in enumerate(elements):
        mode = text_of(element, "altitudeMode") or "clampToGround"
        points += list(_points(source, f"Point {i + 1}", text_of(element, "coordinates"), mode))
    return Drawn("", tuple(points), _lacking(mode))


def _lacking(mode: str) -> str:
    """Return the text that says why points of a KML altitudeMode have no usable altitude."""
    return (
        "has points without altitudes" if mode in _ABOVE else f"is on the ground (altitudeMode {shortened(mode, 40)})"
    )


def _points(source: str, where: str, text: str, mode: str) -> Iterator[Point]:
    """Yield the points of a KML coordinates text; without altitudes for a mode such as clampToGround."""
    above = _ABOVE.get(mode)
    for place, numbers in _tuples(source, f"{where}, point", 1, text):
        latitude, longitude = checked_place(source, place, numbers[1], numbers[0])
        if above is None or len(numbers) < 3:
            yield Point(latitude, longitude)
        else:
            yield Point(latitude, longitude, checked_altitude(source, place, numbers[2]), above)


def _tuples(source: str, where: str, first: int, text: str) -> Iterator[tuple[str, list[float]]]:
    """Yield (place in the file, [longitude, latitude [deg], altitude [m]]) of each tuple in a KML coordinates text.

    The place is ``where`` with a number, which begins at ``first``. The altitude may be left out.
    """
    tuples = text.split()
    check_count(source, where.rpartition(",")[0], len(tuples))
    for i, words in enumerate(tuples, first):
        try:
            numbers = [float(word) for word in words.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) not in (2, 3) or not all(map(math.isfinite, numbers)):
            raise UsageError(
                f"{source}: {where} {i}: '{shortened(words, 60)}'; expected longitude,latitude or "
                "longitude,latitude,altitude"
            )
        yield f"{where} {i}", numbers


def _polygons(source: str, marks: list[Element]) -> list[DrawnPolygon]:
    """Return the polygons of KML placemarks; their corners are parsed only when they are chosen."""
    return [
        DrawnPolygon(name, partial(_polygon, source, name, element))
        for mark in marks
        for name in [text_of(mark, "name")]
        for element in mark.iter()
        if tag(element) == "Polygon"
    ]


def _polygon(source: str, name: str, element: Element) -> FencePolygon:
    """Convert a KML Polygon element to a polygon with holes; raises UsageError unless it has one outer ring."""
    where = f"polygon '{name}'" if name else "polygon (without a name)"
    outer, inner = (list(_rings(source, where, element, f"{kind}BoundaryIs")) for kind in ("outer", "inner"))
    if len(outer) != 1:
        raise UsageError(f"{source}: {where}: expected one outerBoundaryIs with a LinearRing with coordinates")
    return FencePolygon(True, outer[0], tuple(inner), name)


def _rings(source: str, where: str, element: Element, boundary: str) -> Iterator[Corners]:
    """Yield the corners of each LinearRing in the ``boundary`` elements (outer or inner) of a KML polygon."""
    for ring in (ring for each in children(element, boundary) for ring in children(each, "LinearRing")):
        tuples = _tuples(source, f"{where}, corner", 0, text_of(ring, "coordinates"))
        corners = [checked_place(source, place, numbers[1], numbers[0]) for place, numbers in tuples]
        if corners:
            yield closed_ring(source, where, corners)
