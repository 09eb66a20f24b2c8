"""Jammers, spoofers and discs: a mast at each, and a fence round what it reaches while it acts."""

from __future__ import annotations

import math

import numpy as np

from qrsim.runs.colours import GREY
from qrsim.runs.interferers import Interferer, of_world
from qrsim.view import shapes
from qrsim.view.frame import Frame
from qrsim.view.layers import Layer, Stage
from qrsim.world.state import World

INTERFERENCE = "jammers and spoofers"
# Corners of a fence; how high it is, by the width of all that is seen.
CORNERS, HIGH = 96, 0.04
# More places than these have no words.
MOST_NAMED = 20


class Interference(Layer):
    """What interferes with receivers at a place; it costs nothing but where something begins or ends."""

    title = INTERFERENCE
    every = 5.0

    def __init__(self, stage: Stage, found: tuple[Interferer, ...]):
        self._found = found
        super().__init__(stage)

    def begin(self) -> None:
        """Add a mast and a label for each GNSS interferer, and a hidden fence around its reach."""
        places = np.array([item.place_ned for item in self._found])
        tall, colour = 1.5 * self.stage.span, shapes.linear(GREY)
        self._places, self._active = places, np.zeros(len(places), bool)
        self.several("masts", mast(), places, colour, np.full((len(places), 3), tall, np.float32), receive_shadow=True)
        self._fences = self.several("fences", fence(), places, colour, opacity=0.35)
        for number, item in enumerate(self._found[:MOST_NAMED]):
            self.stage.scene.add_label(
                f"{self.path}/words{number}", item.label, position=places[number] - [0.0, 0.0, 1.2 * tall]
            )

    def draw(self, frame: Frame) -> None:
        """Show the fences of the interferers that are on at this frame's time."""
        active = np.array([item.acts(frame.time) for item in self._found])
        if np.array_equal(active, self._active):
            return
        self._active = active
        reach = np.array([item.radius for item in self._found])
        high = np.maximum(HIGH * self.stage.cast.extent, 0.02 * reach)
        size = np.stack([reach, reach, high], axis=1) * active[:, None]
        self._fences.batched_scales = size.astype(np.float32)


def fence() -> shapes.Mesh:
    """Return the mesh of an upright cylindrical band of radius 1 and height 1, centred on the origin."""
    angles = np.arange(CORNERS) * 2.0 * math.pi / CORNERS
    rim = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    corners = np.concatenate([np.column_stack([rim, np.full(CORNERS, z)]) for z in (-0.5, 0.5)])
    i, j = np.arange(CORNERS), np.roll(np.arange(CORNERS), -1)
    faces = np.concatenate([np.stack([i, j, j + CORNERS], axis=1), np.stack([i, j + CORNERS, i + CORNERS], axis=1)])
    return corners.astype(np.float32), faces.astype(np.uint32)


def mast() -> shapes.Mesh:
    """Return the mesh of a mast of height 1, from the origin upwards, with a ball at its top."""
    parts = [shapes.box((-0.03, -0.03, -1.0), (0.03, 0.03, 0.0))]
    parts += [
        shapes.box((-a, -b, -1.0 - c), (a, b, -1.0 + c))
        for a, b, c in ((0.2, 0.12, 0.12), (0.12, 0.2, 0.12), (0.12, 0.12, 0.2))
    ]
    return shapes.merged(*parts)


def interference_layers(stage: Stage, world: World) -> list[Layer]:
    """Return a list with the layer of GNSS interferers that have a position, [] if there are none."""
    found = tuple(item for item in of_world(world) if item.place_ned is not None)
    return [Interference(stage, found)] if found else []
