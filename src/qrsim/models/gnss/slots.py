"""The sky of receivers with many satellites: those in view have slots, and all else changes every few seconds.

Positions, mappings and common errors are computed at knots, for all satellites, and are linear in between: over 5 s a
direction errs by less than 1e-7 rad, and errors of minutes by nothing that can be seen.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from qrsim.core.clock import split_time
from qrsim.core.noise import Draw
from qrsim.core.tree import map_tree, quantity, record, replace, setting
from qrsim.core.vectors import Vec3
from qrsim.models.gnss.base_station import BaseState, BaseStation
from qrsim.models.gnss.contracts import RangeErrors, Sky
from qrsim.models.gnss.interference import Interference, Interfering
from qrsim.models.gnss.orbits import Ephemeris, Orbits, elevation_azimuth
from qrsim.models.gnss.receivers import SkyState
from qrsim.models.gnss.sight import CommonErrors, Scales, Sight, sight_of
from qrsim.models.site import Site

# Time between knots [s], and the number of a free slot.
KNOT_S = 5.0
NOBODY = 0xFFFFFFFF
# Slots: for the satellites in view over a day [s], sampled at this interval [s]; spare ones; and the largest number.
DAY_S, LOOK_S, SPARE_SLOTS, MOST_SLOTS = 86400.0, 120.0, 1, 48


@record
class Slots:
    """The satellites in view since a knot, in K slots; what a free slot holds is finite and means nothing."""

    ids: Array = quantity(doc="(K,) uint32 number of the satellite, NOBODY of a free slot")
    system: Array = quantity(doc="(K,) int32 number of its system")
    places: Array = quantity(doc="(K,) int32 place of it among all satellites, -1 of a free slot")
    sight: Sight = quantity(doc="(K,) how it is seen")
    before: CommonErrors = quantity(doc="(K,) errors that all receivers share, at the last knot")
    after: CommonErrors = quantity(doc="(K,) at the next")
    scales: Scales = quantity(doc="(K,) their standard deviations")
    dropped: Array = quantity(doc="() int32 satellites in view that have found no slot, the lowest ones")
    knot: Array = quantity(doc="() int32 number of the knot: while it lasts, all of the above does")
    part: Array = quantity(unit="1", doc="() how far it is from the last knot to the next")
    own: Any = quantity(default=None, doc="the range errors, where every receiver has its own")
    base: Any = quantity(default=None, doc="BaseSeen of a base station, None without one")
    interference: Interfering | None = quantity(
        default=None, doc="Interfering, what interferes at this epoch; None if nothing can"
    )
    knot_s: float = setting(default=KNOT_S, unit="s", doc="time from one knot to the next")
    rough: bool = setting(default=False, doc="range errors are stepped at every epoch, and not by knots")


@record
class Ends:
    """Positions and range errors of all S satellites at the last and next knot, for receivers of the older kind."""

    before_ned: Vec3 = quantity(unit="m", doc="(S,) positions at the last knot")
    error_before: Array = quantity(unit="m", doc="(S,) range errors at the last knot")
    error_after: Array = quantity(unit="m", doc="(S,) range errors at the next")


@record
class SlottedMemory:
    """State of a slotted sky, for all S satellites."""

    errors: Any = quantity(doc="state of the range errors, at the next knot or at the epoch")
    after_ned: Vec3 = quantity(unit="m", doc="positions at the next knot")
    ends: Ends | None = quantity(doc="Ends, where receivers of the older kind need them, else None")
    base: Any = quantity(default=None, doc="state of the base station, None without one")


@record
class SlottedSky(Sky):
    """A sky with slots for its satellites in view; receivers of the older kind see it as they see any other."""

    orbits: Orbits = quantity(doc="satellite positions as seen from the site")
    errors: RangeErrors = quantity(doc="range errors")
    ids: Array = quantity(doc="(S,) uint32 number of each satellite, which its randomness belongs to")
    system: Array = quantity(doc="(S,) int32 number of each satellite's system")
    period: float = setting(doc="interval between epochs [s]")
    time_step: float = setting(doc="simulation step [s]")
    slots: int = setting(doc="number of slots")
    lowest_sine: float = setting(doc="sine of the elevation above which a satellite is in view")
    each_epoch: bool = setting(
        default=True, doc="positions and errors of all satellites are of every epoch, not of the last knot"
    )
    base: BaseStation | None = quantity(default=None, doc="base station that sends corrections")
    interference: Interference | None = quantity(default=None, doc="jammers, spoofers, outages, storms")

    @property
    def knot_ticks(self) -> int:
        """Number of ticks between two updates of the satellites (knots), a multiple of an epoch's ticks."""
        return max(1, round(self.period / self.time_step)) * max(1, round(KNOT_S / self.period))

    @property
    def knot_s(self) -> float:
        """Time [s] between two updates of the satellites (knots)."""
        return self.knot_ticks * self.time_step

    def init(self, draw: Draw) -> SkyState:
        """Return the satellites' state at the start of an episode, which is an update (knot)."""
        zero = jnp.zeros_like(draw.like)
        errors = self.errors.init(draw)
        here = self.orbits.positions_ned(jnp.int32(0), zero)
        later = self.orbits.positions_ned(*split_time(jnp.int32(self.knot_ticks), self.time_step, zero.dtype))
        # Of the same stream at another tick, because two steps must not have the same normals.
        ahead = replace(draw, tick=draw.tick + 1)
        advanced = self._advanced(errors, ahead)
        nobody = jnp.full((self.slots,), -1, jnp.int32)
        memory, slots, error = self._from(errors, advanced, here, later, nobody, jnp.int32(0))
        if self.base is not None:
            base = self.base.init(draw)
            memory, slots = self._with_base(memory, slots, base, self.base.step(base, ahead, self.knot_s))
        slots = self._with_base_and_interference(memory, slots, jnp.int32(0), zero)
        return SkyState(here, error, jnp.zeros_like(error), memory, jnp.asarray(self.ids), slots)

    def step(self, state: SkyState, draw: Draw, seconds: Array, fraction: Array) -> SkyState:
        """Return the satellites' state one epoch later, at ``seconds`` (int32) plus ``fraction`` [s] in the run."""
        tick = draw.tick.astype(jnp.int32)

        def held() -> tuple[object, ...]:
            """Return the satellites' state held from the last update (knot)."""
            # Interference changes at every epoch and is set below.
            return state.memory, replace(state.slots, interference=None), state.satellites_ned, state.range_error

        memory, slots, satellites, error = lax.cond(tick % self.knot_ticks == 0, lambda: self._knot(state, draw), held)
        part = (tick % self.knot_ticks).astype(fraction.dtype) * (1.0 / self.knot_ticks)
        if self.base is not None:
            memory = replace(memory, base=self.base.carried(memory.base, draw, self.period))
        slots = self._with_base_and_interference(memory, slots, seconds, fraction)
        if self.each_epoch:
            satellites = map_tree(lambda a, b: _between(a, b, part), memory.ends.before_ned, memory.after_ned)
            error = _between(memory.ends.error_before, memory.ends.error_after, part)
        if not self.errors.needs_sight:
            memory = replace(memory, errors=self.errors.step(memory.errors, draw, self.period))
            error = self.errors.value(memory.errors)
        changes = self.each_epoch or not self.errors.needs_sight
        rate = (error - state.range_error) * (1.0 / self.period) if changes else state.range_rate_error
        return SkyState(satellites, error, rate, memory, state.ids, replace(slots, part=part))

    @property
    def steps_by_parts(self) -> bool:
        """True if only the interpolation between two updates (knots) changes from epoch to epoch."""
        plain = self.base is None and self.interference is None
        return plain and self.errors.needs_sight and not self.each_epoch

    def step_by_parts(self, state: SkyState, draw: Draw, tick: Array) -> SkyState:
        """Return the satellites' state at a tick () int32, with branches that copy only the parts that change."""
        epoch = max(1, round(self.period / self.time_step))

        def held() -> tuple[object, ...]:
            """Return the satellites' state held from the last update (knot)."""
            return state.memory, replace(state.slots, part=None), state.satellites_ned, state.range_error

        def knot() -> tuple[object, ...]:
            """Return the satellites' state at a new update (knot)."""
            memory, slots, satellites, error = self._knot(state, draw)
            return memory, replace(slots, part=None), satellites, error

        memory, slots, satellites, error = lax.cond(tick % self.knot_ticks == 0, knot, held)
        old = state.slots.part
        part = (tick % self.knot_ticks).astype(old.dtype) * (1.0 / self.knot_ticks)
        slots = replace(slots, part=jnp.where(tick % epoch == 0, part, old))
        return SkyState(satellites, error, state.range_rate_error, memory, state.ids, slots)

    def _knot(self, state: SkyState, draw: Draw) -> tuple[object, ...]:
        """Return the parts of the satellites' state at an update (knot); those of the next one are computed ahead."""
        memory, tick = state.memory, draw.tick.astype(jnp.int32)
        here = memory.after_ned
        ahead = self.orbits.positions_ned(*split_time(tick + self.knot_ticks, self.time_step, draw.like.dtype))
        # Recorded orbits may end before the next knot; over so short a time a line is as good.
        before = state.satellites_ned if memory.ends is None else memory.ends.before_ned
        missing = ~jnp.isfinite(ahead.z)
        ahead = map_tree(lambda line, orbit: jnp.where(missing, line, orbit), here + (here - before), ahead)
        advanced = self._advanced(memory.errors, draw)
        knot = tick // self.knot_ticks
        base = memory.base
        memory, slots, error = self._from(memory.errors, advanced, here, ahead, state.slots.places, knot)
        if self.base is not None:
            memory, slots = self._with_base(memory, slots, base, self.base.step(base, draw, self.knot_s))
        return memory, slots, here, error

    def _with_base(
        self, memory: SlottedMemory, slots: Slots, now: BaseState, later: BaseState
    ) -> tuple[SlottedMemory, Slots]:
        """Return the state's memory and slots with the base station's data from this update (knot) to the next."""
        assert self.base is not None
        seen, taken = self.base.seen(now, later), jnp.maximum(slots.places, 0)
        seen = replace(seen, code_before=seen.code_before[taken], code_after=seen.code_after[taken])
        return replace(memory, base=later), replace(slots, base=seen)

    def _with_base_and_interference(
        self, memory: SlottedMemory, slots: Slots, seconds: Array, fraction: Array
    ) -> Slots:
        """Return slots with the base station's corrections and the interference of an epoch."""
        if self.base is not None:
            slots = replace(slots, base=self.base.heard(slots.base, memory.base.carrier, seconds, fraction))
        if self.interference is not None:
            slots = replace(slots, interference=self.interference.at(slots.places, seconds, fraction))
        return slots

    def _advanced(self, errors: object, draw: Draw) -> object:
        """Return the range errors at the next update (knot); unchanged if they are stepped at every epoch."""
        return self.errors.step(errors, draw, self.knot_s) if self.errors.needs_sight else errors

    def _from(
        self, errors: object, advanced: object, here: Vec3, later: Vec3, places: Array, knot: Array
    ) -> tuple[SlottedMemory, Slots, Array]:
        """Return memory, slots and range errors (S,) from update (knot) ``knot`` on; satellites in view keep slots."""
        sights = [sight_of(where) for where in (here, later)]
        system = jnp.asarray(self.system)
        common = [self.errors.seen(e, s, system) for e, s in zip((errors, advanced), sights, strict=True)]
        if self.interference is not None:
            ticks = (knot * self.knot_ticks, (knot + 1) * self.knot_ticks)
            times = [split_time(tick, self.time_step, here.x.dtype) for tick in ticks]
            common = [self.interference.stormy(c, *time) for c, time in zip(common, times, strict=True)]
        highest = jnp.maximum(*(-sight.line_of_sight.z for sight in sights))
        # Of a satellite without a position this is NaN, which fails the comparison.
        places, dropped = assigned(highest > self.lowest_sine, highest, places)
        taken, free = jnp.maximum(places, 0), places < 0

        def picked(leaf: Array) -> Array:
            """Return the values (K,) of the satellites in the slots, 0.5 in free slots, from those of all (S,)."""
            return jnp.where(free, 0.5, leaf[taken])

        slots = Slots(
            ids=jnp.where(free, jnp.uint32(NOBODY), jnp.asarray(self.ids)[taken]),
            system=system[taken],
            places=places,
            sight=map_tree(picked, sights[0]),
            before=map_tree(picked, common[0]),
            after=map_tree(picked, common[1]),
            scales=self.errors.scales(system[taken]),
            dropped=dropped,
            knot=knot,
            part=jnp.zeros((), here.x.dtype),
            own=self.errors if self.errors.common == "per_vehicle" else None,
            knot_s=self.knot_s,
            rough=not self.errors.needs_sight,
        )
        first, last = (each.signal + each.delay for each in common)
        ends = Ends(here, first, last) if self.each_epoch else None
        return SlottedMemory(advanced, later, ends), slots, first


def _between(first: Array, last: Array, part: Array) -> Array:
    """Return the linear interpolation from ``first`` at ``part`` 0 to ``last`` at ``part`` 1."""
    return first + part * (last - first)


def assigned(in_view: Array, highest: Array, places: Array) -> tuple[Array, Array]:
    """Return each slot's satellite after satellites entered or left the view, and the number without a slot.

    Args:
        in_view: (S,) bool.
        highest: (S,) what the highest come first by, where slots are short.
        places: (K,) int32 satellite of each slot so far, -1 of a free one.

    Returns:
        The places now, and () int32 how many satellites in view have none.
    """
    count, slots = in_view.shape[0], places.shape[0]
    kept = (places >= 0) & in_view[jnp.maximum(places, 0)]
    number = jnp.arange(count, dtype=jnp.int32)
    # One place more, for what belongs nowhere.
    has_slot = jnp.zeros(count + 1, jnp.int32).at[jnp.where(kept, places, count)].set(1)[:count] > 0
    new = in_view & ~has_slot
    free, wanted = jnp.sum(~kept, dtype=jnp.int32), jnp.sum(new, dtype=jnp.int32)

    def by_height() -> Array:
        """Return each new satellite's rank by elevation, the highest first."""
        height = jnp.where(new, highest, -2.0)
        same = (height[:, None] == height[None, :]) & (number[:, None] < number[None, :])
        return jnp.sum(new[:, None] & ((height[:, None] > height[None, :]) | same), axis=0, dtype=jnp.int32)

    rank = lax.cond(wanted > free, by_height, lambda: jnp.cumsum(new, dtype=jnp.int32) - 1)
    rank = jnp.where(new, jnp.minimum(rank, slots), slots)
    in_turn = jnp.full(slots + 1, -1, jnp.int32).at[rank].set(number)
    turn = jnp.cumsum(~kept, dtype=jnp.int32) - 1
    found = jnp.where(turn < wanted, in_turn[jnp.clip(turn, 0, slots - 1)], -1)
    return jnp.where(kept, places, found), jnp.maximum(wanted - free, 0)


def slots_needed(ephemeris: Ephemeris, site: Site, start: float, duration_s: float, lowest_sine: float) -> int:
    """Return the number of slots for all satellites in view at once: over a day, or a shorter run with a file."""
    first, last = ephemeris.span_gps_seconds
    begin = min(max(start, first), last)
    if math.isinf(last):
        return _nominal_slots(ephemeris, site, begin, begin + DAY_S, lowest_sine)  # type: ignore[arg-type]
    return _slots_between(ephemeris, site, begin, min(last, begin + min(duration_s, DAY_S)), lowest_sine)


def _slots_between(ephemeris: Ephemeris, site: Site, begin: float, end: float, lowest_sine: float) -> int:
    """Return the number of slots for all satellites in view at once between two times [GPS s]."""
    times = np.append(np.arange(begin, end, LOOK_S), end)
    rays = (ephemeris.positions_ecef(times) - site.origin_ecef()) @ site.ned_from_ecef_rotation().T
    with np.errstate(invalid="ignore"):
        in_view = elevation_azimuth(rays)[0] > math.asin(lowest_sine)
    most = int(np.max(np.sum(in_view, axis=1), initial=1))
    return min(most + SPARE_SLOTS, in_view.shape[1], MOST_SLOTS)


# Nominal orbits are given by their parameters, and a study builds many worlds under the same ones.
_nominal_slots = lru_cache(maxsize=64)(_slots_between)
