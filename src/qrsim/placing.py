"""Vehicles put into given states between two ticks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.control import Estimate
from qrsim.core.tree import replace, select
from qrsim.core.vectors import Euler, Vec3, rotation
from qrsim.errors import UsageError
from qrsim.models.area import Violation, collisions, reason_text
from qrsim.world import Fleet, FleetState, State, World, own_checks

FloatArray = np.ndarray[Any, Any]
WIDTHS = (3, 6, 12, 13)


def placed(world: World, state: State, rows: Any, names: Sequence[str]) -> State:
    """Return a state with vehicles put into the states ``rows``; see ``Simulation.set_state``.

    Raises:
        UsageError: wrong shape, a row that is partly NaN, or a state beyond area and limits or in collision.
    """
    dtype = np.dtype(world.fleets[0].start.position_ned.x.dtype)
    full, chosen = _rows(rows, names, dtype)
    ends = np.cumsum([fleet.size for fleet in world.fleets])
    fleets = tuple(
        _place(fleet, fleet_state, full[end - fleet.size : end], chosen[end - fleet.size : end])
        for fleet, fleet_state, end in zip(world.fleets, state.fleets, ends, strict=True)
    )
    _refuse(world, fleets, chosen, names)
    return jax.tree.map(np.asarray, replace(state, fleets=fleets))


def _rows(rows: Any, names: Sequence[str], dtype: np.dtype[Any]) -> tuple[FloatArray, FloatArray]:
    """Return states (n, 13), NaN where not given, and which vehicles (n,) are placed."""
    try:
        given = np.asarray(rows, dtype)
    except (TypeError, ValueError):
        given = np.zeros(0, dtype)
    if given.ndim != 2 or len(given) != len(names) or given.shape[1] not in WIDTHS:
        raise UsageError(f"state: expected shape ({len(names)}, 13), 12, 6 or 3 columns, found shape {given.shape}")
    chosen = ~np.isnan(given).all(axis=1)
    wrong = chosen & ~np.isfinite(given).all(axis=1)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise UsageError(f"state: the row of vehicle {row} ('{names[row]}') is partly not finite: {given[row]}")
    full = np.zeros((len(names), 13), dtype)
    full[:, 12] = np.nan
    full[:, : given.shape[1]] = given
    return full, chosen


def _place(fleet: Fleet, state: FleetState, rows: FloatArray, chosen: FloatArray) -> FleetState:
    columns: list[Any] = [jnp.asarray(rows[:, i]) for i in range(13)]
    position, attitude = Vec3(*columns[0:3]), Euler(*columns[3:6])
    vehicle = fleet.vehicle.initial_state(position, attitude, Vec3(*columns[6:9]), Vec3(*columns[9:12]))
    thrust = jnp.where(jnp.isfinite(columns[12]), columns[12], vehicle.thrust)
    vehicle = replace(vehicle, thrust=thrust)
    estimate = Estimate(position, rotation(attitude).to_ned(vehicle.velocity_body), attitude)
    none = Violation(jnp.zeros(len(rows), jnp.int32), jnp.zeros_like(thrust))
    where = jnp.asarray(chosen)
    return replace(
        state,
        vehicle=select(where, vehicle, state.vehicle),
        estimate=select(where, estimate, state.estimate),
        controller=select(where, fleet.controller.init(estimate), state.controller),
        violation=select(where, none, state.violation),
    )


def _refuse(world: World, fleets: tuple[FleetState, ...], chosen: FloatArray, names: Sequence[str]) -> None:
    """Raise a UsageError where a placed vehicle would stop at once."""
    together = jax.tree.map(lambda *parts: jnp.concatenate(parts), *(fleet.vehicle.position_ned for fleet in fleets))
    collided = collisions(together, world.collision_distance)
    own = [
        Violation.first(own_checks(world, fleet, state), state.vehicle.thrust)
        for fleet, state in zip(world.fleets, fleets, strict=True)
    ]
    found = jax.tree.map(lambda *parts: jnp.concatenate(parts), *own).or_else(collided)
    wrong = chosen & (np.asarray(found.code) != 0)
    if wrong.any():
        row = int(np.argmax(wrong))
        why = reason_text(int(found.code[row]), float(found.value[row]))
        raise UsageError(f"state: vehicle {row} ('{names[row]}') would be invalid: {why}")
