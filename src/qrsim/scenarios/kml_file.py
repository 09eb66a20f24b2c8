"""Reading the polygons of KML 2.2 files, for fences."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

from qrsim.errors import UsageError, did_you_mean, readable
from qrsim.files.user_files import LARGEST_TEXT, read_bytes
from qrsim.models.scene.fence import polygon_problems
from qrsim.scenarios.plans.xml import children, tag, text_of, xml_root

GEOMETRIES = ("Point", "LineString", "LinearRing", "Polygon", "Model", "Track", "MultiTrack")
# Names in one message.
MOST_NAMES = 20


@dataclass(frozen=True)
class KmlPolygon:
    """A polygon of a KML file.

    Attributes:
        name: of its placemark, "" where it has none.
        vertices: latitude and longitude [deg] of each corner; the last is joined to the first, which is not repeated.
        altitudes: of each corner [m], as written, 0 where the file has none; a fence does not use them.
        holes: corners of each hole, as ``vertices``.
    """

    name: str
    vertices: tuple[tuple[float, float], ...]
    altitudes: tuple[float, ...]
    holes: tuple[tuple[tuple[float, float], ...], ...] = ()


def read_fence(path: str | Path, name: str | None = None) -> KmlPolygon:
    """Read the polygon of a KML file, or the named one.

    Points, lines and other features are passed over. Polygons whose placemarks have the same name, or that share one
    by a MultiGeometry, are 'NAME #1', 'NAME #2' and so on in the order of the file.

    Args:
        path: the file.
        name: of the polygon's placemark; may be left out where the file has one polygon only.

    Raises:
        UsageError: the file is no KML, has no such polygon or several, or one that has a hole or is not simple.
    """
    found = _polygon_elements(str(path))
    names = _own_names([each for each, _ in found])
    chosen = [i for i, (each, _) in enumerate(found) if name in (None, each, names[i])]
    if not chosen:
        raise UsageError(
            f"{path}: no polygon is called '{name}'{did_you_mean(str(name), [each for each in names if each])}"
        )
    if len(chosen) > 1:
        many = f"has {len(found)} polygons" if name is None else f"{len(chosen)} polygons are called '{name}'"
        first = ", ".join(_called(names[i]) for i in chosen[:MOST_NAMES]) + (
            ", ..." if len(chosen) > MOST_NAMES else ""
        )
        raise UsageError(f"{path}: {many}; choose one by its name: {first}")
    return _polygon(str(path), *found[chosen[0]])


def read_polygons(path: str | Path, name: str | None = None) -> list[KmlPolygon]:
    """Read all polygons of a KML file with their holes, or all of one name.

    Args:
        path: the file.
        name: of the polygons' placemarks, or of one polygon as in ``read_fence``; None: all.

    Raises:
        UsageError: the file is no KML, has no such polygon, or one that is not simple.
    """
    found = _polygon_elements(str(path))
    names = _own_names([each for each, _ in found])
    chosen = [i for i, (each, _) in enumerate(found) if name in (None, each, names[i])]
    if not chosen:
        hint = did_you_mean(str(name), [each for each in names if each])
        raise UsageError(f"{path}: no polygon is called '{name}'{hint}")
    return [_polygon(str(path), names[i], found[i][1], holes=True) for i in chosen]


def _own_names(names: list[str]) -> list[str]:
    """Return a name for each polygon: its own, with a number where others have the same."""
    counts, so_far, found = Counter(names), Counter[str](), []
    for name in names:
        so_far[name] += 1
        found.append(f"{name} #{so_far[name]}".strip() if counts[name] > 1 else name)
    return found


def _called(name: str) -> str:
    """Return the name of a placemark in quotes, or words for one without a name."""
    return f"'{name}'" if name else "(without a name)"


def _root(path: str) -> Element:
    """Return the document's first element."""
    with readable(path):
        data = read_bytes(path, LARGEST_TEXT)
    if data.startswith(b"PK"):
        raise UsageError(f"{path}: is a KMZ archive; unpack it and give the KML file inside, usually doc.kml")
    return xml_root(path, data, "KML")


def _polygon_elements(path: str) -> list[tuple[str, Element]]:
    """Return (name of the placemark, element) of each polygon; at least one."""
    placemarks = [element for element in _root(path).iter() if tag(element) == "Placemark"]
    found = [
        (text_of(placemark, "name"), element)
        for placemark in placemarks
        for element in placemark.iter()
        if tag(element) == "Polygon"
    ]
    if not found:
        others = Counter(tag(part) for placemark in placemarks for part in placemark.iter() if tag(part) in GEOMETRIES)
        words = ", ".join(f"{count} {kind}" for kind, count in others.items()) or "no geometry"
        raise UsageError(f"{path}: has no Polygon in a Placemark; found {words}")
    return found


def _polygon(path: str, name: str, element: Element, holes: bool = False) -> KmlPolygon:
    """Return a Polygon element; without ``holes``, one that has any is refused."""
    where = f"{path}: polygon {_called(name)}"
    if children(element, "innerBoundaryIs") and not holes:
        raise UsageError(
            f"{where}: has a hole (innerBoundaryIs), and a fence has none; give world.area of type zones with "
            "stay_in: [{file: ...}]"
        )
    outer = _rings(where, element, "outerBoundaryIs")
    if len(outer) != 1:
        raise UsageError(f"{where}: expected one outerBoundaryIs with a LinearRing with coordinates")
    vertices, *inner = (
        tuple((latitude, longitude) for latitude, longitude, _ in ring)
        for ring in [*outer, *_rings(where, element, "innerBoundaryIs")]
    )
    for ring in (vertices, *inner):
        for problem in polygon_problems(ring):
            raise UsageError(f"{where}: {problem}")
    return KmlPolygon(name, vertices, tuple(altitude for _, _, altitude in outer[0]), tuple(inner))


def _rings(where: str, element: Element, boundary: str) -> list[list[tuple[float, float, float]]]:
    """Return the corners of each boundary of a kind; the last, which repeats the first, is left out."""
    found = []
    for part in children(element, boundary):
        for ring in children(part, "LinearRing"):
            corners = list(_corners(where, text_of(ring, "coordinates")))
            if len(corners) > 1 and corners[0] == corners[-1]:
                corners.pop()
            found += [corners] if corners else []
    return found


def _corners(where: str, text: str) -> Iterator[tuple[float, float, float]]:
    """Yield (latitude [deg], longitude [deg], altitude [m]) of each tuple of a coordinates element."""
    for i, words in enumerate(text.split()):
        try:
            numbers = [float(word) for word in words.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) not in (2, 3) or not all(map(math.isfinite, numbers)):
            raise UsageError(
                f"{where}: corner {i}, '{words}': expected longitude,latitude or longitude,latitude,altitude"
            )
        longitude, latitude = numbers[:2]
        if abs(longitude) > 180.0 or abs(latitude) > 90.0:
            raise UsageError(
                f"{where}: corner {i}, '{words}': longitude comes first, within 180 degrees, then latitude, within 90"
            )
        yield latitude, longitude, numbers[2] if len(numbers) == 3 else 0.0
