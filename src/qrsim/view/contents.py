"""Contents of a world besides vehicles: ground cover, persons, plume."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from qrsim.core.arrays import Floats
from qrsim.models.scene.contents import ContentsState
from qrsim.runs.colours import FOUND, MISSING, PLUME
from qrsim.view import shapes
from qrsim.view.frame import Beside, Frame
from qrsim.view.layers import Layer, Stage, down_at
from qrsim.world.state import World

# Of the classes of the ground, from the second on: clutter and occlusion.
COVER_COLOURS = np.array([(190, 170, 90), (70, 110, 50)], np.uint8)
MISSING_COLOUR, FOUND_COLOUR, PLUME_COLOUR = MISSING, FOUND, PLUME
# Of a plume: places where it is asked for, and those of them that are drawn; below this part of its peak none is.
PLACES, DRAWN, FAINTEST = 20_000, 1500, 0.01


class Contents(Layer):
    """Base of the layers of contents; unknown contents are not drawn."""

    every = 10

    def __init__(self, stage: Stage, world: World):
        self.world = world
        super().__init__(stage)

    def draw(self, frame: Frame) -> None:
        """Draw ground cover, persons or plume at the frame's time, if the frame has the world's contents."""
        if frame.beside is not None:
            self.look(frame.beside, frame.time)

    def look(self, beside: Beside, time: float) -> None:
        """Draw the layer at a time [s] from the world's contents (``beside``)."""


class Cover(Contents):
    """Ground cover classes, drawn once."""

    title = "terrain"

    def begin(self) -> None:
        """Add no nodes yet: the ground cover is drawn once its map is known."""
        self._drawn = False

    def look(self, beside: Beside, time: float) -> None:
        """Add a flat plate to the scene for each class of ground cover except clear ground."""
        if self._drawn:
            return
        self._drawn = True
        cells = np.asarray(self.world.contents.terrain.cells(beside.contents.terrain))
        area: Any = self.world.area
        low, high = (np.array([float(area.x_min), float(area.y_min)]), np.array([float(area.x_max), float(area.y_max)]))
        for kind, colour in enumerate(COVER_COLOURS.tolist(), start=1):
            if (cells == kind).any():
                corners, faces = plate(cells == kind, low, high)
                corners[:, 2] = down_at(self.world.ground, corners[:, 0], corners[:, 1]) - self.stage.lift
                self.stage.scene.add_mesh_simple(
                    f"{self.path}/class{kind}",
                    corners.astype(np.float32),
                    faces.astype(np.uint32),
                    color=tuple(colour),
                    flat_shading=True,
                    side="double",
                    cast_shadow=False,
                )


def plate(there: Floats, low: Floats, high: Floats) -> shapes.Mesh:
    """Return a flat mesh of the True cells of ``there`` (N, M), a grid between corners ``low``, ``high`` (2,) [m].

    Neighbours share their corners, so nothing shows through between them.
    """
    rows, columns = there.shape
    north, east = (np.linspace(low[axis], high[axis], count + 1) for axis, count in enumerate((rows, columns)))
    grid = np.stack([*np.meshgrid(north, east, indexing="ij"), np.zeros((rows + 1, columns + 1))], axis=-1).reshape(
        -1, 3
    )
    i, j = np.nonzero(there)
    first = i * (columns + 1) + j
    near, far = first + 1, first + columns + 1
    faces = np.concatenate([np.stack([first, far, near], axis=1), np.stack([near, far, far + 1], axis=1)])
    used, faces = np.unique(faces, return_inverse=True)
    return grid[used], faces.reshape(-1, 3)


class Persons(Contents):
    """A pin at each person: yellow until found, then dark green."""

    title = "persons"

    def begin(self) -> None:
        """Add no nodes yet: the persons are drawn once their positions are known."""
        self._handle: Any = None

    def look(self, beside: Beside, time: float) -> None:
        """Draw a pin for each person on the ground, in another colour if it has been found by ``time`` [s]."""
        persons = beside.contents.persons
        there, found = np.asarray(persons.there), np.asarray(persons.found_tick) >= 0
        colours = shapes.linear(np.where(found[:, None], FOUND_COLOUR, MISSING_COLOUR))
        tall = np.where(there, 0.8 * self.stage.span, 0.0)
        scales = np.repeat(tall, 3).reshape(-1, 3).astype(np.float32)
        if self._handle is not None:
            self._handle.batched_colors, self._handle.batched_scales = colours, scales
            return
        down = down_at(self.world.ground, np.asarray(persons.north), np.asarray(persons.east))
        places = np.stack([persons.north, persons.east, down], axis=1)
        self._handle = self.several("persons", shapes.pin(), places, colours, scales, side="front", receive_shadow=True)


class Plume(Contents):
    """A plume as translucent points at the highest of many sampled concentrations."""

    title = "plume"
    every = 30

    def begin(self) -> None:
        """Add the scene nodes of the plume, and draw random sample points in the area."""
        area, rng = self.world.area, np.random.default_rng(1)
        low, high = ([float(getattr(area, f"{axis}_{end}")) for axis in "xyz"] for end in ("min", "max"))
        self._dtype = np.asarray(self.world.fleets[0].start.position_ned.x).dtype
        self._places = rng.uniform(low, high, (PLACES, 3)).astype(self._dtype)
        self._ask = jax.jit(_concentration)
        self._handle = self.several(
            "points",
            shapes.box((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)),
            np.zeros((DRAWN, 3)),
            shapes.linear(PLUME_COLOUR),
            batched_opacities=np.zeros(DRAWN, np.float32),
            opacity=0.6,
            flat_shading=False,
            side="front",
        )

    def look(self, beside: Beside, time: float) -> None:
        """Evaluate the concentration at random points at a time [s] and show the points of highest concentration."""
        tick = np.int32(round(time / self.world.time_step))
        with jax.enable_x64(self._dtype == np.float64):
            found = np.asarray(self._ask(beside.world, beside.drawn, beside.contents, tick, self._places))
        strongest = np.argsort(found)[-DRAWN:]
        share = found[strongest] / max(float(found.max()), 1e-30)
        size = np.where(share > FAINTEST, 0.35 * self.stage.span, 0.0)
        self._handle.batched_positions = self._places[strongest]
        self._handle.batched_scales = np.repeat(size, 3).reshape(-1, 3)
        self._handle.batched_opacities = np.sqrt(share).astype(np.float32)


def _concentration(world: World, drawn: Any, contents: ContentsState, tick: Any, places: Any) -> jax.Array:
    """Return the summed plume concentration (k,) at places (k, 3) NED [m] at a tick."""
    from qrsim.core.vectors import Vec3
    from qrsim.world.episode import surroundings

    around = surroundings(world.with_drawn(drawn), contents, tick)
    return around.concentration(Vec3(places[:, 0], places[:, 1], places[:, 2]))


def contents_layers(stage: Stage, world: World) -> list[Layer]:
    """Return the layers of ground cover, persons and plume that a world has; its area must be a box."""
    if not world.area.is_box:
        return []
    parts = (("terrain", Cover), ("persons", Persons), ("plume", Plume))
    return [layer(stage, world) for name, layer in parts if getattr(world.contents, name).random]
