"""Places that a task is about: a cross at a goal, an octahedron at a source, boxes where something is asked for."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.runs.colours import GREY, PLUME, Colour
from qrsim.tasks.places import Places
from qrsim.view import shapes
from qrsim.view.layers import Layer, Stage

# More goals than these have no words: they would hide each other.
MOST_NAMED = 3
GOALS, SOURCES, LOCATIONS = "goals", "sources", "places asked for"


class _Marks(Layer):
    """Base: one mesh at each place; they stay where they are."""

    every = 1000.0
    colour: ClassVar[Colour] = GREY
    # Size in spans of a vehicle.
    spans: ClassVar[float] = 1.0

    def __init__(self, stage: Stage, places: Floats):
        self._places = places
        super().__init__(stage)

    def mesh(self) -> shapes.Mesh:
        """Return the mesh of one mark, of size 1."""
        raise NotImplementedError

    def begin(self) -> None:
        """Add a mark to the scene at each place of the task."""
        count, (corners, faces) = len(self._places), self.mesh()
        mesh = corners.astype(np.float32), faces.astype(np.uint32)
        scales = np.full((count, 3), self.spans * self.stage.span, np.float32)
        self.several("marks", mesh, self._places, shapes.linear(self.colour), scales)


class Goals(_Marks):
    """Where vehicles are to be."""

    title = GOALS
    spans = 1.4

    def mesh(self) -> shapes.Mesh:
        """Return the mesh of a goal's mark: three crossing bars, one along each axis."""
        bars = [[0.5 if axis == along else 0.015 for axis in range(3)] for along in range(3)]
        return shapes.merged(*(shapes.box((-a, -b, -c), (a, b, c)) for a, b, c in bars))

    def begin(self) -> None:
        """Add a mark to the scene at each goal, with labels if there are few."""
        super().begin()
        for number, place in enumerate(self._places if len(self._places) <= MOST_NAMED else ()):
            above = place - [0.0, 0.0, 1.5 * self.stage.span]
            self.stage.scene.add_label(f"{self.path}/words{number}", "goal", position=tuple(above))


class Sources(_Marks):
    """Where a plume comes from."""

    title, colour = SOURCES, PLUME

    def mesh(self) -> shapes.Mesh:
        """Return the mesh of a source's mark: an octahedron."""
        corners = 0.5 * np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], float)
        return corners, np.array([(x, y, z) for x in (0, 1) for y in (2, 3) for z in (4, 5)])


class Locations(_Marks):
    """Where the task asks for the concentration."""

    title = LOCATIONS
    spans = 0.15

    def mesh(self) -> shapes.Mesh:
        """Return the mesh of a location's mark: a box."""
        return shapes.box((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5))


def task_layers(stage: Stage, places: Places | None) -> list[Layer]:
    """Return the layers of a task's goals, sources and locations that there are; [] without a task."""
    if places is None:
        return []
    parts = ((Goals, places.goals), (Sources, places.sources), (Locations, places.locations))
    return [layer(stage, found) for layer, found in parts if len(found)]
