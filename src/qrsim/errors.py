"""Errors a user can cause, and the words used to explain them."""

from __future__ import annotations

import difflib
import os
import re
import sys
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

# To look for similar names takes the square of their lengths; messages are to be read.
LONGEST_NAME, MOST_KNOWN, LONGEST_PROBLEM, MOST_PROBLEMS = 200, 100, 2000, 200
# Faults that differ in their numbers only, as those of all waypoints of a plan, have at most so many lines.
MOST_ALIKE = 3
_NUMBER = re.compile(r"[-+]?[0-9]+(?:[.][0-9]+)?(?:e[-+]?[0-9]+)?")
# What others call it, by words that look unlike it.
SYNONYMS: dict[str, str] = {
    "alt": "height", "altitude": "height", "altitudeamsl": "height_amsl", "amsl": "height_amsl",
    "bearing": "wind_from_deg", "compass": "magnetometer",
    "direction": "wind_from_deg", "from": "wind_from_deg", "gps": "gnss", "lat": "latitude_deg",
    "latitude": "latitude_deg", "lidar": "scan", "liion": "lithium_cells", "lipo": "lithium_cells",
    "heightmsl": "height_amsl", "lng": "longitude_deg", "lon": "longitude_deg", "long": "longitude_deg",
    "longitude": "longitude_deg", "msl": "height_amsl",
    "winddirection": "wind_from_deg",
}  # fmt: skip


class QrsimError(Exception):
    """Base of every error that qrsim raises on purpose; the command line prints it without a traceback.

    Each argument is a line of the message. Names and values of inputs may have line ends and control characters in
    them: these are written out, so that a line stays one. In another message (``f"{error}"``) all is one line.
    """

    exit_code = 1

    def __init__(self, *lines: object):
        super().__init__(*(visible(line) if isinstance(line, str) else line for line in lines))

    def __str__(self) -> str:
        return "\n".join(map(str, self.args))

    def __format__(self, spec: str) -> str:
        return format("; ".join(line.strip() for line in str(self).split("\n")), spec)


class UsageError(QrsimError, ValueError):
    """The input was wrong: a name, a value, a shape, a file's content. Exit code 2 on the command line."""

    exit_code = 2


class ScenarioError(UsageError):
    """One or several faults of a scenario, each on its own line with its path.

    Attributes:
        problems: the faults, one sentence each.
    """

    def __init__(self, source: str, problems: Iterable[str]):
        self.source = source
        self.problems = [visible(problem) for problem in problems]
        count = len(self.problems)
        head = f"{source}: {count} problem{'s' if count != 1 else ''}"
        told = list(_told(self.problems))
        lines = [f"  {shortened(line)}" for line, _ in told[:MOST_PROBLEMS]]
        more = [f"  ... and {sum(each for _, each in told[MOST_PROBLEMS:])} more"] if len(told) > MOST_PROBLEMS else []
        super().__init__(head, *lines, *more)

    def __reduce__(self) -> tuple[object, ...]:
        # By its own arguments, which are not those of Exception; notes and the like are in the dict.
        return type(self), (self.source, self.problems), self.__dict__


def _told(problems: list[str]) -> Iterator[tuple[str, int]]:
    """Yield lines that list faults, each with the number of faults it covers; many that differ only in numbers are
    summed up."""
    groups: dict[str, list[str]] = {}
    for problem in problems:
        groups.setdefault(_NUMBER.sub("0", problem), []).append(problem)
    for alike in groups.values():
        shown = len(alike) if len(alike) <= MOST_ALIKE else MOST_ALIKE - 1
        yield from ((problem, 1) for problem in alike[:shown])
        if shown < len(alike):
            yield f"... and {len(alike) - shown} more like it", len(alike) - shown


class LogError(UsageError):
    """A flight log is damaged, or does not show the requested constants. Exit code 1: the command itself was right.

    Attributes:
        details: what was measured of the log, line by line, beside the message, which is one line.
    """

    exit_code = 1

    def __init__(self, message: str, details: Iterable[str] = ()):
        super().__init__(message)
        self.details = [visible(line) for line in details]


class RunError(QrsimError):
    """A valid run could not be carried out (disk full, folder not writable, data missing)."""


class NeighbourWarning(UserWarning):
    """Vehicles may have missed others that are near."""


class RadioWarning(NeighbourWarning):
    """Vehicles may have missed others that are near over the radio."""


class CompilerWarning(UserWarning):
    """qrsim's own compiler refused a program, so XLA computes it: same results, more slowly."""


class BusyError(RunError, RuntimeError):
    """Two threads used an object at once that only one may use at a time."""


def shortened(text: str, most: int = LONGEST_PROBLEM) -> str:
    """Return a text of at most ``most`` characters, with its middle cut out if it is longer."""
    return text if len(text) <= most else f"{text[: most // 2]} ... {text[len(text) - most // 2 :]}"


def visible(text: str) -> str:
    """Return a text as one line, with line ends and control characters, except tabs, written as escapes."""
    return "".join(
        character if character.isprintable() or character == "\t" else ascii(character)[1:-1] for character in text
    )


def nearest(name: str, known: Iterable[str]) -> str | None:
    """Return the name in ``known`` that is most similar to ``name``, None if none is similar."""
    if len(name) > LONGEST_NAME:
        return None
    known = list(known)
    called = SYNONYMS.get(name.lower().replace("-", "").replace("_", ""))
    if called in known:
        return called
    found = next(iter(difflib.get_close_matches(name, known, n=1, cutoff=0.6)), None)
    if found is None or not found.endswith("_rad") or "_rad" in name:
        return found
    # People have angles in degrees unless they say otherwise.
    twin = f"{found.removesuffix('_rad')}_deg"
    return twin if twin in known else found


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return the hint ``"; did you mean 'x'?"`` for a wrong name, or a list of the known names if none is similar."""
    known = list(known)
    match = nearest(name, known)
    if match is not None:
        return f"; did you mean '{match}'?"
    more = f" and {len(known) - MOST_KNOWN} more" if len(known) > MOST_KNOWN else ""
    return f"; known: {', '.join(known[:MOST_KNOWN])}{more}" if known else ""


def did_you_mean_file(path: Path) -> str:
    """Return the hint ``"; did you mean 'x'?"`` with a file of a similar name in the same folder; "" without one."""
    try:
        known = sorted(found.name for found in path.parent.glob(f"*{path.suffix}"))
    except OSError:
        return ""
    match = nearest(path.name, known)
    return f"; did you mean '{match}'?" if match and match != path.name else ""


@contextmanager
def os_error_as(kind: type[QrsimError], what: str) -> Iterator[None]:
    """In the context, raise every OSError as an error of the class ``kind``; the message says ``what`` failed, and
    why."""
    try:
        yield
    except OSError as error:
        raise kind(f"{what}: {error.strerror or error}") from None


@contextmanager
def readable(path: str | Path) -> Iterator[None]:
    """In the context, raise an OSError from reading a user's file as a UsageError that names the most similar file."""
    try:
        yield
    except OSError as error:
        hint = did_you_mean_file(Path(os.path.expanduser(path)))
        raise UsageError(f"{path}: cannot be read: {error.strerror or error}{hint}") from None


def warn_user(message: str) -> None:
    """Give a warning in one line, attributed to the user's line of code that called into qrsim."""
    depth = 1
    while sys._getframe(depth).f_globals.get("__name__", "").partition(".")[0] == "qrsim":
        if sys._getframe(depth).f_back is None:
            break
        depth += 1
    warnings.warn(visible(message), UserWarning, stacklevel=depth + 1)
