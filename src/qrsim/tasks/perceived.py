"""What agents see by their own sensors that look around: who is near, and how far it is to what stands around.

A task whose ``senses`` name such sensors adds their readings to its observations, in the sensor's axes: forward, right
and down of the vehicle unless it is mounted otherwise.
"""

from __future__ import annotations

from typing import Any, cast

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.tree import setting
from qrsim.models.sensors import rangefinder, scan
from qrsim.models.sensors.neighbours import Looking, NeighboursReading
from qrsim.models.sensors.rangefinder import IdealRangefinder, Rangefinder, RangefinderReading
from qrsim.models.sensors.scan import IdealScan, Scan, ScanReading
from qrsim.tasks.agents import Axis, fleet_of, number_of
from qrsim.world.state import State, World

# Sensors that agents can see by.
SEEING = (Looking, Scan, IdealScan, Rangefinder, IdealRangefinder)


def senses() -> tuple[str, ...]:
    """Declare a record's field: the names of the sensors with readings in the agents' observations."""
    return setting(
        default=(), doc="names of the agents' sensors of type neighbours, scan and rangefinder in their observations"
    )


def sensed_axes(world: World, fleet: str, names: tuple[str, ...]) -> tuple[Axis, ...]:
    """Describe the S values of ``sensed`` by name, unit and range; the ranges hold in every episode."""
    # An episode that draws how far a sensor sees draws no more than this.
    world = world.with_drawn(tuple(item.high for item in world.ranges))
    agents, axes = world.fleets[number_of(world, fleet)], []
    for name in names:
        sensor = agents.sensors[agents.sensor_names.index(name)]
        reach = float(np.max(np.asarray(_sensor_reach(sensor))))
        if isinstance(sensor, Looking):
            for slot in range(sensor.slots):
                axes += [Axis(f"{name}_{slot}_{axis}", "m", -reach, reach) for axis in "xyz"]
                axes += [Axis(f"{name}_{slot}_velocity_{axis}", "m/s") for axis in "xyz" if sensor.velocity]
                axes += [Axis(f"{name}_{slot}_mate", "1", 0.0, 1.0)] * sensor.identity
                axes.append(Axis(f"{name}_{slot}_seen", "1", 0.0, 1.0))
        elif isinstance(sensor, Scan | IdealScan):
            axes += [Axis(f"{name}_{ray}", "m", 0.0, reach) for ray in range(sensor.rays)]
        else:
            axes.append(Axis(name, "m", 0.0, reach))
    return tuple(axes)


def sensed(world: World, state: State, fleet: str, names: tuple[str, ...]) -> Array:
    """Return the readings (n, S) of the sensors with these names, as observed by a fleet's agents.

    Of a sensor ``neighbours`` for each slot position and velocity (if it measures it), both 0 where it has nobody,
    whether that is one of the agents' own fleet (if it knows who they are), and whether there is one, 1 or 0. Of a scan
    or a rangefinder the ranges, its reach where nothing came back. No number leaves its range in ``sensed_axes``.
    """
    world = world.with_drawn(state.drawn)
    agents, now = fleet_of(world, state, fleet)
    columns: list[Array] = []
    for name in names:
        number = agents.sensor_names.index(name)
        sensor, reading = agents.sensors[number], now.readings[number]
        reach = jnp.asarray(_sensor_reach(sensor))
        if isinstance(sensor, Looking):
            columns += _neighbour_columns(sensor, cast(NeighboursReading, reading), reach, world.rows_of(fleet))
        elif isinstance(sensor, Scan | IdealScan):
            columns += [_clipped_range(ray, reach) for ray in cast(ScanReading, reading).range]
        else:
            columns.append(_clipped_range(cast(RangefinderReading, reading).range, reach))
    return jnp.stack(columns, axis=-1)


def _neighbour_columns(
    sensor: Looking, reading: NeighboursReading, reach: Array, mates: slice[int, int, None]
) -> list[Array]:
    """Return columns (n,) of a neighbour list, a few per slot; ``mates``: numbers of the own fleet's vehicles."""
    columns = []
    for slot in range(sensor.slots):
        seen = jnp.isfinite(reading.distance[slot])
        columns += [jnp.where(seen, jnp.clip(axis, -reach, reach), 0.0) for axis in reading.position[slot].axes]
        if sensor.velocity:
            columns += [jnp.where(seen, axis, 0.0) for axis in reading.velocity[slot].axes]
        said = seen.astype(reach.dtype)
        if sensor.identity:
            who = reading.vehicle[slot]
            columns.append(jnp.where((who >= mates.start) & (who < mates.stop), said, 0.0))
        columns.append(said)
    return columns


def _clipped_range(measured: Array, reach: Array) -> Array:
    """Return measured ranges (n,) [m] clipped to the sensor's maximum range, which also replaces missing echoes."""
    return jnp.where(jnp.isfinite(measured), jnp.clip(measured, 0.0, reach), reach)


def _sensor_reach(sensor: Any) -> object:
    """Return the maximum range [m] of a sensor, such as a rangefinder."""
    if isinstance(sensor, IdealScan):
        return scan.FARTHEST
    return rangefinder.FARTHEST if isinstance(sensor, IdealRangefinder) else sensor.range_max
