"""Camera footprints: the ground patch of each window of a picture, and the classifier's ratio for it."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.arrays import Floats
from qrsim.models.scene.contents import ContentsState
from qrsim.models.sensors.camera import CameraReading
from qrsim.runs.colours import GREY
from qrsim.view import shapes
from qrsim.view.contents import Contents
from qrsim.view.frame import Beside
from qrsim.view.layers import Layer, Stage
from qrsim.world.episode import develop
from qrsim.world.state import World

# While nobody is chosen, of so many cameras.
MOST_SHOWN = 4
# The strongest colours stand for a ratio of this and more, and of minus this and less.
STRONG_RATIO = 10.0
# Instances are added so many at a time: a browser makes its mesh anew where their number changes.
INSTANCES = 512
EDGE_COLOUR = GREY


class Cameras(Contents):
    """Footprints of the last pictures, coloured by each window's ratio: yellow for a person, blue against."""

    title = "camera pictures"
    every = 5
    of_chosen = True

    def begin(self) -> None:
        """Add the scene nodes for camera pictures, without pictures yet."""
        first = np.cumsum([0, *(fleet.size for fleet in self.world.fleets)])
        self._owners = [
            (int(first[number]) + i, number, index, i)
            for number, index in camera_places(self.world)
            for i in range(self.world.fleets[number].size)
        ]
        self._drawn: list[Any] = []
        self._develop = jax.jit(_developed, static_argnums=(5, 6))
        self._dtype = np.asarray(self.world.fleets[0].start.position_ned.x).dtype
        places, colours = np.zeros((INSTANCES, 3), np.float32), np.zeros((INSTANCES, 3), np.uint8)
        self._windows = self.several("windows", _window(), places, colours, opacity=0.85)
        self._edges = self.stage.scene.add_line_segments(
            f"{self.path}/edges", np.zeros((8, 2, 3), np.float32), EDGE_COLOUR, thickness=1.5, thickness_units="screen"
        )

    def look(self, beside: Beside, time: float) -> None:
        """Draw the latest pictures of the chosen vehicles' cameras on the ground, if there are new ones."""
        owners = [owner for owner in self._owners if owner[1:3] in beside.cameras]
        chosen = [owner for owner in owners if owner[0] in self.stage.chosen] or owners[:MOST_SHOWN]
        shown = []
        for owner in chosen:
            reading = jax.tree.map(lambda leaf: float(leaf[owner[3]]), beside.cameras[owner[1:3]])  # noqa: B023
            # A vehicle that has stopped has no picture any more.
            if np.isfinite(reading.picture):
                # Where it was taken, because in another run another picture has this number.
                shown.append((owner, reading.picture, reading.taken_at_ned.x, reading.taken_at_ned.y))
        if shown == self._drawn:
            return
        self._drawn = shown
        pictures = [self._picture(beside, *owner[1:]) for owner, *_ in shown]
        # Above the plates of the ground's cover.
        z = -2.0 * self.stage.lift
        self._put([_windows(picture, z) for _, picture in pictures])
        edges = [_edges(where, picture, z) for where, picture in pictures] or [np.zeros((8, 2, 3))]
        self._edges.points = np.concatenate(edges).astype(np.float32)

    def _picture(self, beside: Beside, number: int, index: int, i: int) -> tuple[Floats, Any]:
        """Return the position (3,) NED [m] at which vehicle ``i`` of a fleet took its last picture, and the picture."""
        reading = jax.tree.map(lambda leaf: np.asarray(leaf)[i : i + 1], beside.cameras[number, index])
        with jax.enable_x64(self._dtype == np.float64):
            keys = beside.fleet_keys[number]
            found = self._develop(
                beside.world, beside.drawn, beside.contents, keys, reading, number, index, np.uint32(i)
            )
            picture = jax.tree.map(lambda leaf: np.asarray(leaf)[0], found)
        return np.array([np.asarray(axis)[0] for axis in vars(reading.taken_at_ned).values()]), picture

    def _put(self, windows: list[tuple[Floats, ...]]) -> None:
        """Draw pictures' pixels; each picture: positions (K, 3), quaternions (K, 4), scales (K, 3), colours (K, 3)."""
        rest = -sum(len(part[0]) for part in windows) % INSTANCES or (0 if windows else INSTANCES)
        nothing = (np.zeros((rest, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (rest, 1)), np.zeros((rest, 3)))
        parts = zip(*windows, (*nothing, np.zeros((rest, 3), np.uint8)), strict=True)
        positions, wxyzs, scales, colours = (np.concatenate(part) for part in parts)
        self._windows.batched_positions = positions.astype(np.float32)
        self._windows.batched_wxyzs = wxyzs.astype(np.float32)
        self._windows.batched_scales = scales.astype(np.float32)
        self._windows.batched_colors = shapes.linear(colours)


def _developed(
    world: World,
    drawn: Any,
    contents: ContentsState,
    keys: Any,
    reading: CameraReading,
    number: int,
    index: int,
    i: Any,
) -> object:
    """Compute the last camera picture of vehicle ``i`` of fleet ``number`` by its sensor ``index``, arrays (1, ...)."""
    world = world.with_drawn(drawn)
    fleet = world.fleets[number]
    # A number of a camera may differ from vehicle to vehicle.
    camera = jax.tree.map(lambda leaf: leaf[i][None] if jnp.ndim(leaf) else leaf, fleet.sensors[index])
    stream = keys.stream(fleet.stream_names.index(fleet.sensor_names[index]), jnp.asarray(i, jnp.uint32)[None])
    return develop(world, contents, camera, reading, stream)


def _window() -> shapes.Mesh:
    """Return the mesh of a flat square of side 1, for one pixel of a picture on the ground."""
    corners = np.array([(-0.5, -0.5, 0.0), (0.5, -0.5, 0.0), (0.5, 0.5, 0.0), (-0.5, 0.5, 0.0)])
    return corners, np.array([(0, 1, 2), (0, 2, 3)])


def _windows(picture: Any, z: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Return positions, quaternions, scales and colours to draw a picture's pixels with, at down coordinate z [m]."""
    corners = np.stack([picture.north, picture.east], axis=-1).astype(np.float64)
    middle = 0.25 * (corners[:-1, :-1] + corners[:-1, 1:] + corners[1:, :-1] + corners[1:, 1:])
    across, down = corners[:-1, 1:] - corners[:-1, :-1], corners[1:, :-1] - corners[:-1, :-1]
    there = np.isfinite(picture.ratio)
    across, down = across[there], down[there]
    half = 0.5 * np.arctan2(across[:, 1], across[:, 0])
    flat = np.zeros(len(half))
    return (
        np.insert(middle[there], 2, z, axis=1),
        np.stack([np.cos(half), flat, flat, np.sin(half)], axis=1),
        np.stack([np.linalg.norm(across, axis=1), np.linalg.norm(down, axis=1), flat + 1.0], axis=1),
        shapes.ratio_colours(picture.ratio[there], STRONG_RATIO),
    )


def _edges(where: Floats, picture: Any, z: float) -> Floats:
    """Return lines (8, 2, 3) from a camera to its picture's corners at down coordinate z [m], and around them."""
    rows, columns = int(picture.rows), int(picture.columns)
    ends = ((0, 0), (0, columns), (rows, columns), (rows, 0))
    corners = np.array([(picture.north[end], picture.east[end], z) for end in ends])
    sides = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    return np.concatenate([np.stack([np.tile(where, (4, 1)), corners], axis=1), sides])


def camera_places(world: World) -> list[tuple[int, int]]:
    """Return (fleet index, sensor index) of each camera of a world."""
    return [
        (number, index)
        for number, fleet in enumerate(world.fleets)
        for index, sensor in enumerate(fleet.sensors)
        if sensor.takes_pictures
    ]


def camera_layers(stage: Stage, world: World) -> list[Layer]:
    """Return a list with the layer of camera pictures, [] if the world has no cameras."""
    return [Cameras(stage, world)] if camera_places(world) else []
