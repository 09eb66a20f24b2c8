"""Fixes with the corrections of a base station: by code, and by carrier phase, float and fixed.

See docs/howto/corrections.md.

All errors here are relative to the base station; ``_reported_error`` adds the error of the base itself last.
"""

from __future__ import annotations

import math

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import exp
from qrsim.core.noise import Draw
from qrsim.core.tree import quantity, record, replace, select
from qrsim.core.vectors import Vec3
from qrsim.models.gnss.base_station import carrier_step, distance
from qrsim.models.gnss.geometry import Geometry
from qrsim.models.gnss.interference import Effect
from qrsim.models.gnss.parameters import ReceiverParameters
from qrsim.models.gnss.slots import Slots

# Fix types, as GPS_FIX_TYPE of MAVLink has them.
NONE, SINGLE, CORRECTED, FLOAT, FIXED = 0.0, 3.0, 4.0, 5.0, 6.0
# Ages of corrections [s] up to which carrier phase stays fixed, and after which they are of no use.
_FIXED_AGE, LAST_AGE = 10.0, 60.0
_OLDEST = 1e4
# Fixing the carrier phase takes this number of stages of equal mean duration, so the time has a gamma distribution.
_STAGES = 4
# Satellites that it needs, number of further satellites from which on it is fastest, and length [m] of a baseline over
# which it takes e times as long.
_FEWEST, _MORE, _BASELINE = 5.0, 12.0, 25e3
# Wrong fixes: their errors [m], horizontal per axis and vertical, and the rate [1/s] at which they are noticed.
_WRONG, _NOTICED = (0.3, 0.6), 1.0 / 30.0
# By the share of satellites of which a reflection alone is tracked: more wrong fixes, and the rate [1/s] of losses.
_WRONG_REFLECTED, _LOST_REFLECTED = 0.1, 0.2
# White noise of carrier phase in position [m].
_WHITE = 0.002
# Errors within which half of all are, in standard deviations: of a circle, and of one axis.
_CIRCLE, _AXIS = math.sqrt(2.0 * math.log(2.0)), 0.6744898
# Pairs of numbers, apart from those of the sensor.
_UNIFORM_PAIR, _NORMAL_PAIR = 40, 48


@record
class Link:
    """State of n receivers that take the corrections of a base station."""

    age: Array = quantity(unit="s", doc="age of the corrections in use")
    on: Array = quantity(doc="bool: they are used")
    fixed: Array = quantity(doc="bool: carrier phase is fixed")
    stage: Array = quantity(unit="1", doc="stages of fixing it that are done")
    carrier: Vec3 = quantity(unit="1", doc="error of carrier phase, of unit variance")
    wrong: Vec3 = quantity(unit="m", doc="error of a wrong fix, else zero")
    drift: Vec3 = quantity(unit="m", doc="change of the common errors since the last corrections")
    said: Vec3 = quantity(unit="m", doc="error of the last reported position")


@record
class Received:
    """Corrections as n receivers get them at an epoch, and what they make of the errors."""

    way: Vec3 = quantity(unit="m", doc="vector from the base")
    live: Array = quantity(doc="bool: corrections have just come")
    on: Array = quantity(doc="bool: corrections are used")
    age: Array = quantity(unit="s", doc="age of the corrections")
    error: Vec3 = quantity(unit="m", doc="error of the code solution, relative to the base where corrections are used")
    moved_on: Vec3 = quantity(unit="m", doc="change of that error by common errors")
    drift: Vec3 = quantity(unit="m", doc="change of the common errors since the last corrections")


@record
class Quality:
    """Quality that receivers report for their fixes; (n,), or (m,) if it is the same for all."""

    fix_type: Array | float = quantity(unit="1", doc="as GPS_FIX_TYPE of MAVLink has them")
    horizontal: Array = quantity(unit="m", doc="accuracy, both axes together")
    vertical: Array = quantity(unit="m", doc="accuracy of the height")
    age: Array | None = quantity(default=None, unit="s", doc="age of the corrections; None without any")


def _picked(value: Array, base: Array) -> Array:
    """Return the value () of the vehicle that is the base station: the one True in the mask ``base`` (n,)."""
    return jnp.sum(jnp.where(base, value, 0.0))


def received(
    receiver: ReceiverParameters,
    slots: Slots,
    link: Link | None,
    position_ned: Vec3,
    now: Geometry,
    own: Vec3,
    error: Vec3,
    moved_on: Vec3,
    effect: Effect | None = None,
) -> Received:
    """Return which receivers (n,) use base corrections at an epoch, and the errors (n,) [m] of their code solutions.

    The base is one of the vehicles (``moving_base``) or the fixed station in ``slots``. Corrections are in use until
    they are ``LAST_AGE`` old; ``drift`` sums up how the common errors have changed since they were received.

    Args:
        receiver: a ``Gnss`` that takes corrections.
        slots: satellites in view, and the fixed base station.
        link: state of the receivers after the last epoch; None at the start.
        position_ned: true positions of the receivers (n,) [m].
        now: geometry of the solution, and how corrections change its errors.
        own: error (n,) [m] of the code solution by the errors of each receiver: bias, multipath, noise.
        error: ``own`` with the common errors of satellites and atmosphere (n,) [m].
        moved_on: change of the common errors since the last epoch, as the carrier phase has it (n,) or (1,) [m].
        effect: interference; receivers that are spoofed use no corrections.
    """
    nothing = jnp.zeros_like(position_ned.x)
    enough = jnp.broadcast_to(now.enough, nothing.shape)
    if receiver.moving_base:
        base = receiver.base_vehicle
        way = position_ned.map(lambda axis: axis - _picked(axis, base))
        relative = error.map(lambda axis: axis - _picked(axis, base))
        live = ~base & jnp.any(base & enough)
        fresh = nothing
    else:
        seen, part = slots.base, now.differential
        way = position_ned - seen.position_ned
        # The common errors cancel. The base adds the error of its own code; the slope of the ionosphere counts from it.
        of_base = part.before + (part.after - part.before) * slots.part
        relative = own + of_base - now.slope_north * seen.position_ned.x - now.slope_east * seen.position_ned.y
        live = jnp.broadcast_to(seen.sends & (distance(way) <= seen.reach), nothing.shape)
        fresh = nothing + seen.age
    before = nothing + _OLDEST if link is None else link.age
    age = jnp.where(live, fresh, jnp.minimum(before + receiver.period, _OLDEST))
    # Corrections of a moving base are valid only at the epoch at which they were sent.
    on = enough & (live if receiver.moving_base else age <= LAST_AGE)
    if effect is not None and effect.misled is not None:
        on = on & ~effect.misled
    zero = Vec3(nothing, nothing, nothing)
    drift = zero if link is None else select(on & ~live, link.drift + moved_on, zero)
    spread = moved_on.map(lambda axis: nothing + axis)
    return Received(way, live, on, age, select(on, relative, error), select(on, zero, spread), drift)


def started(
    receiver: ReceiverParameters, draw: Draw, slots: Slots, now: Geometry, got: Received
) -> tuple[Link, Quality]:
    """Return the correction link's state of receivers just switched on, and the quality of their first fixes."""
    nothing = jnp.zeros_like(got.age)
    zero = Vec3(nothing, nothing, nothing)
    carrier = Vec3(*draw.normal_rows(3, first=_NORMAL_PAIR))
    fixed = got.on & (receiver.corrections == "rtk" and receiver.first_fix == "fixed")
    link = Link(got.age, got.on, fixed, nothing, carrier, zero, zero, got.error)
    settled = nothing + receiver.smoothing_time / receiver.period
    said = _reported_error(receiver, link, slots, got, got.error, zero)
    return replace(link, said=said), _quality(receiver, link, now, got, settled)


def stepped(
    receiver: ReceiverParameters,
    link: Link,
    draw: Draw,
    slots: Slots,
    now: Geometry,
    got: Received,
    outer: Vec3,
    fixes: Array,
) -> tuple[Link, Quality]:
    """Return correction link and fix quality after an epoch, for filtered position errors ``outer`` (n,) [m]."""
    fixed, stage, wrong, carrier, white = link.fixed, link.stage, link.wrong, link.carrier, outer * 0.0
    if receiver.corrections == "rtk":
        rows = draw.normal_rows(10, first=_NORMAL_PAIR)
        carrier = carrier_step(carrier, (rows[0], rows[1], rows[2]), receiver.period)
        white = Vec3(rows[3], rows[4], rows[5]) * _WHITE
        chance, other = (
            0.5 + row[0] * (0.5 / math.sqrt(3.0))
            for row in draw.uniform_pairs(jnp.full((1,), _UNIFORM_PAIR, jnp.uint32))
        )
        part = now.differential
        able = got.on & (part.strong >= _FEWEST) & (got.age <= _FIXED_AGE)
        # Reflections that are taken for direct signals keep it from being fixed, and make it wrong.
        share = 0.0 if now.mirrored is None else now.mirrored / jnp.maximum(now.count, 1.0)
        speed = jnp.clip((part.strong - 4.0) / _MORE, 0.0, 1.0) * exp(-distance(got.way) * (1.0 / _BASELINE))
        speed = speed * (1.0 - jnp.minimum(1.0, 2.0 * share))
        goes_on = chance < speed * (_STAGES * receiver.period / receiver.fix_time)
        stage = jnp.where(able & ~fixed, stage + goes_on.astype(stage.dtype), 0.0)
        new = stage >= _STAGES
        spread = Vec3(rows[6] * _WRONG[0], rows[7] * _WRONG[0], rows[8] * _WRONG[1])
        is_wrong = new & (other < receiver.wrong_fixes + _WRONG_REFLECTED * share)
        wrong = spread.map(lambda axis: jnp.where(is_wrong, axis, 0.0))
        wrong = select(fixed, link.wrong, wrong)
        ends = jnp.where(link.wrong.x != 0.0, _NOTICED, 0.0) + _LOST_REFLECTED * share
        noticed = fixed & (other < receiver.period * ends)
        fixed = (fixed | new) & able & ~noticed
        stage = jnp.where(new, 0.0, stage)
        wrong = wrong.map(lambda axis: jnp.where(fixed, axis, 0.0))
    after = Link(got.age, got.on, fixed, stage, carrier, wrong, got.drift, outer)
    said = _reported_error(receiver, after, slots, got, outer, white)
    return replace(after, said=said), _quality(receiver, after, now, got, fixes)


def _reported_error(
    receiver: ReceiverParameters, link: Link, slots: Slots, got: Received, outer: Vec3, white: Vec3
) -> Vec3:
    """Return the errors (n,) [m] of the reported positions: relative to the base station, plus the base's own error."""
    if receiver.moving_base:
        base = receiver.base_vehicle
        origin, other = (part.map(lambda axis: _picked(axis, base)) for part in (outer, link.carrier))
    else:
        origin, other = slots.base.coordinates, slots.base.carrier
    if receiver.corrections == "rtk":
        scale = [receiver.fixed_accuracy * (math.sqrt(0.5) / s) for s in (_CIRCLE, _CIRCLE, _AXIS)]
        both = zip(link.carrier.axes, other.axes, scale, strict=True)
        phase = Vec3(*((own + base) * s for own, base, s in both)) + white + link.wrong
        if not receiver.moving_base:
            north, east = slots.base.tilt_north, slots.base.tilt_east
            scale = [receiver.fixed_per_distance / s for s in (_CIRCLE, _CIRCLE, _AXIS)]
            parts = zip(north.axes, east.axes, scale, strict=True)
            phase = phase + Vec3(*((a * got.way.x + b * got.way.y) * s for a, b, s in parts))
        against = select(link.fixed, phase, outer)
    else:
        against = outer
    with_base = against + link.drift
    whole = with_base + origin
    return select(got.on, whole, outer)


def _quality(receiver: ReceiverParameters, link: Link, now: Geometry, got: Received, fixes: Array) -> Quality:
    """Return the fix type and accuracies [m] that receivers report, which ignore wrong fixes and the base's error."""
    part = now.differential
    horizontal, vertical = part.horizontal, part.vertical
    fix_type: Array | float = CORRECTED
    if receiver.corrections == "rtk":
        begun = exp(-fixes * (receiver.period / receiver.float_time))
        horizontal, vertical = (
            jnp.sqrt(late * late + begun * jnp.maximum(early * early - late * late, 0.0))
            for early, late in ((horizontal, part.float_horizontal), (vertical, part.float_vertical))
        )
        per_way = receiver.fixed_per_distance * distance(got.way)
        square = receiver.fixed_accuracy * receiver.fixed_accuracy + per_way * per_way
        horizontal = jnp.where(link.fixed, jnp.sqrt(2.0 * (square / _CIRCLE**2 + _WHITE**2)), horizontal)
        vertical = jnp.where(link.fixed, jnp.sqrt(square / _AXIS**2 + _WHITE**2), vertical)
        fix_type = jnp.where(link.fixed, FIXED, FLOAT)
    return Quality(
        jnp.where(got.on, fix_type, SINGLE),
        jnp.where(got.on, horizontal, now.horizontal),
        jnp.where(got.on, vertical, now.vertical),
        got.age,
    )
