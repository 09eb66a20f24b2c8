"""Cats that follow the mouse in a fan, steer it round the middle of the area from behind, and close in at the end."""

from __future__ import annotations

from typing import Any

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.tasks.baselines.separation import apart
from qrsim.tasks.play import Play

# The mouse is to run round the middle of the area at this distance [m]; so far off it runs straight to it.
ORBIT, PULL = 45.0, 30.0
# Where the cats are behind the mouse: how far for most of the time and at the end [m], bearing between two [rad].
FAR, NEAR, CLOSING_STEPS, FAN = 9.0, 4.5, 40, 0.8
# The fan is turned from where the mouse runs to where it is to run by no more than this [rad].
STEER = 0.6
MOUSE_SPEED = 3.0
# Cats keep apart where they will be after so long [s].
AHEAD_S = 0.7
# How fast places are made good [1/s], and how fast it is learned what the wind adds to a velocity, a step.
GAIN, LEARN = 0.7, 0.15
# Cats closer than this [m] move apart.
SEPARATION, SEPARATION_AT_END = 6.0, 4.0


class Chasing:
    """Cats in a fan behind the mouse.

    Who runs as fast as they do cannot be overtaken, but it runs away from all of them: cats that go to one side of its
    way turn it to the other side. It is led round the middle of the area, and is followed closely at the end.
    """

    def __init__(self, play: Play, seed: int = 0):
        area: Any = play.world.area
        self._middle = 0.5 * np.array([float(area.x_min + area.x_max), float(area.y_min + area.y_max)])
        self._limit = float(play.axes[0].high)
        self._left = play.steps
        self._asked: NumpyArray | None = None
        self._drift = np.zeros(2)

    def act(self, seen: NumpyArray) -> NumpyArray:
        """Return the actions (n, 2), scaled velocities north and east, of cats that drive the mouse together."""
        seen = np.asarray(seen, np.float64)
        place, velocity = seen[:, :2], seen[:, 2:4]
        mouse = np.mean(place + seen[:, 4:6], axis=0)
        if self._asked is not None:
            self._drift = self._drift + LEARN * (np.mean(self._asked - velocity, axis=0) - self._drift)
        closing = min(1.0, max(0.0, self._left / CLOSING_STEPS))
        self._left -= 1
        offset = mouse - place
        away = np.sum(offset / np.sum(offset**2, axis=1, keepdims=True), axis=0)
        runs = float(np.arctan2(away[1], away[0]))
        turn = np.clip(_wrap_angle(self._way(mouse) - runs), -STEER, STEER)
        goal = mouse + (NEAR + (FAR - NEAR) * closing) * self._fan(offset, runs + turn)
        running = MOUSE_SPEED * np.array([np.cos(runs), np.sin(runs)])
        self._asked = np.clip(running + GAIN * (goal - place), -self._limit, self._limit)
        distance = SEPARATION_AT_END + (SEPARATION - SEPARATION_AT_END) * closing
        wanted = self._asked + self._drift + apart(place + AHEAD_S * velocity, distance)
        return np.clip(wanted / self._limit, -1.0, 1.0)

    def _way(self, mouse: NumpyArray) -> float:
        """Return the heading [rad] in which to drive the mouse at (2,) [m], so that it stays near the area's middle."""
        offset = mouse - self._middle
        distance = float(np.linalg.norm(offset))
        outward = float(np.arctan2(offset[1], offset[0]))
        return outward + 0.5 * np.pi * (1.0 + np.clip((distance - ORBIT) / PULL, -1.0, 1.0))

    @staticmethod
    def _fan(offset: NumpyArray, heading: float) -> NumpyArray:
        """Return unit vectors (n, 2) from a mouse that runs at ``heading`` to its cats' goals, a fan in their order."""
        count = len(offset)
        side = _wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - heading)
        rank = np.argsort(np.argsort(side))
        angle = heading + FAN * (rank - 0.5 * (count - 1))
        return -np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _wrap_angle(angle: Any) -> Any:
    """Return an angle [rad] wrapped to the interval from -pi to pi."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi
