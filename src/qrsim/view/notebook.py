"""A recorded run in a notebook: its page, embedded in the output of a cell."""

from __future__ import annotations

import html
from pathlib import Path

from qrsim.errors import RunError, UsageError, os_error_as, warn_user
from qrsim.files.atomic import write_atomically
from qrsim.runs import Run, open_run
from qrsim.simulation.rollout import Rollout
from qrsim.view.server import require_viser

# A notebook keeps the page in its file [bytes].
LARGE = 50_000_000
LEAST_HEIGHT = 200


class Shown:
    """The page of a run: a notebook shows it where it is the value of a cell.

    Attributes:
        page: the whole page, HTML that needs nothing else.
        heading: what it shows, one line.
    """

    def __init__(self, page: str, heading: str, folder: Path, height: int):
        self.page, self.heading = page, heading
        self._folder, self._height = folder, height

    def _repr_html_(self) -> str:
        """Return HTML that embeds the 3-D page in a notebook."""
        inside = html.escape(self.page, quote=True)
        style = "border:1px solid #ddd;display:block"
        return f'<iframe srcdoc="{inside}" width="100%" height="{self._height}" style="{style}"></iframe>'

    def __repr__(self) -> str:
        return (
            f"<page of {self.heading}, {len(self.page) / 1e6:.1f} MB: a notebook shows it; elsewhere "
            f".save('page.html') writes it, and 'qrsim view {self._folder}' plays the run in a browser>"
        )

    def save(self, path: str | Path) -> Path:
        """Write the 3-D page to an HTML file for any browser, and return its path; an existing file is replaced.

        Raises:
            UsageError: the name does not end in .html, or its folder is missing.
            RunError: it cannot be written.
        """
        path = Path(path)
        if path.suffix.lower() not in (".html", ".htm"):
            raise UsageError(f"save: {path}: the name has to end in .html")
        if not path.parent.is_dir():
            raise UsageError(f"save: {path}: there is no folder {path.parent}")
        with os_error_as(RunError, f"cannot write {path}"):
            write_atomically(path, self.page.encode("utf-8"))
        return path


def show(run: Run | Path | str, *, height: int = 600) -> Shown:
    """Return a 3-D page that plays a recorded run in a notebook, ``height`` pixels high, without a server.

    As the last expression of a cell it is displayed; elsewhere in one, ``display(qrsim.show(run))`` does so. It needs
    viser, and no notebook: ``save`` writes the page.

    Args:
        run: what ``qrsim.open_run`` returns, or the path of a run folder.
        height: of the frame [pixels].

    Raises:
        MissingExtraError: viser is not installed; the message says how to install it.
        UsageError: it is no run, or no height.
        RunError: the run is damaged, or there is nothing to show in it.
    """
    if isinstance(run, Rollout):
        raise UsageError(
            "show: a rollout keeps numbers and no flight; record one of its worlds, "
            "qrsim.fly(scenario, FOLDER, seed=...), and show that folder"
        )
    if not isinstance(run, Run | Path | str):
        raise UsageError(f"show: expected a run (qrsim.open_run) or its folder, not {type(run).__name__}")
    if isinstance(height, bool) or not isinstance(height, int) or height < LEAST_HEIGHT:
        raise UsageError(f"show: height: {height!r}; expected a whole number of pixels, at least {LEAST_HEIGHT}")
    require_viser()
    from qrsim.view.film import film, thinned
    from qrsim.view.recording import Recording

    recording = Recording(run if isinstance(run, Run) else open_run(run))
    for line in thinned(recording):
        warn_user(f"{recording.run.folder}: {line}")
    found = Shown(film(recording), recording.heading, recording.run.folder, height)
    if len(found.page) > LARGE:
        warn_user(f"the page has {len(found.page) / 1e6:.0f} MB, and a notebook keeps it; 'qrsim view' does not")
    return found
