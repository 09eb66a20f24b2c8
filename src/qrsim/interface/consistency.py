"""Consistency of the fleets' estimators in flight: their errors compared with the uncertainty that they report."""

from __future__ import annotations

from collections.abc import Iterator

import jax.numpy as jnp
from jax import Array, lax

from qrsim.control.consistency import Consistency, Truth
from qrsim.core.tree import concatenated, quantity, record
from qrsim.core.vectors import Vec3, rotation
from qrsim.world.state import Fleet, FleetState, State, World

# Time between two samples [s]: errors of a filter last longer, and a sample costs as much as a tick of the filter.
EVERY_S = 1.0


@record
class Looks:
    """Sums of the normalised squared errors of n vehicles so far, each (n,)."""

    total: Consistency = quantity(unit="1", doc="sums")
    count: Array = quantity(doc="int32 samples")

    @staticmethod
    def none(world: World, state: State) -> Looks | None:
        """Return zero sums of normalised squared errors, at a flight's start; None if no estimator reports an
        uncertainty."""
        if all(fleet.belief is None or fleet.belief.std is None for fleet in state.fleets):
            return None
        code = jnp.concatenate([fleet.violation.code for fleet in state.fleets])
        zero = jnp.zeros(code.shape, state.fleets[0].vehicle.position_ned.x.dtype)
        return Looks(Consistency(zero, zero, zero, zero, zero), jnp.zeros(code.shape, jnp.int32))

    def update(self, world: World, state: State, tick: Array, flying: Array) -> Looks:
        """Return the sums of normalised squared errors with a sample of the vehicles ``flying`` (n,) added every
        ``EVERY_S`` [s]; NaN without a reported uncertainty."""

        def look() -> Looks:
            """Return the sums with the normalised squared errors at this tick added."""
            parts = [_consistency_of(fleet, part) for fleet, part in zip(world.fleets, state.fleets, strict=True)]
            now: Consistency = concatenated(parts)
            sums = {
                name: total + jnp.where(flying, getattr(now, name), 0.0) for name, total in vars(self.total).items()
            }
            return Looks(Consistency(**sums), self.count + flying.astype(jnp.int32))

        ticks = max(1, round(EVERY_S / world.time_step))
        return lax.cond((tick > 0) & (tick % ticks == 0), look, lambda: self)


def truth_of(fleet: Fleet, state: FleetState) -> Truth:
    """Return the true values of a fleet's estimated quantities, each (n,), or (T, n) for a history of states."""
    pose = fleet.vehicle.pose(state.vehicle)
    biases = dict(_biases(fleet, state))
    velocity = rotation(pose.attitude).to_ned(pose.velocity_body)
    return Truth(
        pose.position_ned,
        velocity,
        pose.attitude,
        state.position_low_ned,
        biases.get("rates_body"),
        biases.get("specific_force"),
    )


def _biases(fleet: Fleet, state: FleetState) -> Iterator[tuple[str, Vec3]]:
    """Yield (field of a reading, true sensor bias) for each bias that is simulated; the first sensor with a field
    counts."""
    seen: set[str] = set()
    zero = jnp.zeros_like(state.vehicle.position_ned.x)
    for sensor, memory, reading in zip(fleet.sensors, state.sensors, state.readings, strict=True):
        known = sensor.biases(memory)
        for name in reading.__dataclass_fields__:
            if name in known and name not in seen:
                bias = known[name]
                yield name, bias if isinstance(bias, Vec3) else Vec3(*(zero + bias for _ in range(3)))
            seen.add(name)


def _consistency_of(fleet: Fleet, state: FleetState) -> Consistency:
    """Return the normalised squared errors (n,) of a fleet's estimates; NaN without a reported uncertainty."""
    errors, estimator = None, fleet.own_estimator
    if state.belief is not None and estimator is not None:
        errors = estimator.consistency(state.belief.memory, truth_of(fleet, state))
    nothing = jnp.full_like(state.vehicle.position_ned.x, jnp.nan)
    return Consistency(*(nothing,) * 5) if errors is None else errors
