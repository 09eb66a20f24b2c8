"""Commands of ``qrsim``: one module each.

A command parses its options, calls the library, prints the result and sets the exit code. Commands do not import each
other, and each imports the library when it runs, so that ``qrsim --help`` stays quick. Times are given in seconds or
with a unit.
It may import ``studies`` and the layers below it.
Read ``run/command.py`` first.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Annotated, Any

import tyro

from qrsim.errors import UsageError

_TIME = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)\s*([a-z]*)", re.IGNORECASE)
_UNITS = {"": 1.0, "ms": 1e-3, "s": 1.0, "sec": 1.0, "min": 60.0, "h": 3600.0}


def seconds_of(text: str) -> float:
    """Convert a time such as ``20``, ``20s``, ``2min`` or ``1.5h`` to seconds; raises an error for other texts.

    Raises:
        ValueError: the text is not a time.
    """
    try:
        # NaN passes here: each option reports its own range.
        return float(text)
    except ValueError:
        pass
    found = _TIME.fullmatch(text.strip())
    if found is None or found[2].lower() not in _UNITS:
        raise ValueError(f"'{text[:60]}' is no time; expected seconds, or a number with a unit as 20s, 2min or 1.5h")
    return float(found[1]) * _UNITS[found[2].lower()]


def _optional(words: list[str]) -> float | None:
    """Convert the one word of a time option to seconds, or "None" to None."""
    return None if words == ["None"] else seconds_of(words[0])


def _spec(parse: Any) -> object:
    """Return the command-line parser's (tyro's) specification of a time option, converted by ``parse``."""
    return tyro.constructors.PrimitiveConstructorSpec(
        nargs=1,
        metavar="SECONDS",
        instance_from_str=parse,
        is_instance=lambda value: value is None or isinstance(value, int | float),
        str_from_instance=lambda value: [str(value)],
    )


# Annotations of options: a required time, and an optional one.
SECONDS = _spec(lambda words: seconds_of(words[0]))
OPTIONAL_SECONDS = _spec(_optional)
# Types of options: one that can be given several times, and the duration of a flight.
Repeated = tyro.conf.UseAppendAction[list[str]]
Duration = Annotated[float | None, OPTIONAL_SECONDS, tyro.conf.arg(help_behavior_hint="(default: the scenario's)")]


def check_seed(seed: int, option: str = "--seed", runs: int = 0) -> None:
    """Raise UsageError unless ``seed``, and the seeds of ``runs`` further runs after it, are in range; ``option`` names
    it."""
    if not 0 <= seed < 2**63 - runs:
        raise UsageError(f"{option} {seed}: expected an integer from 0 to 2**63 - 1{' - --seeds' if runs else ''}")


def with_duration(overrides: list[str], duration: float | None) -> list[str]:
    """Return scenario overrides (NAME=VALUE) with one for the duration [s] appended, if given; raises UsageError unless
    above 0."""
    if duration is None:
        return list(overrides)
    if not (math.isfinite(duration) and duration > 0):
        raise UsageError(f"--duration {duration:g}: expected a positive number of seconds")
    return [*overrides, f"duration={duration!r}"]


@contextmanager
def progress_bar(name: str, total: float, *texts: str, **fields: Any) -> Iterator[Callable[..., None]]:
    """Show a progress bar up to ``total`` while the context lasts, on a terminal only; yield Rich's function that
    updates it.

    Args:
        name: in front of the bar.
        total: what is to be done.
        texts: between the bar and the remaining time, as Rich's ``TextColumn`` takes them.
        fields: at the start, as Rich's ``Progress.add_task`` takes them.
    """
    if not sys.stderr.isatty():
        yield lambda **changes: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), *map(TextColumn, texts), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        yield partial(bar.update, bar.add_task(name, total=total, **fields))
