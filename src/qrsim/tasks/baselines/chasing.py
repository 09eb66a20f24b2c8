"""Cats that intercept the mouse, each on its own side of it, and drive it back to the middle of the area."""

from __future__ import annotations

from typing import Any

import numpy as np

from qrsim.tasks.play import Play

Array = np.ndarray[Any, Any]
# Where the cats are to be around the mouse [m]: far for most of the time, near at the end.
FAR, NEAR, CLOSING_STEPS = 14.0, 5.0, 30
# The cat behind the mouse is nearer by this part: the mouse then flees to where the others leave it room.
PUSH = 0.3
# Interception: the mouse is met where it will be after so many seconds.
AHEAD_S = 2.0
GAIN, SPEED = 1.0, 3.0
# Cats closer than this [m] move apart.
SEPARATION = 6.0


class Chasing:
    """Cats on a ring around the mouse.

    The mouse runs away from all cats at once, so those on a ring around it leave it nowhere to go; the cat on the far
    side of the middle of the area comes nearer, and the mouse runs to the middle.
    """

    def __init__(self, play: Play, seed: int = 0):
        self._mouse: Array | None = None
        self._velocity = np.zeros(2)
        self._left = play.steps
        area = play.world.area
        self._middle = 0.5 * np.array([float(area.x_min + area.x_max), float(area.y_min + area.y_max)])
        self._limit = float(play.task.axes[0].high)

    def act(self, seen: Array) -> Array:
        """Return the actions (n, 2)."""
        seen = np.asarray(seen, np.float64)
        place, velocity = seen[:, :2], seen[:, 2:4]
        mouse = np.mean(place + seen[:, 4:6], axis=0)
        if self._mouse is not None:
            # A measured step of one second, of which nobody is faster than the mouse.
            moved = mouse - self._mouse
            moved *= min(1.0, SPEED / max(float(np.linalg.norm(moved)), 1e-9))
            self._velocity = 0.5 * self._velocity + 0.5 * moved
        self._mouse = mouse
        self._left -= 1
        met = mouse + AHEAD_S * self._velocity
        wanted = self._velocity + GAIN * (met + self._ring(place - mouse, mouse) - place - AHEAD_S * velocity * 0.5)
        return np.clip((wanted + self._apart(place)) / self._limit, -1.0, 1.0)

    def _ring(self, offset: Array, mouse: Array) -> Array:
        """Return where on the ring each cat is to be (n, 2): evenly, each as near as can be to where it is."""
        count = len(offset)
        home = self._middle - mouse
        distance = float(np.linalg.norm(home))
        push = PUSH * min(1.0, distance / 15.0)
        # One place is behind the mouse, seen from the middle of the area.
        behind = np.arctan2(-home[1], -home[0])
        places = behind + 2.0 * np.pi * np.arange(count) / count
        bearing = np.arctan2(offset[:, 1], offset[:, 0])
        turns = [(bearing[:, None] - places[None] + np.pi) % (2.0 * np.pi) - np.pi]
        # The cats keep their order around the ring, and all of them take the shift that turns them least.
        order = np.argsort(bearing)
        costs = []
        for shift in range(count):
            taken = np.empty(count, int)
            taken[order] = (np.arange(count) + shift) % count
            costs.append((float(np.sum(turns[0][np.arange(count), taken] ** 2)), shift, taken))
        taken = min(costs, key=lambda cost: cost[:2])[2]
        far = NEAR + (FAR - NEAR) * min(1.0, max(0, self._left) / CLOSING_STEPS)
        radius = np.where(taken == 0, far * (1.0 - push), far * (1.0 + 0.5 * push))
        # A cat that has far to go round the ring goes round, not across.
        turn = (places[taken] - bearing + np.pi) % (2.0 * np.pi) - np.pi
        angle = bearing + np.clip(turn, -0.6, 0.6)
        return radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)

    @staticmethod
    def _apart(place: Array) -> Array:
        offset = place[:, None] - place[None]
        distance = np.linalg.norm(offset, axis=-1) + 1e9 * np.eye(len(place))
        strength = np.maximum(SEPARATION - distance, 0.0) / distance
        return np.sum(strength[:, :, None] * offset, axis=1)
