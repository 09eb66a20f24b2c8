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
# Without a clock: how near cats are behind the mouse, and to each other there [m], how fast places are made good [1/s],
# and the mouse's speed [m/s], which replaces the drift. They are far where the mouse runs this far from where it is to
# run [rad]. They keep apart where they ask to be after so long [s], as a cat does not see the velocities of the others,
# and on their way to the mouse by this part of their distance to it.
NEAREST, LEAST_ROOM, SLOW_GAIN, FULL_SPEED = 4.4, 3.6, 0.5, 3.6
ASTRAY, FARTHER_AHEAD_S, ROOM = 2.5, 1.0, 0.5
# The mouse may turn towards a cat, so they keep this far [m] from where it will be after so long [s], and farther in
# front of it by so much [m]; each metre that lacks adds so much to their velocity [1/s].
CLEAR, CLEAR_AHEAD_S, IN_FRONT, CLEAR_GAIN, SHORTEST = 4.0, 1.5, 4.0, 2.0, 1e-3
# A mouse between cats turns round. The mean of the unit vectors from the cats to the mouse has this length or more if
# all are behind it; if it is shorter by so much, they keep far.
TOGETHER, SCATTERED = 0.75, 0.8


class Chasing:
    """Cats in a fan behind the mouse.

    Who runs as fast as they do cannot be overtaken, but it runs away from all of them: cats that go to one side of its
    way turn it to the other side. It is led round the middle of the area, and is followed closely at the end.

    Args:
        play: the pursuit and its world.
        seed: nothing is drawn.
        timeless: the mouse is followed closely whenever it runs where it is to run, as policies without a clock can do.
    """

    def __init__(self, play: Play, seed: int = 0, timeless: bool = False):
        area: Any = play.world.area
        self._middle = 0.5 * np.array([float(area.x_min + area.x_max), float(area.y_min + area.y_max)])
        self._limit = float(play.axes[0].high)
        self._steps, self._timeless = play.steps, timeless
        self._left: Any = play.steps
        self._asked: NumpyArray | None = None
        self._drift = np.zeros(2)

    def act(self, seen: NumpyArray) -> NumpyArray:
        """Return the actions (..., n, 2) of the cats for observations (..., n, O), of one episode or of many."""
        seen = np.asarray(seen, np.float64)
        place, velocity = seen[..., :2], seen[..., 2:4]
        mouse = np.mean(place + seen[..., 4:6], axis=-2, keepdims=True)
        if self._asked is not None and not self._timeless:
            lacking = np.nan_to_num(np.mean(self._asked - velocity, axis=-2, keepdims=True))
            self._drift = self._drift + LEARN * (lacking - self._drift)
        offset = mouse - place
        square = np.sum(offset**2, axis=-1, keepdims=True)
        away = np.sum(offset / square, axis=-2, keepdims=True)
        runs = np.arctan2(away[..., 1], away[..., 0])
        astray = _wrap_angle(self._way(mouse) - runs)
        turn = np.clip(astray, -STEER, STEER)
        if self._timeless:
            behind, distance = self._by_state(astray, offset, np.sqrt(square))
        else:
            behind, distance = self._by_time()
        goal = mouse + behind * self._fan(offset, runs + turn)
        speed, gain = (FULL_SPEED, SLOW_GAIN) if self._timeless else (MOUSE_SPEED, GAIN)
        running = speed * np.stack([np.cos(runs), np.sin(runs)], axis=-1)
        self._asked = np.clip(running + gain * (goal - place), -self._limit, self._limit)
        ahead = FARTHER_AHEAD_S * self._asked if self._timeless else AHEAD_S * velocity
        wanted = self._asked + self._drift + apart(place + ahead, distance)
        if self._timeless:
            wanted = wanted + self._clear(self._asked, running / FULL_SPEED, offset)
        return np.clip(wanted / self._limit, -1.0, 1.0)

    def begin(self, size: int, rows: NumpyArray | None = None) -> None:
        """Begin ``size`` episodes side by side, or the next episodes in some of their rows."""
        if rows is None or self._asked is None:
            self._left, self._drift = np.full((size, 1, 1), self._steps), np.zeros((size, 1, 2))
            self._asked = None
            return
        # What was asked in another episode tells nothing of the drift.
        self._left[rows], self._drift[rows], self._asked[rows] = self._steps, 0.0, np.nan

    def _by_time(self) -> tuple[Any, Any]:
        """Return how far cats are behind the mouse, and at least from each other [m]: near at the end."""
        closing = np.clip(self._left / CLOSING_STEPS, 0.0, 1.0)
        self._left = self._left - 1
        return NEAR + (FAR - NEAR) * closing, SEPARATION_AT_END + (SEPARATION - SEPARATION_AT_END) * closing

    @staticmethod
    def _by_state(astray: NumpyArray, offset: NumpyArray, length: NumpyArray) -> tuple[NumpyArray, NumpyArray]:
        """Return how far cats are behind the mouse, and at least from each other [m]: near where cats lead the mouse.

        Args:
            astray: (..., 1) angle from where the mouse runs to where it is to run [rad].
            offset: (..., n, 2) from each cat to the mouse [m].
            length: (..., n, 1) of these [m].
        """
        together = np.linalg.norm(np.mean(offset / length, axis=-2), axis=-1, keepdims=True)
        part = np.maximum(np.abs(astray) / ASTRAY, (TOGETHER - together) / SCATTERED)
        part = np.minimum(part, 1.0)[..., None]
        room = LEAST_ROOM + (SEPARATION - LEAST_ROOM) * part
        return NEAREST + (FAR - NEAREST) * part, np.maximum(room, ROOM * length)

    @staticmethod
    def _clear(velocity: NumpyArray, runs: NumpyArray, offset: NumpyArray) -> NumpyArray:
        """Return the velocities (..., n, 2) [m/s] that keep cats clear of the mouse.

        Args:
            velocity: (..., n, 2) of each cat [m/s].
            runs: (..., 1, 2) unit vector of the way in which the mouse runs.
            offset: (..., n, 2) from each cat to the mouse [m].
        """
        meeting = CLEAR_AHEAD_S * (velocity - MOUSE_SPEED * runs) - offset
        ahead = -np.sum(offset * runs, axis=-1, keepdims=True) / np.linalg.norm(offset, axis=-1, keepdims=True)
        room = CLEAR + IN_FRONT * np.maximum(ahead, 0.0)
        length = np.maximum(np.linalg.norm(meeting, axis=-1, keepdims=True), SHORTEST)
        found: NumpyArray = CLEAR_GAIN * np.maximum(room / length - 1.0, 0.0) * meeting
        return found

    def _way(self, mouse: NumpyArray) -> NumpyArray:
        """Return the heading (..., 1) [rad] in which to drive the mouse at (..., 1, 2) [m], to stay near the middle."""
        offset = mouse - self._middle
        distance = np.linalg.norm(offset, axis=-1)
        outward = np.arctan2(offset[..., 1], offset[..., 0])
        return outward + 0.5 * np.pi * (1.0 + np.clip((distance - ORBIT) / PULL, -1.0, 1.0))

    @staticmethod
    def _fan(offset: NumpyArray, heading: NumpyArray) -> NumpyArray:
        """Return the directions (..., n, 2) from the mouse to each cat's goal, a fan in their present order.

        Args:
            offset: (..., n, 2) from each cat to the mouse [m].
            heading: (..., 1) of the mouse [rad].
        """
        side = _wrap_angle(np.arctan2(offset[..., 1], offset[..., 0]) - heading)
        rank = np.argsort(np.argsort(side, axis=-1), axis=-1)
        angle = heading + FAN * (rank - 0.5 * (offset.shape[-2] - 1))
        return -np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _wrap_angle(angle: Any) -> Any:
    """Return an angle [rad] wrapped to the interval from -pi to pi."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi
