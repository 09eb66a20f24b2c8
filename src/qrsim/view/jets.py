"""Wakes below multirotors, by the jet that others fly through (models/vehicles/wake.py)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jax import Array

from qrsim.core.arrays import Floats
from qrsim.core.host import on_host
from qrsim.core.tree import record_of
from qrsim.core.vectors import Vec3
from qrsim.models.vehicles.contracts import Vehicle
from qrsim.models.vehicles.wake import SPREAD, Wake, half_width, jet_axis, jet_share, jet_strength
from qrsim.view import shapes
from qrsim.view.frame import Frame
from qrsim.view.layers import GUST_COLOUR, Layer, Stage, down_at
from qrsim.view.truth import turned_to_ned
from qrsim.world.state import World

WAKES = "wakes"
# Speed on the axis [m/s] at which a wake is no longer drawn.
SLOWEST = 1.0
# Half width at the rotors, in half widths at the end: that of a vehicle of 1 kg.
NARROW = 0.12


class Wakes(Layer):
    """A cone along the axis of each wake, as wide as half of its speed reaches, down to 1 m/s or the ground."""

    title = WAKES
    every, beside = 3.0, True
    most = -1

    def __init__(self, stage: Stage, world: World):
        # Of further runs no wind is known, so they have none.
        known = _parameters(world)
        self._wakes = tuple(np.pad(own, (0, stage.cast.size - len(own)), constant_values=np.nan) for own in known)
        self._flow = on_host(_flow)
        super().__init__(stage)

    def begin(self) -> None:
        """Add one cone per vehicle to the scene, to show its rotors' wake."""
        self._handle = self.batch("cones", shapes.funnel(NARROW), GUST_COLOUR, opacity=0.22)

    def draw(self, frame: Frame) -> None:
        """Turn and stretch the cones along the wakes; vehicles without thrust have none."""
        if frame.details is None:
            return
        found, position = frame.details(), frame.position_ned
        down = turned_to_ned(frame.attitude, np.tile([0.0, 0.0, 1.0], (len(position), 1)))
        relative = np.nan_to_num(frame.wind_ned) + np.nan_to_num(frame.gust_ned) - found.velocity_ned
        known = np.isfinite(np.column_stack([position, down, relative, found.thrust, *self._wakes])).all(axis=1)
        known &= frame.valid
        size, area, thrust = (np.where(known, own, 1.0).astype(np.float64) for own in (*self._wakes, found.thrust))
        vectors = [
            record_of(Vec3, *np.where(known[:, None], own, 1.0).astype(np.float64).T) for own in (down, relative)
        ]
        axis, length, start = self._flow(record_of(Wake, size, area), thrust, *vectors)
        along = np.stack([axis.x, axis.y, axis.z], axis=1)
        length = np.minimum(length, self._room(position, along))
        width = np.maximum(SPREAD * length, start)
        scales = np.stack([length, width, width], axis=1) * (known & (found.thrust > 0.0))[:, None]
        self._handle.batched_positions = np.where(known[:, None], position, 0.0).astype(np.float32)
        self._handle.batched_wxyzs = shapes.along(along).astype(np.float32)
        self._handle.batched_scales = scales.astype(np.float32)

    def _room(self, position: Floats, along: Floats) -> Floats:
        """Return the distance (n,) [m] from each vehicle along its wake to the ground's height below it."""
        ground, place = self.stage.ground, np.nan_to_num(position)
        down = 0.0 if ground is None or ground.at_zero else down_at(ground, place[:, 0], place[:, 1])
        return np.maximum(down - place[:, 2], 0.0) / np.maximum(along[:, 2], 1e-3)


def _flow(wake: Wake, thrust: Array, down: Vec3, relative: Vec3) -> tuple[Vec3, Array, Array]:
    """Return wakes' axes, lengths (n,) down to speed ``SLOWEST``, half widths at the rotors (n,) [m]."""
    push = thrust * jet_share(wake, thrust, down, relative)
    # The speed on the axis is the strength over the half width, which grows by SPREAD.
    end = jet_strength(push) * (1.0 / (SLOWEST * SPREAD))
    return jet_axis(wake, thrust, down, relative), end, half_width(wake, 0.0 * push)


def _parameters(world: World) -> tuple[Floats, Floats]:
    """Return size (n,) [m] and rotor disc area (n,) [m^2] of all vehicles; NaN for those without a wake."""
    parts = []
    for fleet in world.fleets:
        wake = _wake(fleet.vehicle)
        own = (np.nan, np.nan) if wake is None else (wake.size, wake.disc_area)
        parts.append([np.broadcast_to(np.asarray(value, np.float64), (fleet.size,)) for value in own])
    return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])


def wake_layers(stage: Stage, world: World) -> list[Layer]:
    """Return a list with the layer of rotor wakes, [] if no vehicle has a wake."""
    return [Wakes(stage, world)] if any(_wake(fleet.vehicle) is not None for fleet in world.fleets) else []


# By NumPy: for the first few numbers JAX would start its backend and compile programs, while a page waits.
_wake: Callable[[Vehicle], Wake | None] = on_host(lambda vehicle: vehicle.wake())
