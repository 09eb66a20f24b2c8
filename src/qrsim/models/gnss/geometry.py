"""Geometry of the satellites in view: weights, solution, and its error by each cause.

See docs/explanation/models/gnss.md.

It is constant between two knots of the sky. If all receivers see the same satellites it is computed once for all of
them, and the last axis m is 1; it is n if each receiver sees its own.
"""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import exp, log
from qrsim.core.tree import quantity, record, select
from qrsim.core.vectors import Vec3
from qrsim.models.gnss.parameters import ReceiverParameters, across, column, times
from qrsim.models.gnss.sight import LETTERS
from qrsim.models.gnss.slots import NOBODY, Slots
from qrsim.models.gnss.solving import Gains, Solution, Symmetric, factor, robust, solve, sums
from qrsim.models.scene.contracts import Ground

# Speed of light over the rate of the C/A code [m]: a chip.
CHIP_M = 293.05
# DO-229D, J.2.4, smoothed airborne code: 0.13 m + 0.53 m exp(-elevation/10 deg).
_MULTIPATH_ALL, _MULTIPATH_LOW, _MULTIPATH_DEG = 0.13, 0.53, 10.0
# By how much C/N0 falls from the zenith to the horizon [dB], ours; above which one it costs no weight [dB-Hz]; and
# variance that comes with every tenfold less power [m^2].
_CN0_FALL, _CN0_STRONG, _CN0_VARIANCE = 10.0, 45.0, 0.15
# What corrections of satellites leave of clocks and ephemerides, and of the ionosphere; ours.
SBAS_SIGNAL, SBAS_DELAY = 0.5, 0.25
# Carrier phase is fixed with satellites above this C/N0 [dB-Hz], tracked for so long [s].
_STRONG_CN0, _LOCKED_S = 35.0, 3.0
# Satellites are lost below the one and found again above the other [dB-Hz]; what that is in weakness, 1 at 45 dB-Hz.
_LOST_CN0, _FOUND_CN0 = 25.0, 33.0
LOST, FOUND = (10.0 ** (0.1 * (_CN0_STRONG - cn0)) for cn0 in (_LOST_CN0, _FOUND_CN0))
# Ages below this are of satellites that are not tracked, and decrease with the time since. After _COLD_S [s] they must
# be acquired again.
AWAY = -1000.0
_COLD_S, _OLDEST_S = 60.0, 1e6
# Rate [1/s] of a base station's multipath, as an accuracy takes it.
_BASE_RATE = 0.01


@record
class Differential:
    """Errors and accuracies of a solution with the corrections of a base station; m is 1 or n."""

    before: Any = quantity(unit="m", doc="(m,) error by the base's code at the last knot; None for a base that moves")
    after: Any = quantity(unit="m", doc="(m,) at the next")
    strong: Array = quantity(unit="1", doc="(m,) satellites that carrier phase can be fixed with")
    horizontal: Array = quantity(unit="m", doc="(m,) accuracy of a fix by code, both axes together")
    vertical: Array = quantity(unit="m", doc="(m,) of its height")
    float_horizontal: Array = quantity(unit="m", doc="(m,) accuracy of one that carrier phase has smoothed for long")
    float_vertical: Array = quantity(unit="m", doc="(m,) of its height")


@record
class Own:
    """Solutions of receivers among obstacles, for each receiver by itself."""

    gains: Gains = quantity(doc="their solutions")
    clear: Array = quantity(doc="(n,) bool: it is that of the open sky")
    directions: Any = quantity(default=None, unit="1", doc="Vec3 (K, 1) to the satellites; None while remembered")
    half: Any = quantity(default=None, unit="m", doc="(K, 1) std of each half of multipath; None while remembered")

    def of(self, shared: Vec3, ranges: Array) -> Vec3:
        """Return the position error (n,) [m] for range errors (K, n) [m]; that in ``shared`` with an open sky."""
        return select(self.clear, shared, self.gains.of(self.directions, ranges))


@record
class Geometry:
    """A solution of receivers: its errors by each cause, its accuracy and its satellites."""

    knot: Array = quantity(doc="() int32 number of the knot since which it holds")
    age: Any = quantity(unit="s", doc="(K, m) time for which a satellite has been seen, 0 where it is not")
    rows: Any = quantity(unit="1", doc="(K, m) from errors of ranges to that of the solution, or None")
    multipath: Any = quantity(unit="m", doc="Vec3 (K, m) the same from each half of multipath, of unit variance")
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
    differential: Any = quantity(default=None, doc="Differential, of receivers that take corrections of a base")
    reflected: Vec3 | None = quantity(default=None, unit="m", doc="(m,) error by reflections; None without obstacles")
    blocked: Array | None = quantity(default=None, unit="1", doc="(m,) satellites that obstacles hide")
    mirrored: Array | None = quantity(
        default=None, unit="1", doc="(m,) satellites of which a reflection alone is tracked"
    )
    own: Own | None = quantity(default=None, doc="Own, among obstacles: rows and multipath are those of the open sky")

    def of(self, ranges: Array) -> Vec3:
        """Return the solution's position error (n,) [m] for range errors (K, 1) or (K, n) [m]."""
        shared: Vec3 = self.rows.map(lambda row: jnp.sum(row * ranges, axis=0))
        return shared if self.own is None else self.own.of(shared, ranges)

    def of_multipath(self, both: Array) -> Vec3:
        """Return the solution's position error (n,) [m] for multipath (K, n), the sum of two unit-variance parts."""
        shared: Vec3 = self.multipath.map(lambda row: jnp.sum(row * both, axis=0))
        return shared if self.own is None else self.own.of(shared, self.own.half * both)

    def common(self, part: Array) -> Vec3:
        """Return the position error (m,) [m] by errors that all receivers share, at ``part`` 0 to 1 between updates."""
        return self.before + (self.after - self.before) * part


@record
class View:
    """Signals as receivers among obstacles get them; see hidden.py."""

    loss: Array = quantity(unit="dB", doc="(K, m) what C/N0 lacks")
    extra: Array = quantity(unit="m", doc="(K, m) error by a reflection")
    multipath: Array = quantity(unit="1", doc="(K, m) sum of both halves, of unit variance each")
    counted: Array = quantity(doc="(K, m) bool: above the mask")


def thermal_variance(receiver: ReceiverParameters) -> Array:
    """Return the variance [m^2] of a range by thermal noise at 45 dB-Hz (delay-lock loop, Kaplan and Hegarty)."""
    at_45 = CHIP_M**2 * 0.5 * 10.0 ** (-0.1 * _CN0_STRONG)
    return at_45 * jnp.asarray(receiver.code_bandwidth) * receiver.correlator_spacing


def multipath_std(receiver: ReceiverParameters, slots: Slots) -> Array:
    """Return the multipath standard deviation [m] of each slot's range, (K, 1) or (K, n), by elevation."""
    low = exp(slots.sight.elevation[:, None] * (-1.0 / math.radians(_MULTIPATH_DEG)))
    return across(receiver.multipath) * (_MULTIPATH_ALL + _MULTIPATH_LOW * low)


def carrier_to_noise(receiver: ReceiverParameters, up: Array) -> Array:
    """Return the C/N0 [dB-Hz] of unobstructed satellites, by the sine ``up`` of their elevation."""
    return across(receiver.cn0_zenith) - _CN0_FALL * (1.0 - up)


def passed(receiver: ReceiverParameters, rate: Array | float, smoothing_time: Array | None = None) -> Array:
    """Return the share of a first-order process' variance (``rate`` [1/s]) that passes the receiver's two filters."""
    second_time = receiver.smoothing_time if smoothing_time is None else smoothing_time
    first, second = 1.0 / jnp.asarray(receiver.loop_time), 1.0 / jnp.asarray(second_time)
    above = first * second * (rate + first + second)
    return above / ((rate + first) * (rate + second) * (first + second))


def sights(receiver: ReceiverParameters, slots: Slots, position_ned: Vec3 | None, ground: Ground | None) -> Array:
    """Return (K, m) bool: the receiver uses the system of the slot's satellite, and sees it above mask and terrain."""
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


def weakness(receiver: ReceiverParameters, slots: Slots, jam: Array | None = None, loss: Array | float = 0.0) -> Array:
    """Return 45 dB-Hz over the C/N0 of each satellite (K, m), as a power ratio: larger for weaker signals.

    ``jam`` (n,) is what jammers add, ``loss`` (K, m) what C/N0 lacks [dB].
    """
    cn0 = carrier_to_noise(receiver, -slots.sight.line_of_sight.z[:, None]) - loss
    weaker = exp((_CN0_STRONG - cn0) * (0.1 * math.log(10.0)))
    return weaker if jam is None else weaker + jam[None, :]


def strengths(receiver: ReceiverParameters, slots: Slots, jam: Array | None = None) -> Array:
    """Return the C/N0 (K, m) [dB-Hz] of the satellites, reduced by jamming ``jam`` (n,)."""
    return _CN0_STRONG - 10.0 / math.log(10.0) * log(weakness(receiver, slots, jam))


def clear_weakness(receiver: ReceiverParameters) -> Array:
    """Return 45 dB-Hz over the C/N0 of an unjammed satellite at the zenith, as a power ratio."""
    return exp((_CN0_STRONG - jnp.asarray(receiver.cn0_zenith)) * (0.1 * math.log(10.0)))


def tracked(receiver: ReceiverParameters, slots: Slots, seen: Array, age: Array, jam: Array) -> Array:
    """Return (K, n) bool: jammed receivers track the satellite; ``age`` (K, n) [s]: tracked so far, see ``aged``."""
    weaker = weakness(receiver, slots, jam)
    strong = weaker < jnp.where(age > 0.5 * AWAY, LOST, FOUND)
    return seen & (strong | ~(jam > 0.0)[None, :])


def aged(receiver: ReceiverParameters, seen: Array, same: Array, age: Array) -> Array:
    """Return tracking times (K, n) [s] one period later; while not in view they fall from ``AWAY``, a negative time."""
    period = receiver.period
    long = AWAY - age > _COLD_S
    found = across(receiver.acquisition) - jnp.where(
        long, across(receiver.reacquisition_long), across(receiver.reacquisition)
    )
    begins = jnp.where(age > 0.5 * AWAY, age, found)
    on = jnp.minimum(begins + period, _OLDEST_S)
    off = jnp.where(age > 0.5 * AWAY, AWAY, jnp.maximum(age, 10.0 * AWAY)) - period
    return jnp.where(same, jnp.where(seen, on, off), jnp.where(seen, period, AWAY - period))


def geometry_of(
    receiver: ReceiverParameters,
    slots: Slots,
    seen: Array,
    age: Array,
    view: View | None = None,
    jam: Array | None = None,
) -> Geometry:
    """Return the position solution (errors, accuracies) of receivers that track satellites (K, m) for ``age`` [s].

    Args:
        receiver: its parameters.
        slots: satellites of the sky, K of them.
        seen: (K, m) bool: the satellite is tracked.
        age: (K, m) [s] for which it has been tracked; does not count if it is not.
        view: effect of obstacles on its signals; None: an open sky.
        jam: (n,) weakening of all signals by jammers; None: no jammer.
    """
    age = jnp.where(seen, age, 0.0)
    ramp = jnp.clip((age - across(receiver.acquisition)) / across(receiver.entry), 0.0, 1.0)
    used = seen & (ramp > 0.0)
    sight, scales, which = slots.sight, slots.scales, column(receiver)
    up = -sight.line_of_sight.z[:, None]
    weaker = weakness(receiver, slots, jam, 0.0 if view is None else view.loss)
    multipath = multipath_std(receiver, slots)
    thermal = across(thermal_variance(receiver)) * weaker
    delay = 0.5 * scales.vertical[which] * sight.ionosphere
    zenith = scales.troposphere * sight.troposphere
    signal, left = _left(receiver)
    clock = signal * scales.signal
    delay = left * delay
    common = (clock * clock + delay * delay + zenith * zenith)[:, None]
    variance = multipath * multipath + thermal + common + _CN0_VARIANCE * jnp.maximum(weaker - 1.0, 0.0)
    directions, weight = sight.line_of_sight.map(lambda axis: axis[:, None]), jnp.where(used, ramp / variance, 0.0)
    solution = solve(directions, weight, used)
    apart = [(slots.system == LETTERS.index(letter)).astype(up.dtype)[:, None] for letter in receiver.systems[1:]]
    before, after = (
        (
            errors.signal if signal == 1.0 else errors.weather + signal * (errors.signal - errors.weather),
            left * (errors.delay if which == 0 else errors.delay_dual),
        )
        for errors in (slots.before, slots.after)
    )
    carried = (after[0] - after[1]) - (before[0] - before[1])
    slope = left * scales.slope[which] * 1e-3
    columns = [
        before[0] + before[1],
        after[0] + after[1],
        carried,
        slope * slots.before.slope_north,
        slope * slots.before.slope_east,
    ]
    if view is not None:
        errors = view.extra + math.sqrt(0.5) * multipath * view.multipath
        if not slots.rough:
            errors = errors + (columns[0] + (columns[1] - columns[0]) * slots.part)[:, None]
        solution = robust(solution, directions, weight, used, errors, jnp.sqrt(variance))
    rows = solution.rows()
    found = solution.of([*(entry[:, None] for entry in columns), *apart])
    horizontal, vertical, speed = _accuracies(receiver, slots, solution, rows, multipath, weaker, found[5:])
    half = math.sqrt(0.5) * multipath
    # Receivers among obstacles keep less: hidden.py decides which use the solution of the open sky.
    own = None if view is None else Own(Gains(solution.weight, solution.mean, solution.inverse), solution.enough)
    # Carrier phase is not fixed with reflections, which are all that is weaker for obstacles.
    direct = used if view is None else used & ~(view.loss > 0.0)
    return Geometry(
        knot=slots.knot,
        age=age if view is None else None,
        rows=rows if view is None and (slots.rough or slots.own is not None) else None,
        multipath=None if view is not None else rows.map(lambda row: row * half),
        own=own,
        before=found[0],
        after=found[1],
        carried=found[2],
        slope_north=found[3],
        slope_east=found[4],
        systems=tuple(found[5:]),
        noise=factor(rows, weaker),
        horizontal=horizontal,
        vertical=vertical,
        speed=speed,
        hdop=solution.hdop,
        vdop=solution.vdop,
        count=solution.count,
        seen=jnp.sum((seen if view is None else view.counted).astype(up.dtype), axis=0),
        enough=solution.enough,
        reflected=None if view is None else solution.of([view.extra])[0],
        differential=_differential(receiver, slots, solution, rows, age, direct, multipath, weaker, found[5:]),
    )


def left_signal(receiver: ReceiverParameters) -> float:
    """Return the share of satellite clock and orbit errors that SBAS corrections leave; 1 without SBAS."""
    return _left(receiver)[0]


def _left(receiver: ReceiverParameters) -> tuple[float, float]:
    """Return the shares of satellite clock and orbit errors, and of ionospheric errors, left by SBAS; 1 without."""
    return (SBAS_SIGNAL, SBAS_DELAY) if receiver.corrections == "sbas" else (1.0, 1.0)


def _own_variance(
    receiver: ReceiverParameters, multipath: Array, weaker: Array, smoothing_time: Array | None = None
) -> Array:
    """Return the variance (K, m) [m^2] of a receiver's own range errors (noise, multipath) after both its filters."""
    fast, slow = (passed(receiver, 1.0 / jnp.asarray(time), smoothing_time) for time in times(receiver))
    white = passed(receiver, 2.0 / receiver.period, smoothing_time)
    return multipath * multipath * across(0.5 * (fast + slow)) + across(thermal_variance(receiver) * white) * weaker


def _differential(
    receiver: ReceiverParameters,
    slots: Slots,
    solution: Solution,
    rows: Vec3,
    age: Array,
    used: Array,
    multipath: Array,
    weaker: Array,
    systems: list[Vec3],
) -> Differential | None:
    """Return position errors and accuracies [m] with a base station's corrections, None without a base station."""
    if not receiver.takes_base:
        return None
    before = after = None
    if receiver.moving_base:
        # The base is a receiver like this one.
        other = [_own_variance(receiver, multipath, weaker, time) for time in (None, receiver.float_time)]
        spread = math.sqrt(2.0)
    else:
        low = exp(slots.sight.elevation * (-1.0 / math.radians(_MULTIPATH_DEG)))
        std = slots.base.multipath * (_MULTIPATH_ALL + _MULTIPATH_LOW * low)
        before, after = (
            -part
            for part in solution.of([(std * code)[:, None] for code in (slots.base.code_before, slots.base.code_after)])
        )
        other = [passed(receiver, _BASE_RATE, time) * (std * std)[:, None] for time in (None, receiver.float_time)]
        spread = 1.0
    squares = [axis * axis for axis in (rows.x, rows.y, rows.z)]
    own = [_own_variance(receiver, multipath, weaker, time) for time in (None, receiver.float_time)]
    found = sums([square * (a + b) for a, b in zip(own, other, strict=True) for square in squares])
    bias = spread * receiver.system_bias
    for part in systems:
        found = [v + (bias * a) ** 2 for v, a in zip(found, (part.x, part.y, part.z) * 2, strict=True)]
    strong = used & (age > _LOCKED_S) & (weaker < 10.0 ** (0.1 * (_CN0_STRONG - _STRONG_CN0)))
    count = jnp.sum(strong.astype(weaker.dtype), axis=0)
    north, east, down, float_north, float_east, float_down = found
    return Differential(
        before,
        after,
        count,
        jnp.sqrt(north + east),
        jnp.sqrt(down),
        jnp.sqrt(float_north + float_east),
        jnp.sqrt(float_down),
    )


def _accuracies(
    receiver: ReceiverParameters,
    slots: Slots,
    solution: Solution,
    rows: Vec3,
    multipath: Array,
    weaker: Array,
    systems: list[Vec3],
) -> tuple[Array, Array, Array]:
    """Return the accuracies to report: horizontal position [m], height [m] and velocity [m/s], as stds."""
    sight, scales, which = slots.sight, slots.scales, column(receiver)
    signal, left = _left(receiver)
    own = _own_variance(receiver, multipath, weaker)
    clock, local = signal * scales.signal, left * scales.local[which] * sight.ionosphere
    each = own + (clock * clock + local * local)[:, None]
    squares = [axis * axis for axis in (rows.x, rows.y, rows.z)]
    north, east, down, *rates = sums([s * part for part in (each, weaker) for s in squares])
    gradient = left * scales.gradient[which]
    together = [
        (left * scales.vertical[which], sight.ionosphere),
        (scales.troposphere, sight.troposphere),
        (gradient, sight.ionosphere * sight.pierce_north),
        (gradient, sight.ionosphere * sight.pierce_east),
    ]
    parts = [*solution.of([entry[:, None] for _, entry in together]), *systems]
    stds = [*(std for std, _ in together), *(receiver.system_bias for _ in systems)]
    for std, part in zip(stds, parts, strict=True):
        north, east, down = (v + (std * a) ** 2 for v, a in ((north, part.x), (east, part.y), (down, part.z)))
    speed = receiver.doppler_noise * jnp.sqrt(rates[0] + rates[1] + rates[2])
    return jnp.sqrt(north + east), jnp.sqrt(down), speed
