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
from qrsim.core.tree import derived, parameter, record, replace, select, setting
from qrsim.core.vectors import Vec3
from qrsim.models.gnss import fixing
from qrsim.models.gnss.apart import Apart, apart_at, apart_init, apart_step
from qrsim.models.gnss.fixes import GnssFix, GnssState
from qrsim.models.gnss.fixing import CORRECTED, SINGLE, Quality, Received
from qrsim.models.gnss.geometry import (
    AWAY,
    Geometry,
    across,
    aged,
    clear_weakness,
    column,
    geometry_of,
    left_signal,
    passed,
    sights,
    thermal_variance,
    times,
    tracked,
)
from qrsim.models.gnss.hidden import solved
from qrsim.models.gnss.interference import Effect, jammed, lied_to
from qrsim.models.gnss.per_satellite import with_satellites
from qrsim.models.gnss.presets import PRESETS, default
from qrsim.models.gnss.receivers import SkyState
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


def _number(name: str, unit: str, doc: str, *, positive: bool = False, most: float | None = None) -> Any:
    bound = {"above": 0.0} if positive else {"minimum": 0.0}
    return parameter(default=default(name), unit=unit, doc=doc, maximum=most, **bound)  # type: ignore[arg-type]


@record
class Gnss(Sensor):
    """A GNSS receiver with multipath and noise of its own, a filter, and honest accuracies.

    It needs a sky with slots, which every scenario with such a sensor has. ``velocity: differenced`` takes the velocity
    from successive fixes. With fewer than 4 satellites it coasts on its last velocity for a while.
    """

    preset: Literal["m8n", "f9p_single", "f9p_sbas", "f9p_rtk", "gps_2011"] = setting(
        default="f9p_single", doc="which receiver the parameters that are not given are of"
    )
    systems: str = setting(default=default("systems"), doc="letters of the systems it uses, of G, E, R, C")
    frequencies: Literal["single", "dual"] = setting(default=default("frequencies"), doc="that it uses")
    velocity: Literal["doppler", "differenced"] = setting(
        default=default("velocity"), doc="where the velocity comes from"
    )
    corrections: Literal["none", "sbas", "dgps", "rtk"] = setting(
        default=default("corrections"), doc="of satellites (sbas), or of a base station: by code, or carrier phase too"
    )
    moving_base: str = setting(
        default=default("moving_base"), doc="vehicle of the fleet that is the base; empty: world.base_station is"
    )
    first_fix: Literal["float", "fixed"] = setting(
        default=default("first_fix"), doc="whether carrier phase has to be fixed when a run starts"
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
    per_satellite: bool = setting(
        default=default("per_satellite"), doc="whether a reading has C/N0, state, number and place of each satellite"
    )
    obstacle_period: float = setting(
        default=default("obstacle_period"), unit="s", doc="interval at which it looks at what obstacles hide", above=0.0
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
    reacquisition: Array = _number("reacquisition", "s", "time until one that was hidden or jammed is used again")
    reacquisition_long: Array = _number(
        "reacquisition_long", "s", "the same, of one that was so for more than a minute"
    )
    coast: Array = _number("coast", "s", "time for which it goes on without enough satellites")
    float_time: Array = _number(
        "float_time", "s", "time constant of the second lag, without a fixed phase", positive=True
    )
    fix_time: Array = _number("fix_time", "s", "mean time to fix carrier phase with 16 satellites", positive=True)
    wrong_fixes: Array = _number("wrong_fixes", "1", "share of fixed carrier phases that are wrong", most=1.0)
    fixed_accuracy: Array = _number("fixed_accuracy", "m", "within which half of all fixed positions and heights are")
    fixed_per_distance: Array = _number("fixed_per_distance", "1", "what comes with the way from the base")
    base_vehicle: Any = derived(default=None, doc="(n,) bool: which vehicle is the moving base")
    spoofed: Any = derived(default=None, doc="for each spoofer of the world (n,) bool: which vehicles it is for")
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
        shared: dict[str, Any] = {"geometry": before.geometry, "ids": before.ids}
        if fresh.tracking is not None and before.tracking is not None:
            shared["tracking"] = before.tracking.placed(chosen, fresh.tracking)
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
        age, effect = None, None
        if state.geometry is None:
            seen, effect = self._seen(slots, position_ned, ground, skyline, state.age)
            age = aged(self, seen, same[:, None], state.age)
            now = geometry_of(self, slots, seen, age, None, None if effect is None else effect.jam)
        else:
            now = lax.cond(
                slots.knot == state.geometry.knot, lambda: state.geometry, lambda: self._renewed(state, slots)
            )
        fast, slow = self._multipath(state, draw, slots, same, velocity_ned)
        whole, tracking = now, None
        if skyline is not None:
            signals = (position_ned, fast, slow, effect)
            now, tracking = solved(self, skyline, slots, whole, state.tracking, same, *signals)
        normals = draw.normals(6)
        common, moved_on, ranges, apart = self._common(now, state, draw, sky, same)
        own = self._own_error(now, state.bias, position_ned, fast, slow)
        error = own + common
        thermal = correlated(now.noise, normals[:3]) * jnp.sqrt(thermal_variance(self))
        own, error = own + thermal, error + thermal

        enough = now.enough
        fixes = jnp.where(enough, jnp.minimum(state.fixes + 1.0, float(_MANY)), 0.0)
        link, quality, before = state.link, self._plain(now), state.outer
        if link is None:
            inner, outer = self._lagged(state, error, moved_on, fixes)
            said = outer
        else:
            got = fixing.received(self, slots, link, position_ned, now, own, error, moved_on, effect)
            # Whose kind of solution is another than before starts anew.
            fixes = jnp.where(enough & (got.on != link.on), 1.0, fixes)
            inner, outer = self._lagged(state, got.error, got.moved_on, fixes, got)
            before = link.said
            link, quality = fixing.stepped(self, link, draw, slots, now, got, outer, fixes)
            said = link.said
        moved = _moved(position_ned, position_low_ned, state)
        if self.velocity == "doppler":
            noise = correlated(now.noise, normals[3:]) * jnp.asarray(self.doppler_noise)
            velocity = velocity_ned + moved_on * (1.0 / self.period) + noise
        else:
            mean = (moved + (said - before)) * (1.0 / self.period)
            velocity = mean.map(lambda axis: jnp.where(fixes > 1.0, axis, jnp.nan))
        held = state.history[-1]
        coasted = jnp.where(enough, 0.0, state.coasted + 1.0)
        lasts = coasted * self.period < self.coast + 0.5 * self.period
        coasting = ~enough & lasts & jnp.isfinite(held.velocity_ned.x)
        way = held.velocity_ned * self.period - moved
        drifted = Vec3(*(jnp.where(coasting, a + b, a) for a, b in _axes(before, way)))
        outer, inner, said = select(enough & (fixes > 0.0), (outer, inner, said), (drifted, drifted, drifted))
        if link is not None:
            link = replace(link, said=said)
        shown, velocity = _misled(effect, said, velocity)
        place = _placed_at(position_ned, position_low_ned, shown)
        fresh = self._reading(now, quality, place, velocity, held, coasting, effect)
        if self.per_satellite:
            fresh = with_satellites(self, fresh, now, slots, effect, position_ned, ground, skyline, slow)
        history = (*state.history, fresh)
        state = GnssState(
            geometry=None if state.geometry is None else whole, age=age,
            ids=slots.ids, fast=fast, slow=slow, inner=inner, outer=outer, fixes=fixes, coasted=coasted,
            bias=state.bias, true_ned=position_ned, true_low_ned=position_low_ned, ranges=ranges, apart=apart,
            history=history[1:], link=link, tracking=tracking,
        )  # fmt: skip
        return state, history[-1 - self.delay]

    def _started(
        self, draw: Draw, position_ned: Vec3, velocity_ned: Vec3, sky: SkyState, position_low_ned: Vec3 | None,
        ground: Any, skyline: Any, shared: Geometry | None,
    ) -> tuple[GnssState, GnssFix]:  # fmt: skip
        """Return state and reading of receivers whose filters have settled; ``shared`` is what they share already."""
        slots: Slots = sky.slots
        alike = (ground is None or not ground.hides) and slots.interference is None
        now, age, effect = shared, None, None
        if now is None:
            old = jnp.full((*slots.ids.shape, *(() if alike else position_ned.x.shape)), _LONG_S, slots.part.dtype)
            old = old[:, None] if alike else old
            seen, effect = self._seen(slots, position_ned, ground, skyline, old)
            age = None if alike else jnp.where(seen, old, 2.0 * AWAY)
            now = geometry_of(self, slots, seen, old, None, None if effect is None else effect.jam)
        normals = draw.normals(6)
        pair = draw.normal_rows(2 * len(LETTERS), first=_BIAS_PAIR)
        spread = jnp.asarray(self.system_bias)
        bias = tuple(spread * pair[i] for i in range(len(self.systems) - 1))
        fast, slow = draw.normal_pairs(slots.ids + jnp.uint32(_MULTIPATH_PAIRS))
        whole, tracking = now, None
        if skyline is not None:
            now, tracking = solved(self, skyline, slots, whole, None, None, position_ned, fast, slow, effect)
        speed = velocity_ned.norm()
        settled = [jnp.sqrt(passed(self, 1.0 / time + speed / self.multipath_length)) for time in times(self)]
        apart = None if slots.own is None else apart_init(slots.own, draw, slots)
        if apart is not None:
            code, ranges = apart_at(slots.own, apart, slots, column(self))
            common = now.of(code)
        elif slots.rough:
            ranges = left_signal(self) * sky.range_error[jnp.maximum(slots.places, 0)]
            common = now.of(ranges[:, None])
        else:
            common, ranges = now.common(slots.part), None
        own = self._own_error(now, bias, position_ned, across(settled[0]) * fast, across(settled[1]) * slow)
        error = own + common
        noise = correlated(now.noise, normals[3:]) * jnp.asarray(self.doppler_noise)
        nothing = jnp.zeros_like(position_ned.x)
        none = Vec3(nothing, nothing, nothing)
        fixes, said, link, quality = nothing + float(_MANY), error, None, self._plain(now)
        if self.takes_base:
            got = fixing.received(self, slots, None, position_ned, now, own, error, none, effect)
            link, quality = fixing.started(self, draw, slots, now, got)
            error, said = got.error, link.said
            if self.corrections == "rtk":
                fixes = jnp.where(got.on, self.smoothing_time / self.period, fixes)
        shown, velocity = _misled(effect, said, velocity_ned + noise)
        place = _placed_at(position_ned, position_low_ned, shown)
        without = GnssFix(none, none, *(nothing,) * 8)
        reading = self._reading(now, quality, place, velocity, without, nothing > 0.0, effect)
        if self.per_satellite:
            reading = with_satellites(self, reading, now, slots, effect, position_ned, ground, skyline, slow)
        enough = jnp.broadcast_to(now.enough, nothing.shape)
        error = error.map(lambda axis: jnp.where(enough, axis, 0.0))
        state = GnssState(
            geometry=whole if alike else None, age=age,
            ids=slots.ids, fast=fast, slow=slow, inner=error, outer=error,
            fixes=jnp.where(enough, fixes, nothing), coasted=nothing, bias=bias,
            true_ned=position_ned, true_low_ned=position_low_ned, ranges=ranges, apart=apart,
            history=(reading,) * max(self.delay, 1), link=link, tracking=tracking,
        )  # fmt: skip
        return state, reading

    def _seen(
        self, slots: Slots, position_ned: Vec3, ground: Any, skyline: Any, age: Array
    ) -> tuple[Array, Effect | None]:
        """Return which satellites (K, m) receivers track, tracked for ages (K, m) [s] so far, and what interferes."""
        seen, present = sights(self, slots, position_ned, ground), slots.interference
        if present is None:
            return seen, None
        of_whom = self.spoofed or ()
        jam = jammed(present, of_whom, position_ned, ground, skyline)
        misled, offset, rate = lied_to(present, of_whom, position_ned) if present.lies else (None, None, None)
        there = seen & ~present.silent[:, None]
        kept = tracked(self, slots, there, age, jam)
        above, left = (jnp.sum(which.astype(jam.dtype), axis=0) + 0.0 * jam for which in (there, kept))
        return kept, Effect(jam, misled, offset, rate, above, above - left)

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
            code = carrier = left_signal(self) * sky.range_error[jnp.maximum(slots.places, 0)]
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

    @property
    def takes_base(self) -> bool:
        """Whether it takes corrections of a base station."""
        return self.corrections in ("dgps", "rtk")

    def _plain(self, now: Geometry) -> Quality:
        """Return the quality of fixes without a base station."""
        return Quality(CORRECTED if self.corrections == "sbas" else SINGLE, now.horizontal, now.vertical)

    def _lagged(
        self, state: GnssState, error: Vec3, moved_on: Vec3, fixes: Array, got: Received | None = None
    ) -> tuple[Vec3, Vec3]:
        """Return the errors after both lags, which the carrier's change moves on; without corrections they wait."""
        started = 1.0 / jnp.maximum(fixes, 1.0)
        gains = [
            jnp.maximum(started, -jnp.expm1(-self.period / jnp.asarray(time)))
            for time in (self.loop_time, self.smoothing_time)
        ]
        if got is not None:
            if self.corrections == "rtk":
                slower = jnp.maximum(started, -jnp.expm1(-self.period / jnp.asarray(self.float_time)))
                gains[1] = jnp.where(got.on, slower, gains[1])
            gains = [jnp.where(got.on & ~got.live, 0.0, gain) for gain in gains]
        inner = state.inner + moved_on
        inner = inner + (error - inner) * gains[0]
        outer = state.outer + moved_on
        return inner, outer + (inner - outer) * gains[1]

    def _reading(
        self, now: Geometry, quality: Quality, place: Vec3, velocity: Vec3, held: GnssFix, coasting: Array,
        effect: Effect | None,
    ) -> GnssFix:  # fmt: skip
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
            _spread(jnp.where(enough, quality.fix_type, jnp.where(coasting, SINGLE, 0.0)), place.x),
            chosen(quality.horizontal, held.horizontal_accuracy + wider),
            chosen(quality.vertical, held.vertical_accuracy + wider),
            chosen(now.speed, grown),
            jnp.broadcast_to(now.seen if effect is None else effect.above, shape),
            now.blocked,
            now.mirrored,
            quality.age,
            None if effect is None else effect.jam / (effect.jam + clear_weakness(self)),
            None if effect is None else effect.lost,
        )


def _axes(first: Vec3, second: Vec3) -> tuple[tuple[Array, Array], ...]:
    return (first.x, second.x), (first.y, second.y), (first.z, second.z)


def _misled(effect: Effect | None, error: Vec3, velocity: Vec3) -> tuple[Vec3, Vec3]:
    """Return errors of positions, and velocities, that spoofers have moved on."""
    if effect is None or effect.misled is None:
        return error, velocity
    return error + effect.offset_ned, velocity + effect.rate_ned


def _spread(value: Array, like: Array) -> Array:
    """Return a value for each of n receivers."""
    return jnp.broadcast_to(value, like.shape).astype(like.dtype)


def _moved(position_ned: Vec3, low: Vec3 | None, state: GnssState) -> Vec3:
    """Return by how much receivers (n,) have truly moved since the last fix."""
    moved = position_ned - state.true_ned
    return moved if low is None else moved + (low - state.true_low_ned)


def _placed_at(position_ned: Vec3, low: Vec3 | None, error: Vec3) -> Vec3:
    """Return where receivers (n,) say they are."""
    return position_ned + error if low is None else added(position_ned, error + low)[0]
