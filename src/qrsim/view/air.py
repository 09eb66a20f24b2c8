"""The air in a horizontal plane: arrows at the points of a grid that goes with the vehicles."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.arrays import Floats
from qrsim.core.clock import split_time
from qrsim.core.noise import Drawn
from qrsim.core.tree import replace
from qrsim.core.vectors import Vec3
from qrsim.models.atmosphere.turbulence import Still
from qrsim.models.atmosphere.wind import mean_wind_at
from qrsim.view import shapes
from qrsim.view.contents import Contents
from qrsim.view.frame import Beside, Frame
from qrsim.view.layers import GUST_COLOUR, STRONG_WIND, Layer, Stage
from qrsim.world.air import gust_at
from qrsim.world.state import World

AIR = "air in a plane"
# What its arrows show, and the speed [m/s] of one that is as long as two are apart.
GUST, WHOLE = "gust", "gust and mean wind"
REACHES = {GUST: 2.0, WHOLE: 8.0}
# Arrows along each side, which is at least so long [m] and so many times the vehicles' own.
ALONG, LEAST_SIDE, SIDES = 15, 30.0, 1.2
# Height of the plane above the origin [m] where vehicles start on the ground.
LOW, LOWEST = 10.0, 1.0
# How thick they are beside those of vehicles, which are few.
THICKNESS = 0.5
# Steps of turns, and of lengths a metre: a page without a server is much smaller so, and nobody sees it.
TURN_STEPS, LENGTH_STEPS = 128.0, 32.0


class Air(Contents):
    """Arrows along gusts, or along all of the wind, that one air has in a plane at a height over the origin.

    Attributes:
        height: of the plane over the origin [m].
        shows: GUST or WHOLE.
        cell: distance of two arrows [m].
    """

    title = AIR
    every = 3
    # Asked for only: it is as many bytes of a frame as sixty vehicles.
    most = -1
    most_in_film = 300

    def begin(self) -> None:
        """Add the wind arrows to the scene, on a horizontal plane at the height of the vehicles' starts."""
        cast = self.stage.cast
        seen = cast.start_ned if cast.around is None else np.vstack([cast.start_ned, cast.around])
        side = max(LEAST_SIDE, SIDES * float(np.ptp(seen[:, :2], axis=0).max()))
        self.cell = side / (ALONG - 1)
        height = float(np.median(-cast.start_ned[:, 2]))
        self.height = float(round(height)) if height >= LOWEST else LOW
        self.shows = GUST if blows_as_a_field(self.world) or self.world.updrafts else WHOLE
        steps = self.cell * (np.arange(ALONG) - ALONG // 2)
        north, east = np.meshgrid(steps, steps, indexing="ij")
        self._offsets = np.stack([north.ravel(), east.ravel(), np.zeros(ALONG**2)], axis=1)
        self._dtype = np.asarray(self.world.fleets[0].start.position_ned.x).dtype
        self._ask = jax.jit(air_at)
        self._placed: Any = None
        corners, faces = shapes.arrow()
        self._handle = self.several(
            "arrows",
            (corners * [1.0, THICKNESS, THICKNESS], faces),
            self._offsets,
            np.tile(shapes.linear(GUST_COLOUR), (ALONG**2, 1)),
            np.zeros(ALONG**2, np.float32),
        )

    @property
    def highest(self) -> float:
        """Return the largest height [m] of the arrows' plane that users can choose."""
        return max(60.0, 2.0 * self.height)

    @property
    def label(self) -> str:
        """Return the text for the layer in an exported page's list: title, kind of wind and height."""
        return f"{self.title}: {self.shows} at {self.height:g} m"

    def draw(self, frame: Frame) -> None:
        """Turn the arrows along the wind of this frame; their grid moves with the vehicles."""
        if frame.beside is None:
            return
        places = self._places(frame)
        mean, gust, height = self._asked(frame.beside, frame.time, places)
        vector = gust if self.shows == GUST else mean + gust
        speed = np.linalg.norm(vector, axis=1)
        length = np.where(height > 0.0, speed * (self.cell / REACHES[self.shows]), 0.0)
        if self._placed is None or not np.array_equal(places, self._placed):
            self._handle.batched_positions = self._placed = places
        self._handle.batched_wxyzs = np.round(shapes.along(vector) * TURN_STEPS) / TURN_STEPS
        self._handle.batched_scales = (np.round(length * LENGTH_STEPS) / LENGTH_STEPS).astype(np.float32)
        colours = GUST_COLOUR if self.shows == GUST else shapes.speed_colours(speed, STRONG_WIND)
        self._handle.batched_colors = np.broadcast_to(shapes.linear(colours), (ALONG**2, 3)).copy()

    def _places(self, frame: Frame) -> Floats:
        """Return the arrows' positions (k, 3) NED [m]: a grid around the vehicles that moves in whole cells."""
        known = frame.position_ned[frame.valid & np.isfinite(frame.position_ned).all(axis=1)]
        middle = np.zeros(3) if not len(known) else 0.5 * (known.min(axis=0) + known.max(axis=0))
        corner = self.cell * np.round(middle / self.cell)
        return (self._offsets + np.array([corner[0], corner[1], -self.height])).astype(np.float32)

    def _asked(self, beside: Beside, time: float, places: Floats) -> tuple[Floats, Floats, Floats]:
        """Compute mean wind, gusts (k, 3) [m/s], heights above ground (k,) [m] at a time [s], places (k, 3) NED [m]."""
        tick = np.int32(round(time / self.world.time_step))
        with jax.enable_x64(self._dtype == np.float64):
            found = self._ask(beside.world, beside.drawn, beside.field, tick, places.astype(self._dtype))
            mean, gusts, heights = (np.asarray(part, np.float64) for part in found)
            return mean, gusts, heights


def blows_as_a_field(world: World) -> bool:
    """Return whether a world's turbulence is a function of position, and not separate for each vehicle."""
    return "position_ned" in world.turbulence.reads


def has_a_plane(world: World) -> bool:
    """Return whether the wind varies with position in a way that can be computed away from vehicles."""
    return blows_as_a_field(world) or "position_ned" in world.wind.reads or bool(world.updrafts)


def air_at(world: World, drawn: Any, field: object, tick: Array, places: Array) -> tuple[Array, Array, Array]:
    """Return mean wind and gusts (M, 3) [m/s] and heights above ground (M,) [m] at places (M, 3) NED [m].

    Gusts that are each vehicle's own, a turbulence's or its residual's, are nowhere else and are left out.

    Args:
        world, drawn, field: of a State, the numbers that the episode has drawn among them.
        tick: () int32.
        places: NED.
    """
    world = world.with_drawn(drawn)
    if not blows_as_a_field(world):
        world = replace(world, turbulence=Still())
    position = Vec3(places[:, 0], places[:, 1], places[:, 2])
    height = world.height_agl(position)
    time = split_time(tick, world.time_step, places.dtype)
    mean = mean_wind_at(world.wind, height, position, time)
    nothing = jnp.zeros_like(height)
    memory = world.turbulence.init(Drawn((nothing,) * world.turbulence.normals))
    return mean.stack(), gust_at(world, field, memory, height, position, time).stack(), height


def air_layers(stage: Stage, world: World) -> list[Layer]:
    """Return a list with the layer of wind arrows, [] for a world with the same wind everywhere."""
    return [Air(stage, world)] if has_a_plane(world) else []
