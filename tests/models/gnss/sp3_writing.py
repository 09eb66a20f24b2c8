"""Writing SP3 files for tests: of the nominal constellation, and spoilt line by line."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from qrsim.models.gnss.constellations import NominalConstellations
from qrsim.models.gnss.orbits import NominalConstellation
from qrsim.models.site import GPS_EPOCH

# The first epoch of the recorded file, on the GPS scale.
FIRST = (datetime(2010, 8, 31, 15, tzinfo=UTC) - GPS_EPOCH).total_seconds()
NOMINAL = NominalConstellation()


def names_of(letter: str, count: int = 24) -> list[str]:
    return [f"{letter}{number:02}" for number in range(1, count + 1)]


def sp3_text(
    version: str = "c",
    names: Iterable[str] = tuple(names_of("G")),
    epochs: int = 20,
    *,
    interval: float = 900.0,
    time_system: str = "GPS",
    first: datetime = datetime(2010, 8, 31, 15),
    shift_s: float = 0.0,
    orbits: Any = NOMINAL,
) -> str:
    """An SP3 file of the nominal constellation, its slots repeated under as many names as asked for.

    ``first`` is what the first epoch line says; ``shift_s`` is GPS time minus the file's time system; ``orbits`` are
    others that the positions are of.
    """
    names = list(names)
    start = (first.replace(tzinfo=UTC) - GPS_EPOCH).total_seconds() + shift_s
    positions = orbits.positions_ecef(start + interval * np.arange(epochs)) / 1000.0
    rows = max(5, math.ceil(len(names) / 17))
    padded = names + ["  0"] * (17 * rows - len(names))
    lines = [
        f"#{version}P{first:%Y %m %d %H %M}  0.00000000 {epochs:7} ORBIT IGS05 HLM  IGS",
        f"## 1599 226800.00000000 {interval:14.8f} 55439 0.6250000000000",
        *(
            f"+  {len(names) if row == 0 else '':>3}   " + "".join(padded[17 * row : 17 * row + 17])
            for row in range(rows)
        ),
        *(["++         0" + "  0" * 16] * rows),
        f"%c {'M' if len({name[0] for name in names}) > 1 else names[0][0]}  cc {time_system} ccc cccc cccc",
        "%c cc cc ccc ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc",
        *(["%f  1.2500000  1.025000000  0.00000000000  0.000000000000000"] * 2),
        *(["%i    0    0    0    0      0      0      0      0         0"] * 2),
        *(["/* a comment"] * (4 if version != "d" else 7)),
    ]
    for epoch in range(epochs):
        when = first + timedelta(seconds=interval * epoch)
        lines.append(f"*  {when:%Y %m %d %H %M} {when.second + when.microsecond / 1e6:11.8f}")
        for i, name in enumerate(names):
            x, y, z = positions[epoch, i % positions.shape[1]]
            lines.append(f"P{name}{x:14.6f}{y:14.6f}{z:14.6f}{100.0 + i:14.6f} 10  9  8  77")
    return "\n".join([*lines, "EOF", ""])


def four_systems(letters: str = "GERC", version: str = "d") -> str:
    """An SP3 file of the nominal constellations of these systems, 24 satellites each."""
    names = [name for letter in letters for name in names_of(letter)]
    return sp3_text(version, names, orbits=NominalConstellations(letters))


def line_of(text: str, start: str, occurrence: int = 0) -> int:
    """Number, from 1, of a line that starts so."""
    return [i for i, line in enumerate(text.splitlines(), 1) if line.startswith(start)][occurrence]


def edit(text: str, number: int, change: Callable[[str], str | None]) -> str:
    """Change one line; None deletes it."""
    lines = text.splitlines()
    changed = change(lines[number - 1])
    lines[number - 1 : number] = [] if changed is None else [changed]
    return "\n".join([*lines, ""])
