"""Messages whose strings and lengths stay: bytes of CDR, in which numbers are put at their places."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Any

from rosbags.interfaces import Nodetype

from qrsim.links.ros2 import Message
from qrsim.links.ros2.typestore import Types

HEADER = 4
_CODES = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "uint8": "B",
    "int8": "b",
    "uint16": "H",
    "int16": "h",
    "uint32": "I",
    "int32": "i",
    "uint64": "Q",
    "int64": "q",
    "float32": "f",
    "float64": "d",
}
Put = Callable[..., None]


class Template:
    """A message as bytes.

    Args:
        types: of the distribution.
        message: of rosbags; its numbers can be changed, its strings and lengths not.

    Attributes:
        cdr: the bytes, with the header of CDR.
        places: of each number or array of numbers, its offset, format of ``struct`` and count, by its dotted path.
    """

    def __init__(self, types: Types, message: Message):
        self._types = types
        self.cdr = bytearray(types.encode(message))
        self.places: dict[str, tuple[int, str, int]] = {}
        # Where something begins, numbers, lengths and texts.
        self._taken: set[int] = set()
        self._scan_message("", message.__msgtype__, message, 0)

    def putter(self, *paths: str) -> Put:
        """Return a function that writes its arguments into the encoded message at field paths such as "pose.x", in that
        order.

        Args:
            paths: such as "pose.covariance", or "pose.covariance[7]" for one element.

        Raises:
            KeyError: the message has no number there.
        """
        runs: list[tuple[int, str]] = []
        end = -1
        for path in paths:
            offset, code, count = self.slot(path)
            gap = offset - end
            if runs and 0 <= gap < 8 and not any(at in self._taken for at in range(end, offset)):
                runs[-1] = (runs[-1][0], f"{runs[-1][1]}{'x' * gap}{count}{code}")
            else:
                runs.append((offset, f"<{count}{code}"))
            end = offset + count * struct.calcsize(f"<{code}")
        return _putter(self.cdr, runs)

    def slot(self, path: str) -> tuple[int, str, int]:
        """Return (byte offset, struct code, count) of a field path, such as "pose.x" or "covariance[4]"; raises
        KeyError."""
        if path in self.places:
            return self.places[path]
        array, _, rest = path.partition("[")
        offset, code, count = self.places[array]
        number = int(rest.rstrip("]"))
        if not 0 <= number < count:
            raise KeyError(path)
        return offset + number * struct.calcsize(f"<{code}"), code, 1

    def _scan_message(self, prefix: str, name: str, message: object, at: int) -> int:
        """Store the byte offsets of all numbers of a nested message that begins at ``at``, and return its end;
        ``prefix``: its path."""
        for field, description in self._types.fields(name):
            at = self._scan_field(f"{prefix}{field}", description, getattr(message, field), at)
        return at

    def _scan_field(self, path: str, description: Any, value: Any, at: int) -> int:
        """Store the byte offsets of the numbers of a field that begins at ``at``, and return its end."""
        kind, content = description
        if kind == Nodetype.NAME:
            return self._scan_message(f"{path}.", content, value, at)
        if kind == Nodetype.BASE:
            if content[0] == "string":
                at = self._aligned(at, 4)
                return at + 4 + len(value.encode()) + 1
            return self._scan_numbers(path, content[0], 1, at)
        if kind == Nodetype.SEQUENCE:
            at = self._aligned(at, 4) + 4
        element, base = content[0]
        if element == Nodetype.BASE and base[0] != "string":
            return self._scan_numbers(path, base[0], len(value), at) if len(value) else at
        for number, each in enumerate(value):
            at = self._scan_field(f"{path}.{number}", content[0], each, at)
        return at

    def _scan_numbers(self, path: str, base: str, count: int, at: int) -> int:
        """Store the byte offset of ``count`` numbers of a type (``base``), aligned to their size, and return their
        end."""
        code = _CODES[base]
        size = struct.calcsize(f"<{code}")
        at = self._aligned(at, size)
        self.places[path] = HEADER + at, code, count
        return at + size * count

    def _aligned(self, at: int, size: int) -> int:
        """Return the next offset from ``at`` on that is a multiple of ``size``."""
        at += -at % size
        self._taken.add(HEADER + at)
        return at


def _putter(cdr: bytearray, runs: Sequence[tuple[int, str]]) -> Put:
    """Return a function that packs its arguments into the encoded message ``cdr`` at runs of (byte offset, struct
    format)."""
    parts, first = [], 0
    for offset, form in runs:
        packer = struct.Struct(form)
        count = len(packer.unpack(bytes(packer.size)))
        parts.append((packer.pack_into, offset, slice(first, first + count)))
        first += count
    if len(parts) == 1:
        pack_into, offset, _ = parts[0]

        def put_once(*values: float) -> None:
            """Pack all numbers at the only stored byte offset."""
            pack_into(cdr, offset, *values)

        return put_once

    def put(*values: float) -> None:
        """Pack the numbers at the stored byte offsets, in order; raises ValueError for a wrong count."""
        if len(values) != first:
            raise ValueError(f"{len(values)} numbers; expected {first}")
        for pack_into, offset, own in parts:
            pack_into(cdr, offset, *values[own])

    return put
