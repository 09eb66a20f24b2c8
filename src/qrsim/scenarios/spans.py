"""Checks of when something begins and ends in a run: faults, interference."""

from __future__ import annotations

from collections.abc import Iterator


def moment_problems(path: str, seconds: float, duration: float) -> Iterator[str]:
    """Yield an error if the time [s] of an event at ``path`` is outside the run of ``duration`` [s]."""
    if seconds >= duration:
        yield (
            f"{path}: {seconds:g} s is not within the run; "
            f"allowed: from 0 s to before its end at {duration:g} s (duration)"
        )


def span_problems(path: str, start: float, end: float | None, duration: float) -> Iterator[str]:
    """Yield the errors of times ``path.start`` and ``path.end`` [s] in a run; an end of None is unlimited."""
    yield from moment_problems(f"{path}.start", start, duration)
    if end is not None and end <= start:
        yield f"{path}.end: {end:g} s is not after the start, {start:g} s"
