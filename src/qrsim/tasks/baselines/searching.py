"""Search that surveys from high up as long as time allows, and visits on short tours who is suspected."""

from __future__ import annotations

from typing import Any

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.tasks.baselines.belief import Belief, view
from qrsim.tasks.baselines.coverage import Coverage
from qrsim.tasks.baselines.separation import apart
from qrsim.tasks.baselines.tours import length, tours
from qrsim.tasks.baselines.visiting import HEIGHT, NEAR, SEPARATION, SPEED, over_ground, toward
from qrsim.tasks.play import Play

# Height of the survey [m], at most so far from the area's ceiling, and how steeply it is left for a person.
SURVEY, CEILING, SLOPE = 70.0, 8.0, 0.85
# Log odds that make a cell worth a visit, and that end one.
LIKELY, DOUBTFUL = -0.5, -4.0
# Persons are told apart from this distance on; around one that was visited nobody else is expected [m].
APART, DONE = 3.0, 2.5
# Steps that a visit lasts at most, and steps at rest near the place after which a person has been found.
PATIENCE, REST_STEPS, REST_M = 9, 1, 0.09
# For the plan of time: pace of a tour [m/s], a stop [s], and what is kept in hand [s].
PACE, STOP_S, SPARE_S = 3.0, 9.0, 30.0
GAIN = 0.5
# Width of what a camera sees, for each metre of height.
SWATH = 0.42


class Searching:
    """A team that shares a belief map.

    Args:
        play: a search with lying persons in a box; nothing is drawn, so that ``seed`` changes nothing.
    """

    def __init__(self, play: Play, seed: int = 0):
        area: Any = play.world.area
        self._belief = Belief(play)
        self._coverage = Coverage(self._belief.low, self._belief.extent, self._belief.camera)
        self._height = max(HEIGHT, min(SURVEY, -float(area.z_min) - CEILING))
        self._limit = float(play.axes[0].high)
        self._left, self._period = play.steps, play.task.period
        count = len(play.agents)
        self._target = np.full((count, 2), np.nan)
        self._waited, self._rested = np.zeros(count, int), np.zeros(count, int)
        self._place: NumpyArray | None = None

    def act(self, seen: dict[str, NumpyArray]) -> NumpyArray:
        """Return actions (n, 3), scaled velocities NED, of a team that searches for persons."""
        place = np.asarray(seen["vehicle"][:, :3], np.float64).copy()
        for i in range(len(place)):
            if int(seen["grid"][i][0]):
                place[i] = self._look(seen["ratio"][i], seen["corners"][i], seen["grid"][i])
        before = place if self._place is None else self._place
        velocity = (place - before) / self._period
        self._place, self._left = place, self._left - 1
        for i in range(len(place)):
            if np.isfinite(self._target[i, 0]):
                self._follow(i, place[i], velocity[i])
        self._assign(place)
        yaw = np.asarray(seen["vehicle"][:, 8], np.float64)
        wanted = np.stack([self._steer(i, place, velocity[i], float(yaw[i])) for i in range(len(place))])
        return np.clip(over_ground(wanted + apart(place, SEPARATION), place) / self._limit, -1.0, 1.0)

    def _look(self, ratio: NumpyArray, corners: NumpyArray, grid: NumpyArray) -> NumpyArray:
        """Add a picture (log ratios, corners on the ground) to both maps; return the camera's position (3,) NED [m]."""
        corners = np.asarray(corners, np.float64)
        shown = view(corners, grid, self._belief.camera)
        places = self._belief.look(ratio, shown, corners, grid)
        if len(places):
            self._coverage.look(places, float(-shown.place[2]))
        return shown.place

    def _follow(self, i: int, here: NumpyArray, velocity: NumpyArray) -> None:
        """Update the suspected person that vehicle ``i`` at ``here`` visits; drop it if found, unlikely or too slow."""
        target, odds = self._belief.best(self._target[i], 1.5)
        near = float(np.linalg.norm(self._target[i] - here[:2])) < NEAR + 1.0 and -here[2] < HEIGHT + 1.0
        self._waited[i] += near
        self._rested[i] += near and float(np.linalg.norm(velocity)) * self._period < REST_M
        if odds < DOUBTFUL or self._waited[i] > PATIENCE or self._rested[i] >= REST_STEPS:
            self._belief.forget(self._target[i], DONE)
            self._target[i] = np.nan
        elif not near:
            self._target[i] = target

    def _assign(self, place: NumpyArray) -> None:
        """Assign suspected persons to vehicles as tours; vehicles survey on while the tours leave time."""
        suspected = self._belief.suspected(LIKELY, APART)
        if not len(suspected):
            self._target[:] = np.nan
            return
        orders = tours(place[:, :2], suspected[:24], PACE * STOP_S)
        left = self._left * self._period
        for i, order in enumerate(orders):
            if np.isfinite(self._target[i, 0]) and np.linalg.norm(self._target[i] - place[i, :2]) < 12.0:
                continue
            self._target[i] = np.nan
            if not order:
                continue
            way = length(place[i, :2], suspected, order)
            first = float(np.linalg.norm(suspected[order[0]] - place[i, :2]))
            down = max(0.0, (-place[i, 2] - HEIGHT) / SPEED - first / PACE)
            if left <= way / PACE + down + STOP_S * len(order) + SPARE_S:
                self._target[i] = suspected[order[0]]
                self._waited[i] = self._rested[i] = 0

    def _steer(self, i: int, place: NumpyArray, velocity: NumpyArray, yaw: float) -> NumpyArray:
        """Return the velocity NED (3,) [m/s] to command to vehicle ``i``, to visit a person or to survey."""
        here = place[i]
        if np.isfinite(self._target[i, 0]):
            distance = float(np.linalg.norm(self._target[i] - here[:2]))
            return toward(here, self._target[i], min(self._height, max(HEIGHT, SLOPE * (distance - NEAR))))
        swath = SWATH * max(-here[2], 15.0)
        way = self._coverage.heading(i, place[:, :2], velocity[:2], swath, yaw)
        cos, sin = np.cos(yaw), np.sin(yaw)
        largest = max(abs(cos * way[0] + sin * way[1]), abs(cos * way[1] - sin * way[0]), 1e-9)
        level = way * (SPEED / largest if way.any() else 0.0)
        return np.array([*level, np.clip(-GAIN * (self._height + here[2]), -SPEED, SPEED)])
