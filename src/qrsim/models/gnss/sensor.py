"""The sensor ``gnss``: a receiver whose errors have a part of its own, and a filter (docs/gnss.md).

What it measures is truth plus error, and the error is what is computed: a weighted solution of range errors goes
through two lags that carrier phase carries along. With the place it differs by the ionosphere's slope only.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal

import jax.numpy as jnp
from jax import Array, lax

from qrsim.core.fastmath import exp
from qrsim.core.noise import Draw
from qrsim.core.pairs import added
from qrsim.core.tree import parameter, quantity, record, replace, select, setting
from qrsim.core.vectors import Vec3
from qrsim.models.gnss.apart import Apart, apart_at, apart_init, apart_step
from qrsim.models.gnss.geometry import Geometry, across, column, geometry_of, passed, sights, thermal_variance, times
from qrsim.models.gnss.hidden import Tracking, solved
from qrsim.models.gnss.presets import PRESETS, default
from qrsim.models.gnss.receivers import GnssReading, SkyState
from qrsim.models.gnss.sight import LETTERS, MASK_LOWEST
from qrsim.models.gnss.slots import Slots
from qrsim.models.gnss.solving import correlated
from qrsim.models.sensors.contracts import Sensor

# Fixes after which a filter counts as settled, times [s] for which a satellite counts as seen for ever, and just now.
_MANY, _LONG_S, _JUST_S = 1 << 20, 1e6, 1e-3
# While coasting the velocity gets less certain by this much [m/s^2], ours.
_COASTING = 2.0
# Pairs of normals: of multipath they are those of the satellites' numbers from here on.
_MULTIPATH_PAIRS, _BIAS_PAIR = 1 << 24, 8


def _number(name: str, unit: str, doc: str, *, positive: bool = False) -> Any:
    bound = {"above": 0.0} if positive else {"minimum": 0.0}
    return parameter(default=default(name), unit=unit, doc=doc, **bound)  # type: ignore[arg-type]


@record
class GnssFix(GnssReading):
    """Reading of a ``gnss`` receiver; its position and velocity, dilutions and accuracies are NaN without a fix."""

    fix_type: Array = quantity(unit="1", doc="3: three-dimensional, 0: none, as GPS_FIX_TYPE of MAVLink has them")
    horizontal_accuracy: Array = quantity(
        unit="m", doc="standard deviation of the horizontal error, both axes together"
    )
    vertical_accuracy: Array = quantity(unit="m", doc="standard deviation of the vertical error")
    speed_accuracy: Array = quantity(unit="m/s", doc="standard deviation of the velocity error, all axes together")
    satellites_seen: Array = quantity(unit="1", doc="satellites above the mask")
    satellites_blocked: Any = quantity(
        default=None, unit="1", doc="of these, those that obstacles hide; None in worlds without obstacles"
    )
    satellites_reflected: Any = quantity(
        default=None, unit="1", doc="of these, those of which a reflection alone is tracked; None without obstacles"
    )


@record
class GnssState:
    """State of n receivers."""

    geometry: Any = quantity(doc="Geometry that all of them share; None where receivers see satellites of their own")
    age: Any = quantity(doc="(K, n) time [s] for which each has seen a satellite, where they differ, else None")
    ids: Array = quantity(doc="(K,) uint32 number of the satellite in each slot")
    fast: Array = quantity(unit="1", doc="(K, n) multipath that changes soon")
    slow: Array = quantity(unit="1", doc="(K, n) multipath that stays")
    inner: Vec3 = quantity(unit="m", doc="error after the first lag")
    outer: Vec3 = quantity(unit="m", doc="error after the second lag: that of the fix")
    fixes: Array = quantity(unit="1", doc="fixes since the filter started")
    coasted: Array = quantity(unit="1", doc="periods without enough satellites")
    bias: tuple[Array, ...] = quantity(unit="m", doc="of each system but the first, against that one")
    true_ned: Vec3 = quantity(unit="m", doc="true position at the last fix")
    true_low_ned: Any = quantity(unit="m", doc="what single precision leaves out of it, or None")
    ranges: Any = quantity(doc="(K,) or (K, n) error of the carrier at the last fix, where it is needed, else None")
    apart: Any = quantity(doc="common errors where each receiver has its own, else None")
    history: tuple[GnssFix, ...] = quantity(doc="the last fixes, oldest first: as many as the delay, at least one")
    tracking: Tracking | None = quantity(default=None, doc="signals that obstacles have hidden; None without obstacles")


@record
class Gnss(Sensor):
    """A GNSS receiver with multipath and noise of its own, a filter, and honest accuracies.

    It needs a sky with slots, which every scenario with such a sensor has. ``velocity: differenced`` takes the velocity
    from successive fixes. With fewer than 4 satellites it coasts on its last velocity for a while.
    """

    preset: Literal["m8n", "f9p_single", "gps_2011"] = setting(
        default="f9p_single", doc="which receiver the parameters that are not given are of"
    )
    systems: str = setting(default=default("systems"), doc="letters of the systems it uses, of G, E, R, C")
    frequencies: Literal["single", "dual"] = setting(default=default("frequencies"), doc="that it uses")
    velocity: Literal["doppler", "differenced"] = setting(
        default=default("velocity"), doc="where the velocity comes from"
    )
    nlos: Literal["track", "ignore"] = setting(
        default=default("nlos"), doc="what it does with reflections of satellites that obstacles hide"
    )
    elevation_mask_rad: float = setting(
        default=default("elevation_mask_rad"), unit="rad", doc="satellites below this elevation are not used",
        minimum=MASK_LOWEST, maximum=math.pi / 2,
    )  # fmt: skip
    delay: int = setting(
        default=default("delay"), unit="periods", doc="age of a fix when it is reported", minimum=0, maximum=50
    )
    period: float = setting(
        default=default("period"), unit="s", doc="interval between fixes, a multiple of the sky's period", above=0.0
    )
    multipath: Array = _number("multipath", "1", "multipath per that of an airborne antenna")
    multipath_time: Array = _number("multipath_time", "s", "time constant of its faster half at rest", positive=True)
    multipath_slow_time: Array = _number(
        "multipath_slow_time", "s", "time constant of its slower half at rest", positive=True
    )
    multipath_length: Array = _number(
        "multipath_length", "m", "way on which multipath changes in flight", positive=True
    )
    cn0_zenith: Array = _number("cn0_zenith", "dB-Hz", "carrier to noise density of a satellite at the zenith")
    code_bandwidth: Array = _number("code_bandwidth", "Hz", "noise bandwidth of the code loop")
    correlator_spacing: Array = _number("correlator_spacing", "1", "early to late, in chips")
    doppler_noise: Array = _number("doppler_noise", "m/s", "std of each range rate at 45 dB-Hz")
    system_bias: Array = _number("system_bias", "m", "std of what is left of a system's offset after calibration")
    loop_time: Array = _number("loop_time", "s", "time constant of the first lag", positive=True)
    smoothing_time: Array = _number("smoothing_time", "s", "time constant of the second lag", positive=True)
    acquisition: Array = _number("acquisition", "s", "time until a satellite that comes into view is used")
    entry: Array = _number("entry", "s", "time in which its weight grows to the full one", positive=True)
    reacquisition: Array = _number("reacquisition", "s", "time until one that obstacles have hidden is used again")
    reacquisition_long: Array = _number(
        "reacquisition_long", "s", "the same, of one that was hidden for more than a minute"
    )
    coast: Array = _number("coast", "s", "time for which it goes on without enough satellites")
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "velocity_ned", "sky", "position_low_ned", "ground", "skyline")
    draws_alone: ClassVar[bool] = True
    presets: ClassVar[dict[str, dict[str, Any]]] = PRESETS

    def init(
        self, draw: Draw, position_ned: Vec3, velocity_ned: Vec3, sky: SkyState, position_low_ned: Vec3 | None = None,
        ground: Any = None, skyline: Any = None,
    ) -> tuple[GnssState, GnssFix]:  # fmt: skip
        """Return the first fix of receivers that have long been running."""
        return self._started(draw, position_ned, velocity_ned, sky, position_low_ned, ground, skyline, None)

    def restart(
        self, state: GnssState, draw: Draw, since: Array, position_ned: Vec3, velocity_ned: Vec3, sky: SkyState,
        position_low_ned: Vec3 | None = None, ground: Any = None, skyline: Any = None,
    ) -> tuple[GnssState, GnssFix]:  # fmt: skip
        """Return the first fix of receivers placed anew, ``since`` [s] after an epoch."""
        shared = state.geometry
        fresh, reading = self._started(draw, position_ned, velocity_ned, sky, position_low_ned, ground, skyline, shared)
        return replace(fresh, true_ned=fresh.true_ned - velocity_ned * since), reading

    def placed(self, chosen: Array, fresh: GnssState, before: GnssState) -> GnssState:
        """Return the state in which only chosen receivers (n,) were placed anew; what all share stays."""
        shared = {"geometry": before.geometry, "ids": before.ids}
        if before.ranges is not None and before.apart is None:
            shared["ranges"] = before.ranges
        nothing = dict.fromkeys(shared)
        return replace(select(chosen, replace(fresh, **nothing), replace(before, **nothing)), **shared)

    def step(
        self, state: GnssState, draw: Draw, position_ned: Vec3, velocity_ned: Vec3, sky: SkyState,
        position_low_ned: Vec3 | None = None, ground: Any = None, skyline: Any = None,
    ) -> tuple[GnssState, GnssFix]:  # fmt: skip
        """Compute a fix of receivers at position_ned (n,), and report the one of ``delay`` periods ago."""
        slots: Slots = sky.slots
        same = slots.ids == state.ids
        if state.geometry is None:
            age = jnp.where(same[:, None], state.age + self.period, self.period)
            now = geometry_of(self, slots, sights(self, slots, position_ned, ground), age)
        else:
            now = lax.cond(
                slots.knot == state.geometry.knot, lambda: state.geometry, lambda: self._renewed(state, slots)
            )
        fast, slow = self._multipath(state, draw, slots, same, velocity_ned)
        whole, tracking = now, None
        if skyline is not None:
            now, tracking = solved(self, skyline, slots, whole, state.tracking, same, position_ned, fast, slow)
        normals = draw.normals(6)
        common, moved_on, ranges, apart = self._common(now, state, draw, sky, same)
        error = self._own_error(now, state.bias, position_ned, fast, slow) + common
        error = error + correlated(now.noise, normals[:3]) * jnp.sqrt(thermal_variance(self))

        enough = now.enough
        fixes = jnp.where(enough, jnp.minimum(state.fixes + 1.0, float(_MANY)), 0.0)
        inner, outer = self._lagged(state, error, moved_on, fixes)
        moved = _moved(position_ned, position_low_ned, state)
        if self.velocity == "doppler":
            noise = correlated(now.noise, normals[3:]) * jnp.asarray(self.doppler_noise)
            velocity = velocity_ned + moved_on * (1.0 / self.period) + noise
        else:
            mean = (moved + (outer - state.outer)) * (1.0 / self.period)
            velocity = mean.map(lambda axis: jnp.where(fixes > 1.0, axis, jnp.nan))
        held = state.history[-1]
        coasted = jnp.where(enough, 0.0, state.coasted + 1.0)
        lasts = coasted * self.period < self.coast + 0.5 * self.period
        coasting = ~enough & lasts & jnp.isfinite(held.velocity_ned.x)
        way = held.velocity_ned * self.period - moved
        drifted = Vec3(*(jnp.where(coasting, a + b, a) for a, b in _axes(state.outer, way)))
        outer, inner = select(enough & (fixes > 0.0), (outer, inner), (drifted, drifted))
        place = _placed_at(position_ned, position_low_ned, outer)
        fresh = self._reading(now, place, velocity, held, coasting)
        history = (*state.history, fresh)
        state = GnssState(
            geometry=None if state.geometry is None else whole, age=None if state.geometry is not None else whole.age,
            ids=slots.ids, fast=fast, slow=slow, inner=inner, outer=outer, fixes=fixes, coasted=coasted,
            bias=state.bias, true_ned=position_ned, true_low_ned=position_low_ned, ranges=ranges, apart=apart,
            history=history[1:], tracking=tracking,
        )  # fmt: skip
        return state, history[-1 - self.delay]

    def _started(
        self, draw: Draw, position_ned: Vec3, velocity_ned: Vec3, sky: SkyState, position_low_ned: Vec3 | None,
        ground: Any, skyline: Any, shared: Geometry | None,
    ) -> tuple[GnssState, GnssFix]:  # fmt: skip
        """Return state and reading of receivers whose filters have settled; ``shared`` is what they share already."""
        slots: Slots = sky.slots
        alike = ground is None or not ground.hides
        now = shared
        if now is None:
            old = jnp.full((*slots.ids.shape, 1), _LONG_S, slots.part.dtype)
            now = geometry_of(self, slots, sights(self, slots, position_ned, ground), old)
        normals = draw.normals(6)
        pair = draw.normal_rows(2 * len(LETTERS), first=_BIAS_PAIR)
        spread = jnp.asarray(self.system_bias)
        bias = tuple(spread * pair[i] for i in range(len(self.systems) - 1))
        fast, slow = draw.normal_pairs(slots.ids + jnp.uint32(_MULTIPATH_PAIRS))
        whole, tracking = now, None
        if skyline is not None:
            now, tracking = solved(self, skyline, slots, whole, None, None, position_ned, fast, slow)
        speed = velocity_ned.norm()
        settled = [jnp.sqrt(passed(self, 1.0 / time + speed / self.multipath_length)) for time in times(self)]
        apart = None if slots.own is None else apart_init(slots.own, draw, slots)
        if apart is not None:
            code, ranges = apart_at(slots.own, apart, slots, column(self))
            common = now.of(code)
        elif slots.rough:
            ranges = sky.range_error[jnp.maximum(slots.places, 0)]
            common = now.of(ranges[:, None])
        else:
            common, ranges = now.common(slots.part), None
        error = self._own_error(now, bias, position_ned, across(settled[0]) * fast, across(settled[1]) * slow) + common
        noise = correlated(now.noise, normals[3:]) * jnp.asarray(self.doppler_noise)
        place = _placed_at(position_ned, position_low_ned, error)
        nothing = jnp.zeros_like(position_ned.x)
        none = Vec3(nothing, nothing, nothing)
        without = GnssFix(none, none, *(nothing,) * 8)
        reading = self._reading(now, place, velocity_ned + noise, without, nothing > 0.0)
        enough = jnp.broadcast_to(now.enough, nothing.shape)
        error = error.map(lambda axis: jnp.where(enough, axis, 0.0))
        state = GnssState(
            geometry=whole if alike else None, age=None if alike else jnp.broadcast_to(whole.age, fast.shape),
            ids=slots.ids, fast=fast, slow=slow, inner=error, outer=error,
            fixes=jnp.where(enough, float(_MANY), nothing), coasted=nothing, bias=bias,
            true_ned=position_ned, true_low_ned=position_low_ned, ranges=ranges, apart=apart,
            history=(reading,) * max(self.delay, 1), tracking=tracking,
        )  # fmt: skip
        return state, reading

    def _renewed(self, state: GnssState, slots: Slots) -> Geometry:
        """Return the geometry of a new knot, that all receivers share."""
        before: Geometry = state.geometry
        passed_s = (slots.knot - before.knot).astype(before.age.dtype) * slots.knot_s
        same = (slots.ids == state.ids)[:, None]
        # What is new came into view since the last knot.
        age = jnp.where(same & (before.age > 0.0), jnp.minimum(before.age + passed_s, _LONG_S), _JUST_S)
        return geometry_of(self, slots, sights(self, slots, None, None), age)

    def _common(
        self, now: Geometry, state: GnssState, draw: Draw, sky: SkyState, same: Array
    ) -> tuple[Vec3, Vec3, Any, Apart | None]:
        """Return the solution's error by common errors, its change by the carrier's, and what is to be remembered."""
        slots: Slots = sky.slots
        if state.apart is None and not slots.rough:
            return now.common(slots.part), now.carried * (self.period / slots.knot_s), None, None
        if state.apart is None:
            code = carrier = sky.range_error[jnp.maximum(slots.places, 0)]
            change = jnp.where(same, carrier - state.ranges, 0.0)[:, None]
            return now.of(code[:, None]), now.of(change), carrier, None
        apart = apart_step(slots.own, state.apart, draw, slots, same, self.period)
        code, carrier = apart_at(slots.own, apart, slots, column(self))
        return now.of(code), now.of(jnp.where(same[:, None], carrier - state.ranges, 0.0)), carrier, apart

    def _own_error(self, now: Geometry, bias: tuple[Array, ...], position_ned: Vec3, fast: Array, slow: Array) -> Vec3:
        """Return the solution's error (n,) by multipath, by offsets of systems, and by where a receiver is."""
        both = fast + slow
        error = now.multipath.map(lambda row: jnp.sum(row * both, axis=0))
        for part, value in zip(now.systems, bias, strict=True):
            error = error + part * value
        if now.reflected is not None:
            error = error + now.reflected
        return error + now.slope_north * position_ned.x + now.slope_east * position_ned.y

    def _multipath(
        self, state: GnssState, draw: Draw, slots: Slots, same: Array, velocity_ned: Vec3
    ) -> tuple[Array, Array]:
        """Advance both halves of the multipath (K, n) by a period; that of a satellite in a new slot begins anew."""
        # Not normal, which would take half of a fix's time: the sums over time and satellites are.
        drawn = draw.uniform_pairs(slots.ids + jnp.uint32(_MULTIPATH_PAIRS))
        way = velocity_ned.norm() * (self.period / self.multipath_length)
        found = []
        for before, number, time in zip((state.fast, state.slow), drawn, times(self), strict=True):
            change = self.period / jnp.asarray(time) + way
            decay, spread = exp(-change), jnp.sqrt(-jnp.expm1(-2.0 * change))
            found.append(jnp.where(same[:, None], across(decay) * before + across(spread) * number, number))
        return found[0], found[1]

    def _lagged(self, state: GnssState, error: Vec3, moved_on: Vec3, fixes: Array) -> tuple[Vec3, Vec3]:
        """Return the errors after both lags, which the carrier's change moves on."""
        started = 1.0 / jnp.maximum(fixes, 1.0)
        gains = [
            jnp.maximum(started, -jnp.expm1(-self.period / jnp.asarray(time)))
            for time in (self.loop_time, self.smoothing_time)
        ]
        inner = state.inner + moved_on
        inner = inner + (error - inner) * gains[0]
        outer = state.outer + moved_on
        return inner, outer + (inner - outer) * gains[1]

    def _reading(self, now: Geometry, place: Vec3, velocity: Vec3, held: GnssFix, coasting: Array) -> GnssFix:
        """Return the fix: computed, coasting on what is ``held``, or none."""
        shape, enough = place.x.shape, now.enough
        grown = held.speed_accuracy + _COASTING * self.period
        wider = grown * self.period

        def chosen(new: Array, old: Array) -> Array:
            return jnp.broadcast_to(jnp.where(enough, new, jnp.where(coasting, old, jnp.nan)), shape)

        fix = jnp.broadcast_to(enough | coasting, shape)
        return GnssFix(
            place.map(lambda axis: jnp.where(fix, axis, jnp.nan)),
            Vec3(*(chosen(new, old) for new, old in _axes(velocity, held.velocity_ned))),
            jnp.broadcast_to(now.count, shape),
            chosen(now.hdop, held.hdop),
            chosen(now.vdop, held.vdop),
            jnp.where(fix, 3.0, 0.0).astype(place.x.dtype),
            chosen(now.horizontal, held.horizontal_accuracy + wider),
            chosen(now.vertical, held.vertical_accuracy + wider),
            chosen(now.speed, grown),
            jnp.broadcast_to(now.seen, shape),
            now.blocked,
            now.mirrored,
        )


def _axes(first: Vec3, second: Vec3) -> tuple[tuple[Array, Array], ...]:
    return (first.x, second.x), (first.y, second.y), (first.z, second.z)


def _moved(position_ned: Vec3, low: Vec3 | None, state: GnssState) -> Vec3:
    """Return by how much receivers (n,) have truly moved since the last fix."""
    moved = position_ned - state.true_ned
    return moved if low is None else moved + (low - state.true_low_ned)


def _placed_at(position_ned: Vec3, low: Vec3 | None, error: Vec3) -> Vec3:
    """Return where receivers (n,) say they are."""
    return position_ned + error if low is None else added(position_ned, error + low)[0]
