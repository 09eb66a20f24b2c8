"""The noise of a world: its streams' keys, and what is drawn at a tick."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from qrsim.core.noise import Draw, Key, Noise, Stream, StreamKeys, draw_together
from qrsim.models.atmosphere.contracts import Turbulence
from qrsim.models.radio.contracts import STREAMS
from qrsim.models.sensors.contracts import Sensor
from qrsim.models.vehicles.contracts import Vehicle
from qrsim.world.episode import (
    episode_streams,
)
from qrsim.world.state import (
    PLUME,
    PROCESS,
    SKY,
    TURBULENCE,
    Fleet,
    World,
    WorldKeys,
    period_ticks,
)


def keys_of(world: World, key: Key) -> WorldKeys:
    """Return the keys of all random streams of a world, derived from ``key``; NumPy arrays for a NumPy key."""
    fleets = [_stream_names(fleet, suffix) for suffix in ("", "/start") for fleet in world.fleets]
    episode, plume, radio = episode_streams(world), world.contents.plume.changes, world.radio is not None
    sky, start, *rest = key.families(
        [[SKY], [f"{SKY}/start"], *fleets, episode, [PLUME] if plume else [], STREAMS if radio else []]
    )
    count = len(world.fleets)
    return WorldKeys(
        sky,
        start,
        tuple(rest[:count]),
        tuple(rest[count : 2 * count]),
        *(keys if used else None for keys, used in zip(rest[2 * count :], (episode, plume, radio), strict=True)),
    )


def stream_keys(fleet: Fleet, key: Key) -> StreamKeys:
    """Return the keys of a fleet's random streams, derived from the world's key."""
    return key.streams(_stream_names(fleet, ""))


def _stream_names(fleet: Fleet, suffix: str) -> list[str]:
    """Return the names of a fleet's random streams, each with ``suffix`` appended."""
    return [f"{fleet.name}/{name}{suffix}" for name in fleet.stream_names]


def _streams(fleet: Fleet, keys: StreamKeys) -> dict[str, Stream]:
    """Return a fleet's random streams by name, with the vehicles' numbers in the fleet as ids."""
    ids = jnp.arange(fleet.size, dtype=jnp.uint32)
    return {name: keys.stream(i, ids) for i, name in enumerate(fleet.stream_names)}


def draw_fleet(world: World, fleet: Fleet, keys: StreamKeys, tick: Array, first: bool = False) -> dict[str, Noise]:
    """Return a fleet's random numbers of a tick by stream name; those needed at every tick are drawn together.

    Args:
        world, fleet: parameters.
        keys: of the fleet's streams.
        tick: () integer.
        first: whether it is that of a start.
    """
    like = jnp.zeros((), fleet.start.position_ned.x.dtype)
    streams = _streams(fleet, keys)
    most: dict[str, int | None] = {}
    counts: dict[str, int] = {}
    users: dict[str, Turbulence | Vehicle | Sensor] = {TURBULENCE: world.turbulence, PROCESS: fleet.vehicle}
    for name, sensor in zip(fleet.sensor_names, fleet.sensors, strict=True):
        every_tick = period_ticks(sensor.period, world.time_step) == 1
        if every_tick and not sensor.draws_alone:
            users[name] = sensor
        count = (first and sensor.first_normals) or sensor.normals
        counts[name] = count
        most[name] = None if sensor.draws_alone else count
    drawn = draw_together(
        [streams[name] for name in users], [counts.get(name, user.normals) for name, user in users.items()], tick, like
    )
    on_demand = {
        name: Draw(stream, tick, like, most.get(name)) for name, stream in streams.items() if name not in users
    }
    return {**dict(zip(users, drawn, strict=True)), **on_demand}


def draw_sky(world: World, keys: StreamKeys, tick: Array, like: Array) -> Draw:
    """Return the random draw of the GNSS satellites' errors at a tick, in the dtype of ``like``."""
    return Draw(keys.stream(0, world.sky.ids), tick, jnp.zeros((), like.dtype))
