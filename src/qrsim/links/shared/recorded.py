"""Which order each vehicle flew by in each tick, in a recording: the stream "orders"."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.links.shared.kinds import NAMES
from qrsim.links.shared.plant import FLIES, Plant
from qrsim.runs import Column

STREAM = "orders"
_KINDS = ", ".join(f"{number} {name}" for number, name in enumerate(NAMES, 1))
_FLIES = ", ".join(f"{number} {name}" for number, name in enumerate(FLIES))


# A recording of vehicles that are put back to their starts in flight has this column.
RESTARTED = Column("restarted_tick", "", "at which the vehicle was last put back to its start; -1: never", "int64")


def basic_columns(width: int) -> list[Column]:
    """Return the columns of recorded orders: each vehicle's kind of order and its ``width`` numbers."""
    return [
        Column("kind", "", f"kind of the order that this tick was flown by: 0 guidance, {_KINDS}", "int32"),
        *(Column(f"number_{i}", "", f"number {i} of the order", "float64") for i in range(width)),
    ]


def order_columns(plant: Plant) -> list[Column]:
    """Return the columns of recorded orders in a world that several clients share: kind, numbers, client and others."""
    return [
        *basic_columns(plant.latches.numbers.shape[1]),
        Column("flies", "", f"by what the vehicle flew: {_FLIES}", "int32"),
        Column("client", "", "number of the client that had claimed it; 0: nobody", "int32"),
        Column("source_tick", "", "of the readings that the order was computed from; -1: unknown", "int64"),
        Column("arrival_tick", "", "at which the order arrived; -1: there was none", "int64"),
        *([] if plant.spoken is None else plant.spoken.described()),
    ]


def stacked(columns: Sequence[Column], flown: Sequence[dict[str, NumpyArray]]) -> dict[str, NumpyArray]:
    """Stack the orders of T ticks, {column: (n,)} each, to {column: (T, n)}."""
    found = {name: np.stack([tick[name] for tick in flown]) for name in flown[0]}
    numbers = found.pop("numbers")
    found |= {f"number_{i}": numbers[..., i] for i in range(numbers.shape[-1])}
    return {column.name: found[column.name].astype(column.dtype) for column in columns}
