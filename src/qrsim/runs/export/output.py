"""Shared by all formats: atomic writing of targets, and checks that streams are readable."""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from qrsim.errors import RunError, UsageError
from qrsim.runs import Run


@dataclass(frozen=True)
class Written:
    """A file that was written.

    Attributes:
        path: where it is.
        counts: what is in it, for example {"rows": 500}.
    """

    path: Path
    counts: Mapping[str, int]


def check_target(path: Path, force: bool) -> None:
    """Raise UsageError if the output path is a folder, or exists and ``force`` is False.

    Raises:
        UsageError: it is a folder, or exists and may not be overwritten.
    """
    if path.is_dir():
        raise UsageError(f"{path} is a folder; --out must name a file here")
    if path.exists() and not force:
        raise UsageError(f"{path} exists; choose another --out, or --force to overwrite it")


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Context manager: give a temporary file that replaces ``path`` if the block succeeds, else is deleted.

    Raises:
        RunError: it cannot be written.
    """
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(temporary, "wb") as file:
            yield file
        os.replace(temporary, path)
    except BaseException as error:
        with contextlib.suppress(OSError):
            temporary.unlink()
        if isinstance(error, OSError):
            raise RunError(f"cannot write {path}: {error.strerror or error}") from error
        raise


def is_readable(run: Run, stream: str) -> bool:
    """Return whether any part of a stream of the run is readable; warn if all parts are damaged."""
    if stream not in run:
        return False
    try:
        run.describe(stream)
    except RunError as error:
        warnings.warn(f"left out: {error}", stacklevel=2)
        return False
    return True


def readable_streams(run: Run, only: str | None) -> list[str]:
    """Return the names of the run's readable streams; if ``only`` names a stream, that one alone.

    Raises:
        UsageError: there is no stream ``only``.
        RunError: nothing of it, or of any stream, can be read.
    """
    if only is not None:
        run.describe(only)
        return [only]
    streams = [stream for stream in run.streams if is_readable(run, stream)]
    if not streams:
        raise RunError(f"{run.folder}: no stream can be read")
    return streams
