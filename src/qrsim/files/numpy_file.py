"""Arrays of NumPy archives that users give, compressed or not: looked at before anything of them is unpacked."""

from __future__ import annotations

import io
import math
import zipfile
from typing import IO, Any

import numpy as np

from qrsim.errors import UsageError


def read_arrays(file: str, data: bytes, most_numbers: int) -> dict[str, np.ndarray[Any, Any]]:
    """Return the arrays, by name, of an archive by ``numpy.savez`` or ``savez_compressed``, each of at most
    ``most_numbers`` numbers; ``file``: for messages.

    Args:
        file: its name, for messages.
        data: its content.
        most_numbers: of any array.

    Raises:
        UsageError: it is no such archive, damaged, holds objects, or an array that is larger.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for entry in archive.infolist():
                with archive.open(entry) as stream:
                    shape, size = _header(stream)
                if math.prod(shape) > most_numbers:
                    raise UsageError(
                        f"{file}: '{entry.filename.removesuffix('.npy')}' has shape {shape}, "
                        f"{math.prod(shape):.3g} numbers; allowed: {most_numbers:.3g}"
                    )
                # What is claimed beyond what is there would be made room for.
                if math.prod(shape) * size > entry.file_size:
                    raise ValueError("shorter than its header says")
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}
    except UsageError:
        raise
    # What readers of ZIP files raise depends on what is wrong with one.
    except (
        ValueError,
        OSError,
        EOFError,
        RuntimeError,
        LookupError,
        OverflowError,
        NotImplementedError,
        zipfile.BadZipFile,
    ):
        raise UsageError(f"{file}: is no NumPy archive of numbers, or it is damaged") from None


def _header(stream: IO[bytes]) -> tuple[tuple[int, ...], int]:
    """Return an array's shape and the size [bytes] of one element, from the header of an .npy stream."""
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(stream)
    return shape, dtype.itemsize
