"""Oracle of a search: it knows where all persons lie, and visits them on short tours."""

from __future__ import annotations

from typing import Any

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.tasks.agents import fleet_of
from qrsim.tasks.baselines.separation import apart
from qrsim.tasks.baselines.tours import tours
from qrsim.tasks.baselines.visiting import SEPARATION, over_ground, toward
from qrsim.tasks.play import Play

# What the stop at a person costs, as a length of way [m].
STOP = 20.0


class Touring:
    """Vehicles that are told the truth of every step: from person to person, low over the ground.

    It bounds what a search can find by flying alone, but is no proof: its tours and stops are good, not the best.
    """

    def __init__(self, play: Play, seed: int = 0):
        self._play = play
        self._limit = float(play.axes[0].high)
        self._state: Any = None
        self._tours: list[list[int]] | None = None

    def know(self, state: object) -> None:
        """Take the true state of the world, from which the next actions follow."""
        self._state = state

    def act(self, seen: object) -> NumpyArray:
        """Return actions (n, 3), scaled velocities NED, that visit the persons at their true positions."""
        model, fleet = fleet_of(self._play.world, self._state, self._play.task.fleet)
        pose = model.vehicle.pose(fleet.vehicle)
        place = np.asarray(pose.position_ned.stack(), np.float64)
        persons = self._state.contents.persons
        points = np.stack([np.asarray(persons.north), np.asarray(persons.east)], axis=1).astype(np.float64)
        missing = np.asarray(persons.there) & (np.asarray(persons.found_tick) < 0)
        if self._tours is None:
            known = np.flatnonzero(missing)
            self._tours = [[int(known[k]) for k in order] for order in tours(place[:, :2], points[known], STOP)]
        wanted = np.zeros_like(place)
        for i, order in enumerate(self._tours):
            self._tours[i] = order = [k for k in order if missing[k]]
            wanted[i] = toward(place[i], points[order[0]]) if order else np.zeros(3)
        return np.clip(over_ground(wanted + apart(place, SEPARATION), place) / self._limit, -1.0, 1.0)
