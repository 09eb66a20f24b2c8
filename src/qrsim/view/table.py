"""The table of all vehicles at the time shown: what a page answers when a browser has it open (table.js)."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.errors import QrsimError
from qrsim.view.derived import in_sigmas
from qrsim.view.details import Details
from qrsim.view.frame import Frame
from qrsim.view.labels import doing_of
from qrsim.view.server import packed

# Columns of numbers, in the order of an answer; the last two are the index of the text and the time of the stop.
COLUMNS = ("north", "east", "height", "speed", "charge", "error", "std", "sigmas", "text", "stopped")


def answer(
    wish: Mapping[str, object], frame: Frame | None, waypoints: Sequence[int], stops: Mapping[int, float], exact: bool
) -> bytes:
    """Answer a browser's request for the table of a frame's vehicles, as bytes: a JSON head, then numbers.

    Args:
        wish: ``number``, which the answer repeats, and ``known``, the key of the texts that the browser has.
        frame: what is shown; None: nothing yet.
        waypoints: (n,) of each vehicle's route.
        stops: vehicle -> time of its stop [s], also of stops after the frame.
        exact: whether these times are exact, or up to a drawn frame late.

    Returns:
        The length of a head in 4 bytes, the head as JSON, and float32 (10, n), a row for each of ``COLUMNS``. The head
        has the time [s], the key of the texts and, if the browser does not have them, the texts. Without a frame it has
        the number only.
    """
    if frame is None:
        return packed({"number": wish.get("number")})
    values, texts = table_of(frame, waypoints, stops, exact)
    key = zlib.crc32("\n".join(texts).encode())
    head: dict[str, object] = {"number": wish.get("number"), "time": frame.time, "key": key}
    return packed(head | ({} if wish.get("known") == key else {"texts": texts}), values.ravel())


def table_of(
    frame: Frame, waypoints: Sequence[int], stops: Mapping[int, float], exact: bool = True
) -> tuple[Floats, list[str]]:
    """Return a table of vehicles: numbers (10, n), a row per column of ``COLUMNS``, and the texts of their states.

    Args:
        frame: at the time shown.
        waypoints: number of each vehicle's next waypoint.
        stops: vehicle -> time [s] at which its flight ended.
        exact: whether these times are known to a tick, or only to a frame.
    """
    size = len(frame.valid)
    values = np.full((len(COLUMNS), size), np.nan)
    values[:3] = frame.position_ned.T * np.array([[1.0], [1.0], [-1.0]])
    found: Details | None = None
    # A damaged stream leaves its columns empty.
    with suppress(QrsimError):
        found = None if frame.details is None else frame.details()
    if found is not None:
        values[3] = np.linalg.norm(found.velocity_ned, axis=1)
        values[4] = found.charge
        error = found.believed_ned - frame.position_ned
        values[5] = np.linalg.norm(error, axis=1)
        values[6] = np.linalg.norm(found.std_ned, axis=1)
        values[7] = in_sigmas(error, found.std_ned)
    numbers: dict[str, int] = {}
    for i in range(size):
        if i in frame.reasons or not frame.valid[i]:
            time = stops.get(i, np.nan)
            values[9, i] = time
            text = stopped_text(frame.reasons.get(i), time, exact)
        else:
            text = "" if found is None else ", ".join(doing_of(found, i, waypoints[i]))
        values[8, i] = numbers.setdefault(text, len(numbers))
    return values, list(numbers)


def stopped_text(why: str | None, time: float, exact: bool = True) -> str:
    """Return the text for a vehicle that has stopped, such as "stopped at 3.20 s: ..."; ``time`` [s], NaN: unknown."""
    when = "" if np.isnan(time) else f" at {time:.2f} s" if exact else f" at about {time:.1f} s"
    return f"stopped{when}: {why}" if why else f"stopped{when}"
