"""Reads routes and polygons of KML 2.2 files and KMZ archives; ``absolute`` altitudes are above mean sea level."""

from __future__ import annotations

import io
import math
import struct
import zipfile
import zlib
from collections.abc import Iterator
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
# Whatever zipfile raises for an archive that is damaged.
_DAMAGED = (
    zipfile.BadZipFile, NotImplementedError, RuntimeError, OSError, EOFError, ValueError, OverflowError, struct.error,
    zlib.error,
)  # fmt: skip


def read_kml(source: str, options: Options) -> Plan:
    """Read a route of a KML file or KMZ archive: a LineString, else its Points in their order; and its polygons.

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
    return drawn_plan(source, chosen(source, routes, options.route), options, [*_polygons(source, marks)])


def _root(source: str) -> Element:
    with readable(source):
        data = read_bytes(source, LARGEST_TEXT)
    return xml_root(source, _unpacked(source, data) if data.startswith(b"PK") else data, "KML")


def _unpacked(source: str, data: bytes) -> bytes:
    """Return the KML document of a KMZ archive."""
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
    """Return the content of a file of an archive; the words for why not, where it is too large."""
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
    return next(
        f"{count / unit:.3g} {name}" for unit, name in ((1e9, "GB"), (1e6, "MB"), (1, "bytes")) if count >= unit
    )


def _line(source: str, name: str, element: Element) -> Drawn:
    mode = text_of(element, "altitudeMode") or "clampToGround"
    where = f"'{name}'" if name else "its LineString"
    points = tuple(_points(source, where, text_of(element, "coordinates"), mode))
    return Drawn(name, points, _lacking(mode))


def _of_points(source: str, elements: list[Element]) -> Drawn:
    points, mode = [], "clampToGround"
    for i, element in enumerate(elements):
        mode = text_of(element, "altitudeMode") or "clampToGround"
        points += list(_points(source, f"Point {i + 1}", text_of(element, "coordinates"), mode))
    return Drawn("", tuple(points), _lacking(mode))


def _lacking(mode: str) -> str:
    return (
        "has points without altitudes" if mode in _ABOVE else f"is on the ground (altitudeMode {shortened(mode, 40)})"
    )


def _points(source: str, where: str, text: str, mode: str) -> Iterator[Point]:
    above = _ABOVE.get(mode)
    for number, numbers in enumerate(_tuples(source, where, text), 1):
        place = f"{where}, point {number}"
        latitude, longitude = checked_place(source, place, numbers[1], numbers[0])
        if above is None or len(numbers) < 3:
            yield Point(latitude, longitude)
        else:
            yield Point(latitude, longitude, checked_altitude(source, place, numbers[2]), above)


def _tuples(source: str, where: str, text: str) -> Iterator[list[float]]:
    """Yield longitude, latitude [deg] and perhaps altitude [m] of each tuple of a coordinates element."""
    tuples = text.split()
    check_count(source, where, len(tuples))
    for i, words in enumerate(tuples, 1):
        try:
            numbers = [float(word) for word in words.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) not in (2, 3) or not all(map(math.isfinite, numbers)):
            raise UsageError(
                f"{source}: {where}, point {i}: '{shortened(words, 60)}'; expected longitude,latitude or "
                "longitude,latitude,altitude"
            )
        yield numbers


def _polygons(source: str, marks: list[Element]) -> Iterator[FencePolygon]:
    """Yield the polygons of placemarks with their holes, as places to stay in."""
    for mark in marks:
        name = text_of(mark, "name")
        for element in mark.iter():
            if tag(element) == "Polygon":
                where = f"polygon '{name}'" if name else "polygon (without a name)"
                outer = _rings(source, where, element, "outerBoundaryIs")
                if len(outer) != 1:
                    raise UsageError(f"{source}: {where}: expected one outerBoundaryIs, found {len(outer)}")
                yield FencePolygon(True, outer[0], tuple(_rings(source, where, element, "innerBoundaryIs")), name)


def _rings(source: str, where: str, element: Element, boundary: str) -> list[Corners]:
    found = []
    for ring in (ring for each in children(element, boundary) for ring in children(each, "LinearRing")):
        corners = [
            checked_place(source, f"{where}, corner {i}", numbers[1], numbers[0])
            for i, numbers in enumerate(_tuples(source, where, text_of(ring, "coordinates")))
        ]
        found.append(closed_ring(source, where, corners))
    return found
