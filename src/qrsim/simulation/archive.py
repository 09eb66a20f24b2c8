"""Reads untrusted NumPy archives: everything is checked before use.

An archive is read as ``numpy.savez`` writes it, uncompressed, and in no other form: what is in it can then be no larger
than the file, and nothing in it is evaluated.
"""

from __future__ import annotations

import io
import math
import re
import struct
import zipfile
from collections.abc import Collection

import numpy as np

from qrsim.core.arrays import NumpyArray

MAGIC = b"\x93NUMPY\x01\x00"
HEADER = re.compile(
    rb"\{'descr': '([<=>|][a-zA-Z]\d{1,8})', 'fortran_order': False, "
    rb"'shape': \((?:(\d{1,15}),|((?:\d{1,15}, )+\d{1,15}))?\), \} *\n"
)
# The end of a ZIP file without a comment: signature, disks, entries, size and offset of the directory.
_END = struct.Struct("<4s4H2LH")
_END_OF_LARGE = b"PK\x06\x07"
_ENTRY_BYTES = 1024


class DamagedError(ValueError):
    """The bytes are not an archive, or a damaged one."""


class OtherNamesError(ValueError):
    """The archive holds other arrays than expected."""


def read_archive(data: bytes, names: Collection[str]) -> dict[str, NumpyArray]:
    """Return the arrays of an uncompressed NumPy archive (.npz) by name, as read-only views of ``data``.

    Args:
        data: the file.
        names: of the arrays that it must hold, and no others.

    Raises:
        DamagedError: it is no archive, or damaged, compressed or encrypted.
        OtherNamesError: it holds other arrays.
    """
    _check_end(data, len(names))
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = archive.infolist()
            for entry in entries:
                if entry.compress_type != zipfile.ZIP_STORED or entry.flag_bits & 1:
                    raise DamagedError("compressed or encrypted")
                if entry.file_size != entry.compress_size or entry.file_size > len(data):
                    raise DamagedError("sizes")
            found = [entry.filename.removesuffix(".npy") for entry in entries]
            if sorted(found) != sorted(names):
                raise OtherNamesError(", ".join(found))
            return {name: _array(archive.read(entry)) for name, entry in zip(found, entries, strict=True)}
    except (DamagedError, OtherNamesError):
        raise
    # What Python's reader of ZIP files raises depends on what is wrong with one.
    except (ValueError, EOFError, RuntimeError, OSError, OverflowError, LookupError, zipfile.BadZipFile, struct.error):
        raise DamagedError("no ZIP file") from None


def _check_end(data: bytes, count: int) -> None:
    """Raise DamagedError if the directory at the end of an archive is damaged or too long, and OtherNamesError if it
    does not list ``count`` arrays."""
    if len(data) < _END.size:
        raise DamagedError("too short")
    signature, _, _, _, entries, size, begin, comment = _END.unpack(data[-_END.size :])
    if signature != b"PK\x05\x06" or comment or data[-_END.size - 20 : -_END.size].startswith(_END_OF_LARGE):
        raise DamagedError("no end")
    if entries != count:
        raise OtherNamesError(f"{entries} entries") if entries < 1000 else DamagedError("entries")
    # Python's reader takes a file with something else before the archive.
    if size > _ENTRY_BYTES * count or begin + size + _END.size != len(data):
        raise DamagedError("directory")


def _array(content: bytes) -> NumpyArray:
    """Return the array in the bytes of an .npy file; raises DamagedError for any other content."""
    begin = len(MAGIC) + 2
    if content[: len(MAGIC)] != MAGIC or len(content) < begin:
        raise DamagedError("no array")
    end = begin + int.from_bytes(content[len(MAGIC) : begin], "little")
    header = HEADER.fullmatch(content[begin:end])
    if header is None:
        raise DamagedError("header of an array")
    dtype = _dtype(header[1].decode())
    sizes = header[2] or header[3] or b""
    shape = tuple(int(size) for size in sizes.split(b", ") if size)
    if dtype.hasobject or dtype.itemsize * math.prod(shape) != len(content) - end:
        raise DamagedError("size of an array")
    return np.frombuffer(content, dtype, offset=end).reshape(shape) if dtype.itemsize else np.zeros(shape, dtype)


def _dtype(name: str) -> np.dtype[np.generic]:
    """Return the NumPy dtype with this name; raises DamagedError for an unknown one."""
    try:
        return np.dtype(name)
    except TypeError:
        raise DamagedError("type of an array") from None
