"""Layers of the page: one class for each group of things that is shown or hidden together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
from viser import SceneApi

from qrsim.core.arrays import Floats, NumpyArray
from qrsim.core.tree import record_of
from qrsim.core.vectors import Vec3
from qrsim.interface.arrays import quaternion_of
from qrsim.models.scene.contracts import Ground
from qrsim.runs.colours import GREY, GUST, STOPPED
from qrsim.view import shapes
from qrsim.view.frame import Cast, Frame
from qrsim.view.paint import Paint
from qrsim.view.sky import Satellite

STOPPED_COLOUR, GUST_COLOUR, GHOST_COLOUR, POLE_COLOUR = STOPPED, GUST, GREY, GREY
# More labels than this cannot be read.
MOST_LABELS = 20
# Of more vehicles than this, what shows where they are believed to be cannot be told apart from where they are.
MANY = 200
# Of more vehicles than this, what is beside them is drawn less often, as the root of their number.
FULL_RATE = 100
# The strongest wind that has a colour of its own [m/s].
STRONG_WIND = 12.0
# Of several runs, all but the first are drawn so opaque.
GHOSTLY = 0.6
# Lengths of arrows, in spans of a vehicle for each m/s.
ARROW_SPANS = 0.3


@dataclass
class Stage:
    """The drawing surface of the layers.

    Attributes:
        scene: of the page.
        cast: who is in it.
        span: how large a vehicle is drawn [m].
        chosen: numbers of the vehicles that browsers have chosen.
        ground: what vehicles fly over; None: the plane z = 0.
        sky: returns the satellites of a vehicle, none where nothing is known of them.
        paint: colours of vehicles and true paths by a quantity; None: those of the vehicles.
    """

    scene: SceneApi
    cast: Cast
    span: float
    chosen: frozenset[int] = frozenset()
    ground: Ground | None = None
    paint: Paint | None = None
    sky: Callable[[int], list[Satellite]] = lambda vehicle: []
    palette: ClassVar[Floats] = shapes.PALETTE

    @property
    def lift(self) -> float:
        """Height [m] between flat things drawn on the ground one above the other, so that none flickers."""
        return max(0.1, self.cast.extent / 800.0)

    @property
    def few(self) -> bool:
        """Whether there are so few vehicles that each has a different colour."""
        return self.cast.run_of is None and self.cast.size <= len(self.palette)

    @property
    def hues(self) -> NumpyArray:
        """Palette indices (n,) of the vehicles: one each while they are few, otherwise one per run or fleet."""
        groups = self.cast.fleets if self.cast.run_of is None else self.cast.run_of
        return np.asarray((np.arange(self.cast.size) if self.few else groups) % len(self.palette))

    @property
    def colours(self) -> Floats:
        """Colours (n, 3) of the vehicles, sRGB 0 to 255."""
        return self.palette[self.hues]


def down_at(ground: Ground, north: Floats, east: Floats) -> Floats:
    """Return the down coordinate [m] of the ground at north and east [m] of any shape."""
    places = record_of(Vec3, np.float32(north), np.float32(east), np.zeros_like(north, np.float32))
    return np.asarray(ground.down(places))


class Layer:
    """Base of all layers; its nodes are children of ``root``.

    Attributes:
        title: what the page calls it.
        every: it is drawn anew at every so-many-th frame, on average.
        most: of more vehicles than these it is hidden at first.
        beside: whether it shows something about each vehicle beside the vehicle itself; of many it is drawn less often.
        most_in_film: a page without a server has it at so many times at most, None: at all that it has.
        in_film: whether a page without a server has it.
        of_chosen: whether it shows something else once other vehicles are chosen.
        always: whether it is drawn while it is hidden too, because it then shows something else.
    """

    title = ""
    every: float = 1
    most = 1_000_000
    beside = False
    most_in_film: int | None = None
    in_film = True
    of_chosen = always = False

    def __init__(self, stage: Stage):
        self.stage = stage
        self.path = f"/world/{type(self).__name__.lower()}"
        if self.beside:
            self.every *= max(1.0, stage.cast.size / FULL_RATE) ** 0.5
        self.root = stage.scene.add_frame(self.path, show_axes=False, visible=stage.cast.size <= self.most)
        self.begin()

    @property
    def label(self) -> str:
        """Return the layer's name in the list of an exported page."""
        return self.title

    def begin(self) -> None:
        """Add the layer's nodes to viser's scene."""

    def draw(self, frame: Frame) -> None:
        """Update the layer's scene nodes to a frame: the vehicles and surroundings at one time."""

    def batch(self, name: str, mesh: shapes.Mesh, colours: Any, members: Any = slice(None), **options: Any) -> Any:
        """Add an instance of a mesh to the scene at the start of each vehicle, or of each of ``members`` (k,)."""
        return self.several(name, mesh, self.stage.cast.start_ned[members], shapes.linear(colours), **options)

    def several(
        self,
        name: str,
        mesh: shapes.Mesh,
        places: Floats,
        colours: NumpyArray,
        scales: Floats | None = None,
        **options: object,
    ) -> Any:
        """Add an instance of a mesh to the scene at each position (k, 3) NED [m], with colours and scales.

        Args:
            name: of the node.
            mesh: corners and faces.
            places: where they are.
            colours: (k, 3) or one for all, as viser takes them.
            scales: (k, 3); default: 0, so that none is seen.
            options: of viser's ``add_batched_meshes_simple``.
        """
        usual: dict[str, Any] = {"lod": "off", "flat_shading": True, "side": "double"}
        usual |= {"cast_shadow": False, "receive_shadow": False}
        return self.stage.scene.add_batched_meshes_simple(
            f"{self.path}/{name}",
            *mesh,
            batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (len(places), 1)),
            batched_positions=places,
            batched_scales=np.zeros((len(places), 3), np.float32) if scales is None else scales,
            batched_colors=colours,
            **usual | options,
        )


class Bodies:
    """The bodies of all vehicles, in one batch for each kind of looks.

    Args:
        layer: that they are in.
        colours: (n, 3) of the vehicles, or one for all.

    Attributes:
        batches: numbers (k,) of vehicles of one kind, and their node.
    """

    def __init__(self, layer: Layer, colours: Any, **options: object):
        every, each = layer.stage.cast.kinds, np.ndim(colours) == 2
        self._start = layer.stage.cast.start_ned
        runs = layer.stage.cast.run_of
        opaque = None
        if runs is not None and each and "opacity" not in options:
            opaque = np.where(runs > 0, GHOSTLY, 1.0).astype(np.float32)
        self.batches = [
            (
                members,
                layer.batch(
                    f"bodies{number or ''}",
                    shapes.looks(kind),
                    colours[members] if each else colours,
                    members,
                    **options,
                    **({} if opaque is None else {"batched_opacities": opaque[members]}),
                ),
            )
            for number, (kind, members) in enumerate(every)
        ]

    def place(self, position_ned: Floats, attitude: Floats, span: Floats) -> None:
        """Set positions (n, 3) [m], attitudes (n, 3) [rad] and spans (n,) [m] of all vehicles' bodies."""
        position = _finite(position_ned, self._start)
        turn = np.nan_to_num(quaternion_of(attitude)).astype(np.float32)
        scales = np.repeat(np.asarray(span, np.float32), 3).reshape(-1, 3)
        for members, handle in self.batches:
            handle.batched_positions = position[members]
            handle.batched_wxyzs = turn[members]
            handle.batched_scales = scales[members]

    def paint(self, colours: Floats) -> None:
        """Set the colour of each vehicle's body (n, 3)."""
        for members, handle in self.batches:
            handle.batched_colors = shapes.linear(colours[members])


class Vehicles(Layer):
    """The vehicles with their attitudes; red once they have stopped."""

    title = "vehicles"

    def begin(self) -> None:
        """Add a body for each vehicle to the scene."""
        self._shown = self.stage.colours.copy()
        self.bodies = Bodies(self, self.stage.colours)

    def draw(self, frame: Frame) -> None:
        """Move and turn the vehicles' bodies to their poses in a frame."""
        size = self.stage.cast.size
        self.bodies.place(frame.position_ned, frame.attitude, np.full(size, self.stage.span))
        paint = self.stage.paint
        own = self.stage.colours if paint is None else paint.colours(np.array([frame.time]))[0]
        colours = np.where(frame.valid[:, None], own, STOPPED_COLOUR).astype(np.uint8)
        if not np.array_equal(colours, self._shown):
            self._shown = colours
            self.bodies.paint(colours)

    def on_click(self, call: Callable[[int | None, Any], None]) -> None:
        """Register a function to call with the number of a clicked vehicle (None: unknown) and the event."""

        def clicked(members: Floats, event: Any) -> None:
            """Call ``call`` with the clicked vehicle's number among all, None if the click has no instance number."""
            # The outline of what the mouse is over has no number.
            index = event.instance_index
            call(None if index is None else int(members[index]), event)

        for members, handle in self.bodies.batches:
            handle.on_click(partial(clicked, members))


class Poles(Layer):
    """Vertical lines from the vehicles to the ground."""

    title = "poles"
    every, beside = 3.0, True

    def begin(self) -> None:
        """Add one vertical pole for each vehicle to the scene."""
        self._handle = self.batch("poles", shapes.box((-0.5, -0.5, 0.0), (0.5, 0.5, 1.0)), POLE_COLOUR, opacity=0.35)

    def draw(self, frame: Frame) -> None:
        """Stretch the poles from the vehicles' positions in a frame down to the ground."""
        top, ground = _finite(frame.position_ned, self.stage.cast.start_ned), self.stage.ground
        down = 0.0 if ground is None or ground.at_zero else down_at(ground, top[:, 0], top[:, 1])
        wide = np.full(len(top), 0.03 * self.stage.span)
        self._handle.batched_positions = top
        self._handle.batched_scales = np.stack([wide, wide, np.maximum(down - top[:, 2], 0.0)], axis=1)


class Ghosts(Layer):
    """GNSS positions of the vehicles."""

    title = "GNSS positions"
    every, beside = 3.0, True
    most = MANY

    def begin(self) -> None:
        """Add one pale body for each vehicle to the scene, for its GNSS position."""
        several = self.stage.cast.run_of is not None
        self._bodies = Bodies(self, self.stage.colours if several else GHOST_COLOUR, opacity=0.4)

    def draw(self, frame: Frame) -> None:
        """Move the pale bodies to the GNSS positions of a frame; those without a fix are hidden."""
        fixed = np.isfinite(frame.ghost_ned).all(axis=1)
        place = _finite(frame.ghost_ned, frame.position_ned)
        self._bodies.place(place, frame.attitude, np.where(fixed, self.stage.span, 0.0))


class Wind(Layer):
    """The mean wind at each vehicle, its strength as length and colour."""

    title = "mean wind"
    every, beside = 3.0, True

    def begin(self) -> None:
        """Add one arrow for each vehicle to the scene, for the mean wind."""
        self._handle = self.batch("arrows", shapes.arrow(), np.tile(shapes.PALETTE[0], (self.stage.cast.size, 1)))

    def draw(self, frame: Frame) -> None:
        """Turn each vehicle's arrow along the mean wind of a frame."""
        _point(self._handle, _finite(frame.position_ned, self.stage.cast.start_ned), frame.wind_ned, self.stage.span)
        speed = np.linalg.norm(np.nan_to_num(frame.wind_ned), axis=1)
        self._handle.batched_colors = shapes.linear(shapes.speed_colours(speed, STRONG_WIND))


class Gusts(Layer):
    """The gust at each vehicle, from the tip of the mean wind; their sum is the wind at the vehicle."""

    title = "gusts"
    every, beside = 3.0, True

    def begin(self) -> None:
        """Add one arrow for each vehicle to the scene, for the gust."""
        self._handle = self.batch("arrows", shapes.arrow(), GUST_COLOUR)

    def draw(self, frame: Frame) -> None:
        """Turn each vehicle's arrow along the gust of a frame."""
        start = _finite(frame.position_ned, self.stage.cast.start_ned)
        tip = start + np.nan_to_num(frame.wind_ned) * (ARROW_SPANS * self.stage.span)
        _point(self._handle, tip, frame.gust_ned, self.stage.span)


class Names(Layer):
    """Names of the vehicles while they are few, and why each stopped one stopped; browsers draw them themselves."""

    title = "names and reasons"
    every = 2

    def begin(self) -> None:
        """Add no scene nodes: a script in the browser draws the vehicles' names."""
        self.tell: Callable[[dict[int, str]], None] = lambda reasons: None

    def draw(self, frame: Frame) -> None:
        """Send browsers the vehicles that have stopped by this frame, with the reasons."""
        self.tell(frame.reasons)


def _finite(values: Floats, instead: Floats) -> Floats:
    """Return values with non-finite ones replaced by the elements of ``instead``."""
    return np.where(np.isfinite(values), values, instead)


def _point(handle: Any, start: Floats, vector: Floats, span: float) -> None:
    """Place an arrow mesh's instances at ``start`` (n, 3) [m] along vectors (n, 3) [m/s], sized by ``span`` [m]."""
    vector = np.nan_to_num(vector)
    length = np.linalg.norm(vector, axis=1) * (ARROW_SPANS * span)
    wide = np.minimum(0.6 * span, length)
    handle.batched_positions = start
    handle.batched_wxyzs = shapes.along(vector)
    handle.batched_scales = np.stack([length, wide, wide], axis=1)
