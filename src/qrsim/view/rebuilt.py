"""Contents of a recorded world besides vehicles, which logs do not hold: computed again.

Cover of the ground, persons, sources, puffs and the field of gusts are drawn from the seed alone, so they are drawn
again; who was found when, and which wind was asked for, the events say; where pictures were taken, the measurements do,
and what they show follows from all of these.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from qrsim.core.noise import Draw, Key
from qrsim.core.tree import record_of, replace
from qrsim.core.vectors import Euler, Vec3
from qrsim.errors import UsageError
from qrsim.models.sensors.camera import CameraReading
from qrsim.runs import Run
from qrsim.runs.layout import EVENTS, PERSON_FOUND
from qrsim.runs.surroundings import drawn_contents
from qrsim.scenarios.injection_file import KEYS
from qrsim.simulation.changing import changed
from qrsim.simulation.injections import WORLD
from qrsim.view.air import has_a_plane
from qrsim.view.cameras import camera_places
from qrsim.view.columns import Columns, vector
from qrsim.view.frame import Beside
from qrsim.view.steering import WIND_CHANGED, with_asked
from qrsim.view.truth import ANGLES, AXES
from qrsim.world.air import weather_at
from qrsim.world.draws import keys_of
from qrsim.world.episode import draw_field, episode_draws
from qrsim.world.state import World, period_ticks


class Rebuilt:
    """Contents of a recorded world at any time.

    Args:
        run: what was recorded.
        world: of its scenario, in its precision.
    """

    def __init__(self, run: Run, world: World):
        self._world = world
        self._wide = run.info.precision == "float64"
        with self._precision():
            self._keys = keys_of(world, Key.root(run.info.seed, 0))
            self._drawn, self._start, self._field = jax.jit(_drawn_again)(world, self._keys)
        self._puffs, self._puffs_ticks = self._start.plume, 0
        self._blow = jax.jit(_blown)
        events = run.events if EVENTS in run else []
        self._winds = [event for event in events if event.kind == WIND_CHANGED]
        self._worlds = list(_weathers(run, world))
        persons = self._start.persons
        self._found = np.full(0 if persons is None else len(persons.there), np.iinfo(np.int32).max, np.int32)
        for event in events:
            number = -1 if event.kind != PERSON_FOUND or event.value is None else int(event.value)
            if 0 <= number < len(self._found):
                self._found[number] = event.tick
        self._cameras = _cameras(run, world)

    def _precision(self) -> Any:
        """Return a context in which JAX uses the precision (32 or 64 bits) of the run."""
        return jax.enable_x64(self._wide)

    def at(self, time: float) -> Beside:
        """Recompute the world's contents (plume, persons ...), camera readings and weather at a time [s]."""
        tick = round(time / self._world.time_step)
        contents = self._start
        if contents.persons is not None:
            when = np.where(self._found <= tick, self._found, -1)
            contents = replace(contents, persons=replace(contents.persons, found_tick=when))
        if self._world.contents.plume.changes:
            contents = replace(contents, plume=self._blown(tick))
        cameras = {place: camera.at(time) for place, camera in self._cameras.items()}
        return Beside(self._blowing(time), self._drawn, contents, self._keys.fleets, cameras, self._field)

    def _blowing(self, time: float) -> World:
        """Return the world with its weather at a time [s], from recorded requests and scheduled changes."""
        tick: Any = np.int32(round(time / self._world.time_step))
        worlds = [world for since, world in self._worlds if since <= tick]
        changes = self._world.changes
        if worlds or (changes is not None and changes.speed_20ft is not None):
            with self._precision():
                return weather_at(worlds[-1] if worlds else self._world, tick)
        asked = {event.field: event.value for event in self._winds if event.time <= time}
        return with_asked(self._world, asked) if asked else self._world

    def _blown(self, tick: int) -> object:
        """Return the plume's puffs at a tick, computed from those of the last call if these are earlier."""
        done = tick // period_ticks(self._world.contents.plume.period, self._world.time_step)
        if done < self._puffs_ticks:
            self._puffs, self._puffs_ticks = self._start.plume, 0
        if done > self._puffs_ticks:
            with self._precision():
                span = (np.int32(self._puffs_ticks), np.int32(done))
                self._puffs = self._blow(self._world, self._keys.plume, self._puffs, *span)
            self._puffs_ticks = done
        return self._puffs


def _weathers(run: Run, world: World) -> Iterator[tuple[int, World]]:
    """Yield (tick, world from then on) for each change of weather that was requested during the run."""
    for entry in run.injections:
        numbers = {name: value for name, value in entry.items() if name not in KEYS}
        with contextlib.suppress(UsageError):
            if entry["target"] == WORLD:
                world = changed(world, entry["kind"], numbers, entry["tick"])
                yield entry["tick"], world


def rebuilt(run: Run, world: World | None) -> Rebuilt | None:
    """Return a recomputation of what logs lack (contents, pictures, wind); None if the world has none or is unknown."""
    if world is None:
        return None
    parts = world.contents.random
    return Rebuilt(run, world) if parts or camera_places(world) or has_a_plane(world) else None


def _drawn_again(world: World, keys: Any) -> tuple[Any, Any, object]:
    """Redraw an episode's random values from its keys: world parameters, contents at the start, gust field."""
    drawn, contents = drawn_contents(world, keys)
    like = jnp.zeros((), world.fleets[0].start.position_ned.x.dtype)
    return drawn, contents, draw_field(world.with_drawn(drawn), episode_draws(world, keys, like))


def _blown(world: World, keys: Any, puffs: Any, done: object, wanted: object) -> object:
    """Return the plume's puffs after ``wanted`` of its periods, from ``puffs`` after ``done`` periods."""
    plume = world.contents.plume
    stream = keys.stream(0, jnp.arange(plume.ids, dtype=jnp.uint32))
    ticks = period_ticks(plume.period, world.time_step)

    def step(number: Any, puffs: Any) -> Any:
        """Return the puffs one plume period later, the same as in the flight."""
        return plume.step(puffs, Draw(stream, (number + 1) * ticks, jnp.zeros((), puffs.age.dtype)))

    return lax.fori_loop(done, wanted, step, puffs)


class _Camera:
    """Positions and times of the last pictures of a fleet's cameras."""

    def __init__(self, run: Run, sensor: str, vehicles: slice, dtype: Any):
        parts = {"taken_at_ned": AXES, "taken_attitude": ANGLES}
        vectors = {name: vector(run, "measurements", f"{sensor}.{name}", axes) for name, axes in parts.items()}
        number = f"{sensor}.picture"
        known = "measurements" in run and number in run["measurements"] and all(vectors.values())
        self.known = known
        self._columns = Columns(run, "measurements", {**vectors, "picture": (number,)} if known else {})
        self._vehicles, self._dtype = vehicles, dtype

    def at(self, time: float) -> CameraReading:
        """Return a camera's recorded reading at a time [s]: pose at its last picture, and the picture's number."""
        where, attitude, number = (
            self._columns.at(name, time)[self._vehicles].astype(self._dtype)
            for name in ("taken_at_ned", "taken_attitude", "picture")
        )
        return record_of(CameraReading, Vec3(*where.T), Euler(*attitude.T), number[:, 0])


def _cameras(run: Run, world: World) -> dict[tuple[int, int], _Camera]:
    """Return (fleet number, sensor number) -> recorded readings, for all cameras that were logged."""
    found, first = {}, 0
    for number, fleet in enumerate(world.fleets):
        for index in (index for place, index in camera_places(world) if place == number):
            dtype = np.asarray(fleet.start.position_ned.x).dtype
            camera = _Camera(run, fleet.sensor_names[index], slice(first, first + fleet.size), dtype)
            if camera.known:
                found[number, index] = camera
        first += fleet.size
    return found
