"""Draws of an episode, and the contents of a world other than vehicles: their start and part of a tick."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array

from qrsim.core.noise import Draw, Stream
from qrsim.core.tree import Record, concatenated, replace
from qrsim.errors import RunError
from qrsim.models.radio.contracts import FIELD_STREAM
from qrsim.models.scene.contents import ContentsState, Surroundings, over_ground
from qrsim.models.scene.contracts import GroundCover, People, Plume
from qrsim.models.scene.uniform import uniform
from qrsim.models.sensors.camera import Picture, TakesPictures
from qrsim.world.state import (
    FIELD,
    PERSONS,
    PLACEMENT,
    PLUME,
    RANGE,
    TERRAIN,
    UPDRAFT,
    AirField,
    Fleet,
    FleetState,
    Start,
    State,
    World,
    WorldKeys,
    period_ticks,
    when_due,
)


def episode_streams(world: World) -> list[str]:
    """Return the names of the random streams from which numbers are drawn once an episode."""
    contents = world.contents
    parts: tuple[tuple[str, Plume | GroundCover | People], ...] = (
        (PLUME, contents.plume),
        (TERRAIN, contents.terrain),
        (PERSONS, contents.persons),
    )
    names = [f"{name}/start" for name, part in parts if part.random]
    names += [FIELD] if world.turbulence.field_ids else []
    names += [f"{UPDRAFT}/{i}" for i, updraft in enumerate(world.updrafts) if updraft.drawn_ids]
    names += [] if world.radio is None else [FIELD_STREAM]
    names += [f"{PLACEMENT}/{fleet.name}" for fleet in world.fleets if fleet.placement.random]
    return names + [f"{RANGE}/{item.name}" for item in world.ranges]


def episode_draws(world: World, keys: WorldKeys, like: Array) -> dict[str, Draw]:
    """Return the random draws of an episode, by the names of their streams."""
    sizes = {f"{PLACEMENT}/{fleet.name}": fleet.size for fleet in world.fleets}
    sizes |= {
        FIELD: world.turbulence.field_ids,
        FIELD_STREAM: 1 if world.radio is None else world.radio.field_ids,
        f"{PLUME}/start": world.contents.plume.ids,
        f"{PERSONS}/start": world.contents.persons.most,
        **{f"{UPDRAFT}/{i}": updraft.drawn_ids for i, updraft in enumerate(world.updrafts)},
    }
    draws = {}
    for i, name in enumerate(episode_streams(world)):
        assert keys.episode is not None
        ids = jnp.arange(sizes.get(name, 1), dtype=jnp.uint32)
        draws[name] = Draw(keys.episode.stream(i, ids), jnp.int32(0), like)
    return draws


def refuse_unplaced(world: World, placed: Sequence[npt.ArrayLike]) -> None:
    """Raise RunError if random placement found no start positions for a fleet in some world.

    Args:
        world: whose fleets.
        placed: ``State.placed`` on the host, of one world or of many.

    Raises:
        RunError: it names the fleet, the tries and the distance.
    """
    random = [fleet for fleet in world.fleets if fleet.placement.random]
    for fleet, found in zip(random, placed, strict=True):
        if not np.all(found):
            number = int(np.argmin(np.ravel(found)))
            where = f" of world {number} of the batch" if np.ndim(found) else ""
            raise RunError(f"fleets.{fleet.name}.placement{where}: {fleet.placement.unplaced(fleet.size)}")


def draw_ranges(world: World, draws: dict[str, Draw]) -> tuple[Array, ...]:
    """Return a random number () for each range of the world, uniform between its limits."""
    return tuple(uniform(draws[f"{RANGE}/{item.name}"], 0, item.low, item.high)[0] for item in world.ranges)


def draw_field(world: World, draws: dict[str, Draw]) -> object:
    """Return the episode's random gust field, shared by all vehicles, or None; with updrafts an ``AirField``."""
    turbulence, shared = world.turbulence, None
    if turbulence.field_ids:
        shared = turbulence.draw_field(draws[FIELD], **({"wind": world.wind} if turbulence.sees_wind else {}))
    if not world.updrafts:
        return shared
    drawn = (
        updraft.draw(draws[f"{UPDRAFT}/{i}"]) if updraft.drawn_ids else None for i, updraft in enumerate(world.updrafts)
    )
    return AirField(shared, tuple(drawn))


def start_contents(world: World, draws: dict[str, Draw]) -> ContentsState:
    """Return an episode's random plume, land cover and persons to be found; None for parts without randomness."""
    contents = world.contents
    release: Plume = contents.plume
    plume = terrain = persons = None
    if release.random:
        plume = release.init(draws[f"{PLUME}/start"], world.area)
    if contents.terrain.random:
        terrain = contents.terrain.init(draws[f"{TERRAIN}/start"])
    if contents.persons.random:
        persons = contents.persons.init(draws[f"{PERSONS}/start"], contents.terrain.cells(terrain), world.area)
    return ContentsState(plume, terrain, persons)


def place(world: World, fleet: Fleet, draws: dict[str, Draw]) -> tuple[Start, Array | None]:
    """Return a fleet's start positions, and () bool: random placement found them; None if they are given."""
    if not fleet.placement.random:
        return fleet.start, None
    start: Start
    start, found = fleet.placement.place(draws[f"{PLACEMENT}/{fleet.name}"], fleet.start, world.area)
    if not world.ground.at_zero:
        # Random places are not known beforehand, so the given height is above the ground there.
        position = start.position_ned
        start = replace(start, position_ned=replace(position, z=position.z + world.ground.down(position)))
    return start, found


def surroundings(world: World, contents: ContentsState, tick: Array) -> Surroundings:
    """Return the parts of a world that sensors read at a tick: ground, obstacles, wind, plume and others."""
    return Surroundings(
        world.contents,
        contents,
        world.wind,
        world.area,
        tick,
        world.time_step,
        world.ground,
        world.skyline,
        world.obstacles,
    )


def step_contents(
    world: World, state: State, fleets: tuple[FleetState, ...], due: Array, after: Array
) -> ContentsState:
    """Return plume and persons after a tick: new puffs released, persons that vehicles found marked."""
    contents = state.contents
    plume: Plume = world.contents.plume
    persons = world.contents.persons
    if state.contents_keys is not None:
        ids = jnp.arange(plume.ids, dtype=jnp.uint32)
        draw = Draw(state.contents_keys.stream(0, ids), after, jnp.zeros((), state.sky.range_error.dtype))
        ticks = period_ticks(plume.period, world.time_step)
        contents = replace(
            contents, plume=when_due(ticks, due, lambda: plume.step(contents.plume, draw), contents.plume)
        )
    if contents.persons is not None:
        poses = [fleet.vehicle.pose(now.vehicle) for fleet, now in zip(world.fleets, fleets, strict=True)]
        vehicles = [
            (over_ground(world.ground, pose.position_ned), pose.velocity_body.norm(), now.violation.code == 0)
            for pose, now in zip(poses, fleets, strict=True)
        ]
        position, speed, valid = concatenated(vehicles)
        ticks = period_ticks(persons.period, world.time_step)
        contents = replace(
            contents,
            persons=when_due(
                ticks, due, lambda: persons.step(contents.persons, position, speed, valid, after), contents.persons
            ),
        )
    return contents


def picture(world: World, state: State, number: int, camera: str) -> Picture:
    """Return the last picture that ``camera`` of each vehicle (n,) took, in fleet number ``number``.

    Args:
        world: with the numbers of the episode.
        state: of the world.
        number: of the fleet.
        camera: name of the sensor.
    """
    taking, reading, stream = film(world, state, number, camera)
    return develop(world, state.contents, cast(TakesPictures, taking), reading, stream)


def film(world: World, state: State, number: int, camera: str) -> tuple[Any, Any, Stream]:
    """Return a fleet's camera sensor, its last reading and its random stream; arguments as of ``picture``."""
    fleet = world.fleets[number]
    index = fleet.sensor_names.index(camera)
    ids = jnp.arange(fleet.size, dtype=jnp.uint32)
    stream = state.fleet_keys[number].stream(fleet.stream_names.index(camera), ids)
    return fleet.sensors[index], state.fleets[number].readings[index], stream


def develop(world: World, contents: ContentsState, camera: TakesPictures, reading: Record, stream: Stream) -> Picture:
    """Return each vehicle's (n,) last camera picture, computed from the reading with its pose.

    Args:
        world: with the numbers of the episode.
        contents: of the world.
        camera: the sensor.
        reading: its last one.
        stream: of its noise.
    """
    around = surroundings(world, contents, jnp.int32(0))
    return camera.develop(reading, around, stream, world.contents.persons.size)
