"""Baseline of a search by numbers: to the likeliest window of a picture, or along a pattern until one is likely."""

from __future__ import annotations

from typing import Any

import numpy as np

from qrsim.core.arrays import Floats, NumpyArray
from qrsim.tasks.baselines.separation import apart
from qrsim.tasks.baselines.visiting import SEPARATION, over_ground, toward
from qrsim.tasks.play import Play

# Height of the pattern [m], at most so far from the ceiling of the area.
SURVEY, CEILING = 12.0, 5.0
# Corners of the pattern, in parts of half a side of the area, and the distance at which one is reached [m].
CORNERS, REACHED = ((0.45, 0.45), (0.45, -0.45), (-0.45, -0.45), (-0.45, 0.45)), 3.0


class Spotting:
    """Flies each vehicle to the window that most likely has a person, and otherwise around the middle of the area.

    Args:
        play: a search in a box with ``observes: likeliest``.
        seed: nothing is drawn.
    """

    def __init__(self, play: Play, seed: int = 0):
        area: Any = play.world.area
        low, high = (np.array([float(getattr(area, f"{axis}_{end}")) for axis in "xy"]) for end in ("min", "max"))
        self._corners = 0.5 * (low + high) + 0.5 * (high - low) * np.array(CORNERS)
        self._height = min(SURVEY, -float(area.z_min) - CEILING)
        self._limit = float(play.axes[0].high)
        # Vehicles begin at different corners.
        self._next = np.arange(len(play.agents)) % len(CORNERS)

    def act(self, seen: Floats) -> Floats:
        """Return actions (n, 3), scaled velocities NED, to likely persons or around the area, for ``seen`` (n, 12)."""
        seen = np.asarray(seen, np.float64)
        place, to_window = seen[:, :3], seen[:, 9:11]
        wanted = np.stack(
            [
                toward(here, here[:2] + offset) if offset.any() else self._on_pattern(number, here)
                for number, (here, offset) in enumerate(zip(place, to_window, strict=True))
            ]
        )
        found: Floats = np.clip(over_ground(wanted + apart(place, SEPARATION), place) / self._limit, -1.0, 1.0)
        return found

    def _on_pattern(self, number: int, here: NumpyArray) -> NumpyArray:
        """Return the velocity NED (3,) [m/s] of vehicle ``number`` at ``here`` (3,) to its next survey corner."""
        if np.linalg.norm(self._corners[self._next[number]] - here[:2]) < REACHED:
            self._next[number] = (self._next[number] + 1) % len(CORNERS)
        return toward(here, self._corners[self._next[number]], self._height)
