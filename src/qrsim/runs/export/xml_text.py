"""XML written element by element, so that a long track is never a tree in memory."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Mapping
from typing import BinaryIO
from xml.sax.saxutils import XMLGenerator
from xml.sax.xmlreader import AttributesImpl

_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


class XmlText:
    """Writes one document."""

    def __init__(self, file: BinaryIO):
        self._out = XMLGenerator(file, encoding="utf-8", short_empty_elements=True)
        self._out.startDocument()
        self._depth = 0

    @contextlib.contextmanager
    def element(self, name: str, attributes: Mapping[str, str] | None = None) -> Iterator[None]:
        """Open an element for the length of a block."""
        self._begin_line()
        self._out.startElement(name, _clean_all(attributes))
        self._depth += 1
        yield
        self._depth -= 1
        self._begin_line()
        self._out.endElement(name)

    def leaf(self, name: str, text: str, attributes: Mapping[str, str] | None = None) -> None:
        """Write an element that holds text; characters that XML cannot say become U+FFFD."""
        self._begin_line()
        self._out.startElement(name, _clean_all(attributes))
        self._out.characters(_clean(text))
        self._out.endElement(name)

    def _begin_line(self) -> None:
        self._out.ignorableWhitespace("\n" + " " * self._depth)


def _clean(text: str) -> str:
    return _NOT_XML.sub("\ufffd", text)


def _clean_all(attributes: Mapping[str, str] | None) -> AttributesImpl[str]:
    return AttributesImpl({name: _clean(value) for name, value in (attributes or {}).items()})
