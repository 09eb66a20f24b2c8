"""``qrsim data fetch`` and ``qrsim data where``."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from qrsim.errors import RunError
from qrsim.files import recordings

if TYPE_CHECKING:
    from rich.progress import Progress


@dataclass(frozen=True)
class Fetch:
    """Fetch the public recordings (2.6 MB) that validation and tests use.

    Good files are kept; altered ones are reported and fetched again. Every file is checked by its sha256.

    Example:
      qrsim data fetch
      qrsim data fetch --dest recordings
    """

    dest: Annotated[
        Path | None,
        tyro.conf.arg(metavar="DIR", help_behavior_hint="(default: QRSIM_DATA_DIR, else a folder in the user's cache)"),
    ] = None
    """Folder to save to."""

    def run(self) -> None:
        """Download the recordings file by file, and print the outcome of each."""
        import shlex

        folder = recordings.data_folder() if self.dest is None else Path(os.path.expanduser(self.dest)).absolute()
        if folder.exists() and not folder.is_dir():
            raise RunError(f"{folder} is not a folder")
        statuses = [recordings.file_status(name, folder) for name in recordings.RECORDINGS]
        wanted = [status.name for status in statuses if status.condition != "good"]
        for status in statuses:
            _bring(status, wanted)
        print(f"folder: {folder}")
        print(f"export {recordings.FOLDER_VARIABLE}={shlex.quote(str(folder))}")


@dataclass(frozen=True)
class Where:
    """Print the folder of the recordings and which of them are present and good.

    Example:
      qrsim data where
      qrsim data where --json
    """

    json: bool = False
    """Print JSON: the folder, and for each file its condition and sha256."""

    def run(self) -> None:
        """Print where the recordings are and the state of each file, as a table or JSON."""
        folder = recordings.data_folder()
        statuses = [recordings.file_status(name) for name in recordings.RECORDINGS]
        complete = all(status.condition == "good" for status in statuses)
        if self.json:
            _print_json(folder, statuses, complete)
            return
        print(f"folder: {folder}")
        for status in statuses:
            print(f"  {status.condition:<8} {status.name}")
        if not complete:
            print("'qrsim data fetch' downloads missing and altered files")


def _bring(status: recordings.FileStatus, wanted: list[str]) -> None:
    """Download a file unless it is complete; ``wanted``: all incomplete files, for the advice if it fails."""
    if status.condition == "good":
        print(f"kept     {status.name}")
        return
    if status.condition == "altered":
        print(
            f"altered  {status.name}: expected sha256 {status.sha256_expected}, found {status.sha256_found};"
            " fetching it again"
        )
    folder = status.path.parent
    try:
        with _progress_bar(status.name) as bar:
            recordings.fetch_file(status.name, folder, bar)
    except RunError as error:
        missing = wanted[wanted.index(status.name) :]
        raise RunError(str(error), *recordings.fetch_by_hand(missing, folder)) from error
    print(f"fetched  {status.name}")


def _print_json(folder: Path, statuses: list[recordings.FileStatus], complete: bool) -> None:
    """Print the state of each recording in a folder as JSON; ``complete``: all are good."""
    import json

    files = [
        {
            "name": status.name,
            "condition": status.condition,
            "sha256_expected": status.sha256_expected,
            "sha256_found": status.sha256_found,
        }
        for status in statuses
    ]
    print(json.dumps({"folder": str(folder), "complete": complete, "files": files}, indent=2))


@contextmanager
def _progress_bar(name: str) -> Iterator[_RichBar | None]:
    """Show the progress bar of a download while the context lasts, on a terminal only; yield it, or None."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn

    columns = (TextColumn("{task.description:<20}"), BarColumn(), DownloadColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        yield _RichBar(progress, name)


class _RichBar:
    """A rich progress task with the four members that pooch calls."""

    def __init__(self, progress: Progress, name: str) -> None:
        self._progress = progress
        self._task = progress.add_task(name, total=None)
        self._total = 0

    @property
    def total(self) -> int:
        """Size of the download [bytes], 0 if it is unknown."""
        return self._total

    @total.setter
    def total(self, count: int) -> None:
        """Set the size of the download [bytes], 0 if it is unknown."""
        self._total = count
        # A server that compresses announces no size.
        self._progress.update(self._task, total=count or None)

    def update(self, count: int) -> None:
        """Add ``count`` downloaded bytes to the bar."""
        self._progress.advance(self._task, count)

    def reset(self) -> None:
        """Set the number of downloaded bytes back to 0."""
        self._progress.update(self._task, completed=0)

    def close(self) -> None:
        """Do nothing: the context closes the bar."""
