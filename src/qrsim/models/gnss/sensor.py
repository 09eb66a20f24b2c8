"""The sensor ``gnss``: a receiver with partly independent errors, and a filter (docs/howto/choose_a_receiver.md).

What it measures is truth plus error, and the error is what is computed: a weighted solution of range errors goes
through two lags that carrier phase carries along. With the place it differs by the ionosphere's slope only.
"""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jax import Array, lax

from qrsim.core.noise import Draw
from qrsim.core.tree import record, replace, select
from qrsim.core.vectors import Vec3
from qrsim.models.gnss import fixing
from qrsim.models.gnss.fixes import GnssFix, GnssState
from qrsim.models.gnss.geometry import (
    AWAY,
    Geometry,
    aged,
    geometry_of,
    passed,
    sights,
    thermal_variance,
    tracked,
)
from qrsim.models.gnss.hidden import solved
from qrsim.models.gnss.interference import Effect, jammed, lied_to
from qrsim.models.gnss.own_errors import MULTIPATH_PAIRS, common_errors, first_common, own_error, step_multipath
from qrsim.models.gnss.parameters import ReceiverParameters, across, times
from qrsim.models.gnss.per_satellite import with_satellites
from qrsim.models.gnss.receivers import SkyState
from qrsim.models.gnss.reporting import fix_of, lagged, misled, moved, placed_at, plain
from qrsim.models.gnss.sight import LETTERS
from qrsim.models.gnss.skyline import Skyline
from qrsim.models.gnss.slots import Slots
from qrsim.models.gnss.solving import correlated
from qrsim.models.scene.contracts import Ground
from qrsim.models.sensors.contracts import Sensor

# Fixes after which a filter counts as settled, times [s] for which a satellite counts as seen for ever, and just now.
_MANY, _LONG_S, _JUST_S = 1 << 20, 1e6, 1e-3
# Pair of normals from which on they are those of offsets between systems.
_BIAS_PAIR = 8


@record
class Gnss(ReceiverParameters, Sensor):
    """A GNSS receiver with shared and independent errors, a filter, and reported accuracies.

    It needs a sky with slots, which every scenario with this sensor has. ``velocity: differenced`` takes the velocity
    from successive fixes. With fewer than 4 satellites it coasts on its last velocity for a while.
    """

    reads: ClassVar[tuple[str, ...]] = ("position_ned", "velocity_ned", "sky", "position_low_ned", "ground", "skyline")
    draws_alone: ClassVar[bool] = True

    def init(
        self,
        draw: Draw,
        position_ned: Vec3,
        velocity_ned: Vec3,
        sky: SkyState,
        position_low_ned: Vec3 | None = None,
        ground: Ground | None = None,
        skyline: Skyline | None = None,
    ) -> tuple[GnssState, GnssFix]:
        """Return state and first fix of receivers that have been running for long, so filters are settled."""
        return self._started(draw, position_ned, velocity_ned, sky, position_low_ned, ground, skyline, None)

    def restart(
        self,
        state: GnssState,
        draw: Draw,
        since: Array,
        position_ned: Vec3,
        velocity_ned: Vec3,
        sky: SkyState,
        position_low_ned: Vec3 | None = None,
        ground: Ground | None = None,
        skyline: Skyline | None = None,
    ) -> tuple[GnssState, GnssFix]:
        """Return state and first fix of receivers that were moved to other positions, ``since`` [s] after an epoch."""
        shared = state.geometry
        fresh, reading = self._started(draw, position_ned, velocity_ned, sky, position_low_ned, ground, skyline, shared)
        return replace(fresh, true_ned=fresh.true_ned - velocity_ned * since), reading

    def placed(self, chosen: Array, fresh: GnssState, before: GnssState) -> GnssState:
        """Return ``before`` with the receivers ``chosen`` (n,) taken from ``fresh``; shared parts are unchanged."""
        shared: dict[str, object] = {"geometry": before.geometry, "ids": before.ids}
        if fresh.tracking is not None and before.tracking is not None:
            shared["tracking"] = before.tracking.placed(chosen, fresh.tracking)
        if before.ranges is not None and before.apart is None:
            shared["ranges"] = before.ranges
        nothing = dict.fromkeys(shared)
        return replace(select(chosen, replace(fresh, **nothing), replace(before, **nothing)), **shared)

    def step(
        self,
        state: GnssState,
        draw: Draw,
        position_ned: Vec3,
        velocity_ned: Vec3,
        sky: SkyState,
        position_low_ned: Vec3 | None = None,
        ground: Ground | None = None,
        skyline: Skyline | None = None,
    ) -> tuple[GnssState, GnssFix]:
        """Return the receivers' state after an epoch at ``position_ned`` (n,) [m], and the fix ``delay`` epochs old."""
        slots: Slots = sky.slots
        same = slots.ids == state.ids
        age, effect = None, None
        if state.geometry is None:
            seen, effect = self._tracked(slots, position_ned, ground, skyline, state.age)
            age = aged(self, seen, same[:, None], state.age)
            now = geometry_of(self, slots, seen, age, None, None if effect is None else effect.jam)
        else:
            now = lax.cond(
                slots.knot == state.geometry.knot, lambda: state.geometry, lambda: self._renewed(state, slots)
            )
        fast, slow = step_multipath(self, state, draw, slots, same, velocity_ned)
        whole, tracking = now, None
        if skyline is not None:
            signals = (position_ned, fast, slow, effect)
            now, tracking = solved(self, skyline, slots, whole, state.tracking, same, *signals)
        normals = draw.normals(6)
        shared, moved_on, ranges, apart = common_errors(self, now, state, draw, sky, same)
        own = own_error(now, state.bias, position_ned, fast, slow)
        error = own + shared
        thermal = correlated(now.noise, normals[:3]) * jnp.sqrt(thermal_variance(self))
        own, error = own + thermal, error + thermal

        enough = now.enough
        fixes = jnp.where(enough, jnp.minimum(state.fixes + 1.0, float(_MANY)), 0.0)
        link, quality, before = state.link, plain(self, now), state.outer
        if link is None:
            inner, outer = lagged(self, state, error, moved_on, fixes)
            said = outer
        else:
            got = fixing.received(self, slots, link, position_ned, now, own, error, moved_on, effect)
            # The filter restarts if the receiver begins or ends to use corrections.
            fixes = jnp.where(enough & (got.on != link.on), 1.0, fixes)
            inner, outer = lagged(self, state, got.error, got.moved_on, fixes, got)
            before = link.said
            link, quality = fixing.stepped(self, link, draw, slots, now, got, outer, fixes)
            said = link.said
        way = moved(position_ned, position_low_ned, state)
        if self.velocity == "doppler":
            noise = correlated(now.noise, normals[3:]) * jnp.asarray(self.doppler_noise)
            velocity = velocity_ned + moved_on * (1.0 / self.period) + noise
        else:
            mean = (way + (said - before)) * (1.0 / self.period)
            velocity = mean.map(lambda axis: jnp.where(fixes > 1.0, axis, jnp.nan))
        held = state.history[-1]
        coasted = jnp.where(enough, 0.0, state.coasted + 1.0)
        lasts = coasted * self.period < self.coast + 0.5 * self.period
        coasting = ~enough & lasts & jnp.isfinite(held.velocity_ned.x)
        further = held.velocity_ned * self.period - way
        drifted = Vec3(*(jnp.where(coasting, a + b, a) for a, b in zip(before.axes, further.axes, strict=True)))
        outer, inner, said = select(enough & (fixes > 0.0), (outer, inner, said), (drifted, drifted, drifted))
        if link is not None:
            link = replace(link, said=said)
        shown, velocity = misled(effect, said, velocity)
        place = placed_at(position_ned, position_low_ned, shown)
        fresh = fix_of(self, now, quality, place, velocity, held, coasting, effect)
        if self.per_satellite:
            fresh = with_satellites(self, fresh, now, slots, effect, position_ned, ground, skyline, slow)
        history = (*state.history, fresh)
        state = GnssState(
            geometry=None if state.geometry is None else whole,
            age=age,
            ids=slots.ids,
            fast=fast,
            slow=slow,
            inner=inner,
            outer=outer,
            fixes=fixes,
            coasted=coasted,
            bias=state.bias,
            true_ned=position_ned,
            true_low_ned=position_low_ned,
            ranges=ranges,
            apart=apart,
            history=history[1:],
            link=link,
            tracking=tracking,
        )
        return state, history[-1 - self.delay]

    def _started(
        self,
        draw: Draw,
        position_ned: Vec3,
        velocity_ned: Vec3,
        sky: SkyState,
        position_low_ned: Vec3 | None,
        ground: Ground | None,
        skyline: Skyline | None,
        shared: Geometry | None,
    ) -> tuple[GnssState, GnssFix]:
        """Return state and reading of receivers with settled filters; ``shared``: the common solution, if known."""
        slots: Slots = sky.slots
        alike = (ground is None or not ground.hides) and slots.interference is None
        now, age, effect = shared, None, None
        if now is None:
            old = jnp.full((*slots.ids.shape, *(() if alike else position_ned.x.shape)), _LONG_S, slots.part.dtype)
            old = old[:, None] if alike else old
            seen, effect = self._tracked(slots, position_ned, ground, skyline, old)
            age = None if alike else jnp.where(seen, old, 2.0 * AWAY)
            now = geometry_of(self, slots, seen, old, None, None if effect is None else effect.jam)
        normals = draw.normals(6)
        pair = draw.normal_rows(2 * len(LETTERS), first=_BIAS_PAIR)
        spread = jnp.asarray(self.system_bias)
        bias = tuple(spread * pair[i] for i in range(len(self.systems) - 1))
        fast, slow = draw.normal_pairs(slots.ids + jnp.uint32(MULTIPATH_PAIRS))
        whole, tracking = now, None
        if skyline is not None:
            now, tracking = solved(self, skyline, slots, whole, None, None, position_ned, fast, slow, effect)
        speed = velocity_ned.norm()
        settled = [jnp.sqrt(passed(self, 1.0 / time + speed / self.multipath_length)) for time in times(self)]
        shared_errors, ranges, apart = first_common(self, now, draw, sky)
        own = own_error(now, bias, position_ned, across(settled[0]) * fast, across(settled[1]) * slow)
        error = own + shared_errors
        noise = correlated(now.noise, normals[3:]) * jnp.asarray(self.doppler_noise)
        nothing = jnp.zeros_like(position_ned.x)
        none = Vec3(nothing, nothing, nothing)
        fixes, said, link, quality = nothing + float(_MANY), error, None, plain(self, now)
        if self.takes_base:
            got = fixing.received(self, slots, None, position_ned, now, own, error, none, effect)
            link, quality = fixing.started(self, draw, slots, now, got)
            error, said = got.error, link.said
            if self.corrections == "rtk":
                fixes = jnp.where(got.on, self.smoothing_time / self.period, fixes)
        shown, velocity = misled(effect, said, velocity_ned + noise)
        place = placed_at(position_ned, position_low_ned, shown)
        without = GnssFix(none, none, *(nothing,) * 8)
        reading = fix_of(self, now, quality, place, velocity, without, nothing > 0.0, effect)
        if self.per_satellite:
            reading = with_satellites(self, reading, now, slots, effect, position_ned, ground, skyline, slow)
        enough = jnp.broadcast_to(now.enough, nothing.shape)
        error = error.map(lambda axis: jnp.where(enough, axis, 0.0))
        state = GnssState(
            geometry=whole if alike else None,
            age=age,
            ids=slots.ids,
            fast=fast,
            slow=slow,
            inner=error,
            outer=error,
            fixes=jnp.where(enough, fixes, nothing),
            coasted=nothing,
            bias=bias,
            true_ned=position_ned,
            true_low_ned=position_low_ned,
            ranges=ranges,
            apart=apart,
            history=(reading,) * max(self.delay, 1),
            link=link,
            tracking=tracking,
        )
        return state, reading

    def _tracked(
        self, slots: Slots, position_ned: Vec3, ground: Ground | None, skyline: Skyline | None, age: Array
    ) -> tuple[Array, Effect | None]:
        """Return (K, m) bool: the receiver tracks the satellite, and the effect of interference, None without any.

        ``age``: time (K, m) [s] for which each satellite has been tracked.
        """
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
        """Return the receivers' common position solution for the satellites' positions at a new update (knot)."""
        before: Geometry = state.geometry
        passed_s = (slots.knot - before.knot).astype(before.age.dtype) * slots.knot_s
        same = (slots.ids == state.ids)[:, None]
        # What is new came into view since the last knot.
        age = jnp.where(same & (before.age > 0.0), jnp.minimum(before.age + passed_s, _LONG_S), _JUST_S)
        return geometry_of(self, slots, sights(self, slots, None, None), age)
