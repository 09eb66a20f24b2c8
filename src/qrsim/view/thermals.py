"""Thermals: a column at each, where the mean wind has carried it."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from qrsim.core.arrays import Floats
from qrsim.models.atmosphere.contracts import horizontal_mean
from qrsim.models.atmosphere.thermals import COUNTED_AT, Thermals, mean_radius
from qrsim.view import shapes
from qrsim.view.contents import Contents
from qrsim.view.frame import Beside
from qrsim.view.layers import GUST_COLOUR, Layer, Stage, down_at
from qrsim.world.state import AirField, World

THERMALS = "thermals"


class Columns(Contents):
    """A column at each thermal, from the ground up to the top of the scene; its radius is that at 0.4 z_i."""

    title = THERMALS
    every = 10
    most = -1

    def begin(self) -> None:
        """Add a column for each thermal to the scene, hidden at first."""
        found = [updraft.number for updraft in self.world.updrafts if isinstance(updraft, Thermals)]
        mesh = shapes.prism(1.0, -1.0, 0.0, 32)
        self._handles = [
            self.several(f"columns{k}", mesh, np.zeros((number, 3)), shapes.linear(GUST_COLOUR), opacity=0.14)
            for k, number in enumerate(found)
        ]

    def look(self, beside: Beside, time: float) -> None:
        """Move the columns to the thermals' positions at a time [s]."""
        draws = beside.field.updrafts if isinstance(beside.field, AirField) else (None,) * len(beside.world.updrafts)
        thermals = [
            (updraft, drawn)
            for updraft, drawn in zip(beside.world.updrafts, draws, strict=True)
            if isinstance(updraft, Thermals)
        ]
        for handle, (own, drawn) in zip(self._handles, thermals, strict=True):
            places = centres(own, drawn, beside.world, time)
            down = down_at(beside.world.ground, places[:, 0], places[:, 1]) if not beside.world.ground.at_zero else 0.0
            depth = float(own.z_i)
            radius = float(mean_radius(COUNTED_AT, depth))
            high = min(depth, max(3.0 * radius, self.stage.cast.extent))
            handle.batched_positions = np.column_stack([places, np.broadcast_to(down, len(places))]).astype(np.float32)
            handle.batched_scales = np.tile([radius, radius, high], (len(places), 1)).astype(np.float32)


def centres(thermals: Thermals, drawn: object, world: World, time: float) -> Floats:
    """Return the positions (K, 2), north and east [m], of the thermals' axes at a time [s].

    Args:
        thermals: of the world.
        drawn: their places at the start as the episode has drawn them; None for given ones.
        world: with the mean wind that carries them.
        time: since the start of the run [s].
    """
    start = np.asarray(thermals.places_ned, np.float64) if drawn is None else np.stack([drawn.x, drawn.y], axis=1)  # type: ignore[attr-defined]
    if not thermals.drifts:
        return start
    mean = horizontal_mean(world.wind, jnp.float32(thermals.drift_height))
    low, sides = (np.asarray(part, np.float64) for part in (thermals.corner, thermals.sides))
    moved = start + time * np.array([float(mean.x), float(mean.y)])
    return low + (moved - low) % sides


def thermal_layers(stage: Stage, world: World) -> list[Layer]:
    """Return a list with the layer of thermals, [] if the world has none."""
    return [Columns(stage, world)] if any(isinstance(updraft, Thermals) for updraft in world.updrafts) else []
