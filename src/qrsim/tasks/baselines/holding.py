"""Baseline of the simple tasks: tilt and throttle by the error of a velocity that leads to the goal."""

from __future__ import annotations

from typing import Any

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.tasks.baselines.inner import Inner
from qrsim.tasks.landing import Land
from qrsim.tasks.play import Play
from qrsim.tasks.simple import KeepVelocity, is_direct

# What the controller takes an action for, as the names of its numbers.
FLOWN = ("pitch", "roll", "throttle", "yaw_rate", "battery")
# Velocity for each metre of the way [1/s], and at most [m/s].
APPROACH, FASTEST = 0.4, 3.0
# A vehicle that lands aims at least this far below itself [m].
SINKING = 1.0
# Tilt and throttle for each m/s that is lacking, tilt at most [rad]; yaw rate for each radian [1/s].
TILT, LARGEST_TILT, THROTTLE, TURN = 0.12, 0.3, 0.1, 0.2


class Holding:
    """Flies a quadrotor to its goal, or along a line at the wanted velocity, heading north.

    Args:
        play: a simple task, whose action is the command of a quadrotor (``FLOWN``), or rates or motors of a multirotor.
        seed: nothing is drawn.
    """

    def __init__(self, play: Play, seed: int = 0):
        self._inner = Inner(play) if is_direct(play.task) else None
        self._axes, self._period = play.axes, play.task.period
        self._by_velocity, self._lands = isinstance(play.task, KeepVelocity), isinstance(play.task, Land)
        task: Any = play.task
        self._hover = float(np.asarray(task.effort.hover_throttle)) if self._inner is None else self._inner.hover
        self._start: Floats | None = None
        self._steps = 0

    def begin(self, size: int, rows: Floats | None = None) -> None:
        """Begin ``size`` episodes, all together; ``act`` then takes and returns (size, n, ...)."""
        self._start, self._steps = None, 0

    def act(self, seen: Floats) -> Floats:
        """Return actions (..., n, A) that fly to the goal.

        Args:
            seen: observations (..., n, 12), estimated state and offset to the goal; for rates and motors (..., n, 15),
                with the body rates.
        """
        position, velocity, yaw, offset = seen[..., :3], seen[..., 3:6], seen[..., 8], seen[..., 9:12]
        wanted = np.zeros_like(velocity)
        if self._by_velocity:
            # Who holds a velocity holds the line too: the error of a velocity alone lets a height drift.
            wanted = offset + velocity
            self._start = position.copy() if self._start is None else self._start
            offset = self._start + wanted * (self._steps * self._period) - position
        elif self._lands:
            # The estimated height may be wrong: it sinks until it stands.
            offset = np.concatenate([offset[..., :2], np.maximum(offset[..., 2:], SINKING)], axis=-1)
        self._steps += 1
        lacking = np.clip(APPROACH * offset, -FASTEST, FASTEST) + wanted - velocity
        cos, sin = np.cos(yaw), np.sin(yaw)
        north, east, down = np.moveaxis(lacking, -1, 0)
        ahead, right = cos * north + sin * east, cos * east - sin * north
        pitch, roll = (np.clip(TILT * part, -LARGEST_TILT, LARGEST_TILT) for part in (-ahead, right))
        command: Any = (pitch, roll, self._hover - THROTTLE * down, -TURN * yaw, np.full_like(yaw, np.inf))
        if self._inner is not None:
            command = self._inner.action(command, seen)
        parts = [axis.action(value) for value, axis in zip(command, self._axes, strict=True)]
        return np.stack(parts, axis=-1)
