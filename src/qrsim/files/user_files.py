"""Opens users' files: regular files only, up to a size limit, and never blocking."""

from __future__ import annotations

import errno
import io
import os
import stat
from pathlib import Path
from typing import BinaryIO

# Of text that is read whole: scenarios, studies, plans, fences.
LARGEST_TEXT = 16 * 2**20
# Of ephemerides and winds, and of logs.
LARGEST_TABLE, LARGEST_DATA = 64 * 2**20, 2**30
_KINDS = (
    (stat.S_ISFIFO, "it is a pipe"),
    (stat.S_ISSOCK, "it is a socket"),
    (stat.S_ISCHR, "it is a device"),
    (stat.S_ISBLK, "it is a device"),
)


def open_file(path: str | os.PathLike[str], most: int = LARGEST_DATA) -> BinaryIO:
    """Open a user's file for reading bytes; raises an error unless it is a regular file of at most ``most`` bytes.

    Args:
        path: as the user gave it; ``~`` is the user's home.
        most: largest size [bytes].

    Raises:
        OSError: there is no such file, it is a folder, a pipe, a socket or a device, or it is too large; its strerror
            says which.
    """
    name = os.fspath(path)
    if "\0" in name:
        raise OSError(errno.EINVAL, "its name has a null byte in it", name)
    # Without O_NONBLOCK, opening a pipe waits for somebody to write to it.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
    try:
        handle = os.open(os.path.expanduser(name), flags)
    except UnicodeEncodeError:
        raise OSError(errno.EINVAL, "its name is no text that a file can have", name) from None
    try:
        status = os.fstat(handle)
        if stat.S_ISDIR(status.st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), name)
        if not stat.S_ISREG(status.st_mode):
            kind = next((words for test, words in _KINDS if test(status.st_mode)), "it is no regular file")
            raise OSError(errno.EINVAL, f"{kind}; expected a file", name)
        if status.st_size > most:
            raise OSError(errno.EFBIG, f"it has {_size(status.st_size)}; allowed: up to {_size(most)}", name)
    except OSError:
        os.close(handle)
        raise
    return os.fdopen(handle, "rb")


def open_text(path: str | os.PathLike[str], most: int = LARGEST_DATA, errors: str = "strict") -> io.TextIOWrapper:
    """Open a user's UTF-8 file as text for ``csv``, with limits as ``open_file``; a byte order mark is skipped."""
    return io.TextIOWrapper(open_file(path, most), encoding="utf-8-sig", errors=errors, newline="")


def read_bytes(path: str | os.PathLike[str], most: int = LARGEST_DATA) -> bytes:
    """Read a user's file of at most ``most`` bytes; raises as ``open_file``."""
    with open_file(path, most) as file:
        content = file.read(most + 1)
    # Files of /proc have no size before they are read.
    if len(content) > most:
        raise OSError(errno.EFBIG, f"it has more than {_size(most)}", os.fspath(path))
    return content


def read_text(path: str | os.PathLike[str], most: int = LARGEST_TEXT) -> str:
    """Read a user's UTF-8 file of at most ``most`` bytes as text, without a byte order mark; raises as ``open_file``.

    Raises:
        OSError: as ``open_file``, and where it is no UTF-8 text; the strerror says where.
    """
    content = read_bytes(path, most)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        found = f"byte 0x{content[error.start]:02x} in line {line} is no UTF-8 text"
        raise OSError(errno.EILSEQ, found, os.fspath(path)) from None


def check_file(path: str | os.PathLike[str], most: int = LARGEST_DATA) -> Path:
    """Check a user's file, which a library will open, as ``open_file`` does; return its path with ``~`` expanded."""
    open_file(path, most).close()
    return Path(os.path.expanduser(path))


def _size(count: int) -> str:
    """Return a number of bytes as text, in MB or GB if it is large."""
    for factor, unit in ((2**30, "GB"), (2**20, "MB")):
        if count >= factor:
            return f"{count / factor:.4g} {unit}"
    return f"{count} bytes"
