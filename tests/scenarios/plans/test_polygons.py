"""Polygons of KML files and KMZ archives: which are found, which one is chosen, and every bad file."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from qrsim.errors import UsageError
from qrsim.scenarios.plans.polygons import read_outline, read_polygons

Write = Callable[[str], str]
NAMESPACE = ' xmlns="http://www.opengis.net/kml/2.2"'
SQUARE = "8.0,47.0 8.1,47.0 8.1,47.2 8.0,47.2"
TRIANGLE = "9.0,46.0 9.1,46.0 9.0,46.1"


def polygon(coordinates: str, inner: str = "") -> str:
    ring = f"<LinearRing><coordinates>{coordinates}</coordinates></LinearRing>"
    holes = f"<innerBoundaryIs>{ring.replace(coordinates, inner)}</innerBoundaryIs>" if inner else ""
    return f"<Polygon><outerBoundaryIs>{ring}</outerBoundaryIs>{holes}</Polygon>"


def placemark(name: str | None, content: str) -> str:
    return f"<Placemark>{'' if name is None else f'<name>{name}</name>'}{content}</Placemark>"


def kml(*parts: str, namespace: str = NAMESPACE) -> str:
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<kml{namespace}><Document>{"".join(parts)}</Document></kml>'


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write_it(text: str) -> str:
        path = tmp_path / "field.kml"
        path.write_text(text, encoding="utf-8")
        return str(path)

    return write_it


@pytest.mark.parametrize("namespace", [NAMESPACE, "", ' xmlns="http://earth.google.com/kml/2.1"'])
@pytest.mark.parametrize("last", ["", " 8.0,47.0"], ids=["open", "closed"])
def test_the_only_polygon(write: Write, namespace: str, last: str) -> None:
    path = write(kml(placemark("field", polygon(SQUARE + last)), namespace=namespace))
    assert read_outline(path) == ((47.0, 8.0), (47.0, 8.1), (47.2, 8.1), (47.2, 8.0))
    (found,) = read_polygons(path, "field")
    assert (found.name, found.holes, found.inclusion) == ("field", (), True)


def test_altitudes_and_any_space_between_corners(write: Write) -> None:
    text = "\n\t-8.5,-47.0,100\n   -8.4,-47.0,110.5\n\n -8.4,-46.9,120\n -8.5,-47.0,100\n"
    found = read_outline(write(kml(placemark("south", polygon(text)))))
    assert found == ((-47.0, -8.5), (-47.0, -8.4), (-46.9, -8.4))


def test_polygons_are_found_at_any_depth_among_other_things(write: Write) -> None:
    inner = placemark(" inner field ", f"<MultiGeometry>{polygon(TRIANGLE)}</MultiGeometry>")
    deep = f"<Folder><Folder>{inner}</Folder></Folder>"
    point = placemark("mast", "<Point><coordinates>8.0,47.0</coordinates></Point>")
    path = write(kml("<name>my document</name>", point, deep, placemark(None, polygon(SQUARE))))
    found = [(each.name, len(each.vertices)) for each in read_polygons(path)]
    assert found == [("inner field", 3), ("", 4)]
    assert read_outline(path, "inner field")[0] == (46.0, 9.0)
    assert read_outline(path, "")[0] == (47.0, 8.0)
    # What is wrong with a polygon that is not asked for does not matter.
    path = write(kml(placemark("bad", polygon("1,2")), placemark("good", polygon(SQUARE))))
    assert len(read_outline(path, "good")) == 4


def test_of_several_polygons_of_a_placemark_one_is_chosen(write: Write) -> None:
    path = write(kml(placemark("field", f"<MultiGeometry>{polygon(SQUARE)}{polygon(TRIANGLE)}</MultiGeometry>")))
    assert read_outline(path, "field #1")[0] == (47.0, 8.0)
    assert read_outline(path, "field #2")[0] == (46.0, 9.0)
    path = write(kml(placemark(None, f"<MultiGeometry>{polygon(SQUARE)}{polygon(TRIANGLE)}</MultiGeometry>")))
    assert read_outline(path, "#2")[0] == (46.0, 9.0)
    assert [each.name for each in read_polygons(path)] == ["", ""]


def test_an_archive(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "field.kmz", "w") as archive:
        archive.writestr("doc.kml", kml(placemark("field", polygon(SQUARE, TRIANGLE))))
    (found,) = read_polygons(str(tmp_path / "field.kmz"))
    assert (len(found.vertices), [len(hole) for hole in found.holes]) == (4, [3])


ENTITY = '<!DOCTYPE kml [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>'
BAD: dict[str, tuple[str, str | None, str]] = {
    # The text, the name asked for, and words of the message.
    "empty": ("", None, "is not XML: no element found"),
    "no XML": ("8.0,47.0 8.1,47.0", None, "is not XML: syntax error: line 1, column 0"),
    "cut off": (kml(placemark("field", polygon(SQUARE)))[:-20], None, "is not XML: unclosed token"),
    "document type": (
        ENTITY + f"<kml>{placemark('&b;', polygon(SQUARE))}</kml>",
        None,
        "has a document type (<!DOCTYPE), which KML has not",
    ),
    "another format": ("<gpx><trk/></gpx>", None, "is not KML: its first element is <gpx>, expected <kml>"),
    "nothing": (kml(), None, "has no Polygon in a Placemark; found no geometry"),
    "lines only": (
        kml(*[placemark("path", "<LineString/>")] * 2, placemark("mast", "<Point/>")),
        None,
        "has no Polygon in a Placemark; found 2 LineString, 1 Point",
    ),
    "several": (
        kml(
            placemark("north", polygon(SQUARE)),
            *[placemark("south", polygon(TRIANGLE))] * 2,
            placemark(None, polygon(SQUARE)),
        ),
        None,
        "has 4 polygons; choose one by its name: 'north', 'south #1', 'south #2', (without a name)",
    ),
    "several of a name": (
        kml(placemark("field", f"<MultiGeometry>{polygon(SQUARE)}{polygon(TRIANGLE)}</MultiGeometry>")),
        "field",
        "2 polygons are called 'field'; choose one by its name: 'field #1', 'field #2'",
    ),
    "no such name": (
        kml(placemark("north", polygon(SQUARE)), placemark("south", polygon(TRIANGLE))),
        "nort",
        "no polygon is called 'nort'; did you mean 'north'?",
    ),
    "no name like it": (
        kml(placemark("north", polygon(SQUARE)), placemark("south", polygon(TRIANGLE))),
        "x",
        "no polygon is called 'x'; known: north, south",
    ),
    "hole": (
        kml(placemark("field", polygon(SQUARE, inner=TRIANGLE))),
        None,
        "polygon 'field' has a hole, and a fence has none; give world.area of type zones with stay_in: [{file: ...}]",
    ),
    "no ring": (
        kml(placemark("field", "<Polygon/>")),
        None,
        "polygon 'field': expected one outerBoundaryIs with a LinearRing with coordinates",
    ),
    "no coordinates": (
        kml(placemark(None, polygon(" "))),
        None,
        "polygon (without a name): expected one outerBoundaryIs with a LinearRing with coordinates",
    ),
    "two corners": (
        kml(placemark("field", polygon("8,47 8.1,47 8,47"))),
        None,
        "polygon 'field': has 2 corners; a polygon needs at least 3",
    ),
    "crossing": (
        kml(placemark("field", polygon("8.0,47.0 8.1,47.2 8.1,47.0 8.0,47.2"))),
        None,
        "polygon 'field': crosses itself: the edge from corner 0 to 1 meets the edge from corner 2 to 3",
    ),
    "space after the comma": (
        kml(placemark("field", polygon("8.0, 47.0 8.1, 47.0"))),
        None,
        "polygon 'field', corner 0: '8.0,'; expected longitude,latitude or longitude,latitude,altitude",
    ),
    "one number": (
        kml(placemark("field", polygon("8,47 8.1"))),
        None,
        "polygon 'field', corner 1: '8.1'; expected longitude,latitude",
    ),
    "not finite": (
        kml(placemark("field", polygon("8,47 nan,47"))),
        None,
        "polygon 'field', corner 1: 'nan,47'; expected longitude",
    ),
    "latitude first": (
        kml(placemark("field", polygon("8,47 47,147 8,48"))),
        None,
        "polygon 'field', corner 1: latitude 147; allowed: -90 to 90 deg; is it longitude, latitude?",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_files(write: Write, case: str) -> None:
    text, name, words = BAD[case]
    path = write(text)
    with pytest.raises(UsageError) as caught:
        read_outline(path, name)
    assert str(caught.value).startswith(f"{path}: {words}")


def test_a_document_type_is_refused_in_any_encoding(tmp_path: Path) -> None:
    path = tmp_path / "field.kml"
    path.write_bytes(f'<?xml version="1.0" encoding="UTF-16"?>{ENTITY}<kml>&b;</kml>'.encode("utf-16"))
    with pytest.raises(UsageError, match="has a document type"):
        read_outline(str(path))


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"nowhere\.kml: cannot be read: No such file"):
        read_outline(str(tmp_path / "nowhere.kml"))
    archive = tmp_path / "field.kmz"
    archive.write_bytes(b"PK\x03\x04rest")
    with pytest.raises(UsageError, match=r"field\.kmz: is no KMZ archive: "):
        read_outline(str(archive))
    odd = tmp_path / "odd.kml"
    odd.write_bytes(b'<?xml version="1.0" encoding="no-such-code"?><kml/>')
    with pytest.raises(UsageError, match=r"odd\.kml: is not XML: "):
        read_outline(str(odd))
