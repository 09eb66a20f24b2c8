"""The messages of a ULog, walked and bounded before pyulog sees them: damaged ones can hang it."""

from __future__ import annotations

import contextlib
import io
import struct
from pathlib import Path
from typing import Any

from qrsim import extras
from qrsim.errors import LogError
from qrsim.files.user_files import read_bytes

_HEADER = 16
# Message header: payload size (uint16), type (a letter).
_HEAD = 3
# Message types that pyulog takes in each section. Others it may read again byte by byte, for ever, so it gets none.
_DEFINITIONS, _DATA = b"FIMPQ", b"AIMPQLCDSO"
# All types of the ULog format, and those of which the first begins the data section.
_TYPES, _BEGINNING = b"BFIMPQARDLCSO", b"ALC"
# Payload of a message of type S, by which a reader finds its place again.
_SYNC = bytes((0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12))
_SYNC_MESSAGE = b"\x08\x00S" + _SYNC
# Offsets of appended data in the flags, a message of type B that comes first.
_OFFSETS, _OFFSETS_AT = struct.Struct("<3Q"), _HEAD + 16
# Fields of all subscribed topics. PX4 logs have some ten thousand; pyulog makes an object for each.
MOST_FIELDS = 200_000
_DEEPEST = 20


def open_ulog(path: Path, topics: list[str]) -> tuple[Any, list[str]]:
    """Read some topics of a ULog with pyulog; return its object, and notes on damage.

    Raises:
        LogError: it cannot be read.
        RunError: pyulog is not installed.
    """
    pyulog = extras.load("identify", "reading a ULog", "pyulog")
    messages, notes = whole_messages(read_bytes(path))
    try:
        # The library prints its complaints, one for each message that it cannot place.
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            _check_fields(messages, pyulog.ULog.MessageFormat)
            log = pyulog.ULog(io.BytesIO(b"".join(messages)), topics)
    except Exception as error:  # pyulog raises whatever its parsing runs into
        raise LogError(f"{path}: a ULog that cannot be read: {error or type(error).__name__}") from None
    if log.file_corruption and not notes:
        notes.append("the file is damaged; only the parts that can be read are used")
    return log, notes


def whole_messages(content: bytes) -> tuple[list[bytes], list[str]]:
    """Return the header and every complete message of a ULog, by section, and notes on what was dropped.

    After a damaged message reading goes on at the next synchronisation message. Data that PX4 appends after a crash
    begins where the log was cut; here it follows the last whole message, and the flags have no offsets.
    """
    kept, place, lost, damaged, defining = [content[:_HEADER]], _HEADER, 0, False, True
    for end in (*_appended_offsets(content), len(content)):
        while place + _HEAD <= end:
            following = place + _HEAD + int.from_bytes(content[place : place + 2], "little")
            kind = content[place + 2]
            if kind in _TYPES and following <= end:
                defining = defining and kind not in _BEGINNING
                if kind in (_DEFINITIONS if defining else _DATA):
                    kept.append(content[place:following])
                elif kind == ord("B") and place == _HEADER:
                    kept.append(_without_offsets(content[place:following]))
                place = following
                continue
            # A type that no log has, or a length beyond the end: of a cut, or of damage before it.
            found = content.find(_SYNC, place, end)
            if found < 0:
                break
            damaged, place = True, found + len(_SYNC)
            kept.append(_SYNC_MESSAGE)
        lost, place = end - place, end
    notes = []
    if damaged:
        notes.append("the file is damaged; only the parts that can be read are used")
    if lost > 0:
        notes.append(f"the file ends inside a message: the last {lost} bytes are lost (log cut off)")
    return kept, notes


def _appended_offsets(content: bytes) -> list[int]:
    """Return the file offsets of a ULog's appended data, in ascending order."""
    end = _HEADER + _OFFSETS_AT + _OFFSETS.size
    if len(content) < end or content[_HEADER + 2] != ord("B"):
        return []
    return sorted(at for at in _OFFSETS.unpack_from(content, _HEADER + _OFFSETS_AT) if end <= at < len(content))


def _without_offsets(flags: bytes) -> bytes:
    """Return a ULog's flag bits with the offsets of appended data set to zero."""
    after = _OFFSETS_AT + _OFFSETS.size
    return flags[:_OFFSETS_AT] + bytes(len(flags[_OFFSETS_AT:after])) + flags[after:]


def _check_fields(messages: list[bytes], form: Any) -> None:
    """Raise ValueError for topics with so many nested fields that pyulog would take hours.

    Raises:
        ValueError: too many, or formats nested too deeply or in themselves.
    """
    formats: dict[str, list[tuple[str, int, str]]] = {}
    counts: dict[str, int] = {}

    def count(name: str, depth: int) -> int:
        """Return the number of fields of a message format, those of nested formats included."""
        if depth > _DEEPEST:
            raise ValueError(f"its formats are nested more than {_DEEPEST} deep")
        if name not in formats:
            return 1
        if name not in counts:
            # A format counts too: many that have no fields take as long.
            counts[name] = 1 + sum((size or 1) * count(kind, depth + 1) for kind, size, _ in formats[name])
        return counts[name]

    total = 0
    for message in messages[1:]:
        if message[2] == ord("F"):
            with contextlib.suppress(IndexError, ValueError):  # as pyulog does
                found = form(message[_HEAD:].decode("utf-8", "ignore").encode(), None)
                formats[found.name] = found.fields
        elif message[2] == ord("A"):
            total += count(message[_HEAD + 3 :].decode("utf-8", "ignore"), 0)
            if total > MOST_FIELDS:
                raise ValueError(f"its topics have more than {MOST_FIELDS} fields in all")
