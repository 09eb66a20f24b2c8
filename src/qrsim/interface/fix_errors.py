"""Errors of GNSS fixes, accumulated in flight: reported position minus the true one at the time of the fix."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.arrays import NumpyArray
from qrsim.core.tree import concatenated, quantity, record, replace, select
from qrsim.core.vectors import Vec3
from qrsim.interface.extremes import Extreme
from qrsim.models.gnss.receivers import GnssReading
from qrsim.world.state import Fleet, FleetState, State, World, period_ticks

# Both parts of a true position (n,); the second one None in double precision.
Truth = tuple[Vec3, Vec3 | None]


@record
class FixErrors:
    """Memory of the fixes of n vehicles, each (n,)."""

    fix_ned: Vec3 = quantity(unit="m", doc="last position that the receiver reported")
    fixes: Array = quantity(doc="int32 new fixes")
    horizontal_square: Array = quantity(unit="m^2", doc="sum over the fixes of the squared horizontal error")
    vertical_square: Array = quantity(unit="m^2", doc="sum over the fixes of the squared vertical error")
    without_fix: Array = quantity(doc="int32 ticks without a fix")
    loss: Extreme = quantity(doc="the first loss of the fix; its value is 1")
    past: tuple[tuple[tuple[Vec3, Vec3 | None], ...], ...] = quantity(
        doc="of each fleet its true positions at the last epochs, as many as its fixes are late"
    )

    @staticmethod
    def none(world: World, state: State, like: Array) -> FixErrors:
        """Return sums of zero for the errors of n vehicles' GNSS fixes, at a flight's start, shaped as ``like``
        (n,)."""
        count, zero, nothing = jnp.zeros(like.shape, jnp.int32), jnp.zeros_like(like), Extreme.none(like)
        past = tuple(
            (_truth(now),) * _delay_periods(fleet, now) for fleet, now in zip(world.fleets, state.fleets, strict=True)
        )
        return FixErrors(nothing.position_ned, count, zero, zero, count, nothing, past)

    def update(self, world: World, state: State, tick: Array, flying: Array) -> FixErrors:
        """Return the sums updated by a tick, for vehicles in ``flying`` (n,) bool; vehicles without a receiver count
        nothing."""
        reported, has = concatenated([_fix(fleet) for fleet in state.fleets])
        error = concatenated(
            [
                _minus(_fix(now)[0], past[-1] if past else _truth(now))
                for now, past in zip(state.fleets, self.past, strict=True)
            ]
        )
        # A receiver repeats itself between two fixes; with a delay of one period, once after the start too.
        counts = jnp.isfinite(error.x) & flying & differs(reported, self.fix_ned)
        lost = has & flying & ~jnp.isfinite(error.x)
        first = lost & (self.loss.tick < 0)
        position = concatenated([fleet.vehicle.position_ned for fleet in state.fleets])
        return replace(
            self,
            fix_ned=reported,
            fixes=self.fixes + counts.astype(jnp.int32),
            horizontal_square=self.horizontal_square + jnp.where(counts, error.x * error.x + error.y * error.y, 0.0),
            vertical_square=self.vertical_square + jnp.where(counts, error.z * error.z, 0.0),
            without_fix=self.without_fix + (lost & (tick > 0)).astype(jnp.int32),
            loss=self.loss.update(jnp.ones_like(error.x), tick, position, first),
            past=tuple(
                _later(world, fleet, now, past, tick)
                for fleet, now, past in zip(world.fleets, state.fleets, self.past, strict=True)
            ),
        )

    def finish(self, dt: float) -> dict[str, NumpyArray]:
        """Return the metrics of GNSS fixes by name, each (W, n), for W worlds; ``dt``: time step [s]."""
        count = np.asarray(self.fixes)

        def root_mean(total: Array) -> NumpyArray:
            """Return the root mean square from a sum of squares, NaN without fixes."""
            return np.sqrt(np.where(count > 0, np.asarray(total) / np.maximum(count, 1), np.nan))

        return {
            "gnss_horizontal_rms_m": root_mean(self.horizontal_square),
            "gnss_vertical_rms_m": root_mean(self.vertical_square),
            "without_fix_s": np.asarray(self.without_fix) * dt,
        }


def _later(world: World, fleet: Fleet, now: FleetState, past: tuple[Truth, ...], tick: Array) -> tuple[Truth, ...]:
    """Return the true positions at the receiver's last epochs, latest first, with the present one added if an epoch is
    now."""
    if not past:
        return past
    due = tick % period_ticks(fleet.sensors[_receiver(now)].period, world.time_step) == 0
    shifted = (_truth(now), *past[:-1])
    found: tuple[Truth, ...] = select(due, shifted, past)
    return found


def _delay_periods(fleet: Fleet, now: FleetState) -> int:
    """Return the delay of a fleet's first GNSS receiver, in its periods; 0 without a receiver. ``now``: the fleet's
    state."""
    return int(fleet.sensors[_receiver(now)].delay) if _receiver(now) >= 0 else 0


def _receiver(fleet: FleetState) -> int:
    """Return the index of the first GNSS receiver among a fleet's readings, -1 without one."""
    return next((i for i, reading in enumerate(fleet.readings) if isinstance(reading, GnssReading)), -1)


def _fix(fleet: FleetState) -> tuple[Vec3, Array]:
    """Return the first receiver's reported position NED (n,) [m], and whether the fleet has a receiver, (n,) bool."""
    like, number = fleet.vehicle.position_ned.x, _receiver(fleet)
    if number >= 0:
        reading: Any = fleet.readings[number]
        return reading.position_ned, jnp.ones(like.shape, bool)
    return Vec3(*(jnp.full_like(like, jnp.nan) for _ in range(3))), jnp.zeros(like.shape, bool)


def _truth(fleet: FleetState) -> Truth:
    """Return the true positions NED (n,) [m] of a fleet, and their rounding remainders or None."""
    return fleet.vehicle.position_ned, fleet.position_low_ned


def _minus(reported: Vec3, truth: Truth) -> Vec3:
    """Return the reported minus the true position [m]; the true one may have rounding remainders."""
    position, low = truth
    return reported - position if low is None else reported - position - low


def differs(new: Vec3, old: Vec3) -> Array:
    """Return whether two vectors differ in any component, (n,) bool; NaN differs from everything."""
    return ~((new.x == old.x) & (new.y == old.y) & (new.z == old.z))
