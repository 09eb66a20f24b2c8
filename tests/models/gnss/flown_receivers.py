"""Receivers of type gnss in many worlds, each with its sky: what the study of GNSS and its small forms are made of."""

from __future__ import annotations

import math
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.clock import split_time
from qrsim.core.noise import Draw, Key
from qrsim.core.tree import cast
from qrsim.core.vectors import Vec3
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


# Optimised, the program takes ten times as long to compile, and flies no study in less time than that.
_QUICKLY = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0}


@partial(jax.jit, static_argnames=("fixes", "worlds", "keep"), compiler_options=_QUICKLY)
def _flown(
    sky: SlottedSky, sensor: Gnss, offsets: Any, velocity: Any, seed: Any, fixes: int, worlds: int, keep: int
) -> Any:
    like = jnp.zeros((), offsets.x.dtype)
    ids = jnp.arange(offsets.x.shape[0], dtype=jnp.uint32)
    names = ("/sky", "/sky/start", "receiver", "receiver/start")

    def one(world: jax.Array) -> Any:
        key = Key.root(seed, world)
        later_sky, first_sky, later, first = (key.stream(name, sky.ids if "sky" in name else ids) for name in names)
        start = sky.init(Draw(first_sky, jnp.int32(0), like))
        memory, _ = sensor.init(Draw(first, jnp.int32(0), like), offsets, velocity, start)

        def fix(carry: Any, tick: jax.Array) -> Any:
            state, memory = carry
            seconds, fraction = split_time(tick, sensor.period, like.dtype)
            state = sky.step(state, Draw(later_sky, tick, like), seconds, fraction)
            time = tick.astype(like.dtype) * sensor.period
            truth = offsets + velocity * time
            memory, reading = sensor.step(memory, Draw(later, tick, like), truth, velocity, state)
            said = memory.outer if memory.link is None else memory.link.said
            return (state, memory), (
                jnp.where((reading.fix_type > 0.0)[:, None], said.stack(), jnp.nan),
                (reading.velocity_ned - velocity).stack(),
                jnp.stack([reading.horizontal_accuracy, reading.vertical_accuracy, reading.speed_accuracy], axis=-1),
                reading.satellites,
                reading.fix_type,
            )

        def some(carry: Any, first: jax.Array) -> Any:
            carry, found = jax.lax.scan(fix, carry, first + jnp.arange(1, keep + 1, dtype=jnp.int32))
            return carry, jax.tree.map(lambda leaf: leaf[-1], found)

        return jax.lax.scan(some, (start, memory), keep * jnp.arange(fixes // keep, dtype=jnp.int32))[1]

    return jax.vmap(one)(jnp.arange(worlds, dtype=jnp.uint32))


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
        where = Vec3(*(jnp.asarray(places[:, i]) for i in range(3)))
        north = Vec3(*(jnp.full(len(places), value, dtype) for value in (speed, 0.0, 0.0)))
        sky = sky or sky_of(sensor, start_s, errors, dtype, base=base, interference=interference)
        fixes = round(seconds / sensor.period)
        words = jnp.asarray([seed, 0], jnp.uint32)
        found = _flown(sky, cast(sensor, dtype), where, north, words, fixes - fixes % keep, worlds, keep)
        return Flown(*(np.moveaxis(np.asarray(part, np.float64), 0, 1) for part in found))


def over_a_day(sensor: Gnss, starts: int, seconds: float, worlds: int, seed: int = 0, **how: Any) -> Flown:
    """Return the last fixes of flights that begin at evenly spaced times of a day, one after the other."""
    parts = []
    last = round(seconds / sensor.period)
    for i in range(starts):
        start = 86400.0 * i / starts
        parts.append(fly(sensor, seconds, worlds, seed=seed + i, start_s=start, keep=last, **how))
    return Flown(*(np.concatenate([getattr(part, name) for part in parts]) for name in Flown._fields))
