"""The page of a command with ``--view``: before the flight, during it and after it."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from qrsim.errors import QrsimError, nearest, warn_user
from qrsim.files.interruptions import ending

if TYPE_CHECKING:
    from qrsim.view.live import LiveView

OFF, NOW, WAIT = "off", "now", "wait"
OPTION = "--view"
# A browser that loads the page anew is away for less than this [s].
RELOAD_S = 3.0


def completed(arguments: Sequence[str]) -> list[str]:
    """Return the command line's arguments with a bare ``--view`` replaced by ``--view=now``."""
    found = list(arguments)
    for i, word in enumerate(found):
        following = found[i + 1] if i + 1 < len(found) else ""
        if word == OPTION and nearest(following, (OFF, NOW, WAIT)) is None:
            found[i] = f"{OPTION}={NOW}"
    return found


@contextmanager
def shown(how: str, port: int, host: str) -> Iterator[LiveView | None]:
    """Open the live page and yield it, None if ``how`` requests none; "wait": first wait for a browser."""
    if how == OFF:
        yield None
        return
    from qrsim.view.clock import Clock
    from qrsim.view.live import LiveView

    page = LiveView(port, Clock(), host)
    # Not on standard output, which belongs to the result.
    print(f"page: {page.address}", file=sys.stderr, flush=True)
    try:
        if how == WAIT:
            page.wait_for("a browser; then the flight begins")
            while not page.browsers:
                time.sleep(0.05)
        page.wait_for("the flight, which is being prepared")
        yield page
    finally:
        page.close()


def replay(page: LiveView, folder: Path) -> None:
    """Replace the live page by a replay of the run that was recorded in this folder."""
    from qrsim.runs import open_run
    from qrsim.view.recording import Recording

    try:
        page.replay(Recording(open_run(folder)))
    except QrsimError as error:
        page.note(f"The flight has ended. There is no replay: {error}")
        warn_user(f"the page is no replay: {error}")


def stay(page: LiveView) -> None:
    """Keep the page open: on a terminal until Ctrl-C, else while a browser shows it."""
    with ending() as asked:
        if sys.stderr.isatty():
            print(f"the page stays, as a replay: {page.address}  (Ctrl-C ends it)", file=sys.stderr, flush=True)
            while not asked.wait(0.25):
                pass
            return
        seen = time.monotonic() if page.browsers else None
        while seen is not None and time.monotonic() - seen < RELOAD_S and not asked.wait(0.1):
            if page.browsers:
                seen = time.monotonic()
