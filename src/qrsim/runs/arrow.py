"""Arrow arrays from NumPy arrays and lists, and back; pyarrow's own conversions import pandas where it is installed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa

from qrsim.core.arrays import NumpyArray
from qrsim.runs.layout import numpy_dtype


def column(values: NumpyArray) -> pa.Array:
    """Convert a NumPy array (n,) of numbers or bools to an Arrow array without missing values."""
    values = np.ascontiguousarray(values)
    kind = pa.from_numpy_dtype(values.dtype)
    # Arrow packs eight bools into a byte.
    data = np.packbits(values, bitorder="little") if values.dtype == bool else values
    return pa.Array.from_buffers(kind, len(values), [None, pa.py_buffer(data)])


def numbers(values: Sequence[object], kind: object) -> pa.Array:
    """Return an Arrow array of numbers of the Arrow type ``kind``; None becomes a missing value."""
    present = np.array([value is not None for value in values], bool)
    plain = np.array([0 if value is None else value for value in values], numpy_dtype(kind))
    validity = pa.py_buffer(np.packbits(present, bitorder="little"))
    return pa.Array.from_buffers(kind, len(plain), [validity, column(plain).buffers()[1]])


def strings(values: Sequence[str | None]) -> pa.StringArray:
    """Return an Arrow array of strings; None becomes a missing value."""
    present = np.array([value is not None for value in values], bool)
    encoded = [(value or "").encode() for value in values]
    ends = np.cumsum([0, *map(len, encoded)]).astype(np.int32)
    validity = pa.py_buffer(np.packbits(present, bitorder="little"))
    return pa.StringArray.from_buffers(len(encoded), pa.py_buffer(ends), pa.py_buffer(b"".join(encoded)), validity)


def names(values: Sequence[str | None]) -> pa.DictionaryArray:
    """Return a dictionary-encoded Arrow array of strings; None becomes a missing value."""
    known = list(dict.fromkeys(value for value in values if value is not None))
    indices = [None if value is None else known.index(value) for value in values]
    return pa.DictionaryArray.from_arrays(numbers(indices, pa.int32()), strings(known))


def to_numpy(values: pa.Array | pa.ChunkedArray) -> NumpyArray:
    """Convert an Arrow column, or one chunk of it, to a NumPy array; missing numbers become NaN."""
    chunks = values.chunks if isinstance(values, pa.ChunkedArray) else [values]
    arrays = [_as_numpy(chunk) for chunk in chunks]
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays or [np.zeros(0, numpy_dtype(values.type))])


def _as_numpy(chunk: pa.Array) -> NumpyArray:
    """Return the values of an Arrow chunk as a numpy array, without a copy where possible."""
    dtype = numpy_dtype(chunk.type)
    if not len(chunk):
        return np.zeros(0, dtype)
    if dtype.kind == "b" and not chunk.null_count:
        bits = np.unpackbits(np.frombuffer(chunk.buffers()[1], np.uint8), bitorder="little")
        return bits[chunk.offset : chunk.offset + len(chunk)].astype(bool)
    if dtype.kind not in "fiu" or chunk.null_count:
        found: NumpyArray = chunk.to_numpy(zero_copy_only=False)
        return found
    return np.frombuffer(chunk.buffers()[1], dtype, len(chunk), chunk.offset * dtype.itemsize)
