"""The last minute of the vehicles' true and estimated paths, in pieces: only those that changed are sent."""

from __future__ import annotations

from typing import Any

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.runs.colours import GREY
from qrsim.view import shapes
from qrsim.view.frame import Frame
from qrsim.view.layers import MANY, MOST_LABELS, Layer

LENGTH_S = 60.0
# Corners of the paths of all vehicles together; of each path the fewest and most pieces, and the most corners of one.
SEGMENTS, FEWEST_PIECES, MOST_PIECES, MOST_CORNERS = 20_000, 8, 40, 15
ESTIMATE_COLOUR = GREY


class Paths(Layer):
    """The true path of each vehicle, in its colour.

    A path is a ring of pieces, and each piece of all vehicles is one node of the page. The newest piece grows and is
    sent as it does; the others lie still, and the oldest vanishes after a minute of simulated time.
    """

    title = "true paths"
    every = 10
    thickness = 3.0
    paints = True

    def begin(self) -> None:
        """Begin the drawn paths at the vehicles' start positions."""
        cast = self.stage.cast
        each = SEGMENTS // cast.size
        pieces = int(np.clip(each, FEWEST_PIECES, MOST_PIECES))
        self._corners = int(np.clip(each // pieces, 1, MOST_CORNERS))
        self._piece_s, self._corner_s = LENGTH_S / pieces, LENGTH_S / (pieces * self._corners)
        # One more than a minute needs, for the one that grows.
        self._points = np.repeat(cast.start_ned[None].astype(np.float32), (pieces + 1) * (self._corners + 1), axis=0)
        self._points = self._points.reshape(pieces + 1, self._corners + 1, cast.size, 3)
        self._stamps = np.zeros(self._points.shape[:2])
        self._from, self._to = np.zeros(pieces + 1), np.full(pieces + 1, -np.inf)
        self._newest, self._known, self._corner_at = 0, 1, 0.0
        self._time: float | None = None
        self._changed: set[int] = set()
        self._nodes: dict[int, Any] = {}
        self._painted = False

    def note(self, frame: Frame) -> None:
        """Extend the paths by the positions of a frame; an earlier time than the last restarts them."""
        self.extend(np.array([frame.time]), self.position(frame)[None])

    def missing(self, time: float) -> Floats:
        """Return times (K,) [s] at which positions are needed to draw paths up to ``time``, at most a minute back."""
        if self._time is not None and self._time <= time <= self._time + LENGTH_S:
            return np.arange(self._time + self._corner_s, time, self._corner_s)
        self._time = None
        return np.append(np.arange(max(0.0, time - LENGTH_S), time, self._corner_s), time)

    def extend(self, times: Floats, points: Floats) -> None:
        """Extend the paths by positions (K, n, 3) [m] at times (K,) [s]; an earlier time restarts them."""
        for time, point in zip(times.tolist(), points, strict=True):
            if self._time is None or time < self._time:
                self._restart(time, point)
            tip = self._points[self._newest, -1]
            self._points[self._newest, self._known :] = np.where(np.isfinite(point), point, tip)
            self._stamps[self._newest, self._known :] = time
            self._time = self._to[self._newest] = time
            self._changed.add(self._newest)
            if time - self._corner_at >= self._corner_s * (1.0 - 1e-6):
                self._keep_corner(time)
        self._forget()

    def _restart(self, time: float, point: Floats) -> None:
        """Begin each vehicle's path again at a time [s] and a position (n, 3) NED [m]."""
        self._points[:] = np.where(np.isfinite(point), point, self.stage.cast.start_ned)
        self._stamps[:] = time
        self._from[:], self._to[:] = time, -np.inf
        self._newest, self._known, self._corner_at = 0, 1, time
        self._changed = set(range(len(self._points)))

    def _keep_corner(self, time: float) -> None:
        """Keep the end of each path as a corner; begin a new piece of path if the present one is full."""
        self._known, self._corner_at = self._known + 1, time
        if self._known > self._corners or time - self._from[self._newest] >= self._piece_s * (1.0 - 1e-6):
            tip = self._points[self._newest, -1]
            self._newest, self._known = (self._newest + 1) % len(self._points), 1
            self._points[self._newest], self._stamps[self._newest] = tip, time
            self._from[self._newest] = self._to[self._newest] = time
            self._changed.add(self._newest)

    def _forget(self) -> None:
        """Remove the pieces of path that are older than a minute."""
        assert self._time is not None
        for number in np.flatnonzero(np.isfinite(self._to) & (self._to < self._time - LENGTH_S)).tolist():
            self._points[number], self._to[number] = self._points[number, -1], -np.inf
            self._changed.add(number)

    def position(self, frame: Frame) -> Floats:
        """Return the positions (n, 3) NED [m] of a frame that the paths join: the true ones."""
        return frame.position_ned

    def draw(self, frame: Frame) -> None:
        """Send browsers the pieces of path that have changed."""
        for number in self._changed:
            if number in self._nodes:
                self._nodes[number].points = self._segments(number)
                if self._painted or self.stage.paint:
                    self._nodes[number].colors = np.asarray(self._colours(number), np.uint8)
            # What has no length yet would weigh as much as a path.
            elif np.isfinite(self._to[number]):
                self._nodes[number] = self.stage.scene.add_line_segments(
                    f"{self.path}/{number}",
                    self._segments(number),
                    self._colours(number),
                    thickness=self.thickness,
                    thickness_units="screen",
                )
        self._changed.clear()
        self._painted = self.stage.paint is not None

    def repaint(self) -> None:
        """Send all pieces of path again at the next frame, because the colours have changed."""
        self._changed = set(range(len(self._points)))

    def _segments(self, number: int) -> Floats:
        """Return piece ``number`` of all vehicles' paths as line segments (corners * n, 2, 3) NED [m]."""
        points = self._points[number]
        return np.stack([points[:-1], points[1:]], axis=2).reshape(-1, 2, 3)

    def _colours(self, number: int) -> Any:
        """Return one colour for all segments of piece ``number``, or a colour for each end of each segment."""
        if self.paints and self.stage.paint is not None:
            own = shapes.linear(self.stage.paint.colours(self._stamps[number]))
            return np.stack([own[:-1], own[1:]], axis=2).reshape(-1, 2, 3)
        colours = self.stage.colours
        if (colours == colours[0]).all():
            return tuple(colours[0].tolist())
        return np.repeat(np.tile(shapes.linear(colours), (self._corners, 1))[:, None], 2, axis=1)


class Routes(Layer):
    """Where each vehicle is sent: from its start to one waypoint, or end of a leg, after the other."""

    title = "routes"
    most = MOST_LABELS
    every = 1000.0

    def begin(self) -> None:
        """Add all vehicles' routes to the scene as one set of lines."""
        pairs = [np.stack([route[:-1], route[1:]], axis=1) for route in self.stage.cast.routes]
        legs = np.concatenate(pairs).astype(np.float32)
        colours = np.repeat(shapes.linear(self.stage.colours), [len(own) for own in pairs], axis=0)
        self.stage.scene.add_line_segments(
            f"{self.path}/legs", legs, np.repeat(colours[:, None], 2, axis=1), thickness=1.0, thickness_units="screen"
        )


class EstimatedPaths(Paths):
    """The paths by the vehicles' own position estimates."""

    title = "estimated paths"
    most = MANY
    thickness = 1.5
    paints = False

    def position(self, frame: Frame) -> Floats:
        """Return the positions (n, 3) NED [m] of a frame that the paths join: the estimated ones."""
        return frame.estimate_ned

    def _colours(self, number: int) -> Any:
        """Return one colour for the estimated paths of all vehicles; with several runs, those of the runs."""
        return ESTIMATE_COLOUR if self.stage.cast.run_of is None else super()._colours(number)
