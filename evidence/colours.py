"""How far apart the colours of vehicles are, seen with all cones, without the medium and without the long ones."""

from __future__ import annotations

from typing import Any

import numpy as np
from tests.runs.colour_vision import VISIONS, seen, smallest

from qrsim.runs import colours

DOC = "smallest CIEDE2000 differences of the colours of the page, the figures and the exports"
# As many vehicles as the smallest difference is promised for, beside what has stopped.
PROMISED = 8


def run(full: bool) -> dict[str, Any]:
    """Return the smallest differences of any two colours by vision; both forms are the same."""
    others = (colours.MISSING, colours.FOUND, colours.GUST, colours.PLUME)
    sets = {
        "eight": [*colours.VEHICLES[:PROMISED], colours.STOPPED],
        "ten": [*colours.VEHICLES, colours.STOPPED],
        "all": [*colours.VEHICLES, colours.STOPPED, *others],
    }
    found: dict[str, Any] = {
        name: {vision: smallest(np.array(own), vision) for vision in VISIONS} for name, own in sets.items()
    }
    for name in sets:
        found[name]["smallest"] = min(found[name].values())
    found["wind"] = {vision: float(np.diff(-seen(colours.WIND, vision)[:, 0]).min()) for vision in VISIONS}
    found["wind"]["smallest"] = min(found["wind"].values())
    return found
