"""Rays from the selected vehicles to the satellites, by what their receivers report of each (sky.py)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.arrays import Floats
from qrsim.core.vectors import Vec3
from qrsim.models.gnss.parameters import ReceiverParameters
from qrsim.models.scene.rays import can_hide, first_hit
from qrsim.runs.colours import GREY
from qrsim.view import shapes
from qrsim.view.frame import Frame
from qrsim.view.layers import Layer, Stage
from qrsim.view.sky import Satellite
from qrsim.world.state import World

RAYS = "GNSS rays"
# States of a satellite, as a receiver reports them (models/gnss/fixes.py).
TRACKED, REFLECTED, HIDDEN, JAMMED = 1, 2, 3, 4
# Length of a ray, in diagonals of the scene; of those that are lost, in lengths of a ray.
REACH, LOST = 0.4, 0.4
# Dashes of a ray that is not received directly: how many, and which part of each is drawn.
DASHES, DRAWN = {REFLECTED: 14, HIDDEN: 8, JAMMED: 24}, {REFLECTED: 0.65, HIDDEN: 0.5, JAMMED: 0.25}


class Rays(Layer):
    """Rays of the selected vehicles: solid if tracked, dashed if only a reflection is, grey if hidden or jammed.

    A hidden one ends at what hides it, if that is within the ray's length. A page without a server draws them itself
    (film_details.js), and its hidden rays have one length.
    """

    title = RAYS
    # Twice a second, as often as the sky is told.
    every = 15.0
    of_chosen = True

    def __init__(self, stage: Stage, world: World):
        self._world = world
        self._blocked = can_hide(world.obstacles, world.ground)
        self._hit = jax.jit(lambda origin, way, reach: first_hit(world.obstacles, world.ground, origin, way, reach))
        self._drawn: object = None
        super().__init__(stage)

    def draw(self, frame: Frame) -> None:
        """Draw the lines to the satellites of the chosen vehicles, if any of these have changed."""
        found = [
            (vehicle, self.stage.sky(vehicle), frame.position_ned[vehicle]) for vehicle in sorted(self.stage.chosen)
        ]
        now = [(vehicle, tuple(sky), tuple(np.round(place, 1))) for vehicle, sky, place in found]
        if now == self._drawn:
            return
        self._drawn = now
        segments, colours = [np.zeros((1, 2, 3))], [np.zeros((1, 3))]
        for vehicle, sky, place in found:
            if np.isfinite(place).all():
                own = self._of(sky, place)
                segments.append(own[0])
                colours.append(np.where(own[1][:, None], self.stage.colours[vehicle], GREY))
        # Made anew, because the number of segments changes.
        self.stage.scene.add_line_segments(
            f"{self.path}/rays",
            np.concatenate(segments).astype(np.float32),
            np.repeat(shapes.linear(np.concatenate(colours))[:, None], 2, axis=1),
            thickness=1.5,
            thickness_units="screen",
        )

    def _of(self, sky: list[Satellite], place: Floats) -> tuple[Floats, Floats]:
        """Return line segments (L, 2, 3) [m] from a vehicle (3,) to satellites, and which are received (L,)."""
        rays = [(azimuth, elevation, state) for _, azimuth, elevation, _, state in sky if state in (1, 2, 3, 4)]
        if not rays:
            return np.zeros((0, 2, 3)), np.zeros(0, bool)
        azimuth, elevation, state = np.array(rays, np.float64).T
        level, turn = np.cos(np.radians(elevation)), np.radians(azimuth)
        ways = np.stack([level * np.cos(turn), level * np.sin(turn), -np.sin(np.radians(elevation))], axis=1)
        reach = REACH * self.stage.cast.extent
        length = np.where((state == HIDDEN) | (state == JAMMED), LOST * reach, reach)
        hidden = state == HIDDEN
        if self._blocked and hidden.any():
            length = np.where(hidden, np.minimum(self._met(place, ways, reach), reach), length)
        segments, received = [], []
        for way, far, kind in zip(ways, length.tolist(), state.astype(int).tolist(), strict=True):
            steps = dashes(kind) * far
            segments.append(place + steps[..., None] * way)
            received += [kind in (TRACKED, REFLECTED)] * len(steps)
        return np.concatenate(segments), np.array(received)

    def _met(self, place: Floats, ways: Floats, reach: float) -> Floats:
        """Return the distance (K,) [m] from a position along ways (K, 3) to an obstacle or ground, else ``reach``."""
        # One shape for any number of satellites, so that it is compiled once.
        room = np.zeros((64, 3), np.float32)
        room[:, 2] = -1.0
        room[: len(ways)] = ways[:64]
        origin = Vec3(*(jnp.full(64, value, jnp.float32) for value in place))
        far = np.asarray(self._hit(origin, Vec3(*map(jnp.asarray, room.T)), jnp.float32(reach)))[: len(ways)]
        return np.where(np.isfinite(far), far, reach)


def dashes(kind: int) -> Floats:
    """Return begin and end (L, 2) of the dashes of a satellite's line, as fractions of its length."""
    if kind == TRACKED:
        return np.array([[0.0, 1.0]])
    count, drawn = DASHES[kind], DRAWN[kind]
    begins = np.arange(count) / count
    return np.stack([begins, begins + drawn / count], axis=1)


def rays_of_film(rays: Rays) -> dict[str, object]:
    """Return lengths [m], dashes and colours with which an exported page draws satellite lines, for JSON."""
    return {
        "path": f"{rays.path}/rays",
        "reach": REACH * rays.stage.cast.extent,
        "lost": LOST,
        "dashes": {kind: dashes(kind).tolist() for kind in (TRACKED, REFLECTED, HIDDEN, JAMMED)},
        "grey": shapes.linear(np.array([GREY]))[0].tolist(),
        "colours": shapes.linear(rays.stage.colours).tolist(),
    }


def ray_layers(stage: Stage, world: World) -> list[Layer]:
    """Return a list with the layer of lines to satellites, [] unless a receiver reports single satellites."""
    sensors = (sensor for fleet in world.fleets for sensor in fleet.sensors)
    told = any(isinstance(sensor, ReceiverParameters) and sensor.per_satellite for sensor in sensors)
    return [Rays(stage, world)] if told else []
