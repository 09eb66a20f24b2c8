"""What a run folder has of the radio: counts of packets, and the links to the nearest (docs/howto/radio.md)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import cast

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.models.radio.links import Links
from qrsim.simulation.history import History
from qrsim.world.state import World

# Of the nearest that could be heard, so many are logged.
LOGGED_LINKS = 8
_OF_LINKS = {
    "sender": ("", "number of the vehicle that sent to it in the last period, from the nearest; -1: nobody"),
    "rssi": ("dBm", "strength at which it was received"),
    "error": ("1", "chance of loss if nobody else sends"),
    "outcome": ("", "1 heard, 2 too weak, 3 lost by chance, 4 lost to others, 0 nothing for it"),
}


def radio_columns(world: World, history: History) -> list[tuple[str, NumpyArray, str, str]]:
    """Return (column, array (T, n), unit, doc) of each quantity logged about radio packets; [] without a radio."""
    if world.radio is None:
        return []
    items = [
        (f"radio.{name}", np.asarray(leaf), "1", "packets since the start")
        for name, leaf in world.radio.counted(history.state.radio).items()
    ]
    links = cast(Links, world.radio.links(history.state.radio))
    for number in range(min(LOGGED_LINKS, links.sender.shape[1])):
        items += [
            (f"radio.{name}.{number}", np.asarray(getattr(links, name))[:, number], unit, doc)
            for name, (unit, doc) in _OF_LINKS.items()
        ]
    return items


def links_logged(columns: Iterable[str]) -> int:
    """Return how many neighbours per vehicle a log with these columns describes; 0 without a radio."""
    return sum(column.startswith("radio.sender.") for column in columns)
