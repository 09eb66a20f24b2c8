"""The last minute of the vehicles' true and estimated paths."""

from __future__ import annotations

from typing import Any

import numpy as np

from qrsim.view.frame import Frame
from qrsim.view.layers import MANY, Layer

Floats = np.ndarray[Any, Any]
LENGTH_S = 60.0
# Of all vehicles together; each has at least the second and at most the third of these.
SEGMENTS, FEWEST, MOST = 40_000, 8, 600
ESTIMATE_COLOUR = (30, 30, 30)


class Paths(Layer):
    """The true path of each vehicle, in its colour."""

    title = "true paths"
    every = 30
    thickness = 3.0

    def begin(self) -> None:
        """Begin all paths at the start."""
        cast = self.stage.cast
        self._count = int(np.clip(SEGMENTS // cast.size, FEWEST, MOST))
        self._points = np.repeat(cast.start_ned[None].astype(np.float32), self._count + 1, axis=0)
        self._time, self._begun = np.zeros(self._count + 1), False
        if cast.size <= 50:
            self.every = 5
        self._handle = self.stage.scene.add_line_segments(
            f"{self.path}/lines", self._segments(), self._colours(), thickness=self.thickness, thickness_units="screen"
        )

    def note(self, frame: Frame) -> None:
        """Append a frame; an earlier time restarts the paths."""
        position = self.position(frame)
        if frame.time < self._time[-1] or not self._begun:
            self._begun = True
            self._time[:] = frame.time
            self._points[:] = np.where(np.isfinite(position), position, self.stage.cast.start_ned)
        elif frame.time - self._time[-2] >= LENGTH_S / self._count:
            self._points[:-1], self._time[:-1] = self._points[1:].copy(), self._time[1:].copy()
        self._points[-1], self._time[-1] = np.where(np.isfinite(position), position, self._points[-1]), frame.time

    def remember(self, time: Floats, points: Floats) -> None:
        """Set the paths from a recording: times (K,) [s] of ``sample`` and positions (K, n, 3) [m]."""
        self._time[:], self._points[:], self._begun = time, points, True

    def sample(self, time: float) -> Floats:
        """Return the times [s] of the corners of paths that end at a time."""
        return np.linspace(max(0.0, time - LENGTH_S), time, self._count + 1)

    def position(self, frame: Frame) -> Floats:
        """Return the positions (n, 3) [m] to draw of a frame."""
        return frame.position_ned

    def draw(self, frame: Frame) -> None:
        """Draw the paths."""
        self._handle.points = self._segments()

    def _segments(self) -> Floats:
        return np.stack([self._points[:-1], self._points[1:]], axis=2).reshape(-1, 2, 3)

    def _colours(self) -> Any:
        return np.repeat(np.tile(self.stage.colours, (self._count, 1))[:, None], 2, axis=1)


class EstimatedPaths(Paths):
    """The paths by the vehicles' own position estimates."""

    title = "estimated paths"
    most = MANY
    thickness = 1.5

    def position(self, frame: Frame) -> Floats:
        """Return the estimates (n, 3) [m]."""
        return frame.estimate_ned

    def _colours(self) -> Any:
        return ESTIMATE_COLOUR
