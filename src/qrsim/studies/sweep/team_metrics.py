"""Metrics of the shipped study ``team_errors``: how a team lies, what it knows of that, and what it passes by."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import quantity, record, replace
from qrsim.world.state import State, World

# Time [s] after which errors count: before it all fly from where they stood to where they believe they should be.
SETTLED_S = 10.0
# Of the strip that a line of vehicles searches: from where on, how far [m north of the start], and by which step.
FIRST_M, STEP_M, STEPS = 20.0, 1.0, 60
# Half a vehicle's swath per spacing: neighbours' swaths overlap by a tenth of it where both are where they should be.
HALF_SWATH = 0.55


@record
class TeamMemory:
    """What is kept of the first fleet's vehicles (n,)."""

    ticks: Array = quantity(doc="(n,) counted")
    error_square: Array = quantity(unit="m^2", doc="(n,) sum over ticks of the mean over neighbours, of true places")
    estimate_square: Array = quantity(unit="m^2", doc="(n,) the same, of what their estimates say beside the truth")
    start_north: Array = quantity(unit="m", doc="(n,) where it started")
    start_east: Array = quantity(unit="m", doc="(n,)")
    passed_east: Array = quantity(unit="m", doc="(n, STEPS) east coordinate where it passed each step to the north")


class TeamErrors:
    """Errors of neighbours' places to each other, and the part of a searched strip that nobody saw.

    Neighbours are those at the smallest distance at the start; they should always lie to each other as they did then.
    Errors are horizontal, of flying vehicles, from SETTLED_S on. The strip lies between the outer vehicles of a line
    that flies north; each vehicle sees HALF_SWATH times the spacing to either side of where it passes.
    """

    numbers: ClassVar[dict[str, dict[str, str]]] = {
        "relative_error_rms_m": {"unit": "m", "doc": "of neighbours' places to each other, horizontal", "over": "rms"},
        "relative_estimate_rms_m": {
            "unit": "m",
            "doc": "of what estimates say of these places, horizontal",
            "over": "rms",
        },
        "missed_share": {"unit": "1", "doc": "part of the strip between the outer vehicles that none came near enough"},
    }

    def init(self, world: object, state: State) -> TeamMemory:
        """Return the accumulators at the start of a flight."""
        place = state.fleets[0].vehicle.position_ned
        zero = jnp.zeros_like(place.x)
        nowhere = jnp.full((*zero.shape, STEPS), jnp.nan, zero.dtype)
        return TeamMemory(jnp.zeros(zero.shape, jnp.int32), zero, zero, place.x, place.y, nowhere)

    def update(self, memory: TeamMemory, world: World, state: State, tick: Array) -> TeamMemory:
        """Return the accumulators with the errors of one tick added."""
        fleet, start = state.fleets[0], (memory.start_north, memory.start_east)
        flying, counts = fleet.violation.code == 0, tick >= round(SETTLED_S / world.time_step)
        near = _neighbours(*start) & flying[:, None] & flying[None]
        neighbours = jnp.maximum(jnp.sum(near, axis=1), 1).astype(memory.error_square.dtype)
        true, known = fleet.vehicle.position_ned, fleet.estimate.position_ned

        def mean_square(position: Sequence[Array], wanted: Sequence[Array]) -> Array:
            """Return each vehicle's mean square error [m^2] of the positions of its neighbours relative to it."""
            off = (_differences(axis) - _differences(other) for axis, other in zip(position, wanted, strict=True))
            square = sum(jnp.square(each) for each in off)
            return jnp.sum(jnp.where(near, square, 0.0), axis=1) / neighbours

        error = mean_square((true.x, true.y), start)
        wrong = mean_square((known.x, known.y), (true.x, true.y))
        step = jnp.floor((true.x - memory.start_north - FIRST_M) / STEP_M)
        here = (step[:, None] == jnp.arange(STEPS, dtype=step.dtype)[None]) & flying[:, None]
        return replace(
            memory,
            ticks=memory.ticks + jnp.where(counts, 1, 0),
            error_square=memory.error_square + jnp.where(counts, error, 0.0),
            estimate_square=memory.estimate_square + jnp.where(counts, wrong, 0.0),
            passed_east=jnp.where(here, true.y[:, None], memory.passed_east),
        )

    def finish(self, memory: TeamMemory, world: object, state: object) -> dict[str, Array]:
        """Return metrics of W worlds: per vehicle (W, n), of the team (W,)."""
        ticks = jnp.maximum(memory.ticks, 1).astype(memory.error_square.dtype)
        return {
            "relative_error_rms_m": jnp.sqrt(memory.error_square / ticks),
            "relative_estimate_rms_m": jnp.sqrt(memory.estimate_square / ticks),
            "missed_share": missed_share(memory.passed_east, memory.start_north, memory.start_east),
        }


def _differences(values: Array) -> Array:
    """Return the matrix (n, n) of values (n,): value of the second index minus that of the first."""
    return values[None] - values[:, None]


def _neighbours(north: Array, east: Array) -> Array:
    """Return a mask (n, n) of the pairs of vehicles closest to each other, from coordinates (n,) [m]."""
    square = jnp.square(_differences(north)) + jnp.square(_differences(east))
    square = jnp.where(jnp.eye(square.shape[0], dtype=bool), jnp.inf, square)
    return square < 1.01 * jnp.min(square)


def missed_share(passed_east: Array, start_north: Array, start_east: Array) -> Array:
    """Return the share (W,) of the strip between the outer vehicles that no sensor swath covers; NaN if not in line.

    Args:
        passed_east: (W, n, STEPS) east coordinate [m] where vehicles passed each step; NaN where they did not.
        start_north: (W, n) [m].
        start_east: (W, n) [m].
    """
    west, east = start_east.min(-1), start_east.max(-1)
    spacing = (east - west) / max(start_east.shape[-1] - 1, 1)
    edges, half = west[..., None, None], HALF_SWATH * spacing[..., None, None]
    # Who never passed sees nothing: it is put where it adds nothing.
    order = jnp.sort(jnp.where(jnp.isnan(passed_east), -jnp.inf, passed_east), axis=-2)
    low, high = (jnp.clip(order + side, edges, east[..., None, None]) for side in (-half, half))
    # The swaths further west all end before this one does.
    before = jnp.concatenate([jnp.broadcast_to(edges, high[..., :1, :].shape), high[..., :-1, :]], axis=-2)
    seen = jnp.sum(jnp.maximum(high - jnp.maximum(low, before), 0.0), axis=-2)
    line = start_north.max(-1) - start_north.min(-1) < 0.01 * spacing
    return jnp.where(line, jnp.maximum(1.0 - seen.mean(-1) / (east - west), 0.0), jnp.nan)
