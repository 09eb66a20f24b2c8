"""Placing of vehicles in given states between two ticks."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.arrays import DType, Floats
from qrsim.core.pairs import parts_of
from qrsim.core.tree import replace, select
from qrsim.core.vectors import Euler, Vec3
from qrsim.errors import UsageError
from qrsim.models.scene.area import Violation, collisions, reason_text
from qrsim.models.vehicles.contracts import VehicleState
from qrsim.world.air import weather_at
from qrsim.world.checking import own_checks
from qrsim.world.episode import surroundings
from qrsim.world.sensing import with_traffic
from qrsim.world.starting import start_fleet
from qrsim.world.state import Fleet, FleetState, State, World

WIDTHS = (3, 6, 12, 13)


def place(world: World, given: tuple[Array, Array, Array], state: State, tick: Array) -> State:
    """Return the state with vehicles placed in other states (``given``); their sensors, controllers and noise restart.

    That is their sensors, estimates and control loops, the gusts around them, and the specific force. They keep their
    way along the route, and their battery unless it is renewed. What is drawn is drawn from the numbers of this tick.

    Args:
        world: its parameters.
        given: rows (n, 16) of all vehicles, a thrust of NaN being the weight, the last three what single precision
            leaves out of the positions; which of them (n,) are placed, and whose battery (n,) is renewed.
        state: of the world; the violations of those that are placed say whether they can be where they were put.
        tick: () int32, now.
    """
    rows, chosen, renewed = given
    world = weather_at(world.with_drawn(state.drawn), tick)
    spans, first = [], 0
    for fleet in world.fleets:
        spans.append(slice(first, first + fleet.size))
        first += fleet.size
    puts = [_vehicles(fleet, rows[mine]) for fleet, mine in zip(world.fleets, spans, strict=True)]
    together = zip(puts, state.fleets, spans, strict=True)
    there = [
        (select(chosen[mine], put, now.vehicle), chosen[mine] | (now.violation.code == 0))
        for put, now, mine in together
    ]
    view = with_traffic(world, surroundings(world, state.contents, tick), *zip(*there, strict=True))
    fleets = []
    for fleet, before, keys, mine, put in zip(world.fleets, state.fleets, state.fleet_keys, spans, puts, strict=True):
        low = Vec3(*(rows[mine, i] for i in range(13, 16)))
        fresh = start_fleet(world, fleet, put, keys, tick, state.sky, view, state.field, before, low)
        battery = select(renewed[mine], fresh.battery, before.battery)
        fresh = replace(fresh, guidance=before.guidance, setpoint=before.setpoint, battery=battery)
        pairs = zip(fleet.sensors, fresh.sensors, before.sensors, strict=True)
        sensors = tuple(sensor.placed(chosen[mine], new, old) for sensor, new, old in pairs)
        rest = select(chosen[mine], replace(fresh, sensors=()), replace(before, sensors=()))
        fleets.append(replace(rest, sensors=sensors))
    return replace(state, fleets=_checked(world, tuple(fleets), chosen))


def _vehicles(fleet: Fleet, rows: Array) -> VehicleState:
    """Convert rows (n, 13) to the states of a fleet's vehicles."""
    columns = [rows[:, i] for i in range(13)]
    vehicle = fleet.vehicle.initial_state(
        Vec3(*columns[0:3]), Euler(*columns[3:6]), Vec3(*columns[6:9]), Vec3(*columns[9:12])
    )
    return fleet.vehicle.with_thrust(vehicle, columns[12])


def _checked(world: World, fleets: tuple[FleetState, ...], chosen: Array) -> tuple[FleetState, ...]:
    """Return the fleets' states with the ``chosen`` vehicles, (n,) bool, checked against limits and collisions."""
    together = jax.tree.map(lambda *parts: jnp.concatenate(parts), *(fleet.vehicle.position_ned for fleet in fleets))
    collided = collisions(together, world.collision_distance, world.radii)
    checked, first = [], 0
    for fleet, state in zip(world.fleets, fleets, strict=True):
        mine = slice(first, first + fleet.size)
        first += fleet.size
        own = Violation.first(own_checks(world, fleet, state), state.vehicle.position_ned.x)
        found = own.or_else(jax.tree.map(lambda leaf: leaf[mine], collided))  # noqa: B023
        checked.append(replace(state, violation=select(chosen[mine], found, state.violation)))
    return tuple(checked)


def checked_rows(rows: object, names: Sequence[str], dtype: DType) -> tuple[Floats, Floats]:
    """Check the argument of ``Simulation.set_state``; return rows (n, 16), and which vehicles to place, (n,) bool.

    Raises:
        UsageError: wrong shape, or a row that is partly NaN.
    """
    try:
        given = np.asarray(rows, np.float64)
    except (TypeError, ValueError, OverflowError):
        given = np.zeros(0)
    if given.ndim != 2 or len(given) != len(names) or given.shape[1] not in WIDTHS:
        raise UsageError(f"state: expected shape ({len(names)}, 13), 12, 6 or 3 columns, found shape {given.shape}")
    chosen = np.asarray(~np.isnan(given).all(axis=1))
    with np.errstate(over="ignore"):
        rounded = given.astype(dtype)
        # The truth has no thrust of a vehicle without one.
        wrong = chosen & ~(np.isfinite(rounded[:, :12]).all(axis=1) & ~np.isinf(rounded[:, 12:]).any(axis=1))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise UsageError(f"state: the row of vehicle {row} ('{names[row]}') is partly not finite: {given[row]}")
    full = np.zeros((len(names), 13))
    full[:, 12] = np.nan
    full[chosen, : given.shape[1]] = given[chosen]
    rounded, rest = parts_of(full, dtype)
    return np.concatenate([rounded, rest[:, :3]], axis=1), chosen


def refuse_misplaced(violations: Sequence[Violation], chosen: Floats, names: Sequence[str]) -> None:
    """Raise UsageError if a ``chosen`` vehicle would stop at once in its new place because of a limit or collision.

    Args:
        violations: of each fleet, as ``place`` left them.
        chosen: (n,) which vehicles were placed.
        names: of the vehicles.

    Raises:
        UsageError: it names the first one, and why.
    """
    codes = np.concatenate([found.code for found in violations])
    values = np.concatenate([found.value for found in violations])
    wrong = chosen & (codes != 0)
    if wrong.any():
        row = int(np.argmax(wrong))
        why = reason_text(int(codes[row]), float(values[row]))
        raise UsageError(f"state: vehicle {row} ('{names[row]}') would be invalid: {why}")
