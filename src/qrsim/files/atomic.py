"""Atomic writing of files."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path


def write_atomically(path: Path, data: bytes | memoryview) -> None:
    """Write bytes to a temporary file and rename it to ``path``, so that readers see either the old or the new file
    whole.

    The temporary name starts with a dot, so other tools that read a folder of Parquet files ignore it too.

    Raises:
        OSError: nothing was written and nothing is left behind.
    """
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        with open(temporary, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise
