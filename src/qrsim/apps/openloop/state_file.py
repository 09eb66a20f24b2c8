"""Writing the states of a run as CSV."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import IO

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.errors import RunError, UsageError

HEADER = "step,px,py,pz,phi,theta,psi,u,v,w,p,q,r,thrust,ax,ay,az"
STANDARD_OUTPUT = "-"
_ROW = "%d" + ",%.17g" * 16 + "\n"
_ROWS_PER_WRITE = 4096


def check_output(output: str, overwrite: bool, source: Path) -> None:
    """Raise UsageError, before any work is done, for an output path that cannot be written; ``source``: the file read.

    Raises:
        UsageError: the folder is missing, the file exists and ``overwrite`` is off, or it is ``source`` itself.
    """
    if output == STANDARD_OUTPUT:
        return
    path = Path(output)
    if not path.parent.is_dir():
        raise UsageError(f"{path}: the folder {path.parent} does not exist")
    if path.is_dir():
        raise UsageError(f"{path}: is a folder; expected the name of a file")
    if not path.exists():
        return
    if source.exists() and path.samefile(source):
        raise UsageError(f"{path}: is the file of commands; choose another output")
    if path.is_file() and not overwrite:
        raise UsageError(f"{path}: exists already; --overwrite replaces it")


def write_states(states: NumpyArray, output: str) -> None:
    """Write states (T, 16) as CSV with 17 significant digits, to a file or, for "-", to standard output.

    Raises:
        RunError: the file cannot be written.
    """
    path = Path(output)
    try:
        if output == STANDARD_OUTPUT:
            _write_rows(sys.stdout, states)
        elif path.exists() and not path.is_file():  # a pipe or a device: nothing to replace
            with path.open("w", newline="") as stream:
                _write_rows(stream, states)
        else:
            _write_and_rename(path, states)
    except BrokenPipeError:
        raise
    except OSError as error:
        raise RunError(f"{output}: cannot be written: {error.strerror}") from error


def _write_and_rename(path: Path, states: NumpyArray) -> None:
    """Write states to a temporary file, and rename it to ``path`` once it is complete."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with partial.open("w", newline="") as stream:
            _write_rows(stream, states)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def _write_rows(stream: IO[str], states: NumpyArray) -> None:
    """Write a header and states (T, columns) as CSV, a row for each step, numbered from 1."""
    stream.write(HEADER + "\n")
    for first in range(0, len(states), _ROWS_PER_WRITE):
        block = states[first : first + _ROWS_PER_WRITE].astype(np.float64)
        steps = np.arange(first + 1, first + 1 + len(block))
        stream.write(_ROW * len(block) % tuple(np.column_stack([steps, block]).ravel().tolist()))
