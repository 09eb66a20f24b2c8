"""What the satellites in view are to receivers: weights, solution, and what it makes of each error (docs/gnss.md).

Between two knots of the sky all of it stays as it is. Where receivers see the same satellites it is computed once for
all of them; a last axis m is 1 there, and n where each sees its own.
"""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import exp
from qrsim.core.tree import quantity, record
from qrsim.core.vectors import Vec3
from qrsim.models.gnss.sight import LETTERS
from qrsim.models.gnss.slots import NOBODY, Slots
from qrsim.models.gnss.solving import Solution, Symmetric, factor, robust, solve, sums

# Speed of light over the rate of the C/A code [m]: a chip.
CHIP_M = 293.05
# DO-229D, J.2.4, smoothed airborne code: 0.13 m + 0.53 m exp(-elevation/10 deg).
_MULTIPATH_ALL, _MULTIPATH_LOW, _MULTIPATH_DEG = 0.13, 0.53, 10.0
# By how much C/N0 falls from the zenith to the horizon [dB], ours; above which one it costs no weight [dB-Hz]; and
# variance that comes with every tenfold less power [m^2].
_CN0_FALL, _CN0_STRONG, _CN0_VARIANCE = 10.0, 45.0, 0.15


@record
class Geometry:
    """A solution of receivers, and what it makes of errors."""

    knot: Array = quantity(doc="() int32 number of the knot since which it holds")
    age: Array = quantity(unit="s", doc="(K, m) time for which a satellite has been seen, 0 where it is not")
    rows: Any = quantity(unit="1", doc="(K, m) from errors of ranges to that of the solution, or None")
    multipath: Vec3 = quantity(unit="m", doc="(K, m) the same from each half of multipath, of unit variance")
    before: Vec3 = quantity(unit="m", doc="(m,) error by common errors of the code, at the last knot")
    after: Vec3 = quantity(unit="m", doc="(m,) at the next")
    carried: Vec3 = quantity(unit="m", doc="(m,) change by those of the carrier in between")
    slope_north: Vec3 = quantity(unit="1", doc="(m,) error per way to the north, by the slope of the ionosphere")
    slope_east: Vec3 = quantity(unit="1", doc="(m,) the same, east")
    systems: tuple[Vec3, ...] = quantity(unit="1", doc="(m,) error per offset of each system but the first")
    noise: Symmetric = quantity(unit="1", doc="(m,) factor of the covariance of white noise, 1 at 45 dB-Hz")
    horizontal: Array = quantity(unit="m", doc="(m,) accuracy of a fix, both axes together")
    vertical: Array = quantity(unit="m", doc="(m,) of its height")
    speed: Array = quantity(unit="m/s", doc="(m,) of its velocity")
    hdop: Array = quantity(unit="1", doc="(m,) horizontal dilution of precision")
    vdop: Array = quantity(unit="1", doc="(m,) vertical dilution of precision")
    count: Array = quantity(unit="1", doc="(m,) satellites used")
    seen: Array = quantity(unit="1", doc="(m,) satellites above the mask")
    enough: Array = quantity(doc="(m,) bool: they are enough for a fix")
    reflected: Any = quantity(default=None, unit="m", doc="(m,) error by reflections; None without obstacles")
    blocked: Any = quantity(default=None, unit="1", doc="(m,) satellites that obstacles hide")
    mirrored: Any = quantity(default=None, unit="1", doc="(m,) satellites of which a reflection alone is tracked")

    def of(self, ranges: Array) -> Vec3:
        """Return the error (n,) of the solution for errors of ranges (K, 1) or (K, n) [m]."""
        return Vec3(*(jnp.sum(row * ranges, axis=0) for row in (self.rows.x, self.rows.y, self.rows.z)))

    def common(self, part: Array) -> Vec3:
        """Return the error (m,) by common errors a part of the way from the last knot to the next."""
        return self.before + (self.after - self.before) * part


@record
class View:
    """Signals as receivers among obstacles get them; see hidden.py."""

    loss: Array = quantity(unit="dB", doc="(K, m) what C/N0 lacks")
    extra: Array = quantity(unit="m", doc="(K, m) error by a reflection")
    multipath: Array = quantity(unit="1", doc="(K, m) sum of both halves, of unit variance each")
    counted: Array = quantity(doc="(K, m) bool: above the mask")


def column(receiver: Any) -> int:
    """Return which of the ionosphere's scales are a receiver's: 0 for one frequency, 1 for two."""
    return 0 if receiver.frequencies == "single" else 1


def times(receiver: Any) -> tuple[Array, Array]:
    """Return the time constants [s] of both halves of multipath at rest."""
    return receiver.multipath_time, receiver.multipath_slow_time


def across(parameter: Any) -> Array:
    """Return a parameter as it meets arrays of slots by receivers: () or (1, n)."""
    value = jnp.asarray(parameter)
    return value[None, :] if value.ndim else value


def thermal_variance(receiver: Any) -> Array:
    """Return the variance [m^2] of thermal noise of a range at 45 dB-Hz (Kaplan and Hegarty, delay-lock loop)."""
    at_45 = CHIP_M**2 * 0.5 * 10.0 ** (-0.1 * _CN0_STRONG)
    return at_45 * jnp.asarray(receiver.code_bandwidth) * receiver.correlator_spacing


def carrier_to_noise(receiver: Any, up: Array) -> Array:
    """Return C/N0 [dB-Hz] of satellites of which the sine of the elevation is known, with nothing in between."""
    return across(receiver.cn0_zenith) - _CN0_FALL * (1.0 - up)


def passed(receiver: Any, rate: Array) -> Array:
    """Return the share of variance that both lags leave of a first-order process of a rate [1/s]."""
    first, second = 1.0 / jnp.asarray(receiver.loop_time), 1.0 / jnp.asarray(receiver.smoothing_time)
    above = first * second * (rate + first + second)
    return above / ((rate + first) * (rate + second) * (first + second))


def sights(receiver: Any, slots: Slots, position_ned: Vec3 | None, ground: Any) -> Array:
    """Return which satellites (K, m) receivers see: above the mask, of their systems, and not behind the ground."""
    numbers = [LETTERS.index(letter) for letter in receiver.systems]
    heard = slots.ids != jnp.uint32(NOBODY)
    if len(numbers) < len(LETTERS):
        heard = heard & jnp.any(jnp.stack([slots.system == number for number in numbers]), axis=0)
    sight = slots.sight.line_of_sight
    seen = (heard & (-sight.z > math.sin(receiver.elevation_mask_rad)))[:, None]
    if ground is None or not ground.hides or position_ned is None:
        return seen
    shape = (*slots.ids.shape, *position_ned.x.shape)
    rays = sight.map(lambda axis: jnp.broadcast_to(axis[:, None], shape))
    return seen & (-rays.z > ground.horizon_sine(position_ned, rays))


def geometry_of(receiver: Any, slots: Slots, seen: Array, age: Array, view: View | None = None) -> Geometry:
    """Return the geometry of receivers (a ``Gnss``) that see satellites (K, m) for a time (K, m) [s]."""
    age = jnp.where(seen, age, 0.0)
    ramp = jnp.clip((age - across(receiver.acquisition)) / across(receiver.entry), 0.0, 1.0)
    used = seen & (ramp > 0.0)
    sight, scales, which = slots.sight, slots.scales, column(receiver)
    up = -sight.line_of_sight.z[:, None]
    cn0 = carrier_to_noise(receiver, up) if view is None else carrier_to_noise(receiver, up) - view.loss
    weaker = exp((_CN0_STRONG - cn0) * (0.1 * math.log(10.0)))
    low = exp(sight.elevation[:, None] * (-1.0 / math.radians(_MULTIPATH_DEG)))
    multipath = across(receiver.multipath) * (_MULTIPATH_ALL + _MULTIPATH_LOW * low)
    thermal = across(thermal_variance(receiver)) * weaker
    delay = 0.5 * scales.vertical[which] * sight.ionosphere
    zenith = scales.troposphere * sight.troposphere
    common = (scales.signal * scales.signal + delay * delay + zenith * zenith)[:, None]
    variance = multipath * multipath + thermal + common + _CN0_VARIANCE * jnp.maximum(weaker - 1.0, 0.0)
    directions, weight = sight.line_of_sight.map(lambda axis: axis[:, None]), jnp.where(used, ramp / variance, 0.0)
    solution = solve(directions, weight, used)
    apart = [(slots.system == LETTERS.index(letter)).astype(up.dtype)[:, None] for letter in receiver.systems[1:]]
    before, after = (
        (errors.signal, errors.delay if which == 0 else errors.delay_dual) for errors in (slots.before, slots.after)
    )
    carried = (after[0] - after[1]) - (before[0] - before[1])
    slope = scales.slope[which] * 1e-3
    columns = [before[0] + before[1], after[0] + after[1], carried,
               slope * slots.before.slope_north, slope * slots.before.slope_east]  # fmt: skip
    if view is not None:
        errors = view.extra + math.sqrt(0.5) * multipath * view.multipath
        if not slots.rough:
            errors = errors + (columns[0] + (columns[1] - columns[0]) * slots.part)[:, None]
        solution = robust(solution, directions, weight, used, errors, jnp.sqrt(variance))
    rows = solution.rows()
    found = solution.of([*(entry[:, None] for entry in columns), *apart])
    horizontal, vertical, speed = _accuracies(receiver, slots, solution, rows, multipath, weaker, found[5:])
    half = math.sqrt(0.5) * multipath
    return Geometry(
        knot=slots.knot, age=age,
        rows=rows if slots.rough or slots.own is not None else None,
        multipath=rows.map(lambda row: row * half),
        before=found[0], after=found[1], carried=found[2], slope_north=found[3], slope_east=found[4],
        systems=tuple(found[5:]), noise=factor(rows, weaker),
        horizontal=horizontal, vertical=vertical, speed=speed, hdop=solution.hdop, vdop=solution.vdop,
        count=solution.count, seen=jnp.sum((seen if view is None else view.counted).astype(up.dtype), axis=0),
        enough=solution.enough, reflected=None if view is None else solution.of([view.extra])[0],
    )  # fmt: skip


def _accuracies(
    receiver: Any, slots: Slots, solution: Solution, rows: Vec3, multipath: Array, weaker: Array, systems: list[Vec3]
) -> tuple[Array, Array, Array]:
    """Return the standard deviations of horizontal error, height and velocity that receivers report."""
    sight, scales, which = slots.sight, slots.scales, column(receiver)
    fast, slow = (passed(receiver, 1.0 / jnp.asarray(time)) for time in times(receiver))
    own = multipath * multipath * across(0.5 * (fast + slow))
    white = passed(receiver, jnp.asarray(2.0 / receiver.period))
    own = own + across(thermal_variance(receiver) * white) * weaker
    local = scales.local[which] * sight.ionosphere
    each = own + (scales.signal * scales.signal + local * local)[:, None]
    squares = [axis * axis for axis in (rows.x, rows.y, rows.z)]
    north, east, down, *rates = sums([s * part for part in (each, weaker) for s in squares])
    gradient = scales.gradient[which]
    together = [
        (scales.vertical[which], sight.ionosphere), (scales.troposphere, sight.troposphere),
        (gradient, sight.ionosphere * sight.pierce_north), (gradient, sight.ionosphere * sight.pierce_east),
    ]  # fmt: skip
    parts = [*solution.of([entry[:, None] for _, entry in together]), *systems]
    stds = [*(std for std, _ in together), *(receiver.system_bias for _ in systems)]
    for std, part in zip(stds, parts, strict=True):
        north, east, down = (v + (std * a) ** 2 for v, a in ((north, part.x), (east, part.y), (down, part.z)))
    speed = receiver.doppler_noise * jnp.sqrt(rates[0] + rates[1] + rates[2])
    return jnp.sqrt(north + east), jnp.sqrt(down), speed
