"""XML of users, parsed without document types: their entities can grow without bound."""

from __future__ import annotations

from typing import NoReturn
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from qrsim.errors import UsageError


class _Builder(ElementTree.TreeBuilder):
    """Refuses a document type before any of its entities is read."""

    def doctype(self, name: str, pubid: str | None, system: str | None) -> NoReturn:
        """Raise _DocumentTypeError for a document type, which may define entities that expand without limit."""
        raise _DocumentTypeError


class _DocumentTypeError(Exception):
    pass


def xml_root(path: str, data: bytes, kind: str) -> Element:
    """Parse an XML document and return its root element; raises UsageError if it is not of ``kind``.

    Args:
        path: of the file, for messages.
        data: its content.
        kind: of the file and, in lower case, the tag of its first element: "KML" or "GPX".

    Raises:
        UsageError: it is no XML, or of another kind.
    """
    parser = ElementTree.XMLParser(target=_Builder())
    try:
        parser.feed(data)
        root: Element = parser.close()
    except _DocumentTypeError:
        raise UsageError(f"{path}: has a document type (<!DOCTYPE), which {kind} has not; remove it") from None
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise UsageError(f"{path}: is not XML: {error}") from None
    if tag(root) != kind.lower():
        raise UsageError(f"{path}: is not {kind}: its first element is <{tag(root)}>, expected <{kind.lower()}>")
    return root


def tag(element: Element) -> str:
    """Return the tag of an XML element without its namespace."""
    return element.tag.rpartition("}")[2]


def children(element: Element, name: str) -> list[Element]:
    """Return the child elements with a tag, in any namespace."""
    return [child for child in element if tag(child) == name]


def text_of(element: Element, name: str) -> str:
    """Return the text of the first child element with a tag; "" without one."""
    return "".join((child.text or "").strip() for child in children(element, name)[:1])
