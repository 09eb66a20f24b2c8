"""Virtual rasters (.vrt) as gdalbuildvrt writes them: a list of tiles, taken from the XML without GDAL.

GDAL's own reader of the format opens addresses of the network and runs functions on pixels, so it is not used.
"""

from __future__ import annotations

import contextlib
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from qrsim.errors import UsageError, shortened
from qrsim.files.user_files import LARGEST_TEXT, read_bytes

MOST_SOURCES = 400
# What a source may do to heights, and the number with which it does nothing.
_CHANGES = {"LUT": math.nan, "ScaleRatio": 1.0, "ScaleOffset": 0.0, "Exponent": 1.0, "ColorTableComponent": math.nan}
_KINDS = ("SimpleSource", "ComplexSource")


@dataclass(frozen=True)
class Source:
    """A file of a virtual raster.

    Attributes:
        file: its path.
        nodata: a further value for its missing heights, or None.
    """

    file: str
    nodata: float | None


class _Builder(ElementTree.TreeBuilder):
    """Refuses a document type before any of its entities is read: entities can grow without bound."""

    def doctype(self, name: str, pubid: str | None, system: str | None) -> NoReturn:
        """Raise _DocumentTypeError: XML files with a document type are refused."""
        raise _DocumentTypeError


class _DocumentTypeError(Exception):
    pass


def read_vrt(file: str) -> tuple[Source, ...]:
    """Return the source files of a virtual raster (.vrt), topmost first: the file lists the topmost last.

    Raises:
        UsageError: it is no virtual raster, computes something, or names files outside its folder.
        OSError: there is no such file.
    """
    band = _band(file, _root(file, read_bytes(file, LARGEST_TEXT)))
    found: list[Source] = []
    own = _number(file, band.findtext("NoDataValue"))
    for element in band:
        if element.tag in _KINDS:
            found.append(_source(file, len(found) + 1, element, own))
        elif element.tag.endswith("Source"):
            raise UsageError(f"{file}: has a {shortened(element.tag, 40)}; allowed: {', '.join(_KINDS)}")
    if not found:
        raise UsageError(f"{file}: its band has no sources; expected those that gdalbuildvrt writes")
    if len(found) > MOST_SOURCES:
        raise UsageError(f"{file}: has {len(found)} sources; allowed: {MOST_SOURCES}")
    return tuple(reversed(found))


def _root(file: str, data: bytes) -> Element:
    """Return the root XML element of a .vrt file; raise UsageError for other XML."""
    parser = ElementTree.XMLParser(target=_Builder())
    try:
        parser.feed(data)
        root = parser.close()
    except _DocumentTypeError:
        raise UsageError(f"{file}: has a document type, which is not read") from None
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise UsageError(f"{file}: is no XML: {error}") from None
    if root.tag != "VRTDataset":
        raise UsageError(f"{file}: begins with <{shortened(root.tag, 40)}>; expected <VRTDataset>")
    return root


def _band(file: str, root: Element) -> Element:
    """Return the only band of a .vrt file; raise UsageError for several bands, or for one computed by a function."""
    if root.get("subClass"):
        raise UsageError(f"{file}: is a {shortened(str(root.get('subClass')), 40)}; expected what gdalbuildvrt writes")
    bands = root.findall("VRTRasterBand")
    if len(bands) != 1:
        raise UsageError(f"{file}: has {len(bands)} bands; expected one, the heights")
    if kind := bands[0].get("subClass"):
        raise UsageError(f"{file}: its band is a {shortened(kind, 40)}; expected what gdalbuildvrt writes")
    return bands[0]


def _source(file: str, number: int, element: Element, own: float | None) -> Source:
    """Return file name and missing value of a .vrt file's source; raise UsageError for one that changes heights."""
    name = element.find("SourceFilename")
    text = "" if name is None else (name.text or "").strip()
    if not text:
        raise UsageError(f"{file}: source {number} has no SourceFilename")
    for tag, neutral in _CHANGES.items():
        value = element.findtext(tag)
        if value is not None and not _is(value, neutral):
            raise UsageError(f"{file}: source {number} has {tag}, which changes heights; expected heights as they are")
    if (element.findtext("SourceBand") or "1").strip() != "1":
        raise UsageError(f"{file}: source {number} takes band {element.findtext('SourceBand')}; expected 1")
    folder = Path(os.path.expanduser(file)).resolve().parent
    path = None
    if not text.startswith("/vsi") and "://" not in text:
        # An absolute one is refused below unless it is in the folder. Loops of links, and names that no file can have:
        with contextlib.suppress(OSError, RuntimeError, ValueError):
            path = (folder / text).resolve()
    if path is None or not path.is_relative_to(folder):
        raise UsageError(
            f"{file}: source {number}, {shortened(repr(text), 60)}, is not in its folder; only files in "
            "that folder are read"
        )
    nodata = _number(file, element.findtext("NODATA"))
    return Source(str(path), own if nodata is None else nodata)


def _is(text: str, number: float) -> bool:
    """Return whether ``text`` is a number equal to ``number``."""
    try:
        return float(text) == number
    except ValueError:
        return False


def _number(file: str, text: str | None) -> float | None:
    """Return the missing value that a text gives as a number; None for no text and for NaN."""
    if text is None:
        return None
    try:
        number = float(text)
    except ValueError:
        raise UsageError(f"{file}: the missing height {shortened(repr(text), 40)} is no number") from None
    return number if math.isfinite(number) else None
