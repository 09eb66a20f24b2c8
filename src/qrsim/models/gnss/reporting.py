"""From the error of a solution to what a receiver of type ``gnss`` says: its filter, and its reading."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from qrsim.core.pairs import added
from qrsim.core.vectors import Vec3
from qrsim.models.gnss.fixes import GnssFix, GnssState
from qrsim.models.gnss.fixing import CORRECTED, SINGLE, Quality, Received
from qrsim.models.gnss.geometry import Geometry, clear_weakness
from qrsim.models.gnss.interference import Effect
from qrsim.models.gnss.parameters import ReceiverParameters

# While coasting the velocity gets less certain by this much [m/s^2], ours.
_COASTING = 2.0


def lagged(
    receiver: ReceiverParameters,
    state: GnssState,
    error: Vec3,
    moved_on: Vec3,
    fixes: Array,
    got: Received | None = None,
) -> tuple[Vec3, Vec3]:
    """Return the position errors (n,) [m] after one and after both low-pass filters, shifted by ``moved_on`` [m]."""
    started = 1.0 / jnp.maximum(fixes, 1.0)
    gains = [
        jnp.maximum(started, -jnp.expm1(-receiver.period / jnp.asarray(time)))
        for time in (receiver.loop_time, receiver.smoothing_time)
    ]
    if got is not None:
        if receiver.corrections == "rtk":
            slower = jnp.maximum(started, -jnp.expm1(-receiver.period / jnp.asarray(receiver.float_time)))
            gains[1] = jnp.where(got.on, slower, gains[1])
        gains = [jnp.where(got.on & ~got.live, 0.0, gain) for gain in gains]
    inner = state.inner + moved_on
    inner = inner + (error - inner) * gains[0]
    outer = state.outer + moved_on
    return inner, outer + (inner - outer) * gains[1]


def plain(receiver: ReceiverParameters, now: Geometry) -> Quality:
    """Return the quality (fix type, accuracies) of fixes without a base station's corrections."""
    return Quality(CORRECTED if receiver.corrections == "sbas" else SINGLE, now.horizontal, now.vertical)


def fix_of(
    receiver: ReceiverParameters,
    now: Geometry,
    quality: Quality,
    place: Vec3,
    velocity: Vec3,
    held: GnssFix,
    coasting: Array,
    effect: Effect | None,
) -> GnssFix:
    """Return the reading: the new fix, the last one extrapolated while coasting, or NaN without a fix."""
    shape, enough = place.x.shape, now.enough
    grown = held.speed_accuracy + _COASTING * receiver.period
    wider = grown * receiver.period

    def chosen(new: Array, old: Array) -> Array:
        """Return ``new`` where satellites are enough for a fix, ``old`` while coasting, else NaN."""
        return jnp.broadcast_to(jnp.where(enough, new, jnp.where(coasting, old, jnp.nan)), shape)

    fix = jnp.broadcast_to(enough | coasting, shape)
    fix_type = jnp.where(enough, quality.fix_type, jnp.where(coasting, SINGLE, 0.0))
    return GnssFix(
        place.map(lambda axis: jnp.where(fix, axis, jnp.nan)),
        Vec3(*(chosen(new, old) for new, old in zip(velocity.axes, held.velocity_ned.axes, strict=True))),
        jnp.broadcast_to(now.count, shape),
        chosen(now.hdop, held.hdop),
        chosen(now.vdop, held.vdop),
        jnp.broadcast_to(fix_type, shape).astype(place.x.dtype),
        chosen(quality.horizontal, held.horizontal_accuracy + wider),
        chosen(quality.vertical, held.vertical_accuracy + wider),
        chosen(now.speed, grown),
        jnp.broadcast_to(now.seen if effect is None else effect.above, shape),
        now.blocked,
        now.mirrored,
        quality.age,
        None if effect is None else effect.jam / (effect.jam + clear_weakness(receiver)),
        None if effect is None else effect.lost,
    )


def misled(effect: Effect | None, error: Vec3, velocity: Vec3) -> tuple[Vec3, Vec3]:
    """Return position errors [m] and velocities [m/s] (n,) with the offsets that spoofers cause added."""
    if effect is None or effect.offset_ned is None or effect.rate_ned is None:
        return error, velocity
    return error + effect.offset_ned, velocity + effect.rate_ned


def moved(position_ned: Vec3, low: Vec3 | None, state: GnssState) -> Vec3:
    """Return the true displacement (n,) [m] of receivers since their last fix."""
    way = position_ned - state.true_ned
    return way if low is None else way + (low - state.true_low_ned)


def placed_at(position_ned: Vec3, low: Vec3 | None, error: Vec3) -> Vec3:
    """Return the reported positions (n,) [m]: true position plus error, summed with the remainder ``low``."""
    return position_ned + error if low is None else added(position_ned, error + low)[0]
