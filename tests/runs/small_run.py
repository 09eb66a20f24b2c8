"""A small run: two streams, three vehicles, chunks of four ticks."""

from __future__ import annotations

import numpy as np

from qrsim.runs import Column, RunWriter

VEHICLES = ("alpha", "bravo", "charlie")
COLUMNS = {
    "truth": (
        Column("position_ned.x", "m", "north of the origin", "float64"),
        Column("position_ned", "m", "a name that is the start of another", "float64"),
        Column("thrust", "N", "along the negative body z axis", "float32"),
    ),
    "measurements": (
        Column("height", "m", "barometric height", "float32"),
        Column("fix", "", "whether there is a position fix", "bool"),
        Column("satellites", "", "satellites used", "int32"),
    ),
}
STEP = 0.02


def chunk(stream: str, first_tick: int, count: int = 4) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Ticks, times and values that follow from the tick, so that a reader can be checked without a copy."""
    ticks = np.arange(first_tick, first_tick + count)
    base = ticks[:, None] * 10.0 + np.arange(len(VEHICLES))
    values: dict[str, np.ndarray] = {}
    for i, column in enumerate(COLUMNS[stream]):
        if column.dtype == "bool":
            values[column.name] = base % 2 == 0
        else:
            values[column.name] = (base + 1000 * i).astype(column.dtype)
    return ticks, ticks * STEP, values


def append_chunk(writer: RunWriter, first_tick: int, count: int = 4) -> None:
    """Append one chunk to both streams."""
    for stream in COLUMNS:
        writer.append(stream, *chunk(stream, first_tick, count))
