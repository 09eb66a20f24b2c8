"""Optional fields of a reading of the sensor ``gnss`` for each satellite."""

from __future__ import annotations

import math

import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import replace
from qrsim.core.vectors import Vec3
from qrsim.models.gnss.fixes import GnssFix
from qrsim.models.gnss.geometry import FOUND, Geometry, sights, strengths, weakness
from qrsim.models.gnss.hidden import weaker_by
from qrsim.models.gnss.interference import Effect
from qrsim.models.gnss.parameters import ReceiverParameters
from qrsim.models.gnss.skyline import Skyline
from qrsim.models.gnss.slots import NOBODY, Slots
from qrsim.models.scene.contracts import Ground

# States of a satellite.
OFF, DIRECT, REFLECTED, BLOCKED, JAMMED = 0.0, 1.0, 2.0, 3.0, 4.0
# What a spoofer sends is nearly as strong for all satellites [dB-Hz], ours; a receiver may notice that.
_SPOOFED_CN0, _SPOOFED_SPREAD = 45.0, 1.0


def with_satellites(
    receiver: ReceiverParameters,
    reading: GnssFix,
    now: Geometry,
    slots: Slots,
    effect: Effect | None,
    position_ned: Vec3,
    ground: Ground | None,
    skyline: Skyline | None,
    slow: Array,
) -> GnssFix:
    """Return the reading with each slot's satellite added: number, C/N0, state, azimuth and elevation.

    Args:
        receiver: a ``Gnss``.
        reading: of it.
        now: its solution.
        slots: satellites in view.
        effect: of interference, if there is any.
        position_ned: of the receivers [m].
        ground, skyline: what hides satellites; None: nothing does.
        slow: slower half of their multipath (K, n), by which reflections are weaker.
    """
    like, sight = reading.satellites[None, :] * 0.0, slots.sight
    is_tracked = now.age + like > 0.0
    jam = None if effect is None else effect.jam
    above = sights(receiver, slots, None, None)
    hides = above & ~sights(receiver, slots, position_ned, ground)
    if skyline is not None:
        hides = hides | skyline.look(position_ned, sight)[0]
    state = jnp.where(above & hides, BLOCKED, OFF) + like
    if effect is not None and slots.interference is not None:
        sends = above & ~hides & ~slots.interference.silent[:, None]
        state = jnp.where(
            sends & (effect.jam > 0.0)[None, :] & (weakness(receiver, slots, jam) >= FOUND), JAMMED, state
        )
    state = jnp.where(is_tracked, jnp.where(hides, REFLECTED, DIRECT), state)
    cn0 = strengths(receiver, slots, jam) - jnp.where(hides, weaker_by(slow), 0.0)
    if effect is not None and effect.misled is not None:
        nearly = _SPOOFED_CN0 - _SPOOFED_SPREAD * sight.line_of_sight.z
        cn0 = jnp.where(effect.misled[None, :], nearly[:, None], cn0)
    taken = (slots.ids != jnp.uint32(NOBODY))[:, None]
    numbers = slots.ids.astype(jnp.int32).astype(like.dtype)
    azimuth = jnp.arctan2(sight.line_of_sight.y, sight.line_of_sight.x)

    def each(rows: Array, free: float = 0.0) -> tuple[Array, ...]:
        """Return the rows (K, n) as one array for each slot, ``free`` in slots without a satellite."""
        spread = jnp.where(taken, rows, free) + like
        return tuple(spread[i] for i in range(spread.shape[0]))

    return replace(
        reading,
        cn0=each(jnp.where(is_tracked, cn0, 0.0)),
        satellite_state=each(state),
        satellite=each(numbers[:, None], -1.0),
        azimuth=each(jnp.where(azimuth < 0.0, azimuth + 2.0 * math.pi, azimuth)[:, None]),
        elevation=each(sight.elevation[:, None]),
    )
