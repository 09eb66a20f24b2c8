"""Receivers of type gnss in many worlds, each with its sky: what the study of GNSS and its small forms are made of."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.clock import split_time
from qrsim.core.noise import Draw, Key
from qrsim.core.tree import cast
from qrsim.core.vectors import Vec3
from qrsim.engine.backend import Extent, Function, Worlds
from qrsim.models.gnss.base_station import BaseStation
from qrsim.models.gnss.budget import ErrorBudget
from qrsim.models.gnss.constellations import NominalConstellations
from qrsim.models.gnss.presets import PRESETS
from qrsim.models.gnss.sensor import Gnss
from qrsim.models.gnss.sight import system_numbers
from qrsim.models.gnss.slots import SlottedSky
from qrsim.models.site import Site

Values = np.ndarray[Any, Any]
SLOTS = 40
# 2026-06-21 00:00 UTC.
MIDNIGHT_GPS_S = 1466035218.0


class Flown(NamedTuple):
    """What receivers said; T fixes, W worlds, V receivers in each.

    Attributes:
        error: (T, W, V, 3) of the position [m], NED.
        velocity_error: the same of the velocity [m/s].
        accuracy: (T, W, V, 3) reported: horizontal, vertical [m], speed [m/s].
        satellites: (T, W, V) used.
        fix_type: (T, W, V).
    """

    error: Values
    velocity_error: Values
    accuracy: Values
    satellites: Values
    fix_type: Values


def receiver(preset: str, **changes: Any) -> Gnss:
    """Return a receiver of a preset that reports fixes at once."""
    return Gnss(preset=preset, **{**PRESETS[preset], "delay": 0, **changes})


def base_at(position_ned: tuple[float, float, float] = (0.0, 0.0, 0.0), **how: Any) -> BaseStation:
    """Return a base station at a place [m], without an error of its own position."""
    silent = np.array(how.pop("silent", ()), np.float64)
    return BaseStation(position_ned=np.array(position_ned), silent=silent, **how)  # type: ignore[arg-type]


def sky_of(
    sensor: Gnss,
    start_s: float = 0.0,
    errors: Any = None,
    dtype: Any = np.float32,
    orbits: Any = None,
    site: Site | None = None,
    base: Any = None,
    interference: Any = None,
) -> SlottedSky:
    """Return the sky of a receiver over a site, from a time after midnight [s] on; errors default to the budget."""
    ephemeris = NominalConstellations(sensor.systems) if orbits is None else orbits
    place = site or Site()
    return SlottedSky(
        ephemeris.at(place, MIDNIGHT_GPS_S + start_s if orbits is None else start_s, dtype),
        cast(ErrorBudget() if errors is None else errors, dtype),
        jnp.asarray(ephemeris.satellite_ids),
        jnp.asarray(system_numbers(ephemeris.system_of), jnp.int32),
        sensor.period,
        sensor.period,
        SLOTS,
        math.sin(sensor.elevation_mask_rad),
        base=cast(base, dtype),
        interference=cast(interference, dtype),
    )


# Of the random streams of a world.
STREAMS = ("/sky", "/sky/start", "receiver", "receiver/start")


def _first(shared: Any, given: Any) -> Any:
    """Return a world at its start: keys of its streams, sky, receivers, and a fix that nobody reads."""
    (sky, sensor, offsets, velocity), (_, keys) = shared, given
    like, ids = jnp.zeros((), offsets.x.dtype), jnp.arange(offsets.x.shape[0], dtype=jnp.uint32)
    first_sky, first = keys.stream(1, sky.ids), keys.stream(3, ids)
    state = sky.init(Draw(first_sky, jnp.int32(0), like))
    memory, reading = sensor.init(Draw(first, jnp.int32(0), like), offsets, velocity, state)
    return keys, state, memory, _said(memory, reading, velocity)


def _next(shared: Any, given: Any, before: Any, tick: Any) -> Any:
    """Return a world at its next fix, number ``tick``."""
    (sky, sensor, offsets, velocity), (keys, state, memory, _) = shared, before
    like, ids = jnp.zeros((), offsets.x.dtype), jnp.arange(offsets.x.shape[0], dtype=jnp.uint32)
    later_sky, later = keys.stream(0, sky.ids), keys.stream(2, ids)
    seconds, fraction = split_time(tick, sensor.period, like.dtype)
    state = sky.step(state, Draw(later_sky, tick, like), seconds, fraction)
    truth = offsets + velocity * (tick.astype(like.dtype) * sensor.period)
    memory, reading = sensor.step(memory, Draw(later, tick, like), truth, velocity, state)
    return keys, state, memory, _said(memory, reading, velocity)


def _said(memory: Any, reading: Any, velocity: Any) -> tuple[Any, ...]:
    """Return the fields of ``Flown`` of one fix in one world."""
    said = memory.outer if memory.link is None else memory.link.said
    return (
        jnp.where((reading.fix_type > 0.0)[:, None], said.stack(), jnp.nan),
        (reading.velocity_ned - velocity).stack(),
        jnp.stack([reading.horizontal_accuracy, reading.vertical_accuracy, reading.speed_accuracy], axis=-1),
        reading.satellites,
        reading.fix_type,
    )


def fly(
    sensor: Gnss, seconds: float, worlds: int, *, offsets: Any = ((0.0, 0.0, 0.0),), speed: float = 0.0, seed: int = 0,
    start_s: float = 0.0, keep: int = 1, errors: Any = None, dtype: Any = np.float32, sky: SlottedSky | None = None,
    base: Any = None, interference: Any = None,
) -> Flown:  # fmt: skip
    """Let receivers at offsets (V, 3) [m] from the site report for a time, in each of several worlds.

    Args:
        sensor: see ``receiver``.
        seconds: how long.
        worlds: each with a sky of its own errors.
        offsets: where the receivers begin.
        speed: with which they fly north [m/s].
        seed: of all randomness.
        start_s: time of day of the start [s].
        keep: one fix of so many is kept.
        errors: range errors, by default the error budget.
        dtype: precision.
        sky: in place of the nominal constellations and ``errors``.
        base: see ``base_at``; None: no base station.
        interference: of the world, as ``Interference``; None: nothing interferes.
    """
    with jax.enable_x64(np.dtype(dtype) == np.float64):
        places = np.asarray(offsets, dtype)
        where = Vec3(*places.T)
        north = Vec3(*(np.full(len(places), value, dtype) for value in (speed, 0.0, 0.0)))
        sky = sky or sky_of(sensor, start_s, errors, dtype, base=base, interference=interference)
        # Not by XLA, which compiles for ten times as long.
        flying = Worlds(
            Function("start of receivers", _first, text=None),
            Function("fix of receivers", _next, text=None),
            (sky, cast(sensor, dtype), where, north),
            Extent(len(places), np.dtype(dtype), worlds),
        )
        flying.begin(Key.roots(np.full(worlds, seed, np.int64), np.arange(worlds)).streams(STREAMS))
        found = []
        for first in range(1, round(seconds / sensor.period) - keep + 2, keep):
            flying.advance(first, keep, ())
            found.append([np.array(part, np.float64) for part in flying.get(lambda world: world[3])])
        return Flown(*(np.stack(part) for part in zip(*found, strict=True)))


def over_a_day(sensor: Gnss, starts: int, seconds: float, worlds: int, seed: int = 0, **how: Any) -> Flown:
    """Return the last fixes of flights that begin at evenly spaced times of a day, one after the other."""
    parts = []
    last = round(seconds / sensor.period)
    for i in range(starts):
        start = 86400.0 * i / starts
        parts.append(fly(sensor, seconds, worlds, seed=seed + i, start_s=start, keep=last, **how))
    return Flown(*(np.concatenate([getattr(part, name) for part in parts]) for name in Flown._fields))
