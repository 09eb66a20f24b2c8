"""The messages of a ULog, walked and bounded before pyulog sees them: damaged ones can hang it."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any

from qrsim import extras
from qrsim.errors import LogError
from qrsim.files.user_files import read_bytes

HEADER_BYTES = 16
# Message header: payload size (uint16), type (a letter).
_HEAD = 3
# Types of the ULog format, version 1 with its appended sections.
TYPES = frozenset(b"BFIMPQARDLCSO")
# Payload of a message of type S, by which a reader finds its place again.
SYNC = bytes((0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12))


def open_ulog(path: Path, topics: list[str]) -> tuple[Any, list[str]]:
    """Return pyulog's view of some topics of a log, and notes about what is damaged.

    Raises:
        LogError: it cannot be read.
        RunError: pyulog is not installed.
    """
    pyulog = extras.load("identify", "reading a ULog", "pyulog")
    content, notes = whole_messages(read_bytes(path))
    try:
        # The library prints its complaints, one for each message that it cannot place.
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            log = pyulog.ULog(io.BytesIO(content), topics)
    except Exception as error:  # pyulog raises whatever its parsing runs into
        raise LogError(f"{path}: a ULog that cannot be read: {error or type(error).__name__}") from None
    if log.file_corruption and not notes:
        notes.append("the file is damaged; what can be read between the damaged parts is used")
    return log, notes


def whole_messages(content: bytes) -> tuple[bytes, list[str]]:
    """Return the header and every whole message of a known type, and notes about what is left out.

    After a damaged message reading goes on at the next synchronisation message.
    """
    kept, place, notes = [content[:HEADER_BYTES]], HEADER_BYTES, []
    damaged = False
    while place + _HEAD <= len(content):
        end = place + _HEAD + int.from_bytes(content[place : place + 2], "little")
        if content[place + 2] in TYPES and end <= len(content):
            kept.append(content[place:end])
            place = end
            continue
        # A type that no log has, or a length beyond the end: of a cut, or of damage before it.
        found = content.find(SYNC, place + _HEAD)
        if found < 0:
            break
        damaged, place = True, found - _HEAD
    if damaged:
        notes.append("the file is damaged; what can be read between the damaged parts is used")
    if place < len(content):
        notes.append(f"the file ends inside a message: the last {len(content) - place} bytes are lost (log cut off)")
    return b"".join(kept), notes
