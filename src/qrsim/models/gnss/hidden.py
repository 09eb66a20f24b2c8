"""Signals of satellites that obstacles hide or reflect, as receivers track and weigh them.

See docs/explanation/models/gnss.md.

A signal is seen, seen with a reflection, reflected only (NLOS), or blocked. Receivers for which none is hidden or
reflected have the solution of the open sky, to the bit.
"""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax

from qrsim.core.fastmath import sincos_turns
from qrsim.core.tree import quantity, record, replace, select
from qrsim.core.vectors import Vec3
from qrsim.models.gnss.geometry import (
    AWAY,
    CHIP_M,
    Geometry,
    View,
    carrier_to_noise,
    geometry_of,
    multipath_std,
)
from qrsim.models.gnss.interference import Effect
from qrsim.models.gnss.parameters import ReceiverParameters, across
from qrsim.models.gnss.skyline import Skyline
from qrsim.models.gnss.slots import Slots

# Envelope of a reflection beside the direct signal, for a narrow correlator: a part of its delay, up to half a spacing
# of 0.1 chips; and how often its phase turns while slow multipath changes once: on the way of a wavelength.
_ENVELOPE, _LONGEST, _TURNS = 0.3, 0.05 * CHIP_M, 5.0
# A reflection alone is so much weaker, with this spread [dB], and tracked above this C/N0 [dB-Hz].
_WEAKER, _SPREAD, _WEAKEST = 8.0, 2.0, 28.0
# After this time [s] without its signal a satellite must be acquired again.
_LOST = 60.0
# Times [s] that are for ever.
_LONG = 1e6


@record
class Tracking:
    """State of n receivers among obstacles: the signals in each slot, and the time at which they were last updated."""

    since: Array = quantity(
        unit="s", doc="(K, n) time that counts for the weight since it came back, long: never away; below AWAY: blocked"
    )
    knot: Array = quantity(doc="() int32 number of the knot at which they looked, or after which")
    part: Array = quantity(unit="1", doc="() how far it was to the next")
    solution: Geometry = quantity(doc="solutions since then, but for what is the open sky's")

    @property
    def held(self) -> Array:
        """Time [s] (K, n) since a satellite was last blocked by obstacles, for its weight; 0 while it is blocked."""
        return jnp.where(self.since < AWAY, 0.0, self.since)

    @property
    def away(self) -> Array:
        """Time [s] (K, n) for which a satellite has been blocked by obstacles; 0 if it is not."""
        return jnp.where(self.since < AWAY, AWAY - self.since, 0.0)

    def placed(self, chosen: Array, fresh: Tracking) -> Tracking:
        """Return this state with the receivers ``chosen`` (n,) taken from ``fresh``; shared parts are unchanged."""
        own, new = (
            replace(each, knot=None, part=None, solution=replace(each.solution, knot=None)) for each in (self, fresh)
        )
        mixed = select(chosen, new, own)
        solution = replace(mixed.solution, knot=self.solution.knot)
        return replace(mixed, knot=self.knot, part=self.part, solution=solution)


def solved(
    receiver: ReceiverParameters,
    skyline: Skyline,
    slots: Slots,
    whole: Geometry,
    before: Tracking | None,
    same: Array | None,
    position_ned: Vec3,
    fast: Array,
    slow: Array,
    effect: Effect | None = None,
) -> tuple[Geometry, Tracking]:
    """Return the position solutions and tracking of receivers (n,) among obstacles, updated each ``obstacle_period``.

    Args:
        receiver: a ``Gnss``.
        skyline: what obstacles do to signals.
        slots: satellites in view.
        whole: solution without obstacles; a last axis of 1 where all share it.
        before: what they remember; None at the start.
        same: (K,) bool: the slot has the satellite that it had before.
        position_ned: of the receivers [m].
        fast, slow: both halves of their multipath (K, n), of unit variance.
        effect: of interference, if there is any.
    """
    if before is None:
        start = jnp.zeros_like(slots.part)
        looked = _looked(receiver, skyline, slots, whole, None, same, position_ned, fast, slow, start, effect)
        return _as_seen(receiver, slots, whole, looked), looked
    passed = (slots.knot - before.knot).astype(slots.part.dtype) * slots.knot_s
    passed = passed + (slots.part - before.part) * slots.knot_s
    # A knot may have other satellites in the slots.
    due = (slots.knot != before.knot) | (passed > receiver.obstacle_period - 0.5 * receiver.period)

    def fresh() -> Tracking:
        """Return the tracking computed again for the present positions."""
        return _looked(receiver, skyline, slots, whole, before, same, position_ned, fast, slow, passed, effect)

    # What interferes does so at every fix.
    tracking = lax.cond(due, fresh, lambda: before) if effect is None else fresh()
    return _as_seen(receiver, slots, whole, tracking), tracking


def _as_seen(receiver: ReceiverParameters, slots: Slots, whole: Geometry, tracking: Tracking) -> Geometry:
    """Return the stored solutions with the present satellite directions, and the open sky's where nothing is hidden."""
    own = replace(
        tracking.solution.own,
        directions=slots.sight.line_of_sight.map(lambda axis: axis[:, None]),
        half=math.sqrt(0.5) * multipath_std(receiver, slots),
    )
    age = jnp.where(tracking.since < AWAY, 0.0, jnp.minimum(whole.age, tracking.since))
    return replace(tracking.solution, age=age, rows=whole.rows, multipath=whole.multipath, own=own)


def _looked(
    receiver: ReceiverParameters,
    skyline: Skyline,
    slots: Slots,
    whole: Geometry,
    before: Tracking | None,
    same: Array | None,
    position_ned: Vec3,
    fast: Array,
    slow: Array,
    passed: Array,
    effect: Effect | None,
) -> Tracking:
    """Return the tracking, with solutions among obstacles, computed again ``passed`` () [s] after the last time."""
    hides, detour = skyline.look(position_ned, slots.sight)
    there = jnp.broadcast_to(whole.age > 0.0, hides.shape)
    up = -slots.sight.line_of_sight.z[:, None]
    extra = detour * jnp.sqrt(jnp.maximum(1.0 - up * up, 0.0))
    mirrored = there & (detour > 0.0)
    # Weaker by more or less for each reflection, as long as its slow multipath lasts.
    weaker = weaker_by(slow)
    heard = receiver.nlos == "track"
    alone = mirrored & hides & heard & (carrier_to_noise(receiver, up) - weaker > _WEAKEST)
    echo = _ENVELOPE * jnp.minimum(extra, _LONGEST) * sincos_turns((_TURNS / (2.0 * math.pi)) * slow)[1]
    held, away = _tracked(receiver, before, same, there, hides & ~alone, passed)
    age = jnp.minimum(whole.age, held)
    seen = there & (~hides | alone)
    view = View(
        loss=jnp.where(alone, weaker, 0.0),
        extra=jnp.where(mirrored, jnp.where(hides, extra, echo), 0.0),
        multipath=fast + slow,
        counted=there,
    )
    now = geometry_of(receiver, slots, seen, age, view, None if effect is None else effect.jam)
    # Receivers with no signal that is hidden, reflected or being acquired again.
    settled = held >= jnp.minimum(whole.age, across(receiver.acquisition) + across(receiver.entry))
    clear = jnp.all(~there | (settled & ~hides & ~mirrored), axis=0)
    count = up.dtype
    alike = replace(whole, age=None, rows=None, multipath=None)
    solution = replace(
        _either(clear, alike, replace(now, reflected=None, own=None)),
        own=replace(now.own, clear=clear),
        reflected=now.reflected,
        blocked=jnp.sum((there & hides & ~alone).astype(count), axis=0),
        mirrored=jnp.sum(alone.astype(count), axis=0),
    )
    # Precise to a millisecond for as long as it counts.
    since = jnp.where(away > 0.0, AWAY - jnp.minimum(away, -AWAY), held)
    return Tracking(since, slots.knot, slots.part, solution)


def weaker_by(slow: Array) -> Array:
    """Return the attenuation [dB] of reflected signals, which varies with their slow multipath (unit variance)."""
    return _WEAKER - _SPREAD * slow


def _tracked(
    receiver: ReceiverParameters, before: Tracking | None, same: Any, there: Array, blocked: Array, passed: Array
) -> tuple[Array, Array]:
    """Return the times (K, n) [s] since a signal was last blocked, and for which it is blocked, after ``passed``."""
    blocked = there & blocked
    if before is None:
        long = jnp.full(blocked.shape, _LONG, passed.dtype)
        return jnp.where(blocked, 0.0, long), jnp.where(blocked, long, 0.0)
    kept = there & same[:, None]
    held, away = jnp.where(kept, before.held, _LONG), jnp.where(kept, before.away, 0.0)
    wait = jnp.where(away > _LOST, across(receiver.reacquisition_long), across(receiver.reacquisition))
    back = across(receiver.acquisition) - wait
    ahead = jnp.where(held >= _LONG, held, held + passed)
    since = jnp.where(blocked, jnp.minimum(away + passed, _LONG), 0.0)
    return jnp.where(blocked, 0.0, jnp.where(away > 0.0, back, ahead)), since


def _either(chosen: Array, yes: Geometry, no: Geometry) -> Geometry:
    """Return each receiver's (n,) geometry: ``yes`` where ``chosen``, else ``no``."""

    def pick(a: Array, b: Array) -> Array:
        """Return entries of ``a`` for the chosen receivers, else of ``b``."""
        if not jnp.ndim(a):
            return a
        return jnp.where(chosen if jnp.ndim(b) == 1 else chosen[None, :], a, b)

    return jax.tree.map(pick, yes, no)
